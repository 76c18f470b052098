"""Calibrations of consumer cameras in the words of the table of profiles, grouped, and each calibrator left out."""

import csv
import gzip
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vfm_sdm.inputs.profiles.hierarchy import LensKey
from vfm_sdm.inputs.profiles.table import ProfileTable
from vfm_sdm.inputs.profiles.words import aspect_of, class_of, plain, plain_model, read_setting

__all__ = [
    "GROUP",
    "NORMAL_95",
    "Held",
    "Record",
    "describe_lens",
    "group_records",
    "leave_out",
    "read_records",
]

GROUP = ("kind", "brand", "model", "mode", "film", "aspect", "stabilised")
LEAST_CALIBRATORS = 3
NORMAL_95 = 1.96
_DESCRIBED = 1e-3
"""Root mean square over the picture, over its longer side, up to which radial coefficients describe a lens."""
_ONE_FOCAL, _WORST_RMS_PX, _REACH = 0.03, 5.0, 0.9
"""Calibrations that are left out: two focal lengths that differ by more, residuals of more pixels, and polynomials that
turn back before this share of the corner's radius."""
_GRID = 41


@dataclass(frozen=True)
class Record:
    """One calibration: what lens it is of, by whom, and its figures as `ProfileTable` defines them."""

    key: LensKey
    name: str
    calibrator: str
    order: int
    log_focal: float
    corner: tuple[float, float, float]
    residual: float
    readout_ms: float

    @property
    def group(self) -> tuple[str, ...]:
        """Words of the group in the table, in the order of `GROUP`."""
        setting = self.key.setting
        film = "0" if setting.film_mm is None else str(round(setting.film_mm))
        state = "" if setting.stabilised is None else "on" if setting.stabilised else "off"
        return (str(self.key.kind), self.key.brand, self.key.model, setting.mode, film, setting.aspect, state)


def read_records(path: Path) -> list[Record]:
    """Calibrations that can be used, in the file's order."""
    with gzip.open(path, "rt", encoding="utf-8", newline="") as file:
        return [record for row in csv.DictReader(file) if (record := _read(row)) is not None]


def _read(row: Mapping[str, str]) -> Record | None:
    brand = plain(row["brand"])
    model = plain_model(row["brand"], row["model"])
    kind = class_of(brand, model)
    texts = [row[name] for name in ("model", "lens", "setting", "note")]
    stretched = any(row[name] and float(row[name]) != 1 for name in ("stretch_h", "stretch_v"))
    fx, fy, rms = (float(row[name]) for name in ("fx_px", "fy_px", "rms_px"))
    if stretched or "anamor" in " ".join(texts).casefold() or rms > _WORST_RMS_PX or min(fx, fy) <= 0:
        return None
    if abs(np.log(fx / fy)) > _ONE_FOCAL:
        return None
    width, height = float(row["width_px"]), float(row["height_px"])
    found = describe_lens((fx * fy) ** 0.5, [float(row[f"k{n}"]) for n in (1, 2, 3, 4)], (width, height))
    if found is None:
        return None
    setting = replace(read_setting(texts, kind), aspect=aspect_of(width, height))
    readout = abs(float(row["readout_ms"] or 0))
    return Record(LensKey(kind, brand, model, setting), f"{row['brand'].strip()} {row['model'].strip()}",
                  row["calibrator"], *found, readout)  # fmt: skip


def describe_lens(
    focal: float, fisheye: Sequence[float], size: tuple[float, float]
) -> tuple[int, float, tuple[float, float, float], float] | None:
    """A fisheye calibration in the words of `vfm_sdm.geometry.camera.Camera`.

    Parameters
    ----------
    focal
        Focal length [px].
    fisheye
        Coefficients of OpenCV's fisheye model, shape (4,) [1].
    size
        Width and height of the picture [px].

    Returns
    -------
    order, log_focal, corner, residual
        Number of radial coefficients, 0 where three leave too much; logarithm of focal length over longer side;
        coefficients at the corner; root mean square of what they leave over the picture, over its longer side. None
        where the fisheye polynomial turns back within the picture.

    Notes
    -----
    With the angle t from the axis, a pinhole sees ``x = tan t`` and the fisheye model draws ``f t (1 + sum k_i t^2i)``.
    Least squares of ``f' x (1 + sum k'_i x^2i)`` to that at places spread evenly over the picture is linear in ``f'``
    and ``f' k'_i``; the fewest coefficients that leave less than a thousandth of the longer side describe the lens.
    """
    angle = np.linspace(0, np.pi / 2 * 0.985, 1500)
    drawn = angle * (1 + sum(k * angle ** (2 * n) for n, k in enumerate(fisheye, start=1)))
    rising = np.diff(drawn, prepend=-1.0) > 0
    last = len(rising) if rising.all() else int(np.argmin(rising))
    places = np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, _GRID) * side for side in size)), axis=-1).reshape(-1, 2)
    radius = np.hypot(*places.T) / focal
    longer, farthest = max(size), float(np.hypot(*size)) / 2 / focal
    if last < 2 or drawn[last - 1] < _REACH * farthest:
        return None
    x = np.tan(np.interp(radius[radius <= drawn[last - 1]], drawn[:last], angle[:last]))
    seen = radius[radius <= drawn[last - 1]] * focal / longer
    for order in (1, 2, 3):
        powers = np.stack([x ** (2 * n + 1) for n in range(order + 1)], axis=1)
        found, *_ = np.linalg.lstsq(powers, seen, rcond=None)
        residual = float(np.sqrt(np.mean((powers @ found - seen) ** 2)))
        if found[0] > 0 and residual <= _DESCRIBED:
            corner = np.zeros(3)
            # At the radius of the corner as it is drawn over the focal length, as priors of distortion are stated.
            ratio = farthest * focal / longer / found[0]
            corner[:order] = found[1:] / found[0] * ratio ** (2 * np.arange(1, order + 1))
            return order, float(np.log(found[0])), tuple(corner.tolist()), residual
    return 0, float(np.log(focal / longer)), (0.0, 0.0, 0.0), residual


def group_records(records: Iterable[Record]) -> list[dict[str, Any]]:
    """Rows of the table: one value a calibrator and group, in the order of their names."""
    groups: dict[tuple[Any, ...], dict[str, list[Record]]] = defaultdict(lambda: defaultdict(list))
    for record in records:
        groups[*record.group, record.order][record.calibrator].append(record)
    return [_row(key, of) for key, of in sorted(groups.items())]


def _row(key: tuple[Any, ...], of: Mapping[str, Sequence[Record]]) -> dict[str, Any]:
    names = ("kind", "brand", "model", "mode", "film", "aspect", "stabilised", "order")
    logs = np.array([np.median([one.log_focal for one in own]) for own in of.values()])
    corners = np.array([np.median([one.corner for one in own], axis=0) for own in of.values()])
    everyone = [one for own in of.values() for one in own]
    readouts = [one.readout_ms for one in everyone if one.readout_ms > 0]
    return {
        **dict(zip(names, key, strict=True)),
        "name": Counter(one.name for one in everyone).most_common(1)[0][0],
        "calibrators": len(of),
        "log_focal": round(float(logs.mean()), 4),
        "log_focal_squares": float(f"{((logs - logs.mean()) ** 2).sum():.3g}"),
        **{f"corner{n + 1}": round(float(corners[:, n].mean()), 4) for n in range(3)},
        "corner_squares": float(f"{((corners[:, 0] - corners[:, 0].mean()) ** 2).sum():.3g}"),
        "residual": round(float(np.median([one.residual for one in everyone])), 5),
        "readout_ms": round(float(np.median(readouts)), 1) if readouts else 0,
    }


@dataclass(frozen=True, eq=False)
class Held:
    """A calibrator's value of a group with three or more, to be expected from the others."""

    record: Record
    log_focal: float
    others: ProfileTable


def leave_out(records: Sequence[Record], *, least: int = LEAST_CALIBRATORS, only: str = "") -> Iterator[Held]:
    """Every calibrator's value in every group with so many calibrators, with the table of all others.

    Parameters
    ----------
    records
        Calibrations.
    least
        Calibrators that a group has at least.
    only
        Kind of camera; all when left out.
    """
    used = [one for one in records if one.order > 0]
    people: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for one in used:
        people[one.group].add(one.calibrator)
    rows = group_records(records)
    place = {(*(str(row[name]) for name in GROUP), row["order"]): n for n, row in enumerate(rows)}
    whole = ProfileTable.from_rows(rows)
    by_group: dict[tuple[Any, ...], list[Record]] = defaultdict(list)
    by_person: dict[str, list[Record]] = defaultdict(list)
    for one in records:
        by_group[*one.group, one.order].append(one)
        by_person[one.calibrator].append(one)
    for person, own in by_person.items():
        held: dict[tuple[str, ...], list[Record]] = defaultdict(list)
        for one in own:
            if one.order > 0 and len(people[one.group]) >= least and only in ("", str(one.key.kind)):
                held[one.group].append(one)
        if not held:
            continue
        others = _without(whole, place, by_group, person, own)
        for same in held.values():
            yield Held(same[0], float(np.median([one.log_focal for one in same])), others)


def _without(
    whole: ProfileTable,
    place: Mapping[tuple[Any, ...], int],
    by_group: Mapping[tuple[Any, ...], Sequence[Record]],
    person: str,
    own: Sequence[Record],
) -> ProfileTable:
    """The table without one calibrator."""
    columns = {
        name: getattr(whole, name).copy()
        for name in ("calibrators", "log_focal", "log_focal_squares", "corner", "corner_squares")
    }
    for key in {(*one.group, one.order) for one in own}:
        row, left = place[key], [one for one in by_group[key] if one.calibrator != person]
        if not left:
            columns["calibrators"][row] = 0
            continue
        new = next(iter(group_records(left)))
        for name in ("calibrators", "log_focal", "log_focal_squares", "corner_squares"):
            columns[name][row] = new[name]
        columns["corner"][row] = [new[f"corner{n}"] for n in (1, 2, 3)]
    return replace(whole, **columns)
