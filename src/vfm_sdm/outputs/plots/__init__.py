"""Figures of tracks, displacement and first frames: functions (data, ax=None) -> axes, and a run folder's pictures."""

from vfm_sdm.outputs.plots.audit import plot_audit
from vfm_sdm.outputs.plots.figures import file_stem, save_figures
from vfm_sdm.outputs.plots.panels import plot_displacement, plot_points, plot_trajectory

__all__ = ["file_stem", "plot_audit", "plot_displacement", "plot_points", "plot_trajectory", "save_figures"]
