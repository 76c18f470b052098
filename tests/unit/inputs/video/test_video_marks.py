"""What containers say of their pixels and of the rate at which they were filmed."""

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import IFD, Base
from video_clips import picture, scene, write_clip

from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import FirstFrames, Session, lens_from_exif
from vfm_sdm.inputs.video import open_video
from vfm_sdm.inputs.video.marks import read_capture_clock
from vfm_sdm.stages.cameras.priors import read_priors


def write(path, *, sar=None, tags=None, rotation=None, count=10, rate=30):
    """A clip whose file says how wide its pixels are, or at which rate it was filmed."""
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(tags or {})
        stream = container.add_stream("libx264", rate=rate, options={"qp": "0", "preset": "ultrafast"})
        lumas = scene(count, size=(96, 72))
        stream.height, stream.width = lumas[0].shape
        stream.pix_fmt = "yuv420p"
        if sar:
            stream.codec_context.sample_aspect_ratio = sar
        if rotation is not None:
            stream.set_display_rotation(rotation)
        for luma in lumas:
            container.mux(stream.encode(picture(luma, "yuv420p")))
        container.mux(stream.encode(None))
    return path


def session_of(folder, **lens):
    views = [{"name": name, "video": "a.mp4", "lens": lens} for name in ("left", "right")]
    point = {"name": "p", "view": "left", "pixel": [10.0, 10.0]}
    site = {"baseline": {"value": 1.0, "std": 0.01}}
    return Session(name="bridge", folder=folder, view=views, point=[point], site=site)


@pytest.mark.parametrize(("rotation", "aspect"), [(None, 4 / 3), (90, 3 / 4)])
def test_cameras_of_pixels_that_are_not_square(tmp_path, rotation, aspect):
    video = open_video(write(tmp_path / "a.mp4", sar=Fraction(4, 3), rotation=rotation))
    assert video.info.pixel_aspect == pytest.approx(aspect)
    assert "anamorphic" in video.info.remarks[0]
    session = session_of(tmp_path, focal_mm=4.0, sensor_width_mm=8.0)
    camera = read_priors(session, FirstFrames({"left": video, "right": video}), estimator="two-view").cameras[0]
    # The sensor is 96 pixels long and the lens half as long: 48 of these, and 64 of the 3/4 as high ones.
    expected = (48, 64) if rotation is None else (64, 48)
    np.testing.assert_allclose((camera.K[0, 0], camera.K[1, 1]), expected)


def test_square_pixels_need_no_word(tmp_path):
    info = open_video(write(tmp_path / "a.mp4")).info
    assert (info.pixel_aspect, info.time_scale, info.remarks, info.doubts) == (1.0, 1.0, (), ())


def test_slow_motion_by_android_is_in_true_time(tmp_path):
    video = open_video(write(tmp_path / "a.mp4", tags={"com.android.capture.fps": "120.000000"}))
    assert (video.info.fps, video.info.time_scale) == (120, 0.25)
    assert video.info.duration_s == pytest.approx(10 / 120)
    np.testing.assert_allclose([frame.time_s for frame in video.frames()], np.arange(10) / 120, atol=1e-9)
    assert "filmed at 120 and stored at 30" in video.info.remarks[0]
    # What is stated goes before what the file says.
    stated = open_video(tmp_path / "a.mp4", capture_fps=30.0)
    np.testing.assert_allclose([frame.time_s for frame in stated.frames()], np.arange(10) / 30, atol=1e-9)


def test_a_stated_rate_counts_exactly(tmp_path):
    video = open_video(write(tmp_path / "a.mp4"), capture_fps=239.5)
    assert [frame.time_s for frame in video.frames()][-1] == pytest.approx(9 / 239.5)
    with pytest.raises(DatasetError, match="capture_fps: expected a positive number"):
        open_video(tmp_path / "a.mp4", capture_fps=0.0)


@pytest.mark.parametrize(("taken", "scale"), [("30.0", 1), ("24", 1), ("240", Fraction(1, 8)), ("3", 10), ("text", 1)])
def test_rates_of_capture(taken, scale):
    found = read_capture_clock(Fraction(30000, 1001), {"com.android.capture.fps": taken})
    assert found.scale == scale
    assert bool(found.remarks) == (taken not in ("30.0", "text"))


def test_exported_slow_motion_without_a_rate_is_a_doubt():
    tags = {"com.apple.quicktime.full-frame-rate-playback-intent": "0"}
    assert read_capture_clock(Fraction(30), tags, time_base=Fraction(1, 2400)).doubts
    assert not read_capture_clock(Fraction(240), tags, time_base=Fraction(1, 2400)).doubts
    assert not read_capture_clock(Fraction(30), tags, time_base=Fraction(1, 600)).doubts


def test_interlaced_video_is_a_doubt(tmp_path):
    path = write_clip(tmp_path / "a.mkv", scene(6), codec="mpeg4", options={"flags": "+ildct+ilme"})
    info = open_video(path).info
    assert "interlaced" in info.doubts[0]


@pytest.mark.parametrize("size", [(96, 64), (64, 96)])
@pytest.mark.parametrize("kind", ["film", "plane"])
def test_exif_of_upright_photographs(tmp_path, size, kind):
    exif = Image.Exif()
    tags = exif.get_ifd(IFD.Exif)
    if kind == "film":
        tags[Base.FocalLengthIn35mmFilm] = 43
        expected = 43 / np.hypot(36, 24) * np.hypot(96, 64)
    else:
        tags[Base.FocalLength], tags[Base.FocalPlaneXResolution], tags[Base.FocalPlaneResolutionUnit] = 5.0, 20.0, 4
        tags[Base.ExifImageWidth], tags[Base.ExifImageHeight] = 96, 64
        expected = 100.0
    Image.fromarray(np.zeros(size[::-1], np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    assert lens_from_exif(tmp_path / "a.jpg").focal_prior_px(96) == pytest.approx(expected)
