"""What a finished run shows on the page is what its files hold."""

import json
import shutil

import numpy as np
import pytest

from run_folders import write_run
from vfm_sdm.core.datasets import CAMERA_AXES, STRUCTURE_AXES
from vfm_sdm.core.netcdf import read_displacement, read_tracks
from vfm_sdm.page.review import Results, stand_before


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run [a] ö")
    measurement, _ = write_run(folder)
    return folder, measurement


@pytest.fixture(scope="module")
def results(run):
    return Results(run[0])


def test_histories_are_the_samples_with_their_uncertainty(run, results):
    found = read_displacement(run[0]).sel(point="p0", axis="vertical")
    history = results.history("p0", "vertical")
    assert np.array_equal(history.time_s, found["time"].values)
    assert np.array_equal(history.values, found["displacement"].values, equal_nan=True)
    assert np.allclose(history.above - history.below, 2 * found["expanded_uncertainty"].values, equal_nan=True)
    part = results.history("p0", "vertical", (1.0, 2.0))
    inside = (found["time"].values >= 1.0) & (found["time"].values <= 2.0)
    # One more to either side, to which the line goes on.
    wider = inside | np.roll(inside, 1) | np.roll(inside, -1)
    assert np.array_equal(part.time_s, found["time"].values[wider])
    assert len(results.history("p0", "vertical", (90.0, 91.0)).time_s) <= 1
    assert results.span_s == (found["time"].values[0], found["time"].values[-1])


def test_the_spectrum_peaks_where_the_structure_swings(results):
    frequency_hz, amplitude_mm = results.spectrum("p0", "vertical")
    assert frequency_hz[amplitude_mm.argmax()] == pytest.approx(2.5, abs=0.3)


def test_the_budget_is_that_of_the_summary(run, results):
    stated = results.summary["points"]
    rows = results.budget()
    assert len(rows) == 3 * len(stated)
    for row in rows:
        values = stated[row["point"]]["axes"][row["axis"]]
        assert row["expanded"] == pytest.approx(values["expanded_uncertainty_mm"], abs=6e-5)
        for name, value in values["budget_mm"].items():
            assert row[name] == pytest.approx(value, abs=6e-5)


def test_a_run_that_measured_nothing_is_shown(run, tmp_path):
    """Points without one trusted sample have no budget."""
    folder = shutil.copytree(run[0], tmp_path / "run")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for point in summary["points"].values():
        for values in point["axes"].values():
            values |= {"budget_mm": None, "peak_to_peak_mm": None, "expanded_uncertainty_mm": None}
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    rows = Results(folder).budget()
    assert len(rows) == 3 * len(summary["points"])
    assert {row["expanded"] for row in rows} == {None}


def test_what_is_positive_is_said(results):
    assert results.positive("vertical") == " (positive: down)"
    assert results.positive("sideways") == ""


def test_the_scene_is_no_mirror_image():
    """Right, away and up are right-handed, for axes of a structure and of a camera."""
    for axes in (STRUCTURE_AXES, CAMERA_AXES):
        assert np.linalg.det(stand_before(axes)) == pytest.approx(1.0)
    right, _, up = stand_before(STRUCTURE_AXES)
    assert right.tolist() == [0.0, 0.0, -1.0]
    assert up.tolist() == [0.0, -1.0, 0.0]


def test_the_film_shows_the_tracks(run, results):
    tracks = read_tracks(run[0])["left"]
    film = results.film("left")
    assert film["points"] == [str(name) for name in tracks["point"].values]
    assert len(film["position"]) == len(film["numbers"]) == tracks.sizes["time"]
    assert np.allclose(film["position"][5][0], tracks["position"].values[5, 0], atol=6e-4)
    assert film["home"][0] == film["position"][0][0]
    assert sum(film["static"]) == 3


def test_the_scene_is_in_the_structures_axes(run, results):
    scene = results.scene()
    rig, frame = run[1].cameras.rig, run[1].cameras.frame
    assert np.allclose(scene["cameras"], [frame.rotation @ camera.center for camera in rig.cameras])
    assert np.allclose(np.linalg.norm(scene["looks"], axis=1), 1.0)
    assert scene["motion"].shape[1:] == (len(scene["points"]), 3)


def test_results_of_another_session_are_told(run, results):
    session = run[1].session
    assert results.doubts(session) == []
    changed = session.model_copy(update={"name": "another"})
    for other in (changed, None):
        assert any("was changed since this was measured" in one for one in results.doubts(other))
