"""Several cameras that the images allow, weighed with everything measured on site.

Seen through long lenses a scene is nearly affine: turning the further camera and stretching the depth change next to
nothing in the pictures (the bas-relief ambiguity), and each solution has a mirror image whose baseline points the other
way (Necker's ambiguity) [1]_. All of them are adjusted; what the site cannot tell apart is in the uncertainty.

References
----------
.. [1] Koenderink, J. J., van Doorn, A. J. (1991). Affine structure from motion. Journal of the Optical Society of
   America A 8(2), 377-385.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import Hypothesis
from vfm_sdm.stages.cameras.confusions import FREE_STD
from vfm_sdm.stages.cameras.site import SiteAdjustment, compare_rigs
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["Weighed", "weigh_hypotheses"]

Adjust = Callable[[Hypothesis], SiteAdjustment]

_NARROW_RAD = np.radians(25)
"""Field of view below which a scene is taken for nearly affine."""
_LONGER = 2.0
"""Standard deviations of its prior by which a lens may be longer than stated."""
_TURNS = np.radians([-60.0, -25.0, 25.0, 60.0, 180.0])
"""Directions of the baseline from which the adjustment starts again, from the first solution's."""
_ROTATION = slice(CAMERA_PARAMETERS.index("rx"), CAMERA_PARAMETERS.index("rz") + 1)
_MOST_TURNED = 5.0
"""Standard deviations of its rotation by which a camera may be turned in the adjustment."""
_RIVAL_COST = 9.0
"""Cost above the least one up to which a solution is a rival: three standard deviations of one free direction."""
_AHEAD = 0.5
"""Share of the matches that have to lie in front of the cameras."""
_SAME_RAD = np.radians(0.5)
_BY_CHANCE = 3.0
"""Scatter of what halves of the matches give, over the stated standard deviation, from which chance decides."""
_CONTRADICTED = 4.0
"""A reading or prior this many standard deviations off excludes a solution where another one has none such."""
_READINGS = {"perpendicular distance": (0.02, "m"), "longitudinal distance": (0.05, "m"), "pitch": (0.2, "deg")}
"""Readings that may tell solutions apart, with their usual standard deviations: laser distance meter, spirit level."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """The solution that agrees best, with the spread of those that are left beside it.

    Parameters
    ----------
    hypothesis
        Cameras before the adjustment, with the matches that agree with them.
    adjusted
        Their adjustment, with the spread of the rivals in its covariance.
    rivals
        Adjustments of the others that cannot be excluded.
    scatter
        What halves of the matches tell of the scatter of the solution.
    """

    hypothesis: Hypothesis
    adjusted: SiteAdjustment
    rivals: tuple[SiteAdjustment, ...]
    scatter: "_Scatter"

    def widened(self, adjusted: SiteAdjustment) -> SiteAdjustment:
        """A later adjustment of the same cameras with the spread of the rivals and the scatter of halves.

        Parameters
        ----------
        adjusted
            Adjustment to more than `adjusted` was.
        """
        return self.scatter.added_to(_spread(adjusted, self.rivals))


def weigh_hypotheses(session: Session, hypotheses: Sequence[Hypothesis], adjust: Adjust) -> Weighed:
    """The cameras that agree best with everything measured on site, of all that the images allow.

    Parameters
    ----------
    session
        Measurement session.
    hypotheses
        Cameras with their matches, the most probable first.
    adjust
        Adjustment of cameras to the site.
    """
    solved = [(one, adjust(one)) for one in hypotheses]
    if _is_nearly_affine(hypotheses[0]):
        solved += [(one, adjust(one)) for one in _other_starts(hypotheses[0])]
    solved = [(one, found) for one, found in solved if _fits(session, one, found)] or solved[:1]
    if len(hypotheses) == 1:
        solved.sort(key=lambda pair: pair[1].cost)
    best, adjusted = solved[0]
    rivals: list[SiteAdjustment] = []
    for one, found in solved[1:]:
        # Costs compare where the matches are the same.
        worse = one.matches is best.matches and found.cost - adjusted.cost > _RIVAL_COST
        if not worse and all(_turn(found, other) > _SAME_RAD for other in (adjusted, *rivals)):
            rivals.append(found)
    scatter = _compare_halves(adjusted, [(adjust(half), adjust(rest)) for half, rest in best.halves])
    return Weighed(best, _spread(adjusted, rivals), tuple(rivals), scatter)


def _is_nearly_affine(one: Hypothesis) -> bool:
    """Whether two narrow views are related by their matches alone, which the face does not place."""
    if len(one.rig) != 2 or not one.matches or any(m.on_face.any() for m in one.matches):
        return False
    covariance = one.rig.covariance
    if covariance is None or not np.diag(covariance)[-6:].all():
        return False
    # A lens of which little is known may be narrower than it is taken for.
    relative_std = np.sqrt(np.diag(covariance)[:: len(CAMERA_PARAMETERS)])
    focal_px = [c.focal_px * np.exp(_LONGER * std) for c, std in zip(one.rig.cameras, relative_std, strict=True)]
    views = [2 * np.arctan(max(c.image_size) / 2 / f) for c, f in zip(one.rig.cameras, focal_px, strict=True)]
    return bool(max(views) < _NARROW_RAD)


def _other_starts(one: Hypothesis) -> Iterator[Hypothesis]:
    """The same matches with the second camera elsewhere on its circle, turned so as to look at the same place."""
    first, second = one.rig.cameras
    m = one.matches[0]
    points3d = triangulate(np.stack([m.points_first, m.points_second]), one.rig)
    ahead = in_front_of_all(points3d, one.rig)
    if not ahead.any():
        return
    middle = np.median(points3d[ahead], axis=0)
    for angle in _TURNS:
        centre = Rotation.from_rotvec([0.0, angle, 0.0]).apply(second.center)
        sight = [second.rotation @ _unit(middle - c) for c in (second.center, centre)]
        turn, _ = Rotation.align_vectors(sight[0][None], sight[1][None])
        rotation = turn.as_matrix() @ second.rotation
        moved = replace(second, cam_from_world=np.column_stack([rotation, -rotation @ centre]))
        rig = Rig(one.rig.names, (first, moved), one.rig.metric, one.rig.covariance)
        yield replace(one, rig=rig)


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _fits(session: Session, one: Hypothesis, found: SiteAdjustment) -> bool:
    """Whether nothing that was measured or seen excludes a solution."""
    if list_behind(found.rig, one.matches):
        return False
    if any(q.deviation > _CONTRADICTED for q in found.quantities):
        return False
    for view in session.view[1:]:
        aside = found.rig.camera(view.name).center[0]
        if view.stands is not None and (aside > 0) != (view.stands == "right"):
            return False
    return True


def list_behind(rig: Rig, matches: Sequence[Matches]) -> list[str]:
    """Sentences on pairs of views whose matches for the most part do not lie in front of both cameras.

    Parameters
    ----------
    rig
        Adjusted cameras of V views.
    matches
        Matches between its views [px].

    Notes
    -----
    With the baseline reversed, or with one camera turned about it by half a turn, the epipolar lines are the same: no
    epipolar error tells such cameras from the true ones.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> left = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> right = Camera(left.K, (1280, 720), cam_from_world=np.array([[1.0, 0, 0, 4], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right), metric=True)
    >>> list_behind(rig, [Matches(0, 1, [[800.0, 440.0]], [[160.0, 440.0]])])[0].partition(";")[0]
    "1 of 1 matches of 'left' and 'right' do not lie in front of both cameras"
    """
    found = []
    for m in matches:
        pair = Rig(("first", "second"), (rig.cameras[m.first], rig.cameras[m.second]))
        ahead = in_front_of_all(triangulate(np.stack([m.points_first, m.points_second]), pair), pair)
        if len(m) and ahead.mean() < _AHEAD:
            found.append(
                f"{np.sum(~ahead)} of {len(m)} matches of {rig.names[m.first]!r} and {rig.names[m.second]!r} do not "
                "lie in front of both cameras; use another camera estimator"
            )
    return found


def list_turned(prior: Rig, adjusted: Rig) -> list[str]:
    """Sentences on cameras that the adjustment turned by more than the prior of their rotations lets expect.

    Parameters
    ----------
    prior
        Cameras of V views with their prior covariance; rotations that are free or held fixed are not compared.
    adjusted
        The same cameras after the adjustment.

    Notes
    -----
    Of a rotation whose three parts have the stated standard deviation, one in 60,000 turns further than five of them.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> camera = Camera(np.array([[4000.0, 0, 640], [0, 4000, 360], [0, 0, 1]]), (1280, 720))
    >>> stds = np.array([0.05, 0, 0, 0, 0.03, 0.03, 0.03, 0.1, 0.1, 0.1])
    >>> prior = Rig(("left", "right"), (camera, camera), True, np.diag([*0 * stds, *stds**2]))
    >>> turned = camera.perturbed([0, 0, 0, 0, 0, 0.3, 0, 0, 0, 0])
    >>> list_turned(prior, Rig(prior.names, (camera, turned), True))[0].partition(",")[0]
    "'right' is turned by 17.2 degrees from where its estimator put it"
    """
    found = []
    stds = np.sqrt(np.diag(np.asarray(prior.covariance))).reshape(len(prior), -1)[:, _ROTATION]
    for name, before, after, std in zip(prior.names, prior.cameras, adjusted.cameras, stds, strict=True):
        turn, most = before.turn_to(after), _MOST_TURNED * float(std.max())
        if std.min() > 0 and std.max() < FREE_STD and turn > most:
            found.append(
                f"{name!r} is turned by {np.degrees(turn):.1f} degrees from where its estimator put it, which states "
                f"{np.degrees(std.max()):.1f}; use another camera estimator"
            )
    return found


def _turn(one: SiteAdjustment, other: SiteAdjustment) -> float:
    """Largest angle between the cameras of two solutions [rad]."""
    pairs = zip(one.rig.cameras, other.rig.cameras, strict=True)
    return max(a.turn_to(b) for a, b in pairs)


def _spread(adjusted: SiteAdjustment, rivals: Sequence[SiteAdjustment]) -> SiteAdjustment:
    """The adjustment with rivals in its covariance, as a mixture of normal distributions, and named."""
    if not rivals or adjusted.rig.covariance is None:
        return adjusted
    least = min(one.cost for one in (adjusted, *rivals))
    weights = np.exp(-np.minimum(np.array([one.cost - least for one in (adjusted, *rivals)]), _RIVAL_COST) / 2)
    weights /= weights.sum()
    covariance = weights[0] * adjusted.covariance
    for weight, rival in zip(weights[1:], rivals, strict=True):
        away = _compare(rival, adjusted)
        covariance = covariance + weight * (rival.covariance + np.outer(away, away))
    own = tuple(replace(one, factor=np.sqrt(weights[0]) * one.factor) for one in adjusted.contributions)
    widened = replace(_with_covariance(adjusted, covariance), contributions=own)
    notes = (*adjusted.notes, *(_describe(adjusted, rival) for rival in rivals))
    status = CameraStatus.SEVERAL if adjusted.status == CameraStatus.OK else adjusted.status
    return replace(widened, status=status, notes=notes)


def _compare(one: SiteAdjustment, other: SiteAdjustment) -> FloatArray:
    """Difference of two solutions in the order and units of their joint covariance."""
    away = np.zeros(len(one.covariance))
    away[:-3] = compare_rigs(one.rig, other.rig)
    if one.frame is not None and other.frame is not None:
        away[-3:] = Rotation.from_matrix(one.frame.rotation @ other.frame.rotation.T).as_rotvec()
    return away


def _with_covariance(adjusted: SiteAdjustment, covariance: FloatArray) -> SiteAdjustment:
    count = len(covariance) - 3
    frame = adjusted.frame and StructureFrame(adjusted.frame.rotation, covariance[count:, count:])
    rig = replace(adjusted.rig, covariance=covariance[:count, :count])
    return replace(adjusted, rig=rig, frame=frame, covariance=covariance)


@dataclass(frozen=True, eq=False)
class _Scatter:
    """Scatter of a solution that its stated covariance leaves out, and what to say where chance decides."""

    covariance: FloatArray
    note: str = ""

    def added_to(self, adjusted: SiteAdjustment) -> SiteAdjustment:
        """An adjustment with the scatter in its covariance, and named where chance decides."""
        if adjusted.rig.covariance is None or not self.covariance.any():
            return adjusted
        widened = _with_covariance(adjusted, adjusted.covariance + self.covariance)
        if not self.note:
            return widened
        status = CameraStatus.NOT_CLEAR if adjusted.status == CameraStatus.OK else adjusted.status
        return replace(widened, status=status, notes=(*adjusted.notes, self.note))


def _compare_halves(adjusted: SiteAdjustment, halves: Sequence[tuple[SiteAdjustment, SiteAdjustment]]) -> _Scatter:
    """What halves of the matches tell of the scatter of a solution.

    The estimates from two independent halves of the data differ by twice the standard deviation of the estimate from
    all of them (half-samples [1]_). The covariance of a least-squares adjustment takes the matches for right; which of
    them agree, and so the pose, may be chance.

    References
    ----------
    .. [1] McCarthy, P. J. (1969). Pseudo-replication: half samples. Review of the International Statistical Institute
       37(3), 239-264.
    """
    nothing = np.zeros_like(adjusted.covariance)
    if not halves:
        return _Scatter(nothing)
    apart = np.stack([_compare(one, other) / 2 for one, other in halves])
    size = len(CAMERA_PARAMETERS)
    turned = np.concatenate([np.arange(start + 4, start + 7) for start in range(size, size * len(adjusted.rig), size)])
    stated = np.linalg.pinv(adjusted.covariance[np.ix_(turned, turned)], hermitian=True)
    turns = apart[:, turned]
    square = float(np.einsum("hi,ij,hj->", turns, stated, turns) / turns.size)
    if square <= 1:
        return _Scatter(nothing)
    # What the stated covariance explains already is no news.
    covariance = (1 - 1 / square) * apart.T @ apart / len(apart)
    if square <= _BY_CHANCE**2:
        return _Scatter(covariance)
    turn = np.degrees(max(_turn(one, other) for one, other in halves))
    note = (
        f"halves of the matches give cameras that differ by up to {turn:.1f} degrees, {np.sqrt(square):.0f} times as "
        "much as they should: which matches agree is chance; name five points in both views (pixel_in), measure both "
        "distances of the face, or use a learned matcher"
    )
    return _Scatter(covariance, note)


def _describe(adjusted: SiteAdjustment, rival: SiteAdjustment) -> str:
    """A sentence on another solution, and on the reading that would decide."""
    turn = np.degrees(_turn(adjusted, rival))
    clearest, best = "", 0.0
    for view in adjusted.rig.names[1:]:
        for what, (std, unit) in _READINGS.items():
            here, there = (_predict(one, view, what) for one in (adjusted, rival))
            if np.isfinite(here) and np.isfinite(there) and abs(here - there) / std > best:
                best = abs(here - there) / std
                clearest = f"{what} of view {view!r} would decide: {here:.2f} or {there:.2f} {unit}"
        sides = ["right" if one.rig.camera(view).center[0] > 0 else "left" for one in (adjusted, rival)]
        if sides[0] != sides[1]:
            clearest, best = f'stands of view {view!r} would decide: "{sides[0]}" or "{sides[1]}"', np.inf
    return f"other cameras, turned by {turn:.1f} degrees, agree as well; {clearest or 'a range from the other camera'}"


def _predict(one: SiteAdjustment, view: str, what: str) -> float:
    """Value of a possible reading at a further camera; NaN where it has no meaning."""
    camera = one.rig.camera(view)
    if what == "pitch":
        return float(np.degrees(np.arcsin(-camera.rotation[2, 1])))
    across = {q.name: q.value for q in one.quantities}.get("perpendicular distance")
    if one.frame is None or across is None:
        return float("nan")
    left = across - float(one.frame.rotation[0] @ camera.center)
    ray = one.frame.rotation @ camera.rotation.T @ np.array([0.0, 0.0, 1.0])
    return left if what == "perpendicular distance" else float(abs(left * ray[2] / ray[0]))
