"""Checks of tracks and of the cameras that took them: lost, frozen and slipping points, and what must not move."""

from dataclasses import replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, mean_of_known, unbroken_runs
from vfm_sdm.core.covariances import edges_across, find_edges, measured_variance
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import CameraMotionStatus, Outcome
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditCheck, AuditInputs, Limits, judge
from vfm_sdm.stages.camera_motion import ViewMotion

__all__ = [
    "check_camera_motion",
    "check_frozen",
    "check_halves",
    "check_points",
    "check_slip",
    "check_stabilization",
    "check_static_points",
    "check_tracked",
]

_REFUSED_CAUTION, _REFUSED_FAIL = 1e-9, 0.99
_MISSING_CAUTION, _MISSING_FAIL = 0.05, 0.5
_FROZEN_S = 0.2
"""Shortest run of unchanged positions that counts [s]."""
_UNCHANGED_PX = 1e-6
_MOVED_STD = 5.0
_FROZEN_CAUTION, _FROZEN_FAIL = 1e-9, 0.05
_BLOCKS = 8
"""Parts of the recording whose means are compared for drift."""
_SIGNIFICANT = 5.0
_SLIP_CAUTION, _SLIP_FAIL = 0.1, 0.3
_STILL_CAUTION, _STILL_FAIL = 0.1, 0.5
"""Limits of the motion of what must not move, as shares of the structure's motion [1]."""
_FOLLOWS_CAUTION, _FOLLOWS_FAIL = 0.1, 0.2
_FOLLOWS_CORRELATION = 0.7
_SLIP = 7.0
"""Times the middle difference of halves (5 standard deviations of noise) beyond which one of them is lost."""
_HALVES_CAUTION, _HALVES_FAIL = 0.1, 0.3
_LOST_POSES: dict[str, str] = {
    CameraMotionStatus.TOO_FEW: "camera {!r} moves far, and fewer than three static points show how; name four or more "
    "at several depths",
    CameraMotionStatus.NOT_DETERMINED: "camera {!r} moves far, and its static points do not show how: they lie on one "
    "line or leave the picture; name four or more at several depths, all around the structure",
}
_NO_STATIC = (
    "no point that must not move was named and found: a tripod that moves looks like a structure that moves. Name two "
    "on an abutment or behind the structure (static = true)"
)


def check_points(inputs: AuditInputs) -> AuditCheck:
    """Share of the points on the structure that were known before tracking not to be measured [1]."""
    asked = [p.name for p in inputs.session.point if not p.static]
    refused = {name: why for name, why in inputs.refused.items() if name in asked}
    share = len(refused) / len(asked) if asked else 0.0
    named = "; ".join(f"{name}: {why}" for name, why in refused.items())
    return judge(
        "points refused",
        {named: share},
        Limits(_REFUSED_CAUTION, _REFUSED_FAIL, "1"),
        good="every point of the structure can be followed",
        bad="not measured, as was said before tracking: {}; name other places, or their places in the other view",
    )


def check_tracked(inputs: AuditInputs) -> AuditCheck:
    """Share of samples without a trusted displacement, of the worst moving point [1]."""
    status = inputs.displacement.sel(point=inputs.moving)["status"].values
    return judge(
        "samples missing",
        dict(zip(inputs.moving, (status != Status.OK).mean(axis=0), strict=True)),
        Limits(_MISSING_CAUTION, _MISSING_FAIL, "1"),
        good="hardly any sample is missing",
        bad="point '{}' was lost, left the picture or is not to be trusted in part of the recording",
    )


def check_frozen(inputs: AuditInputs) -> AuditCheck:
    """Share of frames in which a position does not change while another view shows that the point moves [1]."""
    views = [str(view) for view in inputs.aligned["view"].values]
    found = {}
    for point in inputs.moving:
        moved = [_find_moving(inputs.aligned.sel(view=view, point=point)) for view in views]
        for number, view in enumerate(views):
            others = [m for n, m in enumerate(moved) if n != number]
            if others:
                still = _find_unchanged(inputs.tracks[view].sel(point=point))
                # On the view's own clock; a share needs no common one.
                both = np.zeros(len(still), np.bool_)
                both[: len(others[0])] = still[: len(others[0])] & np.any(others, axis=0)[: len(still)]
                found[f"{point} in {view}"] = float(both.mean())
    return judge(
        "frozen tracks",
        found,
        Limits(_FROZEN_CAUTION, _FROZEN_FAIL, "1"),
        good="no track stands still while its point moves",
        bad="{} stands still while another view shows motion: frames repeated, or the tracker holds on to dirt",
    )


def check_slip(inputs: AuditInputs) -> AuditCheck:
    """Drift along the structure, or across the epipolar lines, of one point, as a share of its vertical motion [1].

    Notes
    -----
    A subset that slides over a texture moves a point where structures do not: along the structure (a slip along the
    epipolar line) or apart in two views (a slip across it). Means over eighths of the recording are compared; drift
    within their noise counts as none, and drift that all points share is no slip.
    """
    drifts, scale = {}, {}
    data = inputs.unrefined
    suspicious = [str(a) for a in data["axis"].values if str(a) in ("longitudinal", "forward")]
    vertical = [str(a) for a in data["axis"].values if str(a) in ("vertical", "down")]
    for point in inputs.moving:
        one = data.sel(point=point)
        if not suspicious or not vertical:
            continue
        measured = np.isfinite(one["displacement"].sel(axis=[suspicious[0], vertical[0]]).values).all(axis=-1)
        ok = (one["status"].values == Status.OK) & measured
        if ok.sum() < 4 * _BLOCKS:
            continue
        scale[point] = float(np.ptp(one["displacement"].sel(axis=vertical[0]).values[ok]))
        along = one.sel(axis=suspicious[0])
        drifts[point] = _compute_block_means(along["displacement"].values, along["displacement_std"].values, ok)
    found = {}
    for point, (means, noise) in drifts.items():
        others = [m for p, (m, _) in drifts.items() if p != point]
        own, least = means, noise
        if len(others) > 1:
            own = means - np.median(others, axis=0)
            least = float(np.hypot(noise, np.median([n for p, (_, n) in drifts.items() if p != point])))
        drift = float(np.ptp(own))
        found[point] = drift / scale[point] if drift > _SIGNIFICANT * least and scale[point] > 0 else 0.0
    return judge(
        "slipping tracks",
        found,
        Limits(_SLIP_CAUTION, _SLIP_FAIL, "1"),
        good="no point drifts away from the others",
        bad="point '{}' drifts along the structure as no other point does: its track slips in one view",
    )


def check_static_points(inputs: AuditInputs) -> AuditCheck:
    """Displacement of points that must not move, beyond their noise, as a share of the structure's [1]."""
    name = "static points"
    if not inputs.static:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _STILL_CAUTION, "1", _NO_STATIC)
    axes = [str(a) for a in inputs.unrefined["axis"].values][:2]
    moving = max(
        (_compute_excess(inputs.unrefined.sel(point=p, axis=axes)) for p in inputs.moving), default=float("nan")
    )
    found = {p: _compute_excess(inputs.unrefined.sel(point=p, axis=axes)) / moving for p in inputs.static if moving > 0}
    return judge(
        name,
        found,
        Limits(_STILL_CAUTION, _STILL_FAIL, "1"),
        good="what must not move does not",
        bad="point '{}' must not move and does: a tripod moves, or the point is not where it was meant",
    )


def check_camera_motion(inputs: AuditInputs) -> AuditCheck:
    """Motion in the picture [px] that a view's static points have in common, as a share of the structure's [1].

    Motion that was removed with the help of the static points counts by the part that is left, and is a caution in any
    case.
    """
    name = "tripods"
    if not inputs.static:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _STILL_CAUTION, "1", _NO_STATIC)
    left, removed = {}, {}
    for view, tracks in inputs.tracks.items():
        structure = float(np.fmax.reduce(inputs.motion_px(view), initial=0.0))
        motion = inputs.camera_motion.get(view)
        common, noise = _compute_common_motion(tracks, inputs.static_in(view))
        if motion is not None and motion.status == CameraMotionStatus.NO_GAIN:
            # They move, but not together: air, which the noise of the steady tracks holds.
            _, noise = _compute_common_motion(inputs.aligned.sel(view=view), inputs.static_in(view))
        if not (structure > 0 and len(common)):
            continue
        moved = float(np.sqrt(max(float(common.var(axis=0).sum()) - (NOISE_TRUST * noise) ** 2, 0.0)) / structure)
        left[view] = moved
        if motion is not None and motion.applied and moved >= _STILL_CAUTION:
            removed[view] = motion
            # A single static point cannot show what its correction leaves.
            left[view] = motion.rms_after_px / structure if np.isfinite(motion.rms_after_px) else _STILL_CAUTION
    check = judge(
        name,
        left,
        Limits(_STILL_CAUTION, _STILL_FAIL, "1"),
        good="the cameras stood still",
        bad="camera '{}' moved: what stands still moves in its picture",
    )
    lost = {view: why for view, one in inputs.camera_motion.items() if (why := _LOST_POSES.get(one.status, ""))}
    if lost and check.outcome == Outcome.FAIL:
        view, why = next(iter(lost.items()))
        return replace(check, where=view, sentence=why.format(view))
    if not removed or check.outcome == Outcome.FAIL:
        return check
    view, motion = max(removed.items(), key=lambda pair: pair[1].rms_before_px)
    return AuditCheck(name, Outcome.CAUTION, check.value, _STILL_CAUTION, "1", _describe_removed(view, motion), view)


def _describe_removed(view: str, motion: ViewMotion) -> str:
    """What was taken out of a view, and how it was checked."""
    count, before, after = len(motion.static), motion.rms_before_px, motion.rms_after_px
    if motion.status == CameraMotionStatus.FOLLOWED_BY_THREE:
        return (
            f"camera {view!r} moved far: {before:.2f} px (rms) were taken out by its pose in every frame; three static "
            "points show it and nothing checks them: name a fourth"
        )
    if motion.far:
        return (
            f"camera {view!r} moved far: {before:.2f} px (rms) were taken out by its pose in every frame, found by "
            f"{count} static points; {after:.3f} px are left of each by the others"
        )
    return (
        f"camera {view!r} moved: {before:.2f} px (rms) were removed with the help of {count} static points, "
        f"{after:.2f} px are left"
    )


def check_stabilization(inputs: AuditInputs) -> AuditCheck:
    """Share of the structure's motion [px] that a view's static points show, where the two go together [1]."""
    name = "stabilised video"
    if not inputs.static:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _FOLLOWS_CAUTION, "1", _NO_STATIC)
    found = {}
    for view, tracked in inputs.tracks.items():
        motion = inputs.motion_px(view)
        far = view in inputs.camera_motion and inputs.camera_motion[view].far
        tracks = inputs.aligned.sel(view=view) if far else tracked  # what is left of far motion may follow
        common, _ = _compute_common_motion(tracks, inputs.static_in(view))
        if not len(common) or not np.fmax.reduce(motion, initial=0.0) > 0:
            continue
        point = inputs.moving[int(np.nanargmax(motion))]
        structure = _centre(tracks.sel(point=point)["position"].values)
        known = np.isfinite(structure).all(axis=1) & np.isfinite(common).all(axis=1)
        a, b = structure[known].ravel(), common[known].ravel()
        if len(a) < 20 or not (a.std() > 0 and b.std() > 0):
            continue
        share, correlation = float(a @ b / (a @ a)), float(np.corrcoef(a, b)[0, 1])
        # An electronic stabiliser takes part of the structure's motion from the picture: both then move together.
        left = abs(share) / (1 - share) if share < 0 else abs(share)
        found[view] = left if abs(correlation) >= _FOLLOWS_CORRELATION else 0.0
    check = judge(
        name,
        found,
        Limits(_FOLLOWS_CAUTION, _FOLLOWS_FAIL, "1"),
        good="the picture does not follow the structure",
        bad="the picture of '{}' follows the structure: the camera stabilises. Switch it off and film again",
    )
    following = [view for view, share in found.items() if share >= _FOLLOWS_CAUTION]
    if check.outcome == Outcome.FAIL and all(_is_taken_out(inputs, view) for view in following):
        sentence = f"{check.where!r} stabilises its picture; the static points took it out, but switch it off next time"
        return replace(check, outcome=Outcome.CAUTION, sentence=sentence)
    return check


def _is_taken_out(inputs: AuditInputs, view: str) -> bool:
    """Whether the static points removed a view's motion, and hardly any of it is left in them."""
    motion = inputs.camera_motion.get(view)
    if motion is None or not motion.applied or not np.isfinite(motion.rms_after_px):
        return False
    return motion.rms_after_px < _STILL_CAUTION * float(np.fmax.reduce(inputs.motion_px(view), initial=0.0))


def check_halves(inputs: AuditInputs) -> AuditCheck:
    """Motion of one half of a subset against the other, beyond its noise, as a share of the picture's motion [1]."""
    name, found = "halves of a subset", {}
    for view, tracks in inputs.tracks.items():
        if "half_difference" not in tracks:
            continue
        motion = inputs.motion_px(view)
        for number, point in enumerate(inputs.moving):
            one = tracks.sel(point=point)
            apart = one["half_difference"].values
            known = np.isfinite(apart).all(axis=1)
            if "half_covariance" in one:
                known &= np.isfinite(one["half_covariance"].values).all(axis=(1, 2))
            if known.sum() > 10 and motion[number] > 0:
                noise = NOISE_TRUST**2 * _compute_noise_of_halves(one)
                left = _without_turns(apart[known], inputs.camera_motion.get(view), known)
                excess = max(float(_without_slips(left).var(axis=0).sum()) - noise, 0.0)
                found[f"{point} in {view}"] = float(np.sqrt(excess) / motion[number])
    return judge(
        name,
        found,
        Limits(_HALVES_CAUTION, _HALVES_FAIL, "1"),
        good="both halves of every subset move alike",
        bad="the halves of {} move apart: the square covers an edge, a plant or something else that moves",
    )


def _without_turns(apart: FloatArray, motion: ViewMotion | None, known: BoolArray) -> FloatArray:
    """Differences (N, 2) in the known frames, without what the pose of a camera that moves far makes of them.

    A picture that turns and grows moves one half of a subset against the other, by an amount that follows the pose.
    """
    if motion is None or not motion.far:
        return apart
    pose = np.column_stack([motion.rotation, motion.translation])[known]
    found = np.isfinite(pose).all(axis=1)
    model = np.column_stack([np.ones(int(found.sum())), pose[found]])
    left = apart[found] - model @ np.linalg.lstsq(model, apart[found], rcond=None)[0]
    # Seven numbers take their share of what is left.
    return np.asarray(left * np.sqrt(len(left) / max(len(left) - model.shape[1], 1)))


def _without_slips(apart: FloatArray) -> FloatArray:
    """Differences (T, 2) without those of frames in which a half lost itself: a second motion is seen all the time."""
    far = np.abs(apart - np.median(apart, axis=0))
    return np.asarray(apart[(far <= _SLIP * np.maximum(np.median(far, axis=0), 1e-9)).all(axis=1)])


def _find_unchanged(track: xr.Dataset) -> BoolArray:
    """Frames of runs in which a position does not change at all."""
    position, time_s = track["position"].values, track["time"].values
    step = np.abs(np.diff(position, axis=0)).max(axis=1)
    still = np.zeros(len(position), np.bool_)
    for run in unbroken_runs(step < _UNCHANGED_PX):
        if time_s[run.stop] - time_s[run.start] >= _FROZEN_S:
            still[run.start : run.stop + 1] = True
    return still


def _find_moving(track: xr.Dataset) -> BoolArray:
    """Frames about which, within `_FROZEN_S`, a position changes by more than its noise."""
    position, time_s = track["position"].values, track["time"].values
    half = max(1, round(_FROZEN_S / max(float(np.median(np.diff(time_s))), 1e-6) / 2))
    padded = np.pad(position, ((half, half), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    with np.errstate(invalid="ignore"):
        span = np.linalg.norm(windows.max(axis=-1) - windows.min(axis=-1), axis=-1)
        return np.asarray(span > _MOVED_STD * np.sqrt(_compute_noise(track)))


def _compute_noise(track: xr.Dataset) -> float:
    """Mean stated variance of a track, u and v together or across an edge [px2]."""
    covariance = track["position_covariance"].values[:, None]
    return float(mean_of_known(measured_variance(covariance, edges_across(track)[None]))[0])


def _compute_noise_of_halves(track: xr.Dataset) -> float:
    """Mean stated variance of the difference of a subset's halves, u and v together or across an edge [px2]."""
    # Both halves have about twice the standard deviation of the whole each, which holds a codec's errors that
    # residuals of so few pixels may not show; more where one has little texture, as it states itself.
    least = 8.0 * _compute_noise(track)
    if "half_covariance" not in track:
        return least
    covariance = track["half_covariance"].values[:, None]
    stated = float(mean_of_known(measured_variance(covariance, edges_across(track)[None]))[0])
    return float(np.fmax(least, stated))


def _centre(position: FloatArray) -> FloatArray:
    """Positions less their mean over time, shape (T, 2) [px]."""
    return np.asarray(position - mean_of_known(position))


def _compute_common_motion(tracks: xr.Dataset, static: list[str]) -> tuple[FloatArray, float]:
    """Mean motion of a view's static points, shape (T, 2) [px], and its noise, u and v together [px].

    Edges, which see a part of the motion, are left out.
    """
    edge = dict(zip(tracks["point"].values.tolist(), find_edges(tracks), strict=True))
    static = [point for point in static if not edge[point]]
    chosen = tracks.sel(point=static)
    known = np.isfinite(chosen["position"].values).all(axis=(1, 2))
    if not static or known.sum() < 10:
        return np.empty((0, 2)), float("nan")
    centred = chosen["position"].values - np.nanmean(chosen["position"].values[known], axis=0)
    variances = [_compute_noise(chosen.sel(point=point)) for point in static]
    return np.asarray(centred.mean(axis=1)), float(np.sqrt(np.sum(variances)) / len(variances))


def _compute_block_means(values: FloatArray, std: FloatArray, ok: BoolArray) -> tuple[FloatArray, float]:
    """Means over parts of a series, and the standard deviation of one."""
    blocks = np.array_split(np.flatnonzero(ok), _BLOCKS)
    noise = float(np.sqrt(np.mean(std[ok] ** 2) / min(len(block) for block in blocks)))
    # Motion of the structure does not average out over a short block.
    spread = float(np.median([np.std(values[block]) / np.sqrt(len(block)) for block in blocks]))
    # Nor do slow errors, as of trembling air: halves that follow each other show what is left of them.
    halves = np.array([values[half].mean() for block in blocks for half in np.array_split(block, 2)])
    slow = MAD_TO_STD * float(np.median(np.abs(np.diff(halves)))) / 2
    return np.array([values[block].mean() for block in blocks]), max(noise, spread, slow)


def _compute_excess(series: xr.Dataset) -> float:
    """Root mean square motion over both axes beyond the stated noise [mm]."""
    ok = series["status"].values == Status.OK
    if ok.sum() < 10:
        return float("nan")
    variance = series["displacement"].values[ok].var(axis=0)
    noise = (NOISE_TRUST * series["displacement_std"].values[ok]) ** 2
    excess = np.maximum(variance - noise.mean(axis=0), 0.0)
    measured = np.isfinite(excess)
    return float(np.sqrt(excess[measured].sum())) if measured.any() else float("nan")
