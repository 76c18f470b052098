"""What the audit says of cameras that move far: followed, by three points only, or lost."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit import AuditInputs
from vfm_sdm.stages.audit.tracks import check_camera_motion, check_halves, check_stabilization
from vfm_sdm.stages.camera_motion import ViewMotion

FRAMES = 300
TIME_S = np.arange(FRAMES) / 30
NAMES = ["mid", "pier", "wall", "rock", "block"]
WAY_PX = 60.0 * np.sin(2 * np.pi * 0.3 * TIME_S)[:, None, None]
SWING_PX = 4.0 * np.sin(2 * np.pi * 2.2 * TIME_S)
TURN_RAD = 0.03 * np.sin(2 * np.pi * 0.3 * TIME_S)[:, None] * np.array([1.0, -0.5, 0.3])


def tracks(far):
    """Tracks of a view, of a camera that moves far or of the same one at rest."""
    position = np.random.default_rng(0).normal(0, 0.01, (FRAMES, 5, 2)) + np.arange(5)[:, None] * [40.0, 15.0] + 200
    position[:, 0, 1] += SWING_PX
    covariance = np.tile(1e-4 * np.eye(2), (FRAMES, 5, 1, 1))
    return make_tracks(TIME_S, NAMES, position + WAY_PX * far, covariance, np.zeros((FRAMES, 5)), attrs={})


def inputs(status, *, mapped=True, left_px=0.02, halves=None):
    session = Session(
        name="drone",
        view=[{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4"}],
        site={"baseline": {"value": 4.0, "std": 0.01}},
        point=[{"name": n, "view": "left", "pixel": [9.0, 9.0], "static": n != "mid"} for n in NAMES],
    )
    flown = {view: tracks(True) for view in ("left", "right")}
    if halves is not None:
        flown = {view: one.assign(half_difference=(("time", "point", "pixel"), halves)) for view, one in flown.items()}
    steady = xr.concat([tracks(not mapped)] * 2, "view").assign_coords(view=["left", "right"])
    after = np.full(4, left_px)
    motion = ViewMotion(
        status, tuple(NAMES[1:]), TURN_RAD, TURN_RAD * 0, TURN_RAD, TURN_RAD * 0, np.full(4, 42.0), after, after
    )
    motions = {"left": motion, "right": motion}
    return AuditInputs(session=session, tracks=flown, aligned=steady, camera_motion=motions)


def test_what_was_followed_is_a_caution_that_says_what_is_left():
    check = check_camera_motion(inputs("followed"))
    assert check.outcome == Outcome.CAUTION
    assert "moved far: 42.00 px (rms)" in check.sentence
    assert "found by 4 static points; 0.020 px are left" in check.sentence


def test_three_points_are_a_caution_that_asks_for_a_fourth():
    check = check_camera_motion(inputs("followed by three static points", left_px=np.nan))
    assert check.outcome == Outcome.CAUTION
    assert check.sentence.endswith("name a fourth")


def test_static_points_that_disagree_fail():
    assert check_camera_motion(inputs("followed", left_px=3.0)).outcome == Outcome.FAIL


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ("too few static points", "fewer than three static points"),
        ("static points do not determine the pose", "do not show how"),
        ("no gain", "camera 'left' moved"),
    ],
)
def test_what_was_not_followed_fails(status, words):
    check = check_camera_motion(inputs(status, mapped=False))
    assert check.outcome == Outcome.FAIL
    assert words in check.sentence


@pytest.mark.parametrize(("status", "outcome"), [("followed", Outcome.PASS), ("no gain", Outcome.FAIL)])
def test_a_camera_that_moves_far_and_was_followed_is_no_stabiliser(status, outcome):
    assert check_stabilization(inputs(status, mapped=status == "followed")).outcome == outcome


@pytest.mark.parametrize(("own_px", "outcome"), [(0.0, Outcome.PASS), (2.0, Outcome.FAIL)])
def test_halves_may_move_apart_as_the_picture_turns_and_no_more(own_px, outcome):
    turned = np.einsum("ti,pij->tpj", TURN_RAD, np.random.default_rng(1).normal(0, 20, (5, 3, 2)))
    halves = turned + np.random.default_rng(2).normal(0, 0.01, (FRAMES, 5, 2))
    halves[:, 0, 1] += own_px * np.sin(2 * np.pi * 2.2 * TIME_S)
    assert check_halves(inputs("followed", halves=halves)).outcome == outcome
