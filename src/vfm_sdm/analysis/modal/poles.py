"""Poles of a record over growing orders of its model, and the few that are modes of the structure."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.analysis.modal.library import load_library
from vfm_sdm.analysis.modal.shapes import compute_collinearity, compute_mac, to_real
from vfm_sdm.core.arrays import BoolArray, ComplexArray, FloatArray, IntArray

__all__ = ["Cluster", "Poles", "find_clusters", "find_poles"]

_CHANNELS = 12
"""Combinations of channels that the model is made of, the strongest ones over their noise."""
_BLOCK_ROWS = 20
_FEWEST_WINDOWS = 5
"""Windows of the model that a record must hold."""
_MOST_DAMPING = 0.15
_FREQUENCY_STEP, _LEAST_MAC = 0.02, 0.95
"""How near a pole must be to one of the order before to be stable."""
_FREQUENCY_APART, _MAC_OF_ONE = 0.04, 0.85
"""How near poles must be to each other to be of one mode."""
_STABLE_SHARE = 0.4
"""Share of the orders, from the first at which a mode is stable, at which it must be so."""
_FEWEST_STABLE = 5
_LEAST_COLLINEARITY = 0.75


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of models of growing order.

    Parameters
    ----------
    order
        Order of the model, shape (N,).
    frequency_hz, damping_ratio
        Shape (N,) [Hz], [1].
    shape
        In units of each channel's noise, shape (N, C), complex.
    stable
        Whether a pole of the order before is alike, shape (N,).
    highest_order
        Highest order of the models: less than asked for where channels or samples allow no more.
    """

    order: IntArray
    frequency_hz: FloatArray
    damping_ratio: FloatArray
    shape: ComplexArray
    stable: BoolArray
    highest_order: int


@dataclass(frozen=True, eq=False)
class Cluster:
    """Stable poles of one mode.

    Parameters
    ----------
    frequency_hz, damping_ratio
        Medians [Hz], [1].
    shape
        Mean shape, in units of each channel's noise, shape (C,), complex.
    collinearity
        Modal phase collinearity of the mean shape [1].
    members
        Which poles they are.
    """

    frequency_hz: float
    damping_ratio: float
    shape: ComplexArray
    collinearity: float
    members: IntArray


def find_poles(values: FloatArray, rate_hz: float, *, most_order: int) -> Poles:
    """Poles by covariance-driven stochastic subspace identification, at all even orders.

    Parameters
    ----------
    values
        Channels in units of their noise, shape (T, C).
    rate_hz
        Samples a second [Hz].
    most_order
        Highest order of the model, twice the number of modes that it can hold.

    References
    ----------
    .. [1] Peeters, B. and De Roeck, G. (1999). Reference-based stochastic subspace identification for output-only modal
       analysis. Mechanical Systems and Signal Processing 13(6), 855-878.
    """
    library = load_library()
    basis = np.linalg.svd(values, full_matrices=False)[2][:_CHANNELS]
    used = values @ basis.T
    rows = int(np.clip(len(values) // (2 * _FEWEST_WINDOWS), 3, _BLOCK_ROWS))
    most = min(most_order, (rows - 1) * len(basis)) // 2 * 2
    hankel, _ = library.ssi.build_hank(used.T, used.T, rows, "cov_R")
    observability, states, outputs, _ = library.ssi.SSI_fast(hankel, rows, most, 2)
    with np.errstate(all="ignore"):
        frequency, damping, shape, *_ = library.ssi.SSI_poles(
            observability, states, outputs, most, 1 / rate_hz, 2, HC=True, xi_max=_MOST_DAMPING
        )
    found = np.isfinite(frequency) & np.isfinite(damping) & (damping > 0) & (frequency > 0)
    column, row = np.nonzero(found.T)
    shapes = shape[row, column] @ basis
    order, hertz, ratio = 2 * column, frequency[row, column], damping[row, column]
    return Poles(order, hertz, ratio, shapes, _is_stable(order, hertz, shapes), most)


def _is_stable(order: IntArray, frequency_hz: FloatArray, shape: ComplexArray) -> BoolArray:
    stable = np.zeros(len(order), dtype=bool)
    for one in np.unique(order):
        now, before = np.flatnonzero(order == one), np.flatnonzero(order == one - 2)
        if before.size:
            near = np.abs(frequency_hz[now, None] / frequency_hz[before] - 1) < _FREQUENCY_STEP
            stable[now] = (near & (compute_mac(shape[now], shape[before]) > _LEAST_MAC)).any(axis=1)
    return stable


def find_clusters(poles: Poles, band_hz: tuple[float, float]) -> list[Cluster]:
    """Stable poles that are one mode each, by frequency; what is not stable, collinear and inside the band is left out.

    Parameters
    ----------
    poles
        Poles of growing orders.
    band_hz
        Band [Hz]; its outermost twentieths belong to the filter.
    """
    low, high = band_hz[0] * 1.05, band_hz[1] * 0.95
    free = poles.stable & (poles.frequency_hz > low) & (poles.frequency_hz < high)
    orders = np.unique(poles.order)
    alike = np.abs(np.log(poles.frequency_hz[:, None] / poles.frequency_hz)) < _FREQUENCY_APART
    alike &= compute_mac(poles.shape, poles.shape) > _MAC_OF_ONE
    clusters = []
    while free.any():
        counts = np.where(free, (alike & free).sum(axis=1), 0)
        seed = int(counts.argmax())
        members = np.flatnonzero(alike[seed] & free)
        free[members] = False
        at = np.unique(poles.order[members])
        if len(at) < max(_FEWEST_STABLE, _STABLE_SHARE * (orders >= at[0]).sum()):
            continue
        shape = np.mean([to_real(poles.shape[i], poles.shape[seed]) for i in members], axis=0)
        collinearity = compute_collinearity(shape)
        if collinearity >= _LEAST_COLLINEARITY:
            hertz, damping = (float(np.median(one[members])) for one in (poles.frequency_hz, poles.damping_ratio))
            clusters.append(Cluster(hertz, damping, shape, collinearity, members))
    return sorted(clusters, key=lambda one: one.frequency_hz)
