"""Files of a measurement's products in the run folder."""

from collections.abc import Mapping
from pathlib import Path

import xarray as xr

from vfm_sdm.core.netcdf import open_tracks, write_points, write_tracks
from vfm_sdm.core.products import Kept
from vfm_sdm.core.versions import package_versions
from vfm_sdm.outputs.results.exports import write_displacement
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution, write_solution
from vfm_sdm.stages.revisit import Revisit, write_revisit
from vfm_sdm.stages.tracking.injection.views import read_injection, write_injection
from vfm_sdm.stages.tracking.views import is_whole

__all__ = ["CAMERAS", "DISPLACEMENT", "INJECTION", "POINTS", "REVISIT", "TRACKS"]


def _read_tracks(path: Path) -> tuple[dict[str, xr.Dataset], str]:
    tracks = open_tracks(path)
    keys = {str(of_view.attrs.pop("key", "")) for of_view in tracks.values()}
    return tracks, keys.pop() if len(keys) == 1 else ""


def _write_cameras(path: Path, solution: CameraSolution, marks: Mapping[str, str]) -> None:
    write_solution(path, solution, marks["key"])


def _write_tracks(path: Path, tracks: Mapping[str, xr.Dataset], marks: Mapping[str, str]) -> None:
    write_tracks(path.parent, {view: of_view.assign_attrs(key=marks["key"]) for view, of_view in tracks.items()})


def _write_points(path: Path, points: xr.Dataset, marks: Mapping[str, str]) -> None:
    write_points(path.parent, points.assign_attrs(key=marks["key"]))


def _write_displacement(path: Path, displacement: xr.Dataset, marks: Mapping[str, str]) -> None:
    write_displacement(path.parent, displacement.assign_attrs(marks, versions=package_versions()))


def _write_revisit(path: Path, revisit: Revisit, marks: Mapping[str, str]) -> None:
    del marks  # it stands in summary.json, too
    write_revisit(path, revisit)


CAMERAS: Kept[CameraSolution] = Kept("cameras.toml", read_solution, _write_cameras)
POINTS: Kept[xr.Dataset] = Kept("points.nc", None, _write_points)
TRACKS: Kept[dict[str, xr.Dataset]] = Kept("tracks.nc", _read_tracks, _write_tracks, whole=is_whole)
INJECTION: Kept[xr.Dataset] = Kept("injection.nc", read_injection, write_injection)
DISPLACEMENT: Kept[xr.Dataset] = Kept("displacement.nc", None, _write_displacement, beside=("displacement.csv",))
REVISIT: Kept[Revisit] = Kept("revisit.csv", None, _write_revisit)
