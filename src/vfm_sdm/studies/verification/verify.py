"""A run folder beside what can be computed anew from it: hashes, keys and numbers."""

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.files import file_fingerprint, file_hash
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.core.versions import package_versions
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Session, input_files
from vfm_sdm.outputs.results import read_summary, summarize_displacement
from vfm_sdm.studies.verification.kept_run import KEYED, read_keys, read_measurement, read_session_of

__all__ = ["Finding", "Verification", "verify_run"]

_TOLERANCE = 1e-6
"""Share of a variable's largest amount by which another processor's rounding may differ."""
_CSV_TOLERANCE_MM = 1e-3


@dataclass(frozen=True)
class Finding:
    """One comparison.

    Parameters
    ----------
    what
        What was compared.
    outcome
        Pass, fail (it differs), or not possible.
    sentence
        What was found.
    """

    what: str
    outcome: Outcome
    sentence: str


@dataclass(frozen=True)
class Verification:
    """Result of `verify_run`.

    Parameters
    ----------
    findings
        All comparisons.
    recomputed
        Whether displacement could be computed anew.
    """

    findings: tuple[Finding, ...]
    recomputed: bool

    @property
    def differing(self) -> tuple[Finding, ...]:
        """What is not as the run says."""
        return tuple(finding for finding in self.findings if finding.outcome is Outcome.FAIL)


def verify_run(folder: Path | str) -> Verification:
    """Hashes of inputs, session and products, and displacement computed anew from tracks, cameras and settings.

    Parameters
    ----------
    folder
        Run folder; nothing is written to it.

    Returns
    -------
    verification
        A finding for each comparison. Inputs that are no longer there cannot be compared, which is no difference.

    Raises
    ------
    ResultsError
        There is no run in this folder.

    Notes
    -----
    Numbers agree where no value differs by more than 1e-6 of the largest amount of its variable: another processor may
    round in another way.
    """
    path = Path(folder)
    record = read_summary(path)
    session = read_session_of(path)
    findings = [_compare_session(path, record), *_compare_inputs(session, record)]
    findings += _compare_versions(record)
    recomputed, again, stored = False, None, None
    try:
        again = read_measurement(path).displacement
        recomputed = True
    except VfmSdmError as error:
        findings.append(Finding("displacement computed anew", Outcome.NOT_POSSIBLE, str(error)))
    try:
        stored = read_displacement(path) if (path / "displacement.nc").exists() else None
    except VfmSdmError as error:
        findings.append(Finding("displacement.nc", Outcome.FAIL, str(error)))
    findings += _compare_keys(record, read_keys(path))
    if recomputed:
        findings += _compare_results(stored, again)
    if stored is not None:
        findings += [_compare_summary(record, stored), _compare_csv(path, stored)]
    return Verification(tuple(findings), recomputed)


def _finding(what: str, same: bool, sentence: str, otherwise: str) -> Finding:
    return Finding(what, Outcome.PASS if same else Outcome.FAIL, sentence if same else otherwise)


def _compare_session(path: Path, record: dict[str, Any]) -> Finding:
    same = record.get("session_file") == file_hash(path / SESSION)
    return _finding(SESSION, same, "as it was measured", "not the session that summary.json describes")


def _compare_inputs(session: Session, record: dict[str, Any]) -> Iterator[Finding]:
    """The files that were measured, as far as they are there."""
    stated = record.get("input_hashes")
    stated = stated if isinstance(stated, dict) else {}
    try:
        there = dict(input_files(session))
    except VfmSdmError as error:
        yield Finding("inputs", Outcome.NOT_POSSIBLE, str(error))
        return
    # Seen from the run folder, files have other ways to them than seen from the session's.
    known: dict[tuple[str, str], list[str]] = {}
    for name, digest in stated.items():
        known.setdefault(_split_name(name), []).append(str(digest))
    absent, same = [], 0
    for name, file in there.items():
        expected = known.get(_split_name(name), [])
        try:
            digest = file_fingerprint(file, whole=not any(one.startswith("sampled-") for one in expected))
        except OSError:
            absent.append(name)
            continue
        if digest in expected:
            same += 1
            continue
        said = "another content than when it was measured" if expected else "the run does not know this file"
        yield Finding(name, Outcome.FAIL, said)
    gone = len(absent) + max(len(stated) - len(there), 0)
    yield Finding("inputs", Outcome.PASS if same else Outcome.NOT_POSSIBLE, f"{same} of {len(stated)} compared")
    if gone:
        named = f", such as {absent[0]!r}" if absent else ""
        yield Finding("inputs", Outcome.NOT_POSSIBLE, f"{gone} files are not there{named}")


def _split_name(name: str) -> tuple[str, str]:
    """View, where the name states one, and name of the file itself."""
    label, _, way = name.rpartition(": ")
    return label, Path(way).name


def _compare_versions(record: dict[str, Any]) -> list[Finding]:
    stated = record.get("versions")
    if not isinstance(stated, dict):
        return []
    now = package_versions()
    changed = [f"{name} {stated[name]} then, {now[name]} now" for name in stated if now.get(name) != stated[name]]
    if not changed:
        return []
    return [Finding("versions", Outcome.NOT_POSSIBLE, "measured with other programs: " + "; ".join(map(str, changed)))]


def _compare_keys(record: dict[str, Any], keys: dict[str, str]) -> Iterator[Finding]:
    """Keys in the products' files beside those in the summary."""
    stated = record.get("products")
    if not isinstance(stated, dict):
        yield Finding("products", Outcome.NOT_POSSIBLE, "summary.json states no keys: an older run")
        return
    for name in KEYED:
        if name in stated or name in keys:
            what = f"key of {name}"
            if name not in keys:
                yield Finding(what, Outcome.FAIL, "its file is missing or damaged")
                continue
            yield _finding(what, stated.get(name) == keys[name], "as summary.json says", "not that of summary.json")


def _compare_results(stored: xr.Dataset | None, again: xr.Dataset | None) -> Iterator[Finding]:
    """Every variable of the displacement beside the one that is computed anew."""
    if stored is None or again is None:
        same = stored is again
        yield _finding("displacement", same, "none, as computed anew", "there where there should be none, or missing")
        return
    if {**stored.sizes} != {**again.sizes} or any(
        not np.array_equal(stored[name].values, again[name].values) for name in ("point", "axis")
    ):
        yield Finding(
            "displacement", Outcome.FAIL, f"of other points or frames: {dict(stored.sizes)}, not {dict(again.sizes)}"
        )
        return
    for name in again.variables:
        if name not in stored.variables:
            yield Finding(str(name), Outcome.FAIL, "missing in displacement.nc")
            continue
        yield _compare_variable(str(name), stored[name], again[name])


def _compare_variable(name: str, stored: xr.DataArray, again: xr.DataArray) -> Finding:
    units = f" {again.attrs['units']}" if "units" in again.attrs else ""
    old, new = stored.values, again.values
    if old.shape != new.shape or (old.dtype.kind in "fiu") != (new.dtype.kind in "fiu"):
        return Finding(name, Outcome.FAIL, f"of shape {old.shape}, computed anew {new.shape}")
    if new.dtype.kind not in "fiu":
        same = bool(np.array_equal(old.astype(str), new.astype(str)))
        return _finding(name, same, "as computed anew", "other words than computed anew")
    old, new = old.astype(float), new.astype(float)
    if not np.array_equal(np.isfinite(old), np.isfinite(new)):
        count = int((np.isfinite(old) != np.isfinite(new)).sum())
        return Finding(name, Outcome.FAIL, f"{count} values are there on one side only")
    difference = np.nan_to_num(np.abs(np.where(np.isfinite(new), old - new, 0.0)))
    largest, scale = float(difference.max(initial=0.0)), float(np.nan_to_num(np.abs(new), posinf=0.0).max(initial=0.0))
    place = (
        ", ".join(
            f"{dim} {again[dim].values[index]}" if dim in again.coords else f"{dim} {index}"
            for dim, index in zip(again.dims, np.unravel_index(int(difference.argmax()), difference.shape), strict=True)
        )
        if difference.size
        else ""
    )
    same = largest <= _TOLERANCE * scale
    said = "the same" if largest == 0 else f"within {largest:.1e}{units}"
    return _finding(name, same, said, f"differs by up to {largest:.4g}{units} (at {place})")


def _compare_summary(record: dict[str, Any], stored: xr.Dataset) -> Finding:
    """Figures of the summary beside those of displacement.nc."""
    stated = record.get("points")
    if not stated:
        return Finding("summary.json", Outcome.NOT_POSSIBLE, "it states no figures: the run was cut short")
    text = json.dumps(summarize_displacement(stored), default=float)
    differing = list(_find_differing(stated, json.loads(text), ""))
    same, named = not differing, "; ".join(differing[:3])
    return _finding(
        "summary.json", same, "its figures are those of displacement.nc", f"not of displacement.nc: {named}"
    )


def _find_differing(stated: Any, found: Any, name: str) -> Iterator[str]:
    if isinstance(stated, dict) and isinstance(found, dict):
        for key in found.keys() & stated.keys():
            yield from _find_differing(stated[key], found[key], f"{name} {key}".strip())
        if not name and found.keys() != stated.keys():
            yield f"points {sorted(stated)}"
        return
    numbers = isinstance(stated, int | float) and isinstance(found, int | float)
    if (numbers and not np.isclose(stated, found, rtol=_TOLERANCE, atol=1e-12)) or (not numbers and stated != found):
        yield f"{name} {stated} (is {found})"


def _compare_csv(path: Path, stored: xr.Dataset) -> Finding:
    """Displacement in the table beside that of displacement.nc."""
    what = "displacement.csv"
    try:
        with (path / what).open(encoding="utf-8", newline="") as stream:
            rows = list(csv.reader(stream))
        columns = [
            (rows[0].index(f"{point} {axis} [mm]"), stored["displacement"].sel(point=point, axis=axis).values)
            for point in stored["point"].values
            for axis in stored["axis"].values
        ]
        worst = 0.0
        for column, values in columns:
            table = np.array([float(row[column] or "nan") for row in rows[1:]])
            if table.shape != values.shape or not np.array_equal(np.isfinite(table), np.isfinite(values)):
                return Finding(what, Outcome.FAIL, "not of the same samples as displacement.nc")
            worst = max(worst, float(np.nanmax(np.abs(table - values), initial=0.0)))
    except FileNotFoundError:
        return Finding(what, Outcome.FAIL, "missing")
    except (OSError, ValueError, LookupError, csv.Error) as error:
        return Finding(what, Outcome.FAIL, f"damaged: {error}")
    return _finding(what, worst <= _CSV_TOLERANCE_MM, "as displacement.nc", f"differs by up to {worst:.4g} mm")
