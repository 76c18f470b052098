"""The structure's face where its distances were not measured: the vertical plane that most of the picture shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.inputs.session import Measured, Session, Site
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["KnownFace", "know_face_of_session", "place_matches"]

_TOLERANCE = 0.02
"""Share of its distance by which what counts as on the plane may lie off it."""
_DRAWS = 500
_CELLS = 12
"""Cells along each side of the picture; a plane counts by the cells in which it shows, not by its matches."""
_FEWEST = 12
_SEED = 0


@dataclass(frozen=True, eq=False)
class KnownFace:
    """The session with a face to look for points on, measured or taken from matches.

    Parameters
    ----------
    session
        The session, whose site states distances of the face.
    rig
        Its cameras, lengths in metres.
    frame
        The structure's axes.
    distance_m, std_m
        Distance of the face from the reference camera, and how far what lies on it may be off.
    notes
        What was taken for granted.
    """

    session: Session
    rig: Rig
    frame: StructureFrame
    distance_m: float
    std_m: float
    notes: tuple[str, ...] = ()

    def along_axes(self, points3d: FloatArray) -> FloatArray:
        """Points (N, 3) along the structure's axes [m]; the first coordinate is the distance across the face."""
        return np.asarray(points3d @ self.frame.rotation.T)

    def off_face(self, points3d: FloatArray) -> FloatArray:
        """How far points (N, 3) lie behind the face [m], shape (N,)."""
        return self.along_axes(points3d)[:, 0] - self.distance_m


def know_face_of_session(session: Session, solution: CameraSolution, matches: Sequence[Matches]) -> KnownFace:
    """The face as measured on site or, where it was not, as the matches of the first frames show it.

    Parameters
    ----------
    session
        The measurement.
    solution
        Its cameras, lengths in metres.
    matches
        Feature matches between views.

    Raises
    ------
    DatasetError
        The distances were not measured, and no plane stands out.

    Notes
    -----
    Among vertical planes (across the lateral axis, where lines or distances gave it, else through any two matches) the
    one that shows in most cells of the picture is taken. A wall behind a slender structure may win: the notes say what
    was taken for granted, and the film's own motion decides later what is structure.
    """
    rig = solution.rig
    if rig is None:
        raise DatasetError(f"points suggest: expected cameras, got none: {solution.status}; see `vfm-sdm cameras`")
    site = session.site
    measured = Face.of(site, solution.frame)
    if measured is not None:
        return KnownFace(session, rig, measured.frame, measured.distance_m, measured.std_m)
    rotation, distance, spread = _find_plane(rig, solution.frame, site, matches)
    normal = rotation[0]
    # What `structure_from_cam1` makes of these two distances is this plane again.
    along = Measured(value=float(distance * abs(normal[0]) / normal[2]), std=max(spread, _TOLERANCE * distance))
    across = {"value": float(distance), "std": max(spread, 0.5 * _TOLERANCE * distance)}
    offset = max(site.face_offset_std, spread)
    stated = Site.model_validate(
        {
            **site.model_dump(exclude_none=True),
            "perpendicular_distance": across,
            "longitudinal_distance": along.model_dump(),
            "structure_side": "right" if normal[0] >= 0 else "left",
            "face_offset_std": float(offset),
        }
    )
    note = (
        f"the face was not measured: taken is the vertical plane in {distance:.2f} m that most of the picture shows; "
        "perpendicular_distance and longitudinal_distance would tell it"
    )
    level = "" if solution.frame is not None or site.reference_camera_level is not None else (
        "; the reference camera is taken to be level"
    )  # fmt: skip
    frame = StructureFrame(rotation)
    assumed = session.model_copy(update={"site": stated})
    return KnownFace(assumed, rig, frame, distance, float(np.hypot(across["std"], offset)), (note + level,))


def _find_plane(
    rig: Rig, frame: StructureFrame | None, site: Site, matches: Sequence[Matches]
) -> tuple[FloatArray, float, float]:
    """Axes (3, 3) of the plane, its distance and how far matches scatter about it [m]."""
    points3d, pixels = place_matches(rig, matches)
    if len(points3d) < _FEWEST:
        raise DatasetError(
            f"points suggest: expected {_FEWEST} matches between the views to find the face, got {len(points3d)}; "
            "measure perpendicular_distance and longitudinal_distance, or choose views that overlap more"
        )
    down = _vertical(frame, site)
    width, height = rig.cameras[0].image_size
    cells = (pixels * _CELLS / [width, height]).astype(int) @ [1, _CELLS]
    best, inside, normal = 0, np.zeros(len(points3d), dtype=np.bool_), np.zeros(3)
    rng = np.random.default_rng(_SEED)
    for _ in range(_DRAWS):
        first, second = points3d[rng.choice(len(points3d), 2, replace=False)]
        tried = frame.rotation[0] if frame is not None else np.cross(down, second - first)
        if not np.linalg.norm(tried) > 0:
            continue
        tried = tried / np.linalg.norm(tried) * (1.0 if tried @ first > 0 else -1.0)
        distance = float(tried @ first)
        near: BoolArray = np.abs(points3d @ tried - distance) < _TOLERANCE * distance
        shown = len(np.unique(cells[near]))
        if tried[2] > 0 and shown > best:
            best, inside, normal = shown, near, tried
    if np.count_nonzero(inside) < _FEWEST:
        raise DatasetError(
            "points suggest: expected a plane that many matches share, got none; measure perpendicular_distance and "
            "longitudinal_distance"
        )
    depths = points3d[inside] @ normal
    distance = float(np.median(depths))
    return (
        np.stack([normal, down, np.cross(normal, down)]),
        distance,
        float(MAD_TO_STD * np.median(abs(depths - distance))),
    )


def place_matches(rig: Rig, matches: Sequence[Matches]) -> tuple[FloatArray, FloatArray]:
    """Matches with the reference view in space, shape (N, 3) [m], and their pixels in it, shape (N, 2)."""
    points3d, pixels = [np.empty((0, 3))], [np.empty((0, 2))]
    for one in matches:
        if one.first == 0 and len(one):
            both = np.full((len(rig), len(one), 2), np.nan)
            both[0], both[one.second] = one.points_first, one.points_second
            placed = triangulate(both, rig)
            seen = np.isfinite(both).all(axis=2)
            ahead = in_front_of_all(placed, rig, seen=seen)
            points3d.append(placed[ahead])
            pixels.append(one.points_first[ahead])
    return np.concatenate(points3d), np.concatenate(pixels)


def _vertical(frame: StructureFrame | None, site: Site) -> FloatArray:
    """The direction down in the reference camera's frame, shape (3,)."""
    if frame is not None:
        return np.asarray(frame.rotation[1])
    level = site.reference_camera_level
    pitch, roll = (0.0, 0.0) if level is None else (np.radians(level.pitch), np.radians(level.roll))
    return np.asarray(structure_from_cam1(np.pi / 2, pitch_rad=pitch, roll_rad=roll)[1])
