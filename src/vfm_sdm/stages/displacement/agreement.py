"""Do the views agree on how much a point moves? Vertical motion from each view alone, against all of them."""

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame

__all__ = ["compute_gain_difference"]

_FEWEST_SAMPLES = 10
_CLEAR = 3.0
_STEP_M = 1e-4


def compute_gain_difference(
    tracks: xr.Dataset, displacement: xr.Dataset, rig: Rig, frame: StructureFrame | None
) -> FloatArray:
    """By how much more the first view shows of each point's vertical motion than the second, shape (P,) [1].

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
    difference
        NaN where the motion is not three times its noise, and without axes or a second view.

    Notes
    -----
    The rows of each image, less what lateral and longitudinal motion make of them, are vertical motion by themselves.
    Each is compared with the mean of both, which has less noise than either. Whatever makes motion too small in one
    view only shows: compression, a subset that covers surroundings, a track that slips.
    """
    difference = np.full(displacement.sizes["point"], np.nan)
    if frame is None or len(rig) < 2:
        return difference
    for number, point in enumerate(displacement["point"].values):
        series = displacement.sel(point=point)
        ok = (series["status"].values == Status.OK) & np.isfinite(series["displacement"].values).all(axis=1)
        motion = series["displacement"].values[ok] / 1e3
        if len(motion) < _FEWEST_SAMPLES:
            continue
        motion = motion - motion.mean(axis=0)
        if not np.std(motion[:, 1]) > _CLEAR * np.mean(series["displacement_std"].values[ok, 1]) / 1e3:
            continue
        place = series["position"].values[ok].mean(axis=0)
        alone = []
        for view, camera in enumerate(rig.cameras[:2]):
            around = place + _STEP_M * np.vstack([np.zeros(3), np.eye(3)])
            rows = camera.project(around @ frame.rotation)[:, 1]
            slope = (rows[1:] - rows[0]) / _STEP_M
            seen = tracks["position"].values[view, ok, number, 1]
            alone.append((seen - seen.mean() - motion @ (slope * [1.0, 0.0, 1.0])) / slope[1])
        both = (alone[0] + alone[1]) / 2
        difference[number] = (alone[0] - alone[1]) @ both / (both @ both)
    return difference
