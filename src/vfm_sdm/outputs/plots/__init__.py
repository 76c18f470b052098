"""Figures of tracks, displacement, first frames and the audit: functions (data, ax=None) -> axes, and their files."""

from vfm_sdm.outputs.plots.about import About, describe_run, positive_direction
from vfm_sdm.outputs.plots.audit import plot_audit
from vfm_sdm.outputs.plots.figures import file_stem, first_places, save_figures, save_later_points
from vfm_sdm.outputs.plots.overview import draw_overview
from vfm_sdm.outputs.plots.panels import plot_displacement, plot_spectrum, plot_trajectory
from vfm_sdm.outputs.plots.pictures import draw_frame, plot_points, plot_subsets

__all__ = [
    "About",
    "describe_run",
    "draw_frame",
    "draw_overview",
    "file_stem",
    "first_places",
    "plot_audit",
    "plot_displacement",
    "plot_points",
    "plot_spectrum",
    "plot_subsets",
    "plot_trajectory",
    "positive_direction",
    "save_figures",
    "save_later_points",
]
