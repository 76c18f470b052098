"""Audits of intervals as one: who counts, what is named, and what is printed of it."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.commands.tables import audit_report
from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.stages.audit import Audit, AuditCheck
from vfm_sdm.stages.audit.model import REQUIRED
from vfm_sdm.stages.intervals.division import Interval
from vfm_sdm.stages.intervals.verdicts import join_audits


def audit_of(**outcomes):
    """An audit that passed but for the checks named, with underscores for spaces."""
    named = {name.replace("_", " "): outcome for name, outcome in outcomes.items()}
    checks = dict.fromkeys(sorted(REQUIRED), Outcome.PASS) | named
    return Audit(tuple(AuditCheck(name, one, 0.5, 0.1, "1", f"{name} is so") for name, one in checks.items()))


def facts_of(rms_mm, static_mm=None):
    """Facts of intervals in which one point moves by so much, and one that must not lies there [mm]."""
    count = len(rms_mm)
    rms = np.zeros((count, 2, 3))
    rms[:, 0, 1] = rms_mm
    mean = np.zeros((count, 2, 3))
    mean[:, 1, 1] = np.zeros(count) if static_mm is None else static_mm
    values = {"interval_rms": rms, "interval_mean": mean, "interval_std": np.full((count, 2, 3), 0.01)}
    dims = ("interval", "point", "axis")
    return xr.Dataset({name: (dims, one) for name, one in values.items()}, coords={"point": ["mid", "wall"]})


def join(*audits, rms_mm=None, static_mm=None, static=("wall",)):
    intervals = [Interval(600.0 * number, 600.0 * (number + 1)) for number in range(len(audits))]
    rms_mm = [1.0] * len(audits) if rms_mm is None else rms_mm
    return join_audits(list(zip(intervals, audits, strict=True)), facts_of(rms_mm, static_mm), ["mid"], static)


GOOD, BAD = audit_of(), audit_of(samples_missing=Outcome.FAIL)


def test_all_good_is_fit():
    found = join(GOOD, GOOD, GOOD)
    assert found.verdict == Verdict.FIT
    assert {one.verdict for one in found.intervals} == {Verdict.FIT}
    assert "intervals" not in found["samples missing"].sentence


@pytest.mark.parametrize(("bad", "verdict"), [(1, Verdict.CARE), (2, Verdict.REFUSED), (4, Verdict.REFUSED)])
def test_half_of_the_intervals_condemn_the_whole(bad, verdict):
    found = join(*[BAD] * bad, *[GOOD] * (4 - bad))
    assert found.verdict == verdict
    assert sum(one.verdict == Verdict.REFUSED for one in found.intervals) == bad


def test_what_compares_with_motion_does_not_count_where_there_is_none():
    quiet = audit_of(tripods=Outcome.FAIL, signal_to_noise=Outcome.FAIL)
    found = join(GOOD, quiet, GOOD, rms_mm=[1.0, 0.05, 0.9])
    assert found.verdict == Verdict.FIT
    assert found.intervals[1].verdict == Verdict.NOT_JUDGED
    assert found.intervals[1].reasons == "hardly any motion"
    lively = join(GOOD, quiet, GOOD, rms_mm=[1.0, 0.5, 0.9])
    assert lively.verdict == Verdict.CARE
    assert lively.intervals[1].verdict == Verdict.REFUSED


def test_what_was_lost_counts_at_night_too():
    found = join(GOOD, BAD, GOOD, rms_mm=[1.0, 0.05, 0.9])
    assert found.intervals[1].verdict == Verdict.REFUSED
    assert found.verdict == Verdict.CARE


def test_an_interval_without_any_sample_is_not_quiet():
    found = join(GOOD, audit_of(samples_missing=Outcome.FAIL, tripods=Outcome.FAIL), rms_mm=[1.0, np.nan])
    assert found.intervals[1].verdict == Verdict.REFUSED


def test_what_could_be_checked_some_of_the_time_was_checked():
    unknown = audit_of(tripods=Outcome.NOT_POSSIBLE)
    assert join(unknown, GOOD)["tripods"].outcome == Outcome.PASS
    assert join(unknown, unknown)["tripods"].outcome == Outcome.NOT_POSSIBLE


@pytest.mark.parametrize(
    ("static_mm", "outcome"),
    [([0.0, 0.02, 0.01], Outcome.PASS), ([0.0, 0.1, 0.2], Outcome.CAUTION), ([0.0, 0.5, 1.0], Outcome.FAIL)],
)
def test_slow_drift(static_mm, outcome):
    assert join(GOOD, GOOD, GOOD, static_mm=static_mm)["slow drift"].outcome == outcome


def test_without_static_points_nobody_can_tell_of_drift():
    check = join(GOOD, GOOD, static=())["slow drift"]
    assert check.outcome == Outcome.NOT_POSSIBLE
    assert "nobody can tell" in check.sentence


def test_the_terminal_names_what_is_not_to_be_used():
    found = join(*[GOOD] * 20, *[BAD] * 7)
    lines = [str(part) for part in audit_report(found)]
    assert " intervals: 20 fit to use, 7 do not use" in lines
    assert " do not use 3:20:00 to 3:30:00: samples missing: samples missing is so" in lines
    assert " do not use 2 more, see summary.json" in lines
    assert sum(line.startswith(" do not use") for line in lines) == 6
    assert not any("intervals" in str(part) for part in audit_report(GOOD))
