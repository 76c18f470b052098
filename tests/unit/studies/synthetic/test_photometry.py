"""Each stage of lens and sensor against its own law."""

from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import defocus
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.photometry import DepthBlur, Photometry, compute_blur, compute_vignetting

SIZE = (200, 120)
OFF_CENTRE = Camera(np.array([[900.0, 0, 120.0], [0, 900.0, 50.0], [0, 0, 1]]), SIZE)


def test_vignetting_takes_its_share_in_the_farthest_corner_and_nothing_on_the_axis():
    share = compute_vignetting(Photometry(vignetting=0.35), OFF_CENTRE)
    assert share.shape == SIZE[::-1]
    # The principal point lies to the right and above: the corner at the left bottom is the farthest.
    assert share[-1, 0] == pytest.approx(0.65, abs=1e-6)
    assert share[50, 120] == 1
    assert share.min() == share[-1, 0]
    # Half-way to the corner: (1 + c / 4)^-2 with (1 + c)^-2 = 0.65.
    c = 0.65**-0.5 - 1
    u, v = 60, 50 + (119 - 50) // 2
    r = ((120 - u) ** 2 + (v - 50) ** 2) / (120**2 + 69**2)
    assert share[v, u] == pytest.approx((1 + c * r) ** -2, rel=1e-6)


def test_without_vignetting_all_light_arrives():
    np.testing.assert_array_equal(compute_vignetting(Photometry(), OFF_CENTRE), 1)


@pytest.mark.parametrize("read_e", [0.0, 20.0])
def test_noise_variance_follows_brightness(read_e):
    sensor = Photometry(full_well_e=8000, read_noise_e=read_e)
    imager = Imager(SIZE, noise_std=0.0, photometry=sensor, seed=(4,))
    video, spread, levels = [], [], np.array([25.0, 40.0, 70.0, 110.0, 160.0])
    for number, level in enumerate(levels):
        frames = [imager.expose(np.full(SIZE[::-1], level, np.float32), 10 * number + k) for k in range(4)]
        video.append(np.mean(frames))
        spread.append(np.std(frames))
    # Back to linear light by the slope of the tone curve; rounding adds a twelfth of a level squared.
    slope = (sensor.tone(levels + 0.5) - sensor.tone(levels - 0.5)) / 1.0
    linear = np.sqrt(np.square(spread) - 1 / 12) / slope
    electrons = 8000 * (levels - 16) / 219
    np.testing.assert_allclose(linear, np.sqrt(read_e**2 + electrons) * 219 / 8000, rtol=0.04)
    np.testing.assert_allclose(video, sensor.tone(levels), atol=0.15)


def test_a_sensor_without_photons_is_its_tone_curve():
    sensor = Photometry(shoulder=0.8)
    light = np.linspace(16, 235, SIZE[0] * SIZE[1]).reshape(SIZE[::-1]).astype(np.float32)
    frame = Imager(SIZE, noise_std=0.0, photometry=sensor).expose(light, 0)
    assert np.abs(frame - sensor.tone(light.astype(float))).max() <= 0.51


def test_tone_curve_is_that_of_video_and_lifts_what_is_dark_with_a_shoulder():
    light = np.array([0.0, 0.01, 0.018, 0.18, 0.5, 1.0])
    expected = np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
    np.testing.assert_allclose(Photometry().tone(16 + 219 * light), 16 + 219 * expected, atol=0.1)
    lifted = Photometry(shoulder=1.0).tone(16 + 219 * light)
    assert lifted[0] == 16
    assert lifted[-1] == pytest.approx(235)
    assert np.all(lifted[1:-1] > Photometry().tone(16 + 219 * light)[1:-1])
    assert np.all(np.diff(lifted) > 0)


def test_blur_is_that_of_a_thin_lens():
    # A disc of 12 px: f A |1/z - 1/D| = 8000 * 0.03 * (1/10 - 1/20); its standard deviation is half its radius.
    sigma = compute_blur(Photometry(aperture_mm=30.0, focus_m=20.0), 8000.0, np.array([10.0, 20.0]))
    np.testing.assert_allclose(sigma, [12 / 4, 0])
    x = np.linspace(-6, 6, 4001)
    u, v = np.meshgrid(x, x)
    assert u[u**2 + v**2 <= 36].std() == pytest.approx(sigma[0], rel=1e-3)


def test_uniform_blur_is_a_defocus_and_none_leaves_the_frame():
    luma = np.random.default_rng(1).uniform(20, 200, SIZE[::-1]).astype(np.float32)
    np.testing.assert_array_equal(DepthBlur(np.zeros(SIZE[::-1]))(luma), luma)
    for sigma in (0.5, 1.0, 2.5):
        np.testing.assert_allclose(DepthBlur(np.full(SIZE[::-1], sigma))(luma), defocus(luma, sigma), atol=1e-3)
    smooth = defocus(luma, 2.0)
    between = DepthBlur(np.full(SIZE[::-1], 1.3))(smooth)
    assert np.abs(between - defocus(smooth, 1.3)).max() < 0.03 * np.abs(smooth - defocus(smooth, 1.3)).max()


def test_each_pixel_has_its_own_blur():
    luma = np.random.default_rng(2).uniform(20, 200, SIZE[::-1]).astype(np.float32)
    sigma = np.zeros(SIZE[::-1])
    sigma[:, 100:] = 2.0
    blurred = DepthBlur(sigma)(luma)
    np.testing.assert_array_equal(blurred[:, :100], luma[:, :100])
    np.testing.assert_allclose(blurred[:, 100:], defocus(luma, 2.0)[:, 100:], atol=1e-3)


@pytest.mark.parametrize(
    "change", [{"vignetting": 1.0}, {"aperture_mm": -1.0}, {"focus_m": 0.0}, {"shoulder": -0.1}, {"full_well_e": -1.0}]
)
def test_impossible_lenses_and_sensors_are_refused(change):
    with pytest.raises(DatasetError, match="photometry: expected aperture, electrons and shoulder >= 0"):
        replace(Photometry(), **change)


def test_misuse_is_refused():
    with pytest.raises(DatasetError, match="sigma_px: expected finite values >= 0"):
        DepthBlur(np.array([[np.inf]]))
    with pytest.raises(DatasetError, match="noise_std: expected 0 beside photon noise, got 1"):
        Imager(SIZE, noise_std=1.0, photometry=Photometry(full_well_e=100.0))
