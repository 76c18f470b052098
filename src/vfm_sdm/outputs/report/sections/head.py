"""First page: who wanted what measured, and the verdict with its limits in plain words."""

from collections.abc import Iterator
from datetime import date
from typing import Any

import numpy as np

from vfm_sdm.core.statuses import Outcome, PointStatus, Verdict
from vfm_sdm.outputs.report.content import Block, Cell, Facts, Listed, Paragraph, Section, Tone
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR
from vfm_sdm.stages.registration.designs import Warp

__all__ = ["TONES", "describe_task", "describe_verdict"]

TONES: dict[str, Tone] = {
    Verdict.FIT: "good",
    Verdict.CARE: "care",
    Verdict.NOT_JUDGED: "care",
    Verdict.REFUSED: "bad",
    Outcome.CAUTION: "care",
    Outcome.FAIL: "bad",
    Outcome.NOT_POSSIBLE: "quiet",
}
"""How verdicts and outcomes look; a check that passed looks like text."""


def describe_task(inputs: ReportInputs, language: Language) -> Section:
    """Client, project, place, date, who measured, with what and in what weather.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    session, said = inputs.session, inputs.session.report
    rows: list[tuple[str, Cell]] = []
    for name in ("client", "project", "place"):
        if said is not None and getattr(said, name) is not None:
            rows.append((language.say(name), Cell(getattr(said, name))))
    if (day := _day_of(inputs)) is not None:
        rows.append((language.say("date"), Cell(language.day(day))))
    for name in ("measured_by", "cameras", "weather"):
        if said is not None and getattr(said, name) is not None:
            rows.append((language.say(name), Cell(getattr(said, name))))
    rows.append((language.say("structure"), Cell(session.name)))
    views = ", ".join(view.name for view in session.view)
    rows.append((language.say("views"), Cell(language.say("count of", count=len(session.view), names=views))))
    moving = len([name for name in inputs.point_names if name not in inputs.static])
    counted = language.say("points counted", moving=moving, static=len(inputs.static))
    rows.append((language.say("points"), Cell(counted)))
    blocks: list[Block] = [Facts(tuple(rows))]
    if said is None:
        blocks.append(Paragraph(language.say("no report table"), "quiet"))
    if said is not None and said.remarks is not None:
        blocks += [Paragraph(line) for line in said.remarks.splitlines() if line.strip()]
    return Section(language.say("title task"), tuple(blocks))


def _day_of(inputs: ReportInputs) -> date | None:
    """Day of the recordings, as far as anybody says."""
    said, start = inputs.session.report, inputs.session.reference_view.start
    if said is not None and said.date is not None:
        return said.date
    return None if start is None else start.date()


def describe_verdict(inputs: ReportInputs, language: Language) -> Section:
    """The verdict in plain words, what it rests on, and within which limits the results hold.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    audit = inputs.summary["audit"]
    verdict = str(audit["verdict"])
    blocks: list[Block] = [
        Paragraph(language.word("verdict", verdict), TONES.get(verdict, "")),
        Paragraph(language.word("advice", verdict)),
    ]
    flagged = [
        language.say(
            "flagged",
            outcome=language.word("outcome", check["outcome"]),
            check=language.word("check", check["name"]),
            meaning=language.word("todo", check["name"]),
        )
        for wanted in (Outcome.FAIL, Outcome.CAUTION)
        for check in audit["checks"]
        if check["outcome"] == wanted
    ]
    if flagged:
        blocks += [Paragraph(language.say("flagged head")), Listed(tuple(flagged))]
    if inputs.notes:
        blocks += language.listed(map(language.tell, inputs.notes))
    blocks += [Paragraph(language.say("limits head")), Listed(tuple(_list_limits(inputs, language)))]
    return Section(language.say("title verdict"), tuple(blocks))


def _list_limits(inputs: ReportInputs, language: Language) -> Iterator[str]:
    """Sentences on what the results hold for."""
    time_s = inputs.displacement["time"].values
    if time_s.size > 1:
        length_s, rate_hz = float(time_s[-1] - time_s[0]), (time_s.size - 1) / float(time_s[-1] - time_s[0])
        yield language.say(
            "limit time",
            seconds=language.write(length_s, 1),
            frames=language.write(time_s.size, 0),
            rate=language.write(rate_hz, 2),
            highest=language.write(rate_hz / 2, 1),
        )
    yield language.word("relative", str(inputs.displacement.attrs.get("relative_to", "")))
    limits = [one.summary["detection_limit_mm"] for one in inputs.series.values()]
    known = [one for one in limits if one is not None]
    if known:
        yield language.say("limit noise", most=language.digits(max(known), 2, "mm").text)
    # The audit's worst is that of the axes it judges; a limit of all results is that of all.
    scales = {
        key: one.summary["scale_std"]
        for key, one in inputs.series.items()
        if key[0] not in inputs.static and one.summary["scale_std"] is not None
    }
    if scales:
        point, axis = max(scales, key=lambda key: scales[key])
        percent = language.digits(100 * COVERAGE_FACTOR * scales[point, axis], 2, "%").text
        yield language.say("limit scale", percent=percent, axis=language.word("axis", axis), point=point)
    method = inputs.session.method
    if method.refinement == "sgr":
        yield language.say("limit sgr", axis=language.word("axis", method.sgr.suppressed_axis))
    if len(inputs.session.view) == 1:
        yield language.say("limit one view")
    elif inputs.displacement.attrs.get("frame") != "structure":
        yield language.say("limit no axes")
    yield from _list_limits_of_points(inputs, language)
    yield language.say("limit static") if inputs.static else language.say("limit no static")


def _list_limits_of_points(inputs: ReportInputs, language: Language) -> Iterator[str]:
    """Points that were refused, that are measured across an edge only, or that were rarely seen."""
    subsets: dict[str, dict[str, Any]] = inputs.summary.get("subsets", {})
    named = [(point, row) for of_view in subsets.values() for point, row in of_view.items()]
    edges = {point: None for point, row in named if row.get("warp") == Warp.EDGE}
    refused = {point: None for point, row in named if row.get("status") == PointStatus.NO_TEXTURE}
    for key, points in (("limit edges", edges), ("limit refused", refused)):
        if points:
            yield language.say(key, points=", ".join(points))
    coverage = {point: inputs.summary["points"].get(point, {}).get("coverage_valid") for point in inputs.point_names}
    rarely = [p for p, share in coverage.items() if share is not None and share < 1 and np.round(100 * share) < 95]
    if rarely:
        yield language.say("limit rarely", points=", ".join(rarely))
