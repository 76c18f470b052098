"""Change of rest position with known cameras: values, intervals, and a reason wherever there is none."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.core.datasets import CAMERA_AXES, STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.statuses import PointStatus, RevisitStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.stages.revisit import compare as module
from vfm_sdm.stages.revisit import compare_to_baseline, compare_visits, read_visit, write_revisit
from vfm_sdm.stages.revisit.visit import rest_shifts
from visits import NAMES, NOISE_PX, STATIC, VIEWS, make_pair

CHANGE = {"mid": (0.3, 2.0, -0.1)}


@pytest.fixture
def compare(monkeypatch):
    """Compares a pair whose places are found as it says; ``statuses`` by point, in the left view."""

    def run(pair, statuses=None):
        views = iter(VIEWS)

        def find(images, cameras, places, named, *, subset_px):
            view = next(views)
            found = pair.found[view].copy()
            status = [PointStatus.OK] * len(found)
            for name, one in (statuses or {}).items() if view == "left" else ():
                status[NAMES.index(name)] = one
                found[NAMES.index(name)] = np.nan
            covariance = np.where(np.isnan(found)[..., None], np.nan, NOISE_PX**2 * np.eye(2))
            return found, covariance, status

        monkeypatch.setattr(module, "find_again", find)
        return compare_visits(pair.earlier, pair.later)

    return run


def by_name(revisit):
    return {one.point: one for one in revisit.changes}


def test_a_settlement_is_found_within_its_interval(compare):
    found = compare(make_pair(3, change_mm=CHANGE))
    assert (found.baseline, found.axes, found.static) == ("May", STRUCTURE_AXES, tuple(STATIC))
    changes = by_name(found)
    assert list(changes) == ["mid", "quarter"]
    for name, true in {"mid": CHANGE["mid"], "quarter": (0, 0, 0)}.items():
        one = changes[name]
        assert one.status is RevisitStatus.OK
        assert (np.abs(np.subtract(one.change_mm, true)) < 3 * np.array(one.std_mm)).all()
    # Two millimetres stand out, although each visit knows its positions to centimetres only.
    assert changes["mid"].std_mm[1] < 0.3
    assert abs(np.log(found.scale_ratio)) < 3 * found.scale_ratio_std < 0.1


def test_without_errors_the_change_is_exact(compare):
    pair = make_pair(estimate=False, change_mm=CHANGE)
    exact = {
        view: places["position"].values for view, places in ((v, pair.later.cameras.points.sel(view=v)) for v in VIEWS)
    }
    changes = by_name(compare(replace(pair, found=exact)))
    np.testing.assert_allclose(changes["mid"].change_mm, CHANGE["mid"], atol=2e-3)
    np.testing.assert_allclose(changes["quarter"].change_mm, 0.0, atol=2e-3)


@pytest.mark.hundreds
def test_intervals_hold_for_cameras_known_as_well_as_stated(compare, monkeypatch):
    """Errors over stated deviations have mean square one: of 24 draws with 6 values each, 0.6 to 1.6 holds 99 %."""
    monkeypatch.setattr(module, "_PLACE_STD_PX", 0.0)  # these places have noise alone
    scores = []
    for seed in range(24):
        changes = by_name(compare(make_pair(100 + seed, change_mm=CHANGE)))
        for name, true in {"mid": CHANGE["mid"], "quarter": (0, 0, 0)}.items():
            assert changes[name].status is RevisitStatus.OK
            scores += (np.subtract(changes[name].change_mm, true) / changes[name].std_mm).tolist()
    assert 0.6 < np.mean(np.square(scores)) < 1.6


def test_rest_is_the_still_interval_on_the_clock_of_each_view():
    pair = make_pair(estimate=False)
    still = pair.earlier.session.model_copy(
        update={"method": pair.earlier.session.method.model_copy(update={"still_interval_s": (0.5, 0.8)})}
    )
    time_s = np.arange(20) / 20
    moved = {}
    for view, offset in zip(VIEWS, (0.0, 0.2), strict=True):
        tracks = pair.earlier.tracks[view].copy(deep=True)
        resting = (time_s + offset >= 0.5) & (time_s + offset <= 0.8)
        tracks["position"].values[:, 0] += np.where(resting, 1.5, 0.0)[:, None] * [1.0, -2.0]
        tracks["status"].values[5:, 1] = 1  # lost
        moved[view] = tracks
    zeros = np.zeros((20, 1, 3))
    displacement = make_displacement(
        time_s,
        ["mid"],
        STRUCTURE_AXES,
        DisplacementArrays(zeros, zeros, np.zeros((1, 3)), zeros, np.zeros((20, 1)), np.zeros((20, 1), int)),
        attrs={"frame": "structure"},
    ).assign_coords(view=list(VIEWS))
    displacement = displacement.assign(clock_offset=("view", [0.0, 0.2]))
    visit = replace(pair.earlier, session=still, tracks=moved, displacement=displacement)
    for view in VIEWS:
        shift, covariance = rest_shifts(visit, view, NAMES)
        np.testing.assert_allclose(shift[0], [1.5, -3.0], atol=1e-9)
        np.testing.assert_allclose(shift[2:], 0.0, atol=1e-9)
        assert np.isnan(shift[1]).all()
        assert np.isnan(covariance[1]).all()


def test_the_mean_of_slow_motion_is_not_known_as_of_white_noise():
    pair = make_pair(estimate=False)
    tracks = pair.earlier.tracks["left"].copy(deep=True)
    tracks["position"].values[:, 0, 1] += np.repeat([0.0, 0.4, -0.3, 0.5], 5)
    visit = replace(pair.earlier, tracks={**pair.earlier.tracks, "left": tracks})
    shift, covariance = rest_shifts(visit, "left", NAMES)
    assert shift[0, 1] == pytest.approx(0.15)
    assert 0.05 < np.sqrt(covariance[0, 1, 1]) < 0.3
    assert np.sqrt(covariance[2, 1, 1]) == pytest.approx(1e-3)


REASONS = {
    "not found": ({"mid": PointStatus.NOT_FOUND}, RevisitStatus.NOT_FOUND),
    "look-alike": ({"mid": PointStatus.AMBIGUOUS}, RevisitStatus.LOOK_ALIKE),
}


@pytest.mark.parametrize("case", REASONS)
def test_a_point_that_is_not_seen_again_has_no_value(case, compare):
    statuses, expected = REASONS[case]
    changes = by_name(compare(make_pair(3, change_mm=CHANGE), statuses))
    assert changes["mid"].status is expected
    assert np.isnan([*changes["mid"].change_mm, *changes["mid"].std_mm]).all()
    assert changes["quarter"].status is RevisitStatus.OK


def test_two_static_points_are_too_few(compare):
    lost = dict.fromkeys(("s1", "s2", "s3"), PointStatus.NOT_FOUND)
    found = compare(make_pair(3), {**lost, "quarter": PointStatus.AMBIGUOUS})
    assert found.static == ("s4", "s5")
    assert by_name(found)["mid"].status is RevisitStatus.FEW_STATIC
    assert by_name(found)["quarter"].status is RevisitStatus.LOOK_ALIKE


@pytest.mark.slow
def test_a_static_point_that_moved_is_named(compare):
    found = compare(make_pair(3, change_mm={**CHANGE, "s3": (0.0, 15.0, 0.0)}))
    assert {one.status for one in found.changes} == {RevisitStatus.STATIC_MOVED}
    assert found.notes == ("without 's3' the others agree; check whether it stands still, or name it not static",)


@pytest.mark.slow
def test_where_several_moved_none_is_named(compare):
    moved = {"s1": (0.0, 15.0, 0.0), "s3": (0.0, -15.0, 0.0), "s5": (0.0, 20.0, 0.0)}
    found = compare(make_pair(3, change_mm=moved))
    assert {one.status for one in found.changes} == {RevisitStatus.STATIC_MOVED}
    assert found.notes == ("no single static point explains it",)


def test_of_three_static_points_none_can_be_told(compare):
    lost = dict.fromkeys(("s4", "s5"), PointStatus.NOT_FOUND)
    found = compare(make_pair(3, change_mm={"s3": (60.0, 0.0, 0.0)}), lost)
    assert {one.status for one in found.changes} == {RevisitStatus.STATIC_MOVED}
    assert found.notes == ("with a fourth static point the one that moved could be told",)


def test_three_static_points_check_little_and_a_note_says_so(compare):
    lost = dict.fromkeys(("s4", "s5"), PointStatus.NOT_FOUND)
    found = compare(make_pair(3, change_mm=CHANGE), lost)
    mid = by_name(found)["mid"]
    assert mid.status is RevisitStatus.OK
    assert (np.abs(np.subtract(mid.change_mm, CHANGE["mid"])) < 3 * np.array(mid.std_mm)).all()
    assert len(found.notes) == 1
    assert "one that moved across their plane would not be seen" in found.notes[0]
    assert compare(make_pair(3)).notes == ()


def test_scales_that_disagree_are_no_settlement(compare):
    found = compare(make_pair(3, later_scale=1.2))
    assert {one.status for one in found.changes} == {RevisitStatus.SCALES_DISAGREE}
    assert found.scale_ratio == pytest.approx(1.2, abs=0.05)


def test_visits_without_metric_cameras(compare):
    pair = make_pair(3)
    rig = pair.later.cameras.rig
    for other in (None, replace(rig, metric=False), replace(rig, names=("left", "third"))):
        later = replace(pair.later, cameras=replace(pair.later.cameras, rig=other))
        found = compare(replace(pair, later=later))
        assert {one.status for one in found.changes} == {RevisitStatus.NO_CAMERAS}


def test_a_solver_that_does_not_converge_says_so(compare, monkeypatch):
    adjust = module.adjust_visits
    monkeypatch.setattr(module, "adjust_visits", lambda *a, **k: replace(adjust(*a, **k), converged=False))
    assert {one.status for one in compare(make_pair(3)).changes} == {RevisitStatus.NOT_CONVERGED}


def test_without_axes_the_change_is_along_those_of_the_camera(compare):
    pair = make_pair(estimate=False, change_mm=CHANGE)
    earlier = replace(pair.earlier, cameras=replace(pair.earlier.cameras, frame=None))
    found = compare(replace(pair, earlier=earlier))
    assert found.axes == CAMERA_AXES
    assert by_name(found)["mid"].change_mm[1] == pytest.approx(2.0, abs=0.3)


def test_files_and_tables(compare, tmp_path):
    found = compare(make_pair(3, change_mm=CHANGE), {"quarter": PointStatus.NOT_FOUND})
    with write_revisit(tmp_path / "revisit.csv", found).open(encoding="utf-8") as stream:
        mid, quarter = csv.DictReader(stream)
    one = by_name(found)["mid"]
    assert float(mid["vertical [mm]"]) == pytest.approx(one.change_mm[1], rel=1e-5)
    assert float(mid["vertical U [mm]"]) == pytest.approx(2 * one.std_mm[1], rel=1e-5)
    assert (quarter["status"], quarter["vertical [mm]"]) == ("not found again in two views", "")
    table = found.as_table()
    assert table["changes"][0]["expanded_mm"] == [2 * std for std in one.std_mm]
    assert table["static"] == tuple(STATIC)


def test_a_session_without_an_earlier_visit():
    assert compare_to_baseline(make_pair().later) is None


def test_a_folder_that_is_no_run(tmp_path):
    with pytest.raises(SessionError, match=r"baseline_visit: expected the run folder of an earlier visit, .* got: .*"):
        read_visit(tmp_path)
