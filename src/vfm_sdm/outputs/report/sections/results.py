"""Results of each point and axis with their uncertainty, histories and spectra."""

from collections.abc import Iterator

from vfm_sdm.core.datasets import Status
from vfm_sdm.outputs.report.content import Block, Cell, Figure, Paragraph, Section, Table, Tone
from vfm_sdm.outputs.report.histories import draw_overview, draw_point, draw_spans, overview_pages
from vfm_sdm.outputs.report.inputs import MANY_POINTS, ReportInputs
from vfm_sdm.outputs.report.language import UNKNOWN, Language, count_decimals
from vfm_sdm.outputs.report.series import SeriesValues, Stated, level_length_s

__all__ = ["describe_histories", "describe_results"]


def describe_results(inputs: ReportInputs, language: Language) -> Section:
    """Peak-to-peak, extremes with their times, root mean square and level shift, each with expanded uncertainty.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    rows = tuple(
        _list_cells(inputs.series[point, axis], inputs, language)
        for point in inputs.point_names
        for axis in inputs.axis_names
    )
    length = language.write(level_length_s(inputs.displacement["time"].values), 1)
    columns = ("point", "axis", "p2p", "highest", "at", "lowest", "at", "rms", "shift", "dominant")
    tones: tuple[Tone, ...] = tuple(
        "quiet" if point in inputs.static else "" for point in inputs.point_names for _ in inputs.axis_names
    )
    table = Table(
        language.say("table results", length=length), tuple(map(language.say, columns)), rows, words=2, tones=tones
    )
    valid = tuple(
        (
            Cell(point),
            language.cell(_valid_percent(inputs, point), 1),
            *(language.digits(inputs.series[point, axis].summary["random_std_mm"], 2) for axis in inputs.axis_names),
            *(
                language.digits(inputs.series[point, axis].summary["detection_limit_mm"], 2)
                for axis in inputs.axis_names
            ),
            *(
                language.digits(_double(inputs.series[point, axis].summary["scale_std"]), 2)
                for axis in inputs.axis_names
            ),
        )
        for point in inputs.point_names
    )
    names = [language.word("axis short", axis) for axis in inputs.axis_names]
    heads = [f"{language.say(head)} {name}" for head in ("noise of", "limit of", "scale of") for name in names]
    quality = Table(language.say("table quality"), (language.say("point"), language.say("valid"), *heads), valid)
    return Section(language.say("title results"), (Paragraph(language.say("results head")), table, quality))


def _list_cells(of_axis: SeriesValues, inputs: ReportInputs, language: Language) -> tuple[Cell, ...]:
    """A row of the table of results."""
    summary = of_axis.summary
    span = Stated(_number(summary["peak_to_peak_mm"]), _number(summary["expanded_uncertainty_mm"]))
    name = of_axis.point + (" *" if of_axis.point in inputs.static else "")
    return (
        Cell(name),
        Cell(language.word("axis", of_axis.axis)),
        _state(span, language),
        _state(of_axis.highest, language),
        language.cell(of_axis.highest.at_s, 2),
        _state(of_axis.lowest, language),
        language.cell(of_axis.lowest.at_s, 2),
        _state(of_axis.rms, language),
        _state(of_axis.shift, language),
        language.cell(summary["dominant_frequency_hz"], 2),
    )


def _state(stated: Stated, language: Language) -> Cell:
    """A value and its expanded uncertainty, to the digits that the latter has."""
    decimals = count_decimals(stated.expanded, 2) if stated.expanded == stated.expanded else 2
    value = language.cell(stated.value, decimals)
    return (
        value
        if value.text == UNKNOWN
        else Cell(f"{value.text} ± {language.write(stated.expanded, decimals)}", value.value)
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _double(scale_std: float | None) -> float | None:
    """Expanded uncertainty of a scale (k = 2) [%]."""
    return None if scale_std is None else 200 * scale_std


def _valid_percent(inputs: ReportInputs, point: str) -> float:
    """Share of a point's frames with status ok [%]."""
    return 100 * float((inputs.displacement["status"].sel(point=point).values == Status.OK).mean())


def describe_histories(inputs: ReportInputs, language: Language) -> Section:
    """Histories with uncertainty and spectra: of each point, or overviews where there are many.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    if len(inputs.point_names) > MANY_POINTS:
        blocks = tuple(_list_overviews(inputs, language))
    else:
        blocks = (
            Paragraph(language.say("histories head")),
            *(
                Figure(
                    language.say("figure static history" if point in inputs.static else "figure history", point=point),
                    draw_point(inputs, point, language),
                )
                for point in inputs.point_names
            ),
        )
    return Section(language.say("title histories"), blocks)


_MOST_ROWS = 90
"""Points that overviews show: of more, those that move most."""


def _list_overviews(inputs: ReportInputs, language: Language) -> Iterator[Block]:
    chosen = set(inputs.by_motion[:_MOST_ROWS])
    points = tuple(point for point in inputs.point_names if point in chosen)
    head = language.say("overviews head", count=len(inputs.point_names))
    if len(points) < len(inputs.point_names):
        head += " " + language.say("overviews part", count=len(points))
    yield Paragraph(head)
    for page in overview_pages(points):
        yield Figure(language.say("figure spans"), draw_spans(inputs, page, language))
    for axis in inputs.axis_names:
        for page in overview_pages(points):
            caption = language.say("figure overview", axis=language.word("axis", axis))
            yield Figure(caption, draw_overview(inputs, axis, page, language))
