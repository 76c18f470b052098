"""What a subset is: its size, which of its pixels are believed, and the warps that its registration may choose from."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import DatasetError, SessionError

__all__ = ["FEWEST_BELIEVED_PX", "USUAL_SUBSET_PX", "SubsetDesign", "Warp", "check_subset_px"]

USUAL_SUBSET_PX = 41
"""Side of a subset where nobody names or chooses one [px]."""
FEWEST_BELIEVED_PX = 24
"""Three pixels for each of the eight numbers that an affine registration takes: six of the warp, gain and bias."""
_HIGHEST_SHADING = 5
"""From the sixth degree on, surfaces take the texture of small subsets away."""
_UNIT = 1e-6
"""Relative error of a length that counts as 1."""


class Warp(StrEnum):
    """What may happen to a subset between two images, from the least to the most."""

    EDGE = "edge"
    """Translation along one direction: across an edge."""
    TRANSLATION = "translation"
    SIMILARITY = "similarity"
    """Translation, rotation and a change of scale."""
    AFFINE = "affine"


@dataclass(frozen=True, eq=False)
class SubsetDesign:
    """How a point's subset is cut and registered; by default the whole square and an affine warp.

    Parameters
    ----------
    subset_px
        Side of the square, odd [px].
    warp
        The warps allowed.
    across
        Unit vector (u, v) across the edge in the reference image, shape (2,) [1], for `Warp.EDGE`; else ``None``.
    mask
        Believed pixels of the square, [v, u] like the image, shape (S, S); all by default.
    omitted_std
        Standard deviation of each element of the linear part (rotation, strain) that the subset really undergoes and
        the warp leaves out [1]; what it does to the position is part of the covariance.
    shading
        Degree, 0 to 5, of the polynomial surface of brightness that may come and go on the subset, as shadows do; 0 is
        a bias. A gain is free in any case.

    Raises
    ------
    SessionError
        The size is even or too small.
    DatasetError
        The mask or the direction do not fit the rest.

    Examples
    --------
    >>> SubsetDesign(31, Warp.EDGE, across=np.array([0.6, 0.8])).basis().ravel().tolist()
    [0.6, 0.0, 0.0, 0.8, 0.0, 0.0]
    """

    subset_px: int = USUAL_SUBSET_PX
    warp: Warp = Warp.AFFINE
    across: FloatArray | None = None
    mask: BoolArray | None = None
    omitted_std: float = 0.0
    shading: int = 0

    def __post_init__(self) -> None:
        check_subset_px(self.subset_px, "subset_px")
        if (self.across is not None) != (self.warp == Warp.EDGE):
            raise DatasetError(
                f"across: expected a direction for the warp 'edge' and none for others, got {self.across} for "
                f"'{self.warp}'; name the direction across the edge"
            )
        if self.across is not None and not abs(np.hypot(*np.asarray(self.across, np.float64)) - 1) <= _UNIT:
            raise DatasetError(f"across: expected a unit vector, got {self.across}; divide it by its length")
        side = (self.subset_px, self.subset_px)
        if self.mask is not None and (self.mask.shape != side or self.mask.dtype != np.bool_):
            raise DatasetError(
                f"mask: expected booleans of shape {side}, got {self.mask.dtype} of shape {self.mask.shape}; "
                "state every pixel of the square"
            )
        if self.believed_px < FEWEST_BELIEVED_PX:
            raise DatasetError(
                f"mask: expected at least {FEWEST_BELIEVED_PX} believed pixels, got {self.believed_px}; leave the "
                "point out"
            )
        if not (np.isfinite(self.omitted_std) and self.omitted_std >= 0):
            raise DatasetError(f"omitted_std: expected 0 or more, got {self.omitted_std}; leave it out for 0")
        if not 0 <= self.shading <= _HIGHEST_SHADING:
            raise DatasetError(
                f"shading: expected a degree from 0 to {_HIGHEST_SHADING}, got {self.shading}; leave it out for 0"
            )

    @property
    def shadings(self) -> int:
        """Number of surfaces that make up the shading, beside the constant."""
        return (self.shading + 1) * (self.shading + 2) // 2 - 1

    @property
    def believed_px(self) -> int:
        """Number of believed pixels."""
        return self.subset_px**2 if self.mask is None else int(np.count_nonzero(self.mask))

    def basis(self) -> FloatArray:
        """Allowed steps of the warp (t_u, du/dx, du/dy, t_v, dv/dx, dv/dy), shape (6, k)."""
        unit = np.eye(6)
        if self.warp == Warp.AFFINE:
            return unit
        if self.across is not None:
            return unit[:, ::3] @ np.asarray(self.across, np.float64)[:, None]
        if self.warp == Warp.TRANSLATION:
            return unit[:, ::3]
        return np.column_stack([unit[:, 0], unit[:, 3], unit[:, 1] + unit[:, 5], unit[:, 4] - unit[:, 2]])

    def direction(self) -> FloatArray:
        """Unit vector across the edge, shape (2,) [1]; NaN where the subset is none."""
        return np.full(2, np.nan) if self.across is None else np.asarray(self.across, np.float64)


def check_subset_px(subset_px: int, name: str) -> int:
    """The side of a subset [px], after checking it.

    Parameters
    ----------
    subset_px
        Side of the subset [px].
    name
        Name of the setting in the message.

    Raises
    ------
    SessionError
        The side is even or below 9 px.

    Examples
    --------
    >>> check_subset_px(41, "subset_px")
    41
    """
    if subset_px < 9 or subset_px % 2 == 0:
        raise SessionError(f"{name}: expected an odd number of at least 9 pixels, got {subset_px}; use 41")
    return subset_px
