"""The luma plane of every kind of pixel format."""

from fractions import Fraction

import av
import numpy as np
import pytest
from video_clips import picture, scene

from vfm_sdm.inputs.video.luma import has_luma_plane, luma_bits, luma_plane

LUMA = scene(1)[0]
DEEP = scene(1, bits=10)[0]


def address(array):
    return array.__array_interface__["data"][0]


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuvj420p", "yuv422p", "yuv444p", "nv12", "gray"])
def test_planar_formats_are_not_copied(pixel_format):
    frame = picture(LUMA, pixel_format)
    luma = luma_plane(frame)
    assert frame.planes[0].line_size > frame.width
    assert address(luma) == frame.planes[0].buffer_ptr
    assert not luma.flags.writeable
    np.testing.assert_array_equal(luma, LUMA)
    assert luma_bits(pixel_format) == 8
    assert has_luma_plane(pixel_format)


@pytest.mark.parametrize("pixel_format", ["yuv420p10le", "yuv422p10le", "gray10le"])
def test_ten_bits_in_the_lower_bits_are_not_copied(pixel_format):
    frame = picture(DEEP, pixel_format)
    luma = luma_plane(frame)
    assert address(luma) == frame.planes[0].buffer_ptr
    assert luma.dtype == np.uint16
    np.testing.assert_array_equal(luma, DEEP)
    assert luma_bits(pixel_format) == 10


@pytest.mark.parametrize("pixel_format", ["p010le", "p210le", "p410le"])
def test_ten_bits_in_the_upper_bits_are_moved_down(pixel_format):
    luma = luma_plane(picture(DEEP << 6, pixel_format))
    assert luma.dtype == np.uint16
    np.testing.assert_array_equal(luma, DEEP)
    assert luma_bits(pixel_format) == 10


@pytest.mark.parametrize(("pixel_format", "bits"), [("yuv420p10be", 10), ("gray16be", 16), ("p010be", 10)])
def test_byte_order(pixel_format, bits):
    values = DEEP << 6 if pixel_format.startswith("p0") else DEEP
    luma = luma_plane(picture(values.byteswap(), pixel_format))
    assert luma.dtype.isnative
    np.testing.assert_array_equal(luma, DEEP)
    assert luma_bits(pixel_format) == bits


@pytest.mark.parametrize(("pixel_format", "first"), [("yuyv422", 0), ("uyvy422", 1), ("ya8", 0)])
def test_packed_luma_is_unpacked_unchanged(pixel_format, first):
    frame = av.VideoFrame(LUMA.shape[1], LUMA.shape[0], pixel_format)
    rows = np.frombuffer(frame.planes[0], np.uint8).reshape(LUMA.shape[0], -1)
    rows[:] = 128
    rows[:, first : 2 * LUMA.shape[1] : 2] = LUMA
    np.testing.assert_array_equal(luma_plane(frame), LUMA)
    assert not has_luma_plane(pixel_format)


def test_rgb_becomes_grey():
    colours = np.zeros((3, 3, 3), np.uint8)
    colours[0], colours[1], colours[2] = (200, 0, 0), (0, 200, 0), (0, 0, 200)
    luma = luma_plane(av.VideoFrame.from_ndarray(colours, format="rgb24"))
    # BT.601: 0.299, 0.587, 0.114.
    np.testing.assert_allclose(luma[:, 0], [59.8, 117.4, 22.8], atol=1.5)
    assert luma.shape == (3, 3)
    assert not luma.flags.writeable


def test_deep_rgb_keeps_its_depth():
    frame = av.VideoFrame(16, 8, "gbrp10le")
    for plane in frame.planes:
        np.frombuffer(plane, np.uint16)[:] = 700
    luma = luma_plane(frame)
    assert luma.dtype == np.uint16
    np.testing.assert_allclose(luma, 700, atol=3)
    assert luma_bits("gbrp10le") == 10


def test_palette_becomes_grey():
    frame = av.VideoFrame(4, 2, "pal8")
    indices = np.frombuffer(frame.planes[0], np.uint8).reshape(2, -1)
    indices[:] = 0
    indices[:, 2] = 7
    palette = np.frombuffer(frame.planes[1], np.uint8).reshape(256, 4)
    palette[:] = (10, 10, 10, 255)
    palette[7] = (250, 250, 250, 255)
    np.testing.assert_allclose(luma_plane(frame)[:, :4], [[10, 10, 250, 10]] * 2, atol=2)


def test_rows_stored_from_the_bottom():
    graph = av.filter.Graph()
    source = graph.add_buffer(width=LUMA.shape[1], height=LUMA.shape[0], format="gray", time_base=Fraction(1, 25))
    flip, sink = graph.add("vflip"), graph.add("buffersink")
    source.link_to(flip)
    flip.link_to(sink)
    graph.configure()
    frame = picture(LUMA, "gray")
    frame.pts, frame.time_base = 0, Fraction(1, 25)
    graph.push(frame)
    flipped = graph.pull()
    assert flipped.planes[0].line_size < 0
    np.testing.assert_array_equal(luma_plane(flipped), LUMA[::-1])


def test_luma_outlives_the_picture():
    luma = luma_plane(picture(LUMA, "yuv420p"))
    # Memory that is free again would be taken by these.
    others = [picture(np.zeros_like(LUMA), "yuv420p") for _ in range(20)]
    np.testing.assert_array_equal(luma, LUMA)
    assert len(others) == 20


def test_single_bits_become_black_and_white():
    frame = av.VideoFrame(16, 2, "monob")
    rows = np.frombuffer(frame.planes[0], np.uint8).reshape(2, -1)
    rows[0, :2], rows[1, :2] = (0b11110000, 0), (0, 255)
    luma = luma_plane(frame)
    assert luma.dtype == np.uint8
    np.testing.assert_array_equal(luma, [[255] * 4 + [0] * 12, [0] * 8 + [255] * 8])
    assert luma_bits("monob") == 8
