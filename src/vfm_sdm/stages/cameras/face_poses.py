"""Poses of a second camera that the structure's face proposes: every match on it votes.

Two narrow views of a structure hardly fix their relative pose, and what repeats along the structure agrees with many
epipolar geometries. The site knows more: where the face lies in the first camera's frame, and how far the second camera
stands. A single match on the face then leaves one number open, the direction of the baseline on the ground.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Readings
from vfm_sdm.stages.cameras.face_votes import Integers, count_votes
from vfm_sdm.stages.cameras.relative_pose import count_places, number_cells
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["TOLD_STD", "PoseOnFace", "propose_poses", "told_agree"]

_DIRECTIONS = 72
"""Directions of the baseline that are tried, 5 degrees apart: a turn by half of that moves a point on the face by less
than the tolerance, once the camera is turned back to the match."""
_VOTERS = 160
"""Matches that propose a pose each; all matches vote."""
_TOLERANCE = 5e-3
"""Tolerance of a vote across the epipolar line, over the image's longer side: what level and height of a camera set up
by eye leave."""
_FINE = 2e-3
"""The same once level and height are fitted."""
_VOTES, _FITTED = 4, 6
"""Matches from which poses are voted on, and from which one is fitted, as one of them may be wrong."""
_TOLD = 3
"""Places that somebody told on the face from which they propose a pose by themselves: six numbers for the five of a
pose on the ground."""
TOLD_STD = 4.0
"""Standard deviations within which a told place agrees with a pose."""
_LEVEL_STD = np.radians(1.5)
_HEIGHT_STD_M = 0.5
"""Roll and height of the second camera where nobody read them: tripods that are levelled by eye, on one ground."""
_STEEPEST = np.radians(60)
_SAME_POSE = np.radians(3)
_PROPOSALS = 3
_FITS = 12


@dataclass(frozen=True, eq=False)
class PoseOnFace:
    """A pose of the second camera and the matches on the face that agree.

    Parameters
    ----------
    camera
        The second camera with its pose in the first camera's frame [m].
    matches
        Matches that agree, all of them on the face.
    support
        Number of places in the images where they lie.
    """

    camera: Camera
    matches: Matches
    support: int


def propose_poses(
    matches: Matches, cameras: tuple[Camera, Camera], face: Face, baseline_m: float, readings: Readings
) -> list[PoseOnFace]:
    """Poses of the second camera, those that most matches on the face agree with first.

    Parameters
    ----------
    matches
        N matches of the two views, right and wrong ones; or, with a standard deviation, points that somebody named in
        both views, which are on the face and right [px].
    cameras
        Intrinsics and distortion of the two cameras.
    face
        The structure's face in the first camera's frame.
    baseline_m
        Distance of the two cameras [m].
    readings
        What was read at the second camera.

    Returns
    -------
    proposals
        At most three poses that differ by more than three degrees; none where no match meets the face.

    Notes
    -----
    For each of 72 directions of the baseline on the ground, every match proposes the yaw and pitch that project its
    point on the face to its second pixel, and all matches vote whether theirs comes there too, within the depth of the
    face and a tolerance. Places in the images are counted, not matches: features crowd where a pattern repeats. The
    best are then fitted by least squares with height and roll of the second camera free.
    """
    ground = _Ground.of(matches, cameras, face)
    if ground.usable.sum() < (_TOLD if matches.std_px else _VOTES):
        return []
    voters = np.flatnonzero(ground.usable)
    voters = voters[np.linspace(0, len(voters) - 1, min(len(voters), _VOTERS)).astype(int)]
    cells = number_cells(matches, cameras)
    tried, votes = [], []
    for centre in _list_centres(face, baseline_m, readings):
        poses = np.array(list(_turn_to(ground, centre, voters, readings)))
        if poses.size:
            votes.append(ground.count_votes(_rotations(poses), centre, ground.tolerance(_TOLERANCE), cells))
            tried.append(np.column_stack([poses, np.tile(centre, (len(poses), 1))]))
    if not tried:
        return []
    poses, support = np.concatenate(tried), np.concatenate(votes)
    return _choose_proposals(ground, (poses, support), matches, (cameras[1], baseline_m, readings))


def told_agree(camera: Camera, told: Matches, first: Camera, face: Face) -> BoolArray:
    """Which points that somebody named in both views come out there with a pose, shape (N,).

    Parameters
    ----------
    camera
        The second camera with its pose in the first camera's frame [m].
    told
        N points on the face [px].
    first
        Intrinsics and distortion of the first camera.
    face
        The structure's face in the first camera's frame.
    """
    ground = _Ground.of(told, (first, camera), face)
    rotation, centre = face.axes @ camera.rotation.T, face.axes @ camera.center
    return np.asarray(ground.agree(rotation[None], centre, ground.tolerance(_TOLERANCE))[0])


@dataclass(frozen=True, eq=False)
class _Ground:
    """Matches as points on the face, seen by the second camera.

    Parameters
    ----------
    near, far
        Points on the face and a standard deviation behind it, shape (N, 3) [m], along the structure's axes.
    rays
        Rays of the second pixels in the second camera's frame, shape (N, 3) [1].
    focal_px
        Focal length of the second camera [px].
    long_side_px
        Longer side of its image [px].
    face
        The face.
    std_px
        Standard deviation of second pixels that somebody pointed at [px]; 0 of features.
    """

    near: FloatArray
    far: FloatArray
    rays: FloatArray
    focal_px: float
    long_side_px: int
    face: Face
    std_px: float = 0.0

    @classmethod
    def of(cls, matches: Matches, cameras: tuple[Camera, Camera], face: Face) -> "_Ground":
        first, second = cameras
        rays = np.column_stack([second.normalize(matches.points_second), np.ones(len(matches))])
        near, far = (face.points(first, matches.points_first, beyond) for beyond in (0.0, face.std_m))
        return cls(near, far, rays, second.focal_px, max(second.image_size), face, matches.std_px)

    @property
    def usable(self) -> BoolArray:
        return np.asarray(np.isfinite(self.near).all(axis=1) & np.isfinite(self.rays).all(axis=1))

    def tolerance(self, share: float) -> float:
        """A tolerance over the longer side, or what pointing needs, where somebody pointed [1]."""
        return max(share, TOLD_STD * self.std_px / self.long_side_px)

    def errors(self, rotations: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Errors across and along the images of the lines of sight, and the length of a standard deviation along them.

        ``rotations``, shape (K, 3, 3), lead from the camera to the structure's axes; the results have shape (K, N)
        [px]; infinite behind the camera.
        """
        scale = self.focal_px
        ahead = (self.near - centre) @ rotations
        behind = (self.far - centre) @ rotations
        with np.errstate(invalid="ignore", divide="ignore"):
            place = np.where(ahead[..., 2:] > 0, ahead[..., :2] / ahead[..., 2:], np.inf)
            shift = behind[..., :2] / behind[..., 2:] - place
            length = np.linalg.norm(shift, axis=-1)
            unit = shift / np.maximum(length, 1e-12)[..., None]
            off = self.rays[:, :2] - place
            along = (off * unit).sum(axis=-1)
            across = off[..., 0] * unit[..., 1] - off[..., 1] * unit[..., 0]
        known = np.isfinite(along) & np.isfinite(across)
        return tuple(np.where(known, scale * value, np.inf) for value in (across, along, length))  # type: ignore[return-value]

    def agree(self, rotations: FloatArray, centre: FloatArray, tolerance: float) -> BoolArray:
        """Which matches come out where the second camera saw them, shape (K, N)."""
        across, along, length = self.errors(rotations, centre)
        limit = tolerance * self.long_side_px
        return np.asarray((np.abs(across) < limit) & (np.abs(along) < np.hypot(limit, 2 * np.minimum(length, 1e6))))

    def count_votes(
        self, rotations: FloatArray, centre: FloatArray, tolerance: float, cells: tuple[Integers, Integers]
    ) -> IntArray:
        """Places in the images, with these numbers of cells, where matches `agree`, shape (K,)."""
        places = np.zeros(len(rotations), np.int64)
        points = self.near - centre, self.far - centre, np.ascontiguousarray(self.rays[:, :2])
        count_votes(rotations, points, (self.focal_px, tolerance * self.long_side_px), cells, places)
        return places


def _list_centres(face: Face, baseline_m: float, readings: Readings) -> Iterator[FloatArray]:
    """Places of the second camera on a level circle about the first one, along the structure's axes [m]."""
    right = face.axes @ np.array([1.0, 0.0, 0.0])
    across = readings.perpendicular_distance
    for angle in np.linspace(-np.pi, np.pi, _DIRECTIONS, endpoint=False):
        centre = baseline_m * np.array([np.cos(angle), 0.0, np.sin(angle)])
        nearest = 0.02 * face.distance_m
        if centre[0] > face.distance_m - nearest:
            continue
        if readings.stands is not None and (centre @ right > 0) != (readings.stands == "right"):
            continue
        # A reading excludes what is farther off than it and the step to the next direction explain.
        step = baseline_m * 2 * np.pi / _DIRECTIONS
        if across is not None and abs(face.distance_m - centre[0] - across.value) > step + 3 * across.std:
            continue
        yield centre


def _turn_to(ground: _Ground, centre: FloatArray, voters: IntArray, readings: Readings) -> Iterator[FloatArray]:
    """Yaw, pitch and roll with which the second camera sees each voter's point where its match says, shape (3,)."""
    roll = 0.0 if readings.level is None else np.radians(readings.level.roll)
    cos, sin = np.cos(roll), np.sin(roll)
    sight = ground.near[voters] - centre
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    rays = ground.rays[voters] / np.linalg.norm(ground.rays[voters], axis=1, keepdims=True)
    x, y, z = cos * rays[:, 0] - sin * rays[:, 1], sin * rays[:, 0] + cos * rays[:, 1], rays[:, 2]
    reach = np.hypot(y, z)
    pitch = np.arccos(np.clip(sight[:, 1] / reach, -1, 1)) - np.arctan2(z, y)
    forward = y * np.sin(pitch) + z * np.cos(pitch)
    flip = forward < 0
    pitch = np.where(flip, -np.arccos(np.clip(sight[:, 1] / reach, -1, 1)) - np.arctan2(z, y), pitch)
    forward = np.where(flip, y * np.sin(pitch) + z * np.cos(pitch), forward)
    yaw = np.arctan2(sight[:, 0], sight[:, 2]) - np.arctan2(x, forward)
    pitch = (pitch + np.pi) % (2 * np.pi) - np.pi
    possible = (np.abs(sight[:, 1]) < reach) & (np.abs(pitch) < _STEEPEST)
    if readings.level is not None:
        slack = 3 * np.radians(readings.level.std_deg) + _TOLERANCE * ground.long_side_px / ground.focal_px
        possible &= np.abs(pitch - np.radians(readings.level.pitch)) < slack
    yield from np.column_stack([yaw, pitch, np.full(len(yaw), roll)])[possible]


def _rotations(poses: FloatArray) -> FloatArray:
    """Rotations from the camera to the structure's axes, of yaw, pitch and roll, shape (K, 3, 3)."""
    return np.asarray(Rotation.from_euler("YXZ", np.atleast_2d(poses)[:, :3]).as_matrix())


def _choose_proposals(
    ground: "_Ground", voted: tuple[FloatArray, IntArray], matches: Matches, known: tuple[Camera, float, Readings]
) -> list[PoseOnFace]:
    """The poses with most votes that differ from each other once they are fitted."""
    poses, support = voted
    turns = Rotation.from_matrix(_rotations(poses))
    left = np.ones(len(poses), dtype=np.bool_)
    proposals: list[PoseOnFace] = []
    fitted: list[Rotation] = []
    for _ in range(_FITS):
        if not left.any() or len(proposals) == _PROPOSALS:
            break
        start = int(np.where(left, support, -1).argmax())
        proposal = _fit(ground, poses[start], matches, known)
        turn = Rotation.from_matrix(ground.face.axes @ proposal.camera.rotation.T)
        if all((turn * other.inv()).magnitude() > _SAME_POSE for other in fitted):
            proposals.append(proposal)
        fitted.append(turn)
        # The neighbours of a start end where it ended.
        for one in (turn, turns[start]):
            left &= (turns * one.inv()).magnitude() > _SAME_POSE
    return sorted(proposals, key=lambda one: -one.support)


def _fit(ground: _Ground, pose: FloatArray, matches: Matches, known: tuple[Camera, float, Readings]) -> PoseOnFace:
    """The pose fitted to the matches that agree with it, with roll, height and direction of the baseline free."""
    camera, baseline_m, readings = known
    level, std = (0.0, _LEVEL_STD)
    if readings.level is not None:
        level, std = np.radians([readings.level.roll, readings.level.std_deg])

    def centre_of(p: FloatArray) -> FloatArray:
        return np.array([baseline_m * np.cos(p[3]), p[4] * _HEIGHT_STD_M, baseline_m * np.sin(p[3])])

    parameters = np.array([*pose[:3], np.arctan2(pose[5], pose[3]), 0.0])
    for share in (_TOLERANCE, _TOLERANCE, _FINE, _FINE):
        chosen = ground.agree(_rotations(parameters), centre_of(parameters), ground.tolerance(share))[0]
        if chosen.sum() < (_TOLD if ground.std_px else _FITTED):
            break
        part = replace(ground, near=ground.near[chosen], far=ground.far[chosen], rays=ground.rays[chosen])

        def residuals(p: FloatArray, part: _Ground = part) -> FloatArray:
            across, along, length = part.errors(_rotations(p), centre_of(p))
            noise = part.std_px or _FINE / 3 * part.long_side_px
            with np.errstate(invalid="ignore"):  # behind the camera both are infinite
                depth = along[0] / np.hypot(noise, length[0])
            values = [across[0] / noise, depth, [(p[2] - level) / std, p[4]]]
            return np.asarray(np.nan_to_num(np.concatenate(values), nan=1e3, posinf=1e3, neginf=-1e3))

        parameters = least_squares(residuals, parameters, loss="soft_l1", x_scale=[0.01, 0.01, 0.01, 0.1, 1.0]).x
    chosen = ground.agree(_rotations(parameters), centre_of(parameters), ground.tolerance(_FINE))[0]
    rotation = _rotations(parameters)[0].T @ ground.face.axes
    centre = ground.face.axes.T @ centre_of(parameters)
    posed = replace(camera, cam_from_world=np.column_stack([rotation, -rotation @ centre]))
    kept = replace(matches.chosen(chosen), on_face=np.ones(int(chosen.sum()), dtype=np.bool_))
    support = count_places(chosen[None], matches, (camera, camera))[0]
    return PoseOnFace(posed, kept, int(support))
