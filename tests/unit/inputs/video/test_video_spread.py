"""A look at frames spread over a recording."""

import numpy as np
import pytest
from video_clips import write_clip

from moving_frames import memory_video
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import open_video, reader


def still(count):
    return memory_video([np.full((32, 48), number, np.uint8) for number in range(count)])


def test_frames_are_spread_evenly_from_first_to_last():
    found = [frame.index for frame in still(101).spread(10)]
    assert found == list(range(0, 101, 10))


def test_the_frame_asked_for_comes_first_and_once():
    found = [frame.index for frame in still(41).spread(4, also=20)]
    assert found == [20, 0, 10, 30, 40]


def test_a_look_from_the_first_frame_on_is_one_pass(monkeypatch):
    video, passes = still(41), []
    stream = video._source.stream
    monkeypatch.setattr(video._source, "stream", lambda: passes.append(1) or stream())
    assert [frame.index for frame in video.spread(4)] == [0, 10, 20, 30, 40]
    assert len(passes) == 1


def test_a_short_view_gives_all_it_has():
    assert [frame.index for frame in still(3).spread(10)] == [0, 1, 2]


def test_the_report_of_the_last_pass_stays():
    video = still(5)
    list(video.frames())
    before = video.report
    list(video.spread(3))
    assert video.report == before


def test_a_frame_that_the_view_lacks_is_refused():
    with pytest.raises(VideoError, match="expected a frame 9"):
        list(still(3).spread(2, also=9))


def test_of_a_long_recording_only_some_frames_are_decoded(tmp_path, monkeypatch):
    path = tmp_path / "long.mp4"
    frames = [np.full((48, 64), 10 * number % 250, np.uint8) for number in range(80)]
    write_clip(path, frames, options={"qp": "0", "preset": "ultrafast", "bf": "0", "g": "10"})
    video = open_video(path)
    monkeypatch.setattr(reader, "_LOOK_PIXELS", 40 * 48 * 64)
    found = list(video.spread(8))
    indices = [frame.index for frame in found]
    assert len(indices) >= 6
    assert indices == sorted(set(indices))
    assert indices[-1] > 60
    passed = {frame.index: frame.luma.copy() for frame in video.frames()}
    for frame in found:
        np.testing.assert_array_equal(frame.luma, passed[frame.index])
        assert frame.time_s == pytest.approx(frame.index / video.info.fps, abs=1e-6)
