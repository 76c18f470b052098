"""Triangulation of points seen by two or more cameras (section Triangulation of the paper)."""

import numpy as np
import numpy.typing as npt

from vfm_sdm.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig

__all__ = ["compute_reprojection_error", "in_front_of_all", "sampson_error", "triangulate"]


def triangulate(points2d: npt.ArrayLike, rig: Rig) -> FloatArray:
    """Points in space from their pixels in every view, by the linear method.

    Parameters
    ----------
    points2d
        Shape (V, ..., 2) [px]: one entry a camera of the rig, distorted full-image pixels.
    rig
        V >= 2 cameras.

    Returns
    -------
    points3d
        Shape (..., 3), in the frame of the rig's first camera and the rig's length unit; NaN where a pixel is NaN
        in any view, or where the rays are parallel.

    Raises
    ------
    DatasetError
        Fewer than two views, or another number of views than cameras.

    Notes
    -----
    Eqs. (3) and (4): every view contributes ``(u P3 - P1) X = 0`` and ``(v P3 - P2) X = 0``; the solution is the right
    singular vector of the smallest singular value. Pixels are undistorted first, so that ``P = K [R | t]`` holds.
    """
    u = as_float_array(points2d, "points2d", (-1, 2))
    if u.ndim < 2 or u.shape[0] != len(rig) or len(rig) < 2:
        raise DatasetError(
            f"points2d: expected one entry for each of at least two cameras, got shape {u.shape} for {len(rig)} "
            "cameras; stack the views along the first axis"
        )
    rows = []
    for camera, pixels in zip(rig.cameras, u, strict=True):
        x = camera.normalize(pixels)
        pose = camera.cam_from_world
        # Rows of the normalised equations times fx, fy are the rows of Eq. (3): the error stays one of pixels.
        rows.append(camera.K[0, 0] * (x[..., 0, None] * pose[2] - pose[0]))
        rows.append(camera.K[1, 1] * (x[..., 1, None] * pose[2] - pose[1]))
    A = np.stack(rows, axis=-2)
    valid = np.isfinite(A).all(axis=(-2, -1))
    solution = np.linalg.svd(np.where(valid[..., None, None], A, 0.0))[2][..., -1, :]
    at_infinity = np.abs(solution[..., 3]) < 1e-12 * np.linalg.norm(solution, axis=-1)
    weight = np.where(valid & ~at_infinity, solution[..., 3], np.nan)
    return solution[..., :3] / weight[..., None]


def compute_reprojection_error(points3d: npt.ArrayLike, points2d: npt.ArrayLike, rig: Rig) -> FloatArray:
    """Root mean square over the views of the distance between seen and reprojected pixel.

    Parameters
    ----------
    points3d
        Shape (..., 3), first camera's frame.
    points2d
        Shape (V, ..., 2) [px].

    Returns
    -------
    reprojection_error
        Shape (...) [px]; NaN where a point is NaN or behind a camera.
    """
    u = as_float_array(points2d, "points2d", (-1, 2))
    squares = [np.sum((c.project(points3d) - seen) ** 2, axis=-1) for c, seen in zip(rig.cameras, u, strict=True)]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def in_front_of_all(points3d: npt.ArrayLike, rig: Rig) -> BoolArray:
    """Whether points lie in front of every camera (cheirality), shape (..., 3) to (...); False for NaN."""
    X = as_float_array(points3d, "points3d", (-1, 3))
    depths = np.stack([X @ c.rotation[2] + c.translation[2] for c in rig.cameras])
    return np.asarray((depths > 0).all(axis=0))


def sampson_error(
    points_first: npt.ArrayLike, points_second: npt.ArrayLike, rig: Rig, *, first: int = 0, second: int = 1
) -> FloatArray:
    """Signed first-order distance of a match from the epipolar geometry.

    Parameters
    ----------
    points_first, points_second
        Shape (..., 2) [px] in the two views.
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
    Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 11.4.3 (Sampson distance).
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
