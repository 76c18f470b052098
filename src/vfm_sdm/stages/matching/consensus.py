"""Whether matches agree with a relative pose better than chance would: number of false alarms, a contrario."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln
from scipy.stats import binom

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, as_float_array
from vfm_sdm.errors import CameraError

__all__ = ["Consensus", "assign_cells", "find_consensus"]

_SAMPLE, _MODELS = 5, 10
"""Matches that determine a relative pose with known intrinsics, and the most poses that go through them."""
_SHARES = (0.25, 0.5)
"""Of a cell's matches that have to agree so that the cell agrees; whichever says more."""
_CELLS = 12
"""Along a side of the grid over an image: a cell is as large as a window or a field of a railing, which repeat."""
_STEPS, _STEPS_PER_OCTAVE = 33, 4
"""Thresholds that are tried: from the largest down to a 256th of it."""
_LEAST = 1e-12
"""Least probability: errors of exactly zero are no proof of anything."""
_SIDE_BAND = 4.0
"""Multiple of an error from which on the wrong matches beside the lines tell how dense they are on them."""
_LARGEST_SHARE = 0.005
"""Of the image's diagonal: the largest threshold. Beyond, agreement would say where the wrong matches are."""


@dataclass(frozen=True, eq=False)
class Consensus:
    """Agreement of matches with a relative pose.

    Parameters
    ----------
    log_nfa
        Decimal logarithm of the number of false alarms: of poses with as good an agreement that are to be expected from
        wrong matches alone. Above 0 it is chance; -3 happens once in a thousand pairs of unrelated views.
    threshold_px
        Epipolar error up to which matches count as agreeing [px]; 0 where none do.
    inliers
        Which matches agree, shape (N,).
    """

    log_nfa: float
    threshold_px: float
    inliers: BoolArray

    @property
    def is_meaningful(self) -> bool:
        """Whether less than one such agreement is to be expected by chance."""
        return self.log_nfa < 0


def find_consensus(
    epipolar_error: npt.ArrayLike, image_size: tuple[int, int], *, cells: npt.ArrayLike | None = None
) -> Consensus:
    """Threshold at which the agreement of matches with a relative pose is least probable by chance, and how probable.

    Parameters
    ----------
    epipolar_error
        Epipolar error of each match with the pose, signed or not, shape (N,) [px]
        (`vfm_sdm.geometry.triangulation.sampson_error`); NaN agrees with nothing.
    image_size
        Width and height of the second image [px].
    cells
        Cell of the first image in which each match lies, shape (N,). The matches of a cell count once: neighbours on
        one wall are wrong in the same way (`assign_cells`). By default each match is a cell.

    Raises
    ------
    CameraError
        The arrays differ in length, or an image has no size.

    Notes
    -----
    That k of n cells agree within a threshold by chance has a probability of at most ``C(n, k) p^(k - 5)``, as five
    matches determine the pose. With ten poses from each choice of five of these cells, and T thresholds tried, the
    number of false alarms is [1]_, [2]_

        ``NFA = 10 T C(n, k) C(k, 5) p^(k - 5)``.

    The probability that a random point lies as near to a line as the error e is ``2 sqrt(2) e D / A`` for an image of
    diagonal D and area A (an error is the distance over the square root of two where it is equal in both images). Wrong
    matches are not spread evenly: those on a wall, a railing or a waterline lie at like heights in both views, and thus
    near all epipolar lines of level cameras. Their density is therefore the larger of this and of what is seen beside
    the lines: between the threshold and any multiple of it from four on.

    A cell agrees if a quarter of its matches does, or half of them; both are tried. By chance so many do with the
    probability of the binomial distribution, but not less than that of one match. Cells differ in it; their mean stands
    for all, which bounds the probability [3]_. The threshold and the inliers are those of the matches, each for itself;
    the figure is that of the cells.

    References
    ----------
    .. [1] Moisan, L., Stival, B. (2004). A probabilistic criterion to detect rigid point matches between two images and
       estimate the fundamental matrix. International Journal of Computer Vision 57(3), 201-218.
    .. [2] Moisan, L., Moulon, P., Monasse, P. (2012). Automatic homographic registration of a pair of images, with a
       contrario elimination of outliers. Image Processing On Line 2, 56-73.
    .. [3] Hoeffding, W. (1956). On the distribution of the number of successes in independent trials. Annals of
       Mathematical Statistics 27(3), 713-721.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> wrong, right = rng.uniform(0, 300, 140), np.abs(rng.normal(0, 0.5, 60))
    >>> find_consensus(np.concatenate([wrong, right]), (1280, 720)).log_nfa < -20
    True
    >>> find_consensus(rng.uniform(0, 300, 200), (1280, 720)).is_meaningful
    False
    """
    error = np.abs(as_float_array(epipolar_error, "epipolar_error", (None,)))
    cell = np.arange(error.size) if cells is None else np.unique(np.asarray(cells), return_inverse=True)[1]
    if cell.shape != error.shape or min(image_size) <= 0:
        raise CameraError(
            f"consensus: expected one cell a match and an image with a size, got {error.size} errors, {cell.size} "
            f"cells and {image_size}; pass what belongs to the same matches"
        )
    error = np.where(np.isnan(error), np.inf, error)
    nobody = Consensus(np.inf, 0.0, np.zeros(error.size, dtype=bool))
    if error.size <= _SAMPLE:
        return nobody
    thresholds = _LARGEST_SHARE * np.hypot(*image_size) * 2.0 ** (-np.arange(_STEPS) / _STEPS_PER_OCTAVE)
    ordered = np.sort(error)
    probability = np.array([_find_probability(ordered, threshold, image_size) for threshold in thresholds])
    figures = _log_nfa(error, np.arange(error.size), thresholds, probability)
    if not np.isfinite(figures).any():
        return nobody
    threshold = float(thresholds[np.argmin(figures)])
    of_cells = _log_nfa(error, cell, thresholds, probability)
    return Consensus(float(of_cells.min()), threshold, error <= threshold)


def assign_cells(points2d: npt.ArrayLike, image_size: tuple[int, int]) -> IntArray:
    """Number of the cell of an image in which each point lies, shape (N,), of twelve by twelve cells.

    Parameters
    ----------
    points2d
        Full-image pixels, shape (N, 2) [px].
    image_size
        Width and height of the image [px].

    Raises
    ------
    DatasetError
        The points have another shape.

    Examples
    --------
    >>> assign_cells([[10.0, 10.0], [20.0, 10.0], [639.0, 479.0]], (640, 480)).tolist()
    [0, 0, 143]
    """
    points = as_float_array(points2d, "points2d", (None, 2))
    column, row = np.clip(points * _CELLS // image_size, 0, _CELLS - 1).astype(np.intp).T
    return np.asarray(row * _CELLS + column)


def _find_probability(ordered: FloatArray, threshold: float, image_size: tuple[int, int]) -> float:
    """Probability that a wrong match has an error below a threshold [px], from the sorted errors of all."""
    width, height = image_size
    density = 2 * np.sqrt(2.0) * np.hypot(width, height) / (width * height)
    within = int(np.searchsorted(ordered, threshold, side="right"))
    beside = np.arange(int(np.searchsorted(ordered, _SIDE_BAND * threshold)), ordered.size)
    seen = (beside + 1 - within) / (ordered[beside] - threshold) / ordered.size
    return float(min(1.0, threshold * seen.max(initial=density)))


def _log_nfa(error: FloatArray, cell: IntArray, thresholds: FloatArray, probability: FloatArray) -> FloatArray:
    """Logarithm of the number of false alarms at each threshold, shape (T,); infinite without more than five cells."""
    count = np.bincount(cell)
    agreeing = np.stack([np.bincount(cell, weights=error <= threshold) for threshold in thresholds])
    figures = []
    for share in _SHARES:
        least = np.maximum(1, np.ceil(share * count))
        k = (agreeing >= least).sum(axis=1)
        # Matches of a cell are wrong together, so that several are no less probable than one.
        chance = np.maximum(binom.sf(least - 1, count, probability[:, None]), probability[:, None])
        # Of unlike cells, as many agree as of like ones with the mean.
        with np.errstate(divide="ignore", invalid="ignore"):
            tests = np.log10(len(_SHARES) * _MODELS * thresholds.size) - _SAMPLE * np.log10(share)
            tests = tests + _log_choose(count.size, k) + _log_choose(k, _SAMPLE)
            found = tests + (k - _SAMPLE) * np.log10(np.maximum(chance.mean(axis=1), _LEAST))
        figures.append(np.where(k > _SAMPLE, found, np.inf))
    return np.asarray(np.min(figures, axis=0))


def _log_choose(n: npt.ArrayLike, k: npt.ArrayLike) -> FloatArray:
    """Decimal logarithm of the binomial coefficient."""
    n, k = np.asarray(n, dtype=np.float64), np.asarray(k, dtype=np.float64)
    return np.asarray((gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)) / np.log(10))
