"""Runs of the same films, side by side: what their results differ by, person by person."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
import xarray as xr

from vfm_sdm.analysis.repeatability.anova import Spread, analyse_variance
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import FIRST_SAMPLE, START, Status, check_displacement
from vfm_sdm.errors import DatasetError

__all__ = ["QUANTITIES", "RepeatedRun", "compare_runs"]

QUANTITIES = ("displacement", "peak_to_peak", "rms", "highest", "lowest")
"""What is compared: the samples of a series, and values of it."""
_FEWEST_SHARED = 0.5
"""Share of the samples that all runs must know to be compared."""


@dataclass(frozen=True, eq=False)
class RepeatedRun:
    """One measurement of the films.

    Parameters
    ----------
    name
        What it is called.
    person
        Who made it.
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    films
        Hashes of the recordings by view; empty where they are not known.
    still_interval_s
        Interval whose mean displacement is relative to [s], where that is known.
    """

    name: str
    person: str
    displacement: xr.Dataset
    films: Mapping[str, str]
    still_interval_s: tuple[float, float] | None = None

    @property
    def origin(self) -> str:
        """What displacement is relative to, in words; empty where nobody says."""
        words = str(self.displacement.attrs.get("relative_to", ""))
        if self.still_interval_s is None or not words.startswith("mean"):
            return words
        begin, end = self.still_interval_s
        return f"{words}, {begin:g}-{end:g} s"


def compare_runs(runs: Sequence[RepeatedRun]) -> xr.Dataset:
    """Repeatability and reproducibility of each point and axis, beside the uncertainty that the runs state.

    Parameters
    ----------
    runs
        At least two, of the same films; points have the same names where they are the same.

    Returns
    -------
    result
        Dims ``quantity`` (`QUANTITIES`), ``point`` and ``axis``, all [mm]: ``repeatability``, ``between`` and
        ``reproducibility`` as of `Spread`, with their intervals; ``p_value`` [1]; ``stated_std``, the standard
        uncertainty that the runs state, root mean square over runs and samples; and ``consistency``, the
        reproducibility, or with one person the repeatability, over it [1]. By ``run`` beside: ``value`` [mm], whose
        entry for ``displacement`` is the root mean square difference from the mean of all; ``person``; ``origin``, what
        displacement is relative to, and ``start``, when time is zero, in words. By ``point``, ``first_frame_differs``:
        whether displacement is relative to the first valid sample and that is of another frame in some run. NaN where a
        point is not seen by all runs in half of the samples.

    Raises
    ------
    DatasetError
        Fewer than two runs, or runs of other films, other times or axes, or without a common point.

    Notes
    -----
    The films, and so the noise of their pictures, are the same for all: what differs is where points were placed, what
    was noted of the site, and settings. So the spread is a part of the stated uncertainty, and a consistency above 1
    says that the runs contradict what they state. Runs whose origins differ differ by a constant beside, which is in
    ``displacement``, ``rms``, ``highest`` and ``lowest``, and not in ``peak_to_peak``.

    Examples
    --------
    Four runs of two people: `examples/plot_repeat.py`.
    """
    _check_alike(runs)
    named = [{str(name) for name in run.displacement["point"].values} for run in runs]
    points = [str(name) for name in runs[0].displacement["point"].values if all(str(name) in one for one in named)]
    if not points:
        raise DatasetError(
            f"repeat: expected points of the same names in all runs, got {[sorted(one)[:4] for one in named]}; name "
            "them alike"
        )
    axes = [str(name) for name in runs[0].displacement["axis"].values]
    people = sorted({run.person for run in runs})
    member = [people.index(run.person) for run in runs]
    shape = (len(QUANTITIES), len(points), len(axes))
    found = {one.name: np.full(shape, np.nan) for one in fields(Spread)}
    stated, values = np.full(shape, np.nan), np.full((len(runs), *shape), np.nan)
    for p, point in enumerate(points):
        for a, axis in enumerate(axes):
            series, std = _series(runs, point, axis)
            if not series.size:
                continue
            of_runs, of_std = _quantities(series, std)
            for q, quantity in enumerate(QUANTITIES):
                spread = analyse_variance(of_runs[quantity], member)
                for one, value in zip(fields(Spread), astuple(spread), strict=True):
                    found[one.name][q, p, a] = value
                stated[q, p, a] = of_std[quantity]
                values[:, q, p, a] = (
                    np.sqrt(np.mean((series - series.mean(axis=0)) ** 2, axis=1))
                    if quantity == "displacement"
                    else of_runs[quantity]
                )
    single = np.where(np.isfinite(found["reproducibility"]), found["reproducibility"], found["repeatability"])
    dims = ("quantity", "point", "axis")
    millimetres = {name: (dims, array, {"units": "mm"}) for name, array in found.items() if name != "p_value"}
    return xr.Dataset(
        {
            **millimetres,
            "p_value": (dims, found["p_value"], {"units": "1"}),
            "stated_std": (dims, stated, {"units": "mm"}),
            "consistency": (dims, single / np.where(stated > 0, stated, np.nan), {"units": "1"}),
            "value": (("run", *dims), values, {"units": "mm"}),
            "person": ("run", [run.person for run in runs]),
            "origin": ("run", [run.origin for run in runs]),
            "start": ("run", [str(run.displacement.attrs.get(START, "")) for run in runs]),
            "first_frame_differs": ("point", [_first_frame_differs(runs, point) for point in points]),
        },
        coords={"run": [run.name for run in runs], "quantity": list(QUANTITIES), "point": points, "axis": axes},
        attrs={"displacement_key": str(runs[0].displacement.attrs.get("key", ""))},
    )


def _first_frame_differs(runs: Sequence[RepeatedRun], point: str) -> bool:
    """Whether displacement of a point is relative to its first valid sample, which is not of one frame in all runs."""
    firsts = {
        int(np.argmax(run.displacement["status"].sel(point=point).values == Status.OK))
        for run in runs
        if run.origin == FIRST_SAMPLE
    }
    return len(firsts) > 1


def _check_alike(runs: Sequence[RepeatedRun]) -> None:
    if len(runs) < 2:
        raise DatasetError(f"repeat: expected at least 2 runs of the same films, got {len(runs)}; name further ones")
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise DatasetError(f"repeat: expected different runs, got {', '.join(names)}; name each once")
    first = runs[0]
    for run in runs[1:]:
        check_displacement(run.displacement)
        if first.films and run.films and set(first.films.values()) != set(run.films.values()):
            raise DatasetError(
                f"repeat: expected runs of the same films, got others in {run.name} than in {first.name}; two films of "
                "one motion are compared with `vfm-sdm evaluate`"
            )
        for dim, words in (("time", "times of the frames"), ("axis", "axes")):
            if not np.array_equal(run.displacement[dim].values, first.displacement[dim].values):
                raise DatasetError(
                    f"repeat: expected the same {words}, got others in {run.name} than in {first.name}; measure with "
                    "the same use_s and axes"
                )


def _series(runs: Sequence[RepeatedRun], point: str, axis: str) -> tuple[FloatArray, FloatArray]:
    """Displacement and its standard uncertainty at the samples that all runs know, shape (R, N) [mm]."""
    chosen = [run.displacement.sel(point=point, axis=axis) for run in runs]
    known = np.all([one["status"].values == Status.OK for one in chosen], axis=0)
    series = np.stack([one["displacement"].values for one in chosen])
    std = np.stack([one["combined_std" if "combined_std" in one else "displacement_std"].values for one in chosen])
    known &= np.isfinite(series).all(axis=0)
    return (series[:, known], std[:, known]) if known.mean() >= _FEWEST_SHARED else (series[:, :0], std[:, :0])


def _quantities(series: FloatArray, std: FloatArray) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Values of the runs, shape (R,) or (R, N), and their standard uncertainties [mm]."""
    highest, lowest = series.argmax(axis=1), series.argmin(axis=1)
    each = np.arange(len(series))
    top, bottom = std[each, highest], std[each, lowest]
    values = {
        "displacement": series,
        "peak_to_peak": np.ptp(series, axis=1),
        "rms": np.sqrt(np.mean(series**2, axis=1)),
        "highest": series[each, highest],
        "lowest": series[each, lowest],
    }
    whole = float(np.sqrt(np.mean(std**2)))
    uncertain = {
        "displacement": whole,
        "peak_to_peak": float(np.sqrt(np.mean(top**2 + bottom**2))),
        "rms": whole,
        "highest": float(np.sqrt(np.mean(top**2))),
        "lowest": float(np.sqrt(np.mean(bottom**2))),
    }
    return values, uncertain
