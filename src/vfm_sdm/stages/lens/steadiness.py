"""Whether the focal length stays what it is while the camera turns."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.stages.lens.adjustment import AdjustedClip
from vfm_sdm.stages.lens.normal_equations import NormalEquations

__all__ = ["FocalCourse", "follow_focal"]

_RANK = 1e-9
"""Share of the largest information below which a combination of frames tells nothing."""


@dataclass(frozen=True, eq=False)
class FocalCourse:
    """Focal length over the time of a clip.

    Parameters
    ----------
    time_s
        When the key frames were taken, shape (F,) [s].
    deviation
        Of the logarithm of the focal length from the common one, shape (F,) [1].
    std
        Standard deviations of ``deviation``, shape (F,) [1].
    drift
        Change of the logarithm from the first key frame to the last, along the best line [1].
    drift_std
        Standard deviation of ``drift`` [1].
    """

    time_s: FloatArray
    deviation: FloatArray
    std: FloatArray
    drift: float
    drift_std: float


def follow_focal(adjusted: AdjustedClip, time_s: FloatArray) -> FocalCourse:
    """Focal length of each key frame by itself, and its drift.

    Parameters
    ----------
    adjusted
        The adjustment, with one focal length for all frames.
    time_s
        When the key frames were taken, shape (F,) [s].

    Notes
    -----
    Each frame gets a focal length of its own in one more step from the solution: its derivatives, less what lens, turns
    and scene explain of them, against the residuals. What all frames have in common is the lens's own. The scatter of
    the frames about the line widens the standard deviations where it is larger than the sightings' noise explains, so
    that errors which all sightings of a frame share are in them.
    """
    clip = adjusted.clip
    seen, frames = clip.seen, clip.seen.frames
    weights = adjusted.weights / adjusted.noise_px**2
    normal = NormalEquations(adjusted.camera, clip, weights)
    left = np.empty((frames, len(seen), 2))
    for frame in range(frames):
        own = np.where((seen.frame == frame)[:, None], normal.by_lens[:, :, 0], 0.0)
        left[frame] = normal.unexplained(own)
    heavy = left * weights[None, :, None]
    information = np.einsum("fni,gni->fg", heavy, left, optimize=True)
    score = np.einsum("fni,ni->f", heavy, adjusted.residuals)
    covariance = np.linalg.pinv(information, rcond=_RANK, hermitian=True)
    deviation = covariance @ score
    share = (time_s - time_s.mean()) / max(float(np.ptp(time_s)), 1e-9)
    told = float(share @ information @ share)
    drift = float(share @ score) / told if told > 0 else 0.0
    apart = score - information @ share * drift
    excess = max(float(apart @ covariance @ apart) / max(frames - 2, 1), 1.0)
    std = np.sqrt(np.clip(np.diag(covariance), 0, None) * excess)
    return FocalCourse(time_s, deviation, std, drift, float(np.sqrt(excess / told)) if told > 0 else np.inf)
