"""The whole way on a small recording with exact truth, and what a run folder promises."""

import json
import shutil

import cv2
import numpy as np
import pytest

from scenes import FPS, FRAMES, POINTS, motion_mm, write_scene
from vfm_sdm.errors import BackendUnavailableError, ResultsError, SessionError
from vfm_sdm.measurement import measure
from vfm_sdm.results import read_displacement, read_tracks
from vfm_sdm.session import read_session, write_session

TRUE_MM = np.array([motion_mm(i) for i in range(FRAMES)])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def measured(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return measure(read_session(recorded), folder), folder


@pytest.fixture
def recording(recorded, tmp_path):
    """A copy that a test may damage."""
    shutil.copytree(recorded.parent, tmp_path / "scene")
    return tmp_path / "scene" / "session.toml"


def changed(session, **fields):
    return type(session)(**{**session.model_dump(), "folder": session.folder, **fields})


def test_displacement_is_the_truth(measured):
    displacement = measured[0].displacement
    error = displacement["displacement"].values - TRUE_MM[:, None]
    # Grey values are rounded to integers: some thousandths of a pixel, of which one is 12 mm wide and 35 mm deep.
    assert np.abs(error[..., :2]).max() < 0.08
    assert np.abs(error[..., 2]).max() < 0.25
    assert list(displacement["point"].values) == list(POINTS)
    np.testing.assert_allclose(displacement["time"].values, np.arange(FRAMES) / FPS)


def test_errors_are_of_the_size_that_is_stated(measured):
    displacement = measured[0].displacement
    error = (displacement["displacement"].values - TRUE_MM[:, None])[1:]
    ratio = error / displacement["displacement_std"].values[1:]
    assert 0.3 < np.sqrt(np.mean(ratio**2)) < 2.5


def test_the_run_folder_holds_everything(measured):
    result, folder = measured
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert {
        "cameras.toml",
        "tracks.nc",
        "displacement.nc",
        "displacement.csv",
        "summary.json",
        "session.resolved.toml",
        "figures/points_left.png",
        "figures/points_right.png",
        "figures/trajectory_left.png",
        "figures/trajectory_right.png",
        "figures/displacement_a.png",
    } <= names
    assert not [n for n in names if n.startswith(".")]
    np.testing.assert_array_equal(
        read_displacement(folder)["displacement"].values, result.displacement["displacement"].values
    )
    assert list(read_tracks(folder)) == ["left", "right"]


def test_the_summary_lets_a_reviewer_trace_the_figures(measured):
    summary = json.loads((measured[1] / "summary.json").read_text())
    assert summary["status"] == "ok"
    assert set(summary["seconds"]) >= {"cameras", "tracking", "displacement", "figures"}
    assert len(summary["input_hashes"]) == 2 * FRAMES + 1
    assert summary["versions"]["vfm-sdm"]
    lateral = summary["points"]["a"]["axes"]["right"]
    assert lateral["peak_to_peak_mm"] == pytest.approx(np.ptp(TRUE_MM[:, 0]), abs=0.1)
    assert lateral["expanded_uncertainty_mm"] > 0
    assert summary["recordings"]["left"]["frames"] == FRAMES


def test_finished_stages_are_reused(recorded, measured, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("a finished stage was run again")

    monkeypatch.setattr("vfm_sdm.measurement.solve_cameras", refuse)
    monkeypatch.setattr("vfm_sdm.measurement.track_views", refuse)
    again = measure(read_session(recorded), measured[1])
    assert again.summary["reused_stages"] == ["cameras", "tracking"]
    np.testing.assert_array_equal(again.displacement["displacement"], measured[0].displacement["displacement"])


def test_a_changed_input_runs_the_stage_again(recording, tmp_path):
    out = tmp_path / "run"
    measure(read_session(recording), out)
    image = cv2.imread(str(recording.parent / "left" / "005.png"), 0)
    cv2.imwrite(str(recording.parent / "left" / "005.png"), np.roll(image, 1, axis=1))
    again = measure(read_session(recording), out)
    assert again.summary["reused_stages"] == []


def test_a_changed_setting_runs_only_what_depends_on_it(recording, tmp_path):
    out = tmp_path / "run"
    session = read_session(recording)
    measure(session, out)
    method = {**session.method.model_dump(), "still_interval_s": (0.0, 0.2)}
    again = measure(changed(session, method=method), out)
    assert again.summary["reused_stages"] == ["cameras", "tracking"]
    assert again.displacement.attrs["relative_to"] == "mean of the still interval"
    method["tracker"] = "template"
    assert measure(changed(session, method=method), out).summary["reused_stages"] == ["cameras"]


def test_without_a_folder_nothing_is_written(recorded, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = measure(read_session(recorded))
    assert result.displacement is not None
    assert list(tmp_path.iterdir()) == []


def test_an_unstated_camera_covariance_is_an_unknown_scale(tmp_path):
    result = measure(read_session(write_scene(tmp_path, covariance=False, frames=4)))
    assert np.isnan(result.displacement["scale_std"].values).all()
    assert any("no stated uncertainty" in note for note in result.summary["notes"])


def test_a_point_without_texture_is_missing_with_its_reason(recording):
    for path in (recording.parent / "right").glob("*.png"):
        image = cv2.imread(str(path), 0)
        image[:, :170] = 128
        cv2.imwrite(str(path), image)
    result = measure(read_session(recording))
    states = result.cameras.point_status["right"]
    assert states["a"] != "ok"
    assert np.isnan(result.displacement["displacement"].sel(point="a").values).all()
    assert np.isfinite(result.displacement["displacement"].sel(point="c").values).all()
    assert any("point 'a', view 'right'" in note for note in result.summary["notes"])


def test_a_second_recording_that_starts_late_is_put_on_the_first_clock(recording):
    for index in range(3):
        (recording.parent / "right" / f"{index:03}.png").unlink()
    session = read_session(recording)
    views = [v.model_dump() for v in session.view]
    views[1]["time_offset_s"] = 3 / FPS
    point = [{**p.model_dump(), "pixel_in": {}} for p in session.point]
    result = measure(changed(session, view=views, point=point))
    displacement = result.displacement["displacement"].values
    assert displacement.shape[0] == FRAMES - 3
    # Points were named in the left view's first frame, the right view's first frame is three frames later.
    assert result.tracks["right"].sizes["time"] == FRAMES - 3


def test_refusals(recording, tmp_path):
    session = read_session(recording)
    with pytest.raises(BackendUnavailableError, match="refinement: expected 'none', got 'sgr'"):
        measure(changed(session, method={**session.method.model_dump(), "refinement": "sgr"}))
    with pytest.raises(BackendUnavailableError, match="tracker: expected one of"):
        measure(changed(session, method={**session.method.model_dump(), "tracker": "icg"}))
    outside = [{"name": "far", "view": "left", "pixel": [4000.0, 10.0]}]
    with pytest.raises(SessionError, match=r"'far' in view 'left': expected inside 360 x 260, got \(4000, 10\)"):
        measure(changed(session, point=outside))
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ResultsError, match="expected a folder to write to"):
        measure(session, tmp_path / "file")


def test_the_resolved_session_measures_the_same(measured, tmp_path):
    _, folder = measured
    resolved = read_session(folder / "session.resolved.toml")
    again = measure(resolved)
    np.testing.assert_array_equal(again.displacement["displacement"], measured[0].displacement["displacement"])
    assert write_session(tmp_path / "copy.toml", resolved).exists()


class TestSingleView:
    def session(self, recording, **site):
        session = read_session(recording)
        view = session.view[0].model_dump()
        method = {**session.method.model_dump(), "tracker": "template", "cameras": "two-view"}
        return changed(session, view=[{**view, "camera": None}], method=method, site=site)

    def test_a_known_length_gives_the_paper_s_monocular_baseline(self, recording):
        a, b = np.array(POINTS["a"]), np.array(POINTS["c"])
        metres = 10 / 800 * np.linalg.norm(a - b)
        length = {"points": ("a", "c"), "value": metres, "std": 0.01 * metres}
        result = measure(self.session(recording, length=[length]))
        displacement = result.displacement
        assert list(displacement["axis"].values) == ["right", "down"]
        assert displacement.attrs["frame"] == "image plane"
        # One sixteenth of a pixel is 0.8 mm here; depth and perspective cost some per cent more.
        error = displacement["displacement"].values[..., 1] - TRUE_MM[:, None, 1]
        assert np.abs(error).max() < 1.2
        assert displacement["scale_std"].values == pytest.approx(0.012, abs=0.003)

    def test_without_a_length_there_are_pixels_only(self, recording, tmp_path):
        result = measure(self.session(recording), tmp_path / "run")
        assert result.displacement is None
        assert result.summary["status"] == "one view: motion in the image plane only"
        assert (tmp_path / "run" / "tracks.nc").exists()
        assert (tmp_path / "run" / "summary.json").exists()
