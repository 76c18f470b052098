"""What repeats in a picture is found by the common step of its look-alikes, and takes no part in a free pose."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from rooms import angle_between_deg
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Site
from vfm_sdm.stages.cameras.face_poses import told_agree
from vfm_sdm.stages.cameras.related_views import Known, relate_view
from vfm_sdm.stages.matching.detection import detect_features
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.points import NAMED_STD_PX
from vfm_sdm.stages.matching.repeats import find_repeats, lie_on_repeats

SIZE, TILE_M, TILE_PX = (640, 480), 1.0, 96
LENS = Camera(np.array([[900.0, 0, 319.5], [0, 900.0, 239.5], [0, 0, 1]]), SIZE)
AWAY = np.array([np.cos(0.5), 0, -np.sin(0.5)])
"""Direction of the wall's rows, seen at an angle."""


def draw_wall(tile, centre):
    """A wall of tiles 10 m before the first camera, whose picture a camera of the same direction takes."""
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 2)
    rays = np.column_stack([LENS.normalize(pixels.astype(float)), np.ones(len(pixels))])
    normal = np.array([AWAY[2], 0.0, -AWAY[0]])
    depth = (np.array([0, 0, 10.0]) - centre) @ normal / (rays @ normal)
    places = centre + rays * depth[:, None] - [0, 0, 10.0]
    at = np.stack([places[:, 1], places @ AWAY]) / TILE_M * TILE_PX
    luma = map_coordinates(tile, at, order=1, mode="grid-wrap")
    noise = np.random.default_rng(1).normal(0, 1, luma.size)
    return np.rint(luma + noise).clip(0, 255).astype(np.uint8).reshape(SIZE[::-1])


def make_texture(tiles):
    """A texture that repeats after so many tiles."""
    field = gaussian_filter(np.random.default_rng(3).normal(0, 1, (tiles * TILE_PX,) * 2), 2, mode="wrap")
    return 128 + 30 * field / field.std()


@pytest.fixture(scope="module", params=[1, 20], ids=["tiles", "no tiles"])
def wall(request):
    tile = make_texture(request.param)
    return request.param == 1, [draw_wall(tile, np.array([x, 0.0, 0.0])) for x in (0.0, 1.7)]


def test_tiles_are_found_and_nothing_else(wall):
    tiled, images = wall
    features = detect_features(images[0])
    share = find_repeats(features).mean()
    assert share > 0.6 if tiled else share < 0.05
    on = lie_on_repeats(features.points, features).mean()
    assert on > 0.8 if tiled else on < 0.05


def test_no_pose_is_ok_that_rests_on_tiles(wall):
    tiled, images = wall
    [one] = relate_view(("left", "right"), tuple(images), (LENS, LENS), 1, Known(1.7))
    if tiled:
        assert one.status != CameraStatus.OK
    else:
        assert one.status == CameraStatus.OK
        assert len(one.matches) > 200


FACE = Face.of(
    Site(
        perpendicular_distance={"value": 10 * np.cos(0.5), "std": 0.02},
        longitudinal_distance={"value": 10 * np.sin(0.5), "std": 0.03},
        reference_camera_level={"value_deg": 0.0, "std_deg": 0.1},
        structure_side="right",
    )
)
SECOND = Camera(LENS.K, SIZE, cam_from_world=np.array([[1.0, 0, 0, -1.7], [0, 1, 0, 0], [0, 0, 1, 0]]))


def tell(places, *, off_px=0.0):
    """Points of the wall (along, down) [m] as somebody points at them in both views."""
    points3d = np.array([np.array([0, y, 10.0]) + x * AWAY for x, y in places])
    miss = off_px * np.random.default_rng(7).standard_normal((len(places), 2))
    return Matches(0, 1, LENS.project(points3d), SECOND.project(points3d) + miss, std_px=NAMED_STD_PX)


@pytest.mark.parametrize("places", [[(-1.5, 0.1), (0.2, 0.1), (1.8, 0.1)], [(-1.5, -0.8), (0.2, 0.9), (1.8, 0.1)]])
@pytest.mark.slow
def test_three_places_told_on_tiles_are_a_pose(wall, places):
    """In a row, as on a railing, or not: what somebody points at is no chance, whatever the tiles agree with."""
    _, images = wall
    told = tell(places, off_px=1.0)
    related = relate_view(("left", "right"), tuple(images), (LENS, LENS), 1, Known(1.7, FACE, named=told, told=told))
    assert related[0].status == CameraStatus.OK
    assert angle_between_deg(related[0].camera.rotation, SECOND.rotation) < 3.0
    # As near as guides matches; the adjustment to the site makes the best of all of them.
    assert told_agree(related[0].camera, told, LENS, FACE).all()


def test_one_told_place_tells_which_tile_is_which(wall):
    """Without it, no pose stands out among those that put the wall a tile further."""
    _, images = wall
    told = tell([(-1.5, 0.4)], off_px=1.0)
    related = relate_view(("left", "right"), tuple(images), (LENS, LENS), 1, Known(1.7, FACE, named=told, told=told))
    assert related[0].status == CameraStatus.OK
    assert len(related[0].matches) > 200
    assert angle_between_deg(related[0].camera.rotation, SECOND.rotation) < 0.5


def test_told_places_that_contradict_the_matches_are_named():
    """Where no face is known, and too few are told for a pose of their own."""
    images = [draw_wall(make_texture(20), np.array([x, 0.0, 0.0])) for x in (0.0, 1.7)]
    told = tell([(-1.5, 0.4), (1.2, -0.6)])
    shifted = told.points_second + np.array([0.0, 60.0])
    wrong = Matches(0, 1, told.points_first, shifted, std_px=NAMED_STD_PX)
    [one] = relate_view(("left", "right"), tuple(images), (LENS, LENS), 1, Known(1.7, named=wrong))
    assert one.status == CameraStatus.NOT_CLEAR
    assert "contradicts the points that are named in both views" in one.fault
