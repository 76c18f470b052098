"""Adjustment of cameras to everything measured on site: one least-squares problem, every quantity with its std.

Two views of one structure do not determine everything, above all not their focal lengths: these must come from the
lens or from lengths measured on site. Lens priors, image matches, baseline, distances, ranges, lengths and level
readings enter with their standard deviations. Quantities that are only roughly known (principal point, radial
distortion, distance of points from the face) are nuisance parameters with a prior. See
`vfm_sdm.stages.cameras.site_problem` for the observation equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.inputs.session import Readings, Site
from vfm_sdm.stages.cameras.contributions import Contribution, list_contributions
from vfm_sdm.stages.cameras.culprits import AS_PROBABLE, CULPRIT_STD, Suspect, list_suspects
from vfm_sdm.stages.cameras.site_cameras import DISTANCE
from vfm_sdm.stages.cameras.site_minimum import minimize_from_starts
from vfm_sdm.stages.cameras.site_problem import SiteProblem
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["SiteAdjustment", "SiteQuantity", "adjust_to_site", "compare_rigs"]

_DISAGREEMENT_STD = 3.0
_CONTRADICTED_STD = 5.0
"""Residual over its own standard deviation from which a reading is contradicted. Baarda's 3.3 is for observations whose
weights are known exactly; those of matches are not."""
_LEAST_REDUNDANCY = 0.01
"""Share of a reading that the others must check."""
_DETERMINED = 0.9
"""A quantity counts as determined by the data when its std is below this share of its prior std."""
_USABLE_FOCAL_STD = 0.1
_USABLE_DISTANCE_STD = 0.1


@dataclass(frozen=True)
class SiteQuantity:
    """Adjusted quantity beside its prior or measured value.

    Parameters
    ----------
    name, units
        Name and unit, for example ``focal left`` and ``px``.
    prior, prior_std
        Prior or measured value and its standard deviation [units].
    value, std
        Adjusted value and its standard deviation [units].
    measured
        Whether the quantity is a reading on site; else it is a parameter with a prior.

    Examples
    --------
    >>> baseline = SiteQuantity("baseline", "m", prior=3.0, prior_std=0.01, value=3.02, std=0.008, measured=True)
    >>> round(baseline.deviation, 3), baseline.determined
    (2.0, True)
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
        """Distance of the adjusted value from the prior [prior standard deviations]."""
        return abs(self.value - self.prior) / self.prior_std

    @property
    def contradiction(self) -> float:
        """Distance from the prior over the standard deviation of that distance [1]; 0 where nothing else tells it.

        The test of single observations of a least-squares adjustment [1]_: a reading that others hardly check moves the
        result rather than itself, and a deviation far below its own standard deviation betrays it.

        References
        ----------
        .. [1] Baarda, W. (1968). A testing procedure for use in geodetic networks. Netherlands Geodetic Commission,
           Publications on Geodesy 2(5).

        Examples
        --------
        >>> SiteQuantity("baseline", "m", prior=3.0, prior_std=0.01, value=3.006, std=0.0099).contradiction > 4
        True
        """
        redundancy = 1 - (self.std / self.prior_std) ** 2
        return self.deviation / float(np.sqrt(redundancy)) if redundancy > _LEAST_REDUNDANCY else 0.0

    @property
    def determined(self) -> bool:
        """Whether the other data reduced the standard deviation of the quantity noticeably below its prior one."""
        return self.std < _DETERMINED * self.prior_std


@dataclass(frozen=True, eq=False)
class SiteAdjustment:
    """Adjusted cameras and axes.

    Parameters
    ----------
    rig
        Adjusted cameras, metric when a length was measured, with the covariance of its parameters.
    frame
        Axes of the structure; ``None`` when neither the two distances nor edges tell them.
    covariance
        Joint covariance of the rig's parameters, in the order and units of
        `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, and of a small rotation vector of the axes [rad], shape
        (10 V + 3, 10 V + 3).
    quantities
        Adjusted quantities with prior and result.
    status
        ``ok`` or a named reason not to trust the result.
    notes
        Sentences for the summary about quantities that disagree or that the data could not determine.
    epipolar_rms_px
        Root mean square epipolar error of the matches after the adjustment [px]; NaN without matches.
    cost
        Sum of all squared residuals over their standard deviations, priors included [1].
    suspects
        What was stated and is most probably wrong, the first first; empty where nothing contradicts.
    contributions
        What every statement and kind of observation contributes to the covariance.
    """

    rig: Rig
    frame: StructureFrame | None
    covariance: FloatArray
    quantities: tuple[SiteQuantity, ...]
    status: str
    notes: tuple[str, ...]
    epipolar_rms_px: float
    cost: float
    suspects: tuple[Suspect, ...] = ()
    contributions: tuple[Contribution, ...] = ()


def adjust_to_site(
    rig: Rig,
    matches: Sequence[Matches],
    site: Site,
    points: Mapping[str, SitePoint] | None = None,
    *,
    readings: Mapping[str, Readings] | None = None,
    edges: Sequence[StraightEdges] = (),
) -> SiteAdjustment:
    """Cameras and structural axes that agree best with lens priors, matches and everything measured on site.

    Parameters
    ----------
    rig
        Start of the cameras. Its ``covariance`` is the prior of its parameters; a parameter with zero variance is held
        fixed.
    matches
        Matches between its views; may be empty.
    site
        Lengths and readings that were measured on site.
    points
        Named points in every view; ranges and lengths refer to them.
    readings
        What was read at cameras other than the reference camera, by view.
    edges
        Straight edges of each view; used where ``site.lines`` says so.

    Returns
    -------
    adjustment
        Cameras and structural axes with their joint covariance.

    Raises
    ------
    CameraError
        The rig has no prior covariance, or a range or length names a point without pixels.

    Notes
    -----
    With whitened parameters z, whose prior is a standard normal distribution, and residuals r(z) over their standard
    deviations, the adjustment minimises |z|^2 + |r(z)|^2 by a trust-region Gauss-Newton method. The covariance of z is
    (I + J'J)^-1 with J the derivative of r at the solution; it is not scaled by the residuals, and is carried to the
    parameters of the rig by central differences. Errors of matches are correlated over the image, so that thousands of
    them carry the weight of a few dozen: see `vfm_sdm.stages.cameras.site_problem.SiteProblem`.
    """
    problem = SiteProblem(rig, matches, site, points or {}, readings=readings or {}, edges=edges)
    solution = minimize_from_starts(problem)
    # Every parameter has a prior of unit weight, so the normal matrix is never singular.
    jacobian = np.asarray(solution.jac)
    whitened = np.linalg.inv(jacobian.T @ jacobian)
    rig = problem.rig(solution.x)
    derivative = _differentiate_results(problem, solution.x)
    joint = np.asarray(derivative @ whitened @ derivative.T)
    count = len(CAMERA_PARAMETERS) * len(rig)
    metric = rig.metric or site.baseline is not None
    rotation = problem.structure_rotation(solution.x)
    frame = StructureFrame(rotation, joint[count:, count:]) if problem.has_axes else None
    rig = Rig(rig.names, rig.cameras, metric, joint[:count, :count])
    quantities = _list_quantities(problem, solution.x, whitened)
    suspects = _find_culprits(problem, solution)
    status, notes = _judge(quantities, problem, suspects, bool(solution.success))
    rms = problem.epipolar_rms(solution.x)
    contributions = list_contributions(problem.sources(), jacobian, derivative @ whitened)
    cost = 2 * float(solution.cost)
    return SiteAdjustment(rig, frame, joint, quantities, status, notes, rms, cost, suspects, contributions)


def _find_culprits(problem: SiteProblem, solution: OptimizeResult) -> tuple[Suspect, ...]:
    """Claims that the others contradict, and those that are nearly as probable as the first."""
    claims = problem.claims(len(solution.fun))
    suspects = list_suspects(claims, np.asarray(solution.fun), np.asarray(solution.jac))
    if not suspects or suspects[0].drop <= CULPRIT_STD:
        return ()
    return tuple(one for one in suspects if one.rank > suspects[0].rank - AS_PROBABLE)


def _differentiate_results(problem: SiteProblem, solution: FloatArray) -> FloatArray:
    """Change of rig parameters and axes rotation with whitened parameters at the solution, by central differences."""
    centre_rig, centre_axes = problem.rig(solution), problem.structure_rotation(solution)

    def outputs(z: FloatArray) -> FloatArray:
        turn = Rotation.from_matrix(problem.structure_rotation(z) @ centre_axes.T).as_rotvec()
        return np.concatenate([compare_rigs(problem.rig(z), centre_rig), turn])

    step = 1e-3
    columns = []
    for axis in np.eye(problem.size) * step:
        columns.append((outputs(solution + axis) - outputs(solution - axis)) / (2 * step))
    return np.stack(columns, axis=1)


def compare_rigs(rig: Rig, base_rig: Rig) -> FloatArray:
    """Parameters with which `vfm_sdm.geometry.camera.Rig.perturbed` leads from one rig to the other.

    Parameters
    ----------
    rig, base_rig
        Rigs with the same views.

    Returns
    -------
    difference
        Parameters of all cameras, shape (10 V,), in the order and units of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`.

    Examples
    --------
    >>> from vfm_sdm.geometry.camera import Camera
    >>> rig = Rig(("cam1",), (Camera([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]], (640, 480)),), True)
    >>> compare_rigs(rig.perturbed([0.01, 2.0, 0, 0, 0, 0, 0, 0, 0, 0]), rig)[:4].round(3) + 0.0
    array([0.01, 2.  , 0.  , 0.  ])
    """
    parts = []
    for camera, base in zip(rig.cameras, base_rig.cameras, strict=True):
        turn = Rotation.from_matrix(camera.rotation @ base.rotation.T).as_rotvec()
        focal = np.log(camera.focal_px / base.focal_px)
        center = camera.K[:2, 2] - base.K[:2, 2]
        k1 = camera.distortion[0] - base.distortion[0]
        parts.append(np.concatenate([[focal], center, [k1], turn, camera.translation - base.translation]))
    return np.concatenate(parts)


def _list_quantities(problem: SiteProblem, solution: FloatArray, whitened: FloatArray) -> tuple[SiteQuantity, ...]:
    """Reported quantities with the standard deviation of each, by central differences."""
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


def _judge(
    quantities: tuple[SiteQuantity, ...], problem: SiteProblem, suspects: tuple[Suspect, ...], converged: bool
) -> tuple[str, tuple[str, ...]]:
    """Status and the sentences that explain it."""
    notes = list(problem.notes)
    disagreeing = [
        q for q in quantities if q.deviation > _DISAGREEMENT_STD or (q.measured and q.contradiction > _CONTRADICTED_STD)
    ]
    notes += [
        f"{q.name}: expected {q.prior:.6g} +- {q.prior_std:.2g} {q.units}, the adjustment gives {q.value:.6g} "
        f"({max(q.deviation, q.contradiction):.1f} standard deviations away)"
        for q in disagreeing
    ]
    if suspects:
        notes.append(suspects[0].sentence(suspects[1:]))
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
    if disagreeing or suspects:
        return CameraStatus.DISAGREE, tuple(notes)
    return CameraStatus.OK, tuple(notes)
