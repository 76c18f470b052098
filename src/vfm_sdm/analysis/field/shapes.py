"""Operational bending shapes of a field: how it moves together at the frequencies at which it moves most."""

import numpy as np
from scipy.signal import csd

from vfm_sdm.core.arrays import FloatArray

__all__ = ["SHAPES", "compute_mac", "find_shapes"]

SHAPES = 3
_SEGMENTS = 3
_PEAK_BINS = 2
_NEW_MAC = 0.8
"""Shapes that resemble one that is there already by more than this are the same one [1]."""


def find_shapes(field_mm: FloatArray, time_s: FloatArray, count: int = SHAPES) -> tuple[FloatArray, FloatArray]:
    """Shapes in which a field moves along each axis, by frequency, and their frequencies.

    Parameters
    ----------
    field_mm
        Displacement at stations, shape (T, S, A) [mm]; NaN where nothing is known.
    time_s
        Times, shape (T,) [s].
    count
        How many shapes.

    Returns
    -------
    shapes, frequency_hz
        Shapes of largest value 1, shape (count, S, A) [1], and shape (count, A) [Hz]; NaN where there are fewer.

    Notes
    -----
    First singular vectors of the spectral matrix of the stations (frequency domain decomposition) where the largest
    singular value peaks. The highest peak is taken first, then the highest whose shape is another one. They are shapes
    of the motion as it was, and those of modes only where one mode moves the structure at that frequency.

    Examples
    --------
    >>> time_s, place = np.arange(400) / 40, np.linspace(0, 1, 21)
    >>> first = np.outer(np.sin(2 * np.pi * 2 * time_s), np.sin(np.pi * place))
    >>> second = np.outer(np.sin(2 * np.pi * 5 * time_s), np.sin(2 * np.pi * place))
    >>> shapes, frequency = find_shapes((first + 0.2 * second)[..., None], time_s, 2)
    >>> frequency[:, 0].round(1).tolist(), round(compute_mac(shapes[1, :, 0], np.sin(2 * np.pi * place)), 3)
    ([2.0, 5.0], 1.0)
    """
    axes = field_mm.shape[2]
    shapes, frequencies = np.full((count, field_mm.shape[1], axes), np.nan), np.full((count, axes), np.nan)
    known = np.isfinite(field_mm).all(axis=(1, 2))
    length = int(known.sum() // _SEGMENTS * 2)
    if length < 16 or len(time_s) < 2:
        return shapes, frequencies
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    for axis in range(axes):
        found = _shapes_of(field_mm[known, :, axis], rate, length, count)
        for number, (frequency, shape) in enumerate(found):
            frequencies[number, axis], shapes[number, :, axis] = frequency, shape
    return shapes, frequencies


def _shapes_of(values: FloatArray, rate_hz: float, length: int, count: int) -> list[tuple[float, FloatArray]]:
    """Frequencies and shapes (S,) of one axis, by frequency."""
    # A field has few independent directions: their spectra say all.
    centred = values - values.mean(axis=0)
    _, size, directions = np.linalg.svd(centred, full_matrices=False)
    directions = directions[size > 1e-6 * max(size[0], 1e-12)][:12]
    if not len(directions):
        return []
    moved = centred @ directions.T
    frequency, spectra = csd(moved.T[:, None], moved.T[None], rate_hz, nperseg=length, noverlap=length // 2, axis=-1)
    vectors, levels, _ = np.linalg.svd(np.moveaxis(spectra, -1, 0))
    level = levels[:, 0]
    found: list[tuple[float, FloatArray]] = []
    for peak in sorted(_peaks(level), key=lambda one: -level[one]):
        shape = _make_real(directions.T @ vectors[peak, :, 0])
        if all(compute_mac(shape, other) < _NEW_MAC for _, other in found):
            found.append((float(frequency[peak]), shape))
        if len(found) == count:
            break
    return sorted(found, key=lambda one: one[0])


def _peaks(level: FloatArray) -> list[int]:
    """Lines that are higher than those beside them, without the first, which is a drift."""
    return [k for k in range(2, len(level) - 1) if level[k] >= level[max(1, k - _PEAK_BINS) : k + _PEAK_BINS + 1].max()]


def _make_real(shape: np.ndarray) -> FloatArray:
    """The real shape nearest to a complex one, of largest value 1."""
    turned = shape * np.exp(-0.5j * np.angle((shape**2).sum()))
    real = turned.real
    return np.asarray(real / real[np.argmax(np.abs(real))])


def compute_mac(first: FloatArray, second: FloatArray) -> float:
    """Modal assurance criterion of two real shapes: 1 where they are alike [1].

    Parameters
    ----------
    first, second
        Shapes, shape (S,) each.

    Examples
    --------
    >>> compute_mac(np.array([1.0, 2.0]), np.array([-2.0, -4.0]))
    1.0
    """
    return float((first @ second) ** 2 / ((first @ first) * (second @ second)))
