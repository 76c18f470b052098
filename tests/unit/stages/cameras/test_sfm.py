"""Structure from motion on a rendered room, and the learned matchers with networks of random weights."""

import shutil
import sys
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from rooms import BASELINE_M, FOCAL_PX, SIZE, TARGET, angle_between_deg, room_frames, room_rig, room_session
from simulation import gain_error, project_all
from textures import WaveTexture
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import BackendUnavailableError, CameraError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.profiles import expect_any
from vfm_sdm.inputs.session import Method, Sfm, Site
from vfm_sdm.stages.cameras.base import estimator_of
from vfm_sdm.stages.cameras.file import write_rig
from vfm_sdm.stages.cameras.sfm import SfmCameras
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.matching import learned_features
from vfm_sdm.stages.matching.features import FeatureMatches
from vfm_sdm.stages.matching.learned_features import MATCHERS, LearnedMatcher

pycolmap = pytest.importorskip("pycolmap", reason="structure from motion needs the extra 'sfm'")

POINT = np.array([0.2, -0.1, 11.5])
NAMES = ("left", "right")


def assert_true_pose(rig, truth, view=1, *, rotation_deg, direction_deg):
    found, true = rig.cameras[view], truth.cameras[view]
    assert angle_between_deg(found.rotation, true.rotation) < rotation_deg
    assert angle_between_deg(found.translation, true.translation) < direction_deg


def texture(seed):
    return np.clip(np.rint(WaveTexture(seed, waves=40).image(SIZE[::-1])), 0, 255).astype(np.uint8)


def with_matches(matches):
    """The estimator with ready matches in place of a learned matcher's."""
    estimator = SfmCameras()
    ready = {pair: FeatureMatches(*both, np.ones(len(both[0]))) for pair, both in matches.items()}
    estimator._matcher = SimpleNamespace(match=lambda images: ready)
    return estimator


def zoomed(rig, factor):
    """The rig with longer lenses."""
    cameras = [replace(c, K=c.K * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]]) for c in rig.cameras]
    return Rig(rig.names, tuple(cameras), rig.metric)


def exact_matches(rig):
    """Pixels of random points that all views see, by pair of views."""
    first, rng = rig.cameras[0], np.random.default_rng(1)
    depth = TARGET[2] * (1 + rng.uniform(-0.2, 0.2, (3000, 1)) * FOCAL_PX / first.focal_px)
    rays = np.column_stack([first.normalize(rng.uniform([0, 0], SIZE, (3000, 2))), np.ones(3000)])
    u = project_all(rig, depth * rays)
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))][:, :300]
    return {(i, j): (u[i], u[j]) for i, j in combinations(range(len(rig)), 2)}


def blank_frames(rig):
    return {name: np.zeros(SIZE[::-1], np.uint8) for name in rig.names}


@pytest.fixture(scope="module")
def pair():
    rig = room_rig(2)
    return rig, room_frames(rig)


@pytest.fixture(scope="module")
def estimate(pair):
    """Of two views whose focal lengths are stated a per cent too long."""
    rig, frames = pair
    return SfmCameras().estimate(room_session(rig, focal_factor=1.01), frames)


@pytest.fixture(scope="module")
def trio():
    rig = room_rig(3)
    return rig, room_frames(rig)


class TestTruth:
    def test_pose_with_the_focal_length_known_to_a_per_cent(self, pair, estimate):
        rig, _ = pair
        assert estimate.status == "ok"
        assert_true_pose(estimate.rig, rig, rotation_deg=0.15, direction_deg=0.3)
        assert estimate.rig.baseline() == pytest.approx(BASELINE_M)
        assert estimate.rig.cameras[0].focal_px == pytest.approx(1.01 * FOCAL_PX)
        assert "mean reprojection error" in estimate.notes[-1]

    def test_adjusted_to_a_range_it_has_the_scale_of_displacement(self, pair, estimate):
        rig, _ = pair
        distance = float(np.linalg.norm(POINT))
        site = Site(
            baseline={"value": BASELINE_M, "std": 0.002},
            range=[{"point": "p", "value": distance, "std": 0.001 * distance}],
        )
        pixels = project_all(rig, POINT[None])[:, 0]
        adjustment = adjust_to_site(estimate.rig, estimate.matches, site, {"p": SitePoint(pixels)})
        sensitivity = compute_gain_sensitivity(pixels[:, None], adjustment.rig)
        stated = np.diag(compute_gain_std(sensitivity, np.eye(3), adjustment.covariance)[0])
        error = np.abs(gain_error(rig, adjustment.rig, POINT))
        assert adjustment.status == "ok"
        assert adjustment.epipolar_rms_px < 0.3
        assert (error < 3 * stated).all()
        assert error[:2].max() < 0.01

    def test_three_views_have_one_scale(self, trio):
        rig, frames = trio
        estimate = SfmCameras().estimate(room_session(rig), frames)
        assert [(m.first, m.second) for m in estimate.matches] == [(0, 1), (0, 2), (1, 2)]
        for view in (1, 2):
            assert_true_pose(estimate.rig, rig, view, rotation_deg=0.1, direction_deg=0.1)
        assert estimate.rig.baseline(0, 2) == pytest.approx(rig.baseline(0, 2), rel=2e-3)

    def test_pixels_are_those_of_the_package(self, pair):
        # Upside down, half a pixel too much in the first view is half a pixel too little in the second.
        rig, frames = pair
        turned = rig.cameras[1]
        turned = Camera(turned.K, SIZE, cam_from_world=np.diag([-1.0, -1, 1]) @ turned.cam_from_world)
        rig = Rig(rig.names, (rig.cameras[0], turned), True)
        frames = {"left": frames["left"], "right": frames["right"][::-1, ::-1].copy()}
        estimate = SfmCameras().estimate(room_session(rig), frames)
        (matches,) = estimate.matches
        error = sampson_error(matches.points_first, matches.points_second, rig)
        assert abs(np.median(error)) < 0.03
        assert np.sqrt(np.mean(error**2)) < 0.15
        assert_true_pose(estimate.rig, rig, rotation_deg=0.1, direction_deg=0.1)

    @pytest.mark.parametrize("views", [2, 3])
    @pytest.mark.parametrize(("zoom", "k"), [(1, [-0.25, 0.3, 1e-3, -2e-3, 0.4]), (15, [-5.0, 300.0, 0.0, 0.0, 0.0])])
    def test_exact_matches_give_exact_poses_through_any_lens(self, tmp_path, views, zoom, k):
        rig = zoomed(room_rig(views, distortion=np.array(k)), zoom)
        write_rig(tmp_path / "rig.toml", rig)
        view = [{"name": n, "video": f"{n}.mp4", "camera": "rig.toml"} for n in rig.names]
        session = room_session(rig, view=view, folder=tmp_path)
        matches = exact_matches(rig)
        estimate = with_matches(matches).estimate(session, blank_frames(rig))
        assert estimate.status == "ok"
        for second in range(1, views):
            assert_true_pose(estimate.rig, rig, second, rotation_deg=1e-3, direction_deg=1e-3)
        assert [len(m) for m in estimate.matches] == [len(first) for first, _ in matches.values()]
        for kept in estimate.matches:
            for points, given in zip(
                (kept.points_first, kept.points_second), matches[kept.first, kept.second], strict=True
            ):
                order, expected = np.lexsort(points.T), np.lexsort(given.T)
                np.testing.assert_allclose(points[order], given[expected], atol=1e-4)

    def test_says_nothing_on_the_terminal(self, pair, capfd):
        rig, frames = pair
        before = pycolmap.logging.minloglevel
        with_matches(exact_matches(rig)).estimate(room_session(rig), frames)
        SfmCameras().estimate(room_session(rig), blank_frames(rig))
        assert capfd.readouterr() == ("", "")
        assert pycolmap.logging.minloglevel == before


class TestNamedFailures:
    def test_unrelated_images(self, pair):
        rig, _ = pair
        estimate = SfmCameras().estimate(room_session(rig), {"left": texture(1), "right": texture(2)})
        assert (estimate.rig, estimate.matches, estimate.status) == (None, (), CameraStatus.TOO_FEW_MATCHES)
        assert "left and right: " in estimate.notes[-1]
        assert "choose views that overlap more" in estimate.notes[-1]

    def test_one_view_that_sees_something_else(self, pair):
        rig = room_rig(3)
        frames = {**pair[1], "third": texture(3)}
        estimate = SfmCameras().estimate(room_session(rig), frames)
        assert (estimate.rig, estimate.status) == (None, CameraStatus.TOO_FEW_MATCHES)
        assert "left and third: 0 of" in estimate.notes[-1]

    def test_cameras_at_one_place(self, pair):
        rig, frames = pair
        estimate = SfmCameras().estimate(room_session(rig), {"left": frames["left"], "right": frames["left"]})
        assert (estimate.rig, estimate.matches, estimate.status) == (None, (), CameraStatus.NOT_RECONSTRUCTED)
        assert "distance between them" in estimate.notes[-1]

    def test_a_camera_that_only_turned(self, pair):
        rig, _ = pair
        first = rig.cameras[0]
        angle = np.radians(8)
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        turned = Camera(first.K, SIZE, cam_from_world=np.column_stack([turn, np.zeros(3)]))
        matches = exact_matches(Rig(NAMES, (first, turned)))
        estimate = with_matches(matches).estimate(room_session(rig), blank_frames(rig))
        assert (estimate.rig, estimate.status) == (None, CameraStatus.NOT_RECONSTRUCTED)

    def test_an_unknown_lens_is_noted(self, pair):
        rig, _ = pair
        estimate = with_matches(exact_matches(rig)).estimate(room_session(rig, lens=False), blank_frames(rig))
        assert sum("nothing known of the lens" in note for note in estimate.notes) == 2
        assert estimate.rig.covariance[0, 0] == pytest.approx(expect_any().std ** 2)


class TestRefused:
    def test_a_camera_with_skew(self, tmp_path):
        rig = room_rig(2)
        skewed = rig.cameras[1].K + np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]])
        write_rig(tmp_path / "rig.toml", Rig(NAMES, (rig.cameras[0], Camera(skewed, SIZE)), True))
        view = [{"name": n, "video": f"{n}.mp4", "camera": "rig.toml"} for n in NAMES]
        with pytest.raises(CameraError, match=r"view 'right': expected K without skew, got 2\.0; use cameras"):
            SfmCameras().estimate(room_session(rig, view=view, folder=tmp_path), blank_frames(rig))

    def test_without_pycolmap(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pycolmap", None)
        with pytest.raises(BackendUnavailableError, match=r"pycolmap, got none; pip install 'vfm-sdm\[sfm\]'"):
            SfmCameras()


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    """Folder of a small network with random weights, by matcher."""
    torch = pytest.importorskip("torch", reason="learned matching needs torch")
    transformers = pytest.importorskip("transformers", reason="learned matching needs transformers")
    detector = transformers.SuperPointConfig(
        encoder_hidden_sizes=[8, 8, 16, 16],
        decoder_hidden_size=16,
        descriptor_decoder_dim=16,
        keypoint_threshold=0.0,
    )
    configs = {
        "lightglue": transformers.LightGlueConfig(
            keypoint_detector_config=detector,
            descriptor_dim=16,
            num_hidden_layers=2,
            num_attention_heads=2,
            filter_threshold=0.0,
            depth_confidence=-1.0,
            width_confidence=-1.0,
        ),
        "superglue": transformers.SuperGlueConfig(
            keypoint_detector_config=detector,
            hidden_size=16,
            keypoint_encoder_sizes=[8, 16],
            gnn_layers_types=["self", "cross"],
            num_attention_heads=2,
            sinkhorn_iterations=5,
        ),
    }
    folders = {}
    for matcher, config in configs.items():
        folders[matcher] = tmp_path_factory.mktemp(matcher)
        with torch.random.fork_rng():
            torch.manual_seed(0)
            network = transformers.AutoModelForKeypointMatching.from_config(config)
        network.save_pretrained(folders[matcher])
    return folders


def changed(folder, tmp_path, old, new):
    """A copy of a checkpoint with another configuration."""
    copy = shutil.copytree(folder, tmp_path / "network")
    text = (copy / "config.json").read_text()
    assert old in text
    (copy / "config.json").write_text(text.replace(old, new))
    return copy


@pytest.fixture(params=sorted(MATCHERS))
def matcher(request):
    return request.param


class Detections:
    """A network in place of a real one: fixed features, each matched with itself."""

    def __init__(self, torch, first, second):
        self._torch, self._points = torch, (first, second)

    def __call__(self, pixel_values):
        torch = self._torch
        self.shape = tuple(pixel_values.shape)
        size = torch.tensor(pixel_values.shape[:2:-1])
        count = len(self._points[0])
        keypoints = torch.stack([torch.tensor(p) / size for p in self._points])
        # One feature more that counts for nothing, as where the other image has more of them.
        keypoints = torch.cat([keypoints, torch.zeros(2, 1, 2)], dim=1)
        partners = torch.cat([torch.arange(count), torch.tensor([0])])
        mask = torch.tensor([1] * count + [0])
        return SimpleNamespace(
            keypoints=keypoints[None],
            matches=torch.stack([partners] * 2)[None],
            mask=torch.stack([mask] * 2)[None],
            matching_scores=torch.ones(1, 2, count + 1),
        )


class TestLearnedMatcher:
    def test_an_image_matches_itself_in_place(self, checkpoints, matcher, pair):
        image = pair[1]["left"][:120, :160]
        found = LearnedMatcher(matcher, model=checkpoints[matcher]).match([image, image])[0, 1]
        first, second = found.points_first, found.points_second
        assert len(first) > 0
        assert np.median(np.abs(first - second)) < 1e-3  # a few of random weights go astray
        np.testing.assert_allclose(first, np.rint(first), atol=1e-3)  # features lie on pixels

    def test_reduced_images_keep_their_pixels(self, checkpoints):
        torch = pytest.importorskip("torch")
        made = LearnedMatcher("lightglue", model=checkpoints["lightglue"])
        canvas = np.array([[0.0, 0.0], [100.0, 50.0], [300.0, 700.0], [10.0, 20.0]])
        made._network = Detections(torch, canvas, canvas + 5)
        images = [np.zeros((1024, 2048), np.uint8), np.zeros((500, 400), np.uint8)]
        found = made.match(images)[0, 1]
        first, second = found.points_first, found.points_second
        assert made._network.shape == (1, 2, 3, 512, 1024)
        # The first is too near the border, the third below both images; half a pixel of the canvas is one of the image.
        np.testing.assert_allclose(first, [[200.5, 100.5], [20.5, 40.5]], atol=1e-3)
        np.testing.assert_allclose(second, [[105.0, 55.0], [15.0, 25.0]], atol=1e-3)

    def test_all_of_sfm_runs_with_it(self, checkpoints, matcher, pair, capfd):
        rig, frames = pair
        settings = Sfm(model=str(checkpoints[matcher]))
        estimator = estimator_of(Method(cameras="sfm", matching=f"superpoint+{matcher}", sfm=settings))
        parts = {name: frame[::3, ::3] for name, frame in frames.items()}
        estimate = estimator.estimate(room_session(rig), parts)
        # Random weights match at random.
        assert (estimate.rig, estimate.status) == (None, CameraStatus.TOO_FEW_MATCHES)
        assert capfd.readouterr() == ("", "")

    def test_nothing_to_match_is_an_empty_set(self, checkpoints, matcher, pair, tmp_path):
        folder = changed(checkpoints[matcher], tmp_path, '"keypoint_threshold": 0.0', '"keypoint_threshold": 1.0')
        found = LearnedMatcher(matcher, model=folder).match(list(pair[1].values()))[0, 1]
        assert found.points_first.shape == found.points_second.shape == (0, 2)

    def test_unknown_name(self):
        with pytest.raises(BackendUnavailableError, match=r"expected one of \['lightglue', 'superglue'\], got 'loftr'"):
            LearnedMatcher("loftr")

    def test_without_transformers(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "transformers", None)
        with pytest.raises(BackendUnavailableError, match=r"'superglue': expected torch and transformers, got no"):
            estimator_of(Method(cameras="sfm", matching="superpoint+superglue"))

    def test_without_a_checkpoint(self, checkpoints, monkeypatch):
        monkeypatch.setitem(learned_features.MATCHERS, "superglue", "nobody/nothing")
        with pytest.raises(
            BackendUnavailableError, match=r"on this machine, got none; download .* as model = '\.\.\.'"
        ):
            estimator_of(Method(cameras="sfm", matching="superpoint+superglue"))

    def test_without_its_folder(self, checkpoints, tmp_path):
        with pytest.raises(BackendUnavailableError, match=r"expected a folder, got none; download"):
            LearnedMatcher("lightglue", model=tmp_path / "absent")

    def test_another_network(self, checkpoints):
        with pytest.raises(BackendUnavailableError, match="expected a lightglue network, got superglue"):
            LearnedMatcher("lightglue", model=checkpoints["superglue"])

    @pytest.mark.parametrize("change", [('"num_hidden_layers": 2', '"num_hidden_layers": 3'), ("16", "32")])
    def test_weights_that_do_not_fit(self, checkpoints, tmp_path, change):
        folder = changed(checkpoints["lightglue"], tmp_path, *change)
        with pytest.raises(BackendUnavailableError, match=r"expected all weights of its network, got \d+ missing or"):
            LearnedMatcher("lightglue", model=folder)

    def test_a_broken_file(self, checkpoints, tmp_path):
        folder = shutil.copytree(checkpoints["lightglue"], tmp_path / "network")
        (folder / "model.safetensors").write_bytes(b"nothing")
        with pytest.raises(BackendUnavailableError, match=r"expected a lightglue checkpoint, got: .*header"):
            LearnedMatcher("lightglue", model=folder)
