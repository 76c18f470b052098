"""Displacement of many points of a beam whose motion and whose errors are known: what a field is held against."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement

__all__ = ["DrawnField", "draw_field"]

LENGTH_M, HEIGHT_M = 16.0, 0.8
FREQUENCIES_HZ = (1.9, 5.3, 9.1)
AMPLITUDES_MM = {"lateral": (2.0, 0.5, 0.1), "vertical": (5.0, 0.8, 0.2), "longitudinal": (0.3, 0.05, 0.02)}


@dataclass(frozen=True, eq=False)
class DrawnField:
    """What was measured, and what moved.

    Parameters
    ----------
    displacement
        Displacement dataset with its budget, shape (T, P, 3) [mm].
    bad
        Names of points that follow something else.
    """

    displacement: xr.Dataset
    bad: tuple[str, ...]

    def truth(self, station_m: FloatArray) -> FloatArray:
        """True displacement at stations, shape (T, S, 3) [mm]."""
        return _move(self.displacement["time"].values, station_m)


def _move(time_s: FloatArray, station_m: FloatArray) -> FloatArray:
    shape = np.stack([np.sin((n + 1) * np.pi * (station_m + 2) / (LENGTH_M + 4)) for n in range(3)])
    swing = np.stack([np.sin(2 * np.pi * f * time_s + n) for n, f in enumerate(FREQUENCIES_HZ)])
    amplitudes = np.array([AMPLITUDES_MM[axis] for axis in STRUCTURE_AXES])
    return np.einsum("am,mt,ms->tsa", amplitudes, swing, shape)


def draw_field(
    seed: int, *, points: int = 200, frames: int = 120, bad: int = 3, shared_noise: float = 0.03
) -> DrawnField:
    """Points of a beam with noise that neighbours share, gains of their own, one scale error, and some that are wrong.

    Parameters
    ----------
    seed
        Of everything random.
    points, frames, bad
        How many there are, and how many of the points do not move as the beam does.
    shared_noise
        Standard deviation of noise that all points have alike in a frame [mm].
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(frames) / 30
    place = np.column_stack(
        [np.full(points, 9.6), rng.uniform(0, HEIGHT_M, points), np.sort(rng.uniform(0, LENGTH_M, points))]
    )
    true = _move(time_s, place[:, 2])
    scale_std = np.array([0.008, 0.006, 0.01])
    # Neighbours within decimetres compare the same pixels in part.
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    root = np.linalg.cholesky(0.6 * np.exp(-apart / 0.3) + 0.4 * np.eye(points))
    own_std = rng.uniform(0.01, 0.05, points)
    values = true * (1 + scale_std * rng.normal(size=3)) * (1 + rng.normal(0, 0.01, (points, 3)))
    values += own_std[:, None] * np.einsum("pq,tqa->tpa", root, rng.normal(size=(frames, points, 3)))
    values += shared_noise * rng.normal(size=(frames, 1, 3))
    names = [f"web {number + 1:03d}" for number in range(points)]
    wrong = rng.choice(points, bad, replace=False)
    values[:, wrong] = 0.3 * values[:, wrong] + rng.normal(0, 0.3, (frames, bad, 3))
    random = np.hypot(own_std, shared_noise)[:, None] * np.ones(3)
    displacement = make_displacement(
        time_s,
        names,
        STRUCTURE_AXES,
        DisplacementArrays(
            values,
            np.broadcast_to(random, values.shape),
            np.broadcast_to(scale_std, (points, 3)),
            np.broadcast_to(place, values.shape),
            np.zeros(values.shape[:2]),
            np.zeros(values.shape[:2]),
        ),
        attrs={"frame": "structure"},
    )
    budget = np.stack([np.broadcast_to(random, values.shape), np.abs(values) * scale_std])
    displacement = displacement.assign(
        uncertainty=(("component", "time", "point", "axis"), budget, {"units": "mm"}),
        origin=(("point", "axis"), place, {"units": "m"}),
    ).assign_coords(component=["random", "cameras"])
    return DrawnField(displacement, tuple(names[number] for number in sorted(wrong)))
