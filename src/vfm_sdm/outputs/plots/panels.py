"""Figures: trajectories in pixels, and displacement in millimetres.

Each ``plot_`` function draws into the axes given, or into a figure of its own, and returns the axes. Figures are made
without pyplot, so that nothing global changes and no window system is needed.
"""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from vfm_sdm.core.datasets import Status, check_displacement, check_tracks
from vfm_sdm.outputs.plots.drawing import (
    AXIS_COLOURS,
    BLUE,
    GREY,
    VERMILION,
    choose_name,
    finish_axes,
    list_names,
    make_axes,
    mark_status,
    plain_text,
    reduce_band,
    reduce_line,
)
from vfm_sdm.signals.spectrum import amplitude_spectrum, dominant_frequency

__all__ = ["plot_displacement", "plot_spectrum", "plot_trajectory"]

_LEAST_SHARE = 1e-4
"""Share of the highest line below which a spectrum shows nothing [1]."""


def plot_trajectory(tracks: xr.Dataset, ax: Axes | None = None, *, point: str | None = None) -> Axes:
    """Movement of one point in the image against time, relative to its first sample with status ok [px].

    Parameters
    ----------
    tracks
        Tracks of one view, shape (T, P, 2) [px].
    ax
        Axes to draw into; a new figure when None.
    point
        Name of the point; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no tracks, or no such point.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> position = np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0]
    >>> covariance = np.tile(0.01 * np.eye(2), (90, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(90) / 30, ["mid"], position, covariance, np.zeros((90, 1)), attrs={})
    >>> plot_trajectory(tracks).get_ylabel()
    'movement [px]'
    """
    of_point = check_tracks(tracks).sel(point=choose_name(tracks, "point", point))
    axes = make_axes(ax)
    time_s, status = of_point["time"].values, of_point["status"].values
    position = of_point["position"].values
    good = np.flatnonzero(status == Status.OK)
    moved = position - (position[good[0]] if good.size else np.full(2, np.nan))
    for values, name, colour in zip(moved.T, ("u (right)", "v (down)"), (BLUE, VERMILION), strict=True):
        axes.plot(*reduce_line(time_s, values), color=colour, linewidth=1.0, label=name)
    mark_status(axes, time_s, moved, status)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("movement [px]")
    axes.set_title(plain_text(str(of_point["point"].values)), loc="left")
    return finish_axes(axes, time_s)


def plot_displacement(
    displacement: xr.Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None
) -> Axes:
    """Displacement of one point along one axis against time [mm], with a band of two standard deviations.

    The band is the random part; the systematic part stands in the title, as a percentage of the displacement (k = 2).

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    ax
        Axes to draw into; a new figure when None.
    point, axis
        Names of the point and the axis; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no displacement, or no such point or axis.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import DisplacementArrays, STRUCTURE_AXES, make_displacement
    >>> displacement = make_displacement(
    ...     np.arange(90) / 30,
    ...     ["mid"],
    ...     STRUCTURE_AXES,
    ...     DisplacementArrays(
    ...         displacement_mm=np.sin(np.arange(90) / 5)[:, None, None] * [1.0, 2.0, 0.1],
    ...         displacement_std_mm=np.full((90, 1, 3), 0.1),
    ...         scale_std=np.full((1, 3), 0.01),
    ...         position_m=np.zeros((90, 1, 3)),
    ...         reprojection_error_px=np.zeros((90, 1)),
    ...         status=np.zeros((90, 1)),
    ...     ),
    ...     attrs={"frame": "structure"},
    ... )
    >>> plot_displacement(displacement, axis="vertical").get_title(loc="left")
    'mid, vertical'
    """
    check_displacement(displacement)
    names = {"point": choose_name(displacement, "point", point), "axis": choose_name(displacement, "axis", axis)}
    series = displacement.sel(names)
    axes = make_axes(ax)
    time_s, status = series["time"].values, series["status"].values
    values, half_band = series["displacement"].values, 2 * series["displacement_std"].values
    label = "± 2 std (random)"
    if "expanded_uncertainty" in series:
        half_band, label = series["expanded_uncertainty"].values, "expanded uncertainty (k = 2)"
    colour = AXIS_COLOURS[list_names(displacement, "axis").index(names["axis"]) % len(AXIS_COLOURS)]
    band = reduce_band(time_s, values - half_band, values + half_band)
    axes.fill_between(*band, color=colour, alpha=0.25, linewidth=0, label=label)
    axes.plot(*reduce_line(time_s, values), color=colour, linewidth=1.0)
    mark_status(axes, time_s, values[:, None], status)
    scale_std = float(series["scale_std"])
    scale = f"scale ± {200 * scale_std:.2g} % (k = 2)" if np.isfinite(scale_std) else "scale uncertainty not known"
    axes.set_title(plain_text(f"{names['point']}, {names['axis']}"), loc="left")
    axes.set_title(scale, loc="right", fontsize="small", color=GREY)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{names['axis']} [mm]")
    return finish_axes(axes, time_s)


def plot_spectrum(
    displacement: xr.Dataset, ax: Axes | None = None, *, point: str | None = None, axis: str | None = None
) -> Axes:
    """Amplitudes of one point's displacement along one axis against frequency [mm], with the dominant frequency.

    Parameters
    ----------
    displacement
        Displacement dataset, shape (T, P, 3) [mm].
    ax
        Axes to draw into; a new figure when None.
    point, axis
        Names of the point and the axis; may be left out where there is only one.

    Raises
    ------
    DatasetError
        The dataset holds no displacement, or no such point or axis.

    Notes
    -----
    Of samples that are ok; where the recording is too short, or too many samples are missing, the axes say so.
    """
    check_displacement(displacement)
    names = {"point": choose_name(displacement, "point", point), "axis": choose_name(displacement, "axis", axis)}
    series = displacement.sel(names)
    axes = make_axes(ax, (5, 3.5))
    values = np.where(series["status"].values == Status.OK, series["displacement"].values, np.nan)
    frequency_hz, amplitude = amplitude_spectrum(series["time"].values, values)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    colour = AXIS_COLOURS[list_names(displacement, "axis").index(names["axis"]) % len(AXIS_COLOURS)]
    if not amplitude.any():
        axes.text(
            0.5, 0.5, "too short for a spectrum,\nor too many gaps", transform=axes.transAxes, ha="center", va="center"
        )
        axes.set_yticks([])
        return finish_axes(axes, frequency_hz)
    axes.plot(*reduce_line(frequency_hz, amplitude), color=colour, linewidth=1.0)
    axes.set_yscale("log")
    lowest = max(_LEAST_SHARE * amplitude.max(), 0.5 * float(np.quantile(amplitude, 0.02)))
    axes.set_ylim(lowest, 2 * amplitude.max())
    dominant = dominant_frequency(series["time"].values, values)
    if dominant is not None:
        axes.axvline(dominant, color=GREY, linewidth=0.8, linestyle=":")
        axes.set_title(f"{dominant:.2f} Hz", loc="right", fontsize="small", color=GREY)
    return finish_axes(axes, frequency_hz)
