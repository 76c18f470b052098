"""The paper's protocol in one go: field tests x methods, every table and figure."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import xarray as xr

from vfm_sdm.analysis.evaluation import Evaluation
from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import ResultsError, VfmSdmError
from vfm_sdm.studies.protocol import report
from vfm_sdm.studies.protocol.figures import save_protocol_figures
from vfm_sdm.studies.protocol.methods import (
    MONOCULAR,
    WITH_SGR,
    WITHOUT_SGR,
    ComparedMethod,
    Comparison,
    comparisons,
    why_not,
)
from vfm_sdm.studies.protocol.records import AGAINST, Benchmark, TestResult
from vfm_sdm.studies.protocol.runs import (
    FieldTest,
    MethodRun,
    measure_geometry,
    prepare_field_test,
    run_method,
    run_monocular,
)
from vfm_sdm.studies.protocol.sensitivity import SensitivityRow, run_sensitivity
from vfm_sdm.studies.protocol.tables import Case, Table, comparison_table, write_table
from vfm_sdm.studies.synthetic.presets import PRESETS, PresetName, Size, preset

__all__ = ["run_benchmark"]


def run_benchmark(
    folder: Path | str,
    *,
    size: Size = "small",
    names: Sequence[PresetName] = PRESETS,
    sensitivity: bool = True,
    progress: Progress | None = None,
) -> Benchmark:
    """Makes the field tests, measures them with every method that can run, and writes all tables and figures.

    Parameters
    ----------
    folder
        Folder for ``field_tests/``, ``runs/``, ``tables/`` and ``figures/``. What is finished there is not done again,
        so a run that was cut short goes on where it was.
    size
        Size of the field tests, see `vfm_sdm.studies.synthetic.presets.preset`.
    names
        Names of the field tests.
    sensitivity
        Whether to add the sensitivity study.
    progress
        Called with the name of the step, the steps done and the steps in all.

    Returns
    -------
    benchmark
        Tables, results of every method on every field test (lengths in mm), and the paths of the figures.

    Raises
    ------
    ResultsError
        The folder cannot be written to.
    """
    start = time.perf_counter()
    out = Path(folder)
    try:
        (out / "tables").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"{out}: expected a folder to write to, got: {error}; choose another") from error
    results: dict[str, TestResult] = {name: _run_test(out, name, size, progress) for name in names}
    rows = run_sensitivity(out / "sensitivity", size=size, progress=progress) if sensitivity else []
    tables = {table.name: table for table in _make_tables(results, rows)}
    for table in tables.values():
        write_table(out / "tables", table)
    with _announced(progress, "figures"):
        figures = save_protocol_figures(out / "figures", results, rows)
    seconds = time.perf_counter() - start
    report.write_summary(out, tables, size=size, seconds=seconds)
    return Benchmark(out, tables, results, figures, seconds)


def _run_test(out: Path, name: PresetName, size: Size, progress: Progress | None) -> TestResult:
    test = prepare_field_test(out / "field_tests" / f"{name}-{size}", preset(name, size), progress=progress)
    result, place = TestResult(test), out / "runs" / f"{name}-{size}"
    wanted = dict.fromkeys(method for comparison in comparisons() for method in comparison.methods)
    methods = [method for method in wanted if why_not(method) is None]
    if not test.plan.within_assumptions:
        methods = [WITHOUT_SGR, WITH_SGR]
    done: dict[tuple[str, str, str], ComparedMethod] = {}
    for method in methods:
        # Some tables show the same method under another name.
        twin = done.setdefault((method.tracker, method.cameras, method.refinement), method)
        if twin != method:
            result.runs[method] = result.runs[twin]
            for evaluations in result.evaluations.values():
                if twin in evaluations:
                    evaluations[method] = evaluations[twin]
            continue
        with _announced(progress, f"{name}: {method.label}"):
            try:
                if method == MONOCULAR:
                    run = run_monocular(test, place, progress=progress)
                else:
                    run, costs = run_method(test, method, place, progress=progress)
                    if method == WITH_SGR:
                        result.costs = [*costs, *measure_geometry(run)]
            except VfmSdmError as error:
                # One method that fails on one field test is a line in the tables, not the end of the protocol.
                run = MethodRun(None, status=str(error))
        result.runs[method] = run
        if run.displacement is not None:
            for against, evaluation in _evaluate_run(test, run.displacement).items():
                result.evaluations[against][method] = evaluation
    result.reference = test.against_sensors(_select_monitored(test))
    return result


def _evaluate_run(test: FieldTest, displacement: xr.Dataset) -> dict[str, Evaluation]:
    found = {"truth": test.against_truth(displacement)}
    sensors = test.against_sensors(displacement)
    return found if sensors is None else {**found, "accelerometers": sensors}


def _select_monitored(test: FieldTest) -> xr.Dataset:
    return test.truth.sel(point=list(test.monitored))


def _make_tables(results: Mapping[str, TestResult], rows: Sequence[SensitivityRow]) -> Iterator[Table]:
    inside = {name: r for name, r in results.items() if r.test.plan.within_assumptions}
    yield report.dataset_table(results)
    yield report.amplitude_table(inside)
    for comparison in comparisons():
        for against in AGAINST:
            yield _make_comparison(comparison, inside, against)
    yield report.reference_table(inside)
    yield report.clock_table(results)
    yield report.outside_table({name: r for name, r in results.items() if name not in inside})
    yield report.cost_table(inside)
    if rows:
        yield report.sensitivity_table(rows)


def _make_comparison(comparison: Comparison, results: Mapping[str, TestResult], against: str) -> Table:
    cases = [case for result in results.values() for case in result.cases if case.axis in comparison.axes]
    able = [method for method in comparison.methods if why_not(method) is None]
    scores: dict[str, dict[Case, Score]] = {}
    for method in able:
        found = {case: results[case.dataset].score(against, method, case) for case in cases}
        scores[method.label] = {case: score for case, score in found.items() if score is not None}
    return comparison_table(
        f"{comparison.name}_against_{against}",
        f"Comparison of {comparison.title}, against {AGAINST[against]}",
        scores,
        cases=cases,
        missing={method.label: str(why_not(method)) for method in comparison.methods if method not in able},
        notes=[*_note_failures(able, results), *_note_gaps(able, results, against)],
    )


def _note_failures(methods: Sequence[ComparedMethod], results: Mapping[str, TestResult]) -> list[str]:
    """Sentences on methods that ran without a result, and why."""
    return [
        f"{method.label} on {name}: {result.runs[method].status}"
        for name, result in results.items()
        for method in methods
        if method in result.runs and result.runs[method].displacement is None
    ]


def _note_gaps(methods: Sequence[ComparedMethod], results: Mapping[str, TestResult], against: str) -> list[str]:
    """Sentences on missing metrics of methods that gave a displacement, such as an unknown lag."""
    return [
        f"{method.label} on {name}: {note}"
        for name, result in results.items()
        for method in methods
        if (evaluation := result.evaluations[against].get(method)) is not None
        and len(evaluation.scored_rows) < len(evaluation.rows)
        for note in evaluation.notes
    ]


@contextmanager
def _announced(progress: Progress | None, what: str) -> Iterator[None]:
    if progress is not None:
        progress(what, 0, None)
    yield
    if progress is not None:
        progress(what, 1, 1)
