"""Run folders of simulated measurements, in a second and without films: a session, tracks and cameras given."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from measurements import FPS, STILL_S, VIEWS, Simulated, points_dataset, simulate
from simulation import project_all
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.netcdf import write_displacement, write_points, write_tracks
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.inputs.session import Point, Session, file_hash, write_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results import write_summary
from vfm_sdm.stages.cameras.solution import CameraSolution, write_solution

__all__ = ["bridge_session", "write_run"]

PERIOD_S = 1 / 2.5
_STD_PX = 0.02


def write_run(
    folder: Path,
    /,
    *,
    moving: int = 2,
    duration_s: float = 4.0,
    names: tuple[str, ...] = (),
    lost: tuple[str, ...] = (),
    motion: Callable[[np.ndarray], np.ndarray] | None = None,
    **session: Any,
) -> tuple[Measurement, Simulated]:
    """A run folder with so many moving points along the face, which swing at 2.5 Hz, and three static points.

    Parameters
    ----------
    folder
        The run folder.
    moving
        Number of moving points.
    duration_s
        Length of the recording [s].
    names
        Names of the first points, in place of ``p0``, ``p1``, ...
    lost
        Points that are never seen.
    motion
        Of the middle of the points by time, shapes (T,) [s] -> (T,), 4 mm downwards at 1.
    **session
        Fields of the session that differ; of its views those that are measured.
    """
    site = _solved_site()
    named, places = _place(site, moving, names)
    measured = bridge_session(site, named, places, **session)
    pixels = project_all(site.rig, places)
    points = points_dataset({name: pixels[:, n] for n, name in enumerate(named)})
    cameras = replace(site.solution, points=points)
    if measured.site.perpendicular_distance is None:
        cameras = replace(cameras, frame=None)
    if len(measured.view) == 1:
        cameras = CameraSolution(None, None, None, points.isel(view=[0]), status=CameraStatus.ONE_VIEW)
    tracks = _track(site, named, places, duration_s, lost, motion or _swing)
    tracks = {view.name: tracks[view.name] for view in measured.view}
    measurement = Measurement(measured).given(cameras=cameras, tracks=tracks, frames={})
    write_products(measurement, folder)
    return measurement, site


@cache
def _solved_site() -> Simulated:
    """The site of all these run folders, which takes longer to solve than all else."""
    known = {"distortion_std": 0.0, "distortion_errors": (0.0, 0.0), "time_offset_s": 0.0}
    return simulate(3, duration_s=1.0, synchronization="none", **known)


def _swing(clock: np.ndarray) -> np.ndarray:
    """Rest, then a vibration."""
    return np.sin(2 * np.pi * (clock - STILL_S[1]) / PERIOD_S) * (clock >= STILL_S[1])


def _track(
    site: Simulated,
    named: list[str],
    places: np.ndarray,
    duration_s: float,
    lost: tuple[str, ...],
    history: Callable[[np.ndarray], np.ndarray],
) -> dict[str, xr.Dataset]:
    """Tracks of all points by view."""
    clock = np.arange(round(duration_s * FPS)) / FPS
    # A half wave over the points, in mm, along lateral and vertical.
    moving, shape = len(named) - 3, np.zeros((len(named), 3))
    shape[:moving, 1] = 4.0 * np.sin(np.pi * (np.arange(moving) + 1) / (moving + 1))
    shape[:moving, 0] = 0.5 * shape[:moving, 1]
    motion = np.einsum("t,pa,ax->tpx", history(clock), shape / 1e3, site.frame.rotation)
    rng, tracks = np.random.default_rng(11), {}
    for view, camera in zip(VIEWS, site.rig.cameras, strict=True):
        position = np.stack([camera.project(places + at) for at in motion])
        position = position + rng.normal(0, _STD_PX, position.shape)
        covariance = np.tile(_STD_PX**2 * np.eye(2), (*position.shape[:2], 1, 1))
        status = np.zeros(position.shape[:2], int)
        missing = [named.index(name) for name in lost]
        position[:, missing], covariance[:, missing], status[:, missing] = np.nan, np.nan, Status.LOST
        attrs = {"tracker": "simulated", "image_width": camera.image_size[0], "image_height": camera.image_size[1]}
        tracks[view] = make_tracks(clock, named, position, covariance, status, attrs=attrs)
    return tracks


def bridge_session(site: Simulated, named: list[str], places: np.ndarray, /, **session: Any) -> Session:
    """The simulated session with other points."""
    pixels = site.rig.cameras[0].project(places)
    points = tuple(
        Point(name=name, view=VIEWS[0], pixel=tuple(pixel), static=n >= len(named) - 3)
        for n, (name, pixel) in enumerate(zip(named, pixels.tolist(), strict=True))
    )
    fields = {"name": "simulated", **session, "point": points}
    noted = site.session.site.model_copy(update={"range": (), "length": ()})
    return Session(**{**dict(site.session), "site": noted, **fields})


def write_products(measurement: Measurement, folder: Path) -> None:
    """Files of a whole run, of which cameras and tracks were given: such a chain writes none itself."""
    marks = {**measurement.marks(), "key": "simulated"}
    write_solution(folder / "cameras.toml", measurement.cameras, "given")
    write_points(folder, measurement.cameras.points)
    write_tracks(folder, measurement.tracks)
    write_displacement(folder, measurement.displacement.assign_attrs(marks))
    session = file_hash(write_session(folder / SESSION, measurement.session))
    products = {"displacement": "simulated"}
    write_summary(folder, {**measurement.summary, "finished": True, "session_file": session, "products": products})


def _place(site: Simulated, moving: int, names: tuple[str, ...]) -> tuple[list[str], np.ndarray]:
    """Names and places [m] of points along the line through the two of the face, and of the static ones."""
    first, second = site.points3d[:2]
    share = np.linspace(-0.2, 1.2, moving)[:, None]
    along = first + share * (second - first)
    named = [*names, *(f"p{n}" for n in range(len(names), moving))]
    return [*named, "s0", "s1", "s2"], np.concatenate([along, site.points3d[2:]])
