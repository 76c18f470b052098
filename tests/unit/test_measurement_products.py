"""What a measurement does between the stages, on simulated measurements."""

import numpy as np
import pytest

from faults import FAULTS, good_run
from measurements import MOVING, Simulated, measured, simulate
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.inputs.session import Session
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.camera_motion import steady_tracks


def error_mm(run: Simulated, camera_motion: str) -> float:
    """Root mean square error of vertical displacement of the structure's points, less their mean."""
    method = run.session.method.model_copy(update={"camera_motion": camera_motion})
    displacement = measured(run.session.model_copy(update={"method": method}), run.tracks, run.solution).displacement
    error = run.error_of(displacement).sel(point=list(MOVING), axis="vertical")
    return float(np.sqrt(((error - error.mean("time")) ** 2).mean()))


@pytest.mark.parametrize("seed", [0, 3])
def test_a_tripod_that_sways_is_taken_out_of_the_displacement(seed):
    shaken = FAULTS["a moved tripod"][0](seed)
    assert error_mm(shaken, "remove") < error_mm(shaken, "keep") / 5
    measurement = measured(shaken.session, shaken.tracks, shaken.solution)
    right = measurement.displacement.sel(view="right")
    assert right["camera_motion_status"].item() == "ok"
    before, after = right["camera_motion_before"].item(), right["camera_motion_after"].item()
    assert after < before / 10
    found = measurement.audit["tripods"]
    assert found.outcome == Outcome.CAUTION
    assert f"{before:.2f} px (rms) were removed" in found.sentence


def test_cameras_that_stand_still_keep_their_tracks():
    run = good_run(0)
    steady = measured(run.session, run.tracks, run.solution).steady
    assert {motion.status for motion in steady.views.values()} == {"still"}
    assert all(steady.tracks[view] is run.tracks[view] for view in steady.tracks)


def test_without_static_points_nothing_is_looked_for():
    run = good_run(0)
    points = tuple(p for p in run.session.point if not p.static)
    steady = measured(run.session.model_copy(update={"point": points}), run.tracks, run.solution).steady
    assert (steady.tracks, steady.views) == (run.tracks, {})
    unknown = steady_tracks(run.tracks, None, ["s0"])
    assert (unknown.tracks, unknown.views) == (run.tracks, {})


def test_a_measurement_says_what_it_is():
    session = Session(
        name="bridge <1>",
        view=[{"name": view, "video": f"{view}.mp4"} for view in ("left", "right")],
        point=[{"name": "mid & end", "view": "left", "pixel": [1.0, 2.0], "static": True}],
        site={"baseline": {"value": 4.0, "std": 0.01}},
    )
    measurement = Measurement(session).given(tracks={})
    assert repr(measurement) == "<Measurement 'bridge <1>': views 2, points 1, in memory; made: tracks>"
    html = measurement._repr_html_()
    assert "bridge &lt;1&gt;" in html
    assert "mid &amp; end (static)" in html
    assert html.count("<tr>") == 1 + len(Measurement.products())
    assert "<code>tracks</code></td><td>given<" in html
    assert "<code>cameras</code></td><td>not yet<" in html


def test_a_verdict_is_part_of_what_it_says():
    simulated = simulate(3)
    measurement = measured(simulated.session, simulated.tracks, simulated.solution)
    assert measurement.audit is not None
    assert repr(measurement).endswith(f"; {measurement.audit.verdict}>")
    assert f"; {measurement.audit.verdict}<br>" in measurement._repr_html_()
