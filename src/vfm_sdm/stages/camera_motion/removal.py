"""Tracks without the motion of the cameras, such as that of a tripod that shakes in the wind or settles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, mean_of_known, time_blocks
from vfm_sdm.core.covariances import edges_across, measured_variance
from vfm_sdm.core.datasets import Status, check_tracks, trusted_values
from vfm_sdm.core.statuses import CameraMotionStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.stages.camera_motion.depths import DEPTH_SLOPE, REST_PLACE
from vfm_sdm.stages.camera_motion.estimation import (
    MotionEstimate,
    MotionModel,
    compute_motion_jacobian,
    fit_motion,
    replace_doubtful,
)
from vfm_sdm.stages.camera_motion.far import moves_far
from vfm_sdm.stages.camera_motion.far_removal import remove_far_motion
from vfm_sdm.stages.camera_motion.places import Places, locate
from vfm_sdm.stages.camera_motion.view_motion import (
    CameraMotion,
    ViewMotion,
    compute_predicted_share,
    compute_scatter,
    keep_measured,
    root_mean_square,
)

__all__ = ["remove_camera_motion", "steady_tracks"]

_SIGNIFICANT = 20.0
"""Likelihood ratio that a still camera reaches once in 10^5 recordings (chi-square with one degree of freedom)."""
_PREDICTED = 0.75
"""Share of the static points' slow shifts that the others must predict; by chance, two that drift agree by half."""
_UNKNOWN_REST = np.full(2, np.nan)
_CLEAR = 5.0
_CLEAR_PX = 0.1
"""Multiples of their noise, and of a drift, that the shifts of a single static point must exceed: nothing checks it."""


def steady_tracks(
    tracks: Mapping[str, xr.Dataset],
    rig: Rig | None,
    static: Sequence[str],
    rest: Mapping[str, Mapping[str, FloatArray]] | None = None,
    place_std: FloatArray | None = None,
) -> CameraMotion:
    """As `remove_camera_motion`, and the tracks as they are where nothing can show the cameras' motion.

    Parameters
    ----------
    tracks
        By view, each on its own clock.
    rig
        Cameras; without metres, depths of points are unknown and nothing is removed.
    static
        Names of the points that must not move; without any, nothing is removed.
    rest, place_std
        See `remove_camera_motion` [px].
    """
    if not static or rig is None or not rig.metric:
        return CameraMotion(tracks, {})
    return remove_camera_motion(tracks, rig, static, rest, place_std)


def remove_camera_motion(
    tracks: Mapping[str, xr.Dataset],
    rig: Rig,
    static: Sequence[str],
    rest: Mapping[str, Mapping[str, FloatArray]] | None = None,
    place_std: FloatArray | None = None,
) -> CameraMotion:
    """Tracks as cameras that stand still would have seen them.

    Parameters
    ----------
    tracks
        Tracks of every view of the rig on its own clock, shape (T, P, 2) [px], before or after synchronisation, all
        with the same points.
    rig
        Metric cameras at rest.
    static
        Names of points that do not move. Three or more, far apart in the picture and at several depths,
        determine the motion; with two, roll and translation lean on the prior; with one, they come from it alone.
    rest
        Pixels of static points (2,) by view and point with the cameras at rest, where an earlier part of the recording
        told them [px]: motion is relative to those, so that it goes on where that of the earlier part ended.
    place_std
        How well the same place was found in every view, shape (V, P, 2) [px], where it is known.

    Returns
    -------
    motion
        Every point's pixels less the shift that the camera's motion gives them at their own depth, with the
        uncertainty of that shift added to ``position_covariance``. A static point is corrected by the others, so that
        what is left of it remains a check. Where no (other) static point is seen, the position stands as tracked, with
        the recording's usual shift in its covariance and the status ``unreliable``; so does that of a point without a
        known depth, with its own covariance.

    Raises
    ------
    DatasetError
        The rig is not metric or has other views than the tracks, the views have other points than each other, or a
        static point is not among them.

    Notes
    -----
    Points are triangulated once, from their mean pixels; the motion is estimated frame by frame, see
    `vfm_sdm.stages.camera_motion.estimation.fit_motion`, linear in the shifts. That leaves about ``shift^2 / (2
    f)`` of a shift: 0.01 px of 18 px at a focal length of 15,500 px. The motion is relative to its mean over the
    recording, which drops out of displacement.

    Nothing is changed unless the shifts are significant and, with two static points or more, each is predicted by the
    others: of the variance of their shifts beyond noise that is white in time, three quarters have to go.
    """
    names = _check_inputs(tracks, rig, static)
    positions = {view: trusted_values(tracks[view], "position") for view in rig.names}
    indices = [names.index(name) for name in static]
    given = {view: _read_rest(names, (rest or {}).get(view, {})) for view in rig.names}
    first = {
        view: np.where(np.isfinite(given[view]), given[view], mean_of_known(positions[view][:1])) for view in rig.names
    }
    far = [
        view
        for view, camera in zip(rig.names, rig.cameras, strict=True)
        if moves_far(positions[view][:, indices], first[view][indices], camera.focal_px)
    ]
    at_rest = np.stack([first[v] if v in far else mean_of_known(positions[v]) for v in rig.names])
    points3d = triangulate(at_rest, rig)
    points3d = np.where(in_front_of_all(points3d, rig)[:, None], points3d, np.nan)
    usable = [index for index in indices if np.isfinite(points3d[index]).all()]
    places: Sequence[Places] = locate(at_rest, rig, place_std) if far else ()
    corrected, views = {}, {}
    for number, (view, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        # A point that other views alone see says nothing of this camera.
        seen_here = [index for index in usable if np.isfinite(positions[view][:, index]).any()]
        one = tracks[view], positions[view]
        if view in far:
            corrected[view], views[view] = remove_far_motion(*one, seen_here, places[number], first[view])
            continue
        jacobian = compute_motion_jacobian(camera, points3d)
        corrected[view], views[view] = _remove_from_view(*one, jacobian, seen_here, given[view][seen_here])
    if any(views[view].far for view in far):
        corrected = {view: _with_places(one, points3d) for view, one in corrected.items()}
    return CameraMotion({view: corrected[view] for view in tracks}, {view: views[view] for view in tracks})


def _with_places(tracks: xr.Dataset, points3d: FloatArray) -> xr.Dataset:
    """Tracks with what `follow_depths` needs, of a view that stands still or hardly moves as well."""
    if DEPTH_SLOPE not in tracks:
        nothing = np.zeros((*tracks["position"].shape, 3))
        tracks = tracks.assign({DEPTH_SLOPE: (("time", "point", "pixel", "space"), nothing, {"units": "px/m"})})
    return tracks.assign({REST_PLACE: (("point", "space"), points3d, {"units": "m"})})


def _read_rest(names: Sequence[str], rest: Mapping[str, FloatArray]) -> FloatArray:
    """Pixels of all points with a camera at rest, as far as they are known, shape (P, 2) [px]."""
    return np.array([rest.get(name, _UNKNOWN_REST) for name in names]).reshape(-1, 2)


def _check_inputs(tracks: Mapping[str, xr.Dataset], rig: Rig, static: Sequence[str]) -> list[str]:
    """Names of the points that all views share."""
    if not rig.metric:
        raise DatasetError("rig: expected metres, got an unknown scale; measure the baseline")
    if set(tracks) != set(rig.names):
        raise DatasetError(f"tracks: expected views {list(rig.names)}, got {list(tracks)}; pass one dataset a camera")
    names = [str(point) for point in check_tracks(tracks[rig.names[0]])["point"].values]
    for view in rig.names[1:]:
        found = [str(point) for point in check_tracks(tracks[view])["point"].values]
        if found != names:
            raise DatasetError(f"view {view!r}: expected points {names}, got {found}; retrack")
    unknown = [name for name in static if name not in names]
    if unknown or len(set(static)) != len(static):
        raise DatasetError(f"static points: expected distinct names of {names}, got {list(static)}; correct them")
    return names


def _remove_from_view(
    tracks: xr.Dataset, position: FloatArray, jacobian: FloatArray, usable: Sequence[int], rest: FloatArray
) -> tuple[xr.Dataset, ViewMotion]:
    """Tracks of one view without its camera's motion, and that motion; what is known of the rest has shape (S, 2)."""
    frames = len(position)
    if not usable:
        nothing = np.full((frames, 3), np.nan)
        empty = np.zeros(0)
        unmoved = (nothing, nothing, nothing, nothing, empty, empty, rest)
        return tracks, ViewMotion(CameraMotionStatus.NO_POINTS, (), *unmoved)
    seen = np.asarray(np.isfinite(position[:, usable]).all(axis=-1))
    covariance = replace_doubtful(tracks["position_covariance"].values[:, usable], position[:, usable])
    model = fit_motion(position[:, usable], covariance, jacobian[usable], rest)
    parts = [
        _MotionSeries.of(model.estimate(position[block][:, usable], covariance[block]), jacobian[usable])
        for block in time_blocks(frames)
    ]
    series = _MotionSeries(*(np.concatenate([getattr(p, name) for p in parts]) for name in _MotionSeries.names()))
    across = edges_across(tracks)[usable]
    shifts = _compute_shifts(position[:, usable], seen, model.rest, series.predicted)
    shift, left = (keep_measured(one, across) for one in shifts)
    before, after = compute_scatter(shift), compute_scatter(left)
    if model.likelihood_ratio < _SIGNIFICANT:
        status = CameraMotionStatus.STILL
    elif len(usable) == 1:
        stated = tracks["position_covariance"].values[:, usable]
        noise_px = root_mean_square(np.sqrt(measured_variance(stated, across)[seen]))
        clear = before[0] > max(_CLEAR * noise_px, _CLEAR_PX)
        status = CameraMotionStatus.ONE_POINT if clear else CameraMotionStatus.STILL
    else:
        predicted = compute_predicted_share(shift, left, rest) > _PREDICTED
        status = CameraMotionStatus.OK if predicted else CameraMotionStatus.NO_GAIN
    found = np.asarray(seen.any(axis=1))[:, None]
    motion, std = (np.where(found, one, np.nan) for one in (series.motion, series.std))
    static = tuple(str(tracks["point"].values[index]) for index in usable)
    series_of = (motion[:, :3], std[:, :3], motion[:, 3:], std[:, 3:])
    view = ViewMotion(status, static, *series_of, before, after, model.rest)
    if not view.applied:
        return tracks, view
    return _subtract_motion(tracks, jacobian, usable, (model, position[:, usable], covariance)), view


@dataclass(frozen=True, eq=False)
class _MotionSeries:
    """What is kept of the motion of every frame."""

    motion: FloatArray
    """Shape (T, 6) [rad, m]."""
    std: FloatArray
    """Its standard deviation, shape (T, 6)."""
    predicted: FloatArray
    """Shifts of the static points that the others predict, shape (T, S, 2) [px]."""

    @classmethod
    def of(cls, estimate: MotionEstimate, jacobian: FloatArray) -> "_MotionSeries":
        std = np.sqrt(np.einsum("taa->ta", estimate.covariance))
        return cls(estimate.motion, std, np.einsum("pia,pta->tpi", jacobian, estimate.motion_without))

    @classmethod
    def names(cls) -> list[str]:
        return [one.name for one in fields(cls)]


def _compute_shifts(
    position: FloatArray, seen: BoolArray, rest: FloatArray, predicted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Shifts of the static points from their rest, and what the others' prediction leaves of them, (T, S, 2) [px]."""
    if seen.shape[1] == 1:
        return position - rest, np.full(position.shape, np.nan)
    others = seen & (seen.sum(axis=1, keepdims=True) > 1)
    shift = np.where(others[..., None], position - rest, np.nan)
    return shift, shift - predicted


def _subtract_motion(
    tracks: xr.Dataset,
    jacobian: FloatArray,
    usable: Sequence[int],
    fitted: tuple[MotionModel, FloatArray, FloatArray],
) -> xr.Dataset:
    """The tracks less the shifts that the motion predicts, with its covariance added.

    ``fitted`` are the model, and positions and covariances of the static points that it was fitted to.
    """
    model, static, covariance = fitted
    seen = np.asarray(np.isfinite(static).all(axis=-1))
    known = np.asarray(np.isfinite(jacobian).all(axis=(1, 2)))
    supported = np.repeat(np.asarray(seen.any(axis=1))[:, None], len(jacobian), axis=1)
    position, stated = tracks["position"].values.copy(), tracks["position_covariance"].values.copy()
    for block in time_blocks(len(static)):
        estimate = model.estimate(static[block], covariance[block])
        shift = np.einsum("pia,ta->tpi", jacobian, estimate.motion)
        added = np.einsum("pia,tab,pjb->tpij", jacobian, estimate.covariance, jacobian, optimize=True)
        for number, index in enumerate(usable):
            J = jacobian[index]
            shift[:, index] = estimate.motion_without[number] @ J.T
            added[:, index] = np.einsum("ia,tab,jb->tij", J, estimate.covariance_without[number], J)
        # Without support the estimate is zero and its covariance that of the whole recording.
        position[block] -= np.where(known[:, None], shift, 0.0)
        stated[block] += np.where(known[:, None, None], added, 0.0)
    for number, index in enumerate(usable):
        supported[:, index] = np.asarray(np.delete(seen, number, axis=1)).any(axis=1)
    status = tracks["status"].values
    doubtful = ~(supported & known) & (status == Status.OK)
    values = {
        "position": position,
        "position_covariance": stated,
        "status": np.where(doubtful, np.int8(Status.UNRELIABLE), status),
    }
    return tracks.assign({name: tracks[name].copy(data=data) for name, data in values.items()})
