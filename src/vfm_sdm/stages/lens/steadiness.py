"""Whether the focal length stays what it is while the camera turns."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.stages.lens.adjustment import AdjustedClip
from vfm_sdm.stages.lens.turning_camera import LensClip

__all__ = ["focal_drift"]


def focal_drift(adjusted: AdjustedClip, clip: LensClip, time_s: FloatArray) -> tuple[float, float]:
    """Change of the logarithm of the focal length from the first key frame to the last, and its standard deviation [1].

    Parameters
    ----------
    adjusted
        The adjustment, with one focal length for all frames.
    clip
        Its sightings.
    time_s
        When the key frames were taken, shape (F,) [s].

    Notes
    -----
    One more parameter, the slope of the logarithm over time, is added to the solution: its score against the residuals,
    with the turns of each frame taken out. The scatter of the frames' own scores gives the standard deviation, so that
    errors which all sightings of a frame share are in it.
    """
    seen = clip.seen
    by_lens, by_turn, _ = adjusted.camera.derivatives(seen)
    weights = adjusted.weights / adjusted.noise_px**2
    along, across = by_lens[:, :, 0], by_turn
    frames = len(time_s)
    found, told = np.zeros(frames), np.zeros(frames)
    for frame in range(frames):
        rows = np.flatnonzero(seen.frame == frame)
        if len(rows) < 3:
            continue
        root = np.sqrt(weights[rows])[:, None]
        turn = (across[rows] * root[:, :, None]).reshape(-1, 3)
        focal = (along[rows] * root).ravel()
        left = focal - turn @ np.linalg.lstsq(turn, focal, rcond=None)[0]
        told[frame] = left @ left
        found[frame] = left @ (adjusted.residuals[rows] * root).ravel()
    span = max(float(np.ptp(time_s)), 1e-9)
    share = (time_s - time_s.mean()) / span
    known = told > 0
    if known.sum() < 3:
        return 0.0, np.inf
    own = found[known] / told[known]
    weight = told[known]
    design = np.column_stack([np.ones(known.sum()), share[known]])
    normal = design.T @ (design * weight[:, None])
    solution = np.linalg.solve(normal, design.T @ (weight * own))
    spread = float((weight * (own - design @ solution) ** 2).sum() / max(known.sum() - 2, 1))
    std = float(np.sqrt(np.linalg.inv(normal)[1, 1] * max(spread, 1.0)))
    return float(solution[1]), std
