"""Checks of the signal itself: above its noise, measured at its full size, and recorded whole."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from scipy.ndimage import shift as shift_image

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.covariances import edges_across
from vfm_sdm.core.datasets import Status, frames_of_points
from vfm_sdm.core.statuses import Outcome, RecordingStatus, RefinementStatus
from vfm_sdm.inputs.session import picture_of
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditCheck, AuditInputs, Limits, judge
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS
from vfm_sdm.stages.registration.subsets import SubsetBank, SubsetDesign, Warp

__all__ = ["check_duration", "check_gain", "check_recording", "check_refinement", "check_signal"]

_SNR_CAUTION, _SNR_FAIL = 3.0, 1.0
_SHIFTS_PX = ((0.11, -0.07), (0.23, 0.19), (-0.31, 0.37), (0.5, -0.5), (-0.43, 0.29))
"""Injected shifts [px]: small, as the motion of structures is, and spread over the fractions of a pixel, where
interpolation errs."""
_MARGIN_PX = 12
_FINE_LEVELS = 16
"""Grey levels of the shifted picture in one of the recording, as many as fit into 16 bits: rounding must not matter."""
_GAIN = "gain of injected shifts"
_GAIN_CAUTION, _GAIN_FAIL = 0.02, 0.1
_DROPPED_CAUTION, _DROPPED_FAIL = 1e-9, 0.1
_LOST_FAIL = 0.5
"""Share of the frames that cannot be read from which what is left is no measurement of the recording."""
_FRAMES_CAUTION = 50
_UNUSED = 0.1
"""Share of a recording without frames of the other views at its side that is worth saying."""


def check_signal(inputs: AuditInputs) -> AuditCheck:
    """Root mean square motion [mm] over its noise, of the axis that shows least, beyond what the noise explains [1]."""
    name, data = "signal to noise", inputs.displacement
    ratios: dict[str, float] = {}
    axes = inputs.judged_axes
    for point in inputs.moving:
        for axis in axes:
            series = data.sel(point=point, axis=axis)
            ok = (series["status"].values == Status.OK) & np.isfinite(series["displacement"].values)
            if ok.sum() > 10:
                noise = float(np.mean(series["displacement_std"].values[ok] ** 2))
                excess = max(float(np.var(series["displacement"].values[ok])) - noise, 0.0)
                ratios[f"{axis} of {point}"] = np.sqrt(excess) / (NOISE_TRUST * np.sqrt(noise)) if noise else np.inf
    if not ratios:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _SNR_CAUTION, "", "nothing was measured")
    weak = [what for what, ratio in ratios.items() if ratio < _SNR_CAUTION]
    worst = min(ratios, key=lambda key: ratios[key])
    if not weak:
        sentence = "all motion stands clear of its noise"
        return AuditCheck(name, Outcome.PASS, ratios[worst], _SNR_CAUTION, "", sentence, worst, larger_is_better=True)
    nothing = all(ratio < _SNR_FAIL for ratio in ratios.values())
    bad = "nothing rises above the noise" if nothing else f"little more than noise: {', '.join(weak)}"
    advice = "use a longer lens, a larger subset or more light"
    outcome = Outcome.FAIL if nothing else Outcome.CAUTION
    return AuditCheck(name, outcome, ratios[worst], _SNR_CAUTION, "", f"{bad}; {advice}", worst, larger_is_better=True)


def check_gain(inputs: AuditInputs) -> AuditCheck:
    """Error of the registration's gain for shifts of parts of a pixel that are put into the first frames [1].

    Notes
    -----
    Into those in which they are named, of points that come into view later.

    The shifted picture gets noise of its own, as much as the frame seems to have, because noise draws the gain of a
    weak texture towards zero. Patterns finer than the pixels pass, because they cannot be shifted as a camera would see
    them.

    The gain of registration says nothing of a network that follows points by itself; its gain is unknown.
    """
    alone = [view for view, t in inputs.tracks.items() if "weights" in t.attrs and "disagreement" not in t]
    if alone:
        sentence = (
            "positions are a network's own, whose gain on small motion is not known; "
            'let registration measure (tracker "...+icgn"), or test the weights (docs/networks.md)'
        )
        return AuditCheck(_GAIN, Outcome.CAUTION, float("nan"), _GAIN_CAUTION, "1", sentence, alone[0])
    found = {}
    for view in inputs.frames:
        points = inputs.cameras.points.sel(view=view)
        for point, number in zip(inputs.moving, frames_of_points(points, inputs.moving).tolist(), strict=True):
            u, v = points["position"].sel(point=point).values
            image = picture_of(inputs.frames, view, number)
            design = _find_design(inputs.tracks[view], point, inputs.session.method.usual_subset_px)
            gain = _measure_gain(image, (float(u), float(v)), design)
            if np.isfinite(gain):
                found[f"{point} in {view}"] = abs(gain - 1)
    return judge(
        _GAIN,
        found,
        Limits(_GAIN_CAUTION, _GAIN_FAIL, "1"),
        good="known shifts of parts of a pixel come out at their full size",
        bad="known shifts come out wrong at {}: too little texture for the noise; use a larger subset",
    )


def check_recording(inputs: AuditInputs) -> AuditCheck:
    """Share of frames that the recordings lack or repeat [1], whether they end early, and what is doubtful about them.

    Notes
    -----
    Frames that a conversion of the rate put in, and that were left out, do not count; what was allowed for is a note.
    """
    name = "recordings"
    records = {view: t.attrs["recording"] for view, t in inputs.tracks.items() if "recording" in t.attrs}
    damaged = [
        view for view, record in records.items() if record.get("status", RecordingStatus.OK) != RecordingStatus.OK
    ]
    share = {
        view: (record["dropped"] + record["duplicated"]) / max(record["frames"], 1) for view, record in records.items()
    }
    if damaged:
        return _judge_damaged(name, max(damaged, key=lambda view: _lost_share(records[view])), records)
    doubtful = {view: record["doubts"] for view, record in records.items() if record.get("doubts")}
    if doubtful and max(share.values()) < _DROPPED_FAIL:
        view, said = next(iter(doubtful.items()))
        sentence = f"the recording of {view!r}: {'; '.join(said)}"
        return AuditCheck(name, Outcome.CAUTION, max(share.values()), _DROPPED_CAUTION, "1", sentence, view)
    return judge(
        name,
        share,
        Limits(_DROPPED_CAUTION, _DROPPED_FAIL, "1"),
        good="no frame is missing or repeated",
        bad="the recording of '{}' lacks frames or repeats them",
    )


def _lost_share(record: Mapping[str, Any]) -> float:
    """Share of a recording's frames, as its container counts them, that could not be read; 0 where nobody knows."""
    stated = record.get("stated_frames")
    return 1 - record["frames"] / stated if stated and record["frames"] < stated else 0.0


def _judge_damaged(name: str, view: str, records: Mapping[str, Mapping[str, Any]]) -> AuditCheck:
    """The check of a recording that is not whole."""
    lost = _lost_share(records[view])
    outcome = Outcome.FAIL if lost >= _LOST_FAIL else Outcome.CAUTION
    part = f", {100 * lost:.0f} % of its frames cannot be read" if lost else ""
    sentence = f"the recording of {view!r} is not whole: {records[view]['status']}{part}; copy it from the camera again"
    return AuditCheck(name, outcome, lost or float("nan"), _DROPPED_CAUTION, "1", sentence, view)


def check_duration(inputs: AuditInputs) -> AuditCheck:
    """Number of common frames in which the best-tracked point of the structure has a trusted displacement.

    Notes
    -----
    The standard deviation of noise is known from n frames to ``1 / sqrt(2 n)`` of itself; a tenth needs 50.
    """
    name = "length of the recording"
    ok = (inputs.displacement.sel(point=inputs.moving)["status"].values == Status.OK).sum(axis=0)
    frames = int(ok.max()) if ok.size else 0
    common = inputs.aligned.sizes["time"]
    unused = {view: 1 - common / max(t.sizes["time"], 1) for view, t in inputs.tracks.items()}
    view, share = max(unused.items(), key=lambda pair: pair[1], default=("", 0.0))
    rest = f"; {100 * share:.0f} % of {view!r} has no frame at its side and is not used" if share > _UNUSED else ""
    if frames >= _FRAMES_CAUTION:
        good = f"{frames} frames of all views together are enough to judge noise and motion by" + rest
        return AuditCheck(name, Outcome.PASS, frames, _FRAMES_CAUTION, "frames", good, larger_is_better=True)
    bad = f"{frames} trusted frames of all views together are too few to judge noise, clocks and cameras by"
    return AuditCheck(name, Outcome.CAUTION, frames, _FRAMES_CAUTION, "frames", bad + rest, larger_is_better=True)


def check_refinement(inputs: AuditInputs) -> AuditCheck | None:
    """Share of points that could not be refined [1]; ``None`` where no refinement was asked for."""
    name = "refinement"
    if inputs.session.method.refinement == "none":
        return None
    if "refinement_status" not in inputs.displacement:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), 0.0, "1", "it takes a second view to refine")
    refused = {
        str(point): status
        for point, status in zip(
            inputs.displacement["point"].values, inputs.displacement["refinement_status"].values, strict=True
        )
        if status not in (RefinementStatus.OK, RefinementStatus.EDGE) and str(point) in inputs.moving
    }
    share = len(refused) / max(len(inputs.moving), 1)
    if refused:
        point, status = next(iter(refused.items()))
        return AuditCheck(name, Outcome.CAUTION, share, 0.0, "1", f"point {point!r} was not refined: {status}", point)
    heaviest = max(_weigh_assumptions(inputs), key=lambda pair: pair[1], default=("", 0.0))
    sentence = "every point was refined"
    if heaviest[1] > 1:
        sentence += (
            f"; for {heaviest[0]} the assumption about the suppressed axis weighs {heaviest[1]:.1f} times the images' "
            "noise in the stated uncertainty"
        )
    return AuditCheck(name, Outcome.PASS, share, 0.0, "1", sentence, heaviest[0])


def _weigh_assumptions(inputs: AuditInputs) -> Iterator[tuple[str, float]]:
    """The assumption's part of the uncertainty over the random part [1], with its axis and point."""
    data = inputs.displacement.sel(point=inputs.moving)
    suppressed = inputs.session.method.sgr.suppressed_axis
    rms = np.sqrt(np.nan_to_num(data["uncertainty"].values ** 2).mean(axis=1))
    random, assumption = (rms[COMPONENTS.index(component)] for component in ("random", "assumption"))
    for column, axis in enumerate(str(a) for a in data["axis"].values):
        for row, point in enumerate(inputs.moving):
            if axis != suppressed and random[row, column] > 0:
                yield f"{axis} of {point}", float(assumption[row, column] / random[row, column])


def _find_design(tracks: xr.Dataset, point: str, subset_px: int) -> SubsetDesign | None:
    """How a view's tracks say that a point was registered, less its mask; ``None`` where it was not."""
    one = tracks.sel(point=point)
    if "warp" not in one:
        return SubsetDesign(subset_px)
    if not one["warp"].item():
        return None
    warp, across = Warp(str(one["warp"].item())), edges_across(one)
    return SubsetDesign(int(one["subset_px"].item()), warp, across=across if warp == Warp.EDGE else None)


def _measure_gain(image: LumaArray, place: tuple[float, float], design: SubsetDesign | None) -> float:
    """Slope of found over injected shifts at a point: 0 where none is found, NaN where the subset leaves the image."""
    if design is None:
        return float("nan")
    half = design.subset_px // 2 + _MARGIN_PX
    if not np.isfinite(place).all():
        return float("nan")
    u, v = (round(x) for x in place)
    if min(u, v, image.shape[1] - 1 - u, image.shape[0] - 1 - v) < half:
        return float("nan")
    patch = image[v - half : v + half + 1, u - half : u + half + 1]
    center = np.array([[half + place[0] - u, half + place[1] - v]])
    grey, rng = patch.astype(np.float64), np.random.default_rng(0)
    noise = _estimate_noise(grey)
    # Of a recording of 16 bits rounding does not matter anyway.
    fine = min(_FINE_LEVELS, max(np.iinfo(np.uint16).max // max(int(patch.max()), 1), 1))
    injected, found = [], []
    for du, dv in _SHIFTS_PX:
        moved = shift_image(grey, (dv, du), order=5, mode="reflect") + rng.normal(0, noise, grey.shape)
        as_filmed = np.clip(np.rint(fine * moved), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        bank = SubsetBank.prepare(fine * patch.astype(np.uint16), center, designs=[design])
        result = bank.register(as_filmed, center)
        if result.converged[0]:
            injected.append((du, dv))
            found.append(result.position[0] - center[0])
    if len(found) < len(_SHIFTS_PX) // 2 + 1:
        return 0.0
    seen = np.eye(2) if design.across is None else design.direction()
    a, b = np.ravel(injected @ seen), np.ravel(found @ seen)
    return float(a @ b / (a @ a))


def _estimate_noise(image: FloatArray) -> float:
    """Standard deviation of the noise in a picture, from a difference that planes and edges hardly touch.

    References
    ----------
    .. [1] Immerkaer, J. (1996). Fast noise variance estimation. Computer Vision and Image Understanding 64(2), 300-302.
    """
    bent = image[:-2] - 2 * image[1:-1] + image[2:]
    twice = bent[:, :-2] - 2 * bent[:, 1:-1] + bent[:, 2:]
    return float(np.sqrt(np.pi / 2) * np.mean(np.abs(twice)) / 6)
