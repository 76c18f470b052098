"""Frames of points that come into view later: which they are in every view, and what is refused."""

import numpy as np
import pytest

from moving_frames import memory_video
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import FirstFrames, Point, Session, find_reference_frames, picture_of, session_hash

FPS = 10.0


def session_of(point, **right):
    views = [{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4", **right}]
    site = {"baseline": {"value": 4.0, "std": 0.01}}
    points = [{"name": "first", "view": "left", "pixel": [1.0, 2.0]}]
    points.append({"name": "late", "view": "left", "pixel": [3.0, 2.0], **point})
    return Session(name="s", view=views, site=site, point=points)


def videos(frames=30, right=30):
    counts = {"left": frames, "right": right}
    return {
        view: memory_video([np.full((8, 8), n, np.uint8) for n in range(count)], fps=FPS)
        for view, count in counts.items()
    }


@pytest.mark.parametrize(
    ("point", "right", "expected"),
    [
        ({}, {}, {}),
        ({"frame": 0}, {}, {}),
        ({"time_s": 0.0}, {}, {}),
        ({"frame": 12}, {}, {"left": {"late": 12}, "right": {"late": 12}}),
        ({"time_s": 1.24}, {}, {"left": {"late": 12}, "right": {"late": 12}}),
        ({"frame": 12}, {"time_offset_s": 0.43}, {"left": {"late": 12}, "right": {"late": 8}}),
        ({"frame": 12}, {"time_offset_s": -0.5}, {"left": {"late": 12}, "right": {"late": 17}}),
        ({"frame": 12}, {"use_s": [0.4]}, {"left": {"late": 12}, "right": {"late": 8}}),
        ({"frame": 12}, {"time_offset_s": 1.2}, {"left": {"late": 12}, "right": {"late": 0}}),
    ],
)
def test_frames_are_of_one_time(point, right, expected):
    assert find_reference_frames(session_of(point, **right), videos()) == expected


@pytest.mark.parametrize(
    ("point", "right", "message"),
    [
        ({"frame": 30}, {}, r"point\[late\].frame: expected less than 30.*got 30; correct it"),
        ({"time_s": 3.1}, {}, r"point\[late\].time_s: expected up to 2.900 s.*got 3.1 s; correct it"),
        ({"frame": 3}, {"time_offset_s": 1.0}, r"view 'right' films, too, got -0.700 s of .*name the point"),
        ({"frame": 29}, {"time_offset_s": -1.0}, r"got 3.900 s of 2.900 s there"),
    ],
)
def test_what_lies_outside_of_a_recording_is_refused(point, right, message):
    with pytest.raises(SessionError, match=message):
        find_reference_frames(session_of(point, **right), videos())


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ({"frame": 3, "time_s": 0.3}, r"point\[late\]: expected frame or time_s, got both \(3 and 0.3\); keep one"),
        ({"frame": -1}, r"point\[late\].frame: expected greater than or equal to 0, got -1"),
        ({"time_s": -0.1}, r"point\[late\].time_s: expected greater than or equal to 0, got -0.1"),
        ({"frame": 1.5}, r"point\[late\].frame: expected a valid integer, got 1.5"),
    ],
)
def test_faults_of_the_fields(point, message):
    with pytest.raises(SessionError, match=message):
        session_of(point)


def test_a_point_that_says_nothing_leaves_no_trace():
    """Hashes of sessions stay as they were before these fields came."""
    plain = Point(name="a", view="left", pixel=(1.0, 2.0))
    assert set(plain.model_dump()) == {"name", "view", "pixel", "static", "pixel_in"}
    assert Point(name="a", view="left", pixel=(1.0, 2.0), frame=3).model_dump()["frame"] == 3
    assert session_hash(session_of({"frame": 3})) != session_hash(session_of({"time_s": 0.3}))
    assert not plain.comes_later


def test_pictures_of_other_frames():
    frames = FirstFrames(videos())
    later = frames.at({"left": 4})
    assert (later["left"].max(), later["right"].max()) == (4, 0)
    assert later.colors["left"].max() == 4
    assert later.quiet["left"].max() == 4
    assert frames.at({"left": 0}) is frames
    assert picture_of(frames, "right", 7).min() == 7
    assert picture_of(dict(frames), "right", 0).max() == 0
