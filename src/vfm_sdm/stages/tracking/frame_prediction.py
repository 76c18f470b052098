"""Frames that are missing in a motion which goes on as if later: told by predicting it from what went before."""

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray

__all__ = ["find_gaps"]

_ORDER = 16
"""Frames before one from which it is predicted: eight modes at most, each of which takes two."""
_ROWS_AN_UNKNOWN = 4
_LONGEST = 12
"""Frames that may be missing in one place, less than half a second at usual rates."""
_AHEAD = 5
"""Frames after a gap that must go on as predicted."""
_OUTSTANDING = 12.0
"""Squared error of a prediction over the usual one from which on a frame does not follow: three and a half times."""
_GOES_ON = 0.1
"""Share of the squared error that may be left once frames are taken for missing: a third of the error."""
_LEFT = 12.0
"""Squared error over the usual one that may be left in a frame: predicted from afar, it is some times larger."""
_AS_USUAL = 0.1
"""Share of the motion's variance that usual errors of such predictions may have: what they cannot tell, they do not."""
_REFITS, _SPREAD_OUT = 3, 9.0
_BLOCK = 4096


def find_gaps(position: FloatArray, usable: npt.NDArray[np.bool_]) -> IntArray:
    """Frames before which others are missing, because the motion goes on as it was to be some frames later.

    Parameters
    ----------
    position
        Positions of all points in each frame, over their noise, shape (T, K) [1].
    usable
        Whether they are known, shape (T,).

    Returns
    -------
    frames
        Their numbers, from 0, of T.

    Notes
    -----
    A structure that vibrates in some modes is predicted from the frames before (linear prediction, one set of
    coefficients for all points [1]_). Where frames are missing, the next ones are not as predicted, but as predicted
    for later ones. After an impact they are as predicted for none.

    References
    ----------
    .. [1] Makhoul, J. (1975). Linear prediction: a tutorial review. Proceedings of the IEEE 63(4), 561-580.

    Examples
    --------
    >>> time_s = np.delete(np.arange(200) / 30, [90, 91])
    >>> position = 40 * np.sin(2 * np.pi * np.outer(time_s, [2.2, 3.7]))
    >>> position += np.random.default_rng(0).normal(0, 1, position.shape)
    >>> find_gaps(position, np.ones(198, bool)).tolist()
    [90]
    """
    order = min(_ORDER, len(position) // (2 * _ROWS_AN_UNKNOWN))
    if order < 2:
        return np.zeros(0, np.int64)
    y = position - position[usable].mean(axis=0) if usable.any() else position
    # Before a frame all of its past must be known.
    whole = np.lib.stride_tricks.sliding_window_view(usable, order + 1).all(axis=-1)
    rows = np.flatnonzero(whole) + order
    if len(rows) < _ROWS_AN_UNKNOWN * order:
        return np.zeros(0, np.int64)
    coefficients, error = _fit(y, rows, order)
    usual = float(np.median(error))
    energy = float((y[rows] ** 2).sum(axis=1).mean())
    if usual > _AS_USUAL * energy:
        return np.zeros(0, np.int64)
    found: list[int] = []
    for k in rows[error > _OUTSTANDING * usual].tolist():
        if found and k - found[-1] <= order:  # its past holds the gap
            continue
        if k + _AHEAD <= len(y) and usable[k : k + _AHEAD].all() and _goes_on(y, k, coefficients, usual):
            found.append(k)
    return np.array(found, np.int64)


def _fit(y: FloatArray, rows: IntArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Coefficients (p,) of the prediction of frames from the p before, the last first, and squared errors (R,)."""
    kept: BoolArray = np.ones(len(rows), np.bool_)
    for _ in range(_REFITS):
        normal, product = np.zeros((order, order)), np.zeros(order)
        for block in _blocks(len(rows)):
            inside = _past(y, rows[block][kept[block]], order).reshape(order, -1)
            normal += inside @ inside.T
            product += inside @ y[rows[block][kept[block]]].ravel()
        coefficients = np.linalg.lstsq(normal, product, rcond=1e-12)[0]
        predicted = (np.tensordot(coefficients, _past(y, rows[block], order), axes=1) for block in _blocks(len(rows)))
        error = ((y[rows] - np.concatenate(list(predicted))) ** 2).sum(axis=1)
        kept = error <= _SPREAD_OUT * np.median(error)
    return np.asarray(coefficients), np.asarray(error)


def _blocks(count: int) -> list[slice]:
    """Parts of so many rows: the past of all frames of an hour is a hundred times the frames."""
    return [slice(first, first + _BLOCK) for first in range(0, count, _BLOCK)]


def _past(y: FloatArray, rows: IntArray, order: int) -> FloatArray:
    """The frames before each of R frames, the last first, shape (p, R, K)."""
    return np.stack([y[rows - lag] for lag in range(1, order + 1)])


def _goes_on(y: FloatArray, k: int, coefficients: FloatArray, usual: float) -> bool:
    """Whether frames from one on are those predicted for some frames later, and not for themselves."""
    order = len(coefficients)
    track = [*y[k - order : k]]
    for _ in range(_LONGEST + _AHEAD):
        track.append(coefficients @ np.asarray(track[: -order - 1 : -1]))
    ahead = np.asarray(track[order:])
    left = [float(((y[k : k + _AHEAD] - ahead[n : n + _AHEAD]) ** 2).sum()) for n in range(_LONGEST + 1)]
    return min(left[1:]) < min(_GOES_ON * left[0], _LEFT * _AHEAD * usual)
