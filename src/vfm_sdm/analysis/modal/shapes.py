"""Mode shapes: how alike two are, how far one is from moving all in phase, and their phase."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, ComplexArray, FloatArray

__all__ = ["Peaks", "compute_collinearity", "compute_mac", "to_real"]


@dataclass(frozen=True, eq=False)
class Peaks:
    """Where M modes show in the lines of a record.

    Parameters
    ----------
    frequency_hz, damping_ratio
        Of the modes, shape (M,) [Hz], [1].
    duration_s
        Length of the record [s].

    Examples
    --------
    >>> peaks = Peaks(np.array([2.0, 2.1, 5.0]), np.array([0.01, 0.01, 0.01]), 60.0)
    >>> peaks.beside(1), int(peaks.near(2, np.arange(600) / 60).sum())
    ([1, 0], 13)
    """

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    duration_s: float

    @property
    def half_widths_hz(self) -> FloatArray:
        """How far from its frequency a mode is most of what moves, shape (M,) [Hz]."""
        return np.maximum(4 / self.duration_s, 2 * self.damping_ratio * self.frequency_hz)

    def near(self, number: int, line_hz: npt.NDArray[np.floating]) -> BoolArray:
        """Lines that a mode rules, shape (F,).

        Parameters
        ----------
        number
            Of the mode.
        line_hz
            Frequencies of the lines, shape (F,) [Hz].
        """
        return np.asarray(np.abs(line_hz - self.frequency_hz[number]) <= self.half_widths_hz[number])

    def beside(self, number: int) -> list[int]:
        """Numbers of a mode and, after it, of all whose peaks overlap with its own.

        Parameters
        ----------
        number
            Of the mode.
        """
        apart = np.abs(self.frequency_hz - self.frequency_hz[number])
        overlap = np.flatnonzero(apart <= self.half_widths_hz + self.half_widths_hz[number])
        return [number, *(int(other) for other in overlap if other != number)]


def compute_mac(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Modal assurance criterion of all pairs of shapes, shape (M, N) [1].

    Parameters
    ----------
    first, second
        Shapes, (M, C) and (N, C), complex or real; where one is NaN, the channel does not count.

    Notes
    -----
    ``|a^H b|^2 / (a^H a)(b^H b)``.

    Examples
    --------
    >>> compute_mac(np.array([[1.0, 1.0]]), np.array([[2j, 2j], [1, -1]])).round(6).tolist()
    [[1.0, 0.0]]
    """
    known = np.isfinite(first).all(axis=0) & np.isfinite(second).all(axis=0)
    a, b = first[:, known], second[:, known]
    with np.errstate(invalid="ignore", divide="ignore"):
        mac = np.abs(a.conj() @ b.T) ** 2 / np.outer((np.abs(a) ** 2).sum(axis=1), (np.abs(b) ** 2).sum(axis=1))
    return np.asarray(mac)


def compute_collinearity(shape: ComplexArray) -> float:
    """Modal phase collinearity: 1 where all channels move in phase or against it, 0 where phases are any [1].

    Parameters
    ----------
    shape
        Shape (C,), complex; NaN where it is not known.

    Notes
    -----
    ``((l1 - l2) / (l1 + l2))^2`` of the eigenvalues of the second moments of real and imaginary part. Unlike pyOMA-2's,
    they are not taken about their means: a shape that is the same everywhere is as collinear as any.

    References
    ----------
    .. [1] Pappa, R. S., Elliott, K. B. and Schenk, A. (1993). Consistent-mode indicator for the eigensystem realization
       algorithm. Journal of Guidance, Control, and Dynamics 16(5), 852-858.

    Examples
    --------
    >>> round(compute_collinearity(np.array([1 + 1j, -2 - 2j, 0.5 + 0.5j])), 6)
    1.0
    """
    known = shape[np.isfinite(shape)]
    moments = np.stack([known.real, known.imag]) @ np.stack([known.real, known.imag]).T
    low, high = np.linalg.eigvalsh(moments)
    return float(((high - low) / (high + low)) ** 2)


def to_real(shape: ComplexArray, like: ComplexArray | None = None) -> ComplexArray:
    """The shape at unit length and with the phase at which it is most real, shape (C,).

    Parameters
    ----------
    shape
        Shape (C,), complex.
    like
        Shape whose sign it gets; by default its largest channel is positive.

    Examples
    --------
    >>> to_real(np.array([3j, -4j])).real.round(6).tolist()
    [-0.6, 0.8]
    """
    turned = shape * np.exp(-0.5j * np.angle(np.sum(shape**2))) / np.linalg.norm(shape)
    along = turned[np.abs(turned).argmax()] if like is None else to_real(like).conj() @ turned
    positive: ComplexArray = turned if along.real >= 0 else -turned
    return positive + 0.0
