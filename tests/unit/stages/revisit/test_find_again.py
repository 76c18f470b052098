"""Places of one picture in a later one of the same view, from a camera that stands elsewhere and zooms otherwise."""

import numpy as np
import pytest

from scenes import DEPTH, SIZE, render
from simulation import intrinsics, looking_at
from textures import WaveTexture
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.revisit.places import find_again

TARGET = np.array([0.0, 0.0, DEPTH])
PLACES = np.array([[100.3, 80.6], [200.0, 130.0], [260.7, 170.2]])


def camera(center, focal_px):
    return Camera(intrinsics(focal_px, SIZE), SIZE, cam_from_world=looking_at(np.array(center), TARGET))


@pytest.fixture(scope="module")
def views():
    """Cameras and pictures of two visits, and where the later one shows the places."""
    cameras = camera([0.0, 0.0, 0.0], 800.0), camera([0.4, -0.1, 0.3], 840.0)
    texture = WaveTexture(8)
    images = tuple(render(one, texture, np.zeros(3)) for one in cameras)
    rays = np.column_stack([cameras[0].normalize(PLACES), np.ones(3)]) @ cameras[0].rotation
    normal = np.array([-0.2, 0.0, 1.0])
    points3d = rays * ((TARGET @ normal) / (rays @ normal))[:, None]
    return cameras, images, cameras[1].project(points3d)


def test_places_are_found_to_a_fraction_of_a_pixel(views):
    cameras, images, true = views
    named = true + np.array([[4.0, -3.0], [-5.0, 2.0], [0.0, 6.0]])  # a click is some pixels beside
    found, covariance, status = find_again(images, cameras, PLACES, named, subset_px=31)
    assert status == [PointStatus.OK] * 3
    apart = found - true
    assert np.abs(apart).max() < 0.05
    assert (np.abs(apart) < 4 * np.sqrt(np.einsum("pii->pi", covariance)) + 0.02).all()


def test_another_place_than_the_later_session_names_is_a_look_alike(views):
    cameras, images, true = views
    named = true.copy()
    named[1] += [60.0, 10.0]
    found, covariance, status = find_again(images, cameras, PLACES, named, subset_px=31)
    assert status[0] == status[2] == PointStatus.OK
    assert status[1] != PointStatus.OK
    assert np.isnan(found[1]).all()
    assert np.isnan(covariance[1]).all()


def test_what_one_visit_does_not_see_is_not_looked_for(views):
    cameras, images, true = views
    places, named = PLACES.copy(), true.copy()
    places[0], named[2] = np.nan, np.nan
    _, _, status = find_again(images, cameras, places, named, subset_px=31)
    assert status == [PointStatus.NOT_FOUND, PointStatus.OK, PointStatus.NOT_FOUND]


def test_pictures_that_have_nothing_in_common(views):
    cameras, images, true = views
    blank = np.full_like(images[1], 90)
    found, covariance, status = find_again((images[0], blank), cameras, PLACES, true, subset_px=31)
    assert status == [PointStatus.NOT_FOUND] * 3
    assert np.isnan(found).all()
    assert np.isnan(covariance).all()


def test_smaller_subsets_that_disagree_count_in_the_covariance(views):
    """A strip beside the point that lies nearer moves otherwise with the camera."""
    cameras, images, true = views
    later = images[1].copy()
    u, v = np.rint(true[1]).astype(int)
    strip = (slice(v - 20, v + 20), slice(u + 9, u + 16))
    later[strip] = np.roll(images[1], 2, axis=1)[strip]
    plain = find_again(images, cameras, PLACES, true, subset_px=41)[1]
    found, mixed, status = find_again((images[0], later), cameras, PLACES, true, subset_px=41)
    assert status[1] == PointStatus.OK
    assert mixed[1, 0, 0] > 2 * plain[1, 0, 0]
    assert np.abs(found[1] - true[1])[0] < 4 * np.sqrt(mixed[1, 0, 0])
