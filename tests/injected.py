"""Faults of sites, lenses, recordings and references put into simulated measurements: right, or named, or silent."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import xarray as xr

from faults import FAULTS, GOOD, Fault, good_run
from measurements import FPS, VIEWS, Simulated, draw_conditions, simulate
from vfm_sdm.core.sensor_datasets import make_acceleration
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings, compute_reference
from vfm_sdm.inputs.video.marks import read_capture_clock, read_pixel_aspect
from vfm_sdm.stages.tracking.frame_clock import check_frames

__all__ = ["INJECTED", "Injected", "clipped_reference"]

_LENS = frozenset({"site and lenses", "scale", "epipolar error"})
_SITE = frozenset({"site and lenses", "epipolar error", "static points", "agreement of the views"})
_RECORDING = frozenset({"recordings"})


@dataclass(frozen=True)
class Injected:
    """A kind of fault.

    Parameters
    ----------
    make
        Measurement with the fault, from a seed.
    named_by
        Checks that say what is wrong, of which one is enough.
    """

    make: Fault
    named_by: frozenset[str]


def wrong_lenses(seed: int) -> Simulated:
    """One focal length noted for both lenses, stated as 2 % and wrong by 10 to 50 %, as with a wrong sensor width."""
    rng = _rng(seed)
    wrong = rng.choice([-1, 1]) * rng.uniform(np.log(1.1), np.log(1.5))
    return simulate(seed, **GOOD, focal_std=0.02, focal_errors=tuple(wrong + rng.normal(0, 0.02, 2)))


def wrong_lens(seed: int) -> Simulated:
    """The same of one lens alone."""
    rng = _rng(seed)
    wrong = rng.choice([-1, 1]) * rng.uniform(np.log(1.1), np.log(1.5)) * np.eye(2)[rng.integers(2)]
    return simulate(seed, **GOOD, focal_std=0.02, focal_errors=tuple(wrong + rng.normal(0, 0.02, 2)))


def swapped_distances(seed: int) -> Simulated:
    """The perpendicular distance noted as the longitudinal one, and the other way round."""
    c = draw_conditions(np.random.default_rng([seed, 0]))
    apart = c.longitudinal - c.perpendicular
    return simulate(
        seed, **GOOD,
        perpendicular_error=apart + c.longitudinal_error, perpendicular_std=c.longitudinal_std,
        longitudinal_error=-apart + c.perpendicular_error, longitudinal_std=c.perpendicular_std,
    )  # fmt: skip


def wrong_side(seed: int) -> Simulated:
    """The structure noted on the left, where it is on the right."""
    return simulate(seed, **GOOD, stated_side="left")


def wrong_level_sign(seed: int) -> Simulated:
    """Pitch and roll of the camera noted with the wrong sign."""
    c = draw_conditions(np.random.default_rng([seed, 0]))
    pitch = np.degrees(np.arctan2(c.height, np.hypot(c.perpendicular, c.longitudinal)))
    # An error is what is noted less what is true.
    pitch_error, roll_error = c.level_errors
    return simulate(seed, **GOOD, level_errors=(-2 * pitch - pitch_error, -2 * c.roll - roll_error))


def look_alike(seed: int) -> Simulated:
    """In the second view a point's neighbour is followed that looks like it, as the next baluster, 0.1 to 1 m away."""
    rng = _rng(seed)
    return simulate(seed, **GOOD, mistaken_m=float(rng.choice([-1, 1]) * rng.uniform(0.1, 1.0)))


def anamorphic(seed: int) -> Simulated:
    """Pixels that are 4/3 or 16/11 as wide as high, as the file says."""
    stored = (Fraction(4, 3), Fraction(16, 11))[seed % 2]
    told, _ = read_pixel_aspect(stored, 0)
    return simulate(seed, **GOOD, pixel_aspect=float(stored), stated_aspect=told)


def anamorphic_untold(seed: int) -> Simulated:
    """The same, where a conversion lost what the file said."""
    return simulate(seed, **GOOD, pixel_aspect=float((Fraction(4, 3), Fraction(16, 11))[seed % 2]))


def slow_motion(seed: int) -> Simulated:
    """Filmed at 4 or 8 times the rate that the file is stored at, with the tags of Android's or Apple's cameras."""
    run, factor = good_run(seed), (4, 8)[seed % 2]
    stored = Fraction(int(FPS))
    taken, apple = (
        {"com.android.capture.fps": f"{factor * FPS:.6f}"},
        {"com.apple.quicktime.full-frame-rate-playback-intent": "0"},
    )
    tags, unit = (taken, None) if seed % 4 < 2 else (apple, Fraction(1, 2400))
    clock = read_capture_clock(stored, tags, time_base=unit)
    tracks = {}
    for view, one in run.tracks.items():
        stamps = one["time"].values * factor * float(clock.scale)
        stretched = one.assign_coords(time=("time", stamps, one["time"].attrs))
        tracks[view] = _recorded(stretched, {"remarks": list(clock.remarks), "doubts": list(clock.doubts)})
    views = run.session.view
    if clock.doubts:  # whoever notes the offset of two clocks reads it off the same stamps
        stated = [view.time_offset_s * factor if view.time_offset_s is not None else None for view in views]
        views = tuple(view.model_copy(update={"time_offset_s": one}) for view, one in zip(views, stated, strict=True))
    still = run.session.method.still_interval_s
    scale = factor * float(clock.scale)
    method = run.session.method.model_copy(update={"still_interval_s": tuple(scale * s for s in still)})
    return replace(run, tracks=tracks, session=run.session.model_copy(update={"view": views, "method": method}))


def repeated_frames(seed: int) -> Simulated:
    """Frames of one view that repeat the one before, in place of lost ones; a codec makes them a little different."""
    run, rng, view = good_run(seed), _rng(seed), VIEWS[seed % 2]
    tracks = run.tracks[view].copy(deep=True)
    position, frames = tracks["position"].values, tracks.sizes["time"]
    for k in rng.choice(np.arange(45, frames - 10, 5), rng.integers(3, 9), replace=False):
        noise = np.sqrt(np.einsum("pii->pi", tracks["position_covariance"].values[k])) / 10
        position[k] = position[k - 1] + rng.normal(0, 1, noise.shape) * noise
    return replace(run, tracks={v: _checked(tracks if v == view else t) for v, t in run.tracks.items()})


def both_drop(seed: int) -> Simulated:
    """Both cameras lose the same two to six frames while the stamps run on."""
    run, rng = good_run(seed), _rng(seed)
    stamps = {view: tracks["time"].values for view, tracks in run.tracks.items()}
    start, lost = rng.uniform(2.0, stamps[VIEWS[0]][-1] - 1.5), int(rng.integers(2, 7))
    tracks = {}
    for view, one in run.tracks.items():
        began = start - (run.conditions.time_offset_s if view == VIEWS[1] else 0.0)
        first = int(np.argmin(np.abs(stamps[view] - began)))
        left = one.isel(time=np.delete(np.arange(len(stamps[view])), slice(first, first + lost)))
        runs_on = stamps[view][: left.sizes["time"]]
        tracks[view] = _checked(left.assign_coords(time=("time", runs_on, one["time"].attrs)))
    return replace(run, tracks=tracks)


def clipped_reference(seed: int) -> tuple[str, float, dict[str, str]]:
    """An accelerometer whose range ends below the structure's vibration, of any rate, noise and resolution.

    Returns the verdict, the rms error of its displacement in 2 % of its rms motion, and the notes that name it.
    """
    rng = _rng(seed)
    rate, begun = float(rng.choice([64, 100, 200])), 3.0
    time_s = np.arange(round(20 * rate)) / rate
    since = np.maximum(time_s - begun, 0)
    hertz = np.array([rng.uniform(1.5, 3), rng.uniform(1.5, 3), rng.uniform(4, 6)])
    swing = np.sin(2 * np.pi * since[:, None] * hertz + rng.uniform(0, 1, 3)) @ rng.uniform([1, 1, 0], [2, 2, 1])
    swing *= np.clip(since, 0, 1) ** 2 * np.exp(-rng.uniform(0, 0.2) * since)
    felt = np.column_stack([0.4 * swing, swing - 9.80665, 0.1 * swing])
    felt = felt + rng.normal(0, 10 ** rng.uniform(-4, -2), felt.shape)
    step = 10 ** rng.uniform(-4, -2)
    whole, cut = felt.copy(), felt.copy()
    cut[:, 1] = np.clip(cut[:, 1], -99, -9.80665 + rng.uniform(0.4, 0.85) * np.abs(swing).max())
    made = []
    for values in (whole, cut):
        coarse = np.round(values / step) * step
        acceleration = make_acceleration(
            time_s, ["a"], ("lateral", "vertical", "longitudinal"), coarse[:, None], sampling_rate_hz=rate
        )
        try:
            made.append(compute_reference(acceleration, RecipeSettings(onset_s=begun)))
        except VfmSdmError as error:
            return str(Verdict.REFUSED), np.inf, {"reference": str(error)[:80]}
    truth, found = (one["displacement"].values[:, 0, 1] for one in made)
    both = np.isfinite(truth) & np.isfinite(found)
    off = np.sqrt(np.mean((found - truth)[both] ** 2)) / np.nanstd(truth) / 0.02 if both.any() else 0.0
    flags = {note[:80]: "" for note in made[1].attrs["notes"] if "clipped" in note}
    return str(Verdict.CARE if flags else Verdict.FIT), float(off), flags


def _checked(tracks: xr.Dataset) -> xr.Dataset:
    """Tracks as the tracking stage leaves them, with what their motion says of the frames."""
    clock = check_frames(tracks)
    return _recorded(clock.tracks, clock.facts)


def _recorded(tracks: xr.Dataset, facts: dict[str, object]) -> xr.Dataset:
    recording = {"frames": tracks.sizes["time"], "dropped": 0, "duplicated": 0, **facts}
    return tracks.assign_attrs(recording=recording)


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 77])


INJECTED: dict[str, Injected] = {
    **{name: Injected(make, checks) for name, (make, checks) in FAULTS.items()},
    "both lenses wrong": Injected(wrong_lenses, _LENS),
    "one lens wrong": Injected(wrong_lens, _LENS),
    "distances swapped": Injected(swapped_distances, _SITE),
    "structure on the wrong side": Injected(wrong_side, _SITE),
    "levels with the wrong sign": Injected(wrong_level_sign, _SITE),
    "a look-alike in the second view": Injected(look_alike, _SITE | {"epipolar error in motion"}),
    "anamorphic pixels": Injected(anamorphic, _LENS | _SITE),
    "anamorphic pixels, untold": Injected(anamorphic_untold, _LENS | _SITE),
    "slow motion": Injected(slow_motion, _RECORDING),
    "repeated frames": Injected(repeated_frames, _RECORDING | {"frozen tracks"}),
    "both views drop frames": Injected(both_drop, _RECORDING),
}
"""By fault: what makes it, and the checks that name it."""
