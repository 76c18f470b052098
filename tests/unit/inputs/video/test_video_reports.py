"""What a pass reports, with sources that are made up; and the rule for dropped frames."""

from functools import partial

import numpy as np
import pytest

from vfm_sdm.errors import DatasetError, VideoError
from vfm_sdm.inputs.video import DecodeReport, DecodeStop, Frame, Region, Video, VideoInfo
from vfm_sdm.inputs.video.clock import count_dropped
from vfm_sdm.inputs.video.integrity import missing_bytes


class MadeUp:
    """Numbered pictures at given times; the pass ends with an error of choice."""

    def __init__(self, time_s, error=None, **claims):
        self._time_s = time_s
        self._error = error
        self.closed = 0
        self.pulled = 0
        self.converted = []
        facts = {"fps": 10.0, "frame_count": None, "duration_s": None, **claims}
        self.info = VideoInfo("made up", 6, 4, codec="none", pixel_format="gray", bit_depth=8, rotation_deg=0, **facts)

    def stream(self):
        try:
            for number, time_s in enumerate(self._time_s):
                self.pulled += 1
                yield Frame(number, time_s, np.full((4, 6), number % 256, np.uint8), partial(self.convert, number))
            if self._error is not None:
                raise self._error
        finally:
            self.closed += 1

    def convert(self, number, region):
        self.converted.append((number, region))
        return np.full((region.height, region.width, 3), number, np.uint8)


TENTHS = np.arange(20) / 10


def test_before_any_pass():
    video = Video(MadeUp(TENTHS))
    assert video.report == DecodeReport(0, 0, 0, "not read", "no pass over the frames has ended yet")
    assert video.first_frame().time_s == 0
    assert video.color_frame(3)[0, 0, 0] == 3
    assert video.report.status == "not read"


def test_colours_are_converted_only_where_asked():
    source = MadeUp(TENTHS)
    frames = list(Video(source).frames(stop=5))
    assert source.converted == []
    half = frames[3].color(Region(2, 0, 4, 2, scale_u=0.5, scale_v=0.5))
    assert half.shape == (1, 2, 3)
    assert half.max() == 3
    assert frames[4].color().shape == (4, 6, 3)
    assert source.converted == [(3, Region(2, 0, 4, 2)), (4, Region(0, 0, 6, 4))]
    with pytest.raises(DatasetError, match="inside the image of 6 x 4 px, got columns 3 to 6"):
        frames[4].color(Region(3, 0, 4, 2))
    assert len(source.converted) == 2


def test_stop_reads_no_further():
    source = MadeUp(TENTHS, frame_count=20)
    video = Video(source)
    assert [frame.index for frame in video.frames(stop=4)] == [0, 1, 2, 3]
    assert (source.pulled, source.closed) == (4, 1)
    assert video.report == DecodeReport(4, 0, 0, "ok", "read 4 of 20 claimed frames; stopped as asked")
    assert len(list(video.frames(stop=100))) == 20
    assert video.report.message == "read 20 of 20 claimed frames"


@pytest.mark.parametrize("stop", [0, -1])
def test_stop_is_at_least_one(stop):
    with pytest.raises(DatasetError, match=f"stop: expected at least one frame, got {stop}; leave it out"):
        Video(MadeUp(TENTHS)).frames(stop=stop)


def test_a_pass_that_is_left():
    source = MadeUp(TENTHS)
    video = Video(source)
    frames = video.frames()
    next(frames)
    next(frames)
    frames.close()
    assert source.closed == 1
    assert video.report == DecodeReport(2, 0, 0, "ok", "read 2 frames; left before its end")


@pytest.mark.parametrize("status", ["truncated", "corrupt"])
def test_damage_ends_the_pass_and_is_reported(status):
    video = Video(MadeUp(TENTHS, DecodeStop(status, "nothing more"), duration_s=3.0))
    assert len(list(video.frames())) == 20
    assert video.report == DecodeReport(20, 0, 0, status, "read 20 of about 30 claimed frames; nothing more")


def test_a_file_that_the_user_has_to_mend():
    video = Video(MadeUp(TENTHS, VideoError("img7: expected 5, got 6; mend it")))
    with pytest.raises(VideoError, match="mend it"):
        list(video.frames())
    assert (video.report.frames, video.report.status) == (20, "corrupt")


def test_no_first_frame():
    with pytest.raises(VideoError, match=r"made up: expected a frame 0, got 0 frames \(gone\); check the file"):
        Video(MadeUp([], DecodeStop("corrupt", "gone"))).first_frame()


def test_irregular_clocks_are_named():
    rng = np.random.default_rng(4)
    video = Video(MadeUp(np.cumsum(rng.uniform(0.01, 0.2, 100))))
    list(video.frames())
    assert video.report.dropped == 0
    assert video.report.message == "read 100 frames; irregular time stamps: dropped frames cannot be told"


def clock(intervals):
    return np.concatenate([[0.0], np.cumsum(intervals)])


@pytest.mark.parametrize("count", [20, 600])
@pytest.mark.parametrize("lost", [{0: 1}, {7: 1, 12: 5}, {18: 2}, {3: 1, 4: 1, 5: 1}])
def test_gaps_are_counted_exactly(count, lost):
    intervals = np.full(count, 1 / 60)
    for place, missing in lost.items():
        intervals[place] *= missing + 1
    assert count_dropped(clock(intervals)) == (sum(lost.values()), True)


def test_rounded_stamps_lose_nothing():
    # Matroska keeps whole milliseconds: 16 and 17 ms at 60 frames a second.
    time_s = np.round(np.arange(500) / 60, 3)
    assert count_dropped(time_s) == (0, True)
    assert count_dropped(np.delete(time_s, [100, 101, 300])) == (3, True)


def test_a_camera_that_slows_down_loses_nothing():
    # Variable frame rate: 60 frames a second, in bad light 30, then 24.
    intervals = np.concatenate([np.full(400, 1 / 60), np.full(200, 1 / 30), np.full(200, 1 / 24)])
    assert count_dropped(clock(intervals)) == (0, True)
    intervals[[100, 500, 700]] *= 2
    assert count_dropped(clock(intervals)) == (3, True)


def test_jitter_loses_nothing():
    rng = np.random.default_rng(2)
    assert count_dropped(clock(rng.uniform(0.8, 1.2, 500) / 30)) == (0, True)


@pytest.mark.parametrize("time_s", [[], [0.0], [0.0, 5.0]])
def test_too_short_to_tell(time_s):
    assert count_dropped(np.array(time_s)) == (0, True)


def test_clock_is_one_row():
    with pytest.raises(DatasetError, match="time_s: expected shape"):
        count_dropped(np.zeros((3, 2)))


def box(name, payload, length=None):
    return (8 + len(payload) if length is None else length).to_bytes(4, "big") + name + payload


EBML = b"\x1a\x45\xdf\xa3\x83abc"
SEGMENT = b"\x18\x53\x80\x67"


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        (box(b"ftyp", b"isom") + box(b"mdat", bytes(100)), 0),
        (box(b"ftyp", b"isom") + box(b"mdat", bytes(100), 308), 200),
        (box(b"ftyp", b"isom") + box(b"mdat", (316).to_bytes(8, "big") + bytes(100), 1), 200),
        (box(b"ftyp", b"isom") + box(b"mdat", bytes(100), 0), 0),
        (box(b"ftyp", b"isom") + box(b"mdat", bytes(100)) + bytes(3), 0),
        (box(b"ftyp", b"isom") + box(b"mdat", bytes(100)) + b"appended by a viewer", 0),
        (EBML + SEGMENT + b"\x8a" + bytes(10), 0),
        (EBML + SEGMENT + b"\x8a" + bytes(4), 6),
        (EBML + SEGMENT + b"\x01" + (2000).to_bytes(7, "big") + bytes(500), 1500),
        (EBML + SEGMENT + b"\x01" + b"\xff" * 7 + bytes(500), 0),
        (EBML + SEGMENT, 0),
        (EBML + b"\xec\x82ab" + SEGMENT, 0),
        (b"RIFF" + bytes(20), 0),
        (b"", 0),
    ],
)
def test_missing_bytes(tmp_path, content, missing):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert missing_bytes(path) == missing
