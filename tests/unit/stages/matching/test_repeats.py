"""What repeats in a picture is found by the common step of its look-alikes, and takes no part in a free pose."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.cameras.related_views import Known, relate_view
from vfm_sdm.stages.matching.detection import detect_features
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
