"""Many rigs at once, drawn from the covariance of one: what propagation by Monte Carlo triangulates with."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.geometry.distortion import distort, distort_derivative
from vfm_sdm.geometry.triangulation import triangulate_equations

__all__ = ["RigDraws", "draw_normal"]

_NEWTON_STEPS = 3
"""Steps from the nominal solution: the error is squared at each, and drawn distortions differ by far below 1."""


def draw_normal(covariance: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Normal draws about zero, also from a covariance that is singular.

    Parameters
    ----------
    covariance
        Shape (n, n), in any squared units.
    count
        Number of draws N.
    rng
        Source of the draws.

    Returns
    -------
    draws
        Shape (N, n).

    Examples
    --------
    >>> draws = draw_normal(np.array([[4.0, 0.0], [0.0, 0.0]]), 10000, np.random.default_rng(0))
    >>> draws.std(axis=0).round(1).tolist()
    [2.0, 0.0]
    """
    # Focal lengths and angles differ by many orders: the decomposition is that of the correlations.
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(rng.standard_normal((count, len(scale))) @ root.T * scale)


@dataclass(frozen=True, eq=False)
class RigDraws:
    """N rigs whose parameters differ a little from those of one rig.

    Parameters
    ----------
    rig
        The nominal rig of V cameras.
    steps
        Changes of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS` of every draw and camera, shape (N, V, 10), as
        `Rig.perturbed` takes them.

    Examples
    --------
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> steps = np.zeros((2, 2, 10))
    >>> steps[1, :, 0] = np.log(1.01)  # both focal lengths 1 % longer
    >>> pixels = np.stack([camera.project([[1.0, 0.5, 25.0]] * 2) for camera in rig.cameras])
    >>> RigDraws(rig, steps).triangulate(pixels).round(3).tolist()
    [[1.0, 0.5, 25.0], [1.0, 0.5, 25.25]]
    """

    rig: Rig
    steps: FloatArray

    @classmethod
    def from_covariance(cls, rig: Rig, covariance: FloatArray, count: int, rng: np.random.Generator) -> "RigDraws":
        """Rigs drawn from a covariance of all parameters.

        Parameters
        ----------
        rig
            The nominal rig.
        covariance
            Shape (10 V, 10 V), in the order and units of the rig's.
        count
            Number of draws.
        rng
            Source of the draws.
        """
        return cls(rig, draw_normal(covariance, count, rng).reshape(count, len(rig), len(CAMERA_PARAMETERS)))

    def triangulate(self, points2d: FloatArray, *, weights: FloatArray | None = None) -> FloatArray:
        """A position with each of the rigs, by the linear method of `vfm_sdm.geometry.triangulation.triangulate`.

        Parameters
        ----------
        points2d
            Pixels in every view for each draw, shape (V, N, 2) [px]; NaN where a view does not see the point.
        weights
            Factor of the equations of each view, shape (V,) [1].

        Returns
        -------
        points3d
            In the frame in which the nominal first camera is the origin, shape (N, 3) [length unit of the rig].
        """
        factors = np.ones(len(self.rig)) if weights is None else weights
        equations = [
            factor * _equations(camera, self.steps[:, view], points2d[view])
            for view, (camera, factor) in enumerate(zip(self.rig.cameras, factors, strict=True))
        ]
        return np.ascontiguousarray(triangulate_equations(equations).T)


def _equations(camera: Camera, steps: FloatArray, pixels: FloatArray) -> FloatArray:
    """As `view_equations`, one camera a point: steps (N, 10), pixels (N, 2) [px] to (2, 4, N)."""
    focal = np.diag(camera.K)[:2, None] * np.exp(steps[:, 0])
    skew = camera.K[0, 1] * np.exp(steps[:, 0])
    y = (pixels[:, 1] - camera.K[1, 2] - steps[:, 2]) / focal[1]
    x = (pixels[:, 0] - camera.K[0, 2] - steps[:, 1] - skew * y) / focal[0]
    normalized = _undistort(np.stack([x, y], axis=-1), camera.distortion, steps[:, 3])
    rotation = Rotation.from_rotvec(steps[:, 4:7]).as_matrix() @ camera.rotation
    pose = np.concatenate([rotation, (camera.translation + steps[:, 7:10])[:, :, None]], axis=2)
    rows = [focal[row] * (normalized[:, row] * pose[:, 2].T - pose[:, row].T) for row in range(2)]
    return np.stack(rows)


def _undistort(distorted: FloatArray, coefficients: FloatArray, k1_steps: FloatArray) -> FloatArray:
    """Undistorted coordinates (N, 2) by Newton's method, each with its own k1."""
    own = np.repeat(coefficients[:, None], len(distorted), axis=1)
    own[0] += k1_steps
    if not own.any():
        return distorted
    found = distorted.copy()
    for _ in range(_NEWTON_STEPS + 2 * bool(coefficients.any())):
        missing = distorted - distort(found, own)
        J = distort_derivative(found, own)
        determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        found = found + np.stack(
            [
                (J[:, 1, 1] * missing[:, 0] - J[:, 0, 1] * missing[:, 1]) / determinant,
                (J[:, 0, 0] * missing[:, 1] - J[:, 1, 0] * missing[:, 0]) / determinant,
            ],
            axis=-1,
        )
    return found
