"""Checks one by one, each on the few products that it reads, made by hand."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.datasets import (
    STRUCTURE_AXES,
    DisplacementArrays,
    Status,
    make_displacement,
    make_points,
    make_tracks,
)
from vfm_sdm.core.statuses import CameraStatus, ClockStatus, ClockUse, Outcome, RecordingStatus, RefinementStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit.clocks import check_drift, check_synchronization
from vfm_sdm.stages.audit.geometry import check_agreement, check_baseline, check_site
from vfm_sdm.stages.audit.model import AuditInputs
from vfm_sdm.stages.audit.signal import check_gain, check_recording, check_refinement, check_signal
from vfm_sdm.stages.audit.still import check_still_interval
from vfm_sdm.stages.audit.tracks import (
    check_camera_motion,
    check_frozen,
    check_slip,
    check_static_points,
    check_tracked,
)
from vfm_sdm.stages.camera_motion import ViewMotion
from vfm_sdm.stages.cameras.site import SiteQuantity
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.tracking.track_noise import include_static_noise

FRAMES = 300
TIME_S = np.arange(FRAMES) / 30


def session(**method):
    points = [{"name": "mid", "view": "left", "pixel": [100.0, 80.0]}]
    points.append({"name": "wall", "view": "left", "pixel": [30.0, 80.0], "static": True})
    views = [{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4"}]
    site = {"baseline": {"value": 4.0, "std": 0.01}}
    return Session(name="bridge", view=views, site=site, point=points, method=method)


def swing(amplitude, *, hz=2.2):
    return amplitude * np.sin(2 * np.pi * hz * TIME_S * (1 + 0.01 * TIME_S))


def displacement(mid_mm=(1.0, 4.0, 0.0), wall_mm=(0.0, 0.0, 0.0), *, std_mm=0.01, status=None):
    """Displacement of both points, an amplitude an axis [mm], with noise as stated."""
    rng = np.random.default_rng(0)
    shape = (FRAMES, 2, 3)
    values = np.stack([[swing(a) for a in of_point] for of_point in (mid_mm, wall_mm)]).transpose(2, 0, 1)
    return make_displacement(
        TIME_S,
        ["mid", "wall"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values + rng.normal(0, std_mm, shape),
            displacement_std_mm=np.full(shape, std_mm),
            scale_std=np.zeros((2, 3)),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2], int) if status is None else status,
        ),
        attrs={"frame": "structure"},
    )


def tracks(v_px=5.0, **attrs):
    """Tracks of one view: the point moves up and down, the wall stands."""
    rng = np.random.default_rng(1)
    position = np.tile([[100.0, 80.0], [30.0, 80.0]], (FRAMES, 1, 1))
    position[:, 0, 1] += swing(v_px)
    covariance = np.broadcast_to(1e-4 * np.eye(2), (FRAMES, 2, 2, 2))
    noise = rng.normal(0, 0.01, position.shape)
    return make_tracks(TIME_S, ["mid", "wall"], position + noise, covariance, np.zeros((FRAMES, 2), int), attrs=attrs)


def aligned(left=None, right=None, *, clock_status="ok", offset_std=1e-4):
    pair = [left or tracks(), right or tracks()]
    both = xr.concat(pair, "view", combine_attrs="override").assign_coords(view=["left", "right"])
    return both.assign(
        clock_offset_std=("view", [0.0, offset_std]),
        clock_status=("view", np.array(["ok", clock_status], dtype=object)),
    )


def quantity(name="baseline", *, value=4.0, prior=4.0, std=0.01, prior_std=0.01):
    return SiteQuantity(name=name, prior=prior, prior_std=prior_std, value=value, std=std, units="m")


def cameras(*quantities, status=CameraStatus.OK):
    position = np.full((2, 2, 2), np.nan)
    points = make_points(
        ["left", "right"], ["mid", "wall"], position=position, position_std=position, status=[["ok"] * 2] * 2
    )
    return CameraSolution(None, None, None, points, quantities=quantities, status=status)


def test_a_check_names_the_product_that_it_lacks():
    with pytest.raises(DatasetError, match=r"expected the product 'tracks', got \['aligned'\]; give it to AuditInputs"):
        check_recording(AuditInputs(aligned=aligned()))
    with pytest.raises(DatasetError, match=r"got \['trakcs'\]; correct their names"):
        AuditInputs(trakcs={})


@pytest.mark.parametrize(
    ("record", "outcome", "figure"),
    [
        ({}, Outcome.PASS, 0.0),
        ({"dropped": 3}, Outcome.CAUTION, 0.01),
        ({"duplicated": 60}, Outcome.FAIL, 0.2),
        ({"status": RecordingStatus.TRUNCATED}, Outcome.CAUTION, np.nan),
    ],
)
def test_recordings(record, outcome, figure):
    whole = {"frames": 300, "dropped": 0, "duplicated": 0, "status": RecordingStatus.OK}
    found = check_recording(AuditInputs(tracks={"left": tracks(recording={**whole, **record})}))
    assert found.outcome == outcome
    assert found.value == pytest.approx(figure, nan_ok=True)
    assert found.where == ("left" if outcome != Outcome.PASS else found.where)


def test_samples_missing():
    status = np.zeros((FRAMES, 2), int)
    for lost, outcome in ((0, Outcome.PASS), (30, Outcome.CAUTION), (200, Outcome.FAIL)):
        status[:lost, 0] = Status.LOST
        found = check_tracked(AuditInputs(session=session(), displacement=displacement(status=status)))
        assert (found.outcome, found.value) == (outcome, pytest.approx(lost / FRAMES))


@pytest.mark.parametrize(
    ("amplitudes", "outcome"),
    [((1.0, 4.0, 0.0), Outcome.PASS), ((0.04, 4.0, 0.0), Outcome.CAUTION), ((0.0, 0.0, 0.0), Outcome.FAIL)],
)
def test_signal_to_noise(amplitudes, outcome):
    found = check_signal(AuditInputs(session=session(), displacement=displacement(amplitudes)))
    assert found.outcome == outcome
    if outcome == Outcome.CAUTION:
        assert found.where == "lateral of mid"


@pytest.mark.parametrize(
    ("interval", "outcome"), [((0.0, 1.0), Outcome.PASS), ((0.0, 0.2), Outcome.PASS), ((3.0, 3.2), Outcome.FAIL)]
)
def test_still_interval(interval, outcome):
    found = check_still_interval(
        AuditInputs(
            session=session(still_interval_s=interval),
            displacement=at_rest_first(),
            aligned=aligned(),
            tracks={},
            cameras=cameras(),
        )
    )
    assert found.outcome == outcome


def test_no_still_interval_no_check():
    assert check_still_interval(AuditInputs(session=session(), displacement=displacement())) is None


def at_rest_first():
    """Displacement that begins after a second."""
    found = displacement()
    noise = np.random.default_rng(2).normal(0, 0.01, found["displacement"].shape)
    moving = (TIME_S > 1)[:, None, None]
    return found.assign(displacement=found["displacement"].copy(data=np.where(moving, found["displacement"], noise)))


@pytest.mark.parametrize(("wall_mm", "outcome"), [(0.0, Outcome.PASS), (0.8, Outcome.CAUTION), (3.0, Outcome.FAIL)])
def test_static_points(wall_mm, outcome):
    unrefined = displacement(wall_mm=(0.0, wall_mm, 0.0))
    found = check_static_points(AuditInputs(session=session(), aligned=aligned(), unrefined=unrefined))
    assert (found.outcome, found.where) == (outcome, "wall" if outcome != Outcome.PASS else found.where)


def test_slip_along_the_structure():
    good = displacement()
    bad = good.copy(deep=True)
    bad["displacement"].loc[{"point": "mid", "axis": "longitudinal"}] += np.linspace(0, 2, FRAMES)
    assert check_slip(AuditInputs(session=session(), unrefined=good)).outcome == Outcome.PASS
    found = check_slip(AuditInputs(session=session(), unrefined=bad))
    assert (found.outcome, found.where) == (Outcome.CAUTION, "mid")


def test_a_frozen_track():
    frozen = tracks()
    frozen["position"].values[100:160, 0] = frozen["position"].values[100, 0]
    for right, outcome in ((tracks(), Outcome.PASS), (frozen, Outcome.FAIL)):
        pair = {"left": tracks(), "right": right}
        found = check_frozen(AuditInputs(session=session(), tracks=pair, aligned=aligned(right=right)))
        assert found.outcome == outcome
    assert found.where == "mid in right"


@pytest.mark.parametrize(
    ("difference", "outcome"), [(0.01, Outcome.PASS), (-0.1, Outcome.CAUTION), (0.4, Outcome.FAIL)]
)
def test_left_and_right(difference, outcome):
    shown = displacement().assign(gain_difference=("point", [difference, 0.9]))
    assert check_agreement(AuditInputs(session=session(), displacement=shown)).outcome == outcome


def test_left_and_right_tell_nothing_where_no_sample_is_trusted():
    shown = displacement(status=np.full((FRAMES, 2), Status.UNRELIABLE)).assign(gain_difference=("point", [0.4, 0.9]))
    found = check_agreement(AuditInputs(session=session(), displacement=shown))
    assert found.outcome == Outcome.NOT_POSSIBLE


def test_the_site_against_the_adjustment():
    good, bad = quantity("range", std=0.005), quantity("range", value=4.1, std=0.005)
    assert check_site(AuditInputs(cameras=cameras(good))).outcome == Outcome.PASS
    found = check_site(AuditInputs(cameras=cameras(good, bad)))
    assert (found.outcome, found.where) == (Outcome.FAIL, "range")
    assert found.value == pytest.approx(0.1 / (0.01 * np.sqrt(0.75)))
    for status in (CameraStatus.NOT_IDENTIFIABLE, CameraStatus.BEHIND):
        lost = check_site(AuditInputs(cameras=cameras(status=status)))
        assert (lost.outcome, lost.sentence) == (Outcome.FAIL, f"{status}: the displacement has no usable scale")
    doubtful = check_site(AuditInputs(cameras=cameras(good, status=CameraStatus.CONTRADICTION)))
    assert (doubtful.outcome, doubtful.sentence.split(";")[0]) == (Outcome.CAUTION, CameraStatus.CONTRADICTION)


def test_what_error_of_the_baseline_would_be_seen():
    alone = check_baseline(AuditInputs(cameras=cameras(quantity())))
    assert alone.outcome == Outcome.NOT_POSSIBLE
    assert "a wrong baseline cannot be seen" in alone.sentence
    # A spare length takes half of the variance away: an error of 4 std / sqrt(1/2) over 4 m is seen.
    spare = check_baseline(AuditInputs(cameras=cameras(quantity(std=0.01 / np.sqrt(2)))))
    assert (spare.outcome, spare.value) == (Outcome.PASS, pytest.approx(4 * 0.01 * np.sqrt(2) / 4.0))


def test_a_clock_that_nobody_knows():
    unknown = aligned(clock_status=ClockStatus.NO_MOTION, offset_std=np.nan)
    found = check_synchronization(AuditInputs(session=session(), tracks={"left": 0, "right": 0}, aligned=unknown))
    assert (found.outcome, found.where) == (Outcome.FAIL, "right")


def test_points_that_the_clocks_leave_out_are_named():
    uses = np.array([[ClockUse.USED, ClockUse.USED], [ClockUse.USED, ClockUse.DISAGREES]], dtype=object)
    inputs = {"session": session(), "tracks": {"left": tracks(), "right": tracks()}}
    found = check_synchronization(AuditInputs(**inputs, aligned=aligned().assign(clock_use=(("view", "point"), uses))))
    assert found.outcome == Outcome.PASS
    assert found.sentence.endswith("without 'wall', which moves otherwise than most: check its place")
    assert "without" not in check_synchronization(AuditInputs(**inputs, aligned=aligned())).sentence


def test_drift_of_a_short_recording_is_not_possible():
    short = aligned().isel(time=slice(0, 150))
    found = check_drift(AuditInputs(session=session(), aligned=short))
    assert found.outcome == Outcome.NOT_POSSIBLE
    assert "shorter than 8 s" in found.sentence
    assert check_drift(AuditInputs(session=session(), aligned=aligned())).outcome == Outcome.PASS


def test_a_network_that_measures_by_itself():
    alone = {"left": tracks(weights="mine")}
    assert check_gain(AuditInputs(tracks=alone)).outcome == Outcome.CAUTION


def test_points_that_were_not_refined():
    shown = displacement().assign(
        refinement_status=("point", np.array([RefinementStatus.TOO_FEW_FRAMES, RefinementStatus.OK], dtype=object))
    )
    found = check_refinement(AuditInputs(session=session(refinement="sgr"), displacement=shown))
    assert (found.outcome, found.where, found.value) == (Outcome.CAUTION, "mid", 1.0)
    assert check_refinement(AuditInputs(session=session(), displacement=shown)) is None


def test_tripods_without_static_points():
    nothing = AuditInputs(
        session=session().model_copy(update={"point": session().point[:1]}),
        tracks={"left": tracks()},
        aligned=aligned(),
        camera_motion={},
    )
    found = check_camera_motion(nothing)
    assert found.outcome == Outcome.NOT_POSSIBLE
    assert "static = true" in found.sentence


def in_air(rng, std, shape):
    """Noise that keeps 0.9 of itself from frame to frame, shape (T, ...)."""
    steps = rng.normal(0, std * np.sqrt(1 - 0.9**2), shape)
    for frame in range(1, len(steps)):
        steps[frame] += 0.9 * steps[frame - 1]
    return steps


def test_slow_errors_are_no_slip():
    trembling = displacement(std_mm=0.5)
    rng = np.random.default_rng(0)
    for point in ("mid", "wall"):
        trembling["displacement"].loc[{"point": point, "axis": "longitudinal"}] += in_air(rng, 2.0, FRAMES)
    assert check_slip(AuditInputs(session=session(), unrefined=trembling)).outcome == Outcome.PASS


@pytest.mark.parametrize(("status", "outcome"), [("no gain", Outcome.PASS), ("still", Outcome.FAIL)])
def test_air_that_moves_static_points_one_by_one_is_no_tripod(status, outcome):
    points = [*session().point, session().point[1].model_copy(update={"name": "pier"})]
    both = session().model_copy(update={"point": points})
    rng = np.random.default_rng(0)
    views = {}
    for view in ("left", "right"):
        one = tracks(v_px=1.0)
        shaken = xr.concat([one, one.sel(point=["wall"]).assign_coords(point=["pier"])], "point")
        shaken["position"][:, 1:] += in_air(rng, 0.4, (FRAMES, 2, 2))
        views[view] = shaken
    steady = aligned(*include_static_noise(views, ["wall", "pier"]).values())
    nothing = np.full((FRAMES, 3), np.nan)
    rms_px, rest = np.full(2, 0.5), np.zeros((2, 2))
    motion = ViewMotion(status, ("wall", "pier"), nothing, nothing, nothing, nothing, rms_px, rms_px, rest)
    found = check_camera_motion(
        AuditInputs(session=both, tracks=views, aligned=steady, camera_motion={"left": motion, "right": motion})
    )
    assert found.outcome == outcome
