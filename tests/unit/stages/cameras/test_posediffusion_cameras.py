"""PoseDiffusion as a camera estimator, with a stand-in that knows the cameras, and its weights as files."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch", reason="PoseDiffusion needs torch")

from known_cameras import KnownGuidedCameras, Pictures, network_cameras, with_pictures, write_pictures  # noqa: E402
from rooms import BASELINE_M, NAMES, room_session  # noqa: E402
from simulation import intrinsics  # noqa: E402
from small_networks import posediffusion_on_cpu  # noqa: E402
from vfm_sdm.core.statuses import CameraStatus  # noqa: E402
from vfm_sdm.errors import BackendUnavailableError, DatasetError  # noqa: E402
from vfm_sdm.geometry.camera import Camera, Rig  # noqa: E402
from vfm_sdm.inputs.session import FirstFrames, open_views  # noqa: E402
from vfm_sdm.networks import availability  # noqa: E402
from vfm_sdm.networks.posediffusion.guidance import Guide, ImageMatches  # noqa: E402
from vfm_sdm.networks.posediffusion.inference import PoseDiffusionInference  # noqa: E402
from vfm_sdm.networks.posediffusion.model import PoseDiffusion  # noqa: E402
from vfm_sdm.networks.posediffusion.pose import decode_pose, encode_pose  # noqa: E402
from vfm_sdm.stages.cameras import posediffusion  # noqa: E402
from vfm_sdm.stages.cameras.base import find_estimator  # noqa: E402
from vfm_sdm.stages.cameras.solve import solve_cameras  # noqa: E402
from vfm_sdm.stages.matching.matches import Matches  # noqa: E402

SIZES = [(640, 360), (300, 500), (417, 395)]


def rig_of(count):
    cameras = []
    for index, size in enumerate(SIZES[:count]):
        R = Rotation.from_rotvec([0.05 * index, -0.2 * index, 0.03 * index]).as_matrix()
        center = BASELINE_M * np.array([[0, 0, 0], [0.96, -0.28, 0], [1.7, 0.3, 0.4]])[index]
        K = intrinsics(700.0 + 90 * index, size)
        cameras.append(Camera(K, size, np.zeros(5), np.column_stack([R, -R @ center])))
    return Rig(NAMES[:count], tuple(cameras), True)


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What the estimator says of pictures with these matches, from a network that knows the rig."""

    def ask(count=2, change=None, matches=()):
        monkeypatch.setattr(posediffusion, "related_matches", lambda *_: (matches, () if matches else ("no matches",)))
        rig, rng = rig_of(count), np.random.default_rng(0)
        shown = [rng.integers(0, 256, (*camera.image_size[::-1], 3), dtype=np.uint8) for camera in rig.cameras]
        write_pictures(tmp_path, rig.names, shown)
        known = KnownGuidedCameras(rig, shown)
        if change is not None:
            change(known)
        session = with_pictures(room_session(rig, folder=tmp_path))
        views = [v.model_copy(update={"lens": v.lens.model_copy(update={"relative_std": 0.02})}) for v in session.view]
        session = session.model_copy(update={"view": tuple(views)})
        frames = FirstFrames(open_views(session))
        return rig, network_cameras("posediffusion", tmp_path, known).estimate(session, frames)

    return ask


@pytest.mark.parametrize("count", [2, 3])
def test_known_cameras_come_back_with_the_stated_uncertainty(asked, count):
    rig, estimate = asked(count)
    assert (estimate.status, estimate.rig.names, estimate.rig.metric) == ("ok", rig.names, True)
    assert estimate.notes == ("no matches",)
    for found, true in zip(estimate.rig.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(found.K, true.K, rtol=1e-9)
        np.testing.assert_allclose(found.cam_from_world, true.cam_from_world, rtol=0, atol=1e-9)
    std = np.sqrt(np.diag(estimate.rig.covariance)).reshape(count, 10)
    np.testing.assert_allclose(std[:, 0], 1 / np.hypot(1 / 0.02, 1 / 0.1))
    np.testing.assert_allclose(std[1:, 4:7], 0.1)
    np.testing.assert_allclose(std[1:, 7:], 0.2 * BASELINE_M)


def _no_focal(known):
    known.focal_px[1, 0] = np.nan


def _no_rotation(known):
    known.cam_from_world[1, :, :3] = np.nan


def _one_place(known):
    known.cam_from_world[1] = known.cam_from_world[0]


@pytest.mark.parametrize(
    ("change", "status"),
    [
        (_no_focal, CameraStatus.NOT_A_CAMERA),
        (_no_rotation, CameraStatus.NOT_A_CAMERA),
        (_one_place, CameraStatus.ONE_PLACE),
    ],
)
def test_named_failures_have_no_rig(asked, change, status):
    _, estimate = asked(change=change)
    assert (estimate.rig, estimate.matches, estimate.status) == (None, (), status)
    assert estimate.notes == ("no matches", "use another camera estimator")


@pytest.mark.parametrize(
    ("guided", "agreeing", "doubt"),
    [
        (True, 1.0, None),
        (True, 0.5, None),
        (
            True,
            0.25,
            "PoseDiffusion: 10 of 40 matches of 'left' and 'right' agree with its cameras; they are probably w",
        ),
        (False, 0.25, "PoseDiffusion: 10 of 40 matches agree with its cameras, too few to guide it"),
    ],
)
def test_matches_that_do_not_agree_with_the_network_are_a_note(asked, guided, agreeing, doubt):
    u = np.random.default_rng(0).uniform(0, 300, (40, 2))

    def change(known):
        known.guided, known.agreeing = guided, agreeing

    _, estimate = asked(change=change, matches=(Matches(0, 1, u, u),))
    assert estimate.status == "ok"
    assert [note[: len(doubt or "")] for note in estimate.notes] == ([] if doubt is None else [doubt])


@pytest.mark.parametrize(
    ("side", "turn", "status", "said"),
    [
        (1, 0.0, "ok", ()),
        (1, 0.3, "ok", ()),
        (-1, 0.0, CameraStatus.BEHIND, ("do not lie in front of both cameras",)),
        (1, 1.5, CameraStatus.TURNED, ("degrees from where its estimator put it, which states 5.7",)),
    ],
)
def test_cameras_that_no_epipolar_error_tells_are_named(tmp_path, monkeypatch, side, turn, status, said):
    """A reversed baseline, and a camera that the matches turn back from far."""
    rig = rig_of(2)
    points3d = np.random.default_rng(0).uniform([-2, -1, 8], [4, 1, 14], (300, 3))
    seen = Matches(0, 1, *(camera.project(points3d) for camera in rig.cameras))
    monkeypatch.setattr(posediffusion, "related_matches", lambda *_: ((seen,), ()))
    frames = Pictures({c: np.zeros(one.image_size[::-1], np.uint8) for c, one in zip(NAMES, rig.cameras, strict=False)})
    first, second = rig.cameras
    second = replace(second, cam_from_world=np.column_stack([second.rotation, side * second.translation]))
    second = second.perturbed([0, 0, 0, 0, 0, turn, 0, 0, 0, 0])
    known = KnownGuidedCameras(Rig(rig.names, (first, second), True), list(frames.colors.values()))
    solution = solve_cameras(room_session(rig), frames, network_cameras("posediffusion", tmp_path, known))
    assert solution.status == status
    assert solution.epipolar_rms_px < 0.1  # less than any feature shows
    for sentence in ("do not lie in front of both cameras", "from where its estimator put it"):
        assert any(sentence in note for note in solution.notes) == any(sentence in one for one in said)
    assert all(any(one in note for note in solution.notes) for one in said)


def scene(poses, count=60):
    """Pixels of points in the network's pictures of two cameras, and the guide that they make."""
    rng = np.random.default_rng(2)
    rotation, translation, focal = decode_pose(poses)
    points = torch.tensor(rng.uniform([-0.2, -0.2, 3], [0.2, 0.2, 5], (count, 3)), dtype=poses.dtype)
    seen = points @ rotation.mT + translation[:, None]
    pixels = seen[..., :2] / seen[..., 2:] * focal[:, None] * 112 + 112
    return Guide(ImageMatches(*pixels, torch.tensor([[0, 1]]).expand(count, 2)), iterations=20)


POSES = torch.tensor([[0, 0, 0, 1, 0, 0, 0, -0.6, -0.6], [0.3, 0, 0, 1, 0, 0.1, 0, -0.6, -0.6]], dtype=torch.float64)


def test_true_cameras_have_no_error_and_the_guide_leads_towards_them():
    guide = scene(POSES)
    assert guide.errors(POSES).max() < 1e-18
    off = POSES + torch.tensor(np.random.default_rng(1).normal(0, 2e-3, (2, 9)))
    assert guide.errors(guide.refine(off)).mean() < 0.3 * guide.errors(off).mean()


def test_the_gradient_is_that_of_differences():
    guide = scene(POSES)
    off = POSES + torch.tensor(np.random.default_rng(1).normal(0, 2e-3, (2, 9)))
    gradient, step = guide.gradient(off), 1e-6
    for index in np.ndindex(2, 9):
        ahead, behind = off.clone(), off.clone()
        ahead[index] += step
        behind[index] -= step
        slope = (guide.errors(ahead).mean() - guide.errors(behind).mean()) / (2 * step)
        assert gradient[index] == pytest.approx(float(slope), rel=1e-4, abs=1e-4)


def test_too_few_near_matches_guide_nothing():
    guide = scene(POSES, count=19)  # ten a frame are needed
    off = POSES + 1e-3
    torch.testing.assert_close(guide.refine(off), off, rtol=0, atol=0)


def test_pose_vectors_come_back_whatever_entry_of_the_quaternion_is_largest():
    rotations = Rotation.from_quat(np.vstack([np.eye(4), Rotation.random(20, rng=np.random.default_rng(0)).as_quat()]))
    R = torch.tensor(rotations.as_matrix())
    poses = encode_pose(R, torch.ones(24, 3, dtype=R.dtype), torch.full((24, 2), 3.0, dtype=R.dtype))
    found, translation, focal = decode_pose(poses)
    torch.testing.assert_close(found, R, rtol=0, atol=1e-14)
    torch.testing.assert_close(translation, torch.ones_like(translation))
    torch.testing.assert_close(focal, torch.full_like(focal, 3.0))


def test_pictures_of_any_sizes_give_the_same_cameras_again():
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (h, w, 3), np.uint8) for w, h in SIZES]
    matches = [Matches(0, 2, rng.uniform(0, 300, (50, 2)), rng.uniform(0, 300, (50, 2)))]
    inference = posediffusion_on_cpu()
    first, second = (inference.estimate_poses(pictures, matches) for _ in range(2))
    assert first.cam_from_world.shape == (3, 3, 4)
    assert first.near.shape == (50,)
    np.testing.assert_array_equal(first.cam_from_world, second.cam_from_world)
    np.testing.assert_array_equal(first.focal_px, second.focal_px)


@pytest.mark.parametrize(
    ("images", "noise", "message"),
    [
        (torch.zeros(2, 3, 224, 224, dtype=torch.uint8), torch.zeros(100, 2, 9), "images: expected floating-point"),
        (torch.zeros(2, 224, 224), torch.zeros(100, 2, 9), "images: expected floating-point"),
        (torch.zeros(2, 3, 224, 224), torch.zeros(100, 3, 9), r"noise: expected shape \(100, 2, 9\)"),
    ],
)
def test_wrong_shapes_are_one_line(images, noise, message):
    with pytest.raises(DatasetError, match=message):
        posediffusion_on_cpu().network.sample(images, noise)


def test_weights_of_another_network_are_named_with_their_file(tmp_path):
    torch.save({"module.layer.weight": torch.zeros(3)}, tmp_path / "other.pth")
    with pytest.raises(BackendUnavailableError, match=r"^weights other\.pth: expected the 271 .* 1 unexpected \(layer"):
        PoseDiffusionInference.load(str(tmp_path / "other.pth"), device="cpu")


def test_weights_of_another_schedule_are_refused(tmp_path):
    state = PoseDiffusion().state_dict()
    state["diffuser.betas"] = 2 * state["diffuser.betas"]
    torch.save(state, tmp_path / "other.pth")
    with pytest.raises(BackendUnavailableError, match=r"expected the noise schedule of .*, got another betas"):
        PoseDiffusionInference.load(str(tmp_path / "other.pth"), device="cpu")


def test_without_torch_or_weights_it_says_what_to_do(monkeypatch):
    with pytest.raises(BackendUnavailableError, match=r"run `vfm-sdm weights fetch posediffusion-co3d`$"):
        find_estimator("posediffusion")
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    with pytest.raises(BackendUnavailableError, match=r"^cameras posediffusion: expected PyTorch, got none; pip"):
        find_estimator("posediffusion")


def test_importing_it_does_not_import_torch():
    code = "import sys, vfm_sdm.stages.cameras.posediffusion; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
