"""A plan of what was measured: a finished run's cameras, session, motion and noise, for the same again, but better."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.errors import ResultsError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Session, read_session
from vfm_sdm.outputs.results import summarize_displacement
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution
from vfm_sdm.studies.planning.plan import Plan

__all__ = ["plan_from_run"]

_SPAN = 10.0
"""Length of the face over that of the points: a run does not say where the supports are, and all points swing alike."""
_LEAST_SPAN_M, _ABOVE_M = 10.0, 0.3
_EYE_M = 1.5
_CLEAR = 3.0
"""Amplitude over the detection limit from which an axis counts as moving."""


def plan_from_run(folder: Path | str) -> Plan:
    """The plan that a finished run would have had.

    Parameters
    ----------
    folder
        Run folder with ``cameras.toml``, ``displacement.nc`` and ``session.resolved.toml``.

    Raises
    ------
    ResultsError
        A file is missing or damaged, or the run has no cameras in the structure's axes.

    Notes
    -----
    Places are those of the adjusted cameras and of the measured points; lenses have the priors that they had, readings
    the standard deviations of the session, tracks the noise that the displacement shows.
    """
    run = Path(folder)
    solution, _ = read_solution(run / "cameras.toml")
    displacement = read_displacement(run / "displacement.nc")
    session = read_session(run / "session.resolved.toml", check_files=False)
    if solution.rig is None or solution.frame is None or session.site.perpendicular_distance is None:
        raise ResultsError(
            f"{run}: expected a run with cameras in the structure's axes, got none; measure the perpendicular and the "
            "longitudinal distance"
        )
    places = _list_places(displacement)
    known = [name for name, at in places.items() if np.isfinite(at).all()]
    if not any(not point.static for point in session.point if point.name in known):
        raise ResultsError(f"{run}: expected a point of the structure that was measured, got none; see the run's notes")
    along = np.array([places[name][2] for name in known])
    span = max(_SPAN * float(np.ptp(along)), _LEAST_SPAN_M)
    start = float(along.mean()) - span / 2
    cameras = _list_cameras(solution, session, start)
    time_s = displacement["time"].values
    still = session.method.still_interval_s
    return Plan(
        name=session.name,
        structure={**_describe_face(session, places), "span_m": span, "noise_px": _find_noise(displacement, session)},
        camera=cameras,
        point=[
            {
                "name": point.name,
                "perpendicular_m": _perpendicular(solution, session) - float(places[point.name][0]),
                "longitudinal_m": float(places[point.name][2]) - start,
                "height_m": _EYE_M - float(places[point.name][1]),
                "static": point.static,
            }
            for point in session.point
            if point.name in known
        ],
        motion=_list_motions(displacement, [p.name for p in session.point if p.name in known and not p.static]),
        measured=_list_measurements(session, known),
        fps=float((len(time_s) - 1) / np.ptp(time_s)),
        duration_s=float(np.ptp(time_s)),
        still_s=0.2 if still is None else max(float(still[1]), 0.1),
        synchronization=session.method.synchronization,
        time_offset_std_s=max((view.time_offset_std_s or 0.0 for view in session.view), default=0.0) or None,
    )


def _perpendicular(solution: CameraSolution, session: Session) -> float:
    """Distance from the reference camera to the face, as adjusted [m]."""
    found = [one.value for one in solution.quantities if one.name == "perpendicular distance"]
    noted = session.site.perpendicular_distance
    return float(found[0]) if found else float(noted.value if noted is not None else np.nan)


def _axes(solution: CameraSolution) -> FloatArray:
    """Rotation from the first camera's frame to the structure's axes, shape (3, 3)."""
    return np.eye(3) if solution.frame is None else solution.frame.rotation


def _list_places(displacement: xr.Dataset) -> dict[str, FloatArray]:
    """Median place of every point in the structure's axes, shape (3,) [m]; NaN where it was not measured."""
    position = displacement["position"].transpose("time", "point", "axis").values
    with np.errstate(invalid="ignore"):
        found = np.array([np.nanmedian(of, axis=0) if np.isfinite(of).any() else np.full(3, np.nan)
                          for of in position.swapaxes(0, 1)])  # fmt: skip
    return {str(name): at for name, at in zip(displacement["point"].values, found, strict=True)}


def _list_cameras(solution: CameraSolution, session: Session, start: float) -> list[dict[str, Any]]:
    """Places, directions and lenses of the cameras."""
    rig, axes, away = solution.rig, _axes(solution), _perpendicular(solution, session)
    priors = {one.name.removeprefix("focal "): one for one in solution.quantities if one.name.startswith("focal ")}
    cameras = []
    for name, camera in zip(() if rig is None else rig.names, () if rig is None else rig.cameras, strict=True):
        center = axes @ camera.center
        seen = _seen_on_face(camera, axes, away)
        known = priors.get(name)
        std = 1e-3 if known is None else max(known.prior_std / known.prior, 1e-6)
        # A lens states the focal length along the longer side of its picture.
        focal = float(camera.K[0, 0] if camera.image_size[0] >= camera.image_size[1] else camera.K[1, 1])
        cameras.append(
            {
                "name": name,
                "perpendicular_m": float(away - center[0]),
                "longitudinal_m": float(center[2]) - start,
                "height_m": _EYE_M - float(center[1]),
                "looks_at": (float(seen[2]) - start, _EYE_M - float(seen[1])),
                "image_size": camera.image_size,
                "lens": {"focal_px": focal, "relative_std": std},
            }
        )
    return cameras


def _seen_on_face(camera: Camera, axes: FloatArray, away: float) -> FloatArray:
    """Place on the face that the middle of a picture shows, in the structure's axes, shape (3,) [m]."""
    middle = np.append(camera.normalize((np.array(camera.image_size) - 1) / 2), 1.0)
    ray, center = axes @ camera.rotation.T @ middle, axes @ camera.center
    return np.asarray(center + ray * (away - center[0]) / ray[0])


def _describe_face(session: Session, places: dict[str, FloatArray]) -> dict[str, float]:
    """Edges of the face around the points of the structure [m]."""
    heights = [
        _EYE_M - float(places[point.name][1])
        for point in session.point
        if not point.static and np.isfinite(places.get(point.name, np.full(3, np.nan))).all()
    ]
    return {
        "bottom_m": min(heights) - _ABOVE_M,
        "top_m": max(heights) + _ABOVE_M,
        "face_offset_std_m": session.site.face_offset_std,
    }


def _find_noise(displacement: xr.Dataset, session: Session) -> float:
    """Standard deviation of one frame's track that the random part of the displacement shows [px]."""
    moving = [point.name for point in session.point if not point.static]
    data = displacement.sel(point=[name for name in displacement["point"].values if name in moving])
    reach = np.sqrt((data["pixel_sensitivity"] ** 2).sum(("view", "pixel")))
    noise = (data["displacement_std"].median("time") / reach).values
    return float(np.nanmedian(noise))


def _list_motions(displacement: xr.Dataset, moving: list[str]) -> dict[str, dict[str, float]]:
    """Amplitude of the point that moves most, and frequency, along every axis that moves."""
    summary = summarize_displacement(displacement.sel(point=moving))
    rate_hz = (displacement.sizes["time"] - 1) / float(np.ptp(displacement["time"].values))
    found: dict[str, dict[str, float]] = {}
    for axis in [str(name) for name in displacement["axis"].values]:
        rows = [figures["axes"][axis] for figures in summary.values() if figures["axes"][axis]["rms_mm"] is not None]
        most = max(rows, key=lambda row: float(row["rms_mm"]), default=None)
        if most is None:
            continue
        amplitude = float(np.sqrt(2) * most["rms_mm"])
        if axis != "longitudinal" or amplitude > _CLEAR * float(most["random_std_mm"] or np.inf):
            frequency = min(most["dominant_frequency_hz"] or 1.0, 0.45 * rate_hz)
            found[axis] = {"amplitude_mm": max(amplitude, 1e-3), "frequency_hz": float(frequency)}
    return found


def _list_measurements(session: Session, known: list[str]) -> dict[str, Any]:
    """What was measured on site, by its standard deviations."""
    site = session.site
    measured: dict[str, Any] = {
        "range": [{"point": one.point, "view": one.view, "std_m": one.std} for one in site.range if one.point in known],
        "length": [{"points": one.points, "std_m": one.std} for one in site.length if set(one.points) <= set(known)],
        "reading": [
            {
                "view": view.name,
                "level_std_deg": None if view.level is None else view.level.std_deg,
                "perpendicular_std_m": None if view.perpendicular_distance is None else view.perpendicular_distance.std,
                "longitudinal_std_m": None if view.longitudinal_distance is None else view.longitudinal_distance.std,
            }
            for view in session.view[1:]
            if view.level or view.perpendicular_distance or view.longitudinal_distance
        ],
    }
    for key, reading in (
        ("baseline_std_m", site.baseline),
        ("perpendicular_std_m", site.perpendicular_distance),
        ("longitudinal_std_m", site.longitudinal_distance),
    ):
        if reading is not None:
            measured[key] = reading.std
    measured["level_std_deg"] = 1.0 if site.reference_camera_level is None else site.reference_camera_level.std_deg
    return measured
