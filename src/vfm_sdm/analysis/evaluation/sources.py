"""Evaluation of files: recordings of sensors of any kind, and the run folder of a measurement."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import xarray as xr

from vfm_sdm.analysis.evaluation.comparison import ReferenceClock, evaluate
from vfm_sdm.analysis.evaluation.records import Evaluation
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.core.sensor_datasets import ACCELERATION_UNITS
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings, compute_reference
from vfm_sdm.inputs.sensors.netcdf import join_sensors, read_comparison
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration, read_reference, states_acceleration
from vfm_sdm.inputs.session import Session, read_session

__all__ = ["evaluate_run", "read_sensors"]

_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log")
"""Suffixes of the files that instruments write as text."""


def read_sensors(
    paths: Sequence[Path | str],
    *,
    sensors: Sequence[str] = (),
    columns: Mapping[str, str] | None = None,
    units: str | None = None,
    sampling_rate_hz: float | None = None,
    settings: RecipeSettings | None = None,
) -> xr.Dataset:
    r"""Reference dataset of several sensors that share a clock, from one CSV file each.

    Parameters
    ----------
    paths
        CSV files.
    sensors
        Name of the sensor in each file; the files' names when left out.
    columns, units, sampling_rate_hz
        Columns, units and sampling rate [Hz] of all files, see `vfm_sdm.inputs.sensors.sensor_csv.read_acceleration`.
        Accelerations go through `vfm_sdm.inputs.sensors.accelerometer.compute_reference`, displacements stay as
        recorded. Units that are left out are those of the first file's header, else g.
    settings
        Constants of the recipe for accelerations.

    Returns
    -------
    reference
        Displacement of the S sensors, shape (T, S, A) [mm]; attribute ``notes`` holds what a reader must know of it.

    Raises
    ------
    DatasetError
        A file is not as described; the files do not share a clock or axes; there is not one name a file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "gauge.csv")
    ...     _ = file.write_text("time,vertical\n0.0,1.5\n0.1,1.0\n0.2,1.25\n")
    ...     reference = read_sensors([file], units="mm")
    >>> reference["displacement"].values.ravel().tolist()
    [1.5, 1.0, 1.25]
    """
    if sensors and len(sensors) != len(paths):
        raise DatasetError(f"sensors: expected one name a file, got {len(sensors)} for {len(paths)}; name all or none")
    is_acceleration = units in ACCELERATION_UNITS
    if units is None and paths:
        is_acceleration = states_acceleration(paths[0], columns) is not False
    read = read_acceleration if is_acceleration else read_reference
    names: Sequence[str | None] = sensors or [None] * len(paths)
    recordings = [
        read(path, sensor=name, columns=columns, units=units, sampling_rate_hz=sampling_rate_hz)
        for path, name in zip(paths, names, strict=True)
    ]
    joined = join_sensors(recordings)
    return compute_reference(joined, settings) if is_acceleration else joined


def evaluate_run(
    folder: Path | str,
    reference: Path | str,
    *,
    pairs: Mapping[str, str] | None = None,
    axes: Sequence[str] = ("lateral", "vertical"),
    band_hz: tuple[float, float] | None = None,
    clock: ReferenceClock | None = None,
) -> Evaluation:
    """Evaluation of the displacement in a run folder.

    Parameters
    ----------
    folder
        Run folder with ``displacement.nc``. Its ``session.resolved.toml``, where present, says which points are static
        and which sensor sits at which point.
    reference
        ``truth.nc`` or another ``displacement.nc``; a file of `write_reference`; or a CSV file that the session names.
        The CSV file is found by its name, so that it may have been moved since.
    pairs
        Sensor or reference point of each point, see `evaluate`; the pairs of the session when left out.
    axes, band_hz, clock
        See `evaluate`; band [Hz] and times [s].

    Returns
    -------
    evaluation
        One row of metrics for every compared point and axis; lengths in mm.

    Raises
    ------
    ResultsError, SessionError, DatasetError
        A file is missing or is not what it should be; nothing can be paired; or `evaluate` refuses the data.
    """
    displacement = read_displacement(folder)
    session_file = Path(folder) / SESSION
    session = read_session(session_file, check_files=False) if session_file.is_file() else None
    notes = RunFolder(folder).check_whole("displacement", displacement.attrs)
    is_csv = Path(reference).suffix.lower() in _TEXT
    known = _read_session_sensor(session, Path(reference)) if is_csv else read_comparison(reference)
    if pairs is None and session is not None:
        pairs = _read_session_pairs(session, displacement, known)
    result = evaluate(displacement, known, pairs=pairs, axes=axes, band_hz=band_hz, clock=clock)
    return replace(result, notes=(*notes, *result.notes))


def _read_session_sensor(session: Session | None, path: Path) -> xr.Dataset:
    """Reference dataset of a sensor's CSV file as the session describes it."""
    sensors = () if session is None else session.sensor
    named = [sensor for sensor in sensors if sensor.file.name == path.name]
    columns = {str(axis): column for axis, column in named[0].columns.items()} if len(named) == 1 else {}
    if len(named) != 1 or (named[0].units is None and states_acceleration(path, columns or None) is None):
        what = f"{len(named)} sensors of that file" if len(named) != 1 else f"no units for {named[0].name!r}"
        raise SessionError(
            f"{path}: expected one sensor with its units in the run's session, got {what}; convert the file with "
            "`vfm-sdm reference`"
        )
    sensor = named[0]
    return read_sensors(
        [path],
        sensors=[sensor.name],
        columns=columns or None,
        units=sensor.units,
        sampling_rate_hz=sensor.sampling_rate_hz,
    )


def _read_session_pairs(session: Session, displacement: xr.Dataset, known: xr.Dataset) -> dict[str, str]:
    """What sits where: sensors at the points of the measurement that move, else points of the same name."""
    moving = [p.name for p in session.point if not p.static and p.name in displacement["point"].values]
    if "sensor" not in known.dims:
        return {point: point for point in moving if point in known["point"].values}
    sensors = [s for s in session.sensor if s.name in known["sensor"].values]
    pairs = {str(s.point): s.name for s in sensors if s.point in moving}
    if not pairs or len(pairs) < sum(s.point in moving for s in sensors):
        placed, found = [(s.name, s.point) for s in session.sensor], [str(s) for s in known["sensor"].values]
        raise SessionError(
            f"pairs: expected one of the sensors {found} at each of some of the points {moving}, got {placed} in the "
            "session; name pairs with --pair point=sensor"
        )
    return pairs
