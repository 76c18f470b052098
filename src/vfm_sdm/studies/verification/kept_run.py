"""The measurement of a run folder, with its kept products in the place of the recordings."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.analysis.acceptance import BudgetModel
from vfm_sdm.core.grids import grid_points
from vfm_sdm.core.netcdf import read_displacement, read_points
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import Session, read_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results.kept import CAMERAS, INJECTION, TRACKS
from vfm_sdm.stages.cameras.solution import read_solution
from vfm_sdm.stages.tracking.injection.views import read_injection

__all__ = ["KEYED", "read_budget_model", "read_keys", "read_measurement", "read_session_of"]

KEYED = ("cameras", "points", "tracks", "injection", "displacement")
"""Products that a run folder keeps under keys."""


def read_session_of(folder: Path) -> Session:
    """The session of a run folder, whether its inputs are there or not.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    ResultsError
        There is no session, or it cannot be used.
    """
    try:
        return read_session(folder / SESSION, check_files=False)
    except SessionError as error:
        raise ResultsError(f"{folder}: expected the session of a run, got: {error}; run `vfm-sdm measure`") from error


def read_keys(folder: Path) -> dict[str, str]:
    """Keys of the products that can be read, by name.

    Parameters
    ----------
    folder
        The run folder.
    """
    readers: dict[str, Callable[[], str]] = {
        "cameras": lambda: read_solution(folder / CAMERAS.file)[1],
        "points": lambda: str(read_points(folder).attrs.get("key", "")),
        "tracks": lambda: _read_tracks(folder)[1],
        "injection": lambda: read_injection(folder / INJECTION.file)[1],
        "displacement": lambda: str(read_displacement(folder).attrs.get("key", "")),
    }
    keys = {}
    for name, read in readers.items():
        with suppress(ResultsError):
            keys[name] = read()
    return keys


def read_measurement(folder: Path | str) -> Measurement:
    """The measurement that a run folder keeps, in memory.

    Parameters
    ----------
    folder
        Run folder of `vfm_sdm.measurement.measure`; nothing is written to it.

    Returns
    -------
    measurement
        With cameras, points, tracks and gains given, so that nothing after them needs the recordings.

    Raises
    ------
    ResultsError
        Session, cameras, points or tracks are missing or damaged, or of different sessions.
    """
    path = Path(folder)
    session = read_session_of(path)
    cameras, _ = read_solution(path / CAMERAS.file)
    tracks, _ = _read_tracks(path)
    points = read_points(path)
    _check_names(path, session, points, tracks)
    products: dict[str, Any] = {"cameras": cameras, "points": points, "tracks": tracks, "injection": None}
    if (path / INJECTION.file).exists():
        products["injection"], _ = read_injection(path / INJECTION.file)
    return Measurement(session).given(**products)


def _read_tracks(folder: Path) -> tuple[dict[str, xr.Dataset], str]:
    if TRACKS.read is None:
        raise ResultsError(f"{folder}: expected tracks that can be read back, got none; run `vfm-sdm measure`")
    return TRACKS.read(folder / TRACKS.file)


def _check_names(path: Path, session: Session, points: xr.Dataset, tracks: dict[str, xr.Dataset]) -> None:
    """Refuses tracks of other views or points than the session names, before a stage trips over them."""
    wanted = [view.name for view in session.view], {p.name for p in session.point} | set(grid_points(points))
    got = list(tracks), {str(name) for of_view in tracks.values() for name in of_view["point"].values}
    if wanted[0] != got[0] or not got[1] <= wanted[1]:
        raise ResultsError(
            f"{path}: expected tracks of the session's views {wanted[0]} and points {sorted(wanted[1])}, got "
            f"{got[0]} and {sorted(got[1])}; run `vfm-sdm measure` again"
        )


def read_budget_model(folder: Path | str) -> BudgetModel:
    """What a run's displacement was computed from.

    Parameters
    ----------
    folder
        Run folder; nothing is written to it.

    Raises
    ------
    ResultsError
        A product is missing or damaged, or there is no displacement of two views or more.
    """
    measurement = read_measurement(folder)
    cameras, displacement, unrefined = measurement.cameras, measurement.displacement, measurement.unrefined
    if cameras.rig is None or displacement is None or unrefined is None:
        raise ResultsError(
            f"{folder}: expected displacement of two views or more, got none ({cameras.status}); a budget needs cameras"
        )
    return BudgetModel(
        displacement=displacement,
        unrefined=unrefined,
        tracks=measurement.aligned.assign(place_std=measurement.points["position_std"]),
        rig=cameras.rig,
        rotation=np.eye(3) if cameras.frame is None else cameras.frame.rotation,
        covariance=cameras.covariance,
    )
