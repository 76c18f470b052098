"""Least-squares adjustment of a turning camera to its clip, and the covariance of the lens."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.stages.lens.nearness import PointSums, lever_precision, log_volume, taken_by_nearness
from vfm_sdm.stages.lens.turning_camera import LENS, LensClip, TurningCamera

__all__ = ["AdjustedClip", "adjust_clip"]

_MAX_ITERATIONS, _NOISE_ROUNDS = 60, 6
_CONVERGED, _NOISE_KNOWN = 1e-9, 0.02
_MAX_DAMPING = 1e10
_ROBUST = 2.5
"""Residual over its standard deviation from which a sighting loses weight [1]."""
_MEDIAN_ABSOLUTE = 0.6745
"""Median absolute value of a standard normal number."""
_LEAST_NOISE_PX = 1e-6
_TOLD = 0.2
"""Share of its residuals that a point must keep to tell of the noise."""
_LEVER = slice(5, 8)
_STEP = 0.5
"""Step of the derivative of the points' volume, in standard deviations."""


@dataclass(frozen=True, eq=False)
class AdjustedClip:
    """Result of `adjust_clip`.

    Parameters
    ----------
    camera
        Lens, lever, attitudes and scene at the solution.
    lens
        Values of `LENS`, shape (10,): those of ``camera`` less the bias that the points' distances bring.
    covariance
        Of ``lens``, shape (10, 10), in its units.
    residuals
        Seen minus predicted pixels, shape (N, 2) [px].
    weights
        Weight of each sighting, shape (N,): 1 where it agrees.
    noise_px
        Standard deviation of a sighting along one axis [px].
    """

    camera: TurningCamera
    lens: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    weights: FloatArray
    noise_px: float


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations without the points; C values: `LENS` and the turns, P points."""

    reduced: FloatArray  # (C, C)
    gradient: FloatArray  # (C,)
    coupling: FloatArray  # (P, C, 3)
    points: FloatArray  # (P, 3, 3)
    point_gradient: FloatArray  # (P, 3)

    def moved(self, camera: TurningCamera, step: FloatArray, point_gradient: FloatArray) -> TurningCamera:
        """The camera after a step (C,), with the points where it and their own gradient (P, 3) take them."""
        back = point_gradient - np.einsum("pca,c->pa", self.coupling, step)
        points = np.linalg.solve(self.points, back[:, :, None])[:, :, 0]
        return camera.moved(step[: len(LENS)], step[len(LENS) :].reshape(-1, 3), points)


def adjust_clip(start: TurningCamera, clip: LensClip) -> AdjustedClip:
    """The camera that reproduces the sightings best.

    Parameters
    ----------
    start
        Approximate lens, attitudes and scene; the first attitude is held.
    clip
        Sightings and priors.

    Returns
    -------
    adjusted
        The solution; its covariance includes what the lever, the distances of the scene and the read-out leave open.

    Raises
    ------
    CameraError
        The sightings do not determine the turns.

    Notes
    -----
    Levenberg-Marquardt with the points eliminated (Schur complement) and Huber's weights. The noise is that of the
    residuals: their median absolute value, each over the share that its point leaves it. The deviations of the points'
    distances are integrated out (`vfm_sdm.stages.lens.nearness`): the lever in every step, the lens by one step at the
    end, along the profile of each of its values.
    """
    now, noise = start, 1.0
    for _ in range(_NOISE_ROUNDS):
        now = _converge(now, clip, noise)
        if now.shared[3] < 0:
            # Lever and nearness tell their product: with both signs turned round the scene lies before the camera.
            now = _converge(now.mirrored(), clip, noise)
        found = _estimate_noise(now, clip, noise)
        known, noise = abs(found / noise - 1) < _NOISE_KNOWN, found
        if known:
            break
    residuals = now.residuals(clip.seen)
    weights = _weigh(residuals, noise)
    normal = _eliminate(now, clip, weights / noise**2)
    free = np.flatnonzero(clip.prior[1] > 0)
    covariance = np.zeros((len(LENS), len(LENS)))
    covariance[np.ix_(free, free)] = _invert(normal.reduced)[np.ix_(free, free)]
    lens = now.lens - _bias(now, clip, weights / noise**2)
    return AdjustedClip(now, lens, covariance, residuals, weights, noise)


def _converge(start: TurningCamera, clip: LensClip, noise: float) -> TurningCamera:
    now, damping, cost = start, 1e-4, _cost(start, clip, noise)
    for _ in range(_MAX_ITERATIONS):
        weights = _weigh(now.residuals(clip.seen), noise) / noise**2
        normal = _eliminate(now, clip, weights, damping=damping, lever=lever_precision(now, clip, weights))
        trial = normal.moved(now, _solve(normal.reduced, normal.gradient), normal.point_gradient)
        trial_cost = _cost(trial, clip, noise)
        if trial_cost < cost:
            gain = (cost - trial_cost) / cost
            now, cost, damping = trial, trial_cost, damping / 4
            if gain < _CONVERGED:
                break
        else:
            damping *= 5
            if damping > _MAX_DAMPING:
                break
    return now


def _cost(now: TurningCamera, clip: LensClip, noise: float) -> float:
    """Twice the negative logarithm of the likelihood, but for a constant; infinite where a ray has no pixel [1]."""
    residuals = now.residuals(clip.seen)
    size = np.linalg.norm(residuals, axis=1) / noise
    if not np.isfinite(size).all():
        return np.inf
    loss = np.where(size < _ROBUST, size**2, _ROBUST * (2 * size - _ROBUST)).sum()
    mean, std = clip.prior
    free = std > 0
    apart = ((now.lens - mean)[free] / std[free]) ** 2
    volume = log_volume(now, clip, _weigh(residuals, noise) / noise**2)
    return float(loss + apart.sum() + ((now.nearness / clip.nearness_std) ** 2).sum() + 2 * volume)


def _weigh(residuals: FloatArray, noise: float) -> FloatArray:
    size = np.linalg.norm(residuals, axis=1) / noise
    return np.asarray(np.minimum(1.0, _ROBUST / np.maximum(size, 1e-12)))


def _estimate_noise(now: TurningCamera, clip: LensClip, noise: float) -> float:
    """Standard deviation of a sighting along one axis [px]."""
    residuals, seen = now.residuals(clip.seen), clip.seen
    sightings = np.bincount(seen.point)
    taken = 2 + taken_by_nearness(now, clip, _weigh(residuals, noise) / noise**2)
    left = 1 - taken / (2 * sightings)
    shared = len(LENS) + 3 * (seen.frames - 1)
    left *= max(1 - shared / float((2 * sightings * left).sum()), 0.0)
    tells = left[seen.point] > _TOLD
    if not tells.any():
        return noise
    scaled = residuals[tells] / np.sqrt(left[seen.point][tells])[:, None]
    return max(float(np.median(np.abs(scaled))) / _MEDIAN_ABSOLUTE, _LEAST_NOISE_PX)


def _eliminate(
    now: TurningCamera, clip: LensClip, weights: FloatArray, *, damping: float = 0.0, lever: FloatArray | None = None
) -> _Normal:
    """Normal equations; ``weights`` (N,) [1/px2], ``lever`` the precision (3, 3) of a zero lever [1/m2]."""
    seen, count = clip.seen, len(LENS)
    residuals = now.residuals(seen)
    by_lens, by_turn, by_point = now.derivatives(seen)
    size = count + 3 * seen.frames
    jacobian = np.zeros((len(seen), 2, size))
    jacobian[:, :, :count] = by_lens
    columns = count + 3 * seen.frame[:, None] + np.arange(3)
    np.put_along_axis(jacobian, np.broadcast_to(columns[:, None, :], by_turn.shape), by_turn, axis=2)
    heavy = jacobian * weights[:, None, None]
    full = heavy.reshape(-1, size).T @ jacobian.reshape(-1, size)
    gradient = heavy.reshape(-1, size).T @ residuals.ravel()
    sums = PointSums(seen.point)
    coupling = sums(heavy.swapaxes(1, 2) @ by_point)
    heavy_points = (by_point * weights[:, None, None]).swapaxes(1, 2)
    points = sums(heavy_points @ by_point)
    point_gradient = sums((heavy_points @ residuals[:, :, None])[:, :, 0])
    points[:, 2, 2] += 1 / clip.nearness_std**2
    point_gradient[:, 2] -= now.nearness / clip.nearness_std**2
    _add_priors(full, gradient, now, clip, lever)
    # Values that are held, and the first attitude, from which the scene's directions are counted.
    held = np.r_[np.flatnonzero(clip.prior[1] == 0), count : count + 3]
    full[held, :] = full[:, held] = 0.0
    full[held, held] = 1.0
    gradient[held] = 0.0
    coupling[:, held] = 0.0
    full[np.diag_indices(size)] *= 1 + damping
    points[:, range(3), range(3)] *= 1 + damping
    carried = coupling @ np.linalg.inv(points)
    reduced = full - np.tensordot(carried, coupling, axes=([0, 2], [0, 2]))
    gradient = gradient - np.einsum("pca,pa->c", carried, point_gradient)
    return _Normal(reduced, gradient, coupling, points, point_gradient)


def _add_priors(
    full: FloatArray, gradient: FloatArray, now: TurningCamera, clip: LensClip, lever: FloatArray | None
) -> None:
    mean, std = clip.prior
    free = np.flatnonzero(std > 0)
    full[free, free] += 1 / std[free] ** 2
    gradient[free] += (mean - now.lens)[free] / std[free] ** 2
    if lever is not None:
        full[_LEVER, _LEVER] += lever
        gradient[_LEVER] -= lever @ now.lever


def _bias(now: TurningCamera, clip: LensClip, weights: FloatArray) -> FloatArray:
    """What the lens, without the lever, gains by the deviations' freedom, shape (10,)."""
    normal = _eliminate(now, clip, weights, lever=lever_precision(now, clip, weights))
    covariance, count = _invert(normal.reduced), len(LENS)
    slope = np.zeros(count)
    still = np.zeros_like(normal.point_gradient)
    for index in np.setdiff1d(np.flatnonzero(clip.prior[1] > 0), np.r_[_LEVER]):
        turns = -_solve(normal.reduced[count:, count:], normal.reduced[count:, index])
        reach = _STEP * np.sqrt(covariance[index, index])
        step = reach * np.concatenate([np.eye(count)[index], turns])
        ends = [log_volume(normal.moved(now, sign * step, still), clip, weights) for sign in (1, -1)]
        slope[index] = (ends[0] - ends[1]) / (2 * reach)
    return np.asarray(covariance[:count, :count] @ slope)


def _factor(matrix: FloatArray) -> tuple[tuple[FloatArray, bool], FloatArray]:
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    try:
        return cho_factor(matrix * scale[:, None] * scale), scale
    except np.linalg.LinAlgError as error:
        raise CameraError(
            "pan clip: expected sightings that determine all turns, got a singular adjustment; pan, tilt and roll more"
        ) from error


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    factor, scale = _factor(matrix)
    return np.asarray(cho_solve(factor, right * scale) * scale)


def _invert(matrix: FloatArray) -> FloatArray:
    factor, scale = _factor(matrix)
    return np.asarray(cho_solve(factor, np.eye(len(matrix))) * scale[:, None] * scale)
