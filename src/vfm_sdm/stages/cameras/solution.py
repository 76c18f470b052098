"""Result of the camera stage: adjusted cameras, axes and the points' places in every view; ``cameras.toml``."""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomli_w
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.files import write_file
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import ResultsError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.cameras.contributions import Contribution
from vfm_sdm.stages.cameras.culprits import Suspect
from vfm_sdm.stages.cameras.file import read_rig, write_rig
from vfm_sdm.stages.cameras.site import SiteAdjustment, SiteQuantity
from vfm_sdm.stages.matching.points import state_frames

__all__ = ["CameraSolution", "read_solution", "write_solution"]


@dataclass(frozen=True, eq=False)
class CameraSolution:
    """Result of the camera stage.

    Parameters
    ----------
    rig
        Metric rig; ``None`` when the images did not allow one, and then the status says why.
    frame
        The structure's axes in the reference camera's frame, if the two distances were measured.
    covariance
        Joint covariance of rig parameters and axes, shape (10 V + 3, 10 V + 3); ``None`` when unknown.
    points
        Points dataset: pixels in every view, shape (V, P, 2) [px], and why one is missing.
    quantities, status, notes, epipolar_rms_px, suspects, contributions
        As in `vfm_sdm.stages.cameras.site.SiteAdjustment`.
    """

    rig: Rig | None
    frame: StructureFrame | None
    covariance: FloatArray | None
    points: xr.Dataset
    quantities: tuple[SiteQuantity, ...] = ()
    status: str = CameraStatus.OK
    notes: tuple[str, ...] = ()
    epipolar_rms_px: float = field(default=float("nan"))
    suspects: tuple[Suspect, ...] = ()
    contributions: tuple[Contribution, ...] = ()

    @property
    def place_std(self) -> FloatArray:
        """How well the same place was found in every view, shape (V, P, 2) [px]; NaN where that is not known."""
        return np.asarray(self.points["position_std"].transpose("view", "point", "pixel").values)

    @classmethod
    def of(cls, adjusted: SiteAdjustment, points: xr.Dataset) -> Self:
        """The solution that an adjustment gives.

        Parameters
        ----------
        adjusted
            Cameras adjusted to the site.
        points
            Points dataset: pixels in every view, shape (V, P, 2) [px].
        """
        return cls(
            adjusted.rig,
            adjusted.frame,
            adjusted.covariance,
            points,
            quantities=adjusted.quantities,
            status=adjusted.status,
            notes=adjusted.notes,
            epipolar_rms_px=adjusted.epipolar_rms_px,
            suspects=adjusted.suspects,
            contributions=adjusted.contributions,
        )


def write_solution(path: Path | str, solution: CameraSolution, key: str) -> Path:
    """Writes ``cameras.toml``: the rig as `write_rig` does, and all else in its table ``extra``.

    Parameters
    ----------
    path
        File to write; replaced as a whole.
    solution
        Result of the camera stage, for V views and P points; pixels in px, lengths in metres.
    key
        Identifies the inputs of the stage, to tell later whether the file is still true.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    site: dict[str, Any] = {
        "key": key,
        "status": solution.status,
        "notes": list(solution.notes),
        "epipolar_rms_px": solution.epipolar_rms_px,
        "points": _by_view(solution.points["position"]),
        "point_std": _by_view(solution.points["position_std"]),
        "point_status": _by_view(solution.points["status"]),
        **({"point_frame": _by_view(solution.points["frame"])} if "frame" in solution.points else {}),
        "quantity": [asdict(q) for q in solution.quantities],
        "suspect": [asdict(one) for one in solution.suspects],
        "contribution": {one.source: one.factor.tolist() for one in solution.contributions},
    }
    if solution.frame is not None:
        site["structure_from_cam1"] = solution.frame.rotation.tolist()
    if solution.covariance is not None:
        site["covariance"] = solution.covariance.tolist()
    if solution.rig is not None:
        write_rig(path, solution.rig, extra=site)
        return Path(path)
    return write_file(path, tomli_w.dumps({"extra": site}))


def read_solution(path: Path | str) -> tuple[CameraSolution, str]:
    """The solution and its key from ``cameras.toml``.

    Parameters
    ----------
    path
        A file of `write_solution`.

    Returns
    -------
    solution, key
        Result of the camera stage, for V views and P points, pixels in px and lengths in metres; and what identifies
        its inputs.

    Raises
    ------
    ResultsError
        The file is missing, or is not one that `write_solution` wrote.
    """
    file = Path(path)
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        site = table["extra"]
        covariance = np.array(site["covariance"]) if "covariance" in site else None
        frame = None
        if "structure_from_cam1" in site:
            turn = covariance[-3:, -3:] if covariance is not None else np.zeros((3, 3))
            frame = StructureFrame(np.array(site["structure_from_cam1"]), turn)
        solution = CameraSolution(
            read_rig(file) if len(table) > 1 else None,
            frame,
            covariance,
            _points(site),
            quantities=tuple(SiteQuantity(**q) for q in site["quantity"]),
            status=site["status"],
            notes=tuple(site["notes"]),
            epipolar_rms_px=site["epipolar_rms_px"],
            suspects=tuple(Suspect(**one) for one in site.get("suspect", [])),
            contributions=tuple(Contribution(*one) for one in _factors(site.get("contribution", {}))),
        )
    except FileNotFoundError as error:
        raise ResultsError(f"{file}: expected cameras.toml, got no such file; run `vfm-sdm cameras` first") from error
    except (LookupError, TypeError, ValueError, AttributeError, OSError) as error:
        raise ResultsError(
            f"{file}: expected a file written by `vfm-sdm cameras`, got {error}; delete it and run the stage again"
        ) from error
    return solution, str(site.get("key", ""))


def _factors(tables: Mapping[str, Any]) -> Iterator[tuple[str, FloatArray]]:
    for source, factor in tables.items():
        yield source, as_float_array(factor, f"contribution of {source}", (None, None))


def _by_view(variable: xr.DataArray) -> dict[str, dict[str, Any]]:
    """Values of a variable of points as tables: by view, by point."""
    views, points = ([str(name) for name in variable[dim].values] for dim in ("view", "point"))
    values = variable.transpose("view", "point", ...).values
    return {view: dict(zip(points, row.tolist(), strict=True)) for view, row in zip(views, values, strict=True)}


def _points(tables: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> xr.Dataset:
    """Points dataset from the tables of `_by_view`."""
    views = list(tables["points"])
    points = list(tables["points"][views[0]]) if views else []
    position, std, status = (
        [[tables[table][view][point] for point in points] for view in views]
        for table in ("points", "point_std", "point_status")
    )
    found = make_points(views, points, position=position, position_std=std, status=status)
    return state_frames(found, tables.get("point_frame", {}))
