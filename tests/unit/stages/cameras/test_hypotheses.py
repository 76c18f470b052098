"""Cameras seen through long lenses: other solutions are found, and the reading that decides between them is named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_face_poses import AXES, BASELINE, LENS, SITE, second_camera

from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import Hypothesis
from vfm_sdm.stages.cameras.hypotheses import list_behind, weigh_hypotheses
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.matching.matches import Matches


def make_session(**second):
    views = [{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4", **second}]
    site = {"baseline": {"value": BASELINE, "std": 0.01}, **SITE.model_dump(exclude_none=True, exclude={"baseline"})}
    return Session(name="girder", view=views, site=site, point=[{"name": "p", "view": "left", "pixel": [1.0, 1.0]}])


def free_prior(cameras):
    """The rig with known lenses and a pose that is free."""
    std = [np.r_[0.01, 5.0, 5.0, 0.1, np.zeros(6)], np.r_[0.01, 5.0, 5.0, 0.1, np.ones(3), np.full(3, 2 * BASELINE)]]
    return Rig(("left", "right"), tuple(cameras), metric=True, covariance=np.diag(np.concatenate(std) ** 2))


def flat_matches(rng, second):
    """Matches on a scene of little depth, whose epipolar lines leave the pose open."""
    depth = rng.uniform(21, 24, 400)
    pixels = rng.uniform([20, 20], [1260, 700], (400, 2))
    points = np.column_stack([LENS.normalize(pixels), np.ones(400)]) * depth[:, None]
    seen = second.project(points) + rng.normal(0, 0.3, pixels.shape)
    inside = ((seen > 0) & (seen < (1280, 720))).all(axis=1)
    return Matches(0, 1, pixels[inside], seen[inside])


@pytest.fixture(scope="module")
def start():
    second = second_camera()
    matches = flat_matches(np.random.default_rng(1), second)
    return second, Hypothesis(free_prior([LENS, second]), (matches,))


def weigh(session, *hypotheses):
    readings = {view.name: view for view in session.view[1:]}
    return weigh_hypotheses(
        session, list(hypotheses), lambda h: adjust_to_site(h.rig, h.matches, session.site, readings=readings)
    )


@pytest.fixture(scope="module")
def another():
    """Matches of a repeated pattern that agree with a camera elsewhere."""
    second = second_camera(across=8.4)
    return Hypothesis(free_prior([LENS, second]), (flat_matches(np.random.default_rng(2), second),))


def test_one_solution_is_not_widened(start):
    second, one = start
    weighed = weigh(make_session(), one)
    assert weighed.rivals == ()
    assert weighed.adjusted.status == CameraStatus.OK
    assert np.linalg.norm(weighed.adjusted.rig.cameras[1].center - second.center) < 0.5


def test_solutions_that_remain_are_in_the_uncertainty_and_named(start, another):
    _, one = start
    weighed = weigh(make_session(), one, another)
    assert len(weighed.rivals) == 1
    assert weighed.adjusted.status == CameraStatus.SEVERAL
    assert any("distance of view 'right' would decide" in note for note in weighed.adjusted.notes)
    std = np.sqrt(np.diag(weighed.adjusted.rig.covariance))[17:20]
    away = weighed.adjusted.rig.cameras[1].translation - another.rig.cameras[1].translation
    assert np.all(np.abs(away) < 2 * std + 0.1)


@pytest.mark.parametrize("order", [1, -1])
def test_the_reading_that_decides_leaves_one(start, another, order):
    second, one = start
    across = {"value": 9.0 - float((AXES @ second.center)[0]), "std": 0.02}
    session = make_session(perpendicular_distance=across, stands="right", level={"pitch_deg": 2.4, "std_deg": 0.2})
    weighed = weigh(session, *[one, another][::order])
    assert weighed.rivals == ()
    assert np.linalg.norm(weighed.adjusted.rig.cameras[1].center - second.center) < 0.5


def test_the_side_on_which_a_camera_stands_excludes_its_mirror_image(start):
    second, one = start
    mirrored = replace(second, cam_from_world=np.column_stack([second.rotation, -second.translation]))
    wrong = Hypothesis(free_prior([LENS, mirrored]), one.matches)
    weighed = weigh(make_session(), wrong, one)
    assert weighed.adjusted.rig.cameras[1].center[0] > 0


def test_a_later_adjustment_keeps_the_spread(start, another):
    _, one = start
    weighed = weigh(make_session(), one, another)
    alone = replace(weighed.adjusted, covariance=weighed.adjusted.covariance * 0, status=CameraStatus.OK)
    widened = weighed.widened(alone)
    assert widened.status == CameraStatus.SEVERAL
    assert np.diag(widened.covariance).max() > 0.01


def halved(one, other_half=None):
    """The hypothesis with one way of halving its matches; the other half may come from elsewhere."""
    [matches] = one.matches
    even = np.arange(len(matches)) % 2 == 0
    rest = Hypothesis(one.rig, (matches.chosen(~even),)) if other_half is None else other_half
    return replace(one, halves=((Hypothesis(one.rig, (matches.chosen(even),)), rest),))


def test_halves_that_agree_change_nothing(start):
    _, one = start
    alone, weighed = weigh(make_session(), one), weigh(make_session(), halved(one))
    assert weighed.widened(weighed.adjusted).status == CameraStatus.OK
    std, before = (np.sqrt(np.diag(w.widened(w.adjusted).covariance)) for w in (weighed, alone))
    assert np.all(std < 2 * before + 1e-9)


def test_halves_that_give_another_roll_say_that_chance_decides(start):
    second, one = start
    rolled = second.perturbed([0, 0, 0, 0, 0, 0, np.radians(3), 0, 0, 0])
    other_half = Hypothesis(one.rig, (flat_matches(np.random.default_rng(3), rolled),))
    weighed = weigh(make_session(), halved(one, other_half))
    widened = weighed.widened(weighed.adjusted)
    assert widened.status == CameraStatus.NOT_CLEAR
    assert any("halves of the matches" in note for note in widened.notes)
    assert np.sqrt(widened.rig.covariance[16, 16]) > np.radians(1)


@pytest.mark.parametrize(("relative_std", "starts"), [(0.01, 1), (0.5, 6)])
def test_a_lens_that_may_be_longer_than_stated_gets_other_starts(start, relative_std, starts):
    second, one = start
    # Forty degrees as stated, fifteen at two standard deviations of the weaker statement.
    wide = [replace(camera, K=np.diag([0.25, 0.25, 1.0]) @ camera.K) for camera in (LENS, second)]
    rig = free_prior(wide)
    covariance = np.array(rig.covariance)
    covariance[0, 0] = covariance[10, 10] = relative_std**2
    asked = []

    def adjust(hypothesis):
        asked.append(hypothesis)
        return adjust_to_site(hypothesis.rig, (), make_session().site)

    weigh_hypotheses(make_session(), [Hypothesis(replace(rig, covariance=covariance), one.matches)], adjust)
    assert len(asked) == starts


def reversed_baseline(second):
    """The second camera on the other side: all epipolar lines are the same."""
    return replace(second, cam_from_world=np.column_stack([second.rotation, -second.translation]))


def about_turned(second):
    """The second camera turned by half a turn about the baseline."""
    axis = second.center / np.linalg.norm(second.center)
    rotation = second.rotation @ Rotation.from_rotvec(np.pi * axis).as_matrix()
    return replace(second, cam_from_world=np.column_stack([rotation, -rotation @ second.center]))


@pytest.mark.parametrize("change", [reversed_baseline, about_turned])
def test_matches_behind_the_cameras_are_told_where_no_epipolar_error_is(start, change):
    second, hypothesis = start
    rig = free_prior([LENS, second])
    wrong = free_prior([LENS, change(second)])
    (m,) = hypothesis.matches
    errors = [np.abs(sampson_error(m.points_first, m.points_second, one)) for one in (rig, wrong)]
    np.testing.assert_allclose(*errors, atol=1e-6)
    assert list_behind(rig, hypothesis.matches) == []
    (note,) = list_behind(wrong, hypothesis.matches)
    assert note.startswith(
        f"{len(m)} of {len(m)} matches of 'left' and 'right' do not lie in front of both cameras; use"
    )
