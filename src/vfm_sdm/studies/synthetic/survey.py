"""What an engineer would have noted on the site of a virtual field test, and where its points really are."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import (
    Length,
    Lens,
    Level,
    Measured,
    Method,
    Point,
    Range,
    Sensor,
    Session,
    Site,
    View,
)
from vfm_sdm.studies.synthetic.girder_bridge import find_on_face
from vfm_sdm.studies.synthetic.plan import Blunder, FurtherReadings, Preset, SitePoint
from vfm_sdm.studies.synthetic.scene import Scene, find_hidden

__all__ = ["make_sessions", "true_points"]

_SENSOR_WIDTH_MM = 6.17

_Error = Callable[[float], float]
"""From a standard deviation to an error drawn from it."""


def make_sessions(plan: Preset, folder: Path) -> dict[str, Session]:
    """Sessions by the names of their files: every value with an error of the size of its standard deviation.

    Parameters
    ----------
    plan
        The field test.
    folder
        Where its recordings lie.

    Returns
    -------
    sessions
        ``session.toml``, and ``session_further.toml`` where the plan has further readings: the same with these.
        Blunders of the plan stand in both.

    Raises
    ------
    DatasetError
        A blunder is of a reading that no session has.
    """
    rng = np.random.default_rng([plan.seed, len(plan.views)])

    def error(std: float) -> float:
        return std * float(np.clip(rng.standard_normal(), -2, 2))

    session = _session(plan, folder, error)
    sessions = {"session.toml": session}
    if plan.further is not None:
        sessions["session_further.toml"] = _read_further(session, plan, plan.further, error)
    for blunder in plan.blunders:
        done = {name: _misread(noted, blunder) for name, noted in sessions.items()}
        if done == sessions:
            raise DatasetError(f"blunder: expected a reading of a session, got {blunder.reading!r}; name one")
        sessions = done
    return sessions


def true_points(plan: Preset, scene: Scene) -> xr.Dataset:
    """Points dataset with the true places of the points at rest; ``not found`` where a view does not see one.

    Parameters
    ----------
    plan
        The field test.
    scene
        What its cameras see.
    """
    rest = np.array([point.position for point in plan.points])
    cameras = plan.site.cameras()
    hidden = np.array([find_hidden(scene, camera, rest) for camera in cameras])
    pixel = np.where(hidden[..., None], np.nan, [camera.project(rest) for camera in cameras])
    return make_points(
        plan.views,
        [point.name for point in plan.points],
        position=pixel,
        position_std=np.where(hidden[..., None], np.nan, np.zeros(pixel.shape)),
        status=np.where(hidden, PointStatus.NOT_FOUND, PointStatus.OK),
    )


def _session(plan: Preset, folder: Path, error: _Error) -> Session:
    """What an engineer would have noted: every value with an error of the size of its standard deviation."""
    views = _views(plan, error)
    camera = plan.site.cameras()[0]
    return Session(
        name=plan.name,
        view=views,
        site=_measured_site(plan, error),
        point=tuple(
            Point(
                name=point.name,
                view=plan.views[0],
                pixel=tuple(float(x) for x in np.round(camera.project(point.position), 3)),
                static=point.static,
            )
            for point in plan.points
        ),
        sensor=tuple(
            Sensor(name=m.sensor.name, file=Path(f"{m.sensor.name}.csv"), point=m.point, units="g")
            for m in plan.accelerometers
        ),
        method=Method(
            subset_px=plan.subset_px,
            still_interval_s=(0.0, plan.still_s),
            refinement=plan.refinement,
            synchronization=plan.synchronization,
        ),
        folder=folder,
    )


def _views(plan: Preset, error: _Error) -> tuple[View, ...]:
    """The views with their lenses as they are printed on them."""
    relative_std = plan.errors.lens_relative
    lenses = [
        camera.focal_px * (1 + error(relative_std / 2)) * _SENSOR_WIDTH_MM / camera.image_size[0]
        for camera in plan.site.cameras()
    ]
    return tuple(
        View(
            name=name,
            video=Path(f"{name}.mp4"),
            lens=Lens(focal_mm=round(focal_mm, 2), sensor_width_mm=_SENSOR_WIDTH_MM, relative_std=relative_std),
        )
        for name, focal_mm in zip(plan.views, lenses, strict=True)
    )


def _measured_site(plan: Preset, error: _Error) -> Site:
    """What tape, laser and spirit level say."""
    errors, site = plan.errors, plan.site

    ranged = _point(plan, plan.ranged or plan.points[0].name)
    return Site(
        baseline=_tape(plan.baseline_m, errors.baseline_m, error),
        perpendicular_distance=_tape(site.perpendicular_m, errors.perpendicular_m, error),
        longitudinal_distance=_tape(site.longitudinal_m, errors.longitudinal_m, error),
        reference_camera_level=_level(site.level_deg, errors.level_deg, error),
        range=(
            Range(
                point=ranged.name,
                value=round(float(np.linalg.norm(ranged.position)) + error(errors.range_m), 3),
                std=errors.range_m,
            ),
        ),
        length=_lengths(plan, error),
    )


def _point(plan: Preset, name: str) -> SitePoint:
    return next(point for point in plan.points if point.name == name)


def _level(level_deg: tuple[float, float], std_deg: float, error: _Error) -> Level:
    """Readings of pitch and roll; of a camera that was set level, one for both."""
    if not any(level_deg):
        return Level(value_deg=round(error(std_deg), 2), std_deg=std_deg)
    pitch, roll = (round(exact + error(std_deg), 2) for exact in level_deg)
    return Level(pitch_deg=pitch, roll_deg=roll, std_deg=std_deg)


def _lengths(plan: Preset, error: _Error) -> tuple[Length, ...]:
    return () if plan.known_length is None else (_length(plan, plan.known_length, error),)


def _length(plan: Preset, names: tuple[str, str], error: _Error) -> Length:
    first, second = (np.array(_point(plan, name).position) for name in names)
    value = round(float(np.linalg.norm(second - first)) + error(plan.errors.length_m), 3)
    return Length(points=names, value=value, std=plan.errors.length_m)


def _read_further(session: Session, plan: Preset, further: FurtherReadings, error: _Error) -> Session:
    """The session with what could also be read at the second camera, and more lengths."""
    camera, errors, site = plan.site.cameras()[1], plan.errors, plan.site
    seen = find_on_face(camera, site.perpendicular_m)
    distance = float(np.linalg.norm(np.array(_point(plan, further.ranged).position) - camera.center))
    ranged = Range(
        point=further.ranged, view=plan.views[1], value=round(distance + error(errors.range_m), 3), std=errors.range_m
    )
    readings = {
        "level": _level(plan.site.further[0].level_deg, errors.level_deg, error),
        "perpendicular_distance": _tape(seen[0] - camera.center[0], errors.perpendicular_m, error),
        "longitudinal_distance": _tape(seen[2] - camera.center[2], errors.longitudinal_m, error),
    }
    second = session.view[1].model_copy(update=readings)
    more = {
        "range": (*session.site.range, ranged),
        "length": (*session.site.length, *(_length(plan, names, error) for names in further.lengths)),
    }
    return session.model_copy(
        update={
            "view": (session.view[0], second, *session.view[2:]),
            "site": session.site.model_copy(update=more),
        }
    )


def _misread(session: Session, blunder: Blunder) -> Session:
    """The session with one reading off; as it is where it lacks that reading."""
    kind, _, number = blunder.reading.partition(" ")
    several, place = kind in ("length", "range"), int(number or 1) - 1
    noted: Any = getattr(session.site, kind, None) or ()
    readings = noted if several or noted == () else (noted,)
    if not 0 <= place < len(readings):
        return session
    wrong = readings[place].model_copy(update={"value": round(readings[place].value + blunder.error_m, 3)})
    update = {kind: (*readings[:place], wrong, *readings[place + 1 :]) if several else wrong}
    return session.model_copy(update={"site": session.site.model_copy(update=update)})


def _tape(exact: float, std: float, error: _Error) -> Measured:
    return Measured(value=round(float(exact) + error(std), 3), std=std)
