"""Points suggested for a session that names none, or too few, by what they should measure."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count as count_from

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import CameraError, DatasetError, SessionError
from vfm_sdm.geometry.propagation import (
    compute_gain_covariance,
    compute_gain_sensitivity,
    compute_place_covariance,
    compute_place_sensitivity,
    projection_jacobian,
)
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import FirstFrames, Point, Session
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR
from vfm_sdm.stages.matching.locate import features_near
from vfm_sdm.studies.planning.candidate_search import PLACED_PX, Candidates, find_candidates
from vfm_sdm.studies.planning.choosing import choose_spread_along, choose_spread_out
from vfm_sdm.studies.planning.face_of_matches import KnownFace, know_face_of_session

__all__ = ["SuggestedPoint", "Suggestion", "suggest_points"]

_ROUNDS = 3
"""Times that points are chosen; what the cameras adjusted to them do not find again is replaced."""
_SAME_PX = 3.0
"""How far a point may be found from where it was before [px]: the cameras adjusted to it look elsewhere a little."""


@dataclass(frozen=True, eq=False)
class SuggestedPoint:
    """A place that is worth measuring.

    Parameters
    ----------
    name, static
        As in the session.
    pixels
        In the first frame of every view, shape (V, 2) [px].
    along_m, behind_m
        Along the longitudinal axis from the reference camera, and behind the face [m].
    std_mm
        Predicted standard deviation of one sample along the lateral, vertical and longitudinal axis, shape (3,) [mm].
    expanded_mm
        Predicted expanded uncertainty (k = 2) of one sample along these axes, shape (3,) [mm]: that noise and what
        cameras, place and subset leave uncertain of a vertical motion as large as the trial tracks show.
    subset_px
        Side of its subset, largest over views [px].
    moved_px
        Motion beyond noise in the trial tracks [px].
    why
        What speaks for it.
    """

    name: str
    static: bool
    pixels: FloatArray
    along_m: float
    behind_m: float
    std_mm: FloatArray
    expanded_mm: FloatArray
    subset_px: int
    moved_px: float
    why: str


@dataclass(frozen=True, eq=False)
class Suggestion:
    """Suggested points, and the session with them.

    Parameters
    ----------
    session
        The session with its own points and the suggested ones.
    points
        Those of the structure in their order along the span, then the static ones.
    frames
        First frame of every view, for a picture.
    notes
        What was taken for granted, and what could not be found.
    """

    session: Session
    points: tuple[SuggestedPoint, ...]
    frames: FirstFrames
    notes: tuple[str, ...]


def suggest_points(
    session: Session, *, count: int = 8, static: int = 3, progress: Progress | None = None
) -> Suggestion:
    """The best places on the structure's face, spread along the span, and on still background.

    Parameters
    ----------
    session
        Cameras and what was measured on site; its own points are kept, and new ones avoid them.
    count, static
        Numbers of points of the structure and of static points that are wanted.
    progress
        Called with what is being done.

    Returns
    -------
    suggestion
        The session with these points and, of each, what it should measure.

    Raises
    ------
    SessionError
        A single view, or a number that is not positive.
    CameraError
        The images did not allow cameras.
    DatasetError
        No place on the face is seen in two views and can be followed.

    Notes
    -----
    Textured places of the reference view are looked for in the other views, on the face and, those that are not found
    there, anywhere on their rays. Their subsets are designed as in a measurement, and tracked over the first frames and
    some spread over the recordings. What these tracks and the cameras say gives the standard deviations in millimetres.
    Where the structure's motion is clear of noise, it tells structure and background apart; else the face does. The
    chosen points are looked for once more as the measurement will do it, with the cameras adjusted to them; those that
    are not found again are replaced.
    """
    if len(session.view) < 2:
        raise SessionError(f"points suggest: expected two views or more, got {len(session.view)}; add a [[view]]")
    if count < 1 or static < 0:
        raise SessionError(
            f"points suggest: expected a count >= 1 and static >= 0, got {count} and {static}; correct them"
        )
    measurement = Measurement(session, progress=progress)
    solution = measurement.cameras
    if solution.rig is None:
        notes = "; ".join(solution.notes)
        raise CameraError(
            f"points suggest: expected cameras from the first frames, got none: {solution.status} ({notes}); "
            "points are found in space only: mend that first"
        )
    _say(progress, "candidates")
    matches = features_near(solution.rig, list(measurement.frames.values()))
    face = know_face_of_session(session, solution, matches)
    candidates = find_candidates(measurement, face, solution, matches, (count, static))
    _say(progress, "choice")
    return _settle(measurement, face, candidates, (count, static))


def _settle(measurement: Measurement, face: KnownFace, found: Candidates, wanted: tuple[int, int]) -> Suggestion:
    """The choice that the measurement itself finds again."""
    session, usable = measurement.session, found.trackable
    cost = _predict(found, face, measurement.cameras, found.located.pixels, found.located.std_px)[1]
    for _ in range(_ROUNDS):
        rows, still = _choose(found, cost, usable, wanted)
        if not rows:
            raise DatasetError(
                "points suggest: expected places on the structure's face that two views show and that can be followed, "
                f"got none of {np.count_nonzero(found.on_face)} on the face; check the distances and cameras "
                "(`vfm-sdm cameras`), or name points by hand"
            )
        named = _name(session, found, rows, still)
        extended = session.model_copy(update={"point": (*session.point, *named)})
        again = Measurement(extended).given(recordings=measurement.recordings, frames=measurement.frames).cameras
        lost = _lost(again, named, found.located.pixels[:, rows + still])
        if not lost:
            break
        usable = usable.copy()
        usable[[(rows + still)[one] for one in lost]] = False
    kept = [one for one in range(len(named)) if one not in lost]
    if not any(one < len(rows) for one in kept):
        raise DatasetError(
            "points suggest: expected the chosen places to be found again by the cameras that are adjusted to them, "
            f"got none ({again.status}); check what was measured on site, or name points by hand"
        )
    named = tuple(named[one] for one in kept)
    extended = session.model_copy(update={"point": (*session.point, *named)})
    points = _describe(found, face, again, named, [(rows + still)[one] for one in kept])
    return Suggestion(extended, points, measurement.frames, (*face.notes, *_notes(found, again, points, wanted)))


def _choose(
    found: Candidates, expanded_mm: FloatArray, usable: BoolArray, wanted: tuple[int, int]
) -> tuple[list[int], list[int]]:
    """Indices of points of the structure, in their order along the span, and of static ones."""
    motion = found.motion
    structure = usable & found.on_face & found.whole
    still = usable & motion.still
    if motion.tells:
        structure &= motion.with_structure
    else:
        still &= ~found.on_face
    # Lateral and vertical motion is what is measured; along the structure it hardly moves.
    rows = choose_spread_along(found.along_m, np.linalg.norm(expanded_mm[:, :2], axis=1), structure, wanted[0])
    worst_px = np.hypot(np.max([one.std_px() for one in found.tried], axis=0), motion.moved_px)
    return rows, choose_spread_out(found.located.pixels[0], worst_px, still, wanted[1])


def _name(session: Session, found: Candidates, rows: list[int], still: list[int]) -> tuple[Point, ...]:
    """The chosen candidates as points of the session, with names that it does not have yet."""
    view, taken = session.reference_view.name, {point.name for point in session.point}
    named: list[Point] = []
    for word, chosen in (("span", rows), ("still", still)):
        free = (name for number in count_from(1) if (name := f"{word} {number}") not in taken)
        for row, name in zip(chosen, free, strict=False):
            u, v = (float(one) for one in found.located.pixels[0, row])
            named.append(Point(name=name, view=view, pixel=(u, v), static=word == "still"))
    return tuple(named)


def _lost(again: CameraSolution, named: Sequence[Point], pixels: FloatArray) -> list[int]:
    """Which of the named points the measurement does not find again where they were, pixels (V, P, 2) [px]."""
    lost = []
    for number, point in enumerate(named):
        one = again.points.sel(point=point.name).transpose("view", "pixel", ...)
        apart = np.linalg.norm(one["position"].values - pixels[:, number], axis=1)[1:]
        ok = (one["status"].values == PointStatus.OK)[1:]
        placed = ok & (one["position_std"].values[1:] <= PLACED_PX).all(axis=1) & (apart <= _SAME_PX)
        if again.rig is None or not placed.any():
            lost.append(number)
    return lost


def _describe(
    found: Candidates, face: KnownFace, again: CameraSolution, named: Sequence[Point], rows: Sequence[int]
) -> tuple[SuggestedPoint, ...]:
    """The points with what they should measure, by the cameras that were adjusted to them."""
    pixels, place_px = found.located.pixels.copy(), found.located.std_px.copy()
    of_named = again.points.sel(point=[point.name for point in named])
    pixels[:, rows] = of_named["position"].transpose("view", "point", "pixel").values
    place_px[:, rows] = of_named["position_std"].transpose("view", "point", "pixel").values
    std_mm, expanded_mm = _predict(found, face, again, pixels, place_px)
    along = triangulate(pixels, again.rig or face.rig) @ (again.frame or face.frame).rotation.T
    return tuple(
        SuggestedPoint(
            name=point.name,
            static=point.static,
            pixels=pixels[:, row],
            along_m=float(along[row, 2]),
            behind_m=float(along[row, 0] - face.distance_m),
            std_mm=std_mm[row],
            expanded_mm=expanded_mm[row],
            subset_px=found.subset_px(row),
            moved_px=float(found.motion.moved_px[row]),
            why=_why(found, row, static=point.static),
        )
        for point, row in zip(named, rows, strict=True)
    )


def _predict(
    found: Candidates, face: KnownFace, solution: CameraSolution, pixels: FloatArray, place_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Standard deviation and expanded uncertainty of one sample of all candidates, shape (P, 3) [mm] each.

    The latter holds what cameras, places of standard deviations (V, P, 2) [px], and subsets whose parts move by
    different amounts leave uncertain of a vertical motion as large as trial tracks show.
    """
    rig, rotation = solution.rig or face.rig, (solution.frame or face.frame).rotation
    std_mm = found.std_mm(rig, rotation, pixels)
    # What moves a picture by so many pixels moves vertically by so many millimetres.
    per_m = projection_jacobian(triangulate(pixels, rig), rig) @ rotation[1]
    amplitude_mm = 1e3 * np.nan_to_num(found.motion.moved_px) / np.linalg.norm(per_m, axis=2).max(axis=1)
    place = np.nan_to_num(place_px).swapaxes(0, 1).reshape(pixels.shape[1], -1)
    gains = compute_place_covariance(compute_place_sensitivity(pixels, rig) * place[..., None, None], rotation)
    if solution.covariance is not None:
        gains = gains + compute_gain_covariance(compute_gain_sensitivity(pixels, rig), rotation, solution.covariance)
    scale = np.sqrt(np.maximum(gains[:, :, 1, 1], 0.0)) * amplitude_mm[:, None]
    parts = found.parts_std_mm(rig, rotation, pixels)
    return std_mm, COVERAGE_FACTOR * np.sqrt(std_mm**2 + scale**2 + parts**2)


def _why(found: Candidates, row: int, *, static: bool) -> str:
    """What speaks for a point, in a few words."""
    motion, moved = found.motion, found.motion.moved_px[row]
    side = "behind" if found.behind_m[row] > 0 else "before"
    off = "on the face" if found.on_face[row] else f"{abs(found.behind_m[row]):.1f} m {side} the face"
    if static:
        return f"{off}, still ({moved:.2f} px)" if motion.tells else f"{off}, still (so is the face)"
    return f"on the face, moves {moved:.2f} px" if motion.tells else "on the face; motion not clear of noise"


def _notes(
    found: Candidates, again: CameraSolution, points: Sequence[SuggestedPoint], wanted: tuple[int, int]
) -> list[str]:
    """What a reader must know beside the table."""
    notes = []
    if found.motion.tells:
        notes.append(f"motion tells structure ({found.motion.structure_px:.2f} px) from background")
    else:
        notes.append("the structure's motion is not clear of noise in the trial frames: the face alone tells it apart")
    fixed = sum(point.static for point in points)
    if (structural := len(points) - fixed) < wanted[0]:
        notes.append(f"{structural} of {wanted[0]} points found: no further place is seen in two views and followed")
    if wanted[1] and not fixed:
        notes.append(
            "no still background found, so no static point: camera motion is neither seen nor taken out; name a place "
            "that cannot move, with static = true"
        )
    elif fixed < wanted[1]:
        notes.append(f"{fixed} of {wanted[1]} static points found")
    if not all(one.scattered for one in found.tried):
        notes.append("the recordings are too short to show a codec's errors: the standard deviations leave them out")
    if again.covariance is None:
        notes.append("the cameras state no covariance: the expanded uncertainty is that of noise alone")
    return notes


def _say(progress: Progress | None, what: str) -> None:
    if progress is not None:
        progress(what, 0, None)
