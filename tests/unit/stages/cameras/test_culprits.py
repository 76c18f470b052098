"""The claim that is wrong is named; a lens that nothing checks keeps the scale from being fit to use."""

from dataclasses import replace

import numpy as np
import pytest

from measurements import simulate
from simulation import project_all
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.propagation import compute_gain_sensitivity
from vfm_sdm.stages.audit.lenses import find_unseen_lens_error
from vfm_sdm.stages.cameras.culprits import Suspect, name_confusions
from vfm_sdm.stages.cameras.site_cameras import ALL_FOCALS

CHECKED = {"focal_std": 0.02, "focal_errors": (0.004, -0.006), "distortion_std": 0.0, "distortion_errors": (0.0, 0.0)}
CHECKED |= {"length_std": 0.003, "length_error": 0.0, "range_std": 0.01, "range_error": 0.0, "baseline_std": 0.005}
CHECKED |= {"baseline_error": 0.0, "perpendicular_std": 0.03, "face_offset_std": 0.03, "focal_px": 6000.0}


def unseen_of(run):
    slopes = compute_gain_sensitivity(project_all(run.rig, run.points3d[:1]), run.solution.rig)
    return find_unseen_lens_error(run.solution, np.pad(slopes[0, :, 1, 1], (0, 3)))


@pytest.mark.parametrize("seed", [1, 2])
def test_what_agrees_has_no_culprit(seed):
    run = simulate(seed, **CHECKED)
    assert run.solution.status == CameraStatus.OK
    assert run.solution.suspects == ()


@pytest.mark.parametrize("seed", [1, 2])
def test_lenses_that_are_both_wrong_are_named_together(seed):
    run = simulate(seed, **CHECKED | {"focal_errors": (0.2, 0.2)})
    assert run.solution.status == CameraStatus.DISAGREE
    assert run.solution.suspects[0].name == ALL_FOCALS
    assert any("most probably wrong: focal lengths of all views" in note for note in run.solution.notes)


def test_a_length_that_was_misread_is_named():
    run = simulate(1, **CHECKED | {"length_error": 0.5})
    assert run.solution.suspects[0].name == "length p0 to p1"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_length_checks_the_lenses(seed):
    alone = CHECKED | {"length_std": None, "range_std": None, "face_offset_std": 0.15}
    assert unseen_of(simulate(seed, **CHECKED)) < 0.5 * unseen_of(simulate(seed, **alone))


def test_calibrated_lenses_are_not_doubted():
    run = simulate(1, **CHECKED | {"focal_std": 0.003, "focal_errors": (0.0, 0.0)})
    assert unseen_of(run) == 0.0


def test_what_lenses_leave_unseen_grows_with_what_rests_on_them():
    run = simulate(1, **CHECKED)
    loose = replace(run.solution, covariance=np.zeros_like(run.solution.covariance))
    slopes = np.ones(len(loose.covariance))
    assert find_unseen_lens_error(loose, slopes) == 0.0


@pytest.mark.parametrize(
    ("suspect", "words"),
    [
        (("baseline", "m", 3780.0, 3.79), "stated in millimetres"),
        (("pitch reference camera", "deg", 5.0, -5.1), "stated with the other sign"),
        (("focal left", "px", 8533.0, 4790.0), "of the other side of a picture"),
        (("baseline", "m", 3.9, 3.79), ""),
    ],
)
def test_simple_confusions_are_recognised(suspect, words):
    found = list(name_confusions(Suspect(*suspect, freed_std=0.001, drop=9.0, rank=81.0)))
    assert found == [] if not words else words in found[0]
