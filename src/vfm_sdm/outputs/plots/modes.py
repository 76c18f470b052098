"""Modes: the diagram they were chosen from, their shapes, and films of them."""

from io import BytesIO

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from vfm_sdm.core.arrays import ComplexArray, FloatArray
from vfm_sdm.outputs.plots.about import About
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION, plain_text
from vfm_sdm.outputs.results.universal_modes import trace_order

__all__ = ["animate_mode", "draw_shapes", "draw_stabilisation"]

_MOST = 8
_FRAMES, _PERIOD_MS = 24, 1500
_REACH = 0.12
"""Largest displacement in a picture of a shape, over the length of the structure."""


def draw_stabilisation(modes: xr.Dataset, about: About) -> Figure:
    """Singular values of the spectra, and above them the poles by order: which are stable, and which are modes.

    Parameters
    ----------
    modes
        Of `vfm_sdm.analysis.modal.identify_modes`.
    about
        What is said of the run.
    """
    figure = Figure(figsize=(13.0, 6.5), layout="constrained")
    figure.suptitle(plain_text(f"modes: {about.line}"), ha="left", x=0.01, fontsize="medium")
    spectrum = figure.subplots()
    for rank in range(modes.sizes["rank"]):
        level = 10 * np.log10(np.maximum(modes["singular_value"].isel(rank=rank).values, 1e-30))
        spectrum.plot(
            modes["line_frequency"], level, color=(BLUE, GREY, "#999999")[rank], linewidth=1.2 - 0.3 * rank,
            label=f"singular value {rank + 1}",
        )  # fmt: skip
    low, high = modes.attrs["band_hz"]
    inside = (modes["line_frequency"].values > low) & (modes["line_frequency"].values < high)
    first = 10 * np.log10(np.maximum(modes["singular_value"].values[inside, 0], 1e-30))
    spectrum.set_ylim(first.min() - 20, first.max() + 5)
    spectrum.set_xlim(0, 1.05 * modes.attrs["band_hz"][1])
    spectrum.set_xlabel("frequency [Hz]")
    spectrum.set_ylabel("singular values, over the displacement's noise [dB/Hz]")
    poles = spectrum.twinx()
    stable, of_mode = modes["pole_stable"].values > 0, modes["pole_mode"].values >= 0
    for which, colour, marker, label in (
        (~stable, "#bbbbbb", ".", "pole"), (stable & ~of_mode, ORANGE, "+", "stable pole"),
        (of_mode, VERMILION, "o", "stable pole of a mode"),
    ):  # fmt: skip
        poles.plot(
            modes["pole_frequency"].values[which], modes["pole_order"].values[which], marker, color=colour,
            markersize=4, linestyle="none", label=label,
        )  # fmt: skip
    for hertz in modes["frequency"].values:
        poles.axvline(hertz, color=VERMILION, linewidth=0.8, linestyle=":")
        poles.annotate(
            f"{hertz:.3f}", (hertz, 1.0), xycoords=("data", "axes fraction"), rotation=90, va="top", ha="right",
            fontsize="small", color=VERMILION,
        )  # fmt: skip
    poles.set_ylim(0, 1.12 * modes.attrs["highest_order"])
    poles.set_ylabel("order of the model")
    handles = [*spectrum.get_legend_handles_labels()[0], *poles.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize="small", frameon=False)
    return figure


def draw_shapes(modes: xr.Dataset, about: About) -> Figure:
    """Shapes of the modes in elevation (vertical) and in plan (lateral), along the structure.

    Along the axes of a camera or a picture, where displacement is along these; by point, where places are not known.

    Parameters
    ----------
    modes
        Of `vfm_sdm.analysis.modal.identify_modes`.
    about
        What is said of the run.
    """
    count = min(modes.sizes["mode"], _MOST)
    figure = Figure(figsize=(13.0, 1.0 + 1.9 * count), layout="constrained")
    figure.suptitle(plain_text(f"mode shapes: {about.line}"), ha="left", x=0.01, fontsize="medium")
    panels = figure.subplots(count, 2, squeeze=False, sharex=True)
    for row, number in zip(panels, range(count), strict=True):
        one = modes.isel(mode=number)
        title = (
            f"{int(one['mode'])}: {float(one['frequency']):.3f} Hz, damping {100 * float(one['damping_ratio']):.2f} %"
        )
        for axes, (axis, what) in zip(row, _shown_axes(one), strict=True):
            _draw_shape(axes, one, axis)
            axes.set_title(f"{title}, {what}{axis}", loc="left", fontsize="small")
    placed = bool(trace_order(modes["position"].transpose("point", "axis").values))
    for axes in panels[-1]:
        axes.set_xlabel("along the structure [m]" if placed else "point")
    return figure


def _shown_axes(modes: xr.Dataset) -> tuple[tuple[str, str], tuple[str, str]]:
    """Axes of the two columns, and what each shows of a structure."""
    names = [str(name) for name in modes["axis"].values]
    if "vertical" in names:
        return ("vertical", "elevation: "), ("lateral", "plan: ")
    return ("down", ""), (names[-1] if names[-1] != "down" else names[0], "")


def _draw_shape(axes: Axes, one: xr.Dataset, axis: str) -> None:
    places = one["position"].transpose("point", "axis").values
    order = trace_order(places) or list(range(len(places)))
    along = _along(places)
    axes.axhline(0, color=GREY, linewidth=0.6)
    if axis not in one["axis"].values:
        return
    shape, std = one["shape"].sel(axis=axis).values.real, one["shape_std"].sel(axis=axis).values
    known = [i for i in order if np.isfinite(shape[i])]
    axes.errorbar(
        along[known], shape[known], yerr=2 * std[known], color=BLUE, marker="o", markersize=5, capsize=3, linewidth=1.2
    )
    unknown = [i for i in order if not np.isfinite(shape[i])]
    axes.plot(along[unknown], np.zeros(len(unknown)), "x", color=GREY)
    axes.set_ylim(-1.25, 1.25)
    if axis in ("vertical", "down"):
        axes.invert_yaxis()  # positive is down
    axes.set_ylabel("shape [1]")


def _along(places: FloatArray) -> FloatArray:
    """Places along the longest extent of the structure [m], NaN of unknown points; numbers where all are unknown."""
    known = places[np.isfinite(places).all(axis=1)]
    if not len(known):
        return np.arange(1.0, len(places) + 1)
    return np.asarray(places[:, int(np.argmax(np.ptp(known, axis=0)))])


def animate_mode(one: xr.Dataset, about: About) -> bytes:
    """A film of one mode in space, one period, as an animated GIF.

    Parameters
    ----------
    one
        One mode of `vfm_sdm.analysis.modal.identify_modes`.
    about
        What is said of the run.
    """
    places = one["position"].transpose("point", "axis").values
    shape = np.nan_to_num(one["shape"].transpose("point", "axis").values)
    known = np.isfinite(one["shape"].values).any(axis=1)
    order = [i for i in trace_order(places) if known[i]]
    others = [i for i in trace_order(places) if not known[i]]
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    shown = places[[*order, *others]]
    size = max(float(np.max(np.ptp(shown, axis=0))), 1e-3) if len(shown) else 1.0
    middle = (shown.max(axis=0) + shown.min(axis=0)) / 2 if len(shown) else np.zeros(3)
    pictures = []
    for phase in np.arange(_FRAMES) / _FRAMES:
        axes.clear()
        moved = places + _REACH * size * (shape * np.exp(2j * np.pi * phase)).real
        for at, style in (
            (places, {"color": GREY, "linewidth": 0.8, "marker": "."}),
            (moved, {"color": BLUE, "marker": "o"}),
        ):
            axes.plot(*_drawn(at[order]), **style)
        axes.plot(*_drawn(places[others]), "x", color=GREY)
        _fix(axes, middle, size)
        axes.set_title(
            plain_text(f"{about.session} mode {int(one['mode'])}: {float(one['frequency']):.3f} Hz".strip()),
            fontsize="small",
        )
        canvas.draw()  # type: ignore[no-untyped-call]
        drawn = np.asarray(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
        pictures.append(Image.fromarray(drawn).quantize(64))
    buffer = BytesIO()
    pictures[0].save(
        buffer, format="GIF", save_all=True, append_images=pictures[1:], duration=_PERIOD_MS // _FRAMES, loop=0
    )
    return buffer.getvalue()


def _drawn(places: FloatArray | ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Longitudinal, lateral and upwards, as a picture in space has them."""
    return places[:, 2].real, places[:, 0].real, -places[:, 1].real


def _fix(axes: Axes, middle: FloatArray, size: float) -> None:
    half = 0.55 * size
    axes.set(xlim=(middle[2] - half, middle[2] + half), ylim=(middle[0] - half / 2, middle[0] + half / 2))
    axes.set(zlim=(-middle[1] - half / 2, -middle[1] + half / 2), box_aspect=(2, 1, 1))
    axes.set(xlabel="longitudinal [m]", ylabel="lateral [m]", zlabel="up [m]")
