"""The whole way on a small recording with exact truth, and what a run folder promises."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from passes import count_passes
from scenes import DEPTH, FPS, FRAMES, POINTS, motion_mm, write_scene
from simulation import simple_rig
from vfm_sdm.core.datasets import STRUCTURE_AXES, Status, make_points, make_tracks
from vfm_sdm.core.netcdf import read_displacement, read_tracks
from vfm_sdm.core.run_folder import RunFolder
from vfm_sdm.errors import DatasetError, ResultsError, SessionError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.inputs.session import Session, open_views, read_session, write_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.points import named_points
from vfm_sdm.stages.synchronize import synchronize_tracks
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.views import track_views

# Figures are those of `measured`.
pytestmark = pytest.mark.usefixtures("undrawn")

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


@pytest.fixture
def run(measured, tmp_path):
    """A copy of the run folder of the recording."""
    return shutil.copytree(measured[1], tmp_path / "run")


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
        "figures/audit.png",
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
    checks = {check["name"]: check for check in summary["audit"]["checks"]}
    assert summary["audit"]["verdict"] == measured[0].audit.verdict
    assert checks["epipolar error in motion"]["outcome"] == "pass"
    assert checks["gain of injected shifts"]["outcome"] == "pass"
    assert checks["tripods"]["outcome"] == "not possible"


def test_finished_stages_are_reused(recorded, measured):
    again = measure(read_session(recorded), measured[1])
    assert again.summary["reused_stages"] == ["cameras", "tracking", "injection"]
    assert not {"cameras", "tracks"} & set(again.made)
    np.testing.assert_array_equal(again.displacement["displacement"], measured[0].displacement["displacement"])


def test_a_changed_input_runs_the_stage_again(recording, run):
    image = cv2.imread(str(recording.parent / "left" / "005.png"), 0)
    cv2.imwrite(str(recording.parent / "left" / "005.png"), np.roll(image, 1, axis=1))
    again = measure(read_session(recording), run)
    assert again.summary["reused_stages"] == []


def test_a_changed_setting_runs_only_what_depends_on_it(recording, run):
    session = read_session(recording)
    method = {**session.method.model_dump(), "still_interval_s": (0.0, 0.2)}
    again = measure(changed(session, method=method), run)
    assert again.summary["reused_stages"] == ["cameras", "tracking", "injection"]
    assert again.displacement.attrs["relative_to"] == "mean of the still interval"
    method["tracker"] = "template"
    assert measure(changed(session, method=method), run).summary["reused_stages"] == ["cameras"]


@pytest.mark.parametrize(
    "method", [{"tracker": "icgn"}, {"tracker": "template"}, {"tracker": "icgn", "cameras": "file"}]
)
def test_each_product_is_made_once_and_each_recording_decoded_once(recorded, tmp_path, monkeypatch, method):
    """A first frame for cameras and points, a look of bounded length, and the one pass that these trackers need."""
    counted = count_passes(monkeypatch)
    session = read_session(recorded)
    chosen = session.model_copy(update={"method": session.method.model_copy(update=method)})
    result = measure(chosen, tmp_path / "run")
    assert result.displacement is not None
    assert set(result.made) == set(Measurement.products()) - {"expectation"}  # nobody asked for it
    assert set(result.made.values()) == {1}
    assert [len(of_each) for of_each in counted.values()] == [2, 2, 2]
    assert {count for of_each in counted.values() for count in of_each.values()} == {1}
    # Asking again makes nothing again.
    assert result.aligned is result.aligned
    assert set(result.made.values()) == {1}


def test_asking_for_cameras_decodes_first_frames_only(recorded, monkeypatch):
    counted = count_passes(monkeypatch)
    measurement = Measurement(read_session(recorded))
    assert measurement.cameras.rig is not None
    assert set(measurement.made) == {"recordings", "frames", "reference_frames", "sensor_scale", "cameras"}
    assert not counted["passes"]


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
    assert result.cameras.points["status"].sel(view="right", point="a") != "ok"
    assert np.isnan(result.displacement["displacement"].sel(point="a").values).all()
    assert np.isfinite(result.displacement["displacement"].sel(point="c").values).all()
    assert any("point 'a', view 'right'" in note for note in result.summary["notes"])


def test_a_view_in_which_no_point_is_found_has_lost_tracks_on_its_clock(recorded):
    session = read_session(recorded)
    videos = open_views(session)
    nowhere, lost = np.full((2, 2, 2), np.nan), [["lost"] * 2] * 2
    points = make_points(list(videos), ["a", "b"], position=nowhere, position_std=nowhere, status=lost)
    tracks = track_views(videos, points, IcgnTracker())
    for view, of_view in tracks.items():
        np.testing.assert_array_equal(of_view["time"], [frame.time_s for frame in videos[view].frames()])
        assert np.all(of_view["status"].values == Status.LOST)
        assert np.isnan(of_view["position"].values).all()


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
    with pytest.raises(DatasetError, match="refinement: expected the structure's axes, got none"):
        measure(changed(session, method={**session.method.model_dump(), "refinement": "sgr"}))
    with pytest.raises(SessionError, match=r"method\.tracker: expected one of .*, got 'icg'; did you mean 'icgn'"):
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


def test_the_summary_tells_clocks_and_refinement(recording, tmp_path):
    session = read_session(recording)
    # The plane's, whose normal is turned by a fifth to the left.
    across, along = ({"value": DEPTH * turned, "std": 0.05} for turned in (np.sqrt(1 / 1.04), 0.2 * np.sqrt(1 / 1.04)))
    site = {"perpendicular_distance": across, "longitudinal_distance": along, "structure_side": "left"}
    method = {**session.method.model_dump(), "refinement": "sgr"}
    views = [{**view.model_dump(), "time_offset_s": None} for view in session.view]
    measure(changed(session, view=views, site=site, method=method), tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    # Half a second of motion tells no offset, and the session states none.
    assert set(summary["clocks"]) == {"right"}
    assert summary["clocks"]["right"]["status"] == "too short"
    assert any("view 'right': not synchronised by its motion: too short" in note for note in summary["notes"])
    assert (read_displacement(tmp_path / "run")["status"].values == Status.UNRELIABLE).all()
    assert list(summary["refinement"]) == list(POINTS)
    for point in summary["refinement"].values():
        assert point["status"] == "ok"
        assert point["view"] in ("left", "right")
        assert 0 < point["prior_share"] < 1
    plain = measure(changed(session, method={**session.method.model_dump(), "synchronization": "none"}))
    assert (plain.summary["clocks"], plain.summary["refinement"]) == ({}, {})
    assert (plain.displacement["status"].values == Status.OK).all()


FRAME = StructureFrame(structure_from_cam1(0.42, pitch_rad=0.03))
LATE_S = 0.173


def swing_mm(time_s, *, periodic=False):
    """Displacement along the structure's axes (T, 3) [mm]: an even swing, or two that begin after a rest."""
    if periodic:
        return np.outer(np.sin(2 * np.pi * 2.0 * time_s), [4.0, 8.0, 0.0])
    swell = np.clip((time_s - 1) / 1.5, 0, 1) ** 2
    waves = [4 * np.sin(2 * np.pi * 1.4 * time_s), 9 * np.sin(2 * np.pi * (2.2 + 0.1 * time_s) * time_s), 0 * time_s]
    return (swell * np.array(waves)).T


def make_recordings(*, periodic=False, moving=True, noise_px=(0.01, 0.01), late_s=LATE_S, seed=0):
    """Tracks of two points in two views 8 s long, the right one of which begins late; each on its own clock."""
    rig, stamps = simple_rig(), np.arange(240) / 30
    rest = np.array([[0.5, -0.2, 21.0], [-1.5, 0.3, 25.0]])
    rng, tracks = np.random.default_rng(seed), {}
    for name, camera, std, start_s in zip(("left", "right"), rig.cameras, noise_px, (0.0, late_s), strict=True):
        motion = moving * swing_mm(stamps + start_s, periodic=periodic)[:, None] / 1e3
        seen = np.asarray(camera.project(rest + motion @ FRAME.rotation)) + rng.normal(0, std, (240, 2, 2))
        covariance = np.broadcast_to(np.eye(2) * std**2, (240, 2, 2, 2))
        tracks[name] = make_tracks(stamps, ["p", "q"], seen, covariance, np.zeros((240, 2), int), attrs={})
    solution = CameraSolution(
        Rig(("left", "right"), rig.cameras, rig.metric), FRAME, None, named_points(make_session(), ["left", "right"])
    )
    return tracks, solution


def displacement_of(session, tracks, solution):
    return Measurement(session).given(cameras=solution, tracks=tracks).displacement


def make_session(*, method=None, left=None, **right):
    return Session(
        name="bridge",
        view=[
            {"name": "left", "video": "l.mp4", **(left or {})},
            {"name": "right", "video": "r.mp4", **right},
        ],
        site={"baseline": {"value": 4.0, "std": 0.01}},
        point=[{"name": name, "view": "left", "pixel": [1.0, 1.0]} for name in "pq"],
        method={"still_interval_s": [0.0, 0.9], **(method or {})},
    )


def largest_error_mm(displacement):
    error = displacement["displacement"].values - swing_mm(displacement["time"].values)[:, None]
    return np.abs(error[..., :2]).max()


class TestClocks:
    def test_the_motion_tells_the_offset(self):
        tracks, solution = make_recordings()
        displacement = displacement_of(make_session(), tracks, solution)
        right = displacement.sel(view="right")
        offset_s, std_s, ratio = (right[f"clock_{name}"].item() for name in ("offset", "offset_std", "rate"))
        assert offset_s == pytest.approx(LATE_S, abs=1e-3)
        assert 0 < std_s < 1e-3
        assert ratio == 1.0
        assert right["clock_status"] == "ok"
        assert displacement["clock_offset"].sel(view="left") == 0
        assert largest_error_mm(displacement) < 1.0
        assert (displacement["status"].values == Status.OK).all()
        # The same recordings taken as simultaneous are wrong by more than the motion.
        simultaneous = displacement_of(make_session(method={"synchronization": "none"}), tracks, solution)
        assert largest_error_mm(simultaneous) > 10
        assert list(simultaneous["clock_status"].values) == ["as stated", "as stated"]

    @pytest.mark.parametrize(
        "stated",
        [
            {"time_offset_s": LATE_S},
            {"start": "2026-11-20T10:00:00.173Z", "left": {"start": "2026-11-20T11:00:00+01:00"}},
        ],
    )
    def test_a_stated_offset_is_taken_where_the_motion_tells_none(self, stated):
        tracks, _ = make_recordings(moving=False)
        aligned = synchronize_tracks(make_session(**stated), tracks)
        assert aligned["clock_status"].sel(view="right") == "no common motion"
        assert aligned["time"].values[0] == pytest.approx(6 / 30)
        tracks, solution = make_recordings()
        method = {"synchronization": "none"}
        displacement = displacement_of(make_session(method=method, **stated), tracks, solution)
        assert largest_error_mm(displacement) < 1.0

    def test_the_stated_accuracy_of_an_offset_is_in_the_budget(self):
        tracks, solution = make_recordings()
        method = {"synchronization": "none"}
        exact, vague = (
            displacement_of(make_session(method=method, time_offset_s=LATE_S, **std), tracks, solution)
            for std in ({}, {"time_offset_std_s": 0.01})
        )
        parts = [d["uncertainty"].sel(component="synchronization").values for d in (exact, vague)]
        assert np.all(parts[0] == 0)
        assert parts[1].max() > 0.01

    def test_an_offset_that_nobody_knows_makes_samples_unreliable(self):
        tracks, solution = make_recordings(moving=False)
        unknown = displacement_of(make_session(), tracks, solution)
        assert unknown["clock_status"].sel(view="right") == "no common motion"
        assert (unknown["status"].values == Status.UNRELIABLE).all()
        assert np.isnan(unknown["uncertainty"].sel(component="synchronization")).all()
        stated = displacement_of(make_session(time_offset_s=LATE_S), tracks, solution)
        assert stated["clock_status"].sel(view="right") == "no common motion"
        assert (stated["status"].values == Status.OK).all()
        # A time of one view alone says nothing, zero does.
        alone = displacement_of(make_session(start="2026-11-20T10:00:00Z"), tracks, solution)
        assert (alone["status"].values == Status.UNRELIABLE).all()
        together = displacement_of(make_session(time_offset_s=0.0), tracks, solution)
        assert (together["status"].values == Status.OK).all()

    def test_what_was_not_stated_is_not_stated_by_the_session_s_file(self, tmp_path):
        tracks, solution = make_recordings(moving=False)
        written = read_session(write_session(tmp_path / "session.toml", make_session()), check_files=False)
        again = displacement_of(written, tracks, solution)
        assert (again["status"].values == Status.UNRELIABLE).all()

    def test_the_stated_offset_s_accuracy_decides_between_peaks(self):
        tracks, _ = make_recordings(periodic=True)
        session = make_session(time_offset_s=0.2)
        assert synchronize_tracks(session, tracks)["clock_status"].sel(view="right") == "peak not unique"
        sure = make_session(time_offset_s=0.2, time_offset_std_s=0.03)
        found = synchronize_tracks(sure, tracks).sel(view="right")
        assert found["clock_status"] == "ok"
        assert found["clock_offset"].item() == pytest.approx(LATE_S, abs=1e-3)


class TestRefinement:
    def refined(self, *, noise_px=(0.02, 0.1), **sgr):
        tracks, solution = make_recordings(noise_px=noise_px)
        return displacement_of(make_session(method={"refinement": "sgr", "sgr": sgr}), tracks, solution)

    def test_the_poorer_view_is_corrected_and_longitudinal_noise_is_gone(self):
        tracks, solution = make_recordings(noise_px=(0.02, 0.1))
        before, after = displacement_of(make_session(), tracks, solution), self.refined()
        assert after.attrs["refinement"] == "sgr"
        assert list(after["refinement_status"].values) == ["ok", "ok"]
        assert list(after["refined_view"].values) == ["right", "right"]
        assert "refinement_status" not in before
        longitudinal = [float(one["displacement"].sel(axis="longitudinal").std()) for one in (before, after)]
        assert longitudinal[1] < 0.3 * longitudinal[0]
        stated = [float(one["displacement_std"].sel(axis="longitudinal").mean()) for one in (before, after)]
        assert stated[1] < 0.5 * stated[0]
        assert np.abs(after["refinement_correction"].values).max() > 0.05
        assert after["refinement_correction"].attrs["units"] == "px"
        assert ((after["prior_share"] > 0.5) & (after["prior_share"] < 1)).all()
        vertical = after["displacement"].sel(axis="vertical") - swing_mm(after["time"].values)[:, 1, None]
        assert float(np.sqrt((vertical**2).mean())) < 0.3

    def test_its_settings_are_those_of_the_session(self):
        assert list(self.refined(uncertain_view="left")["refined_view"].values) == ["left", "left"]
        share = float(self.refined()["prior_share"][0])
        for lax in ({"pixel": 50.0}, {"longitudinal": 0.1, "longitudinal_rate": 0.1}, {"others": 600.0}):
            assert float(self.refined(**lax)["prior_share"][0]) < share - 0.03
        lateral = [self.refined(suppressed_axis=a)["displacement"].sel(axis="lateral") for a in STRUCTURE_AXES[::2]]
        assert np.ptp(lateral[0].values) < 0.8 * np.ptp(lateral[1].values)
        with pytest.raises(DatasetError, match="'middle'"):
            self.refined(uncertain_view="middle")

    def test_without_the_structure_s_axes_it_is_refused(self):
        tracks, solution = make_recordings()
        with pytest.raises(DatasetError, match="refinement: expected the structure's axes, got none"):
            displacement_of(make_session(method={"refinement": "sgr"}), tracks, replace(solution, frame=None))


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
        checks = {check.name: str(check.outcome) for check in result.audit.checks}
        assert {checks[name] for name in ("epipolar error", "clocks", "slipping tracks")} == {"not possible"}
        assert (checks["scale"], checks["samples missing"], checks["recordings"]) == ("pass", "pass", "pass")
        assert checks["static points"] == "not possible"  # none was named
        assert result.audit.verdict == "use with care"

    def test_without_a_length_there_are_pixels_only(self, recording, tmp_path):
        result = measure(self.session(recording), tmp_path / "run")
        assert result.displacement is None
        assert result.summary["status"] == "one view: motion in the image plane only"
        assert (tmp_path / "run" / "tracks.nc").exists()
        assert (tmp_path / "run" / "summary.json").exists()


class TestFilesOfARun:
    """What goes wrong in folders: none of it is a wrong reuse, a lost input or a traceback."""

    def with_images(self, session, pattern):
        views = tuple(v.model_copy(update={"images": pattern.format(v.name)}) for v in session.view)
        return session.model_copy(update={"view": views})

    @pytest.mark.parametrize("pattern", ["{}/**/*.png", "{}/*/img.png"])
    def test_frames_of_nested_folders_are_in_the_key(self, tmp_path, pattern):
        recording = write_scene(tmp_path / "scene", tracker="template")
        for view in ("left", "right"):
            for path in sorted((recording.parent / view).glob("*.png")):
                (recording.parent / view / path.stem).mkdir()
                path.rename(recording.parent / view / path.stem / "img.png")
        session = self.with_images(read_session(recording, check_files=False), pattern)
        Measurement(session, tmp_path / "run").run("tracks")
        assert Measurement(session, tmp_path / "run").run("tracks").reused == ["cameras", "tracking"]
        (changed_frame,) = (recording.parent / "left").glob("*5/img.png")
        image = cv2.imread(str(changed_frame), 0)
        cv2.imwrite(str(changed_frame), np.roll(image, 1, axis=1))
        assert Measurement(session, tmp_path / "run").run("tracks").reused == []
        assert len(RunFolder(tmp_path / "run").record["input_hashes"]) == 2 * FRAMES + 1

    def test_a_folder_among_the_frames_is_no_frame(self, recording, tmp_path):
        (recording.parent / "left" / "thumbs").mkdir()
        session = self.with_images(read_session(recording, check_files=False), "{}/*.png")
        assert measure(session, tmp_path / "run").displacement is not None

    @pytest.mark.parametrize("content", ["", "[extra]\nstatus = 'ok'", "extra = 3", "[extra]\npoints = []"])
    def test_cameras_of_another_version_are_made_again(self, recorded, tmp_path, content):
        folder = tmp_path / "run"
        folder.mkdir()
        (folder / "cameras.toml").write_text(content)
        assert Measurement(read_session(recorded), folder).cameras.rig is not None

    def test_damaged_tracks_are_made_again(self, tmp_path):
        session, folder = read_session(write_scene(tmp_path / "scene", frames=4, tracker="template")), tmp_path / "run"
        expected = Measurement(session, folder).tracks
        whole = (folder / "tracks.nc").read_bytes()
        rng = np.random.default_rng(3)
        for _ in range(12):
            damaged = bytearray(whole)
            for place in rng.integers(0, len(whole) // 4, 3):
                damaged[place] ^= 0xFF
            (folder / "tracks.nc").write_bytes(bytes(damaged))
            found = Measurement(session, folder).tracks
            assert list(found) == list(expected)

    def test_what_the_session_reads_is_not_overwritten(self, recording):
        text = recording.read_text().replace("rig.toml", "cameras.toml")
        (recording.parent / "rig.toml").rename(recording.parent / "cameras.toml")
        recording.write_text(text)
        before = (recording.parent / "cameras.toml").read_bytes()
        with pytest.raises(ResultsError, match=r"overwritten that the session reads, got cameras\.toml"):
            measure(read_session(recording), recording.parent)
        assert (recording.parent / "cameras.toml").read_bytes() == before

    def test_a_missing_file_is_named(self, recording, tmp_path):
        session = read_session(recording)
        (recording.parent / "rig.toml").unlink()
        with pytest.raises(SessionError, match=r"rig\.toml: expected a file that can be read, got: No such file"):
            _ = Measurement(session, tmp_path / "run").cameras

    def test_who_is_told_may_ask(self, recorded):
        said = []
        measurement = Measurement(
            read_session(recorded), progress=lambda *step: said.append((step, measurement.session))
        )
        assert measurement.tracks
        assert {step[0] for step, _ in said} == {
            "cameras",
            "subsets left",
            "subsets right",
            "tracking left",
            "tracking right",
        }
