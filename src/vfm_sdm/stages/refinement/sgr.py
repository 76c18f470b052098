"""Structural geometry refinement of synchronised tracks (paper, section of that name, Algorithm 1)."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, mean_of_known
from vfm_sdm.core.covariances import find_edges
from vfm_sdm.core.datasets import STRUCTURE_AXES, check_tracks
from vfm_sdm.core.statuses import RefinementStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import triangulation_jacobian
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.visibility import Sightings, typical_std
from vfm_sdm.signals.clocks import still_frames
from vfm_sdm.stages.refinement.model import Refinement, SgrSettings
from vfm_sdm.stages.refinement.objective import Baseline
from vfm_sdm.stages.refinement.sightings import see_tracks
from vfm_sdm.stages.refinement.solver import PointTriangulation, find_minimum

__all__ = ["refine"]

_MIN_FRAMES = 3
_CHUNK = 32768
"""Samples that are refined at a time: their intermediate arrays stay in the processor's cache."""


def refine(
    tracks: xr.Dataset,
    rig: Rig,
    frame: StructureFrame | None,
    *,
    settings: SgrSettings | None = None,
    still_interval_s: tuple[float, float] | None = None,
) -> Refinement:
    """Tracks whose poorer view is corrected so that hardly any motion along the suppressed axis remains.

    Parameters
    ----------
    tracks
        Tracks with a dim ``view`` of two views or more, in the order of the rig's cameras, on one clock; with
        ``origin`` (point, axis) [m] where an earlier part of the recording told the positions that displacement is
        relative to.
    rig
        Their cameras; they stay fixed.
    frame
        The structure's axes in the reference camera's frame; without them there is no axis to suppress.
    settings
        Weights, suppressed axis and choice of the view; the paper's by default.
    still_interval_s
        Beginning and end [s] of the interval whose mean is the origin of displacement; without it, the first valid
        sample is the origin.

    Raises
    ------
    DatasetError
        There are no axes, the tracks are not synchronised, have a single view or others than the rig's, the uncertain
        view is none of them, or no frame lies in the still interval.

    Notes
    -----
    The objective is the paper's (section Structural geometry refinement, weights in section SGR optimization
    settings); each term is divided by its scale in the baseline triangulation (`make_objective`). Only neighbouring
    frames of a point are coupled, so a Gauss-Newton step is one tridiagonal solve for all points. A step that raises
    a point's objective is halved. A missing sample splits the series: no difference is taken over it.

    Of more than two views, each point has one whose u is corrected, and all that see a sample triangulate it, weighed
    as in the displacement that is made of the tracks (`vfm_sdm.geometry.visibility`). With two views that is the
    paper's pair; samples that the corrected view does not see stay as the others give them.

    A point that a view sees across an edge only stays as it is.

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
    if frame is None:
        raise DatasetError(
            "refinement: expected the structure's axes, got none; measure perpendicular_distance and "
            'longitudinal_distance, or set method.refinement = "none"'
        )
    chosen = settings or SgrSettings()
    names = _check_views(tracks, rig)
    time_s = tracks.variables["time"].values
    still = None if still_interval_s is None else still_frames(time_s, still_interval_s)
    covariance = tracks.variables["position_covariance"].values
    sight = see_tracks(tracks, rig)
    origin = tracks["origin"].transpose("point", "axis").values if "origin" in tracks else None
    task = _Task(sight, rig, frame, still, chosen, origin)
    view, status = _choose_views(covariance, names, task)
    edge = find_edges(tracks)
    view, status = np.where(edge, -1, view), np.where(edge, RefinementStatus.EDGE, status)
    result = _empty_result(sight, status)
    for index, members in _portions(view, status, len(time_s)):
        _refine_points(task, members, index, result)
    refined = np.where(status == RefinementStatus.OK, view, -1)
    return Refinement(
        _corrected_tracks(tracks, result.correction, refined, chosen),
        result.correction,
        tuple(names[index] if index >= 0 else None for index in view),
        tuple(_reference_views(sight, names, point, index) for point, index in enumerate(view)),
        tuple(str(text) for text in result.status),
        result.cost,
        result.iterations,
        result.share,
        result.gain,
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """What all points share: their pixels, the cameras and axes, the frames at rest (T,) or ``None``, the settings.

    ``origin`` (P, 3) [m] is where displacement is relative to, along the axes, where an earlier part told it.
    """

    sight: Sightings
    rig: Rig
    frame: StructureFrame
    still: BoolArray | None
    settings: SgrSettings
    origin: FloatArray | None = None

    @property
    def order(self) -> list[int]:
        """Indices of the structural axes, the suppressed one first."""
        suppressed = STRUCTURE_AXES.index(self.settings.suppressed_axis)
        return [suppressed, *(axis for axis in range(3) if axis != suppressed)]


@dataclass(eq=False)
class _Result:
    """The arrays of a `Refinement`, filled part by part."""

    correction: FloatArray
    status: np.ndarray[Any, Any]
    cost: FloatArray
    iterations: IntArray
    share: FloatArray
    gain: FloatArray


def _empty_result(sight: Sightings, status: np.ndarray[Any, Any]) -> _Result:
    """Of points that were not refined."""
    points = len(status)
    return _Result(
        correction=np.where(sight.visibility.of_sample >= 0, 0.0, np.nan),
        status=status,
        cost=np.full(points, np.nan),
        iterations=np.zeros(points, dtype=np.int64),
        share=np.full(points, np.nan),
        gain=np.full((points, 3, 3), np.nan),
    )


def _check_views(tracks: xr.Dataset, rig: Rig) -> tuple[str, ...]:
    check_tracks(tracks, synchronized=True)
    names = tuple(str(name) for name in tracks["view"].values)
    if len(names) < 2 or len(rig) < 2:
        raise DatasetError(
            f"refinement: expected tracks and cameras of at least two views, got {len(names)} and {len(rig)}; add a "
            "view, or do without refinement"
        )
    if names != rig.names:
        raise DatasetError(f"tracks: expected views {list(rig.names)}, got {list(names)}; select and order them")
    return names


def _choose_views(covariance: FloatArray, names: tuple[str, ...], task: _Task) -> tuple[IntArray, np.ndarray[Any, Any]]:
    """Index of the uncertain view and status of each point from the tracks' covariances (V, T, P, 2, 2) [px2]."""
    std, wanted = typical_std(covariance[..., 0, 0]), task.settings.uncertain_view
    known = np.isfinite(std)
    # Of more than two views, one that does not see a point cannot serve it.
    poor = np.asarray(((std > task.settings.poor_std_px) | (~known & (len(std) > 2))).all(axis=0))
    if wanted == "auto":
        unknown = known.sum(axis=0) < 2
        worth = std if len(std) == 2 else -_expected_error(covariance, std, task)
        # Equal views: the last, as in the paper.
        view = len(std) - 1 - np.where(known, worth, -np.inf)[::-1].argmax(axis=0)
        status = np.select([unknown, poor], [RefinementStatus.UNKNOWN, RefinementStatus.BOTH_POOR], RefinementStatus.OK)
        return np.where(poor | unknown, -1, view), status.astype(object)
    indices = list(range(len(names)))
    if wanted not in (*names, *indices):
        raise DatasetError(
            f"uncertain view: expected 'auto', {', '.join(map(str, indices))} or one of {list(names)}, got {wanted!r}; "
            "correct it"
        )
    index = names.index(wanted) if isinstance(wanted, str) else wanted
    status = np.where(poor, RefinementStatus.BOTH_POOR, RefinementStatus.OK).astype(object)
    return np.where(poor, -1, index), status


def _expected_error(covariance: FloatArray, std_u: FloatArray, task: _Task) -> FloatArray:
    """Variance along the other axes once u of a view is corrected until nothing moves along the suppressed one, (V, P).

    From the covariances (V, T, P, 2, 2) [px2] and the standard deviation of u (V, P) [px]. A correction moves a point
    along ``g = dX/du``; it takes along the noise n, of which ``n - n_z g / g_z`` is left, and true motion along the
    suppressed axis, of which ``g / g_z`` is left elsewhere: as much as the series varies beyond its noise, or might in
    so many frames. Infinite for a view that cannot correct.
    """
    sight, axes = task.sight, task.frame.rotation[task.order]
    seen = sight.visibility.of_sample >= 0
    jacobian = triangulation_jacobian(sight.anchor(seen), task.rig, weights=sight.weights)
    jacobian = np.nan_to_num(np.einsum("ai,pivk->pavk", axes, jacobian))
    variance = np.nan_to_num(np.stack([std_u, typical_std(covariance[..., 1, 1])], axis=-1) ** 2)
    noise = np.einsum("pavk,vpk,pbvk->pab", jacobian, variance, jacobian)
    series = np.where(seen, sight.triangulate(task.rig) @ axes[0], np.nan)
    varies = mean_of_known((series - mean_of_known(series)) ** 2)
    doubt = np.sqrt(2 / np.maximum(seen.sum(axis=0), 1))
    motion = np.fmax(varies - noise[:, 0, 0], doubt * noise[:, 0, 0])
    expected = np.full(variance.shape[:2], np.inf)
    for view in range(len(expected)):
        along = jacobian[:, :, view, 0]
        able = np.abs(along[:, 0]) > 0
        left = np.tile(np.eye(3), (len(along), 1, 1))
        left[able, :, 0] -= along[able] / along[able, :1]
        of_noise = np.einsum("pab,pbc,pac->pa", left, noise, left)[:, 1:].sum(axis=1)
        of_motion = np.sum(left[:, 1:, 0] ** 2, axis=1) * motion
        expected[view] = np.where(able, of_noise + of_motion, np.inf)
    return expected


def _portions(view: IntArray, status: np.ndarray[Any, Any], frames: int) -> Iterator[tuple[int, IntArray]]:
    """Points that are refined together: the index of their view, and their own."""
    count = max(1, _CHUNK // frames)
    chosen = status == RefinementStatus.OK
    for index in np.unique(view[chosen]).tolist():
        members = np.flatnonzero((view == index) & chosen)
        for start in range(0, len(members), count):
            yield index, members[start : start + count]


def _reference_views(sight: Sightings, names: tuple[str, ...], point: int, view: int) -> tuple[str, ...]:
    """Views beside the refined one that see a point with it."""
    if view < 0:
        return ()
    if len(names) == 2:
        return (names[1 - view],)
    used = sight.used[:, :, point]
    shared = (used & used[view]).any(axis=1)
    return tuple(name for number, name in enumerate(names) if number != view and shared[number])


def _refine_points(task: _Task, members: IntArray, view: int, result: _Result) -> None:
    """Refine some points with the same uncertain view and write what came out into the result."""
    axes, sight = task.frame.rotation[task.order], task.sight

    def triangulation_of(points: IntArray) -> PointTriangulation:
        weights = None if sight.weights is None else sight.weights[:, points]
        return PointTriangulation(sight.pixels[:, :, points], task.rig, axes, view, weights)

    triangulation = triangulation_of(members)
    position, slope = triangulation(np.zeros(triangulation.shape))
    valid = np.asarray((np.isfinite(position) & np.isfinite(slope)).all(axis=0))
    reference = valid & (np.cumsum(valid, axis=1) == 1 if task.still is None else task.still)
    known = np.full((3, len(members)), np.nan) if task.origin is None else task.origin[members][:, task.order].T
    few, moving = valid.sum(axis=1) < _MIN_FRAMES, ~(reference.any(axis=1) | np.isfinite(known).all(axis=0))
    result.status[members[moving]] = RefinementStatus.NO_STILL_FRAMES
    result.status[members[few]] = RefinementStatus.TOO_FEW_FRAMES
    usable = ~(few | moving)
    if not usable.any():
        return
    baseline = Baseline(position, slope, valid, reference, known)
    if not usable.all():
        members, baseline = members[usable], baseline.of(usable)
        triangulation = triangulation_of(members)
    settings = task.settings
    minimum = find_minimum(triangulation, baseline, settings.weights, max_iterations=settings.max_iterations)
    result.iterations[members] = minimum.iterations
    result.status[members[~minimum.converged]] = RefinementStatus.NOT_CONVERGED
    done = minimum.converged
    points = members[done]
    result.correction[:, points] = np.where(baseline.valid, minimum.correction, np.nan)[done].T
    result.cost[points] = minimum.cost[done]
    result.share[points] = minimum.direction[done, 0]
    gain = np.tile(np.eye(3), (len(points), 1, 1))
    gain[:, task.order, task.order[0]] -= minimum.direction[done]
    result.gain[points] = gain


def _corrected_tracks(tracks: xr.Dataset, correction: FloatArray, view: IntArray, settings: SgrSettings) -> xr.Dataset:
    position = tracks.variables["position"].values.copy()
    names = [str(name) for name in tracks["view"].values]
    for index in range(len(names)):
        chosen = np.flatnonzero(view == index)
        added = correction[:, chosen]
        # A missing sample keeps what the tracker wrote into it.
        position[index, :, chosen, 0] += np.where(np.isnan(added), 0.0, added).T
    refined = tracks.copy()
    refined.variables["position"].data = position
    weights = asdict(settings.weights)
    refined.attrs |= {
        "refinement": "structural geometry refinement",
        "refined_view": ", ".join(names[index] for index in range(len(names)) if (view == index).any()),
        "refinement_suppressed_axis": settings.suppressed_axis,
        "refinement_weights": ", ".join(f"{name} = {value:g}" for name, value in weights.items()),
    }
    if len(names) > 2:
        of_point = np.array([names[index] if index >= 0 else "" for index in view], dtype=object)
        refined = refined.assign(refined_view=("point", of_point))
    return refined
