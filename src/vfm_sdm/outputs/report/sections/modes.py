"""Modes: frequencies, damping and shapes, with the diagram they were chosen from."""

import numpy as np
import xarray as xr

from vfm_sdm.core.statuses import ModeStatus
from vfm_sdm.outputs.report.content import Block, Cell, Figure, Paragraph, Section, Table
from vfm_sdm.outputs.report.drawing import Drawing, Panel
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import UNKNOWN, Language, count_decimals
from vfm_sdm.outputs.report.sections.outdated import warn_outdated
from vfm_sdm.outputs.results.universal_modes import trace_order
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["describe_modes"]

_BLUE, _ORANGE, _GREY = "#0072B2", "#D55E00", "#bbbbbb"
_LEFT, _RIGHT, _HEIGHT, _ROW = 60.0, 20.0, 250.0, 90.0
_ANY = 1e-30
_DRAWN = (("vertical", _BLUE, -1), ("lateral", _ORANGE, 1), ("down", _BLUE, -1), ("forward", _ORANGE, 1))
"""Axes of the structure, or of the reference camera, their colours, and the sign that is upwards in a drawing."""


def describe_modes(inputs: ReportInputs, language: Language) -> Section | None:
    """Frequencies, damping and shapes with the settings; nothing where no modes were looked for.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    modes = inputs.modes
    if modes is None:
        return None
    blocks: list[Block] = [*warn_outdated(inputs, modes, "modes", language)]
    if "band_hz" in modes.attrs:
        blocks.append(Paragraph(_tell_settings(modes, language)))
    if not modes.sizes["mode"]:
        return Section(language.say("title modes"), (*blocks, Paragraph(language.say("modes none"))))
    blocks.append(_tabulate(modes, language))
    if "status" in modes:
        short = np.flatnonzero(modes["status"].values == str(ModeStatus.DAMPING_UNKNOWN)) + 1
        if short.size:
            blocks.append(Paragraph(language.say("modes short", modes=", ".join(map(str, short))), "care"))
    if "pole_frequency" in modes:
        blocks.append(Figure(language.say("figure stabilisation"), _draw_stabilisation(modes, language)))
    blocks.append(_tabulate_shapes(modes, language))
    if "position" in modes and len(trace_order(modes["position"].values)) > 1:
        blocks.append(Figure(language.say("figure shapes"), _draw_shapes(modes, language)))
    return Section(language.say("title modes"), tuple(blocks))


def _tell_settings(modes: xr.Dataset, language: Language) -> str:
    low, high = modes.attrs["band_hz"]
    numbers = {
        "duration": modes.attrs["duration_s"], "rate": modes.attrs["sampling_rate_hz"], "low": low, "high": high
    }  # fmt: skip
    shown = {name: language.digits(value, 4).text for name, value in numbers.items()}
    axes = ", ".join(language.word("axis", str(name)) for name in modes.attrs["axes"].split(", "))
    order = modes.attrs["highest_order"]
    return language.say("modes settings", channels=modes.attrs["channels"], axes=axes, order=order, **shown)


def _tabulate(modes: xr.Dataset, language: Language) -> Table:
    has_ends = "frequency_low" in modes
    rows = []
    for number in range(modes.sizes["mode"]):
        one = modes.isel(mode=number)
        cells: list[Cell] = []
        for name, factor in (("frequency", 1.0), ("damping_ratio", 100.0)):
            value = factor * float(one[name])
            std = factor * float(one[f"{name}_std"]) if f"{name}_std" in one else np.nan
            decimals = count_decimals(COVERAGE_FACTOR * std, 2) if np.isfinite(std) and std > 0 else 3
            shown = language.cell(value, decimals)
            if has_ends:
                ends = (language.write(factor * float(one[f"{name}_{end}"]), decimals) for end in ("low", "high"))
                cells += [shown, Cell(" … ".join(ends))]
                continue
            if shown.text != UNKNOWN and np.isfinite(std):
                shown = Cell(f"{shown.text} ± {language.write(COVERAGE_FACTOR * std, decimals)}", value)
            cells.append(shown)
        if has_ends:
            cells += [language.cell(float(one["collinearity"]), 2), language.digits(float(one["rms"]), 3)]
        rows.append((Cell(str(number + 1)), *cells))
    columns: tuple[str, ...] = ("mode", "frequency hz", "damping percent")
    if has_ends:
        columns = ("mode", "frequency hz", "mode interval", "damping percent", "mode interval", "mode mpc", "mode rms")
    return Table(language.say("table modes"), tuple(language.say(name) for name in columns), tuple(rows))


def _tabulate_shapes(modes: xr.Dataset, language: Language) -> Table:
    shapes = []
    for point in modes["point"].values:
        for axis in modes["axis"].values:
            values = np.atleast_1d(modes["shape"].sel(point=point, axis=axis).values)
            cells = [
                Cell(
                    f"{language.write(abs(v), 3)} ∠ {language.write(float(np.degrees(np.angle(v))), 0)}°", float(abs(v))
                )
                if np.isfinite(v)
                else Cell(UNKNOWN)
                for v in values
            ]
            shapes.append((Cell(str(point)), Cell(language.word("axis", str(axis))), *cells))
    heads = (language.say("point"), language.say("axis"), *(str(n + 1) for n in range(modes.sizes["mode"])))
    return Table(language.say("table shapes"), heads, tuple(shapes), words=2)


def _draw_stabilisation(modes: xr.Dataset, language: Language) -> str:
    low, high = modes.attrs["band_hz"]
    drawing = Drawing(_HEIGHT, language.say("figure stabilisation"))
    box = (_LEFT, 14.0, drawing.width - _RIGHT, _HEIGHT - 36)
    span = (0.0, 1.03 * high)
    order = Panel(drawing, box, span, (0.0, 1.1 * modes.attrs["highest_order"]), language)
    order.frame(x_label=language.say("modes hertz"), y_label=language.say("modes order"))
    line = modes["line_frequency"].values
    inside = (line > low) & (line < high)
    level = 10 * np.log10(np.maximum(modes["singular_value"].values[inside, 0], _ANY))
    spectrum = Panel(drawing, box, span, (float(level.min()) - 10, float(level.max()) + 3), language)
    drawing.line(spectrum.place(line[inside], level), _BLUE, width=1.1)
    # What lies beyond the band is not drawn.
    for place, of_mode, hertz in zip(
        order.place(modes["pole_frequency"].values, modes["pole_order"].values),
        modes["pole_mode"].values >= 0, modes["pole_frequency"].values, strict=True,
    ):  # fmt: skip
        if hertz <= span[1]:
            drawing.dot(place, 2.0 if of_mode else 1.4, _ORANGE if of_mode else _GREY, filled=bool(of_mode))
    return drawing.svg()


def _draw_shapes(modes: xr.Dataset, language: Language) -> str:
    count = modes.sizes["mode"]
    places = modes["position"].transpose("point", "axis").values
    points = trace_order(places)
    along = places[points][:, int(np.argmax(np.ptp(places[points], axis=0)))]
    edge = 0.03 * float(np.ptp(along)) or 1.0
    drawing = Drawing(_ROW * count + 34, language.say("figure shapes"))
    for number in range(count):
        one = modes.isel(mode=number)
        top = _ROW * number + 18
        box = (_LEFT, top, drawing.width - _RIGHT, top + _ROW - 24)
        panel = Panel(drawing, box, (float(along.min()) - edge, float(along.max()) + edge), (-1.15, 1.15), language)
        last = number == count - 1
        panel.frame(x_label=language.say("modes along") if last else "", x_numbers=last, y_ticks=0)
        drawing.line(panel.place(panel.x_range, [0.0, 0.0]), _GREY, width=0.8)
        hertz = language.write(float(one["frequency"]), 3)
        drawing.text(_LEFT, top - 5, language.say("mode line", mode=number + 1, hertz=hertz), size=10.5)
        for axis, colour, up in _DRAWN:
            if axis not in one["axis"].values:
                continue
            shape = up * one["shape"].sel(axis=axis).values.real[points]
            known = np.isfinite(shape)
            if known.any():
                corners = panel.place(along[known], shape[known])
                drawing.line(corners, colour, width=1.3)
                for corner in corners:
                    drawing.dot(corner, 2.2, colour)
    return drawing.svg()
