"""Tracks as poses of the package ``movement``."""

from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.tracks.record import ForeignTracks, whole_frames

__all__ = ["read_poses"]

_DIMS = ("time", "keypoints", "individuals", "space")
_LAYOUT = {"position": _DIMS, "position_std": _DIMS, "status": _DIMS[:3], "confidence": _DIMS[:3]}
"""Dims of what is read, in any order."""
_DOUBTFUL = 0.6
"""Confidence below which a position is not trusted, where no status says so [1]."""


def read_poses(path: Path) -> ForeignTracks:
    """Tracks in a netCDF file of poses of one view; points of several individuals are named ``individual keypoint``.

    Parameters
    ----------
    path
        The file: ``position`` (time, space, keypoints, individuals) [px], and where they are there ``confidence``,
        ``position_std`` [px] and ``status`` as `vfm_sdm.outputs.results.write_movement` writes them.

    Raises
    ------
    ResultsError
        It cannot be read, or holds something else.
    """
    try:
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as found:
            poses = found.load()
    except (OSError, ValueError, LookupError, RuntimeError) as error:
        raise ResultsError(f"{path}: expected netCDF of poses, got: {error}; check the path") from error
    _check(path, poses)
    people = [str(name) for name in poses["individuals"].values]
    points = [str(name) for name in poses["keypoints"].values]
    names = tuple(point if len(people) == 1 else f"{person} {point}" for point in points for person in people)
    if len({*names}) < len(names):
        raise ResultsError(f"{path}: expected each point once, got {', '.join(map(repr, names))}; rename them")
    position = _flat(poses["position"])
    std = _flat(poses["position_std"]) if "position_std" in poses else np.full_like(position, np.nan)
    if "status" in poses:
        doubtful = _flat(poses["status"]) == Status.UNRELIABLE
    elif "confidence" in poses:
        doubtful = _flat(poses["confidence"]) < _DOUBTFUL
    else:
        doubtful = np.zeros(position.shape[:2], np.bool_)
    clock = poses["time"].values
    if poses.attrs.get("time_unit") == "frames":
        return ForeignTracks(position, std, doubtful, names, frames=whole_frames(path, clock), program="movement")
    return ForeignTracks(position, std, doubtful, names, time_s=clock.astype(np.float64), program="movement")


def _check(path: Path, poses: xr.Dataset) -> None:
    """Refuses what is no poses of a picture."""
    wrong = [
        name
        for name, dims in _LAYOUT.items()
        if name in poses and (sorted(map(str, poses[name].dims)) != sorted(dims) or poses[name].dtype.kind not in "iuf")
    ]
    space = [] if "space" not in poses.coords else sorted(map(str, poses["space"].values))
    if "position" not in poses or wrong or space != ["x", "y"] or not all(poses.sizes.values()):
        raise ResultsError(
            f"{path}: expected position (time, space, keypoints, individuals) with x and y alone, and what belongs to "
            f"it with the same dims, got {dict(poses.sizes)}{''.join(f', other {name}' for name in wrong)}; write it "
            "with movement, or as a table"
        )


def _flat(array: xr.DataArray) -> np.ndarray:
    """Values by time and point, and by space where it is there, x before y."""
    dims = [dim for dim in _DIMS if dim in array.dims]
    chosen = (array.sel(space=["x", "y"]) if "space" in dims else array).transpose(*dims).values
    return chosen.reshape(chosen.shape[0], -1, *chosen.shape[3:])
