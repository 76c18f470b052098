import numpy as np
import pytest
from rendered_scenes import plain_camera, plain_face

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.scene import GUARD, Face, Mark, Scene, Texture, coarsest_pixel, texture_luma

SIZE_M = (2.0, 1.5)


def texture(**changes):
    return Texture(**{"seed": 3, "mean": 110.0, "contrast": 18.0, "shortest_m": (0.04, 0.02), **changes})


def spectrum(texture_):
    """Amplitude and frequencies along u and v [1/m] of the texture's texels."""
    luma = texture_luma(texture_, SIZE_M)
    f_v = np.fft.fftfreq(luma.shape[0], 1 / texture_.texels_per_m[1])[:, None]
    f_u = np.fft.rfftfreq(luma.shape[1], 1 / texture_.texels_per_m[0])
    return np.abs(np.fft.rfft2(luma - luma.mean())), f_u, f_v


def test_texture_holds_nothing_finer_than_its_shortest_wavelengths():
    amplitude, f_u, f_v = spectrum(texture())
    beyond = (f_u * 0.04) ** 2 + (f_v * 0.02) ** 2 > 1
    assert amplitude[beyond].max() < 1e-9 * amplitude.max()
    near = ~beyond & ((f_u * 0.04) ** 2 + (f_v * 0.02) ** 2 > 0.4)
    assert amplitude[near].mean() > 1e-3 * amplitude.max()


def test_texture_amplitude_falls_as_one_over_frequency():
    amplitude, f_u, f_v = spectrum(texture(shortest_m=(0.02, 0.02)))
    f = np.hypot(f_u, f_v)
    # From the flat part below 2 / m to the taper above 30 / m.
    bands = [(4, 6), (8, 12), (16, 24)]
    means = [np.sqrt(np.mean(amplitude[(f > low) & (f < high)] ** 2)) for low, high in bands]
    np.testing.assert_allclose([means[0] / means[1], means[1] / means[2]], 2.0, rtol=0.15)


def test_texture_has_the_mean_and_contrast_asked_for():
    luma = texture_luma(texture(), SIZE_M)
    assert luma.mean() == pytest.approx(110.0, abs=1e-9)
    assert luma.std() == pytest.approx(18.0, rel=1e-9)
    least = (1.5 / 0.005 + 2 * GUARD, 2.0 / 0.01 + 2 * GUARD)
    assert all(low <= size <= 1.05 * low for size, low in zip(luma.shape, least, strict=True))


def test_texture_follows_its_seed():
    np.testing.assert_array_equal(texture_luma(texture(), SIZE_M), texture_luma(texture(), SIZE_M))
    assert np.abs(texture_luma(texture(), SIZE_M) - texture_luma(texture(seed=4), SIZE_M)).mean() > 5


def test_mark_darkens_the_texture_where_it_is_placed():
    mark = Mark((0.5, 1.2), (0.05, 0.03), -40.0)
    drawn = texture_luma(texture(marks=(mark,)), SIZE_M) - texture_luma(texture(), SIZE_M)
    v, u = np.unravel_index(drawn.argmin(), drawn.shape)
    assert drawn.min() == pytest.approx(-40.0, rel=1e-9)
    assert ((u - GUARD) * 0.01, (v - GUARD) * 0.005) == (pytest.approx(0.5), pytest.approx(1.2))
    beside = drawn[v, u + 5]  # one standard deviation along u
    assert beside == pytest.approx(-40.0 * np.exp(-0.5), rel=1e-6)


def test_mark_finer_than_the_texture_is_widened_to_what_it_can_hold():
    drawn = texture_luma(texture(contrast=0.0, marks=(Mark((1.0, 0.7), (1e-4, 1e-4), -40.0),)), SIZE_M) - 110.0
    v, u = np.unravel_index(drawn.argmin(), drawn.shape)
    assert drawn[v, u + 1] / drawn[v, u] == pytest.approx(np.exp(-0.5 * (0.01 / (0.4 * 0.04)) ** 2), rel=1e-6)


def test_face_knows_its_points():
    face = plain_face("wall", 90.0, (1, 2, 3), (0, 0, 2), (0, 4, 0))
    assert face.size_m == (2.0, 4.0)
    np.testing.assert_allclose(face.points3d([0.5, 1.0]), [1, 3, 3.5])
    np.testing.assert_allclose(face.corners, [[1, 2, 3], [1, 6, 3], [1, 2, 5], [1, 6, 5]])


def test_scene_finds_a_face_by_name():
    wall = plain_face("wall", 90.0, (0, 0, 3), (1, 0, 0), (0, 1, 0))
    assert Scene((wall,)).face("wall") is wall
    with pytest.raises(DatasetError, match=r"face 'door': expected one of \['wall'\]"):
        Scene((wall,)).face("door")


def test_coarsest_pixel_is_depth_over_focal_length_seen_at_a_right_angle():
    size = coarsest_pixel((-2, -2, 6), (4, 0, 0), (0, 4, 0), [plain_camera(focal_px=300.0)])
    np.testing.assert_allclose(size, 6 / 300, rtol=1e-3)


def test_coarsest_pixel_grows_with_obliqueness_and_with_the_worse_camera():
    near, far = plain_camera(focal_px=600.0), plain_camera(focal_px=300.0)
    # At 60 degrees from the optical axis' normal; small, so that it is at one depth.
    u = 0.02 * np.array([0.5, 0, np.sqrt(0.75)])
    size = coarsest_pixel((0, 0, 6), u, (0, 0.02, 0), [near, far])
    np.testing.assert_allclose(size, [6 / 300 / 0.5, 6 / 300], rtol=0.01)


def test_coarsest_pixel_is_none_for_what_no_camera_sees():
    assert coarsest_pixel((-1, -1, -6), (2, 0, 0), (0, 2, 0), [plain_camera()]) is None
    assert coarsest_pixel((50, -1, 6), (2, 0, 0), (0, 2, 0), [plain_camera()]) is None
    assert coarsest_pixel((-1, -1, 6), (2, 0, 0), (0, 2, 0), []) is None


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        (((1, 0, 0), (1, 1, 0)), "wall: expected two edges at right angles"),
        (((1, 0, 0), (0, 0, 0)), "wall: expected two edges at right angles"),
        (((1, 0, 0), (0, np.nan, 0)), "wall: expected two edges at right angles"),
        (((1, 0), (0, 1, 0)), r"wall\.edge_u: expected shape \(3\)"),
    ],
)
def test_face_refuses_what_is_no_rectangle(edges, message):
    with pytest.raises(DatasetError, match=message):
        Face("wall", np.zeros(3), np.array(edges[0], float), np.array(edges[1], float), texture())


@pytest.mark.parametrize("faces", [(), (plain_face("a", 1.0, (0, 0, 1), (1, 0, 0), (0, 1, 0)),) * 2])
def test_scene_refuses_no_face_and_names_twice(faces):
    with pytest.raises(DatasetError, match="scene: expected at least one face and distinct names"):
        Scene(faces)


@pytest.mark.parametrize("changes", [{"shortest_m": (0.0, 0.1)}, {"longest_m": -1.0}, {"shortest_m": (np.nan, 0.1)}])
def test_texture_refuses_wavelengths_that_are_none(changes):
    with pytest.raises(DatasetError, match="texture: expected wavelengths > 0 m"):
        texture(**changes)
