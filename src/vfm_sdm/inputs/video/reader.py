"""A view as a sequence of frames, whatever it is stored in."""

import math
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import DatasetError, VideoError
from vfm_sdm.inputs.video.container import INTERLACED, ContainerSource
from vfm_sdm.inputs.video.cuts import CutSource, choose_cuts
from vfm_sdm.inputs.video.decoder import Start
from vfm_sdm.inputs.video.images import ImageSource
from vfm_sdm.inputs.video.parts import IntervalSource, JoinedSource, SeekableSource
from vfm_sdm.inputs.video.passes import PassRecord, PassTally
from vfm_sdm.inputs.video.records import DecodeReport, DecodeStop, Frame, FrameSource, RgbArray, VideoInfo

__all__ = ["Video", "open_images", "open_video"]

_UNDIVIDED = 1.5
"""Segments up to which a recording stays in one piece."""
_LOOK_PIXELS = 1_500_000_000
"""Pixels that a look at a recording may decode: some two or three seconds on two processors."""


class Video:
    """Frames of one view, read in order as often as needed.

    Parameters
    ----------
    source
        Where the frames come from; `open_video` and `open_images` choose it.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._passed: PassRecord | None = None

    @property
    def info(self) -> VideoInfo:
        """What the container or the first image says about the view."""
        return self._source.info

    @property
    def report(self) -> DecodeReport:
        """What happened in the pass over `frames` that ended last."""
        if self._passed is None:
            return DecodeReport(0, 0, 0, RecordingStatus.NOT_READ, "no pass over the frames has ended yet")
        return self._passed.report(self.info)

    @property
    def passed(self) -> PassRecord | None:
        """Frames of that pass; ``None`` before the first one has ended."""
        return self._passed

    def frames(self, *, stop: int | None = None) -> Iterator[Frame]:
        """A fresh pass over the frames: each decoded once, in order, a bounded number of them in memory.

        Parameters
        ----------
        stop
            Number of frames after which to stop; all of them when ``None``.

        Yields
        ------
        frame
            Index, time [s] and luma, shape (height, width); see `vfm_sdm.inputs.video.records.Frame`.

        Raises
        ------
        DatasetError
            ``stop`` is less than 1.
        VideoError
            The file is gone, or an image differs in size or depth from the first.

        Notes
        -----
        Where the data end early, are damaged, or a time stamp is missing or does not rise, the pass ends before that
        frame, without an exception: look at `report`. No frame is made up, no time stamp repaired. In a damaged file,
        the few frames inside the decoder at that moment are lost as well.

        A frame is counted as duplicated when its luma equals that of the frame before in every pixel. A still scene
        without noise looks the same to a lossy encoder, so such frames are counted, not removed. Where frames hold
        noise, ``alike`` of the report names those that hold the noise of the frame before.
        """
        if stop is not None and stop < 1:
            raise DatasetError(f"stop: expected at least one frame, got {stop}; leave it out to read all frames")
        return self._pass(stop)

    def spread(self, count: int, *, also: int = 0) -> Iterator[Frame]:
        """Frames spread evenly over the view, in order, for a look at what it shows; `report` stays as it is.

        Parameters
        ----------
        count
            Number of frames wanted; fewer come where the view has fewer, ends early or is long.
        also
            Index of a frame that comes in any case, before the others.

        Yields
        ------
        frame
            Frames of a pass; in a long recording those that are soon decoded after a jump, whose ``index`` is counted
            from their times.

        Notes
        -----
        The work is bounded, whatever the length: up to `_LOOK_PIXELS` pixels a single pass is read, beyond that the
        container is asked to jump, and from where it lands (a key frame) only a few frames are decoded.
        """
        size = self.info.width * self.info.height
        known = self.info.frame_count
        budget = max(_LOOK_PIXELS // size, 4 * count)
        jump = getattr(self._source, "jump", None) if known is not None and known > budget else None
        # A pass begins with the first frame, which need not be decoded twice.
        waiting = jump is None and also == 0
        if not waiting:
            yield self.single(also).frame(also)
        if jump is not None:
            frames = jump(count, budget // count)
        else:
            frames = _pick(self._source.stream(), count, min(known or budget, budget))
        with closing(frames), suppress(DecodeStop):  # the pass that measures reports what is damaged
            for frame in frames:
                if waiting or frame.index != also:
                    yield frame
                waiting = False
        if waiting:
            yield self.frame(also)  # which says what is wrong

    def divide(self, length_s: float) -> list[tuple[int, float]]:
        """Numbers and times [s] of the frames with which segments of the view begin; one where it cannot be divided.

        Parameters
        ----------
        length_s
            Nominal length of a segment [s]; see `vfm_sdm.inputs.video.cuts.choose_cuts`.

        Notes
        -----
        Of a file that says it is shorter than a segment and a half nothing is read.
        """
        source, claimed_s = self._source, self.info.duration_s
        whole = [(0, 0.0)]
        if claimed_s is not None and claimed_s < _UNDIVIDED * length_s:
            return whole
        # Of fields that come in packets of their own, packets do not tell frames.
        if not isinstance(source, SeekableSource) or INTERLACED in self.info.doubts:
            return whole
        try:
            time_s, keys = source.clock(), source.keys()
        except VideoError:
            return whole  # the pass over it says what is wrong
        firsts = choose_cuts(time_s, keys, length_s)
        return list(zip(firsts, time_s[firsts].tolist(), strict=True)) if len(firsts) > 1 else whole

    def clock(self) -> FloatArray:
        """Times of all frames from the first one, shape (T,) [s]; where packets do not tell them, by a pass.

        Raises
        ------
        VideoError
            The file is gone or cannot be read any more.
        """
        if self._can_jump:
            return self._source.clock()  # type: ignore[attr-defined, no-any-return]
        time_s: list[float] = []
        with suppress(DecodeStop):  # the pass that measures reports what is damaged
            for frame in self._source.stream():
                time_s.append(frame.time_s)  # what comes before damage counts
        return np.array(time_s)

    def single(self, number: int) -> "Video":
        """A view in which a frame by its number is soon reached: that frame alone, or all where it needs a pass.

        Parameters
        ----------
        number
            Number of the frame.
        """
        return self.part(number, 1) if self._can_jump else self

    @property
    def _can_jump(self) -> bool:
        """Whether packets tell frames, and decoding can begin at them."""
        # Of fields that come in packets of their own they do not.
        return isinstance(self._source, SeekableSource) and INTERLACED not in self.info.doubts

    def keys(self, apart_s: float) -> list[int]:
        """Numbers of frames with which decoding can begin, at least so far apart [s]; of a view that can be divided.

        Parameters
        ----------
        apart_s
            Least time between two of them [s].
        """
        if not isinstance(self._source, SeekableSource):
            return []
        keys, time_s = self._source.keys(), self._source.clock()
        # The first of each interval of that length, so that it does not depend on those before.
        first = np.unique((time_s[keys] / apart_s).astype(np.int64), return_index=True)[1]
        return [int(number) for number in keys[first]]

    def part(self, first: int, count: int | None = None) -> "Video":
        """So many frames from a frame on as a view of its own, which keep their numbers and times.

        Parameters
        ----------
        first, count
            Number of the first frame, and of frames; all that follow for ``None``.

        Raises
        ------
        VideoError
            The frames cannot be reached but from the beginning.

        Notes
        -----
        Such a view can be sent to another process: it holds paths, times and where decoding begins.
        """
        if not isinstance(self._source, SeekableSource):
            raise VideoError(
                f"{self.info.source}: expected a recording that can be divided, not a stream; read it whole"
            )
        return Video(CutSource(self.info, self._source.cut(first, count)))

    def on_one_thread(self) -> "Video":
        """The same view, decoded picture by picture, for one of several processes that share the processors."""
        if isinstance(self._source, SeekableSource):
            return self.part(0).on_one_thread()
        return Video(self._source.on_one_thread()) if isinstance(self._source, CutSource) else self

    def compressed_from(self) -> tuple[Path, Start | None]:
        """File that holds the first frame, and where in it; ``None`` where that is its beginning.

        Raises
        ------
        VideoError
            The frames do not come from a file.
        """
        begins = getattr(self._source, "compressed_from", None)
        if begins is None:
            raise VideoError(f"{self.info.source}: expected a video file, got {self.info.codec}; give the recording")
        found: tuple[Path, Start | None] = begins(0)
        return found

    def frame(self, index: int) -> Frame:
        """A frame by its number; `report` stays as it is.

        Parameters
        ----------
        index
            Number of the frame; a view is decoded up to it, see `part`.

        Raises
        ------
        VideoError
            There is no such frame, or it cannot be decoded.
        """
        count = 0
        why = ""
        with closing(self._source.stream()) as stream:
            try:
                for frame in stream:
                    if frame.index == index:
                        return frame
                    count += 1
            except DecodeStop as damage:
                why = f" ({damage})"
        advice = "ask for an earlier one" if count else "check the file"
        raise VideoError(f"{self.info.source}: expected a frame {index}, got {count} frames{why}; {advice}")

    def first_frame(self) -> Frame:
        """The first frame, which was decoded to open the view; `report` stays as it is.

        Raises
        ------
        VideoError
            The file is gone or cannot be read any more.

        Notes
        -----
        It is kept until it is asked for the first time, and decoded anew after that.
        """
        opening = getattr(self._source, "opening", lambda: None)()
        return self.single(0).on_one_thread().frame(0) if opening is None else opening

    def color_frame(self, index: int = 0) -> RgbArray:
        """A frame in colour; `report` stays as it is.

        Parameters
        ----------
        index
            Position of the frame; the video is decoded up to it. In a pass, use `Frame.color`.

        Returns
        -------
        colours
            Red, green and blue in 8 bits, shape (height, width, 3).

        Raises
        ------
        DatasetError
            ``index`` is negative.
        VideoError
            There is no such frame, or its colour space cannot be converted.
        """
        if index < 0:
            raise DatasetError(f"index: expected 0 or more, got {index}; count frames from the first")
        return self.frame(index).color()

    def _pass(self, stop: int | None) -> Iterator[Frame]:
        tally = PassTally()
        status = RecordingStatus.OK
        detail = "left before its end"
        try:
            with closing(self._source.stream()) as stream:
                for frame in stream:
                    tally.add(frame)
                    yield frame
                    if tally.frames == stop:
                        detail = "stopped as asked"
                        break
                else:
                    detail = ""
        except (DecodeStop, VideoError) as error:
            status = error.status if isinstance(error, DecodeStop) else RecordingStatus.CORRUPT
            detail = str(error)
            if isinstance(error, VideoError):
                raise
        finally:
            self._passed = tally.record(status, detail)


def _pick(frames: Generator[Frame], count: int, total: int) -> Generator[Frame]:
    """Some of the first frames, as evenly spaced as their number allows."""
    wanted = set(np.linspace(0, total - 1, min(count + 1, total)).round().astype(int).tolist())
    with closing(frames):
        for frame in frames:
            if frame.index in wanted:
                yield frame
            if frame.index >= total - 1:
                return


def open_video(
    *path: str | Path, capture_fps: float | None = None, use_s: tuple[float, float | None] | None = None
) -> Video:
    """The video in a file: H.264, HEVC or whatever else FFmpeg decodes, in mp4, mov, mkv and the like.

    Parameters
    ----------
    *path
        The file, or the chapters of one recording in their order. The first frame of each is decoded here, to know that
        it can be used.
    capture_fps
        Frames a second that the camera took, where the file is stored at another rate; what the file's metadata say
        when left out [1/s].
    use_s
        Beginning and end of the interval that is used, from the first frame [s]; ``None`` is the end.

    Raises
    ------
    DatasetError
        ``capture_fps`` is not positive.
    VideoError
        A file is missing or empty, is not a video, holds no decodable frame, has no time stamps, or is to be shown
        mirrored or at an angle other than 0, 90, 180 or 270 degrees; chapters are not of one recording; or there is no
        frame in the interval.
    """
    if capture_fps is not None and not (math.isfinite(capture_fps) and capture_fps > 0):
        raise DatasetError(
            f"capture_fps: expected a positive number of frames a second, got {capture_fps}; leave it out where the "
            "file's own time stamps are right"
        )
    sources = [ContainerSource(Path(one), capture_fps=capture_fps) for one in path]
    if len(sources) == 1 and use_s is None:
        return Video(sources[0])
    for one in sources:
        one.opening()  # else many chapters would keep many pictures
    return _use(sources[0] if len(sources) == 1 else JoinedSource(sources), use_s)


def _use(source: SeekableSource, use_s: tuple[float, float | None] | None) -> Video:
    return Video(source if use_s is None else IntervalSource(source, *use_s))


def open_images(pattern: str | Path, fps: float, *, use_s: tuple[float, float | None] | None = None) -> Video:
    """The images that match a pattern, in natural order, a constant time apart.

    Parameters
    ----------
    pattern
        JPEG, PNG or TIFF files of 8 or 16 bits, such as ``left/*.jpg``.
    fps
        Images a second [1/s].
    use_s
        Beginning and end of the interval that is used, from the first image [s]; ``None`` is the end.

    Raises
    ------
    DatasetError
        ``fps`` is not positive.
    VideoError
        No file matches, the first one cannot be used, or there is no image in the interval.

    Examples
    --------
    >>> import cv2
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for number in range(3):
    ...         _ = cv2.imwrite(f"{folder}/{number}.png", np.full((48, 64), number, np.uint8))
    ...     video = open_images(f"{folder}/*.png", fps=10)
    ...     print(video.info.width, video.info.height, [frame.time_s for frame in video.frames()])
    64 48 [0.0, 0.1, 0.2]
    """
    if not (math.isfinite(fps) and fps > 0):
        raise DatasetError(f"fps: expected a positive number of images a second, got {fps}; give the camera's rate")
    return _use(ImageSource(str(pattern), float(fps)), use_s)
