"""The audit against measurements with nothing wrong, and against faults put into them."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from faults import FAULTS, GOOD, good_run
from measurements import MOVING, Simulated, measured, simulate
from parallel import in_processes
from textures import WaveTexture
from vfm_sdm.commands.tables import audit_report
from vfm_sdm.core.statuses import CameraStatus, Outcome, Verdict
from vfm_sdm.outputs.plots import plot_audit
from vfm_sdm.stages.audit import Audit, AuditCheck
from vfm_sdm.stages.audit.model import REQUIRED, AuditInputs, Limits, judge
from vfm_sdm.stages.audit.scale_budget import weigh_scale

NEVER_REFUSED = 0.02
FOUND = 0.95


def audited(run: Simulated, *, refinement: str = "none", frames=None) -> Audit:
    method = run.session.method.model_copy(update={"refinement": refinement})
    session = run.session.model_copy(update={"method": method})
    found = measured(session, run.tracks, run.solution, frames=frames or {}).audit
    assert found is not None
    return found


def refinement(seed: int) -> str:
    return ("none", "sgr")[seed % 2]


def found_by_the_right_check(fault: str, seed: int) -> bool:
    make, checks = FAULTS[fault]
    return bool(checks & {check.name for check in audited(make(seed), refinement=refinement(seed)).flagged})


def verdict_of_a_good_run(seed: int) -> tuple[Verdict, list[str]]:
    found = audited(good_run(seed), refinement=refinement(seed))
    return found.verdict, [f"{check.name}: {check.value:.3g}" for check in found.flagged]


def faults_missed(seed: int) -> list[str]:
    return [fault for fault in FAULTS if not found_by_the_right_check(fault, seed)]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_good_measurement_is_not_refused(seed):
    found = audited(good_run(seed), refinement=refinement(seed))
    assert found.verdict != Verdict.REFUSED, found.flagged
    # Noise without SGR may hide the lateral motion, and weak lenses leave the scale open; everything else passes.
    assert {check.name for check in found.flagged} <= {"signal to noise", "scale"}
    assert found["scale"].outcome == Outcome.CAUTION or found["scale"].value <= 0.05


def test_points_of_one_motion_agree_on_the_clocks():
    # A sample at an end, where the two lags had different ones, once made a point disagree with its own best lag.
    run = good_run(11)
    aligned = measured(run.session, run.tracks, run.solution).aligned
    assert aligned["clock_status"].values.tolist() == ["ok", "ok"]
    assert abs(aligned["clock_offset"].values[1] - run.conditions.time_offset_s) < 1e-3


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_by_the_right_check(fault):
    assert found_by_the_right_check(fault, 1)


def test_a_stabilised_video_is_refused_unless_static_points_take_it_out():
    run = FAULTS["stabilised video"][0](2)
    assert audited(run)["stabilised video"].outcome == Outcome.CAUTION
    method = run.session.method.model_copy(update={"camera_motion": "keep"})
    kept = replace(run, session=run.session.model_copy(update={"method": method}))
    assert audited(kept)["stabilised video"].outcome == Outcome.FAIL


@pytest.mark.hundreds
def test_at_most_two_of_a_hundred_good_measurements_are_refused(capsys):
    found = in_processes(verdict_of_a_good_run, range(100))
    refused = {seed: flagged for seed, (verdict, flagged) in enumerate(found) if verdict == Verdict.REFUSED}
    with capsys.disabled():
        print("\ngood measurements:", Counter(str(verdict) for verdict, _ in found), "refused:", refused)
    assert len(refused) <= NEVER_REFUSED * len(found), refused


@pytest.mark.hundreds
def test_faults_are_found_nearly_always(capsys):
    missed = in_processes(faults_missed, range(20))
    counts = {fault: [seed for seed, names in enumerate(missed) if fault in names] for fault in FAULTS}
    with capsys.disabled():
        print(f"\nof {len(missed)} each, seeds of faults that were missed:", counts)
    assert all(len(seeds) <= (1 - FOUND) * len(missed) for seeds in counts.values()), counts


def test_a_wrong_baseline_alone_cannot_be_seen_and_the_audit_says_so():
    wrong = {"baseline_error": 0.4, "baseline_std": 0.005, "range_std": None, "length_std": None}
    found = audited(simulate(3, **GOOD, **wrong))
    assert found.verdict != Verdict.REFUSED
    scale = found["scale by a spare length"]
    assert scale.outcome == Outcome.NOT_POSSIBLE
    assert "baseline" in scale.sentence
    assert "Measure the length between two points" in scale.sentence


SPARE = {"length_std": 0.002, "length_error": 0.0, "range_std": 0.005, "range_error": 0.0}
SPARE |= {"focal_std": 0.001, "focal_errors": (0.0, 0.0), "baseline_std": 0.02}


def test_good_spare_lengths_agree_with_a_right_baseline():
    right = audited(simulate(3, **GOOD, **SPARE, baseline_error=0.01))
    assert right["scale by a spare length"].outcome == Outcome.PASS
    assert right["scale by a spare length"].value < 0.05


@pytest.mark.slow
def test_good_spare_lengths_show_a_wrong_baseline():
    wrong = audited(simulate(3, **GOOD, **SPARE, baseline_error=0.4))
    assert wrong["site and lenses"].outcome == Outcome.FAIL


def test_what_the_camera_estimator_objects_to_is_a_caution():
    run = good_run(1)
    assert audited(run)["site and lenses"].outcome == Outcome.PASS
    named = audited(replace(run, solution=replace(run.solution, status=CameraStatus.CONTRADICTION)))
    assert named["site and lenses"].outcome == Outcome.CAUTION
    assert CameraStatus.CONTRADICTION in named["site and lenses"].sentence
    assert named.verdict == Verdict.CARE


def test_unknown_clocks_are_refused():
    run = good_run(2)
    views = tuple(v.model_copy(update={"time_offset_s": None, "time_offset_std_s": None}) for v in run.session.view)
    still = {view: t.assign(position=t["position"] * 0 + t["position"].isel(time=0)) for view, t in run.tracks.items()}
    found = audited(replace(run, session=run.session.model_copy(update={"view": views}), tracks=still))
    assert found["clocks"].outcome == Outcome.FAIL
    assert found["clocks"].where == "right"
    assert found.verdict == Verdict.REFUSED


def test_without_static_points_the_audit_says_what_it_cannot_see():
    run = good_run(0)
    points = tuple(p for p in run.session.point if not p.static)
    tracks = {view: t.sel(point=list(MOVING)) for view, t in run.tracks.items()}
    found = audited(replace(run, session=run.session.model_copy(update={"point": points}), tracks=tracks))
    for name in ("static points", "tripods", "stabilised video"):
        assert found[name].outcome == Outcome.NOT_POSSIBLE
        assert "static = true" in found[name].sentence
    assert found.verdict != Verdict.FIT
    assert {check.name for check in found.missing} == {"static points", "tripods"}


def test_a_clock_that_drifts_is_found():
    run = simulate(5, **GOOD, duration_s=10.0)
    right = run.tracks["right"]
    drifting = right.assign_coords(time=("time", right["time"].values * 1.006, right["time"].attrs))
    assert audited(run)["clock drift"].outcome == Outcome.PASS
    found = audited(replace(run, tracks={**run.tracks, "right": drifting}))
    assert found["clock drift"].outcome in (Outcome.CAUTION, Outcome.FAIL)


def test_recordings_that_lack_frames_are_named():
    run = good_run(0)
    tracks = {
        v: t.assign_attrs(recording={"frames": 200, "dropped": 0, "duplicated": 0}) for v, t in run.tracks.items()
    }
    assert audited(replace(run, tracks=tracks))["recordings"].outcome == Outcome.PASS
    tracks["right"].attrs["recording"]["dropped"] = 4
    found = audited(replace(run, tracks=tracks))["recordings"]
    assert (found.outcome, found.where, found.value) == (Outcome.CAUTION, "right", 0.02)
    tracks["left"].attrs["recording"]["status"] = "truncated"
    assert audited(replace(run, tracks=tracks))["recordings"].where == "left"


@pytest.mark.parametrize(("stated", "outcome"), [(None, "caution"), (250, "caution"), (450, "fail")])
def test_a_recording_most_of_which_cannot_be_read_fails(stated, outcome):
    run = good_run(0)
    record = {"frames": 200, "dropped": 0, "duplicated": 0, "stated_frames": stated, "status": "corrupt"}
    tracks = run.tracks | {"right": run.tracks["right"].assign_attrs(recording=record)}
    found = audited(replace(run, tracks=tracks))["recordings"]
    assert (found.outcome, found.where) == (outcome, "right")


def test_halves_of_a_subset_that_part_are_found():
    run = good_run(0)
    noise = np.random.default_rng(1).normal(0, 0.01, run.tracks["right"]["position"].shape)
    together = run.tracks["right"].assign(half_difference=run.tracks["right"]["position"].copy(data=noise))
    assert audited(replace(run, tracks={**run.tracks, "right": together}))["halves of a subset"].outcome == Outcome.PASS
    moved = run.tracks["right"]["position"].values
    parted = together.assign(half_difference=together["half_difference"].copy(data=noise + 0.5 * (moved - moved[0])))
    found = audited(replace(run, tracks={**run.tracks, "right": parted}))["halves of a subset"]
    assert found.outcome == Outcome.FAIL
    assert found.where.endswith("in right")


def test_halves_that_state_less_noise_than_the_whole_are_not_blamed():
    run = good_run(0)
    whole = run.tracks["right"]["position_covariance"]
    std = np.sqrt(np.einsum("tpii->tp", whole.values).mean())
    noise = np.random.default_rng(2).normal(0, 2 * std, run.tracks["right"]["position"].shape)
    claimed = whole.copy(data=1e-4 * whole.values).rename("half_covariance")
    halves = run.tracks["right"].assign(
        half_difference=run.tracks["right"]["position"].copy(data=noise), half_covariance=claimed
    )
    found = audited(replace(run, tracks={**run.tracks, "right": halves}))["halves of a subset"]
    assert found.value == 0.0


def pictures(contrast: float, noise: float) -> dict[str, np.ndarray]:
    """First frames of a texture that repeats every 480 px, with noise of their own."""
    v, u = np.mgrid[:480, :480].astype(float)
    texture = np.tile(128 + contrast * (WaveTexture(5)(u, v) - 128), (5, 8))
    rng = np.random.default_rng(1)
    noisy = [texture + rng.normal(0, noise, texture.shape) for _ in range(2)]
    return {
        view: np.clip(np.rint(p), 0, 255).astype(np.uint8) for view, p in zip(("left", "right"), noisy, strict=True)
    }


def test_shifts_put_into_a_good_texture_come_out_whole():
    found = audited(good_run(0), frames=pictures(1.0, 1.0))["gain of injected shifts"]
    assert found.outcome == Outcome.PASS
    assert found.value < 0.01


def test_a_surface_without_texture_does_not_pass():
    found = audited(good_run(0), frames=pictures(0.0, 4.0))["gain of injected shifts"]
    assert found.outcome in (Outcome.CAUTION, Outcome.FAIL)


def test_the_verdict_is_that_of_the_worst_check():
    def made(*outcomes: Outcome) -> Verdict:
        return Audit(tuple(AuditCheck(f"{n}", o, 1.0, 1.0, "1", "") for n, o in enumerate(outcomes))).verdict

    assert made(Outcome.PASS, Outcome.NOT_POSSIBLE) == Verdict.FIT
    assert made(Outcome.PASS, Outcome.CAUTION) == Verdict.CARE
    assert made(Outcome.CAUTION, Outcome.FAIL, Outcome.PASS) == Verdict.REFUSED


def test_checks_that_could_not_be_made_do_not_count_as_passed():
    def made(possible: int) -> Verdict:
        outcomes = [Outcome.PASS] * possible + [Outcome.NOT_POSSIBLE] * (len(REQUIRED) - possible)
        return Audit(
            tuple(AuditCheck(n, o, 1.0, 1.0, "1", "") for n, o in zip(REQUIRED, outcomes, strict=True))
        ).verdict

    assert made(len(REQUIRED)) == Verdict.FIT
    assert made(len(REQUIRED) - 1) == Verdict.CARE
    assert made(1) == Verdict.NOT_JUDGED


@pytest.mark.parametrize("seed", [1, 4, 8])
def test_a_length_brings_what_the_audit_says_that_it_would(seed):
    """The same site without and with the length between two points."""
    known = {"focal_std": 0.05, "focal_errors": (0.02, -0.01), "range_std": None}
    without = simulate(seed, **GOOD, **known, length_std=None)
    made = measured(without.session, without.tracks, without.solution)
    check = made.audit["scale"]
    assert check.outcome == Outcome.CAUTION
    inputs = AuditInputs(session=without.session, cameras=without.solution, displacement=made.displacement)
    said = {one.sentence: one.left for one in weigh_scale(inputs).readings}
    (length,) = [left for sentence, left in said.items() if "between 'p0' and 'p1'" in sentence]
    assert min(said.values()) < check.value
    assert f"to {100 * min(said.values()):.2g} %" in check.sentence
    with_length = simulate(seed, **GOOD, **known, length_std=0.005, length_error=0.0)
    after = audited(with_length)["scale"]
    assert after.value == pytest.approx(length, rel=0.25)


def test_the_scale_says_what_it_rests_on_and_what_to_measure_next():
    run = simulate(4, **GOOD, focal_std=0.05, focal_errors=(0.02, -0.01), range_std=None, length_std=None)
    found = audited(run)
    shares = found.scale.shares
    assert sum(shares.values()) == pytest.approx(1)
    assert next(iter(shares)).startswith("focal")
    left = [one.left for one in found.scale.readings]
    assert left == sorted(left)
    table = found.scale.as_table()
    assert table["measure_next"][0] == {"reading": found.scale.readings[0].sentence, "leaves": left[0]}
    (line,) = [str(text) for text in audit_report(found) if " of p" in str(text) and "from" in str(text)]
    assert next(iter(shares)) in line
    assert f"To measure next: {found.scale.readings[0].sentence}" in line


def test_the_fewer_the_frames_the_worse_the_verdict():
    run = good_run(3)
    for frames, expected in ((5, Verdict.NOT_JUDGED), (18, None), (400, Verdict.FIT)):
        short = {view: t.isel(time=slice(frames)) for view, t in run.tracks.items()}
        found = audited(replace(run, tracks=short))
        assert found.verdict == expected if expected is not None else found.verdict != Verdict.FIT
        length = found["length of the recording"]
        assert (length.outcome == Outcome.PASS) == (frames > 50)
        assert length.units == "frames"
        assert length.sentence.startswith(f"{length.value:.0f} ")
        said = any(f"{length.value:.0f} frames (limit 50 frames)" in str(text) for text in audit_report(found))
        assert said == (frames < 50)


@pytest.mark.parametrize(
    ("figure", "outcome"),
    [(0.0, Outcome.PASS), (0.1, Outcome.CAUTION), (0.3, Outcome.FAIL), (np.nan, Outcome.NOT_POSSIBLE)],
)
def test_a_figure_is_judged_by_its_limits(figure, outcome):
    found = {"smaller": figure / 2, "largest": figure, "unknown": np.nan}
    check = judge("x", found, Limits(0.1, 0.3, "1"), good="good", bad="'{}' is bad")
    assert check.outcome == outcome
    assert check.sentence == {"pass": "good", "not possible": "nothing to look at"}.get(outcome, "'largest' is bad")
    if outcome != Outcome.NOT_POSSIBLE and figure > 0:
        assert check.where == "largest"


def test_a_check_is_loaded_by_its_figure_over_its_limit():
    assert AuditCheck("x", Outcome.PASS, 0.05, 0.1, "1", "").share_of_limit == 0.5
    assert AuditCheck("x", Outcome.CAUTION, 2.0, 3.0, "", "", larger_is_better=True).share_of_limit == 1.5
    assert np.isnan(AuditCheck("x", Outcome.NOT_POSSIBLE, np.nan, 0.1, "1", "").share_of_limit)


def test_figure_table_and_report_show_every_check():
    found = audited(FAULTS["a frozen track"][0](1))
    table = found.as_table()
    assert json.loads(json.dumps(table))["verdict"] == "do not use"
    axes = plot_audit(found)
    assert [label.get_text() for label in axes.get_yticklabels()] == [f"{c.name}: {c.outcome}" for c in found.checks]
    lines = [str(part) for part in audit_report(found)]
    assert lines[-1].startswith("verdict: do not use: ")
    assert "frozen tracks" in lines[-1]
