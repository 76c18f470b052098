"""Fusion of video and accelerometer: histories beside each other, and their spectra."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.outputs.plots.about import About
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION, plain_text, reduce_line
from vfm_sdm.signals.spectrum import amplitude_spectrum

__all__ = ["draw_fusion"]

_ROW_IN, _WIDTH_IN = 2.8, 13.0
_FRAMES_SHOWN = 30
"""Frames of the video in the close look."""


def draw_fusion(displacement: xr.Dataset, fused: xr.Dataset, about: About) -> Figure:
    """Of every axis the whole history, a close look where it moves most, and both spectra.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    fused
        Of `vfm_sdm.analysis.fusion.fuse`, shape (N, A) [mm].
    about
        What is said of the run.
    """
    axes = [str(axis) for axis in fused["axis"].values]
    point, sensor = str(fused.attrs["point"]), str(fused.attrs["sensor"])
    figure = Figure(figsize=(_WIDTH_IN, 1.2 + _ROW_IN * len(axes)), layout="constrained")
    figure.suptitle(
        plain_text(f"{about.named(point)} with sensor {sensor}: {about.line}"), ha="left", x=0.01, fontsize="medium"
    )
    panels = figure.subplots(len(axes), 3, squeeze=False, gridspec_kw={"width_ratios": [1.6, 1.2, 1.0]})
    seen = displacement.sel(point=[point])
    values = trusted_values(seen.transpose("time", "point", "axis", ...), "displacement")[:, 0]
    frames = displacement["time"].values
    for row, axis in zip(panels, axes, strict=True):
        video = values[:, list(displacement["axis"].values).index(axis)]
        one = fused.sel(axis=axis)
        _draw_history(frames, video, one, row[0], None)
        _draw_history(frames, video, one, row[1], _liveliest(one, frames))
        _draw_spectra(frames, video, one, row[2])
        row[0].set_title(axis, loc="left", fontsize="small")
    panels[0, 1].legend(fontsize="small", frameon=False, loc="best")
    panels[0, 2].legend(fontsize="small", frameon=False)
    return figure


def _liveliest(one: xr.Dataset, frames: np.ndarray) -> tuple[float, float] | None:
    """The second or so in which the fused displacement moves fastest [s]."""
    time_s, values = one["time"].values, one["displacement"].values
    if time_s.size < 3 or frames.size < 2:
        return None
    speed = np.abs(np.nan_to_num(np.diff(values)))
    length = _FRAMES_SHOWN * float(np.median(np.diff(frames)))
    count = max(int(length / float(np.median(np.diff(time_s)))), 1)
    energy = np.convolve(speed**2, np.ones(min(count, speed.size)), "valid")
    begin = float(time_s[int(np.argmax(energy))])
    return begin, begin + length


def _draw_history(
    frames: np.ndarray, video: np.ndarray, one: xr.Dataset, axes: Axes, window: tuple[float, float] | None
) -> None:
    time_s, values, std = one["time"].values, one["displacement"].values, one["displacement_std"].values
    if window is None:
        axes.plot(*reduce_line(frames, video), color=GREY, linewidth=0.6)
        axes.plot(*reduce_line(time_s, values), color=BLUE, linewidth=0.7)
        bridged = one["status"].values == 1
        if bridged.any():
            axes.plot(time_s, np.where(bridged, values, np.nan), color=VERMILION, linewidth=1.0, label="bridged")
            axes.legend(fontsize="small", frameon=False)
    else:
        seen = (frames >= window[0]) & (frames <= window[1])
        inside = (time_s >= window[0]) & (time_s <= window[1])
        low, high = ((values + sign * 2 * std)[inside] for sign in (-1, 1))
        axes.fill_between(time_s[inside], low, high, color=BLUE, alpha=0.25, linewidth=0, label="95 %")
        axes.plot(time_s[inside], values[inside], color=BLUE, linewidth=1.0, label="fused")
        axes.plot(frames[seen], video[seen], color=ORANGE, marker="o", markersize=3, linestyle="none", label="video")
        axes.set_xlim(*window)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("displacement [mm]")


def _draw_spectra(frames: np.ndarray, video: np.ndarray, one: xr.Dataset, axes: Axes) -> None:
    for time_s, values, color, label in (
        (frames, video, ORANGE, "video"),
        (one["time"].values, one["displacement"].values, BLUE, "fused"),
    ):
        frequency_hz, amplitude = amplitude_spectrum(time_s, values)
        if frequency_hz.size:
            axes.loglog(frequency_hz, amplitude, color=color, linewidth=0.8, label=label)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
