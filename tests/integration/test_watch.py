"""``vfm-sdm watch`` beside the process that writes the films: motion, counts, latency, and the ways to end."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from growing_film import Film, start_film

SESSION = """
name = "bridge"

[[view]]
name = "left"
video = "left.ts"
lens = {{ focal_px = 1000.0 }}

[[view]]
name = "right"
video = "right.{right}"

[site]
baseline = {{ value = 4.0, std = 0.01 }}
range = [{{ point = "mid", value = 20.0, std = 0.01 }}]

[[point]]
name = "mid"
view = "left"
pixel = [127.5, 127.5]
pixel_in = {{ right = [100.0, 140.0] }}

[[point]]
name = "pier"
view = "left"
pixel = [60.0, 170.0]
static = true
"""


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text(SESSION.format(right="mkv"), encoding="utf-8")
    return path


def watch(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "vfm_sdm", "watch", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )


@pytest.fixture
def films(tmp_path):
    """Starts the films of both views; what is left of them ends with the test."""
    writers = []

    def start(film):
        writers.extend(start_film(tmp_path / name, film) for name in ("left.ts", "right.mkv"))

    yield start
    for writer in writers:
        writer.kill()
        writer.wait()


@pytest.mark.slow
def test_films_that_are_being_written(session, films):
    film = Film(seconds=14.0)
    watched = watch(session, "--json", "--every", 0.5, "--idle-s", 8)
    films(film)
    out, err = watched.communicate(timeout=120)
    assert watched.returncode == 0, err
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["ended"] for line in lines[:-1]] == [None] * (len(lines) - 1)
    assert lines[-1]["ended"] == "every source has ended"
    for name in ("left", "right"):
        last = lines[-1]["views"][name]
        assert last["state"] == "ended: nothing new for 8 s"
        assert last["came"] == last["measured"] + last["dropped"] + last["damaged"] + last["before"] == film.frames
        assert last["damaged"] == 0
        assert last["measured"] > film.frames // 4
        assert 0 < last["latency_s"] <= last["worst_latency_s"]
        np.testing.assert_allclose(last["rate_hz"], film.fps, rtol=1e-3)
        assert last["points"]["mid"]["lost"] == 0.0
        # Every report shows the motion of the picture that it names; the codec takes 1 % of it.
        shown = [line["views"][name] for line in lines if "now_px" in line["views"][name]["points"].get("mid", {})]
        assert len(shown) > 5
        moved = np.array([one["points"]["mid"]["now_px"] for one in shown])
        np.testing.assert_allclose(moved[:, 1], film.moved_px([one["time_s"] for one in shown]), atol=0.05)
        np.testing.assert_allclose(moved[:, 0], 0.0, atol=0.02)
        np.testing.assert_allclose(last["points"]["mid"]["peak_px"], 2 * film.amplitude_px, rtol=0.03)
    mid = lines[-1]["views"]["left"]["points"]["mid"]
    # 20 m over 1000 px is 20 mm a pixel; the right view has no lens.
    np.testing.assert_allclose(mid["peak_mm"] / mid["peak_px"], 20.0, rtol=1e-3)
    assert mid["scale_source"] == "range over focal length"
    assert mid["trusted"]
    assert "mm_per_px" not in lines[-1]["views"]["right"]["points"]["mid"]
    assert lines[-1]["views"]["left"]["points"]["pier"]["doubts"] == ["static, but moves: tripod, wind?"]
    assert lines[-1]["views"]["right"]["elsewhere"] == ["pier"]


def test_told_to_end(session, films):
    watched = watch(session, "--json", "--every", 0.3)
    films(Film(seconds=60.0))
    watched.stdout.readline()
    watched.send_signal(signal.SIGINT)
    out, err = watched.communicate(timeout=60)
    assert watched.returncode == 0, err
    last = json.loads(out.splitlines()[-1])
    assert last["ended"] == "told to end"
    assert {view["state"] for view in last["views"].values()} == {"ended: stopped"}


def test_a_table_after_so_many_seconds(session, films):
    films(Film(seconds=60.0))
    begin = time.monotonic()
    watched = watch(session, "--seconds", 6)
    out, err = watched.communicate(timeout=120)
    assert watched.returncode == 0, err
    assert time.monotonic() - begin < 60
    words = " ".join(out.split())
    # A long path is broken into lines anywhere.
    assert "left.ts, ended: stopped" in words.replace(" ,", ",")
    assert "pictures came," in words
    assert "6 s are over" in words


def test_an_index_at_the_end_says_what_to_record(tmp_path):
    session = tmp_path / "session.toml"
    session.write_text(SESSION.format(right="mp4"), encoding="utf-8")
    writer = start_film(tmp_path / "right.mp4", Film(seconds=60.0))
    watched = watch(session, "--source", f"left={tmp_path / 'right.mp4'}", "--json")
    _, err = watched.communicate(timeout=60)
    writer.kill()
    writer.wait()
    assert watched.returncode == 1
    assert "got an MP4 whose index comes at its end; record MPEG-TS (.ts), Matroska (.mkv) or fragmented MP4" in err


def test_times_are_positive(command, session):
    for option in ("--seconds", "--every", "--idle-s"):
        status, _, err = command("watch", session, option, 0)
        assert status == 1
        assert f"{option}: expected a positive number of seconds, got 0.0; correct it" in err
    status, _, err = command("watch", session, "--source", "left")
    assert status == 1
    assert "--source: expected name=value" in err
