"""Rotation and translation of one camera a frame, from the pixels of points that stand still."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from vfm_sdm.core.arrays import BoolArray, FloatArray, mean_of_known, time_blocks
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.distortion import distort_derivative

__all__ = [
    "LEVER_ARM_M",
    "MotionEstimate",
    "MotionModel",
    "compute_motion_jacobian",
    "fit_motion",
    "jacobian_in_camera",
    "replace_doubtful",
]

LEVER_ARM_M = 1.5
"""Height of a tripod: a camera that turns by a radian about the tripod's foot is carried along by this much [m]."""
_LEAST_STD_PX = 1e-3
"""Least standard deviation of a track; it keeps stated covariances of zero from outweighing all others."""
_SUSPICIOUS = 0.1
"""Share of a point's mean variance below which a frame's own variance is not used: the tracker's reference frame."""
_UNSTEADINESS = np.linspace(np.log(1e-8), np.log(0.1), 65)
"""Logarithms of the standard deviations of rotation [rad] among which the recording's is sought."""
_ROUNDS = 8
_SETTLED = 1e-3
_FEWEST_SPARE = 10
"""Spare observations from which the size of the noise can be told."""


@dataclass(frozen=True, eq=False)
class MotionEstimate:
    """Motion of one camera in T frames by S static points.

    Parameters
    ----------
    motion
        Rotation [rad], then translation [m], shape (T, 6), see `compute_motion_jacobian`.
    covariance
        Covariance of the motion, shape (T, 6, 6) [rad2, rad m, m2].
    motion_without, covariance_without
        Motion and covariance found without one static point, shapes (S, T, 6) and (S, T, 6, 6).
    """

    motion: FloatArray
    covariance: FloatArray
    motion_without: FloatArray
    covariance_without: FloatArray


@dataclass(frozen=True, eq=False)
class MotionModel:
    """What a whole recording says of its camera's motion; of `fit_motion`.

    Parameters
    ----------
    slope
        Change of the S static points' pixels with the motion in units of the prior, shape (S, 2, 6) [px].
    rest
        Pixels of the static points with the camera at rest, shape (S, 2) [px].
    unsteadiness_rad
        Standard deviation of the rotation over the recording [rad].
    likelihood_ratio
        Twice the logarithm of how much likelier the shifts are with a moving camera than with a still one [1].
    noise_factor
        Variance of the static points about the estimate over their stated one [1]; 1 where nothing tells.
    """

    slope: FloatArray
    rest: FloatArray
    unsteadiness_rad: float
    likelihood_ratio: float
    noise_factor: float

    def estimate(self, position: FloatArray, covariance: FloatArray) -> MotionEstimate:
        """Motion in some of the frames, relative to its mean over the recording.

        Parameters
        ----------
        position, covariance
            Of the static points in these frames, as of `fit_motion`.

        Notes
        -----
        Where a frame shows no static point, the motion is zero and its covariance that over the recording.
        """
        equations = _Equations.of(self, position, covariance)
        scale = np.repeat([1.0, LEVER_ARM_M], 3)
        z, z_covariance = equations.posterior(self.unsteadiness_rad)
        others = [np.arange(len(self.rest)) != point for point in range(len(self.rest))]
        without = [equations.posterior(self.unsteadiness_rad, among) for among in others]
        return MotionEstimate(
            motion=scale * z,
            covariance=np.outer(scale, scale) * z_covariance,
            motion_without=scale * np.stack([one for one, _ in without]),
            covariance_without=np.outer(scale, scale) * np.stack([one for _, one in without]),
        )


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of some frames, point by point."""

    seen: BoolArray
    shift: FloatArray
    weight: FloatArray
    weighted: FloatArray
    normal: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, model: MotionModel, position: FloatArray, covariance: FloatArray) -> "_Equations":
        seen = np.asarray(np.isfinite(position).all(axis=-1))
        noise = model.noise_factor * covariance + _LEAST_STD_PX**2 * np.eye(2)
        weight = np.where(seen[..., None, None], np.linalg.inv(noise), 0.0)
        weighted = np.einsum("pia,tpij->tpaj", model.slope, weight)
        shift = np.where(seen[..., None], position - model.rest, 0.0)
        normal = np.einsum("tpaj,pjb->tpab", weighted, model.slope)
        return cls(seen, shift, weight, weighted, normal, np.einsum("tpaj,tpj->tpa", weighted, shift))

    def posterior(self, spread: float, among: BoolArray | slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """Most probable z (T, 6) and its covariance (T, 6, 6) by some of the points, of a prior of this spread."""
        normal = self.normal[:, among].sum(axis=1)
        covariance = np.asarray(np.linalg.inv(normal + np.eye(normal.shape[-1]) / spread**2))
        return np.asarray(np.einsum("tab,tb->ta", covariance, self.right[:, among].sum(axis=1))), covariance

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues of each frame's normal matrix, and squares of the right side along its vectors, shape (T, 6)."""
        eigenvalues, vectors = np.linalg.eigh(self.normal.sum(axis=1))
        squares = np.einsum("tba,tb->ta", vectors, self.right.sum(axis=1)) ** 2
        return np.maximum(eigenvalues, 0.0), squares


def compute_motion_jacobian(camera: Camera, points3d: FloatArray) -> FloatArray:
    """Change of pixels with a small motion of the camera.

    Parameters
    ----------
    camera
        The camera at rest.
    points3d
        World frame, shape (P, 3) [length unit of the rig]; NaN where unknown.

    Returns
    -------
    jacobian
        Shape (P, 2, 6) [px/rad, px per length unit]. A point at ``X`` in the camera's axes at rest is at
        ``X + w x X + s`` in those of the moved camera, with the rotation w and the translation s.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> jacobian = compute_motion_jacobian(camera, np.array([[0.0, 0.0, 20.0]]))
    >>> jacobian[0].round(3).tolist()
    [[0.0, 1000.0, 0.0, 50.0, 0.0, 0.0], [-1000.0, 0.0, 0.0, 0.0, 50.0, 0.0]]
    """
    return jacobian_in_camera(camera, points3d @ camera.rotation.T + camera.translation)


def jacobian_in_camera(camera: Camera, X: FloatArray) -> FloatArray:
    """Change of pixels with a small motion of the camera, of points in the camera's own axes.

    Parameters
    ----------
    camera
        Its lens; its pose does not count.
    X
        Camera's axes, shape (..., 3) [length unit of the rig]; NaN where unknown.

    Returns
    -------
    jacobian
        Shape (..., 2, 6) [px/rad, px per length unit], see `compute_motion_jacobian`.
    """
    x, y, depth = X[..., 0] / X[..., 2], X[..., 1] / X[..., 2], X[..., 2]
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = (*x.shape, 2, 3)
    # Of the normalised coordinates by w and s; w x X = (wy z - wz y, wz x - wx z, wx y - wy x).
    by_rotation = np.stack([-x * y, 1 + x * x, -y, -(1 + y * y), x * y, x], axis=-1).reshape(rows)
    by_translation = np.stack([one, zero, -x, zero, one, -y], axis=-1).reshape(rows) / depth[..., None, None]
    lens = camera.K[:2, :2] @ distort_derivative(np.stack([x, y], axis=-1), camera.distortion)
    return np.asarray(lens @ np.concatenate([by_rotation, by_translation], axis=-1))


def fit_motion(
    position: FloatArray, covariance: FloatArray, jacobian: FloatArray, rest: FloatArray | None = None
) -> MotionModel:
    """What explains how static points shift: how much a camera moves, and where they are when it rests.

    Parameters
    ----------
    position
        Pixels of S static points, shape (T, S, 2) [px]; NaN where missing, no point without any sample.
    covariance
        Covariance of the pixels, shape (T, S, 2, 2) [px2], see `replace_doubtful`.
    jacobian
        Result of `compute_motion_jacobian` for the static points, shape (S, 2, 6) [px/rad, px/m].
    rest
        Pixels of the static points with the camera at rest, shape (S, 2) [px], where an earlier part of the recording
        told them: the motion is relative to those. NaN, or ``None``, where these frames have to tell.

    Notes
    -----
    Pixels are ``y = m + J D z + n`` with the noise n of the tracks and ``z ~ N(0, s^2 I)``, independent from frame to
    frame. D scales rotations by 1 and translations by `LEVER_ARM_M`. So one number, the camera's unsteadiness s, is
    the prior of all six; it is taken from the recording itself, where the likelihood of all shifts (z integrated out)
    is largest. With it the most probable z follows from as many or as few points as a frame shows, and goes to zero
    with s. The pixels at rest m are the generalised least-squares mean, the factor of the noise makes the residuals
    what they should be; the three are found in turn. Frames are taken in blocks, so that memory grows little with the
    length of a recording.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> points3d = np.array([[-4.0, -2.0, 20.0], [4.0, -2.0, 25.0], [0.0, 3.0, 15.0]])
    >>> jacobian = compute_motion_jacobian(camera, points3d)
    >>> yaw_rad = 1e-3 * np.sin(np.arange(200) / 5)
    >>> position = camera.project(points3d) + yaw_rad[:, None, None] * jacobian[:, :, 1]
    >>> covariance = np.tile(0.01**2 * np.eye(2), (200, 3, 1, 1))
    >>> motion = fit_motion(position, covariance, jacobian).estimate(position, covariance).motion
    >>> bool(np.abs(motion[:, 1] - yaw_rad + yaw_rad.mean()).max() < 2e-5)
    True
    """
    seen = np.asarray(np.isfinite(position).all(axis=-1))
    slope = jacobian * np.repeat([1.0, LEVER_ARM_M], 3)
    given = np.full(position.shape[1:], np.nan) if rest is None else rest
    free = np.asarray(np.isnan(given).any(axis=1))
    start = np.where(free[:, None], mean_of_known(position, seen[..., None]), given)
    model = MotionModel(slope, start, -1.0, 0.0, 1.0)
    for _ in range(_ROUNDS):
        modes = [
            _Equations.of(model, position[block], covariance[block]).modes() for block in time_blocks(len(position))
        ]
        spread, ratio = _estimate_unsteadiness(*(np.concatenate(one) for one in zip(*modes, strict=True)))
        settled = abs(spread - model.unsteadiness_rad) <= _SETTLED * spread
        model = replace(model, unsteadiness_rad=spread, likelihood_ratio=ratio)
        if settled:
            break
        model = _improve(model, position, covariance, free)
    return model


def _improve(model: MotionModel, position: FloatArray, covariance: FloatArray, free: BoolArray) -> MotionModel:
    """The model with the pixels at rest of the free points (S,) and the noise that its motion leaves."""
    points = len(model.rest)
    normal, right = np.zeros((points, 2, points, 2)), np.zeros((points, 2))
    used, squares, samples = 0.0, 0.0, 0
    for block in time_blocks(len(position)):
        one = _Equations.of(model, position[block], covariance[block])
        z, z_covariance = one.posterior(model.unsteadiness_rad)
        residual = np.where(one.seen[..., None], one.shift - np.einsum("pia,ta->tpi", model.slope, z), 0.0)
        # The generalised mean of what is left, motion integrated out.
        normal -= np.einsum("tpai,tab,tqbj->piqj", one.weighted, z_covariance, one.weighted, optimize=True)
        normal[np.arange(points), :, np.arange(points)] += one.weight.sum(axis=0)
        right += np.einsum("tpij,tpj->pi", one.weight, residual)
        weight = np.linalg.inv(covariance[block] + _LEAST_STD_PX**2 * np.eye(2))
        squares += float(np.einsum("tpi,tpij,tpj->", residual, weight, residual))
        used += float(np.einsum("tpab,tba->", one.normal, z_covariance))
        samples += int(one.seen.sum())
    correction, unknowns = np.zeros((points, 2)), 2 * int(free.sum())
    of_free = normal[free][:, :, free].reshape(unknowns, unknowns)
    correction[free] = np.linalg.solve(of_free, right[free].ravel()).reshape(-1, 2)
    spare = 2 * samples - used - unknowns
    factor = squares / spare if spare >= _FEWEST_SPARE else 1.0
    return replace(model, rest=model.rest + correction, noise_factor=factor)


def replace_doubtful(covariance: FloatArray, position: FloatArray) -> FloatArray:
    """Covariances, shape (T, S, 2, 2) [px2]; the mean of the point where a frame states next to nothing or nothing.

    Parameters
    ----------
    covariance, position
        Of S static points, shapes (T, S, 2, 2) [px2] and (T, S, 2) [px]; NaN where missing.
    """
    seen = np.asarray(np.isfinite(position).all(axis=-1))
    known = seen & np.isfinite(covariance).all(axis=(2, 3))
    trace = np.trace(covariance, axis1=2, axis2=3)
    believed = known & (trace >= _SUSPICIOUS * mean_of_known(trace, known))
    mean = np.nan_to_num(mean_of_known(covariance, believed[..., None, None]))
    return np.where(believed[..., None, None], covariance, mean)


def _estimate_unsteadiness(eigenvalues: FloatArray, squares: FloatArray) -> tuple[float, float]:
    """The standard deviation of z that makes the shifts likeliest, and twice their log-likelihood ratio to none.

    With the eigenvalues l and -vectors of each frame's normal matrix, and c the right side along them, the ratio is
    the sum of ``s^2 c^2 / (1 + s^2 l) - log(1 + s^2 l)``.
    """

    def ratio(log_spread: float) -> float:
        variance = np.exp(2 * log_spread)
        gain = 1 + variance * eigenvalues
        return float(np.sum(variance * squares / gain - np.log(gain)))

    best = int(np.argmax([ratio(one) for one in _UNSTEADINESS]))
    around = _UNSTEADINESS[max(best - 1, 0)], _UNSTEADINESS[min(best + 1, len(_UNSTEADINESS) - 1)]
    found = minimize_scalar(lambda one: -ratio(one), bounds=around, method="bounded", options={"xatol": 1e-4})
    return float(np.exp(found.x)), float(-found.fun)
