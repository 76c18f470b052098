"""Influence lines: static displacement under 1 kN by its place, from that under a vehicle of several axles."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline

from vfm_sdm.analysis.load_test.passages import Axle
from vfm_sdm.core.arrays import FloatArray

__all__ = ["find_influence"]

_SPLINES = 12
"""Coefficients of an influence line."""


def find_influence(static: FloatArray, place: FloatArray, along: FloatArray, axles: Sequence[Axle]) -> FloatArray:
    """Displacement under 1 kN at places on the structure, shape (draws, stations) [mm/kN].

    Parameters
    ----------
    static
        Static displacement while the vehicle passes, shape (draws, stations) [mm].
    place
        Where its first axle was, counted from where the structure begins, shape (stations,) [m].
    along
        Places that are asked for, from 0 to the structure's length, shape (stations,) [m].
    axles
        Of the vehicle.

    Notes
    -----
    What a vehicle causes is the sum over its axles of load times the line where each axle is. The line, a cubic spline
    that is zero where the structure begins and ends, follows by least squares; twelve coefficients are enough for a
    girder of several spans, and few enough to be known.

    Examples
    --------
    >>> place = np.linspace(0, 24, 200)
    >>> line = lambda x: np.where((x > 0) & (x < 20), np.sin(np.pi * x / 20), 0)
    >>> truck = (Axle(0, 60), Axle(4, 100))
    >>> static = 60 * line(place) + 100 * line(place - 4)
    >>> found = find_influence(static[None], place, np.linspace(0, 20, 5), truck)
    >>> (np.round(found[0], 2) + 0).tolist()
    [0.0, 0.71, 1.0, 0.71, 0.0]
    """
    length = along[-1]
    knots = np.concatenate([np.zeros(3), np.linspace(0, length, _SPLINES - 2), np.full(3, length)])

    def basis(x: FloatArray) -> FloatArray:
        inside = (x >= 0) & (x <= length)
        rows = np.zeros((len(x), _SPLINES))
        rows[inside] = BSpline.design_matrix(x[inside], knots, 3).toarray()
        return rows[:, 1:-1]

    response = np.sum([axle.load_kn * basis(place - axle.behind_m) for axle in axles], axis=0)
    coefficients = np.linalg.lstsq(response, static.T, rcond=None)[0]
    return np.asarray((basis(along) @ coefficients).T)
