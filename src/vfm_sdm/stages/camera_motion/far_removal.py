"""Tracks of a view without the motion of a camera that moves far, and what is said of it."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray, time_blocks
from vfm_sdm.core.covariances import edges_across, largest_std
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import CameraMotionStatus
from vfm_sdm.stages.camera_motion.depths import DEPTH_SLOPE
from vfm_sdm.stages.camera_motion.far import DETERMINED_PX, FarMotion, Mapped, find_far_motion, map_back
from vfm_sdm.stages.camera_motion.places import Places
from vfm_sdm.stages.camera_motion.poses import FEWEST_STATIC
from vfm_sdm.stages.camera_motion.view_motion import (
    ViewMotion,
    compute_predicted_share,
    compute_scatter,
    keep_measured,
)

__all__ = ["remove_far_motion"]

_PREDICTED = 0.75
"""Share of the static points' slow shifts that the others must predict, as of small motion."""
_OFTEN = 0.5
"""Share of the samples seen for which the pose has to be determined."""


def remove_far_motion(
    tracks: xr.Dataset, position: FloatArray, static: Sequence[int], prior: Places, rest: FloatArray
) -> tuple[xr.Dataset, ViewMotion]:
    """Tracks of a view as its camera at rest would have seen them, and the camera's motion.

    Parameters
    ----------
    tracks
        Of the view, shape (T, P, 2) [px].
    position
        Positions that are trusted, else NaN, shape (T, P, 2) [px].
    static
        Numbers of the S static points that the view sees and whose place is known.
    prior
        Lens and points as the rig knows them.
    rest
        Pixels of all points with the camera at rest, shape (P, 2) [px]; NaN where unknown.

    Returns
    -------
    tracks, motion
        Every point mapped back to the camera at rest, with the uncertainty of that; a static point by the pose that the
        others give. A sample without a pose is lost, one for which the pose is hardly determined (0.5 px) unreliable.
        Where the motion could not be found, all samples are unreliable.
    """
    names, known = [str(name) for name in tracks["point"].values], np.asarray(np.isfinite(rest).all(axis=-1))
    places = {name: rest[p] for p, name in enumerate(names) if known[p]}
    used = tuple(names[index] for index in static)
    nothing, unknown = np.full((len(position), 3), np.nan), np.full(len(static), np.nan)
    at_rest = rest[list(static)]
    if len(static) < FEWEST_STATIC:
        series = (nothing, nothing, nothing, nothing, unknown, unknown)
        return _doubted(tracks), ViewMotion(CameraMotionStatus.TOO_FEW, used, *series, at_rest, places)
    covariance = tracks["position_covariance"].values
    motion = find_far_motion(position[:, list(static)], covariance[:, list(static)], static, prior)
    found_again = _map_all(tracks, motion)
    mapped, added = found_again.position, found_again.added
    across = edges_across(tracks)[list(static)]
    shift = keep_measured(position[:, list(static)] - at_rest, across)
    left = keep_measured(np.where(np.isfinite(position), mapped, np.nan)[:, list(static)] - at_rest, across)
    status = _judge(motion, position, added, (shift, left, at_rest))
    std, found = np.sqrt(np.einsum("taa->ta", motion.poses.covariance)), motion.poses.found[:, None]
    turn, way = motion.poses.rotation_vector, motion.poses.translation
    turn, turn_std, way, way_std = (np.where(found, one, np.nan) for one in (turn, std[:, :3], way, std[:, 3:]))
    after = compute_scatter(left) if len(static) > FEWEST_STATIC else unknown
    before = compute_scatter(shift)
    view = ViewMotion(status, used, turn, turn_std, way, way_std, before, after, at_rest, places)
    if not view.applied:
        return _doubted(tracks), view
    codes = _codes(tracks, mapped, added)
    values = {"position": mapped, "position_covariance": found_again.covariance, "status": codes}
    slopes = (("time", "point", "pixel", "space"), found_again.depth_slope, {"units": "px/m"})
    steady = tracks.assign({name: tracks[name].copy(data=data) for name, data in values.items()})
    return steady.assign({DEPTH_SLOPE: slopes}), view


def _map_all(tracks: xr.Dataset, motion: FarMotion) -> Mapped:
    """All points of all frames."""
    parts = []
    for block in time_blocks(tracks.sizes["time"]):
        position, covariance = (tracks[name].values[block] for name in ("position", "position_covariance"))
        parts.append(map_back(position, covariance, motion, block))
    return Mapped.joined(parts)


def _judge(
    motion: FarMotion, position: FloatArray, added: FloatArray, shifts: tuple[FloatArray, FloatArray, FloatArray]
) -> CameraMotionStatus:
    """Whether the static points show the motion; ``shifts`` are before, after, and the rest (S, 2) [px]."""
    others = np.delete(np.arange(position.shape[1]), motion.static)
    others = others if len(others) else np.array(motion.static)
    seen = np.isfinite(position[:, others]).all(axis=-1)
    with np.errstate(invalid="ignore"):
        # Points that contradict each other are a matter of their own.
        determined = largest_std(added[:, others]) <= DETERMINED_PX * np.sqrt(max(motion.noise_factor, 1.0))
    if not np.mean(determined[seen]) > _OFTEN:
        return CameraMotionStatus.NOT_DETERMINED
    if len(motion.static) == FEWEST_STATIC:
        return CameraMotionStatus.FOLLOWED_BY_THREE
    predicted = compute_predicted_share(*shifts) > _PREDICTED
    return CameraMotionStatus.FOLLOWED if predicted else CameraMotionStatus.NO_GAIN


def _codes(tracks: xr.Dataset, mapped: FloatArray, added: FloatArray) -> IntArray:
    """Status codes of the samples, shape (T, P)."""
    status = tracks["status"].values
    lost = np.isfinite(tracks["position"].values).all(axis=-1) & ~np.isfinite(mapped).all(axis=-1)
    with np.errstate(invalid="ignore"):
        doubtful = (status == Status.OK) & (largest_std(added) > DETERMINED_PX)
    return np.where(lost, np.int8(Status.LOST), np.where(doubtful, np.int8(Status.UNRELIABLE), status))


def _doubted(tracks: xr.Dataset) -> xr.Dataset:
    """The tracks with all samples unreliable: what the camera's own motion does to them is not known."""
    status = tracks["status"]
    return tracks.assign(status=status.copy(data=np.where(status == Status.OK, np.int8(Status.UNRELIABLE), status)))
