"""Live sources: the newest pictures, honest counts, and latency against the writer's own clock."""

import json
import os
import sys
import time

import av
import numpy as np
import pytest
from video_clips import write_clip

from growing_film import Film, start_film
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import open_video
from vfm_sdm.inputs.video.live import LiveSource


def numbers_of(taken, film):
    return [round(picture.time_s * film.fps) for _, picture in taken]


def watch(source, pause_s=0.0):
    """Pictures, each with when it was taken, until the source ends."""
    taken = []
    source.start()
    while not source.ended:
        if (picture := source.take(0.1)) is not None:
            taken.append((time.monotonic(), picture))
            time.sleep(pause_s)
    return taken


@pytest.mark.parametrize(("name", "options"), [("film.ts", ""), ("film.mp4", "movflags=frag_keyframe+empty_moov")])
def test_latency_is_that_of_the_writers_clock(tmp_path, name, options):
    film, log = Film(seconds=4.0, options=options), tmp_path / "log.json"
    writer = start_film(tmp_path / name, film, log=log)
    taken = watch(LiveSource(str(tmp_path / name), idle_s=5.0))
    assert writer.wait() == 0
    numbers = np.array(numbers_of(taken, film))
    assert (np.diff(numbers) > 0).all()
    assert len(numbers) > film.frames // 2  # on a machine that stands still for a second, some are dropped
    np.testing.assert_allclose([p.time_s for _, p in taken], numbers / film.fps, atol=1e-4)
    handed = np.array(json.loads(log.read_text()))[numbers]
    # Of the first second the quickest picture is not known yet; the last ones come when the file has ended.
    middle = (numbers >= film.fps) & (numbers < film.frames - film.key_frames)
    true = (np.array([at for at, _ in taken]) - handed)[middle]
    stated = np.array([at - picture.due_s for at, picture in taken])[middle]
    # What all pictures have in common is not seen; fragments hold the first of their pictures back for half a second.
    assert 0 <= np.median(true - stated) < 0.3
    # A writer that is interrupted between looking at its clock and writing is late in a way that nobody else can see.
    assert np.quantile(np.abs(true - stated - np.median(true - stated)), 0.8) < 0.15
    assert np.ptp(true) > 0.3 or not options


def test_what_nobody_takes_in_time_is_dropped_and_counted(tmp_path):
    film = Film(seconds=5.0, fps=60)
    writer = start_film(tmp_path / "film.mkv", film)
    source = LiveSource(str(tmp_path / "film.mkv"), idle_s=5.0)
    taken = watch(source, pause_s=0.1)
    assert writer.wait() == 0
    counts = source.counts
    assert counts.came == film.frames
    assert counts.dropped > film.frames // 2
    assert counts.came == len(taken) + counts.dropped
    # As long as newer ones come, none waits for more than a second, beside a burst and a pause of the taker.
    late = [at - picture.due_s for at, picture in taken if picture.time_s < film.seconds - 1.0]
    assert np.nanmedian(late) < 1.6
    assert source.ended == "nothing new for 5 s"


def test_what_lay_there_is_passed_over_up_to_a_key_frame(tmp_path):
    film = Film(seconds=20.0, at_once=True)
    assert start_film(tmp_path / "film.ts", film).wait() == 0
    source = LiveSource(str(tmp_path / "film.ts"), idle_s=0.3)
    taken = watch(source)
    assert taken[0][1].time_s == 0.0
    assert np.isnan(taken[0][1].due_s)
    numbers = numbers_of(taken, film)
    assert numbers[-1] == film.frames - 1
    jump = int(np.argmax(np.diff(numbers)))
    assert numbers[jump + 1] > film.frames // 2
    # Decoding went on where it can: the picture is that of a pass over the whole file.
    whole = open_video(tmp_path / "film.ts").frame(numbers[jump + 1])
    np.testing.assert_array_equal(taken[jump + 1][1].luma, whole.luma)
    assert source.counts.before > film.frames // 3
    assert source.counts.dropped == 0
    assert source.counts.came == len(taken) + source.counts.before == film.frames


def test_a_stream_that_is_joined_late_begins_with_a_key_frame(tmp_path):
    address = f"udp://127.0.0.1:{20000 + os.getpid() % 20000}"
    film = Film(seconds=8.0)
    writer = start_film(address + "?pkt_size=1316", film)
    source = LiveSource(address, idle_s=5.0)
    taken = watch(source)
    assert writer.wait() == 0
    assert len(taken) > film.frames // 4
    assert source.counts.came == len(taken) + source.counts.before + source.counts.damaged + source.counts.dropped
    np.testing.assert_allclose(np.diff([picture.time_s for _, picture in taken]).min(), 1 / film.fps, atol=1e-4)
    assert source.ended.endswith("expected pictures, got nothing within 5 s; check camera and connection")


def test_damaged_pictures_are_counted(tmp_path):
    film = Film(seconds=4.0, at_once=True)
    assert start_film(tmp_path / "film.ts", film).wait() == 0
    data = bytearray((tmp_path / "film.ts").read_bytes())
    middle = len(data) // 2 // 188 * 188
    for packet in range(middle, middle + 188 * 20, 188):
        data[packet + 40 : packet + 180] = bytes(140)
    (tmp_path / "film.ts").write_bytes(data)
    source = LiveSource(str(tmp_path / "film.ts"), idle_s=0.3)
    taken = watch(source)
    counts = source.counts
    assert counts.damaged > 0
    assert taken[-1][1].time_s > 3.5  # it goes on with a later key frame
    assert counts.came == len(taken) + counts.damaged + counts.before + counts.dropped
    # Of pictures whose first bytes were hit nothing comes.
    assert film.frames - 3 <= counts.came <= film.frames


def test_range_of_grey(tmp_path):
    lumas = np.random.default_rng(0).integers(30, 200, (5, 48, 64), np.uint8)
    for pixel_format, expected in (("yuv420p", (16.0, 235.0)), ("yuvj420p", (0.0, 255.0))):
        path = write_clip(tmp_path / f"{pixel_format}.mkv", lumas, pixel_format=pixel_format)
        source = LiveSource(str(path), idle_s=0.2)
        taken = watch(source)
        assert len(taken) == 5
        assert source.range == expected
        assert (source.width, source.height, source.bit_depth) == (64, 48, 8)
        np.testing.assert_array_equal(taken[0][1].luma, lumas[0])


def refusal(name, match):
    source = LiveSource(str(name), idle_s=0.2)
    source.start()
    while not source.ended:
        time.sleep(0.01)
    with pytest.raises(VideoError, match=match):
        source.take(0.1)
    source.stop()


def test_what_cannot_be_watched(tmp_path):
    (tmp_path / "notes.ts").write_bytes(b"no film at all, only some words of text" * 100)
    refusal(tmp_path / "notes.ts", "expected a live source that FFmpeg can open")
    refusal(tmp_path / "none.ts", "got nothing of that name")
    refusal("rtsp://127.0.0.1:1/none", "expected a live source that FFmpeg can open, got an error")
    refusal("/dev/video97", "expected (a live source that FFmpeg can open|Linux or macOS)")
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    refusal(tmp_path / "sound.mkv", "expected a video stream, got only audio")


def test_a_camera_on_another_system(monkeypatch):
    monkeypatch.setattr(sys, "platform", "plan9")
    refusal("0", "expected Linux or macOS for a camera, got plan9; give an RTSP address")


def test_told_to_stop_before_anything_came(tmp_path):
    source = LiveSource(str(tmp_path / "none.ts"), idle_s=60.0)
    source.start()
    source.stop()
    assert source.ended == "stopped"
    assert source.take(0.1) is None


@pytest.mark.parametrize("rotation", [90, 180, 270])
def test_pictures_are_turned_as_those_of_a_recording(tmp_path, rotation):
    lumas = np.random.default_rng(0).integers(0, 255, (6, 48, 64), np.uint8)
    fragmented = {"movflags": "frag_keyframe+empty_moov"}
    path = write_clip(tmp_path / "film.mp4", lumas, container_options=fragmented, rotation=rotation)
    source = LiveSource(str(path), idle_s=0.2)
    taken = watch(source)
    recorded = list(open_video(path).frames())
    assert recorded[0].luma.shape == ((64, 48) if rotation % 180 else (48, 64))
    assert (source.height, source.width) == recorded[0].luma.shape
    assert len(taken) == len(recorded) == 6
    for (_, picture), frame in zip(taken, recorded, strict=True):
        np.testing.assert_array_equal(picture.luma, frame.luma)
