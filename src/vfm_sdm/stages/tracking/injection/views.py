"""Injection in all views, and tracks at the size that the injected motion shows to be right."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import MAD_TO_STD, FloatArray
from vfm_sdm.core.covariances import raise_variance
from vfm_sdm.core.dataset_checks import check_variable
from vfm_sdm.core.grids import grid_points
from vfm_sdm.core.netcdf import read_dataset, write_dataset
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.statuses import InjectionStatus
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.tracking.base import Tracker
from vfm_sdm.stages.tracking.design.choice import SubsetChoice
from vfm_sdm.stages.tracking.injection.inject import inject

__all__ = ["correct_tracks", "inject_views", "read_injection", "write_injection"]

_OF_A_GRID = 6
"""Points of a grid that motion is put in around: it takes seconds a point, and the codec treats neighbours alike."""
_SIGNIFICANT = 2.0
"""Standard deviations by which a gain must differ from 1 to be corrected."""


def inject_views(
    videos: Mapping[str, Video],
    tracks: Mapping[str, xr.Dataset],
    tracker: Tracker,
    subsets: Mapping[str, Mapping[str, SubsetChoice]],
    *,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Gain and noise of all points in all views, as `inject` finds them.

    Parameters
    ----------
    videos, tracks
        Recordings, and tracks of shape (T, P, 2) [px], by view.
    tracker
        Tracker that the tracks come from.
    subsets
        What the subset of each point compares, by view and point; empty for trackers that have none to design.
    progress
        Called with the view.

    Returns
    -------
    found
        The variables of `inject`, with a leading dim ``view``. Of a grid, some points are looked at; the others get the
        median of these, with their scatter.
    """
    found = []
    for number, (view, video) in enumerate(videos.items()):
        if progress is not None:
            progress("injection", number, len(videos))
        designs = {name: choice.design for name, choice in subsets.get(view, {}).items()}
        chosen = _choose_points(tracks[view])
        told = inject(video, tracks[view].sel(point=chosen), tracker, designs=designs or None)
        found.append(_fill_grids(told, tracks[view]))
    return xr.concat(found, dim="view").assign_coords(view=list(videos))


def _choose_points(tracks: xr.Dataset) -> list[str]:
    """Points that motion is put in around: those with names of their own, and some of every grid, evenly over it."""
    names, many = [str(name) for name in tracks["point"].values], grid_points(tracks)
    if not many:
        return names
    followed = np.isfinite(tracks["position"].values).all(axis=(0, 2))
    chosen = [name for name in names if name not in set(many)]
    for grid in np.unique(tracks["grid"].values[tracks["grid"].values != ""]):
        rows = np.flatnonzero((tracks["grid"].values == grid) & followed)
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _OF_A_GRID).round().astype(int))] if rows.size else rows
        chosen += [names[row] for row in rows]
    return chosen


def _fill_grids(told: xr.Dataset, tracks: xr.Dataset) -> xr.Dataset:
    """What was found of some points, for all: of the others of a grid, the middle of what its points told."""
    names = tracks["point"].values.tolist()
    if told.sizes["point"] == len(names):
        return told
    ok = told["injection_status"].values == InjectionStatus.OK
    found = told.reindex(point=names, fill_value={"injection_status": str(InjectionStatus.STILL)})
    for grid in np.unique(tracks["grid"].values[tracks["grid"].values != ""]):
        members = [name for name, of in zip(names, tracks["grid"].values, strict=True) if of == grid]
        rest = [name for name in members if name not in told["point"].values]
        sample = told.isel(point=np.flatnonzero(ok & np.isin(told["point"].values, members)))
        found["injected_direction"].loc[{"point": rest}] = np.eye(2)
        if not sample.sizes["point"]:
            continue
        scatter = MAD_TO_STD * abs(sample["injected_gain"] - sample["injected_gain"].median("point")).median("point")
        for name in ("injected_gain", "injected_noise"):
            found[name].loc[{"point": rest}] = sample[name].median("point")
        spread = np.sqrt(sample["injected_gain_std"].median("point") ** 2 + scatter**2)
        found["injected_gain_std"].loc[{"point": rest}] = spread
        found["injection_status"].loc[{"point": rest}] = str(InjectionStatus.AS_OTHERS)
    return found


def correct_tracks(tracks: Mapping[str, xr.Dataset], found: xr.Dataset | None) -> dict[str, xr.Dataset]:
    """Tracks whose motion is divided by its gain where that is certain; what is left is said of each point.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px].
    found
        Gains, see `inject_views`; ``None`` where nothing was injected.

    Returns
    -------
    corrected
        The tracks with the variables of ``found``, and with ``gain_left_std`` (point, direction) [1]: relative standard
        deviation of the gain that the motion in these tracks has; NaN where it is not known.

    Notes
    -----
    Where a gain differs from 1 by more than two of its standard deviations, motion since the first frame is divided by
    it, and covariances with it. Elsewhere the loss that may be there counts as uncertainty. Covariances are raised to
    the noise that the injected motion came out with: it holds the slow errors of the codec, which neither residuals nor
    the highest frequencies show.
    """
    if found is None:
        return dict(tracks)
    return {view: _correct(of_view, found.sel(view=view, drop=True)) for view, of_view in tracks.items()}


def read_injection(path: Path) -> tuple[xr.Dataset, str]:
    """What `write_injection` wrote, and its key.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ResultsError
        The file is damaged or holds something else.
    """
    found = read_dataset(path, _check_gains, kind="gains", command="vfm-sdm measure")
    return found, str(found.attrs.pop("key", ""))


def write_injection(path: Path, found: xr.Dataset, marks: Mapping[str, str]) -> None:
    """Writes gains of all views, see `inject_views`.

    Parameters
    ----------
    path
        The file.
    found
        Gains of V views and P points along two directions, shape (V, P, 2) [1].
    marks
        With the ``key`` of what they were made of.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    write_dataset(path, found.assign_attrs(key=marks["key"]))


def _check_gains(found: xr.Dataset) -> xr.Dataset:
    check_variable(found, "injected_gain", ("view", "point", "direction"), "1")
    return found


def _correct(tracks: xr.Dataset, found: xr.Dataset) -> xr.Dataset:
    gain, std = found["injected_gain"].values, found["injected_gain_std"].values
    certain = np.isfinite(gain) & (gain > 0) & (np.abs(1 - gain) > _SIGNIFICANT * std)
    factor = np.where(certain, 1 / np.where(certain, gain, 1.0), 1.0)
    left = np.where(certain, std * factor, np.hypot(1 - gain, std))
    directions = found["injected_direction"].values
    A = np.einsum("pki,pk,pkj->pij", directions, factor, directions)
    position, covariance = tracks["position"].values, tracks["position_covariance"].values
    start = _first_known(position)
    values: dict[str, Any] = {
        "position": start + np.einsum("pij,tpj->tpi", A, position - start),
        "position_covariance": np.einsum("pij,tpjk,plk->tpil", A, covariance, A),
    }
    unchanged = ~certain.any(axis=1)
    for name, data in values.items():
        data[:, unchanged] = tracks[name].values[:, unchanged]  # to the last bit
    noise = (found["injected_noise"].values * factor) ** 2
    values["position_covariance"] = raise_variance(values["position_covariance"], directions, noise)
    corrected = tracks.copy()
    for name, data in values.items():
        corrected[name] = tracks[name].copy(data=data)
    return corrected.assign({name: found[name] for name in found.data_vars}).assign(
        gain_left_std=(("point", "direction"), left, {"units": "1"})
    )


def _first_known(position: FloatArray) -> FloatArray:
    """First position of each point, shape (P, 2) [px]; NaN for a point that is never seen."""
    known = np.isfinite(position).all(axis=2)
    return np.asarray(position[known.argmax(axis=0), np.arange(position.shape[1])])
