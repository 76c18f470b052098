"""Load tests with known truth: intervals hold, probabilities of exceedance are frequencies, files say the same."""

import csv
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr

import measurements
from measurements import MOVING, STATIC, measured, simulate
from vfm_sdm.analysis.load_test import (
    Limits,
    LoadPlan,
    LoadStep,
    judge_load_test,
    read_load_test,
    write_load_test,
)
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.netcdf import write_displacement
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

RATE = 20
LOADS = np.array([0.0, 100.0, 200.0, 300.0, 150.0, 0.0])
STAND_S, MOVE_S = 20.0, 8.0
NOISE_MM, SCALE_STD = 0.05, 0.02


def steps_of_time(seconds, levels):
    """What stands for `STAND_S` at each level and moves on in `MOVE_S`, at given times."""
    each = STAND_S + MOVE_S
    number = np.minimum((seconds // each).astype(int), len(levels) - 1)
    x = np.clip((seconds - number * each - STAND_S) / MOVE_S, 0, 1)
    after = np.append(levels, levels[-1])[number + 1]
    return levels[number] + (after - levels[number]) * (3 * x**2 - 2 * x**3)


def plan_of(calculated, *, point="mid", timed=True):
    """The plan of a test whose steps stand as `steps_of_time` has them."""
    begin = np.arange(len(LOADS)) * (STAND_S + MOVE_S)
    times = [(b + 0.5, b + STAND_S - 0.5) if timed else (None, None) for b in begin]
    steps = [
        LoadStep(load, *time, {(point, "vertical"): value})
        for load, time, value in zip(LOADS, times, calculated, strict=True)
    ]
    return LoadPlan(tuple(steps), "kN")


def simulated(seed, ratio, residual):
    """Displacement of a test of 5 mm with vibration of 0.3 mm, its scale drawn; the plan and the true levels."""
    rng = np.random.default_rng(seed)
    calculated = 5.0 * LOADS / 300
    levels = calculated * ratio
    levels[-1] = residual * levels[3]
    seconds = np.arange(round((6 * STAND_S + 5 * MOVE_S) * RATE)) / RATE
    wave = 0.3 * np.sqrt(2) * np.sin(2 * np.pi * rng.uniform(1.2, 3) * seconds + rng.uniform(0, 6))
    strength = 1 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.02, 0.1) * seconds + rng.uniform(0, 6))
    shown = (steps_of_time(seconds, levels) + strength * wave) * (1 + rng.normal(0, SCALE_STD))
    values = np.zeros((len(seconds), 1, 3))
    values[:, 0, 1] = shown + rng.normal(0, NOISE_MM, len(seconds))
    data = make_displacement(
        seconds,
        ["mid"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(values.shape, NOISE_MM),
            scale_std=np.full((1, 3), SCALE_STD),
            position_m=np.zeros(values.shape),
            reprojection_error_px=np.zeros(values.shape[:2]),
            status=np.zeros(values.shape[:2]),
        ),
        attrs={"frame": "structure"},
    )
    budget = np.zeros((len(COMPONENTS), *values.shape))
    budget[COMPONENTS.index("random")] = NOISE_MM
    budget[COMPONENTS.index("cameras")] = SCALE_STD * np.abs(values)
    budget = (("component", "time", "point", "axis"), budget, {"units": "mm"})
    return data.assign(uncertainty=budget).assign_coords(component=list(COMPONENTS)), calculated, levels


@pytest.fixture(scope="module")
def many():
    """200 tests: what was judged, and what is true."""
    judged = []
    for seed in range(200):
        rng = np.random.default_rng([seed, 1])
        ratio, residual = rng.uniform(0.92, 1.08), rng.uniform(0.14, 0.16)
        data, calculated, levels = simulated(seed, ratio, residual)
        result = judge_load_test(data, plan_of(calculated)).sel(point="mid", axis="vertical")
        judged.append((result, ratio, residual, levels))
    return judged


def test_level_errors_lie_inside_their_intervals(many):
    held = np.array(
        [
            np.abs(result["deflection"].values - levels)[1:] <= result["expanded_uncertainty"].values[1:]
            for result, _, _, levels in many
        ]
    )
    # Steps of one test share the error of the scale: 200 draws count, of which three standard deviations are 4.6 %.
    assert held.mean() == pytest.approx(0.95, abs=0.046)


@pytest.mark.parametrize("what", ["ratio", "residual"])
def test_probabilities_of_exceedance_are_frequencies(many, what):
    if what == "ratio":
        said = np.array([float(result["ratio_exceeded"][3]) for result, *_ in many])
        true = np.array([ratio > 1.0 for _, ratio, _, _ in many])
    else:
        said = np.array([float(result["residual_exceeded"]) for result, *_ in many])
        true = np.array([residual > 0.15 for _, _, residual, _ in many])
    edges = [0.0, 0.1, 0.5, 0.9, 1.0]
    for low, high in pairwise(edges):
        inside = (said >= low) & ((said < high) | (high == 1.0))
        assert inside.sum() > 5
        expected = said[inside].mean()
        spread = np.sqrt(np.sum(said[inside] * (1 - said[inside]))) / inside.sum()
        assert true[inside].mean() == pytest.approx(expected, abs=3 * spread + 1 / inside.sum())


def test_what_remains_knows_nothing_of_the_scale(many):
    """A residual's share is far better known than either deflection, because both have the same scale."""
    widths = [float(result["share_high"] - result["share_low"]) for result, *_ in many]
    largest = [float(result["expanded_uncertainty"][3] / abs(result["deflection"][3])) for result, *_ in many]
    assert np.median(largest) > 0.9 * 2 * SCALE_STD
    assert np.median(widths) < 0.015
    held = [float(r["share_low"]) <= residual <= float(r["share_high"]) for r, _, residual, _ in many]
    assert np.mean(held) == pytest.approx(0.95, abs=0.046)


def test_a_point_that_did_not_move_has_no_share():
    data, calculated, _ = simulated(5, 1.0, 0.1)
    data["displacement"].values[:, 0, 0] = data["displacement"].values[:, 0, 1] / 1e3
    data["displacement"].values[:, 0, 0] += np.random.default_rng(1).normal(0, NOISE_MM, data.sizes["time"])
    result = judge_load_test(data, plan_of(calculated)).sel(point="mid")
    assert np.isnan(result["residual_share"].sel(axis="lateral"))
    assert np.isnan(result["residual_exceeded"].sel(axis="lateral"))
    assert np.isfinite(result["residual"].sel(axis="lateral"))
    assert np.isfinite(result["residual_share"].sel(axis="vertical"))


def test_flexibility_is_the_slope_against_load():
    data, calculated, _ = simulated(5, 1.0, 0.0)
    result = judge_load_test(data, plan_of(calculated)).sel(point="mid", axis="vertical")
    assert result["flexibility"].attrs["units"] == "mm/(kN)"
    assert abs(float(result["flexibility"]) - 5 / 300) < 3 * float(result["flexibility_std"])
    assert float(result["flexibility_std"]) == pytest.approx(SCALE_STD * 5 / 300, rel=0.2)


def test_standing_that_is_found_gives_the_same_levels():
    data, calculated, levels = simulated(7, 1.0, 0.1)
    found = judge_load_test(data, plan_of(calculated, timed=False))
    assert found.attrs["stillness"] == "found"
    of_point = found.sel(point="mid", axis="vertical")
    error = np.abs(of_point["deflection"].values - levels)
    assert (error[1:] <= 2 * of_point["expanded_uncertainty"].values[1:]).all()


def test_steps_that_are_not_seen_are_not_known(tmp_path):
    data, calculated, _ = simulated(3, 1.0, 0.1)
    data["status"].values[data["time"].values > 5 * (STAND_S + MOVE_S)] = 2
    result = judge_load_test(data, plan_of(calculated))
    one = result.sel(point="mid", axis="vertical")
    assert np.isfinite(one["deflection"].values).tolist() == [True] * 5 + [False]
    assert np.isnan(one["residual"])
    assert np.isfinite(one["flexibility"])


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (plan_of(LOADS, point="nowhere"), "expected calculated values of measured points"),
        (
            LoadPlan((LoadStep(0, 0.0, 5.0, {}), LoadStep(1, 500.0, 510.0, {})), ""),
            "expected steps within the recording",
        ),
    ],
)
def test_plans_of_another_recording_are_refused(plan, message):
    data, _, _ = simulated(3, 1.0, 0.1)
    with pytest.raises(DatasetError, match=message):
        judge_load_test(data, plan)
    with pytest.raises(DatasetError, match="expected displacement with a budget"):
        judge_load_test(data.drop_vars("uncertainty"), plan)


@pytest.mark.parametrize("limits", [{"ratio": np.nan}, {"ratio": -1.0}, {"residual": np.inf}, {"residual": 0.0}])
def test_limits_that_are_none_are_refused(limits):
    with pytest.raises(DatasetError, match=r"expected a limit of the [a-z]+ above 0"):
        Limits(**limits)


def test_files_say_what_was_judged(tmp_path):
    data, calculated, _ = simulated(3, 1.0, 0.1)
    result = judge_load_test(data, plan_of(calculated))
    netcdf, table = write_load_test(tmp_path, result)
    xr.testing.assert_identical(read_load_test(tmp_path).drop_attrs(), result.drop_attrs())
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 6 * 3
    for row in rows:
        one = result.sel(step=int(row["step"]), point=row["point"], axis=row["axis"])
        for name, key in (("deflection_mm", "deflection"), ("ratio", "ratio"), ("load [kN]", "load")):
            known = float(one[key])
            assert (row[name] == "") if np.isnan(known) else float(row[name]) == pytest.approx(known, rel=1e-5)
    netcdf.unlink()
    assert read_load_test(tmp_path) is None


def test_the_command(command, tmp_path):
    data, calculated, _ = simulated(3, 1.2, 0.1)
    write_displacement(tmp_path, data)
    steps = tmp_path / "steps [1].csv"
    rows = [f"{load},{value}" for load, value in zip(LOADS, calculated, strict=True)]
    steps.write_text("\n".join(["load [kN],mid vertical [mm]", *rows]))
    status, out, err = command("load-test", tmp_path, steps, "--ratio", "1.1")
    assert (status, err) == (0, "")
    assert "P(> 1.1)" in out
    assert "compare begin and end with the notes of the test" in out
    assert (tmp_path / "figures" / "load_test.png").stat().st_size > 10_000
    found = read_load_test(tmp_path)
    assert float(found["ratio_exceeded"].sel(step=4, point="mid", axis="vertical")) > 0.99
    assert command("load-test", tmp_path, steps, "--axis", "up")[0] == 1


@pytest.mark.slow
def test_levels_of_a_measurement_lie_inside_their_intervals(monkeypatch):
    """Cameras, scale and axes as they are found on a site: the whole budget counts."""
    levels = np.array([0.0, 1.0, 3.0, 5.0, 2.0, 0.5])
    share = np.concatenate([[1.0], np.linspace(0.9, 0.5, len(MOVING) - 1), np.zeros(len(STATIC))])

    def true_motion(conditions, rng):
        def motion(seconds):
            vertical = steps_of_time(np.clip(seconds - 0.0, 0, None), levels)
            wave = 0.3 * np.sqrt(2) * np.sin(2 * np.pi * 2.1 * seconds) * (seconds > 2)
            along = np.stack([0 * seconds, vertical + wave, 0 * seconds], axis=-1)
            return along[:, None] * share[:, None]

        return motion

    monkeypatch.setattr(measurements, "_true_motion", true_motion)
    held = []
    for seed in range(8):
        made = simulate(
            seed, duration_s=6 * STAND_S + 5 * MOVE_S, track_std_px=(0.02, 0.02), synchronization="none",
            time_offset_s=0.0, time_offset_std_s=0.002, time_offset_error_s=0.0,
        )  # fmt: skip
        found = measured(made.session, made.tracks, made.solution).displacement
        begin = np.arange(len(LOADS)) * (STAND_S + MOVE_S)
        plan = LoadPlan(
            tuple(LoadStep(a, b + 0.5, b + STAND_S - 0.5, {}) for a, b in zip(LOADS, begin, strict=True)), ""
        )
        result = judge_load_test(found, plan, Limits()).sel(axis="vertical")
        error = np.abs(result["deflection"].values - np.outer(levels, share))
        moving = [str(name) in MOVING for name in result["point"].values]
        held.append((error <= result["expanded_uncertainty"].values)[1:, moving].mean())
    # Of a site all levels share the error of the scale: of eight, one may lie outside.
    assert np.mean(np.array(held) > 0.5) >= 7 / 8 - 1e-9
    assert np.mean(held) > 0.8
