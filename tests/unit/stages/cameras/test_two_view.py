from dataclasses import replace

import numpy as np
import pytest

from rooms import BASELINE_M, SIZE, TARGET, angle_between_deg, room_frames, room_rig, room_session
from simulation import looking_at, project_all, scene_points, simple_rig
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.profiles import expect_any
from vfm_sdm.inputs.session import Session, Site
from vfm_sdm.stages.cameras import related_views
from vfm_sdm.stages.cameras.relative_pose import estimate_relative_pose
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.two_view import TwoViewCameras
from vfm_sdm.stages.matching.features import FeatureMatches


def session(*, lens=True, baseline=True, views=("left", "right")):
    return Session(
        name="test",
        view=[
            {"name": n, "video": f"{n}.mp4", **({"lens": {"focal_px": 800.0, "relative_std": 0.03}} if lens else {})}
            for n in views
        ],
        site={"baseline": {"value": 4.0, "std": 0.01}} if baseline else {},
        point=[{"name": "p", "view": views[0], "pixel": [10.0, 10.0]}],
        method={"cameras": "two-view" if baseline or len(views) < 2 else "file"},
    )


def textured(rng, shape=(300, 400)):
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=shape), 2)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)


class TestRelativePose:
    def test_true_pose_from_matches_with_outliers(self):
        rng = np.random.default_rng(0)
        rig = simple_rig(distortion=True)
        u = project_all(rig, scene_points(rng, 400)) + rng.normal(0, 0.2, (2, 400, 2))
        u[1, :80] += rng.uniform(30, 300, (80, 2))
        pose, inliers = estimate_relative_pose(u[0], u[1], *rig.cameras)
        second = rig.cameras[1]
        np.testing.assert_allclose(pose[:, :3], second.rotation, atol=2e-3)
        direction = second.translation / np.linalg.norm(second.translation)
        assert np.degrees(np.arccos(np.clip(pose[:, 3] @ direction, -1, 1))) < 1.0
        assert inliers[80:].mean() > 0.98
        assert inliers[:80].mean() < 0.1

    def test_too_few_matches_have_no_inliers(self):
        rig = simple_rig()
        _, inliers = estimate_relative_pose(np.zeros((5, 2)), np.zeros((5, 2)), *rig.cameras)
        assert inliers.tolist() == [False] * 5


class TestTwoViewCameras:
    def test_unrelated_images_are_a_named_failure_not_a_rig(self):
        frames = {"left": textured(np.random.default_rng(3)), "right": textured(np.random.default_rng(4))}
        estimate = TwoViewCameras().estimate(session(), frames)
        assert estimate.rig is None
        assert estimate.status == CameraStatus.TOO_FEW_MATCHES
        assert "choose views that overlap more" in estimate.notes[0]

    def test_needs_two_views_and_a_baseline(self):
        frame = textured(np.random.default_rng(5))
        with pytest.raises(CameraError, match="expected at least two views"):
            TwoViewCameras().estimate(session(views=("left",)), {"left": frame})
        alone = session(views=("left",), baseline=False)
        with pytest.raises(CameraError, match=r"expected site\.baseline"):
            TwoViewCameras().estimate(alone, {"left": frame, "right": frame})

    def test_a_lens_nobody_stated_is_noted_and_uncertain(self):
        rng = np.random.default_rng(6)
        image = textured(rng, (340, 460))
        frames = {"left": image[20:320, 30:430], "right": image[10:310, 5:405]}
        estimate = TwoViewCameras().estimate(session(lens=False), frames)
        assert any("nothing known of the lens" in note for note in estimate.notes)
        if estimate.rig is not None:
            assert np.sqrt(estimate.rig.covariance[0, 0]) == pytest.approx(expect_any().std)


@pytest.fixture(scope="module")
def trio():
    """The true rig, whose cameras do not stand in a row, and what they see."""
    rig = room_rig(3)
    third = rig.cameras[2]
    pose = looking_at(third.center + np.array([-0.6, -1.5, 0.0]), TARGET)
    rig = Rig(rig.names, (*rig.cameras[:2], replace(third, cam_from_world=pose)), True)
    return rig, room_frames(rig)


def test_a_third_camera_in_a_row_is_placed_on_site():
    """Rendered pictures; the pairs' epipolar lines alone let it slide along the row by twelve per cent."""
    rig = room_rig(3)
    estimate = TwoViewCameras().estimate(room_session(rig), room_frames(rig))
    adjustment = adjust_to_site(estimate.rig, estimate.matches, Site(baseline={"value": BASELINE_M, "std": 0.002}))
    along = adjustment.rig.cameras[2].translation / adjustment.rig.baseline(0, 2)
    std = float(np.sqrt(along @ adjustment.rig.covariance[27:, 27:] @ along))
    error = adjustment.rig.baseline(0, 2) - rig.baseline(0, 2)
    assert adjustment.status == "ok"
    assert std < 0.01 * rig.baseline(0, 2)
    assert abs(error) < 3 * std


@pytest.fixture(scope="module")
def estimate(trio):
    rig, frames = trio
    return TwoViewCameras().estimate(room_session(rig), frames)


class TestThreeViews:
    def test_have_one_scale(self, trio, estimate):
        rig, _ = trio
        assert estimate.status == "ok"
        assert estimate.rig.baseline() == pytest.approx(BASELINE_M)
        assert estimate.rig.baseline(0, 2) == pytest.approx(rig.baseline(0, 2), rel=0.01)
        for found, true in zip(estimate.rig.cameras[1:], rig.cameras[1:], strict=True):
            assert angle_between_deg(found.rotation, true.rotation) < 0.2
            assert angle_between_deg(found.translation, true.translation) < 0.5

    def test_hand_on_what_the_further_ones_share(self, trio, estimate):
        rig, _ = trio
        assert [(m.first, m.second) for m in estimate.matches] == [(0, 1), (0, 2), (1, 2)]
        m = estimate.matches[2]
        error = sampson_error(m.points_first, m.points_second, rig, first=1, second=2)
        assert np.median(np.abs(error)) < 0.2

    def test_keep_their_scale_on_site(self, trio, estimate):
        rig, _ = trio
        site = Site(baseline={"value": BASELINE_M, "std": 0.002})
        adjustment = adjust_to_site(estimate.rig, estimate.matches, site)
        std = np.sqrt(np.diag(adjustment.rig.covariance))[27:]
        assert adjustment.rig.baseline(0, 2) == pytest.approx(rig.baseline(0, 2), rel=0.01)
        assert np.linalg.norm(std) < 0.05 * rig.baseline(0, 2)

    def test_without_common_points_are_a_named_failure(self, trio, monkeypatch):
        rig, frames = trio
        u = project_all(rig, np.random.default_rng(0).uniform([-2, -1, 10], [2, 1, 13], (400, 3)))
        u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))]
        # The first twenty features are matched in both pairs, all others in one.
        half = u.shape[1] // 2
        pairs = [(u[0, :half], u[1, :half]), (u[0, half - 20 :], u[2, half - 20 :])]
        seen = [FeatureMatches(*pair, np.ones(len(pair[0]))) for pair in pairs]
        monkeypatch.setattr(related_views, "match_features", lambda first, second, **_: seen.pop(0))
        estimate = TwoViewCameras().estimate(room_session(rig), frames)
        assert (estimate.rig, estimate.matches, estimate.status) == (None, (), CameraStatus.NO_COMMON_SCALE)
        assert "left, right and third: 20 matches go through all three, 30 are needed" in estimate.notes[-1]
