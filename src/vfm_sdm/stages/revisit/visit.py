"""One visit: cameras, first frames, and where every point rests in every view."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import Status, frames_of_points
from vfm_sdm.core.netcdf import read_displacement, read_tracks
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.errors import ResultsError, SessionError, VideoError
from vfm_sdm.inputs.session import FirstFrames, Session, open_views, read_session
from vfm_sdm.signals.clocks import still_frames
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution

__all__ = ["Visit", "read_visit", "rest_shifts"]

_BLOCKS = 8
"""Parts of a recording whose means scatter as slow motion does."""
_LEAST_SHARE = 0.5
"""Share of the frames in which a point has to be seen."""


@dataclass(frozen=True, eq=False)
class Visit:
    """What is kept of a visit.

    Parameters
    ----------
    session
        What was measured.
    frames
        First frame of every view by name, shape (H, W) each.
    cameras
        Cameras, axes and the points' places in the first frames.
    tracks
        Tracks by view, each on its own clock, shape (T, P, 2) [px].
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; ``None`` where there is none.
    """

    session: Session
    frames: Mapping[str, LumaArray]
    cameras: CameraSolution
    tracks: Mapping[str, xr.Dataset]
    displacement: xr.Dataset | None


def read_visit(folder: Path) -> Visit:
    """An earlier visit from its run folder and its recordings.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    SessionError
        The folder holds no whole run, or its recordings are not where they were.
    """
    try:
        session = read_session(folder / SESSION)
        cameras, _ = read_solution(folder / "cameras.toml")
        tracks = read_tracks(folder)
        displacement = read_displacement(folder) if (folder / "displacement.nc").exists() else None
        return Visit(session, FirstFrames(open_views(session)), cameras, tracks, displacement)
    except (SessionError, ResultsError, VideoError) as error:
        raise SessionError(
            f"baseline_visit: expected the run folder of an earlier visit, with its recordings where they were, got: "
            f"{error}; measure that visit again, or correct the path"
        ) from error


def rest_shifts(visit: Visit, view: str, points: list[str]) -> tuple[FloatArray, FloatArray]:
    """How far from its place in the frame in which it is named each point rests in a view.

    Parameters
    ----------
    visit
        The visit.
    view
        Name of the view.
    points
        Names of P points.

    Returns
    -------
    shift, covariance
        Shapes (P, 2) [px] and (P, 2, 2) [px2]; NaN where a point is not seen in half of the frames.

    Notes
    -----
    Rest is the mean over the still interval, where the session states one, else over the whole recording. The
    covariance is that of one sample, because the frame in which a point is named is one, and of the mean, from the
    means of eight parts: what is slower than white noise scatters there, too.
    """
    tracks = visit.tracks[view].sel(point=points)
    named = frames_of_points(visit.cameras.points.sel(view=view), points).tolist()
    time_s, still = tracks["time"].values, visit.session.method.still_interval_s
    resting = np.ones(len(time_s), dtype=np.bool_)
    if still is not None:
        resting = still_frames(time_s + _clock_offset(visit, view), still)
    shift, covariance = np.full((len(points), 2), np.nan), np.full((len(points), 2, 2), np.nan)
    for number in range(len(points)):
        of_point = tracks.isel(point=number)
        ok = resting & np.asarray(of_point["status"].values == Status.OK)
        home = min(named[number], len(time_s) - 1)
        if of_point["status"].values[home] != Status.OK or ok.sum() < _LEAST_SHARE * resting.sum():
            continue
        position = of_point["position"].values
        shift[number] = position[ok].mean(axis=0) - position[home]
        covariance[number] = _of_one_sample(of_point["position_covariance"].values[ok]) + _of_mean(position[ok])
    return shift, covariance


def _clock_offset(visit: Visit, view: str) -> float:
    """How much later than the reference view's a view's clock begins [s]; 0 where nobody knows."""
    if visit.displacement is None or "clock_offset" not in visit.displacement:
        return 0.0
    return float(np.nan_to_num(visit.displacement["clock_offset"].sel(view=view)))


def _of_one_sample(covariance: FloatArray) -> FloatArray:
    known = covariance[np.isfinite(covariance).all(axis=(1, 2))]
    return np.asarray(np.median(known, axis=0)) if len(known) else np.zeros((2, 2))


def _of_mean(position: FloatArray) -> FloatArray:
    """Covariance of the mean of a series (N, 2), shape (2, 2)."""
    parts = min(_BLOCKS, len(position))
    if parts < 2:
        return np.zeros((2, 2))
    means = np.array([part.mean(axis=0) for part in np.array_split(position, parts)])
    return np.asarray(np.cov(means.T) / parts)
