from fractions import Fraction

import av
import numpy as np
import pytest

from vfm_sdm.errors import VideoError
from vfm_sdm.studies.synthetic.recording import write_video

LOSSLESS = {"qp": "0", "preset": "ultrafast"}


def frames(count=7, *, size=(32, 48), seed=0):
    return list(np.random.default_rng(seed).integers(16, 236, (count, *size)).astype(np.uint8))


def read(path):
    """Time stamps [s] as fractions, and luma with chroma as rows below it."""
    with av.open(str(path)) as container:
        decoded = [(frame.pts * frame.time_base, frame.to_ndarray()) for frame in container.decode(video=0)]
    return [time for time, _ in decoded], [image for _, image in decoded]


@pytest.mark.parametrize("fps", [30, 60, Fraction(30000, 1001)])
@pytest.mark.parametrize("preset", ["ultrafast", "medium"])  # without and with reordered frames
def test_time_stamps_are_exact(tmp_path, fps, preset):
    write_video(tmp_path / "a.mp4", frames(), fps=fps, options={"preset": preset})
    times, _ = read(tmp_path / "a.mp4")
    assert times == [k / Fraction(fps) for k in range(7)]


def test_luma_and_chroma_come_back(tmp_path):
    chroma = np.stack([np.full((16, 24), 110), np.full((16, 24), 140)]).astype(np.uint8)
    sent = frames()
    assert write_video(tmp_path / "a.mp4", iter(sent), fps=30, chroma=chroma, options=LOSSLESS) == tmp_path / "a.mp4"
    _, images = read(tmp_path / "a.mp4")
    np.testing.assert_array_equal([image[:32] for image in images], sent)
    np.testing.assert_array_equal(images[3][32:].reshape(2, 16, 24), chroma)


def test_video_without_chroma_is_grey(tmp_path):
    write_video(tmp_path / "a.mkv", frames(2), fps=30, options=LOSSLESS)
    assert np.all(read(tmp_path / "a.mkv")[1][0][32:] == 128)


def test_same_frames_give_the_same_bytes(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, frames(20), fps=30, options={"preset": "veryfast", "threads": "2"})
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


@pytest.mark.parametrize(
    ("images", "chroma", "message"),
    [
        ([], None, "expected at least one frame, got none"),
        ([*frames(1), *frames(1, size=(48, 32))], None, "frame 1: expected 48 x 32 px as the first, got 32 x 48"),
        (frames(1, size=(31, 48)), None, "frame: expected an even size"),
        (frames(1), np.zeros((2, 32, 48), np.uint8), r"expected an even size and chroma \(2, 16, 24\)"),
    ],
)
def test_refused_frames_leave_no_file(tmp_path, images, chroma, message):
    with pytest.raises(VideoError, match=message):
        write_video(tmp_path / "a.mp4", images, fps=30, chroma=chroma, options={})
    assert list(tmp_path.iterdir()) == []


def test_refused_options_are_named(tmp_path):
    with pytest.raises(VideoError, match=r"expected to write H\.264 with \{'preset': 'no such'\}"):
        write_video(tmp_path / "a.mp4", frames(), fps=30, options={"preset": "no such"})
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_recording_leaves_the_earlier_one(tmp_path):
    write_video(tmp_path / "a.mp4", frames(), fps=30, options={})
    before = (tmp_path / "a.mp4").read_bytes()

    def broken():
        yield frames(1)[0]
        raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        write_video(tmp_path / "a.mp4", broken(), fps=30, options={})
    assert (tmp_path / "a.mp4").read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_stated_stamps_are_kept_to_a_512th_of_an_interval(tmp_path):
    stamps = [0.0, 0.9, 2.05, 3.0, 5.5]
    write_video(tmp_path / "a.mp4", frames(5), fps=30, options={"preset": "medium"}, stamps=stamps)
    times, _ = read(tmp_path / "a.mp4")
    np.testing.assert_allclose([float(30 * time) for time in times], stamps, atol=1 / 1024 + 1e-9)


def test_another_codec_is_written_at_its_stated_rate(tmp_path):
    still = frames(1, size=(96, 128))[0]
    moving = [np.roll(still, number, axis=1) for number in range(90)]
    sizes = []
    for rate in (100_000, 600_000):
        options = {"codec": "libx265", "preset": "ultrafast", "x265-params": "log-level=none", "b": str(rate)}
        write_video(tmp_path / "a.mp4", moving, fps=30, options=options)
        with av.open(str(tmp_path / "a.mp4")) as container:
            assert container.streams.video[0].codec_context.name == "hevc"
        sizes.append((tmp_path / "a.mp4").stat().st_size)
    assert 2 < sizes[1] / sizes[0] < 6
