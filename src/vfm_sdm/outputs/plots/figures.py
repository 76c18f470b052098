"""The figures of a run folder, and their files."""

import gc
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.datasets import frames_of_points
from vfm_sdm.core.files import distinct_stem, file_stem, write_file
from vfm_sdm.core.grids import without_grids
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.plots.about import About, positive_direction
from vfm_sdm.outputs.plots.audit import plot_audit
from vfm_sdm.outputs.plots.drawing import GREY, list_names, plain_text
from vfm_sdm.outputs.plots.overview import MOST_FIGURES, draw_overview
from vfm_sdm.outputs.plots.panels import plot_displacement, plot_spectrum, plot_trajectory
from vfm_sdm.outputs.plots.pictures import plot_points
from vfm_sdm.stages.audit import Audit

__all__ = ["file_stem", "first_places", "save_figures", "save_later_points"]

_DPI = 150
_MOST_PANELS = 12
_WIDTH_IN = 9.0
_SPECTRUM_IN = 3.2
_NOTHING = About()


def save_figures(
    folder: Path | str,
    tracks_by_view: Mapping[str, xr.Dataset],
    displacement: xr.Dataset | None,
    frames: Mapping[str, npt.NDArray[Any]],
    points_by_view: Mapping[str, npt.ArrayLike],
    *,
    about: About = _NOTHING,
) -> list[Path]:
    """Writes the figures of a run into ``figures/`` of its folder and returns their paths.

    ``trajectory_<view>.png``, ``displacement_<point>.png`` (one panel an axis, its spectrum beside it), of more than 20
    points in their place ``displacement_overview_<axis>.png``, ``points_<view>.png`` and ``audit.png``; characters that
    file names may not have are replaced (see `file_stem`).

    Parameters
    ----------
    folder
        The run folder.
    tracks_by_view
        Tracks of each view, shape (T, P, 2) [px]; points of grids are not drawn.
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; None when there is none.
    frames
        First frame by view, shape (H, W) or (H, W, 3).
    points_by_view
        Positions in that frame by view, shape (P, 2) [px], in the order of the view's tracks; or with their names,
        ``position`` of a points dataset, without those that are named in other frames.
    about
        What the figures say of the run: session, verdict, static points.

    Raises
    ------
    ResultsError
        A figure cannot be written.
    DatasetError
        The data do not fit together.
    """
    tracks_by_view = {view: without_grids(tracks) for view, tracks in tracks_by_view.items()}
    displacement = None if displacement is None else without_grids(displacement)
    for view in points_by_view:
        if view not in frames or view not in tracks_by_view:
            raise DatasetError(f"view {view!r}: expected its first frame and its tracks, got neither or one; pass both")
    drawings: list[tuple[str, Callable[[], Figure]]] = []
    for view, tracks in tracks_by_view.items():
        drawings.append((f"trajectory_{file_stem(view)}", partial(_draw_trajectories, view, tracks, about)))
    if displacement is not None and displacement.sizes["point"] > MOST_FIGURES:
        for axis in list_names(displacement, "axis"):
            stem = f"displacement_overview_{file_stem(axis)}"
            drawings.append((stem, partial(draw_overview, displacement, axis, about)))
    elif displacement is not None:
        for point in list_names(displacement, "point"):
            drawings.append(
                (f"displacement_{file_stem(point)}", partial(_draw_displacement, displacement, point, about))
            )
    for view, points in points_by_view.items():
        # Positions that say whose they are need not be of all points.
        names = list_names(points.to_dataset() if isinstance(points, xr.DataArray) else tracks_by_view[view], "point")
        draw = partial(_draw_points, frames[view], points, names, about, f"points in view {view}, first frame")
        drawings.append((f"points_{file_stem(view)}", draw))
    if about.audit is not None:
        drawings.append(("audit", partial(_draw_audit, about.audit, about.line)))
    return _write_figures(Path(folder) / "figures", drawings)


def first_places(points: xr.Dataset) -> dict[str, xr.DataArray]:
    """Positions by view of the points that are named in its first frame, as `save_figures` takes them.

    Parameters
    ----------
    points
        Points dataset, positions of shape (V, P, 2) [px].
    """
    points = without_grids(points)
    of_views = {view: points.sel(view=view) for view in list_names(points, "view")}
    return {
        view: one["position"].transpose("point", "pixel").isel(point=frames_of_points(one) == 0)
        for view, one in of_views.items()
    }


def save_later_points(
    folder: Path | str, points: xr.Dataset, picture: Callable[[str, int], npt.NDArray[Any]], *, about: About = _NOTHING
) -> list[Path]:
    """Writes pictures of the points that come into view later, each with its own frame, and returns their paths.

    ``points_<view>_frame_<number>.png`` in ``figures/``; none where all points are named in the first frames.

    Parameters
    ----------
    folder
        The run folder.
    points
        Points dataset, positions of shape (V, P, 2) [px].
    picture
        Function of a view and a number that returns that frame, shape (H, W).
    about
        What the figures say of the run.

    Raises
    ------
    ResultsError
        A figure cannot be written.
    """
    drawings: list[tuple[str, Callable[[], Figure]]] = []
    for view in list_names(points, "view") if "frame" in points else []:
        of_view = points.sel(view=view)
        numbers = of_view["frame"].values
        for number in sorted({*numbers.tolist()} - {0}):
            some = of_view.isel(point=numbers == number)
            names, places = list_names(some, "point"), some["position"].transpose("point", "pixel").values
            draw = partial(
                _draw_points, picture(view, number), places, names, about, f"points in view {view}, frame {number}"
            )
            drawings.append((f"points_{file_stem(view)}_frame_{number}", draw))
    return _write_figures(Path(folder) / "figures", drawings)


def _write_figures(folder: Path, drawings: Sequence[tuple[str, Callable[[], Figure]]]) -> list[Path]:
    """Files of the figures, of which only one is in memory at a time."""
    paths: list[Path] = []
    taken: set[str] = set()
    for stem, draw in drawings:
        unique = distinct_stem(stem, taken)
        drawn = BytesIO()
        draw().savefig(drawn, format="png", dpi=_DPI, pil_kwargs={"compress_level": 3})
        paths.append(write_file(folder / f"{unique}.png", drawn.getvalue()))
        # A figure and its canvas hold each other, with some 50 MB of pixels that no count of objects shows.
        gc.collect()
    return paths


def _draw_points(frame: npt.NDArray[Any], points: npt.ArrayLike, names: list[str], about: About, title: str) -> Figure:
    height, width = frame.shape[:2]
    figure = _make_figure(rows_in=min(_WIDTH_IN * height / width, 12.0))
    axes = plot_points(frame, points, names, figure.add_subplot(), static=[name in about.static for name in names])
    legend = "; blue: static" if about.static & {*names} else ""
    _add_head(figure, f"{title}{legend}", [axes], about.line)
    return figure


def _draw_trajectories(view: str, tracks: xr.Dataset, about: About) -> Figure:
    names = list_names(tracks, "point")
    shown = names[:_MOST_PANELS]
    figure = _make_figure(rows_in=1.7 * max(len(shown), 1))
    panels = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False, gridspec_kw={"hspace": 0.3})[:, 0]
    for panel, point in zip(panels, shown, strict=False):
        plot_trajectory(tracks, panel, point=point)
        panel.set_title(plain_text(about.named(point)), loc="left")
        panel.label_outer()
    part = f" ({len(shown)} of {len(names)} points)" if len(shown) < len(names) else ""
    _add_head(figure, f"image movement in view {view}{part}", panels.tolist(), about.line)
    return figure


def _draw_displacement(displacement: xr.Dataset, point: str, about: About) -> Figure:
    axes_names = list_names(displacement, "axis")
    frame = str(displacement.attrs.get("frame") or "")
    figure = _make_figure(rows_in=2.1 * len(axes_names), width_in=_WIDTH_IN + _SPECTRUM_IN)
    layout = {"hspace": 0.3, "wspace": 0.2, "width_ratios": [_WIDTH_IN, _SPECTRUM_IN]}
    panels = figure.subplots(len(axes_names), 2, sharex="col", squeeze=False, gridspec_kw=layout)
    for (history, spectrum), axis in zip(panels, axes_names, strict=True):
        plot_displacement(displacement, history, point=point, axis=axis)
        plot_spectrum(displacement, spectrum, point=point, axis=axis)
        positive = positive_direction(frame, axis)
        history.set_title(f"positive: {positive}" if positive else "", loc="left", fontsize="small", color=GREY)
        for panel in (history, spectrum):
            # Times and frequencies stand below the last row.
            panel.set_xlabel(panel.get_xlabel() if axis == axes_names[-1] else "")
    title = f"displacement of {about.named(point)}" + (f" ({frame} axes)" if frame else "")
    _add_head(figure, title, panels[:, 0].tolist(), about.line)
    return figure


def _draw_audit(audit: Audit, line: str) -> Figure:
    figure = Figure(figsize=(14.0, 1.3 + 0.34 * len(audit.checks)))
    # Names of checks on the left, their sentences on the right.
    figure.subplots_adjust(left=0.17, right=0.52, bottom=0.6 / figure.get_figheight(), top=0.93)
    plot_audit(audit, figure.add_subplot())
    top = 1 - 0.15 / figure.get_figheight()
    figure.text(0.99, top, plain_text(line), ha="right", va="top", fontsize="small", color=GREY)
    return figure


def _make_figure(rows_in: float, width_in: float = _WIDTH_IN) -> Figure:
    """A figure with fixed margins around a plotting area of this height and width [inch].

    An automatic layout would draw every figure twice.
    """
    # The left one holds tick labels of eight characters and the axis label.
    left, right, bottom, top = 1.2, 0.2, 0.75, 0.95
    width, height = left + width_in + right, bottom + rows_in + top
    figure = Figure(figsize=(width, height))
    figure.subplots_adjust(left / width, bottom / height, 1 - right / width, 1 - top / height)
    return figure


def _add_head(figure: Figure, title: str, panels: Sequence[Axes], line: str = "") -> None:
    """A title with what is said of the run below it, and one legend for all panels so that none covers data."""
    height = figure.get_size_inches()[1]
    figure.text(0.01, 1 - 0.1 / height, plain_text(title), ha="left", va="top", fontsize="large")
    figure.text(0.01, 1 - 0.36 / height, plain_text(line), ha="left", va="top", fontsize="small", color=GREY)
    figure.align_ylabels(panels)
    entries: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        figure.legend(entries.values(), entries.keys(), loc="upper right", ncols=len(entries), frameon=False)
