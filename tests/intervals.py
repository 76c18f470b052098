"""What can be said against stated intervals when the errors are known.

Two figures are bounded from both sides: the share of samples whose interval holds the truth, and the width that the
errors ask for over the stated one. Neither is enough by itself: infinite intervals hold everything, and of intervals
of the right mean width half may be far too narrow.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest, chi2, t

from vfm_sdm.core.arrays import FloatArray

__all__ = ["TOO_NARROW", "TOO_WIDE", "covered", "mean_square", "objections", "range_of_mean_share", "range_of_share"]

COVERED, MOST_COVERED = 0.95, 0.99
SPREAD = 0.06
"""Standard deviation of the share of one measurement: its systematic errors are drawn once."""
TAIL = 1e-3
"""How rarely right intervals may be called too wide, or too narrow, by the width that the errors ask for."""

TOO_WIDE = {"too many samples held", "wider than the errors ask for"}
TOO_NARROW = {"too few samples held", "narrower than the errors ask for"}


def covered(ratio: FloatArray) -> FloatArray:
    """Share of samples in their interval, of errors over expanded uncertainties (..., sample, axis)."""
    return np.asarray(np.mean(np.abs(ratio) <= 1, axis=-2))


def mean_square(ratio: FloatArray) -> FloatArray:
    """Mean square of errors over standard uncertainties, 1 if these are right; errors as in `covered`, with k = 2."""
    return np.asarray(np.mean((2 * ratio) ** 2, axis=-2))


def objections(ratios: Sequence[FloatArray]) -> set[str]:
    """What speaks against the intervals of many measurements.

    The errors of one measurement may be as good as one draw, because its cameras and lengths are drawn once. So the sum
    over measurements of the mean squares is, at worst, that of as many squared normal deviates.

    Parameters
    ----------
    ratios
        Of each measurement the errors over the stated expanded uncertainties (k = 2), shape (..., sample, axis).
    """
    margin = 0.02 + 3 * SPREAD / np.sqrt(len(ratios))
    share = np.mean([covered(one) for one in ratios], axis=0)
    squares = np.sum([mean_square(one) for one in ratios], axis=0)
    least, most = chi2.ppf([TAIL, 1 - TAIL], len(ratios))
    beyond = {
        "too few samples held": share < COVERED - margin,
        "too many samples held": share > MOST_COVERED,
        "narrower than the errors ask for": squares > most,
        "wider than the errors ask for": squares < least,
    }
    return {what for what, anywhere in beyond.items() if anywhere.any()}


def range_of_share(held: int, of: int) -> tuple[float, float]:
    """Between which shares the true one lies with 95 %, of independent trials (Wilson's interval)."""
    found = binomtest(int(held), int(of)).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)


def range_of_mean_share(shares: FloatArray) -> tuple[float, float]:
    """Between which shares the true mean lies with 95 %, of independent records (R,); of one record, anywhere.

    Samples of one record are alike, so that the records count and not their samples.
    """
    if len(shares) < 2:
        return 0.0, 1.0
    half = float(t.ppf(0.975, len(shares) - 1) * np.std(shares, ddof=1) / np.sqrt(len(shares)))
    middle = float(np.mean(shares))
    return max(middle - half, 0.0), min(middle + half, 1.0)
