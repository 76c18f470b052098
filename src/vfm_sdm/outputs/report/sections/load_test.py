"""Load tests: deflection of every step, what remains, and vehicles that passed."""

import numpy as np
import xarray as xr

from vfm_sdm.analysis.load_test import drop_static, find_moved_static, read_load_test, read_passages_of_run
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.constants import KM_H
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION
from vfm_sdm.outputs.report.content import Block, Cell, Figure, Paragraph, Section, Table
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, Panel, shorten, span_of
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import UNKNOWN, Language, count_decimals
from vfm_sdm.outputs.report.sections.outdated import warn_outdated

__all__ = ["describe_load_test", "describe_passages"]

_MOST_POINTS, _MOST_CURVES = 40, 6
_COLUMNS = 2
_LEFT, _GAP, _PANEL, _TOP, _BOTTOM = 62.0, 84.0, 130.0, 22.0, 44.0
_COLOURS = (BLUE, VERMILION, ORANGE, GREY)


def describe_load_test(inputs: ReportInputs, language: Language) -> Section | None:
    """Steps of a load test beside what was calculated, and what remains; nothing where none was judged.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    result = read_load_test(inputs.folder)
    if result is None:
        return None
    blocks: list[Block] = [*warn_outdated(inputs, result, "load-test", language)]
    shown = drop_static(result, inputs.static)
    for axis in _chosen_axes(shown["largest"], shown["calculated"]):
        one, name = shown.sel(axis=axis), language.word("axis", axis)
        points = _largest(one["largest"].values, one["point"].values)
        blocks.append(Paragraph(language.say("load test head", axis=name)))
        blocks.append(_tabulate_steps(one, points[:_MOST_POINTS], language))
        blocks.append(_tabulate_residuals(one, points[:_MOST_POINTS], language))
        blocks.append(Figure(language.say("figure load", axis=name), _draw_loads(one, points[:_MOST_CURVES], language)))
    stillness = "stillness found" if result.attrs["stillness"] == "found" else "stillness given"
    blocks.append(Paragraph(language.say(stillness), "quiet"))
    blocks += _tell_static(inputs, result, "load_test.csv", language)
    return Section(language.say("title load test"), tuple(blocks))


def describe_passages(inputs: ReportInputs, language: Language) -> Section | None:
    """Amplification of vehicles that passed, and displacement against their place; nothing where none were judged.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    result = read_passages_of_run(inputs.folder)
    if result is None:
        return None
    shown = drop_static(result, inputs.static)
    largest = shown["largest_static"].transpose("passage", "point", "axis")
    sizes = xr.DataArray(np.abs(largest.values).max(axis=0), coords=[largest["point"], largest["axis"]])
    blocks: list[Block] = [*warn_outdated(inputs, result, "passages", language)]
    blocks.append(Paragraph(language.say("passages head")))
    for axis in _chosen_axes(sizes, None):
        one, name = shown.sel(axis=axis), language.word("axis", axis)
        blocks.append(Paragraph(_tell_frequency(one, name, language)))
        points = _largest(sizes.sel(axis=axis).values, one["point"].values)
        blocks.append(_tabulate_passages(one, points[:_MOST_POINTS], language))
        line = "influence" if "influence" in one and np.isfinite(one["influence"]).any() else "static"
        caption = language.say(f"figure {line}", axis=name)
        blocks.append(Figure(caption, _draw_lines(one, line, points[:_MOST_CURVES], language)))
    blocks += _tell_static(inputs, result, "passages.csv", language)
    return Section(language.say("title passages"), tuple(blocks))


def _chosen_axes(sizes: xr.DataArray, calculated: xr.DataArray | None) -> list[str]:
    """Axes with calculated values; without any, the one with the largest size."""
    names = [str(name) for name in sizes["axis"].values]
    if calculated is not None:
        stated = [name for name in names if np.isfinite(calculated.sel(axis=name)).any()]
        if stated:
            return stated
    known = [np.nan_to_num(np.abs(sizes.sel(axis=name).values), nan=-1.0).max(initial=-1.0) for name in names]
    return [names[int(np.argmax(known))]]


def _largest(sizes: FloatArray, names: np.ndarray) -> list[str]:
    """Names of points with a known size, the largest first."""
    order = np.argsort(-np.nan_to_num(np.abs(sizes), nan=-1.0), kind="stable")
    return [str(names[i]) for i in order if np.isfinite(sizes[i])]


def _tell_static(inputs: ReportInputs, result: xr.Dataset, where: str, language: Language) -> list[Block]:
    """How many points are not shown because they must not move, and which of them moved."""
    left = sum(str(name) in inputs.static for name in result["point"].values)
    if not left:
        return []
    blocks: list[Block] = [Paragraph(language.say("static left out", count=left, where=where), "quiet")]
    of = "step" if "deflection" in result else "passage"
    for one in find_moved_static(result, inputs.static):
        size = _with(one.value_mm, one.expanded_mm, language).text
        name = language.word("axis", one.axis)
        said = language.say(f"static moved in {of}", point=one.point, size=size, axis=name, number=one.number)
        blocks.append(Paragraph(said, "care"))
    return blocks


def _tell_frequency(one: xr.Dataset, axis: str, language: Language) -> str:
    """Natural frequency by which static and dynamic part are told apart along an axis, and where it is from."""
    known = one["frequency"].values[np.isfinite(one["frequency"].values)]
    if not known.size:
        return language.say("passages frequency none", axis=axis)
    low, high = (language.write(float(value), 2) for value in (known.min(), known.max()))
    origin = language.say(f"passages frequency {one.attrs['frequency']}")
    between = low if low == high else f"{low} – {high}"
    return language.say("passages frequency", axis=axis, hertz=between, origin=origin)


def _with(value: float, expanded: float, language: Language) -> Cell:
    """A value and its expanded uncertainty, to the digits that the latter has."""
    if not np.isfinite(value):
        return Cell(UNKNOWN)
    decimals = count_decimals(expanded, 2) if np.isfinite(expanded) and expanded > 0 else 3
    return Cell(f"{language.write(value, decimals)} ± {language.write(expanded, decimals)}", float(value))


def _tabulate_steps(one: xr.Dataset, points: list[str], language: Language) -> Table:
    units = str(one["load"].attrs.get("units") or "1")
    decimals = count_decimals(float(np.abs(one["load"]).max()) or 1.0, 3)
    rows = []
    for point in points:
        for number in range(one.sizes["step"]):
            step = one.sel(point=point).isel(step=number)
            rows.append(
                (
                    Cell(point if number == 0 else ""),
                    language.cell(float(step["load"]), decimals),
                    Cell(f"{language.write(float(step['begin_s']), 0)} – {language.write(float(step['end_s']), 0)}"),
                    _with(float(step["deflection"]), float(step["expanded_uncertainty"]), language),
                    language.cell(float(step["calculated"]), 3),
                    language.cell(float(step["ratio"]), 3),
                    language.cell(float(step["ratio_exceeded"]), 2),
                )
            )
    heads = (
        language.say("point"),
        language.say("load", units=units),
        language.say("stood"),
        language.say("deflection mm"),
        language.say("calculated mm"),
        language.say("ratio"),
        language.say("exceeds ratio", limit=language.write(one.attrs["ratio_limit"], 2)),
    )
    caption = language.say("table steps", axis=language.word("axis", str(one["axis"].values)))
    return Table(caption, heads, tuple(rows))


def _tabulate_residuals(one: xr.Dataset, points: list[str], language: Language) -> Table:
    rows = []
    for point in points:
        of_point = one.sel(point=point)
        share = 100 * float(of_point["residual_share"])
        half = 50 * float(of_point["share_high"] - of_point["share_low"])
        rows.append(
            (
                Cell(point),
                language.cell(float(of_point["largest"]), 3),
                language.cell(float(of_point["residual"]), 3),
                _with(share, half, language),
                language.cell(float(of_point["residual_exceeded"]), 2),
                _with(float(of_point["flexibility"]), 2 * float(of_point["flexibility_std"]), language),
            )
        )
    limit = language.write(100 * one.attrs["residual_limit"], 0)
    heads = ("point", "largest mm", "residual mm", "share percent")
    names = (*map(language.say, heads), language.say("exceeds share", limit=limit), language.say("slope"))
    caption = language.say("table residual", axis=language.word("axis", str(one["axis"].values)))
    return Table(caption, names, tuple(rows))


def _tabulate_passages(one: xr.Dataset, points: list[str], language: Language) -> Table:
    rows = []
    for point in points:
        for number in range(one.sizes["passage"]):
            passage = one.sel(point=point).isel(passage=number)
            low, high = (float(passage[f"amplification_{end}"]) for end in ("low", "high"))
            between = f"{language.write(low, 3)} – {language.write(high, 3)}" if np.isfinite(low) else UNKNOWN
            rows.append(
                (
                    Cell(point if number == 0 else ""),
                    Cell(
                        f"{language.write(float(passage['begin_s']), 1)} – {language.write(float(passage['end_s']), 1)}"
                    ),
                    language.cell(KM_H * float(passage["speed_m_s"]), 1),
                    _with(float(passage["largest_total"]), float(passage["total_uncertainty"]), language),
                    _with(float(passage["largest_static"]), float(passage["static_uncertainty"]), language),
                    language.cell(float(passage["amplification"]), 3),
                    Cell(between),
                    language.cell(float(passage["cutoff"]), 2),
                    Cell(language.word("passage status", str(passage["status"].values))),
                )
            )
    heads = (
        *("point", "passage time", "speed", "total mm", "static mm"),
        *("amplification", "interval", "cutoff hz", "status"),
    )
    caption = language.say("table passages", axis=language.word("axis", str(one["axis"].values)))
    return Table(caption, tuple(map(language.say, heads)), tuple(rows))


def _boxes(count: int) -> tuple[float, list[tuple[float, float, float, float]]]:
    """Height of a drawing, and boxes of so many panels in two columns."""
    width = (WIDTH - 12 - _LEFT - (_COLUMNS - 1) * _GAP) / _COLUMNS
    rows = -(-max(count, 1) // _COLUMNS)
    boxes = []
    for number in range(count):
        left = _LEFT + (number % _COLUMNS) * (width + _GAP)
        top = _TOP + (number // _COLUMNS) * (_PANEL + _TOP + _BOTTOM)
        boxes.append((left, top, left + width, top + _PANEL))
    return rows * (_PANEL + _TOP + _BOTTOM), boxes


def _draw_loads(one: xr.Dataset, points: list[str], language: Language) -> str:
    height, boxes = _boxes(len(points))
    drawing = Drawing(height, language.say("figure load label"))
    load, units = one["load"].values, str(one["load"].attrs.get("units") or "1")
    for point, box in zip(points, boxes, strict=True):
        of_point = one.sel(point=point)
        value, half, calculated = (of_point[key].values for key in ("deflection", "expanded_uncertainty", "calculated"))
        panel = Panel(drawing, box, span_of([load]), span_of([value - half, value + half, calculated]), language)
        panel.frame(x_label=language.say("load", units=units), y_label=language.say("deflection mm"))
        drawing.text(box[0], box[1] - 7, shorten(point, box[2] - box[0]), bold=True)
        for x, y, u, c in zip(load, value, half, calculated, strict=True):
            if np.isfinite(y):
                drawing.line(panel.place([x, x], [y - u, y + u]), BLUE, width=1.4)
                drawing.dot(panel.place([x], [y])[0], 2.4, BLUE)
            if np.isfinite(c):
                right, down = panel.place([x], [c])[0]
                for slope in (-4, 4):
                    drawing.line([[right - 4, down - slope], [right + 4, down + slope]], ORANGE, width=1.4)
    return drawing.svg()


def _draw_lines(one: xr.Dataset, line: str, points: list[str], language: Language) -> str:
    height, boxes = _boxes(len(points))
    drawing = Drawing(height, language.say("figure static label"))
    place = one["along" if line == "influence" else "place"].values
    known = np.isfinite(place).all()
    if not known:
        place = np.tile(np.linspace(0, 1, one.sizes["station"]), (one.sizes["passage"], 1))
    x_label = language.say("place m" if known else "share of passage")
    for point, box in zip(points, boxes, strict=True):
        of_point = one.sel(point=point).transpose("passage", "station")
        value, half = of_point[line].values, 2 * of_point[f"{line}_std"].values
        panel = Panel(drawing, box, span_of([place], margin=0.0), span_of([value - half, value + half]), language)
        panel.frame(x_label=x_label, y_label="mm/kN" if line == "influence" else "mm")
        drawing.text(box[0], box[1] - 7, shorten(point, box[2] - box[0]), bold=True)
        for number, (x, y, u) in enumerate(zip(place, value, half, strict=True)):
            colour = _COLOURS[number % len(_COLOURS)]
            panel.band(x, y - u, y + u, colour)
            panel.curve(x, y, y, colour, width=1.2)
    return drawing.svg()
