"""Points that a view sees across an edge only: their motion, and what stands in for the direction that nobody sees."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.covariances import find_edges
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.edge_motion import EdgeMotion, EdgePoint
from vfm_sdm.geometry.propagation import compute_gain_sensitivity
from vfm_sdm.geometry.visibility import Sightings

__all__ = ["OPEN_SHARE", "UNKNOWN_MOTION_M", "SolvedEdges", "solve_edges", "state_prior"]

UNKNOWN_MOTION_M = 0.03
"""Standard deviation of motion of which nothing is known [m]: some times what footbridges and floors do in use."""
_ALIKE = 1.5
"""How much more than the points that are seen whole an edge may move along an axis: these need not be at mid-span."""
_STILLEST = 0.1
"""No axis is stiller than this share of the liveliest: that of refined points is so by assumption."""
OPEN_SHARE = 0.1
"""Share of the prior's variance that pixels may leave; with more, an axis counts as not measured: by this share motion
comes out too small, because the prior draws it to zero."""
_MOVING = 2.0
"""Standard deviations of its noise from which on a point is seen to move (root mean square)."""
_FEWEST_SAMPLES = 10
_LEAST_PX = 1e-3
"""Least standard deviation of a position: no tracker resolves less."""


def state_prior(others: xr.Dataset | None) -> FloatArray:
    """Standard deviation of an edge's motion along each axis before it is measured, shape (3,) [m].

    Parameters
    ----------
    others
        Displacement of the points that are seen whole, shape (T, P, 3) [mm]; ``None`` without any.

    Returns
    -------
    prior_std
        One and a half times the root mean square of the displacement, about its mean, of the point that moves most
        along an axis, noise included; `UNKNOWN_MOTION_M` along every axis where no point is seen to move.
    """
    found = []
    for point in [] if others is None else others["point"].values:
        one = others.sel(point=point) if others is not None else xr.Dataset()
        ok = one["status"].values == Status.OK
        if ok.sum() >= _FEWEST_SAMPLES:
            motion = one["displacement"].values[ok].std(axis=0)
            noise = np.sqrt(np.mean(one["displacement_std"].values[ok] ** 2, axis=0))
            if (motion > _MOVING * noise).any():
                found.append(motion)
    if not found:
        return np.full(3, UNKNOWN_MOTION_M)
    prior_std = _ALIKE * np.max(found, axis=0) / 1e3
    return np.asarray(np.maximum(prior_std, _STILLEST * prior_std.max()))


@dataclass(frozen=True, eq=False)
class SolvedEdges:
    """Motion of the edges among the P points of tracks.

    Parameters
    ----------
    points
        The edges, by index among the points.
    motions
        Their motion.
    places
        Their position of reference, shape (3,) each [length unit of the rig].
    not_measured
        Axes along which the pixels leave too much to the prior, shape (3,) each.
    rotation
        Rows are the axes of the result in the first camera's frame, shape (3, 3) [1].
    """

    points: Mapping[int, EdgePoint]
    motions: Mapping[int, EdgeMotion]
    places: Mapping[int, FloatArray]
    not_measured: Mapping[int, BoolArray]
    rotation: FloatArray

    def put_positions(self, points3d: FloatArray) -> FloatArray:
        """Positions of all points, shape (T, P, 3), those of the edges replaced.

        Parameters
        ----------
        points3d
            Shape (T, P, 3) [length unit of the rig], in the frame of the first camera.
        """
        result = points3d.copy()
        for number, motion in self.motions.items():
            result[:, number] = self.places[number] + motion.motion
        return result

    def put_variances(self, variance: FloatArray) -> FloatArray:
        """Variances of all points along the axes, shape (T, P, 3), those of the edges replaced.

        Parameters
        ----------
        variance
            Shape (T, P, 3) [squared length unit of the rig].
        """
        result = variance.copy()
        for number, motion in self.motions.items():
            own = np.einsum("ai,tij,aj->ta", self.rotation, motion.covariance, self.rotation)
            result[:, number] = own
        return result

    def put_residuals(self, error: FloatArray) -> FloatArray:
        """Reprojection errors of all points, shape (T, P) [px], those of the edges replaced.

        Parameters
        ----------
        error
            Shape (T, P) [px].
        """
        result = error.copy()
        for number, motion in self.motions.items():
            result[:, number] = motion.residual
        return result

    def hide_open(self, values: FloatArray) -> FloatArray:
        """Values along the axes, shape (T, P, 3), NaN along the axes that are not measured.

        Parameters
        ----------
        values
            Shape (T, P, 3) in any unit.
        """
        result = values.copy()
        for number, hidden in self.not_measured.items():
            result[:, number, hidden] = np.nan
        return result

    def put_slopes(self, jacobian: FloatArray, sensitivity: FloatArray | None, pixels: FloatArray, rig: Rig) -> None:
        """Enters the derivatives of the edges for one set of views, in place.

        Parameters
        ----------
        jacobian
            Derivative of all positions by the pixels along the axes, shape (P, 3, V, 2) [length unit of the rig/px].
        sensitivity
            Derivative of all gains by the camera parameters, shape (P, 10 V, 3, 3); ``None`` where it is not wanted.
        pixels
            Pixels of reference, shape (V, P, 2) [px]; NaN in views that are left out.
        rig
            V cameras.
        """
        for number, point in self.points.items():
            own = pixels[:, number]
            jacobian[number] = np.einsum("ai,ivk->avk", self.rotation, point.jacobian(own, rig))
            if sensitivity is not None:
                one = compute_gain_sensitivity(own[:, None], rig, jacobian_of=_Slope(point))
                sensitivity[number] = one[0]


@dataclass(frozen=True, eq=False)
class _Slope:
    """`EdgePoint.jacobian` of one point in the form of `triangulation_jacobian`."""

    point: EdgePoint

    def __call__(self, points2d: FloatArray, rig: Rig) -> FloatArray:
        return self.point.jacobian(points2d[:, 0], rig)[None]


def solve_edges(
    tracks: xr.Dataset, sight: Sightings, rig: Rig, rotation: FloatArray, prior_std_m: FloatArray
) -> SolvedEdges:
    """Motion of all edges among the points.

    Parameters
    ----------
    tracks
        Synchronised tracks, shape (V, T, P, 2) [px].
    sight
        Pixels that are used.
    rig
        V metric cameras.
    rotation
        Rows are the axes of the result in the first camera's frame, shape (3, 3) [1].
    prior_std_m
        Standard deviation of the motion along these axes before it is measured, shape (3,) [m].
    """
    prior = rotation.T @ np.diag(prior_std_m**-2.0) @ rotation
    anchor = sight.anchor(sight.visibility.of_sample >= 0)
    points: dict[int, EdgePoint] = {}
    motions: dict[int, EdgeMotion] = {}
    places: dict[int, FloatArray] = {}
    hidden: dict[int, BoolArray] = {}
    for number in np.flatnonzero(find_edges(tracks)).tolist():
        used = sight.used[:, :, number] & (sight.visibility.of_sample[:, number] >= 0)
        information = _invert(tracks["position_covariance"].values[:, :, number], used)
        point = EdgePoint(anchor[:, number], information, prior)
        motion = point.solve(np.where(used[..., None], sight.pixels[:, :, number], np.nan), rig)
        points[number], motions[number], places[number] = point, motion, point.place(rig)
        hidden[number] = point.open_axes(motion.covariance, rotation, OPEN_SHARE)
    return SolvedEdges(points, motions, places, hidden, rotation)


def _invert(covariance: FloatArray, used: BoolArray) -> FloatArray:
    """Information of one point's pixels, shape (V, T, 2, 2) [1/px2]; zero where a view is not used.

    A covariance that a frame does not state is the mean of those that its view states.
    """
    known = used & np.isfinite(covariance).all(axis=(2, 3))
    count = np.maximum(known.sum(axis=1), 1)[:, None, None]
    mean = np.where(known[..., None, None], covariance, 0.0).sum(axis=1) / count
    stated = np.where(known[..., None, None], covariance, mean[:, None])
    information = np.linalg.inv(stated + _LEAST_PX**2 * np.eye(2))
    counts = used & np.asarray(known.any(axis=1, keepdims=True))
    return np.where(counts[..., None, None], information, 0.0)
