"""Tracks for the package ``movement``, and for anybody's plain xarray: one netCDF file a view, without groups."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.cf import described
from vfm_sdm.core.datasets import START, Status, check_tracks
from vfm_sdm.core.files import distinct_stem, file_stem, write_file

__all__ = ["to_poses", "write_movement"]

_STRUCTURE = "structure"
"""The one individual, whose keypoints are the points."""


def write_movement(folder: Path | str, tracks_by_view: Mapping[str, xr.Dataset]) -> list[Path]:
    """Writes ``movement_VIEW.nc`` for each view; their paths.

    Parameters
    ----------
    folder
        The run folder; made when absent.
    tracks_by_view
        Tracks by view, shape (T, P, 2) [px], each with its own clock.

    Raises
    ------
    ResultsError
        A file cannot be written.
    DatasetError
        A dataset does not hold tracks.
    """
    written: list[Path] = []
    taken: set[str] = set()
    for view, tracks in tracks_by_view.items():
        content = described(to_poses(tracks)).to_netcdf(engine="h5netcdf")
        written.append(
            write_file(Path(folder) / f"{distinct_stem(f'movement_{file_stem(view)}', taken)}.nc", bytes(content))
        )
    return written


def to_poses(tracks: xr.Dataset) -> xr.Dataset:
    """Tracks of one view as a dataset of poses.

    Parameters
    ----------
    tracks
        Tracks, shape (T, P, 2) [px].

    Returns
    -------
    poses
        ``position`` (time, space, keypoints, individuals) [px] and ``confidence`` (time, keypoints, individuals) [1]:
        the correlation with the reference subset where the tracker states one, else 1 for status ok and 0.5 for
        unreliable; 0 where there is no position. Beyond what ``movement`` asks for: ``position_std`` [px], the standard
        deviation along x and y, and ``status`` (time, keypoints, individuals).

    Raises
    ------
    DatasetError
        The dataset does not hold tracks.

    References
    ----------
    .. [1] Neuroinformatics Unit, "movement", documentation of the datasets of poses, https://movement.neuroinformatics.dev

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> tracks = make_tracks([0.0, 0.1], ["mid"], np.ones((2, 1, 2)), np.zeros((2, 1, 2, 2)), [[0], [3]], attrs={})
    >>> poses = to_poses(tracks)
    >>> poses["position"].dims, poses["confidence"].values.ravel().tolist(), poses.attrs["fps"]
    (('time', 'space', 'keypoints', 'individuals'), [1.0, 0.5], 10.0)
    """
    check_tracks(tracks)
    time_s, status = tracks["time"].values, tracks["status"].values
    position = tracks["position"].transpose("time", "pixel", "point").values
    variance = np.einsum("tpkk->tkp", tracks["position_covariance"].values)
    sure = np.where(status == Status.OK, 1.0, np.where(status == Status.UNRELIABLE, 0.5, 0.0))
    if "correlation" in tracks:
        sure = np.where(sure > 0, np.clip(np.nan_to_num(tracks["correlation"].values), 0.0, 1.0), 0.0)
    lead, alike = ("time", "space", "keypoints", "individuals"), ("time", "keypoints", "individuals")
    attrs: dict[str, Any] = {"source_software": "vfm-sdm", "ds_type": "poses", "time_unit": "seconds"}
    if time_s.size > 1:
        attrs["fps"] = float(np.round((time_s.size - 1) / (time_s[-1] - time_s[0]), 6))
    kept = ("view", "tracker", "source", "image_width", "image_height", START)
    attrs |= {key: tracks.attrs[key] for key in kept if key in tracks.attrs}
    return xr.Dataset(
        {
            "position": (lead, position[..., None], {"units": "px"}),
            "confidence": (alike, sure[..., None], {"units": "1"}),
            "position_std": (lead, np.sqrt(variance)[..., None], {"units": "px"}),
            "status": (alike, status[..., None], tracks["status"].attrs),
        },
        coords={
            "time": ("time", time_s),
            "space": ["x", "y"],
            "keypoints": [str(name) for name in tracks["point"].values],
            "individuals": [_STRUCTURE],
        },
        attrs=attrs,
    )
