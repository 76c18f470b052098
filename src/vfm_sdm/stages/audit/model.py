"""Results of an audit: checks, each with a value and a sentence, and the verdict that follows from them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar, cast

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray, mean_of_known
from vfm_sdm.core.covariances import edges_across, measured_variance
from vfm_sdm.core.grids import grid_points
from vfm_sdm.core.statuses import Outcome, PointStatus, Verdict
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit.scale_budget import ScaleBudget, weigh_scale
from vfm_sdm.stages.camera_motion import ViewMotion
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = [
    "BETWEEN_VIEWS",
    "NOISE_TRUST",
    "REQUIRED",
    "Audit",
    "AuditCheck",
    "AuditInputs",
    "AuditedInterval",
    "Limits",
    "judge",
]

T = TypeVar("T")

NOISE_TRUST = 1.5
"""Factor by which stated noise may be too small before what is left counts as motion [1]."""
REQUIRED = frozenset(
    {
        *("scale", "epipolar error", "epipolar error in motion", "samples missing"),
        *("static points", "tripods", "signal to noise"),
    }
)
"""Names of the checks without which nobody knows whether a result is fit to use: of the scale, of the views against
each other (also of their clocks), of the cameras that must stand still, and of whether anything was measured."""
BETWEEN_VIEWS = {
    "epipolar-level": "epipolar error",
    "epipolar-motion": "epipolar error in motion",
    "agreement": "agreement of the views",
    "synchronization": "clocks",
    "drift": "clock drift",
    "frozen": "frozen tracks",
    "slip": "slipping tracks",
}
"""Checks that compare views, by their part's name, with what they are called."""


@dataclass(frozen=True)
class AuditCheck:
    """Result of one check.

    Parameters
    ----------
    name
        Name of what was checked.
    outcome
        Outcome of the check.
    value, limit, units
        Value that was found, limit from which on it is a caution, and the units of both; NaN where there is none.
        Shares and ratios have the unit ``1``; a number that is no share, such as signal over noise, has none.
    sentence
        Meaning of the outcome, in words for someone on site.
    where
        The view, point or quantity with the worst value.
    larger_is_better
        Whether the value has to stay above the limit instead of below it.
    """

    name: str
    outcome: Outcome
    value: float
    limit: float
    units: str
    sentence: str
    where: str = ""
    larger_is_better: bool = False

    @property
    def share_of_limit(self) -> float:
        """The value over its limit, or the limit over the value where larger is better; NaN where unknown [1]."""
        above, below = (self.limit, self.value) if self.larger_is_better else (self.value, self.limit)
        if not (np.isfinite(above) and np.isfinite(below)):
            return float("nan")
        return float(above / below) if below > 0 else (float("inf") if above > 0 else 0.0)


@dataclass(frozen=True)
class AuditedInterval:
    """Verdict on a part of a long recording.

    Parameters
    ----------
    begin_s, end_s
        The part, on the reference view's clock [s].
    verdict
        Its verdict; not judged where nothing moved.
    reasons
        Sentences of the checks that did not pass.
    """

    begin_s: float
    end_s: float
    verdict: Verdict
    reasons: str


@dataclass(frozen=True)
class Audit:
    """All checks of one measurement and their verdict.

    Refused by one that failed; care for any caution, and for any check of `REQUIRED` that could not be made; not judged
    where most of these could not. What only further views could show is missing where there is one, and no more than
    that: it does not keep the rest from being judged.

    Parameters
    ----------
    checks
        Results of the checks.
    views
        Number of views that were measured with.
    scale
        How well the scale is known, and by what; ``None`` where nobody knows, and of a single view.
    intervals
        Verdicts on the parts of a long recording; empty for one that was judged as a whole.

    Examples
    --------
    >>> check = AuditCheck("drift", Outcome.CAUTION, 0.2, 0.1, "px", "view right drifts")
    >>> str(Audit((check,)).verdict)
    'use with care'
    """

    checks: tuple[AuditCheck, ...]
    views: int = 2
    scale: ScaleBudget | None = None
    intervals: tuple[AuditedInterval, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Verdict that follows from the checks."""
        outcomes = {check.outcome for check in self.checks}
        if Outcome.FAIL in outcomes:
            return Verdict.REFUSED
        needed = REQUIRED - set(BETWEEN_VIEWS.values()) if self.views == 1 else REQUIRED
        required = [check for check in self.checks if check.name in needed]
        if 2 * sum(check.outcome == Outcome.NOT_POSSIBLE for check in required) > len(required):
            return Verdict.NOT_JUDGED
        return Verdict.CARE if Outcome.CAUTION in outcomes or self.missing else Verdict.FIT

    @property
    def missing(self) -> tuple[AuditCheck, ...]:
        """Checks without which nothing is fit to use, and that could not be made."""
        return tuple(c for c in self.checks if c.name in REQUIRED and c.outcome == Outcome.NOT_POSSIBLE)

    @property
    def flagged(self) -> tuple[AuditCheck, ...]:
        """Checks that did not pass, failures first."""
        return tuple(
            check for wanted in (Outcome.FAIL, Outcome.CAUTION) for check in self.checks if check.outcome == wanted
        )

    def as_table(self) -> dict[str, Any]:
        """Checks and verdict as plain tables, for ``summary.json``, where the value of a check is its ``figure``."""
        rows = []
        for check in self.checks:
            row = {"figure" if name == "value" else name: value for name, value in asdict(check).items()}
            rows.append({**row, "outcome": str(check.outcome)})
        table: dict[str, Any] = {"verdict": str(self.verdict), "checks": rows}
        if self.intervals:
            table["intervals"] = [{**asdict(one), "verdict": str(one.verdict)} for one in self.intervals]
        return table

    def __getitem__(self, name: str) -> AuditCheck:
        """The check of this name."""
        return next(check for check in self.checks if check.name == name)


class _Read(Generic[T]):
    """A product that checks read."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, inputs: "AuditInputs", owner: type | None = None) -> T:
        if self._name not in inputs.given:
            raise DatasetError(
                f"audit: expected the product {self._name!r}, got {sorted(inputs.given)}; give it to AuditInputs"
            )
        return cast(T, inputs.given[self._name])


class AuditInputs:
    """Products of a measurement; each check reads those that it looks at, and asks for no others.

    Parameters
    ----------
    products
        By name, any of these:

        session
            The measurement on site and its settings.
        cameras
            Cameras, axes and the adjustment to the site.
        tracks
            Tracks by view, shape (T, P, 2) [px], each on its own clock.
        aligned
            Tracks on one clock, with a dim ``view``, shape (V, T, P, 2) [px], without the motion of the cameras as far
            as it was removed; before any refinement.
        displacement
            The result, shape (T, P, 3) [mm], with its uncertainty budget.
        unrefined
            Displacement as the images alone give it, shape (T, P, 3) [mm]; equal to ``displacement`` where nothing was
            refined.
        camera_motion
            Motion of the cameras by view; empty where it was not looked for.
        frames
            First frame of every view, shape (H, W); empty where nothing that needs images can be checked.

    Raises
    ------
    DatasetError
        There is no such product; or, where a check reads one, it was not given.

    Examples
    --------
    >>> inputs = AuditInputs(tracks={}, camera_motion={})
    >>> inputs.tracks
    {}
    """

    session = _Read[Session]()
    cameras = _Read[CameraSolution]()
    tracks = _Read[Mapping[str, xr.Dataset]]()
    aligned = _Read[xr.Dataset]()
    displacement = _Read[xr.Dataset]()
    unrefined = _Read[xr.Dataset]()
    camera_motion = _Read[Mapping[str, ViewMotion]]()
    frames = _Read[Mapping[str, LumaArray]]()

    def __init__(self, **products: object) -> None:
        known = sorted(name for name, one in vars(AuditInputs).items() if isinstance(one, _Read))
        unknown = sorted(set(products) - set(known))
        if unknown:
            raise DatasetError(f"audit: expected products of {known}, got {unknown}; correct their names")
        # Points of grids are judged together, by a check of their own; one of hundreds must not condemn the rest.
        self.grid = _find_grids(products.get("displacement"))
        many = [] if self.grid is None else self.grid["point"].values.tolist()
        self.given = {name: _without(one, many) for name, one in products.items()} if many else dict(products)

    @cached_property
    def scale(self) -> ScaleBudget | None:
        """How well the scale is known, and by what; ``None`` where nobody knows."""
        return weigh_scale(self)

    @property
    def moving(self) -> list[str]:
        """Names of the points on the structure, without those that were refused before tracking."""
        refused = self.refused
        return [p.name for p in self.session.point if not (p.static or p.name in refused)]

    @cached_property
    def refused(self) -> dict[str, str]:
        """Points that were known before tracking not to be measured, and why: fewer than two views have them."""
        needed = min(2, len(self.session.view))
        faults: dict[str, list[str]] = {}
        for point in (p.name for p in self.session.point):
            found = [self._fault(view.name, point) for view in self.session.view]
            if sum(not fault for fault in found) < needed:
                faults[point] = [fault for fault in found if fault]
        return {point: "; ".join(dict.fromkeys(found)) for point, found in faults.items()}

    def _fault(self, view: str, point: str) -> str:
        """Why a view does not have a point; empty where it does, or where nobody knows."""
        cameras, tracks = (self.given.get(name) for name in ("cameras", "tracks"))
        status = PointStatus.OK.value
        if isinstance(cameras, CameraSolution) and view in cameras.points["view"].values:
            status = cameras.points["status"].sel(view=view, point=point).item()
        if status == PointStatus.OK and isinstance(tracks, Mapping):
            one = tracks.get(view)
            if isinstance(one, xr.Dataset) and "subset_status" in one and point in one["point"].values:
                status = one["subset_status"].sel(point=point).item() or PointStatus.OK.value
        return "" if status == PointStatus.OK else f"{status} in view {view!r}"

    @property
    def static(self) -> list[str]:
        """Names of the points that must not move, as far as two views or more tracked them, or the only one."""
        needed = min(2, self.aligned.sizes["view"])
        return self._static_in(np.isfinite(self.aligned["position"].values).all(axis=-1).sum(axis=0) >= needed)

    def static_in(self, view: str) -> list[str]:
        """Names of those of `static` that a view tracked itself."""
        found = self._static_in(np.isfinite(self.aligned["position"].sel(view=view).values).all(axis=-1))
        return [name for name in self.static if name in found]

    def _static_in(self, found: BoolArray) -> list[str]:
        """Names of the static points that are found in most samples, from shape (T, P)."""
        often = dict(zip(self.aligned["point"].values.tolist(), found.mean(axis=0) > 0.5, strict=True))
        return [p.name for p in self.session.point if p.static and often.get(p.name, False)]

    @property
    def judged_axes(self) -> list[str]:
        """Axes whose displacement is judged: not along the view, and not the one that the refinement suppresses."""
        method = self.session.method
        suppressed = method.sgr.suppressed_axis if method.refinement == "sgr" else ""
        axes = [str(axis) for axis in self.displacement["axis"].values]
        return [axis for axis in axes if axis not in (suppressed, "longitudinal", "forward")]

    def motion_px(self, view: str) -> FloatArray:
        """Root mean square motion of the structure's P points in a view, without the stated noise, shape (P,) [px].

        Parameters
        ----------
        view
            Name of the view.

        Returns
        -------
        motion_px
            NaN where a point was not tracked.
        """
        chosen = self.aligned.sel(view=view, point=self.moving)
        with np.errstate(invalid="ignore"):
            variance = chosen["position"].var("time").sum("pixel", skipna=False).values
        noise = measured_variance(chosen["position_covariance"].values, edges_across(chosen))
        return np.asarray(np.sqrt(np.maximum(variance - mean_of_known(noise), 0.0)))


def _find_grids(displacement: object) -> xr.DataArray | None:
    """Status of the points of grids (time, point); ``None`` without any."""
    names = grid_points(displacement) if isinstance(displacement, xr.Dataset) else []
    return displacement["status"].sel(point=names) if names and isinstance(displacement, xr.Dataset) else None


def _without(product: object, names: list[str]) -> object:
    """A product without some points."""
    if isinstance(product, xr.Dataset):
        return product.drop_sel(point=names)
    if isinstance(product, dict) and all(isinstance(one, xr.Dataset) for one in product.values()):
        return {view: _without(one, names) for view, one in product.items()}
    return product


@dataclass(frozen=True)
class Limits:
    """Limits of a check.

    Parameters
    ----------
    caution, fail
        Values from which on the check is a caution, and from which on it fails.
    units
        Units of the values and limits, such as ``px`` or ``s``.
    """

    caution: float
    fail: float
    units: str


def judge(name: str, found: Mapping[str, float], limits: Limits, *, good: str, bad: str) -> AuditCheck:
    """A check of values that should be small, by the largest of them.

    Parameters
    ----------
    name
        Name of the check.
    found
        Values by what they belong to; those that are NaN do not count. Without any the check is not possible.
    limits
        From which values on the check is a caution, and from which on it fails.
    good, bad
        Sentence for a check that passed, and for one that did not, with ``{}`` for what has the largest value.

    Examples
    --------
    >>> found = {"left": 0.02, "right": 0.2}
    >>> check = judge("drift", found, Limits(caution=0.1, fail=0.5, units="px"), good="still", bad="view {} drifts")
    >>> str(check.outcome), check.where, round(check.share_of_limit, 3), check.sentence
    ('caution', 'right', 2.0, 'view right drifts')
    """
    known = {where: value for where, value in found.items() if np.isfinite(value)}
    if not known:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), limits.caution, limits.units, "nothing to look at")
    where, value = max(known.items(), key=lambda pair: pair[1])
    outcome = Outcome.FAIL if value >= limits.fail else Outcome.CAUTION if value >= limits.caution else Outcome.PASS
    sentence = good if outcome == Outcome.PASS else bad.replace("{}", where)
    return AuditCheck(name, outcome, float(value), limits.caution, limits.units, sentence, where)
