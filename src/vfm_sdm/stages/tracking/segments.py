"""A view in segments: each is tracked by itself, in this process or another one, and all are judged together."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.block_files import JoinedBlocks
from vfm_sdm.core.executors import ThreadWorkers, run_tasks
from vfm_sdm.core.pieces import Pieces
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.core.threads import small_algebra
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.video import PassRecord, PassTally, Video, join_passes
from vfm_sdm.stages.tracking.base import SegmentTracker, Targets
from vfm_sdm.stages.tracking.looks import plan_looks
from vfm_sdm.stages.tracking.standings import Standing
from vfm_sdm.stages.tracking.subset_parts import MOST_SAMPLES

__all__ = [
    "SegmentTask",
    "TrackedSegments",
    "Work",
    "join_records",
    "plan_segments",
    "read_pass",
    "track_segment",
    "track_segments",
]

_MOST_AT_ONCE = 4
"""Segments in work at once in one process: each takes memory, and processes scale further."""
_PASS = "pass_"
_PASS_DIMS = {
    "time_s": ("frame",),
    "change": ("frame", "measure"),
    "same": ("frame",),
    "edges": ("edge", "row", "column"),
}


@dataclass(frozen=True, eq=False)
class Work:
    """How recordings are divided, and who tracks the segments.

    Parameters
    ----------
    segment_s
        Nominal length of a segment [s].
    executor
        Who works: processes, a cluster; ``None`` is this process, in which as many segments are in work as it has
        processors, where the tracker can.
    pieces
        Where segments are kept for a run that is cut short; in memory without.
    folder
        Where tracks lie that are too long for memory; that for temporary files when ``None``.
    """

    segment_s: float = 60.0
    executor: Executor | None = None
    pieces: Pieces | None = None
    folder: Path | None = None


@dataclass(frozen=True, eq=False)
class SegmentTask:
    """A segment of a view with all that is needed to track it, in any process that has the recording.

    Parameters
    ----------
    first
        Number of its first frame in the view.
    begins_s
        Time of that frame [s].
    segment
        Its frames.
    home
        The recording's first frames; ``None`` in the first segment.
    tracker
        Who follows.
    targets
        What is followed.
    start
        What the targets are compared with and where they are as it begins, of `SegmentTracker.find_starts`.
    """

    first: int
    begins_s: float
    segment: Video
    home: Video | None
    tracker: SegmentTracker
    targets: Targets
    start: Sequence[Standing] | None = None

    def on_one_thread(self) -> "SegmentTask":
        """The same task for one of several processes that share the processors."""
        return replace(
            self,
            segment=self.segment.on_one_thread(),
            home=None if self.home is None else self.home.on_one_thread(),
            tracker=self.tracker.on_one_thread(),
        )


def plan_segments(video: Video, tracker: SegmentTracker, targets: Targets, length_s: float) -> list[SegmentTask]:
    """Segments of a view, and where the targets are as each begins.

    Parameters
    ----------
    video
        The view.
    tracker
        Who follows.
    targets
        What is followed.
    length_s
        Nominal length of a segment [s].

    Raises
    ------
    VideoError
        The recording cannot be decoded.
    """
    begins = [(0, 0.0)] if tracker.in_one_piece else video.divide(length_s)
    firsts = [first for first, _ in begins]
    if len(begins) == 1:
        return [SegmentTask(0, 0.0, video, None, tracker, targets, _as_it_begins(targets, None, 0, None))]
    targets = replace(targets, segments=len(begins))
    home = video.part(0, 1)
    reference = home.first_frame().luma
    starts = [None, *tracker.find_starts(plan_looks(video, firsts), reference, targets)]
    counts = [*np.diff(firsts).tolist(), None]
    return [
        SegmentTask(
            *(first, begin_s, video.part(first, count), home if first else None, tracker, targets),
            _as_it_begins(targets, start, first, count),
        )
        for (first, begin_s), count, start in zip(begins, counts, starts, strict=True)
    ]


def _as_it_begins(
    targets: Targets, start: Sequence[Standing] | None, first: int, count: int | None
) -> Sequence[Standing] | None:
    """What targets are compared with in a segment of so many frames from the first one on; of ``find_starts``."""
    return [one.within(first, count) for one in start or targets.named] if targets.named else start


@dataclass(frozen=True, eq=False)
class TrackedSegments:
    """Segments of one view that were tracked.

    Parameters
    ----------
    tasks
        All segments of the view.
    read
        Function that returns the record of a segment by its number; ``None`` where there is none.
    failed
        Errors of those that failed, by number.
    length_s
        Nominal length of a segment [s].
    """

    tasks: Sequence[SegmentTask]
    read: Callable[[int], xr.Dataset | None]
    failed: Mapping[int, Exception]
    length_s: float

    @property
    def count(self) -> int:
        """Number of segments."""
        return len(self.tasks)

    def records(self) -> Iterator[xr.Dataset]:
        """Records of the segments that were tracked, one after the other.

        Raises
        ------
        Exception
            None was; the error of the first one.
        ResultsError
            The file of one is gone.
        """
        if len(self.failed) == len(self.tasks):
            raise self.failed[0]
        return (self._record(number) for number in range(len(self.tasks)) if number not in self.failed)

    def _record(self, number: int) -> xr.Dataset:
        found = self.read(number)
        if found is None:
            raise ResultsError(
                f"segment {number}: expected what was tracked a moment ago, got a damaged file or none; keep other "
                "programs out of the run folder and run again"
            )
        return found

    @property
    def untracked(self) -> list[tuple[float, float | None]]:
        """Beginnings and ends of the segments that failed [s]; ``None`` is the recording's end."""
        ends = [*(task.begins_s for task in self.tasks[1:]), None]
        return [(self.tasks[number].begins_s, ends[number]) for number in sorted(self.failed)]

    @property
    def doubts(self) -> list[str]:
        """Sentences on what was not tracked."""
        return [
            f"not tracked from {begin:.0f} s to {'the end' if end is None else f'{end:.0f} s'}: "
            f"{self.failed[number]}; run again to try it once more"
            for number, (begin, end) in zip(sorted(self.failed), self.untracked, strict=True)
        ]

    @property
    def remarks(self) -> list[str]:
        """Sentences on how the recording was divided, where that is not as asked for."""
        first = self.tasks[0]
        duration_s = first.segment.info.duration_s or 0.0
        if len(self.tasks) > 1 or duration_s < 2 * self.length_s:
            return []
        whole = first.tracker.in_one_piece
        why = f"{first.tracker.name} needs the whole recording" if whole else "no frames at which it can be divided"
        return [f"tracked in one piece of {duration_s:.0f} s: {why}"]


def track_segments(
    plans: Mapping[str, Sequence[SegmentTask]], work: Work, progress: Progress | None = None
) -> dict[str, TrackedSegments]:
    """Tracks the segments of all views; those that an earlier run kept are taken from there.

    Parameters
    ----------
    plans
        Segments by view, of `plan_segments`.
    work
        Who tracks them, and where they are kept.
    progress
        Called with the view and the frames done.

    Raises
    ------
    ResultsError
        A segment cannot be kept.
    Exception
        An error of ``progress`` itself, which ends the work: what is done is kept.
    """
    places = [(view, number) for view, tasks in plans.items() for number in range(len(tasks))]
    held: dict[tuple[str, int], xr.Dataset] = {}
    order = {view: group for group, view in enumerate(plans)}
    pieces, frames = work.pieces, Counter[str]()

    def read(view: str, number: int) -> xr.Dataset | None:
        return held.get((view, number)) if pieces is None else pieces.read(order[view], number)

    def keep(index: int, record: xr.Dataset) -> None:
        view, number = left[index]
        if pieces is None:
            held[view, number] = record
        else:
            pieces.write(order[view], number, record)
        frames[view] += record.sizes["time"]
        if progress is not None and work.executor is not None:
            progress(f"tracking {view}", frames[view], plans[view][0].segment.info.frame_count)

    def track_here(place: tuple[str, int]) -> xr.Dataset:
        view, number = place
        return track_segment(plans[view][number], _named(progress, view))

    left: list[tuple[str, int]] = []
    if pieces is not None:
        pieces.tidy()
    for view, number in places:
        found = read(view, number)
        if found is None:
            left.append((view, number))
        else:
            frames[view] += found.sizes["time"]
    tasks = [plans[view][number].on_one_thread() for view, number in left]
    if work.executor is not None:
        failed = run_tasks(track_segment, tasks, work.executor, keep)
    else:
        try:
            if (at_once := _count_at_once(plans)) > 1:
                tell = _tell_of_views(progress, frames, left, plans)
                failed = _track_in_threads(tasks, at_once, keep, tell)
            else:
                failed = run_tasks(track_here, left, None, keep)
        except _ToldError as told:
            raise told.error from told.error.__cause__
    errors = {left[index]: error for index, error in failed.items()}
    return {
        view: TrackedSegments(
            of_view,
            partial(read, view),
            {number: error for (other, number), error in errors.items() if other == view},
            work.segment_s,
        )
        for view, of_view in plans.items()
    }


def _tell_of_views(
    progress: Progress | None,
    found: Mapping[str, int],
    left: Sequence[tuple[str, int]],
    plans: Mapping[str, Sequence[SegmentTask]],
) -> Callable[[int, int], None]:
    """Progress of views by that of their segments: beside the frames found before, those done of all that are left."""
    frames, begun, told = Counter(found), Counter[int](), _tagged(progress)

    def tell(index: int, done: int) -> None:
        view, _ = left[index]
        frames[view] += done - begun[index]
        begun[index] = done
        if told is not None:
            told(f"tracking {view}", frames[view], plans[view][0].segment.info.frame_count)

    return tell


def _count_at_once(plans: Mapping[str, Sequence[SegmentTask]]) -> int:
    """Segments that are in work at once in this process: of short recordings one, with all processors."""
    divided = any(len(tasks) > 1 for tasks in plans.values())
    able = all(getattr(tasks[0].tracker, "at_once", False) for tasks in plans.values())
    return min(os.cpu_count() or 1, _MOST_AT_ONCE) if divided and able else 1


def _track_in_threads(
    tasks: Sequence[SegmentTask],
    count: int,
    keep: Callable[[int, xr.Dataset], None],
    tell: Callable[[int, int], None],
) -> dict[int, Exception]:
    """Tracks segments in so many threads; whatever ends this ends them within a frame.

    ``tell`` is called with the number of the task and the frames done of it, by one thread at a time.
    """
    lock, ended = Lock(), Event()

    def track(number: int) -> xr.Dataset:
        def go_on(_: str, done: int, __: int | None) -> None:
            with lock:
                if ended.is_set():
                    raise CancelledError
                tell(number, done - tasks[number].first)

        return track_segment(tasks[number], go_on)

    # What each of them limits for itself would else be lifted for the others when the first one ends.
    with small_algebra(), ThreadWorkers(count) as executor:
        try:
            return run_tasks(track, range(len(tasks)), executor, keep)
        except BaseException:
            ended.set()
            raise


def track_segment(task: SegmentTask, progress: Progress | None = None) -> xr.Dataset:
    """The record of a segment, with what its pass over the frames showed.

    Parameters
    ----------
    task
        The segment.
    progress
        Called with ``tracking``, the number of frames done so far and that of all.

    Raises
    ------
    VideoError
        The recording cannot be opened.
    DatasetError
        The recording has no frame.
    """
    reference = None if task.home is None else task.home.first_frame()
    with small_algebra():
        record = task.tracker.follow(
            task.segment, reference, task.targets, start=task.start, progress=_counted_on(progress, task.first)
        )
    unread = PassTally().record(RecordingStatus.NOT_READ, "the tracker made no pass over the frames")
    return _with_pass(record, task.segment.passed or unread)


def _with_pass(record: xr.Dataset, passed: PassRecord) -> xr.Dataset:
    """A record with the pass over its frames, as a file can hold it; `read_pass` takes it out again.

    Parameters
    ----------
    record
        Of `SegmentTracker.follow`.
    passed
        The pass.
    """
    variables = {_PASS + name: (dims, getattr(passed, name)) for name, dims in _PASS_DIMS.items()}
    others = [one.name for one in fields(passed) if one.name not in _PASS_DIMS]
    facts = {_PASS + name: getattr(passed, name) for name in others}
    return record.assign(variables).assign_attrs({**facts, _PASS + "digests": list(passed.digests)})


def read_pass(record: xr.Dataset) -> PassRecord:
    """The pass over the frames of a segment.

    Parameters
    ----------
    record
        Of `_with_pass`.
    """
    arrays = {name: record[_PASS + name].values for name in _PASS_DIMS}
    return PassRecord(
        digests=tuple(record.attrs[_PASS + "digests"]),
        status=RecordingStatus(record.attrs[_PASS + "status"]),
        detail=str(record.attrs[_PASS + "detail"]),
        **arrays,
    )


def join_records(records: Iterable[xr.Dataset], joined: JoinedBlocks) -> tuple[xr.Dataset, PassRecord]:
    """Records of segments as one of the whole recording, and the passes over their frames as one.

    Parameters
    ----------
    records
        In the order of their frames, at least one.
    joined
        Where they are joined.

    Notes
    -----
    Of measurements in some frames (``sample``), as many are kept as of a recording in one piece: every second one is
    dropped as often as it takes.
    """
    passes: list[PassRecord] = []
    samples: list[xr.Dataset] = []
    rest = xr.Dataset()
    for number, record in enumerate(records):
        passes.append(read_pass(record))
        found = record.drop_vars([_PASS + name for name in _PASS_DIMS])
        found.attrs = {name: value for name, value in record.attrs.items() if not str(name).startswith(_PASS)}
        joined.append(found)
        samples.append(found[[name for name, variable in found.data_vars.items() if "sample" in variable.dims]])
        rest = rest if number else found.drop_dims("time")
    if len(samples) > 1:
        rest = rest.drop_dims("sample", errors="ignore").assign(_join_samples(samples))
    return joined.finish(rest), join_passes(passes)


def _join_samples(parts: Sequence[xr.Dataset]) -> dict[str, Any]:
    """Measurements in some frames of all segments, as variables."""
    joined: dict[str, Any] = {}
    for name, variable in parts[0].data_vars.items():
        values = np.concatenate([part[name].values for part in parts], axis=variable.dims.index("sample"))
        while len(values) >= MOST_SAMPLES:
            values = values[1::2]
        joined[str(name)] = (variable.dims, values, variable.attrs)
    return joined


def _counted_on(progress: Progress | None, first: int) -> Progress | None:
    """Progress that counts frames from that of the first one on."""
    return None if progress is None else lambda what, done, total: progress(what, first + done, total)


class _ToldError(BaseException):
    """An error of the caller's, whom progress is told; it is none of a segment, of which the next one would begin."""

    def __init__(self, error: Exception) -> None:
        self.error = error


def _named(progress: Progress | None, view: str) -> Progress | None:
    """Progress that also says which view it is about."""
    told = _tagged(progress)
    return None if told is None else lambda what, done, total: told(f"{what} {view}", done, total)


def _tagged(progress: Progress | None) -> Progress | None:
    """Progress whose own errors are told from those of a segment."""
    if progress is None:
        return None

    def tell(what: str, done: int, total: int | None) -> None:
        try:
            progress(what, done, total)
        except Exception as error:
            raise _ToldError(error) from error

    return tell
