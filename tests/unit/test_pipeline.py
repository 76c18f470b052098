"""What the pipeline does between the stages, on simulated measurements."""

from dataclasses import replace

import numpy as np
import pytest

from faults import FAULTS, good_run
from measurements import MOVING, Simulated
from vfm_sdm.pipeline import audit_of, displacement_of, steady_tracks
from vfm_sdm.stages.audit import Outcome


def error_mm(run: Simulated, camera_motion: str) -> float:
    """Root mean square error of vertical displacement of the structure's points, less their mean."""
    method = run.session.method.model_copy(update={"camera_motion": camera_motion})
    displacement = displacement_of(run.session.model_copy(update={"method": method}), run.tracks, run.solution)
    error = run.error_of(displacement).sel(point=list(MOVING), axis="vertical")
    return float(np.sqrt(((error - error.mean("time")) ** 2).mean()))


@pytest.mark.parametrize("seed", [0, 3])
def test_a_tripod_that_sways_is_taken_out_of_the_displacement(seed):
    shaken = FAULTS["a moved tripod"][0](seed)
    assert error_mm(shaken, "remove") < error_mm(shaken, "keep") / 5
    displacement = displacement_of(shaken.session, shaken.tracks, shaken.solution)
    assert displacement.attrs["camera_motion_right_status"] == "ok"
    before, after = displacement.attrs["camera_motion_right"]
    assert after < before / 10
    found = audit_of(shaken.session, shaken.tracks, shaken.solution, displacement)["tripods"]
    assert found.outcome == Outcome.CAUTION
    assert f"{before:.2f} px (rms) were removed" in found.sentence


def test_cameras_that_stand_still_keep_their_tracks():
    run = good_run(0)
    tracks, motions = steady_tracks(run.session, run.tracks, run.solution)
    assert {motion.status for motion in motions.values()} == {"still"}
    assert all(tracks[view] is run.tracks[view] for view in tracks)


def test_without_static_points_nothing_is_looked_for():
    run = good_run(0)
    points = tuple(p for p in run.session.point if not p.static)
    session = run.session.model_copy(update={"point": points})
    assert steady_tracks(session, run.tracks, run.solution) == (run.tracks, {})
    rig_unknown = replace(run.solution, rig=None)
    assert steady_tracks(run.session, run.tracks, rig_unknown) == (run.tracks, {})
