"""Faults put into simulated measurements, for what the audit must find."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from measurements import MOVING, VIEWS, Simulated, simulate
from vfm_sdm.core.arrays import FloatArray

__all__ = ["FAULTS", "GOOD", "Fault", "good_run"]

GOOD = {"track_std_px": (0.012, 0.015), "vertical_mm": 8.0, "lateral_mm": 4.0, "synchronization": "motion"}
"""A measurement whose motion stands clear of its noise, whatever the site."""

Fault = Callable[[int], Simulated]


@cache
def good_run(seed: int) -> Simulated:
    """A measurement that nothing is wrong with; kept, because several faults start from it."""
    return simulate(seed, **GOOD)


def slipping_track(seed: int) -> Simulated:
    """One track slides off its point by a third of the motion in the picture and 1 px, along the rows."""

    def slip(position: FloatArray, time_s: FloatArray) -> FloatArray:
        amount = 1.0 + 0.3 * np.ptp(position, axis=0).max()
        ramp = np.clip((time_s - time_s[len(time_s) // 3]) / (time_s[-1] / 3), 0, 1)
        return position + ramp[:, None] * [amount, 0.15 * amount]

    return _with_position(good_run(seed), "right", [MOVING[seed % 2]], slip)


def frozen_track(seed: int) -> Simulated:
    """One track stands still for the last third of the recording."""

    def freeze(position: FloatArray, time_s: FloatArray) -> FloatArray:
        start = 2 * len(time_s) // 3
        return np.concatenate([position[:start], np.repeat(position[start : start + 1], len(time_s) - start, axis=0)])

    return _with_position(good_run(seed), VIEWS[seed % 2], [MOVING[0]], freeze)


def swapped_views(seed: int) -> Simulated:
    """The recordings have each other's names."""
    run = good_run(seed)
    return replace(run, tracks={"left": run.tracks["right"], "right": run.tracks["left"]})


def unsynchronised(seed: int) -> Simulated:
    """The second view's clock is 40 ms off, and the session does not let the motion mend it."""
    run = good_run(seed)
    left, right = run.session.view
    wrong = right.model_copy(update={"time_offset_s": run.conditions.time_offset_s + 0.04, "time_offset_std_s": 0.002})
    method = run.session.method.model_copy(update={"synchronization": "none"})
    return replace(run, session=run.session.model_copy(update={"view": (left, wrong), "method": method}))


def wrong_focal(seed: int) -> Simulated:
    """Both lenses noted 20 % too long, where a length between two points was measured."""
    wrong = {"focal_errors": (0.2, 0.2), "focal_std": 0.02}
    return simulate(seed, **GOOD, **wrong, length_std=0.005, length_error=0.0, range_std=0.02, range_error=0.0)


def moved_tripod(seed: int) -> Simulated:
    """Someone leans on the second tripod: its picture sways by a fifth of the structure's motion and 2 px."""
    run = good_run(seed)
    rng = np.random.default_rng([seed, 99])
    phase, rates = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0.3, 0.8, 2)
    amount = 2.0 + 0.2 * _largest_motion(run, "right")

    def sway(position: FloatArray, time_s: FloatArray) -> FloatArray:
        return position + amount / 2 * np.sin(2 * np.pi * np.outer(time_s, rates) + phase)

    return _with_position(run, "right", [str(p) for p in run.tracks["right"]["point"].values], sway)


def stabilised_video(seed: int) -> Simulated:
    """The second camera takes half of the structure's motion out of its picture."""
    run = good_run(seed)
    structure = run.tracks["right"].sel(point=list(MOVING))["position"].mean("point").values

    def follow(position: FloatArray, _time_s: FloatArray) -> FloatArray:
        return position - 0.5 * (structure - structure[0])

    return _with_position(run, "right", [str(p) for p in run.tracks["right"]["point"].values], follow)


def low_signal(seed: int) -> Simulated:
    """A structure that hardly moves."""
    return simulate(seed, vertical_mm=0.02, lateral_mm=0.01, track_std_px=(0.04, 0.04))


FAULTS: dict[str, tuple[Fault, frozenset[str]]] = {
    "a slipping track": (
        slipping_track,
        frozenset({"slipping tracks", "epipolar error in motion", "agreement of the views"}),
    ),
    "a frozen track": (frozen_track, frozenset({"frozen tracks"})),
    "views swapped": (swapped_views, frozenset({"epipolar error", "samples missing"})),
    "40 ms unsynchronised": (unsynchronised, frozenset({"clocks"})),
    "a focal length 20 % wrong": (wrong_focal, frozenset({"site and lenses"})),
    "a moved tripod": (moved_tripod, frozenset({"tripods", "static points"})),
    "stabilised video": (stabilised_video, frozenset({"stabilised video"})),
    "a low signal": (low_signal, frozenset({"signal to noise"})),
}
"""By fault: what makes it, and the checks of which one must speak."""


def _with_position(
    run: Simulated, view: str, points: list[str], change: Callable[[FloatArray, FloatArray], FloatArray]
) -> Simulated:
    tracks = run.tracks[view].copy(deep=True)
    for point in points:
        number = [str(p) for p in tracks["point"].values].index(point)
        tracks["position"].values[:, number] = change(tracks["position"].values[:, number], tracks["time"].values)
    return replace(run, tracks={**run.tracks, view: tracks})


def _largest_motion(run: Simulated, view: str) -> float:
    position = run.tracks[view].sel(point=list(MOVING))["position"].values
    return float(np.ptp(position, axis=0).max())
