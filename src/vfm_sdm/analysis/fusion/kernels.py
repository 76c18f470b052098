"""Kalman filter and smoother of displacement that measured acceleration drives; compiled.

The state is, in this order: displacement [mm], velocity [mm/s], bias of the sensor [mm/s2], slow error of the video
[mm], lag of the sensor [s], its drift [s/s], and for every axis of the sensor what its gain is off the one in use [1].
"""

import numpy as np
from numba import njit

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code

__all__ = ["BIAS", "DRIFT", "FIRST", "GAINS", "LAG", "SLOW", "filter_forward", "smooth_backward"]

BIAS, SLOW, LAG, DRIFT, GAINS = 2, 3, 4, 5, 6
"""Places in the state, of which the gains are the last."""
FIRST = 6
"""Place of the first axis of the sensor in a step."""

_compiled = njit(nogil=True, cache=True, error_model="numpy")


@_compiled
def _row(step: FloatArray, order: int) -> FloatArray:
    """How displacement (order 0) or velocity (order 1) follows from the state before a step, beside itself."""
    dt, inputs = step[0], (step.size - FIRST) // 2
    row = np.zeros(GAINS + inputs)
    if order == 0:
        row[1], row[BIAS], row[LAG] = dt, -dt * dt / 2, step[2]
        row[GAINS:] = step[FIRST : FIRST + inputs]
    else:
        row[BIAS], row[LAG] = -dt, step[3]
        row[GAINS:] = step[FIRST + inputs :]
    return row


@_compiled
def _predict(x: FloatArray, P: FloatArray, step: FloatArray, noise: FloatArray) -> None:
    """State and covariance after a step, in place."""
    dt = step[0]
    to_d, to_v = _row(step, 0), _row(step, 1)
    decay = np.exp(-dt * noise[3])
    x[0], x[1] = x[0] + to_d @ x + step[4], x[1] + to_v @ x + step[5]
    x[SLOW] *= decay
    x[LAG] += dt * x[DRIFT]
    # Rows, then columns: all read what was before the step, for displacement is done before what it is made of.
    P[0] += to_d @ P
    P[1] += to_v @ P
    P[SLOW] *= decay
    P[LAG] += dt * P[DRIFT]
    P[:, 0] += P @ to_d
    P[:, 1] += P @ to_v
    P[:, SLOW] *= decay
    P[:, LAG] += dt * P[:, DRIFT]
    q, wander = noise[0] + step[1], noise[1]
    P[0, 0] += q * dt**3 / 3 + wander * dt**5 / 20
    P[1, 1] += q * dt + wander * dt**3 / 3
    P[BIAS, BIAS] += wander * dt
    across = q * dt**2 / 2 + wander * dt**4 / 8
    P[0, 1] += across
    P[1, 0] += across
    P[0, BIAS] -= wander * dt**3 / 6
    P[BIAS, 0] -= wander * dt**3 / 6
    P[1, BIAS] -= wander * dt**2 / 2
    P[BIAS, 1] -= wander * dt**2 / 2
    P[SLOW, SLOW] += noise[2] * (1 - decay * decay)


@_compiled
def _step_back(adjoint: FloatArray, information: FloatArray, step: FloatArray, noise: FloatArray) -> None:
    """Adjoint and its information before a step, in place: with the transposed transition."""
    dt = step[0]
    to_d, to_v = _row(step, 0), _row(step, 1)
    decay = np.exp(-dt * noise[3])
    of_d, of_v = adjoint[0], adjoint[1]
    adjoint[SLOW] *= decay
    adjoint[DRIFT] += dt * adjoint[LAG]
    adjoint += to_d * of_d + to_v * of_v
    _turn_rows(information, to_d, to_v, decay, dt)
    for i in range(to_d.size):
        for j in range(i):
            information[i, j], information[j, i] = information[j, i], information[i, j]
    _turn_rows(information, to_d, to_v, decay, dt)


@_compiled
def _turn_rows(L: FloatArray, to_d: FloatArray, to_v: FloatArray, decay: float, dt: float) -> None:
    """The transposed transition times a matrix, in place."""
    of_d, of_v = L[0].copy(), L[1].copy()
    L[SLOW] *= decay
    L[DRIFT] += dt * L[LAG]
    for i in range(to_d.size):
        L[i] += to_d[i] * of_d + to_v[i] * of_v


@_compiled
def _seen(exposed: FloatArray) -> FloatArray:
    """What the state contributes to a value of the video."""
    h = np.zeros(GAINS + exposed.size - 1)
    h[0] = h[SLOW] = 1.0
    h[GAINS:] = exposed[1:]
    return h


@njit(nogil=True, cache=True, error_model="numpy")
@cached_by_code
def filter_forward(
    nodes: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    noise: FloatArray,
    x: FloatArray,
    P: FloatArray,
    states: FloatArray,
    covariances: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Log-likelihood of the video's values, and innovations with their standard deviations.

    Parameters
    ----------
    nodes
        Steps to each of N nodes, shape (N, 6 + 2 A) (see `vfm_sdm.analysis.fusion.drive.Drive.steps`); values of the
        video there [mm], NaN where there is none; their variances [mm2]; and what exposure adds: with
        the gains in use, then by axis for other gains, shape (N, 1 + A).
    noise
        Density of the sensor's noise [mm2/s3], of its bias' wandering [mm2/s5], variance of the video's slow error
        [mm2], and the inverse of its correlation time [1/s].
    x, P
        State and covariance before the first node; afterwards those at the last.
    states, covariances
        Filled with the filtered ones at the nodes with a value, shapes (M, n) and (M, n, n); of length zero to keep
        none.
    """
    steps, values, variances, exposed = nodes
    innovations, stds = np.full(len(values), np.nan), np.full(len(values), np.nan)
    total, place = 0.0, 0
    for k in range(len(values)):
        _predict(x, P, steps[k], noise)
        if np.isnan(values[k]):
            continue
        h = _seen(exposed[k])
        Ph = P @ h
        s = h @ Ph + variances[k]
        innovations[k], stds[k] = values[k] - exposed[k, 0] - h @ x, np.sqrt(s)
        x += Ph * (innovations[k] / s)
        for i in range(x.size):
            for j in range(x.size):
                P[i, j] -= Ph[i] * Ph[j] / s
        total -= 0.5 * (np.log(2 * np.pi * s) + innovations[k] ** 2 / s)
        if len(states):
            states[place], covariances[place] = x, P
            place += 1
    return total, innovations, stds


@njit(nogil=True, cache=True, error_model="numpy")
@cached_by_code
def smooth_backward(
    nodes: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    noise: FloatArray,
    states: FloatArray,
    covariances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Displacement [mm] and its variance [mm2] at every node from the first value of the video to the last.

    Parameters
    ----------
    nodes, noise
        As of `filter_forward`.
    states, covariances
        Those that it kept.

    Notes
    -----
    The modified Bryson-Frazier form of the Rauch-Tung-Striebel smoother, which inverts nothing: between two values of
    the video states are predicted once more from the one before, so that only those at values are kept.

    References
    ----------
    .. [1] Bierman, G. J. (1973). Fixed interval smoothing with discrete measurements. International Journal of Control
       18(1), 65-75.
    """
    steps, values, variances, exposed = nodes
    size = states.shape[1]
    mean, variance = np.full(len(values), np.nan), np.full(len(values), np.nan)
    seen = np.flatnonzero(~np.isnan(values))
    longest = 0
    for m in range(1, len(seen)):
        longest = max(longest, seen[m] - seen[m - 1])
    means, rows = np.zeros((longest + 1, size)), np.zeros((longest + 1, size))
    adjoint, information = np.zeros(size), np.zeros((size, size))
    last = seen[-1]
    mean[last], variance[last] = states[-1, 0], covariances[-1, 0, 0]
    for m in range(len(seen) - 1, 0, -1):
        begin, end = seen[m - 1], seen[m]
        x, P = states[m - 1].copy(), covariances[m - 1].copy()
        for k in range(begin + 1, end + 1):
            _predict(x, P, steps[k], noise)
            means[k - begin], rows[k - begin] = x, P[0]
        # The value at the end, as the state predicted there sees it.
        h = _seen(exposed[end])
        Ph = P @ h
        s = h @ Ph + variances[end]
        gain = Ph / s
        adjoint -= h * ((values[end] - exposed[end, 0] - h @ x) / s + gain @ adjoint)
        Lg = information @ gain
        weight = gain @ Lg + 1 / s
        for i in range(size):
            for j in range(size):
                information[i, j] += weight * h[i] * h[j] - h[i] * Lg[j] - Lg[i] * h[j]
        for k in range(end, begin, -1):
            if k < end:
                row = rows[k - begin]
                mean[k] = means[k - begin, 0] - row @ adjoint
                variance[k] = row[0] - row @ information @ row
            _step_back(adjoint, information, steps[k], noise)
        row = covariances[m - 1, 0]
        mean[begin] = states[m - 1, 0] - row @ adjoint
        variance[begin] = row[0] - row @ information @ row
    return mean, variance
