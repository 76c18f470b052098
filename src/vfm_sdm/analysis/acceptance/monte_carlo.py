"""The budget of uncertainty by Monte Carlo, beside the linear one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

from vfm_sdm.analysis.acceptance.records import Acceptance, AcceptanceRow
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.covariances import find_edges
from vfm_sdm.core.datasets import FIRST_SAMPLE, Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.rig_draws import RigDraws, draw_normal
from vfm_sdm.geometry.visibility import see_points
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["BudgetModel", "check_budget"]

SOURCES = ("random", "cameras", "synchronization", "origin")
"""Components of the budget that the tracks, clocks and cameras go through; the others are stated, not propagated."""
_AGREEMENT = 0.05
"""Largest distance between the ends of both intervals, as a share of the linear expanded uncertainty."""
_FEWEST_TRIALS = 10_000
_BLOCK = 20_000
"""Trials that are computed at once."""
_TAIL = 0.02275
"""Probability beyond two standard deviations on one side of a normal distribution."""
_ORIGIN = 1e-3
"""Share of the usual standard deviation below which a sample is its own origin [1]."""
_MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class BudgetModel:
    """What a displacement was computed from, as far as its uncertainty is propagated.

    Parameters
    ----------
    displacement, unrefined
        The result with its budget, and what the images alone gave, shape (T, P, 3) [mm].
    tracks
        Synchronised tracks before any refinement, shape (V, T, P, 2) [px], with ``origin_covariance`` [px2],
        ``clock_offset_std`` [s] and, where known, ``place_std`` [px].
    rig
        Metric cameras.
    rotation
        ``structure_from_cam1``, or the identity, shape (3, 3) [1].
    covariance
        Of camera parameters and axes, shape (10 V + 3, 10 V + 3); ``None`` where nothing is known of it.
    """

    displacement: xr.Dataset
    unrefined: xr.Dataset
    tracks: xr.Dataset
    rig: Rig
    rotation: FloatArray
    covariance: FloatArray | None


@dataclass(frozen=True, eq=False)
class _Sample:
    """One frame of a point: all that its trials need.

    Parameters
    ----------
    rest, motion
        Position at displacement zero [m] and displacement [m], shape (3,), along the result's axes.
    noise, origin
        Covariances of the pixels in this frame and of the origin, shape (V, 2, 2) [px2].
    place_std
        Standard deviation of the place in each view, shape (V, 2) [px].
    splines, time_s, start_s
        Position in each view over time, time of the sample, and of the origin [s]: ``None`` where a still interval
        holds it.
    gain
        From displacement as the images alone give it to the result, shape (3, 3) [1].
    weights
        Factors of the views, shape (V,) [1].
    """

    rest: FloatArray
    motion: FloatArray
    noise: FloatArray
    origin: FloatArray
    place_std: FloatArray
    splines: tuple[CubicSpline | None, ...]
    time_s: float
    start_s: float | None
    gain: FloatArray
    weights: FloatArray


def check_budget(model: BudgetModel, *, trials: int = 100_000, seed: int = 0) -> Acceptance:
    """Intervals of displacement by Monte Carlo, beside those of the linear budget.

    Parameters
    ----------
    model
        The result, and what it was computed from.
    trials
        Number of trials.
    seed
        Seed of the trials.

    Returns
    -------
    acceptance
        A row for each point and axis: the largest distance between the ends of the two 95 % intervals over the linear
        expanded uncertainty, limit 5 %, at the sample of the axis's largest displacement and at the point's fastest
        one, whichever is worse. ``details["points"]`` states both uncertainties [mm], the wider one, and the component
        that differs where they do not agree.

    Raises
    ------
    DatasetError
        There are too few trials, or the result holds no budget.

    Notes
    -----
    Propagation of distributions [1]_, and its comparison with the law of propagation of uncertainty (section 8). In
    each trial the cameras and axes, the places of the points, the pixels of the sample and of the origin, and the
    offset of each clock are drawn from normal distributions with the stated covariances; pixels follow the tracks over
    time where a clock is off; the sample and its origin are triangulated with the drawn cameras. What the budget adds
    beside (assumption, compression, subset) is stated there and not propagated; a refinement counts by its gain.
    Points that a view sees across an edge only are left out.

    References
    ----------
    .. [1] JCGM 101:2008. Evaluation of measurement data: supplement 1 to the GUM: propagation of distributions using a
       Monte Carlo method.
    """
    if trials < _FEWEST_TRIALS:
        raise DatasetError(
            f"trials: expected {_FEWEST_TRIALS} or more, got {trials}: with fewer the ends of an interval scatter by "
            "more than 1 %; ask for more"
        )
    if "uncertainty" not in model.displacement:
        raise DatasetError("displacement: expected a budget of uncertainty, got none; run `vfm-sdm measure`")
    rows: list[AcceptanceRow] = []
    tables: dict[str, dict[str, Any]] = {}
    notes = []
    axes = [str(axis) for axis in model.displacement["axis"].values]
    for number, name in enumerate(map(str, model.displacement["point"].values)):
        chosen = _choose_samples(model, number)
        if not chosen:
            notes.append(f"{name}: no sample to propagate (none ok, or seen across an edge only)")
            continue
        samples = {frame: _make_sample(model, number, frame) for frame in set(chosen.values())}
        found = _Comparison(model, number, samples, trials, seed)
        for axis, axis_name in enumerate(axes):
            table = max((found.compare(axis, chosen[key]) for key in (axis, "fastest")), key=lambda t: t["apart"])
            tables.setdefault(name, {})[axis_name] = table
            rows.append(AcceptanceRow(f"{name} {axis_name}", "ends of intervals / U", table["apart"], _AGREEMENT, "1"))
    for name, of_point in tables.items():
        for axis_name, table in of_point.items():
            if table["apart"] > _AGREEMENT:
                notes.append(
                    f"{name} {axis_name}: U linear {table['linear_mm']:.4f} mm, by Monte Carlo "
                    f"{table['monte_carlo_mm']:.4f} mm, by its component {table['differs']!r}; the wider one counts: "
                    f"{table['stated_mm']:.4f} mm with all components"
                )
    limits = f"JCGM 101, section 8: {_AGREEMENT:.0%} of the linear expanded uncertainty, {trials} trials"
    return Acceptance("budget", limits, tuple(rows), tuple(notes), {"trials": trials, "seed": seed, "points": tables})


def _choose_samples(model: BudgetModel, point: int) -> dict[int | str, int]:
    """Frames of the largest displacement along each axis (0, 1, 2) and of the largest speed (``fastest``)."""
    data = model.displacement.isel(point=point)
    values = data["displacement"].values
    pixels = model.tracks["position"].values[:, :, point]
    linear = data["uncertainty"].sel(component="random").values
    usable = (data["status"].values == Status.OK) & np.isfinite(values).all(axis=-1) & np.isfinite(linear).all(axis=-1)
    usable &= np.isfinite(pixels).all(axis=-1).sum(axis=0) >= 2
    # Where displacement is zero by its definition there is no interval to compare.
    usable &= (linear > _ORIGIN * np.nanmedian(linear, axis=0)).all(axis=-1)
    if not usable.any() or find_edges(model.tracks)[point]:
        return {}
    amounts = np.where(usable[:, None], np.abs(values), -1.0)
    speed = np.linalg.norm(np.gradient(np.nan_to_num(values), data["time"].values, axis=0), axis=-1)
    fastest = int(np.where(usable, speed, -1.0).argmax())
    return {**{axis: int(frame) for axis, frame in enumerate(amounts.argmax(axis=0))}, "fastest": fastest}


def _make_sample(model: BudgetModel, point: int, frame: int) -> _Sample:
    """What the trials of one sample need."""
    data, tracks = model.displacement.isel(point=point), model.tracks.isel(point=point)
    motion = data["displacement"].values[frame] / _MM_PER_M
    ok = data["status"].values == Status.OK
    seen = np.isfinite(tracks["position"].values[:, frame]).all(axis=-1)
    covariance = model.tracks["position_covariance"].values
    sight = see_points(
        model.tracks["position"].values, covariance, model.tracks["status"].values == Status.OK, model.rig
    )
    if len(model.rig) > 2:
        seen = sight.used[:, frame, point]
    weights = np.ones(len(model.rig)) if sight.weights is None else sight.weights[:, point]
    views = len(model.rig)
    place = tracks["place_std"].transpose("view", "pixel").values if "place_std" in tracks else np.zeros((views, 2))
    stated, alone = (one.isel(point=point)["pixel_sensitivity"].values for one in (model.displacement, model.unrefined))
    gain = np.nan_to_num(stated).reshape(3, -1) @ np.linalg.pinv(np.nan_to_num(alone).reshape(3, -1))
    still = model.displacement.attrs.get("relative_to") != FIRST_SAMPLE
    return _Sample(
        rest=data["position"].values[frame] - motion,
        motion=motion,
        noise=np.where(seen[:, None, None], np.nan_to_num(covariance[:, frame, point]), np.nan),
        origin=np.nan_to_num(tracks["origin_covariance"].values),
        place_std=np.nan_to_num(place),
        splines=tuple(_interpolate(tracks.isel(view=view)) for view in range(views)),
        time_s=float(data["time"].values[frame]),
        start_s=None if still else float(data["time"].values[ok.argmax()]),
        gain=gain,
        weights=weights,
    )


def _interpolate(of_view: xr.Dataset) -> CubicSpline | None:
    """Position in one view over time, (2,) [px]; ``None`` of too few samples."""
    found = np.isfinite(of_view["position"].values).all(axis=-1)
    if found.sum() < 4:
        return None
    return CubicSpline(of_view["time"].values[found], of_view["position"].values[found])


class _Comparison:
    """Trials of the samples of one point, together and, where asked for, each source alone."""

    def __init__(self, model: BudgetModel, point: int, samples: Mapping[int, _Sample], trials: int, seed: int) -> None:
        self.model, self.samples, self.seed, self.trials = model, samples, seed, trials
        self.point = point
        budget = model.displacement["uncertainty"].isel(point=point)
        self.budget = {str(name): budget.sel(component=name).values for name in budget["component"].values}
        # Of cameras whose covariance nobody stated, the budget knows nothing, and there is nothing to draw.
        self.known = tuple(name for name in SOURCES if name != "cameras" or model.covariance is not None)
        self.errors = self._draw(self.known, trials)
        self._alone: dict[str, dict[int, FloatArray]] = {}

    def compare(self, axis: int, frame: int) -> dict[str, Any]:
        """Both expanded uncertainties of one sample and axis [mm], and how far the ends of the intervals are apart."""
        linear = COVERAGE_FACTOR * float(np.sqrt(sum(self.budget[name][frame, axis] ** 2 for name in self.known)))
        low, high = np.quantile(self.errors[frame][:, axis], [_TAIL, 1 - _TAIL])
        apart = max(abs(low + linear), abs(high - linear)) / linear if linear > 0 else float("nan")
        table: dict[str, Any] = {
            "time_s": self.samples[frame].time_s,
            "displacement_mm": float(self.samples[frame].motion[axis] * _MM_PER_M),
            "linear_mm": linear,
            "monte_carlo_mm": float((high - low) / 2),
            "mean_error_mm": float(self.errors[frame][:, axis].mean()),
            "apart": float(apart),
            "sources": list(self.known),
        }
        if apart > _AGREEMENT:
            table["differs"] = self._find_source(axis, frame)
        others = sum(part[frame, axis] ** 2 for name, part in self.budget.items() if name not in self.known)
        wider = max(linear, abs(low), abs(high))
        table["stated_mm"] = float(np.hypot(wider, COVERAGE_FACTOR * np.sqrt(others)))
        return table

    def _find_source(self, axis: int, frame: int) -> str:
        """The component whose trials, alone, differ most from what the budget states for it."""
        if not self._alone:
            self._alone = {name: self._draw((name,), _FEWEST_TRIALS) for name in self.known}
        variance = {name: float(np.mean(of[frame][:, axis] ** 2)) for name, of in self._alone.items()}
        return max(self.known, key=lambda name: abs(variance[name] - self.budget[name][frame, axis] ** 2))

    def _draw(self, sources: tuple[str, ...], trials: int) -> dict[int, FloatArray]:
        """Errors of each sample, shape (N, 3) [mm], under some of the sources."""
        # The cameras of a trial are the same for all points: each point begins the same sequence anew.
        rng = np.random.default_rng(self.seed)
        found: dict[int, list[FloatArray]] = {frame: [] for frame in self.samples}
        for start in range(0, trials, _BLOCK):
            trial = _Trial(self.model, sources, min(_BLOCK, trials - start), rng)
            for frame, sample in self.samples.items():
                found[frame].append(trial.errors(sample))
        return {frame: np.concatenate(parts) for frame, parts in found.items()}


class _Trial:
    """A block of N trials: cameras, axes and clocks that all samples share."""

    def __init__(self, model: BudgetModel, sources: tuple[str, ...], count: int, rng: np.random.Generator) -> None:
        self.sources, self.count, self.rng, self.rig = sources, count, rng, model.rig
        size = 10 * len(model.rig)
        drawn = np.zeros((count, size + 3))
        if "cameras" in sources and model.covariance is not None:
            drawn = draw_normal(model.covariance, count, rng)
        self.draws = RigDraws(model.rig, drawn[:, :size].reshape(count, len(model.rig), 10))
        self.turns, self.rotation = drawn[:, size:], model.rotation
        clocks = np.nan_to_num(model.tracks["clock_offset_std"].values) * ("synchronization" in sources)
        clocks[0] = 0.0
        self.late_s = clocks * rng.standard_normal((count, len(clocks)))

    def errors(self, sample: _Sample) -> FloatArray:
        """Errors of displacement of one sample, shape (N, 3) [mm]."""
        place = np.zeros((len(self.rig), self.count, 2))
        if "cameras" in self.sources:
            place = sample.place_std[:, None] * self.rng.standard_normal(place.shape)
        ends = []
        for position, noise, source, time_s in (
            (sample.rest, sample.origin, "origin", sample.start_s),
            (sample.rest + sample.motion, sample.noise, "random", sample.time_s),
        ):
            at = np.stack([camera.project(position @ self.rotation) for camera in self.rig.cameras])
            pixels = at[:, None] + place
            for view in range(len(self.rig)):
                if np.isnan(sample.noise[view]).any():
                    pixels[view] = np.nan
                    continue
                if source in self.sources:
                    pixels[view] += draw_normal(noise[view], self.count, self.rng)
                pixels[view] += self._late(sample, view, time_s)
            ends.append(self.draws.triangulate(pixels, weights=sample.weights))
        moved = (ends[1] - ends[0]) @ self.rotation.T
        # An error w of the axes turns a displacement d into d + w x d; what was refined follows by its gain.
        change = moved - sample.motion + np.cross(self.turns, moved)
        return np.asarray(change @ sample.gain.T * _MM_PER_M)

    def _late(self, sample: _Sample, view: int, time_s: float | None) -> FloatArray | float:
        """Motion in a view's picture while its clock is off, shape (N, 2) [px]."""
        spline = sample.splines[view]
        if time_s is None or spline is None or not self.late_s[:, view].any():
            return 0.0
        return np.asarray(spline(time_s + self.late_s[:, view]) - spline(time_s))
