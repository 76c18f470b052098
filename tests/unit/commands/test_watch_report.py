"""The command ``watch``: what it prints, and how it is told to end."""

import json
import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from vfm_sdm.commands import watch as module
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.inputs.session import Point
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.live import PointMotion
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.studies.watching.scales import PointScale
from vfm_sdm.studies.watching.view import Light, PointNow, ViewNow

TIME_S = np.arange(600) / 10
MOTION = PointMotion(
    samples=600,
    lost=0.0,
    unreliable=0.0,
    now_px=np.array([0.1, -0.5]),
    rms_px=0.5,
    peak_px=2.0,
    noise_px=0.01,
    along=np.array([0.0, 1.0]),
    time_s=TIME_S,
    trace_px=np.sin(TIME_S),
)
CHOICE = SubsetChoice(SubsetDesign(41), np.full(2, 0.01), np.zeros(2), 1.0, PointStatus.OK, np.full(2, np.nan))
SCALE = PointScale(20.0, "range over focal length")


def point(name, motion=MOTION, scale=None):
    return PointNow(Point(name=name, view="left", pixel=(9.0, 9.0)), motion, CHOICE, Light(0.5, 0.0, 0.0), scale)


LOST = replace(MOTION, now_px=np.full(2, np.nan), lost=0.25)
VIEW = ViewNow(
    name="left",
    source="rtsp://camera/1",
    state="measuring",
    time_s=60.0,
    came=1800,
    measured=1750,
    dropped=45,
    while_choosing=40,
    damaged=0,
    before=5,
    missing=0,
    rate_hz=30.0,
    kept_hz=29.5,
    latency_s=0.05,
    worst_latency_s=np.nan,
    silent_s=0.03,
    light=Light(0.5, 0.001, -0.02),
    points=(point("1/2 span [mid]", scale=SCALE), point("pier", motion=LOST)),
    elsewhere=("tower",),
)


def printed(width, views=(VIEW,), encoding="utf-8", monkeypatch=None):
    class Stream:
        def __init__(self):
            self.encoding, self.text = encoding, ""

        def write(self, text):
            self.text += text

        def flush(self):
            pass

    stream = Stream()
    console = Console(file=stream, width=width, markup=False, color_system=None)
    monkeypatch.setattr(module, "OUT", console)
    console.print(module._report(views))
    return stream.text


@pytest.mark.parametrize("width", [50, 80, 200])
def test_a_report_fits_every_terminal(monkeypatch, width):
    text = printed(width, monkeypatch=monkeypatch)
    assert max(len(line) for line in text.splitlines()) <= width
    words = " ".join(text.split())
    for part in (
        "left: rtsp://camera/1, measuring",
        "29.5 of 30.0 pictures a second",
        "0.05 s late, at most -",
        "1795 pictures came, 45 dropped (40 before the first)",
        "light 50%, white 0.1%, -2% since the start",
        "pier: lost now; lost in 25%",
        "not watched here, no pixel known: tower",
    ):
        assert part in words
    assert "+0.10 -0.50" in text
    assert "40.00" in text  # 2 px at 20 mm a pixel
    assert ("last minute" in text) == (width >= 80)


def test_a_terminal_without_braille(monkeypatch):
    text = printed(80, encoding="ascii", monkeypatch=monkeypatch)
    assert "last minute" not in text
    assert "+0.10 -0.50" in text


def test_before_anything_is_measured(monkeypatch):
    waiting = replace(VIEW, state="waiting for the first picture", light=None, points=(point("mid", motion=None),))
    assert printed(80, [waiting], monkeypatch=monkeypatch).splitlines() == [
        "left: rtsp://camera/1, waiting for the first picture"
    ]
    choosing = replace(VIEW, state="choosing subsets", points=(point("mid", motion=None),))
    text = printed(80, [choosing], monkeypatch=monkeypatch)
    assert "light 50%" in text
    assert "mid" not in text


def test_lines_for_programs(monkeypatch, capsys):
    monkeypatch.setattr(module, "OUT", Console(markup=False, width=40))
    unknown = replace(VIEW, points=(*VIEW.points, point("new", motion=None)))
    module._print_line(1.5, [unknown], ended="told to end")
    line = json.loads(capsys.readouterr().out)
    assert line["ended"] == "told to end"
    view = line["views"]["left"]
    assert (view["came"], view["while_choosing"], view["worst_latency_s"]) == (1800, 40, None)
    assert view["light"] == {"mean": 0.5, "saturated": 0.001, "change": -0.02}
    assert view["doubts"] == ["not watched here, no pixel known: tower"]
    mid, pier, new = (view["points"][name] for name in ("1/2 span [mid]", "pier", "new"))
    assert (mid["trusted"], mid["now_px"], mid["now_mm"]) == (True, [0.1, -0.5], [2.0, -10.0])
    assert (mid["peak_mm"], mid["rms_mm"], mid["signal_to_noise"]) == (40.0, 10.0, 50.0)
    assert (pier["trusted"], pier["now_px"], pier["doubts"]) == (False, [None, None], ["lost now", "lost in 25%"])
    assert "mm_per_px" not in pier
    assert new == {"trusted": False, "doubts": ["not measured yet"], "light": view["points"]["new"]["light"]}


def test_a_trace_shows_the_extremes_and_leaves_gaps():
    time_s = np.linspace(0.1, 60.0, 600)
    values = np.where(time_s < 30, 0.0, np.nan)
    values[450:] = np.tile([-1.0, 1.0], 75)
    lines = module.draw_trace(time_s, values, 8, 2).splitlines()
    assert [len(line) for line in lines] == [8, 8]
    dots = np.array([[ord(one) - 0x2800 for one in line] for line in lines])
    assert (dots[:, 4:6] == 0).all()  # nothing is known there
    assert (dots[:, 6:] == 0xFF).all()  # from the least to the largest
    assert (dots[0, :4] == 0xC0).all() or (dots[1, :4] == 0x09).all()  # one level in the middle
    # A minute that has just begun stands at the right.
    assert module.draw_trace(np.array([0.0]), np.array([5.0]), 4, 1)[:3] == "\u2800" * 3
    assert set(module.draw_trace(np.array([0.0]), np.array([np.nan]), 4, 1)) == {"\u2800"}


def test_a_polite_kill_ends_and_a_second_interrupts():
    before = signal.getsignal(signal.SIGTERM)
    with module._told_to_end() as end:
        assert not end.is_set()
        os.kill(os.getpid(), signal.SIGTERM)
        assert end.wait(5.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_changing_table_only_on_a_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")  # one that can change what it shows
    for terminal in (True, False):
        console = Console(markup=False, width=80, height=40, force_terminal=terminal, color_system=None)
        monkeypatch.setattr(module, "OUT", console)
        with console.capture() as captured, module._display(json_lines=False) as show:
            show(1.0, [VIEW])
        assert ("measuring" in captured.get()) == terminal
