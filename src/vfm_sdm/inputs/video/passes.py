"""What a pass over frames shows of the recording, frame by frame; segments of one recording are joined here."""

import hashlib
import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.inputs.video.clock import count_dropped
from vfm_sdm.inputs.video.records import DecodeReport, Frame, VideoInfo
from vfm_sdm.inputs.video.repeats import compare_rows, find_alike, sample_rows

__all__ = ["PassRecord", "PassTally", "join_passes"]

_SAMPLE_ROWS = 8
_BLOCK_ROWS = 128


@dataclass(frozen=True, eq=False)
class PassRecord:
    """Frames of a pass.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    change
        Root mean square change into each frame [grey levels] and share of the pixels that change [1], shape (T, 2); NaN
        for the first frame.
    same
        Whether a frame equals the one before in every pixel, shape (T,).
    edges
        Sampled rows of the first and the last frame, by which passes are joined, shape (2, R, W) [grey levels].
    digests
        Hashes of the first and the last frame.
    status
        How the pass ended.
    detail
        Why.
    """

    time_s: FloatArray
    change: FloatArray
    same: BoolArray
    edges: npt.NDArray[np.float32]
    digests: tuple[str, str]
    status: RecordingStatus
    detail: str

    def report(self, info: VideoInfo) -> DecodeReport:
        """What happened in the pass.

        Parameters
        ----------
        info
            What the container says.
        """
        frames = len(self.time_s)
        dropped, regular = count_dropped(self.time_s)
        words = [f"read {frames}{_format_claim(info)} frames"]
        if self.detail:
            words.append(self.detail)
        if not regular:
            words.append("irregular time stamps: dropped frames cannot be told")
        alike = tuple(find_alike(*self.change[1:].T).tolist())
        return DecodeReport(frames, int(self.same.sum()), dropped, self.status, "; ".join(words), alike)


class PassTally:
    """Frames of a pass, as they come; holds the last one."""

    def __init__(self) -> None:
        self._time_s, self._change, self._same = array("d"), array("d"), array("b")
        self._last: tuple[LumaArray, npt.NDArray[np.float32]] | None = None
        self._first: tuple[str, npt.NDArray[np.float32]] | None = None

    @property
    def frames(self) -> int:
        """Number of frames so far."""
        return len(self._time_s)

    def add(self, frame: Frame) -> None:
        """Takes the next frame."""
        rows = sample_rows(frame.luma)
        if self._last is None:
            self._first = _digest(frame.luma), rows
            change, same = (math.nan, math.nan), False
        else:
            before, rows_before = self._last
            change, same = compare_rows(rows_before, rows), _same_picture(before, frame.luma)
        self._last = frame.luma, rows
        self._time_s.append(frame.time_s)
        self._change.extend(change)
        self._same.append(same)

    def record(self, status: RecordingStatus, detail: str) -> PassRecord:
        """The pass, once it has ended.

        Parameters
        ----------
        status
            How it ended.
        detail
            Why.
        """
        edges, digests = np.zeros((2, 0, 0), np.float32), ("", "")
        if self._first is not None and self._last is not None:
            (digest, first), (luma, last) = self._first, self._last
            if first.shape == last.shape:
                edges, digests = np.stack([first, last]), (digest, _digest(luma))
        self._last = None  # a picture keeps the decoder's memory
        change = np.array(self._change).reshape(-1, 2)
        return PassRecord(np.array(self._time_s), change, np.array(self._same, bool), edges, digests, status, detail)


def join_passes(passes: Sequence[PassRecord]) -> PassRecord:
    """Passes over segments that follow one another, as one pass.

    Parameters
    ----------
    passes
        In the order of their frames, at least one.

    Notes
    -----
    The first frame of a pass is compared with the last one of the pass before, as within one. Where one was cut short,
    so was the whole.
    """
    if len(passes) == 1:
        return passes[0]
    seen = [one for one in passes if len(one.time_s)] or [passes[0]]
    change, same = [one.change.copy() for one in seen], [one.same.copy() for one in seen]
    for number, (before, after) in enumerate(pairwise(seen), start=1):
        change[number][0] = compare_rows(before.edges[1], after.edges[0])
        same[number][0] = before.digests[1] == after.digests[0] != ""
    cut = [one for one in passes if one.status != RecordingStatus.OK]
    return PassRecord(
        time_s=np.concatenate([one.time_s for one in seen]),
        change=np.concatenate(change),
        same=np.concatenate(same),
        edges=np.stack([seen[0].edges[0], seen[-1].edges[1]]),
        digests=(seen[0].digests[0], seen[-1].digests[1]),
        status=cut[0].status if cut else RecordingStatus.OK,
        detail="; ".join(dict.fromkeys(one.detail for one in cut)),
    )


def _digest(luma: LumaArray) -> str:
    return hashlib.blake2b(np.ascontiguousarray(luma).data, digest_size=16).hexdigest()


def _format_claim(info: VideoInfo) -> str:
    if info.frame_count is not None:
        return f" of {info.frame_count} claimed"
    if info.duration_s is not None and math.isfinite(info.fps):
        return f" of about {info.duration_s * info.fps:.0f} claimed"
    return ""


def _same_picture(first: LumaArray, second: LumaArray) -> bool:
    if abs(first.strides[1]) > abs(first.strides[0]):
        # Pictures turned by a quarter lie in memory column by column.
        first, second = first.T, second.T
    # A few rows tell nearly all pictures apart at next to no cost; the rest is compared in blocks that fit the cache.
    step = max(1, first.shape[0] // _SAMPLE_ROWS)
    if not np.array_equal(first[step // 2 :: step], second[step // 2 :: step]):
        return False
    starts = range(0, first.shape[0], _BLOCK_ROWS)
    return all(np.array_equal(first[s : s + _BLOCK_ROWS], second[s : s + _BLOCK_ROWS]) for s in starts)
