"""The surroundings of a point in several frames: noise, and the motion of parts of them."""

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, LumaArray

__all__ = [
    "REACH_PX",
    "SLOW_PX",
    "SOFT_PX",
    "Image",
    "Window",
    "kept_noise",
    "local_mean",
    "noise_of_gradients",
    "soften",
]

Image = npt.NDArray[np.float32]

SOFT_PX = 0.6
"""Standard deviation of the Gaussian that takes the frequencies which no interpolation renders out of an image [px]."""
SLOW_PX = 7.0
"""Standard deviation of the Gaussian that leaves what changes as slowly over an image as light does [px]."""
_LEVELS = 255
_BLOCK_PX = 9
"""Side of the blocks that are held to move as one."""
_ROUNDING = 1 / 12
"""Variance of rounding to whole grey levels."""
_CODED = 0.25
"""Least variance that a softened pixel is held to have [squared grey levels]: half a grey level. A codec that repeats
what it coded once shows less from frame to frame, and what it repeats is noise."""
_USABLE_PX = 0.3
"""Standard deviation of one frame's motion in a direction above which it is left as it is [px]."""
_WEAKEST = 0.01
"""Share of the information across an edge below which that along it is made by the edge's own roughness."""
_UNKNOWN_PX = 100.0
"""Standard deviation that is stated of a direction of which nothing is known [px]: more would drown the other in
rounding."""
_ITERATIONS = 8
_STEP_PX, _SMALL_STEP_PX = 1.5, 2e-3
_LOCAL_ITERATIONS = 3
REACH_PX = 4.0
"""A motion further than this from its start is none: a texture is registered over about twice the blur of its lens."""


def soften(image: Image, sigma_px: float) -> Image:
    """An image under a Gaussian of this standard deviation [px], shape (R, R)."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def local_mean(image: Image) -> Image:
    """Means over blocks around every pixel, shape (R, R)."""
    return np.asarray(cv2.boxFilter(image, -1, (_BLOCK_PX, _BLOCK_PX)), np.float32)


class Window:
    """A window around a point, in the reference frame and in K others.

    Parameters
    ----------
    frames
        The window [v, u] in every frame, that of the reference first, shape (K + 1, R, R).

    Attributes
    ----------
    soft
        The same, softened by `SOFT_PX`.
    gradient
        Gradients of the softened reference along u and v, shape (2, R, R) [grey levels a pixel].
    radius2
        Squared distances from the middle, shape (R, R) [px2].
    """

    def __init__(self, frames: LumaArray) -> None:
        # All constants are in grey levels of 8 bits; and products of finer ones exceed what float32 resolves.
        raw = frames.astype(np.float32) * np.float32(_LEVELS / np.iinfo(frames.dtype).max)
        # Brightness that all of a frame shares is nobody's motion.
        raw -= np.median(raw - raw[0], axis=(1, 2), keepdims=True)
        self.soft = np.stack([soften(frame, SOFT_PX) for frame in raw])
        self.count = len(frames) - 1
        half = np.array([[-0.5, 0.0, 0.5]], np.float32)
        self.gradient = np.stack([cv2.filter2D(self.soft[0], -1, half), cv2.filter2D(self.soft[0], -1, half.T)])
        steps = np.arange(frames.shape[1], dtype=np.float32) - frames.shape[1] // 2
        self.radius2 = steps[:, None] ** 2 + steps[None, :] ** 2

    def moved(self, frame: int, motion: FloatArray, *, images: Image | None = None) -> Image:
        """A frame, 0 to K - 1, sampled where the reference's pixels are after a motion (u, v) [px], shape (R, R)."""
        image = (self.soft if images is None else images)[frame + 1]
        shift = np.array([[1, 0, motion[0]], [0, 1, motion[1]]], np.float64)
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        sampled = cv2.warpAffine(image, shift, image.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(sampled, np.float32)

    def local_motion(self, motion: FloatArray) -> tuple[Image, Image]:
        """What blocks around every pixel do beyond a motion, and what no translation of theirs explains.

        Parameters
        ----------
        motion
            Motion in each frame, shape (K, 2) [px].

        Returns
        -------
        further
            Motion of the blocks beyond it, shape (K, 2, R, R) [px]; towards zero where there is no
            texture.
        noise
            Variance of a softened pixel in one frame: of what is left in a block, mean over frames, shape (R, R)
            [squared grey levels].
        """
        gu, gv = self.gradient
        uu, uv, vv = local_mean(gu * gu), local_mean(gu * gv), local_mean(gv * gv)
        little = np.float32(noise_of_gradients() * _ROUNDING)
        # Of (uu + little) (vv + little) - uv uv, at an edge of many grey levels rounding leaves nothing.
        determinant = np.maximum(uu * vv - uv * uv, 0) + little * (uu + vv + little)
        further = np.zeros((self.count, 2, *gu.shape), np.float32)
        rows, columns = np.indices(gu.shape, np.float32)
        left = np.zeros_like(gu)
        for frame in range(self.count):
            best: Image | None = None
            trial = further[frame].copy()
            for iteration in range(_LOCAL_ITERATIONS):
                at = columns + trial[0] + np.float32(motion[frame, 0]), rows + trial[1] + np.float32(motion[frame, 1])
                sampled = cv2.remap(self.soft[frame + 1], *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
                error = sampled - self.soft[0]
                misfit = local_mean(error * error)
                better = np.ones(gu.shape, np.bool_) if best is None else misfit < best
                best = misfit if best is None else np.minimum(misfit, best)
                further[frame] = np.where(better, trial, further[frame])
                if iteration == _LOCAL_ITERATIONS - 1:
                    break
                bu, bv = local_mean(gu * error), local_mean(gv * error)
                trial = (
                    further[frame]
                    - np.stack([(vv + little) * bu - uv * bv, (uu + little) * bv - uv * bu]) / determinant
                )
                trial = np.clip(trial, -REACH_PX, REACH_PX).astype(np.float32)
            if best is not None:
                left += best
        noise = np.maximum(left / (2 * self.count), _CODED).astype(np.float32)
        return further, noise

    def register(self, weights: Image, noise: Image, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Translation of a part of the window in every frame, by weighted least squares.

        Parameters
        ----------
        weights
            Weights of the pixels, 0 to 1, shape (R, R).
        noise
            Variance of a softened pixel, shape (R, R) [squared grey levels].
        start
            Motion to start from, shape (K, 2) [px]; kept in directions about which the part says nothing.

        Returns
        -------
        motion
            Shape (K, 2) [px].
        covariance
            Of one frame's motion, shape (2, 2) [px2]; what the noise adds to the gradients is taken out.
        """
        rows, columns = np.nonzero(weights > 1e-3)
        if len(rows) == 0:
            return start.copy(), 1e6 * np.eye(2)
        part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        weight = (weights[part] / noise[part]).astype(np.float64).ravel()
        reference = self.soft[0][part].astype(np.float64).ravel()
        gradient = self.gradient[(slice(None), *part)].reshape(2, -1).astype(np.float64)
        total = weight.sum()
        template = reference - weight @ reference / total
        free = gradient - (gradient @ weight / total)[:, None]
        # A change of contrast is no motion.
        free -= ((free * template) @ weight / (weight @ template**2 + 1e-12))[:, None] * template
        normal = (free * weight) @ free.T
        values, axes = np.linalg.eigh(normal)
        # Noise has gradients, too: they are as many as the noise, and tell nothing.
        true = values - noise_of_gradients() * float(weights[part].sum())
        variance = 2 / kept_noise() * np.maximum(values, 1e-12) / np.maximum(true, 1e-6) ** 2
        variance = np.where(true > 0, np.minimum(variance, _UNKNOWN_PX**2), _UNKNOWN_PX**2)
        usable = (variance < _USABLE_PX**2) & (true > _WEAKEST * true[-1])
        solve = (axes * np.where(usable, 1 / np.maximum(values, 1e-12), 0.0)) @ axes.T @ (free * weight)
        motion = start.copy()
        corner = np.array([columns.min(), rows.min()])
        size = (part[1].stop - part[1].start, part[0].stop - part[0].start)
        for frame in range(self.count):
            found = self._follow(frame, (solve, weight / total, reference), corner, size, start[frame])
            if np.hypot(*(found - start[frame])) <= REACH_PX:
                motion[frame] = found
        return motion, (axes * variance) @ axes.T

    def _follow(
        self,
        frame: int,
        problem: tuple[FloatArray, FloatArray, FloatArray],
        corner: npt.NDArray[np.int64],
        size: tuple[int, int],
        start: FloatArray,
    ) -> FloatArray:
        """Gauss-Newton steps of a part of the window in one frame, shape (2,) [px]."""
        (solve, weight, reference), motion = problem, start.copy()
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        for _ in range(_ITERATIONS):
            shift = np.column_stack([np.eye(2), motion + corner])
            sampled = cv2.warpAffine(self.soft[frame + 1], shift, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            error = sampled.ravel() - reference
            step = -solve @ (error - weight @ error)
            length = float(np.hypot(*step))
            motion = motion + step * min(1.0, _STEP_PX / max(length, 1e-9))
            if length < _SMALL_STEP_PX or np.hypot(*(motion - start)) > REACH_PX:
                break
        return motion


def kept_noise() -> float:
    """Share of white noise's variance that softening keeps [1]; slow noise it keeps whole."""
    return float((_softened_impulse() ** 2).sum())


def noise_of_gradients() -> float:
    """Squared gradient along an axis that softened white noise has, of unit variance after softening [1]."""
    impulse = _softened_impulse()
    gradient = (impulse[:, 2:] - impulse[:, :-2]) / 2
    return float((gradient**2).sum() / (impulse**2).sum())


def _softened_impulse() -> Image:
    impulse = np.zeros((15, 15), np.float32)
    impulse[7, 7] = 1
    return soften(impulse, SOFT_PX)
