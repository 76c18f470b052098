"""Do the views agree on how much a point moves? Vertical motion from each view of a pair alone, against both."""

from itertools import combinations

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame

__all__ = ["compute_gain_difference", "compute_pair_differences"]

_FEWEST_SAMPLES = 10
_CLEAR = 3.0
_STEP_M = 1e-4


def compute_gain_difference(
    tracks: xr.Dataset, displacement: xr.Dataset, rig: Rig, frame: StructureFrame | None
) -> FloatArray:
    """By how much more one view shows of each point's vertical motion than another, shape (P,) [1].

    The first of the pair of views that disagree most, less the second; arguments and limits as in
    `compute_pair_differences`.
    """
    by_pair = np.stack(list(compute_pair_differences(tracks, displacement, rig, frame).values()))
    worst = np.nan_to_num(np.abs(by_pair), nan=-1.0).argmax(axis=0)
    return np.asarray(by_pair[worst, np.arange(by_pair.shape[1])])


def compute_pair_differences(
    tracks: xr.Dataset, displacement: xr.Dataset, rig: Rig, frame: StructureFrame | None
) -> dict[tuple[str, str], FloatArray]:
    """By how much more the first view of every pair shows of each point's vertical motion than the second.

    Parameters
    ----------
    tracks
        Synchronised tracks, in the order of the rig's cameras.
    displacement
        Made of them without refinement, at the same times.
    rig, frame
        Metric cameras and the structure's axes.

    Returns
    -------
    differences
        By the names of both views, shape (P,) [1]; NaN where the motion is not three times its noise, and without axes
        or a second view.

    Notes
    -----
    The rows of each image, less what lateral and longitudinal motion make of them, are vertical motion by themselves.
    Each is compared with the mean of both, which has less noise than either, over the samples that both views see.
    Whatever makes motion too small in one view only shows: compression, a subset that covers surroundings, a track that
    slips.
    """
    unknown = np.full(displacement.sizes["point"], np.nan)
    if frame is None or len(rig) < 2:
        return {(rig.names[0], rig.names[-1]): unknown}
    found = {}
    for first, second in combinations(range(len(rig)), 2):
        rows = tracks["position"].values[[first, second], ..., 1]
        cameras = rig.cameras[first], rig.cameras[second]
        found[rig.names[first], rig.names[second]] = np.array(
            [
                _compare(displacement.isel(point=number), rows[..., number], cameras, frame)
                for number in range(displacement.sizes["point"])
            ]
        )
    return found


def _compare(series: xr.Dataset, rows: FloatArray, cameras: tuple[Camera, Camera], frame: StructureFrame) -> float:
    """What the first of two views shows more of one point's vertical motion, from its rows (2, T) [px]."""
    ok = (series["status"].values == Status.OK) & np.isfinite(series["displacement"].values).all(axis=1)
    ok &= np.isfinite(rows).all(axis=0)
    motion = series["displacement"].values[ok] / 1e3
    if len(motion) < _FEWEST_SAMPLES:
        return float("nan")
    motion = motion - motion.mean(axis=0)
    if not np.std(motion[:, 1]) > _CLEAR * np.mean(series["displacement_std"].values[ok, 1]) / 1e3:
        return float("nan")
    around = series["position"].values[ok].mean(axis=0) + _STEP_M * np.vstack([np.zeros(3), np.eye(3)])
    alone = []
    for camera, of_view in zip(cameras, rows, strict=True):
        expected = camera.project(around @ frame.rotation)[:, 1]
        slope = (expected[1:] - expected[0]) / _STEP_M
        seen = of_view[ok]
        alone.append((seen - seen.mean() - motion @ (slope * [1.0, 0.0, 1.0])) / slope[1])
    both = (alone[0] + alone[1]) / 2
    return float((alone[0] - alone[1]) @ both / (both @ both))
