"""Runs of the same films: analysis of variance against its definition and against simulated people."""

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from scipy import stats

from vfm_sdm.analysis.repeatability import (
    RepeatedRun,
    analyse_variance,
    compare_runs,
    read_repeatability,
    write_repeatability,
)
from vfm_sdm.commands.repeat import _explain, _tabulate
from vfm_sdm.core.datasets import START, STRUCTURE_AXES, DisplacementArrays, Status, make_displacement
from vfm_sdm.core.netcdf import write_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.report import find_language
from vfm_sdm.outputs.report.sections.repeatability import describe_repeatability


def dataset(values_mm, *, names=("mid", "quarter"), std_mm=0.05, key="a"):
    """Displacement of shape (T, P, 3) [mm]."""
    return make_displacement(
        np.arange(len(values_mm)) / 30,
        list(names),
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values_mm,
            displacement_std_mm=np.full(values_mm.shape, std_mm),
            scale_std=np.full(values_mm.shape[1:], 0.01),
            position_m=np.zeros(values_mm.shape),
            reprojection_error_px=np.zeros(values_mm.shape[:2]),
            status=np.zeros(values_mm.shape[:2]),
        ),
        attrs={"frame": "structure", "key": key},
    )


def runs_of(gains, people, *, films=None, **options):
    """Runs that see the same motion with different gains."""
    time_s = np.arange(240) / 30
    motion = np.sin(2 * np.pi * 2 * time_s)[:, None, None] * np.array([[0.5, 4.0, 0.1], [0.3, 3.0, 0.05]])
    return [
        RepeatedRun(f"run {n}", person, dataset(gain * motion, **options), {"left": "1"} if films is None else films[n])
        for n, (gain, person) in enumerate(zip(gains, people, strict=True))
    ]


def test_balanced_variances_are_those_of_the_textbook():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(5, 3)) + rng.normal(size=(5, 1))
    found = analyse_variance(values.ravel(), np.repeat(np.arange(5), 3))
    within = values.var(axis=1, ddof=1).mean()
    between = 3 * values.mean(axis=1).var(ddof=1)
    assert found.repeatability == pytest.approx(np.sqrt(within))
    assert found.between == pytest.approx(np.sqrt((between - within) / 3))
    assert found.p_value == pytest.approx(stats.f_oneway(*values).pvalue)


def test_intervals_hold_over_simulated_people():
    """Of 6 people with 4 results each; 600 simulations have a standard deviation of 0.9 %."""
    rng = np.random.default_rng(4)
    held = []
    for _ in range(600):
        values = rng.normal(0, 0.3, (6, 1)) + rng.normal(0, 0.2, (6, 4))
        one = analyse_variance(values.ravel(), np.repeat(np.arange(6), 4))
        held.append(
            (
                one.repeatability_low <= 0.2 <= one.repeatability_high,
                one.reproducibility_low <= np.hypot(0.2, 0.3) <= one.reproducibility_high,
            )
        )
    of_one, of_all = np.mean(held, axis=0)
    assert of_one == pytest.approx(0.95, abs=0.027)
    # Satterthwaite's degrees of freedom are an approximation.
    assert of_all == pytest.approx(0.95, abs=0.05)


def test_what_nothing_tells_is_not_known():
    alone = analyse_variance(np.array([1.0, 1.2, 1.1]), [0, 1, 2])
    assert np.isnan([alone.repeatability, alone.between, alone.p_value]).all()
    assert alone.reproducibility == pytest.approx(0.1)
    same = analyse_variance(np.array([1.0, 1.2, 1.1]), [0, 0, 0])
    assert np.isnan([same.reproducibility, same.between]).all()
    assert same.repeatability == pytest.approx(0.1)
    assert np.isnan(analyse_variance(np.array([1.0]), [0]).repeatability)
    alike = analyse_variance(np.array([1.0, 1.2, 1.2, 1.0]), [0, 0, 1, 1])
    assert alike.between == 0
    assert alike.reproducibility == alike.repeatability


def test_scale_of_a_person_shows_in_every_quantity():
    result = compare_runs(runs_of([1.0, 1.0, 1.02, 1.02], ["anna", "anna", "ben", "ben"]))
    one = result.sel(point="mid", axis="vertical")
    assert float(one["repeatability"].sel(quantity="peak_to_peak")) == pytest.approx(0, abs=1e-9)
    # Two people 2 % of 8 mm apart.
    assert float(one["reproducibility"].sel(quantity="peak_to_peak")) == pytest.approx(0.16 / np.sqrt(2), rel=0.02)
    rms = 0.02 * 4 / np.sqrt(2)
    assert float(one["reproducibility"].sel(quantity="displacement")) == pytest.approx(rms / np.sqrt(2), rel=0.02)
    assert float(one["consistency"].sel(quantity="displacement")) == pytest.approx(rms / np.sqrt(2) / 0.05, rel=0.02)


def test_points_are_found_by_their_names():
    first, second = runs_of([1.0, 1.0], ["anna", "ben"])
    mixed = second.displacement.isel(point=[1, 0]).assign_coords(point=["quarter", "mid"])
    result = compare_runs([first, RepeatedRun("b", "ben", mixed, {})])
    assert result["point"].values.tolist() == ["mid", "quarter"]
    assert float(np.abs(result["reproducibility"]).max()) < 1e-9


def test_a_point_that_a_run_hardly_sees_is_not_compared():
    first, second = runs_of([1.0, 1.1], ["anna", "ben"])
    second.displacement["status"].values[:200, 1] = 1
    result = compare_runs([first, second])
    assert np.isnan(result["reproducibility"].sel(point="quarter")).all()
    assert np.isfinite(result["reproducibility"].sel(point="mid", axis="vertical")).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: runs_of([1], ["anna"]), "expected at least 2 runs of the same films, got 1"),
        (lambda: runs_of([1, 1], ["anna", "ben"], films=[{"left": "1"}, {"left": "2"}]), "runs of the same films"),
        (lambda: runs_of([1], ["anna"]) * 2, "expected different runs"),
        (
            lambda: [*runs_of([1], ["anna"]), RepeatedRun("x", "b", dataset(np.zeros((9, 2, 3))), {})],
            "expected the same times of the frames",
        ),
        (
            lambda: [*runs_of([1], ["anna"]), RepeatedRun("x", "b", dataset(np.zeros((240, 2, 3)), names="xy"), {})],
            "expected points of the same names",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(make, message):
    with pytest.raises(DatasetError, match=message):
        compare_runs(make())


def test_files_say_what_was_compared(tmp_path):
    result = compare_runs(runs_of([1.0, 1.01, 1.02], ["anna", "anna", "ben"]))
    netcdf, table = write_repeatability(tmp_path, result)
    xr.testing.assert_identical(read_repeatability(tmp_path).drop_attrs(), result.drop_attrs())
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 5 * 2 * 3
    one = result.sel(quantity="rms", point="mid", axis="vertical")
    (row,) = [r for r in rows if (r["quantity"], r["point"], r["axis"]) == ("rms", "mid", "vertical")]
    assert float(row["repeatability_mm"]) == pytest.approx(float(one["repeatability"]), rel=1e-5)
    assert float(row["run 2_mm"]) == pytest.approx(float(one["value"].sel(run="run 2")), rel=1e-5)
    netcdf.unlink()
    assert read_repeatability(tmp_path) is None


def test_runs_that_are_relative_to_something_else_are_named(tmp_path):
    """Three runs of one result: from the first sample, from a mean, and from a later sample as the first was lost."""
    values = runs_of([1.0], ["anna"])[0].displacement["displacement"].values
    first = dataset(values).assign_attrs(relative_to="first valid sample", **{START: "2026-11-20T10:15:30+00:00"})
    mean = dataset(values + 0.4).assign_attrs(relative_to="mean of the still interval")
    later = first.copy(deep=True)
    later["status"][:5, 0] = Status.LOST
    people = (("a", first, None), ("b", mean, (0.0, 2.5)), ("c", later, None))
    result = compare_runs([RepeatedRun(name, name, data, {}, still) for name, data, still in people])
    write_repeatability(tmp_path, result)
    stored = read_repeatability(tmp_path)
    said = "; ".join(_explain(stored))
    assert (
        "relative to something else from run to run (a: first valid sample; b: mean of the still interval, 0-2.5 s;"
        in said
    )
    assert "time is zero at other dates from run to run (a: 2026-11-20T10:15:30+00:00; b: not stated" in said
    assert "the first valid sample is not of the same frame in all runs: mid; what differs" in said
    inputs = SimpleNamespace(folder=tmp_path, displacement=first)
    told = [one.text for one in describe_repeatability(inputs, find_language("de")).blocks if one.kind == "paragraph"]
    assert any("b: Mittel über das Ruheintervall, 0-2.5 s; c: erster gültiger Wert" in one for one in told)
    assert any("nicht in allen Auswertungen im selben Bild" in one and one.endswith(": mid.") for one in told)


def test_runs_of_one_origin_need_no_word():
    said = "; ".join(_explain(compare_runs(runs_of([1.0, 1.01], ["anna", "ben"]))))
    assert "relative" not in said
    assert "time is zero" not in said


def test_no_number_of_the_table_is_cut_at_80_columns():
    names = ("deck edge left of pier 3", "1/2 span")
    runs = runs_of((1.0, 1.01, 1.05, 1.06), ("anna", "anna", "ben", "ben"), names=names)
    shown = io.StringIO()
    Console(file=shown, width=80).print(_tabulate(compare_runs(runs).sel(quantity="displacement"), "displacement"))
    assert "…" not in shown.getvalue()
    assert shown.getvalue().count("longitudinal") == len(names)


def test_the_command(command, tmp_path):
    folders = [tmp_path / name for name in ("anna 1", "anna 2", "ben [1]")]
    for folder, run in zip(folders, runs_of([1.0, 1.001, 1.05], ["", "", ""]), strict=True):
        write_displacement(folder, run.displacement)
    code, out, err = command("repeat", *folders, "--persons", "anna,anna,ben")
    assert code == 0, err
    assert "runs differ by more than the standard uncertainty that they state: vertical of mid" in out
    assert (folders[0] / "figures" / "repeatability.png").stat().st_size > 10_000
    found = read_repeatability(folders[0])
    assert found["person"].values.tolist() == ["anna", "anna", "ben"]
    code, out, _ = command("repeat", *folders, "-o", tmp_path / "all", "--quantity", "peak_to_peak")
    assert code == 0
    assert "nobody is named" in out
    assert "only reproducibility is known" in out
    assert read_repeatability(tmp_path / "all") is not None
    assert command("repeat", *folders, "--persons", "anna")[0] == 1
    assert command("repeat", *folders, "--quantity", "speed")[0] == 1
