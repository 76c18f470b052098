"""Modes as a dataset: what is told of each, where each point goes, and the diagram they were chosen from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.analysis.modal.oscillation import Oscillation, Spread
from vfm_sdm.analysis.modal.poles import Cluster, Poles
from vfm_sdm.analysis.modal.shapes import Peaks, compute_mac, to_real
from vfm_sdm.analysis.modal.signals import DETRENDING, Channels
from vfm_sdm.analysis.modal.spectra import Spectra
from vfm_sdm.core.arrays import ComplexArray, FloatArray
from vfm_sdm.core.statuses import ModeStatus

__all__ = ["METHOD", "Found", "make_modes"]

METHOD = "SSI-cov (pyOMA-2), stable poles; frequency, damping and 95 % intervals by the likelihood of each mode"

_PEAK_NEAR, _PEAK_LIKE = 0.1, 0.7
"""How near in frequency (relative) and how alike in shape (MAC) a peak of the spectrum must be to be a mode's."""


@dataclass(frozen=True, eq=False)
class Found:
    """A mode.

    Parameters
    ----------
    cluster
        Its stable poles.
    oscillation
        Frequency and damping.
    status
        What is known of it.
    series
        Its modal coordinate, shape (T,), in units of noise for a shape of unit length.
    """

    cluster: Cluster
    oscillation: Oscillation
    status: ModeStatus
    series: FloatArray


def make_modes(
    displacement: xr.Dataset,
    channels: Channels,
    found: Sequence[Found],
    *,
    poles: Poles,
    spectra: Spectra,
    left_out: Sequence[tuple[float, str]],
) -> xr.Dataset:
    """The dataset of modes of `identify_modes`.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    channels
        What was analysed.
    found
        M modes.
    poles, spectra
        What the diagram shows.
    left_out
        Frequency [Hz] of every candidate that is no mode, and why.
    """
    size = (len(found), displacement.sizes["point"], displacement.sizes["axis"])
    shape, std = np.full(size, np.nan + 0j), np.full(size, np.nan)
    rms, fdd = np.full(len(found), np.nan), np.full(len(found), np.nan)
    for number, one in enumerate(found):
        mean, scatter = _scaled_shape(channels, one, found)
        shape[number, channels.place[:, 0], channels.place[:, 1]] = mean
        std[number, channels.place[:, 0], channels.place[:, 1]] = scatter
        reach = np.abs(one.cluster.shape.real * channels.noise_mm).max()
        rms[number] = reach * np.sqrt(np.mean(one.series**2))
        fdd[number] = _peak(spectra, one.cluster)
    in_mode = np.full(len(poles.order), -1)
    for number, one in enumerate(found):
        in_mode[one.cluster.members] = number
    variables = {
        **_by_mode("frequency", "Hz", [one.oscillation.frequency_hz for one in found]),
        **_by_mode("damping_ratio", "1", [one.oscillation.damping_ratio for one in found]),
        "shape": (("mode", "point", "axis"), shape, {"units": "1"}),
        "shape_std": (("mode", "point", "axis"), std, {"units": "1"}),
        "status": ("mode", np.array([str(one.status) for one in found], dtype=object)),
        "collinearity": ("mode", np.array([one.cluster.collinearity for one in found]), {"units": "1"}),
        "support": ("mode", np.array([one.oscillation.support for one in found]), {"units": "1"}),
        "rms": ("mode", rms, {"units": "mm"}),
        "frequency_fdd": ("mode", fdd, {"units": "Hz"}),
        "mac": (("mode", "other"), _mac(shape), {"units": "1"}),
        "position": (("point", "axis"), _median_position(displacement), {"units": "m"}),
        "pole_frequency": ("pole", poles.frequency_hz, {"units": "Hz"}),
        "pole_damping_ratio": ("pole", poles.damping_ratio, {"units": "1"}),
        "pole_order": ("pole", np.asarray(poles.order)),
        "pole_stable": ("pole", poles.stable.astype(np.int8)),
        "pole_mode": ("pole", in_mode),
        "singular_value": (("line", "rank"), spectra.singular_values, {"units": "1/Hz"}),
        "line_frequency": ("line", spectra.frequency_hz, {"units": "Hz"}),
    }
    attrs = {
        "method": METHOD,
        "sampling_rate_hz": channels.rate_hz,
        "band_hz": list(channels.band_hz),
        "detrending": DETRENDING,
        "duration_s": channels.duration_s,
        "channels": len(channels.place),
        "axes": ", ".join(str(displacement["axis"].values[a]) for a in np.unique(channels.place[:, 1])),
        "filled_share": channels.filled,
        "frame": displacement.attrs.get("frame", ""),
        "displacement_key": str(displacement.attrs.get("key", "")),
        "left_out": [{"frequency_hz": hertz, "reason": str(reason)} for hertz, reason in sorted(left_out)],
    }
    coords = {"mode": np.arange(1, len(found) + 1), **{dim: displacement[dim].values for dim in ("point", "axis")}}
    return xr.Dataset(variables, coords, attrs)


def _by_mode(name: str, units: str, spreads: Sequence[Spread]) -> dict[str, Any]:
    parts = {"": "value", "_std": "std", "_low": "low", "_high": "high"}
    return {
        name + ending: ("mode", np.array([getattr(one, part) for one in spreads], dtype=float), {"units": units})
        for ending, part in parts.items()
    }


def _scaled_shape(channels: Channels, one: Found, found: Sequence[Found]) -> tuple[ComplexArray, FloatArray]:
    """Shape with its largest entry 1, and its standard deviation by what else moves near its frequency."""
    white = channels.values / channels.noise_mm
    peaks = Peaks(
        np.array([other.oscillation.frequency_hz.value for other in found]),
        np.array([other.oscillation.damping_ratio.value for other in found]),
        channels.duration_s,
    )
    hertz = np.asarray(np.fft.rfftfreq(len(white), 1 / channels.rate_hz), np.float64)
    near = peaks.near(found.index(one), hertz)
    beside = [found[number] for number in peaks.beside(found.index(one))]
    lines = np.fft.rfft(white, axis=0)[near]
    series = np.fft.rfft(np.stack([other.series for other in beside], axis=1), axis=0)[near]
    own = series[:, 0]
    left = lines - series @ np.stack([other.cluster.shape for other in beside])
    scatter = np.sqrt((np.abs(left) ** 2).mean(axis=0) / (np.abs(own) ** 2).sum())
    scaled = to_real(one.cluster.shape * channels.noise_mm)
    factor = np.linalg.norm(one.cluster.shape * channels.noise_mm) / np.linalg.norm(one.cluster.shape)
    largest = np.abs(scaled).max()
    return scaled / largest, scatter * channels.noise_mm / (factor * largest)


def _peak(spectra: Spectra, cluster: Cluster) -> float:
    """Peak of the first singular value about a mode, where its shape is like the mode's [Hz]; NaN without one."""
    like = compute_mac(spectra.first, cluster.shape[None])[:, 0]
    near = (np.abs(spectra.frequency_hz / cluster.frequency_hz - 1) < _PEAK_NEAR) & (like > _PEAK_LIKE)
    if not near.any():
        return float("nan")
    return float(spectra.frequency_hz[np.where(near, spectra.singular_values[:, 0], -np.inf).argmax()])


def _mac(shape: ComplexArray) -> FloatArray:
    flat = shape.reshape(len(shape), int(np.prod(shape.shape[1:])))
    return compute_mac(flat, flat)


def _median_position(displacement: xr.Dataset) -> FloatArray:
    position = displacement["position"].transpose("time", "point", "axis").values
    result = np.full(position.shape[1:], np.nan)
    known = np.isfinite(position).any(axis=0)
    result[known] = np.nanmedian(position[:, known], axis=0)
    return result
