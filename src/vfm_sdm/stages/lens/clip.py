"""The lens from a pan clip: key frames, places seen again, start, adjustment, and whether to believe it."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import LensStatus
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.lens.adjustment import AdjustedClip, adjust_clip
from vfm_sdm.stages.lens.key_frames import ClipMotion, choose_key_frames, detect_in, follow_clip
from vfm_sdm.stages.lens.sightings import join_pairs, match_key_frames
from vfm_sdm.stages.lens.start import chain_turns, search_focal
from vfm_sdm.stages.lens.turning_camera import LENS, LensClip, Sightings, TurningCamera

__all__ = ["LensEstimate", "PanScene", "estimate_lens"]

_SIGHTINGS = 3
_LEAST_FRAMES, _LEAST_POINTS = 5, 60
_FOCAL_STD = 1.0
_CENTRE_STD = 0.015
"""Principal point from the image centre, over the image diagonal."""
_K1_CORNER_STD, _K2_CORNER_STD = 0.1, 0.03
"""Radial distortion at the image corner, over the radius: of lenses of any field of view."""
_READOUT_S, _READOUT_STD_S = 0.012, 0.012
_MOST_FOCAL_STD = 0.03
_WORST_NOISE = 2e-3
"""Noise over the longer side beyond which something else than turns moves the picture: SIFT finds a place ten times as
well."""
_STEADY = 3.0


@dataclass(frozen=True)
class PanScene:
    """What is known of a pan clip's scene and tripod.

    Parameters
    ----------
    nearest_m, farthest_m
        Distances between which the scene lies [m].
    lever_std_m
        Standard deviation of the lever along each axis [m]: from the point about which the camera turns to its lens.
    """

    nearest_m: float = 50.0
    farthest_m: float = 1000.0
    lever_std_m: float = 0.08

    @property
    def nearness(self) -> tuple[float, float]:
        """Mean and standard deviation of 1 / distance, as if every value between the ends were as likely [1/m]."""
        near, far = 1 / self.nearest_m, 1 / self.farthest_m
        return (near + far) / 2, max((near - far) / np.sqrt(12), 1e-3 * near)


@dataclass(frozen=True, eq=False)
class LensEstimate:
    """A lens with its uncertainty.

    Parameters
    ----------
    camera
        Intrinsics and distortion; ``None`` where the clip did not allow an estimate.
    covariance
        Of ``log_focal, cx, cy, k1``, the first of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, shape (4, 4).
    status
        ``ok``, or what is wrong.
    notes
        Sentences on what was found.
    adjusted
        The adjustment, where there was one.
    """

    camera: Camera | None
    covariance: FloatArray
    status: LensStatus
    notes: tuple[str, ...] = ()
    adjusted: AdjustedClip | None = None


def estimate_lens(video: Video, scene: PanScene) -> LensEstimate:
    """Focal length, principal point and distortion from a clip of a camera that pans, tilts and rolls.

    Parameters
    ----------
    video
        The clip.
    scene
        How far the scene is, and how long the lever.
    """
    size = (video.info.width, video.info.height)
    motion = follow_clip(video.frames())
    numbers = choose_key_frames(motion, size)
    if len(numbers) < _LEAST_FRAMES:
        return _refused(LensStatus.STILL, f"only {len(numbers)} frames show another part of the scene")
    keys = detect_in(video.frames(), numbers)
    pairs = match_key_frames(keys, size)
    if not pairs:
        return _refused(LensStatus.TOO_FEW_PLACES, "no place was found again")
    focal = search_focal(keys, pairs, size)
    connected, attitudes = chain_turns(keys, pairs, size, focal)
    frame, point, pixel = join_pairs(keys, pairs, least=_SIGHTINGS)
    kept = np.isin(frame, connected)
    _, frame = np.unique(frame[kept], return_inverse=True)
    count = np.bincount(point[kept], minlength=point.max(initial=-1) + 1)
    ...
