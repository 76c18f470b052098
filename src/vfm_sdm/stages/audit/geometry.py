"""Checks of cameras and scale: measurements on site against the adjustment, and the views against each other."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.covariances import find_edges
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import CameraStatus, Outcome
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.stages.audit.model import NOISE_TRUST, AuditCheck, AuditInputs, Limits, judge
from vfm_sdm.stages.cameras.site import SiteQuantity

__all__ = ["check_agreement", "check_baseline", "check_epipolar_level", "check_epipolar_motion", "check_site"]

_LEAST_REDUNDANCY = 0.01
"""Share of a quantity's variance that the other data take away, below which there is nothing to compare it with."""
_W_CAUTION, _W_FAIL = 4.0, 6.0
"""Standardised differences; by chance one of 15 quantities exceeds the first in one run of a thousand."""
_DETECTABLE = 4.0
"""Error that is found in four of five cases by a test that false alarms pass in 1 of 1000, in standard deviations."""
_BLIND = 0.05
"""Relative error of the baseline that may stay unseen without a warning [1]."""
_LEVEL_CAUTION, _LEVEL_FAIL = 1e-3, 4e-3
"""Distance from the epipolar lines, as shares of the image's width."""
_RATIO_CAUTION, _RATIO_FAIL = 0.1, 0.3
"""Shares of the motion that one view shows and the other does not."""
_GAIN_CAUTION, _GAIN_FAIL = 0.05, 0.2
_BASELINE = "baseline"
_NO_SCALE = (
    *(CameraStatus.NOT_CONVERGED, CameraStatus.NOT_IDENTIFIABLE),
    *(CameraStatus.UNKNOWN_DISTANCE, CameraStatus.BEHIND),
)
"""Cameras that measure nothing."""


def check_site(inputs: AuditInputs) -> AuditCheck:
    """Every prior and reading on site against its value from all the others.

    Notes
    -----
    This is Baarda's w-test [1]_: the adjusted value differs from the reading by an amount whose variance is that of the
    reading less that of the adjusted value. The value of the check is the largest of these standardised differences.

    A status that the camera estimator gave is a caution by itself: a contradiction before the adjustment need not show
    after it.

    References
    ----------
    .. [1] Baarda, W. (1968). A testing procedure for use in geodetic networks. Netherlands Geodetic Commission,
       Publications on Geodesy 2(5).
    """
    name, cameras = "site and lenses", inputs.cameras
    if cameras.status in _NO_SCALE:
        sentence = f"{cameras.status}: the displacement has no usable scale"
        return AuditCheck(name, Outcome.FAIL, float("nan"), _W_CAUTION, "std", sentence)
    tested = {q.name: _standardise(q) for q in cameras.quantities if _compute_redundancy(q) > _LEAST_REDUNDANCY}
    judged = judge(
        name,
        tested,
        Limits(_W_CAUTION, _W_FAIL, "std"),
        good="what was measured on site, the lenses and the images agree",
        bad="{} contradicts the rest; a lens, a tape reading or a point is wrong, and with it the scale",
    )
    if cameras.suspects:
        first, *others = cameras.suspects
        outcome = Outcome.FAIL if judged.outcome == Outcome.FAIL or first.drop >= _W_FAIL else Outcome.CAUTION
        said = f"{first.sentence(others)}; what was stated contradicts itself, and the scale with it"
        return replace(judged, outcome=outcome, value=first.drop, where=first.name, sentence=said)
    if cameras.status in (CameraStatus.OK, CameraStatus.DISAGREE) or judged.outcome == Outcome.FAIL:
        return judged
    return replace(judged, outcome=Outcome.CAUTION, sentence=f"{cameras.status}; the notes of the cameras say where")


def check_baseline(inputs: AuditInputs) -> AuditCheck:
    """Relative error of the baseline that the other lengths would just show [1]."""
    name = "scale by a spare length"
    for quantity in inputs.cameras.quantities:
        if quantity.name != _BASELINE:
            continue
        redundancy = _compute_redundancy(quantity)
        if redundancy > 1e-6:
            detectable = _DETECTABLE * quantity.prior_std / np.sqrt(redundancy) / quantity.prior
            if detectable <= _BLIND:
                good = f"a baseline misread by {100 * detectable:.1f} % or more would have been noticed"
                return AuditCheck(name, Outcome.PASS, float(detectable), _BLIND, "1", good, _BASELINE)
            blind = f"only a baseline wrong by {100 * detectable:.0f} % or more would be noticed"
        else:
            blind = "nothing else tells the scale, so a wrong baseline cannot be seen"
        sentence = f"{blind}. Measure the length between two points of the structure, which checks it"
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _BLIND, "1", sentence, _BASELINE)
    return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), _BLIND, "1", "no baseline was measured", _BASELINE)


def check_epipolar_level(inputs: AuditInputs) -> AuditCheck:
    """Distance of the moving points from the epipolar lines, median over time [px]: wrong point, wrong camera."""
    level = {where: float(np.nanmedian(np.abs(error))) for where, (_, _, error) in _compare_pairs(inputs).items()}
    width = float(min(camera.image_size[0] for camera in inputs.cameras.rig.cameras)) if inputs.cameras.rig else 1.0
    return judge(
        "epipolar error",
        level,
        Limits(_LEVEL_CAUTION * width, _LEVEL_FAIL * width, "px"),
        good="the views see the same points",
        bad="point '{}' is another place in another view, the views are swapped, or a camera is wrong",
    )


def check_epipolar_motion(inputs: AuditInputs) -> AuditCheck:
    """Motion of the epipolar error over time, as a share of the motion in the picture [1]."""
    motion_px = {str(view): inputs.motion_px(str(view)) for view in inputs.aligned["view"].values}
    found = {}
    for where, (point, pair, error) in _compare_pairs(inputs).items():
        known = np.isfinite(error)
        motion = float(np.fmin.reduce([motion_px[view][inputs.moving.index(point)] for view in pair]))
        if known.sum() > 2 and motion > 0:
            excess = float(np.var(error[known])) - NOISE_TRUST**2 * _compute_epipolar_variance(inputs, point, pair)
            found[where] = float(np.sqrt(max(excess, 0.0)) / motion)
    return judge(
        "epipolar error in motion",
        found,
        Limits(_RATIO_CAUTION, _RATIO_FAIL, "1"),
        good="the views see one motion",
        bad="point '{}' moves differently in two views: clocks, a track that slips, or a camera that moves",
    )


def check_agreement(inputs: AuditInputs) -> AuditCheck:
    """Difference of the vertical motion that two views alone show, of the two that differ most [1]."""
    shown = inputs.displacement.sel(point=inputs.moving)
    # Without a trusted sample (nobody knows a clock, say), views that differ tell nothing of tracks and scale.
    trusted = (shown["status"] == Status.OK).any("time")
    found = shown["gain_difference"].where(trusted).values
    known = {p: abs(float(g)) for p, g in zip(inputs.moving, found, strict=True) if np.isfinite(g)}
    return judge(
        "agreement of the views",
        known,
        Limits(_GAIN_CAUTION, _GAIN_FAIL, "1"),
        good="the views show the same vertical motion",
        bad="the views disagree about how much '{}' moves up and down; one track slips or a scale is wrong",
    )


def _standardise(quantity: SiteQuantity) -> float:
    return float(abs(quantity.value - quantity.prior) / (quantity.prior_std * np.sqrt(_compute_redundancy(quantity))))


def _compute_redundancy(quantity: SiteQuantity) -> float:
    """Share of the prior's variance that the other data took away, 0 to 1."""
    return max(0.0, 1.0 - float(quantity.std / quantity.prior_std) ** 2) if quantity.prior_std > 0 else 0.0


def _compare_pairs(inputs: AuditInputs) -> dict[str, tuple[str, tuple[str, str], FloatArray]]:
    """Moving point, two views that see it, and its epipolar error, shape (T,) [px], by what to call them.

    That is the point where there are two views, and the point in the two views where there are more.
    """
    rig = inputs.cameras.rig
    if rig is None:
        return {}
    edge = find_edges(inputs.aligned)
    # Where an edge was tracked in one view is not the place along it where it was in the other.
    whole = [p for p, of in zip(inputs.aligned["point"].values.tolist(), edge, strict=True) if not of]
    moving = [point for point in inputs.moving if point in whole]
    chosen = inputs.aligned.sel(point=moving)
    ok = (chosen["status"].values == Status.OK) | (chosen["status"].values == Status.UNRELIABLE)
    pixels = np.where(ok[..., None], chosen["position"].values, np.nan)
    found = {}
    for first, second in combinations(range(len(rig)), 2):
        errors = sampson_error(pixels[first], pixels[second], rig, first=first, second=second)
        pair = rig.names[first], rig.names[second]
        for point, error in zip(moving, errors.T, strict=True):
            if np.isfinite(error).any():
                where = point if len(rig) == 2 else f"{point} in {pair[0]} and {pair[1]}"
                found[where] = (point, pair, error)
    return found


def _compute_epipolar_variance(inputs: AuditInputs, point: str, pair: tuple[str, str]) -> float:
    """Mean variance of a point's epipolar error from its tracks' covariances [px2]."""
    covariance = inputs.aligned.sel(point=point, view=list(pair))["position_covariance"].values
    known = np.isfinite(covariance).all(axis=(0, 2, 3))
    # The error is a unit combination of all coordinates: the largest variance bounds its own.
    return float(np.linalg.eigvalsh(covariance[:, known])[..., -1].max(axis=0).mean()) if known.any() else float("nan")
