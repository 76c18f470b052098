"""What is shown and not to be trusted says so."""

from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError, SessionError, VideoError
from vfm_sdm.inputs.session import Point, Session
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.live import PointMotion
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.studies.watching.view import Light, PointNow, ViewNow
from vfm_sdm.studies.watching.watch import Watch, doubt_point, doubt_view

GOOD = PointMotion(300, 0.0, 0.0, np.array([0.1, 0.5]), 0.5, 2.0, 0.01, np.array([0.0, 1.0]), np.zeros(1), np.zeros(1))
CHOICE = SubsetChoice(SubsetDesign(41), np.full(2, 0.01), np.zeros(2), 1.0, PointStatus.OK, np.full(2, np.nan))
LIGHT = Light(0.5, 0.0, 0.0)


def point(static=False, motion=GOOD, choice=CHOICE, light=LIGHT):
    return PointNow(Point(name="mid", view="left", pixel=(9.0, 9.0), static=static), motion, choice, light, None)


@pytest.mark.parametrize(
    ("shown", "doubts"),
    [
        (point(), ()),
        (point(motion=None), ("not measured yet",)),
        (point(motion=replace(GOOD, now_px=np.full(2, np.nan), lost=0.25)), ("lost now", "lost in 25%")),
        (point(motion=replace(GOOD, lost=0.01)), ()),
        (point(motion=replace(GOOD, unreliable=0.5)), ("unreliable in 50%",)),
        (point(motion=replace(GOOD, rms_px=0.02)), ("no motion above noise",)),
        (point(static=True, motion=replace(GOOD, rms_px=0.02)), ()),
        (point(static=True), ("static, but moves: tripod, wind?",)),
        (point(motion=replace(GOOD, samples=12)), ("only 12 pictures so far",)),
        (point(light=Light(0.9, 0.3, 0.0)), ("30% of it is white: expose less",)),
        (point(choice=replace(CHOICE, status=PointStatus.NO_TEXTURE)), ("no texture to follow",)),
        (
            point(choice=replace(CHOICE, status=PointStatus.NO_TEXTURE, nearest=np.array([40.2, 51.0]))),
            ("no texture to follow; 40, 51 would do",),
        ),
    ],
)
def test_points(shown, doubts):
    assert doubt_point(shown) == doubts


FINE = ViewNow(
    name="left",
    source="left.ts",
    state="measuring",
    time_s=60.0,
    came=1800,
    measured=1750,
    dropped=50,
    while_choosing=50,
    damaged=0,
    before=0,
    missing=0,
    rate_hz=30.0,
    kept_hz=29.5,
    latency_s=0.05,
    worst_latency_s=0.2,
    silent_s=0.03,
    light=LIGHT,
    points=(),
    elsewhere=(),
)


@pytest.mark.parametrize(
    ("changed", "doubts"),
    [
        ({}, ()),
        ({"silent_s": 7.0}, ("no picture for 7 s: what is shown is old",)),
        ({"silent_s": 7.0, "state": "ended: stopped"}, ()),
        ({"latency_s": 1.5}, ("shown 1.5 s late",)),
        ({"kept_hz": 10.0}, ("10.0 of 30.0 pictures a second are measured: motion above 5.0 Hz is shown wrong",)),
        ({"missing": 3}, ("missing in the source itself, in the last minute: 3",)),
        ({"damaged": 2}, ("damaged: 2",)),
        ({"light": Light(0.5, 0.1, 0.0)}, ("10% of the picture is white: expose less",)),
        ({"light": Light(0.5, 0.0, -0.4)}, ("light has changed by -40% since the start",)),
        ({"elsewhere": ("pier",)}, ("not watched here, no pixel known: pier",)),
    ],
)
def test_views(changed, doubts):
    assert doubt_view(replace(FINE, **changed)) == doubts


def session(**view):
    return Session(
        name="bridge",
        view=[{"name": "left", **(view or {"video": "left.ts"})}],
        point=[{"name": "mid", "view": "left", "pixel": [9000.0, 9.0]}],
    )


def test_sources_are_those_of_views(tmp_path):
    with pytest.raises(SessionError, match=r"source: expected views of the session \(left\), got middle, top"):
        Watch(session(), {"top": "0", "middle": "1"})
    with pytest.raises(SessionError, match=r"expected one video file that grows, got images; .*--source left=SOURCE"):
        Watch(session(images="*.png", fps=30.0))
    with pytest.raises(SessionError, match="got several chapters"):
        Watch(session(video=["a.mp4", "b.mp4"]))
    Watch(session(images="*.png", fps=30.0), {"left": "0"})


def test_a_source_that_shows_nothing_is_an_error(tmp_path):
    with Watch(session(), {"left": str(tmp_path / "none.ts")}, idle_s=0.1) as watched:
        while watched.running:
            pass
        with pytest.raises(VideoError, match="got nothing of that name"):
            watched.look()


def test_a_point_outside_the_pictures_is_an_error(tmp_path):
    from growing_film import Film, start_film

    assert start_film(tmp_path / "film.ts", Film(seconds=1.0, at_once=True)).wait() == 0
    with Watch(session(), {"left": str(tmp_path / "film.ts")}, idle_s=0.1) as watched:
        while watched.running:
            pass
        with pytest.raises(DatasetError, match="expected pixels inside 256 x 256"):
            watched.look()
