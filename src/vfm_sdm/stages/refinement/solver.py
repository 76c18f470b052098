"""Gauss-Newton iteration of the refinement, for many points of one uncertain view at a time."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate_with_slope, view_equations
from vfm_sdm.stages.refinement.objective import Baseline, Objective, SgrWeights, make_objective

__all__ = ["Minimum", "PointTriangulation", "find_minimum"]

_STEP_TOLERANCE_PX = 1e-3
"""Convergence is quadratic: after a step of this size about a thousandth of its square is left."""
_RISE = 1e-12
"""Relative rise of the objective that is rounding."""
_FREQUENCIES = 64


@dataclass(frozen=True, eq=False)
class Minimum:
    """Result of the iteration for P points of T frames.

    Parameters
    ----------
    correction
        Correction of the pixel coordinate u, shape (P, T) [px]; zero where not valid.
    valid
        Samples that took part, shape (P, T).
    cost, iterations, converged
        Objective, steps, and whether the last step was below tolerance, shape (P,).
    direction
        Displacement that a unit of baseline motion along the suppressed axis loses, shape (P, 3) [1], axes in the
        order of the objective: the first entry is the share of the assumption.
    """

    correction: FloatArray
    valid: BoolArray
    cost: FloatArray
    iterations: IntArray
    converged: BoolArray
    direction: FloatArray


class PointTriangulation:
    """Positions of P points in T frames as functions of a correction of u in one of the views.

    Parameters
    ----------
    pixels
        Shape (V, T, P, 2) [px]; NaN where one of more than two views does not see a point.
    rig
        V cameras.
    axes
        Rotation from the first camera's frame to the axes of the positions, shape (3, 3).
    view
        Index of the corrected view.
    weights
        Factors of the equations of each view, shape (V, P) [1]; 1 without.
    """

    def __init__(
        self, pixels: FloatArray, rig: Rig, axes: FloatArray, view: int, weights: FloatArray | None = None
    ) -> None:
        by_point = np.ascontiguousarray(pixels.transpose(0, 2, 1, 3))
        self.shape: tuple[int, int] = by_point.shape[1:3]
        self.u = by_point[view, ..., 0]
        self._pixels = by_point[view].reshape(-1, 2)
        self._rig, self._axes, self._view = rig, axes, view
        self._seen = np.isfinite(by_point).all(axis=-1).reshape(len(rig), -1)
        self._weights = None if weights is None else np.repeat(weights, self.shape[1], axis=1)
        self._fixed = {
            number: self._weighed(number, view_equations(camera, camera.normalize(own.reshape(-1, 2))))
            for number, (camera, own) in enumerate(zip(rig.cameras, by_point, strict=True))
            if number != view
        }

    def _weighed(self, view: int, equations: FloatArray) -> FloatArray:
        return equations if self._weights is None else self._weights[view] * equations

    def __call__(self, correction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and their change with u, both (3, P, T), at a correction (P, T).

        NaN where a pixel is missing, the rays are nearly parallel, or the point is behind a camera.
        """
        pixels = self._pixels.copy()
        pixels[:, 0] += correction.ravel()
        camera = self._rig.cameras[self._view]
        normalized = camera.normalize(pixels)
        moved = self._weighed(self._view, view_equations(camera, normalized))
        equations = [self._fixed.get(number, moved) for number in range(len(self._rig))]
        weights = 1.0 if self._weights is None else self._weights[self._view]
        points3d, slope = triangulate_with_slope(equations, camera, normalized, view=self._view, weights=weights)
        for c, seen in zip(self._rig.cameras, self._seen, strict=True):
            depth = c.rotation[2] @ points3d + c.translation[2]
            points3d[:, seen & ~(depth > 0)] = np.nan
        return (self._axes @ points3d).reshape(3, *self.shape), (self._axes @ slope).reshape(3, *self.shape)


def find_minimum(
    triangulation: PointTriangulation, baseline: Baseline, weights: SgrWeights, *, max_iterations: int
) -> Minimum:
    """Corrections that make the objective of each point least.

    Parameters
    ----------
    triangulation
        Of the points.
    baseline
        Its value without correction.
    weights, max_iterations
        See `SgrSettings`.

    Returns
    -------
    minimum
        Corrections, shape (P, T) [px], and how the iteration ended.
    """
    position, valid = baseline.position, baseline.valid
    slope = np.where(valid, baseline.slope, 0.0)
    objective = make_objective(replace(baseline, slope=slope), triangulation.u, weights)
    direction = _compute_lost_motion(objective, slope)
    correction = np.zeros(triangulation.shape)
    cost = objective.cost(position, correction)
    points = len(cost)
    damping = np.ones(points)
    converged, iterations = np.zeros(points, dtype=bool), np.zeros(points, dtype=np.int64)
    for _ in range(max_iterations):
        iterations[~converged] += 1
        gradient, diagonal, beside = objective.normal_equations(position, slope, correction)
        # One chain holds all points: the couplings between the end of one and the start of the next are zero.
        step = solveh_banded(np.stack([beside.ravel(), diagonal.ravel()]), -gradient.ravel(), check_finite=False)
        step = step.reshape(correction.shape)
        converged |= np.abs(step).max(axis=1) < _STEP_TOLERANCE_PX
        if converged.all():
            # So near the minimum the quadratic model is exact; it saves the last triangulation.
            correction = correction + step
            cost = cost + np.einsum("pt,pt->p", gradient, step)
            break
        trial = correction + damping[:, None] * step
        trial_position, trial_slope = triangulation(trial)
        trial_cost = objective.cost(trial_position, trial)
        better = trial_cost <= cost * (1 + _RISE)
        damping = np.where(better, np.minimum(1.0, 2 * damping), 0.5 * damping)
        cost = np.where(better, trial_cost, cost)
        correction = np.where(better[:, None], trial, correction)
        position = np.where(better[:, None], trial_position, position)
        slope = np.where(better[:, None] & valid, trial_slope, slope)
    return Minimum(correction, valid, cost, iterations, converged, direction)


def _compute_lost_motion(objective: Objective, slope: FloatArray) -> FloatArray:
    """See `Minimum.direction`: ``S g / g_z`` of the linearised problem, averaged over the frequencies, (P, 3)."""
    mean = slope.sum(axis=2) / objective.valid.sum(axis=1)
    frequency = (np.arange(_FREQUENCIES) + 0.5) / (2 * _FREQUENCIES)
    stiffness = objective.level + objective.rate * 4 * np.sin(np.pi * frequency) ** 2
    resistance = (mean[..., None] ** 2 * stiffness).sum(axis=0) + objective.pixel
    return np.asarray((mean * np.mean(mean[0, :, None] * stiffness[0] / resistance, axis=1)).T)
