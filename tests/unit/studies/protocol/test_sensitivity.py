"""The sensitivity study: what it changes, what it leaves alone, and what it makes of the runs; nothing is filmed."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.studies.protocol import sensitivity
from vfm_sdm.studies.protocol.runs import FieldTest, MethodRun
from vfm_sdm.studies.protocol.sensitivity import PARAMETERS, run_sensitivity, sensitivity_plan
from vfm_sdm.studies.synthetic.field_test import _truth
from vfm_sdm.studies.synthetic.plan import Recording
from vfm_sdm.studies.synthetic.presets import preset
from vfm_sdm.studies.synthetic.survey import make_sessions

GAIN = {"none": 1.2, "sgr": 1.1}
"""What the stand-in for a measurement makes of the truth."""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Rows of a study in which every method yields the truth times a gain, and the plans and runs that it asked for."""
    folder = tmp_path_factory.mktemp("study")
    plans, runs = {}, []

    def prepare(place, plan, *, progress=None):
        plans[place.relative_to(folder).as_posix()] = plan
        return FieldTest(plan, place, make_sessions(plan, place)["session.toml"], _truth(plan), None)

    def run(test, method, place, *, progress=None):
        runs.append((test, method, place.relative_to(folder).as_posix()))
        if test.plan.name == "noise 8":
            return MethodRun(None, status="no cameras"), []
        changed = test.truth.copy(deep=True)
        changed["displacement"] *= GAIN[method.refinement]
        return MethodRun(changed), []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensitivity, "prepare_field_test", prepare)
        patch.setattr(sensitivity, "run_method", run)
        rows = run_sensitivity(folder, size="small")
    return rows, plans, runs


def test_the_plan_is_data_2_in_good_light_and_focus():
    plan, source = sensitivity_plan(), preset("data-2", "small")
    assert plan.site.image_size == (960, 540)
    assert (plan.fps, plan.duration_s) == (30, 4.0)
    assert plan.motion == source.motion
    assert plan.points == source.points[:2]
    assert [mounted.point for mounted in plan.accelerometers] == [point.name for point in plan.points]
    start_s = source.recordings[1].start_s
    assert plan.recordings == (Recording(), Recording(start_s=start_s))
    assert start_s != 0


def test_every_parameter_has_two_values_or_four_beside_the_plan_s_own():
    for values in PARAMETERS.values():
        assert (len(set(values["small"])), len(set(values["full"]))) == (2, 4)


def test_every_value_has_a_row_for_every_method_and_axis_in_order(study):
    rows = study[0]
    count = Counter((row.parameter, row.value) for row in rows)
    # Two methods and two axes at the plan's own value and at two more of five parameters.
    assert set(count.values()) == {4}
    assert len(count) == 15
    assert list(dict.fromkeys(row.parameter for row in rows)) == list(PARAMETERS)
    for name, values in PARAMETERS.items():
        found = list(dict.fromkeys(row.value for row in rows if row.parameter == name))
        assert found == sorted(found)
        assert set(values["small"]) < set(found)
    assert {(row.method, row.axis) for row in rows} == {
        (method, axis) for method in ("with SGR", "without SGR") for axis in ("vertical", "lateral")
    }


def test_the_plan_s_own_values_are_where_the_others_are_not(study):
    rows, plans, _ = study
    plan = plans["unchanged/recording"]
    own = {
        "amplitude [1]": 1.0,
        "defocus [px]": plan.recordings[0].defocus_px,
        "noise [grey levels]": plan.recordings[0].noise_std,
        "compression [crf]": plan.recordings[0].crf,
        "baseline [m]": plan.baseline_m,
    }
    for name, value in own.items():
        (other,) = {row.value for row in rows if row.parameter == name} - set(PARAMETERS[name]["small"])
        assert other == pytest.approx(value), name


def test_one_thing_is_changed_at_a_time(study):
    plans = dict(study[1])
    assert len(plans) == 11
    base = plans.pop("unchanged/recording")
    assert replace(base, name="sensitivity") == sensitivity_plan()
    for place, plan in plans.items():
        name, value = plan.name.split()
        assert place == f"{name}_{value}/recording"
        field = {"amplitude": "motion", "baseline": "site"}.get(name, "recordings")
        assert replace(plan, name=base.name, **{field: getattr(base, field)}) == base, name
        assert getattr(plan, field) != getattr(base, field)
        for recording, before in zip(plan.recordings, base.recordings, strict=True):
            known = {"defocus": "defocus_px", "noise": "noise_std", "compression": "crf"}
            if name in known:
                assert getattr(recording, known[name]) == float(value)
                assert replace(recording, **{known[name]: getattr(before, known[name])}) == before


def test_amplitude_scales_the_motion_and_nothing_else(study):
    base, scaled = study[1]["unchanged/recording"], study[1]["amplitude_0.2/recording"]
    time_s, places = np.linspace(1, 4, 50), [point.position for point in base.points]
    for what in ("displacement", "acceleration"):
        expected = 0.2 * getattr(base.motion, what)(time_s, places)
        assert np.abs(expected).max() > 1e-4
        np.testing.assert_allclose(getattr(scaled.motion, what)(time_s, places), expected, atol=1e-12)
    for what in ("support_m", "span_m", "still_s"):
        assert getattr(scaled.motion, what) == getattr(base.motion, what)


def test_the_baseline_is_as_long_as_asked_in_the_same_direction(study):
    base = np.array(study[1]["unchanged/recording"].site.further[0].center)
    for value in (1.0, 2.0):
        plan = study[1][f"baseline_{value:g}/recording"]
        assert plan.baseline_m == pytest.approx(value)
        np.testing.assert_allclose(np.cross(plan.site.further[0].center, base), 0, atol=1e-12)
        assert plan.site.further[0].target_m == sensitivity_plan().site.further[0].target_m


def test_cameras_points_and_clock_are_given(study):
    for test, method, place in study[2]:
        assert method.cameras == "file"
        assert place == f"{test.plan.name.replace(' ', '_')}/run"
        first, second = test.session.view
        assert (first.time_offset_s, second.time_offset_s) == (0.0, test.plan.recordings[1].start_s)
        assert second.time_offset_std_s == 0.002
        assert test.session.method.subset_px == 31
        camera = test.plan.site.cameras()[1]
        for given, point in zip(test.session.point, test.plan.points, strict=True):
            np.testing.assert_allclose(given.pixel_in["right"], camera.project(np.array(point.position)), atol=1e-9)
    assert Counter(method.refinement for _, method, _ in study[2]) == {"none": 11, "sgr": 11}


def test_errors_are_means_over_the_points_against_the_truth(study):
    rows, plans, _ = study
    plan = plans["defocus_2.5/recording"]
    truth = _truth(plan)["displacement"]
    for refinement, label in (("none", "without SGR"), ("sgr", "with SGR")):
        for axis in ("vertical", "lateral"):
            (row,) = [r for r in rows if (r.parameter, r.value, r.method, r.axis) == ("defocus [px]", 2.5, label, axis)]
            error = GAIN[refinement] - 1
            rms = [np.sqrt(np.mean((error * truth.sel(axis=axis, point=p.name)) ** 2)) for p in plan.points]
            spans = [np.ptp(truth.sel(axis=axis, point=p.name).values) for p in plan.points]
            assert row.rms_error_mm == pytest.approx(np.mean(rms))
            assert row.nrmse == pytest.approx(np.mean(np.divide(rms, spans)))


def test_a_run_without_displacement_is_an_unknown_error(study):
    failed = [row for row in study[0] if (row.parameter, row.value) == ("noise [grey levels]", 8.0)]
    assert len(failed) == 4
    assert np.isnan([(row.nrmse, row.rms_error_mm) for row in failed]).all()
    assert np.isfinite([row.nrmse for row in study[0] if row not in failed]).all()
