"""What a report is made of: the files of a run folder, read and checked."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import xarray as xr

from vfm_sdm.analysis.field import read_field
from vfm_sdm.analysis.modal.record import read_modes
from vfm_sdm.core.block_files import LONG_BYTES
from vfm_sdm.core.grids import grid_points, without_grids
from vfm_sdm.core.netcdf import open_displacement, read_displacement, read_points
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.core.stored import check_seal
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import Session, read_session, session_hash
from vfm_sdm.outputs.report.series import SeriesValues, describe_series
from vfm_sdm.outputs.results.summary import read_summary
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution

__all__ = ["MANY_POINTS", "ReportInputs", "open_run"]

MANY_POINTS = 20
"""Points up to which each has a figure of its own."""
_TABLES = ("points", "audit", "cameras", "versions", "seconds", "input_hashes")
"""Entries of ``summary.json`` without which a folder holds no run."""


@dataclass(frozen=True, eq=False)
class ReportInputs:
    """Files of a run folder, as sections read them.

    Parameters
    ----------
    folder
        The run folder.
    session
        The session that was measured.
    summary
        ``summary.json``.
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; of long recordings what is looked at is read.
    cameras
        Cameras, axes and points.
    points
        Points dataset, positions of shape (V, P, 2) [px].
    evaluation
        ``evaluation.json``; ``None`` where there is none.
    modes
        Dataset of modes, dims ``mode, point, axis``; ``None`` where there is none.
    notes
        Sentences that a reader of the folder must know.
    """

    folder: Path
    session: Session
    summary: Mapping[str, Any]
    displacement: xr.Dataset
    cameras: CameraSolution
    points: xr.Dataset
    evaluation: Mapping[str, Any] | None = None
    modes: xr.Dataset | None = None
    field: xr.Dataset | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def point_names(self) -> tuple[str, ...]:
        """Names of all points that have names of their own, in the session's order."""
        return tuple(str(name) for name in without_grids(self.displacement)["point"].values)

    @cached_property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(str(name) for name in self.displacement["axis"].values)

    @cached_property
    def static(self) -> frozenset[str]:
        """Names of the points that must not move."""
        return frozenset(point.name for point in self.session.point if point.static)

    @cached_property
    def series(self) -> dict[tuple[str, str], SeriesValues]:
        """Values by point and axis; each series is read once, and forgotten but for these."""
        return {
            (point, axis): describe_series(self.displacement, point, axis)
            for point in self.point_names
            for axis in self.axis_names
        }

    @cached_property
    def by_motion(self) -> tuple[str, ...]:
        """Points by their largest peak-to-peak along any axis, those of the structure first."""

        def rank(point: str) -> tuple[bool, float]:
            spans = [self.series[point, axis].summary["peak_to_peak_mm"] or 0.0 for axis in self.axis_names]
            return point in self.static, -max(spans, default=0.0)

        return tuple(sorted(self.point_names, key=rank))


@contextmanager
def open_run(folder: Path | str, *, session: Path | str | None = None) -> Iterator[ReportInputs]:
    """The files of a run folder, for the time of the block.

    Parameters
    ----------
    folder
        The run folder.
    session
        Session file whose table ``[report]`` is taken in place of the one in the folder.

    Raises
    ------
    ResultsError
        A file is missing, damaged, or of another run.
    SessionError
        The session file cannot be read, or is not the one that was measured.
    """
    place = Path(folder)
    if not place.is_dir():
        raise ResultsError(f"{place}: expected a run folder, got no such folder; run `vfm-sdm measure` first")
    summary = read_summary(place)
    lacking = [name for name in _TABLES if not isinstance(summary.get(name), dict)]
    if lacking:
        raise ResultsError(
            f"{place}: expected the summary of a finished measurement, got none of {', '.join(lacking)}; run "
            "`vfm-sdm measure` again"
        )
    measured = _read_session(place)
    cameras, _ = read_solution(place / "cameras.toml")
    with _displacement(place) as displacement:
        notes = RunFolder(place).check_whole("displacement", displacement.attrs)
        named = {point.name for point in measured.point} | set(grid_points(displacement))
        unknown = {str(name) for name in displacement["point"].values} ^ named
        if unknown:
            raise ResultsError(
                f"{place}: expected the points of {SESSION}, got others in displacement.nc: "
                f"{', '.join(sorted(unknown))}; run `vfm-sdm measure` again"
            )
        yield ReportInputs(
            folder=place,
            session=measured if session is None else _take_report(measured, session, summary),
            summary=summary,
            displacement=displacement,
            cameras=cameras,
            points=without_grids(read_points(place)),
            evaluation=_read_evaluation(place),
            field=read_field(place),
            modes=read_modes(place),
            notes=notes,
        )


@contextmanager
def _displacement(folder: Path) -> Iterator[xr.Dataset]:
    """Displacement of a run folder; a long one stays in its file, whose seal is looked at first."""
    file = folder / "displacement.nc"
    if not file.is_file() or file.stat().st_size < LONG_BYTES:
        yield read_displacement(folder)
        return
    try:
        check_seal(file)
    except ValueError as error:
        raise ResultsError(
            f"{file}: expected displacement, got a damaged file ({error}); run `vfm-sdm measure` again"
        ) from error
    with open_displacement(file) as displacement:
        yield displacement


def _read_session(folder: Path) -> Session:
    file = folder / SESSION
    if not file.is_file():
        raise ResultsError(f"{file}: expected the session that was measured, got none; run `vfm-sdm measure` again")
    try:
        return read_session(file, check_files=False)
    except SessionError as error:
        raise ResultsError(f"{error}; run `vfm-sdm measure` again") from error


def _take_report(measured: Session, path: Path | str, summary: Mapping[str, Any]) -> Session:
    """The session that was measured, with what another file of it says for the report."""
    given = read_session(path, check_files=False)
    if session_hash(given) != summary.get("session_hash"):
        raise SessionError(
            f"{path}: expected the session of this run, got another one, beyond its table [report]; measure it, or "
            "name the file that was measured"
        )
    return measured.model_copy(update={"report": given.report})


def _read_evaluation(folder: Path) -> Mapping[str, Any] | None:
    file = folder / "evaluation.json"
    if not file.exists():
        return None
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{file}: expected a comparison, got: {error}; run `vfm-sdm evaluate` again") from error
    if not isinstance(found, dict) or not isinstance(found.get("rows"), list):
        raise ResultsError(f"{file}: expected a comparison with rows, got something else; run `vfm-sdm evaluate` again")
    return found
