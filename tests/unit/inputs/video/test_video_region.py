"""Regions: pixels of a region or a resized canvas and of the full image."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.video import Region

IMAGE = np.arange(60 * 80, dtype=np.uint16).reshape(60, 80)


def test_crop_is_a_view_of_the_right_pixels():
    region = Region(10, 20, 5, 4)
    part = region.crop(IMAGE)
    assert part.shape == (4, 5)
    assert np.shares_memory(part, IMAGE)
    # Canvas pixel (u, v) = (3, 2) is full-image pixel (13, 22).
    assert part[2, 3] == IMAGE[22, 13]
    np.testing.assert_array_equal(region.to_full([3, 2]), [13, 22])
    np.testing.assert_array_equal(region.from_full([13, 22]), [3, 2])


def test_colours_are_cut_and_resized_like_single_planes():
    colours = np.stack([IMAGE, IMAGE[::-1], 2 * IMAGE], axis=-1)
    for scale in (1, 0.5, 2):
        region = Region(8, 12, 40, 32, scale_u=scale, scale_v=scale)
        found = region.crop(colours)
        assert found.dtype == np.uint16
        planes = [region.crop(np.ascontiguousarray(colours[..., channel])) for channel in range(3)]
        np.testing.assert_array_equal(found, np.stack(planes, axis=-1))
    assert np.shares_memory(Region(8, 12, 40, 32).crop(colours), colours)


def test_region_within_what_another_one_cuts_out():
    outer, region = Region(8, 12, 40, 32), Region(11, 20, 8, 6, scale_u=0.5, scale_v=2)
    inner = region.within(outer)
    assert inner == Region(3, 8, 8, 6, scale_u=0.5, scale_v=2)
    np.testing.assert_array_equal(inner.crop(outer.crop(IMAGE)), region.crop(IMAGE))


def test_borders_map_to_borders():
    # Half-pixel rule: a pixel reaches half a pixel to each side of its centre.
    region = Region(10, 20, 8, 6, scale_u=2, scale_v=0.5)
    assert region.canvas_size == (16, 3)
    np.testing.assert_allclose(region.to_full([[-0.5, -0.5], [15.5, 2.5]]), [[9.5, 19.5], [17.5, 25.5]], atol=1e-12)


@pytest.mark.parametrize("scale", [0.5, 0.25, 2, 3])
def test_resized_picture_lies_where_the_mapping_says(scale):
    # A ramp keeps its value at every place under averaging and linear interpolation, away from the border.
    v, u = np.indices((60, 80))
    ramp = (100 * u + 37 * v).astype(np.uint16)
    region = Region(8, 12, 40, 32, scale_u=scale, scale_v=scale)
    canvas = region.crop(ramp)
    assert canvas.shape == region.canvas_size[::-1]
    assert canvas.dtype == np.uint16
    rows, columns = np.indices(canvas.shape)
    full = region.to_full(np.stack([columns, rows], axis=-1))
    expected = full @ [100, 37]
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(canvas[inner], expected[inner], atol=1)


def test_mapping_is_opencvs(tmp_path):
    matrix = np.array([[0.5, 0, 0], [0, 0.5, 0]])
    region = Region(0, 0, 80, 60, scale_u=0.5, scale_v=0.5)
    # OpenCV's affine warp maps pixel centres, so the half-pixel shift has to be written into it.
    matrix[:, 2] = region.from_full([0, 0])
    warped = cv2.warpAffine(IMAGE, matrix, (40, 30), flags=cv2.INTER_LINEAR)
    np.testing.assert_allclose(warped[1:-1, 1:-1].astype(float), region.crop(IMAGE)[1:-1, 1:-1], atol=1)


sides = st.integers(1, 4000)


@given(
    st.integers(-5000, 5000), st.integers(-5000, 5000), sides, sides, sides, sides,
    st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 2), min_size=1, max_size=5),
)  # fmt: skip
def test_there_and_back(x, y, width, height, columns, rows, points):
    region = Region(x, y, width, height, columns / width, rows / height)
    assert region.canvas_size == (columns, rows)
    # 1e-9 of a full-image pixel, or of a canvas pixel where these are larger.
    bound = 1e-9 * max(1, region.scale_u, region.scale_v)
    np.testing.assert_allclose(region.from_full(region.to_full(points)), points, rtol=0, atol=bound)
    np.testing.assert_allclose(region.to_full(region.from_full(points)), points, rtol=0, atol=1e-9)


@given(st.floats(-0.5, 639.5), st.floats(-0.5, 479.5), st.integers(1, 480), st.integers(1, 480))
def test_around_stays_inside_and_is_centred_where_it_can(u, v, width, height):
    region = Region.around((u, v), (width, height), (640, 480))
    assert (region.width, region.height) == (width, height)
    assert region.x >= 0
    assert region.y >= 0
    assert region.x + width <= 640
    assert region.y + height <= 480
    for value, first, side, length in ((u, region.x, width, 640), (v, region.y, height, 480)):
        if 0 < first < length - side:
            assert abs(first + (side - 1) / 2 - value) <= 0.5 + 1e-9
        assert first - 0.5 <= value <= first + side - 0.5


def test_around_examples():
    assert Region.around((50, 30), 5, (80, 60)) == Region(48, 28, 5, 5)
    assert Region.around((50.4, 29.6), 5, (80, 60)) == Region(48, 28, 5, 5)
    assert Region.around((0, 59), (7, 3), (80, 60)) == Region(0, 57, 7, 3)
    assert Region.around((40, 30), (80, 60), (80, 60)) == Region(0, 0, 80, 60)


def test_whole_numbers_of_any_kind():
    region = Region(np.int64(3), np.int32(4), np.int16(5), 6)
    assert region == Region(3, 4, 5, 6)
    assert type(region.x) is int


@pytest.mark.parametrize(
    ("region", "found"),
    [
        (Region(-1, 0, 5, 5), "columns -1 to 3 and rows 0 to 4"),
        (Region(76, 0, 5, 5), "columns 76 to 80 and rows 0 to 4"),
        (Region(0, -2, 5, 5), "columns 0 to 4 and rows -2 to 2"),
        (Region(0, 56, 5, 5), "columns 0 to 4 and rows 56 to 60"),
    ],
)
def test_crop_does_not_leave_the_image(region, found):
    with pytest.raises(DatasetError, match=rf"inside the image of 80 x 60 px, got {found}; shift it"):
        region.crop(IMAGE)
    with pytest.raises(DatasetError, match=f"got {found}; shift it"):
        region.check_inside((80, 60))


def test_crop_takes_one_picture():
    with pytest.raises(
        DatasetError, match=r"image: expected shape \(height, width\) or \(height, width, 3\), got \(60, 80, 1\); pass"
    ):
        Region(0, 0, 5, 5).crop(IMAGE[..., None])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0, 0, 5), "expected a width and height of at least 1 px, got 0 x 5; enlarge it"),
        ((0, 0, 5, -1), "expected a width and height of at least 1 px, got 5 x -1; enlarge it"),
        ((0.5, 0, 5, 5), "region x: expected a whole number of pixels, got 0.5; round it"),
        ((0, 0, 5, 5, 0.0), "scale_u: expected a positive number, got 0.0"),
        ((0, 0, 5, 5, 1, float("nan")), "scale_v: expected a positive number, got nan"),
        ((0, 0, 5, 5, 0.5), r"scale_u: expected a canvas of whole pixels, got 5 x 0.5 = 2.5; use canvas size"),
        ((0, 0, 5, 5, 1, 1e-9), "scale_v: expected a canvas of whole pixels"),
    ],
)
def test_impossible_regions(arguments, message):
    with pytest.raises(DatasetError, match=message):
        Region(*arguments)


@pytest.mark.parametrize(
    ("point", "size", "message"),
    [
        ((80, 30), 5, r"point: expected a place inside the image of 80 x 60 px, got \[80.0, 30.0\]; check the point"),
        ((40, -0.6), 5, "point: expected a place inside the image"),
        ((np.nan, 30), 5, r"point: expected a place inside the image .* got \[nan, 30.0\]"),
        ((40, 30), 61, "region height: expected at most the image's 60 px, got 61 px; use a smaller region"),
        ((40, 30), (81, 5), "region width: expected at most the image's 80 px, got 81 px"),
        ((40, 30), 4.5, "region width: expected a whole number of pixels, got 4.5"),
        ((40, 30, 1), 5, r"point: expected shape \(2\), got \(3,\)"),
    ],
)
def test_impossible_places(point, size, message):
    with pytest.raises(DatasetError, match=message):
        Region.around(point, size, (80, 60))


def test_points_have_two_coordinates():
    with pytest.raises(DatasetError, match="points2d: expected shape"):
        Region(0, 0, 5, 5).to_full([1, 2, 3])
    with pytest.raises(DatasetError, match="points2d: expected shape"):
        Region(0, 0, 5, 5).from_full([[1], [2]])
