"""Acceleration of a sensor that a session names."""

import xarray as xr

from vfm_sdm.core.sensor_datasets import ACCELERATION_UNITS
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.sensors.sensor_csv import read_acceleration, states_acceleration
from vfm_sdm.inputs.session import Session

__all__ = ["read_session_acceleration"]


def read_session_acceleration(session: Session, name: str) -> tuple[xr.Dataset, str]:
    """Acceleration of a sensor, and the point that it sits at.

    Parameters
    ----------
    session
        The session.
    name
        Name of the sensor.

    Returns
    -------
    acceleration, point
        Dataset of shape (T, 1, A) [m/s2] on the sensor's clock, and the name of its point.

    Raises
    ------
    SessionError
        There is no such sensor, it has no point, or it does not measure acceleration.
    DatasetError
        Its file cannot be read.
    """
    named = {sensor.name: sensor for sensor in session.sensor}
    if name not in named:
        known = ", ".join(named) or "there is none"
        raise SessionError(
            f"sensor: expected one of the session's ({known}), got {name!r}; add a [[sensor]] of it to a "
            "session, and name that with --session"
        )
    sensor = named[name]
    if sensor.point is None:
        raise SessionError(
            f"sensor[{name}].point: expected the point that the sensor sits at, got none; add point = ..."
        )
    columns = {str(axis): column for axis, column in sensor.columns.items()} or None
    path = session.resolve(sensor.file)
    is_acceleration = sensor.units in ACCELERATION_UNITS
    if sensor.units is None:
        is_acceleration = states_acceleration(path, columns) is not False
    if not is_acceleration:
        raise SessionError(
            f"sensor[{name}].units: expected acceleration ({', '.join(ACCELERATION_UNITS)}), got displacement; compare "
            "it with `vfm-sdm evaluate`"
        )
    acceleration = read_acceleration(
        path,
        sensor=name,
        columns=columns,
        units=sensor.units,
        sampling_rate_hz=sensor.sampling_rate_hz,
        start=sensor.start,
    )
    return acceleration, sensor.point
