"""Uncertainty of displacement: a budget of named components for each sample, after the GUM."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import xarray as xr
from scipy.stats import norm

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.covariances import edges_across, measured_axes
from vfm_sdm.core.datasets import Status, check_displacement, check_tracks
from vfm_sdm.errors import DatasetError

__all__ = ["COMPONENTS", "COVERAGE_FACTOR", "BudgetInputs", "add_uncertainty", "compression_gain_std"]

COMPONENTS = ("random", "cameras", "synchronization", "assumption", "compression", "subset", "origin")
"""Components of the budget. Random: scatter of the tracks. Cameras: focal lengths, pose, baseline, lengths of the site
and axes. Synchronization: offset between the views. Assumption: motion along the axis that the refinement suppresses.
Compression: the loss of every motion in a video codec. Subset: motion beside the point that its subset
holds, by the spread of the gains of its parts. Origin: the position that displacement is relative to."""
COVERAGE_FACTOR = 2.0
"""Factor k of the expanded uncertainty, for about 95 % of a normal distribution."""

# Bits a pixel, and the share of motion that H.264 lost there (docs/decisions/008-compression.md).
_BITS = np.array([0.07, 0.31, 1.26, 2.81])
_GAIN_LOSS = np.array([0.020, 0.012, 0.007, 0.001])
_FEWEST_SAMPLES = 10
_CHANCE = 0.05
"""Probability with which noise alone may pass for motion at some frequency of a series."""
_SIGNIFICANT = 2.0
"""Standard deviations beyond which a series holds more than its noise."""


@dataclass(frozen=True, eq=False)
class BudgetInputs:
    """Sources of uncertainty beside the displacement dataset itself.

    Parameters
    ----------
    tracks
        Synchronised tracks before any refinement, with a dim ``view``, shape (V, T, P, 2) [px].
    clock_std_s
        Standard deviation of each view's offset by view name [s]; NaN where it is not known; views that are not named
        have none.
    bits_per_pixel
        Size of each view's recording over its pixels, by view name [bit]; views that are not named count as not
        compressed.
    baseline
        Displacement from the same tracks without refinement, and the axis that the refinement suppresses; ``None``
        when there was no refinement.
    refinement_gain
        Gain from displacement as the images alone give it to refined displacement, shape (P, 3, 3) [1]; NaN where a
        point was not refined.
    gain_difference
        Difference of each point's motion between two views
        (`vfm_sdm.stages.displacement.agreement.compute_gain_difference`), shape (P,) [1]; NaN where it is not known.
    """

    tracks: xr.Dataset
    clock_std_s: Mapping[str, float] = field(default_factory=dict)
    bits_per_pixel: Mapping[str, float] = field(default_factory=dict)
    baseline: tuple[xr.Dataset, str] | None = None
    refinement_gain: FloatArray | None = None
    gain_difference: FloatArray | None = None


def add_uncertainty(displacement: xr.Dataset, inputs: BudgetInputs) -> xr.Dataset:
    """The dataset with the uncertainty budget of every sample.

    Parameters
    ----------
    displacement
        Result of `vfm_sdm.stages.displacement.stereo.compute_displacement`, shape (T, P, 3) [mm].
    inputs
        Further sources.

    Returns
    -------
    displacement
        The dataset with ``uncertainty``, standard deviations of shape (7, T, P, 3) [mm]; and with ``combined_std`` and
        ``expanded_uncertainty``, shape (T, P, 3) [mm]. NaN where a component is not known, such as the cameras of a
        file that states no covariance. ``uncertainty_estimated``, shape (7, P), says whether there was anything to
        estimate a component from: where not, it counts as zero, which nobody measured.

    Raises
    ------
    DatasetError
        The tracks are not those of the displacement.

    Notes
    -----
    With the displacement d, its sensitivity J to the pixels and the covariance C_a of the gains of axis a:

    - random: ``displacement_std``;
    - cameras: ``sqrt(d' C_a d)``, zero at rest and growing with the motion;
    - synchronization: an offset wrong by tau moves view v's pixels by ``velocity tau``: ``|J_v velocity_v| tau``;
    - assumption: true motion z along the suppressed axis is missing there and leaks into the others, by the column of
      the refinement's gain for that axis, less 1 on the diagonal. z is not known; its variance is what the baseline's
      displacement along that axis has beyond its stated noise, at the frequencies at which the point is seen to move
      along any axis. The variance of noise at m of these frequencies is known to ``sqrt(1 / m)`` of itself, and that
      of z is not negative: it is stated as its expectation under both. Where the whole series has significantly more
      than noise, all of that counts. What an offset of the clocks within its standard deviation explains of z is taken
      off first: it follows the velocity, while motion in a mode is in phase along all axes;
    - compression: where the gain of the point was measured by injected motion (``gain_left_std`` of the tracks), the
      standard deviation of what is left of it in each view and direction, through J, on the motion in the picture that
      belongs to d; else `compression_gain_std` of the poorest view, times ``|d|``. At least half of what one view shows
      more than another, because noise takes bits too, and a dark view loses more than its size tells;
    - subset: where parts of the subsets were compared (``part_gain_std`` of the tracks), the spread of their gains in
      each view and direction, through J in the same way;
    - origin: the covariance of the origin (``origin_covariance`` of the tracks,
      `vfm_sdm.stages.displacement.origin.include_origin`) through J, the same for all samples.

    Of more than two views, J and C_a are those of the views that a sample comes from. Components are taken as
    independent and add as squares. All but the first are systematic: they do not average out over a series.

    References
    ----------
    .. [1] JCGM 100:2008. Evaluation of measurement data: guide to the expression of uncertainty in measurement (GUM).
    """
    check_displacement(displacement)
    tracks = check_tracks(inputs.tracks, synchronized=True)
    if list(tracks["point"].values) != list(displacement["point"].values):
        raise DatasetError("tracks: expected the points of the displacement; pass the tracks that it came from")
    values = displacement["displacement"].values
    # What moves along an axis that is not measured is not known; its share in the others is part of their scatter.
    known = np.where(np.isfinite(values).any(axis=-1, keepdims=True), np.nan_to_num(values), np.nan)
    parts = {
        "random": displacement["displacement_std"].values,
        "cameras": _apply_by_views(
            displacement,
            "gain_covariance",
            lambda gains: np.sqrt(np.maximum(np.einsum("tpb,pabc,tpc->tpa", known, gains, known), 0.0)),
        ),
        "synchronization": _compute_clock_std(displacement, tracks, inputs.clock_std_s),
        "assumption": _compute_assumption_std(displacement, tracks, inputs),
        "compression": _compute_compression_std(displacement, tracks, inputs),
        "subset": _compute_subset_std(displacement, tracks),
        "origin": _compute_origin_std(displacement, tracks),
    }
    budget = np.stack([parts[name] for name in COMPONENTS])
    combined = np.sqrt(np.sum(budget**2, axis=0))
    dims, units = ("time", "point", "axis"), {"units": "mm"}
    return displacement.assign(
        uncertainty=(("component", *dims), budget, units),
        uncertainty_estimated=(("component", "point"), _list_estimated(tracks, inputs)),
        combined_std=(dims, combined, units),
        expanded_uncertainty=(dims, COVERAGE_FACTOR * combined, {**units, "coverage_factor": COVERAGE_FACTOR}),
    ).assign_coords(component=list(COMPONENTS))


def _list_estimated(tracks: xr.Dataset, inputs: BudgetInputs) -> BoolArray:
    """Whether there was anything to estimate each component of each point from, shape (7, P)."""
    every: BoolArray = np.ones(tracks.sizes["point"], dtype=np.bool_)
    found: dict[str, BoolArray] = dict.fromkeys(COMPONENTS, every)
    found["synchronization"] = every & any(std != 0 for std in inputs.clock_std_s.values())
    found["assumption"] = ~every
    if inputs.baseline is not None and inputs.refinement_gain is not None:
        found["assumption"] = np.asarray(np.isfinite(inputs.refinement_gain).all(axis=(1, 2)))
    sources = [every & any(np.isfinite(bits) for bits in inputs.bits_per_pixel.values())]
    sources += [_is_gain_known(tracks)] if "gain_left_std" in tracks else []
    found["compression"] = np.logical_or.reduce(sources)
    spread = tracks["part_gain_std"].transpose("view", "point", ...).values if "part_gain_std" in tracks else None
    found["subset"] = ~every if spread is None else np.isfinite(spread).any(axis=(0, 2))
    found["origin"] = every & ("origin_covariance" in tracks)
    return np.stack([found[name] for name in COMPONENTS])


def compression_gain_std(bits_per_pixel: float) -> float:
    """Relative standard deviation of the gain of motion in compressed video [1]; 0 for no compression.

    Parameters
    ----------
    bits_per_pixel
        Size of the H.264 recording over its pixels [bit]; infinite where it is not compressed.

    Notes
    -----
    Measured on rendered recordings: the loss of gain itself, as the standard deviation of a correction that is not
    made, because it depends on the encoder. Between the measured sizes it is interpolated in their logarithm; beyond
    the largest it falls on with the inverse of the size.

    Examples
    --------
    >>> compression_gain_std(float("inf")), round(compression_gain_std(0.31), 4)
    (0.0, 0.012)
    """
    if not np.isfinite(bits_per_pixel):
        return 0.0
    if bits_per_pixel > _BITS[-1]:
        return float(_GAIN_LOSS[-1] * _BITS[-1] / bits_per_pixel)
    return float(np.interp(np.log(max(bits_per_pixel, 1e-9)), np.log(_BITS), _GAIN_LOSS))


def _compute_compression_std(displacement: xr.Dataset, tracks: xr.Dataset, inputs: BudgetInputs) -> FloatArray:
    """Standard deviation from the gain of each point's motion in compressed recordings, shape (T, P, 3) [mm]."""
    values = np.abs(displacement["displacement"].values)
    by_size = compression_gain_std(min(inputs.bits_per_pixel.values(), default=np.inf))
    found = np.broadcast_to(by_size * values, values.shape)
    if "gain_left_std" in tracks:
        measured = _spread_gains(displacement, tracks, "gain_left_std")
        known = _is_gain_known(tracks)[:, None]
        found = np.where(known, measured, found)
    elif by_size == 0:
        return found
    if inputs.gain_difference is None:
        return found
    return np.asarray(np.fmax(found, np.abs(inputs.gain_difference)[:, None] / 2 * values))


def _is_gain_known(tracks: xr.Dataset) -> BoolArray:
    """Whether injection measured all gains of a point, shape (P,); along an edge there is none to measure."""
    known = np.isfinite(tracks["gain_left_std"].values)
    known[..., 1] |= np.isfinite(edges_across(tracks)).all(axis=-1)
    return np.asarray(known.all(axis=(0, 2)))


def _compute_subset_std(displacement: xr.Dataset, tracks: xr.Dataset) -> FloatArray:
    """Standard deviation from gains that differ over the subsets, shape (T, P, 3) [mm]."""
    if "part_gain_std" not in tracks:
        return np.zeros(displacement["displacement"].shape)
    return _spread_gains(displacement, tracks, "part_gain_std")


def _compute_origin_std(displacement: xr.Dataset, tracks: xr.Dataset) -> FloatArray:
    """Standard deviation from the origin of each series, shape (T, P, 3) [mm]."""
    shape = displacement["displacement"].shape
    if "origin_covariance" not in tracks:
        return np.zeros(shape)
    covariance = tracks["origin_covariance"].transpose("view", "point", ...).values

    def effect(per_px: FloatArray) -> FloatArray:
        J = np.nan_to_num(per_px)
        return np.broadcast_to(np.sqrt(np.einsum("pavk,vpkl,pavl->pa", J, covariance, J)), shape)

    return _apply_by_views(displacement, "pixel_sensitivity", effect)


def _spread_gains(displacement: xr.Dataset, tracks: xr.Dataset, name: str) -> FloatArray:
    """Standard deviation from gains of all views, of which the tracks state that, shape (T, P, 3) [mm]."""
    by_view = [_spread_gain(displacement, tracks, view, name) for view in range(tracks.sizes["view"])]
    return np.asarray(np.sqrt(np.sum(np.square(by_view), axis=0)))


def _spread_gain(displacement: xr.Dataset, tracks: xr.Dataset, view: int, name: str) -> FloatArray:
    """Standard deviation from the gains of one view, shape (T, P, 3) [mm]."""
    values = np.nan_to_num(displacement["displacement"].values)
    left = np.nan_to_num(tracks[name].values[view])
    directions = measured_axes(edges_across(tracks)[view])

    def effect(per_px: FloatArray) -> FloatArray:
        J = np.nan_to_num(per_px).reshape(len(per_px), 3, -1)
        # The motion in all pictures that belongs to a displacement: J times it is the displacement.
        in_pictures = np.einsum("pka,tpa->tpk", np.linalg.pinv(J), values).reshape(*values.shape[:2], -1, 2)
        along = np.einsum("pki,tpi->tpk", directions, in_pictures[:, :, view]) * left
        shares = np.einsum("pai,pki,tpk->tpak", np.nan_to_num(per_px[:, :, view]), directions, along)
        return np.asarray(np.sqrt(np.sum(shares**2, axis=-1)))

    return _apply_by_views(displacement, "pixel_sensitivity", effect)


def _compute_clock_std(displacement: xr.Dataset, tracks: xr.Dataset, clock_std_s: Mapping[str, float]) -> FloatArray:
    """Standard deviation from the views' offsets, shape (T, P, 3) [mm]."""
    return np.asarray(np.sqrt(np.sum(_compute_clock_patterns(displacement, tracks, clock_std_s) ** 2, axis=0)))


def _compute_clock_patterns(
    displacement: xr.Dataset, tracks: xr.Dataset, clock_std_s: Mapping[str, float]
) -> FloatArray:
    """Effect of one standard deviation of each view's offset on the displacement, shape (V, T, P, 3) [mm]."""
    patterns = np.zeros((tracks.sizes["view"], *displacement["displacement"].shape))
    for number, view in enumerate(tracks["view"].values):
        tau = clock_std_s.get(str(view), 0.0)
        if tau != 0:
            velocity = _compute_velocity(tracks["position"].values[number], tracks["time"].values)
            shift = _apply_by_views(displacement, "pixel_sensitivity", partial(_project_motion, velocity, number))
            patterns[number] = tau * np.nan_to_num(shift)
    return patterns


def _project_motion(motion: FloatArray, view: int, per_px: FloatArray) -> FloatArray:
    """Motion in one view's picture (T, P, 2) by its part of a sensitivity (P, 3, V, 2), shape (T, P, 3)."""
    return np.asarray(np.einsum("pak,tpk->tpa", per_px[:, :, view], motion))


def _apply_by_views(displacement: xr.Dataset, name: str, effect: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Effect of a variable on all samples, (T, P, 3), each by the value for the views that it comes from."""
    if "seen_by" not in displacement:
        return effect(displacement[name].values)
    seen_by, of_sets = displacement["seen_by"].values, displacement[f"{name}_seen_by"].values
    result = np.full(displacement["displacement"].shape, np.nan)
    for number, value in enumerate(of_sets):
        result = np.where((seen_by == number)[..., None], effect(value), result)
    return result


def _find_refined_samples(displacement: xr.Dataset, point: int) -> BoolArray:
    """Samples of a refined point that the refinement moved: those that its refined view sees, shape (T,)."""
    if "seen_by" not in displacement or "refined_view" not in displacement:
        return np.ones(displacement.sizes["time"], dtype=np.bool_)
    view = displacement["refined_view"].values[point]
    holds = displacement["visibility_views"].sel(view=view).values > 0
    seen_by = displacement["seen_by"].values[:, point]
    return np.asarray(np.where(seen_by >= 0, holds[seen_by], False))


def _compute_velocity(position: FloatArray, time_s: FloatArray) -> FloatArray:
    """Velocity of each point in one view, over missing samples from those around them, shape (T, P, 2) [px/s]."""
    velocity = np.full(position.shape, np.nan)
    for point in range(position.shape[1]):
        found = np.isfinite(position[:, point]).all(axis=-1)
        if found.sum() >= 3:
            velocity[found, point] = np.gradient(position[found, point], time_s[found], axis=0, edge_order=2)
    return velocity


def _compute_assumption_std(displacement: xr.Dataset, tracks: xr.Dataset, inputs: BudgetInputs) -> FloatArray:
    """Standard deviation from motion along the suppressed axis, shape (T, P, 3) [mm]."""
    result = np.zeros(displacement["displacement"].shape)
    if inputs.baseline is None or inputs.refinement_gain is None:
        return result
    before, name = inputs.baseline
    axis = [str(a) for a in displacement["axis"].values].index(name)
    removed = inputs.refinement_gain - np.eye(3)
    patterns = _compute_clock_patterns(before, tracks, inputs.clock_std_s)[..., axis]
    for point in range(result.shape[1]):
        if np.isfinite(removed[point]).all():
            hidden = _estimate_hidden_motion(before.isel(point=point), axis, patterns[:, :, point])
            moved = _find_refined_samples(displacement, point)[:, None]
            result[:, point] = np.where(moved, np.abs(removed[point, :, axis]) * hidden, 0.0)
    return result


def _estimate_hidden_motion(before: xr.Dataset, axis: int, patterns: FloatArray) -> float:
    """Standard deviation of the motion that one point's noisy series along an axis may hold [mm].

    Parameters
    ----------
    before
        Displacement of the point without refinement, shape (T, 3) [mm].
    axis
        Index of the axis.
    patterns
        Effect of one standard deviation of each clock on the series, shape (V, T) [mm].
    """
    values = before["displacement"].values
    ok = (before["status"].values == Status.OK) & np.isfinite(values).all(axis=-1)
    if ok.sum() < _FEWEST_SAMPLES:
        return float("nan")
    noise = np.mean(before["displacement_std"].values[ok] ** 2, axis=0)
    centred = np.where(ok[:, None], values - values[ok].mean(axis=0), 0.0)
    centred[:, axis] = _remove_patterns(centred[:, axis], patterns.T * ok[:, None], noise[axis])
    # One-sided: the frequencies above zero sum up to the variance.
    power = 2 * np.abs(np.fft.rfft(centred[:, axis])[1:]) ** 2 / (len(values) * ok.sum())
    moving = _find_moving_frequencies(centred, noise * ok.sum())

    def excess(chosen: BoolArray) -> tuple[float, float]:
        part = float(noise[axis] * np.mean(chosen))
        return float(power[chosen].sum()) - part, part * float(np.sqrt(2 / (np.mean(chosen) * ok.sum())))

    found, doubt = excess(np.ones_like(moving))
    if moving.any() and found < _SIGNIFICANT * doubt:
        found, doubt = excess(moving)
    return float(np.sqrt(_expect_not_negative(found, doubt)))


def _remove_patterns(series: FloatArray, patterns: FloatArray, noise: float) -> FloatArray:
    """The series, shape (T,), less the most probable sum of patterns, shape (T, V), with standard normal factors."""
    patterns = patterns[:, (np.isfinite(patterns) & (patterns != 0)).any(axis=0)]
    normal = patterns.T @ patterns + noise * np.eye(patterns.shape[1])
    return np.asarray(series - patterns @ np.linalg.solve(normal, patterns.T @ series))


def _find_moving_frequencies(centred: FloatArray, noise_energy: FloatArray) -> BoolArray:
    """Frequencies above zero at which motion stands out of white noise, in any column of (T, n)."""
    taper = np.hanning(len(centred) + 2)[1:-1, None]
    power = np.abs(np.fft.rfft(centred * taper, axis=0)[1:]) ** 2
    limit = np.log(len(power) / _CHANCE) * noise_energy * np.mean(taper**2)
    return np.asarray((power > limit).any(axis=1))


def _expect_not_negative(value: float, std: float) -> float:
    """Expectation of a quantity that is not negative, given a measurement of it with normal error."""
    if std == 0:
        return max(value, 0.0)
    score = value / std
    # The inverse Mills ratio; in logarithms, because both may underflow.
    return value + std * float(np.exp(norm.logpdf(score) - norm.logcdf(score)))
