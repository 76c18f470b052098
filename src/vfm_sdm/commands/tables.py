"""What a command prints: short tables that can be read on a windy bank."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta

import numpy as np
import xarray as xr
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.terminal import add_name_column, number_text, plain_table, say_rest, shown_rows
from vfm_sdm.core.datasets import STATUS_MEANINGS, Status
from vfm_sdm.core.grids import without_grids
from vfm_sdm.core.statuses import CameraStatus, Outcome, PointStatus, RevisitStatus, Verdict
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results import Worth, describe_expectation, summarize_displacement
from vfm_sdm.stages.audit import Audit, AuditedInterval
from vfm_sdm.stages.audit.scale_budget import ScaleBudget, say_percent
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR
from vfm_sdm.stages.revisit import Revisit

__all__ = [
    "audit_report",
    "budget_table",
    "camera_report",
    "displacement_table",
    "expectation_table",
    "measurement_report",
    "revisit_table",
    "track_table",
]


_NO_LIMIT = 1e-6
"""Limit of a check below which any amount is a caution, and none is worth saying."""
_MOST_INTERVALS = 5
_WORTH_SAYING_S = 0.05
_WORTH_NAMING, _WORTH_MEASURING = 0.05, 0.9
"""Share of the scale's variance from which a source is named, and share of its uncertainty that a further reading has
to leave at most to be named [1]."""
_COLOURS = {Worth.GOOD: "green", Worth.PART: "", Worth.EDGE: "yellow", Worth.UNKNOWN: "", Worth.REFUSED: "red"}
_ROOM_BESIDE_BUDGET = 10
_SHORT = {"cameras": "camera", "synchronization": "clocks", "assumption": "assum.", "compression": "compr."}
"""Headings with which all components of the budget stand in one line of a terminal of 80 columns."""


def measurement_report(measurement: Measurement) -> Iterator[RenderableType]:
    """Cameras, displacement, recordings' faults and the time taken."""
    yield from camera_report(measurement.cameras, notes=False)
    if measurement.displacement is not None:
        # Tables of nothing but dashes would hide the sentence that says why.
        if np.isfinite(measurement.displacement["displacement"]).any():
            yield displacement_table(measurement.displacement)
            if "uncertainty" in measurement.displacement:
                yield budget_table(measurement.displacement)
        if measurement.displacement.attrs["frame"] == "reference camera":
            yield Text(
                "Axes: those of the reference camera (right, down, forward). For lateral, vertical and longitudinal "
                "measure site.perpendicular_distance and site.longitudinal_distance.",
                style="yellow",
            )
    if measurement.revisit is not None:
        yield revisit_table(measurement.revisit)
    for note in measurement.summary["notes"]:
        yield Text(f"note: {note}", style="yellow")
    reused = measurement.summary["reused_stages"]
    if reused:
        yield Text(f"reused from the run folder: {', '.join(reused)}")
    seconds = measurement.summary["seconds"]
    yield Text("time: " + ", ".join(f"{n} {s:.1f} s" for n, s in seconds.items() if s > _WORTH_SAYING_S))
    if measurement.audit is not None:
        yield from audit_report(measurement.audit)


def audit_report(audit: Audit) -> Iterator[RenderableType]:
    """What did not pass or could not be checked, a paragraph each, and the verdict in the last line."""
    yield Text("Audit", style="italic")
    unchecked = [check for check in audit.checks if check.outcome is Outcome.NOT_POSSIBLE]
    for check in (*audit.flagged, *unchecked):
        style = {Outcome.FAIL: "red", Outcome.CAUTION: "yellow"}.get(check.outcome, "")
        shown = ""
        if np.isfinite(check.value):
            units = "" if check.units in ("", "1") else f" {check.units}"
            limit = f" (limit {check.limit:.3g}{units})" if check.limit > _NO_LIMIT else ""
            shown = f" {check.value:.3g}{units}{limit}"
        yield Text(f" {check.outcome}: {check.name}{shown}: {check.sentence}", style=style)
    if audit.scale is not None and audit.scale.shares:
        yield Text(f" {_describe_scale(audit.scale)}")
    yield from _describe_intervals(audit.intervals)
    passed = sum(check.outcome is Outcome.PASS for check in audit.checks)
    colour = {Verdict.FIT: "green", Verdict.REFUSED: "red"}.get(audit.verdict, "yellow")
    named = [check.name for check in audit.flagged]
    named += [f"{check.name} not checked" for check in audit.missing]
    reasons = f": {'; '.join(named)}" if named else ""
    yield Text(
        f"verdict: {audit.verdict}{reasons} ({passed} of {len(audit.checks)} checks passed)", style=f"bold {colour}"
    )


def _describe_intervals(intervals: Sequence[AuditedInterval]) -> Iterator[Text]:
    """How many intervals have which verdict, and when a long recording is not to be used."""
    if not intervals:
        return
    counts = Counter(str(one.verdict) for one in intervals)
    yield Text(f" intervals: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}")
    refused = [one for one in intervals if one.verdict == Verdict.REFUSED]
    for one in refused[:_MOST_INTERVALS]:
        times = " to ".join(str(timedelta(seconds=round(value))) for value in (one.begin_s, one.end_s))
        yield Text(f" do not use {times}: {one.reasons}", style="yellow")
    if len(refused) > _MOST_INTERVALS:
        yield Text(f" do not use {len(refused) - _MOST_INTERVALS} more, see summary.json", style="yellow")


def _describe_scale(scale: ScaleBudget) -> str:
    """What the scale rests on, and what would tell it better, in one line."""
    parts = [f"{100 * share:.0f} % {source}" for source, share in scale.shares.items() if share >= _WORTH_NAMING]
    begin = f"scale: {say_percent(scale.expanded)} (k = 2, {scale.axis} of {scale.point}), from {', '.join(parts)}"
    better = [one for one in scale.readings if one.left < _WORTH_MEASURING * scale.expanded]
    if not better:
        return begin
    return f"{begin}. To measure next: {better[0].sentence} leaves {say_percent(better[0].left)}"


def camera_report(solution: CameraSolution, *, notes: bool = True) -> Iterator[RenderableType]:
    """Status, adjusted quantities beside what was known before, and points that were not found."""
    style = "green" if solution.status == CameraStatus.OK else "red"
    yield Text(f"cameras: {solution.status}", style=style)
    table = plain_table("Adjustment to the site")
    for name in ("quantity", "before", "std", "adjusted", "std", "unit"):
        table.add_column(Text(name), justify="left" if name in ("quantity", "unit") else "right")
    for q in solution.quantities:
        digits = max(0, 1 - int(np.floor(np.log10(min(q.std, q.prior_std))))) if min(q.std, q.prior_std) > 0 else 3
        values = tuple(f"{value:.{digits}f}" for value in (q.prior, q.prior_std, q.value, q.std))
        table.add_row(q.name, *values, q.units, style="red" if q.deviation > 3 else None)
    if solution.quantities:
        yield table
    if not notes:
        states = solution.points["status"].to_series()
        wrong = states[~states.isin([PointStatus.OK, PointStatus.NOT_LOOKED_FOR])]
        for (view, point), state in wrong[: shown_rows(len(wrong))].items():
            yield Text(f"point {point!r} in view {view!r}: {state}", style="red")
        if len(wrong) > shown_rows(len(wrong)):
            yield Text(f"... and {len(wrong) - shown_rows(len(wrong))} more; all in points.nc", style="red")
    if notes:
        for note in solution.notes:
            yield Text(f"note: {note}", style="yellow")


def revisit_table(revisit: Revisit) -> Table:
    """Change of rest position of each point with its expanded uncertainty (k = 2), or why there is none."""
    title = f"Change of rest position since {revisit.baseline!r} in mm, +- k=2"
    table = plain_table(title)
    add_name_column(table, "point", [one.point for one in revisit.changes])
    for axis in revisit.axes:
        table.add_column(Text(axis), justify="right", overflow="fold")
    table.add_column(Text(""), overflow="fold")
    for one in revisit.changes[: shown_rows(len(revisit.changes))]:
        ok = one.status is RevisitStatus.OK
        pairs = zip(one.change_mm, one.std_mm, strict=True)
        cells = [f"{change:.2f} +- {COVERAGE_FACTOR * std:.2f}" if ok else "-" for change, std in pairs]
        table.add_row(Text(one.point), *cells, Text("" if ok else str(one.status), style="red"))
    left = len(revisit.changes) - shown_rows(len(revisit.changes))
    rest = [f"... and {left} more points; all in revisit.csv"] if left > 0 else []
    table.caption, table.caption_justify = Text("\n".join([*rest, *_explain_revisit(revisit)])), "left"
    return table


def _explain_revisit(revisit: Revisit) -> Iterator[str]:
    """What the change is relative to, whether the scales agree, and notes."""
    yield f"relative to the static points {', '.join(revisit.static) or '(none)'}"
    if np.isfinite(revisit.scale_ratio):
        std = 100 * COVERAGE_FACTOR * revisit.scale_ratio_std
        yield f"scale of this visit over that one: {100 * revisit.scale_ratio:.2f} +- {std:.2f} %"
    yield from revisit.notes


def expectation_table(expected: Mapping[str, xr.Dataset]) -> Table:
    """What named points should measure: a line a view and point, with what to do where that is little."""
    table = plain_table("Expected of the points, before anything is measured (std of one frame)")
    for name in ("view", "point", "expected"):
        table.add_column(Text(name))
    for view, subsets in expected.items():
        for name in subsets["point"].values[: shown_rows(subsets.sizes["point"])]:
            words, worth = describe_expectation(subsets.sel(point=name))
            table.add_row(view, str(name), Text(words, style=_COLOURS[worth]))
    most = max((subsets.sizes["point"] for subsets in expected.values()), default=0)
    return say_rest(table, most, "the run folder when they are measured")


def displacement_table(displacement: xr.Dataset) -> Table:
    """Peak-to-peak with its uncertainty (k = 2), detection limit, scale, frequency and valid share a point and axis."""
    table = plain_table(f"Displacement in mm, axes of the {displacement.attrs['frame']}", dense=True)
    for name in (
        "point",
        "axis",
        "p-p",
        "+- k=2",
        "std",
        "detect",
        "scale %",
        "f [Hz]",
        "valid %",
    ):
        if name == "point":
            add_name_column(table, name, without_grids(displacement)["point"].values)
        else:
            table.add_column(Text(name), justify="left" if name == "axis" else "right", no_wrap=name == "axis")
    for point, figures in summarize_displacement(_first(displacement)).items():
        for number, (axis, values) in enumerate(figures["axes"].items()):
            table.add_row(
                point if number == 0 else "",
                axis,
                number_text(values["peak_to_peak_mm"], "{:.2f}"),
                number_text(values["expanded_uncertainty_mm"], "{:.2f}"),
                number_text(values["random_std_mm"], "{:.3f}"),
                number_text(values["detection_limit_mm"], "{:.3f}"),
                number_text(values["scale_std"], "{:.1f}", 100),
                number_text(values["dominant_frequency_hz"], "{:.2f}"),
                number_text(figures["coverage_valid"], "{:.0f}", 100),
            )
    return say_rest(table, without_grids(displacement).sizes["point"], "summary.json")


def budget_table(displacement: xr.Dataset) -> Table:
    """Components of the uncertainty of a sample a point and axis, root mean square over time, and all at k = 2."""
    table = plain_table("Uncertainty budget in mm (k = 1, root mean square over time)", dense=True)
    components = [str(name) for name in displacement["component"].values]
    add_name_column(table, "point", without_grids(displacement)["point"].values, room=_ROOM_BESIDE_BUDGET)
    table.add_column(Text("axis"), no_wrap=True)
    for name in (*components, "k = 2"):
        table.add_column(Text(_SHORT.get(name, name)), justify="right", no_wrap=True)
    for point, figures in summarize_displacement(_first(displacement)).items():
        for number, (axis, values) in enumerate(figures["axes"].items()):
            budget = values["budget_mm"] or {}
            parts = [budget.get(name) for name in components]
            known = [part for part in parts if part is not None]
            expanded = (
                COVERAGE_FACTOR * float(np.sqrt(np.sum(np.square(known)))) if len(known) == len(components) else None
            )
            cells = [number_text(part, "{:.3f}") for part in (*parts, expanded)]
            table.add_row(point if number == 0 else "", axis, *cells)
    return say_rest(table, without_grids(displacement).sizes["point"], "summary.json")


def _first(dataset: xr.Dataset) -> xr.Dataset:
    """The points that a table has room for, those with names of their own."""
    dataset = without_grids(dataset)
    return dataset.isel(point=slice(shown_rows(dataset.sizes["point"])))


def track_table(tracks: Mapping[str, xr.Dataset]) -> Table:
    """Motion in pixels and frames by status, a view and point."""
    table = plain_table("Tracks")
    for name in ("view", "point", "range u [px]", "range v [px]", "median std [px]", *STATUS_MEANINGS[:4]):
        if name == "point":
            add_name_column(table, name, [p for of_view in tracks.values() for p in of_view["point"].values])
        else:
            table.add_column(Text(name), justify="left" if name == "view" else "right")
    for view, of_view in tracks.items():
        for point in _first(of_view)["point"].values:
            one = of_view.sel(point=point)
            position, status = one["position"].values, one["status"].values
            found = np.isfinite(position).all(axis=1)
            span = np.ptp(position[found], axis=0) if found.any() else np.full(2, np.nan)
            variance = np.einsum("tii->t", one["position_covariance"].values)[found] / 2
            std = float(np.sqrt(np.median(variance))) if found.any() else float("nan")
            counts = [str(int((status == code).sum())) for code in range(Status.UNRELIABLE + 1)]
            table.add_row(view, str(point), f"{span[0]:.2f}", f"{span[1]:.2f}", f"{std:.4f}", *counts)
    return say_rest(table, max((of_view.sizes["point"] for of_view in tracks.values()), default=0), "tracks.nc")
