"""The lens of a camera from a clip in which it turns on its tripod: intrinsics without a calibration object."""
