"""What the motion of all points of a view says about its frames: repeated, missing, or with stamps that jitter."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.stats import theilslopes

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.tracking.frame_prediction import find_gaps

__all__ = ["FrameClock", "check_frames", "find_repeats", "find_skips"]

_LONG = 3.0
"""Times the usual interval of the stamps from which on frames are known to be missing."""
_FEWEST_FRAMES = 12
_STD_FLOOR_PX = 2e-3
"""Smallest standard deviation of a position [px]: below, the subsets' own systematic errors rule."""
_CLEAR = 50.0
"""Expected squared step over its noise from which on a step is clear: its ratio is then known to 1/7."""
_NOISE_SHARE = 4.0
_STOPPED = 0.1
"""Share of the smaller squared step before and after it below which a frame shows what the one before showed."""
_AS_ELSEWHERE = 0.25
"""Share of the usual squared step that must be expected: near a turning point motions of two kinds may cancel."""
_SKIP = 16.0
"""Squared bend of the motion over the largest about it from which on frames are missing there: four times."""
_LARGER = 2.5
"""Squared step over the larger of those before and after it: over one missing frame it is four."""
_SAME_GAP = 2
"""Frames between what is one gap by both of its signs."""
_ABOUT = 15
"""Frames to each side over which a bend is compared: half a second."""
_CADENCE = 1.0
"""Distance in frames of a repeat from an even cadence: a conversion of the rate rounds to a frame."""
_FEWEST_REPEATS = 4
_SHORTEST_CADENCE = 1.5
_MOST = 0.75
"""Share of the repeats found that must keep an even distance."""
_ROUNDED = 0.05
"""Share of an interval by which containers round stamps."""
_SMOOTHER = 0.5
_SMOOTH = 0.5
"""Correlation of steps with expected ones from which on motion rules, not noise: of white noise it is -0.7."""


@dataclass(frozen=True)
class FrameClock:
    """What became of a view's frames.

    Parameters
    ----------
    tracks
        The tracks, shape (T, P, 2) [px]: without the frames that a conversion of the rate put in, on an even clock
        where the stamps jitter, and with status unreliable where single frames are repeated.
    facts
        ``repeated`` and ``skipped``: numbers of frames; ``remarks`` and ``doubts``: sentences.
    """

    tracks: xr.Dataset
    facts: dict[str, Any] = field(default_factory=dict)


def check_frames(tracks: xr.Dataset, *, alike: Sequence[int] = ()) -> FrameClock:
    """Tracks of a view whose frames the motion of all its points agrees with, and what was found.

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px], with their covariances.
    alike
        Numbers of the frames that hold the noise of the frame before, from 0, of T.

    Notes
    -----
    Frames that hold the noise of the frame before show its motion, too, however small that is or noisy.

    Structures move smoothly from frame to frame. The step of all points into a frame is compared with that which the
    steps before and after it let expect (cubic interpolation): near nothing, and the frame repeats the one before,
    whatever a codec made of its pixels; far more, and frames are missing that the stamps do not show. A conversion of
    the rate repeats frames at an even distance; the others are then an even time apart. Where the motion goes on as it
    was to be some frames later, those are missing, too (`find_gaps`). Only motion clear of its noise shows any of it.
    """
    steps = _Steps.of(tracks)
    facts: dict[str, Any] = {"repeated": 0, "skipped": 0, "remarks": [], "doubts": []}
    same: IntArray = np.array([k for k in alike if k < tracks.sizes["time"]], np.int64)
    repeats: IntArray = np.zeros(0, np.int64)
    if steps is not None:
        tracks = _even_stamps(tracks, steps, facts)
        steps = _Steps.of(tracks) or steps
        repeats = find_repeats(steps.step, steps.usable)
    if repeats.size or same.size:
        tracks = _without_repeats(tracks, repeats, same, facts)
        steps = _Steps.of(tracks) or steps
    if steps is None:
        return FrameClock(tracks, facts)
    skips = _find_all_skips(steps)
    # A frame in place of a lost one is followed by a step of two.
    about = np.concatenate([repeats, same, repeats + 1, same + 1])
    skips = skips[~np.isin(skips, about)] if facts["doubts"] else skips
    if skips.size:
        facts["skipped"] = int(skips.size)
        at = ", ".join(f"{tracks['time'].values[k]:.2f}" for k in skips[:5])
        facts["doubts"].append(
            f"all points jump at once at {at} s: frames are missing there that the time stamps do not show, and the "
            "time after is wrong; film at a lower rate or with a faster card, and measure the parts between alone"
        )
    return FrameClock(tracks, facts)


def _find_all_skips(steps: "_Steps") -> IntArray:
    """Frames before which others are missing, by how large the step is or by how the motion goes on."""
    large = find_skips(steps.step, steps.usable)
    position = np.concatenate([np.zeros((1, steps.step.shape[1])), np.cumsum(steps.step, axis=0)])
    gaps = find_gaps(position, np.concatenate([[True], steps.usable]))
    apart = np.abs(gaps[:, None] - large[None, :]) > _SAME_GAP
    return np.union1d(large, gaps[apart.all(axis=1)]).astype(np.int64)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of all points from frame to frame over their noise, shape (T - 1, 2 P) [1], and where they are known."""

    step: FloatArray
    usable: BoolArray

    @classmethod
    def of(cls, tracks: xr.Dataset, time_s: FloatArray | None = None) -> "_Steps | None":
        """Steps in a nominal interval of the stamps; ``None`` where there are too few."""
        time_s = tracks["time"].values if time_s is None else time_s
        if len(time_s) < _FEWEST_FRAMES:
            return None
        interval = np.diff(time_s)
        step = np.diff(tracks["position"].values, axis=0) * (np.median(interval) / interval)[:, None, None]
        variance = np.einsum("tpkk->tpk", tracks["position_covariance"].values)
        variance = np.where(variance > 0, variance, np.nan)
        known = np.isfinite(variance).any(axis=0)
        std = np.sqrt(np.nanmedian(np.where(known, variance, 1.0), axis=0)).clip(_STD_FLOOR_PX)
        ok: BoolArray = np.asarray(tracks["status"].values == Status.OK)
        good = ok.mean(axis=0) > 0.5
        if not good.any():
            return None
        found = (step / (np.sqrt(2) * std))[:, good]
        # Over a gap that the stamps show, motion does not go on; the steps beside it are compared with that over it.
        gap = np.convolve(interval > _LONG * np.median(interval), np.ones(5), "same") > 0
        usable = np.isfinite(found).all(axis=(1, 2)) & ~gap
        return cls(np.nan_to_num(found.reshape(len(found), -1)), usable)


def _expected(step: FloatArray) -> FloatArray:
    """Steps that those before and after them let expect, shape (N, K); NaN for the two at each end."""
    expected = np.full(step.shape, np.nan)
    expected[2:-2] = (4 * (step[1:-3] + step[3:-1]) - step[:-4] - step[4:]) / 6
    return expected


def find_repeats(step: npt.NDArray[np.float64], usable: npt.NDArray[np.bool_]) -> IntArray:
    """Frames that show what the frame before showed, while all points move.

    Parameters
    ----------
    step
        Step into each frame but the first, over its noise, shape (T - 1, K) [1].
    usable
        Whether it is known, shape (T - 1,).

    Returns
    -------
    frames
        Their numbers, from 0, of T.

    Examples
    --------
    >>> position = 40 * np.sin(2 * np.pi * 0.05 * np.arange(40))
    >>> position[21] = position[20]
    >>> find_repeats(np.diff(position)[:, None], np.ones(39, bool)).tolist()
    [21]
    """
    count = step.shape[1]
    if not _is_smooth(step, np.nan_to_num(_expected(step)), usable):
        return np.zeros(0, np.int64)
    found = (step**2).sum(axis=1)
    usual = float(np.median(np.maximum(found[usable] - count, 0.0)))
    # Both neighbours must say that the points move, and the same way: a jump on one side says nothing.
    moved = np.zeros(len(step))
    moved[1:-1] = np.minimum(found[:-2], found[2:]) - count
    onward = np.zeros(len(step), np.bool_)
    onward[1:-1] = (step[:-2] * step[2:]).sum(axis=1) > _SMOOTH * np.sqrt(found[:-2] * found[2:])
    clear = onward & (moved > max(_CLEAR, _NOISE_SHARE * count)) & (moved > _AS_ELSEWHERE * usual)
    return np.flatnonzero(clear & usable & (found < _STOPPED * moved)) + 1


def _is_smooth(step: FloatArray, expected: FloatArray, usable: BoolArray) -> bool:
    """Whether the steps go with what those about them let expect; of noise they go against it."""
    inner = usable.copy()
    inner[:2] = inner[-2:] = False
    a, b = step[inner], expected[inner]
    return bool((a * b).sum() > _SMOOTH * np.sqrt((a**2).sum() * (b**2).sum()))


def find_skips(step: npt.NDArray[np.float64], usable: npt.NDArray[np.bool_]) -> IntArray:
    """Frames before which others are missing, though nothing in their stamps says so.

    Parameters
    ----------
    step
        Step into each frame but the first, over its noise, shape (T - 1, K) [1].
    usable
        Whether it is known, shape (T - 1,).

    Returns
    -------
    frames
        Their numbers, from 0, of T.

    Notes
    -----
    Where an impact sets a structure in motion, its speed changes at once, but nothing moved before, or the step lies
    between those before and after it. Over missing frames of a structure that moves it is larger than both.

    Examples
    --------
    >>> position = np.delete(40 * np.sin(2 * np.pi * 0.05 * np.arange(60)), [20, 21])
    >>> find_skips(np.diff(position)[:, None], np.ones(57, bool)).tolist()
    [20]
    """
    count = step.shape[1]
    expected = np.nan_to_num(_expected(step))
    bend = ((step - expected) ** 2).sum(axis=1)
    energy = (step**2).sum(axis=1)
    found: list[int] = []
    if not _is_smooth(step, expected, usable):
        return np.zeros(0, np.int64)
    bend[:2] = bend[-2:] = 0.0
    clear = max(_CLEAR, _NOISE_SHARE * count)
    for k in np.flatnonzero(usable & (bend > clear)).tolist():
        first, last = max(k - _ABOUT, 0), k + _ABOUT + 1
        # What is missing bends the motion of the two frames to either side as well.
        about = np.concatenate([bend[first : max(k - 2, first)], bend[k + 3 : last]])
        least, sides = sorted((energy[k - 1], energy[k + 1]))
        # One point alone that jumps is a track that slipped.
        apart = (step[k] - expected[k]) ** 2
        together = apart.max() < 0.9 * bend[k] or count <= 2
        if about.size and bend[k] > _SKIP * about.max() and energy[k] > _LARGER * sides and together and least > clear:
            found.append(k + 1)
    return np.array(found, np.int64)


def _without_repeats(tracks: xr.Dataset, repeats: IntArray, same: IntArray, facts: dict[str, Any]) -> xr.Dataset:
    """Tracks without what a conversion of the rate put in; single repeats and frames of the ``same`` noise are marked.

    Motion alone tells the frames of a conversion: encoders pass kinds of frames on at an even distance, too.
    """
    time_s = tracks["time"].values
    inserted = _find_cadence(repeats, len(time_s))
    if inserted is not None and not _catches_up(tracks, inserted):
        keep = np.setdiff1d(np.arange(len(time_s)), inserted)
        interval = float(np.polyfit(np.arange(keep.size), time_s[keep], 1)[0])
        facts["repeated"] = int(inserted.size)
        facts["remarks"].append(
            f"every {np.diff(inserted).mean():.3g}th frame repeats the one before: converted from {1 / interval:.4g} "
            f"frames a second; {inserted.size} repeated frames are left out and the others are an even time apart"
        )
        return tracks.isel(time=keep).assign_coords(
            time=("time", time_s[0] + np.arange(keep.size) * interval, tracks["time"].attrs)
        )
    repeats = np.union1d(repeats, same)
    facts["repeated"] = int(repeats.size)
    status = tracks["status"].values.copy()
    rows = status[repeats]
    rows[rows == Status.OK] = Status.UNRELIABLE
    status[repeats] = rows
    facts["doubts"].append(
        f"{repeats.size} frames repeat the one before and their samples are not trusted; use the camera's original "
        "file, or a constant frame rate"
    )
    return tracks.assign(status=tracks["status"].copy(data=status))


def _find_cadence(repeats: IntArray, frames: int) -> IntArray | None:
    """All repeats of a conversion of the rate, found or not; ``None`` where those found keep no even distance.

    Near turning points nothing shows a repeat, and there others are taken for one: the cadence decides.
    """
    gaps = np.diff(repeats)
    if gaps.size < _FEWEST_REPEATS - 1:
        return None
    # Counted from the one in the middle.
    numbers = np.rint((repeats - repeats[len(repeats) // 2]) / np.median(gaps))
    if np.unique(numbers).size < _FEWEST_REPEATS - 1:
        return None
    slope, start, _, _ = theilslopes(repeats, numbers)
    fits = repeats[np.abs(repeats - start - slope * numbers) <= _CADENCE]
    if slope < _SHORTEST_CADENCE or len(fits) < max(_FEWEST_REPEATS, _MOST * len(repeats)):
        return None
    whole = round(slope)
    if abs(slope - whole) * frames / slope < 1:
        # As many frames apart each time: all where most are.
        phases, often = np.unique(fits % whole, return_counts=True)
        inserted = np.arange(phases[np.argmax(often)], frames, whole)
        return np.asarray(inserted[inserted > 0])
    first, last = np.ceil((1 - start) / slope), np.floor((frames - 1 - start) / slope)
    line = start + slope * np.arange(first, last + 1)
    apart = np.abs(line[:, None] - fits[None])
    nearest = fits[apart.argmin(axis=1)]
    return np.unique(np.where(apart.min(axis=1) <= _CADENCE, nearest, np.rint(line).astype(np.int64)))


def _catches_up(tracks: xr.Dataset, repeats: IntArray) -> bool:
    """Whether the motion makes up for a repeat in the next frame, as of one that was put in place of a lost one."""
    steps = _Steps.of(tracks)
    if steps is None:
        return False
    inner = repeats[(repeats >= 3) & (repeats < len(steps.step) - 2)]
    # Step number k leads into frame k + 1.
    after, beyond = steps.step[inner], (steps.step[inner - 2] + steps.step[inner + 1]) / 2
    share = (after * beyond).sum(axis=1) / np.maximum((beyond**2).sum(axis=1), 1e-9)
    return bool(share.size) and float(np.median(share)) > 1.5


def _even_stamps(tracks: xr.Dataset, steps: _Steps, facts: dict[str, Any]) -> xr.Dataset:
    """Tracks on an even clock, where their stamps jitter about one and the motion does not."""
    time_s = tracks["time"].values
    count = np.arange(len(time_s))
    interval, start = np.polyfit(count, time_s, 1)
    off = time_s - (start + interval * count)
    if np.abs(off).max() <= _ROUNDED * interval or np.abs(off).max() >= interval:
        return tracks
    even = _Steps.of(tracks, start + interval * count)
    if even is None:
        return tracks
    bends = []
    for one in (steps, even):
        bend = np.nan_to_num(((one.step - _expected(one.step)) ** 2).sum(axis=1))[one.usable]
        bends.append(float(np.mean(np.maximum(bend - 2 * one.step.shape[1], 0.0))))
    if bends[0] < _CLEAR or bends[1] > _SMOOTHER * bends[0]:
        return tracks
    facts["remarks"].append(
        f"time stamps jitter by {1e3 * float(np.std(off)):.1f} ms (rms) while the motion runs evenly: an even clock of "
        f"{1 / interval:.5g} frames a second is used"
    )
    clock = interval * count
    return tracks.assign_coords(time=("time", time_s[0] + clock, tracks["time"].attrs))
