"""Structural geometry refinement of synchronised tracks (paper, section of that name, Algorithm 1)."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.core.datasets import STRUCTURE_AXES, check_tracks
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.refinement.model import Refinement, SgrSettings
from vfm_sdm.stages.refinement.solver import PointTriangulation, find_minimum

__all__ = ["refine"]

_MIN_FRAMES = 3
_CHUNK = 32768
"""Samples that are refined at a time: their intermediate arrays stay in the processor's cache."""


def refine(
    tracks: xr.Dataset,
    rig: Rig,
    frame: StructureFrame,
    *,
    settings: SgrSettings | None = None,
    still_interval_s: tuple[float, float] | None = None,
) -> Refinement:
    """Tracks whose poorer view is corrected so that hardly any motion along the suppressed axis remains.

    Parameters
    ----------
    tracks
        Tracks of two views on one clock, in the order of the rig's cameras, dims ``view, time, point, pixel``, shape
        (2, T, P, 2) [px].
    rig
        The two cameras; they stay fixed.
    frame
        The structure's axes in the reference camera's frame.
    settings
        Weights, suppressed axis and choice of the view; the paper's by default.
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin of displacement; without it, the first valid
        sample is the origin.

    Raises
    ------
    DatasetError
        The tracks are not synchronised, have other than two views or others than the rig's, the uncertain view is
        none of them, or no frame lies in the still interval.

    Notes
    -----
    The objective is the paper's (section Structural geometry refinement, weights in section SGR optimization
    settings); each term is divided by its scale in the baseline triangulation (`make_objective`). Only neighbouring
    frames of a point are coupled, so a Gauss-Newton step is one tridiagonal solve for all points. A step that raises
    a point's objective is halved. A missing sample splits the series: no difference is taken over it.

    Limits: true motion along the suppressed axis is removed as noise is, and moves the point along the reference
    view's ray, so part of it appears along the other axes (`Refinement.gain`); true motion along the others passes.
    Because every term has its own scale, the correction is strong where motion along the other axes stands out of the
    noise, and weaker where all that is seen is noise (a share of 0.4 for a point at rest). A few gross errors raise the
    scale of the suppressed axis and weaken the correction of the whole series; mark them as missing before.

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, -4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> time_s = np.arange(300) / 30
    >>> points3d = [1.0, 0.0, 25.0] + 5e-3 * np.sin(12 * time_s)[:, None] * [0.3, 1.0, 0.0]
    >>> noise = np.random.default_rng(0).normal(0, 0.02, (300, 1, 2))
    >>> views = []
    >>> for camera, error, std in ((left, 0.0, 0.005), (right, noise, 0.02)):
    ...     covariance = np.tile(std**2 * np.eye(2), (300, 1, 1, 1))
    ...     seen = camera.project(points3d)[:, None] + error
    ...     views.append(make_tracks(time_s, ["mid"], seen, covariance, np.zeros((300, 1)), attrs={}))
    >>> tracks = xr.concat(views, "view").assign_coords(view=["left", "right"])
    >>> refinement = refine(tracks, rig, StructureFrame(np.eye(3)))
    >>> refinement.status, refinement.uncertain_view
    (('ok',), ('right',))
    """
    chosen = settings or SgrSettings()
    names = _check_views(tracks, rig)
    pixels = tracks.variables["position"].values
    frames, points = pixels.shape[1:3]
    still = _find_still_frames(tracks.variables["time"].values, still_interval_s)
    view, status = _choose_views(
        _compute_median_std(tracks.variables["position_covariance"].values[..., 0, 0]), names, chosen
    )
    result = _Result(
        correction=np.where(np.isfinite(pixels).all(axis=(0, 3)), 0.0, np.nan),
        status=status,
        cost=np.full(points, np.nan),
        iterations=np.zeros(points, dtype=np.int64),
        share=np.full(points, np.nan),
        gain=np.full((points, 3, 3), np.nan),
    )
    for index in range(2):
        members = np.flatnonzero((view == index) & (status == "ok"))
        count = max(1, _CHUNK // frames)
        for start in range(0, len(members), count):
            _refine_points(pixels, rig, frame, members[start : start + count], index, still, chosen, result)
    return Refinement(
        _correct_tracks(tracks, result.correction, np.where(status == "ok", view, -1), names, chosen),
        result.correction,
        tuple(names[index] if index >= 0 else None for index in view),
        tuple(str(text) for text in result.status),
        result.cost,
        result.iterations,
        result.share,
        result.gain,
    )


@dataclass(eq=False)
class _Result:
    """The arrays of a `Refinement`, filled part by part."""

    correction: FloatArray
    status: np.ndarray[Any, Any]
    cost: FloatArray
    iterations: IntArray
    share: FloatArray
    gain: FloatArray


def _check_views(tracks: xr.Dataset, rig: Rig) -> tuple[str, str]:
    check_tracks(tracks, synchronized=True)
    names = tuple(str(name) for name in tracks["view"].values)
    if len(names) != 2 or len(rig) != 2:
        raise DatasetError(
            f"refinement: expected tracks and cameras of two views, got {len(names)} and {len(rig)}; select the pair"
        )
    if names != rig.names:
        raise DatasetError(f"tracks: expected views {list(rig.names)}, got {list(names)}; select and order them")
    return names[0], names[1]


def _find_still_frames(time_s: FloatArray, still_interval_s: tuple[float, float] | None) -> BoolArray | None:
    """Frames of the still interval, shape (T,); ``None`` without one."""
    if still_interval_s is None:
        return None
    still = (time_s >= still_interval_s[0]) & (time_s <= still_interval_s[1])
    if not still.any():
        raise DatasetError(
            f"still interval: expected frames between {still_interval_s[0]} and {still_interval_s[1]} s, got a "
            f"recording from {time_s[0]:.3f} to {time_s[-1]:.3f} s; correct method.still_interval_s"
        )
    return np.asarray(still)


def _compute_median_std(variance: FloatArray) -> FloatArray:
    """Standard deviation of the median variance over the frames that state one, (V, T, P) to (V, P).

    NaN where none does. A tracker's reference frame states none: the point is there by definition.
    """
    stated = np.sort(np.where(variance > 0, variance, np.nan), axis=1)  # NaN last
    count = np.isfinite(stated).sum(axis=1, keepdims=True)
    middle = [np.take_along_axis(stated, np.maximum(index, 0), axis=1) for index in ((count - 1) // 2, count // 2)]
    return np.asarray(np.sqrt((middle[0] + middle[1]) / 2)[:, 0])


def _choose_views(
    std: FloatArray, names: tuple[str, str], settings: SgrSettings
) -> tuple[IntArray, np.ndarray[Any, Any]]:
    """Index of the uncertain view and status of each point from the standard deviations (V, P) [px]."""
    wanted = settings.uncertain_view
    poor = np.asarray((std > settings.poor_std_px).all(axis=0))
    if wanted == "auto":
        unknown = np.isnan(std).any(axis=0)
        # Equal views: the second, as in the paper.
        view = np.where(poor | unknown, -1, np.where(std[1] >= std[0], 1, 0))
        return view, np.select([unknown, poor], ["uncertainty unknown", "both views poor"], "ok").astype(object)
    if wanted not in (*names, 0, 1):
        raise DatasetError(f"uncertain view: expected 'auto', 0, 1 or one of {list(names)}, got {wanted!r}; correct it")
    index = names.index(wanted) if isinstance(wanted, str) else wanted
    return np.where(poor, -1, index), np.where(poor, "both views poor", "ok").astype(object)


def _refine_points(
    pixels: FloatArray,
    rig: Rig,
    frame: StructureFrame,
    members: IntArray,
    view: int,
    still: BoolArray | None,
    settings: SgrSettings,
    result: _Result,
) -> None:
    """Refines some points with the same uncertain view and enters the outcome into the result."""
    suppressed = STRUCTURE_AXES.index(settings.suppressed_axis)
    order = [suppressed, *(axis for axis in range(3) if axis != suppressed)]
    axes = frame.rotation[order]
    triangulation = PointTriangulation(pixels[:, :, members], rig, axes, view)
    position, slope = triangulation(np.zeros(triangulation.shape))
    valid = np.asarray((np.isfinite(position) & np.isfinite(slope)).all(axis=0))
    origin = valid & (np.cumsum(valid, axis=1) == 1 if still is None else still)
    few, moving = valid.sum(axis=1) < _MIN_FRAMES, ~origin.any(axis=1)
    result.status[members[moving]] = "no still frames"
    result.status[members[few]] = "too few frames"
    usable = ~(few | moving)
    if not usable.any():
        return
    if not usable.all():
        members, valid, origin = members[usable], valid[usable], origin[usable]
        position, slope = position[:, usable], slope[:, usable]
        triangulation = PointTriangulation(pixels[:, :, members], rig, axes, view)
    minimum = find_minimum(
        triangulation,
        position,
        slope,
        valid=valid,
        origin=origin,
        weights=settings.weights,
        max_iterations=settings.max_iterations,
    )
    result.iterations[members] = minimum.iterations
    result.status[members[~minimum.converged]] = "not converged"
    done = minimum.converged
    points = members[done]
    result.correction[:, points] = np.where(valid, minimum.correction, np.nan)[done].T
    result.cost[points] = minimum.cost[done]
    result.share[points] = minimum.direction[done, 0]
    gain = np.tile(np.eye(3), (len(points), 1, 1))
    gain[:, order, suppressed] -= minimum.direction[done]
    result.gain[points] = gain


def _correct_tracks(
    tracks: xr.Dataset, correction: FloatArray, view: IntArray, names: tuple[str, str], settings: SgrSettings
) -> xr.Dataset:
    position = tracks.variables["position"].values.copy()
    for index in range(2):
        chosen = np.flatnonzero(view == index)
        added = correction[:, chosen]
        # A missing sample keeps what the tracker wrote into it.
        position[index, :, chosen, 0] += np.where(np.isnan(added), 0.0, added).T
    refined = tracks.copy()
    refined.variables["position"].data = position
    weights = asdict(settings.weights)
    refined.attrs |= {
        "refinement": "structural geometry refinement",
        "refined_view": ", ".join(names[index] for index in range(2) if (view == index).any()),
        "refinement_suppressed_axis": settings.suppressed_axis,
        "refinement_weights": ", ".join(f"{name} = {value:g}" for name, value in weights.items()),
    }
    return refined
