"""Triangulation of points seen by two or more cameras (section Triangulation of the paper)."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.distortion import distort_derivative

__all__ = [
    "compute_reprojection_error",
    "in_front_of_all",
    "sampson_error",
    "stack_equations",
    "triangulate",
    "triangulate_equations",
    "triangulate_with_slope",
    "view_equations",
]

_SETTLED = 1e-6
"""Relative size of a point's last correction below which it is found: the next would be about the square of it."""
_CORRECTIONS = 6
_SINGULAR = 1e-13
"""Share of the largest pivot below which a system counts as singular."""
_ROUNDING = 1e-26
"""Share of the largest pivot that rounding may add to a squared residual."""

_Factors = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def triangulate(points2d: npt.ArrayLike, rig: Rig, *, weights: npt.ArrayLike | None = None) -> FloatArray:
    """Points in space from their pixels in the views that see them, by the linear method.

    Parameters
    ----------
    points2d
        Distorted full-image pixels, one entry for each camera of the rig, shape (V, ..., 2) [px]; NaN where a view does
        not see a point.
    rig
        V >= 2 cameras.
    weights
        Factors of the equations of each view, broadcast to shape (V, ...) [1]; 1 by default.

    Returns
    -------
    points3d
        Shape (..., 3) [length unit of the rig], in the frame of the rig's first camera; NaN where fewer than two views
        have a pixel, or where the rays are parallel.

    Raises
    ------
    DatasetError
        Fewer than two views, or another number of views than cameras.

    Notes
    -----
    Eqs. (3) and (4): every view contributes ``(u P3 - P1) X = 0`` and ``(v P3 - P2) X = 0``; the solution is the right
    singular vector of the smallest singular value. Pixels are undistorted first, so that ``P = K [R | t]`` holds.

    References
    ----------
    .. [1] Hartley, R., Zisserman, A. (2004). Multiple View Geometry in Computer Vision, 2nd edition, section 12.2.

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> pixels = [camera.project([1.0, 0.5, 25.0]) for camera in rig.cameras]
    >>> triangulate(pixels, rig).round(6).tolist()
    [1.0, 0.5, 25.0]
    """
    u = as_float_array(points2d, "points2d", (-1, 2))
    if u.ndim < 2 or u.shape[0] != len(rig) or len(rig) < 2:
        raise DatasetError(
            f"points2d: expected one entry for each of at least two cameras, got shape {u.shape} for {len(rig)} "
            "cameras; stack the views along the first axis"
        )
    equations = [view_equations(c, c.normalize(p.reshape(-1, 2))) for c, p in zip(rig.cameras, u, strict=True)]
    if weights is not None:
        factors = np.broadcast_to(np.asarray(weights, np.float64), u.shape[:-1]).reshape(len(rig), -1)
        equations = [factor * rows for factor, rows in zip(factors, equations, strict=True)]
    points3d = triangulate_equations(equations)
    return np.ascontiguousarray(points3d.T).reshape(*u.shape[1:-1], 3)


def view_equations(camera: Camera, normalized: FloatArray) -> FloatArray:
    """The two equations of the linear method that one view contributes for each point.

    Parameters
    ----------
    camera
        The camera, with its pose in the frame of the wanted points.
    normalized
        Undistorted normalised coordinates of `Camera.normalize`, shape (N, 2) [1].

    Returns
    -------
    equations
        Rows whose product with the homogeneous point is zero, shape (2, 4, N) [px].

    Notes
    -----
    The rows of the normalised equations are taken times fx and fy, which makes them those of Eq. (3): the error stays
    one of pixels.

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> point = np.array([1.0, 0.5, 25.0, 1.0])
    >>> equations = view_equations(left, left.normalize(left.project(point[:3])[None]))
    >>> np.abs(equations[..., 0] @ point).round(9).tolist()
    [0.0, 0.0]
    """
    pose = camera.cam_from_world
    equations = np.empty((2, 4, len(normalized)))
    for row, focal in enumerate((camera.K[0, 0], camera.K[1, 1])):
        np.multiply.outer(focal * pose[2], normalized[:, row], out=equations[row])
        equations[row] -= (focal * pose[row])[:, None]
    return equations


def stack_equations(equations: Sequence[FloatArray]) -> FloatArray:
    """The equations of every view as one system, without those of views that miss a point.

    Parameters
    ----------
    equations
        Equations of each of V views, shape (2, 4, N) [px]; NaN where a view misses a point.

    Returns
    -------
    system
        Shape (2 V, 4, N) [px].

    Notes
    -----
    For more than two views, equations that are NaN become zero, and a point is NaN where fewer than two views are left:
    equations of zeros leave the solution to the others, so that one solve serves points that different views see.
    """
    A = np.concatenate(equations)
    if len(equations) < 3:
        return A
    seen = np.isfinite(A).all(axis=1).reshape(len(equations), 2, -1).all(axis=1)
    if not seen.all():
        A = np.where(np.repeat(seen, 2, axis=0)[:, None], A, 0.0)
        A[:, :, seen.sum(axis=0) < 2] = np.nan
    return A


def triangulate_equations(equations: Sequence[FloatArray]) -> FloatArray:
    """Points in space from the equations of every view, which may be those of another camera for each point.

    Parameters
    ----------
    equations
        As of `view_equations`, times their weights, shape (2, 4, N) each [px].

    Returns
    -------
    points3d
        Points as `triangulate` finds them, shape (3, N) [length unit of the rig].
    """
    return _solve_equations(stack_equations(equations))[0]


def triangulate_with_slope(
    equations: Sequence[FloatArray],
    camera: Camera,
    normalized: FloatArray,
    *,
    view: int,
    weights: FloatArray | float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Points in space, and their change with the pixel coordinate u of one of the views.

    Parameters
    ----------
    equations
        Results of `view_equations` for every view, times their weights, shape (2, 4, N) each [px].
    camera, normalized
        Camera of the view whose u moves, and its undistorted normalised coordinates, shape (N, 2) [1].
    view
        Index of that view.
    weights
        Factors of its equations, a scalar or shape (N,) [1].

    Returns
    -------
    points3d
        Points as `triangulate` finds them, shape (3, N) [length unit of the rig].
    slope
        Shape (3, N) [length unit of the rig per px]; NaN where the rays are nearly parallel, or this view does not see
        the point.

    Notes
    -----
    The derivative of ``(M - s I) X = -b`` (see `_solve_equations`), with A' that of A, is
    ``(M - s I) X' = s' X - (A'^T A x + A^T A' x)``, where ``s' = 2 (A x)^T (A' x) / x^T x``. Of A only the two rows of
    the view change, each by a multiple of the third row of its pose.
    """
    A = stack_equations(equations)
    X, residual, factors, doubtful = _solve_equations(A)
    axis = camera.cam_from_world[2]
    rate_u, rate_v = (weights * rate for rate in _equation_rates(camera, normalized))
    row = A[2 * view : 2 * view + 2, :3]
    depth = axis[:3] @ X + axis[3]
    push = rate_u * residual[2 * view] + rate_v * residual[2 * view + 1]
    change = depth * (rate_u * row[0] + rate_v * row[1]) + push * axis[:3, None]
    slope = _solve(factors, 2 * depth * push / (1 + np.einsum("in,in->n", X, X)) * X - change)
    slope[:, doubtful] = np.nan
    if len(equations) > 2:
        slope[:, np.isnan(normalized).any(axis=1)] = np.nan
    return X, slope


def _equation_rates(camera: Camera, normalized: FloatArray) -> tuple[FloatArray | float, FloatArray | float]:
    """Multiples of the third row of the pose by which the two equations grow with u, scalars or shape (N,) [1]."""
    if not np.any(camera.distortion):
        return 1.0, 0.0
    jacobian = distort_derivative(normalized, camera.distortion)
    xx, xy, yy = jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 1]
    determinant = xx * yy - xy * xy
    return yy / determinant, -camera.K[1, 1] / camera.K[0, 0] * xy / determinant


def _solve_equations(A: FloatArray) -> tuple[FloatArray, FloatArray, _Factors, IntArray]:
    """Points that fit all equations best.

    Parameters
    ----------
    A
        R equations for each point, shape (R, 4, N) [px].

    Returns
    -------
    points3d
        Shape (3, N) [length unit of the rig]; NaN where an equation is NaN or the rays are parallel.
    residual
        ``A x`` with ``x = (X, 1)``, shape (R, N).
    factors
        Factors of ``M - s I``, see below.
    doubtful
        Indices of points that went through a singular value decomposition, whose residual and factors mean nothing.

    Notes
    -----
    The right singular vector x of the smallest singular value of A solves ``(A^T A - s I) x = 0`` with the smallest
    eigenvalue s. Its first three rows, ``(M - s I) X = -b``, are solved from s = 0 on with residuals taken from A, so
    that the conditioning is that of A and not of its square. Eigenvalues interlace: where ``M - s I`` is positive
    definite, s is below all eigenvalues of M and therefore the smallest of ``A^T A``. Points for which this or
    convergence cannot be shown go through the decomposition.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        normal = np.einsum("rin,rjn->ijn", A[:, :3], A)
        X = -_solve(_factorize(normal, 0.0), normal[:, 3])
        residual, share = _residual(A, X)
        for _ in range(_CORRECTIONS):
            factors, shift = _factorize(normal, share), share
            step = _solve(factors, share * X - np.einsum("rin,rn->in", A[:, :3], residual))
            X = X + step
            residual, share = _residual(A, X)
            moving = np.abs(step).max(axis=0) > _SETTLED * np.abs(X).max(axis=0)
            if not moving.any():
                break
        largest = np.maximum(np.maximum(*factors[:2]), factors[2])
        least = np.minimum(np.minimum(*factors[:2]), factors[2])
        smallest = (least > _SINGULAR * largest) & (share <= 1.001 * shift + _ROUNDING * largest)
    doubtful = np.flatnonzero(~smallest | moving)
    if doubtful.size:
        X[:, doubtful] = _solve_by_svd(A[:, :, doubtful])
    return X, residual, factors, doubtful


def _residual(A: FloatArray, X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``A x`` and its squared length over that of ``x = (X, 1)``; (R, 4, N), (3, N) to (R, N) and (N,)."""
    residual = np.einsum("rin,in->rn", A[:, :3], X) + A[:, 3]
    return residual, np.einsum("rn,rn->n", residual, residual) / (1 + np.einsum("in,in->n", X, X))


def _factorize(normal: FloatArray, shift: FloatArray | float) -> _Factors:
    """L D L^T of the symmetric 3 x 3 matrices (3, 3+, N) less ``shift`` I: three pivots, then l10, l20, l21."""
    d0 = normal[0, 0] - shift
    l10, l20 = normal[0, 1] / d0, normal[0, 2] / d0
    d1 = normal[1, 1] - shift - l10 * normal[0, 1]
    e21 = normal[1, 2] - l20 * normal[0, 1]
    l21 = e21 / d1
    d2 = normal[2, 2] - shift - l20 * normal[0, 2] - l21 * e21
    return d0, d1, d2, l10, l20, l21


def _solve(factors: _Factors, right: FloatArray) -> FloatArray:
    """Solutions of the factorised systems, (3, N) to (3, N)."""
    d0, d1, d2, l10, l20, l21 = factors
    solution = np.empty_like(right)
    y1 = right[1] - l10 * right[0]
    z2 = solution[2] = (right[2] - l20 * right[0] - l21 * y1) / d2
    z1 = solution[1] = y1 / d1 - l21 * z2
    solution[0] = right[0] / d0 - l10 * z1 - l20 * z2
    return solution


def _solve_by_svd(A: FloatArray) -> FloatArray:
    """Points (3, N) from equations (R, 4, N); NaN where an equation is NaN or the rays are parallel."""
    stacked = np.moveaxis(A, -1, 0)
    valid = np.asarray(np.isfinite(stacked).all(axis=(-2, -1)))
    solution = np.linalg.svd(np.where(valid[:, None, None], stacked, 0.0))[2][:, -1]
    at_infinity = np.abs(solution[:, 3]) < 1e-12 * np.linalg.norm(solution, axis=-1)
    weight = np.where(valid & ~at_infinity, solution[:, 3], np.nan)
    return np.asarray((solution[:, :3] / weight[:, None]).T)


def compute_reprojection_error(points3d: npt.ArrayLike, points2d: npt.ArrayLike, rig: Rig) -> FloatArray:
    """Root mean square, over the views that see a point, of the distance between seen and reprojected pixel.

    Parameters
    ----------
    points3d
        Points in the first camera's frame, shape (..., 3) [length unit of the rig].
    points2d
        Pixels in every view, shape (V, ..., 2) [px]; NaN where a view does not see a point.
    rig
        V cameras.

    Returns
    -------
    reprojection_error
        Shape (...) [px]; NaN where a point is NaN, behind a camera that sees it, or seen by none.

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> point = [1.0, 0.5, 25.0]
    >>> pixels = np.stack([camera.project(point) for camera in rig.cameras]) + [0.3, 0.4]
    >>> round(float(compute_reprojection_error(point, pixels, rig)), 6)
    0.5
    """
    u = as_float_array(points2d, "points2d", (-1, 2))
    seen = np.isfinite(u).all(axis=-1)
    squares = np.stack([np.sum((c.project(points3d) - p) ** 2, axis=-1) for c, p in zip(rig.cameras, u, strict=True)])
    total, count = np.where(seen, squares, 0.0).sum(axis=0), seen.sum(axis=0)
    return np.asarray(np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan)))


def in_front_of_all(points3d: npt.ArrayLike, rig: Rig, *, seen: BoolArray | None = None) -> BoolArray:
    """Whether points lie in front of every camera that sees them (cheirality).

    Parameters
    ----------
    points3d
        Points in the first camera's frame, shape (..., 3) [length unit of the rig].
    rig
        V cameras.
    seen
        Which cameras see a point, shape (V, ...); all by default.

    Returns
    -------
    in_front
        Shape (...); False for NaN.

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> in_front_of_all([[1.0, 0.5, 25.0], [1.0, 0.5, -25.0]], rig).tolist()
    [True, False]
    """
    X = as_float_array(points3d, "points3d", (-1, 3))
    depths = np.stack([X @ c.rotation[2] + c.translation[2] for c in rig.cameras])
    if seen is None:
        return np.asarray((depths > 0).all(axis=0))
    return np.asarray(((depths > 0) | ~seen).all(axis=0) & np.isfinite(X).all(axis=-1))


def sampson_error(
    points_first: npt.ArrayLike, points_second: npt.ArrayLike, rig: Rig, *, first: int = 0, second: int = 1
) -> FloatArray:
    """Signed first-order distance of a match from the epipolar geometry.

    Parameters
    ----------
    points_first, points_second
        Pixels of the match in the two views, shape (..., 2) [px].
    rig
        The cameras.
    first, second
        Indices of the views in the rig.

    Returns
    -------
    epipolar_error
        Shape (...) [px]. Its standard deviation equals that of one pixel coordinate when all four coordinates of the
        match have independent noise of the same size.

    Notes
    -----
    Eq. (2), ``x2^T E x1 = 0`` with ``E = [t]x R``, divided by its gradient with respect to the four pixel
    coordinates; the gradient is taken in undistorted pixels (each coordinate scaled by its focal length).

    References
    ----------
    .. [1] Hartley, R., Zisserman, A. (2004). Multiple View Geometry in Computer Vision, 2nd edition, section 11.4.3
       (Sampson distance).

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> first, second = (camera.project([1.0, 0.5, 25.0]) for camera in rig.cameras)
    >>> round(float(sampson_error(first, second + [0.0, 1.0], rig)), 4)
    0.7071
    """
    a, b = rig.cameras[first], rig.cameras[second]
    R = b.rotation @ a.rotation.T
    t = b.translation - R @ a.translation
    E = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]]) @ R
    x1, x2 = a.normalize(points_first), b.normalize(points_second)
    line2 = x1 @ E[:, :2].T + E[:, 2]
    line1 = x2 @ E[:2] + E[2]
    numerator = np.sum(x2 * line2[..., :2], axis=-1) + line2[..., 2]
    gradient = (
        np.sum((line2[..., :2] / [b.K[0, 0], b.K[1, 1]]) ** 2, axis=-1)
        + np.sum((line1[..., :2] / [a.K[0, 0], a.K[1, 1]]) ** 2, axis=-1)
    )  # fmt: skip
    return np.asarray(numerator / np.sqrt(gradient))
