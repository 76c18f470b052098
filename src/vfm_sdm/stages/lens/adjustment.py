"""Least-squares adjustment of a turning camera to its clip, and the covariance of the lens."""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, FloatArray
from vfm_sdm.stages.lens.nearness import PointsVolume, taken_by_points, volume_of_points
from vfm_sdm.stages.lens.normal_equations import NormalEquations, invert_scaled, solve_scaled
from vfm_sdm.stages.lens.turning_camera import LENS, LEVER, LensClip, TurningCamera

__all__ = ["AdjustedClip", "adjust_clip"]

_MAX_ITERATIONS, _ROUNDS = 60, 8
_CONVERGED, _NOISE_KNOWN, _SETTLED = 1e-7, 0.02, 0.1
"""Relative gain that ends a round (one of 1e-9 moves the focal length by less than .003 of its standard
deviation); changes of the noise, and of the focal length over its standard deviation, that end
all."""
_MAX_DAMPING = 1e10
_ROBUST = 2.5
"""Residual over its standard deviation from which a sighting loses weight [1]."""
_LEAST_NOISE_PX = 1e-6
_TOLD = 0.2
"""Share of its residuals that a point must keep to tell of the noise."""
_STEP = 0.5
"""Step of the derivative of the points' volume, in standard deviations."""


@dataclass(frozen=True, eq=False)
class AdjustedClip:
    """Result of `adjust_clip`.

    Parameters
    ----------
    camera
        Lens, lever, attitudes and scene at the solution.
    clip
        What was adjusted.
    covariance
        Of `LENS`, shape (10, 10), in its units.
    residuals
        Seen minus predicted pixels, shape (N, 2) [px].
    weights
        Weight of each sighting, shape (N,): 1 where it agrees.
    noise_px
        Standard deviation of a sighting along one axis [px].
    """

    camera: TurningCamera
    clip: LensClip
    covariance: FloatArray
    residuals: FloatArray
    weights: FloatArray
    noise_px: float

    @property
    def lens(self) -> FloatArray:
        """Values of `LENS`, shape (10,)."""
        return self.camera.lens


def adjust_clip(start: TurningCamera, clip: LensClip, *, again: bool = True) -> AdjustedClip:
    """The camera that reproduces the sightings best.

    Parameters
    ----------
    start
        Approximate lens, attitudes and scene; the first attitude is held.
    clip
        Sightings and priors.
    again
        Whether it is begun again from other places, see the notes.

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
    distances are integrated out (`vfm_sdm.stages.lens.nearness`): their volume is part of what is minimised. A round
    takes it as a straight line in all values but the lever, along the profile of each, and the next one takes it anew.
    A scene near the camera has several minima, such as one with the lever on the other side: the adjustment is begun
    again from where it ended and from there, and the best end counts.
    """
    best = _settle(start, clip)
    for side in (1, -1) if again else ():
        shared = best.camera.shared * [side, side, side, 1, 1]
        other = _settle(replace(best.camera, shared=shared, nearness=side * best.camera.nearness), clip)
        if _cost_at(other, best.noise_px) < _cost_at(best, best.noise_px):
            best = other
    return best


def _cost_at(end: AdjustedClip, noise: float) -> float:
    """Cost of an end at this noise."""
    clip = replace(end.clip, growth_std=noise / end.camera.camera.focal_px)
    weights = _weigh(end.residuals, noise) / noise**2
    return _cost(end.camera, clip, noise, volume_of_points(end.camera, clip, weights))


def _settle(start: TurningCamera, clip: LensClip) -> AdjustedClip:
    """The minimum that a start leads to."""
    now, noise = start, 1.0
    for _ in range(_ROUNDS):
        # What stretching does to a detector is as much as what noise does.
        clip = replace(clip, growth_std=noise / now.camera.focal_px)
        before, now = now, _converge(now, clip, noise)
        if now.shared[3] < 0:
            # Lever and nearness tell their product: with both signs turned round the scene lies before the camera.
            now = _converge(now.mirrored(), clip, noise)
        found = _estimate_noise(now, clip, noise)
        known, noise = abs(found / noise - 1) < _NOISE_KNOWN, found
        if known and abs(now.lens[0] - before.lens[0]) < _SETTLED * np.sqrt(_covariance(now, clip, noise)[0, 0]):
            break
    residuals = now.residuals(clip.seen)
    return AdjustedClip(now, clip, _covariance(now, clip, noise), residuals, _weigh(residuals, noise), noise)


def _covariance(now: TurningCamera, clip: LensClip, noise: float) -> FloatArray:
    """Of `LENS`, shape (10, 10)."""
    normal = NormalEquations(now, clip, _weigh(now.residuals(clip.seen), noise) / noise**2)
    free = np.flatnonzero(clip.prior[1] > 0)
    covariance = np.zeros((len(LENS), len(LENS)))
    covariance[np.ix_(free, free)] = invert_scaled(normal.reduced)[np.ix_(free, free)]
    return covariance


def _converge(start: TurningCamera, clip: LensClip, noise: float) -> TurningCamera:
    volume = _take_volume(start, clip, _weigh(start.residuals(clip.seen), noise) / noise**2)
    now, damping, cost = start, 1e-4, _cost(start, clip, noise, volume)
    for _ in range(_MAX_ITERATIONS):
        weights = _weigh(now.residuals(clip.seen), noise) / noise**2
        trial = NormalEquations(now, clip, weights, damping=damping, volume=volume).step()
        trial_cost = _cost(trial, clip, noise, volume)
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


def _cost(now: TurningCamera, clip: LensClip, noise: float, volume: PointsVolume) -> float:
    """Twice the negative logarithm of the likelihood, but for a constant; infinite where a ray has no pixel [1]."""
    residuals = now.residuals(clip.seen)
    size = np.linalg.norm(residuals, axis=1) / noise
    if not np.isfinite(size).all():
        return np.inf
    loss = np.where(size < _ROBUST, size**2, _ROBUST * (2 * size - _ROBUST)).sum()
    mean, std = clip.prior
    free = std > 0
    apart = ((now.lens - mean)[free] / std[free]) ** 2
    own = ((now.nearness / clip.nearness_std) ** 2).sum() + ((now.growth / clip.growth_std) ** 2).sum()
    return float(loss + apart.sum() + own + 2 * volume.log(now))


def _weigh(residuals: FloatArray, noise: float) -> FloatArray:
    size = np.linalg.norm(residuals, axis=1) / noise
    return np.asarray(np.minimum(1.0, _ROBUST / np.maximum(size, 1e-12)))


def _estimate_noise(now: TurningCamera, clip: LensClip, noise: float) -> float:
    """Standard deviation of a sighting along one axis [px]."""
    residuals, seen = now.residuals(clip.seen), clip.seen
    sightings = np.bincount(seen.point)
    taken = taken_by_points(now, clip, _weigh(residuals, noise) / noise**2)
    left = 1 - taken / (2 * sightings)
    shared = len(LENS) + 3 * (seen.frames - 1)
    left *= max(1 - shared / float((2 * sightings * left).sum()), 0.0)
    tells = left[seen.point] > _TOLD
    if not tells.any():
        return noise
    scaled = residuals[tells] / np.sqrt(left[seen.point][tells])[:, None]
    return max(MAD_TO_STD * float(np.median(np.abs(scaled))), _LEAST_NOISE_PX)


def _take_volume(now: TurningCamera, clip: LensClip, weights: FloatArray) -> PointsVolume:
    """The points' volume near a camera, with its slope along the profile of each value of the lens but the lever."""
    volume, count = volume_of_points(now, clip, weights), len(LENS)
    normal = NormalEquations(now, clip, weights, volume=volume)
    covariance = invert_scaled(normal.reduced)
    free = np.setdiff1d(np.flatnonzero(clip.prior[1] > 0), np.arange(count)[LEVER])
    turns = -solve_scaled(normal.reduced[count:, count:], normal.reduced[count:, free])
    slope = np.zeros(count)
    for index, turn in zip(free.tolist(), turns.T, strict=True):
        reach = _STEP * np.sqrt(covariance[index, index])
        step = reach * np.concatenate([np.eye(count)[index], turn])
        ends = [normal.along(sign * step) for sign in (1, -1)]
        logs = [volume_of_points(end, clip, weights).log(end) for end in ends]
        slope[index] = (logs[0] - logs[1]) / (2 * reach)
    return replace(volume, slope=slope)
