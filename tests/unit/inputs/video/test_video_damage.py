"""Files that end early or are damaged: sound frames up to there and a named status, or a clear error."""

from contextlib import contextmanager

import av
import numpy as np
import pytest
from video_clips import (
    FRONT,
    LOSSLESS,
    REAL,
    TIME_BASE,
    cut,
    damage,
    decoded,
    packet_places,
    picture,
    scene,
    shown_as,
    write_clip,
)

from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import decoder, open_video

FRAMES = 40


@pytest.fixture(scope="module", params=[(c, e) for c in ("libx264", "libx265") for e in ("mp4", "mkv")])
def recording(request, tmp_path_factory):
    codec, extension = request.param
    path = tmp_path_factory.mktemp("recording") / f"sound.{extension}"
    options = {**REAL[codec], "g": "12"}
    return write_clip(path, scene(FRAMES), codec=codec, options=options, container_options=FRONT)


def read(path, truth):
    """Frames of a damaged file, after checking that they are the first of the sound one."""
    video = open_video(path)
    count = 0
    for frame in video.frames():
        assert frame.index == count
        assert frame.time_s == pytest.approx(count / 25, abs=1e-9)
        np.testing.assert_array_equal(frame.luma, truth[count])
        count += 1
    assert video.report.frames == count
    return count, video.report


def use_threads(monkeypatch, count):
    opened = av.open

    def open_with_threads(*arguments, **options):
        container = opened(*arguments, **options)
        container.streams.video[0].thread_count = count
        return container

    monkeypatch.setattr(av, "open", open_with_threads)


@pytest.mark.parametrize("share", [0.6, 0.75, 0.9, 0.98])
def test_file_that_ends_early(recording, tmp_path, share):
    size = round(recording.stat().st_size * share)
    places = packet_places(recording)
    whole = sum(place + length <= size for place, length in places)
    path = cut(recording, tmp_path / f"cut{recording.suffix}", size)
    if whole < 3:
        pytest.skip("nothing left of this one")

    count, report = read(path, decoded(recording))

    # Whole packets of which a neighbour in time is missing (three B pictures in a row here) are not shown.
    assert whole - 3 <= count <= whole
    assert report.status == "truncated"
    claim = "about 40" if path.suffix == ".mkv" else "40"
    assert report.message.startswith(f"read {count} of {claim} claimed frames; the file ends early, by at least")
    assert report.dropped == 0


def test_missing_tail_without_pictures_is_noticed(tmp_path):
    path = write_clip(tmp_path / "sound.mkv", scene(10))
    end = max(place + length for place, length in packet_places(path))
    short = cut(path, tmp_path / "cut.mkv", end + 6)
    count, report = read(short, decoded(path))
    assert (count, report.status) == (10, "truncated")


def test_last_picture_incomplete(tmp_path):
    path = write_clip(tmp_path / "sound.mp4", scene(10), container_options=FRONT)
    short = cut(path, tmp_path / "cut.mp4", path.stat().st_size - 1)
    count, report = read(short, decoded(path))
    assert (count, report.status) == (9, "truncated")
    assert "by at least 1 bytes; copy it again" in report.message


@pytest.mark.parametrize("number", [5, 8, 13, 14, 21, 26, 30, FRAMES - 1])
def test_damaged_bytes_in_the_middle(recording, tmp_path, number):
    place, length = packet_places(recording)[number]
    path = damage(recording, tmp_path / f"bad{recording.suffix}", place + length // 3, b"\xff" * (length // 3))

    count, report = read(path, decoded(recording))

    # Frames up to the first whose packet does not come before the damage; the decoder may keep one as it fails.
    before = [shown_as(recording, earlier) for earlier in range(number)]
    possible = next(shown for shown in range(FRAMES) if shown not in before)
    assert possible - 1 <= count <= possible
    assert report.status == "corrupt"
    assert report.message.startswith(f"read {count} of ")
    assert "; copy the file again" in report.message


@pytest.mark.parametrize("threads", [1, 2, 9])
@pytest.mark.parametrize("number", [1, 5, 28, 29])
def test_every_frame_before_the_damage_is_read(tmp_path, monkeypatch, threads, number):
    # Shown in the order in which they are decoded.
    options = {"crf": "20", "preset": "ultrafast", "bf": "0"}
    whole = write_clip(tmp_path / "sound.mp4", scene(30), options=options, container_options=FRONT)
    place, length = packet_places(whole)[number]
    path = damage(whole, tmp_path / "bad.mp4", place + length // 3, b"\xff" * (length // 3))
    use_threads(monkeypatch, threads)
    count, report = read(path, decoded(whole))
    assert (count, report.status) == (number, "corrupt")


def test_half_a_picture_missing(tmp_path):
    # Two slices a picture; the decoder fills in for the first without an error.
    options = {"crf": "20", "preset": "ultrafast", "bf": "2", "slices": "2", "b-pyramid": "none"}
    whole = write_clip(tmp_path / "sound.mp4", scene(30), options=options, container_options=FRONT)
    content = whole.read_bytes()
    places = [place for place, _ in packet_places(whole)]
    # A slice that nothing refers to (B), renamed to filler data.
    number = next(n for n, place in enumerate(places) if n > 12 and content[place + 4] == 0x01)
    path = damage(whole, tmp_path / "bad.mp4", places[number] + 4, b"\x0c")
    count, report = read(path, decoded(whole))
    assert (count, report.status) == (shown_as(whole, number), "corrupt")
    assert "a picture that is damaged, missing or out of order" in report.message


def test_picture_that_the_decoder_leaves_out_in_silence(tmp_path):
    options = {"crf": "20", "preset": "fast", "x265-params": "bframes=2:b-pyramid=0:log-level=none:keyint=60"}
    whole = write_clip(tmp_path / "sound.mp4", scene(30), codec="libx265", options=options, container_options=FRONT)
    content = bytearray(whole.read_bytes())
    places = packet_places(whole)
    # A picture that nothing refers to (TRAIL_N), renamed to filler data: a valid stream of one picture less.
    number, place = next((n, p) for n, (p, _) in enumerate(places) if n > 12 and content[p + 4] >> 1 == 0)
    assert int.from_bytes(content[place : place + 4], "big") + 4 == places[number][1]
    path = damage(whole, tmp_path / "bad.mp4", place + 4, b"\x4c")
    count, report = read(path, decoded(whole))
    assert (count, report.status) == (shown_as(whole, number), "corrupt")
    assert "a picture that is damaged, missing or out of order" in report.message


@pytest.mark.parametrize("number", [5, 20])
def test_a_file_whose_rest_is_zero(recording, tmp_path, number):
    # What a copy leaves that was interrupted after the space was reserved.
    place, _ = packet_places(recording)[number]
    start = place + 12
    path = damage(recording, tmp_path / f"bad{recording.suffix}", start, bytes(recording.stat().st_size - start))
    count, report = read(path, decoded(recording))
    assert number - 4 <= count <= shown_as(recording, number)
    assert report.status in {"corrupt", "truncated"}


def test_a_damaged_file_gives_the_same_frames_with_any_number_of_threads(recording, tmp_path, monkeypatch):
    place, length = packet_places(recording)[30]
    path = damage(recording, tmp_path / f"bad{recording.suffix}", place + length // 3, b"\xff" * (length // 3))
    usual = read(path, decoded(recording))

    use_threads(monkeypatch, 9)
    assert read(path, decoded(recording)) == usual


def test_damage_in_the_first_picture_leaves_nothing(recording, tmp_path):
    place, length = packet_places(recording)[0]
    path = damage(recording, tmp_path / f"bad{recording.suffix}", place + length // 3, b"\xff" * (length // 3))
    with pytest.raises(
        VideoError, match=r"expected at least one usable frame, got none: .* at the start; copy the file again"
    ):
        open_video(path)


def test_pictures_lost_in_transport(tmp_path):
    path = write_clip(tmp_path / "sound.ts", scene(20), codec="libx264")
    truth = decoded(path)
    content = path.read_bytes()
    # A transport stream comes in packets of 188 bytes; take out a run of the video's in the middle.
    start = packet_places(path)[10][0] // 188 * 188
    bad = tmp_path / "bad.ts"
    bad.write_bytes(content[:start] + content[start + 10 * 188 :])
    count, report = read(bad, truth)
    assert 5 <= count <= 10
    assert report.status == "corrupt"


def test_stamps_that_do_not_rise(tmp_path):
    def repeat_one(packets):
        for packet in packets:
            packet.dts = packet.dts - 10 * 512
        packets[6].pts = packets[5].pts
        return packets

    path = write_clip(tmp_path / "clip.mkv", scene(10), edit=repeat_one)
    count, report = read(path, decoded(path))
    assert (count, report.status) == (6, "corrupt")
    assert "expected rising time stamps, got 0.200000 s after 0.200000 s; write the file anew" in report.message


def test_stamps_out_of_order(tmp_path):
    def fall_back(packets):
        for packet in packets:
            packet.dts = packet.dts - 10 * 512
        packets[6].pts = packets[3].pts + 100
        return packets

    path = write_clip(tmp_path / "clip.mp4", scene(10), edit=fall_back)
    video = open_video(path)
    time_s = [frame.time_s for frame in video.frames()]
    assert 0 < len(time_s) <= 6
    assert np.all(np.diff(time_s) > 0)
    assert video.report.status == "corrupt"


def test_picture_size_changes(tmp_path):
    path = tmp_path / "clip.ts"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options=LOSSLESS["libx264"])
        stream.width, stream.height, stream.pix_fmt = 198, 134, "yuv420p"
        stream.time_base = stream.codec_context.time_base = TIME_BASE
        other = av.CodecContext.create("libx264", "w")
        other.width, other.height, other.pix_fmt = 262, 134, "yuv420p"
        other.options, other.framerate, other.time_base = LOSSLESS["libx264"], 25, TIME_BASE
        for encoder, lumas, start in ((stream, scene(6), 0), (other, scene(6, size=(262, 134)), 6)):
            packets = []
            for number, luma in enumerate(lumas):
                frame = picture(luma, "yuv420p")
                frame.pts, frame.time_base = (start + number) * 512, TIME_BASE
                packets += encoder.encode(frame)
            for packet in packets + encoder.encode(None):
                packet.stream = stream
                packet.time_base = TIME_BASE
                container.mux(packet)
    video = open_video(path)
    assert [frame.luma.shape for frame in video.frames()] == [(134, 198)] * 6
    assert video.report.status == "corrupt"
    assert "expected 198 x 134 yuv420p throughout, got 262 x 134 yuv420p; cut the file" in video.report.message


@pytest.mark.parametrize("threads", [1, 2, 9])
@pytest.mark.parametrize("number", [10, 11, 12])
def test_frames_behind_a_true_gap_are_kept(tmp_path, monkeypatch, threads, number):
    numbers = [*range(10), *range(15, 30)]
    whole = write_clip(tmp_path / "sound.mkv", scene(25), stamps=[shown * 512 for shown in numbers])
    truth = decoded(whole)
    place, length = packet_places(whole)[number]
    damaged = damage(whole, tmp_path / "bad.mkv", place + length // 3, b"\xff" * (length // 3))
    short = cut(whole, tmp_path / "cut.mkv", place + length // 2)
    use_threads(monkeypatch, threads)
    for path, status in ((damaged, "corrupt"), (short, "truncated")):
        video = open_video(path)
        frames = [(frame.time_s, np.array_equal(frame.luma, truth[frame.index])) for frame in video.frames()]
        assert frames == [(pytest.approx(shown / 25), True) for shown in numbers[:number]]
        assert (video.report.status, video.report.dropped) == (status, 5 if number > 10 else 0)


def test_damage_that_is_gone_when_looked_at_again(tmp_path, monkeypatch):
    # A disk or network that answers otherwise the second time.
    path = write_clip(tmp_path / "clip.mp4", scene(30))
    video = open_video(path)
    checked = decoder._Pass._check_off

    def lost_once(run, stamp):
        return checked(run, stamp) or (run._earlier is None and stamp == 12 * 512)

    monkeypatch.setattr(decoder._Pass, "_check_off", lost_once)
    count = sum(1 for _ in video.frames())
    assert 12 <= count < 30
    assert video.report.status == "corrupt"
    assert "a picture that is damaged, missing or out of order after 0.440 s" in video.report.message


class Proxy:
    """A container or stream of which one method fails."""

    def __init__(self, real, **methods):
        self._real = real
        self.__dict__.update(methods)

    def __getattr__(self, name):
        return getattr(self._real, name)

    def demux(self, video):
        return self._real.demux(getattr(video, "_real", video))


@pytest.mark.parametrize("failing", ["seek", "flush"])
def test_second_look_that_fails(tmp_path, monkeypatch, failing):
    whole = write_clip(tmp_path / "sound.mp4", scene(60))
    place, length = packet_places(whole)[50]
    path = damage(whole, tmp_path / "bad.mp4", place + length // 3, b"\xff" * (length // 3))
    usual = decoder.open_stream
    seeks = []

    @contextmanager
    def hindered(path, *, threads=True):
        with usual(path, threads=threads) as (container, video):

            def seek(*arguments, **options):
                seeks.append(arguments)
                if failing == "seek":
                    raise av.error.PermissionError(1, "no")

            def decode(packet):
                raise av.error.EOFError(1, "no")

            yield Proxy(container, seek=seek), Proxy(video, decode=decode) if failing == "flush" else video

    monkeypatch.setattr(decoder, "open_stream", hindered)
    count, report = read(path, decoded(whole))
    assert 45 <= count <= 50
    assert report.status == "corrupt"
    assert len(seeks) == 1


def empty(path):
    path.write_bytes(b"")


def text(path):
    path.write_text("lateral displacement in millimetres\n" * 100)


def without_index(path):
    whole = write_clip(path.with_name("whole.mp4"), scene(10))
    cut(whole, path, whole.stat().st_size // 2)


def only_sound(path):
    with av.open(str(path), "w") as container:
        sound = container.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 8000
        container.mux(sound.encode(frame) + sound.encode(None))


def unknown_codec(path):
    whole = write_clip(path.with_name("whole.mp4"), scene(3))
    damage(whole, path, whole.read_bytes().index(b"avc1", 64), b"zz99")


def no_frames(path):
    whole = write_clip(path.with_name("whole.mp4"), scene(10), container_options=FRONT)
    cut(whole, path, packet_places(whole)[0][0] + 20)


def no_stamps(path):
    whole = write_clip(path.with_name("whole.h264"), scene(5))
    path.write_bytes(whole.read_bytes())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "expected a video file, got nothing of that name; check the path"),
        (lambda path: path.mkdir(), "expected a video file, got a folder; check the path"),
        (empty, "expected a video file, got an empty file; copy it again"),
        (text, "expected a video, got something that FFmpeg cannot open .*; check that the recording was closed"),
        (without_index, "expected a video, got something that FFmpeg cannot open .*; check that the recording"),
        (only_sound, "expected a video stream, got only audio; give the file the camera recorded"),
        (unknown_codec, "expected a codec that FFmpeg can decode, got none; convert it to H.264 or HEVC"),
        (no_frames, "expected at least one usable frame, got none: the file ends early"),
        (
            no_stamps,
            "expected at least one usable frame, got none: a frame has no time stamp; copy the recording into an mp4",
        ),
    ],
)
def test_files_of_no_use_are_refused(tmp_path, make, message):
    path = tmp_path / "clip.mp4"
    make(path)
    with pytest.raises(VideoError, match=rf"clip\.mp4: {message}"):
        open_video(path)


def test_a_file_that_goes_away(tmp_path):
    path = write_clip(tmp_path / "clip.mp4", scene(3))
    video = open_video(path)
    path.unlink()
    with pytest.raises(VideoError, match="got nothing of that name"):
        list(video.frames())
    assert video.report.status == "corrupt"
    assert video.first_frame().index == 0  # which was decoded to open it
    with pytest.raises(VideoError, match="got nothing of that name"):
        video.first_frame()


def test_colour_of_a_frame_behind_the_damage(recording, tmp_path):
    place, length = packet_places(recording)[10]
    path = damage(recording, tmp_path / f"bad{recording.suffix}", place + length // 3, b"\xff" * (length // 3))
    with pytest.raises(
        VideoError, match=r"expected a frame 30, got \d+ frames \(damaged data .*\); ask for an earlier"
    ):
        open_video(path).color_frame(30)


def test_lossless_options_are_what_the_tests_mean(tmp_path):
    # Truth of this file is PyAV's own loop; that loop itself is checked here.
    lumas = scene(4)
    path = write_clip(tmp_path / "clip.mp4", lumas, options=LOSSLESS["libx264"])
    np.testing.assert_array_equal(decoded(path), lumas)
    assert picture(lumas[0], "yuv420p").width == 198
