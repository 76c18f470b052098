"""Cameras in three dimensions: where they stand and what they see, for several estimates at a time."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.core.datasets import CAMERA_AXES, STRUCTURE_AXES
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.outputs.plots.drawing import BLUE, GREEN, ORANGE, PURPLE, VERMILION, plain_text
from vfm_sdm.outputs.plots.protocol.layout import make_figure

__all__ = ["plot_camera_poses"]

_RIG_STYLES = (
    ("#AAAAAA", 2.2, "-"),  # under the others, and still to be seen
    (VERMILION, 0.9, "-"),
    (BLUE, 0.9, "--"),
    (GREEN, 0.9, ":"),
    (PURPLE, 0.9, "-."),
    (ORANGE, 0.9, "--"),
)
_DIRECTIONS = {"lateral": "lateral (away)", "vertical": "vertical (down)"}
_SHORTEST = 0.22
"""Least length of an axis as a share of the longest."""
_MOST_TICKS = 8


def plot_camera_poses(
    rigs: Mapping[str, Rig],
    ax: Axes | None = None,
    *,
    frame: StructureFrame | None = None,
    points3d: npt.ArrayLike | None = None,
    title: str = "",
) -> Axes:
    """Positions and viewing pyramids of several rigs' cameras in 3D, drawn with the vertical axis upwards.

    Parameters
    ----------
    rigs
        Rigs by name, such as true and estimated, with at least two cameras each. All have the same reference camera.
    ax
        Three-dimensional axes to draw into; a new figure when None.
    frame
        The structure's axes; those of the reference camera when None.
    points3d
        Points in the reference camera's frame, shape (P, 3) [length unit of the first rig, such as m]; NaN are left
        out.
    title
        Title of the picture.

    Raises
    ------
    DatasetError
        There is no rig, one has no baseline, the axes are not three-dimensional, or ``points3d`` has another shape.

    Notes
    -----
    A rig without metric scale gets the baseline of the first that has it; if none has, every baseline is 1. Pyramids
    reach half the way to the points, and at least as far as the baseline is long.

    Examples
    --------
    >>> left = Camera(np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]), (640, 480))
    >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> plot_camera_poses({"true": Rig(("left", "right"), (left, right), metric=True)}).get_xlabel()
    'right [m]'
    """
    factors, unit, baseline = _choose_scale(rigs)
    axes: Any = ax or make_figure(4.9).add_subplot(projection="3d")
    if getattr(axes, "name", None) != "3d":
        raise DatasetError("ax: expected three-dimensional axes, got flat ones; make them with projection='3d'")
    rotation = np.eye(3) if frame is None else frame.rotation
    drawn: list[FloatArray] = []

    def draw(where: FloatArray, *style: str, **options: Any) -> None:
        # In the order first, third, second, and with the second pointing down, the axes keep their handedness.
        drawn.append((where @ rotation.T)[:, [0, 2, 1]])
        axes.plot(*drawn[-1].T, *style, **options)

    depth = baseline
    points = as_float_array(np.empty((0, 3)) if points3d is None else points3d, "points3d", (None, 3))
    points = factors[next(iter(rigs))] * points[np.isfinite(points).all(axis=1)]
    if len(points):
        depth = max(baseline, 0.5 * float(np.median(np.linalg.norm(points, axis=1))))
        draw(points, ".", color="black", markersize=3, markeredgewidth=0, label="points")
    for (name, rig), (colour, width, dashes) in zip(rigs.items(), cycle(_RIG_STYLES), strict=False):
        label = name + ("" if rig.metric or unit != "m" else " (scale aligned)")
        for camera in rig.scaled(factors[name]).cameras:
            draw(camera.center[None], "o", color=colour, markersize=3 + width)
            draw(_make_pyramid(camera, depth), color=colour, linewidth=width, linestyle=dashes, label=label)
            label = "_"
    _label_cameras(axes, rigs, factors, rotation)
    _set_limits(axes, np.concatenate(drawn))
    _label_axes(axes, unit, in_structure=frame is not None)
    axes.set_title(plain_text(title), loc="left", fontsize="medium", pad=20)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, frameon=False, fontsize="small", borderpad=0)
    return axes  # type: ignore[no-any-return]


def _label_cameras(axes: Any, rigs: Mapping[str, Rig], factors: Mapping[str, float], rotation: FloatArray) -> None:
    """View names at the first rig's cameras."""
    name, rig = next(iter(rigs.items()))
    for view, camera in zip(rig.names, rig.scaled(factors[name]).cameras, strict=True):
        axes.text(
            *(rotation @ camera.center)[[0, 2, 1]], plain_text(f"\n{view}"), ha="center", va="top", fontsize="small"
        )


def _label_axes(axes: Any, unit: str, *, in_structure: bool) -> None:
    """Names, directions and units, seen from behind the cameras."""
    axes.view_init(elev=28, azim=-148 if in_structure else -62)
    names = STRUCTURE_AXES if in_structure else CAMERA_AXES
    for place, axis, pad in zip("xzy", names, (9, 9, 20 if in_structure else 9), strict=True):
        getattr(axes, f"set_{place}label")(f"{_DIRECTIONS.get(axis, axis)} [{unit}]", labelpad=pad)


def _set_limits(axes: Any, drawn: FloatArray) -> None:
    """Equal units along all axes, the third downwards; none so short that its numbers run into each other."""
    low, high = np.nanmin(drawn, axis=0), np.nanmax(drawn, axis=0)
    size = 1.05 * np.maximum(high - low, _SHORTEST * np.max(high - low))
    middle = (low + high) / 2
    for place, start, end, share in zip("xyz", middle - size / 2, middle + size / 2, size / size.max(), strict=True):
        getattr(axes, f"set_{place}lim")(*((end, start) if place == "z" else (start, end)))
        axes.locator_params(axis=place, nbins=max(2, round(_MOST_TICKS * share)))
    axes.set_box_aspect(size)


def _choose_scale(rigs: Mapping[str, Rig]) -> tuple[dict[str, float], str, float]:
    """Factor of each rig's lengths, the common unit, and the baseline in it."""
    if not rigs:
        raise DatasetError("rigs: expected at least one, got none; pass rigs by name")
    for name, rig in rigs.items():
        if len(rig) < 2 or not rig.baseline() > 0:
            raise DatasetError(f"rig {name!r}: expected two cameras at a distance, got none; leave it out")
    metric = next((rig.baseline() for rig in rigs.values() if rig.metric), None)
    baseline = 1.0 if metric is None else metric
    factors = {name: 1.0 if rig.metric else baseline / rig.baseline() for name, rig in rigs.items()}
    return factors, "baselines" if metric is None else "m", baseline


def _make_pyramid(camera: Camera, depth: float) -> FloatArray:
    """One stroke along all edges from the centre to the image's corners at this depth, shape (11, 3)."""
    right, lower = camera.image_size[0] - 0.5, camera.image_size[1] - 0.5
    edge = camera.normalize([[-0.5, -0.5], [right, -0.5], [right, lower], [-0.5, lower]])
    a, b, c, d = (depth * np.column_stack([edge, np.ones(4)]) - camera.translation) @ camera.rotation
    centre = camera.center
    return np.stack([centre, a, b, centre, c, b, c, d, centre, d, a])
