"""Frames that show the picture before them once more, as the noise of the pictures tells it."""

import math

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray, time_blocks

__all__ = ["compare_rows", "find_alike", "sample_rows"]

_PIXELS = 65_536
"""Pixels that are compared: shares of them are known to less than a percent."""
_LEAST_STEP = 8
_FEWEST = 12
_ABOUT = 7
"""Frames to each side that say what is usual: half a second."""
_BLOCK = 65536
"""Frames whose surroundings are in memory at a time."""
_USUAL = 0.8
"""Quantile of the changes about a frame that is usual: most of the frames of a converted rate may be repeated."""
_UNCHANGED = 0.5
"""Share of the pixels from which on frames do not change: where that is usual, an encoder passes still parts on."""
_CHANGE = 0.35
"""Share of the usual change (rms) below which a frame may repeat the one before: noise of an eighth of the power."""
_PIXELS_CHANGED = 0.5
"""Share of the pixels that usually change below which a frame may repeat the one before."""

_OWN = 0.75
"""Share of the pixels that usually change from which on a frame is clearly one of its own."""

_CHANCE = 25
"""One over the chance from which on an even distance is none: the odds that random gaps are multiples of a number."""


def sample_rows(luma: LumaArray) -> npt.NDArray[np.float32]:
    """Rows spread over a picture, by which frames are compared, shape (R, W) [grey levels].

    Parameters
    ----------
    luma
        The frame, shape (H, W).
    """
    step = max(_LEAST_STEP, -(-luma.size // _PIXELS))
    return luma[step // 2 :: step].astype(np.float32)


def compare_rows(before: npt.NDArray[np.float32], after: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Root mean square change [grey levels] and share of the pixels that change [1]; NaN for pictures of two sizes.

    Parameters
    ----------
    before, after
        Rows of two frames, see `sample_rows`, shape (R, W) [grey levels].
    """
    if before.shape != after.shape:
        return math.nan, math.nan
    change = (after - before).ravel()
    size = max(change.size, 1)
    return float(np.sqrt(change @ change / size)), np.count_nonzero(after != before) / size


def find_alike(rms: FloatArray, changed: FloatArray) -> IntArray:
    """Frames that hold the noise of the frame before, not their own.

    Parameters
    ----------
    rms
        Root mean square change into each frame but the first, shape (T - 1,) [grey levels].
    changed
        Share of the pixels that change, shape (T - 1,) [1].

    Returns
    -------
    frames
        Their numbers, from 0, of T.

    Notes
    -----
    Noise is new in each frame, so that two frames differ by it even where nothing moves; a frame that is stored twice
    differs by what the codec made of it. Two things must come together: the change is a third of the usual one about
    the frame, and half as many pixels as usual change. Where most
    pixels usually stay as they are, as in films of low bit rate, whose encoders pass still blocks on, or without noise,
    nothing can be told; nor where as many frames lie between, because some kinds of frames are passed on in large part;
    nor from frames an even distance apart, which may be of a kind that an encoder passes on (motion tells those that a
    conversion of the rate put in, `vfm_sdm.stages.tracking.frame_clock`).

    Examples
    --------
    >>> rms, changed = np.full(60, 3.0), np.full(60, 0.9)
    >>> rms[20], changed[20] = 0.4, 0.2
    >>> find_alike(rms, changed).tolist()
    [21]
    """
    none = np.zeros(0, np.int64)
    if len(rms) < _FEWEST:
        return none
    level = np.log(np.maximum(rms, 1e-3))
    usual_level, usual_changed = (_usual(series) for series in (level, changed))
    sees_noise = usual_changed > 1 - _UNCHANGED
    share = np.divide(changed, usual_changed, out=np.ones_like(changed), where=sees_noise)
    found = (share < _PIXELS_CHANGED) & (level < usual_level + np.log(_CHANGE))
    # Between a repeat and a frame of its own lies nothing, but where an encoder passes on more or less of the pictures.
    if np.count_nonzero((share < _OWN) & ~found) >= np.count_nonzero(found):
        return none
    frames = np.flatnonzero(found) + 1
    even = int(np.gcd.reduce(np.diff(frames))) if len(frames) > 1 else 1
    return none if even ** (len(frames) - 1) > _CHANCE else frames


def _usual(series: FloatArray) -> FloatArray:
    """What is usual about each value of a series (T,)."""
    padded = np.pad(series, _ABOUT, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _ABOUT + 1)
    usual = np.empty(len(series))
    for block in time_blocks(len(series), size=_BLOCK):
        known = np.isfinite(windows[block]).all(axis=1)
        # Row by row, as NumPy looks past NaN, takes sixty times as long.
        usual[block][known] = np.quantile(windows[block][known], _USUAL, axis=1)
        usual[block][~known] = np.nanquantile(windows[block][~known], _USUAL, axis=1)
    return usual
