"""Frames of a pan clip that are worth looking at: far enough apart, and where the camera turns slowly."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.inputs.video import Frame
from vfm_sdm.stages.matching.detection import ImageFeatures, detect_features, to_eight_bit

__all__ = ["ClipMotion", "KeyFrames", "choose_key_frames", "follow_clip"]

_LOOK_SIDE_PX = 480
"""Longer side of the reduced pictures in which the motion is followed."""
_CORNERS, _CORNER_QUALITY, _CORNER_APART_PX = 200, 0.01, 10.0
_LEAST_CORNERS = 12
_STEP = 0.12
"""Motion between key frames, over the longer side of the picture: eight of them see a place that crosses it."""
_MOST = 48


@dataclass(frozen=True, eq=False)
class ClipMotion:
    """How the picture moves from frame to frame.

    Parameters
    ----------
    time_s
        Shape (F,) [s].
    rate
        Motion of the picture's centre [px/s] along u and v, and its rotation [rad/s], shape (F, 3); NaN where the picture
        could not be followed.
    """

    time_s: FloatArray
    rate: FloatArray


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
    Corners are followed by pyramidal Lucas-Kanade flow [1]_ in reduced pictures; their motion is a similarity, by random
    sample consensus.

    References
    ----------
    .. [1] Bouguet, J.-Y. (2000). Pyramidal implementation of the Lucas Kanade feature tracker. Intel Corporation.
    """
    times: list[float] = []
    moves: list[FloatArray] = []
    before: npt.NDArray[np.uint8] | None = None
    scale = 1.0
    for frame in frames:
        luma = to_eight_bit(frame.luma)
        scale = min(1.0, _LOOK_SIDE_PX / max(luma.shape))
        size = (round(luma.shape[1] * scale), round(luma.shape[0] * scale))
        now: npt.NDArray[np.uint8] = np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)
        if before is not None:
            moves.append(_motion(before, now))
        times.append(frame.time_s)
        before = now
    time_s = np.array(times)
    rate = np.full((len(times), 3), np.nan)
    if len(times) > 1:
        step = np.array(moves) / np.diff(time_s)[:, None]
        step[:, :2] /= scale
        # A frame's rate is the mean of the steps to it and from it; at the ends there is one.
        rate = np.stack([np.vstack([step[:1], step]), np.vstack([step, step[-1:]])]).mean(axis=0)
    return ClipMotion(time_s, rate)


def _motion(before: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8]) -> FloatArray:
    """Shift of the centre [px of these pictures] and rotation [rad], shape (3,); NaN where nothing can be followed."""
    lost = np.full(3, np.nan)
    corners = cv2.goodFeaturesToTrack(before, _CORNERS, _CORNER_QUALITY, _CORNER_APART_PX)
    if corners is None or len(corners) < _LEAST_CORNERS:
        return lost
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, corners, None)
    kept = np.asarray(found).ravel() == 1
    if kept.sum() < _LEAST_CORNERS:
        return lost
    similarity, _ = cv2.estimateAffinePartial2D(corners.reshape(-1, 2)[kept], moved.reshape(-1, 2)[kept])
    if similarity is None:
        return lost
    centre = (np.array(before.shape[::-1]) - 1) / 2
    shift = similarity[:, :2] @ centre + similarity[:, 2] - centre
    return np.array([*shift, np.arctan2(similarity[1, 0], similarity[0, 0])])


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
    >>> time_s = np.arange(300) / 30
    >>> steady = ClipMotion(time_s, np.tile([400.0, 0.0, 0.0], (300, 1)))
    >>> numbers = choose_key_frames(steady, (1920, 1080))
    >>> len(numbers), set(np.diff(numbers).tolist()) <= {16, 17, 18}
    (18, True)
    """
    longer = max(image_size)
    rate = motion.rate.copy()
    rate[:, 2] *= longer / 2
    speed = np.linalg.norm(rate, axis=1)
    known = np.isfinite(speed)
    if len(speed) < 2 or not known.any():
        return np.zeros(0, np.intp)
    steps = np.diff(motion.time_s, prepend=motion.time_s[0])
    path = np.cumsum(np.where(known, speed, 0.0) * steps)
    stretch = np.floor(path / max(_STEP * longer, path[-1] / _MOST)).astype(int)
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
