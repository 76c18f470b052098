"""Points carried from one view into another, on a textured plane seen by two cameras thirty degrees apart."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from simulation import intrinsics, looking_at
from textures import WaveTexture
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.correspondence import Surface, find_correspondences
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.pyramid import ViewPair

SIZE = (420, 320)
DEPTH = 10.0
NO_MATCHES = Matches(0, 1, np.empty((0, 2)), np.empty((0, 2)))
# An affine warp leaves out the second order of the perspective, tan(angle) x^2 / f: 0.09 px on average over a subset of
# 41 px at 30 degrees and 900 px of focal length. It shifts the place by a constant and no displacement.
ATOL_PX = 0.1
POINTS = np.array([[150.3, 120.6], [210.0, 160.0], [260.7, 200.2]])


def rig():
    angle = np.radians(30)
    target = np.array([0.0, 0.0, DEPTH])
    centers = [np.zeros(3), target + DEPTH * np.array([np.sin(angle), 0.0, -np.cos(angle)])]
    cameras = [Camera(intrinsics(900.0, SIZE), SIZE, cam_from_world=looking_at(c, target)) for c in centers]
    return Rig.from_world(("left", "right"), cameras, metric=True)


def plane_points(camera, pixels):
    """Where the viewing rays meet the plane z = DEPTH + 0.2 x, shape (..., 3) [m]."""
    rays = np.concatenate([camera.normalize(pixels), np.ones((*pixels.shape[:-1], 1))], axis=-1) @ camera.rotation
    normal = np.array([-0.2, 0.0, 1.0])
    distance = (DEPTH - camera.center @ normal) / (rays @ normal)
    return camera.center + distance[..., None] * rays


def view(camera, texture):
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    X = plane_points(camera, np.stack([u, v], axis=-1))
    grey = texture(X[..., 0] * 90, X[..., 1] * 90)  # 90 px of texture a metre, as many as a pixel sees
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def images():
    texture = WaveTexture(5)
    return tuple(view(camera, texture) for camera in rig().cameras)


def true_position():
    left, right = rig().cameras
    return right.project(plane_points(left, POINTS))


def matches_around(count=40, seed=0, wrong=0):
    left, right = rig().cameras
    rng = np.random.default_rng(seed)
    first = rng.uniform([100, 80], [320, 240], (count, 2))
    second = right.project(plane_points(left, first)) + rng.normal(0, 0.5, (count, 2))
    second[:wrong] += rng.uniform(20, 60, (wrong, 2))
    return Matches(0, 1, first, second)


@pytest.mark.parametrize(
    "matches", [NO_MATCHES, matches_around(), matches_around(wrong=8)], ids=["none", "some", "wrong"]
)
def test_found_to_sub_pixel_at_thirty_degrees(images, matches):
    found = find_correspondences(ViewPair(images, rig(), matches), POINTS)
    assert found.status == (PointStatus.OK,) * 3
    np.testing.assert_allclose(found.points2d, true_position(), atol=ATOL_PX)
    assert (found.return_error < 0.05).all()
    assert (found.correlation > 0.98).all()


def test_an_approximate_rig_is_enough(images):
    step = np.zeros(20)
    step[10:] = [0.03, 0, 0, 0, 0.002, 0.01, 0.002, 0.05, 0.02, 0.05]
    found = find_correspondences(ViewPair(images, rig().perturbed(step), matches_around()), POINTS)
    np.testing.assert_allclose(found.points2d, true_position(), atol=ATOL_PX)


def test_a_repeated_pattern_is_ambiguous_not_a_guess():
    def stripes(x, _y):
        return 128 + 60 * np.cos(2 * np.pi * x / 14) * np.cos(2 * np.pi * _y / 14)

    images = tuple(view(camera, stripes) for camera in rig().cameras)
    found = find_correspondences(ViewPair(images, rig(), NO_MATCHES), POINTS)
    assert set(found.status) == {PointStatus.AMBIGUOUS}
    assert np.isnan(found.points2d).all()


def test_a_position_given_by_hand_decides_between_look_alikes():
    def stripes(x, y):
        return 128 + 60 * np.cos(2 * np.pi * x / 24) * np.cos(2 * np.pi * y / 24)

    images = tuple(view(camera, stripes) for camera in rig().cameras)
    given = dict(enumerate(true_position() + 1.0))
    found = find_correspondences(ViewPair(images, rig(), NO_MATCHES), POINTS, given=given)
    assert found.status == (PointStatus.OK,) * 3
    np.testing.assert_allclose(found.points2d, true_position(), atol=ATOL_PX)


def test_what_the_other_view_does_not_show_is_not_found(images):
    other = view(rig().cameras[1], WaveTexture(99))
    found = find_correspondences(ViewPair((images[0], other), rig(), NO_MATCHES), POINTS)
    assert set(found.status) <= {PointStatus.NOT_FOUND, PointStatus.AMBIGUOUS}
    assert np.isnan(found.points2d).all()


def test_nothing_asked_nothing_found(images):
    found = find_correspondences(ViewPair(images, rig(), NO_MATCHES), np.empty((0, 2)))
    assert found.points2d.shape == (0, 2)
    assert found.status == ()


def test_points_outside_the_first_image_are_refused(images):
    with pytest.raises(DatasetError, match="expected pixels inside 420 x 320"):
        find_correspondences(ViewPair(images, rig(), NO_MATCHES), np.array([[500.0, 10.0]]))


def test_smaller_squares_find_what_a_stiffener_hides_in_part(images, monkeypatch):
    left, right = images[0], images[1].copy()
    stiffener = view(rig().cameras[1], WaveTexture(77))
    place = true_position()[1]
    # From 13 px beside the point on, the second view sees something else.
    edge = round(place[0]) + 13
    right[:, edge : edge + 60] = stiffener[:, edge : edge + 60]
    found = find_correspondences(ViewPair((left, right), rig(), NO_MATCHES), POINTS[1:2], subset_px=61)
    assert found.status == (PointStatus.OK,)
    assert found.correlation[0] > 0.9
    np.testing.assert_allclose(found.points2d[0], place, atol=ATOL_PX)
    monkeypatch.setattr("vfm_sdm.stages.matching.correspondence._SIZES_PX", (61,))
    whole = find_correspondences(ViewPair((left, right), rig(), NO_MATCHES), POINTS[1:2], subset_px=61)
    assert whole.status != (PointStatus.OK,) or np.abs(whole.points2d[0] - place).max() > 2 * ATOL_PX


def surface(offset=0.0, std=0.3):
    scale = np.hypot(1.0, 0.2)
    return Surface(np.array([-0.2, 0.0, 1.0]) / scale, DEPTH / scale + offset, std)


def dark_and_out_of_focus(image, seed=3):
    soft = gaussian_filter(image.astype(float), 2.0)
    noisy = 0.12 * soft + np.random.default_rng(seed).normal(0, 1.2, image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def test_a_known_surface_finds_what_a_dark_view_out_of_focus_shows_between_stiffeners(images):
    right = images[1].copy()
    stiffener = view(rig().cameras[1], WaveTexture(77))
    place = true_position()[1]
    for edge in (round(place[0]) - 41, round(place[0]) + 15):
        right[:, edge : edge + 26] = stiffener[:, edge : edge + 26]
    right = dark_and_out_of_focus(right)
    views = ViewPair((images[0], right), rig(), NO_MATCHES)
    alone = find_correspondences(views, POINTS[1:2], subset_px=61)
    assert alone.status != (PointStatus.OK,)
    found = find_correspondences(views, POINTS[1:2], subset_px=61, surface=surface())
    assert found.status == (PointStatus.OK,)
    np.testing.assert_allclose(found.points2d[0], place, atol=0.5)


def test_nothing_is_found_on_a_surface_that_is_elsewhere(images):
    found = find_correspondences(ViewPair(images, rig(), NO_MATCHES), POINTS, surface=surface(offset=2.0, std=0.1))
    assert found.status == (PointStatus.NOT_FOUND,) * 3
    assert np.isnan(found.points2d).all()


def test_a_surface_alone_does_not_make_up_a_place(images):
    other = view(rig().cameras[1], WaveTexture(99))
    found = find_correspondences(ViewPair((images[0], other), rig(), NO_MATCHES), POINTS, surface=surface())
    assert found.status == (PointStatus.NOT_FOUND,) * 3
