"""One view watched: its points followed by a thread of their own, and what can be said of them now."""

import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from threading import Lock, Thread

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Point
from vfm_sdm.inputs.video import VideoInfo
from vfm_sdm.inputs.video.clock import count_dropped
from vfm_sdm.inputs.video.live import LivePicture, LiveSource
from vfm_sdm.inputs.video.memory import video_in_memory
from vfm_sdm.stages.tracking.live import LivePoints, PointMotion, summarize_motion
from vfm_sdm.stages.tracking.subset_design import SubsetChoice, design_subsets
from vfm_sdm.studies.watching.scales import PointScale

__all__ = ["Light", "PointNow", "ViewNow", "WatchedView"]

_LOOK_S, _LOOKS = 2.0, 12
"""Pictures from which subsets are chosen: so many, spread over the first seconds [s]."""
_MINUTE_S = 60.0
_RATE_S = 10.0
"""Time over which rates and latency are taken [s]."""
_THIN = 4
"""Every fourth pixel along both axes tells the light."""
_WHITE = 0.98
_WAIT_S = 0.1


@dataclass(frozen=True)
class Light:
    """Brightness of a picture, or of a part of it.

    Parameters
    ----------
    mean
        Mean between black and white [1].
    saturated
        Share of pixels that are white [1].
    change
        Mean now over that at the start, less 1 [1].
    """

    mean: float
    saturated: float
    change: float


@dataclass(frozen=True, eq=False)
class PointNow:
    """What can be said of a point now.

    Parameters
    ----------
    point
        The point of the session.
    motion
        The last minute; ``None`` before subsets were chosen.
    choice
        Its subset; ``None`` before that.
    light
        Light of its subset.
    scale
        Millimetres a pixel; ``None`` where that is not known.
    """

    point: Point
    motion: PointMotion | None
    choice: SubsetChoice | None
    light: Light | None
    scale: PointScale | None


@dataclass(frozen=True, eq=False)
class ViewNow:
    """What can be said of a view now.

    Parameters
    ----------
    name, source
        The view, and where its pictures come from.
    state
        What is being done, or why nothing more comes.
    time_s
        Stamp of the newest picture that was measured, from the first one [s]; NaN before.
    came, measured, dropped, damaged, before
        Pictures that came; those that were measured; those that this machine did not get round to; those that could not
        be decoded; those that were in the file before and were passed over. The first is the sum of the others, and
        of the few that wait.
    while_choosing
        How many of the dropped ones were so while subsets were chosen.
    missing
        Pictures that the source's own stamps lack, in the last minute.
    rate_hz, kept_hz
        Pictures a second of the source, and of those that were measured in the last 10 s [1/s].
    latency_s, worst_latency_s
        From when a picture could have been here to when it was measured, median and largest of the last 10 s [s].
    silent_s
        How long ago the last picture was measured [s].
    light
        Light of the picture; ``None`` before the first one.
    points
        The points whose pixels are known in the view.
    elsewhere
        Names of the points of which they are not.
    """

    name: str
    source: str
    state: str
    time_s: float
    came: int
    measured: int
    dropped: int
    damaged: int
    before: int
    while_choosing: int
    missing: int
    rate_hz: float
    kept_hz: float
    latency_s: float
    worst_latency_s: float
    silent_s: float
    light: Light | None
    points: tuple[PointNow, ...]
    elsewhere: tuple[str, ...]


class WatchedView:
    """Takes pictures from a source and follows points through them.

    Parameters
    ----------
    name
        The view.
    source
        Where its pictures come from.
    points
        All points of the session.
    places
        Where they are in the view's first picture, by name, each of shape (2,) [px]; those that are known.
    subset_px
        Side of the subsets [px]; chosen for each point when ``None``.
    executor
        Threads that share the work.

    Attributes
    ----------
    error
        Why nothing can be watched; ``None`` as long as something can.
    scales
        Millimetres a pixel by point, filled in by whoever knows them when `image_size` is known.
    """

    def __init__(
        self,
        name: str,
        source: LiveSource,
        points: Sequence[Point],
        places: Mapping[str, FloatArray],
        *,
        subset_px: int | None,
        executor: Executor,
    ) -> None:
        self.name, self.scales = name, dict[str, PointScale]()
        self.error: VfmSdmError | None = None
        self._source, self._subset_px, self._executor = source, subset_px, executor
        self._points = tuple(point for point in points if point.name in places)
        self._elsewhere = tuple(point.name for point in points if point.name not in places)
        self._pixels = np.array([places[point.name] for point in self._points]).reshape(-1, 2)
        self._lock = Lock()
        self._live: LivePoints | None = None
        self._choices: list[SubsetChoice] = []
        self._first: LumaArray | None = None
        self._newest: LivePicture | None = None
        self._while_choosing = self._looked_at = 0
        self._measured, self._state = 0, "waiting for the first picture"
        self._done: deque[tuple[float, float, float]] = deque()  # when a picture was done, its latency and stamp [s]
        self._thread = Thread(target=self._run, name=f"watch {name}", daemon=True)

    def start(self) -> None:
        """Begins to watch."""
        self._source.start()
        self._thread.start()

    def stop(self) -> None:
        """Ends: what waits is still measured, what would come is not."""
        self._source.stop()
        self._thread.join()

    @property
    def running(self) -> bool:
        """Whether more may come."""
        return self._thread.is_alive()

    def look(self) -> ViewNow:
        """What can be said now."""
        counts, stamps = self._source.counts, self._source.stamps_s()
        with self._lock:
            done, measured, state, newest = list(self._done), self._measured, self._state, self._newest
            looked_at = self._looked_at
            points = self._look_at_points(newest)
        now = time.monotonic()
        recent = [one for one in done if one[0] > now - _RATE_S] if self.running else done
        latency = np.array([late for _, late, _ in recent if np.isfinite(late)])
        stamps = stamps[stamps > stamps[-1] - _MINUTE_S] if stamps.size else stamps
        missing = count_dropped(stamps)[0]
        came_s, spent = (
            (np.ptp(stamps) if stamps.size else 0.0),
            recent[-1][2] - recent[0][2] if len(recent) > 1 else 0.0,
        )
        return ViewNow(
            name=self.name,
            source=self._source.name,
            state=state,
            time_s=np.nan if newest is None else newest.time_s,
            came=counts.came,
            measured=measured,
            dropped=counts.dropped + looked_at,
            while_choosing=self._while_choosing,
            damaged=counts.damaged,
            before=counts.before,
            missing=missing,
            rate_hz=float((stamps.size - 1 + missing) / came_s) if came_s > 0 else np.nan,
            kept_hz=(len(recent) - 1) / spent if spent > 0 else np.nan,
            latency_s=float(np.median(latency)) if latency.size else np.nan,
            worst_latency_s=float(latency.max()) if latency.size else np.nan,
            silent_s=now - done[-1][0] if done else np.nan,
            light=None if newest is None else self._measure_light(newest.luma, np.s_[::_THIN, ::_THIN]),
            points=points,
            elsewhere=self._elsewhere,
        )

    def _run(self) -> None:
        try:
            if opening := self._take_opening():
                self._choose_subsets(opening)
            opening.clear()
            while (picture := self._next()) is not None:
                self._measure(picture)
            self._say(f"ended: {self._source.ended}")
        except VfmSdmError as error:
            self.error = error
            self._say(f"ended: {error}")
        finally:
            self._source.stop()

    def _next(self) -> LivePicture | None:
        """The next picture, as soon as it is there; ``None`` when none will come."""
        while not self._source.ended:
            if (picture := self._source.take(_WAIT_S)) is not None:
                return picture
        return self._source.take(0.0)

    def _take_opening(self) -> list[LivePicture]:
        """Pictures spread over the first seconds, from which subsets are chosen; the first one is the reference."""
        kept: list[LivePicture] = []
        while self._points and len(kept) < _LOOKS and (picture := self._next()) is not None:
            self._looked_at += 1
            if not kept:
                self._first, self._newest = picture.luma, picture
                self._say("looking at the first pictures")
            if picture.time_s >= len(kept) * _LOOK_S / _LOOKS:
                kept.append(picture)
            if picture.time_s > _LOOK_S:
                break
        return kept

    def _choose_subsets(self, opening: Sequence[LivePicture]) -> None:
        """Subsets from the first pictures, and who follows them."""
        self._say("choosing subsets")
        names = [point.name for point in self._points]
        video = video_in_memory([one.luma for one in opening], fps=1.0, bit_depth=self._source.bit_depth)
        choices = design_subsets(video, self._pixels, names, subset_px=self._subset_px)
        designs = [choice.design for choice in choices]
        live = LivePoints(
            opening[0].luma, self._pixels, names, designs=designs, executor=self._executor, kept_s=_MINUTE_S
        )
        with self._lock:
            self._live, self._choices = live, choices
        # What came since waited for the choice: that tells no rate and no latency of what follows.
        self._while_choosing = self._source.counts.dropped + self._looked_at

    def _measure(self, picture: LivePicture) -> None:
        with self._lock:
            self._state = "measuring"
            if self._first is None:
                self._first = picture.luma
            if self._live is not None:
                self._live.advance(picture.time_s, picture.luma)
            self._measured += 1
            now = time.monotonic()
            self._done.append((now, now - picture.due_s, picture.time_s))
            while self._done[0][0] < now - _MINUTE_S:
                self._done.popleft()
            self._newest = picture

    def _say(self, state: str) -> None:
        with self._lock:
            self._state = state

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the pictures [px]; ``None`` before the first one."""
        return None if self._newest is None else (self._source.width, self._source.height)

    def _look_at_points(self, newest: LivePicture | None) -> tuple[PointNow, ...]:
        if self._live is None or newest is None or not self._measured:
            return tuple(PointNow(point, None, None, None, self.scales.get(point.name)) for point in self._points)
        width, height = self._source.width, self._source.height
        info = VideoInfo(
            self._source.name, width, height, np.nan, None, None, "live", "", self._source.bit_depth, rotation_deg=0
        )
        motions = summarize_motion(self._live.tracks(info), self._pixels)
        return tuple(
            PointNow(point, motion, choice, self._light_at(pixel, motion, choice, newest), self.scales.get(point.name))
            for point, pixel, motion, choice in zip(self._points, self._pixels, motions, self._choices, strict=True)
        )

    def _light_at(
        self, pixel: FloatArray, motion: PointMotion, choice: SubsetChoice, newest: LivePicture
    ) -> Light | None:
        """Light of a point's subset where it is now."""
        if choice.design is None or choice.status != PointStatus.OK or not np.isfinite(motion.now_px).all():
            return None
        half = choice.design.subset_px // 2
        column, row = np.maximum(np.rint(pixel + motion.now_px).astype(int) - half, 0).tolist()
        return self._measure_light(newest.luma, np.s_[row : row + 2 * half + 1, column : column + 2 * half + 1])

    def _measure_light(self, luma: LumaArray, part: tuple[slice, slice]) -> Light:
        black, white = self._source.range
        first = luma if self._first is None else self._first
        mean, begin = ((float(one[part].mean()) - black) / (white - black) for one in (luma, first))
        # A codec leaves white a little below.
        saturated = float(np.mean(luma[part] >= black + _WHITE * (white - black)))
        return Light(mean, saturated, mean / begin - 1 if begin > 0 else np.nan)
