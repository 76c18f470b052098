"""Long recordings behind tracking: intervals together are as one piece, with clocks and verdicts of their own."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from measurements import FPS, MOVING, STATIC, measured, simulate
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.netcdf import open_displacement, read_displacement, write_displacement
from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.errors import DatasetError
from vfm_sdm.outputs.results.summary import describe_measurement

pytestmark = pytest.mark.slow

WHOLE_S, PART_S = 1000.0, 15.0
CALM = {
    **{"vertical_mm": 20.0, "lateral_mm": 8.0, "track_std_px": (0.01, 0.01), "longitudinal_share": 0.02},
    **{
        "duration_s": 45.0,
        "synchronization": "none",
        "time_offset_error_s": 0.0,
        "range_std": 0.05,
        "length_std": 0.01,
    },
}
"""Motion that stands clear of all noise, on clocks that are known."""


def method_of(simulated, **method):
    session = simulated.session
    return session.model_copy(update={"method": session.method.model_copy(update=method)})


def run(simulated, interval_s=PART_S, **method):
    """The measurement in intervals; with textured first frames, of which the audit takes the gain."""
    session = method_of(simulated, interval_s=interval_s, **method)
    return measured(session, simulated.tracks, simulated.solution, injection=None)


def changed(simulated, change):
    """The same with other tracks, of a function of view, dataset and time."""
    tracks = {view: change(view, one.copy(deep=True), one["time"].values) for view, one in simulated.tracks.items()}
    return replace(simulated, tracks=tracks)


def shifted(view, by_px):
    """A change of all pixels of one view, by a function of time (T, 2)."""

    def change(name, tracks, time_s):
        if name == view:
            tracks["position"] = tracks["position"] + xr.DataArray(by_px(time_s), dims=("time", "pixel"))
        return tracks

    return change


@pytest.fixture(scope="module")
def simulated():
    return simulate(11, **CALM)


@pytest.fixture(scope="module")
def in_parts(simulated):
    return run(simulated)


@pytest.mark.parametrize("refinement", ["none", "sgr"])
def test_displacement_is_that_of_one_piece(refinement):
    simulated = simulate(11, refinement=refinement, **CALM)
    whole, parts = run(simulated, WHOLE_S).displacement, run(simulated).displacement
    assert parts["interval_begin"].values.round(3).tolist() == [0.0, 15.0, 30.0]
    np.testing.assert_array_equal(parts["time"], whole["time"])
    np.testing.assert_array_equal(parts["status"], whole["status"])
    apart = np.abs(parts["displacement"] - whole["displacement"])
    if refinement == "none":
        # Sums of other lengths, and a linear refinement of nothing.
        assert float((apart / whole["displacement_std"]).max()) < 1e-3
    else:
        # The weights of the assumption follow the noise and motion of each interval.
        assert float((apart / whole["combined_std"]).max()) < 1.0
    # Velocities at the ends of an interval come from one side.
    ratio = (parts["combined_std"] ** 2).mean("time") / (whole["combined_std"] ** 2).mean("time")
    assert 0.9 < float(ratio.min()) <= float(ratio.max()) < 1.1


def test_displacement_is_the_truth_within_what_is_stated(simulated, in_parts):
    error = simulated.error_of(in_parts.displacement)
    share = float((np.abs(error) < 2 * in_parts.displacement["combined_std"]).sel(point=list(MOVING)).mean())
    assert share > 0.9


def test_a_tripod_that_settles_makes_no_step_between_intervals(simulated):
    """Camera motion was relative to its mean over each interval."""
    drifts = changed(simulated, shifted("right", lambda t: np.stack([0.5 * t / 45, 0.3 * t / 45], axis=-1)))
    found = run(drifts).displacement
    assert found["camera_motion_status"].sel(view="right") == "ok"
    error = simulated.error_of(found).sel(axis=["lateral", "vertical"])
    means = [error.sel(time=slice(first, first + 15)).mean("time") for first in (0.0, 15.0, 30.0)]
    steps = xr.concat(means, "interval").std("interval") / found["combined_std"].median("time")
    assert float(steps.max()) < 1.0


def test_without_what_is_carried_on_there_is_a_step(simulated, monkeypatch):
    monkeypatch.setattr("vfm_sdm.stages.intervals.measure.Carried.after", lambda self, *_: self)
    found = run(simulated).displacement
    error = simulated.error_of(found).sel(axis="vertical", point=MOVING[0])
    means = [float(error.sel(time=slice(first, first + 15)).mean()) for first in (0.0, 15.0, 30.0)]
    assert np.ptp(means) > 1.0


def test_clocks_are_found_anew_in_every_interval():
    """A clock that is slow by 40 ppm, and one that jumps, are followed."""
    simulated = simulate(12, **{**CALM, "synchronization": "motion", "time_offset_std_s": 0.05, "duration_s": 60.0})

    def slow(view, tracks, time_s):
        late = np.where(time_s < 30, 0.0, 0.02)
        return tracks.assign_coords(time=("time", time_s - late, {"units": "s"})) if view == "right" else tracks

    jumps = changed(simulated, slow)
    found = run(jumps, 30.0)
    offsets = found.displacement["clock_offset_by_interval"].sel(view="right").values
    assert np.diff(offsets) == pytest.approx([0.02], abs=2e-3)
    whole = run(jumps, WHOLE_S)
    errors = [float((simulated.error_of(one.displacement) ** 2).mean()) for one in (found, whole)]
    assert errors[0] < errors[1] / 4
    assert whole.audit.verdict != Verdict.FIT


def test_bad_minutes_do_not_condemn_the_rest_and_are_named(simulated, in_parts):
    def lost(view, tracks, time_s):
        within = ((time_s >= 15) & (time_s < 27))[:, None] & np.isin(tracks["point"], MOVING)
        return tracks.assign(status=tracks["status"].where(~within, np.int8(Status.LOST)))

    bad = changed(simulated, lost)
    found, whole = run(bad), run(bad, 20.0 * 45)
    check = found.audit["samples missing"]
    assert check.outcome == Outcome.CAUTION
    assert "in 1 of 3 intervals, worst from 15 to 30 s" in check.sentence
    assert [one.verdict for one in found.audit.intervals] == [
        in_parts.audit.intervals[0].verdict,
        Verdict.REFUSED,
        in_parts.audit.intervals[2].verdict,
    ]
    assert found.audit.verdict == Verdict.CARE
    status = found.displacement["status"].sel(point=list(MOVING))
    assert (status.sel(time=slice(0, 14.9)) == Status.OK).all()
    assert not (status.sel(time=slice(15.1, 29.9)) == Status.OK).any()
    assert (status.sel(time=slice(30.1, None)) == Status.OK).all()
    assert whole.audit.intervals == ()
    table = json.loads(json.dumps(found.audit.as_table()))
    assert [one["verdict"] for one in table["intervals"]][1] == "do not use"
    assert "samples missing" in table["intervals"][1]["reasons"]


def test_minutes_of_rest_are_not_judged_and_stay(simulated):
    """At night nobody crosses a bridge: a share of no motion is no fault."""

    def rests(view, tracks, time_s):
        late = time_s >= 29  # on its own clock, which is apart by less than a second
        noise = np.random.default_rng(len(view)).normal(0, 0.01, tracks["position"].shape)
        rest = tracks["position"].isel(time=0).values + noise
        return tracks.assign(position=tracks["position"].where(~xr.DataArray(late, dims="time"), rest))

    found = run(changed(simulated, rests))
    assert found.audit.intervals[2].verdict == Verdict.NOT_JUDGED
    assert found.audit.intervals[2].reasons.startswith("hardly any motion")
    assert found.audit["signal to noise"].outcome == Outcome.PASS
    assert (found.displacement["status"].sel(time=slice(30.1, None)) == Status.OK).all()


def test_rest_positions_are_those_of_a_still_interval_wherever_it_lies(simulated):
    still_s = (31.0, 33.0)
    whole, parts = (run(simulated, length, still_interval_s=still_s).displacement for length in (WHOLE_S, PART_S))
    apart = np.abs(parts["displacement"] - whole["displacement"])
    assert float((apart / whole["displacement_std"]).max()) < 1e-3
    assert parts.attrs["relative_to"] == whole.attrs["relative_to"] == "mean of the still interval"


def test_a_still_interval_lies_in_one_interval(simulated):
    parts = run(simulated, still_interval_s=(29.0, 31.0)).displacement
    assert parts["interval_begin"].values.round(3).tolist() == [0.0, 15.0, 29.0]


def test_a_still_interval_without_frames_is_an_error(simulated):
    with pytest.raises(DatasetError, match="still"):
        _ = run(simulated, still_interval_s=(50.0, 51.0)).displacement


def test_time_without_one_of_the_views_is_left_out(simulated):
    def gap(view, tracks, time_s):
        return tracks.isel(time=(time_s < 15) | (time_s >= 30.5)) if view == "right" else tracks

    found = run(changed(simulated, gap))
    assert found.displacement["interval_begin"].values.round(3).tolist() == [0.0, 30.0]
    assert len(found.audit.intervals) == 2


def test_recordings_that_never_overlap_are_an_error(simulated):
    apart = changed(
        simulated,
        lambda view, tracks, time_s: tracks.assign_coords(time=time_s + (200.0 if view == "right" else 0.0)),
    )
    with pytest.raises(DatasetError, match="expected recordings that overlap"):
        _ = run(apart).displacement


def test_slow_drift_of_what_must_not_move_is_seen_between_intervals(simulated, in_parts):
    assert in_parts.audit["slow drift"].outcome == Outcome.PASS

    def sinks(view, tracks, time_s):
        moved = tracks["position"].copy()
        moved.loc[{"point": STATIC[0], "pixel": "v"}] += 3.0 * np.floor(time_s / 15.0)
        return tracks.assign(position=moved)

    check = run(changed(simulated, sinks), camera_motion="keep").audit["slow drift"]
    assert check.outcome == Outcome.FAIL
    assert check.where == STATIC[0]


def test_long_results_are_written_and_read_part_by_part(simulated, in_parts, tmp_path, monkeypatch):
    found = in_parts.displacement
    monkeypatch.setattr("vfm_sdm.core.netcdf.LONG_BYTES", 1)
    monkeypatch.setattr("vfm_sdm.core.block_files._BLOCK", 400)
    path = write_displacement(tmp_path, found)
    for read in (read_displacement(path), open_displacement(path).load()):
        xr.testing.assert_identical(read, found.load())
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(Exception, match="damaged"):
        read_displacement(path)


def test_the_summary_holds_the_intervals(in_parts, simulated):
    summary = describe_measurement(in_parts.cameras, simulated.tracks, in_parts.displacement, in_parts.audit)
    assert len(summary["audit"]["intervals"]) == 3
    assert summary["points"][MOVING[0]]["coverage_valid"] > 0.9


def test_frames_of_the_last_interval_are_not_lost(simulated, in_parts):
    assert in_parts.displacement.sizes["time"] == run(simulated, WHOLE_S).displacement.sizes["time"]
    assert in_parts.displacement.sizes["time"] > 44 * FPS
