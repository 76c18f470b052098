"""Adjustment of cameras to everything measured on site: one least-squares problem, every quantity with its std.

What two views of one spot cannot tell (their focal lengths above all) must come from the lens or from the tape.
Lens priors, image matches, baseline, distances, ranges, lengths and level readings enter with their standard
deviations; what is not modelled (principal point, radial distortion, how far points lie off the face) is a nuisance
parameter with a prior. See `vfm_sdm.stages.cameras.site_problem` for the observation equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.inputs.session import Site
from vfm_sdm.stages.cameras.site_problem import DISTANCE, SiteProblem
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["SiteAdjustment", "SiteQuantity", "adjust_to_site"]

_DISAGREEMENT_STD = 3.0
_DETERMINED = 0.9
"""A quantity counts as determined by the data when its std fell below this share of its prior std."""
_USABLE_FOCAL_STD = 0.1
_USABLE_DISTANCE_STD = 0.1


@dataclass(frozen=True)
class SiteQuantity:
    """One adjusted quantity beside what was known of it before.

    Parameters
    ----------
    name, units
        For example ``focal left`` in ``px``.
    prior, prior_std
        Prior or measured value and its standard deviation.
    value, std
        Adjusted value and its standard deviation.
    measured
        Whether it is a reading on site; else a parameter with a prior.
    """

    name: str
    units: str
    prior: float
    prior_std: float
    value: float
    std: float
    measured: bool = False

    @property
    def deviation(self) -> float:
        """Distance of the adjusted value from the prior, in prior standard deviations."""
        return abs(self.value - self.prior) / self.prior_std

    @property
    def determined(self) -> bool:
        """Whether the other data say more about the quantity than its own prior does."""
        return self.std < _DETERMINED * self.prior_std


@dataclass(frozen=True, eq=False)
class SiteAdjustment:
    """Adjusted cameras and axes.

    Parameters
    ----------
    rig
        Adjusted rig, metric when a length was measured, with the covariance of its parameters.
    frame
        The structure's axes; ``None`` when the two distances were not measured.
    covariance
        Joint covariance of the rig's parameters and of a small rotation vector of the axes,
        shape (10 V + 3, 10 V + 3).
    quantities
        What was adjusted, with prior and result.
    status
        ``ok`` or a named reason not to trust the result.
    notes
        Sentences for the summary: what disagrees, what the data could not determine.
    epipolar_rms_px
        Root mean square epipolar error of the matches after the adjustment [px]; NaN without matches.
    """

    rig: Rig
    frame: StructureFrame | None
    covariance: FloatArray
    quantities: tuple[SiteQuantity, ...]
    status: str
    notes: tuple[str, ...]
    epipolar_rms_px: float


def adjust_to_site(
    rig: Rig,
    matches: Sequence[Matches],
    site: Site,
    points: Mapping[str, FloatArray] | None = None,
    *,
    face_points: frozenset[str] = frozenset(),
    levels: Mapping[str, tuple[float, float, float]] | None = None,
) -> SiteAdjustment:
    """Cameras and structural axes that agree best with lens priors, matches and everything measured on site.

    Parameters
    ----------
    rig
        Its ``covariance`` is the prior of its parameters; a parameter with zero variance is held fixed.
    matches
        Matches between its views; may be empty.
    site
        What was measured on site.
    points
        Named points' pixels, shape (V, 2) each, NaN where one of more than two views does not see a point; ranges and
        lengths refer to them.
    face_points
        Names of those points that lie on the structure's face, whose perpendicular distance was measured.
    levels
        Pitch, roll and their standard deviation [rad] of views other than the reference.

    Raises
    ------
    CameraError
        The rig has no prior covariance, or a range or length names a point without pixels.

    Notes
    -----
    Gauss-Markov model with priors, solved in whitened parameters by a trust-region Gauss-Newton method; the
    covariance is the inverse normal matrix at the solution, not rescaled by the residuals. Matches have errors that
    are correlated over the image, so that thousands of them carry the weight of a few dozen: see `SiteProblem`.
    """
    problem = SiteProblem(rig, matches, site, points or {}, face_points=face_points, levels=levels or {})
    solution = _solve(problem, np.zeros(problem.size))
    if problem.cell_rms(solution.x) > problem.match_std_px:
        # The camera model leaves out more than was allowed for: the matches get the weight that they deserve.
        problem.match_std_px = problem.cell_rms(solution.x)
        solution = _solve(problem, solution.x)
    # Every parameter has a prior of unit weight, so the normal matrix is never singular.
    jacobian = np.asarray(solution.jac)
    whitened = np.linalg.inv(jacobian.T @ jacobian)
    rig = problem.rig(solution.x)
    joint = _joint_covariance(problem, solution.x, whitened)
    count = len(CAMERA_PARAMETERS) * len(rig)
    metric = rig.metric or site.baseline is not None
    rotation = problem.structure_rotation(solution.x)
    frame = StructureFrame(rotation, joint[count:, count:]) if problem.has_axes else None
    rig = Rig(rig.names, rig.cameras, metric, joint[:count, :count])
    quantities = _quantities(problem, solution.x, whitened)
    status, notes = _verdict(quantities, problem, bool(solution.success))
    return SiteAdjustment(rig, frame, joint, quantities, status, notes, problem.epipolar_rms(solution.x))


def _solve(problem: SiteProblem, start: FloatArray) -> OptimizeResult:
    return least_squares(problem.residuals, start, jac=problem.jacobian, xtol=1e-7, ftol=1e-7, max_nfev=100)


def _joint_covariance(problem: SiteProblem, solution: FloatArray, whitened: FloatArray) -> FloatArray:
    """Covariance of rig parameters and axes rotation, relative to the solution, by central differences."""
    centre_rig, centre_axes = problem.rig(solution), problem.structure_rotation(solution)

    def outputs(z: FloatArray) -> FloatArray:
        turn = Rotation.from_matrix(problem.structure_rotation(z) @ centre_axes.T).as_rotvec()
        return np.concatenate([rig_difference(problem.rig(z), centre_rig), turn])

    step = 1e-3
    columns = []
    for axis in np.eye(problem.size) * step:
        columns.append((outputs(solution + axis) - outputs(solution - axis)) / (2 * step))
    jacobian = np.stack(columns, axis=1)
    return np.asarray(jacobian @ whitened @ jacobian.T)


def rig_difference(rig: Rig, reference: Rig) -> FloatArray:
    """Parameters that `Rig.perturbed` needs to lead from the reference to the rig, shape (10 V,)."""
    parts = []
    for camera, base in zip(rig.cameras, reference.cameras, strict=True):
        turn = Rotation.from_matrix(camera.rotation @ base.rotation.T).as_rotvec()
        focal = np.log(camera.focal_px / base.focal_px)
        center = camera.K[:2, 2] - base.K[:2, 2]
        k1 = camera.distortion[0] - base.distortion[0]
        parts.append(np.concatenate([[focal], center, [k1], turn, camera.translation - base.translation]))
    return np.concatenate(parts)


def _quantities(problem: SiteProblem, solution: FloatArray, whitened: FloatArray) -> tuple[SiteQuantity, ...]:
    """The reported quantities with the std of each, by central differences."""
    named = problem.quantities(solution)
    step = 1e-3
    gradients = np.stack(
        [
            [
                (up.value - down.value) / (2 * step)
                for up, down in zip(
                    problem.quantities(solution + axis), problem.quantities(solution - axis), strict=True
                )
            ]
            for axis in np.eye(problem.size) * step
        ],
        axis=1,
    )
    stds = np.sqrt(np.einsum("qi,ij,qj->q", gradients, whitened, gradients))
    return tuple(
        SiteQuantity(q.name, q.units, q.prior, q.prior_std, q.value, float(std), q.measured)
        for q, std in zip(named, stds, strict=True)
    )


def _verdict(
    quantities: tuple[SiteQuantity, ...], problem: SiteProblem, converged: bool
) -> tuple[str, tuple[str, ...]]:
    """Status and the sentences that explain it."""
    notes = list(problem.notes)
    disagreeing = [q for q in quantities if q.deviation > _DISAGREEMENT_STD]
    notes += [
        f"{q.name}: expected {q.prior:.6g} +- {q.prior_std:.2g} {q.units}, the adjustment gives {q.value:.6g} "
        f"({q.deviation:.1f} standard deviations away)"
        for q in disagreeing
    ]
    undetermined = [q.name for q in quantities if not (q.determined or q.measured)]
    if undetermined:
        notes.append(f"not determined by the other data, rests on its prior alone: {', '.join(undetermined)}")
    unusable = [q for q in quantities if q.name.startswith("focal") and q.std > _USABLE_FOCAL_STD * q.value]
    notes += [
        f"{q.name}: known to {100 * q.std / q.value:.0f} % only; state the lens, or measure a range to a point"
        for q in unusable
    ]
    unplaced = [q for q in quantities if q.name.startswith(DISTANCE) and q.std > _USABLE_DISTANCE_STD * q.value]
    notes += [
        f"{q.name}: known to {100 * q.std / q.value:.0f} % only; choose views that overlap more, so that three see the "
        "same points"
        for q in unplaced
    ]
    if not converged:
        return CameraStatus.NOT_CONVERGED, tuple(notes)
    if unusable:
        return CameraStatus.NOT_IDENTIFIABLE, tuple(notes)
    if unplaced:
        return CameraStatus.UNKNOWN_DISTANCE, tuple(notes)
    return (CameraStatus.DISAGREE if disagreeing else CameraStatus.OK), tuple(notes)
