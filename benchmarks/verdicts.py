"""Statistics of verdicts: good measurements that are refused or cautioned, and faults that nobody is told of.

Good runs and most faults are simulated measurements (`tests/faults.py`, `tests/injected.py`): sites, lenses, readings,
matches and tracks drawn with the standard deviations that the session states. Faults of pixels are small films
(`tests/fault_films.py`), a clipped reference is an accelerometer's record. Definitions:

- *refused*: the verdict is "do not use" or "not judged". *Cautioned*: it is "use with care". *Without cause*: one of
  its flags has none. A flag has a cause

  - where the displacement is off by more than three standard deviations or, but for ``scale``, a tenth of the motion
    (rms) at any point and axis;
  - ``scale``, where its expanded relative uncertainty, or the error of the gain, is above the session's limit;
  - ``scale`` that says that nothing checks the lenses, where that is shown: the same site with both lenses noted wrong
    by 7 to 30 % is off by more than the limit and no check but ``scale`` says so, for one size and direction at least.

- A fault is *right* where the rms error of every point and axis is within three stated standard uncertainties (99 % for
  four series together), *named* where a check speaks that names such faults, *cautioned* where only others do, and
  *silent* otherwise: wrong, and fit to use.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from fault_films import FILM_FAULTS, MOVING, film_errors, film_measurement  # noqa: E402
from faults import GOOD, good_run  # noqa: E402
from injected import INJECTED, clipped_reference  # noqa: E402
from measurements import MOVING as SIMULATED_MOVING  # noqa: E402
from measurements import STILL_S, Simulated, measured, simulate  # noqa: E402
from simulation import gain_error  # noqa: E402
from vfm_sdm.core.datasets import Status  # noqa: E402
from vfm_sdm.core.statuses import Verdict  # noqa: E402
from vfm_sdm.errors import VfmSdmError  # noqa: E402
from vfm_sdm.stages.audit import Audit  # noqa: E402

RIGHT_STD, TENTH = 3.0, 0.1
LENSES_WRONG = tuple(sign * size for size in (0.1, 0.14, 0.2, 0.07, 0.3) for sign in (-1, 1))
CLIPPED = "a clipped reference"
FILM_NAMED = frozenset(
    {
        *("halves of a subset", "parts of a subset", "share of a subset", "samples missing", "points refused"),
        *("slipping tracks", "agreement of the views", "epipolar error in motion", "epipolar error"),
    }
)
KINDS = (*INJECTED, *FILM_FAULTS, CLIPPED)


@dataclass(frozen=True)
class Outcome:
    """What one measurement came to."""

    kind: str
    seed: int
    verdict: str
    flags: dict[str, str] = field(default_factory=dict)
    """Checks that did not pass, with their outcome and value in words."""
    worst_std: float = 0.0
    """Largest rms error of a point and axis over its standard uncertainty."""
    worst_share: float = 0.0
    """Largest rms error over the rms motion."""
    scale_error: float = 0.0
    scale_value: float = 0.0
    unfounded: tuple[str, ...] = ()
    """Flags of a good run that have no cause."""
    named: bool = False

    @property
    def right(self) -> bool:
        return self.worst_std <= RIGHT_STD

    @property
    def word(self) -> str:
        """What became of a fault."""
        if self.right:
            return "right"
        if self.named:
            return "named"
        return "silent" if self.verdict == Verdict.FIT else "cautioned"


@dataclass(frozen=True)
class Series:
    """Errors, their expanded uncertainty and the truth of one point and axis, of samples that are trusted [mm]."""

    error: np.ndarray
    expanded: np.ndarray
    truth: np.ndarray

    @property
    def stds(self) -> float:
        return float(np.sqrt(np.mean((2 * self.error / self.expanded) ** 2)))

    @property
    def share(self) -> float:
        return float(np.sqrt(np.mean(self.error**2)) / np.std(self.truth))


def good(seed: int) -> Outcome:
    """A good run, and its flags that have no cause."""
    found = audited(good_run(seed), seed)
    limit = good_run(seed).session.method.scale_limit
    unfounded = [name for name in found.flags if not has_cause(name, found, seed, limit)]
    return replace(found, unfounded=tuple(unfounded))


def has_cause(name: str, found: Outcome, seed: int, limit: float) -> bool:
    """Whether the errors, or the session's limit, justify a flag."""
    if found.worst_std > RIGHT_STD or (found.worst_share > TENTH and name != "scale"):
        return True
    if name != "scale":
        return False
    return max(abs(found.scale_error), found.scale_value) > limit or is_blind(seed, limit)


def is_blind(seed: int, limit: float) -> bool:
    """Whether both lenses may be noted too long or too short at a site and only `scale` speaks."""
    std = good_run(seed).conditions.focal_std
    for wrong in LENSES_WRONG:
        found = audited(simulate(seed, **GOOD, focal_errors=(wrong, wrong), focal_std=std), seed)
        if abs(found.scale_error) > limit and set(found.flags) <= {"scale", "signal to noise"}:
            return True
    return False


def injected(kind: str, seed: int) -> Outcome:
    """A measurement with a fault."""
    if kind == CLIPPED:
        verdict, worst, flags = clipped_reference(seed)
        return Outcome(kind, seed, verdict, flags, worst_std=worst, named=bool(flags))
    if kind in FILM_FAULTS:
        measurement, film = film_measurement(seed, kind)
        displacement = measurement.displacement
        errors = film_errors(measurement, film)
        found = [
            pick(displacement, errors, errors * 0, point, axis, np.ones(errors.sizes["time"], bool))
            for point in MOVING
            for axis in errors["axis"].values
        ]
        return judged(kind, seed, measurement.audit, [one for one in found if one], FILM_NAMED, ratio=False)
    return audited(INJECTED[kind].make(seed), seed, kind, INJECTED[kind].named_by)


def audited(run: Simulated, seed: int, kind: str = "good", named_by: frozenset[str] = frozenset()) -> Outcome:
    """The verdict of a simulated measurement, and its errors."""
    method = run.session.method.model_copy(update={"refinement": ("none", "sgr")[seed % 2]})
    session = run.session.model_copy(update={"method": method})
    try:
        measurement = measured(session, run.tracks, run.solution)
        audit, displacement = measurement.audit, measurement.displacement
    except VfmSdmError as error:
        return Outcome(kind, seed, str(Verdict.REFUSED), {"error": str(error)[:60]}, worst_std=np.inf, named=True)
    if displacement is None:
        return Outcome(kind, seed, str(Verdict.REFUSED), {"no displacement": ""}, worst_std=np.inf, named=True)
    errors = align(run, displacement)
    truth = displacement["displacement"] - errors
    moving = displacement["time"].values > STILL_S[1]
    found = [
        pick(displacement, errors, truth, point, axis, moving)
        for point in SIMULATED_MOVING
        for axis in ("lateral", "vertical")
    ]
    outcome = judged(kind, seed, audit, [one for one in found if one], named_by)
    if run.solution.rig is None:
        return outcome
    gains = [gain_error(run.rig, run.solution.rig, point)[:2] for point in run.points3d[: len(SIMULATED_MOVING)]]
    return replace(outcome, scale_error=float(np.max(np.abs(gains))))


def align(run: Simulated, displacement):
    """Displacement less the truth at the stamps of its samples, whatever became of them [mm]."""
    known = run.truth["displacement"].interp(time=displacement["time"].values, kwargs={"fill_value": "extrapolate"})
    return displacement["displacement"] - known.assign_coords(time=displacement["time"].values)


def pick(displacement, errors, truth, point: str, axis: str, chosen) -> Series | None:
    one = displacement.sel(point=point, axis=axis)
    expanded = one["expanded_uncertainty"].values
    error = errors.sel(point=point, axis=axis).values
    ok = chosen & (one["status"].values == Status.OK) & np.isfinite(error) & (expanded > 0)
    if ok.sum() < 5:
        return None
    return Series(error[ok], expanded[ok], truth.sel(point=point, axis=axis).values[ok])


def judged(
    kind: str, seed: int, audit: Audit, found: Sequence[Series], named_by: frozenset[str], *, ratio: bool = True
) -> Outcome:
    flags = {check.name: f"{check.outcome} {check.value:.3g} {check.where}" for check in audit.flagged}
    flags |= {check.name: "not possible" for check in audit.missing}
    scale = next((check.value for check in audit.checks if check.name == "scale"), 0.0)
    return Outcome(
        kind,
        seed,
        str(audit.verdict),
        flags,
        worst_std=max((one.stds for one in found), default=0.0),
        worst_share=max((one.share for one in found), default=0.0) if ratio else 0.0,
        scale_value=scale,
        named=bool(named_by & set(flags)),
    )


def attempt(kind_and_seed: tuple[str, int]) -> Outcome:
    kind, seed = kind_and_seed
    with threadpool_limits(1):
        found = good(seed) if kind == "good" else injected(kind, seed)
    good_run.cache_clear()
    return found


def run_all(items: Sequence[tuple[str, int]], processes: int, tell: Callable[[Outcome], None]) -> list[Outcome]:
    found = []
    if processes <= 1:
        for item in items:
            found.append(attempt(item))
            tell(found[-1])
        return found
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for one in pool.map(attempt, items):
            found.append(one)
            tell(one)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="good runs")
    parser.add_argument("--seeds", type=int, default=20, help="measurements with each fault")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    kinds = ", ".join(KINDS).replace("%", "%%")
    parser.add_argument("--faults", nargs="*", default=list(KINDS), help=f"kinds of fault, of: {kinds}")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.faults) - set(KINDS))
    if unknown:
        parser.error(f"expected faults of {list(KINDS)}, got {unknown}")
    start = time.process_time()

    def tell(one: Outcome) -> None:
        if options.verbose:
            print(describe(one), flush=True)

    seeds = range(options.first, options.first + options.runs)
    summary = {
        "processors": os.cpu_count(),
        "good": tell_good(run_all([("good", s) for s in seeds], options.processes, tell)),
    }
    print(f"\n{'fault':34s}" + "".join(f"  {word:>9s}" for word in ("right", "named", "cautioned", "silent")))
    total: Counter[str] = Counter()
    for kind in options.faults:
        items = [(kind, s) for s in range(options.first, options.first + options.seeds)]
        words = Counter(one.word for one in run_all(items, options.processes, tell))
        total += words
        print(f"{kind:34s}" + row(words), flush=True)
        summary[kind] = {f"{word}_share": words[word] / max(len(items), 1) for word in sorted(words)}
    count = max(sum(total.values()), 1)
    print(f"{'all faults':34s}" + row(total))
    summary["right_or_flagged_share"] = 1 - total["silent"] / count
    summary["right_or_named_share"] = (total["right"] + total["named"]) / count
    summary["cpu_total_s"] = time.process_time() - start
    print(json.dumps(summary))


def row(words: Counter[str]) -> str:
    return "".join(f"  {words[word]:9d}" for word in ("right", "named", "cautioned", "silent"))


def tell_good(found: Sequence[Outcome]) -> dict[str, object]:
    """Table of good runs: verdicts, with and without cause, and the checks that spoke."""
    count = max(len(found), 1)
    verdicts = {
        "fit": [one for one in found if one.verdict == Verdict.FIT],
        "refused": [one for one in found if one.verdict in (Verdict.REFUSED, Verdict.NOT_JUDGED)],
        "cautioned": [one for one in found if one.verdict == Verdict.CARE],
    }
    print(f"{'good runs':34s}  {'runs':>9s}  {'no cause':>9s}")
    summary: dict[str, object] = {}
    for name, ones in verdicts.items():
        without = [one for one in ones if one.unfounded]
        print(f"{name:34s}  {len(ones):9d}  {len(without):9d}" + "".join(f" {one.seed}" for one in without[:8]))
        summary[f"{name}_share"] = len(ones) / count
        summary[f"{name}_without_cause_share"] = len(without) / count
    flags = Counter(check for one in found for check in one.flags)
    unfounded = Counter(check for one in found for check in one.unfounded)
    for check, times in flags.most_common():
        print(f"  {check:32s}  {times:9d}  {unfounded[check]:9d}")
    summary["flags"] = {f"{check.replace(' ', '_')}_share": times / count for check, times in flags.items()}
    return summary


def describe(one: Outcome) -> str:
    said = ", ".join(f"{name}: {text}" for name, text in one.flags.items())
    what = f"without cause: {list(one.unfounded)}" if one.kind == "good" else one.word
    return (
        f"{one.kind:28s} {one.seed:4d} {one.verdict:14s} error {one.worst_std:.2f} std, {one.worst_share:.2f} of motion"
        f", scale {one.scale_error:+.3f} [{what}] {said}"
    )


if __name__ == "__main__":
    main()
