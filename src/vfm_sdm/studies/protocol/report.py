"""Tables of the protocol beside the comparisons of methods, and its summary."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from vfm_sdm.core.files import write_file
from vfm_sdm.outputs.results import describe_clocks
from vfm_sdm.studies.protocol.methods import WITH_SGR, WITHOUT_SGR, ComparedMethod
from vfm_sdm.studies.protocol.records import TestResult
from vfm_sdm.studies.protocol.sensitivity import SensitivityRow
from vfm_sdm.studies.protocol.tables import METRICS, Case, Cell, Table, comparison_table

__all__ = [
    "PAPER",
    "amplitude_table",
    "clock_table",
    "cost_table",
    "dataset_table",
    "outside_table",
    "reference_table",
    "sensitivity_table",
    "write_summary",
]

PAPER = {"NRMSE range": 0.15, "correlation": 0.73, "RPPAE": 0.11}
"""Means over the twelve cases of the paper, with SGR, against its accelerometers [1]."""

_Results = Mapping[str, TestResult]
_IN_BAND = "accelerometers"


def dataset_table(results: _Results) -> Table:
    """The paper's summary of its data sets.

    Parameters
    ----------
    results
        Results by field test.
    """
    rows: list[tuple[Cell, ...]] = []
    for name, result in results.items():
        plan = result.test.plan
        width, height = plan.site.image_size
        video = f"{width} x {height} px, {plan.fps} fps, {plan.duration_s:g} s"
        points = ", ".join(result.test.monitored)
        rows.append((name, points, video, f"{100 * plan.baseline_m:.0f}", plan.description))
    columns = ("data set", "monitored points", "each video", "baseline [cm]", "conditions")
    return Table("datasets", "Virtual field tests", columns, tuple(rows))


def amplitude_table(results: _Results) -> Table:
    """Peak-to-peak amplitudes [mm], all at 1 to 10 Hz so that they can be compared.

    Parameters
    ----------
    results
        Results by field test.
    """
    rows: list[tuple[Cell, ...]] = []
    for result in results.values():
        for case in result.cases:
            estimates = [_read_peak_to_peak(result, method, case) for method in (WITHOUT_SGR, WITH_SGR)]
            truth, sensor = np.nan, np.nan
            if result.reference is not None:
                row = result.reference.row(case.point, case.axis)
                truth, sensor = row.estimate_peak_to_peak_mm, row.reference_peak_to_peak_mm
            rows.append((case.dataset, case.point, case.axis, *estimates, sensor, truth))
    columns = ("data set", "point", "axis", "without SGR", "with SGR", "accelerometers", "truth")
    return Table("amplitudes", "Global peak-to-peak amplitude in mm, at 1 to 10 Hz", columns, tuple(rows))


def reference_table(results: _Results) -> Table:
    """Errors of the accelerometers' displacement, below which a comparison with it shows nothing.

    Parameters
    ----------
    results
        Results by field test.
    """
    cases = [case for result in results.values() for case in result.cases]
    scores = {
        case: result.reference.row(case.point, case.axis).score
        for result in results.values()
        if result.reference is not None
        for case in result.cases
    }
    return comparison_table(
        "reference_against_truth",
        "Truth against displacement from the accelerometers, both at 1 to 10 Hz",
        {"truth": scores},
        cases=cases,
        notes=(
            "No method can be expected to come closer to the accelerometers than the truth does.",
            "Below 1 Hz the accelerometers know nothing: slow and static deflection is left out on both sides.",
        ),
    )


def clock_table(results: _Results) -> Table:
    """Estimated offsets [s] between the views, and between video and accelerometers, beside the true ones.

    Parameters
    ----------
    results
        Results by field test.
    """
    rows: list[tuple[Cell, ...]] = []
    for name, result in results.items():
        run, truth = result.runs.get(WITH_SGR), result.test.truth.attrs
        clocks = describe_clocks(run.displacement) if run is not None and run.displacement is not None else {}
        offsets_s = truth.get("view_offsets_s", [0.0, truth["second_view_offset_s"]])
        for number, (view, true) in enumerate(zip(result.test.session.view, offsets_s, strict=True)):
            if number > 0 and view.name in clocks:
                clock = clocks[view.name]
                offset, std = clock["offset_s"], clock["offset_std_s"]
                what = "second view" if number == 1 else f"view {view.name}"
                errors = (1e3 * (offset - float(true)), 1e3 * std)
                rows.append((name, what, float(true), offset, *errors, clock["status"]))
        evaluation = result.evaluations["accelerometers"].get(WITH_SGR)
        if evaluation is not None and evaluation.synchronization is not None:
            found = evaluation.synchronization
            true = float(np.atleast_1d(truth["sensor_offset_s"])[0])
            error = 1e3 * (found.offset_s - true)
            rows.append((name, "accelerometers", true, found.offset_s, error, 1e3 * found.lag_std_s, found.status))
    columns = ("data set", "clock", "true offset [s]", "found [s]", "error [ms]", "stated std [ms]", "status")
    return Table("clocks", "Synchronisation by the motion", columns, tuple(rows))


def outside_table(results: _Results) -> Table:
    """Metrics of field tests that violate the method's assumptions, apart from the others as in the paper.

    Parameters
    ----------
    results
        Results by field test.
    """
    cases = [case for result in results.values() for case in result.cases]
    scores = {}
    for method in (WITHOUT_SGR, WITH_SGR):
        found = {case: results[case.dataset].score("truth", method, case) for case in cases}
        scores[method.label] = {case: score for case, score in found.items() if score is not None}
    return comparison_table(
        "outside_assumptions",
        "OUTSIDE THE METHOD'S ASSUMPTIONS: cameras that stabilise and sharpen; not a result",
        scores,
        cases=cases,
        notes=(
            "The stabilisation moves the whole picture. What the static points show of it is removed; the result rests "
            "on them. The paper leaves its phone sequence out of the evaluation, and so do all other tables here.",
        ),
    )


def cost_table(results: _Results) -> Table:
    """Time [ms] and peak memory [MB] of the stages, means over the field tests.

    Parameters
    ----------
    results
        Results by field test.
    """
    tasks = list(dict.fromkeys(cost.task for result in results.values() for cost in result.costs))
    rows: list[tuple[Cell, ...]] = []
    for task in tasks:
        costs = [cost for result in results.values() for cost in result.costs if cost.task == task]
        total = float(np.mean([cost.seconds for cost in costs]))
        memory = float(np.max([cost.peak_memory_mb for cost in costs]))
        calls = costs[0].calls
        rows.append((task, "CPU", costs[0].input_size, str(calls), 1e3 * total / calls, 1e3 * total, memory))
    columns = ("task", "device", "input", "calls", "time a call [ms]", "total [ms]", "peak memory of the process [MB]")
    return Table("cost", "Computational cost of the default method", columns, tuple(rows))


def sensitivity_table(rows: Sequence[SensitivityRow]) -> Table:
    """Errors of the sensitivity study."""
    columns = ("parameter", "value", "method", "axis", "NRMSE range", "RMS error [mm]")
    cells = tuple((row.parameter, row.value, row.method, row.axis, row.nrmse, row.rms_error_mm) for row in rows)
    notes = (
        "One parameter is changed at a time; cameras are known, so that only tracking and geometry are looked at.",
    )
    return Table("sensitivity", "Error against truth as conditions get worse", columns, cells, notes)


def write_summary(folder: Path, tables: Mapping[str, Table], *, size: str, seconds: float) -> None:
    """Writes ``benchmark.json`` and ``README.md``: the means beside the paper's, and where every table is."""
    means = {
        against: {
            metric: _read_mean(tables[f"refinement_against_{against}"], f"{metric}: {WITH_SGR.label}")
            for metric in METRICS
        }
        for against in ("truth", "accelerometers")
        if f"refinement_against_{against}" in tables
    }
    document = {"size": size, "seconds": round(seconds, 1), "means_with_sgr": means, "paper": PAPER}
    write_file(folder / "benchmark.json", json.dumps(document, indent=1))
    lines = [f"# Protocol on the {size} field tests", "", "Means with SGR over the cases within the assumptions:", ""]
    lines += ["| | " + " | ".join(METRICS) + " |", "| --- " * (len(METRICS) + 1) + "|"]
    for against, values in means.items():
        cells = ["-" if value is None else f"{value:.3f}" for value in values.values()]
        lines.append(f"| against {against} | " + " | ".join(cells) + " |")
    paper = [f"{PAPER[metric]:.2f}" if metric in PAPER else "-" for metric in METRICS]
    lines.append("| the paper, its own data | " + " | ".join(paper) + " |")
    lines += ["", "Tables:", "", *(f"- [{table.title}](tables/{table.name}.md)" for table in tables.values()), ""]
    write_file(folder / "README.md", "\n".join(lines))


def _read_mean(table: Table, column: str) -> float | None:
    value = next(row for row in table.rows if row[0] == "mean")[table.columns.index(column)]
    return float(value) if np.isfinite(float(value)) else None


def _read_peak_to_peak(result: TestResult, method: ComparedMethod, case: Case) -> float:
    evaluation = result.evaluations[_IN_BAND].get(method)
    return np.nan if evaluation is None else evaluation.row(case.point, case.axis).estimate_peak_to_peak_mm
