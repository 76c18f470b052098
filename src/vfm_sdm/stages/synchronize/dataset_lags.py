"""Lags between datasets: between views from their tracks, and between vision and sensors from their displacement."""

from collections.abc import Mapping, Sequence

import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import check_displacement, check_tracks, trusted_values
from vfm_sdm.core.statuses import ClockStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.synchronize.channels import compare_points
from vfm_sdm.stages.synchronize.lag import LagSearch, Synchronization, estimate_lag
from vfm_sdm.stages.synchronize.signals import Samples

__all__ = ["estimate_sensor_lag", "estimate_view_lag", "synchronize_views"]


def estimate_view_lag(
    tracks_a: xr.Dataset,
    tracks_b: xr.Dataset,
    *,
    points: Sequence[str] | None = None,
    search: LagSearch | None = None,
    rig: Rig | None = None,
    band_hz: tuple[float, float] = (0.5, 12.0),
) -> Synchronization:
    """Lag of one view's recording behind another's, from the tracks of the same moving points.

    Parameters
    ----------
    tracks_a, tracks_b
        Tracks datasets, shapes (Ta, P, 2) and (Tb, P, 2) [px], each on its own clock [s].
    points
        Moving points to use; without them, all points that both views have. Static points only add the cameras'
        shaking.
    search
        Where the lag is looked for [s]; within 2 s of zero when left out.
    rig
        The cameras of the two views, where they are known.
    band_hz
        See `estimate_lag` [Hz].

    Returns
    -------
    synchronization
        The lag [s]; ``uses`` says of every point, in their order, whether it was used.

    Raises
    ------
    DatasetError
        A point is not in both views, or there is none.

    Notes
    -----
    Each point has its own 2 x 2 mixture from (u, v) to (u, v): what two cameras see of a motion in two directions. Both
    cameras must stand upright on the same side of the structure, so that a motion to the right or down is one in both:
    otherwise half a period later would look as good. With known cameras the motion across the epipolar plane is
    compared, which both see alike whatever the structure does; where that does not determine the lag, all of it. A
    point on an edge counts by the motion across the edge.

    Only samples of status ok are used, of every point its own: lost points do not matter to the others. Points weigh by
    the residual that their own fit leaves, which holds the tracker's noise as it is, not as the tracker states it.
    Points that show no common motion, or another lag than most, are left out (`find_consensus`).
    """
    check_tracks(tracks_a)
    check_tracks(tracks_b)
    both = [str(p) for p in tracks_a["point"].values if p in tracks_b["point"].values]
    chosen = both if points is None else list(points)
    if not chosen or not set(chosen) <= set(both):
        raise DatasetError(f"points: expected some of {both}, which both views have, got {chosen}; correct them")
    clocks = tracks_a["time"].values, tracks_b["time"].values
    for cameras in (rig, None) if rig is not None else (None,):
        values_a, values_b, groups = compare_points(tracks_a, tracks_b, chosen, cameras)
        found = estimate_lag(
            Samples(clocks[0], values_a),
            Samples(clocks[1], values_b),
            search=search or LagSearch(),
            groups=groups,
            positive_gain=True,
            band_hz=band_hz,
        )
        if found.ok:
            break
    return found


def synchronize_views(
    tracks_by_view: Mapping[str, xr.Dataset],
    *,
    start_offsets_s: Mapping[str, float] | None = None,
    start_std_s: float | None = None,
    points: Sequence[str] | None = None,
    search_s: float = 2.0,
    rig: Rig | None = None,
) -> dict[str, Synchronization]:
    """Clock of every view relative to the first view's.

    Parameters
    ----------
    tracks_by_view
        Tracks datasets, shape (T, P, 2) [px], each on its own clock [s]; the first is the reference view.
    start_offsets_s
        Seconds by which a view's first frame happens later than the reference view's, where roughly known: the
        convention of `align_views`, opposite in sign to a lag.
    start_std_s, search_s
        See `LagSearch` [s].
    points
        See `estimate_view_lag`.
    rig
        The cameras of all views by name, where they are known.

    Returns
    -------
    synchronization
        One lag [s] for every view, the reference view included (lag 0). ``offset_s`` and ``rate_ratio`` are what
        `align_views` takes.

    Raises
    ------
    DatasetError
        There is no view, or a point is not in all views.
    """
    if not tracks_by_view:
        raise DatasetError("views: expected one tracks dataset or more, got none; track the views first")
    reference, *others = tracks_by_view
    result = {reference: Synchronization(0.0, 0.0, 1.0, ClockStatus.OK, candidates=(0.0,))}
    for name in others:
        result[name] = estimate_view_lag(
            tracks_by_view[reference],
            tracks_by_view[name],
            points=points,
            search=LagSearch(search_s, -(start_offsets_s or {}).get(name, 0.0), start_std_s),
            rig=None if rig is None else Rig((reference, name), (rig.camera(reference), rig.camera(name))),
        )
    return result


def estimate_sensor_lag(
    displacement: xr.Dataset,
    reference: xr.Dataset,
    *,
    pairs: Sequence[tuple[str, str]],
    axes: Sequence[str] = ("lateral", "vertical"),
    search: LagSearch | None = None,
    band_hz: tuple[float, float] = (1.0, 10.0),
) -> Synchronization:
    """Lag of a sensor's displacement behind the displacement from video.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (Ta, P, 3) [mm].
    reference
        Displacement of the sensors: variable ``displacement``, shape (Tb, S, A) [mm], dims ``time, sensor, axis``, on
        the sensors' clock [s].
    pairs
        Point and sensor that measure the same place.
    axes
        Axes that are used together, each with a gain of its own above zero.
    search
        Where the lag is looked for [s]; within 2 s of zero when left out.
    band_hz
        Band that both sides hold [Hz]; displacement from acceleration has nothing below its high-pass.

    Raises
    ------
    DatasetError
        A dataset has other dims or units, or lacks a point, sensor or axis.
    """
    check_displacement(displacement)
    dims = ("time", "sensor", "axis")
    found = reference.get("displacement")
    if found is None or found.dims != dims or found.attrs.get("units") != "mm":
        got = "none" if found is None else f"{found.dims} in {found.attrs.get('units')!r}"
        raise DatasetError(f"reference: expected a variable 'displacement' with dims {dims} in 'mm', got {got}")
    known = {*displacement["point"].values}, {*reference["sensor"].values}
    if not pairs or any(point not in known[0] or sensor not in known[1] for point, sensor in pairs):
        raise DatasetError(f"pairs: expected points of {known[0]} and sensors of {known[1]}, got {list(pairs)}")
    shared = {*displacement["axis"].values} & {*reference["axis"].values}
    if not axes or not {*axes} <= shared:
        raise DatasetError(f"axes: expected some of {sorted(map(str, shared))}, got {list(axes)}; name common axes")
    places, sensors = ([pair[side] for pair in pairs] for side in (0, 1))
    seen = displacement.sel(point=places, axis=list(axes))
    sensed = reference.sel(sensor=sensors, axis=list(axes))["displacement"]
    channels = len(pairs) * len(axes)
    return estimate_lag(
        Samples(displacement["time"].values, _trusted_columns(seen, "displacement")),
        Samples(reference["time"].values, sensed.values.reshape(sensed.sizes["time"], -1)),
        search=search or LagSearch(),
        groups=[((i,), (i,)) for i in range(channels)],
        positive_gain=True,
        band_hz=band_hz,
    )


def _trusted_columns(dataset: xr.Dataset, name: str) -> FloatArray:
    """Values of a variable (T, P, n) as columns (T, P n), NaN where the status is not ok."""
    return trusted_values(dataset, name).reshape(dataset.sizes["time"], -1)
