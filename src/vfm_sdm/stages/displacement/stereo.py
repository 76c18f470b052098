"""Tracks and cameras to displacement in millimetres along the structure's axes (paper, section Triangulation)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.core.covariances import find_edges
from vfm_sdm.core.datasets import (
    CAMERA_AXES,
    FIRST_SAMPLE,
    PIXEL,
    STRUCTURE_AXES,
    DisplacementArrays,
    Status,
    check_tracks,
    make_displacement,
    worst_status,
)
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import (
    compute_gain_covariance,
    compute_gain_sensitivity,
    compute_place_covariance,
    compute_place_sensitivity,
    compute_position_covariance,
    triangulation_jacobian,
)
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import compute_reprojection_error, in_front_of_all
from vfm_sdm.geometry.visibility import Sightings
from vfm_sdm.signals.clocks import still_frames
from vfm_sdm.stages.displacement.edges import SolvedEdges, solve_edges, state_prior
from vfm_sdm.stages.refinement.sightings import see_tracks

__all__ = ["compute_displacement", "find_origin", "keep_origin"]

_MM_PER_M = 1e3
_UNKNOWN_PLACE_PX = 1.0
"""Standard deviation of a place that was registered where the texture does not tell its uncertainty [px]."""


def compute_displacement(
    tracks: xr.Dataset,
    rig: Rig,
    *,
    frame: StructureFrame | None = None,
    covariance: FloatArray | None = None,
    refinement_gain: FloatArray | None = None,
    still_interval_s: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Displacement dataset of all points from synchronised tracks.

    Parameters
    ----------
    tracks
        Tracks with a dim ``view``, in the order of the rig's cameras, on one clock, shape (V, T, P, 2) [px]; with
        ``place_std`` (view, point, pixel) [px] where it is known how well the points were placed, and with ``origin``
        (point, axis) [m] where an earlier part of the recording told the positions that displacement is relative to.
    rig
        Metric cameras.
    frame
        The structure's axes; without them, displacement is along the reference camera's own axes (right, down,
        forward).
    covariance
        Joint covariance of rig parameters and axes, shape (10 V + 3, 10 V + 3); ``None`` when nothing is known of it,
        and then ``scale_std`` is NaN.
    refinement_gain
        Gain from displacement along each axis as the images alone give it to refined displacement along each, where the
        tracks were refined, shape (P, 3, 3) [1]; NaN for points that were not refined.
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin of displacement; without it, the origin is the
        first valid sample of each point.

    Returns
    -------
    displacement
        Displacement dataset, shape (T, P, 3) [mm], with its ``origin`` (point, axis) [m], and with the gains and
        sensitivities of the notes.

    Raises
    ------
    DatasetError
        The tracks are not synchronised, their views are not the rig's, the rig is not metric, or no frame lies in the
        still interval.

    Notes
    -----
    The random part of the uncertainty is the tracks' covariance through the triangulation. It leaves out the noise that
    all frames share, because the reference frame's noise shifts a whole series and not its motion. The systematic part
    is the gain of each axis under the covariance of cameras and axes (`compute_gain_std`), and under that of the places
    (`compute_place_sensitivity`): pixels of two views that belong a little beside each other give another depth.
    ``gain_std`` also holds the leakage from motion along one axis into another, and ``gain_covariance`` is what
    `vfm_sdm.stages.displacement.uncertainty` needs for any displacement. ``pixel_sensitivity`` is the change of the
    result with each pixel coordinate.

    A sample needs two views. Of more than two views, ``seen_by`` names the ones that a sample comes from (an index of
    ``visibility``, -1 where there is none; ``visibility_views`` says which these are), ``gain_covariance`` and
    ``pixel_sensitivity`` belong to those that see most samples of a point, and ``gain_covariance_seen_by`` and
    ``pixel_sensitivity_seen_by`` to each set of them. Views that join or leave make no step, because their mean
    disagreement is taken off (`vfm_sdm.geometry.visibility`); how well that is known is part of the random standard
    deviation. Samples of views that share too little with the others for that are unreliable.
    ``view_shift`` (view, point, pixel) [px] is what was taken off, and ``view_shift_known`` says of which views.

    A point that a view sees across an edge only (``edge_across`` of the tracks) is solved by weighted least squares
    about its position of reference, with a weak prior on its motion (`vfm_sdm.stages.displacement.edges.state_prior`):
    its standard deviation says along which axes it is measured, and how well; where the pixels leave a tenth of the
    prior's variance or more, displacement is NaN.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> points3d = np.array([[1.0, 0.0, 25.0], [1.0, 0.002, 25.0]])
    >>> covariance, status = np.tile(0.01**2 * np.eye(2), (2, 1, 1, 1)), np.zeros((2, 1))
    >>> views = [
    ...     make_tracks([0.0, 0.1], ["mid"], camera.project(points3d)[:, None], covariance, status, attrs={})
    ...     for camera in rig.cameras
    ... ]
    >>> tracks = xr.concat(views, "view").assign_coords(view=["left", "right"])
    >>> displacement = compute_displacement(tracks, rig)
    >>> displacement["displacement"].sel(axis="down").values.round(3).ravel().tolist()
    [0.0, 2.0]
    """
    names = _check_views(tracks, rig)
    codes, time_s = tracks["status"].values, tracks["time"].values
    sight = see_tracks(tracks, rig)
    points3d = sight.triangulate(rig)
    rotation = np.eye(3) if frame is None else frame.rotation
    edges = _solve_edges(tracks, sight, rig, frame, still_interval_s)
    if edges is not None:
        points3d = edges.put_positions(points3d)
    behind = np.isfinite(points3d).all(axis=-1) & ~in_front_of_all(points3d, rig, seen=sight.used)
    points3d = np.where(behind[..., None], np.nan, points3d)
    valid = np.asarray(np.isfinite(points3d).all(axis=-1))
    position = points3d @ rotation.T

    place_std = tracks["place_std"].transpose("view", "point", "pixel").values if "place_std" in tracks else None
    linear = _linearise(sight, sight.anchor(valid), rig, rotation, covariance, edges)
    linear = replace(linear, places=_gain_of_places(sight, sight.anchor(valid), rig, place_std))
    refined = None if refinement_gain is None else _choose_gains(refinement_gain, sight, tracks)
    if refined is not None:
        linear = linear.refined(refined)
    variance = _compute_random_variance(linear.jacobian, sight, tracks["position_covariance"].values)
    origin = keep_origin(tracks, find_origin(position, valid, time_s, still_interval_s))
    values = position - origin
    error = compute_reprojection_error(
        points3d, np.where(sight.used[..., None], tracks["position"].values, np.nan), rig
    )
    if edges is not None:
        variance, error = edges.put_variances(variance), edges.put_residuals(error)
        values, variance = edges.hide_open(values), edges.hide_open(variance)
    axes = CAMERA_AXES if frame is None else STRUCTURE_AXES
    displacement = make_displacement(
        time_s,
        [str(p) for p in tracks["point"].values],
        axes,
        DisplacementArrays(
            displacement_mm=values * _MM_PER_M,
            displacement_std_mm=np.where(valid[..., None], np.sqrt(variance), np.nan) * _MM_PER_M,
            scale_std=np.full((len(tracks["point"]), 3), np.nan),
            position_m=position,
            reprojection_error_px=error,
            status=_combine_status(codes, sight, behind),
        ),
        attrs={
            "frame": "reference camera" if frame is None else "structure",
            "baseline_m": rig.baseline() if len(rig) > 1 else float("nan"),
            "relative_to": FIRST_SAMPLE if still_interval_s is None else "mean of the still interval",
        },
    )
    displacement = displacement.assign(origin=(("point", "axis"), origin, {"units": "m"}))
    if "refined_view" in tracks:
        displacement = displacement.assign(refined_view=("point", tracks["refined_view"].values))
    return _add_gains(displacement, linear, sight, names)


def _check_views(tracks: xr.Dataset, rig: Rig) -> tuple[str, ...]:
    """Names of the views of synchronised tracks, which are those of a metric rig."""
    check_tracks(tracks, synchronized=True)
    names = tuple(str(name) for name in tracks["view"].values)
    if names != rig.names:
        raise DatasetError(f"tracks: expected views {list(rig.names)}, got {list(names)}; select and order them")
    if not rig.metric:
        raise DatasetError("rig: expected metres, got an unknown scale; measure the baseline")
    return names


@dataclass(frozen=True, eq=False)
class _Linear:
    """Derivatives of displacement by pixels and cameras, for each of K sets of views and P points.

    Parameters
    ----------
    jacobian
        Derivative of positions by pixels, shape (K, P, 3, V, 2) [m/px].
    sensitivity
        Derivative of the gains by camera parameters, shape (K, P, 10 V, 3, 3), in the first camera's frame; ``None``
        where nothing is known of the cameras' covariance.
    rotation, covariance
        As in `compute_gain_covariance`.
    gain
        Gain of the refinement, shape (K, P, 3, 3) [1].
    places
        Derivative of the gains by the points' places in standard deviations, shape (K, P, 2 V, 3, 3) [1]; ``None``
        where the places are taken as exact.
    """

    jacobian: FloatArray
    sensitivity: FloatArray | None
    rotation: FloatArray
    covariance: FloatArray | None
    gain: FloatArray
    places: FloatArray | None = None

    def refined(self, gain: FloatArray) -> "_Linear":
        """Derivatives of refined displacement."""
        jacobian = np.einsum("spab,spbvk->spavk", gain, self.jacobian)
        return replace(self, jacobian=jacobian, gain=gain)

    def gain_covariance(self) -> FloatArray:
        """Covariance of the gains, shape (K, P, 3, 3, 3) [1]; NaN where nothing is known of the cameras."""
        if self.sensitivity is None or self.covariance is None:
            return np.full((*self.jacobian.shape[:2], 3, 3, 3), np.nan)
        covariance = np.stack(
            [
                compute_gain_covariance(sensitivity, self.rotation, self.covariance, refinement_gain=gain)
                for sensitivity, gain in zip(self.sensitivity, self.gain, strict=True)
            ]
        )
        if self.places is not None:
            covariance += np.stack(
                [
                    compute_place_covariance(places, self.rotation, refinement_gain=gain)
                    for places, gain in zip(self.places, self.gain, strict=True)
                ]
            )
        return covariance


def _solve_edges(
    tracks: xr.Dataset,
    sight: Sightings,
    rig: Rig,
    frame: StructureFrame | None,
    still_interval_s: tuple[float, float] | None,
) -> SolvedEdges | None:
    """Motion of the points that a view sees across an edge only; ``None`` without any."""
    edge = find_edges(tracks)
    if not edge.any():
        return None
    others = None
    if not edge.all():
        whole = tracks.isel(point=np.flatnonzero(~edge))
        others = compute_displacement(whole, rig, frame=frame, still_interval_s=still_interval_s)
    rotation = np.eye(3) if frame is None else frame.rotation
    return solve_edges(tracks, sight, rig, rotation, state_prior(others))


def _linearise(
    sight: Sightings,
    anchor: FloatArray,
    rig: Rig,
    rotation: FloatArray,
    covariance: FloatArray | None,
    edges: SolvedEdges | None,
) -> _Linear:
    """Derivatives about one pixel of each point and view, shape (V, P, 2): pixels hardly move against the distance."""
    jacobian, sensitivity = [], []
    for members in sight.visibility.views:
        pixels = np.where(members[:, None, None], anchor, np.nan)
        in_camera = triangulation_jacobian(pixels, rig, weights=sight.weights)
        jacobian.append(np.einsum("ai,pivk->pavk", rotation, in_camera))
        if covariance is not None:
            sensitivity.append(compute_gain_sensitivity(pixels, rig, weights=sight.weights))
        if edges is not None:
            edges.put_slopes(jacobian[-1], sensitivity[-1] if sensitivity else None, pixels, rig)
    gain = np.broadcast_to(np.eye(3), (len(jacobian), anchor.shape[1], 3, 3))
    known = None if covariance is None else np.stack(sensitivity)
    return _Linear(np.stack(jacobian), known, rotation, covariance, gain)


def _gain_of_places(sight: Sightings, anchor: FloatArray, rig: Rig, place_std: FloatArray | None) -> FloatArray | None:
    """Derivatives of the gains by the points' places, in their standard deviations (V, P, 2); (K, P, 2 V, 3, 3) [1]."""
    if place_std is None:
        return None
    # Of a place that was registered on a soft texture the uncertainty may be unknown.
    known = np.moveaxis(np.nan_to_num(place_std, nan=_UNKNOWN_PLACE_PX), 1, 0).reshape(anchor.shape[1], -1)
    every = []
    for members in sight.visibility.views:
        pixels = np.where(members[:, None, None], anchor, np.nan)
        every.append(compute_place_sensitivity(pixels, rig, weights=sight.weights) * known[:, :, None, None])
    return np.stack(every)


def _choose_gains(gain: FloatArray, sight: Sightings, tracks: xr.Dataset) -> FloatArray:
    """Gain of the refinement for each set of views, shape (K, P, 3, 3): the identity without the refined view."""
    sets = sight.visibility.views
    applied = np.broadcast_to(np.where(np.isfinite(gain), gain, np.eye(3)), (len(sets), *gain.shape)).copy()
    if "refined_view" in tracks:
        names = list(tracks["view"].values)
        for point, view in enumerate(tracks["refined_view"].values):
            if view in names:
                applied[~sets[:, names.index(view)], point] = np.eye(3)
    return applied


def _compute_random_variance(jacobian: FloatArray, sight: Sightings, covariance: FloatArray) -> FloatArray:
    """Variance of all samples from the tracks' covariance and the disagreement of views, (T, P, 3) [m2]."""
    visibility, main = sight.visibility, sight.visibility.most_frequent()
    variance = np.full((*visibility.of_sample.shape, 3), np.nan)
    for number, (members, of_set) in enumerate(zip(visibility.views, jacobian, strict=True)):
        stated = np.where(members[:, None, None, None, None], covariance, 0.0)
        own = np.einsum("tpaa->tpa", compute_position_covariance(of_set, stated))
        apart = np.einsum("pavk,vpkl,pavl->pa", of_set, sight.disagreement.covariance, of_set)
        own = own + np.where((main != number)[:, None], apart, 0.0)
        variance = np.where((visibility.of_sample == number)[..., None], own, variance)
    return variance


def _add_gains(displacement: xr.Dataset, linear: _Linear, sight: Sightings, names: Sequence[str]) -> xr.Dataset:
    """The dataset with gains and sensitivities, and, for more than two views, the views that see each sample."""
    points, main = np.arange(displacement.sizes["point"]), sight.visibility.most_frequent()
    gain_covariance, jacobian = linear.gain_covariance(), linear.jacobian * _MM_PER_M
    of_main = gain_covariance[main, points]
    gain_std = np.sqrt(np.maximum(np.einsum("pabb->pab", of_main), 0.0))
    axes = list(displacement["axis"].values)
    gain_dims, pixel_dims = ("point", "axis", "motion_axis", "motion_axis_2"), ("point", "axis", "view", "pixel")
    displacement = displacement.assign(
        scale_std=displacement["scale_std"].copy(data=np.einsum("paa->pa", gain_std)),
        gain_std=(gain_dims[:3], gain_std, {"units": "1"}),
        gain_covariance=(gain_dims, of_main, {"units": "1"}),
        pixel_sensitivity=(pixel_dims, jacobian[main, points], {"units": "mm/px"}),
    )
    displacement = displacement.assign_coords(motion_axis=axes, motion_axis_2=axes, view=list(names), pixel=list(PIXEL))
    if len(names) < 3:
        return displacement
    apart = sight.disagreement
    displacement = displacement.assign(
        view_shift=(("view", "point", "pixel"), apart.shift, {"units": "px"}),
        view_shift_covariance=(("view", "point", "pixel_a", "pixel_b"), apart.covariance, {"units": "px2"}),
        view_shift_known=(("view", "point"), (apart.linked & sight.used.any(axis=1)).astype(np.int8)),
    )
    together = ["+".join(np.array(names)[members].tolist()) for members in sight.visibility.views]
    displacement = displacement.assign(
        visibility_views=(("visibility", "view"), sight.visibility.views.astype(np.int8)),
        seen_by=(("time", "point"), sight.visibility.of_sample.astype(np.int16)),
        gain_covariance_seen_by=(("visibility", *gain_dims), gain_covariance, {"units": "1"}),
        pixel_sensitivity_seen_by=(("visibility", *pixel_dims), jacobian, {"units": "mm/px"}),
    )
    return displacement.assign_coords(visibility=together)


def _combine_status(status: IntArray, sight: Sightings, behind: BoolArray) -> IntArray:
    """The worst status over the views that a sample comes from; over all where fewer than two see it; shape (T, P)."""
    used = sight.used
    enough = used.sum(axis=0) >= 2
    combined = worst_status(np.where(used | ~enough, status, Status.OK))
    apart = enough & (used & ~sight.disagreement.linked[:, None]).any(axis=0)
    combined = np.where(apart & (combined == Status.OK), Status.UNRELIABLE, combined)
    return np.where(behind, Status.BEHIND, combined)


def keep_origin(tracks: xr.Dataset, found: FloatArray) -> FloatArray:
    """Positions that displacement is relative to: those of an earlier part of the recording, where it told them.

    Parameters
    ----------
    tracks
        Tracks, with ``origin`` (point, axis) where there was an earlier part; NaN for points that it did not tell.
    found
        Result of `find_origin`, shape (P, n), in the unit of ``origin``.
    """
    if "origin" not in tracks:
        return found
    known = tracks["origin"].transpose("point", "axis").values
    return np.where(np.isfinite(known), known, found)


def find_origin(
    position: FloatArray, valid: BoolArray, time_s: FloatArray, still_interval_s: tuple[float, float] | None
) -> FloatArray:
    """Positions that displacement is relative to.

    Parameters
    ----------
    position
        Positions, shape (T, P, n), in any unit such as m or px.
    valid
        Samples that count, shape (T, P).
    time_s
        Time stamps, shape (T,) [s].
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin; without it, the first valid sample is.

    Returns
    -------
    origin
        Shape (P, n), in the unit of the positions; NaN for a point without a valid sample.

    Raises
    ------
    DatasetError
        No frame lies in the still interval.

    Examples
    --------
    >>> position = np.array([[[1.0]], [[2.0]], [[4.0]]])
    >>> find_origin(position, np.ones((3, 1), dtype=bool), np.array([0.0, 0.1, 0.2]), (0.05, 0.3)).tolist()
    [[3.0]]
    """
    if still_interval_s is None:
        first = position[valid.argmax(axis=0), np.arange(valid.shape[1])]
        return np.asarray(np.where(np.asarray(valid.any(axis=0))[:, None], first, np.nan))
    usable = (valid & still_frames(time_s, still_interval_s)[:, None])[..., None]
    count = usable.sum(axis=0)
    total = np.where(usable, position, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
