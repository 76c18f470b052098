"""Pan clips as videos: followed, looked at and adjusted."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from turning import draw_plan
from vfm_sdm.core.statuses import LensStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.lens.clip import estimate_lens
from vfm_sdm.stages.lens.key_frames import ClipMotion, choose_key_frames, follow_clip
from vfm_sdm.stages.lens.scene import PanScene
from vfm_sdm.studies.synthetic.pan_clip import pan_frames, write_pan_clip
from vfm_sdm.studies.synthetic.recording import write_video

SIZE = (480, 270)
FIRST = {"size": SIZE, "fps": 15, "duration_s": 3.0, "distance_m": (300.0, 3000.0)}


def test_a_clip_that_stands_still_is_named(tmp_path):
    plan = draw_plan(0, 40, **FIRST, turn_deg=(0.1, 0.1, 0.1))
    estimate = estimate_lens(open_video(write_pan_clip(tmp_path / "pan.mp4", plan)))
    assert estimate.status == LensStatus.STILL
    assert not estimate.usable
    assert np.isnan(estimate.covariance).all()


def test_a_scene_that_is_never_seen_again_is_named(tmp_path):
    """Every frame another noise: corners are followed anywhere, and nothing matches."""
    rng = np.random.default_rng(0)
    frames = (np.kron(rng.integers(0, 255, (27, 48)), np.ones((10, 10))).astype(np.uint8) for _ in range(30))
    path = write_video(tmp_path / "pan.mp4", frames, fps=15, options={"crf": "18"})
    estimate = estimate_lens(open_video(path))
    assert estimate.status in (LensStatus.FEW_PLACES, LensStatus.STILL)


@pytest.mark.slow
@pytest.mark.parametrize("view_deg", [40])
def test_a_rendered_clip_that_turns_fast_gives_its_lens(tmp_path, view_deg):
    plan = draw_plan(1, view_deg, size=(640, 360), fps=25, duration_s=4.0, readout_s=0.015, distance_m=(300.0, 3000.0))
    estimate = estimate_lens(open_video(write_pan_clip(tmp_path / "pan.mp4", plan)), PanScene(300.0, 3000.0))
    assert estimate.status == LensStatus.OK
    error = np.log(estimate.camera.focal_px / plan.camera.focal_px)
    assert estimate.focal_std < 0.002
    assert abs(error) < 4 * estimate.focal_std
    assert estimate.adjusted.lens[9] == pytest.approx(0.015, abs=1e-3)


def test_rates_are_those_of_rows_seen_one_after_another():
    """Corners that a rolling shutter shows, and the rate with which the camera turned."""
    plan = draw_plan(2, 40, readout_s=0.02)
    camera, rng = plan.camera, np.random.default_rng(0)
    rate = np.array([0.3, -0.5, 0.6])
    time_s = np.array([0.0, 1 / 30, 2 / 30])
    first = rng.uniform(100, 900, (300, 2)) + np.array([400, 0])

    def rays(pixels):
        slopes = camera.normalize(pixels)
        found = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    def delay(pixels):
        return 0.02 * ((pixels[:, 1] + 0.5) / camera.image_size[1] - 0.5)

    places, steps = [first], []
    for _ in range(2):
        start, found = places[-1], places[-1]
        for _ in range(6):
            between = 1 / 30 + delay(found) - delay(start)
            found = camera.project(Rotation.from_rotvec(between[:, None] * rate).apply(rays(start)))
        places.append(found)
        steps.append(np.stack([start, found]))
    motion = ClipMotion(time_s, tuple(steps))
    rates, changes = motion.turn_rates(np.array([1]), camera, readout_s=0.02, shift=np.zeros(3))
    np.testing.assert_allclose(rates[0], rate, atol=1e-6)
    np.testing.assert_allclose(changes[0], 0, atol=1e-4)
    blind, _ = motion.turn_rates(np.array([1]), camera, readout_s=0.0, shift=np.zeros(3))
    assert np.abs(blind[0] - rate).max() > 1e-3


def test_far_motion_is_followed_and_what_is_lost_does_not_count(tmp_path):
    """Fine texture that moves by a tenth of the picture a frame: corners that look alike are no motion."""
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.normal(0, 60, (400, 900)).astype(np.float32), (0, 0), 1.2)
    shift = np.array([47, 9])
    cuts = [wide[40 + 9 * i : 310 + 9 * i, 40 + 47 * i : 520 + 47 * i] for i in range(6)]
    pictures = (np.clip(128 + cut, 0, 255).astype(np.uint8) for cut in cuts)
    path = write_video(tmp_path / "far.mp4", pictures, fps=25, options={"crf": "15"})
    motion = follow_clip(open_video(path).frames())
    assert len(motion.steps) == 5
    for first, second in motion.steps:
        assert len(first) > 50
        assert np.abs(second - first + shift).max() < 1


def test_rates_follow_a_turn_that_changes_within_a_few_frames():
    """A head that rolls to and fro in 1.3 s: a straight line through two steps is 1 % off."""
    plan = draw_plan(2, 40, turn_deg=(0.0, 0.0, 20.0), duration_s=4.0)
    camera, times = plan.camera, np.arange(100) / 25
    pixels = np.random.default_rng(0).uniform((300, 200), (1600, 900), (200, 2))
    rays = np.concatenate([camera.normalize(pixels), np.ones((200, 1))], axis=1)
    turns = plan.attitude(times)
    steps = [np.stack([pixels, camera.project((turns[i + 1] * turns[i].inv()).apply(rays))]) for i in range(99)]
    numbers = np.arange(5, 95)
    rates, changes = ClipMotion(times, tuple(steps)).turn_rates(numbers, camera, readout_s=0.0, shift=np.zeros(3))
    ends = [plan.attitude(times[numbers] + sign * 1e-3) for sign in (-1, 1)]
    true = (ends[1] * ends[0].inv()).as_rotvec() / 2e-3
    np.testing.assert_allclose(rates, true, atol=2e-3 * np.abs(true).max())
    assert np.isfinite(changes).all()


def test_key_frames_are_slow_and_apart():
    corners = np.random.default_rng(0).uniform(0, 1000, (20, 2))
    speeds = 10 + 8 * np.sin(np.arange(199) / 5)
    motion = ClipMotion(np.arange(200) / 30, tuple(np.stack([corners, corners + np.array([s, 0])]) for s in speeds))
    numbers = choose_key_frames(motion, (1920, 1080))
    assert numbers[0] > 0
    assert numbers[-1] < 199
    assert np.median(motion.speed[numbers]) < np.median(motion.speed)
    lost = replace(motion, steps=tuple(np.zeros((2, 0, 2)) for _ in range(199)))
    assert choose_key_frames(lost, (1920, 1080)).size == 0


@pytest.mark.parametrize("scene", [(0.0, 10.0), (20.0, 10.0)])
def test_distances_in_the_wrong_order_are_refused(scene):
    with pytest.raises(DatasetError, match="expected 0 < nearest <= farthest distance and a lever >= 0"):
        PanScene(*scene)


def test_a_clip_of_no_length_is_refused():
    with pytest.raises(DatasetError, match="pan clip: expected 0 < nearest"):
        draw_plan(0, 40, duration_s=0.0)


def test_rows_of_a_clip_are_seen_one_after_another():
    """A read-out shears what a pan shows: the rows of one frame are those of frames at their times."""
    plan = draw_plan(3, 40, **(FIRST | {"duration_s": 0.2}), turn_deg=(5.0, 0.0, 0.0), noise_std=0.0)
    rolling = next(iter(pan_frames(replace(plan, readout_s=0.03))))
    still = next(iter(pan_frames(plan)))
    middle = SIZE[1] // 2
    assert np.abs(rolling[middle].astype(int) - still[middle]).max() <= 12
    assert np.abs(rolling[-5].astype(int) - still[-5]).mean() > 2
