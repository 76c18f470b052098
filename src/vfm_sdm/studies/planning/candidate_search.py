"""Candidates for points: on the structure's face and off it, found in every view and tried on the recordings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import compute_position_covariance, triangulation_jacobian
from vfm_sdm.geometry.triangulation import in_front_of_all
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.detection import detect_features
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.repeats import lie_on_repeats
from vfm_sdm.stages.registration.designs import Warp
from vfm_sdm.stages.tracking.base import DesignedTracker
from vfm_sdm.stages.tracking.design.information import USABLE_STD_PX
from vfm_sdm.stages.tracking.subset_design import SubsetChoice, design_subsets
from vfm_sdm.studies.planning.candidates import Located, find_textured, locate_candidates
from vfm_sdm.studies.planning.choosing import Motion, judge_motion
from vfm_sdm.studies.planning.face_of_matches import KnownFace, place_matches
from vfm_sdm.studies.planning.trial_tracks import FrameRow, Tried, choose_row, try_candidates

__all__ = ["PLACED_PX", "Candidates", "find_candidates"]

_GRID = 20, 12
"""Columns and rows of the grid over the reference view, of whose cells the best place is a candidate."""
_ROWS = 3
"""Parts of the height of the picture; in each of them, one place of two columns for each wanted point is looked for on
the face."""
_LOOKS, _ENOUGH = 2, 2
"""Times that places are looked for on the face, and how many for each wanted point are enough at once."""
_EACH_PART = 3
"""Places on the face that are tried for each wanted point, in parts of the span."""
_STATIC_GRID = 4, 3
"""Columns and rows of the parts of the picture in which places off the face are looked for."""
_EACH_CELL = 2
_NEAR = 0.05
"""Share of the picture's width within which matches tell where a place lies."""
PLACED_PX = 3.0
"""Largest standard deviation of a place in another view [px]: farther off, registration does not find it."""
_FAR_STD = 3.0
"""Standard deviations of what lies on the face, from which on something does not."""
_UNSEEN = SubsetChoice(None, np.full(2, np.nan), np.full(2, np.nan), 0.0, PointStatus.NOT_FOUND, np.full(2, np.nan))
"""Of a candidate in a view that does not show it."""
_PARTS_APART = 0.3
"""Largest spread of the gains of a subset's parts [1], at which the audit fails halves; less of it counts as error."""
_BELIEVED = 0.5
"""Least share of a square that moves with its middle: of less it is as likely that the point is what stands out."""
_FOLLOWED = 0.8
"""Least share of trial frames with status ok: in the others something passes before it."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """P places with all that is known of them before the choice.

    Parameters
    ----------
    located
        Where every view shows them.
    on_face
        Which lie on the structure's face, shape (P,).
    along_m, behind_m
        Along the longitudinal axis from the reference camera, and behind the face, shape (P,) [m].
    choices
        What the subset of each compares, by view; ``None`` for trackers that compare none.
    tried
        Trial tracks of every view.
    motion
        What these say of motion.
    """

    located: Located
    on_face: BoolArray
    along_m: FloatArray
    behind_m: FloatArray
    choices: dict[str, list[SubsetChoice]] | None
    tried: list[Tried]
    motion: Motion

    @property
    def trackable(self) -> BoolArray:
        """Which were followed in enough frames of every view that shows them, each with a good std, shape (P,)."""
        seen = np.isfinite(self.located.pixels).all(axis=2)
        fine = np.array([(one.followed >= _FOLLOWED) & (one.std_px() <= USABLE_STD_PX) for one in self.tried])
        if self.choices is not None:
            whole = [[_measures_both(choice) for choice in of_view] for of_view in self.choices.values()]
            fine &= np.array(whole)
        return np.asarray((fine | ~seen).all(axis=0) & (seen.sum(axis=0) >= 2))

    @property
    def whole(self) -> BoolArray:
        """Which subsets move as one in every view, shape (P,): no rail before a wall, no leaves before a girder."""
        fine = np.max([one.parts_apart for one in self.tried], axis=0) <= _PARTS_APART
        for of_view in (self.choices or {}).values():
            fine &= [one.design is None or one.believed >= _BELIEVED for one in of_view]
        return np.asarray(fine)

    def subset_px(self, row: int) -> int:
        """Side of the subset of a candidate, the largest over views [px]; 0 where none is designed."""
        designs = [of_view[row].design for of_view in (self.choices or {}).values()]
        return max((one.subset_px for one in designs if one is not None), default=0)

    def std_mm(self, rig: Rig, rotation: FloatArray, pixels: FloatArray) -> FloatArray:
        """Standard deviation of one sample along the axes, of all candidates at pixels (V, P, 2), shape (P, 3) [mm]."""
        # All that a point shows that must not move is error.
        slow = np.where(self.motion.still, self.motion.moved_px, 0.0)
        noise = np.stack([np.nan_to_num(one.covariance) for one in self.tried]) + _isotropic(slow)
        return _to_mm(noise, rig, rotation, pixels)

    def parts_std_mm(self, rig: Rig, rotation: FloatArray, pixels: FloatArray) -> FloatArray:
        """Standard deviation from parts of subsets that move by different amounts, as of `std_mm`."""
        moved = np.nan_to_num(self.motion.moved_px)
        apart = np.stack([_isotropic(one.parts_apart * moved) for one in self.tried])
        return _to_mm(apart, rig, rotation, pixels)


def _isotropic(total_px: FloatArray) -> FloatArray:
    """Covariances (P, 2, 2) [px2] alike in all directions, of root mean square lengths (P,) [px]."""
    return np.asarray(total_px[:, None, None] ** 2 / 2 * np.eye(2))


def _to_mm(covariance: FloatArray, rig: Rig, rotation: FloatArray, pixels: FloatArray) -> FloatArray:
    """Standard deviations along the axes, shape (P, 3) [mm], from covariances in the pictures (V, P, 2, 2) [px2]."""
    spread = compute_position_covariance(triangulation_jacobian(pixels, rig), covariance[:, None])[0]
    return np.asarray(1e3 * np.sqrt(np.einsum("ai,pij,aj->pa", rotation, spread, rotation)))


def find_candidates(
    measurement: Measurement,
    face: KnownFace,
    solution: CameraSolution,
    matches: Sequence[Matches],
    wanted: tuple[int, int],
) -> Candidates:
    """Places of the reference view that could be points, located and tried.

    Parameters
    ----------
    measurement
        The session's recordings, first frames and tracker.
    face
        The structure's face.
    solution
        Cameras, and the points of the session, which candidates avoid.
    matches
        Feature matches with the reference view: those on the face tell where in the picture it is.
    wanted
        Numbers of points of the structure and of static points.
    """
    rig, frames = face.rig, measurement.frames
    luma = frames[face.session.reference_view.name]
    taken = solution.points["position"].transpose("view", "point", "pixel").values[0]
    pixels, texture = find_textured(luma, subset_px=measurement.session.method.usual_subset_px, grid=_GRID, avoid=taken)
    plain = ~lie_on_repeats(pixels, detect_features(luma))
    pixels, texture = pixels[plain], texture[plain]
    near_face, near_off = _told_by_matches(pixels, face, rig, matches, luma.shape[1])
    looked = _look(measurement, pixels)
    moves = judge_motion([looked], np.ones(len(pixels), dtype=np.bool_)).with_structure
    cells = _cells(pixels, luma, (2 * wanted[0], _ROWS))
    order = np.asarray(2 * ~moves + ~near_face)
    found, rows = _look_on_face(measurement, face, _Places(pixels, texture, cells, order), matches, wanted[0])
    parts = _parts_of_span(face.along_axes(found.points3d)[:, 2], wanted[0])
    located = found.chosen(_best_of_each(parts, order[rows] // 2, texture[rows], _EACH_PART))
    if wanted[1]:
        others = np.setdiff1d(np.arange(len(pixels)), rows)
        order = np.asarray(2 * moves[others] + ~near_off[others])
        cells = _cells(pixels[others], luma, _STATIC_GRID)
        some = others[_best_of_each(cells, order, texture[others], _EACH_CELL)]
        off = locate_candidates(face.session, frames, rig, pixels[some], static=True, matches=matches)
        located = located.joined(off.chosen(np.flatnonzero(_is_placed(off, rig))))
    behind = face.off_face(located.points3d)
    on_face = np.asarray(np.abs(behind) <= _FAR_STD * face.std_m)
    video = measurement.recordings[measurement.session.reference_view.name]
    choices, tried = _try_all(measurement, located, choose_row(video, looked, moves))
    along = face.along_axes(located.points3d)[:, 2]
    return Candidates(located, on_face, along, behind, choices, tried, judge_motion(tried, on_face))


def _cells(pixels: FloatArray, luma: LumaArray, grid: tuple[int, int]) -> IntArray:
    """Number of the cell of a grid (columns, rows) over the picture in which each place (N, 2) lies, shape (N,)."""
    place = (pixels * grid // [luma.shape[1], luma.shape[0]]).astype(np.intp)
    return np.asarray(place @ [1, grid[0]])


def _look(measurement: Measurement, pixels: FloatArray) -> Tried:
    """A quick look at what moves of places (N, 2) of the reference view; it sets orders and frames, and no more."""
    video = measurement.recordings[measurement.session.reference_view.name]
    return try_candidates(video, pixels, measurement.part("trackers"), row=FrameRow(count=1))


@dataclass(frozen=True, eq=False)
class _Places:
    """Textured places of the reference view: pixels (N, 2), and texture, cell and order of looking, shape (N,) each."""

    pixels: FloatArray
    texture: FloatArray
    cell: IntArray
    order: IntArray


def _look_on_face(
    measurement: Measurement, face: KnownFace, places: _Places, matches: Sequence[Matches], wanted: int
) -> tuple[Located, IntArray]:
    """Places that the other views show on the face, and their rows; the second best of cells where these are few."""
    left = np.arange(len(places.pixels))
    found, kept = Located.none(len(measurement.frames)), np.empty(0, dtype=np.intp)
    for _ in range(_LOOKS):
        rows = left[_best_of_each(places.cell[left], places.order[left], places.texture[left], 1)]
        on = locate_candidates(
            face.session, measurement.frames, face.rig, places.pixels[rows], static=False, matches=matches
        )
        good = _is_placed(on, face.rig) & (np.abs(face.off_face(on.points3d)) <= _FAR_STD * face.std_m)
        found, kept = found.joined(on.chosen(np.flatnonzero(good))), np.concatenate([kept, rows[good]])
        left = np.setdiff1d(left, rows)
        # Where something moves, only what moves may be the structure.
        moving = places.order[kept] < 2 if (places.order < 2).any() else np.ones(kept.size, dtype=np.bool_)
        if np.count_nonzero(moving) >= _ENOUGH * wanted:
            break
    return found, kept


def _told_by_matches(
    pixels: FloatArray, face: KnownFace, rig: Rig, matches: Sequence[Matches], width: int
) -> tuple[BoolArray, BoolArray]:
    """Which places (N, 2) have a match on the face near them, and which one off it, shape (N,) each."""
    points3d, at = place_matches(rig, matches)
    apart = np.abs(face.off_face(points3d)) > _FAR_STD * face.std_m
    near = np.linalg.norm(pixels[:, None] - at, axis=2) <= _NEAR * width
    return (near & ~apart).any(axis=1), (near & apart).any(axis=1)


def _best_of_each(group: IntArray, order: IntArray, texture: FloatArray, most: int) -> IntArray:
    """Indices of the best few of each group: of the lowest order, then with the most texture."""
    ranked = np.lexsort((-texture, order))
    kept = [row for one in np.unique(group) for row in ranked[group[ranked] == one][:most]]
    return np.array(kept, dtype=np.intp)


def _is_placed(located: Located, rig: Rig) -> BoolArray:
    """Which candidates were found in a second view well enough, before the cameras, shape (N,)."""
    known = np.array([one == PointStatus.OK for one in located.status], dtype=np.bool_)
    seen: BoolArray = np.asarray(np.isfinite(located.pixels).all(axis=2))
    sure = known & (located.largest_std_px <= PLACED_PX)
    return np.asarray(sure & in_front_of_all(located.points3d, rig, seen=seen))


def _parts_of_span(along: FloatArray, count: int) -> IntArray:
    """Which of equal parts of the span each place lies in, shape (N,)."""
    if not along.size:
        return np.empty(0, dtype=np.intp)
    share = (along - along.min()) / max(float(np.ptp(along)), 1e-9)
    return np.asarray(np.minimum((share * count).astype(np.intp), count - 1))


def _try_all(
    measurement: Measurement, located: Located, row: FrameRow
) -> tuple[dict[str, list[SubsetChoice]] | None, list[Tried]]:
    """Subsets of all candidates by view, and their trial tracks."""
    tracker, size = measurement.part("trackers"), measurement.session.method.subset_px
    choices: dict[str, list[SubsetChoice]] | None = {} if isinstance(tracker, DesignedTracker) else None
    tried = []
    for (view, video), pixels in zip(measurement.recordings.items(), located.pixels, strict=True):
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        of_view: list[SubsetChoice] | None = None
        if choices is not None:
            names = [str(row) for row in seen]
            made = dict(zip(seen.tolist(), design_subsets(video, pixels[seen], names, subset_px=size), strict=True))
            of_view = choices[view] = [made.get(row, _UNSEEN) for row in range(len(pixels))]
        tried.append(try_candidates(video, pixels, tracker, of_view, row=row))
    return choices, tried


def _measures_both(choice: SubsetChoice) -> bool:
    """Whether a subset was accepted and measures both directions."""
    return choice.design is not None and choice.design.warp != Warp.EDGE
