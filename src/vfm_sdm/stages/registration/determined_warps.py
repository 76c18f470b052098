"""Which warps the texture of a subset determines: those whose information stands clear of what noise gives."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import correlate1d

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray

__all__ = ["LINEAR", "LINEAR_STD", "estimate_noise", "invert_determined"]

LINEAR_STD = 3e-4
"""Rotation and strain that an ordinary recording makes unseen [1]: the slope of a girder that is bent by 1/10000 of its
span (pi/10000), as under pedestrians and wind; the limit of serviceability of a footbridge is ten times that."""
_CLEAR = 3.0
"""Information of a warp over that of noise alone from which on the texture determines it: two thirds of it are then
texture, so that each step leaves at most a third of the way, and the smallest such step still shrinks."""
_HIGHEST = np.array([-1, 6, -15, 20, -15, 6, -1]) / 64
"""High-pass sin^6(pi f): a thousandth of a texture's power below a quarter of the sampling frequency passes."""
_QUANTISATION = 1 / 12
"""Variance of rounding to grey levels, below which no noise is [squared grey levels]."""
_POSED = 1e-6
_TRANSLATION, LINEAR = [0, 3], [1, 2, 4, 5]
"""Parameters of an affine warp that move all of it, and those that turn and strain it."""


def estimate_noise(images: FloatArray) -> FloatArray:
    """Variance of the noise of a pixel, by frequencies that hardly a lens passes.

    Parameters
    ----------
    images
        Shape (P, R, R) [grey levels].

    Returns
    -------
    variance
        Shape (P,) [squared grey levels]; at least that of rounding.

    References
    ----------
    .. [1] Immerkaer, J. (1996). Fast noise variance estimation. Computer Vision and Image Understanding 64(2), 300-302.
       Here with a steeper filter and the median instead of the mean, which edges would raise.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0, 2, (1, 60, 60))
    >>> round(float(estimate_noise(noise)[0]), 1)
    3.9
    """
    border = len(_HIGHEST) // 2
    # Neighbours share most of what the filter leaves: every second one along each axis tells as much.
    fine = correlate1d(images, _HIGHEST, axis=2)[:, :, border:-border:2]
    fine = correlate1d(fine, _HIGHEST, axis=1)[:, border:-border:2]
    std = MAD_TO_STD * np.median(np.abs(fine).reshape(len(images), -1), axis=1) / float(_HIGHEST @ _HIGHEST)
    return np.asarray(np.maximum(std**2, _QUANTISATION))


def invert_determined(
    M: FloatArray, noise: FloatArray, bases: Sequence[FloatArray] | None = None
) -> tuple[FloatArray, BoolArray]:
    """Inverses of Gauss-Newton matrices within the allowed warps that the texture determines.

    Parameters
    ----------
    M
        Matrices, shape (P, 6, 6).
    noise
        What noise alone adds to them for the linear part of the warp, shape (P, 4, 4).
    bases
        Allowed steps of each warp, shape (6, k) each; all six by default.

    Returns
    -------
    inverse
        B (B' M B)^-1 B' with B the allowed steps without those that are held, shape (P, 6, 6).
    fixed
        Whether the texture fixes what is left, translation above all, shape (P,).

    Notes
    -----
    Noise of the reference makes gradients, too, and so seems to tell warps of which the texture says nothing: the
    rotation of a round target, the shear of a few coarse grains. The current image has other noise; a step is then
    noise over noise, and whether it ever ends is chance. The linear warps are told apart by what they give M beside the
    translation (a Schur complement), over what noise gives it (a generalised eigenproblem): directions below
    `_CLEAR` are held. Translation never is: where it is not fixed, the subset is of no use.

    Examples
    --------
    >>> inverse, fixed = invert_determined(np.diag([9.0, 1.0, 8.0, 9.0, 8.0, 8.0])[None], np.eye(4)[None])
    >>> inverse[0].diagonal().round(3).tolist(), fixed.tolist()
    ([0.111, 0.0, 0.125, 0.111, 0.125, 0.125], [True])
    """
    inverse, fixed = np.zeros_like(M), np.zeros(len(M), np.bool_)
    whole = np.flatnonzero(_is_determined(M, noise)) if bases is None else np.empty(0, np.int64)
    posed = whole[is_well_posed(M[whole])]
    inverse[posed], fixed[posed] = np.linalg.inv(M[posed]), True
    for point in np.flatnonzero(~fixed).tolist():
        B = _keep_determined(M[point], noise[point], np.eye(6) if bases is None else bases[point])
        within = B.T @ M[point] @ B
        fixed[point] = is_well_posed(within[None])[0]
        inverse[point] = B @ np.linalg.inv(within if fixed[point] else np.eye(B.shape[1])) @ B.T
    return inverse, fixed


def _is_determined(M: FloatArray, noise: FloatArray) -> BoolArray:
    """Whether all linear warps of matrices (P, 6, 6) stand clear of noise (P, 4, 4), shape (P,)."""
    told = _tell_linear(M)
    return np.asarray(np.linalg.eigvalsh(told - _CLEAR * noise)[:, 0] > 0)


def _tell_linear(M: FloatArray) -> FloatArray:
    """What matrices (P, 6, 6) tell of the linear warps where translation is free, shape (P, 4, 4)."""
    symmetric = (M + M.swapaxes(1, 2)) / 2
    place, linear = symmetric[:, _TRANSLATION][:, :, _TRANSLATION], symmetric[:, LINEAR][:, :, LINEAR]
    cross = symmetric[:, LINEAR][:, :, _TRANSLATION]
    # Of an edge, only the direction across has a part in the translation.
    return np.asarray(linear - cross @ np.linalg.pinv(place, rcond=_POSED, hermitian=True) @ cross.swapaxes(1, 2))


def _keep_determined(M: FloatArray, noise: FloatArray, basis: FloatArray) -> FloatArray:
    """The part of a basis of warps (6, k) that a matrix (6, 6) determines, shape (6, m)."""
    moves, bends = basis[:, ~basis[LINEAR].any(axis=0)], basis[:, basis[LINEAR].any(axis=0)]
    if not bends.size:
        return basis
    L = bends[LINEAR]
    told, chance = L.T @ _tell_linear(M[None])[0] @ L, L.T @ noise @ L
    factor = np.linalg.inv(np.linalg.cholesky(chance))
    clear, directions = np.linalg.eigh(factor @ told @ factor.T)
    return np.column_stack([moves, bends @ factor.T @ directions[:, clear > _CLEAR]])


def is_well_posed(M: FloatArray) -> BoolArray:
    """Whether matrices (P, k, k) fix all k parameters: their scaled symmetric part is far from singular."""
    symmetric = (M + M.swapaxes(1, 2)) / 2
    diagonal = np.einsum("pkk->pk", symmetric)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1))
    smallest = np.linalg.eigvalsh(symmetric / scale[:, :, None] / scale[:, None, :])[:, 0]
    return np.asarray((diagonal > 0).all(axis=1) & (smallest > _POSED))
