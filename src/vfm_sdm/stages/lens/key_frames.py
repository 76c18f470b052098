"""Frames of a pan clip that are worth looking at: far enough apart, and where the camera turns slowly."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.video import Frame
from vfm_sdm.stages.matching.detection import ImageFeatures, detect_features, to_eight_bit

__all__ = ["ClipMotion", "KeyFrames", "choose_key_frames", "follow_clip"]

_LOOK_SIDE_PX = 480
"""Longer side of the reduced pictures in which the motion is followed."""
_CORNERS, _CORNER_QUALITY, _CORNER_APART_PX = 200, 0.01, 10.0
_LEAST_CORNERS = 12
_BACK_PX = 1.0
"""Distance within which a corner that is followed on and back comes home: lost ones end anywhere."""
_STEP = 0.12
"""Motion between key frames, over the longer side of the picture: eight of them see a place that crosses it."""
_MOST = 48
_RATE_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class ClipMotion:
    """How the picture moves from frame to frame.

    Parameters
    ----------
    time_s
        Shape (F,) [s].
    steps
        Corners in each frame but the last and where they are in the next, F - 1 arrays of shape (2, N, 2) [px]; empty
        where nothing can be followed.
    """

    time_s: FloatArray
    steps: tuple[FloatArray, ...]

    @property
    def speed(self) -> FloatArray:
        """Motion of the corners of each frame, shape (F,) [px/s]; NaN where the picture could not be followed."""
        moved = np.array(
            [np.median(np.linalg.norm(two[1] - two[0], axis=1)) if two.size else np.nan for two in self.steps]
        )
        step = moved / np.diff(self.time_s)
        # A frame's speed is the mean of the steps to it and from it; at the ends there is one.
        return np.asarray(np.stack([np.append(step[:1], step), np.append(step, step[-1:])]).mean(axis=0))

    def turn_rates(
        self, numbers: IntArray, camera: Camera, *, readout_s: float, shift: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rates of rotation in the camera's axes at the middle rows of frames, and their change.

        Parameters
        ----------
        numbers
            Numbers of K frames, shape (K,).
        camera
            Approximate intrinsics.
        readout_s
            Approximate time from the first row to the last [s].
        shift
            Approximate lever over the distance of the scene, shape (3,) [1].

        Returns
        -------
        rate, change
            Shapes (K, 3) [rad/s] and [rad/s2].
        """
        rates, changes = np.zeros((len(numbers), 3)), np.zeros((len(numbers), 3))
        for row, number in enumerate(numbers.tolist()):
            about = [step for step in range(number - 2, number + 2) if self._followed(step)]
            if not about:
                continue
            found = [self._rate(step, camera, readout_s, shift) for step in about]
            ends = np.array([time for time, _ in found])[:, None] - self.time_s[number]
            half = np.diff(self.time_s)[about][:, None] / 2
            ends = ends + np.concatenate([-half, half], axis=1)
            # A step tells the mean of the rate between its ends; the polynomial with these means tells it at the frame.
            power = np.arange(1, len(about) + 1)
            means = np.diff(ends[:, :, None] ** power, axis=1)[:, 0] / (2 * half * power)
            values = np.linalg.solve(means, np.array([rate for _, rate in found]))
            rates[row] = values[0]
            changes[row] = values[1] if len(values) > 1 else 0.0
        return rates, changes

    def _followed(self, step: int) -> bool:
        return 0 <= step < len(self.steps) and bool(self.steps[step].size)

    def _rate(self, step: int, camera: Camera, readout_s: float, shift: FloatArray) -> tuple[float, FloatArray]:
        """Time [s] and rate of rotation (3,) [rad/s] from one frame to the next, by the corners that agree."""
        corners, height = self.steps[step], camera.image_size[1]
        slopes = camera.normalize(corners)
        rays = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=2)
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        known = np.isfinite(rays).all(axis=(0, 2))
        first, second = rays[:, known]
        # A row below the middle is seen later than the frame's own time.
        times = self.time_s[step : step + 2, None] + readout_s * ((corners[:, known, 1] + 0.5) / height - 0.5)
        between = times[1] - times[0]
        rate, weights = np.zeros(3), np.ones(len(first))
        for _ in range(_RATE_ROUNDS):
            turned = Rotation.from_rotvec(between[:, None] * rate).apply(first + shift) - shift
            turned /= np.linalg.norm(turned, axis=1, keepdims=True)
            error = second - turned
            size = np.linalg.norm(error, axis=1)
            if rate.any():
                weights = 1 / np.maximum(size, max(float(np.median(size)), 1e-9))
            across = np.eye(3) - turned[:, :, None] * turned[:, None, :]
            told = np.einsum("n,nij->ij", weights * between**2, across)
            rate = rate + np.linalg.solve(told, (weights * between) @ np.cross(turned, error))
        return float(np.average(times.mean(axis=0), weights=weights)), rate


@dataclass(frozen=True, eq=False)
class KeyFrames:
    """Features of the chosen frames.

    Parameters
    ----------
    numbers
        Numbers of the frames, shape (K,).
    features
        Of each.
    """

    numbers: IntArray
    features: tuple[ImageFeatures, ...]


def follow_clip(frames: Iterable[Frame]) -> ClipMotion:
    """Motion of the picture in a clip.

    Parameters
    ----------
    frames
        Frames in order.

    Notes
    -----
    Corners are followed by pyramidal Lucas-Kanade flow [1]_ in reduced pictures.

    References
    ----------
    .. [1] Bouguet, J.-Y. (2000). Pyramidal implementation of the Lucas Kanade feature tracker. Intel Corporation.
    """
    times: list[float] = []
    steps: list[FloatArray] = []
    before: npt.NDArray[np.uint8] | None = None
    for frame in frames:
        luma = to_eight_bit(frame.luma)
        scale = min(1.0, _LOOK_SIDE_PX / max(luma.shape))
        size = (round(luma.shape[1] * scale), round(luma.shape[0] * scale))
        now: npt.NDArray[np.uint8] = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
        if before is not None:
            # Pixels are counted from their centres: (u + 1/2) keeps its ratio, not u.
            steps.append((_follow(before, now) + 0.5) * (np.array(luma.shape[::-1]) / size) - 0.5)
        times.append(frame.time_s)
        before = now
    return ClipMotion(np.array(times), tuple(steps))


def _follow(before: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8]) -> FloatArray:
    """Corners in both pictures, shape (2, N, 2) [px of these pictures]; none where too few can be followed."""
    none = np.zeros((2, 0, 2))
    strongest = cv2.goodFeaturesToTrack(before, _CORNERS, _CORNER_QUALITY, _CORNER_APART_PX)
    if strongest is None or len(strongest) < _LEAST_CORNERS:
        return none
    corners = np.asarray(strongest, np.float32)
    found = none
    # Far motion is not followed from where it began; a picture that rolls has no shift as a whole.
    for shift in (_shift(before, now), np.zeros(2, np.float32)):
        moved, there = _flow(before, now, corners, shift)
        home, back = _flow(now, before, moved, -shift)
        kept = there & back & (np.linalg.norm((home - corners)[:, 0], axis=1) < _BACK_PX)
        if kept.sum() > max(found.shape[1], _LEAST_CORNERS - 1):
            found = np.stack([corners[kept, 0], moved[kept, 0]]).astype(np.float64)
    return found


def _shift(before: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Shift of the picture as a whole, shape (2,) [px]."""
    height, width = before.shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    found, _ = cv2.phaseCorrelate(before.astype(np.float32), now.astype(np.float32), window)
    return np.array(found, np.float32)


def _flow(
    before: npt.NDArray[np.uint8],
    now: npt.NDArray[np.uint8],
    corners: npt.NDArray[np.float32],
    shift: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Where corners (N, 1, 2) are in the other picture, looked for about a shift, and which were followed (N,)."""
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, corners, corners + shift, flags=flags)
    return np.asarray(moved, np.float32), np.asarray(found).ravel() == 1


def choose_key_frames(motion: ClipMotion, image_size: tuple[int, int]) -> IntArray:
    """Numbers of the frames to look at.

    Parameters
    ----------
    motion
        Of the picture from frame to frame.
    image_size
        Width and height [px].

    Returns
    -------
    numbers
        Ascending; the slowest frame of each stretch over which the picture moves by an eighth of its longer side. Empty
        where it cannot be followed.

    Examples
    --------
    >>> corners = np.random.default_rng(0).uniform(0, 1000, (20, 2))
    >>> steady = ClipMotion(np.arange(300) / 30, tuple(np.stack([corners, corners + [13.0, 0.0]]) for _ in range(299)))
    >>> len(choose_key_frames(steady, (1920, 1080)))
    17
    """
    longer = max(image_size)
    speed = motion.speed
    known = np.isfinite(speed)
    if len(speed) < 2 or not known.any():
        return np.zeros(0, np.intp)
    steps = np.diff(motion.time_s, prepend=motion.time_s[0])
    path = np.cumsum(np.where(known, speed, 0.0) * steps)
    stretch = np.floor(path / max(_STEP * longer, path[-1] / _MOST)).astype(int)
    # The first and the last frame have a neighbour on one side, which tells no rate at the frame itself.
    known[[0, -1]] = False
    slowness = np.where(known, speed, np.inf)
    chosen = [rows[slowness[rows].argmin()] for rows in (np.flatnonzero(stretch == n) for n in np.unique(stretch))]
    return np.array([number for number in chosen if known[number]], np.intp)


def detect_in(frames: Iterable[Frame], numbers: IntArray) -> KeyFrames:
    """Features of the frames with these numbers.

    Parameters
    ----------
    frames
        Frames in order.
    numbers
        Ascending.
    """
    wanted, features = set(numbers.tolist()), []
    for frame in frames:
        if frame.index in wanted:
            features.append(detect_features(frame.luma))
        if frame.index >= numbers.max(initial=-1):
            break
    return KeyFrames(numbers[: len(features)], tuple(features))
