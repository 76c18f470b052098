"""Cameras that move far, as from a drone or a hand: every point mapped back to the camera at rest, exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, mean_of_known, time_blocks
from vfm_sdm.geometry.distortion import distort_derivative
from vfm_sdm.stages.camera_motion.estimation import jacobian_in_camera, replace_doubtful
from vfm_sdm.stages.camera_motion.places import LENS, Places, compute_place_slopes, refine_places
from vfm_sdm.stages.camera_motion.poses import FEWEST_STATIC, Poses, StaticView, find_poses, look_from

__all__ = ["LINEAR_ERROR_PX", "FarMotion", "Mapped", "find_far_motion", "map_back", "moves_far"]

LINEAR_ERROR_PX = 0.05
"""What the linear model of small shifts may leave, ``shift^2 / (2 f)`` [px]; beyond, the exact one is used."""
_MOST_LINEAR_PX = 0.5
"""The same where fewer than three static points are there, which poses need [px]."""
_MOST = 0.95
"""Share of the frames that must shift less."""
_ROUNDS = 3
_REFINED_FROM = 2000
"""Frames at most that refine lens and places: a hundred times as many as there are numbers to refine."""
_LEAST_STD_PX = 1e-3
_FEWEST_SPARE = 10
DETERMINED_PX = 0.5
"""Standard deviation of a point's shift above which static points do not determine the pose for it [px]."""


@dataclass(frozen=True, eq=False)
class FarMotion:
    """Motion of a camera that moves far.

    Parameters
    ----------
    poses
        Of the camera in T frames, by all S static points.
    poses_without
        Without each of them, S of them.
    places
        The lens and the points.
    static
        Numbers of the static points among the P points.
    view
        Their pixels and weights.
    noise_factor
        Variance of the static points about the poses over their stated one [1].
    """

    poses: Poses
    poses_without: tuple[Poses, ...]
    places: Places
    static: tuple[int, ...]
    view: StaticView
    noise_factor: float


def moves_far(position: FloatArray, rest: FloatArray, focal_px: float) -> bool:
    """Whether a camera moves further than the linear model of small shifts holds.

    Parameters
    ----------
    position
        Pixels of S static points, shape (T, S, 2) [px]; NaN where missing.
    rest
        Their pixels in the reference frame, shape (S, 2) [px].
    focal_px
        Focal length [px].

    Notes
    -----
    Judged by the error of the linear model, 0.05 px; of one or two points, which show no pose, by 0.5 px.

    Examples
    --------
    >>> position = np.zeros((100, 3, 2))
    >>> position[:, :, 0] = np.linspace(0, 30, 100)[:, None]
    >>> moves_far(position, np.zeros((3, 2)), 3000.0), moves_far(position, np.zeros((3, 2)), 30000.0)
    (True, False)
    """
    shift = np.linalg.norm(position - rest, axis=-1)
    known = np.isfinite(shift)
    if not known.any():
        return False
    # A camera moves all points: the lower of the middle ones, so that one that slips decides nothing.
    usual = np.sort(np.where(known, shift, np.inf), axis=1)
    frames = np.flatnonzero(known.any(axis=1))
    middle = usual[frames, (known.sum(axis=1)[frames] - 1) // 2]
    error_px = float(np.quantile(middle, _MOST)) ** 2 / (2 * focal_px)
    return error_px > (LINEAR_ERROR_PX if known.any(axis=0).sum() >= FEWEST_STATIC else _MOST_LINEAR_PX)


def find_far_motion(position: FloatArray, covariance: FloatArray, static: Sequence[int], prior: Places) -> FarMotion:
    """Pose of a camera a frame, and its lens and points as its motion shows them.

    Parameters
    ----------
    position, covariance
        Of S static points, shapes (T, S, 2) [px] and (T, S, 2, 2) [px2]; NaN where missing.
    static
        Their numbers among the P points.
    prior
        Lens and points as the rig knows them.

    Notes
    -----
    Poses of all frames, the lens and the places of the static points are adjusted together (bundle adjustment); the
    poses are eliminated frame by frame, so that what is left is small. The rig's own knowledge is the prior.
    """
    numbers = list(static)
    doubted = replace_doubtful(covariance, position)
    seen = np.asarray(np.isfinite(position).all(axis=-1))
    # A point that is never seen for certain states nothing.
    stated = np.where(seen[..., None, None], doubted, np.eye(2)) + _LEAST_STD_PX**2 * np.eye(2)
    weight = np.asarray(np.linalg.inv(stated))
    places, factor = prior, 1.0
    some = np.unique(np.linspace(0, len(position) - 1, min(len(position), _REFINED_FROM)).round().astype(np.int64))
    poses = None
    for _ in range(_ROUNDS):
        view = StaticView(places.camera, places.X[numbers], position[some], weight[some] / factor)
        poses = find_poses(view, poses)
        factor *= _noise_factor(view, poses)
        view = replace(view, weight=weight[some] / factor)
        poses = find_poses(view, poses)
        places = refine_places(places, numbers, view, poses, prior)
    whole = StaticView(places.camera, places.X[numbers], position, weight / factor)
    poses = _in_blocks(whole)
    without = tuple(
        _in_blocks(whole.without(number), poses) if len(numbers) > FEWEST_STATIC else Poses.at_rest(len(position))
        for number in range(len(numbers))
    )
    return FarMotion(poses, without, places, tuple(numbers), whole, factor)


def _in_blocks(view: StaticView, start: Poses | None = None) -> Poses:
    """Poses of a recording of any length."""
    blocks = list(time_blocks(len(view.position)))
    found = [find_poses(view.of(block), None if start is None else start.of(block)) for block in blocks]
    return Poses.joined(found)


def _noise_factor(view: StaticView, poses: Poses) -> float:
    """Variance of static points about the poses over what their weights say [1]; 1 where nothing tells."""
    residual = view.position - look_from(view.camera, poses.moved(view.X))
    used = np.asarray(np.isfinite(residual).all(axis=-1)) & poses.found[:, None]
    residual = np.where(used[..., None], residual, 0.0)
    spare = int(2 * used.sum() - 6 * poses.found.sum())
    if spare < _FEWEST_SPARE:
        return 1.0
    return float(np.einsum("tpi,tpij,tpj->", residual, np.nan_to_num(view.weight), residual)) / spare


@dataclass(frozen=True, eq=False)
class Mapped:
    """Points as the camera at rest would have seen them.

    Parameters
    ----------
    position
        Shape (T, P, 2) [px].
    covariance
        Shape (T, P, 2, 2) [px2]: of the pixels as tracked, turned to the camera at rest, and of the motion.
    added
        The part of the motion, shape (T, P, 2, 2) [px2].
    depth_slope
        Change of the position with what a point moves itself, in the world frame, because that changes its depth,
        shape (T, P, 2, 3) [px/m]; zero for static points.
    """

    position: FloatArray
    covariance: FloatArray
    added: FloatArray
    depth_slope: FloatArray

    @classmethod
    def joined(cls, parts: Sequence["Mapped"]) -> "Mapped":
        """Those of parts of a recording that follow each other."""
        names = [one.name for one in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def map_back(position: FloatArray, covariance: FloatArray, motion: FarMotion, rows: slice) -> Mapped:
    """Pixels of all points mapped back to the camera at rest: along their rays, to their own depths, and seen again.

    Parameters
    ----------
    position, covariance
        Of all P points in the frames of ``rows``, shapes (T, P, 2) [px] and (T, P, 2, 2) [px2].
    motion
        Of the camera.
    rows
        Which frames.

    Notes
    -----
    A static point is mapped by the pose that the others give. A point's depth is that of its place at rest, seen from
    the moved camera; what it moves along the ray beside that follows when both views are known
    (`vfm_sdm.stages.camera_motion.depths.follow_depths`). The covariance holds, beside the pixel's
    own, that of the pose (noise of the static points) and that of lens and places.
    """
    poses = motion.poses.of(rows)
    mapped = _map(position, covariance, motion, poses, motion.view.of(rows))
    for number, index in enumerate(motion.static):
        one = _map(
            position[:, [index]],
            covariance[:, [index]],
            replace(motion, static=tuple(np.delete(motion.static, number).tolist())),
            motion.poses_without[number].of(rows),
            motion.view.of(rows).without(number),
            [index],
        )
        for name in ("position", "covariance", "added"):
            getattr(mapped, name)[:, index] = getattr(one, name)[:, 0]
        mapped.depth_slope[:, index] = 0.0
    return mapped


def _map(
    position: FloatArray,
    covariance: FloatArray,
    motion: FarMotion,
    poses: Poses,
    view: StaticView,
    points: list[int] | None = None,
) -> Mapped:
    """Some points (all by default) mapped back by poses that some static points gave."""
    places = motion.places
    camera, indices = places.camera, list(range(len(places.X))) if points is None else points
    X = places.X[indices]
    moved = poses.moved(X)
    depth = moved[..., 2]
    normalized = camera.normalize(position)
    ray = np.concatenate([normalized, np.ones((*normalized.shape[:-1], 1))], axis=-1)
    at_rest = np.einsum("tji,tpj->tpi", poses.rotation, depth[..., None] * ray - poses.translation[:, None])
    known = poses.found[:, None] & (depth > 0)
    found = np.where(known[..., None], look_from(camera, at_rest), np.nan)
    # From the moved picture to that at rest, at a fixed depth.
    seen_again = jacobian_in_camera(camera, at_rest)[..., 3:] @ np.swapaxes(poses.rotation, 1, 2)[:, None]
    lens = camera.K[:2, :2] @ distort_derivative(normalized, camera.distortion)
    turn = seen_again[..., :2] * depth[..., None, None] @ np.linalg.inv(lens)
    own = turn @ covariance @ np.swapaxes(turn, -1, -2)
    jacobian = jacobian_in_camera(camera, moved)
    by_pose = turn @ jacobian
    added = np.einsum("tpia,tab,tpjb->tpij", by_pose, poses.covariance, by_pose, optimize=True)
    added += _covariance_of_places(places, (poses, view, motion.static), X, (indices, turn, by_pose))
    by_depth = np.einsum("tpij,tpj->tpi", seen_again, ray)
    slope = by_depth[..., None] * (poses.rotation[:, 2] @ camera.rotation)[:, None, None]
    return Mapped(found, own + added, np.where(known[..., None, None], added, np.nan), np.nan_to_num(slope))


def _covariance_of_places(
    places: Places,
    given: tuple[Poses, StaticView, tuple[int, ...]],
    X: FloatArray,
    mapping: tuple[list[int], FloatArray, FloatArray],
) -> FloatArray:
    """What errors of lens and places do to points (P, 3) that are mapped back, shape (T, P, 2, 2) [px2].

    ``given`` are the poses and the static points that gave them, ``mapping`` the points' numbers, and how their pixels
    at rest change with the pixels and with the pose.
    """
    (poses, view, static), (indices, turn, by_pose) = given, mapping
    rows = places.chosen(list(static))
    of_static = _pose_by_places(places, poses, view)
    rest = _rest_of(view)
    lens_now, place_now = compute_place_slopes(places, poses, X)
    lens_rest, place_rest = compute_place_slopes(places, rest[0], X)
    of_rest = jacobian_in_camera(places.camera, X) @ _pose_by_places(places, rest[0], rest[1])
    found = np.empty((*turn.shape[:2], 2, 2))
    for number, index in enumerate(indices):
        own = LENS + 3 * index + np.arange(3)
        every = np.concatenate([rows, own])
        G = np.zeros((len(turn), 2, len(every)))
        # An error of the pose at rest is that of all frames: it shifts a series, and not its motion.
        G[..., : len(rows)] = by_pose[:, number] @ of_static - of_rest[number]
        G[..., :LENS] += lens_rest[:, number] - turn[:, number] @ lens_now[:, number]
        G[..., len(rows) :] = place_rest[:, number] - turn[:, number] @ place_now[:, number]
        found[:, number] = G @ places.covariance[np.ix_(every, every)] @ np.swapaxes(G, 1, 2)
    return found


def _rest_of(view: StaticView) -> tuple[Poses, StaticView]:
    """The camera at rest, which sees all static points as well as it mostly does."""
    seen = view.seen
    weight = mean_of_known(view.weight, seen[..., None, None])
    at_rest = replace(view, position=look_from(view.camera, view.X)[None], weight=np.nan_to_num(weight)[None])
    return find_poses(at_rest), at_rest


def _pose_by_places(places: Places, poses: Poses, view: StaticView) -> FloatArray:
    """How poses give way to errors of the lens and of the static points, shape (T, 6, 4 + 3 S), sign turned."""
    by_lens, by_place = compute_place_slopes(places, poses, view.X)
    used = np.where((view.seen & poses.found[:, None])[..., None, None], view.weight, 0.0)
    J = np.nan_to_num(jacobian_in_camera(places.camera, poses.moved(view.X)))
    pull = np.einsum("tab,tpib,tpij->tpaj", poses.covariance, J, used, optimize=True)
    of_lens = np.einsum("tpaj,tpjl->tal", pull, by_lens)
    return np.concatenate([of_lens, *np.moveaxis(pull @ by_place, 1, 0)], axis=-1)
