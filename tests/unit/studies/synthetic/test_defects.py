from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.defects import (
    Glare,
    Stabilization,
    add_glare,
    compute_exposure_times,
    compute_row_delays,
    compute_stabilization_path,
    defocus,
    lower_light,
    sharpen,
    warp,
)


@pytest.fixture(scope="module")
def frame():
    noise = np.random.default_rng(3).standard_normal((120, 160))
    return (110 + 90 * gaussian_filter(noise, 2.0)).astype(np.float32)


def test_defocus_is_a_gaussian_point_spread_that_keeps_all_light():
    point = np.zeros((61, 61), np.float32)
    point[30, 30] = 1000
    spread = defocus(point, 2.5)
    v, u = np.mgrid[-30:31, -30:31]
    np.testing.assert_allclose(spread, 1000 * np.exp(-(u**2 + v**2) / 12.5) / (2 * np.pi * 6.25), atol=0.05)
    assert spread.sum() == pytest.approx(1000, rel=1e-5)
    assert spread.dtype == np.float32


def test_no_defocus_leaves_the_frame_alone_and_returns_a_copy(frame):
    same = defocus(frame, 0.0)
    assert same is not frame
    np.testing.assert_array_equal(same, frame)


def test_defocus_adds_up_like_variances(frame):
    twice, once = defocus(defocus(frame, 1.5), 2.0), defocus(frame, 2.5)
    np.testing.assert_allclose(twice[20:-20, 20:-20], once[20:-20, 20:-20], atol=0.05)


def test_glare_adds_light_and_takes_contrast_most_where_the_veil_is_thick(frame):
    glare = Glare(0.6, center=(0.2, 0.3), radius=0.2, floor=0.1, wander=0.0)
    veiled = add_glare(frame, glare, time_s=0.0)
    share = (veiled - frame) / (235 - frame)
    at = np.unravel_index(np.argmax(share), share.shape)
    assert abs(at[1] - 0.2 * 160) <= 1
    assert abs(at[0] - 0.3 * 120) <= 1
    assert share.max() == pytest.approx(0.6, abs=1e-3)
    assert share.min() >= 0.6 * 0.1 - 1e-4
    assert share[-1, -1] < 0.1
    # One standard deviation, 32 px, to the right of the middle.
    assert share[at[0], at[1] + 32] == pytest.approx(0.6 * (0.1 + 0.9 * np.exp(-0.5)), abs=0.01)
    near, far = np.s_[30:40, 27:37], np.s_[100:110, 145:155]
    assert np.std(veiled[near]) / np.std(frame[near]) < 0.45
    assert np.std(veiled[far]) / np.std(frame[far]) > 0.9


def test_glare_wanders_slowly_and_the_same_way_every_time(frame):
    glare = Glare(0.6, wander=0.05, seed=3)
    now, soon, later = (add_glare(frame, glare, time_s=t) for t in (1.0, 1.02, 4.0))
    np.testing.assert_array_equal(now, add_glare(frame, glare, time_s=1.0))
    assert 0 < np.abs(now - soon).max() < 0.3
    assert np.abs(now - later).max() > 2
    assert np.abs(now - add_glare(frame, replace(glare, seed=4), time_s=1.0)).max() > 1


def test_low_light_scales_everything_above_black(frame):
    dark = lower_light(frame, 0.4)
    np.testing.assert_allclose(dark - 16, 0.4 * (frame - 16), rtol=1e-5, atol=1e-4)
    assert dark.dtype == np.float32


def test_sharpening_keeps_the_mean_and_overshoots_at_an_edge():
    step = np.full((60, 80), 80, np.float32)
    step[:, 40:] = 160
    sharp = sharpen(step, 0.8)
    np.testing.assert_allclose(sharp[:, :30], 80, atol=1e-3)
    np.testing.assert_allclose(sharp[:, 50:], 160, atol=1e-3)
    assert sharp.mean() == pytest.approx(step.mean(), abs=1e-3)
    # The blurred edge is 160 - 80 Phi(-0.5) on the first bright pixel's centre.
    assert sharp[30, 40] == pytest.approx(160 + 0.8 * 80 * 0.3085, abs=1.5)
    np.testing.assert_allclose(sharpen(step, 0.0), step, atol=1e-4)


def test_sharpening_raises_fine_waves_by_its_closed_form_gain():
    u = np.arange(160)
    wave = np.tile(100 + 20 * np.cos(2 * np.pi * u / 8), (40, 1)).astype(np.float32)
    gain = 1 + 0.9 * (1 - np.exp(-0.5 * (2 * np.pi / 8) ** 2))
    sharp = sharpen(wave, 0.9)[20, 40:120] - 100
    np.testing.assert_allclose(sharp, gain * (wave[20, 40:120] - 100), atol=0.05)


def test_warp_moves_the_picture_by_the_map(frame):
    whole = warp(frame, [[1, 0, 3], [0, 1, -2]])
    np.testing.assert_allclose(whole[10:-10, 10:-10], frame[12:-8, 7:-13], atol=1e-3)
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))

    def smooth(x, y):
        return 110 + 40 * np.sin(x / 7) * np.cos(y / 9)

    # Rounding, 1/64 px along u and v, is 0.16; the rest is the cubic kernel itself.
    moved = warp(smooth(u, v).astype(np.float32), [[1, 0, 0.37], [0, 1, -0.62]])
    np.testing.assert_allclose(moved[5:-5, 5:-5], smooth(u - 0.37, v + 0.62)[5:-5, 5:-5], atol=0.25)


def test_stabilization_takes_out_its_share_of_the_scene_motion():
    time_s = np.arange(200) / 60
    motion = np.column_stack([np.sin(9 * time_s), 4 * np.cos(7 * time_s)])
    still = Stabilization(follow=0.6, drift_px=0.0, roll_std_deg=0.0)
    path = compute_stabilization_path(time_s, motion, still, image_size=(640, 480))
    np.testing.assert_allclose(path[:, :, 2], -0.6 * motion, atol=1e-12)
    np.testing.assert_allclose(path[:, :, :2], np.tile(np.eye(2), (200, 1, 1)), atol=1e-15)


def test_stabilization_wanders_smoothly_with_the_stated_spread():
    time_s = np.arange(60 * 400) / 60
    settings = Stabilization(follow=0.0, drift_px=1.5, roll_std_deg=0.02, seed=6)
    path = compute_stabilization_path(time_s, np.zeros((len(time_s), 2)), settings, image_size=(640, 480))
    center = np.array([319.5, 239.5])
    middle = path[:, :, :2] @ center + path[:, :, 2] - center
    np.testing.assert_allclose(middle.std(axis=0), 1.5, rtol=0.05)
    assert np.rad2deg(np.arcsin(path[:, 1, 0])).std() == pytest.approx(0.02, rel=0.05)
    np.testing.assert_allclose(np.linalg.det(path[:, :, :2]), 1, atol=1e-12)
    # No frequency above 3 Hz: at most 1.5 px sqrt(2 * 8) 2 pi 3 / 60 from frame to frame.
    assert 0.05 < np.abs(np.diff(middle, axis=0)).max() < 1.9
    again = compute_stabilization_path(time_s[:9], np.zeros((9, 2)), settings, image_size=(640, 480))
    np.testing.assert_array_equal(again, path[:9])
    other = compute_stabilization_path(time_s[:9], np.zeros((9, 2)), replace(settings, seed=9), image_size=(640, 480))
    assert np.abs(other - again).max() > 0.1


def test_exposure_is_sampled_evenly_about_its_middle():
    np.testing.assert_allclose(compute_exposure_times(2.0, 0.012, 3), [1.996, 2.0, 2.004])
    np.testing.assert_allclose(compute_exposure_times(2.0, 0.012, 1), [2.0])
    # The mean over the samples of a fast sine is its mean over the exposure.
    times = compute_exposure_times(0.3, 0.02, 64)
    exact = (np.cos(50 * 0.29) - np.cos(50 * 0.31)) / (50 * 0.02)
    assert np.sin(50 * times).mean() == pytest.approx(exact, abs=1e-4)


def test_rows_are_read_one_after_the_other_about_the_middle_of_the_frame():
    delays = compute_row_delays(1080, 0.0108)
    assert delays.mean() == pytest.approx(0, abs=1e-15)
    np.testing.assert_allclose(np.diff(delays), 1e-5)
    np.testing.assert_array_equal(compute_row_delays(4, 0.0), np.zeros(4))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: defocus(f, -1.0), "sigma_px: expected >= 0"),
        (lambda f: sharpen(f, -0.1), "amount: expected >= 0"),
        (lambda f: lower_light(f, 0.0), "gain: expected more than 0"),
        (lambda _: Glare(1.2), "glare: expected strength"),
        (lambda _: Stabilization(follow=2.0), "stabilization: expected follow"),
        (lambda f: warp(f, np.eye(3)), "affine: expected shape"),
        (
            lambda _: compute_stabilization_path([0.0], [[0.0, 0.0, 0.0]], Stabilization(), image_size=(8, 8)),
            "scene_motion_px: expected shape",
        ),
        (lambda _: compute_exposure_times(0.0, -1.0, 2), "exposure: expected >= 0 s"),
        (lambda _: compute_row_delays(0, 0.01), "rows: expected at least one"),
    ],
)
def test_impossible_settings_are_refused(frame, call, message):
    with pytest.raises(DatasetError, match=message):
        call(frame)
