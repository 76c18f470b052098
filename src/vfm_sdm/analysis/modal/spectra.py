"""Spectra of all channels together: their singular values, and the shapes that belong to them."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.analysis.modal.library import load_library
from vfm_sdm.core.arrays import ComplexArray, FloatArray

__all__ = ["Spectra", "compute_spectra"]

_SINGULAR_VALUES = 3
_STRETCHES = 4
"""Stretches of a record over which its spectrum is averaged, at least."""
_LONGEST = 2048
"""Samples of such a stretch at most."""
_CHANNELS = 30


@dataclass(frozen=True, eq=False)
class Spectra:
    """Singular values of the spectral density of all channels in units of their noise.

    Parameters
    ----------
    frequency_hz
        Shape (F,) [Hz].
    singular_values
        The largest ones, shape (F, 3) [1/Hz].
    first
        Shapes of the largest, shape (F, C), complex.
    """

    frequency_hz: FloatArray
    singular_values: FloatArray
    first: ComplexArray


def compute_spectra(values: FloatArray, rate_hz: float) -> Spectra:
    """Frequency domain decomposition of a record.

    Parameters
    ----------
    values
        Channels in units of their noise, shape (T, C).
    rate_hz
        Samples a second [Hz].

    References
    ----------
    .. [1] Brincker, R., Zhang, L. and Andersen, P. (2001). Modal identification of output-only systems using frequency
       domain decomposition. Smart Materials and Structures 10(3), 441-445.
    """
    library = load_library()
    basis = np.linalg.svd(values, full_matrices=False)[2][:_CHANNELS]
    used = (values @ basis.T).T
    length = int(min(len(values) // _STRETCHES * 2, _LONGEST)) // 2 * 2
    frequency, density = library.fdd.SD_est(used, used, 1 / rate_hz, nxseg=length, method="per", pov=0.5)
    values_of, vectors = library.fdd.SD_svalsvec(density)
    # pyOMA-2 returns the roots of the singular values, and the vectors as rows of a conjugate transpose.
    singular = np.diagonal(values_of, axis1=0, axis2=1)[:, :_SINGULAR_VALUES] ** 2
    first = vectors[0].T.conj() @ basis
    return Spectra(np.asarray(frequency), np.asarray(singular), np.asarray(first))
