"""Propagation of the uncertainty of pixels and cameras to displacement (first order, as in the GUM)."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.triangulation import triangulate

__all__ = [
    "compute_gain_covariance",
    "compute_gain_sensitivity",
    "compute_gain_std",
    "compute_place_covariance",
    "compute_place_sensitivity",
    "compute_position_covariance",
    "projection_jacobian",
    "step_parameters",
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
        Pixels in every view, shape (V, P, 2) [px]; NaN where one of more than two views does not see a point.
    rig
        V cameras.
    weights
        Factors of the equations of each view, shape (V, P) [1], see `triangulate`.

    Returns
    -------
    jacobian
        Derivative by central differences in the first camera's frame, shape (P, 3, V, 2) [length unit of the rig per
        px]; zero for a view that does not see a point.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> pixels = np.stack([camera.project([[1.0, 0.5, 25.0]]) for camera in rig.cameras])
    >>> jacobian = triangulation_jacobian(pixels, rig)
    >>> (1e3 * jacobian[0, 1, :, 1]).round(2).tolist()
    [3.13, 3.13]
    """
    u = as_float_array(points2d, "points2d", (len(rig), None, 2))
    jacobian = np.empty((u.shape[1], 3, len(rig), 2))
    for view, axis, step in _pixel_steps(u):
        difference = triangulate(u + step, rig, weights=weights) - triangulate(u - step, rig, weights=weights)
        jacobian[:, :, view, axis] = difference / (2 * _PIXEL_STEP)
    return jacobian


def compute_position_covariance(jacobian: FloatArray, pixel_covariance: npt.ArrayLike) -> FloatArray:
    """Covariance of positions from independent pixel noise in every view.

    Parameters
    ----------
    jacobian
        Result of `triangulation_jacobian`, shape (P, 3, V, 2) [length unit of the rig per px].
    pixel_covariance
        Covariances of the pixels, shape (V, T, P, 2, 2) [px2].

    Returns
    -------
    covariance
        Shape (T, P, 3, 3) [length unit of the rig, squared].

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> pixels = np.stack([camera.project([[1.0, 0.5, 25.0]]) for camera in rig.cameras])
    >>> noise = np.tile(0.01**2 * np.eye(2), (2, 1, 1, 1, 1))
    >>> covariance = compute_position_covariance(triangulation_jacobian(pixels, rig), noise)
    >>> (1e3 * np.sqrt(np.diag(covariance[0, 0]))).round(3).tolist()
    [0.049, 0.046, 0.552]
    """
    covariance = as_float_array(pixel_covariance, "pixel_covariance", (-1, 2, 2))
    return np.asarray(np.einsum("pivk,vtpkl,pjvl->tpij", jacobian, covariance, jacobian, optimize=True))


def step_parameters(rig: Rig) -> Iterator[tuple[float, Rig, Rig]]:
    """Rigs a step ahead and back along each camera parameter, for central differences.

    Parameters
    ----------
    rig
        V cameras.

    Yields
    ------
    step, ahead, back
        Size of the step in the unit of the parameter, and the two rigs; 10 V of them, in the order of the rig's
        covariance.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right))
    >>> step, ahead, back = next(step_parameters(rig))
    >>> round(float(np.log(ahead.cameras[0].focal_px / back.cameras[0].focal_px) / (2 * step)), 6)
    1.0
    """
    size = len(CAMERA_PARAMETERS)
    lengths = np.full(3, 1e-4 * max(rig.baseline(), 1e-12))
    for index, step in enumerate(np.tile(np.concatenate([_PARAMETER_STEP, lengths]), len(rig))):
        delta = np.zeros(size * len(rig))
        delta[index] = step
        yield float(step), rig.perturbed(delta), rig.perturbed(-delta)


def compute_gain_sensitivity(
    points2d: npt.ArrayLike,
    rig: Rig,
    *,
    weights: npt.ArrayLike | None = None,
    jacobian_of: Callable[[FloatArray, Rig], FloatArray] | None = None,
) -> FloatArray:
    """Change of the displacement gain matrix with every camera parameter.

    Parameters
    ----------
    points2d, rig, weights
        As in `triangulation_jacobian`.
    jacobian_of
        What gives the change of measured positions with the pixels for points and cameras; `triangulation_jacobian` by
        default.

    Returns
    -------
    sensitivity
        Derivative in the first camera's frame, shape (P, 10 V, 3, 3) [1 per unit of the parameter]; parameters in the
        order of the rig's covariance.

    Notes
    -----
    A true small displacement ``d`` moves the pixels by ``P d``; with wrong camera parameters it is measured as
    ``M d``, where ``M = J P`` is the identity for the right ones. The sensitivity is the derivative of ``M``.
    """
    u = as_float_array(points2d, "points2d", (len(rig), None, 2))
    measure = partial(triangulation_jacobian, weights=weights) if jacobian_of is None else jacobian_of
    projection = _project_motion(u, rig, weights)
    sensitivity = np.empty((u.shape[1], len(CAMERA_PARAMETERS) * len(rig), 3, 3))
    for index, (step, ahead, back) in enumerate(step_parameters(rig)):
        sensitivity[:, index] = _change_of_gain(measure(u, ahead), measure(u, back), step, projection)
    return sensitivity


def compute_place_sensitivity(points2d: npt.ArrayLike, rig: Rig, *, weights: npt.ArrayLike | None = None) -> FloatArray:
    """Change of the displacement gain matrix with where each point was found in every view.

    Parameters
    ----------
    points2d, rig, weights
        As in `triangulation_jacobian`.

    Returns
    -------
    sensitivity
        Derivative in the first camera's frame, shape (P, 2 V, 3, 3) [1/px]; pixel coordinates view by view.

    Notes
    -----
    As `compute_gain_sensitivity`: what is a little beside the point moves as it does, and its pixels are taken for
    those of a point at another depth.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> pixels = np.stack([camera.project([[1.0, 0.5, 25.0]]) for camera in rig.cameras])
    >>> sensitivity = compute_place_sensitivity(pixels, rig)
    >>> round(float(640 * sensitivity[0, 2, 1, 1]), 3)  # a disparity of 640 px; one pixel of it is 1/640 of the depth
    1.0
    """
    u = as_float_array(points2d, "points2d", (len(rig), None, 2))
    projection = _project_motion(u, rig, weights)
    sensitivity = np.empty((u.shape[1], 2 * len(rig), 3, 3))
    for view, axis, step in _pixel_steps(u):
        ahead, back = (triangulation_jacobian(u + sign * step, rig, weights=weights) for sign in (1, -1))
        sensitivity[:, 2 * view + axis] = _change_of_gain(ahead, back, _PIXEL_STEP, projection)
    return sensitivity


def compute_place_covariance(
    changes: FloatArray, rotation: FloatArray, *, refinement_gain: FloatArray | None = None
) -> FloatArray:
    """Covariance of the gains from how well the places of points are known.

    Parameters
    ----------
    changes
        Results of `compute_place_sensitivity` times the standard deviation of each pixel coordinate, shape
        (P, 2 V, 3, 3) [1].
    rotation, refinement_gain
        As in `compute_gain_covariance`.

    Returns
    -------
    gain_covariance
        As of `compute_gain_covariance`, shape (P, 3, 3, 3) [1].
    """
    turned = np.einsum("ai,pnij,bj->pnab", rotation, changes, rotation)
    if refinement_gain is not None:
        turned = np.einsum("pax,pnxb->pnab", refinement_gain, turned)
    return np.asarray(np.einsum("pnab,pnac->pabc", turned, turned))


def compute_gain_covariance(
    sensitivity: FloatArray, rotation: FloatArray, covariance: FloatArray, *, refinement_gain: FloatArray | None = None
) -> FloatArray:
    """Covariance of the gains from motion along the axes to measured displacement along each axis.

    Parameters
    ----------
    sensitivity
        Result of `compute_gain_sensitivity`, shape (P, 10 V, 3, 3).
    rotation
        ``structure_from_cam1`` or the identity, shape (3, 3) [1]: the axes of the result.
    covariance
        Covariance of the camera parameters, then of a small rotation vector of the axes [rad], shape
        (10 V + 3, 10 V + 3).
    refinement_gain
        Gain from displacement as the images alone give it to refined displacement, shape (P, 3, 3) [1].

    Returns
    -------
    gain_covariance
        Covariance, shape (P, 3, 3, 3) [1]: element (a, b, c) is the covariance of the relative errors of axis ``a``
        from motions along axes ``b`` and ``c``. A displacement d has the variance ``d' C_a d`` along axis a.

    References
    ----------
    .. [1] JCGM 100:2008. Evaluation of measurement data: guide to the expression of uncertainty in measurement (GUM).
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
        Standard deviation, shape (P, 3, 3) [1]: element (a, b) is the relative error of axis ``a`` from motion along
        axis ``b``; the diagonal is the standard deviation of the scale of each axis, the rest is leakage between axes.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> pixels = np.stack([camera.project([[1.0, 0.5, 25.0]]) for camera in rig.cameras])
    >>> focal = np.zeros((23, 23))
    >>> focal[0, 0] = focal[10, 10] = focal[0, 10] = focal[10, 0] = 0.01**2
    >>> gain_std = compute_gain_std(compute_gain_sensitivity(pixels, rig), np.eye(3), focal)
    >>> np.diag(gain_std[0]).round(4).tolist()
    [0.0, 0.0, 0.01]
    """
    variance = np.einsum("pabb->pab", compute_gain_covariance(sensitivity, rotation, covariance))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _pixel_steps(u: FloatArray) -> Iterator[tuple[int, int, FloatArray]]:
    """Index of a view and of a pixel axis, and steps along it there for pixels (V, P, 2) [px], one after the other."""
    for view, axis in product(range(len(u)), range(2)):
        step = np.zeros_like(u)
        step[view, :, axis] = _PIXEL_STEP
        yield view, axis, step


def _change_of_gain(ahead: FloatArray, back: FloatArray, step: float, projection: FloatArray) -> FloatArray:
    """Derivative of the gain matrices, (P, 3, 3), from Jacobians (P, 3, V, 2) a step ahead and back."""
    return np.asarray(np.einsum("pivk,pvkj->pij", (ahead - back) / (2 * step), projection))


def _project_motion(u: FloatArray, rig: Rig, weights: npt.ArrayLike | None) -> FloatArray:
    """Pixels moved a unit of displacement at triangulated points, shape (P, V, 2, 3) [px per length unit]."""
    projection = projection_jacobian(triangulate(u, rig, weights=weights), rig)
    if len(rig) > 2:  # a view that does not see a point counts for nothing, even where the point lies behind it
        seen = np.asarray(np.isfinite(u).all(axis=-1))
        projection = np.where(seen.T[:, :, None, None], projection, 0.0)
    return projection


def projection_jacobian(points3d: FloatArray, rig: Rig) -> FloatArray:
    """Change of the pixels of every view with the position of a point.

    Parameters
    ----------
    points3d
        Points in the first camera's frame, shape (P, 3) [length unit of the rig].
    rig
        V cameras.

    Returns
    -------
    jacobian
        Shape (P, V, 2, 3) [px per length unit]; NaN for a point that is NaN or behind a camera.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> projection_jacobian(np.array([[0.0, 0.0, 25.0]]), Rig(("left",), (left,)))[0, 0].round(6).tolist()
    [[160.0, 0.0, 0.0], [0.0, 160.0, 0.0]]
    """
    step = 1e-4 * np.linalg.norm(points3d, axis=-1, keepdims=True)
    columns = []
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        moved = [c.project(points3d + shift) - c.project(points3d - shift) for c in rig.cameras]
        columns.append(np.stack(moved, axis=1) / (2 * step[:, :, None]))
    return np.stack(columns, axis=-1)
