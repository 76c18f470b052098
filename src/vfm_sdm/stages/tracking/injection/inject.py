"""Blind injection: known motion put into a recording's own pictures, encoded as these were, tracked, and compared."""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.covariances import edges_across, find_edges
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.core.statuses import InjectionStatus
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import Region, Video
from vfm_sdm.inputs.video.coding import CodedClip, read_coded_clip
from vfm_sdm.inputs.video.memory import video_in_memory
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.base import DesignedTracker, Tracker
from vfm_sdm.stages.tracking.injection.encoder import ClipEncoder
from vfm_sdm.stages.tracking.injection.gains import Gain, combine_gains, compute_gain, smooth_motion
from vfm_sdm.stages.tracking.injection.source import Source, measure_looks

__all__ = ["inject"]

_FRAMES = 180
"""Frames that are injected at most: about 0.5 % of a gain in three passes, at a few seconds for ten points."""
_FEWEST = 60
_PASSES = 3
_MARGIN_PX = 8
"""Room around a subset in its full motion, for interpolation and prediction [px]."""
_OUTSIDE_PX = 16
_GRID_PX = {"h264": 16, "hevc": 64}
"""Largest blocks of the codecs [px]."""
_MOST_PX = 12.0
"""Largest motion that is injected; larger ones are put in with this amplitude [px]."""
_LOSS_SHARE, _LOSS_SHARE_UNKNOWN, _LOSS_SHARE_MIXED = 0.3, 0.6, 1.0
"""Standard deviation of an injected loss over the loss: of recordings that say how their encoder was set
(`benchmarks/injection.py`), of others, and where a subset covers what stands still, which says little of the codec."""
_MIXED, _MIXED_AROUND = 0.02, 0.1
"""Share of a subset's believed pixels, and of its square, that may stand still [1]."""
_CLEAR = 2.0
"""Times its noise by which a point must move: gains of less are not determined."""


def inject(
    video: Video, tracks: xr.Dataset, tracker: Tracker, *, designs: Mapping[str, SubsetDesign | None] | None = None
) -> xr.Dataset:
    """Gain and noise of the points of a view, by known motion that is put into the recording around each of them.

    Parameters
    ----------
    video
        The recording; a few hundred frames of it are read.
    tracks
        Tracks of the view, shape (T, P, 2) [px].
    tracker
        Tracker that they come from.
    designs
        Subset of each point by name, for trackers that take designs; ``None`` for a point that was not tracked.

    Returns
    -------
    found
        ``injected_gain`` and ``injected_gain_std`` (point, direction) [1], ``injected_noise`` (point, direction) [px],
        ``injected_direction`` (point, direction, pixel): unit vectors, u and v, or across and along an edge; and
        ``injection_status`` (point). NaN where the status is not ``ok``, and along an edge.

    Notes
    -----
    The picture before the camera's encoder is not known, and decides how much of a small motion is lost. It is taken
    from the recording: the mean of all frames, each moved back by the track, what stands still beside the point apart;
    with the noise that intra frames show about it. It is moved as the point moved, with the sign changed, encoded
    (`vfm_sdm.stages.tracking.injection.encoder`), tracked with the same subset, and looked at in the same way. By what
    the encoder took of contrast and noise, both are corrected, and the next pass begins.

    References
    ----------
    .. [1] Gourieroux, C., Monfort, A., Renault, E. (1993). Indirect inference. Journal of Applied Econometrics 8,
       S85-S118.
    """
    names = [str(name) for name in tracks["point"].values]
    registration: Any = getattr(tracker, "registration_tracker", tracker)
    if hasattr(registration, "of_whole_subsets"):
        registration = registration.of_whole_subsets()
    sides = [_find_side(registration, name, designs) for name in names]
    shifts = trusted_values(tracks, "position")[:_FRAMES]
    states = [_judge(shifts[:, k], side) for k, side in enumerate(sides)]
    if video.info.codec not in _GRID_PX:
        return _describe(tracks, {}, [InjectionStatus.NOT_COMPRESSED] * len(names))
    chosen = [k for k, state in enumerate(states) if state == InjectionStatus.OK]
    places = [_Place.plan(shifts[:, k], sides[k], video.info.codec) for k in chosen]
    clip = read_coded_clip(video, [place.region for place in places], frames=len(shifts)) if chosen else None
    if clip is None or len(clip.frame_types) < len(shifts):
        return _describe(tracks, {}, [s if s != InjectionStatus.OK else InjectionStatus.TOO_SHORT for s in states])

    def measure(number: int) -> tuple[Gain, Gain] | None:
        name = names[chosen[number]]
        design = None if designs is None else designs.get(name)
        across = None if design is None else design.across
        return _Injection(clip, clip.crops[number], places[number], registration, design, across).run()

    found: dict[int, tuple[Gain, Gain] | None] = {}
    with ThreadPoolExecutor(os.cpu_count() or 1) as executor:
        results = [executor.submit(measure, number) for number in range(len(chosen))]
        for k, result in zip(chosen, results, strict=True):
            try:
                found[k] = result.result()
            except VideoError:
                states[k] = InjectionStatus.NO_ENCODER
                continue
            if found[k] is None:
                states[k] = InjectionStatus.LOST
    return _describe(tracks, {k: gains for k, gains in found.items() if gains is not None}, states)


def _find_side(tracker: Any, name: str, designs: Mapping[str, SubsetDesign | None] | None) -> int:
    """Side of a point's subset [px]; 0 where there is none."""
    if designs and isinstance(tracker, DesignedTracker):
        design = designs.get(name)
        return 0 if design is None else design.subset_px
    return int(getattr(tracker, "subset_px", None) or 0)


def _judge(position: FloatArray, side: int) -> InjectionStatus:
    """Whether a point can be injected, from its positions (T, 2) [px]."""
    known = np.asarray(np.isfinite(position).all(axis=1))
    if side == 0:
        return InjectionStatus.NO_SUBSET
    if len(position) < _FEWEST:
        return InjectionStatus.TOO_SHORT
    if not known[0] or known.sum() < _FEWEST:
        return InjectionStatus.LOST
    motion = smooth_motion(position)
    left = position[known] - motion[known]
    moves = motion.std(axis=0) > _CLEAR * left.std(axis=0)
    return InjectionStatus.OK if moves.any() else InjectionStatus.STILL


@dataclass(frozen=True, eq=False)
class _Place:
    """A part of the picture around a point, and the motion that is put into it.

    Parameters
    ----------
    region
        The part with its margin [px].
    center
        The point in it, shape (2,) [px].
    shifts
        Motion of the point as it was tracked, shape (T, 2) [px].
    motion
        Motion to put in, shape (T, 2) [px].
    margin_px
        Width of the margin [px].
    side
        Side of the subset [px].
    """

    region: Region
    center: FloatArray
    shifts: FloatArray
    motion: FloatArray
    margin_px: int
    side: int

    @classmethod
    def plan(cls, position: FloatArray, side: int, codec: str) -> "_Place":
        """The place of a point with these positions, shape (T, 2) [px]; its blocks are those of the recording."""
        motion = smooth_motion(position)
        motion *= min(1.0, _MOST_PX / max(float(np.abs(motion).max()), 1e-9))
        largest = int(np.ceil(np.abs(motion).max()))
        reach, grid, margin = side // 2 + _MARGIN_PX + largest, _GRID_PX[codec], _OUTSIDE_PX + largest
        low = np.floor((position[0] - reach) / grid) * grid
        high = np.ceil((position[0] + reach + 1) / grid) * grid
        x, y = (low - margin).astype(int).tolist()
        width, height = (high - low + 2 * margin).astype(int).tolist()
        start = position[0] - [x, y]
        return cls(Region(x, y, width, height), start, position - position[0], -motion, margin, side)

    @property
    def subset(self) -> Region:
        """What is compared, in pixels of the whole picture."""
        x, y = (np.rint(self.center) - self.side // 2 + [self.region.x, self.region.y]).astype(int).tolist()
        return Region(x, y, self.side, self.side)

    @property
    def encoded(self) -> Region:
        """What is encoded, in pixels of the whole picture."""
        margin = self.margin_px
        width, height = self.region.width - 2 * margin, self.region.height - 2 * margin
        return Region(self.region.x + margin, self.region.y + margin, width, height)


@dataclass(frozen=True, eq=False)
class _Injection:
    """The injection of one point.

    Parameters
    ----------
    clip, crop
        The recording, and the luma of the place, shape (T, H, W).
    place
        Where.
    tracker, design
        Tracker, and the design of the subset where it takes one.
    across
        Unit vector across an edge, shape (2,); ``None`` for a point that is seen in all directions.
    """

    clip: CodedClip
    crop: LumaArray
    place: _Place
    tracker: Any
    design: SubsetDesign | None
    across: FloatArray | None

    def run(self) -> tuple[Gain, Gain] | None:
        """Gains along both directions, of all passes but the first; ``None`` where the point is lost."""
        place, intra = self.place, self.clip.frame_types == 1
        wanted = measure_looks(self.crop, place.center, place.shifts, intra, place.side)
        source = Source.estimate(self.crop, place.shifts, noise=wanted.noise, margin_px=place.margin_px)
        encoder = ClipEncoder.of(self.clip, place.subset, place.encoded)
        found = []
        for number in range(_PASSES):
            pictures = source.render(place.motion, self.clip.bit_depth, np.random.default_rng([number, place.side]))
            luma = encoder.run(pictures)
            gains, shifts = self._measure(luma)
            if np.isfinite(shifts).all(axis=1).sum() < _FEWEST:
                return None
            if number > 0:
                found.append(gains)
            if number < _PASSES - 1:
                got = measure_looks(luma, place.center - place.margin_px, shifts, intra, place.side)
                source = source.corrected(wanted, got)
        believed = None if self.design is None else self.design.mask
        believed = np.ones((place.side, place.side), np.bool_) if believed is None else believed
        share = _LOSS_SHARE if encoder.by_quality else _LOSS_SHARE_UNKNOWN
        mixed = source.share_still(place.center, believed) > _MIXED
        if mixed or source.share_still(place.center, np.ones_like(believed)) > _MIXED_AROUND:
            share = _LOSS_SHARE_MIXED
        first, second = (combine_gains(one, loss_share=share) for one in zip(*found, strict=True))
        return first, second

    def _measure(self, luma: LumaArray) -> tuple[tuple[Gain, Gain], FloatArray]:
        """Gains along both directions in a clip, and the motion that was tracked in it, shape (T, 2) [px]."""
        place, start = self.place, self.place.center - self.place.margin_px
        video = video_in_memory(luma, fps=_FEWEST / 2.0, bit_depth=self.clip.bit_depth)
        options = {"designs": [self.design]} if self.design is not None else {}
        tracks = self.tracker.track(video, start[None], names=["injected"], **options)
        shifts = trusted_values(tracks, "position")[:, 0] - start
        first, second = (
            compute_gain(shifts @ direction, place.motion @ direction) for direction in find_directions(self.across)
        )
        return (first, second), shifts


def find_directions(across: FloatArray | None) -> FloatArray:
    """Directions in which gains are stated, as rows of shape (2, 2): u and v, or across an edge and along it.

    Parameters
    ----------
    across
        Unit vector across the edge, shape (2,).

    Examples
    --------
    >>> find_directions(np.array([0.6, 0.8])).tolist()
    [[0.6, 0.8], [-0.8, 0.6]]
    """
    return np.eye(2) if across is None else np.array([across, [-across[1], across[0]]])


def _describe(
    tracks: xr.Dataset,
    found: Mapping[int, tuple[Gain, Gain]],
    states: list[InjectionStatus],
) -> xr.Dataset:
    """What was found, as variables of the points."""
    count = tracks.sizes["point"]
    gains, stds, noises = (np.full((count, 2), np.nan) for _ in range(3))
    edges = [across if edge else None for across, edge in zip(edges_across(tracks), find_edges(tracks), strict=True)]
    for point, both in found.items():
        for direction, one in enumerate(both if edges[point] is None else both[:1]):
            gains[point, direction], stds[point, direction], noises[point, direction] = one.gain, one.std, one.noise
        if not np.isfinite(gains[point]).any():
            states[point] = InjectionStatus.STILL
    dims = ("point", "direction")
    return xr.Dataset(
        {
            "injected_gain": (dims, gains, {"units": "1"}),
            "injected_gain_std": (dims, stds, {"units": "1"}),
            "injected_noise": (dims, noises, {"units": "px"}),
            "injected_direction": ((*dims, "pixel"), np.array([find_directions(edge) for edge in edges])),
            "injection_status": ("point", np.array([str(state) for state in states], dtype=object)),
        },
        coords={"point": tracks["point"].values, "pixel": tracks["pixel"].values},
    )
