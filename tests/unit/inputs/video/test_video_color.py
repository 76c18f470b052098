"""Colours of a frame or a region of it, against FFmpeg's conversion of the whole picture."""

import gc

import av
import cv2
import numpy as np
import pytest
from PIL import Image
from video_clips import write_colors

from vfm_sdm.errors import DatasetError, VideoError
from vfm_sdm.inputs.video import Region, color, container, images, open_images, open_video
from vfm_sdm.inputs.video.color import convert_part

# Columns and rows that are no multiple of the tile's grid; both halves of the rows are whole chroma rows.
SIZE = (204, 140)
CORNERS = [(0, 0, 31, 23), (173, 0, 31, 23), (0, 117, 31, 23), (173, 117, 31, 23)]
ODD = [(37, 51, 1, 1), (61, 43, 58, 33), (16, 16, 32, 32), (7, 9, 9, 7), (0, 0, 204, 140), (203, 139, 1, 1)]
REGIONS = [Region(*numbers) for numbers in CORNERS + ODD]
LOSSLESS = {"qp": "0", "preset": "ultrafast"}
FORMATS = [
    ("libx264", "yuv420p", LOSSLESS),
    ("libx264", "yuv422p10le", LOSSLESS),
    ("libx264", "yuv444p", LOSSLESS),
    ("libx265", "yuv420p10le", {"x265-params": "lossless=1:log-level=none"}),
    ("prores_ks", "yuv422p10le", {}),
    ("mjpeg", "yuvj420p", {}),
    ("mjpeg", "yuvj422p", {}),
    ("ffv1", "yuv420p", {}),
    ("ffv1", "yuv410p", {}),
    ("ffv1", "yuv411p", {}),
    ("ffv1", "yuv444p10le", {}),
    ("ffv1", "gray", {}),
    ("ffv1", "bgr0", {}),
    ("rawvideo", "nv12", {}),
    ("rawvideo", "uyvy422", {}),
]


def whole(path, index=0):
    """FFmpeg's conversion of a picture of a sound file, not rotated."""
    with av.open(str(path)) as file:
        for number, picture in enumerate(file.decode(video=0)):
            if number == index:
                return picture.to_ndarray(format="rgb24")
    raise AssertionError(index)


def cut(image, region):
    return image[region.y : region.y + region.height, region.x : region.x + region.width]


def assert_close(found, expected):
    assert found.dtype == np.uint8
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).max() <= 2


def made_up(pixel_format="yuv420p", size=SIZE, seed=3):
    """A picture of strong colours, down to single pixels."""
    rgb = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    return av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format=pixel_format)


@pytest.mark.parametrize(("codec", "pixel_format", "options"), FORMATS, ids=lambda value: str(value)[:12])
def test_regions_equal_the_whole_picture(tmp_path, codec, pixel_format, options):
    path = write_colors(tmp_path / "clip.mkv", SIZE, codec=codec, pixel_format=pixel_format, options=options)
    video = open_video(path)
    assert video.info.pixel_format == pixel_format
    for frame in video.frames():
        expected = whole(path, frame.index)
        if pixel_format != "gray":
            assert np.ptp(expected, axis=2).mean() > 20
        assert_close(frame.color(), expected)
        for region in REGIONS:
            assert_close(frame.color(region), cut(expected, region))
    assert frame.index == 1


@pytest.mark.parametrize("size", [(197, 133), (198, 133), (197, 134), (198, 134)])
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p", "yuv440p", "yuv444p", "nv12", "yuv420p10le", "gray"])
def test_sizes_that_chroma_does_not_divide(pixel_format, size):
    picture = made_up(pixel_format, size)
    expected = picture.to_ndarray(format="rgb24")
    for region in (Region(0, 0, 20, 30), Region(83, 51, 33, 27), Region(size[0] - 21, size[1] - 35, 21, 35)):
        assert_close(convert_part(picture, region), cut(expected, region))


@pytest.mark.parametrize("rows", [140, 142])
def test_both_fields_of_interlaced_pictures(tmp_path, rows):
    options = {"flags": "+ildct+ilme", "qscale": "2"}
    path = write_colors(tmp_path / "clip.mkv", (204, rows), codec="mpeg4", options=options)
    with av.open(str(path)) as file:
        assert next(file.decode(video=0)).interlaced_frame
    frame = open_video(path).first_frame()
    for region in (Region(37, 51, 1, 1), Region(61, 43, 58, 33), Region(173, 0, 31, 23)):
        assert_close(frame.color(region), cut(whole(path), region))


@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p10le", "uyvy422"])
def test_regions_are_in_rotated_pixels(pixel_format, rotation_deg):
    picture = made_up(pixel_format)
    expected = np.rot90(picture.to_ndarray(format="rgb24"), -rotation_deg // 90)
    rows, columns = expected.shape[:2]
    for x, y, width, height in ((0, 0, 31, 23), (columns - 31, 0, 31, 23), (0, rows - 23, 31, 23), (67, 41, 58, 33)):
        region = Region(x, y, width, height)
        assert_close(convert_part(picture, region, rotation_deg), cut(expected, region))


@pytest.mark.skipif(not hasattr(av.VideoStream, "set_display_rotation"), reason="this PyAV cannot write a rotation")
@pytest.mark.parametrize("rotation_deg", [90, 180, 270])
def test_rotated_files(tmp_path, rotation_deg):
    # PyAV counts anticlockwise.
    path = write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS, rotation=-rotation_deg)
    expected = np.rot90(whole(path), -rotation_deg // 90)
    video = open_video(path)
    frame = video.first_frame()
    assert video.info.rotation_deg == rotation_deg
    region = Region(45, 67, 51, 30)
    assert_close(frame.color(region), cut(expected, region))
    assert_close(frame.color(), expected)
    assert_close(video.color_frame(), expected)


@pytest.mark.parametrize(("scale_u", "scale_v"), [(0.5, 0.5), (0.25, 0.5), (2, 2), (1, 3), (0.5, 2)])
def test_canvas_is_resized_as_for_luma(tmp_path, scale_u, scale_v):
    path = write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS)
    region = Region(61, 43, 60, 32, scale_u=scale_u, scale_v=scale_v)
    found = open_video(path).first_frame().color(region)
    channels = [region.crop(np.ascontiguousarray(whole(path)[..., channel])) for channel in range(3)]
    assert found.shape == (*region.canvas_size[::-1], 3)
    assert_close(found, np.stack(channels, axis=-1))


# Weights of red and blue in the luma: ITU-R BT.709-6, section 3, and BT.601-7, section 2.5.1.
WEIGHTS = {1: (0.2126, 0.0722), 5: (0.299, 0.114)}


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("colorspace", [1, 5])
@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv422p10le", "nv12"])
def test_colour_space_and_range_are_the_pictures_own(pixel_format, colorspace, full):
    depth = 4 if "10" in pixel_format else 1
    y, cb, cr = 120, 90, 160
    picture = av.VideoFrame(*SIZE, pixel_format)
    for plane, values in zip(
        picture.planes, [[y], [cb, cr]] if pixel_format == "nv12" else [[y], [cb], [cr]], strict=True
    ):
        data = np.frombuffer(plane, np.uint16 if depth > 1 else np.uint8)
        for place, value in enumerate(values):
            data[place :: len(values)] = value * depth
    picture.colorspace, picture.color_range = colorspace, 2 if full else 1

    red, blue = WEIGHTS[colorspace]
    luma = y / 255 if full else (y - 16) / 219
    cb, cr = ((value - 128) / (255 if full else 224) for value in (cb, cr))
    r, b = luma + 2 * (1 - red) * cr, luma + 2 * (1 - blue) * cb
    expected = 255 * np.array([r, (luma - red * r - blue * b) / (1 - red - blue), b])

    for region in (Region(33, 41, 20, 30), Region(0, 0, *SIZE)):
        found = convert_part(picture, region)
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=3)


def test_colour_space_without_a_conversion_is_named():
    picture = made_up()
    picture.colorspace = 8
    for region in (Region(33, 41, 20, 30), Region(0, 0, *SIZE)):
        with pytest.raises(
            VideoError, match=r"colour: expected a colour space that FFmpeg converts .* number 8 of .*709"
        ):
            convert_part(picture, region)


def test_no_more_than_the_surroundings_are_converted(monkeypatch):
    sizes = []
    original = color._cut

    def watched(picture, tile):
        result = original(picture, tile)
        sizes.append((result.width, result.height))
        assert (
            result.planes[0].buffer_ptr == picture.planes[0].buffer_ptr + tile.y * picture.planes[0].line_size + tile.x
        )
        return result

    monkeypatch.setattr(color, "_cut", watched)
    picture = made_up(size=(640, 480))
    convert_part(picture, Region(300, 201, 40, 30))
    convert_part(picture, Region(0, 0, 40, 30))
    convert_part(made_up("uyvy422", (640, 480)), Region(0, 0, 40, 30))
    assert sizes == [(64, 48), (48, 48), (640, 480)]


def test_nothing_is_converted_unless_asked(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        container, "convert_part", lambda *args, **kwargs: calls.append(args) or convert_part(*args, **kwargs)
    )
    video = open_video(write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS))
    frames = list(video.frames())
    video.first_frame()
    assert calls == []
    frames[1].color(Region(3, 4, 5, 6))
    assert [args[1] for args in calls] == [Region(3, 4, 5, 6)]


def test_frames_keep_their_colours_while_they_are_referenced(tmp_path):
    path = write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS, count=20)
    video = open_video(path)
    kept = [frame for frame in video.frames() if frame.index % 6 == 0]
    list(video.frames())
    path = path.rename(tmp_path / "elsewhere.mkv")
    del video
    gc.collect()
    for frame in kept:
        assert_close(frame.color(Region(50, 60, 70, 30)), cut(whole(path, frame.index), Region(50, 60, 70, 30)))


def test_colours_are_the_callers_own(tmp_path):
    frame = open_video(write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS)).first_frame()
    luma = frame.luma.copy()
    for region in (None, Region(50, 60, 70, 30)):
        first = frame.color(region)
        expected = first.copy()
        assert first.flags.c_contiguous
        first[:] = 0
        np.testing.assert_array_equal(frame.color(region), expected)
    np.testing.assert_array_equal(frame.luma, luma)


def test_regions_stay_inside_the_frame(tmp_path):
    frame = open_video(write_colors(tmp_path / "clip.mkv", SIZE, options=LOSSLESS)).first_frame()
    with pytest.raises(DatasetError, match="inside the image of 204 x 140 px, got columns 200 to 209 and rows 0 to 9"):
        frame.color(Region(200, 0, 10, 10))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("extension", "bits"), [("png", 8), ("png", 16), ("tif", 8), ("tif", 16)])
def test_images_without_loss(tmp_path, extension, bits, channels):
    shape = (43, 61) if channels == 1 else (43, 61, 3)
    image = np.random.default_rng(5).integers(0, 2**bits, shape).astype(np.uint8 if bits == 8 else np.uint16)
    assert cv2.imwrite(str(tmp_path / f"a.{extension}"), image)
    top = (image >> (bits - 8)).astype(np.uint8)
    expected = np.repeat(top[..., None], 3, axis=2) if channels == 1 else top[..., ::-1]
    video = open_images(tmp_path / f"a.{extension}", fps=1)
    frame = video.first_frame()
    for region in (Region(0, 0, 61, 43), Region(13, 7, 30, 21), Region(31, 22, 30, 21)):
        np.testing.assert_array_equal(frame.color(region), cut(expected, region))
    np.testing.assert_array_equal(video.color_frame(), expected)
    half = Region(13, 7, 30, 20, scale_u=0.5, scale_v=0.5)
    np.testing.assert_array_equal(frame.color(half), half.crop(np.ascontiguousarray(expected)))


def test_jpeg_is_decoded_in_colour_once_and_only_when_asked(tmp_path, monkeypatch):
    modes = []
    original = images._decode
    monkeypatch.setattr(images, "_decode", lambda path, data, flags: modes.append(flags) or original(path, data, flags))
    path = tmp_path / "a.jpg"
    assert cv2.imwrite(str(path), made_up(size=(64, 48)).to_ndarray(format="bgr24"))
    expected = cv2.imread(str(path))[..., ::-1]
    video = open_images(path, fps=1)
    frame = next(video.frames())
    assert cv2.IMREAD_COLOR not in modes
    path.unlink()
    for region in (Region(13, 7, 30, 21), Region(0, 0, 64, 48), Region(33, 18, 30, 21)):
        np.testing.assert_array_equal(frame.color(region), cut(expected, region))
    assert modes.count(cv2.IMREAD_COLOR) == 1


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_colours_follow_the_orientation_tag(tmp_path, extension, orientation, turns):
    rgb = np.repeat(np.repeat(np.random.default_rng(6).integers(0, 256, (3, 4, 3), np.uint8), 16, 0), 16, 1)
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"a.{extension}"
    options = {"tif": {"tiffinfo": {274: orientation}}, "png": {"exif": exif}, "jpg": {"exif": exif, "quality": 100}}
    Image.fromarray(rgb).save(path, **options[extension], **({"subsampling": 0} if extension == "jpg" else {}))
    expected = np.rot90(rgb, turns)
    frame = open_images(path, fps=1).first_frame()
    for region in (Region(5, 9, 20, 30), Region(0, 0, expected.shape[1], expected.shape[0])):
        np.testing.assert_allclose(frame.color(region), cut(expected, region), atol=4)
