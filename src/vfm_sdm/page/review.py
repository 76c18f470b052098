"""What a finished run shows: histories with their uncertainty, spectra, budget, audit, tracks and the scene."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.netcdf import open_displacement, open_tracks
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.inputs.session import Session, read_session, session_hash
from vfm_sdm.outputs.plots.about import positive_direction
from vfm_sdm.outputs.plots.drawing import reduce_band, reduce_line
from vfm_sdm.outputs.report.site_plan import lay_flat
from vfm_sdm.outputs.results import read_summary
from vfm_sdm.signals.spectrum import amplitude_spectrum
from vfm_sdm.stages.cameras.solution import read_solution

__all__ = ["History", "Results", "stand_before"]

_FILM_FRAMES = 600
_SCENE_FRAMES = 400


@dataclass(frozen=True, eq=False)
class History:
    """A displacement history, reduced to what a screen can show.

    Parameters
    ----------
    time_s, values
        Line, shape (N,) [s] and [mm]; NaN where no sample counts.
    band_s, below, above
        Expanded uncertainty (k = 2) around it, shape (B,) [s] and [mm].
    """

    time_s: FloatArray
    values: FloatArray
    band_s: FloatArray
    below: FloatArray
    above: FloatArray


class Results:
    """Results in a run folder.

    Parameters
    ----------
    run
        The folder.

    Raises
    ------
    ResultsError
        It holds no finished measurement, or a damaged one.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self.summary: dict[str, Any] = read_summary(run)
        self.displacement = open_displacement(run / "displacement.nc")

    @property
    def session(self) -> Session:
        """The session that was measured."""
        return read_session(self.run / SESSION, check_files=False)

    def doubts(self, session: Session | None) -> list[str]:
        """Sentences on why these are not the results of the session as it stands now.

        Parameters
        ----------
        session
            What the session's file says now; ``None`` where it is not complete.
        """
        found = []
        if session is None or session_hash(session) != self.summary.get("session_hash"):
            found.append("session.toml was changed since this was measured: measure again before you use it")
        if self.summary.get("finished") is False:
            found.append("this is not measured to its end: measure again, which goes on where it was")
        return found

    @property
    def points(self) -> list[str]:
        """Names of the points."""
        return [str(name) for name in self.displacement["point"].values]

    @property
    def axes(self) -> list[str]:
        """Names of the axes."""
        return [str(name) for name in self.displacement["axis"].values]

    def positive(self, axis: str) -> str:
        """In which direction displacement along an axis is positive, in brackets; empty where nobody says.

        Parameters
        ----------
        axis
            Its name.
        """
        words = positive_direction(str(self.displacement.attrs.get("frame", "")), axis)
        return f" (positive: {words})" if words else ""

    @property
    def span_s(self) -> tuple[float, float]:
        """When the recording begins and ends [s]."""
        time_s = self.displacement["time"].values
        return float(time_s[0]), float(time_s[-1])

    def history(self, point: str, axis: str, between_s: tuple[float, float] | None = None) -> History:
        """Displacement of a point along an axis.

        Parameters
        ----------
        point, axis
            Names.
        between_s
            Interval that is shown [s]; all of it when left out.
        """
        series = self._series(point, axis)
        time_s = series["time"].values
        shown = slice(None) if between_s is None else _about(time_s, between_s)
        values, clock = self._valid(series, shown), time_s[shown]
        expanded = series["expanded_uncertainty"].values[shown]
        return History(*reduce_line(clock, values), *reduce_band(clock, values - expanded, values + expanded))

    def spectrum(self, point: str, axis: str) -> tuple[FloatArray, FloatArray]:
        """Frequencies [Hz] and amplitudes [mm] of a point along an axis.

        Parameters
        ----------
        point, axis
            Names.
        """
        series = self._series(point, axis)
        return amplitude_spectrum(series["time"].values, self._valid(series, slice(None)))

    def budget(self) -> list[dict[str, Any]]:
        """Standard deviations of the components of the budget [mm], a row a point and axis."""
        rows = []
        for point, found in self.summary["points"].items():
            for axis, values in found["axes"].items():
                parts = {name: _number(value) for name, value in (values.get("budget_mm") or {}).items()}
                rows.append(
                    {
                        "id": f"{point}/{axis}",
                        "point": point,
                        "axis": axis,
                        "peak_to_peak": _number(values.get("peak_to_peak_mm")),
                        "expanded": _number(values.get("expanded_uncertainty_mm")),
                        **parts,
                    }
                )
        return rows

    def film(self, view: str) -> dict[str, Any]:
        """Tracks of a view for a film of some hundred frames that play: numbers, and places a frame and point [px].

        Parameters
        ----------
        view
            The view.
        """
        tracks = open_tracks(self.run / "tracks.nc")[view]
        count = min(tracks.sizes["time"], _FILM_FRAMES)
        part = tracks[["position", "status"]].isel(time=slice(0, count)).load()
        seen = (part["status"].values == Status.OK)[..., None]
        places = np.where(seen, part["position"].values, np.nan).round(3)
        static = {one.name for one in self.session.point if one.static}
        names = [str(name) for name in tracks["point"].values]
        return {
            "numbers": list(range(count)),
            "points": names,
            "static": [name in static for name in names],
            "position": _without_nan(places),
            "home": _without_nan(np.array([_first(places[:, row]) for row in range(len(names))])),
        }

    def scene(self) -> dict[str, Any]:
        """Cameras, places of points [m] and their motion [mm] along lateral, vertical and longitudinal axis."""
        solution, _ = read_solution(self.run / "cameras.toml")
        rotation = np.eye(3) if solution.frame is None else solution.frame.rotation
        rig = solution.rig
        data = self.displacement
        step = max(data.sizes["time"] // _SCENE_FRAMES, 1)
        motion = data["displacement"].isel(time=slice(None, None, step)).load().values
        places = data["position"].isel(time=0).load().values
        return {
            "cameras": [] if rig is None else [(rotation @ one.center).tolist() for one in rig.cameras],
            "looks": [] if rig is None else [(rotation @ one.rotation[2]).tolist() for one in rig.cameras],
            "names": [] if rig is None else list(rig.names),
            "axes": tuple(self.axes),
            "points": self.points,
            "places": places,
            "motion": np.nan_to_num(motion),
        }

    def _series(self, point: str, axis: str) -> xr.Dataset:
        names = ["displacement", "expanded_uncertainty", "status"]
        return self.displacement[names].sel(point=point, axis=axis).load()

    @staticmethod
    def _valid(series: xr.Dataset, shown: slice) -> FloatArray:
        ok = series["status"].values[shown] == Status.OK
        return np.where(ok, series["displacement"].values[shown], np.nan)


def stand_before(axes: tuple[str, ...]) -> FloatArray:
    """Directions to the right, away and up of who stands before the structure, rows of shape (3, 3) along the axes.

    Parameters
    ----------
    axes
        Names of the axes.
    """
    return np.array([*lay_flat(axes, "plan"), lay_flat(axes, "elevation")[1]])


def _first(places: FloatArray) -> FloatArray:
    """The first known place (2,) of a point [px]."""
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    return np.asarray(places[known[0]]) if known.size else np.full(2, np.nan)


def _without_nan(values: FloatArray) -> Any:
    """Nested lists, with nothing in place of NaN."""
    plain = values.astype(object)
    plain[~np.isfinite(values)] = None
    return plain.tolist()


def _about(time_s: FloatArray, between_s: tuple[float, float]) -> slice:
    """Samples in an interval [s], and one to either side, to which their line goes on."""
    first, last = np.searchsorted(time_s, between_s[0]), np.searchsorted(time_s, between_s[1], side="right")
    return slice(max(int(first) - 1, 0), int(last) + 1)


def _number(value: float | None) -> float | None:
    return None if value is None else round(float(value), 4)
