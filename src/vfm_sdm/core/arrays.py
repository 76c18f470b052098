"""Array types, and the checks that functions make at their door."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vfm_sdm.errors import DatasetError

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "LumaArray",
    "as_float_array",
    "clock_departure",
    "is_even_clock",
    "mean_of_known",
    "unbroken_runs",
]

FloatArray = npt.NDArray[np.float64]
"""Double precision, any shape: everything geometric."""
IntArray = npt.NDArray[np.integer]
BoolArray = npt.NDArray[np.bool_]
LumaArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""One image plane of brightness, shape (height, width)."""


def as_float_array(value: npt.ArrayLike, name: str, shape: Sequence[int | None]) -> FloatArray:
    """The value as a double-precision array of the expected shape.

    Parameters
    ----------
    value
        Anything that NumPy turns into an array.
    name
        What the caller calls it; appears in the message.
    shape
        Expected trailing shape; ``None`` stands for any length. A leading ``-1`` admits any number of leading axes.

    Raises
    ------
    DatasetError
        The value is not numeric or has another shape.
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
    """Runs of neighbouring true values of an array of shape (T,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    return [slice(int(first), int(stop)) for first, stop in zip(edges[::2], edges[1::2], strict=True)]


def mean_of_known(values: FloatArray, known: BoolArray | None = None, *, axis: int | tuple[int, ...] = 0) -> FloatArray:
    """Mean of the values that are known, without a warning where there is none.

    Parameters
    ----------
    values
        Any shape.
    known
        Which values count, of a shape that broadcasts to that of the values; by default those that are finite.
    axis
        Over which the mean is taken; by default the first.

    Returns
    -------
    mean
        Without the axes that it was taken over; NaN where no value is known.
    """
    counts = np.broadcast_to(np.isfinite(values) if known is None else known, values.shape)
    count = counts.sum(axis=axis)
    total = np.where(counts, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def clock_departure(time_s: FloatArray, interval_s: float) -> FloatArray:
    """How far time stamps are from the even clock ``t0 + i * interval_s``, in intervals, shape (T,).

    Parameters
    ----------
    time_s
        Stamps, shape (T,) [s].
    interval_s
        Between two ticks of the even clock [s].
    """
    return (time_s - time_s[:1]) / interval_s - np.arange(len(time_s))


def is_even_clock(time_s: FloatArray, interval_s: float, *, tolerance: float) -> bool:
    """Whether no time stamp is further from the even clock of `clock_departure` than the tolerance, in intervals."""
    return bool(np.all(np.abs(clock_departure(time_s, interval_s)) <= tolerance))
