"""The audit with what to do, and the comparison with sensors."""

from collections.abc import Iterator, Mapping
from typing import Any

from vfm_sdm.core.statuses import Outcome
from vfm_sdm.outputs.report.content import Block, Cell, Listed, Paragraph, Section, Table
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language
from vfm_sdm.outputs.report.sections.head import TONES

__all__ = ["describe_audit", "describe_comparison"]

_NO_LIMIT = 1e-6
"""Limit of a check below which any amount is a caution, and none is worth saying."""
_MOST_READINGS, _MOST_INTERVALS = 3, 40
_WORTH_MEASURING = 0.9


def describe_audit(inputs: ReportInputs, language: Language) -> Section:
    """Every check with its outcome, value and limit, and what to do about those that did not pass.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    audit = inputs.summary["audit"]
    rows = tuple(_list_check(check, language) for check in audit["checks"])
    tones = tuple(TONES.get(check["outcome"], "") for check in audit["checks"])
    columns = tuple(language.say(name) for name in ("check", "outcome", "where", "found", "limit"))
    blocks: list[Block] = [Table(language.say("table audit"), columns, rows, words=3, tones=tones)]
    for wanted in (Outcome.FAIL, Outcome.CAUTION):
        for check in audit["checks"]:
            if check["outcome"] == wanted:
                blocks += list(_explain(check, language))
    unchecked = [
        language.tell(str(check["sentence"])).after(f"{language.word('check', check['name'])}: ")
        for check in audit["checks"]
        if check["outcome"] == Outcome.NOT_POSSIBLE
    ]
    if unchecked:
        blocks += [Paragraph(language.say("not checked")), *language.listed(unchecked)]
    blocks += list(_advise(inputs, language))
    if audit.get("intervals"):
        blocks.append(_tabulate_intervals(audit["intervals"], language))
    return Section(language.say("title audit"), tuple(blocks))


def _list_check(check: Mapping[str, Any], language: Language) -> tuple[Cell, ...]:
    units = "" if check["units"] in ("", "1") else language.word("unit", str(check["units"]))
    limit = check["limit"] if check["limit"] is not None and check["limit"] > _NO_LIMIT else None
    # What is counted has no decimals.
    shown = language.cell(limit, 0, units) if check["units"] == "frames" else language.digits(limit, 3, units)
    if limit is not None:
        shown = Cell(f"{'≥' if check['larger_is_better'] else '<'} {shown.text}", shown.value)
    return (
        Cell(language.word("check", check["name"])),
        Cell(language.word("outcome", check["outcome"])),
        Cell(language.name(str(check["where"] or ""))),
        language.digits(check["figure"], 3, units),
        shown,
    )


def _explain(check: Mapping[str, Any], language: Language) -> Iterator[Block]:
    """What to do about a check, and its own sentence."""
    name = language.word("check", check["name"])
    outcome = language.word("outcome", check["outcome"])
    todo = language.word("todo", check["name"])
    advice = "" if todo == check["name"] else f": {todo}"
    yield Paragraph(f"{name} ({outcome}){advice}", TONES.get(check["outcome"], ""))
    told = language.tell(str(check["sentence"]))
    yield Paragraph(told.text, "quiet", foreign=bool(told.left))


def _advise(inputs: ReportInputs, language: Language) -> Iterator[Block]:
    """What to measure next on site, in the order of what it would bring."""
    scale = inputs.summary.get("scale") or {}
    now = scale.get("expanded_uncertainty")
    better = [one for one in scale.get("measure_next", []) if now and one["leaves"] < _WORTH_MEASURING * now]
    if better:
        items = tuple(
            f"{language.name(one['reading'])}: {language.digits(100 * one['leaves'], 2, '%').text}"
            for one in better[:_MOST_READINGS]
        )
        yield Paragraph(language.say("measure next"))
        yield Listed(items)


def _tabulate_intervals(intervals: list[Mapping[str, Any]], language: Language) -> Table:
    """Verdicts on the parts of a long recording; of many, those that are worst first."""
    chosen = intervals
    if len(intervals) > _MOST_INTERVALS:
        chosen = sorted(intervals, key=lambda one: one["verdict"] != "do not use")[:_MOST_INTERVALS]
        chosen = sorted(chosen, key=lambda one: one["begin_s"])
    rows = tuple(
        (
            language.cell(one["begin_s"], 0),
            language.cell(one["end_s"], 0),
            Cell(language.word("verdict short", one["verdict"])),
            Cell(language.tell(str(one["reasons"])).text),
        )
        for one in chosen
    )
    tones = tuple(TONES.get(one["verdict"], "") for one in chosen)
    columns = tuple(language.say(name) for name in ("from s", "to s", "verdict", "reasons"))
    caption = language.say("table intervals", count=len(chosen), all=len(intervals))
    return Table(caption, columns, rows, words=4, tones=tones)


def describe_comparison(inputs: ReportInputs, language: Language) -> Section | None:
    """The measurement beside a reference; nothing where none was evaluated.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    found = inputs.evaluation
    if found is None:
        return None
    head = language.say("comparison head", reference=language.name(str(found.get("reference", ""))))
    if found.get("band_hz"):
        low, high = (language.digits(value, 3).text for value in found["band_hz"])
        head += " " + language.say("comparison band", low=low, high=high)
    rows = []
    for row in found["rows"]:
        score = row["score"]
        percent = None if score["coverage"] is None else 100 * score["coverage"]
        lag_ms = None if score["lag_s"] is None else 1e3 * score["lag_s"]
        rows.append(
            (
                Cell(str(row["point"])),
                Cell(language.word("axis", str(row["axis"]))),
                language.digits(row["estimate_peak_to_peak_mm"], 4),
                language.digits(row["reference_peak_to_peak_mm"], 4),
                language.digits(row["rms_error_mm"], 2),
                *(language.cell(score[name], 4) for name in ("nrmse_range", "correlation", "rppae", "gain")),
                language.cell(lag_ms, 1),
                language.cell(percent, 0),
            )
        )
    columns = ("point", "axis", "p2p here", "p2p reference", "rms error", "nrmse", "correlation", "rppae", "gain")
    heads = tuple(language.say(name) for name in (*columns, "lag ms", "coverage"))
    table = Table(language.say("table comparison"), heads, tuple(rows), words=2)
    listed = language.listed(language.tell(str(note)) for note in found.get("notes", []))
    return Section(language.say("title comparison"), (Paragraph(head), table, *listed))
