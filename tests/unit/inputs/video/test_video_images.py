"""Image sequences: order, luma, sizes, damaged files."""

import cv2
import numpy as np
import pytest
from PIL import Image
from video_clips import scene

from vfm_sdm.errors import DatasetError, VideoError
from vfm_sdm.inputs.video import DecodeReport, open_images


def write(path, image):
    assert cv2.imwrite(str(path), image)


@pytest.mark.parametrize(("extension", "bits"), [("png", 8), ("png", 16), ("tif", 8), ("tif", 16)])
def test_luma_of_lossless_images(tmp_path, extension, bits):
    lumas = scene(3, size=(61, 43), bits=bits)
    for number, luma in enumerate(lumas):
        write(tmp_path / f"{number}.{extension}", luma)
    video = open_images(str(tmp_path / f"*.{extension}"), fps=20)

    frames = list(video.frames())

    np.testing.assert_array_equal(np.stack([frame.luma for frame in frames]), lumas)
    assert [frame.time_s for frame in frames] == [0, 1 / 20, 2 / 20]
    info = video.info
    assert (info.width, info.height, info.fps, info.frame_count, info.bit_depth) == (61, 43, 20, 3, bits)
    assert (info.codec, info.pixel_format) == (extension, "gray" if bits == 8 else "gray16le")
    assert info.duration_s == pytest.approx(0.15)
    assert video.report == DecodeReport(3, 0, 0, "ok", "read 3 of 3 claimed frames")
    assert not frames[0].luma.flags.writeable


def test_jpeg_luma_is_the_stored_one(tmp_path):
    rng = np.random.default_rng(1)
    # Strong colours: the way over RGB would clip them and change the luma.
    image = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    write(tmp_path / "a.jpg", image)
    with Image.open(tmp_path / "a.jpg") as file:
        file.draft("YCbCr", None)
        stored = np.asarray(file.convert("YCbCr"))[..., 0]
    video = open_images(str(tmp_path / "*.jpg"), fps=1)
    np.testing.assert_array_equal(video.first_frame().luma, stored)
    assert (video.info.codec, video.info.bit_depth) == ("jpg", 8)


@pytest.mark.parametrize("bits", [8, 16])
def test_colour_images_are_weighted(tmp_path, bits):
    top = 2**bits - 1
    image = np.zeros((3, 4, 3), np.uint8 if bits == 8 else np.uint16)
    image[0, :, 2], image[1, :, 1], image[2, :, 0] = top, top, top
    write(tmp_path / "a.png", image)
    video = open_images(str(tmp_path / "a.png"), fps=1)
    np.testing.assert_allclose(video.first_frame().luma[:, 0], np.array([0.299, 0.587, 0.114]) * top, rtol=5e-3, atol=1)
    assert video.info.pixel_format == ("bgr24" if bits == 8 else "bgr48le")
    colour = video.color_frame()
    assert colour.dtype == np.uint8
    np.testing.assert_array_equal(colour[:, 0], [[255, 0, 0], [0, 255, 0], [0, 0, 255]])


def test_natural_order(tmp_path):
    names = ["img1", "img2", "img10", "img011", "img100"]
    for grey, name in enumerate(names):
        write(tmp_path / f"{name}.png", np.full((4, 5), 10 * grey, np.uint8))
    video = open_images(str(tmp_path / "img*.png"), fps=1)
    assert [int(frame.luma[0, 0]) for frame in video.frames()] == [0, 10, 20, 30, 40]


def test_pattern_over_folders_and_brackets_in_names(tmp_path, monkeypatch):
    folder = tmp_path / "test [2]"
    for part in ("part2", "part10"):
        (folder / part).mkdir(parents=True)
        write(folder / part / "a1.png", np.full((4, 5), int(part[4:]), np.uint8))
    expected = [2, 10]
    video = open_images(folder / "part*" / "a?.png", fps=1)
    assert [int(frame.luma[0, 0]) for frame in video.frames()] == expected
    monkeypatch.chdir(folder)
    video = open_images("part*/a[0-9].png", fps=1)
    assert [int(frame.luma[0, 0]) for frame in video.frames()] == expected


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_orientation_tag_is_applied(tmp_path, extension, orientation, turns):
    luma = np.repeat(np.repeat(np.arange(0, 240, 20, dtype=np.uint8).reshape(3, 4), 16, 0), 16, 1)
    exif = Image.Exif()
    exif[274] = orientation
    options = {"tiffinfo": {274: orientation}} if extension == "tif" else {"exif": exif}
    Image.fromarray(luma).save(tmp_path / f"a.{extension}", **options)
    video = open_images(str(tmp_path / f"a.{extension}"), fps=1)
    expected = np.rot90(luma, turns)
    assert (video.info.height, video.info.width) == expected.shape
    np.testing.assert_allclose(video.first_frame().luma, expected, atol=2)
    assert video.color_frame().shape[:2] == expected.shape


def test_duplicated_images_are_counted(tmp_path):
    for number, grey in enumerate([1, 1, 2, 2, 2, 1]):
        write(tmp_path / f"{number}.png", np.full((40, 50), grey, np.uint8))
    video = open_images(str(tmp_path / "*.png"), fps=1)
    assert len(list(video.frames())) == 6
    assert (video.report.duplicated, video.report.dropped) == (3, 0)


def test_images_of_another_size_or_depth_are_named(tmp_path):
    write(tmp_path / "a1.png", np.zeros((40, 50), np.uint8))
    write(tmp_path / "a2.png", np.zeros((40, 51), np.uint8))
    video = open_images(str(tmp_path / "*.png"), fps=1)
    message = r"a2\.png: expected 50 x 40 px of 8 bits like a1\.png, got 51 x 40 px of 8 bits; leave only images"
    with pytest.raises(VideoError, match=message):
        list(video.frames())
    assert (video.report.frames, video.report.status) == (1, "corrupt")
    write(tmp_path / "a2.png", np.zeros((40, 50), np.uint16))
    with pytest.raises(VideoError, match=r"a2\.png: expected .* got 50 x 40 px of 16 bits"):
        list(video.frames())


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_damaged_image_ends_the_sequence(tmp_path, extension, share):
    image = scene(1, size=(300, 200))[0]
    for number in range(3):
        write(tmp_path / f"{number}.{extension}", image + number)
    bad = tmp_path / f"2.{extension}"
    content = bad.read_bytes()
    bad.write_bytes(content[: int(len(content) * share)])
    video = open_images(str(tmp_path / f"*.{extension}"), fps=1)
    assert len(list(video.frames())) == 2
    assert video.report.status == "corrupt"
    expected = f"2.{extension}: expected an image, got data that do not decode; copy the file again"
    assert expected in video.report.message
    with pytest.raises(VideoError, match=rf"2\.{extension}: expected an image, got data that do not decode"):
        open_images(str(bad), fps=1)
    with pytest.raises(VideoError, match=rf"2\.{extension}: expected an image, got data that do not decode"):
        video.color_frame(2)


def test_image_that_goes_away(tmp_path):
    for number in range(2):
        write(tmp_path / f"{number}.png", np.zeros((4, 5), np.uint8))
    video = open_images(str(tmp_path / "*.png"), fps=1)
    (tmp_path / "1.png").unlink()
    assert len(list(video.frames())) == 1
    assert video.report.status == "corrupt"
    assert "1.png: expected an image, got No such file or directory; check the file" in video.report.message


def test_values_that_are_not_whole_are_refused(tmp_path):
    write(tmp_path / "a.tif", np.zeros((4, 5), np.float32))
    with pytest.raises(VideoError, match=r"a\.tif: expected an image of 8 or 16 bits, got float32 of shape"):
        open_images(str(tmp_path / "a.tif"), fps=1)


def test_stacks_are_refused(tmp_path):
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), [np.zeros((4, 5), np.uint8)] * 3)
    with pytest.raises(VideoError, match=r"a\.tif: expected one image a file, got 3 pages; write every page"):
        open_images(str(tmp_path / "a.tif"), fps=1)


def test_no_match_and_bad_rate(tmp_path):
    with pytest.raises(VideoError, match=r"\*\.jpg: expected image files, got no match; check the folder"):
        open_images(str(tmp_path / "*.jpg"), fps=1)
    for fps in (0, -25.0, float("nan"), float("inf")):
        with pytest.raises(DatasetError, match="fps: expected a positive number of images a second, got"):
            open_images(str(tmp_path / "*.jpg"), fps=fps)


def test_colour_behind_the_end(tmp_path):
    write(tmp_path / "a.png", np.zeros((4, 5), np.uint8))
    with pytest.raises(VideoError, match="expected a frame 1, got 1 frames; ask for an earlier one"):
        open_images(str(tmp_path / "*.png"), fps=1).color_frame(1)


def test_real_images(shared_data):
    folder = shared_data("multidic_cylinder") / "speckled"
    video = open_images(folder / "201_*.jpg", fps=1)
    frame = next(video.frames())
    assert (video.info.width, video.info.height, video.info.frame_count) == (2464, 3280, 5)
    np.testing.assert_array_equal(frame.luma, cv2.imread(str(folder / "201_1.jpg"), cv2.IMREAD_GRAYSCALE))
