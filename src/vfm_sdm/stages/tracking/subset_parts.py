"""Parts of subsets, followed by themselves: how far a subset's error and gain go beyond what its residuals say."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX, SubsetDesign, Warp
from vfm_sdm.stages.registration.subsets import RawRegistration, SubsetBank
from vfm_sdm.stages.tracking.injection.gains import compute_gain

__all__ = ["MOST_SAMPLES", "SubsetParts", "compute_disagreement", "compute_gain_spread", "judge_parts"]

_STRIPS = 4
"""Strips along each direction: the fewest that can be joined to halves."""
_EVERY, _RAREST = 2, 32
"""Frames between two measurements at the beginning of a recording, and between those of many segments."""
MOST_SAMPLES = 128
"""Measurements that are kept: enough for variances. Beyond, every second one is dropped and half as many are made, so
that the cost hardly grows with the length of a recording."""
_RECORDED = ("motion", "apart", "covariance", "point", "order", "freedoms")
_QUARTERS, _HALVES, _BALANCED = np.array([0, 1, 2, 3]), np.array([0, 0, 1, 1]), np.array([0, 1, 1, 0])
_OFTEN = 0.8
"""Share of the frames that show the whole in which a strip has to be found."""
_PLACE = 2
"""Parameters of a translation; with more, rotation or strain is measured."""
_FEWEST = 10
_CLEAR = 2.0
"""Times its noise by which a point must move for the gains of its parts to be compared."""


class SubsetParts:
    """Strips of every designed subset, four along each direction, registered by themselves.

    Parameters
    ----------
    reference
        Image that the subsets were taken from, shape (H, W).
    whole
        The bank of the whole subsets, with designs.
    executor
        Threads that share the work.
    segments
        Number of segments of the recording: each makes its share of the measurements that are kept of all.

    Notes
    -----
    A strip holds a quarter of the believed pixels, and only moves: rotation and strain are those of the whole. The
    directions are across an edge and along it, else u and v. Gains are compared between quarters, halves, and the outer
    two and the inner two; noise between halves. Where rotation and strain are measured, their errors move strips on
    both sides of the middle apart: noise is then that of the outer two and the inner two, which have one middle.
    """

    def __init__(self, reference: LumaArray, whole: SubsetBank, executor: Executor, segments: int = 1) -> None:
        self._whole, self._executor = whole, executor
        self._owners: list[tuple[int, int]] = []  # point, and direction of the strips' order
        designs: list[SubsetDesign | None] = []
        for point, design in enumerate(whole.designs or ()):
            for order, strips in enumerate([] if design is None else _cut_strips(design)):
                self._owners += [(point, order)] * len(strips)
                designs += strips
        self._rows = np.array([point for point, _ in self._owners], np.int64)
        self._bank = None
        if designs:
            self._bank = SubsetBank.prepare(reference, whole.points[self._rows], designs=designs, executor=executor)
        # As a recording in one piece would make them, but never so rarely that a short segment has none.
        self._every = min(_EVERY << (segments.bit_length() - 1), _RAREST)
        self._taken = self._every // 2 if segments > 1 else 0
        self._motion: list[FloatArray] = []
        self._strips: list[RawRegistration] = []

    def advance(self, luma: LumaArray, found: RawRegistration) -> None:
        """Takes the next frame, and where the whole subsets were found in it.

        Parameters
        ----------
        luma
            The frame, shape (H, W).
        found
            Registrations of the P whole subsets in it.
        """
        self._taken += 1
        if self._bank is None or self._taken % self._every != 0:
            return
        start = np.where(found.converged[:, None], found.warps, np.nan)
        rows = np.arange(len(self._rows))
        self._strips.append(self._bank.run(luma, rows, start[self._rows], executor=self._executor))
        self._motion.append(self._whole.position(found.rows, start) - self._whole.points)
        if len(self._motion) == MOST_SAMPLES:
            self._every *= 2
            self._motion, self._strips = self._motion[1::2], self._strips[1::2]

    def record(self) -> dict[str, Any]:
        """Measurements so far, as variables of a record of tracks.

        ``part_motion`` (sample, point, pixel) and ``part_apart`` (sample, strip, pixel) are how far the wholes and the
        strips moved [px], with ``part_covariance`` [px2]; ``part_point`` and ``part_order`` (strip) say whose strip one
        is, in which direction; ``part_freedoms`` (point) counts the parameters that a whole's warp has.
        """
        strips, samples = len(self._rows), len(self._motion)
        apart, covariance = np.zeros((samples, strips, 2)), np.zeros((samples, strips, 2, 2))
        if self._bank is not None and samples:
            found = self._bank.interpret(RawRegistration.joined(self._strips))
            apart = found.position.reshape(samples, strips, 2) - self._whole.points[self._rows]
            covariance = found.covariance.reshape(samples, strips, 2, 2)
        motion = np.stack(self._motion) if samples else np.zeros((0, len(self._whole), 2))
        return {
            "part_motion": (("sample", "point", "pixel"), motion, {"units": "px"}),
            "part_apart": (("sample", "strip", "pixel"), apart, {"units": "px"}),
            "part_covariance": (("sample", "strip", "pixel_a", "pixel_b"), covariance, {"units": "px2"}),
            "part_point": ("strip", self._rows),
            "part_order": ("strip", np.array([order for _, order in self._owners], np.int64)),
            "part_freedoms": ("point", self._whole.freedoms),
        }


def judge_parts(
    record: xr.Dataset, designs: Sequence[SubsetDesign | None], directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Disagreement of the strips of each point.

    Parameters
    ----------
    record
        With the variables of `SubsetParts.record`, of one pass or of several joined.
    designs
        Design of each of the P subsets.
    directions
        Directions that are judged, as rows, shape (P, 2, 2) [1]; of an edge only the first, across it.

    Returns
    -------
    noise, gain_std
        Standard deviation of the whole's position by the strips' scatter [px], and of the gain by the spread of theirs
        [1], shape (P, 2); NaN where it is not known, as where the motion is too small to tell a gain.
    """
    noise, gain_std = np.full((len(designs), 2), np.nan), np.full((len(designs), 2), np.nan)
    motion, places, covariances, rows, orders, freedoms = (record[f"part_{name}"].values for name in _RECORDED)
    if len(motion) < _FEWEST:
        return noise, gain_std
    for point, design in enumerate(designs):
        if design is None or not np.any(rows == point):
            continue
        turns = freedoms[point] > _PLACE
        of_noise = _BALANCED if turns else _HALVES
        for direction in range(1 if design.warp == Warp.EDGE else 2):
            along = directions[point, direction]
            found = []
            for order in (0, 1):
                mine = np.flatnonzero((rows == point) & (orders == order))
                variance = np.einsum("i,tkij,j->tk", along, covariances[:, mine], along)
                found.append(_judge(places[:, mine] @ along, variance, motion[:, point] @ along, of_noise))
            noises, spreads = np.array(found).T
            # Strips beside an edge hold little of it: they tell a motion of their own, but no noise of the whole.
            noise[point, direction] = noises[1] if design.warp == Warp.EDGE else np.fmax(noises[0], noises[1])
            gain_std[point, direction] = np.fmax(spreads[0], spreads[1])
    return noise, gain_std


def compute_disagreement(places: FloatArray, weights: FloatArray) -> float:
    """Standard deviation of the weighted mean of series, by how they scatter about it [px].

    Parameters
    ----------
    places
        Positions by K parts, shape (T, K) [px].
    weights
        Weights of the parts, of sum 1, shape (K,).

    Notes
    -----
    Sum of squares of ``w (q - mean) / sqrt(1 - w)``: unbiased for errors that are independent between the parts and
    have variances inverse to the weights, and little biased for others (MacKinnon and White, HC2). The middle over
    time counts, because a part that loses itself in some frames says little of the whole.

    References
    ----------
    .. [1] MacKinnon, J. G., White, H. (1985). Some heteroskedasticity-consistent covariance matrix estimators with
       improved finite sample properties. Journal of Econometrics 29(3), 305-325.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0, 0.1, (4000, 4))
    >>> round(compute_disagreement(noise, np.full(4, 0.25)), 2)
    0.05
    """
    left = places - np.median(places, axis=0)
    apart = left - (left @ weights)[:, None]
    spread = MAD_TO_STD * np.median(np.abs(apart), axis=0)
    return float(np.sqrt(np.sum(weights**2 * spread**2 / np.maximum(1 - weights, 1e-6))))


def compute_gain_spread(gains: FloatArray, stds: FloatArray, weights: FloatArray) -> float:
    """Standard deviation of gains among parts, beyond their own noise [1].

    Parameters
    ----------
    gains, stds
        Gain of each part and its standard deviation, shape (K,) [1].
    weights
        Weights of the parts, of sum 1, shape (K,).

    Notes
    -----
    The variance between parts in a model of random effects, by moments. The named point is one more part: it may have
    any of these gains, so that the spread does not fall with the number of parts.

    References
    ----------
    .. [1] DerSimonian, R., Laird, N. (1986). Meta-analysis in clinical trials. Controlled Clinical Trials 7, 177-188.

    Examples
    --------
    >>> part = np.full(4, 0.25)
    >>> round(compute_gain_spread(np.array([1.0, 0.9, 1.0, 0.9]), np.full(4, 0.01), part), 2)
    0.06
    >>> compute_gain_spread(np.array([1.0, 0.99, 1.01, 1.0]), np.full(4, 0.02), part)
    0.0
    """
    apart = float(weights @ (gains - weights @ gains) ** 2)
    noise = float(np.sum(weights * (1 - weights) * stds**2))
    return float(np.sqrt(max(apart - noise, 0.0) / max(1 - float(weights @ weights), 1e-6)))


def _judge(places: FloatArray, variance: FloatArray, motion: FloatArray, of_noise: IntArray) -> tuple[float, float]:
    """Noise [px] and spread of gains [1] by strips (T, K), with stated variances, about the whole's motion (T,).

    Groupings state of the four strips to which part they are joined. Noise is that of one of them, ``of_noise``:
    quarters lose themselves more easily than the whole, and neighbours err alike. Errors of rotation and strain do not
    go with the motion, so that gains are compared in all.
    """
    seen = np.isfinite(motion)
    known = np.isfinite(places) & np.isfinite(variance) & (variance > 0)
    kept = known.sum(axis=0) >= _OFTEN * max(int(seen.sum()), 1)
    frames = np.asarray(known[:, kept].all(axis=1) & seen)
    if not kept.any() or frames.sum() < _FEWEST:
        return np.nan, np.nan
    information = 1 / np.median(variance[frames][:, kept], axis=0)
    apart, moved = places[frames][:, kept] - motion[frames, None], motion[frames]
    noise, spread = np.nan, np.nan
    for grouping in (_QUARTERS, _HALVES, _BALANCED):
        groups = (np.unique(grouping)[:, None] == grouping[kept]) * information
        weights = groups.sum(axis=1)
        groups, weights = groups[weights > 0], weights[weights > 0]
        if len(weights) < 2 or (grouping is _BALANCED and not kept.all()):
            continue
        joined = apart @ (groups / weights[:, None]).T
        scatter, of_gain = _compare(joined, weights, moved)
        noise = scatter if grouping is of_noise else noise
        spread = np.fmax(spread, of_gain)
    return float(noise), float(spread)


def _compare(apart: FloatArray, information: FloatArray, motion: FloatArray) -> tuple[float, float]:
    """Noise [px] and spread of gains [1] by parts (T, K), of information (K,), less the whole's motion (T,)."""
    weights = information / information.sum()
    noise = compute_disagreement(apart - np.outer(motion - motion.mean(), _slopes(apart, motion)), weights)
    if not motion.std() > _CLEAR * max(noise, float(information.sum()) ** -0.5):
        return noise, np.nan
    found = [compute_gain(column, motion) for column in apart.T]
    gains, stds = np.array([one.gain for one in found]), np.array([one.std for one in found])
    return noise, compute_gain_spread(gains, stds, weights)


def _slopes(series: FloatArray, motion: FloatArray) -> FloatArray:
    """Slopes of series (T, K) over a motion (T,), shape (K,)."""
    moved = motion - motion.mean()
    energy = float(moved @ moved)
    return moved @ series / energy if energy > 0 else np.zeros(series.shape[1])


def _cut_strips(design: SubsetDesign) -> list[list[SubsetDesign | None]]:
    """Strips of a subset in the order of both directions, with equal numbers of believed pixels."""
    side = np.arange(design.subset_px) - design.subset_px // 2
    u, v = np.meshgrid(side, side)
    first = np.array([1.0, 0.0]) if design.across is None else design.direction()
    believed = np.ones(u.shape, np.bool_) if design.mask is None else design.mask
    if np.count_nonzero(believed) < _STRIPS * FEWEST_BELIEVED_PX:
        return []
    warp = Warp.EDGE if design.warp == Warp.EDGE else Warp.TRANSLATION
    orders = first[0] * u + first[1] * v, first[0] * v - first[1] * u
    return [[replace(design, warp=warp, mask=mask) for mask in _split(believed, order)] for order in orders]


def _split(believed: BoolArray, order: FloatArray) -> list[BoolArray]:
    """Masks of equal size of the believed pixels in an order, each of shape (S, S)."""
    rows, columns = np.nonzero(believed)
    masks = []
    for share in np.array_split(np.argsort(order[rows, columns], kind="stable"), _STRIPS):
        mask = np.zeros_like(believed)
        mask[rows[share], columns[share]] = True
        masks.append(mask)
    return masks
