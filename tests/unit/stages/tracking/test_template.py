"""The monocular baseline: resolution, what it refuses, and its way to millimetres."""

import numpy as np
import pytest

from moving_frames import NOISE, NaturalTexture, digitize, memory_video
from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status, check_tracks
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.stages.displacement.monocular import compute_planar_displacement, scale_factor
from vfm_sdm.stages.registration.peaks import correlation_peaks, cut_subset
from vfm_sdm.stages.tracking.template import TemplateTracker

SIZE = 256
POINTS = np.array([[128.0, 128.0], [90.3, 110.7], [150.5, 95.25]])
NAMES = ["a", "b", "c"]


@pytest.fixture(scope="module")
def texture():
    return NaturalTexture(41, contrast=28)


def track(frames, points=POINTS, **options):
    return check_tracks(TemplateTracker(**options).track(memory_video(frames), points, names=NAMES[: len(points)]))


def test_resolution_is_a_sixteenth_of_a_pixel(texture):
    """Noise-free, the nearest grid position is found: errors up to 1/32 px, and multiples of 1/16 px only."""
    rng = np.random.default_rng(1)
    shifts = np.concatenate([[[0, 0]], rng.uniform(-6, 6, (25, 2))])
    tracks = track([digitize(texture.image(shift)) for shift in shifts])
    moved = tracks["position"].values - POINTS
    np.testing.assert_array_equal(moved * 16, np.rint(moved * 16))
    error = moved - shifts[:, None]
    assert np.abs(error).max() < 1 / 32 + 0.006
    assert np.sqrt((error[1:] ** 2).mean()) == pytest.approx(1 / 16 / np.sqrt(12), rel=0.2)
    assert (tracks["status"] == Status.OK).all()


def test_stated_deviation_holds_quantisation_and_noise(texture):
    rng = np.random.default_rng(2)
    shifts = rng.uniform(-3, 3, (25, 2))
    frames = [digitize(texture.image(shift), rng, NOISE) for shift in ((0.0, 0.0), *shifts)]
    tracks = track(frames)
    error = tracks["position"].values[1:] - POINTS - shifts[:, None]
    variance = np.einsum("tpkk->tpk", tracks["position_covariance"].values[1:])
    assert (variance > (1 / 16) ** 2 / 12).all()
    assert np.sqrt((error**2 / variance).mean()) == pytest.approx(1, rel=0.2)


def test_the_region_of_interest_stays(texture):
    """Within the margin of its place in the reference frame the target is found, however it got there."""
    shifts = np.array([[0.0, 0.0], [25.0, -25.0], [0.0, 28.0], [31.0, 0.0], [-28.6, 0.0], [0.2, 0.0]])
    tracks = track([digitize(texture.image(shift)) for shift in shifts], roi_margin_px=30)
    ok, lost = Status.OK, Status.LOST
    np.testing.assert_array_equal(tracks["status"].values[:, 0], [ok, ok, ok, lost, ok, ok])
    np.testing.assert_array_equal(np.isnan(tracks["position"].values).any(axis=(1, 2)), [0, 0, 0, 1, 0, 0])


def test_sixteen_bits_and_light_that_changes(texture):
    shifts = np.array([[0.0, 0.0], [2.25, -1.5]])
    frames = [digitize(texture.image(shifts[0]), dtype=np.uint16, scale=40)]
    frames += [digitize(0.6 * texture.image(shifts[1]) + 90, dtype=np.uint16, scale=40)]
    np.testing.assert_allclose(track(frames)["position"].values[1], POINTS + shifts[1], atol=1e-9)


def test_leaving_the_image_is_outside(texture):
    points = np.array([[SIZE - 24.0, 128.0], [5.0, 128.0]])
    shifts = [(0.0, 0.0), (2.0, 0.0), (6.0, 0.0)]
    status = track([digitize(texture.image(shift)) for shift in shifts], points=points)["status"].values
    assert list(status[:2, 0]) == [Status.OK, Status.OK]
    assert status[2, 0] in (Status.OUTSIDE, Status.LOST)
    assert (status[:, 1] == Status.OUTSIDE).all()


def test_another_texture_is_lost(texture):
    other = digitize(NaturalTexture(42, contrast=28).image())
    tracks = track([digitize(texture.image()), other])
    assert (tracks["status"].values[1] == Status.LOST).all()
    assert np.isnan(tracks["position"].values[1]).all()
    assert np.isnan(tracks["position_covariance"].values[1]).all()


def test_repeated_targets_are_lost():
    """Several places are equally good, from the first frame on."""
    v, u = np.mgrid[:SIZE, :SIZE].astype(float)
    frame = digitize(127 + 50 * np.sin(2 * np.pi * u / 14) * np.sin(2 * np.pi * v / 14))
    assert (track([frame, frame])["status"] == Status.LOST).all()


def test_poor_resemblance_is_unreliable(texture):
    rng = np.random.default_rng(3)
    frames = [digitize(texture.image((0.5 * k, 0.0)), rng, 11.0) for k in range(4)]
    tracks = track(frames, reliable_correlation=0.95)
    assert (tracks["status"].values[1:] == Status.UNRELIABLE).all()
    assert np.isfinite(tracks["position"]).all()
    assert ((tracks["correlation"].values[1:] > 0.7) & (tracks["correlation"].values[1:] < 0.95)).all()


def test_attributes(texture):
    tracks = track([digitize(texture.image())], subset_px=31)
    assert tracks.attrs["tracker"] == "template"
    assert tracks.attrs["subset_px"] == 31
    assert tracks.attrs["resolution_px"] == 1 / 16
    assert tracks["correlation"].attrs["units"] == "1"


def test_correlation_peaks_of_integer_shifts(texture):
    reference = digitize(texture.image())
    subset = cut_subset(reference, np.array([128, 120]), 20)
    for dtype, scale in ((np.uint8, 1.0), (np.uint16, 100.0)):
        image = digitize(texture.image((17, -23)), dtype=dtype, scale=scale)
        template = (subset.astype(float) * scale).astype(dtype)
        peaks = correlation_peaks(template, image, np.array([128.4, 119.6]), radius_px=40, count=3)
        np.testing.assert_array_equal(peaks[0], [145, 97])
    assert correlation_peaks(subset, reference, np.array([128.0, 120.0]), radius_px=0, count=3).tolist() == [[128, 120]]
    assert correlation_peaks(subset, reference, np.array([-30.0, 120.0]), radius_px=40, count=3).shape == (0, 2)


def test_scale_factor_is_length_over_distance():
    assert scale_factor([10.0, 20.0], [40.0, 60.0], 125.0) == pytest.approx(2.5)
    with pytest.raises(DatasetError, match="pixel_a, pixel_b: expected two distinct finite pixels"):
        scale_factor([1.0, 1.0], [1.0, 1.0], 100.0)
    with pytest.raises(DatasetError, match="pixel_a, pixel_b: expected two distinct finite pixels"):
        scale_factor([1.0, np.nan], [1.0, 1.0], 100.0)
    with pytest.raises(DatasetError, match=r"pixel_b: expected shape \(2\)"):
        scale_factor([1.0, 1.0], [1.0, 1.0, 2.0], 100.0)
    for length in (0.0, -3.0, np.inf, np.nan):
        with pytest.raises(DatasetError, match="length_mm: expected a positive length"):
            scale_factor([1.0, 1.0], [5.0, 1.0], length)


def tracks_of(position, std_px=0.01):
    return stated_tracks(position, std_px, 50, names=NAMES[: position.shape[1]], tracker="template")


def test_planar_displacement_is_relative_to_the_first_position():
    position = np.array([[[5.0, 5.0], [np.nan, np.nan]], [[6.0, 4.0], [2.0, 2.0]], [[5.0, 5.5], [2.5, 4.0]]])
    displacement = compute_planar_displacement(tracks_of(position), mm_per_px=2.0, scale_std=0.001)
    expected = [[[0, 0], [np.nan, np.nan]], [[2, -2], [0, 0]], [[0, 1], [1, 4]]]
    np.testing.assert_allclose(displacement["displacement"], expected)
    np.testing.assert_allclose(displacement["displacement_std"], 0.02)
    assert displacement["displacement"].dims == ("time", "point", "axis")
    assert list(displacement["axis"].values) == ["right", "down"]
    assert displacement["displacement"].attrs["units"] == displacement["displacement_std"].attrs["units"] == "mm"
    assert displacement.attrs["frame"] == "image plane"
    assert displacement.attrs["mm_per_px"] == 2.0
    np.testing.assert_array_equal(displacement["status"], [[0, 1], [0, 0], [0, 0]])


def test_planar_displacement_of_a_point_never_seen_is_nan():
    displacement = compute_planar_displacement(tracks_of(np.full((3, 1, 2), np.nan)), mm_per_px=2.0, scale_std=0.001)
    assert np.isnan(displacement["displacement"]).all()


def test_planar_displacement_checks_its_input():
    tracks = tracks_of(np.zeros((2, 1, 2)))
    for factor in (0.0, -1.0, np.nan):
        with pytest.raises(DatasetError, match="mm_per_px: expected a positive factor"):
            compute_planar_displacement(tracks, mm_per_px=factor, scale_std=0.001)
    tracks["position"].attrs["units"] = "mm"
    with pytest.raises(DatasetError, match="position: expected units 'px'"):
        compute_planar_displacement(tracks, mm_per_px=1.0, scale_std=0.001)


def test_from_two_frames_to_millimetres(texture):
    """Alone on one view: a target moves, a known length gives the scale."""
    frames = [digitize(texture.image()), digitize(texture.image((3.0, -1.5)))]
    factor = scale_factor([50.0, 60.0], [50.0, 210.0], 300.0)
    displacement = compute_planar_displacement(track(frames), mm_per_px=factor, scale_std=0.001)["displacement"]
    np.testing.assert_allclose(displacement.values[1], np.tile([6.0, -3.0], (3, 1)), atol=0.13)


def test_settings_and_input_are_checked(texture):
    with pytest.raises(SessionError, match="subset_px: expected an odd number of at least 9 pixels, got 30"):
        TemplateTracker(subset_px=30)
    with pytest.raises(SessionError, match="template: expected positive settings, got roi_margin_px = 0, threads = -1"):
        TemplateTracker(roi_margin_px=0, threads=-1)
    with pytest.raises(SessionError, match="template: expected 0 < minimum_correlation <= reliable_correlation < 1"):
        TemplateTracker(minimum_correlation=0.95)
    video = memory_video([digitize(texture.image())])
    with pytest.raises(DatasetError, match="points2d: expected pixels inside 256 x 256"):
        TemplateTracker().track(video, np.array([[-1.0, 5.0]]), names=["a"])
    with pytest.raises(DatasetError, match="reference_frame: expected a frame 7, got a video of 1 frames"):
        TemplateTracker().track(video, POINTS, names=NAMES, reference_frame=7)
