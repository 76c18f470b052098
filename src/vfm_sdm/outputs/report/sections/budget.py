"""The uncertainty budget in the form of the GUM: source, value, distribution, sensitivity, contribution."""

from collections.abc import Iterator

import numpy as np

from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.outputs.report.content import Block, Cell, Paragraph, Section, Table, Tone
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import UNKNOWN, Language, count_decimals
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["describe_budget"]

_OF_PIXELS = ("random", "origin")
"""Components that come from pixels by the sensitivity of displacement to them."""
_TYPE_A = ("random", "origin")
_SOURCES_OF_TYPE_A = ("matches", "places of the points")
"""Components, and sources of the scale, that were evaluated by statistics of the pictures; the others are of type B."""
_MOST_DECIMALS = 4
"""Decimals of millimetres and per cent: a tenth of a micrometre."""


def describe_budget(inputs: ReportInputs, language: Language) -> Section | None:
    """Budgets of the point that moves most, all points' components, and what the scale rests on.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.

    Notes
    -----
    A component is given as its root mean square over time. Its sensitivity is that of displacement to pixels, to the
    offset of the clocks, or, of what is proportional to the motion, that motion: the root mean square of the
    displacement's length. Value times sensitivity is the contribution.
    """
    blocks: list[Block] = []
    if "uncertainty" in inputs.displacement and inputs.by_motion:
        blocks.append(Paragraph(language.say("budget head")))
        point = inputs.by_motion[0]
        motion_mm = _motion_of(inputs, point)
        for axis in inputs.axis_names:
            blocks.append(_tabulate_one(inputs, (point, axis), motion_mm, language))
        blocks.append(_tabulate_all(inputs, language))
    else:
        blocks.append(Paragraph(language.say("no budget")))
    blocks += list(_describe_scale(inputs, language))
    return Section(language.say("title budget"), tuple(blocks))


def _motion_of(inputs: ReportInputs, point: str) -> float:
    """Root mean square of the length of a point's displacement [mm]."""
    of_point = inputs.displacement[["displacement", "status"]].sel(point=[point])
    values = trusted_values(of_point.transpose("time", "point", "axis"), "displacement")
    # An axis that is not measured has no part in it.
    return float(np.sqrt(np.mean(np.nansum(values**2, axis=2)[np.isfinite(values).any(axis=2)])))


def _tabulate_one(inputs: ReportInputs, of: tuple[str, str], motion_mm: float, language: Language) -> Table:
    """Budget of one point along one axis."""
    point, axis = of
    of_axis = inputs.series[point, axis]
    rows = [
        (
            Cell(language.word("component", name)),
            *_list_source(inputs, of, (name, contribution), motion_mm, language),
            _shorten(contribution, 3, language),
        )
        for name, contribution in _components(inputs, of).items()
    ]
    empty = (Cell(""),) * 3
    rows.append((Cell(language.say("combined")), *empty, _shorten(of_axis.combined_mm, 3, language)))
    rows.append((Cell(language.say("expanded")), *empty, _shorten(COVERAGE_FACTOR * of_axis.combined_mm, 3, language)))
    columns = ("source", "value", "distribution", "sensitivity", "contribution")
    caption = language.say("table budget", point=point, axis=language.word("axis", axis))
    plain: list[Tone] = [""] * (len(rows) - 2)
    tones: tuple[Tone, ...] = (*plain, "strong", "strong")
    return Table(caption, tuple(map(language.say, columns)), tuple(rows), tones=tones)


def _components(inputs: ReportInputs, of: tuple[str, str]) -> dict[str, float | None]:
    """Components of a point and axis [mm]; ``None`` where nobody knows one, and where nothing was there to tell it."""
    budget, data = inputs.series[of].summary["budget_mm"] or {}, inputs.displacement
    if "uncertainty_estimated" not in data:
        return dict(budget)
    estimated = data["uncertainty_estimated"].sel(point=of[0])
    return {name: value if value or bool(estimated.sel(component=name)) else None for name, value in budget.items()}


def _list_source(
    inputs: ReportInputs, of: tuple[str, str], component: tuple[str, float | None], motion_mm: float, language: Language
) -> tuple[Cell, Cell, Cell]:
    """Value of a source with its unit, its distribution, and the sensitivity with its unit."""
    name, contribution = component
    distribution = Cell(language.say("normal a" if name in _TYPE_A else "normal b"))
    sensitivity, units = _find_sensitivity(inputs, of, component, motion_mm)
    if contribution is None or not np.isfinite(sensitivity) or sensitivity == 0:
        return Cell(UNKNOWN), distribution, Cell(UNKNOWN)
    value = language.digits(contribution / sensitivity, 3, units)
    return value, distribution, language.digits(sensitivity, 3, f"mm/{units}")


def _find_sensitivity(
    inputs: ReportInputs, of: tuple[str, str], component: tuple[str, float | None], motion_mm: float
) -> tuple[float, str]:
    """Sensitivity of a displacement to what a component comes from [mm/unit], and that unit; NaN where not known."""
    (point, axis), (name, contribution), data = of, component, inputs.displacement
    if name in _OF_PIXELS and "pixel_sensitivity" in data:
        return float(np.sqrt(np.nansum(data["pixel_sensitivity"].sel(point=point, axis=axis).values ** 2))), "px"
    if name == "synchronization":
        tau_s = np.nan
        if "clock_offset_std" in data:
            tau_s = float(np.sqrt(np.nansum(data["clock_offset_std"].values ** 2)))
        return (contribution or np.nan) / (1e3 * tau_s) if tau_s > 0 else np.nan, "ms"
    if name == "assumption":
        return 1.0, "mm"
    return motion_mm / 100, "%"


def _tabulate_all(inputs: ReportInputs, language: Language) -> Table:
    """All components of all points and axes."""
    components = [str(name) for name in inputs.displacement["component"].values]
    rows = tuple(
        (
            Cell(point),
            Cell(language.word("axis", axis)),
            *(_shorten(_components(inputs, (point, axis)).get(name), 2, language) for name in components),
            _shorten(of_axis.combined_mm, 2, language),
            _shorten(COVERAGE_FACTOR * of_axis.combined_mm, 2, language),
        )
        for (point, axis), of_axis in inputs.series.items()
    )
    heads = [language.word("component short", name) for name in components]
    columns = (language.say("point"), language.say("axis"), *heads, "u", "U")
    return Table(language.say("table components"), columns, rows, words=2)


def _describe_scale(inputs: ReportInputs, language: Language) -> Iterator[Block]:
    """What the scale rests on: each source with its share, and the reading behind it."""
    scale = inputs.summary.get("scale")
    if not scale or not scale.get("shares"):
        return
    quantities = {one["name"]: one for one in inputs.summary["cameras"]["quantities"]}
    std_percent = 100 * scale["expanded_uncertainty"] / COVERAGE_FACTOR
    rows = []
    for source, share in scale["shares"].items():
        one, part = quantities.get(source), std_percent * float(np.sqrt(max(share, 0.0)))
        value = std = sensitivity = Cell(UNKNOWN)
        if one is not None and one["prior_std"]:
            units = "" if one["units"] == "1" else one["units"]
            decimals = count_decimals(one["prior_std"], 2)
            value, std = (language.cell(one[name], decimals, units) for name in ("prior", "prior_std"))
            sensitivity = language.digits(part / one["prior_std"], 2, f"%/{units}" if units else "%")
        words = Cell(_say_source(source, language))
        distribution = Cell(language.say("normal a" if source in _SOURCES_OF_TYPE_A else "normal b"))
        rows.append(
            (words, value, std, distribution, sensitivity, _shorten(part, 2, language), language.cell(100 * share, 2))
        )
    columns = ("source", "stated value", "stated std", "distribution", "sensitivity", "contribution percent", "share")
    caption = language.say(
        "table scale",
        point=scale["point"],
        axis=language.word("axis", scale["axis"]),
        percent=language.digits(100 * scale["expanded_uncertainty"], 2, "%").text,
    )
    yield Table(caption, tuple(map(language.say, columns)), tuple(rows))


def _say_source(source: str, language: Language) -> str:
    """A source in the reader's language, where the catalogue knows its beginning."""
    if (named := language.name(source)) != source:
        return named
    for length in range(len(source.split()), 0, -1):
        words = source.split()
        head, tail = " ".join(words[:length]), " ".join(words[length:])
        if (said := language.word("source", head)) != head or length == 1:
            return f"{said} {tail}".strip()
    return source


def _shorten(value: float | None, digits: int, language: Language) -> Cell:
    """A contribution with so many digits, and no more decimals than make sense."""
    return language.cell(value, min(count_decimals(value, digits), _MOST_DECIMALS))
