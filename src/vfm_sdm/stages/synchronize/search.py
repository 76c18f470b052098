"""Dependence of two signals at every lag of a wide search, by Fourier transforms."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import fft

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.stages.synchronize.signals import Signal

__all__ = ["Group", "average_groups", "compute_dependence", "group_samples", "log_explained"]

ComplexArray = npt.NDArray[np.complex128]
Group = tuple[tuple[int, ...], tuple[int, ...]]
"""Channels of the first signal that together explain these channels of the second."""


def group_samples(signal: Signal, channels: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Samples of a group of channels, and where all of them are valid.

    Parameters
    ----------
    signal
        Motion in a band, T samples.
    channels
        Numbers of the C channels of the group.

    Returns
    -------
    values
        Shape (T, C), in the unit of the signal; zero where not valid.
    valid
        Shape (T,) [1]: 1 where all the group's channels are valid, else 0.

    Examples
    --------
    >>> valid = np.array([[True, True], [True, False]])
    >>> signal = Signal(0.0, 30.0, np.array([[1.0, 2.0], [3.0, 0.0]]), valid)
    >>> values, together = group_samples(signal, [0, 1])
    >>> values.tolist(), together.tolist()
    ([[1.0, 2.0], [0.0, 0.0]], [1.0, 0.0])
    """
    picked = list(channels)
    together = signal.valid[:, picked].all(axis=1).astype(float)
    return signal.values[:, picked] * together[:, None], together


def log_explained(
    own_a: FloatArray, own_b: FloatArray, cross: FloatArray, *, positive_gain: bool = False
) -> FloatArray:
    """Minus the log of the share of b's generalised variance that a does not explain.

    Parameters
    ----------
    own_a, own_b, cross
        Sums of products of a and a, b and b, a and b, in any units, shapes (..., p, p), (..., q, q) and (..., p, q).
    positive_gain
        Whether the channels of a group belong together one by one; where they are negatively related on the whole, they
        then explain nothing.

    Returns
    -------
    explained
        Minus the sum of log(1 - r^2) over the canonical correlations r, shape (...) [1].

    References
    ----------
    .. [1] Hotelling, H. (1936). Relations between two sets of variates. Biometrika 28(3/4), 321-377.

    Examples
    --------
    >>> own = np.array([[1.0]])
    >>> round(float(log_explained(own, own, np.array([[0.8]]))), 4)
    1.0217
    """
    p, q = cross.shape[-2:]
    # The floor keeps motion along one line, or without noise, invertible.
    floor_a = 1e-9 * np.einsum("...ii", own_a)[..., None, None] * np.eye(p) + 1e-300 * np.eye(p)
    floor_b = 1e-9 * np.einsum("...ii", own_b)[..., None, None] * np.eye(q) + 1e-300 * np.eye(q)
    gain = np.linalg.solve(own_a + floor_a, cross)
    left = own_b + floor_b - np.swapaxes(cross, -1, -2) @ gain
    explained = np.linalg.slogdet(own_b + floor_b)[1] - np.linalg.slogdet(left)[1]
    if positive_gain:
        explained = np.where(np.einsum("...ii", cross) > 0, explained, 0.0)
    return np.asarray(explained)


def compute_dependence(
    first: Signal,
    second: Signal,
    groups: Sequence[Group],
    steps: IntArray,
    *,
    positive_gain: bool,
) -> tuple[FloatArray, FloatArray]:
    """Dependence of two signals of one rate at whole-sample shifts.

    Parameters
    ----------
    first, second
        Signals of one rate, Ta and Tb samples.
    groups
        Channels that are compared together.
    steps
        Shifts, shape (K,) [samples]: sample i of the first meets sample i + step of the second.
    positive_gain
        As in `log_explained`.

    Returns
    -------
    dependence
        `log_explained` of the samples that meet, of each of G groups, shape (G, K) [1]; 0 where none meet.
    samples
        Number of samples that meet, shape (G, K) [1].

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=(400, 1))
    >>> valid = np.ones((390, 1), dtype=bool)
    >>> first, second = Signal(0.0, 30.0, noise[10:], valid), Signal(0.0, 30.0, noise[:-10], valid)
    >>> steps = np.arange(-20, 21)
    >>> dependence, _ = compute_dependence(first, second, [((0,), (0,))], steps, positive_gain=False)
    >>> int(steps[dependence[0].argmax()])
    10
    """
    length = fft.next_fast_len(len(first.values) + len(second.values), real=True)
    dependence, samples = np.zeros((len(groups), steps.size)), np.zeros((len(groups), steps.size))

    def sum_products(spectrum_a: ComplexArray, spectrum_b: ComplexArray) -> FloatArray:
        """Sums over i of a[i] b[i + step], shape (K, ...), from spectra, shape (F, ...)."""
        return np.asarray(fft.irfft(np.conj(spectrum_a) * spectrum_b, length, axis=0)[steps])

    for number, (channels_a, channels_b) in enumerate(groups):
        a, valid_a = group_samples(first, channels_a)
        b, valid_b = group_samples(second, channels_b)
        spectrum_a, spectrum_b = fft.rfft(a, length, axis=0), fft.rfft(b, length, axis=0)
        there_a, there_b = fft.rfft(valid_a, length)[:, None, None], fft.rfft(valid_b, length)[:, None, None]
        count = sum_products(there_a, there_b)[:, 0, 0]
        explained = log_explained(
            sum_products(fft.rfft(a[:, :, None] * a[:, None, :], length, axis=0), there_b),
            sum_products(there_a, fft.rfft(b[:, :, None] * b[:, None, :], length, axis=0)),
            sum_products(spectrum_a[:, :, None], spectrum_b[:, None, :]),
            positive_gain=positive_gain,
        )
        samples[number] = np.rint(np.maximum(count, 0.0))
        dependence[number] = np.where(samples[number] >= 1, explained, 0.0)
    return dependence, samples


def average_groups(dependence: FloatArray, samples: FloatArray, fewest: float) -> tuple[FloatArray, FloatArray]:
    """Dependence of groups together: each counts by its samples, and not at all where it has too few.

    Parameters
    ----------
    dependence, samples
        Of `compute_dependence`, shapes (G, K) [1].
    fewest
        Samples below which a group does not count.

    Returns
    -------
    dependence, samples
        Means over the groups, weighted by their samples, shape (K,) [1]: groups that are lost lower neither.

    Examples
    --------
    >>> average_groups(np.array([[1.0], [9.0]]), np.array([[100.0], [3.0]]), 10.0)
    (array([1.]), array([100.]))
    """
    weight = np.where(samples >= fewest, samples, 0.0)
    total = np.maximum(weight.sum(axis=0), 1.0)
    return np.asarray((weight * dependence).sum(axis=0) / total), np.asarray((weight * samples).sum(axis=0) / total)
