"""Motion of the cameras themselves, found by points that stand still and removed from all tracks."""

from vfm_sdm.stages.camera_motion.depths import follow_depths
from vfm_sdm.stages.camera_motion.removal import remove_camera_motion, steady_tracks
from vfm_sdm.stages.camera_motion.view_motion import CameraMotion, ViewMotion

__all__ = ["CameraMotion", "ViewMotion", "follow_depths", "remove_camera_motion", "steady_tracks"]
