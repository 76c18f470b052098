"""Pictures of several sizes and their matches in PoseDiffusion's frame and back, by cameras that are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch", reason="PoseDiffusion needs torch")

from simulation import intrinsics  # noqa: E402
from small_networks import posediffusion_on_cpu  # noqa: E402
from vfm_sdm.errors import DatasetError  # noqa: E402
from vfm_sdm.geometry.camera import Camera  # noqa: E402
from vfm_sdm.networks.posediffusion.crop import SquareCrop  # noqa: E402
from vfm_sdm.networks.posediffusion.pose import QUATERNION, decode_pose, encode_pose  # noqa: E402
from vfm_sdm.stages.matching.matches import Matches  # noqa: E402

SIZES = [(640, 360), (300, 500), (417, 395)]
FOCAL = 2.6
"""Over half the shorter side: the guidance takes the mean of all views for each."""


def true_cameras():
    """Lying, upright and nearly square pictures; the principal point is where the network has it."""
    cameras = []
    for k, (width, height) in enumerate(SIZES):
        crop = SquareCrop.of(width, height)
        K = intrinsics(FOCAL * crop.side / 2, (width, height))
        K[:2, 2] = np.array([crop.left, crop.top]) + crop.side / 2 - 0.5
        R = Rotation.from_rotvec([0.05 * k, -0.1 * k, 0.03 * k]).as_matrix()
        t = np.array([[0.0, 0, 0], [0.6, -0.1, 0.05], [-0.5, 0.2, 0.1]])[k]
        cameras.append(Camera(K, (width, height), cam_from_world=np.column_stack([R, t])))
    return cameras


def encoded(cameras):
    poses = torch.tensor(np.array([c.cam_from_world for c in cameras]))
    focal = torch.full((len(cameras), 2), FOCAL, dtype=poses.dtype)
    return encode_pose(poses[..., :3], poses[..., 3], focal).float()


def true_matches(cameras, count=80):
    points3d = np.random.default_rng(0).uniform([-0.4, -0.4, 4], [0.4, 0.4, 7], (count, 3))
    pixels = [camera.project(points3d) for camera in cameras]
    return [Matches(0, 1, pixels[0], pixels[1]), Matches(2, 0, pixels[2], pixels[0])]


class Answer:
    """In place of the network's sampling: these pose vectors, and what it was given."""

    def __init__(self, poses):
        self.poses, self.guide, self.threads = poses, None, None

    def __call__(self, images, noise, guide=None):
        self.images, self.guide, self.threads = images, guide, torch.get_num_threads()
        return self.poses[None]


@pytest.fixture
def asked():
    def ask(poses, cameras, matches):
        inference, answer = posediffusion_on_cpu(iterations=20), Answer(poses)
        inference.network.sample = answer
        pictures = [np.zeros((*camera.image_size[::-1], 3), np.uint8) for camera in cameras]
        return inference.estimate_poses(pictures, matches), answer

    return ask


def test_cameras_of_pictures_of_different_sizes_come_back_at_full_size(asked):
    cameras = true_cameras()
    found, answer = asked(encoded(cameras), cameras, true_matches(cameras))
    assert answer.images.shape == (3, 3, 224, 224)
    np.testing.assert_allclose(found.cam_from_world, [c.cam_from_world for c in cameras], atol=2e-7)
    np.testing.assert_allclose(found.focal_px, [[c.K[0, 0], c.K[1, 1]] for c in cameras], rtol=1e-6)
    assert found.near.all()
    assert found.guided


def test_true_matches_lie_on_the_epipolar_lines_of_true_cameras(asked):
    """Half a pixel of a full picture is up to 0.4 px here, and an error of 0.1 px^2."""
    cameras = true_cameras()
    _, answer = asked(encoded(cameras), cameras, true_matches(cameras))
    assert answer.guide.matches.frames.unique(dim=0).tolist() == [[0, 1], [2, 0]]
    assert answer.guide.errors(encoded(cameras)).max() < 1e-8


def relative_error(poses, truth):
    """Rotation from the true relative pose of the first two frames to the one found, shape (3,) [rad]."""
    first, second = (Rotation.from_matrix(R) for R in decode_pose(poses.double())[0][:2].numpy())
    true_first, true_second = (Rotation.from_matrix(R) for R in decode_pose(truth.double())[0][:2].numpy())
    return (second * first.inv() * (true_second * true_first.inv()).inv()).as_rotvec()


def test_guidance_turns_a_camera_back_to_the_truth(asked):
    """About the optical axis and the baseline; along the baseline, a turn is nearly a distance, which nothing tells."""
    cameras = true_cameras()
    truth = encoded(cameras)
    _, answer = asked(truth, cameras, true_matches(cameras))
    off = truth.clone()
    off[1, 3:7] += torch.tensor([0.008, 0.0, 0.006, 0.0])
    moved = answer.guide.descend(off, QUATERNION, 100)
    before, after = np.abs([relative_error(poses, truth)[[0, 2]] for poses in (off, moved)])
    assert (before > 0.01).all()
    assert (after < 0.2 * before).all()


def test_the_same_cameras_on_any_number_of_threads(asked):
    cameras, before = true_cameras(), torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        _, answer = asked(encoded(cameras), cameras, ())
        assert answer.threads == 1
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_noise_that_ends_early_is_refused():
    network = posediffusion_on_cpu().network
    with pytest.raises(DatasetError, match=r"noise: expected shape \(100, 2, 9\) or longer, got \(91, 2, 9\); draw"):
        network.sample(torch.zeros(2, 3, 224, 224), torch.zeros(91, 2, 9))
