"""Known lengths in the measured volume, as optical coordinate measuring systems are accepted by them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.analysis.acceptance.records import (
    Acceptance,
    AcceptanceRow,
    AcceptedRun,
    as_number,
    check_limit,
    read_rows,
)
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.rig_draws import RigDraws
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = ["KnownLength", "check_lengths", "read_lengths"]

_MM_PER_M = 1e3
_DRAWS = 2000


@dataclass(frozen=True)
class KnownLength:
    """A length between two points.

    Parameters
    ----------
    point_a, point_b
        Names of the points.
    length_m, std_m
        The calibrated length and its standard deviation [m].
    """

    point_a: str
    point_b: str
    length_m: float
    std_m: float = 0.0


def read_lengths(path: Path | str) -> tuple[KnownLength, ...]:
    r"""Known lengths from a CSV file.

    Parameters
    ----------
    path
        File with the columns ``point_a``, ``point_b``, ``length_m`` and, where known, ``std_m`` [m].

    Raises
    ------
    DatasetError
        The file is not as described, or a length is not positive.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "lengths.csv")
    ...     _ = file.write_text("point_a,point_b,length_m\nleft end,right end,1.5003\n")
    ...     read_lengths(file)
    (KnownLength(point_a='left end', point_b='right end', length_m=1.5003, std_m=0.0),)
    """
    found = []
    for row in read_rows(path, ("point_a", "point_b", "length_m")):
        std = as_number(path, row, "std_m") if row.get("std_m") else 0.0
        length = KnownLength(row["point_a"], row["point_b"], as_number(path, row, "length_m"), std)
        if not (length.length_m > 0 and std >= 0):
            raise DatasetError(f"{path}: expected lengths above 0 m, got {length}; correct the row")
        found.append(length)
    return tuple(found)


def check_lengths(
    run: AcceptedRun,
    cameras: CameraSolution,
    lengths: Sequence[KnownLength],
    *,
    limit_mm: float | None = None,
    limit_per_m: float = 0.0,
) -> Acceptance:
    """Error of each length, measured less known, beside the maximum permissible error.

    Parameters
    ----------
    run
        The run; its points at rest are the ends of the lengths.
    cameras
        Cameras of the run, with their covariance.
    lengths
        Known lengths.
    limit_mm, limit_per_m
        Maximum permissible error ``A + K L``: its constant part [mm], and its part for each metre of the length [mm/m].
        Without a constant part, the limit is the expanded uncertainty (k = 2) of each length that the cameras and
        the places of the points give.

    Returns
    -------
    acceptance
        A row for each length.

    Raises
    ------
    DatasetError
        A point is not in the run, or a limit is not positive.

    Notes
    -----
    The error of a length is ``l_measured - l_known`` [1]_. Positions are those of displacement zero: the mean of
    position less displacement over the samples with status ok. The guideline's own arrangement, several lengths along
    lines all over the volume, is that of whoever places them. Lengths that the adjustment of the cameras has used are
    named, because they are no test of it.

    References
    ----------
    .. [1] VDI/VDE 2634 Part 1 (2002). Optical 3D measuring systems: imaging systems with point-by-point probing.
    """
    check_limit(limit_mm, "limit", positive=False)
    check_limit(limit_per_m, "limit per metre", positive=False)
    names = [str(name) for name in run.displacement["point"].values]
    unknown = sorted({end for one in lengths for end in (one.point_a, one.point_b)} - set(names))
    if unknown or any(one.point_a == one.point_b for one in lengths):
        raise DatasetError(
            f"lengths: expected two of the points {names} each, got {unknown or 'one twice'}; correct it"
        )
    place = {name: _find_place(run, name) for name in names}
    rows = []
    for one in lengths:
        measured = float(np.linalg.norm(place[one.point_a] - place[one.point_b]))
        limit = limit_per_m * one.length_m + limit_mm if limit_mm is not None else float("nan")
        if limit_mm is None:
            own = _MM_PER_M * _find_std(one, place, cameras)
            limit = 2 * float(np.hypot(own, _MM_PER_M * one.std_m))
        error = _MM_PER_M * (measured - one.length_m)
        rows.append(AcceptanceRow(f"{one.point_a} - {one.point_b}", "l_measured - l_known", error, limit, "mm"))
    stated = f"{limit_mm} mm + {limit_per_m:g} mm/m" if limit_mm is not None else "stated by the run itself (k = 2)"
    details = {"lengths": [asdict(one) for one in lengths]}
    return Acceptance("lengths", stated, tuple(rows), _name_used(run, lengths), details)


def _find_place(run: AcceptedRun, name: str) -> FloatArray:
    """Position of a point at displacement zero, shape (3,) [m]; NaN where no sample is ok."""
    one = run.displacement.sel(point=name)
    rest = one["position"].values - one["displacement"].values / _MM_PER_M
    ok = (one["status"].values == Status.OK) & np.isfinite(rest).all(axis=-1)
    return np.asarray(rest[ok].mean(axis=0)) if ok.any() else np.full(rest.shape[-1], np.nan)


def _find_std(one: KnownLength, place: dict[str, FloatArray], cameras: CameraSolution) -> float:
    """Standard deviation of a measured length from cameras and places of points, by random draws [m]."""
    if cameras.rig is None or cameras.covariance is None:
        return float("nan")
    rig, rng = cameras.rig, np.random.default_rng(0)
    turn = np.eye(3) if cameras.frame is None else cameras.frame.rotation
    draws = RigDraws.from_covariance(rig, cameras.covariance[:-3, :-3], _DRAWS, rng)
    ends = []
    for name in (one.point_a, one.point_b):
        pixels = np.stack([camera.project(place[name] @ turn) for camera in rig.cameras])
        std = np.nan_to_num(cameras.points["position_std"].sel(point=name).values)
        noisy = pixels[:, None] + std[:, None] * rng.standard_normal((len(rig), _DRAWS, 2))
        ends.append(draws.triangulate(noisy))
    return float(np.linalg.norm(ends[0] - ends[1], axis=1).std(ddof=1))


def _name_used(run: AcceptedRun, lengths: Sequence[KnownLength]) -> tuple[str, ...]:
    """A sentence on each length that the adjustment used."""
    if run.session is None:
        return ()
    used = [set(length.points) for length in run.session.site.length]
    return tuple(
        f"{one.point_a} - {one.point_b}: this length also adjusted the cameras, so it does not test them"
        for one in lengths
        if {one.point_a, one.point_b} in used
    )
