"""What a registration of subsets yields."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.stages.registration.kernels import CONVERGED, OUTSIDE

__all__ = ["RawRegistration", "Registration"]


@dataclass(frozen=True, eq=False)
class Registration:
    """Where subsets of a reference image were found in another image.

    Parameters
    ----------
    position
        Shape (P, 2) [px]; NaN where it failed.
    affine
        Maps offsets in the reference to offsets in the other image, shape (P, 2, 2) [1]; NaN where it failed.
    covariance
        Of the position, shape (P, 2, 2) [px2]; NaN where it failed, or where the gradients are hardly more than noise.
    correlation
        Zero-normalised cross-correlation, shape (P,) [1]; NaN where nothing was compared.
    iterations
        Gauss-Newton steps taken, shape (P,).
    converged
        Whether the position is a minimum of the criterion, shape (P,).
    outside
        Whether it failed because the subset left the image, shape (P,).
    """

    position: FloatArray
    affine: FloatArray
    covariance: FloatArray
    correlation: FloatArray
    iterations: IntArray
    converged: BoolArray
    outside: BoolArray


@dataclass(frozen=True, eq=False)
class RawRegistration:
    """The kernel's own numbers of K registrations; `SubsetBank.interpret` makes a `Registration` of them.

    Parameters
    ----------
    rows
        Subset of each, shape (K,).
    warps
        Position of the subset's centre, then the affine map row by row, shape (K, 6).
    outcome
        Code, iterations, correlation, residual sum of squares and gain, shape (K, 5).
    """

    rows: IntArray
    warps: FloatArray
    outcome: FloatArray

    @classmethod
    def joined(cls, parts: Sequence["RawRegistration"]) -> "RawRegistration":
        """Several one after the other."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("rows", "warps", "outcome")))

    @property
    def converged(self) -> BoolArray:
        """Whether each ended in a minimum, shape (K,)."""
        return np.asarray(self.outcome[:, 0] == CONVERGED)

    @property
    def outside(self) -> BoolArray:
        """Whether each failed because the subset left the image, shape (K,)."""
        return np.asarray(self.outcome[:, 0] == OUTSIDE)

    @property
    def correlation(self) -> FloatArray:
        """Zero-normalised cross-correlation, shape (K,)."""
        return self.outcome[:, 2]
