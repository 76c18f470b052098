"""The whole way of one measurement, in the order of the paper's Figures 3 and 4.

`solve_cameras` (B in Figure 4), `track_views` (A), `displacement_of` (C); `vfm_sdm.measurement` runs them in a folder.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.inputs.session import Session, Site, View
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.audit import Audit, AuditInputs, audit
from vfm_sdm.stages.camera_motion import ViewMotion, remove_camera_motion
from vfm_sdm.stages.cameras.base import estimator_of
from vfm_sdm.stages.cameras.site import SiteAdjustment, adjust_to_site
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.agreement import compute_gain_difference
from vfm_sdm.stages.displacement.monocular import compute_planar_displacement, scale_factor
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty
from vfm_sdm.stages.matching.correspondence import OK
from vfm_sdm.stages.matching.locate import transfer_on_face, transfer_points
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.refinement import Refinement, SgrSettings, SgrWeights, refine
from vfm_sdm.stages.synchronize import Synchronization, align_views, synchronize_views
from vfm_sdm.stages.tracking.base import Tracker
from vfm_sdm.stages.tracking.track_noise import include_scatter

__all__ = [
    "ONE_VIEW",
    "Progress",
    "audit_of",
    "displacement_of",
    "solve_cameras",
    "steady_tracks",
    "synchronize_tracks",
    "track_views",
]

Progress = Callable[[str, int, int | None], None]
"""Called with what is being done, the steps done and the steps in all (None when unknown)."""

ONE_VIEW = "one view: motion in the image plane only"

_SEARCH_S = 3.0
"""How far from the stated offset between views the true one may be [s]."""
_NAMED_PIXEL_STD = 0.5
"""How well a user points at the end of a length [px]."""


def solve_cameras(session: Session, frames: Mapping[str, LumaArray]) -> CameraSolution:
    """Cameras, structural axes and the points' pixels in every view, from the first frames and the site's lengths.

    Parameters
    ----------
    session
        Settings and everything measured on site.
    frames
        First frame of every view by name, in the session's order.

    Raises
    ------
    SessionError
        A point lies outside its view's image.
    CameraError, BackendUnavailableError
        The settings of the camera estimator do not suffice.
    """
    _check_points(session, frames)
    if len(frames) == 1:
        view = next(iter(frames))
        named_here = {view: {p.name: p.pixel for p in session.point}}
        return CameraSolution(
            None, None, None, named_here, {view: {p.name: OK for p in session.point}}, status=ONE_VIEW
        )
    estimate = estimator_of(session.resolved_method).estimate(session, frames)
    if estimate.rig is None:
        named = {
            view: {p.name: (p.pixel if p.view == view else (np.nan, np.nan)) for p in session.point} for view in frames
        }
        return CameraSolution(None, None, None, named, {}, status=estimate.status, notes=estimate.notes)
    pixels, states = transfer_points(session, frames, estimate.rig, estimate.matches)
    # A rig of unknown accuracy takes no part in the adjustment, and its scale has no stated uncertainty.
    known = estimate.rig.covariance is not None
    size = len(CAMERA_PARAMETERS) * len(estimate.rig)
    prior = estimate.rig if known else replace(estimate.rig, covariance=np.zeros((size, size)))
    adjusted, unused = _adjust(session, prior, estimate.matches, pixels)
    if adjusted.frame is not None and transfer_on_face(session, frames, adjusted.rig, adjusted.frame, pixels, states):
        adjusted, unused = _adjust(session, prior, estimate.matches, pixels)
    notes = [*estimate.notes, *adjusted.notes, *unused]
    notes += [] if known else ["the camera file states no covariance: the scale has no stated uncertainty"]
    notes += [
        f"point {name!r}, view {view!r}: {why}"
        for name, per in states.items()
        for view, why in per.items()
        if why != OK
    ]
    names = list(frames)
    return CameraSolution(
        adjusted.rig if known else replace(adjusted.rig, covariance=None),
        adjusted.frame,
        adjusted.covariance if known else None,
        {view: {p: (float(u[i, 0]), float(u[i, 1])) for p, u in pixels.items()} for i, view in enumerate(names)},
        {view: {p: states[p].get(view, OK) for p in pixels} for view in names},
        quantities=adjusted.quantities,
        status=adjusted.status if estimate.status == "ok" else estimate.status,
        notes=tuple(notes),
        epipolar_rms_px=adjusted.epipolar_rms_px,
    )


def track_views(
    videos: Mapping[str, Video],
    points: Mapping[str, Mapping[str, tuple[float, float]]],
    tracker: Tracker,
    *,
    progress: Progress | None = None,
) -> dict[str, xr.Dataset]:
    """Tracks of all points in every view, each on its own clock; a point without a position is lost throughout.

    Covariances are raised to what the tracks scatter by, see `vfm_sdm.stages.tracking.track_noise.include_scatter`.

    Parameters
    ----------
    videos
        Recordings by view.
    points
        By view and point name: pixel in the first frame, NaN where unknown.
    tracker
        What follows them.
    """
    tracks = {}
    for view, video in videos.items():
        names = list(points[view])
        positions = np.array([points[view][name] for name in names], dtype=np.float64).reshape(-1, 2)
        known = np.asarray(np.isfinite(positions).all(axis=1))
        count = video.info.frame_count
        step = None if progress is None else lambda done, v=view, n=count: progress(f"tracking {v}", done, n)
        if known.any():
            found = tracker.track(
                video, positions[known], names=[n for n, k in zip(names, known, strict=True) if k], progress=step
            )
        else:
            found = _lost_tracks(np.array([frame.time_s for frame in video.frames()]), names)
        found.attrs.update(view=view, image_width=video.info.width, image_height=video.info.height)
        whole = known.all() or not known.any()
        tracks[view] = include_scatter(found if whole else _with_lost_points(found, names))
    return tracks


def steady_tracks(
    session: Session, tracks: Mapping[str, xr.Dataset], solution: CameraSolution
) -> tuple[Mapping[str, xr.Dataset], dict[str, ViewMotion]]:
    """Tracks without the motion of the cameras that static points show, and that motion by view.

    The tracks as they are, and nothing, where the session has no static point or keeps the motion.
    """
    static = [p.name for p in session.point if p.static]
    if session.method.camera_motion == "keep" or not static or solution.rig is None or not solution.rig.metric:
        return tracks, {}
    found = remove_camera_motion(tracks, solution.rig, static)
    return found.tracks, dict(found.views)


def synchronize_tracks(
    session: Session, tracks: Mapping[str, xr.Dataset]
) -> tuple[xr.Dataset, dict[str, Synchronization]]:
    """Tracks of all views on the reference view's clock, and what is known of each view's clock.

    The offset is estimated from the moving points where the session says so; where their motion does not tell it, the
    stated offset stands and the status says why.

    Raises
    ------
    DatasetError
        The recordings do not overlap.
    """
    stated = {view.name: session.stated_offset_s(view) or 0.0 for view in session.view}
    found: dict[str, Synchronization] = {}
    moving = [p.name for p in session.point if not p.static]
    if session.method.synchronization == "motion" and moving:
        for view in session.view:
            pair = {session.reference_view.name: tracks[session.reference_view.name], view.name: tracks[view.name]}
            one = synchronize_views(
                pair, start_offsets_s=stated, start_std_s=view.time_offset_std_s, points=moving, search_s=_SEARCH_S
            )
            found[view.name] = one[view.name]
    known = {name: one for name, one in found.items() if one.ok}
    offsets = {name: known[name].offset_s if name in known else offset for name, offset in stated.items()}
    return align_views(tracks, offsets, {name: one.rate_ratio for name, one in known.items()}), found


def displacement_of(session: Session, tracks: Mapping[str, xr.Dataset], solution: CameraSolution) -> xr.Dataset | None:
    """Displacement dataset from tracks of all views and the cameras.

    A single view gives motion in the image plane if a length between two of its points is known. ``None`` where there
    is neither a rig nor such a length; the status of the solution says why.

    Raises
    ------
    DatasetError
        The recordings do not overlap, or the refinement was asked for without the structure's axes or two views.
    """
    if solution.rig is None and len(session.view) == 1 and session.site.length:
        return _planar_displacement(session, tracks[session.view[0].name])
    if solution.rig is None:
        return None
    tracks, motions = steady_tracks(session, tracks, solution)
    aligned, clocks = synchronize_tracks(session, tracks)
    refinement = None
    if session.method.refinement == "sgr":
        refinement = _refine(session, aligned, solution)
    compute = partial(
        compute_displacement,
        rig=solution.rig,
        frame=solution.frame,
        covariance=solution.covariance,
        still_interval_s=session.method.still_interval_s,
    )
    displacement = compute(
        aligned if refinement is None else refinement.tracks,
        refinement_gain=None if refinement is None else refinement.gain,
        attrs={
            "camera_status": solution.status,
            "tracker": session.method.tracker,
            "cameras": session.method.cameras,
            "refinement": session.method.refinement,
        },
    )
    unrefined = displacement if refinement is None else compute(aligned, covariance=None)
    displacement = add_uncertainty(
        displacement,
        BudgetInputs(
            aligned,
            clock_std_s={view.name: _clock_std(session, view, clocks) for view in session.view[1:]},
            bits_per_pixel={view: float(t.attrs.get("decode_bits_per_pixel", np.inf)) for view, t in tracks.items()},
            gain_difference=compute_gain_difference(aligned, unrefined, solution.rig, solution.frame),
            baseline=None if refinement is None else (unrefined, session.method.sgr.suppressed_axis),
            refinement_gain=None if refinement is None else refinement.gain,
        ),
    )
    for view, motion in motions.items():
        displacement.attrs[f"camera_motion_{view}"] = [motion.rms_before_px, motion.rms_after_px]
        displacement.attrs[f"camera_motion_{view}_status"] = motion.status
    for view, clock in clocks.items():
        displacement.attrs[f"clock_{view}"] = [clock.offset_s, clock.lag_std_s, clock.rate_ratio]
        displacement.attrs[f"clock_{view}_status"] = clock.status
    if any(_clock_unknown(session, view, clocks) for view in session.view[1:]):
        codes = displacement["status"]
        displacement["status"] = codes.where(codes != Status.OK, np.int8(Status.UNRELIABLE)).assign_attrs(codes.attrs)
    if refinement is not None:
        displacement["refinement_correction"] = (("time", "point"), refinement.correction_px, {"units": "px"})
        displacement["prior_share"] = (("point",), refinement.prior_share, {"units": "1"})
        displacement.attrs["refinement_status"] = list(refinement.status)
        displacement.attrs["refined_view"] = [view or "" for view in refinement.uncertain_view]
    return displacement


def audit_of(
    session: Session,
    tracks: Mapping[str, xr.Dataset],
    solution: CameraSolution,
    displacement: xr.Dataset,
    frames: Mapping[str, LumaArray] | None = None,
) -> Audit | None:
    """Checks of a measurement and their verdict; ``None`` for a single view, of which nothing can be checked.

    Parameters
    ----------
    session, tracks, solution
        As in `displacement_of`.
    displacement
        Its result.
    frames
        First frame of every view; without, checks that need images are left out.
    """
    if solution.rig is None or len(session.view) < 2:
        return None
    steady, motions = steady_tracks(session, tracks, solution)
    aligned, _ = synchronize_tracks(session, steady)
    unrefined = displacement
    if session.method.refinement != "none":
        interval = session.method.still_interval_s
        unrefined = compute_displacement(aligned, solution.rig, frame=solution.frame, still_interval_s=interval)
        unrefined["status"] = displacement["status"]
    return audit(
        AuditInputs(
            session,
            solution,
            tracks,
            aligned,
            displacement,
            unrefined,
            camera_motion=motions,
            frames=frames or {},
        )
    )


def _refine(session: Session, aligned: xr.Dataset, solution: CameraSolution) -> Refinement:
    if solution.rig is None or solution.frame is None:
        raise DatasetError(
            "refinement: expected the structure's axes, got none; measure perpendicular_distance and "
            'longitudinal_distance, or set method.refinement = "none"'
        )
    sgr = session.method.sgr
    weights = SgrWeights(sgr.longitudinal, sgr.longitudinal_rate, sgr.others, sgr.others_rate, sgr.pixel)
    settings = SgrSettings(weights, suppressed_axis=sgr.suppressed_axis, uncertain_view=sgr.uncertain_view)
    interval = session.method.still_interval_s
    return refine(aligned, solution.rig, solution.frame, settings=settings, still_interval_s=interval)


def _clock_unknown(session: Session, view: View, clocks: Mapping[str, Synchronization]) -> bool:
    """Whether neither the motion nor the session tells a view's offset: its displacement is not to be trusted."""
    return view.name in clocks and not clocks[view.name].ok and session.stated_offset_s(view) is None


def _clock_std(session: Session, view: View, clocks: Mapping[str, Synchronization]) -> float:
    """Standard deviation of a view's offset [s]: of the motion's, else as stated; NaN where nobody knows it."""
    if view.name in clocks and clocks[view.name].ok:
        return clocks[view.name].lag_std_s
    if view.time_offset_std_s is not None:
        return view.time_offset_std_s
    return float("nan") if _clock_unknown(session, view, clocks) else 0.0


def _planar_displacement(session: Session, tracks: xr.Dataset) -> xr.Dataset:
    """The monocular baseline: a known length between two points of the view sets millimetres a pixel."""
    length = session.site.length[0]
    ends = [np.array(p.pixel) for name in length.points for p in session.point if p.name == name]
    factor = scale_factor(ends[0], ends[1], length.value * 1e3)
    picked = _NAMED_PIXEL_STD * np.sqrt(2) / np.linalg.norm(ends[0] - ends[1])
    return compute_planar_displacement(
        tracks, mm_per_px=factor, scale_std=float(np.hypot(length.std / length.value, picked))
    )


def _adjust(
    session: Session, prior: Rig, matches: tuple[Matches, ...], pixels: Mapping[str, FloatArray]
) -> tuple[SiteAdjustment, list[str]]:
    """The cameras adjusted to everything measured on site to points seen in every view, and what had to be left out."""
    seen = {name: pixels[name] for name in pixels if np.isfinite(pixels[name]).all()}
    site, unused = _measured_to(session.site, seen)
    adjusted = adjust_to_site(
        prior,
        matches,
        site,
        seen,
        face_points=frozenset(p.name for p in session.point if not p.static and p.name in seen),
        levels={
            v.name: (np.radians(v.level.pitch), np.radians(v.level.roll), np.radians(v.level.std_deg))
            for v in session.view[1:]
            if v.level is not None
        },
    )
    return adjusted, unused


def _check_points(session: Session, frames: Mapping[str, LumaArray]) -> None:
    faults = []
    for point in session.point:
        for view, (u, v) in {point.view: point.pixel, **point.pixel_in}.items():
            height, width = frames[view].shape
            if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
                faults.append(
                    f"{point.name!r} in view {view!r}: expected inside {width} x {height}, got ({u:g}, {v:g})"
                )
    if faults:
        raise SessionError("points: " + "; ".join(faults) + "; correct their pixels")


def _measured_to(site: Site, seen: Mapping[str, FloatArray]) -> tuple[Site, list[str]]:
    """The site without lengths to points that are not seen in every view, and what was left out."""
    ranges = tuple(r for r in site.range if r.point in seen)
    lengths = tuple(one for one in site.length if set(one.points) <= set(seen))
    lost = [f"range to {r.point!r}" for r in site.range if r not in ranges]
    lost += [f"length {one.points[0]!r} to {one.points[1]!r}" for one in site.length if one not in lengths]
    notes = [f"{what} not used: its point was not found in every view" for what in lost]
    return site.model_copy(update={"range": ranges, "length": lengths}), notes


def _lost_tracks(time_s: FloatArray, names: list[str]) -> xr.Dataset:
    """Tracks of points none of which has a position."""
    shape = (len(time_s), len(names))
    nothing = np.full((*shape, 2), np.nan), np.full((*shape, 2, 2), np.nan)
    return make_tracks(time_s, names, *nothing, np.full(shape, Status.LOST), attrs={})


def _with_lost_points(tracks: xr.Dataset, names: list[str]) -> xr.Dataset:
    """The tracks with rows of NaN and status lost for the points that were not tracked, in the order of ``names``."""
    codes = tracks["status"].dtype.type(Status.LOST)
    return tracks.reindex(point=names, fill_value={"status": codes})
