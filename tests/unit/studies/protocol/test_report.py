"""The protocol's other tables and its summary, from results made by hand."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.analysis.evaluation import Evaluation, EvaluationRow
from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.stages.synchronize import Synchronization
from vfm_sdm.studies.protocol import TestResult as Result  # by its own name pytest would take it for a test
from vfm_sdm.studies.protocol import report
from vfm_sdm.studies.protocol.cost import Cost
from vfm_sdm.studies.protocol.methods import WITH_SGR, WITHOUT_SGR
from vfm_sdm.studies.protocol.runs import FieldTest, MethodRun
from vfm_sdm.studies.protocol.sensitivity import SensitivityRow
from vfm_sdm.studies.protocol.tables import Case, comparison_table
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.plan import MountedAccelerometer
from vfm_sdm.studies.synthetic.sensors import Accelerometer

NAN = float("nan")
POINTS = ("1/4 span", "1/2 span")
OFFSET_S, SENSOR_S = 0.25, -1.5


def make_score(nrmse=0.1, correlation=0.9, rppae=0.2):
    return Score(nrmse, correlation, rppae, 1.0, 0.01, 0.8, 0.95, 0.0, 0.0, 100, (1.0, 10.0), False)


def make_evaluation(nrmse=0.1, *, estimate_mm=5.0, reference_mm=4.0, clock=None):
    rows = [
        EvaluationRow(point, axis, make_score(nrmse), estimate_mm + n, reference_mm + n, 0.3)
        for n, (point, axis) in enumerate((point, axis) for point in POINTS for axis in ("vertical", "lateral"))
    ]
    return Evaluation(tuple(rows), clock, (1.0, 10.0), "sensors")


def make_displacement_with_clock(offset_s, std_s, status):
    shape = (10, 2, 3)
    clock = {"offset": [0.0, offset_s], "offset_std": [0.0, std_s], "rate": [1.0, 1.0], "status": ["ok", status]}
    displacement = make_displacement(
        np.arange(10) / 30,
        list(POINTS),
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=np.zeros(shape),
            displacement_std_mm=np.zeros(shape),
            scale_std=np.zeros(shape[1:]),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2], int),
        ),
        attrs={"frame": "structure"},
    )
    facts = {f"clock_{name}": ("view", values) for name, values in clock.items()}
    return displacement.assign(facts).assign_coords(view=["left", "right"])


def make_result(name="data-1", **changes):
    """A field test with two monitored points, a run with refinement and evaluations of both methods."""
    sensors = tuple(MountedAccelerometer(Accelerometer(f"acc-{n}"), point) for n, point in enumerate(POINTS))
    plan = replace(demo_plan(), name=name, accelerometers=sensors, **changes)
    session = SimpleNamespace(view=[SimpleNamespace(name="left"), SimpleNamespace(name="right")])
    truth = xr.Dataset(attrs={"second_view_offset_s": OFFSET_S, "sensor_offset_s": [SENSOR_S, SENSOR_S]})
    result = Result(FieldTest(plan, Path(), session, truth, None))
    result.runs[WITH_SGR] = MethodRun(make_displacement_with_clock(OFFSET_S + 0.5e-3, 0.2e-3, "ok"))
    clock = Synchronization(-(SENSOR_S - 2e-3), 0.7e-3, 0.99, "ok")
    result.evaluations["accelerometers"] = {
        WITH_SGR: make_evaluation(estimate_mm=5.0, clock=clock),
        WITHOUT_SGR: make_evaluation(estimate_mm=6.0),
    }
    result.evaluations["truth"] = {WITH_SGR: make_evaluation(0.03), WITHOUT_SGR: make_evaluation(0.08)}
    result.reference = make_evaluation(0.05, estimate_mm=4.5, reference_mm=4.0)
    return result


def test_data_sets_as_they_were_filmed():
    table = report.dataset_table({"data-1": make_result(description="fog")})
    (row,) = table.rows
    assert row[:3] == ("data-1", "1/4 span, 1/2 span", "1280 x 720 px, 30 fps, 3 s")
    assert row[3] == f"{100 * demo_plan().baseline_m:.0f}"
    assert row[4] == "fog"


def test_amplitudes_of_all_sources_side_by_side():
    table = report.amplitude_table({"data-1": make_result()})
    assert table.columns[3:] == ("without SGR", "with SGR", "accelerometers", "truth")
    assert [row[1:3] for row in table.rows] == [(p, axis) for p in POINTS for axis in ("vertical", "lateral")]
    for n, row in enumerate(table.rows):
        assert row[3:] == (6.0 + n, 5.0 + n, 4.0 + n, 4.5 + n)


def test_amplitudes_that_are_not_known():
    result = make_result()
    result.reference = None
    del result.evaluations["accelerometers"][WITHOUT_SGR]
    for row in report.amplitude_table({"data-1": result}).rows:
        assert np.isnan([row[3], row[5], row[6]]).all()
        assert row[4] >= 5.0


def test_the_error_of_the_reference_itself():
    second = make_result("data-2")
    second.reference = None
    table = report.reference_table({"data-1": make_result(), "data-2": second})
    column = table.columns.index("NRMSE range: truth")
    assert [row[column] for row in table.rows[:4]] == [0.05] * 4
    assert np.isnan([row[column] for row in table.rows[4:8]]).all()
    assert (table.rows[8][0], table.rows[8][column]) == ("mean", pytest.approx(0.05))
    assert any("Below 1 Hz" in note for note in table.notes)


def test_clocks_beside_the_true_ones():
    rows = report.clock_table({"data-1": make_result()}).rows
    assert [row[:2] for row in rows] == [("data-1", "second view"), ("data-1", "accelerometers")]
    assert rows[0][2:6] == pytest.approx((OFFSET_S, OFFSET_S + 0.5e-3, 0.5, 0.2))
    assert rows[1][2:6] == pytest.approx((SENSOR_S, SENSOR_S - 2e-3, -2.0, 0.7))
    assert [row[6] for row in rows] == ["ok", "ok"]


def test_a_clock_that_the_motion_does_not_tell_is_shown_with_its_reason():
    result = make_result()
    result.runs[WITH_SGR] = MethodRun(make_displacement_with_clock(NAN, NAN, "peak not unique"))
    row = report.clock_table({"data-1": result}).rows[0]
    assert row[2] == OFFSET_S
    assert np.isnan(row[3:6]).all()
    assert row[6] == "peak not unique"


def test_what_was_not_synchronised_has_no_clock():
    result = make_result()
    result.runs[WITH_SGR] = MethodRun(None, status="no cameras")
    result.evaluations["accelerometers"] = {}
    assert report.clock_table({"data-1": result}).rows == ()
    assert report.clock_table({}).rows == ()


def test_outside_the_assumptions_the_title_says_so():
    table = report.outside_table({"data-4": make_result("data-4", within_assumptions=False)})
    assert table.title.startswith("OUTSIDE THE METHOD'S ASSUMPTIONS")
    assert [row[0] for row in table.rows] == ["data-4"] * 4 + ["mean", "std"]
    before, after = (table.columns.index(f"NRMSE range: {m.label}") for m in (WITHOUT_SGR, WITH_SGR))
    assert (table.rows[0][before], table.rows[0][after]) == (0.08, 0.03)
    assert "The paper leaves its phone sequence out" in table.notes[0]
    assert [row[0] for row in report.outside_table({}).rows] == ["mean", "std"]


def test_costs_are_means_over_the_field_tests_and_memory_the_largest():
    first, second = make_result(), make_result("data-2")
    first.costs = [Cost("tracking", "100 frames", 2, 3.0, 500.0), Cost("triangulation", "1 point", 1, 0.5, 90.0)]
    second.costs = [Cost("tracking", "100 frames", 2, 5.0, 400.0)]
    rows = report.cost_table({"data-1": first, "data-2": second}).rows
    assert rows[0] == ("tracking", "CPU", "100 frames", "2", 2000.0, 4000.0, 500.0)
    assert rows[1] == ("triangulation", "CPU", "1 point", "1", 500.0, 500.0, 90.0)
    assert report.cost_table({"data-1": make_result()}).rows == ()


def test_sensitivity_row_by_row():
    table = report.sensitivity_table([SensitivityRow("baseline [m]", 2.0, "with SGR", "lateral", 0.02, 0.1)])
    assert table.rows == (("baseline [m]", 2.0, "with SGR", "lateral", 0.02, 0.1),)
    assert len(table.columns) == 6
    assert "cameras are known" in table.notes[0]


def test_means_stand_beside_the_paper_s(tmp_path):
    case = Case("data-1", "1/2 span", "vertical")
    tables = {
        f"refinement_against_{against}": comparison_table(
            f"refinement_against_{against}",
            f"Against {against}",
            {WITH_SGR.label: {case: make_score(nrmse, rppae=NAN)}, WITHOUT_SGR.label: {case: make_score(9.0)}},
            cases=[case],
        )
        for against, nrmse in (("truth", 0.0312), ("accelerometers", 0.0567))
    }
    report.write_summary(tmp_path, tables, size="full", seconds=12.345)
    document = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    assert (document["size"], document["seconds"]) == ("full", 12.3)
    # The abstract of the paper: NRMSE 0.15, correlation 0.73, RPPAE 0.11.
    assert document["paper"] == {"NRMSE range": 0.15, "correlation": 0.73, "RPPAE": 0.11}
    assert document["means_with_sgr"]["truth"]["NRMSE range"] == 0.0312
    assert document["means_with_sgr"]["accelerometers"]["RPPAE"] is None
    lines = (tmp_path / "README.md").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "# Protocol on the full field tests"
    first = lines.index("| | NRMSE range | correlation | RPPAE | gain | skill |")
    assert lines[first + 2 : first + 5] == [
        "| against truth | 0.031 | 0.900 | - | 1.000 | 0.800 |",
        "| against accelerometers | 0.057 | 0.900 | - | 1.000 | 0.800 |",
        "| the paper, its own data | 0.15 | 0.73 | 0.11 | - | - |",
    ]
    assert "- [Against truth](tables/refinement_against_truth.md)" in lines


def test_a_summary_without_results_has_no_means(tmp_path):
    report.write_summary(tmp_path, {}, size="small", seconds=1.0)
    assert json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))["means_with_sgr"] == {}
    assert "against truth" not in (tmp_path / "README.md").read_text(encoding="utf-8")
