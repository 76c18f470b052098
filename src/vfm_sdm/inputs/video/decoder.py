"""Pictures of a video stream, decoded once and in order, and the checks that tell damaged ones from sound ones."""

import heapq
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import av

from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.integrity import missing_bytes
from vfm_sdm.inputs.video.records import DecodeStop

__all__ = ["Start", "choose_stream", "drain", "first_picture", "open_stream", "read_pictures", "seek_key"]

# Without "explode" the decoders paint over damaged areas with their neighbours and say nothing.
# "crccheck" compares the checksums of HEVC pictures where the encoder wrote them.
_DECODER_OPTIONS = {"err_detect": "crccheck+explode"}
_GAP_RATIO = 1.5
# A key frame this many frames before another is decoded before it, however deeply the encoder reorders.
_REORDER_STEPS = 32


@dataclass(frozen=True)
class Start:
    """Picture with which a pass begins.

    Parameters
    ----------
    stamp
        Its time stamp [unit of the stream's stamps].
    key
        Stamp of a key frame from which on everything shown decodes, not after it.
    root
        Stamp of the key frame that the decoder is given first, which may be an earlier one.
    """

    stamp: int
    key: int
    root: int


@contextmanager
def open_stream(path: Path, *, threads: bool = True) -> Iterator[tuple[av.container.InputContainer, av.VideoStream]]:
    """The container and its first video stream, ready to decode on all processors.

    Parameters
    ----------
    path
        A video file.
    threads
        Whether several pictures are decoded at once.

    Yields
    ------
    container, stream
        Both are closed when the context ends.

    Raises
    ------
    VideoError
        The file is missing or empty, cannot be opened, or has no video stream that can be decoded.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "nothing of that name"
        raise VideoError(f"{path}: expected a video file, got {found}; check the path")
    if path.stat().st_size == 0:
        raise VideoError(f"{path}: expected a video file, got an empty file; copy it again from the camera")
    try:
        # An absolute path, since FFmpeg takes "name:" at the front of a relative one for a protocol.
        container = av.open(str(path.absolute()), mode="r", metadata_errors="replace")
    except av.FFmpegError as error:
        raise VideoError(
            f"{path}: expected a video, got something that FFmpeg cannot open ({error.strerror}); check that the "
            "recording was closed properly and copied whole"
        ) from error
    with container:
        video = choose_stream(container, path, threads=threads)
        try:
            yield container, video
        finally:
            drain(video.codec_context)


def choose_stream(container: av.container.InputContainer, name: object, *, threads: bool = True) -> av.VideoStream:
    """The first video stream of a container, set up so that damage is reported.

    Parameters
    ----------
    container
        Open for reading.
    name
        What it is called, for messages.
    threads
        Whether several pictures are decoded at once.

    Raises
    ------
    VideoError
        There is no video stream that can be decoded.
    """
    # A cover picture is a stream of one frame that no camera recorded.
    streams = [s for s in container.streams.video if not s.disposition & av.stream.Disposition.attached_pic]
    if not streams:
        kinds = ", ".join(sorted({str(s.type) for s in container.streams})) or "no stream at all"
        raise VideoError(f"{name}: expected a video stream, got only {kinds}; give the file the camera recorded")
    video = streams[0]
    if video.codec_context is None:
        raise VideoError(f"{name}: expected a codec that FFmpeg can decode, got none; convert it to H.264 or HEVC")
    video.codec_context.options = dict(_DECODER_OPTIONS)
    if threads:
        # Whole pictures at once wherever the codec can; with slices at once, H.264 does not mark what it filled in.
        video.thread_type = "AUTO"
    else:
        video.thread_count = 1
    return video


def seek_key(container: av.container.InputContainer, video: av.VideoStream, start: Start) -> None:
    """Moves to a key frame with which decoding leads to a picture.

    Parameters
    ----------
    container, video
        Of `open_stream`.
    start
        The picture.

    Raises
    ------
    av.FFmpegError
        The file cannot be moved in.

    Notes
    -----
    Indices of some files are by the order of decoding, in which the stamp of one key frame may be behind the next one:
    then the search goes further back, and to the beginning at last.
    """
    rate, base = video.average_rate, video.time_base
    step = round(1 / (rate * base)) if rate and base else 0
    for target in (start.root, start.root - _REORDER_STEPS * step):
        container.seek(target, stream=video)
        stamp = next((packet.pts for packet in container.demux(video)), None)
        if stamp is not None and stamp <= start.root:
            container.seek(target, stream=video)
            return
    container.seek(min(video.start_time or 0, 0), stream=video)


def drain(decoder: av.VideoCodecContext) -> None:
    """Waits until the decoder's threads are idle; to be called before it is freed.

    Parameters
    ----------
    decoder
        Of a stream that is read no more.

    Notes
    -----
    One that has something to log asks for the interpreter's lock, which whoever frees the decoder holds while it waits
    for the threads.
    """
    if decoder.is_open:
        with suppress(av.FFmpegError):
            decoder.decode(None)


def read_pictures(path: Path, start: Start | None = None, *, threads: bool = True) -> Generator[av.VideoFrame]:
    """The decoded pictures of a file in the order they are shown.

    Parameters
    ----------
    path
        A video file.
    start
        Picture to begin with; the first one when left out.
    threads
        Whether several pictures are decoded at once.

    Yields
    ------
    picture
        A decoded picture, not rotated, height by width as stored [px].

    Raises
    ------
    DecodeStop
        The file ends early, or data are damaged; every picture before was sound.
    VideoError
        The file cannot be opened as a video.

    Notes
    -----
    Three things are checked: what the decoder itself reports, which is told to refuse damaged data instead of painting
    over them; the time stamps, because every packet that went in must come out, so that a picture which the decoder
    leaves out in silence is noticed when a later one appears; and the length of the file. A change that leaves a valid
    stream without checksums (H.264 has none) cannot be noticed.

    Decoding on several processors, an error surfaces some packets late. The group of pictures in question is then
    decoded once more on a single one, so that a damaged file gives the same frames on every machine. What the decoder
    says of pictures before the key frame of the start does not count: they may refer to what it was not given.
    """
    damage: DecodeStop
    with open_stream(path, threads=threads) as (container, video):
        first = _Pass(container, video, path, start=start)
        first.seek()
        try:
            yield from first.pictures()
        except DecodeStop as stop:
            if stop.status == RecordingStatus.TRUNCATED:
                raise
            damage = stop
        else:
            return
    if threads and start is not None and not first.yielded:
        yield from read_pictures(path, start, threads=False)
        return
    with open_stream(path, threads=False) as (container, video):
        again = _Pass(container, video, path, start=start, earlier=first)
        try:
            again.seek()
        except av.FFmpegError:
            # The index is damaged as well; what was yielded so far stands.
            raise damage from None
        yield from again.pictures()
    raise damage


def first_picture(container: av.container.InputContainer, video: av.VideoStream, path: Path) -> av.VideoFrame | None:
    """The first decoded picture of a file; ``None`` where there is none.

    Parameters
    ----------
    container, video, path
        Of `open_stream`, without threads, and the file.

    Raises
    ------
    DecodeStop
        The file ends before it, or data are damaged.
    """
    with closing(_Pass(container, video, path).pictures()) as pictures:
        return next(pictures, None)


class _Pass:
    """One run of the decoder; with an ``earlier`` run, it goes on from where that one ended to where it failed."""

    def __init__(
        self,
        container: av.container.InputContainer,
        video: av.VideoStream,
        path: Path,
        *,
        start: Start | None = None,
        earlier: "_Pass | None" = None,
    ) -> None:
        self._start = start
        # Whether the key frame of the start went in, and whether an error is that of the packet which just went in.
        self._begun, self._exact = start is None, video.thread_count == 1
        self._container = container
        self._video = video
        self._path = path
        self._earlier = earlier
        self._first: int | None = None if earlier is None else earlier._first
        self._last: int | None = None if earlier is None else earlier._last
        self._step: int = 0 if earlier is None else earlier._step
        # Latest stamp that went into the decoder, and those of pictures still inside it, smallest first.
        self._newest = 0
        self._waiting: list[int] = []
        # Two fields of one interlaced picture may come in two packets, of which one then has no picture.
        self._fields = False
        # No packet that was not read is shown before this stamp; a gap behind it may hide one.
        self._complete_to: int | None = None
        # Whether the last picture of the earlier run was met again, so that none is left out between the runs.
        self._joined = earlier is None or self._last is None
        self._draining_early = False
        self._ended = False

    def seek(self) -> None:
        """Move to where this run begins: the group of pictures that holds the last sound picture of the earlier run."""
        target = None if self._last is None else self._last - _REORDER_STEPS * self._step
        if self._start is not None and (target is None or target < self._start.key):
            seek_key(self._container, self._video, self._start)
        elif target is not None and self._first is not None and target > self._first:
            self._container.seek(target, stream=self._video)

    def pictures(self) -> Generator[av.VideoFrame]:
        """The pictures of this run; it ends with `DecodeStop` where the file does not end well."""
        fed: int | None = None
        partial = False
        try:
            for packet in self._container.demux(self._video):
                if not packet.size:
                    break
                if self._leads(packet):
                    continue
                if partial:
                    yield from self._remaining_pictures(fed)
                    raise self._damage("incomplete data")
                fed = packet.pts
                self._complete_to = packet.dts
                if packet.is_corrupt:
                    # The demuxer could not read it whole: the end of the file, unless another packet follows.
                    partial = True
                    continue
                if fed is not None and not packet.is_discard:
                    heapq.heappush(self._waiting, fed)
                    self._newest = max(self._newest, fed)
                yield from self._check_pictures(self._decode(packet))
                if self._ended:
                    return
            missing = missing_bytes(self._path)
            self._draining_early = partial or missing > 0
            yield from self._check_pictures(self._video.decode(None))
        except av.FFmpegError as error:
            # A decoder that never got a whole picture fails to flush, too: that is the early end, not damage.
            missing = missing_bytes(self._path)
            if not partial:
                yield from self._remaining_pictures(fed)
                raise self._damage(f"damaged data ({error.strerror})") from error
        if partial or missing > 0:
            raise DecodeStop(
                RecordingStatus.TRUNCATED, f"the file ends early, by at least {max(missing, 1)} bytes; copy it again"
            )
        if self._waiting and not (self._fields or self._ended):
            raise self._damage(f"{len(self._waiting)} pictures that do not decode")

    @property
    def yielded(self) -> bool:
        """Whether a picture came out."""
        return self._first is not None

    def _decode(self, packet: "av.Packet[av.VideoStream]") -> list[av.VideoFrame]:
        """What comes out when a packet goes in; errors of pictures before the key frame of the start do not count."""
        stamp = packet.pts
        self._begun = self._begun or (self._start is not None and stamp == self._start.key)
        try:
            return packet.decode()
        except av.FFmpegError:
            before = self._start is not None and stamp is not None and stamp < self._start.key
            if before and (self._exact or not self._begun):
                return []
            raise

    def _leads(self, packet: "av.Packet[av.VideoStream]") -> bool:
        """Whether a packet precedes the first key frame in time: in an open group it refers to what was before.

        Nothing that is shown after a key frame refers to what is shown before it.
        """
        return self._start is not None and packet.pts is not None and packet.pts < self._start.root

    def _remaining_pictures(self, limit: int | None) -> Generator[av.VideoFrame]:
        """Pictures that the decoder still holds from before a bad packet; only without threads that is certain."""
        if self._earlier is None:
            return
        self._draining_early = True
        try:
            held = self._video.decode(None)
        except av.FFmpegError:
            return
        yield from self._check_pictures(held, limit)

    def _check_pictures(self, pictures: list[av.VideoFrame], limit: int | None = None) -> Generator[av.VideoFrame]:
        """The pictures, one by one, as long as they are sound and in order."""
        for picture in pictures:
            stamp = picture.pts
            if stamp is None:
                raise DecodeStop(
                    RecordingStatus.CORRUPT,
                    "a frame has no time stamp; copy the recording into an mp4 or mkv file with time stamps, or give "
                    "its frames as images with their fps",
                )
            lost = self._check_off(stamp)
            if self._start is not None and stamp < self._start.key:
                continue
            if self._earlier is not None and self._last is not None and stamp <= self._last:
                self._joined = self._joined or stamp == self._last
                continue
            if self._is_beyond(stamp, limit):
                self._ended = True
                return
            self._fields = self._fields or picture.interlaced_frame
            if picture.is_corrupt or (lost and not self._fields):
                raise self._damage("a picture that is damaged, missing or out of order")
            self._step = picture.duration or (0 if self._last is None else stamp - self._last)
            self._last = stamp
            if self._start is not None and stamp < self._start.stamp:
                continue
            if self._first is None:
                self._first = stamp
            yield picture

    def _check_off(self, stamp: int) -> bool:
        """Whether a picture between the last one and this one went in and did not come out."""
        lost = False
        while self._waiting and self._waiting[0] <= stamp:
            other = heapq.heappop(self._waiting)
            # Pictures that precede the first one refer to something before the start (open groups).
            lost = lost or (self._last is not None and self._last < other < stamp)
        return lost

    def _is_beyond(self, stamp: int, limit: int | None) -> bool:
        if limit is not None and stamp >= limit:
            return True
        if self._earlier is not None and (stamp > self._earlier._newest or not self._joined):
            return True
        if not self._draining_early or self._last is None:
            return False
        certain = self._complete_to is not None and stamp <= self._complete_to
        return not certain and stamp - self._last > _GAP_RATIO * self._step > 0

    def _damage(self, found: str) -> DecodeStop:
        base = self._video.time_base
        if self._first is None or self._last is None or base is None:
            return DecodeStop(RecordingStatus.CORRUPT, f"{found} at the start; copy the file again")
        after_s = float((self._last - self._first) * base)
        return DecodeStop(RecordingStatus.CORRUPT, f"{found} after {after_s:.3f} s; copy the file again")
