"""Results of the registration of subsets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.stages.registration.kernels import CONVERGED, OUTSIDE

__all__ = ["RawRegistration", "Registration", "Starts"]


@dataclass(frozen=True, eq=False)
class Starts:
    """Where registrations begin in the other image.

    Parameters
    ----------
    position
        Positions, shape (P, 2) [px], within a few pixels of the truth.
    affine
        Maps from offsets in the reference image to offsets in the other one, shape (P, 2, 2) [1]; identity when left
        out.
    """

    position: npt.ArrayLike
    affine: npt.ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Registration:
    """Where subsets of a reference image were found in another image.

    Parameters
    ----------
    position
        Position in the other image, shape (P, 2) [px]; NaN where the registration failed.
    affine
        Maps from offsets in the reference image to offsets in the other one, shape (P, 2, 2) [1]; NaN where the
        registration failed.
    covariance
        Covariance of the position, shape (P, 2, 2) [px2]; NaN where the registration failed, or where the gradients are
        hardly more than noise.
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
    """Numbers of the kernel on K registrations; `SubsetBank.interpret` makes a `Registration` of them.

    Parameters
    ----------
    rows
        Row of the subset in its bank, shape (K,).
    warps
        Position of the subset's centre [px], then the affine map row by row [1], shape (K, 6).
    outcome
        Code, iterations, correlation [1], residual sum of squares, gain and roughness of the residuals [1] (NaN where
        it was not measured), shape (K, 6).
    """

    rows: IntArray
    warps: FloatArray
    outcome: FloatArray

    @classmethod
    def joined(cls, parts: Sequence["RawRegistration"]) -> "RawRegistration":
        """Registrations of several parts, such as successive frames, one part after the other, shape (K, ...)."""
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
