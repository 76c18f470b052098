"""Modes of a measured structure: which there are, and what is known of frequency, damping and shape of each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from vfm_sdm.analysis.modal.dataset import Found, make_modes
from vfm_sdm.analysis.modal.oscillation import Oscillation, compute_support, estimate_oscillation
from vfm_sdm.analysis.modal.poles import Cluster, find_clusters, find_poles
from vfm_sdm.analysis.modal.shapes import Peaks, compute_collinearity, compute_mac, to_real
from vfm_sdm.analysis.modal.signals import Channels, make_channels
from vfm_sdm.analysis.modal.spectra import compute_spectra
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import ModeStatus
from vfm_sdm.errors import DatasetError

__all__ = ["ModalOptions", "identify_modes"]

_LEAST_SUPPORT = 10.0
"""Logarithm of how much more probable a record must be with a mode than without it."""
_ONE_MODE = ((0.8, 0.15), (0.9, 0.4))
"""Shapes as alike (MAC), at frequencies as near (relative), are the same mode seen twice."""
_ALIKE = 0.5
"""Shapes less alike than this (MAC) are taken out of each other's series, wherever they vibrate."""
_WIDTHS, _FEWEST_LINES, _MOST_LINES = 8.0, 16.0, 250.0
"""Band about a mode: half-widths of its peak, and lines of the record at least and at most."""
_REFINEMENTS = 2
"""How often shapes are taken from the lines of the peaks, each time with the coordinates of the shapes before."""
_DRIVEN = 0.002
"""Damping ratio below which nothing that is built vibrates freely [1]."""
_WIDEST = 0.05
"""Half width of a frequency's interval, over it, beyond which it is not known."""
_UNKNOWN_DAMPING = 1.0
"""Width of a damping's interval, over it, beyond which the record is too short to know it."""


@dataclass(frozen=True)
class ModalOptions:
    """What is looked for.

    Parameters
    ----------
    axes
        Names of the axes that count; ``None``: all that were measured, such as the two of a single view.
    band_hz
        Band [Hz]; ``None``: from eight periods in the record, at least 0.2 Hz, to 0.4 of the frame rate.
    most_modes
        Modes at most; of more, the best supported ones.
    most_order
        Highest order of the model.
    """

    axes: tuple[str, ...] | None = None
    band_hz: tuple[float, float] | None = None
    most_modes: int = 12
    most_order: int = 40

    def __post_init__(self) -> None:
        if self.most_modes < 1 or self.most_order < 12:
            raise DatasetError(
                f"modes: expected one mode or more and an order of 12 or more, got {self.most_modes} and "
                f"{self.most_order}; correct them"
            )


_DEFAULT = ModalOptions()


def identify_modes(
    displacement: xr.Dataset, options: ModalOptions = _DEFAULT, *, static: frozenset[str] = frozenset()
) -> xr.Dataset:
    """Modes that a record shows beyond doubt: frequency, damping and shape with 95 % intervals.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    options
        What is looked for.
    static
        Points that must not move; they are left out.

    Returns
    -------
    modes
        Dims ``mode, point, axis``: ``frequency`` [Hz], ``damping_ratio`` [1], ``shape`` [1], each with ``_std``, the
        first two with ``_low`` and ``_high``; ``status``, ``collinearity``, ``support``, ``rms`` [mm]; and what the
        stabilisation diagram shows. Shapes are NaN where a point is static or not ok. Attributes ``axes`` and
        ``highest_order`` are what was used; ``order_asked`` is what was asked for.

    Raises
    ------
    DatasetError
        The options do not fit the record, or no point has enough samples.
    BackendUnavailableError
        pyOMA-2 is not installed.

    Notes
    -----
    Poles of growing order by covariance-driven subspace identification (`find_poles`); those that stay, are alike in
    frequency and shape and move in phase are candidates (`find_clusters`). Each is then held against its own modal
    coordinate, the record projected on its shape with all others taken out: it must be far more probable with the mode
    than without (`compute_support`). Frequency and damping with their intervals are those of that coordinate
    (`estimate_oscillation`).
    """
    channels = make_channels(displacement, axes=options.axes, static=static, band_hz=options.band_hz)
    white = channels.values / channels.noise_mm
    poles = find_poles(white, channels.rate_hz, most_order=options.most_order)
    left_out: list[tuple[float, str]] = []
    chosen = _drop_twins(white, find_clusters(poles, channels.band_hz), channels, left_out)
    while chosen:
        series = _modal_coordinates(white, chosen, channels)
        support = [_support(series, chosen, number, channels) for number in range(len(chosen))]
        weakest = int(np.argmin(support))
        if support[weakest] >= _LEAST_SUPPORT and len(chosen) <= options.most_modes:
            break
        reason = ModeStatus.NO_SUPPORT if support[weakest] < _LEAST_SUPPORT else ModeStatus.TOO_MANY
        left_out.append((chosen.pop(weakest).frequency_hz, reason))
    for _ in range(_REFINEMENTS if chosen else 0):
        chosen = _refine_shapes(white, chosen, channels)
        series = _modal_coordinates(white, chosen, channels)
    found = []
    for number, cluster in enumerate(chosen):
        one = _estimate(series[:, number], chosen, number, channels)
        status = _judge(one)
        if status in (ModeStatus.OK, ModeStatus.DAMPING_UNKNOWN):
            found.append(Found(cluster, one, status, series[:, number]))
        else:
            left_out.append((cluster.frequency_hz, status))
    spectra = compute_spectra(white, channels.rate_hz)
    modes = make_modes(displacement, channels, found, poles=poles, spectra=spectra, left_out=left_out)
    return modes.assign_attrs(highest_order=poles.highest_order, order_asked=options.most_order)


def _drop_twins(
    white: FloatArray, clusters: Sequence[Cluster], channels: Channels, left_out: list[tuple[float, str]]
) -> list[Cluster]:
    """Clusters of which no two are the same mode: of a peak that was split in two, the better supported half stays."""
    alone = [_support(_modal_coordinates(white, [one], channels), [one], 0, channels) for one in clusters]
    kept: list[Cluster] = []
    for index in np.argsort(alone)[::-1]:
        one = clusters[int(index)]
        if any(_is_twin(one, other, channels) for other in kept):
            left_out.append((one.frequency_hz, ModeStatus.TWIN))
        else:
            kept.append(one)
    return sorted(kept, key=lambda one: one.frequency_hz)


def _is_twin(one: Cluster, other: Cluster, channels: Channels) -> bool:
    apart = abs(one.frequency_hz - other.frequency_hz)
    alike = compute_mac(one.shape[None], other.shape[None])[0, 0]
    return any(
        alike > mac and apart < max(near * other.frequency_hz, 4 / channels.duration_s) for mac, near in _ONE_MODE
    )


def _modal_coordinates(white: FloatArray, clusters: Sequence[Cluster], channels: Channels) -> FloatArray:
    """The record projected on each shape with all others taken out, shape (T, M).

    What vibrates outside the band that tells of a mode does not disturb it; taking out a shape like its own would only
    leave noise.
    """
    shapes = np.stack([cluster.shape.real for cluster in clusters], axis=1)
    alike = compute_mac(shapes.T.astype(complex), shapes.T.astype(complex))
    series = np.empty((len(white), len(clusters)))
    for number in range(len(clusters)):
        low, high = _band_of(clusters, number, channels)
        taken = [
            other
            for other, cluster in enumerate(clusters)
            if other == number or alike[number, other] < _ALIKE or low <= cluster.frequency_hz <= high
        ]
        series[:, number] = white @ np.linalg.pinv(shapes[:, taken])[taken.index(number)]
    return series


def _refine_shapes(white: FloatArray, clusters: Sequence[Cluster], channels: Channels) -> list[Cluster]:
    """Clusters with the shapes that the lines of their peaks show.

    In a record of few periods modes that have nothing to do with each other correlate by chance over the short lags of
    the subspace, and so shapes are mixtures. At a mode's own peak the others are weak, and what moves there with its
    coordinate is its shape. Only modes whose peaks overlap are told apart as before.
    """
    lines = np.fft.rfft(white, axis=0)
    hertz = np.asarray(np.fft.rfftfreq(len(white), 1 / channels.rate_hz), np.float64)
    coordinates = np.fft.rfft(_modal_coordinates(white, clusters, channels), axis=0)
    frequency, damping = (
        np.array([getattr(cluster, name) for cluster in clusters]) for name in ("frequency_hz", "damping_ratio")
    )
    peaks, refined = Peaks(frequency, damping, channels.duration_s), []
    for number, one in enumerate(clusters):
        near, beside = peaks.near(number, hertz), peaks.beside(number)
        shape = np.linalg.lstsq(coordinates[near][:, beside], lines[near], rcond=None)[0][0]
        shape = to_real(shape, one.shape)
        refined.append(replace(one, shape=shape, collinearity=compute_collinearity(shape)))
    return refined


def _support(series: FloatArray, clusters: Sequence[Cluster], number: int, channels: Channels) -> float:
    one = clusters[number]
    return compute_support(
        series[:, number],
        1 / channels.rate_hz,
        one.frequency_hz,
        damping_ratio=one.damping_ratio,
        band_hz=_band_of(clusters, number, channels),
    )


def _estimate(series: FloatArray, clusters: Sequence[Cluster], number: int, channels: Channels) -> Oscillation:
    one = clusters[number]
    return estimate_oscillation(
        series,
        1 / channels.rate_hz,
        one.frequency_hz,
        damping_ratio=one.damping_ratio,
        band_hz=_band_of(clusters, number, channels),
    )


def _band_of(clusters: Sequence[Cluster], number: int, channels: Channels) -> tuple[float, float]:
    """Frequencies about a mode that tell of it: its peak and some noise, up to half-way to its neighbours [Hz]."""
    one, line = clusters[number].frequency_hz, 1 / channels.duration_s
    half = np.clip(_WIDTHS * clusters[number].damping_ratio * one, _FEWEST_LINES / 2 * line, _MOST_LINES / 2 * line)
    low, high = max(one - half, 0.55 * one, channels.band_hz[0]), min(one + half, 1.6 * one, channels.band_hz[1])
    for other in (cluster.frequency_hz for cluster in clusters):
        middle = (one + other) / 2
        if other < one:
            low = max(low, min(middle, one - 4 * line))
        elif other > one:
            high = min(high, max(middle, one + 4 * line))
    return float(low), float(high)


def _judge(one: Oscillation) -> ModeStatus:
    frequency, damping = one.frequency_hz, one.damping_ratio
    if not one.inside or frequency.high - frequency.low > 2 * _WIDEST * frequency.value:
        return ModeStatus.FREQUENCY_UNKNOWN
    if damping.high < _DRIVEN:
        return ModeStatus.DRIVEN
    if damping.high - damping.low > _UNKNOWN_DAMPING * damping.value:
        return ModeStatus.DAMPING_UNKNOWN
    return ModeStatus.OK
