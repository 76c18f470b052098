"""Tracks made of pixels: what every test of what comes after tracking begins with."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.datasets import Status, make_tracks

__all__ = ["stated_tracks"]


def stated_tracks(
    position: npt.NDArray[np.float64],
    stated: npt.ArrayLike,
    time_s: npt.ArrayLike,
    *,
    names: Sequence[str] | None = None,
    **attrs: object,
) -> xr.Dataset:
    """Tracks of one view, lost where a position is NaN.

    Parameters
    ----------
    position
        Shape (T, P, 2) [px].
    stated
        One standard deviation along u and v [px], or covariances (2, 2) to (T, P, 2, 2) [px2].
    time_s
        Time stamps, shape (T,) [s], or the frames a second.
    names
        Of the points; ``p0``, ``p1``, ... without.
    **attrs
        Of the dataset.
    """
    known = np.asarray(stated, float)
    covariance = known**2 * np.eye(2) if known.ndim == 0 else known
    clock = np.asarray(time_s, float)
    return make_tracks(
        np.arange(len(position)) / clock if clock.ndim == 0 else clock,
        [f"p{number}" for number in range(position.shape[1])] if names is None else list(names),
        position,
        np.broadcast_to(covariance, (*position.shape, 2)).copy(),
        np.where(np.isfinite(position).all(axis=2), Status.OK, Status.LOST),
        attrs=attrs,
    )
