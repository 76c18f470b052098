"""Files that are read while they are written."""

import struct
import time
from threading import Event, Thread

import pytest

from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.growing import GrowingFile


def box(kind, content=b"", size=None):
    return struct.pack(">I4s", 8 + len(content) if size is None else size, kind) + content


def test_what_is_written_later_is_read_and_the_end_comes_once(tmp_path):
    path = tmp_path / "film.ts"

    def write():
        time.sleep(0.2)
        with path.open("wb", buffering=0) as file:
            file.write(b"GGGGGGGGGG")
            time.sleep(0.3)
            file.write(b"abc")

    writer = Thread(target=write)
    writer.start()
    with GrowingFile(path, idle_s=0.6, stopped=Event()) as file:
        assert file.read(100) == b"GGGGGGGGGG"
        assert file.waiting_bytes == 0
        assert file.read(100) == b"abc"
        assert file.reached_end
        assert not file.complete
        begin = time.monotonic()
        assert file.read(100) == b""
        waited = time.monotonic() - begin
        assert file.complete
        assert file.read(100) == b""  # at once: who reads asks again
        assert 0.5 < waited <= time.monotonic() - begin < waited + 0.3
        assert file.position == 13
    writer.join()


def test_what_was_there_is_no_end(tmp_path):
    path = tmp_path / "film.ts"
    path.write_bytes(b"G" * 50)
    with GrowingFile(path, idle_s=0.1, stopped=Event()) as file:
        assert file.read(20) == b"G" * 20
        assert file.waiting_bytes == 30
        assert not file.reached_end


def test_who_is_told_to_stop_waits_no_longer(tmp_path):
    path, stopped = tmp_path / "film.ts", Event()
    path.write_bytes(b"G" * 10)
    with GrowingFile(path, idle_s=60.0, stopped=stopped) as file:
        stopped.set()
        assert file.read(20) == b""
        assert not file.complete


@pytest.mark.parametrize(
    "content",
    [
        box(b"ftyp", b"isom") + box(b"free") + box(b"mdat", size=0),
        box(b"ftyp", b"qt  ") + box(b"wide") + box(b"mdat", size=1),
        box(b"mdat", b"0123") + box(b"moov", b"0123"),
    ],
    ids=["mp4", "mov", "complete"],
)
def test_an_index_at_the_end_is_refused(tmp_path, content):
    (tmp_path / "film.mp4").write_bytes(content)
    with pytest.raises(
        VideoError, match=r"expected a film that can be read .* record MPEG-TS .*Matroska .*fragmented MP4"
    ):
        GrowingFile(tmp_path / "film.mp4", idle_s=5.0, stopped=Event())


@pytest.mark.parametrize(
    "content",
    [
        box(b"ftyp", b"isom") + box(b"moov", b"0123") + box(b"mdat", size=0),
        box(b"ftyp", b"isom"),
        box(b"ftyp", b"isom", size=3) + b"0123",
        b"GGGGGGGG",
    ],
    ids=["index first", "cut", "broken", "other"],
)
def test_whatever_else_is_left_to_who_reads_it(tmp_path, content):
    (tmp_path / "film.mp4").write_bytes(content)
    with GrowingFile(tmp_path / "film.mp4", idle_s=0.1, stopped=Event()) as file:
        assert file.read(1000) == content


def test_what_never_comes(tmp_path):
    with pytest.raises(VideoError, match=r"got nothing of that name within 0\.1 s; start recording"):
        GrowingFile(tmp_path / "film.ts", idle_s=0.1, stopped=Event())
    with pytest.raises(VideoError, match="expected a video file, got a folder"):
        GrowingFile(tmp_path, idle_s=60.0, stopped=Event())
    (tmp_path / "film.ts").write_bytes(b"GGG")
    with pytest.raises(VideoError, match=r"got 3 bytes and no more within 0\.1 s"):
        GrowingFile(tmp_path / "film.ts", idle_s=0.1, stopped=Event())
