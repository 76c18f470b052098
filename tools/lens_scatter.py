"""How much lenses of one kind differ, level by level: what makes intervals of left-out calibrators shortest and hold.

Parameters minimise the interval score of 95 % intervals over all values that are left out [1]_: the mean of their
widths, and 40 times what lies outside. A last factor makes exactly 95 of 100 hold.

References
----------
.. [1] Gneiting, T., Raftery, A. E. (2007). Strictly proper scoring rules, prediction, and estimation. Journal of the
   American Statistical Association 102(477), 359-378, section 6.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from lens_records import NORMAL_95, Held, Record, leave_out
from scipy.optimize import minimize

from vfm_sdm.inputs.profiles import CROP
from vfm_sdm.inputs.profiles.hierarchy import LensKey, chain_of, collect_moments, shrink
from vfm_sdm.inputs.profiles.table import Scatter
from vfm_sdm.inputs.profiles.words import CameraClass

__all__ = ["fit_all", "variants"]

_SHARE = 0.95
_LEAST = 15
"""Left-out values that a fit needs."""
_PRIOR_STD, _PRIOR_WEIGHT = 0.1, 2e-2
"""Standard deviation towards which those of levels are drawn where the values hardly tell them, and how strongly."""
_KNOWN_STEP = float(-np.log(CROP))


@dataclass(frozen=True, eq=False)
class Cases:
    """Left-out values N with what L levels hold of the others."""

    levels: tuple[str, ...]
    count: np.ndarray
    mean: np.ndarray
    squares: np.ndarray
    value: np.ndarray
    beyond: tuple[str, ...] = ()


def variants(record: Record) -> dict[str, list[LensKey]]:
    """Ways to ask for a calibration's lens, by chain: with and without its state of stabilisation."""
    key, setting = record.key, record.key.setting
    found: dict[str, list[LensKey]] = {}
    states = [setting.stabilised] if setting.stabilised is None else [setting.stabilised, None]
    for state in states:
        without = replace(setting, mode="", film_mm=None, stabilised=state)
        found.setdefault("any", []).append(replace(key, setting=without))
        if setting.mode or setting.film_mm is not None:
            found.setdefault(chain_of(key), []).append(replace(key, setting=replace(setting, stabilised=state)))
    return found


def fit_all(records: Sequence[Record], calibrators: frozenset[str] | None = None) -> dict[str, dict[str, Any]]:
    """Scatter by kind of camera and chain, as it stands in the package.

    Parameters
    ----------
    records
        Calibrations.
    calibrators
        Only values of these are expected; of all when left out.
    """
    held = [one for one in leave_out(records) if calibrators is None or one.record.calibrator in calibrators]
    found: dict[str, dict[str, Any]] = {}
    for kind in CameraClass:
        of = [one for one in held if one.record.key.kind is kind]
        own: dict[str, Any] = {"class": _of_class([r for r in records if r.key.kind is kind and r.order > 0])}
        for chain in ("any", "mode", "film"):
            fitted = _fit(of, chain)
            if fitted is not None:
                own[chain] = fitted
        own["corner"] = _of_corner(of, records, kind)
        found[str(kind)] = own
    return found


def _cases(held: Sequence[Held], chain: str, *, known: bool, seen: bool = True) -> Cases | None:
    """What is expected along a chain; where not ``seen``, as if the table did not have the model."""
    found = []
    for one in held:
        for key in variants(one.record).get(chain, []):
            asked = key if seen else replace(key, model="")
            if (key.setting.stabilised is not None) == known:
                film_mm = np.where(one.others.film_mm > 0, one.others.film_mm, 1.0)
                values = one.others.log_focal - (np.log(film_mm) if chain == "film" else 0.0)
                moments = collect_moments(
                    one.others, asked, values=values, squares=one.others.log_focal_squares, chain=chain
                )
                value = one.log_focal - (np.log(key.setting.film_mm) if chain == "film" else 0.0)
                found.append((moments, value))
    if not found:
        return None
    return Cases(
        found[0][0].levels,
        np.array([m.count for m, _ in found]),
        np.array([m.mean for m, _ in found]),
        np.array([m.squares for m, _ in found]),
        np.array([value for _, value in found]),
        (() if known else ("stabilised",)) + (() if seen else ("model",)),
    )


def _scatter(x: np.ndarray, names: Sequence[str]) -> Scatter:
    levels = dict(zip(names, np.exp(x[: len(names)]).tolist(), strict=True))
    return Scatter({**levels, "stabilised": _KNOWN_STEP}, float(np.exp(x[-2])), float(np.exp(x[-1])), {})


def _apart(cases: Cases, scatter: Scatter) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations of what is expected, shape (N,) each."""
    steps = np.array([scatter.levels[name] for name in cases.levels[1:]])
    mean, std = shrink(cases.count, cases.mean, cases.squares, steps=steps, scatter=scatter)
    beyond = sum(scatter.levels[name] ** 2 for name in cases.beyond)
    return np.abs(cases.value - mean), np.sqrt(std**2 + beyond)


def _fit(held: Sequence[Held], chain: str) -> dict[str, Any] | None:
    both = [cases for known in (True, False) if (cases := _cases(held, chain, known=known)) is not None]
    if sum(len(cases.value) for cases in both) < _LEAST:
        return None
    names = [name for name in both[-1].levels[1:] if name != "stabilised"]

    def score(x: np.ndarray) -> float:
        scatter, total, count = _scatter(x, names), 0.0, 0
        for cases in both:
            error, std = _apart(cases, scatter)
            half = NORMAL_95 * std
            total += float((2 * half + 2 / (1 - _SHARE) * np.maximum(error - half, 0)).sum())
            count += len(error)
        drawn = float(((x[: len(names)] - np.log(_PRIOR_STD)) ** 2).sum() + (x[-1] - 1) ** 2)
        return total / count + _PRIOR_WEIGHT * drawn

    start = np.append(np.full(len(names), np.log(_PRIOR_STD)), [np.log(_PRIOR_STD), 1.0])
    best = minimize(score, start, method="Nelder-Mead", options={"maxfev": 1500, "xatol": 1e-3, "fatol": 1e-5})
    scatter = _scatter(best.x, names)
    widen = {"known" if not cases.beyond else "unknown": _factor(cases, scatter) for cases in both}
    # Not knowing the state must never make an interval shorter.
    widen["unknown"] = max(widen["unknown"], widen.get("known", 0.0))
    widen.setdefault("known", widen["unknown"])
    unseen = _cases(held, chain, known=False, seen=False)
    widen["unseen"] = widen["unknown"] if unseen is None else _factor(unseen, scatter)
    return _as_row(scatter, widen)


def _factor(cases: Cases, scatter: Scatter) -> float:
    error, std = _apart(cases, scatter)
    return float(np.quantile(error / std, _SHARE, method="higher")) / NORMAL_95


def _as_row(scatter: Scatter, widen: dict[str, float]) -> dict[str, Any]:
    def short(values: dict[str, float]) -> dict[str, float]:
        return {name: float(f"{value:.4g}") for name, value in values.items()}

    own = {"own": scatter.own, "freedom": min(scatter.freedom, 1e6)}
    # The value at the edge of its interval must not leave it by the rounding.
    return {
        "levels": short(dict(scatter.levels)),
        **short(own),
        "widen": short({k: 1.001 * v for k, v in widen.items()}),
    }


def _of_class(records: Sequence[Record]) -> dict[str, Any]:
    """Of the kind of camera alone: one value a calibrator and group."""
    values = np.array(list({(*one.group, one.calibrator): one.log_focal for one in records}.values()))
    own = float(values.std())
    factor = float(np.quantile(np.abs(values - values.mean()), _SHARE)) / NORMAL_95 / own
    return _as_row(Scatter({}, own, 1e6, {}), {"known": factor, "unknown": factor, "unseen": factor})


def _of_corner(held: Sequence[Held], records: Sequence[Record], kind: CameraClass) -> dict[str, Any]:
    """Of the distortion at the corner, with one standard deviation for all levels."""
    cases = []
    for one in held:
        key = one.record.key
        moments = collect_moments(
            one.others, key, values=one.others.corner[:, 0], squares=one.others.corner_squares, order=one.record.order
        )
        if moments.count[-1] > 0:
            cases.append((moments, one.record.corner[0]))
    if len(cases) < _LEAST:
        values = np.array([one.corner[0] for one in records if one.key.kind is kind and one.order == 1])
        return _as_row(Scatter({}, float(values.std()), 1e6, {}), {"known": 1.0})
    away = np.array([m.mean[-1] - value for m, value in cases])
    own = float(1.4826 * np.median(np.abs(away)))
    names = ("of the mode", "brand", "model", "aspect", "film", "stabilised")
    scatter = Scatter(dict.fromkeys(names, own), own, 1e6, {})
    ratios = []
    for moments, value in cases:
        steps = np.full(len(moments.levels) - 1, own)
        mean, std = shrink(moments.count, moments.mean, np.asarray(moments.squares), steps=steps, scatter=scatter)
        ratios.append(abs(value - float(mean)) / float(std))
    return _as_row(scatter, {"known": float(np.quantile(ratios, _SHARE, method="higher")) / NORMAL_95})
