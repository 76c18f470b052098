"""Points that must not move: what they show is not the structure's, and where they move it is said."""

import numpy as np
import pytest

from vfm_sdm.analysis.load_test import (
    LoadPlan,
    LoadStep,
    Passage,
    drop_static,
    find_moved_static,
    judge_load_test,
    judge_passages,
)
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

RATE, NOISE_MM = 20, 0.02
STEPS = ((0.0, 0.0, 10.0), (100.0, 15.0, 25.0), (0.0, 30.0, 40.0))
STATIC = {"pier", "rock"}


def displacement_of(vertical):
    """Displacement with noise, shape (T, P, 3) [mm], of points by their vertical motion [mm]."""
    seconds = np.arange(41 * RATE) / RATE
    values = np.random.default_rng(3).normal(0, NOISE_MM, (len(seconds), len(vertical), 3))
    for number, of_time in enumerate(vertical.values()):
        values[:, number, 1] += of_time(seconds)
    arrays = DisplacementArrays(
        displacement_mm=values,
        displacement_std_mm=np.full(values.shape, NOISE_MM),
        scale_std=np.full(values.shape[1:], 0.01),
        position_m=np.zeros(values.shape),
        reprojection_error_px=np.zeros(values.shape[:2]),
        status=np.zeros(values.shape[:2]),
    )
    data = make_displacement(seconds, list(vertical), STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
    budget = np.zeros((len(COMPONENTS), *values.shape))
    budget[COMPONENTS.index("cameras")] = 0.01 * np.abs(values)
    variable = (("component", "time", "point", "axis"), budget, {"units": "mm"})
    return data.assign(uncertainty=variable).assign_coords(component=list(COMPONENTS))


def loaded(size_mm):
    """A level that comes while the second step stands, and goes."""
    return lambda seconds: size_mm * np.interp(seconds, [11, 14, 26, 29], [0, 1, 1, 0])


def shaking(hertz):
    return lambda seconds: 0.2 * np.sin(2 * np.pi * hertz * seconds)


def judged(rock_mm, *, timed=True):
    data = displacement_of({"mid": loaded(4.0), "pier": loaded(0.0), "rock": loaded(rock_mm)})
    times = [times if timed else (None, None) for _, *times in STEPS]
    plan = LoadPlan(tuple(LoadStep(load, *at, {}) for (load, *_), at in zip(STEPS, times, strict=True)), "kN")
    return judge_load_test(data, plan, static=STATIC)


def test_a_static_point_that_deflects_is_named_with_its_step():
    (moved,) = find_moved_static(judged(0.15), STATIC)
    assert (moved.point, moved.axis, moved.number) == ("rock", "vertical", 2)
    assert moved.value_mm == pytest.approx(0.15, abs=moved.expanded_mm)
    assert 0 < moved.expanded_mm < 0.05


def test_static_points_at_rest_are_not_named():
    assert find_moved_static(judged(0.0), STATIC) == ()
    assert find_moved_static(judged(0.15), set()) == ()


def test_what_is_shown_are_points_that_may_move():
    assert drop_static(judged(0.0), STATIC)["point"].values.tolist() == ["mid"]


def test_static_points_do_not_tell_when_steps_stood():
    """A rock that jerks while the steps stand, by more than the structure moves."""
    data = displacement_of({"mid": loaded(4.0), "rock": lambda s: 50.0 * (np.floor(s / 5) % 2)})
    plan = LoadPlan(tuple(LoadStep(load, None, None, {}) for load, *_ in STEPS), "kN")
    found = judge_load_test(data, plan, static=STATIC)
    for begin, end, (_, first, last) in zip(found["begin_s"].values, found["end_s"].values, STEPS, strict=True):
        assert first - 1 <= begin < end <= last + 1


def test_what_a_static_point_shows_is_not_the_frequency_of_the_structure():
    """A tripod that rocks at 1.3 Hz, and a structure at 4 Hz that one point shows and the other does not."""
    shown = {"mid": shaking(4.0), "end": loaded(0.0), "pier": shaking(1.3)}
    data = displacement_of(shown)
    found = judge_passages(data, [Passage(12.0, 20.0)], static={"pier"})
    frequency = found["frequency"].sel(axis="vertical")
    assert frequency.values == pytest.approx([4.0, 4.0, 4.0], abs=0.02)
    assert np.isnan(found["frequency"].sel(axis="lateral")).all()
    assert found.attrs["frequency"] == "found"
    given = judge_passages(data, [Passage(12.0, 20.0)], static={"pier"}, frequency_hz=3.5)
    assert (given["frequency"] == 3.5).all()
    assert given.attrs["frequency"] == "given"


def test_a_static_point_that_moves_under_a_vehicle_is_named():
    crossing = lambda size: lambda s: size * np.sin(np.pi * np.clip((s - 12) / 8, 0, 1))  # noqa: E731
    still = judge_passages(
        displacement_of({"mid": crossing(4.0), "rock": loaded(0.0)}),
        [Passage(12.0, 20.0)],
        frequency_hz=4.0,
        static={"rock"},
    )
    moved = judge_passages(
        displacement_of({"mid": crossing(4.0), "rock": crossing(0.3)}),
        [Passage(12.0, 20.0)],
        frequency_hz=4.0,
        static={"rock"},
    )
    assert find_moved_static(still, {"rock"}) == ()
    (one,) = find_moved_static(moved, {"rock"})
    assert (one.point, one.axis, one.number) == ("rock", "vertical", 1)
    assert one.value_mm == pytest.approx(0.3, abs=2 * one.expanded_mm)
