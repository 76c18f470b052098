"""Array types, and checks of arrays at the entry of functions."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from vfm_sdm.errors import DatasetError

__all__ = [
    "MAD_TO_STD",
    "BoolArray",
    "ComplexArray",
    "FloatArray",
    "IntArray",
    "LumaArray",
    "as_float_array",
    "clock_departure",
    "is_even_clock",
    "mean_of_known",
    "time_blocks",
    "unbroken_runs",
]

FloatArray = npt.NDArray[np.float64]
"""Double precision, any shape: everything geometric."""
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.integer]
BoolArray = npt.NDArray[np.bool_]
LumaArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""One image plane of brightness, shape (height, width)."""
MAD_TO_STD = 1.4826
"""Standard deviation of normally distributed values over the median of their absolute deviations [1]."""


def as_float_array(value: npt.ArrayLike, name: str, shape: Sequence[int | None]) -> FloatArray:
    """The value as a double-precision array of the expected shape.

    Parameters
    ----------
    value
        Anything that NumPy turns into an array.
    name
        Name of the array in messages.
    shape
        Expected trailing shape; ``None`` stands for any length. A leading ``-1`` admits any number of leading axes.

    Returns
    -------
    array
        The value as float64, in the unit that it has; not a copy where none is needed.

    Raises
    ------
    DatasetError
        The value is not numeric or has another shape.

    Examples
    --------
    >>> as_float_array([[320, 240]], "points2d", (None, 2)).shape
    (1, 2)
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{name}: expected numbers, got {type(value).__name__}; pass a numeric array") from error
    open_front = len(shape) > 0 and shape[0] == -1
    trailing = tuple(shape[1:] if open_front else shape)
    found = array.shape[array.ndim - len(trailing) :] if array.ndim >= len(trailing) else None
    fits = (
        found is not None
        and (open_front or array.ndim == len(trailing))
        and all(want is None or want == got for want, got in zip(trailing, found, strict=True))
    )
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in trailing)
        raise DatasetError(
            f"{name}: expected shape ({'..., ' if open_front else ''}{wanted}), got {array.shape}; reshape it"
        )
    return array


def unbroken_runs(valid: BoolArray) -> list[slice]:
    """Runs of neighbouring true values, in order.

    Parameters
    ----------
    valid
        Which values are true, shape (T,); in a series, one value for each frame.

    Returns
    -------
    runs
        Slices from the first value of a run to the one after its last.

    Examples
    --------
    >>> unbroken_runs(np.array([True, True, False, True]))
    [slice(0, 2, None), slice(3, 4, None)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    return [slice(int(first), int(stop)) for first, stop in zip(edges[::2], edges[1::2], strict=True)]


def time_blocks(frames: int, size: int = 8192) -> Iterator[slice]:
    """Slices of so many frames that cover a recording, so that what is computed on the way stays small.

    Parameters
    ----------
    frames
        Number of frames.
    size
        Frames of a slice at most.

    Examples
    --------
    >>> [(block.start, block.stop) for block in time_blocks(10, size=4)]
    [(0, 4), (4, 8), (8, 10)]
    """
    return (slice(first, min(first + size, frames)) for first in range(0, frames, size))


def mean_of_known(values: FloatArray, known: BoolArray | None = None, *, axis: int | tuple[int, ...] = 0) -> FloatArray:
    """Mean of the values that are known, without a warning where there is none.

    Parameters
    ----------
    values
        Values of any shape and unit.
    known
        Which values count, of a shape that broadcasts to that of the values; by default those that are finite.
    axis
        Axes over which the mean is taken; by default the first.

    Returns
    -------
    mean
        Mean without those axes, in the unit of the values; NaN where no value is known.

    Examples
    --------
    >>> mean_of_known(np.array([[1.0, np.nan], [3.0, np.nan]])).tolist()
    [2.0, nan]
    """
    counts = np.broadcast_to(np.isfinite(values) if known is None else known, values.shape)
    count = counts.sum(axis=axis)
    total = np.where(counts, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def clock_departure(time_s: FloatArray, interval_s: float) -> FloatArray:
    """Differences of time stamps from the even clock ``t0 + i * interval_s``, shape (T,) [intervals].

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    interval_s
        Interval between two ticks of the even clock [s].

    Examples
    --------
    >>> clock_departure(np.array([0.0, 0.1, 0.25]), 0.1).round(6).tolist()
    [0.0, 0.0, 0.5]
    """
    return (time_s - time_s[:1]) / interval_s - np.arange(len(time_s))


def is_even_clock(time_s: FloatArray, interval_s: float, *, tolerance: float) -> bool:
    """Whether all time stamps are as near to the even clock of `clock_departure` as a tolerance.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    interval_s
        Interval between two ticks of the even clock [s].
    tolerance
        Largest difference [intervals].

    Examples
    --------
    >>> is_even_clock(np.array([0.0, 0.1001, 0.2]), 0.1, tolerance=0.01)
    True
    """
    return bool(np.all(np.abs(clock_departure(time_s, interval_s)) <= tolerance))
