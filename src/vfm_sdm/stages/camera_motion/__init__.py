"""Small motion of the cameras themselves, found by points that stand still and removed from all tracks."""

from vfm_sdm.stages.camera_motion.removal import (
    CameraMotion,
    ViewMotion,
    remove_camera_motion,
    steady_tracks,
)

__all__ = ["CameraMotion", "ViewMotion", "remove_camera_motion", "steady_tracks"]
