"""What a load test shows: deflections with uncertainty, what remains, and how both compare with what was calculated."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vfm_sdm.analysis.load_test.levels import find_level, find_plateaus
from vfm_sdm.analysis.load_test.static_points import drop_static
from vfm_sdm.analysis.load_test.steps import LoadPlan
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status, check_displacement
from vfm_sdm.errors import DatasetError

__all__ = ["Limits", "judge_load_test"]

_DRAWS = 20_000
_SCALING = ("cameras", "compression", "subset")
"""Components of the budget that grow with the motion: one factor for all steps."""
_STEADY = ("assumption",)
"""Components that differ from level to level."""
_COVERAGE = (0.025, 0.975)
_BY_STEP = {
    **dict.fromkeys(("deflection", "combined_std", "expanded_uncertainty"), "mm"),
    **dict.fromkeys(("ratio", "ratio_low", "ratio_high", "ratio_exceeded"), "1"),
}
_BY_POINT = {
    **dict.fromkeys(("largest", "residual"), "mm"),
    **dict.fromkeys(("residual_share", "share_low", "share_high", "residual_exceeded"), "1"),
    **dict.fromkeys(("flexibility", "flexibility_std"), "mm"),
}
"""Units of what is found, by step and by point and axis."""
_CLEAR = 5.0
"""Multiples of its standard deviation that a deflection must have for a share of it to be stated."""
_SEED = 0


@dataclass(frozen=True)
class Limits:
    """What a load test must not exceed.

    Parameters
    ----------
    ratio
        Largest measured deflection over the calculated one [1].
    residual
        Largest share of the largest deflection that may remain after unloading [1].

    Raises
    ------
    DatasetError
        A limit is not above 0.
    """

    ratio: float = 1.0
    residual: float = 0.15

    def __post_init__(self) -> None:
        for name in ("ratio", "residual"):
            if not 0 < getattr(self, name) < np.inf:
                raise DatasetError(
                    f"load test: expected a limit of the {name} above 0, got {getattr(self, name):g}; correct it"
                )


def judge_load_test(
    displacement: xr.Dataset, plan: LoadPlan, limits: Limits = Limits(), *, static: Collection[str] = ()
) -> xr.Dataset:
    """Deflection of every step, point and axis, with uncertainty, residuals, stiffness and probabilities of exceedance.

    Parameters
    ----------
    displacement
        Displacement dataset with its budget, shape (T, P, 3) [mm].
    plan
        Steps; the first is what all others are compared with.
    limits
        Limits whose exceedance is judged.
    static
        Names of the points that must not move: they do not tell when the steps stood.

    Returns
    -------
    result
        Dims ``step``, ``point`` and ``axis``. By step: ``load``, ``begin_s``, ``end_s``; ``deflection`` from the first
        step on, its ``combined_std`` and ``expanded_uncertainty`` [mm]; ``calculated`` [mm], ``ratio`` of the measured
        to it, ``ratio_low`` and ``ratio_high`` of 95 % [1], and ``ratio_exceeded``, the probability that it is above
        its limit [1]. By point and axis: ``largest`` deflection and, where the last step is without load, the
        ``residual`` [mm], its share of a largest that is clear of noise, and ``residual_exceeded`` [1];
        ``flexibility``, the slope of deflection against load [mm per unit], with its standard deviation. NaN where a
        level is not known.

    Raises
    ------
    DatasetError
        The displacement states no budget; a calculated point is not among the measured ones; a step lies outside the
        recording; or the recording is too short to find the steps.

    Notes
    -----
    Distributions are propagated by drawing (JCGM 101:2008): levels scatter as Student's t with the degrees of freedom
    with which their scatter is known (`vfm_sdm.analysis.load_test.levels.find_level`), all steps of a point and axis
    share one factor with the standard deviation of what grows with the motion, and each level has its own error of what
    does not. So the uncertainty of the scale, most of that of a deflection, is not in the residual's share.
    """
    data = check_displacement(displacement)
    if "uncertainty" not in data:
        raise DatasetError("load test: expected displacement with a budget, got none; measure with `vfm-sdm measure`")
    points, axes = [[str(name) for name in data[dim].values] for dim in ("point", "axis")]
    for point, axis in {key for step in plan.steps for key in step.calculated_mm}:
        if point not in points or axis not in axes:
            raise DatasetError(
                f"load test: expected calculated values of measured points ({', '.join(points)}) and axes "
                f"({', '.join(axes)}), got {point} {axis}; correct the name of the column"
            )
    intervals = _find_intervals(data, plan, static)
    shape = (len(plan.steps), len(points), len(axes))
    calculated = np.full(shape, np.nan)
    for number, step in enumerate(plan.steps):
        for (point, axis), value in step.calculated_mm.items():
            calculated[number, points.index(point), axes.index(axis)] = value
    load = np.array([step.load for step in plan.steps])
    found = {name: np.full(shape, np.nan) for name in _BY_STEP} | {
        name: np.full(shape[1:], np.nan) for name in _BY_POINT
    }
    for p in range(len(points)):
        for a in range(len(axes)):
            draws = _draw(data.isel(point=p, axis=a), intervals, (p, a))
            for name, values in _judge(draws, load, calculated[:, p, a], limits).items():
                found[name][..., p, a] = values
    dims = ("step", "point", "axis")
    units = {**_BY_STEP, **_BY_POINT, **dict.fromkeys(("flexibility", "flexibility_std"), f"mm/({plan.unit or 1})")}
    variables: dict[str, tuple[tuple[str, ...], FloatArray, dict[str, str]]] = {
        name: (dims[3 - values.ndim :], values, {"units": units[name]}) for name, values in found.items()
    }
    variables["calculated"] = (dims, calculated, {"units": "mm"})
    variables["load"] = (("step",), load, {"units": plan.unit or "1"})
    for name, edges in zip(("begin_s", "end_s"), np.array(intervals).T, strict=True):
        variables[name] = (("step",), edges, {"units": "s"})
    coords = {"step": np.arange(1, shape[0] + 1), "point": points, "axis": axes}
    stillness = "given" if plan.timed else "found"
    attrs = {
        "ratio_limit": limits.ratio,
        "residual_limit": limits.residual,
        "stillness": stillness,
        "displacement_key": str(data.attrs.get("key", "")),
    }
    return xr.Dataset(variables, coords=coords, attrs=attrs)


def _find_intervals(data: xr.Dataset, plan: LoadPlan, static: Collection[str]) -> list[tuple[float, float]]:
    """When each step stood [s]."""
    time_s = data["time"].values
    if not plan.timed:
        moving = drop_static(data, static)
        series = moving["displacement"].where(moving["status"] == Status.OK).values.reshape(len(time_s), -1)
        series = series[:, np.isfinite(series).mean(axis=0) > 0.5]
        if not series.shape[1]:
            raise DatasetError(
                "load test: expected points that may move and were measured, got none; state when each step stood"
            )
        return find_plateaus(time_s, series, len(plan.steps))
    intervals = [(float(step.begin_s or 0.0), float(step.end_s or 0.0)) for step in plan.steps]
    if intervals[0][0] < time_s[0] - 1 or intervals[-1][1] > time_s[-1] + 1:
        raise DatasetError(
            f"load test: expected steps within the recording, {time_s[0]:.1f} to {time_s[-1]:.1f} s, got "
            f"{intervals[0][0]:.1f} to {intervals[-1][1]:.1f} s; correct begin_s and end_s"
        )
    return intervals


def _draw(one: xr.Dataset, intervals: list[tuple[float, float]], stream: tuple[int, int]) -> FloatArray:
    """Draws of the deflections of all steps from the first one, shape (draws, S) [mm]; the first is the estimate."""
    time_s, values = one["time"].values, one["displacement"].values
    ok = one["status"].values == Status.OK
    rng = np.random.default_rng((_SEED, *stream))
    budget = one["uncertainty"].transpose("component", "time").sel(component=[*_SCALING, *_STEADY]).values
    levels, scaling, steady = [], [], []
    for begin, end in intervals:
        inside = (time_s >= begin) & (time_s <= end)
        level = find_level(values[inside], ok[inside])
        levels.append(level)
        squares = np.where(inside & ok, np.square(budget), np.nan)
        size = np.sqrt(np.nanmean(squares, axis=1)) if level.freedom else np.full(len(squares), np.nan)
        # These grow with what moves, vibration included; of a level, with the level alone.
        moving = np.sqrt(np.mean(np.square(values[inside & ok]))) if level.freedom else np.nan
        scaling.append(level.value_mm / moving * size[: len(_SCALING)] if moving else 0 * size[: len(_SCALING)])
        steady.append(np.sqrt(np.sum(size[len(_SCALING) :] ** 2)))
    value = np.array([level.value_mm for level in levels])
    std = np.array([level.std_mm for level in levels])
    if not np.isfinite(value[0]):
        return np.full((_DRAWS, len(levels)), np.nan)
    shape = (_DRAWS, len(levels))
    scatter = std * rng.standard_t(levels[0].freedom, shape) + np.array(steady) * rng.standard_normal(shape)
    growth = rng.standard_normal((_DRAWS, len(_SCALING))) @ np.array(scaling).T
    drawn = value + scatter + growth
    drawn[0] = value
    return np.asarray(drawn - drawn[:, :1])


def _judge(
    draws: FloatArray, load: FloatArray, calculated: FloatArray, limits: Limits
) -> Mapping[str, FloatArray | float]:
    """All figures of one point and axis, from draws of its deflections, shape (draws, S) [mm]."""
    deflection = draws[0]
    std = np.std(draws[1:], axis=0)
    low, high = np.quantile(draws[1:], _COVERAGE, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = draws / np.where(calculated == 0, np.nan, calculated)
    ratio_low, ratio_high = np.quantile(ratios[1:], _COVERAGE, axis=0)
    known = np.isfinite(ratios[0])
    result: dict[str, FloatArray | float] = {
        "deflection": deflection,
        "combined_std": std,
        "expanded_uncertainty": (high - low) / 2,
        "ratio": ratios[0],
        "ratio_low": ratio_low,
        "ratio_high": ratio_high,
        "ratio_exceeded": np.where(known, np.mean(ratios[1:] > limits.ratio, axis=0), np.nan),
    }
    finite = np.isfinite(deflection)
    result |= dict.fromkeys(
        ("largest", "residual", "residual_share", "share_low", "share_high", "residual_exceeded"), float("nan")
    )
    result |= {"flexibility": float("nan"), "flexibility_std": float("nan")}
    if not finite[1:].any():
        return result
    top = int(np.nanargmax(np.abs(deflection)))
    result["largest"] = deflection[top]
    if load[-1] == load[0] and finite[-1] and top not in (0, len(load) - 1):
        result["residual"] = deflection[-1]
        # Of a point that did not move it would be noise over noise.
        if abs(deflection[top]) > _CLEAR * std[top]:
            shares = draws[:, -1] / draws[:, top]
            result["residual_share"] = shares[0]
            result["residual_exceeded"] = float(np.mean(shares[1:] > limits.residual))
            result["share_low"], result["share_high"] = np.quantile(shares[1:], _COVERAGE)
    centred = load[finite] - load[finite].mean()
    if np.any(centred):
        slopes = draws[:, finite] @ centred / (centred @ centred)
        result |= {"flexibility": slopes[0], "flexibility_std": float(np.std(slopes[1:]))}
    return result
