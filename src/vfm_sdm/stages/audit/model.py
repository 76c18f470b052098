"""What an audit says: checks, each with a figure and a sentence, and the verdict that they add up to."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray, mean_of_known
from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.camera_motion import ViewMotion
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = ["NOISE_TRUST", "Audit", "AuditCheck", "AuditInputs", "judge"]

NOISE_TRUST = 1.5
"""Stated noise may be too small by this factor before it counts as motion."""


@dataclass(frozen=True)
class AuditCheck:
    """One check.

    Parameters
    ----------
    name
        What was looked at.
    outcome
        How it ended.
    figure, limit, units
        What was found, from where on it is a caution, and in what; NaN where there is none. Shares and ratios have the
        unit ``1``.
    sentence
        What it means, for someone on a river bank.
    where
        The view, point or quantity with the worst figure.
    """

    name: str
    outcome: Outcome
    figure: float
    limit: float
    units: str
    sentence: str
    where: str = ""
    larger_is_better: bool = False

    @property
    def load(self) -> float:
        """The figure over its limit, or the limit over it where larger is better: 1 at the limit, NaN where unknown."""
        above, below = (self.limit, self.figure) if self.larger_is_better else (self.figure, self.limit)
        if not (np.isfinite(above) and np.isfinite(below)):
            return float("nan")
        return float(above / below) if below > 0 else (float("inf") if above > 0 else 0.0)


@dataclass(frozen=True)
class Audit:
    """All checks of one measurement and their verdict: refused by one that failed, care for any caution."""

    checks: tuple[AuditCheck, ...]

    @property
    def verdict(self) -> Verdict:
        """What the checks add up to."""
        outcomes = {check.outcome for check in self.checks}
        if Outcome.FAIL in outcomes:
            return Verdict.REFUSED
        return Verdict.CARE if Outcome.CAUTION in outcomes else Verdict.FIT

    @property
    def flagged(self) -> tuple[AuditCheck, ...]:
        """Checks that did not pass, failures first."""
        return tuple(
            check for wanted in (Outcome.FAIL, Outcome.CAUTION) for check in self.checks if check.outcome == wanted
        )

    def as_table(self) -> dict[str, Any]:
        """The same as plain tables, for ``summary.json``."""
        return {"verdict": str(self.verdict), "checks": [{**asdict(c), "outcome": str(c.outcome)} for c in self.checks]}

    def __getitem__(self, name: str) -> AuditCheck:
        """The check of this name."""
        return next(check for check in self.checks if check.name == name)


@dataclass(frozen=True, eq=False)
class AuditInputs:
    """A measurement, as its stages left it.

    Parameters
    ----------
    session
        What was measured on site, and how.
    cameras
        Cameras, axes and the adjustment to the site.
    tracks
        By view, each on its own clock.
    aligned
        The same on one clock, with a dim ``view``, without the motion of the cameras as far as it was removed; before
        any refinement.
    displacement
        The result, with its budget.
    unrefined
        Displacement as the images alone give it; the same as ``displacement`` where nothing was refined.
    camera_motion
        Motion of the cameras by view; empty where it was not looked for.
    frames
        First frame of every view; without, nothing that needs images is checked.
    """

    session: Session
    cameras: CameraSolution
    tracks: Mapping[str, xr.Dataset]
    aligned: xr.Dataset
    displacement: xr.Dataset
    unrefined: xr.Dataset
    camera_motion: Mapping[str, ViewMotion] = field(default_factory=dict)
    frames: Mapping[str, LumaArray] = field(default_factory=dict)

    @property
    def moving(self) -> list[str]:
        """Names of the points on the structure."""
        return [p.name for p in self.session.point if not p.static]

    @property
    def static(self) -> list[str]:
        """Names of the points that must not move, as far as they were tracked in every view."""
        named = [p.name for p in self.session.point if p.static]
        found = np.isfinite(self.aligned["position"].values).all(axis=-1).all(axis=0).mean(axis=0) > 0.5
        seen = [str(name) for name, ok in zip(self.aligned["point"].values, found, strict=True) if ok]
        return [name for name in named if name in seen]

    def motion_px(self, view: str) -> FloatArray:
        """Motion of the structure's points in a view without the stated noise, root mean square, shape (points,) [px].

        NaN where a point was not tracked.
        """
        chosen = self.aligned.sel(view=view, point=self.moving)
        with np.errstate(invalid="ignore"):
            variance = chosen["position"].var("time").sum("pixel", skipna=False).values
        noise = np.einsum("tpii->tp", chosen["position_covariance"].values)
        return np.asarray(np.sqrt(np.maximum(variance - mean_of_known(noise), 0.0)))


def judge(
    name: str, found: Mapping[str, float], *, caution: float, fail: float, units: str, good: str, bad: str
) -> AuditCheck:
    """A check of figures that should be small, by the largest of them.

    Parameters
    ----------
    found
        Figures by what they belong to; those that are NaN do not count. Without any the check is not possible.
    caution, fail
        From where on.
    good, bad
        The sentence for a check that passed, and for one that did not, with ``{}`` for what has the largest figure.
    """
    known = {where: figure for where, figure in found.items() if np.isfinite(figure)}
    if not known:
        return AuditCheck(name, Outcome.NOT_POSSIBLE, float("nan"), caution, units, "nothing to look at")
    where, figure = max(known.items(), key=lambda pair: pair[1])
    outcome = Outcome.FAIL if figure >= fail else Outcome.CAUTION if figure >= caution else Outcome.PASS
    sentence = good if outcome == Outcome.PASS else bad.replace("{}", where)
    return AuditCheck(name, outcome, float(figure), caution, units, sentence, where)
