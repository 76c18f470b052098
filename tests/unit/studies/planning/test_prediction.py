"""Predictions against closed forms, shares against Euler's theorem, the geometry against the plan's own numbers."""

from dataclasses import replace

import numpy as np
import pytest

from planned import a_plan, fields
from vfm_sdm.errors import SessionError
from vfm_sdm.studies.planning.advice import list_advice, pan_clip_std
from vfm_sdm.studies.planning.layout import check_seen, lay_out
from vfm_sdm.studies.planning.prediction import predict
from vfm_sdm.studies.planning.shares import list_shares
from vfm_sdm.studies.planning.simulation import adjust, list_matches, predict_noise_px

EXACT_LENS = {"focal_px": 4820.0, "relative_std": 1e-6}
EXACT = {"perpendicular_std_m": 1e-5, "longitudinal_std_m": 1e-5, "level_std_deg": 1e-4}


def known_lenses(laid):
    """The layout with lenses of which everything is known."""
    covariance = np.tile(1e-12 * np.eye(4), (len(laid.cameras), 1, 1))
    return replace(laid, priors=replace(laid.priors, intrinsics_covariance=covariance))


@pytest.fixture(scope="module")
def prediction():
    return predict(a_plan())


def test_the_geometry_is_that_of_the_plan():
    laid = lay_out(a_plan())
    pixels, site = laid.pixels, laid.session.site
    assert site.baseline.value == pytest.approx(np.hypot(1.0, 3.2))
    assert site.perpendicular_distance.value == 7.0
    # The middle of the picture shows the middle of the moving points, 5.5 m along.
    assert site.longitudinal_distance.value == pytest.approx(3.5)
    assert site.structure_side == "right"
    first = laid.cameras[0]
    middle = (np.array(first.image_size) - 1) / 2
    ray = np.append(first.normalize(middle), 1) @ first.rotation
    assert ray * 7.0 / ray[0] == pytest.approx([7.0, -0.05, 3.5])
    # A ray to a place is seen at its pixel, and triangulated to it.
    assert laid.points3d[0] == pytest.approx([7.0, 0.0, 3.0])
    assert first.project(laid.points3d)[0] == pytest.approx(pixels[0, 0])


def test_a_structure_on_the_left_is_noted_so():
    cameras = [{**one, "longitudinal_m": 12.0 - one["longitudinal_m"]} for one in fields()["camera"]]
    laid = lay_out(a_plan(camera=cameras))
    assert laid.session.site.structure_side == "left"
    assert laid.session.site.longitudinal_distance.value == pytest.approx(4.5)
    # The adjustment of exact values stays at the truth.
    adjusted = adjust(laid, list_matches(laid))
    assert np.abs(adjusted.frame.rotation - laid.structure_from_cam1).max() < 1e-9


def test_points_that_nobody_sees_are_named():
    points = [*fields()["point"], {"name": "far end", "longitudinal_m": 11.9, "height_m": 1.5}]
    cameras = [{**one, "looks_at": (5.5, 1.5)} for one in fields()["camera"]]
    with pytest.raises(SessionError, match=r"'far end' in none"):
        check_seen(lay_out(a_plan(point=points, camera=cameras)))


def test_a_camera_whose_name_is_no_file_name_is_named():
    first, second = fields()["camera"]
    with pytest.raises(SessionError, match="expected a name without slashes"):
        lay_out(a_plan(camera=[first, {**second, "name": "a/b"}]))


def test_with_all_else_known_the_scale_is_that_of_the_baseline():
    measured = {**EXACT, "baseline_std_m": 0.01 * float(np.hypot(1.0, 3.2))}
    laid = known_lenses(lay_out(a_plan(measured=measured)))
    found = predict(laid)
    # What the face tells of the baseline is little at a face offset of 0.1 m; it can only help.
    for one in found.axes:
        # Depth also rests on the directions in which the cameras look, which matches tell.
        assert 0.0085 < one.scale_std < (0.0105 if one.axis == "vertical" else 0.015)


def test_twice_the_noise_is_twice_the_random_part(prediction):
    noisier = predict(a_plan(structure={**fields()["structure"], "noise_px": 0.02}))
    for before, after in zip(prediction.axes, noisier.axes, strict=True):
        assert after.budget_mm["random"] == pytest.approx(2 * before.budget_mm["random"], rel=0.02)
        assert after.budget_mm["cameras"] == pytest.approx(before.budget_mm["cameras"], rel=0.1)
        assert after.detection_mm == pytest.approx(2 * before.detection_mm, rel=0.02)


def test_shares_add_up_to_one(prediction):
    shares = list_shares(prediction)
    assert sum(one.share for one in shares) == pytest.approx(1, abs=0.01)
    assert [one.share for one in shares] == sorted((one.share for one in shares), reverse=True)


def test_the_share_of_what_limits_is_what_its_removal_takes_away():
    plan = a_plan(structure={**fields()["structure"], "noise_px": 1e-4})
    laid = lay_out(plan)
    found = predict(plan)
    shares = {one.source: one.share for one in list_shares(found)}
    assert shares["focal lengths"] > 0.2
    priors = laid.priors.intrinsics_covariance.copy()
    priors[:, 0, :] *= 1e-3
    priors[:, :, 0] *= 1e-3
    better = predict(replace(laid, priors=replace(laid.priors, intrinsics_covariance=priors)))
    # Without it, other sources are weighed anew: at least its share of the variance is gone.
    assert (better.relative / found.relative) ** 2 < 1 - shares["focal lengths"] + 0.02


@pytest.mark.slow
def test_advice_leaves_what_the_plan_with_it_is_predicted_to_have(prediction):
    advice = list_advice(prediction)
    assert [one.left for one in advice] == sorted(one.left for one in advice)
    assert max(one.left for one in advice) < 1
    best = advice[0]
    assert predict(best.plan).relative == pytest.approx(best.left * prediction.relative)
    assert any("pan clip" in one.sentence for one in advice)


def test_a_pan_clip_tells_more_through_a_wider_lens():
    stds = [pan_clip_std(angle) for angle in (7, 14, 27, 40, 65, 90)]
    assert stds == sorted(stds, reverse=True)
    assert (stds[1], stds[3]) == (0.005, 0.001)


def test_noise_falls_with_contrast():
    assert predict_noise_px(10.0) == pytest.approx(2 * predict_noise_px(20.0), rel=0.05)


def test_motion_too_short_for_the_clocks_is_named():
    with pytest.raises(SessionError, match="motion that tells the offset between the cameras"):
        predict(a_plan(duration_s=2.2, motion={"vertical": {"amplitude_mm": 0.01, "frequency_hz": 0.3}}))
