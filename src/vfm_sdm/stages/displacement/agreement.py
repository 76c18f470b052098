"""Agreement of the views on a point's motion: vertical motion from each view of a pair alone, against both."""

from itertools import combinations

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.covariances import find_edges
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
    """Difference of each point's vertical motion in the two views that disagree most about it.

    Parameters
    ----------
    tracks, displacement, rig, frame
        See `compute_pair_differences`.

    Returns
    -------
    difference
        Motion in the first of those views less that in the second, over their mean, shape (P,) [1]; NaN as in
        `compute_pair_differences`.
    """
    by_pair = np.stack(list(compute_pair_differences(tracks, displacement, rig, frame).values()))
    worst = np.nan_to_num(np.abs(by_pair), nan=-1.0).argmax(axis=0)
    return np.asarray(by_pair[worst, np.arange(by_pair.shape[1])])


def compute_pair_differences(
    tracks: xr.Dataset, displacement: xr.Dataset, rig: Rig, frame: StructureFrame | None
) -> dict[tuple[str, str], FloatArray]:
    """Difference of each point's vertical motion in the two views of every pair, over their mean.

    Parameters
    ----------
    tracks
        Synchronised tracks, in the order of the rig's cameras, shape (V, T, P, 2) [px].
    displacement
        Displacement from these tracks without refinement, shape (T, P, 3) [mm].
    rig, frame
        Metric cameras and the structure's axes.

    Returns
    -------
    differences
        Differences by the names of both views, shape (P,) [1]; positive where the first view shows
        more motion; NaN where the motion is not three times its noise, where a view sees the point across an edge
        only, and without axes or a second view.

    Notes
    -----
    The rows of each image, less what lateral and longitudinal motion make of them, are vertical motion by themselves.
    Each is compared with the mean of both, which has less noise than either, over the samples that both views see.
    Causes that make motion too small in one view only become visible: compression, a subset that covers surroundings, a
    track that slips.
    """
    unknown = np.full(displacement.sizes["point"], np.nan)
    if frame is None or len(rig) < 2:
        return {(rig.names[0], rig.names[-1]): unknown}
    found, edge = {}, find_edges(tracks)
    for first, second in combinations(range(len(rig)), 2):
        rows = tracks["position"].values[[first, second], ..., 1]
        cameras = rig.cameras[first], rig.cameras[second]
        found[rig.names[first], rig.names[second]] = np.array(
            [
                float("nan")
                if edge[number]
                else _compare(displacement.isel(point=number), rows[..., number], cameras, frame)
                for number in range(displacement.sizes["point"])
            ]
        )
    return found


def _compare(series: xr.Dataset, rows: FloatArray, cameras: tuple[Camera, Camera], frame: StructureFrame) -> float:
    """Difference of one point's vertical motion between two views, from its rows, shape (2, T) [px]."""
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
    for camera, row in zip(cameras, rows, strict=True):
        expected = camera.project(around @ frame.rotation)[:, 1]
        slope = (expected[1:] - expected[0]) / _STEP_M
        seen = row[ok]
        alone.append((seen - seen.mean() - motion @ (slope * [1.0, 0.0, 1.0])) / slope[1])
    both = (alone[0] + alone[1]) / 2
    return float((alone[0] - alone[1]) @ both / (both @ both))
