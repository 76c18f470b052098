"""Video files: luma, time stamps, rotation, and what the report says about duplicated and dropped frames."""

import gc
import pickle
import shutil
import weakref
from fractions import Fraction

import av
import cv2
import numpy as np
import pytest
from video_clips import FRONT, RATE, REAL, TIME_BASE, damage, decoded, picture, scene, write_clip

from vfm_sdm.errors import DatasetError, VideoError
from vfm_sdm.inputs.video import DecodeReport, open_video

TICKS = round(1 / RATE / TIME_BASE)


@pytest.mark.parametrize("extension", ["mp4", "mov", "mkv"])
@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize(("codec", "name"), [("libx264", "h264"), ("libx265", "hevc")])
def test_luma_of_a_lossless_file_is_what_was_encoded(tmp_path, codec, name, bits, extension):
    lumas = scene(8, bits=bits)
    pixel_format = {8: "yuv420p", 10: "yuv420p10le"}[bits]
    video = open_video(write_clip(tmp_path / f"clip.{extension}", lumas, codec=codec, pixel_format=pixel_format))

    frames = list(video.frames())

    assert [frame.index for frame in frames] == list(range(8))
    for frame, luma in zip(frames, lumas, strict=True):
        assert frame.luma.dtype == luma.dtype
        np.testing.assert_array_equal(frame.luma, luma)
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(8) / RATE, rtol=0, atol=1e-12)
    info = video.info
    assert (info.width, info.height, info.rotation_deg) == (198, 134, 0)
    assert (info.codec, info.pixel_format, info.bit_depth) == (name, pixel_format, bits)
    assert info.fps == pytest.approx(RATE)
    assert info.duration_s == pytest.approx(8 / RATE, abs=1e-3)
    assert info.frame_count == (None if extension == "mkv" else 8)
    claim = "about 8" if extension == "mkv" else "8"
    assert video.report == DecodeReport(8, 0, 0, "ok", f"read 8 of {claim} claimed frames")


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_reordered_pictures_come_in_the_order_they_are_shown(tmp_path, codec):
    path = write_clip(tmp_path / "clip.mp4", scene(40), codec=codec, options=REAL[codec])
    video = open_video(path)

    frames = list(video.frames())

    assert len(frames) == 40
    assert video.report.status == "ok"
    for frame, luma in zip(frames, decoded(path), strict=True):
        np.testing.assert_array_equal(frame.luma, luma)


@pytest.mark.parametrize("extension", ["mp4", "mkv"])
def test_time_is_the_containers_own_and_starts_at_the_first_frame(tmp_path, extension):
    # Whole milliseconds, which both containers keep; a late start and intervals between 20 and 55 ms.
    milliseconds = np.cumsum([400, 40, 33, 47, 20, 55, 41, 38])
    stamps = [int(Fraction(int(m), 1000) / TIME_BASE) for m in milliseconds]
    video = open_video(write_clip(tmp_path / f"clip.{extension}", scene(8), stamps=stamps))

    time_s = [frame.time_s for frame in video.frames()]

    expected = (milliseconds - 400) / 1000
    np.testing.assert_allclose(time_s, expected, rtol=0, atol=1e-4 if extension == "mp4" else 1e-12)
    assert time_s[0] == 0


def test_every_pass_starts_afresh(tmp_path):
    video = open_video(write_clip(tmp_path / "clip.mp4", scene(5)))
    first, second = video.frames(), video.frames()
    next(first)
    assert [frame.index for frame in second] == [0, 1, 2, 3, 4]
    assert [frame.index for frame in first] == [1, 2, 3, 4]


def test_frames_stay_valid_while_they_are_referenced(tmp_path):
    lumas = scene(40)
    video = open_video(write_clip(tmp_path / "clip.mp4", lumas))
    kept = [frame.luma for frame in video.frames() if frame.index % 3 == 0]
    list(video.frames())
    del video
    gc.collect()
    for luma, truth in zip(kept, lumas[::3], strict=True):
        np.testing.assert_array_equal(luma, truth)
        assert not luma.flags.writeable


def test_a_pass_holds_a_bounded_number_of_frames(tmp_path):
    video = open_video(write_clip(tmp_path / "clip.mp4", scene(40)))
    seen = []
    most = 0
    for frame in video.frames():
        seen.append(weakref.ref(frame.luma))
        most = max(most, sum(reference() is not None for reference in seen))
    assert most <= 3


# ISO/IEC 14496-12, track header: x' = a x + c y + tx, y' = b x + d y + ty places a stored pixel on the screen.
MATRICES = {0: (1, 0, 0, 1), 90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}


def as_shown(luma, matrix):
    a, b, c, d = matrix
    rows, columns = np.indices(luma.shape)
    x, y = a * columns + c * rows, b * columns + d * rows
    shown = np.zeros((np.ptp(y) + 1, np.ptp(x) + 1), luma.dtype)
    shown[y - y.min(), x - x.min()] = luma
    return shown


def with_track_matrix(path, target, matrix):
    content = path.read_bytes()
    # Version, flags, times, track, duration, reserved, layer, group, volume: the matrix starts 48 bytes in.
    place = content.index(b"tkhd") + 4 + 40
    a, b, c, d = (round(value * 65536).to_bytes(4, "big", signed=True) for value in matrix)
    zero, one = bytes(4), (1 << 30).to_bytes(4, "big")
    return damage(path, target, place, a + b + zero + c + d + zero + zero + zero + one)


@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
def test_rotation_turns_the_picture_as_the_track_header_says(tmp_path, rotation_deg):
    lumas = scene(3)
    plain = write_clip(tmp_path / "plain.mp4", lumas)
    path = with_track_matrix(plain, tmp_path / "turned.mp4", MATRICES[rotation_deg])
    video = open_video(path)
    expected = [as_shown(luma, MATRICES[rotation_deg]) for luma in lumas]

    assert video.info.rotation_deg == rotation_deg
    assert (video.info.height, video.info.width) == expected[0].shape
    for frame, luma in zip(video.frames(), expected, strict=True):
        np.testing.assert_array_equal(frame.luma, luma)
    assert video.report.status == "ok"
    colour = video.color_frame(2)
    assert colour.shape == (*expected[2].shape, 3)
    assert colour.dtype == np.uint8
    assert np.corrcoef(colour[..., 1].ravel(), expected[2].ravel())[0, 1] > 0.999


def test_rotation_agrees_with_opencv(tmp_path):
    plain = write_clip(tmp_path / "plain.mp4", scene(2))
    path = with_track_matrix(plain, tmp_path / "turned.mp4", MATRICES[90])
    capture = cv2.VideoCapture(str(path))
    found, image = capture.read()
    capture.release()
    assert found
    np.testing.assert_allclose(open_video(path).color_frame(0), image[..., ::-1], atol=3)


@pytest.mark.skipif(not hasattr(av.VideoStream, "set_display_rotation"), reason="this PyAV cannot write a rotation")
def test_rotation_in_matroska(tmp_path):
    lumas = scene(2)
    # PyAV counts anticlockwise.
    video = open_video(write_clip(tmp_path / "clip.mkv", lumas, rotation=-90))
    assert video.info.rotation_deg == 90
    np.testing.assert_array_equal(video.first_frame().luma, np.rot90(lumas[0], -1))


@pytest.mark.parametrize("matrix", [(-1, 0, 0, 1), (0.8, 0.6, -0.6, 0.8), (0.94, 0.34, -0.34, 0.94)])
def test_mirrored_and_oblique_pictures_are_refused(tmp_path, matrix):
    path = with_track_matrix(write_clip(tmp_path / "plain.mp4", scene(2)), tmp_path / "odd.mp4", matrix)
    with pytest.raises(VideoError, match="expected a rotation by 0, 90, 180 or 270 degrees, got the display matrix"):
        open_video(path)


def test_duplicated_frames_are_counted_and_kept(tmp_path):
    lumas = scene(12)
    # One repeat, a run of three, and a picture that differs from the one before in a single pixel.
    nearly = lumas[9].copy()
    nearly[77, 101] += 1
    order = [lumas[k] for k in (0, 1, 1, 2, 3, 4, 4, 4, 4, 5, 9)] + [nearly]
    video = open_video(write_clip(tmp_path / "clip.mp4", order))
    assert len(list(video.frames())) == 12
    assert (video.report.duplicated, video.report.dropped, video.report.status) == (4, 0, "ok")
    turned = open_video(with_track_matrix(tmp_path / "clip.mp4", tmp_path / "turned.mp4", MATRICES[90]))
    assert len(list(turned.frames())) == 12
    assert turned.report.duplicated == 4


@pytest.mark.parametrize("extension", ["mp4", "mkv"])
@pytest.mark.parametrize(("missing", "dropped"), [((7,), 1), ((1,), 1), ((4, 5, 6, 20), 4), ((), 0)])
def test_dropped_frames_are_counted(tmp_path, extension, missing, dropped):
    numbers = [i for i in range(30) if i not in missing]
    stamps = [i * TICKS for i in numbers]
    video = open_video(write_clip(tmp_path / f"clip.{extension}", scene(len(numbers)), stamps=stamps))
    time_s = [frame.time_s for frame in video.frames()]
    np.testing.assert_allclose(time_s, np.array(numbers) / RATE, atol=1e-12)
    assert (video.report.dropped, video.report.duplicated, video.report.status) == (dropped, 0, "ok")


def test_interlaced_files_are_read_whole(tmp_path):
    path = write_clip(tmp_path / "clip.mkv", scene(10), codec="mpeg4", options={"flags": "+ildct+ilme"})
    video = open_video(path)
    assert len(list(video.frames())) == 10
    assert video.report.status == "ok"


def test_cover_picture_is_not_taken_for_the_video(tmp_path):
    path = tmp_path / "song.mp4"
    with av.open(str(path), "w") as container:
        sound = container.add_stream("aac", rate=8000)
        cover = container.add_stream("png", rate=1)
        cover.width, cover.height, cover.pix_fmt = 32, 32, "gray"
        cover.disposition = av.stream.Disposition.attached_pic
        frame = picture(np.zeros((32, 32), np.uint8), "gray")
        container.mux(cover.encode(frame) + cover.encode(None))
        noise = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        noise.sample_rate = 8000
        container.mux(sound.encode(noise) + sound.encode(None))
    with pytest.raises(VideoError, match=r"song\.mp4: expected a video stream, got only audio, video"):
        open_video(path)


def test_colour_frame(tmp_path):
    lumas = scene(6)
    video = open_video(write_clip(tmp_path / "clip.mp4", lumas))
    colour = video.color_frame(5)
    # Limited range: 16 is black and 235 white.
    grey = np.clip((lumas[5].astype(float) - 16) * 255 / 219, 0, 255)
    assert np.abs(colour.astype(float) - grey[..., None]).max() < 3
    assert video.report.status == "not read"
    with pytest.raises(VideoError, match="expected a frame 6, got 6 frames; ask for an earlier one"):
        video.color_frame(6)
    with pytest.raises(DatasetError, match="index: expected 0 or more, got -1"):
        video.color_frame(-1)


def test_real_recordings(shared_data):
    for path in sorted(shared_data("tuning_fork_videos").glob("*.mp4")):
        video = open_video(path)
        time_s = [frame.time_s for frame in video.frames()]
        assert len(time_s) == video.info.frame_count
        assert (video.info.width, video.info.height) == (640, 420)
        np.testing.assert_allclose(time_s, np.arange(len(time_s)) / 50, atol=1e-12)
        assert (video.report.status, video.report.dropped) == ("ok", 0)


def test_front_index_makes_no_difference(tmp_path):
    lumas = scene(4)
    video = open_video(write_clip(tmp_path / "clip.mp4", lumas, container_options=FRONT))
    np.testing.assert_array_equal(np.stack([frame.luma for frame in video.frames()]), lumas)


@pytest.mark.parametrize("rotation", [None, 90])
def test_what_opens_a_file_is_its_first_frame(tmp_path, monkeypatch, rotation):
    path = write_clip(tmp_path / "clip.mp4", scene(8), options=REAL["libx264"], rotation=rotation)
    true = open_video(path).frame(0)
    path = shutil.copy(path, tmp_path / "another.mp4")  # which nobody has opened yet
    video, sent = open_video(path), pickle.loads(pickle.dumps(open_video(path)))
    monkeypatch.setattr("vfm_sdm.inputs.video.container.read_pictures", None)
    found = video.first_frame()
    assert (found.index, found.time_s) == (0, 0.0)
    np.testing.assert_array_equal(found.luma, true.luma)
    np.testing.assert_array_equal(found.color(), true.color())
    monkeypatch.undo()
    for one in (video, sent):  # decoded anew
        np.testing.assert_array_equal(one.first_frame().luma, true.luma)


def test_chapters_and_intervals_keep_no_pictures(tmp_path):
    paths = [write_clip(tmp_path / f"{name}.mp4", scene(8, seed=name)) for name in (1, 2)]
    for video in (open_video(*paths), open_video(paths[0], use_s=(0.1, None))):
        first = video.first_frame()
        np.testing.assert_array_equal(first.luma, next(iter(video.frames())).luma)
    assert open_video(paths[0], use_s=(0.08, None)).first_frame().time_s == 0.0
