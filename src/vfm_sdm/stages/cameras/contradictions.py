"""The most probable culprit of a contradiction: what was stated, read in every other way and solved anew.

Linear tests at a solution that a wrong statement has bent hardly tell which one it was: the noise of the matches was
taken from a pose that fits none of them, and a lens that is 30 % off is no small step. So statements are left out in
turn and simple confusions undone, each with poses of its own, and what agrees best with everything else is named.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import Lens
from vfm_sdm.stages.cameras.confusions import Statements, list_confusions, with_poses
from vfm_sdm.stages.cameras.culprits import AS_PROBABLE, CULPRIT_STD, Claim, Suspect, advise_on_lens, list_suspects
from vfm_sdm.stages.cameras.match_cells import MatchNoise
from vfm_sdm.stages.cameras.relative_pose import estimate_relative_pose
from vfm_sdm.stages.cameras.site import SiteAdjustment, adjust_to_site
from vfm_sdm.stages.cameras.site_minimum import minimize_residuals, minimize_weighed
from vfm_sdm.stages.cameras.site_problem import SiteProblem

__all__ = ["explain_contradiction"]

_GRID = np.linspace(-0.5, 0.5, 11)
"""Logarithms of what a focal length may be wrong by, for starts: crop factors and formats lie between."""
_READINGS = 4
"""Readings and named points that are left out in turn, the most suspicious ones."""
_ANYWHERE_PX = 50.0
_FAR_COST = 60.0
"""Cost above the least one from which an alternative is not looked into, before its relief is weighed."""
_SAME_RAD = np.radians(3)
"""Angle within which two poses lead to one minimum."""
_TOLERANCE = 1e-4
_TRIAL_STEPS, _STEPS = 25, 40
_RANSAC_STEPS = 1000
"""Half of the matches may be wrong: 145 samples of five hold a right one in 99 of 100 cases."""
_PER_VALUE = 4.0
"""Cost of each value that is left open: the logarithm of about sixty independent observations."""


@dataclass(frozen=True, eq=False)
class _Alternative:
    """What may be wrong, and where its adjustment starts.

    Parameters
    ----------
    name
        What would be wrong; empty for the statements as they are.
    values
        Number of values that are left open.
    read, z
        Statements as they would be meant, and whitened parameters to start from, shape (M,).
    claim
        What is left out, if it has one value.
    advice
        What was expected, what is stated and what to do, of a confusion.
    left_out
        Part of the cost that falls away with the residuals that are left out, whatever they are [1].
    """

    name: str
    values: int
    read: Statements
    z: FloatArray | None = None
    claim: Claim | None = None
    advice: str = ""
    left_out: float = 0.0


@dataclass(frozen=True, eq=False)
class _Solved:
    alternative: _Alternative
    problem: SiteProblem
    solution: OptimizeResult
    cost: float

    @property
    def score(self) -> float:
        return self.cost + _PER_VALUE * self.alternative.values


def explain_contradiction(
    stated: Statements, adjusted: SiteAdjustment, lenses: Mapping[str, Lens | None] | None = None
) -> SiteAdjustment:
    """An adjustment with what is most probably wrong, where statements contradict each other.

    Parameters
    ----------
    stated
        Everything that was stated.
    adjusted
        Its adjustment.
    lenses
        What the session says of the lens of each view.

    Returns
    -------
    explained
        The adjustment itself where nothing contradicts. Else with suspects and a sentence on them; adjusted anew from
        poses that fit the matches where it did not converge.

    Notes
    -----
    All alternatives are solved with the least noise of matches that one of them leaves: what the features do is the
    same in all of them, and only wrong cameras make it larger. Costs compare with that of the statements as they are;
    each value that an alternative leaves open has to lower it by the logarithm of the number of observations [1]_.

    References
    ----------
    .. [1] Schwarz, G. (1978). Estimating the dimension of a model. Annals of Statistics 6(2), 461-464.
    """
    if not adjusted.suspects and adjusted.status not in (CameraStatus.NOT_CONVERGED, CameraStatus.DISAGREE):
        return adjusted
    stated = replace(stated, rig=with_poses(stated.rig, adjusted.rig))
    base, solved = _solve_all(stated)
    explained = bool(solved) and base.cost - solved[0].score >= CULPRIT_STD**2
    if adjusted.status == CameraStatus.NOT_CONVERGED or not explained:
        # Either the pose is a minimum that fits nothing, or what contradicts there agrees from another pose.
        rig = with_poses(stated.rig, base.problem.rig(base.solution.x))
        again = adjust_to_site(rig, stated.matches, stated.site, stated.points, readings=stated.readings)
        if again.status != CameraStatus.NOT_CONVERGED and (explained or not again.suspects):
            adjusted = again
    if not explained:
        return adjusted
    named = [_suspect(one, base, lenses or {}) for one in solved if one.score < solved[0].score + AS_PROBABLE]
    before = [one.sentence(adjusted.suspects[1:]) for one in adjusted.suspects[:1]]
    notes = [note for note in adjusted.notes if note not in before]
    return replace(adjusted, suspects=tuple(named), notes=(*notes, named[0].sentence(named[1:])))


def _solve_all(stated: Statements) -> tuple[_Solved, list[_Solved]]:
    """The statements as they are, and the alternatives, the best first, all with one noise of the matches."""
    poses = _Poses()
    lenses = [_try(one) for one in _list_lenses(stated, poses)]
    starts = list(_list_starts(stated, lenses, poses))
    as_stated = [_try(_Alternative("", 0, one)) for one in starts]
    noise = min((one.problem.noise for one in (*lenses, *as_stated)), key=lambda one: one.shared_px)
    base = min((_solve(one, noise) for one in as_stated), key=lambda one: (not one.solution.success, one.cost))
    solved = [base, *(_solve(one, noise) for one in lenses)]
    least = min(one.score for one in solved)
    claims = _list_suspicious(base)
    for start in starts:
        others = [_without_claim(start, claim, base) for claim in claims]
        others += [_Alternative(one.name, 0, one.read, advice=one.advice) for one in list_confusions(start)]
        trials = [_try(one, noise) for one in others]
        solved += [_solve(one, noise) for one in trials if one.cost < least + _FAR_COST]
    least_of: dict[str, _Solved] = {}
    for one in sorted(solved[1:], key=lambda one: one.score):
        least_of.setdefault(one.alternative.name, one)
    return base, list(least_of.values())


def _suspect(one: _Solved, base: _Solved, lenses: Mapping[str, Lens | None]) -> Suspect:
    """What is said of an alternative."""
    alternative, rank = one.alternative, max(base.cost - one.cost, 0.0)
    drop, unknown = float(np.sqrt(rank)), float("nan")
    claim = alternative.claim
    if claim is None:
        return Suspect(alternative.name, "", unknown, unknown, unknown, drop, rank, alternative.advice)
    residuals = one.problem.residuals(one.solution.x)
    error = float(np.linalg.lstsq(claim.rows, residuals, rcond=None)[0][0])
    checked = list_suspects([claim], residuals, one.problem.jacobian(one.solution.x))
    std = checked[0].freed_std if checked else unknown
    found = Suspect(claim.name, claim.units, claim.stated, claim.freed(error), std, drop, rank)
    said = lenses.get(claim.name.removeprefix("focal "), next(iter(lenses.values()), None))
    return replace(found, advice=advise_on_lens(found, said)) if claim.name.startswith("focal") else found


def _list_lenses(stated: Statements, poses: "_Poses") -> Iterator[_Alternative]:
    """The statements without each lens, and without all, at the pose and focal length that most matches fit."""
    problem = _problem(stated)
    for claim in problem.claims(_count(problem)):
        if not claim.name.startswith("focal"):
            continue
        starts = [(0.0, stated.rig, np.zeros(problem.size))]
        if stated.free_poses:
            away = [claim.rows[: problem.size, 0] * step / claim.std for step in _GRID]
            starts = [(*poses.find(stated, problem.rig(z)), z) for z in away]
        _, rig, z = min(starts, key=lambda one: one[0])
        yield _Alternative(claim.name, 1, replace(stated, rig=with_poses(stated.rig, rig)), z, claim)


def _list_starts(stated: Statements, lenses: Sequence[_Solved], poses: "_Poses") -> Iterator[Statements]:
    """The statements at different poses: as adjusted, as matches alone give them, and as they are without a lens."""
    yield stated
    if not stated.free_poses:
        return
    known = [stated.rig.cameras[1]]
    rigs = [poses.find(stated, stated.rig)[1]]
    if lenses:
        best = min(lenses, key=lambda one: one.cost)
        rigs.append(best.problem.rig(best.solution.x))
    for rig in rigs:
        if all(rig.cameras[1].turn_to(one) > _SAME_RAD for one in known):
            known.append(rig.cameras[1])
            yield replace(stated, rig=with_poses(stated.rig, rig))


def _list_suspicious(base: _Solved) -> list[Claim]:
    """Readings and named points that the linear test finds most suspicious."""
    problem, z = base.problem, base.solution.x
    claims = {one.name: one for one in problem.claims(_count(problem)) if not one.name.startswith("focal")}
    found = list_suspects(claims.values(), problem.residuals(z), problem.jacobian(z))
    return [claims[one.name] for one in found[:_READINGS]]


def _without_claim(read: Statements, claim: Claim, base: _Solved) -> _Alternative:
    """The statements without a reading, or with a named point anywhere."""
    z = base.solution.x if read is base.alternative.read else None
    points = {name: one for name, one in read.points.items() if claim.name == f"point {name!r}"}
    if not points:
        return _Alternative(claim.name, 1, read, z, claim)
    spread = sum(base.problem.log_spread_of(name) for name in points)
    loose = {name: replace(one, std_px=_ANYWHERE_PX, on_face=False) for name, one in points.items()}
    return _Alternative(claim.name, 2, replace(read, points={**read.points, **loose}), z, left_out=spread)


def _problem(stated: Statements) -> SiteProblem:
    return SiteProblem(stated.rig, stated.matches, stated.site, stated.points, readings=stated.readings)


def _count(problem: SiteProblem) -> int:
    return len(problem.residuals(np.zeros(problem.size)))


class _Poses:
    """Relative poses of two views from their matches, each found once."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, bytes], tuple[FloatArray, float]] = {}

    def find(self, stated: Statements, rig: Rig) -> tuple[float, Rig]:
        """Median epipolar error [px], and the rig at the pose that its lenses give."""
        lenses = [replace(c, cam_from_world=np.eye(3, 4)) for c in rig.cameras]
        first = np.concatenate([m.points_first if m.first == 0 else m.points_second for m in stated.matches])
        second = np.concatenate([m.points_second if m.first == 0 else m.points_first for m in stated.matches])
        key = (hash(first.tobytes()), np.array([c.K for c in lenses]).tobytes())
        if key not in self._found:
            self._found[key] = _find_pose(first, second, (lenses[0], lenses[1]))
        pose, error = self._found[key]
        if not np.isfinite(error):
            return error, rig
        length = stated.rig.baseline() if stated.site.baseline is None else stated.site.baseline.value
        moved = replace(lenses[1], cam_from_world=pose * np.array([1.0, 1.0, 1.0, length]))
        return error, replace(rig, cameras=(lenses[0], moved))


def _find_pose(first: FloatArray, second: FloatArray, lenses: tuple[Camera, Camera]) -> tuple[FloatArray, float]:
    """Relative pose (3, 4) of matches (N, 2) [px], and their median error [px]; infinite where there is none."""
    pose, agree = estimate_relative_pose(first, second, *lenses, most_iterations=_RANSAC_STEPS)
    if not agree.any():
        return pose, np.inf
    pair = Rig(("first", "second"), (lenses[0], replace(lenses[1], cam_from_world=pose)))
    error = float(np.median(np.abs(sampson_error(first, second, pair))))
    return pose, error if np.isfinite(error) else np.inf


def _try(one: _Alternative, noise: MatchNoise | None = None) -> _Solved:
    """A solution without the face; with the noise of matches that follows, where it is not given."""
    problem = _problem(one.read)
    problem.noise = noise or problem.noise
    z = np.zeros(problem.size) if one.z is None or len(one.z) != problem.size else one.z
    freed = None if one.claim is None else one.claim.rows
    solution = minimize_residuals(problem, z, freed, steps=_TRIAL_STEPS, tolerance=_TOLERANCE)
    if noise is None:
        problem.weigh_matches(solution.x)
    return _Solved(one, problem, solution, 2 * float(solution.cost))


def _solve(trial: _Solved, noise: MatchNoise) -> _Solved:
    """The minimum from a trial, with a given noise of the matches."""
    problem, claim = trial.problem, trial.alternative.claim
    freed = None if claim is None else claim.rows
    problem.noise = noise
    solution = trial.solution
    for _ in range(2):
        solution, cost = minimize_weighed(problem, solution.x, freed, steps=_STEPS, tolerance=_TOLERANCE)
    cost += trial.alternative.left_out
    return _Solved(trial.alternative, problem, solution, cost if np.isfinite(cost) else np.inf)
