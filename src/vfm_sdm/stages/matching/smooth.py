"""Matches that agree with their surroundings: what a smooth map cannot explain is wrong."""

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray

__all__ = ["agree_smoothly"]

_TRIALS = 500
_ROUNDS = 5
_BENT = 0.3
"""Weight of the prior that keeps the map affine, in observations: few matches must not bend it."""


def agree_smoothly(points2d: FloatArray, offsets: FloatArray, *, seed: int = 0) -> BoolArray:
    """Which offsets lie within one unit of a smooth map of the image that most of them follow.

    Parameters
    ----------
    points2d
        Pixels, shape (N, 2) [px].
    offsets
        Offsets there, in units of their tolerance, shape (N, K) [1].
    seed
        Seed of the random samples.

    Returns
    -------
    agree
        Shape (N,); none of fewer than six.

    Notes
    -----
    Random samples of three [1]_ find the affine map that most offsets follow; a quadratic one is then fitted with
    weights that fall with the distance.

    References
    ----------
    .. [1] Fischler, M. A., Bolles, R. C. (1981). Random sample consensus. Communications of the ACM 24(6), 381-395.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> pixels = rng.uniform(0, 1000, (60, 2))
    >>> offsets = 0.02 * pixels
    >>> offsets[:20] = rng.uniform(-20, 20, (20, 2))
    >>> int(agree_smoothly(pixels, offsets)[20:].sum())
    40
    """
    count = len(points2d)
    if count < 6:
        return np.zeros(count, dtype=np.bool_)
    centred = points2d - points2d.mean(axis=0)
    u, v = (centred / max(float(np.abs(centred).max()), 1.0)).T
    design = np.column_stack([np.ones(count), u, v, u * u, u * v, v * v])
    rng = np.random.default_rng(seed)
    samples = np.array([rng.choice(count, 3, replace=False) for _ in range(_TRIALS)])
    corners = design[samples][:, :, :3]
    usable = np.abs(np.linalg.det(corners)) > 1e-3
    if not usable.any():
        return np.zeros(count, dtype=np.bool_)
    maps = np.linalg.solve(corners[usable], offsets[samples[usable]])
    apart = np.linalg.norm(np.einsum("nc,sck->snk", design[:, :3], maps) - offsets, axis=2)
    best = (apart < 1).sum(axis=1).argmax()
    fitted = np.concatenate([maps[best], np.zeros((3, offsets.shape[1]))])
    prior = np.sqrt(_BENT) * np.eye(6)[3:]
    for _ in range(_ROUNDS):
        distance = np.linalg.norm(offsets - design @ fitted, axis=1)
        weight = np.where(distance < 2, 1 / (1 + distance**2), 0.0)
        root = np.sqrt(weight)[:, None]
        left = np.concatenate([design * root, prior])
        right = np.concatenate([offsets * root, np.zeros((3, offsets.shape[1]))])
        fitted = np.linalg.lstsq(left, right, rcond=None)[0]
    return np.asarray(np.linalg.norm(offsets - design @ fitted, axis=1) < 1)
