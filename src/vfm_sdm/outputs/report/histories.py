"""Drawings of histories and spectra: one a point, and overviews of many points."""

from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, mean_of_known
from vfm_sdm.outputs.plots.drawing import AXIS_COLOURS, GREY
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, Panel, shorten, span_of
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language
from vfm_sdm.outputs.report.series import SeriesValues

__all__ = ["draw_overview", "draw_point", "draw_spans", "overview_pages"]

_LEFT, _MIDDLE, _SPECTRUM = 62.0, 470.0, 540.0
_RIGHT = WIDTH - 12.0
_PANEL, _GAP, _TOP, _BOTTOM = 76.0, 12.0, 10.0, 34.0
_NAMES = 112.0
_ROW = 15.0
_ROWS_OF_PAGE = 45
_COLUMNS = 300


def draw_point(inputs: ReportInputs, point: str, language: Language) -> str:
    """History and spectrum of a point, an axis below the other, as SVG.

    Parameters
    ----------
    inputs
        Files of the run.
    point
        Name of the point.
    language
        Language of the texts.
    """
    axes = inputs.axis_names
    height = _TOP + len(axes) * (_PANEL + _GAP) + _BOTTOM
    drawing = Drawing(height, language.say("figure history label", point=point))
    for number, axis in enumerate(axes):
        of_axis, colour = inputs.series[point, axis], AXIS_COLOURS[number % len(AXIS_COLOURS)]
        top = _TOP + number * (_PANEL + _GAP)
        last = number == len(axes) - 1
        _draw_history(drawing, (_LEFT, top, _MIDDLE, top + _PANEL), of_axis, colour, language, last=last)
        _draw_spectrum(drawing, (_SPECTRUM, top, _RIGHT, top + _PANEL), of_axis, colour, language, last=last)
    return drawing.svg()


def _draw_history(
    drawing: Drawing,
    box: tuple[float, float, float, float],
    of_axis: SeriesValues,
    colour: str,
    language: Language,
    *,
    last: bool,
) -> None:
    curve = of_axis.curve
    times = span_of([curve.time_s], margin=0.0) if curve.time_s.size > 1 else (0.0, 1.0)
    panel = Panel(drawing, box, times, span_of([curve.band_lowest, curve.band_highest]), language)
    name = language.word("axis", of_axis.axis)
    panel.frame(x_label=language.say("time s") if last else "", y_label=f"{name} [mm]", x_numbers=last, y_ticks=4)
    panel.band(curve.time_s, curve.band_lowest, curve.band_highest, colour)
    panel.curve(curve.time_s, curve.lowest, curve.highest, colour)


def _draw_spectrum(
    drawing: Drawing,
    box: tuple[float, float, float, float],
    of_axis: SeriesValues,
    colour: str,
    language: Language,
    *,
    last: bool,
) -> None:
    frequency_hz, amplitude = of_axis.spectrum
    left, top, right, bottom = box
    if not frequency_hz.size:
        drawing.text((left + right) / 2, (top + bottom) / 2, language.say("no spectrum"), anchor="middle", colour=GREY)
        return
    highest = float(amplitude.max()) or 1.0
    panel = Panel(drawing, box, (0.0, float(frequency_hz[-1])), (0.0, 1.08 * highest), language)
    panel.frame(x_label=language.say("frequency hz") if last else "", x_numbers=last, y_ticks=3)
    dominant = of_axis.summary["dominant_frequency_hz"]
    if dominant is not None:
        x = float(panel.place([dominant], [0.0])[0, 0])
        drawing.line([[x, top], [x, bottom]], GREY, width=0.8, dash="3 2")
        late = dominant > 0.6 * float(frequency_hz[-1])
        shown = f"{language.write(dominant, 2)} Hz"
        drawing.text(x + (-4 if late else 4), top + 9, shown, size=10, colour=GREY, anchor="end" if late else "start")
    panel.curve(frequency_hz, amplitude, amplitude, colour)


def draw_overview(inputs: ReportInputs, axis: str, points: tuple[str, ...], language: Language) -> str:
    """Histories and spectra of many points along one axis, a line each on one scale, as SVG.

    Parameters
    ----------
    inputs
        Files of the run.
    axis
        Name of the axis.
    points
        Points that are drawn, from above.
    language
        Language of the texts.
    """
    height = _TOP + 14 + _ROW * (len(points) + 1) + _BOTTOM
    drawing = Drawing(height, language.say("figure overview label", axis=language.word("axis", axis)))
    chosen = [inputs.series[point, axis] for point in points]
    spans = [_half_span(one.curve.lowest, one.curve.highest) for one in chosen]
    # The liveliest touches the lines above and below it; the others are drawn to the same scale.
    scale = 0.5 * _ROW / max(max(spans, default=0.0), 1e-9)
    top, bottom = _TOP + 14.0, height - _BOTTOM
    times = span_of([one.curve.time_s for one in chosen], margin=0.0)
    hertz = max((float(one.spectrum[0][-1]) for one in chosen if one.spectrum[0].size), default=1.0)
    histories = Panel(drawing, (_NAMES, top, _MIDDLE, bottom), times, (0.0, 1.0), language)
    spectra = Panel(drawing, (_SPECTRUM - 50, top, _RIGHT, bottom), (0.0, hertz), (0.0, 1.0), language)
    histories.frame(x_label=language.say("time s"), y_ticks=0)
    spectra.frame(x_label=language.say("frequency hz"), y_ticks=0)
    tallest = max((float(one.spectrum[1].max()) for one in chosen if one.spectrum[1].size), default=1.0) or 1.0
    colour = AXIS_COLOURS[inputs.axis_names.index(axis) % len(AXIS_COLOURS)]
    for row, one in enumerate(chosen):
        y = top + _ROW * (row + 1)
        name = one.point + (" *" if one.point in inputs.static else "")
        drawing.text(_NAMES - 6, y + 3.5, shorten(name, _NAMES - 8, 10), anchor="end", size=10)
        middle = _middle(one.curve.lowest, one.curve.highest)
        _draw_line(histories, (one.curve.time_s, one.curve.lowest, one.curve.highest), (y, scale, middle), colour)
        frequency_hz, amplitude = one.spectrum
        _draw_line(spectra, (frequency_hz, amplitude, amplitude), (y + 0.4 * _ROW, 0.9 * _ROW / tallest, 0.0), colour)
    _draw_scale(drawing, scale, language)
    return drawing.svg()


def overview_pages(points: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Points of each overview, as many as fit a page.

    Parameters
    ----------
    points
        All points.
    """
    return [points[first : first + _ROWS_OF_PAGE] for first in range(0, len(points), _ROWS_OF_PAGE)]


def _half_span(lowest: FloatArray, highest: FloatArray) -> float:
    """Largest distance of a curve from its middle [mm]."""
    if not np.isfinite(lowest).any():
        return 0.0
    middle = _middle(lowest, highest)
    return float(max(np.nanmax(highest) - middle, middle - np.nanmin(lowest)))


def _middle(lowest: FloatArray, highest: FloatArray) -> float:
    return float(mean_of_known((lowest + highest) / 2))


def _draw_line(
    panel: Panel, limits: tuple[FloatArray, FloatArray, FloatArray], base: tuple[float, float, float], colour: str
) -> None:
    """A curve of columns and their limits; its base line is given by place, units of the drawing a mm, and value."""
    x, lowest, highest = _thin(*limits)
    y, scale, middle = base
    left, _, right, _ = panel.box
    # A panel of the line's own, whose unit is that of the drawing.
    own = replace(panel, box=(left, y - 1, right, y), y_range=(middle, middle + 1 / scale))
    own.curve(x, lowest, highest, colour, width=0.7)


def _thin(x: FloatArray, lowest: FloatArray, highest: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Limits in fewer columns: an overview is narrower, and has many lines."""
    share = -(-x.size // _COLUMNS)
    if share < 2:
        return x, lowest, highest
    starts = np.arange(0, x.size, share)
    return x[starts], np.fmin.reduceat(lowest, starts), np.fmax.reduceat(highest, starts)


def _draw_scale(drawing: Drawing, scale: float, language: Language) -> None:
    """A bar of a round length in mm, above the histories."""
    length_mm = 10.0 ** np.floor(np.log10(_ROW / scale))
    length_mm *= next(factor for factor in (5, 2, 1) if factor * length_mm * scale <= _ROW)
    x, y = _NAMES + 6, _TOP + 12.0
    drawing.line([[x, y], [x, y - length_mm * scale]], "#222222", width=2)
    drawing.text(x + 6, y - 2, language.digits(length_mm, 1, "mm").text, size=10)


def draw_spans(inputs: ReportInputs, points: tuple[str, ...], language: Language) -> str:
    """Peak-to-peak of many points along every axis with their expanded uncertainty, as SVG.

    Parameters
    ----------
    inputs
        Files of the run.
    points
        Points that are drawn, from above.
    language
        Language of the texts.
    """
    axes = inputs.axis_names
    height = _TOP + 16 + _ROW * (len(points) + 1) + _BOTTOM
    drawing = Drawing(height, language.say("figure spans label"))
    top, bottom = _TOP + 16.0, height - _BOTTOM
    width = (_RIGHT - _NAMES - 24 * (len(axes) - 1)) / len(axes)
    for row, point in enumerate(points):
        name = point + (" *" if point in inputs.static else "")
        drawing.text(_NAMES - 6, top + _ROW * (row + 1) + 3.5, shorten(name, _NAMES - 8, 10), anchor="end", size=10)
    for number, axis in enumerate(axes):
        colour = AXIS_COLOURS[number % len(AXIS_COLOURS)]
        stated = [inputs.series[point, axis].summary for point in points]
        spans = np.array([np.nan if s["peak_to_peak_mm"] is None else s["peak_to_peak_mm"] for s in stated])
        halves = np.array([s["expanded_uncertainty_mm"] or 0.0 for s in stated])
        most = float(np.nanmax(spans + halves)) if np.isfinite(spans).any() else 1.0
        left = _NAMES + number * (width + 24)
        panel = Panel(drawing, (left, top, left + width, bottom), (0.0, 1.05 * (most or 1.0)), (0.0, 1.0), language)
        panel.frame(x_label=f"{language.word('axis', axis)} [mm]", y_ticks=0)
        for row, (span, half) in enumerate(zip(spans, halves, strict=True)):
            if np.isfinite(span):
                y = top + _ROW * (row + 1)
                x, low, high = panel.place([span, max(span - half, 0.0), span + half], [0.0] * 3)[:, 0]
                drawing.line([[low, y], [high, y]], colour, width=1.4)
                drawing.dot((x, y), 2.2, colour)
    return drawing.svg()
