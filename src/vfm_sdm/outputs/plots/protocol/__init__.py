"""The figures of the paper's protocol: trajectories, refinement, comparison with a reference, cameras, sensitivity.

A figure of one panel is drawn into the axes given, or into a figure of its own, and its axes are returned; one of
several panels is returned as a figure. All are as wide as the text of an A4 page; `save_figure` writes them.
"""

from vfm_sdm.outputs.plots.protocol.layout import save_figure
from vfm_sdm.outputs.plots.protocol.poses import plot_camera_poses
from vfm_sdm.outputs.plots.protocol.sensitivity import SensitivityRecord, plot_sensitivity
from vfm_sdm.outputs.plots.protocol.signals import (
    plot_comparison,
    plot_displacement3d,
    plot_parity,
    plot_refinement,
    plot_trajectories,
)

__all__ = [
    "SensitivityRecord",
    "plot_camera_poses",
    "plot_comparison",
    "plot_displacement3d",
    "plot_parity",
    "plot_refinement",
    "plot_sensitivity",
    "plot_trajectories",
    "save_figure",
]
