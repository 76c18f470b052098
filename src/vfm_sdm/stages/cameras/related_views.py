"""How a further view relates to the first one: poses that matches and site allow, each tested against chance."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import Readings, Session, quiet_frames
from vfm_sdm.stages.cameras.face_poses import TOLD_STD, PoseOnFace, propose_poses, told_agree
from vfm_sdm.stages.cameras.relative_pose import (
    Agreement,
    chance_agreement,
    count_places,
    estimate_relative_pose,
    halve_matches,
    measure_agreement,
)
from vfm_sdm.stages.matching.base import FeatureMatcher
from vfm_sdm.stages.matching.detection import ImageFeatures, detect_features
from vfm_sdm.stages.matching.face import Face
from vfm_sdm.stages.matching.features import match_features
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.points import NAMED_STD_PX, named_points
from vfm_sdm.stages.matching.repeats import lie_on_repeats
from vfm_sdm.stages.matching.smooth import agree_smoothly
from vfm_sdm.stages.matching.surface_matches import match_through

__all__ = ["MIN_INLIERS", "Known", "RelatedView", "relate_to_first", "relate_view"]

MIN_INLIERS = 30
"""Number of matches in agreement with one pose from which a pair of views counts as related."""
_NAMED = 5
"""Points named in both views that determine a pose."""
_POINTED, _NO_CHANCE = Agreement(np.inf, 1.0, 1.0), Agreement(0.0, 1.0, 0.0)
"""Agreement of points that somebody named in both views, which is no chance."""
_WRONG, _WRONG_BESIDE_FACE = 0.5, 0.2
"""Largest share of wrong matches that the adjustment's robust loss bears; and where it can do without them."""
_CLOSE_STD = 3.0
"""Largest error of a match in the scatter of all, from their median absolute error by the normal distribution's."""
_CHANCE_STD = 3.0
"""By how many standard deviations of a count the support has to exceed what chance gives."""
_REACH = (0.045, 0.025)
"""How far along rows and columns the face's map may be wrong before it is adjusted, over the longer side: the depth of
what lies on the face, and a camera that was levelled by eye."""
_NOISE = 2e-3
"""Tolerance of a feature's place across the epipolar line, over the longer side."""
_DEPTH_STD = 2.5
_MOST = 0.5
"""Share of the named points that have to agree with a pose: one of them may be a slip."""
_SAME_RAD = np.radians(3)
"""Angle within which two poses are one."""
_CONTRADICTED = (
    "{} and {}: the pose that most matches agree with contradicts the points that are named in both views; correct "
    "their pixels (pixel_in), name five such points, or measure both distances of the face"
)
_SPLITS = 3
"""Ways of halving the matches: nine differences of angles tell a scatter to a quarter of it."""
_AGREEING = 0.7
"""Share of the matches of one pose that have to agree with another one, for the two to count as the same."""


@dataclass(frozen=True, eq=False)
class Known:
    """What the site tells of the poses.

    Parameters
    ----------
    baseline_m
        Distance of the first two cameras [m].
    face
        The structure's face; ``None`` where its distances were not measured.
    readings
        What was read at the further camera.
    named
        Pixels of the points that the session names in both views; ``None`` where it does not.
    told
        Those of them that lie on the face.
    """

    baseline_m: float
    face: Face | None = None
    readings: Readings = field(default_factory=Readings)
    named: Matches | None = None
    told: Matches | None = None


@dataclass(frozen=True, eq=False)
class RelatedView:
    """A view beside the first one.

    Parameters
    ----------
    camera
        The camera with its pose in the first camera's frame, at a distance of one baseline.
    matches
        Matches of both views that agree with this pose.
    agreement
        How far the matches agree with this pose.
    chance
        The same for unrelated views.
    fault
        Why the two do not count as related, in a sentence; empty where they do.
    status
        The same in a word.
    named
        Points that the session names in both views, which always take part.
    halves
        What either half of all matches gives, for a few ways of halving them; empty where the face gives the pose.
    """

    camera: Camera
    matches: Matches
    agreement: Agreement
    chance: Agreement
    fault: str = ""
    status: CameraStatus = CameraStatus.OK
    named: Matches | None = None
    halves: tuple[tuple["RelatedView", "RelatedView"], ...] = ()

    @property
    def all_matches(self) -> tuple[Matches, ...]:
        """The matches, and the points named in both views."""
        return (self.matches,) if self.named is None else (self.matches, self.named)

    @property
    def clearness(self) -> float:
        """Support above chance [standard deviations]."""
        return (self.agreement.support - self.chance.support) / self.chance.std

    @property
    def wrong_share(self) -> float:
        """Share of the agreeing matches that is wrong, when wrong ones agree as by chance [1]."""
        real, chance = self.agreement.share, self.chance.share
        return 1.0 if real == 0 or chance >= 1 else min(1.0, (1 - real) / (1 - chance) * chance / real)


def relate_to_first(
    session: Session,
    frames: Mapping[str, LumaArray],
    cameras: Sequence[Camera],
    *,
    matcher: FeatureMatcher | None = None,
) -> Iterator[list[RelatedView]]:
    """Poses of every further view beside the first one, each view by itself.

    Parameters
    ----------
    session
        What the site tells: baseline, distances and level readings.
    frames
        Luma by view name, shape (H, W) each, in the session's order.
    cameras
        Intrinsics and distortion of each [px, 1].
    matcher
        What matches features; SIFT by default.
    """
    images = quiet_frames(frames)
    first, *others = images
    readings = {view.name: view for view in session.view}
    baseline, face = session.site.baseline, Face.of(session.site)
    for index, name in enumerate(others, start=1):
        # The tape lay between the first two cameras; of the others nobody knows how far they stand.
        pair_names = (first, name)
        named, told = _named_pairs(session, pair_names, index)
        known = Known(1.0, named=named, told=told)
        if baseline is not None:
            known = replace(
                known, baseline_m=baseline.value, face=face if index == 1 else None, readings=readings[name]
            )
        pair = (images[first], images[name]), (cameras[0], cameras[index])
        related = relate_view(pair_names, *pair, index, known, matcher=matcher)
        yield [one if one.matches is known.named else _with_named(one, known.named) for one in related]


def _with_named(one: RelatedView, named: Matches | None) -> RelatedView:
    halves = tuple((replace(half, named=named), replace(rest, named=named)) for half, rest in one.halves)
    return replace(one, named=named, halves=halves)


def relate_view(
    names: tuple[str, str],
    images: tuple[LumaArray, LumaArray],
    cameras: tuple[Camera, Camera],
    index: int,
    known: Known,
    *,
    matcher: FeatureMatcher | None = None,
) -> list[RelatedView]:
    """Poses of a further view that its matches with the first one allow.

    Parameters
    ----------
    names
        Names of the two views, for sentences.
    images
        Luma of the two views, shape (H, W) each.
    cameras
        Intrinsics and distortion of each [px, 1].
    index
        Index of the further view in the rig.
    known
        What the site tells of the poses.
    matcher
        What matches features; SIFT by default.

    Returns
    -------
    related
        One for each pose, the clearest first; at least one, with a fault where no pose stands out from chance.
    """
    features = detect_features(images[0]), detect_features(images[1])
    found = match_features(*images, known=features) if matcher is None else matcher.match(images)[0, 1]
    matches = Matches(0, index, found.points_first, found.points_second)
    # Tiles, balusters and windows agree with many poses, each of them shifted by a step.
    on_repeats = lie_on_repeats(matches.points_first, features[0]) | lie_on_repeats(matches.points_second, features[1])
    free = _relate_freely(names, matches, cameras, ~on_repeats)
    if not free.fault and _contradicts(free, known.named, cameras[0]):
        free = replace(free, fault=_CONTRADICTED.format(*names), status=CameraStatus.NOT_CLEAR)
    by_hand = _relate_by_hand(known, cameras)
    if known.face is None:
        return [free] if not free.fault else by_hand or [free]
    proposals = _propose(matches, cameras, known, known.face)
    related = _guide(names, (features[0], images), cameras, (proposals, known.face))
    clear = [one for one in related if not one.fault]
    if not free.fault:
        same = [_joined(one, free, cameras[0]) for one in clear]
        clear = [one for one in same if one is not None] or [*clear, free]
    clear.sort(key=lambda one: -one.clearness)
    return clear or by_hand or [free]


def _relate_freely(
    names: tuple[str, str], matches: Matches, cameras: tuple[Camera, Camera], alone: BoolArray
) -> RelatedView:
    """The pose that most matches agree with, whatever the site says; enough of them beside what repeats (``alone``)."""
    pose, agree = estimate_relative_pose(matches.points_first, matches.points_second, *cameras)
    real, chance = measure_agreement(agree, matches, cameras), chance_agreement(matches, cameras)
    one = RelatedView(replace(cameras[1], cam_from_world=pose), matches.chosen(agree), real, chance)
    judged = _judged(names, one, len(matches))
    judged = replace(judged, matches=_close_ones(judged, cameras[0]))
    if judged.fault:
        return judged
    if (agree & alone).sum() >= MIN_INLIERS:
        return replace(judged, halves=_relate_halves(judged, matches, cameras))
    fault = (
        f"{names[0]} and {names[1]}: all but {(agree & alone).sum()} of {agree.sum()} matches lie on what repeats, "
        f"{MIN_INLIERS} others are needed; name five points in both views (pixel_in), or choose views that show more"
    )
    return replace(judged, fault=fault, status=CameraStatus.NOT_CLEAR)


def _relate_halves(
    one: RelatedView, matches: Matches, cameras: tuple[Camera, Camera]
) -> tuple[tuple[RelatedView, RelatedView], ...]:
    """Poses that either half of all matches, right and wrong ones, gives by itself.

    Matches that agree by chance agree with the pose that was chosen for their sake, as closely as right ones. With
    another half of the matches, others do, with another pose.
    """

    def relate(half: BoolArray) -> RelatedView:
        part = matches.chosen(half)
        pose, agree = estimate_relative_pose(part.points_first, part.points_second, *cameras)
        camera = replace(cameras[1], cam_from_world=pose) if agree.any() else one.camera
        posed = replace(one, camera=camera, matches=part.chosen(agree))
        return replace(posed, matches=_close_ones(posed, cameras[0]))

    halves = halve_matches(matches, cameras, _SPLITS)
    return tuple((relate(half), relate(~half)) for half in halves)


def _close_ones(one: RelatedView, first: Camera) -> Matches:
    """The matches that agree as closely as most: the tolerance of the search is that of focal lengths, not of features.

    Where it holds many times their own scatter, what lies far from it is more likely wrong than imprecise.
    """
    m = one.matches
    if len(m) < MIN_INLIERS:
        return m
    rig = Rig(("first", "second"), (first, one.camera))
    error = np.abs(sampson_error(m.points_first, m.points_second, rig))
    return m.chosen(error <= _CLOSE_STD * MAD_TO_STD * np.median(error))


def _named_pairs(session: Session, views: tuple[str, str], index: int) -> tuple[Matches | None, Matches | None]:
    """Pixels of the points that the session names in both views, and of those of them on the face."""
    points = named_points(session, views)["position"].transpose("view", "point", "pixel").values
    both = np.isfinite(points).all(axis=(0, 2))
    on_face = np.array([not point.static for point in session.point], dtype=np.bool_)
    named, told = (
        Matches(0, index, points[0, some], points[1, some], std_px=NAMED_STD_PX) if some.any() else None
        for some in (both, both & on_face)
    )
    return named, told


def _propose(matches: Matches, cameras: tuple[Camera, Camera], known: Known, face: Face) -> list[PoseOnFace]:
    """Poses that matches on the face propose, without those that contradict what somebody named in both views.

    Where something repeats, several poses agree with matches alike, and a named place belongs to one of them. Enough of
    them propose a pose by themselves.
    """
    proposals = propose_poses(matches, cameras, face, known.baseline_m, known.readings)
    if known.told is None:
        return proposals
    by_hand = propose_poses(known.told, cameras, face, known.baseline_m, known.readings)
    believed = [one for one in proposals if told_agree(one.camera, known.told, cameras[0], face).mean() > _MOST]
    others = [one for one in by_hand if all(one.camera.turn_to(other.camera) > _SAME_RAD for other in believed)]
    return [*believed, *others] or proposals


def _contradicts(one: RelatedView, named: Matches | None, first: Camera) -> bool:
    """Whether most points that somebody named in both views lie off the epipolar lines of a pose."""
    if named is None:
        return False
    rig = Rig(("first", "second"), (first, one.camera))
    error = np.abs(sampson_error(named.points_first, named.points_second, rig))
    limit = 2 * _NOISE * max(first.image_size) + TOLD_STD * named.std_px
    return bool((error < limit).mean() <= _MOST)


def _relate_by_hand(known: Known, cameras: tuple[Camera, Camera]) -> list[RelatedView]:
    """Poses from the points that somebody named in both views alone; none where they are too few."""
    named = known.named
    if named is None:
        return []
    if known.face is not None and known.told is not None:
        proposals = propose_poses(known.told, cameras, known.face, known.baseline_m, known.readings)
        whole = [one for one in proposals if len(one.matches) == len(known.told)]
        if whole:
            return [RelatedView(one.camera, named, _POINTED, _NO_CHANCE) for one in whole]
    if len(named) < _NAMED:
        return []
    pose, agree = estimate_relative_pose(named.points_first, named.points_second, *cameras)
    if agree.sum() < _NAMED:
        return []
    return [RelatedView(replace(cameras[1], cam_from_world=pose), named.chosen(agree), _POINTED, _NO_CHANCE)]


def _judged(names: tuple[str, str], one: RelatedView, tried: int) -> RelatedView:
    """The view with its fault, if it has one."""
    fault = _find_fault(names, one, tried)
    few = len(one.matches) < MIN_INLIERS
    status = CameraStatus.OK if not fault else CameraStatus.TOO_FEW_MATCHES if few else CameraStatus.NOT_CLEAR
    return replace(one, fault=fault, status=status)


def _find_fault(names: tuple[str, str], one: RelatedView, tried: int) -> str:
    pair = f"{names[0]} and {names[1]}"
    if len(one.matches) < MIN_INLIERS:
        return (
            f"{pair}: {len(one.matches)} of {tried} matches agree, {MIN_INLIERS} are needed; choose views that overlap "
            "more, or name five points in both views (pixel_in)"
        )
    if one.clearness < _CHANCE_STD or one.wrong_share > _WRONG:
        return (
            f"{pair}: matches agree in {one.agreement.support:.0f} places of the images, by chance they do in "
            f"{one.chance.support:.0f}: no pose stands out, as with what repeats; measure both distances of the face, "
            "name five points in both views (pixel_in), or use a learned matcher"
        )
    return ""


def _guide(
    names: tuple[str, str],
    pictures: tuple[ImageFeatures, tuple[LumaArray, LumaArray]],
    cameras: tuple[Camera, Camera],
    proposed: tuple[list[PoseOnFace], Face],
) -> list[RelatedView]:
    """Poses that the face proposed, with the matches that each of them guides.

    A wrong pose guides matches, too, wherever a pattern repeats: what the others reach is chance.
    """
    proposals, face = proposed
    guided = []
    for proposal in proposals:
        found = _match_on_face(pictures, (cameras[0], proposal.camera), face, proposal.matches.second)
        guided.append(found if len(found) >= len(proposal.matches) else proposal.matches)
    support = [int(count_places(np.ones((1, len(m)), dtype=np.bool_), m, cameras)[0]) for m in guided]
    related = []
    for number, (proposal, found) in enumerate(zip(proposals, guided, strict=True)):
        others = max(support[:number] + support[number + 1 :], default=0)
        real, chance = (Agreement(n, np.sqrt(max(n, 1)), n / max(support)) for n in (support[number], others))
        one = RelatedView(proposal.camera, found, real, chance)
        related.append(_judged(names, one, len(found)))
    return related


def _match_on_face(
    pictures: tuple[ImageFeatures, tuple[LumaArray, LumaArray]], cameras: tuple[Camera, Camera], face: Face, index: int
) -> Matches:
    """Matches of features on the face, guided by a pose, without those that their surroundings contradict."""
    first, second = cameras
    side = max(second.image_size)

    def through(pixels: FloatArray, beyond_m: float = 0.0) -> FloatArray:
        return second.project(face.points(first, pixels, beyond_m) @ face.axes)

    reach = (_REACH[0] * side, _REACH[1] * side)
    pixels, seen = match_through(*pictures, through, reach)
    if not len(pixels):
        return Matches(0, index, pixels, seen)
    place = through(pixels)
    shift = through(pixels, face.std_m) - place
    length = np.linalg.norm(shift, axis=1)
    unit = shift / np.maximum(length, 1e-9)[:, None]
    off = seen - place
    across = (off[:, 0] * unit[:, 1] - off[:, 1] * unit[:, 0]) / (_NOISE * side)
    along = (off * unit).sum(axis=1) / np.hypot(_NOISE * side, _DEPTH_STD * length)
    known = np.isfinite(across) & np.isfinite(along)
    pixels, seen = pixels[known], seen[known]
    agree = agree_smoothly(pixels, np.column_stack([across, along])[known])
    return Matches(0, index, pixels[agree], seen[agree], np.ones(int(agree.sum()), dtype=np.bool_))


def _joined(one: RelatedView, free: RelatedView, first: Camera) -> RelatedView | None:
    """The pose on the face with the matches of the free one too, where the two are the same; else ``None``."""
    scale = np.linalg.norm(one.camera.translation)
    rig = Rig(("first", "second"), (first, one.camera))
    m = free.matches
    error = np.abs(sampson_error(m.points_first, m.points_second, rig))
    turn = one.camera.turn_to(free.camera)
    agree = error < 2 * _NOISE * max(first.image_size)
    if scale == 0 or agree.mean() < _AGREEING or turn > np.radians(10):
        return None
    if free.wrong_share > _WRONG_BESIDE_FACE:
        return one
    pixels = np.concatenate([one.matches.points_first, m.points_first])
    seen = np.concatenate([one.matches.points_second, m.points_second])
    on_face = np.concatenate([one.matches.on_face, np.zeros(len(m), dtype=np.bool_)])
    _, rows = np.unique(np.round(np.column_stack([pixels, seen])), axis=0, return_index=True)
    joined = Matches(m.first, m.second, pixels[rows], seen[rows], on_face[rows])
    return replace(one, matches=joined)
