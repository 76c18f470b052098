"""VGGT as a camera estimator, with a stand-in that knows the cameras, and with a small network of random weights."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("torch", reason="VGGT needs torch")

from known_cameras import KnownCameras, as_colors, vggt_cameras, with_pictures, write_pictures
from rooms import BASELINE_M, NAMES, room_frames, room_rig, room_session
from simulation import gain_error, intrinsics, project_all, scene_points, simple_rig
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std
from vfm_sdm.inputs.session import FirstFrames, Method, Network, Site, open_views
from vfm_sdm.networks import availability
from vfm_sdm.networks.vggt.pose import FOV, QUATERNION
from vfm_sdm.stages.cameras.base import estimator_of, find_estimator
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.matching.matches import Matches

# Width and height of a picture, and what VGGT makes of it: 518 px along the longer side, whole patches of 14 px.
LANDSCAPE, PORTRAIT, SQUARISH = ((640, 360), (518, 294)), ((300, 500), (308, 518)), ((417, 395), (518, 490))


def rig_of(sizes):
    """Cameras `BASELINE_M` apart with pictures of these sizes, turned to each other in no simple way."""
    cameras = []
    for index, size in enumerate(sizes):
        R = Rotation.from_rotvec([0.05 * index, -0.2 * index, 0.03 * index]).as_matrix()
        center = BASELINE_M * np.array([[0, 0, 0], [0.96, -0.28, 0], [1.7, 0.3, 0.4]])[index]
        cameras.append(
            Camera(intrinsics(700.0 + 90 * index, size), size, np.zeros(5), np.column_stack([R, -R @ center]))
        )
    return Rig(NAMES[: len(sizes)], tuple(cameras), True)


def noise(rig):
    """Pictures (height, width, 3) in which nothing matches."""
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (*camera.image_size[::-1], 3), dtype=np.uint8) for camera in rig.cameras]


@pytest.fixture
def asked(tmp_path):
    """What the estimator says of pictures without features, from a network that knows the rig."""

    def ask(pictures, *, lens_std=None, change=None):
        """A lens stated to be true within ``lens_std``, or none; ``change`` is made to what the network knows."""
        sizes, resized = zip(*pictures, strict=True)
        rig = rig_of(sizes)
        shown = noise(rig)
        write_pictures(tmp_path, rig.names, shown)
        known = KnownCameras(rig, shown, resized)
        if change is not None:
            change(known.poses)
        session = with_pictures(room_session(rig, lens=lens_std is not None, folder=tmp_path))
        if lens_std is not None:
            views = [
                v.model_copy(update={"lens": v.lens.model_copy(update={"relative_std": lens_std})})
                for v in session.view
            ]
            session = session.model_copy(update={"view": tuple(views)})
        return rig, vggt_cameras(tmp_path, known).estimate(session, FirstFrames(open_views(session)))

    return ask


class TestKnownCameras:
    @pytest.mark.parametrize(
        "pictures",
        [
            [LANDSCAPE, LANDSCAPE],
            [PORTRAIT, PORTRAIT],
            [LANDSCAPE, PORTRAIT],
            [SQUARISH, LANDSCAPE],
            [LANDSCAPE, PORTRAIT, SQUARISH],
        ],
        ids=["landscape", "portrait", "turned", "of other sizes", "three"],
    )
    def test_come_back_exactly(self, asked, pictures):
        rig, estimate = asked(pictures, lens_std=1e9)
        assert (estimate.status, estimate.rig.names, estimate.rig.metric) == ("ok", rig.names, True)
        for found, true in zip(estimate.rig.cameras, rig.cameras, strict=True):
            assert found.image_size == true.image_size
            np.testing.assert_allclose(found.K, true.K, rtol=1e-9)
            np.testing.assert_allclose(found.cam_from_world, true.cam_from_world, rtol=0, atol=1e-9)
        assert estimate.rig.baseline() == pytest.approx(BASELINE_M, rel=1e-12)

    def test_have_the_stated_uncertainty(self, asked):
        _, estimate = asked([LANDSCAPE, PORTRAIT, SQUARISH], lens_std=0.02)
        std = np.sqrt(np.diag(estimate.rig.covariance)).reshape(3, 10)
        np.testing.assert_allclose(std[:, 0], 1 / np.hypot(1 / 0.02, 1 / 0.05))
        np.testing.assert_array_equal(std[0, 4:], 0)
        # Radians, and metres whatever VGGT's unit is.
        np.testing.assert_allclose(std[1:, 4:7], 0.035)
        np.testing.assert_allclose(std[1:, 7:], 0.1 * BASELINE_M)
        np.testing.assert_array_equal(estimate.rig.covariance, np.diag(std.ravel() ** 2))

    def test_stand_alone_where_no_features_match(self, asked):
        _, estimate = asked([LANDSCAPE, PORTRAIT], lens_std=0.02)
        assert (estimate.status, estimate.matches) == ("ok", ())
        assert "left and right: " in estimate.notes[-1]
        assert "matches agree, 30 are needed" in estimate.notes[-1]


class TestFocalLengths:
    @pytest.mark.parametrize("lens_std", [0.01, 0.08])
    def test_are_the_weighted_mean_of_lens_and_network(self, asked, lens_std):
        def longer(poses):
            poses[:, FOV] = 2 * np.arctan(np.tan(poses[:, FOV] / 2) / 1.1)

        rig, estimate = asked([LANDSCAPE, PORTRAIT], lens_std=lens_std, change=longer)
        weight = lens_std**2 / (lens_std**2 + 0.05**2)
        for found, true in zip(estimate.rig.cameras, rig.cameras, strict=True):
            assert found.focal_px == pytest.approx(true.focal_px * 1.1**weight, rel=1e-12)
            np.testing.assert_array_equal(found.K[:2, 2], true.K[:2, 2])
        std = 1 / np.hypot(1 / lens_std, 1 / 0.05)
        np.testing.assert_allclose(np.sqrt(np.diag(estimate.rig.covariance))[[0, 10]], std)
        assert len(estimate.notes) == 1  # on features alone: it is within what both may be off

    def test_are_the_networks_where_nothing_is_known(self, asked):
        rig, estimate = asked([LANDSCAPE, PORTRAIT])
        for found, true in zip(estimate.rig.cameras, rig.cameras, strict=True):
            assert found.focal_px == pytest.approx(true.focal_px, rel=0.005)
        np.testing.assert_allclose(np.sqrt(np.diag(estimate.rig.covariance))[[0, 10]], 0.05, rtol=0.01)
        assert sum("nothing known of the lens" in note for note in estimate.notes) == 2

    def test_that_contradict_are_noted(self, asked):
        def longer(poses):
            poses[1, FOV] = 2 * np.arctan(np.tan(poses[1, FOV] / 2) / 1.3)

        rig, estimate = asked([LANDSCAPE, PORTRAIT], lens_std=0.01, change=longer)
        assert estimate.status == CameraStatus.CONTRADICTION
        # The session's word stands: a mean of the two would be a third focal length that nobody measured.
        assert estimate.rig.cameras[1].focal_px == pytest.approx(rig.cameras[1].focal_px, rel=1e-9)
        assert estimate.notes[0] == "view 'right': VGGT's focal length is +30% off what was known of it"

    def test_of_one_lens_that_differ_are_noted(self, asked):
        def stretched(poses):
            poses[0, 7] = 2 * np.arctan(np.tan(poses[0, 7] / 2) / 1.05)  # the vertical one

        rig, estimate = asked([LANDSCAPE, PORTRAIT], lens_std=1e9, change=stretched)
        assert estimate.notes[0] == "view 'left': VGGT gives two focal lengths, 700 and 735 px"
        assert estimate.rig.cameras[0].focal_px == pytest.approx(700 * np.sqrt(1.05), rel=1e-9)
        assert estimate.rig.cameras[1].focal_px == pytest.approx(rig.cameras[1].focal_px, rel=1e-9)

    def test_take_the_distortion_at_the_corner_along(self):
        rig = rig_of([(640, 360)] * 2)
        frames = {name: np.zeros((360, 640), np.uint8) for name in rig.names}
        priors = read_priors(room_session(rig, lens=False), frames, estimator="test")
        fused = priors.fused(np.full((2, 2), 2000.0), relative_std=1e-6, source="test")
        corner = np.hypot(640, 360) / 2 / 2000
        np.testing.assert_allclose(np.sqrt(fused.intrinsics_covariance[:, 3, 3]) * corner**2, 0.025, rtol=1e-6)
        np.testing.assert_array_equal(fused.intrinsics_covariance[:, 1:3], priors.intrinsics_covariance[:, 1:3])


def _no_field(poses):
    poses[1, FOV] = 0.0


def _half_a_field(poses):
    poses[0, 8] = np.nan


def _no_rotation(poses):
    poses[1, QUATERNION] = 0.0


def _no_position(poses):
    poses[1, 0] = np.nan


def _one_place(poses):
    poses[1] = poses[0]


class TestNamedFailures:
    @pytest.mark.parametrize(
        ("change", "status"),
        [
            (_no_field, CameraStatus.NOT_A_CAMERA),
            (_half_a_field, CameraStatus.NOT_A_CAMERA),
            (_no_rotation, CameraStatus.NOT_A_CAMERA),
            (_no_position, CameraStatus.NOT_A_CAMERA),
            (_one_place, CameraStatus.ONE_PLACE),
        ],
    )
    def test_have_no_rig(self, asked, change, status):
        _, estimate = asked([LANDSCAPE, PORTRAIT], lens_std=0.02, change=change)
        assert (estimate.rig, estimate.matches, estimate.status) == (None, (), status)
        assert estimate.notes[-1] == "use another camera estimator"


class TestOnSite:
    """A long lens, 22 m from three points whose distances were measured."""

    POINTS = np.array([[0.2, -0.1, 22.0], [-1.0, 0.5, 19.0], [1.5, -0.5, 26.0]])
    SIZE, RESIZED = (960, 540), (518, 294)

    def true_rig(self):
        cameras = [
            Camera(intrinsics(2000.0 + 25 * i, self.SIZE), self.SIZE, cam_from_world=camera.cam_from_world)
            for i, camera in enumerate(simple_rig().cameras)
        ]
        return Rig(NAMES[:2], tuple(cameras), True)

    def matches(self, rig):
        """Pixels, to a twentieth, of points in front of and behind what is measured."""
        rng = np.random.default_rng(1)
        u = project_all(rig, scene_points(rng, 1200))
        u = u[:, ((u >= 0) & (u <= np.array(self.SIZE) - 1)).all(axis=(0, 2))] + rng.normal(0, 0.05, (2, 1, 2))
        return Matches(0, 1, *(u + rng.normal(0, 0.05, u.shape)))

    def adjusted(self, folder, factor):
        """The true rig; estimate with focal lengths off by a factor, pose by half a stated deviation; adjustment."""
        rig = self.true_rig()
        baseline = rig.baseline()
        wrong = [replace(c, K=c.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])) for c in rig.cameras]
        wrong[1] = wrong[1].perturbed([0] * 4 + [0.01, -0.015, 0.01] + [0.03 * baseline, -0.05 * baseline, 0.05])
        blank = {name: np.zeros(self.SIZE[::-1], np.uint8) for name in rig.names}
        write_pictures(folder, rig.names, as_colors(blank))
        # Where both pictures are alike, the first one's camera would be found twice.
        known = KnownCameras(Rig(rig.names, tuple(wrong)), as_colors(blank), [self.RESIZED] * 2)
        known.estimate_poses = lambda images: known.poses
        measured = {"value": baseline, "std": 0.0005 * baseline}
        session = with_pictures(room_session(rig, lens=False, folder=folder, site={"baseline": measured}))
        estimate = vggt_cameras(folder, known).estimate(session, FirstFrames(open_views(session)))
        distances = np.linalg.norm(self.POINTS, axis=1)
        site = Site(
            baseline=measured,
            range=[{"point": f"p{i}", "value": d, "std": 0.001 * d} for i, d in enumerate(distances)],
        )
        points = {f"p{i}": SitePoint(u) for i, u in enumerate(project_all(rig, self.POINTS).swapaxes(0, 1))}
        return (
            rig,
            estimate,
            adjust_to_site(estimate.rig, [self.matches(rig)], site, points),
        )

    def test_tape_and_ranges_correct_the_prior(self, tmp_path):
        rig, estimate, adjustment = self.adjusted(tmp_path, 1.04)
        assert estimate.rig.cameras[0].focal_px == pytest.approx(1.04 * rig.cameras[0].focal_px, rel=0.01)
        assert adjustment.status == "ok"
        for found, true in zip(adjustment.rig.cameras, rig.cameras, strict=True):
            assert found.focal_px == pytest.approx(true.focal_px, rel=0.005)
        point = self.POINTS[0]
        sensitivity = compute_gain_sensitivity(project_all(rig, point[None])[:, :1], adjustment.rig)
        stated = np.diag(compute_gain_std(sensitivity, np.eye(3), adjustment.covariance)[0])
        error = np.abs(gain_error(rig, adjustment.rig, point))
        assert (error < 3 * stated).all()
        assert error.max() < 0.005

    def test_a_prior_four_deviations_off_is_named(self, tmp_path):
        rig, _, adjustment = self.adjusted(tmp_path, np.exp(4 * 0.05))
        assert adjustment.status == CameraStatus.DISAGREE
        assert any(note.startswith("focal left: expected") for note in adjustment.notes)
        assert adjustment.rig.cameras[0].focal_px == pytest.approx(rig.cameras[0].focal_px, rel=0.02)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The true rig, and the folder where what its cameras see lies."""
    rig, folder = room_rig(2), tmp_path_factory.mktemp("room")
    frames = room_frames(rig)
    write_pictures(folder, rig.names, as_colors(frames))
    return rig, folder


class TestRandomWeights:
    def test_whole_estimate_is_deterministic(self, room):
        rig, folder = room
        session = with_pictures(room_session(rig, folder=folder))
        frames = FirstFrames(open_views(session))
        first, second = (vggt_cameras(folder).estimate(session, frames) for _ in range(2))
        assert first.status == second.status
        assert first.notes == second.notes
        assert first.status in ("ok", CameraStatus.CONTRADICTION, CameraStatus.NOT_A_CAMERA, CameraStatus.ONE_PLACE)
        if first.rig is not None:
            assert first.rig.baseline() == pytest.approx(BASELINE_M)
            for a, b in zip(first.rig.cameras, second.rig.cameras, strict=True):
                # To rounding, as the contract says (`tests/contracts/test_estimators.py`).
                np.testing.assert_allclose(a.K, b.K, rtol=1e-12)
                np.testing.assert_allclose(a.cam_from_world, b.cam_from_world, rtol=0, atol=1e-12)


class TestUnavailable:
    def test_without_torch(self, monkeypatch):
        monkeypatch.setattr(availability, "find_spec", lambda name: None)
        message = r"^cameras vggt: expected PyTorch, got none; pip install 'vfm-sdm\[vfm\]'$"
        with pytest.raises(BackendUnavailableError, match=message):
            find_estimator("vggt")

    def test_without_weights(self, monkeypatch, tmp_path):
        monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path))
        with pytest.raises(BackendUnavailableError, match=r"run `vfm-sdm weights fetch vggt-1b`$") as caught:
            find_estimator("vggt")
        assert "\n" not in str(caught.value)
        with pytest.raises(BackendUnavailableError, match=r"expected a file, got 'mine\.pt', which is none"):
            estimator_of(Method(cameras="vggt", network=Network(weights="mine.pt")))

    def test_with_other_weights(self, monkeypatch, tmp_path, room):
        rig, folder = room
        (tmp_path / "vggt-1b.safetensors").write_bytes(b"nothing")
        monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path))
        estimator = find_estimator("vggt")  # a file of the right name; what is in it shows when it is read
        session = with_pictures(room_session(rig, folder=folder))
        with pytest.raises(BackendUnavailableError) as caught:
            estimator.estimate(session, FirstFrames(open_views(session)))
        assert "\n" not in str(caught.value)


def test_importing_it_does_not_import_torch():
    import subprocess

    code = "import sys, vfm_sdm.stages.cameras.vggt; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
