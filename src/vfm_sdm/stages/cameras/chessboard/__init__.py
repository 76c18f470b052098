"""Cameras from pictures of a chessboard: detection, order of the corners, calibration, joint adjustment."""
