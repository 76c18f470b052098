"""Segments of recordings: the same frames, numbers, times and report as of the whole, in any process."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest
from video_clips import RATE, TIME_BASE, damage, packet_places, scene, shown_as, write_clip

from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import Video, join_passes, open_images, open_video
from vfm_sdm.inputs.video.container import ContainerSource
from vfm_sdm.inputs.video.timeline import Timeline

COUNT, GOP, LENGTH_S = 100, 10, 0.7
X264 = {"crf": "23", "preset": "medium", "g": str(GOP), "keyint_min": str(GOP), "sc_threshold": "0"}
X265 = {"crf": "23", "preset": "fast"}
GROUPS = f"hash=1:log-level=none:keyint={GOP}:min-keyint={GOP}:bframes=3:scenecut=0"
KINDS = {
    "closed": ("libx264", {**X264, "bf": "3"}),
    "open": ("libx264", {**X264, "bf": "3", "x264-params": "open-gop=1"}),
    "open, no pyramid": ("libx264", {**X264, "bf": "2", "x264-params": "open-gop=1:b-pyramid=none:ref=16"}),
    "open, no leading": ("libx264", {**X264, "bf": "0", "x264-params": "open-gop=1:ref=16"}),
    "short": (
        "libx264",
        {**X264, "bf": "5", "x264-params": "open-gop=1:keyint=6:min-keyint=6:b-adapt=0:b-pyramid=none:ref=8"},
    ),
    "intra": ("libx264", {**X264, "g": "1"}),
    "HEVC open": ("libx265", {**X265, "x265-params": f"{GROUPS}:open-gop=1"}),
    "HEVC closed": ("libx265", {**X265, "x265-params": f"{GROUPS}:open-gop=0"}),
}
FILES = [
    *((kind, "mp4") for kind in KINDS),
    *((kind, "ts") for kind in ("closed", "open", "HEVC open")),
    ("open", "mkv"),
]


def repeating():
    """Pictures of a moving texture, of which some are stored twice: within segments and where two meet."""
    lumas = scene(COUNT, size=(98, 66))
    for number in (15, 20, 47, 80):
        lumas[number] = lumas[number - 1]
    return lumas


def write(folder, kind="closed", ending="mp4", *, lumas=None, leave_out=(), **more):
    """A recording of a kind; ``leave_out`` are numbers of pictures that the camera dropped."""
    codec, options = KINDS[kind]
    lumas = repeating() if lumas is None else lumas
    kept = [number for number in range(len(lumas)) if number not in leave_out]
    stamps = [round(number / RATE / TIME_BASE) for number in kept]
    path = folder / f"{more.pop('name', 'film')}.{ending}"
    return write_clip(path, [lumas[k] for k in kept], codec=codec, options={**options, **more}, stamps=stamps)


def taken(video):
    return [(frame.index, frame.time_s, frame.luma.tobytes()) for frame in video.frames()]


def parts_of(video, length_s=LENGTH_S):
    """Numbers of the first frames of its segments and how many each has, and the segments."""
    firsts = [first for first, _ in video.divide(length_s)]
    counts = [*np.diff(firsts).tolist(), None]
    return firsts, [video.part(first, count) for first, count in zip(firsts, counts, strict=True)]


def check_equals_whole(video, *, length_s=LENGTH_S, least=3):
    """Segments are together what the whole is; also after a journey to another process, and on one thread."""
    whole = taken(video)
    assert video.report.status == "ok"
    firsts, parts = parts_of(video, length_s)
    assert len(parts) >= least
    begins_s = [time_s for _, time_s in video.divide(length_s)]
    np.testing.assert_allclose(begins_s, [whole[first][1] for first in firsts], atol=1e-9)
    sent = [pickle.loads(pickle.dumps(part)) for part in parts]
    for change in (parts, sent, [part.on_one_thread() for part in sent]):
        found = [taken(part) for part in change]
        for first, after, frames in zip(firsts, [*firsts[1:], None], found, strict=True):
            assert frames == whole[first:after]
        joined = join_passes([part.passed for part in change])
        assert joined.report(video.info) == video.report
        np.testing.assert_array_equal(joined.change, video.passed.change)
        np.testing.assert_array_equal(joined.same, video.passed.same)
    return whole


@pytest.mark.parametrize(("kind", "ending"), FILES)
def test_segments_are_the_whole(tmp_path, kind, ending):
    video = open_video(write(tmp_path, kind, ending, leave_out=(33, 70)))
    check_equals_whole(video, least=4)
    assert video.report.dropped == 2


def test_repeated_pictures_are_counted_where_segments_meet(tmp_path):
    video = open_video(write(tmp_path, "intra", qp="0", crf="-1"))
    check_equals_whole(video)
    assert {number for number in (15, 20, 47, 80) if video.passed.same[number]} == {15, 20, 47, 80}
    assert [first for first, _ in video.divide(0.8)][:2] == [0, 20]
    check_equals_whole(video, length_s=0.8)


def test_frames_that_hold_the_noise_of_the_one_before_are_found_where_segments_meet(tmp_path):
    rng, lumas = np.random.default_rng(0), scene(COUNT, size=(98, 66))
    noisy = [np.clip(luma + rng.normal(0, 6, luma.shape), 0, 255).astype(np.uint8) for luma in lumas]
    for number in (13, 20, 61):
        noisy[number] = np.clip(noisy[number - 1].astype(int) + (rng.random(noisy[0].shape) < 0.02), 0, 255).astype(
            np.uint8
        )
    for number, luma in enumerate(noisy):
        cv2.imwrite(str(tmp_path / f"{number:03}.png"), luma)
    video = open_images(tmp_path / "*.png", RATE)
    check_equals_whole(video, length_s=0.8)
    assert video.report.alike == (13, 20, 61)


@pytest.mark.parametrize("kind", ["closed", "open", "HEVC open"])
def test_segments_of_an_interval(tmp_path, kind):
    video = open_video(write(tmp_path, kind), use_s=(0.5, 3.1))
    check_equals_whole(video)
    assert video.first_frame().index == 0


@pytest.mark.parametrize("kind", ["closed", "open"])
def test_segments_of_chapters_and_of_an_interval_of_chapters(tmp_path, kind):
    lumas = scene(COUNT, size=(98, 66))
    cuts = [lumas[:33], lumas[33:40], lumas[40:]]
    paths = [write(tmp_path, kind, lumas=one, name=f"GX0{k}0001") for k, one in enumerate(cuts)]
    for use_s in (None, (0.3, 3.5)):
        check_equals_whole(open_video(*paths, use_s=use_s))


def test_segments_of_images_with_a_gap(tmp_path):
    for number, luma in enumerate(scene(60, size=(98, 66))):
        if number not in (20, 21):
            cv2.imwrite(str(tmp_path / f"{number:03}.png"), luma)
    for use_s in (None, (0.2, 2.0)):
        check_equals_whole(open_images(tmp_path / "*.png", RATE, use_s=use_s), length_s=0.5)


def test_segments_of_a_turned_recording_and_of_slow_motion(tmp_path):
    check_equals_whole(open_video(write(tmp_path), capture_fps=100.0), length_s=LENGTH_S / 4)
    path = tmp_path / "turned.mp4"
    codec, options = KINDS["closed"]
    write_clip(path, repeating(), codec=codec, options=options, rotation=90)
    check_equals_whole(open_video(path))


def test_a_part_is_small_however_long_the_recording(tmp_path):
    path = write(tmp_path)
    source = ContainerSource(path)
    real = source._timeline
    step = int(np.diff(real.stamps)[0])
    stamps = real.stamps[0] + step * np.arange(50_000)
    vars(source)["_timeline"] = Timeline(stamps, stamps[::GOP], stamps[::GOP])
    source.info = replace(source.info, frame_count=50_000, duration_s=50_000 / RATE)
    video = Video(source)
    assert len(video.divide(60.0)) == pytest.approx(33, abs=1)
    sent = pickle.dumps(video.part(20, 30))
    assert len(sent) < 20_000
    assert taken(pickle.loads(sent)) == taken(open_video(path))[20:50]


def test_a_part_of_many_images_holds_no_more_than_its_own(tmp_path):
    for number in range(3000):
        (tmp_path / f"{number:05}.png").touch()
    for number, luma in enumerate(scene(2, size=(48, 32))):
        cv2.imwrite(str(tmp_path / f"{number:05}.png"), luma)
    video = open_images(tmp_path / "*.png", RATE)
    assert len(pickle.dumps(video.part(100, 50))) < 20_000


def spoil(path, target, number):
    """A copy in which the first large picture stored from a number on is damaged; the number at which it is shown."""
    places = packet_places(path)
    packet = next(k for k in range(number, len(places)) if places[k][1] > 800)
    place, size = places[packet]
    damage(path, target, place + size // 3, b"\xff" * (size // 3))
    return shown_as(path, packet)


@pytest.mark.parametrize("kind", ["closed", "open", "HEVC closed"])
@pytest.mark.parametrize("at", [27, 31, 33, 35])
def test_a_damaged_segment_ends_early_and_the_others_are_whole(tmp_path, kind, at):
    path = write(tmp_path, kind, crf="4")
    sound = taken(open_video(path))
    bad = spoil(path, tmp_path / "bad.mp4", at)
    video = open_video(tmp_path / "bad.mp4")
    whole = taken(video)
    assert video.report.status == "corrupt"
    assert whole == sound[: len(whole)]
    firsts, parts = parts_of(video)
    for each in (parts, [part.on_one_thread() for part in parts]):
        hit = []
        for first, after, part in zip(firsts, [*firsts[1:], COUNT], each, strict=True):
            found = taken(part)
            assert found == sound[first : first + len(found)]
            if part.report.status != RecordingStatus.OK:
                assert part.report.status == "corrupt"
                hit.append(first)
            else:
                assert len(found) == after - first
        assert hit
        assert all(first - GOP <= bad < first + 2 * GOP for first in hit)
        joined = join_passes([part.passed for part in each])
        assert joined.status == "corrupt"
        assert "damaged" in joined.report(video.info).message
        assert joined.report(video.info).dropped == COUNT - len(joined.time_s)


def test_a_file_that_ends_early_ends_with_its_last_segment(tmp_path):
    path = write(tmp_path, "closed", "mkv")
    whole = taken(open_video(path))
    content = path.read_bytes()
    (tmp_path / "cut.mkv").write_bytes(content[: len(content) * 3 // 4])
    video = open_video(tmp_path / "cut.mkv")
    _, parts = parts_of(video)
    found = [taken(part) for part in parts]
    assert [part.report.status for part in parts[:-1]] == ["ok"] * (len(parts) - 1)
    assert parts[-1].report.status == "truncated"
    joined = [frame for frames in found for frame in frames]
    assert joined == whole[: len(joined)]
    assert joined == taken(video)


def test_segments_of_which_nothing_decodes_are_joined_without_a_trace():
    lone = Video(_Nothing())
    assert list(lone.frames()) == []
    joined = join_passes([lone.passed, lone.passed])
    assert joined.report(lone.info).frames == 0


def test_a_recording_without_a_second_key_frame_stays_in_one_piece(tmp_path):
    video = open_video(write(tmp_path, g="1000", keyint_min="1000"))
    assert video.divide(LENGTH_S) == [(0, 0.0)]


def test_a_short_recording_is_not_read_to_know_that(tmp_path, monkeypatch):
    video = open_video(write(tmp_path))
    monkeypatch.setattr("vfm_sdm.inputs.video.container.read_timeline", lambda *_: pytest.fail("was read"))
    assert video.divide(60.0) == [(0, 0.0)]


def test_what_cannot_be_divided_is_refused():
    with pytest.raises(VideoError, match="expected a recording that can be divided, not a stream; read it whole"):
        Video(_Nothing()).part(0, 1)
    assert Video(_Nothing()).divide(0.1) == [(0, 0.0)]


def test_a_file_that_shrank_since_is_named(tmp_path):
    path = write(tmp_path, "intra")
    part = open_video(path).part(50, 30)
    write(tmp_path, "intra", lumas=repeating()[:60])
    assert len(list(part.frames())) == 10
    assert part.report.status == "truncated"
    assert "expected 30 frames, got 10; copy the file again" in part.report.message


class _Nothing:
    """A stream that ends at once."""

    def __init__(self):
        from moving_frames import MemorySource

        self.info = MemorySource([np.zeros((8, 8), np.uint8)]).info

    def stream(self):
        yield from ()
