"""Long recordings through a network that sees a few frames at a time: chunks, and how they are joined.

The paper streams 480 frames in chunks of 144 that overlap by 32 (section Computational cost analysis).
"""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, mean_of_known
from vfm_sdm.errors import DeviceMemoryError
from vfm_sdm.inputs.video import RgbArray
from vfm_sdm.networks.interface import SEEN, ChunkNetwork, ChunkTracks

__all__ = ["ChunkPlan", "ChunkStitcher"]

_LEAST_FRAMES = 8


@dataclass(frozen=True)
class ChunkPlan:
    """Settings of the chunks that a recording is cut into.

    Parameters
    ----------
    frames
        Frames of a chunk.
    overlap
        Frames that a chunk shares with the one before, where its first frame is one of them. Zero: every chunk begins
        with the reference frame instead, so that errors of one chunk do not enter the next.
    """

    frames: int
    overlap: int = 0

    @property
    def anchored(self) -> bool:
        """Whether every chunk begins with the reference frame."""
        return self.overlap == 0

    def within(self, frames: int) -> "ChunkPlan":
        """The settings with a bounded number of frames, of which the same share overlaps.

        Parameters
        ----------
        frames
            Largest number of frames of a chunk; a chunk has never fewer than eight.

        Examples
        --------
        >>> ChunkPlan(144, overlap=32).within(72)
        ChunkPlan(frames=72, overlap=16)
        """
        fewer = min(self.frames, max(frames, _LEAST_FRAMES))
        return replace(self, frames=fewer, overlap=-(-self.overlap * fewer // self.frames))


class ChunkStitcher:
    """Follows points through patches that come one by one, beginning with the reference frame.

    Parameters
    ----------
    network
        Network that follows the points through a chunk.
    plan
        Settings of the chunks; smaller chunks are taken where memory does not suffice.
    queries
        Positions of the points in the first patch, shape (N, 2) [px of the patch].

    Notes
    -----
    Where chunks overlap, a chunk starts from the positions that were found in its first frame. An error of a single
    position would move the whole chunk; both chunks saw the overlap, so the mean difference there is taken out, and the
    positions pass linearly from one chunk to the other.
    """

    def __init__(self, network: ChunkNetwork, plan: ChunkPlan, queries: FloatArray) -> None:
        self._network, self.plan = network, plan
        self._queries = self._start = queries
        self._waiting: list[RgbArray] = []
        self._done: list[ChunkTracks] = []
        self._shared = 1  # of the waiting frames, those whose tracks are known: the last part of what is done

    def feed(self, patch: RgbArray) -> None:
        """Takes the next patch.

        Parameters
        ----------
        patch
            Red, green and blue, shape (height, width, 3), height and width in px.

        Raises
        ------
        DeviceMemoryError
            The device has no memory for a few frames.
        """
        if not self._done:
            known = np.ones((1, len(self._queries)))
            self._done.append(ChunkTracks(self._queries[None], known, known))
            fits = self._network.plan_frames(*patch.shape[:2])
            self.plan = self.plan if fits is None else self.plan.within(fits)
        self._waiting.append(patch)
        while len(self._waiting) >= self.plan.frames:
            self._follow_chunk()

    def finish(self) -> ChunkTracks:
        """Tracks of all patches, shape (T, N, ...) in pixels of the patch, when the last one was taken."""
        while len(self._waiting) > self._shared:
            self._follow_chunk()
        return ChunkTracks.joined(*self._done)

    def _follow_chunk(self) -> None:
        """Follows the points through one chunk; where memory does not suffice, only makes later chunks smaller."""
        chunk = self._waiting[: self.plan.frames]
        try:
            found = self._network.follow(np.stack(chunk), self._start)
        except MemoryError as error:
            if len(chunk) <= _LEAST_FRAMES:
                raise DeviceMemoryError(
                    f"memory: expected room for {len(chunk)} frames of {chunk[0].shape[1]} x {chunk[0].shape[0]} px, "
                    "got less; close other programs on the device, or set another device under [method.network]"
                ) from error
            self.plan = self.plan.within(len(chunk) // 2)
            if not self.plan.anchored:
                self._pass_on(self._done.pop(), self.plan.overlap, self._shared)
            return
        if self.plan.anchored:
            self._done.append(found[1:])
            del self._waiting[1 : len(chunk)]
        else:
            self._pass_on(self._join_overlap(self._done.pop(), found), self.plan.overlap, len(chunk))

    def _pass_on(self, tracks: ChunkTracks, frames: int, seen: int) -> None:
        """Lets the next chunk begin with the last ``frames`` of these tracks, of which as many patches wait."""
        frames = min(frames, seen - 1) if seen > 1 else seen
        del self._waiting[: seen - frames]
        self._shared = frames
        self._done += [tracks[:-frames], tracks[-frames:]]
        # A point without a position cannot be followed: from its last known place it may be found again.
        first = tracks.positions[-frames]
        self._start = np.where(np.isfinite(first), first, self._start)

    def _join_overlap(self, before: ChunkTracks, found: ChunkTracks) -> ChunkTracks:
        """A chunk whose first frames another one has seen, moved to agree with it there."""
        count = len(before.positions)
        now, rest = found[:count], found[count:]
        both = np.minimum(before.visibility, now.visibility) >= SEEN
        shift = np.nan_to_num(mean_of_known(np.where(both[..., None], before.positions - now.positions, np.nan)))
        weight = ((np.arange(count) + 1) / (count + 1))[:, None, None]
        blended = (1 - weight) * before.positions + weight * (now.positions + shift)
        blended = np.where(np.isfinite(blended), blended, now.positions + shift)
        overlap = ChunkTracks(blended, before.visibility, before.confidence)
        return ChunkTracks.joined(overlap, ChunkTracks(rest.positions + shift, rest.visibility, rest.confidence))
