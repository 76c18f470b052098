"""Intervals of recordings, and chapters of which a camera writes one film."""

from fractions import Fraction

import cv2
import numpy as np
import pytest
from video_clips import RATE, REAL, TIME_BASE, scene, write_clip

from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import open_images, open_video
from vfm_sdm.inputs.video.coding import read_coded_clip
from vfm_sdm.inputs.video.container import ContainerSource
from vfm_sdm.inputs.video.continuity import count_time_code, read_time_code

COUNT = 60
OPEN = {"x264-params": "open-gop=1:scenecut=0"}
"""Groups whose first pictures, in the order they are shown, refer to the group before; of x265 by default."""
FILES = [
    *[("a.mp4", "libx264", {}), ("a.mkv", "libx264", {}), ("a.mov", "libx265", {})],
    *[("a.mkv", "libx265", {}), ("a.ts", "libx264", {}), ("a.mp4", "libx264", OPEN), ("a.ts", "libx264", OPEN)],
]


def write(path, codec="libx264", *, lumas=None, start=0, gop=7, metadata=None, **options):
    """A clip whose key frames are seven frames apart, with frames that refer to later ones."""
    lumas = scene(COUNT) if lumas is None else lumas
    settings = {**REAL[codec], **options}
    if codec == "libx264":
        settings["g"] = str(gop)
    else:
        settings["x265-params"] = f"log-level=none:keyint={gop}:min-keyint={gop}:bframes=3"
    stamps = [round((start + i) / RATE / TIME_BASE) for i in range(len(lumas))]
    return write_clip(path, lumas, codec=codec, options=settings, stamps=stamps, metadata=metadata)


def taken(frames):
    return [(frame.index, frame.time_s, frame.luma.tobytes()) for frame in frames]


@pytest.mark.parametrize(("name", "codec", "options"), FILES)
def test_a_pass_that_begins_later_gives_the_same_frames(tmp_path, name, codec, options):
    source = ContainerSource(write(tmp_path / name, codec, **options))
    whole = taken(source.stream())
    assert len(whole) == COUNT
    np.testing.assert_allclose(source.clock(), [time_s for _, time_s, _ in whole], atol=1e-9)
    for first in (1, 6, 7, 8, 20, 28, COUNT - 1):
        assert taken(source.stream_from(first)) == whole[first:]


@pytest.mark.parametrize(("name", "codec", "options"), [*FILES[:3], FILES[-1]])
def test_an_interval_is_the_recording_cut(tmp_path, name, codec, options):
    path = write(tmp_path / name, codec, **options)
    whole, part = taken(open_video(path).frames()), open_video(path, use_s=(0.5, 1.2))
    kept = [(time_s, luma) for _, time_s, luma in whole if 0.5 <= time_s <= 1.2]
    found = taken(part.frames())
    assert [index for index, _, _ in found] == list(range(len(kept)))
    assert [luma for _, _, luma in found] == [luma for _, luma in kept]
    np.testing.assert_allclose([time_s for _, time_s, _ in found], [time_s - 0.5 for time_s, _ in kept], atol=1e-9)
    assert part.info.frame_count == len(kept)
    assert part.report.status == "ok"
    assert part.first_frame().luma.tobytes() == kept[0][1]
    assert any("used from 0.5 to 1.2 s" in remark for remark in part.info.remarks)


def test_an_interval_without_frames_is_named(tmp_path):
    path = write(tmp_path / "a.mp4")
    with pytest.raises(VideoError, match=r"expected frames from 5 s on, got a recording that ends at 2\.360 s"):
        open_video(path, use_s=(5.0, None))


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_an_interval_is_looked_at_as_it_was_compressed(tmp_path, codec):
    path = write(tmp_path / "a.mp4", codec)
    whole, part = (read_coded_clip(open_video(path, use_s=use), [], frames=50) for use in (None, (0.8, None)))
    assert whole.encoder == part.encoder
    np.testing.assert_array_equal(part.frame_types[:20], whole.frame_types[20:40])
    np.testing.assert_allclose(part.quantisers[:20], whole.quantisers[20:40])
    assert part.first.tobytes() == open_video(path, use_s=(0.8, None)).first_frame().luma.tobytes()


def test_what_was_compressed_is_read_the_same_every_time(tmp_path):
    path = write(tmp_path / "a.mp4")
    found = [read_coded_clip(open_video(path), [], frames=50).quantisers for _ in range(8)]
    for one in found[1:]:
        np.testing.assert_array_equal(one, found[0])


def test_chapters_are_one_recording(tmp_path):
    lumas = scene(COUNT)
    whole = write(tmp_path / "whole.mp4", lumas=lumas, crf="0")
    cuts = [lumas[:25], lumas[25:31], lumas[31:]]
    paths = [write(tmp_path / f"GX0{n}0001.MP4", lumas=cut, crf="0") for n, cut in enumerate(cuts, start=1)]
    joined = open_video(*paths)
    found, expected = taken(joined.frames()), taken(open_video(whole).frames())
    assert [luma for _, _, luma in found] == [luma for _, _, luma in expected]
    assert [index for index, _, _ in found] == list(range(COUNT))
    np.testing.assert_allclose([t for _, t, _ in found], [t for _, t, _ in expected], atol=1e-9)
    assert joined.report.dropped == 0
    assert joined.info.frame_count == COUNT
    assert joined.info.size_bytes == sum(path.stat().st_size for path in paths)
    middle = taken(open_video(*paths, use_s=(0.9, 1.5)).frames())
    assert [luma for _, _, luma in middle] == [luma for _, t, luma in expected if 0.9 <= t <= 1.5]


def test_stamps_that_go_on_tell_what_is_missing_between_chapters(tmp_path):
    lumas = scene(40)
    first = write(tmp_path / "1.mkv", lumas=lumas[:20])
    later = write(tmp_path / "2.mkv", lumas=lumas[20:], start=23)
    joined = open_video(first, later)
    time_s = [frame.time_s for frame in joined.frames()]
    np.testing.assert_allclose(np.diff(time_s)[[18, 19, 20]], [1 / RATE, 4 / RATE, 1 / RATE], atol=2e-3)
    assert joined.report.dropped == 3
    assert any("0.120 s missing between" in remark for remark in joined.info.remarks)
    following = write(tmp_path / "3.mkv", lumas=lumas[20:], start=20)
    assert not any("missing" in remark for remark in open_video(first, following).info.remarks)


def write_chapters(folder, *, suffix="mov", **said):
    """Two chapters of 20 frames, each with a clock of its own and what the lists say of it."""
    lumas = scene(40)
    return [
        write(
            folder / f"{number}.{suffix}",
            lumas=lumas[20 * number : 20 * number + 20],
            metadata={key: values[number] for key, values in said.items() if values[number]},
        )
        for number in range(2)
    ]


@pytest.mark.parametrize(
    ("codes", "missing"),
    [
        (("10:00:00:00", "10:00:00:20"), 0),
        (("10:00:00:00", "10:00:00:21"), 0),  # a code that runs on its own is one off by rounding
        (("10:00:00:10", "10:00:02:15"), 35),
        (("23:59:59:20", "00:00:01:00"), 10),  # over midnight
        (("10:00:00:00", "00:00:00:00"), 0),  # begins anew
        (("10:00:00:00", ""), 0),
    ],
)
@pytest.mark.parametrize("suffix", ["mov", "mp4"])
def test_time_codes_tell_what_is_missing_between_chapters(tmp_path, codes, missing, suffix):
    joined = open_video(*write_chapters(tmp_path, suffix=suffix, timecode=codes))
    time_s = [frame.time_s for frame in joined.frames()]
    np.testing.assert_allclose(np.diff(time_s)[18:21], np.array([1, 1 + missing, 1]) / RATE, atol=1e-9)
    assert joined.report.dropped == missing
    said = [remark for remark in joined.info.remarks if "missing between" in remark]
    assert len(said) == (missing > 0)
    if missing:
        assert f"{missing / RATE:.3f} s missing" in said[0]


@pytest.mark.parametrize(
    ("code", "fps", "count"),
    [
        ("00:00:00:00", 25.0, 0),
        ("01:00:00:00", 24.0, 86400),
        ("00:00:59;29", 30000 / 1001, 1799),
        ("00:01:00;02", 30000 / 1001, 1800),
        ("00:10:00;00", 30000 / 1001, 17982),
        ("01:00:00;00", 30000 / 1001, 107892),
        ("00:01:00;04", 60000 / 1001, 3600),
    ],
)
def test_numbers_of_time_codes(code, fps, count):
    assert count_time_code(code, fps) == count


def test_text_that_is_no_time_code():
    assert read_time_code({"timecode": "noon"}) == ""
    assert read_time_code({}) == ""
    with pytest.raises(ValueError, match="expected a time code, got 'noon'"):
        count_time_code("noon", 25.0)


@pytest.mark.parametrize(
    ("dates", "doubted"),
    [
        (("2026-05-01T10:00:00Z", "2026-05-01T10:00:01Z"), False),
        (("2026-05-01T10:00:00Z", "2026-05-01T10:00:00Z"), False),  # that of the recording, in both
        (("2026-05-01T10:00:00Z", "2026-05-01T10:07:00Z"), True),
        (("1970-01-01T00:00:00Z", "2026-05-01T10:07:00Z"), False),  # a clock that was never set
        (("2026-05-01T10:00:00Z", ""), False),
    ],
)
def test_chapters_of_files_that_were_begun_later_are_doubted(tmp_path, dates, doubted):
    joined = open_video(*write_chapters(tmp_path, creation_time=dates))
    said = [doubt for doubt in joined.info.doubts if "by the dates of the files" in doubt]
    assert len(said) == doubted
    if doubted:
        assert "was begun 420 s after" in said[0]
        assert "measure them one by one" in said[0]
    assert joined.report.dropped == 0


def test_chapters_in_another_order_are_refused(tmp_path):
    lumas = scene(60)
    paths = [write(tmp_path / f"{n}.mkv", lumas=lumas[20 * n : 20 * n + 20], start=20 * n) for n in range(3)]
    with pytest.raises(VideoError, match="correct the order of the chapters"):
        open_video(paths[2], paths[1], paths[0])


def test_chapters_of_other_recordings_are_refused(tmp_path):
    first, other = write(tmp_path / "1.mp4"), write(tmp_path / "2.mp4", lumas=scene(5, size=(98, 66)))
    with pytest.raises(VideoError, match=r"expected the width of .*; name only chapters of one recording"):
        open_video(first, other)


def test_a_damaged_chapter_is_named_and_ends_the_pass(tmp_path):
    lumas = scene(60)
    paths = [write(tmp_path / f"{n}.mkv", lumas=lumas[20 * n : 20 * n + 20]) for n in range(3)]
    data = paths[1].read_bytes()
    paths[1].write_bytes(data[: len(data) * 2 // 3])
    joined = open_video(*paths)
    count = sum(1 for _ in joined.frames())
    assert 20 < count < 40
    assert joined.report.status in ("truncated", "corrupt")
    assert "1.mkv" in joined.report.message


def test_a_look_at_an_interval_stays_in_it(tmp_path, monkeypatch):
    monkeypatch.setattr("vfm_sdm.inputs.video.reader._LOOK_PIXELS", 0)
    path = write(tmp_path / "a.mp4")
    for use_s in ((0.4, 2.0), (0.0, None)):
        video = open_video(path, use_s=use_s)
        whole = {frame.index: frame.luma.tobytes() for frame in video.frames()}
        found = taken(video.spread(4))
        assert len(found) == 5
        assert all(whole[index] == luma for index, _, luma in found)


def test_images_have_intervals_too(tmp_path):
    for number, luma in enumerate(scene(10)):
        cv2.imwrite(str(tmp_path / f"{number:03d}.png"), luma)
    part = open_images(tmp_path / "*.png", 10.0, use_s=(0.3, 0.6))
    assert [round(frame.time_s, 6) for frame in part.frames()] == [0.0, 0.1, 0.2, 0.3]
    assert part.info.frame_count == 4


def test_slow_motion_is_cut_by_true_time(tmp_path):
    path = write(tmp_path / "a.mp4")
    part = open_video(path, capture_fps=100.0, use_s=(0.2, 0.4))
    assert part.info.time_scale == pytest.approx(float(Fraction(RATE, 100)))
    assert [round(frame.time_s, 6) for frame in part.frames()][:3] == [0.0, 0.01, 0.02]
    assert part.info.frame_count == 21
