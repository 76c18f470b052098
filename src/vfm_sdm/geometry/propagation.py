"""How uncertainty of pixels and of cameras becomes uncertainty of displacement (first order, as in the GUM)."""

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.triangulation import triangulate

__all__ = [
    "compute_gain_covariance",
    "compute_gain_sensitivity",
    "compute_gain_std",
    "compute_position_covariance",
    "triangulation_jacobian",
]

_PIXEL_STEP = 0.5
# Steps of the camera parameters: large enough to stand clear of rounding, small enough to stay linear.
_PARAMETER_STEP = np.array([1e-4, 0.1, 0.1, 1e-4, 1e-4, 1e-4, 1e-4])


def triangulation_jacobian(points2d: npt.ArrayLike, rig: Rig, *, weights: npt.ArrayLike | None = None) -> FloatArray:
    """Change of triangulated positions with the pixels that they come from.

    Parameters
    ----------
    points2d
        Shape (V, P, 2) [px]; NaN where one of more than two views does not see a point.
    rig
        V cameras.
    weights
        Factors of the equations of each view, shape (V, P) [1], see `triangulate`.

    Returns
    -------
    jacobian
        Shape (P, 3, V, 2) [length unit of the rig per px], first camera's frame; central differences. Zero for a view
        that does not see a point.
    """
    u = as_float_array(points2d, "points2d", (len(rig), None, 2))
    jacobian = np.empty((u.shape[1], 3, len(rig), 2))
    for view in range(len(rig)):
        for axis in range(2):
            step = np.zeros_like(u)
            step[view, :, axis] = _PIXEL_STEP
            difference = triangulate(u + step, rig, weights=weights) - triangulate(u - step, rig, weights=weights)
            jacobian[:, :, view, axis] = difference / (2 * _PIXEL_STEP)
    return jacobian


def compute_position_covariance(jacobian: FloatArray, pixel_covariance: npt.ArrayLike) -> FloatArray:
    """Covariance of positions from independent pixel noise in every view.

    Parameters
    ----------
    jacobian
        Shape (P, 3, V, 2), of `triangulation_jacobian`.
    pixel_covariance
        Shape (V, T, P, 2, 2) [px2].

    Returns
    -------
    covariance
        Shape (T, P, 3, 3) [length unit squared].
    """
    covariance = as_float_array(pixel_covariance, "pixel_covariance", (-1, 2, 2))
    return np.asarray(np.einsum("pivk,vtpkl,pjvl->tpij", jacobian, covariance, jacobian, optimize=True))


def compute_gain_sensitivity(points2d: npt.ArrayLike, rig: Rig, *, weights: npt.ArrayLike | None = None) -> FloatArray:
    """Change of the displacement gain matrix with every camera parameter.

    A true small displacement ``d`` moves the pixels by ``P d``; with wrong camera parameters it is measured as
    ``M d``, where ``M = J P`` is the identity for right ones. This is the derivative of ``M``.

    Parameters
    ----------
    points2d, rig, weights
        As in `triangulation_jacobian`.

    Returns
    -------
    sensitivity
        Shape (P, 10 V, 3, 3), first camera's frame; parameters in the order of the rig's covariance.
    """
    u = as_float_array(points2d, "points2d", (len(rig), None, 2))
    points = u.shape[1]
    projection = _projection_jacobian(triangulate(u, rig, weights=weights), rig)
    if len(rig) > 2:  # a view that does not see a point says nothing, even where the point lies behind it
        seen = np.asarray(np.isfinite(u).all(axis=-1))
        projection = np.where(seen.T[:, :, None, None], projection, 0.0)
    size = len(CAMERA_PARAMETERS)
    lengths = np.full(3, 1e-4 * max(rig.baseline(), 1e-12))
    steps = np.tile(np.concatenate([_PARAMETER_STEP, lengths]), len(rig))
    sensitivity = np.empty((points, size * len(rig), 3, 3))
    for index, step in enumerate(steps):
        delta = np.zeros(size * len(rig))
        delta[index] = step
        ahead, back = (triangulation_jacobian(u, rig.perturbed(sign * delta), weights=weights) for sign in (1, -1))
        change = ahead - back
        sensitivity[:, index] = np.einsum("pivk,pvkj->pij", change / (2 * step), projection)
    return sensitivity


def compute_gain_covariance(
    sensitivity: FloatArray, rotation: FloatArray, covariance: FloatArray, *, refinement_gain: FloatArray | None = None
) -> FloatArray:
    """Covariance of the gains from motion along the axes to measured displacement along each axis.

    Parameters
    ----------
    sensitivity
        Shape (P, 10 V, 3, 3), of `compute_gain_sensitivity`.
    rotation
        ``structure_from_cam1`` or the identity, shape (3, 3): the axes of the result.
    covariance
        Shape (10 V + 3, 10 V + 3): camera parameters, then a small rotation vector of the axes [rad].
    refinement_gain
        Refined displacement from displacement as the images alone give it, shape (P, 3, 3) [1].

    Returns
    -------
    gain_covariance
        Shape (P, 3, 3, 3) [1]: element (a, b, c) is the covariance of the relative errors of axis ``a`` from motions
        along axes ``b`` and ``c``. A displacement d has the variance ``d' C_a d`` along axis a.
    """
    turned = np.einsum("ai,pnij,bj->pnab", rotation, sensitivity, rotation)
    # An error w of the rotation structure_from_cam1 turns a displacement d into d + w x d.
    generators = np.zeros((3, 3, 3))
    for axis, (row, column) in enumerate(((1, 2), (2, 0), (0, 1))):
        generators[axis, row, column], generators[axis, column, row] = -1.0, 1.0
    everything = np.concatenate([turned, np.broadcast_to(generators, (len(turned), 3, 3, 3))], axis=1)
    if refinement_gain is not None:
        everything = np.einsum("pax,pnxb->pnab", refinement_gain, everything)
    return np.asarray(np.einsum("pnab,nm,pmac->pabc", everything, covariance, everything, optimize=True))


def compute_gain_std(sensitivity: FloatArray, rotation: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviation of the gain from motion along one axis to measured displacement along another.

    Parameters
    ----------
    sensitivity, rotation, covariance
        See `compute_gain_covariance`.

    Returns
    -------
    gain_std
        Shape (P, 3, 3) [1]: element (a, b) is the relative error of axis ``a`` from motion along axis ``b``; the
        diagonal is the standard deviation of the scale of each axis, the rest is leakage between axes.
    """
    variance = np.einsum("pabb->pab", compute_gain_covariance(sensitivity, rotation, covariance))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _projection_jacobian(points3d: FloatArray, rig: Rig) -> FloatArray:
    """Pixels moved a unit of displacement, shape (P, V, 2, 3) [px per length unit]."""
    step = 1e-4 * np.linalg.norm(points3d, axis=-1, keepdims=True)
    columns = []
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        moved = [c.project(points3d + shift) - c.project(points3d - shift) for c in rig.cameras]
        columns.append(np.stack(moved, axis=1) / (2 * step[:, :, None]))
    return np.stack(columns, axis=-1)
