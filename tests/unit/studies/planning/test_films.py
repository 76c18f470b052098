"""Films of a plan, a finished run as a plan, best places, and what is written of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from planned import a_plan, fields
from vfm_sdm.commands.app import main
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.netcdf import write_dataset
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import read_session, write_session
from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.cameras.solution import CameraSolution, write_solution
from vfm_sdm.studies.planning.filming import draw_errors, film_plan
from vfm_sdm.studies.planning.from_run import plan_from_run
from vfm_sdm.studies.planning.layout import lay_out, try_lay_out
from vfm_sdm.studies.planning.plan import Area
from vfm_sdm.studies.planning.positions import optimise_positions
from vfm_sdm.studies.planning.prediction import predict
from vfm_sdm.studies.planning.rehearsal import compare_rehearsal, rehearse_tracks
from vfm_sdm.studies.planning.report import list_recordings

SHORT = {"duration_s": 2.5, "still_s": 0.5, "synchronization": "none", "time_offset_std_s": 1e-4}


@pytest.fixture(scope="module")
def prediction():
    return predict(a_plan(**SHORT))


def test_drawn_measurements_state_what_was_predicted(prediction):
    compared = [compare_rehearsal(prediction, rehearse_tracks(prediction.laid, seed=seed)) for seed in range(2)]
    assert [one.status for one in compared] == ["ok"] * 2
    for one in compared:
        assert one.ratio == pytest.approx(1, abs=0.1)
        assert one.error_ratio < 2
    assert np.mean([one.inside for one in compared]) > 0.85


def test_errors_have_the_size_of_their_standard_deviations():
    laid = lay_out(a_plan(**SHORT))
    baselines, focals, pitches = [], [], []
    for seed in range(60):
        true, session = draw_errors(laid, np.random.default_rng(seed))
        baselines.append(session.site.baseline.value - laid.rig.baseline())
        focals.append(np.log(true.cameras[0].focal_px / laid.cameras[0].focal_px))
        pitches.append(session.site.reference_camera_level.pitch_deg)
    # Cut off at two standard deviations a normal distribution has 0.95 of its own.
    assert np.std(baselines) == pytest.approx(0.95 * 0.005, rel=0.3)
    assert np.std(focals) == pytest.approx(0.95 * 0.02, rel=0.3)
    assert np.std(pitches) == pytest.approx(0.95 * 0.2, rel=0.3)


def test_a_film_shows_the_points_where_they_are(tmp_path):
    cameras = [{**one, "image_size": (160, 90)} for one in fields()["camera"]]
    laid = lay_out(a_plan(camera=cameras, **{**SHORT, "duration_s": 1.1, "still_s": 0.1}))
    filmed = film_plan(laid, tmp_path, seed=3)
    session = read_session(tmp_path / "session.toml")
    assert session.site.baseline.value == filmed.session.site.baseline.value
    frame = open_video(tmp_path / "left.mp4").first_frame().luma
    assert frame.shape == (90, 160)
    # The middle of the girder is textured, and brighter on the whole than nothing.
    assert frame[40:50, 60:100].std() > 3
    assert float(np.abs(filmed.truth["displacement"].sel(point="wall")).max()) == 0
    assert float(filmed.truth["displacement"].sel(point="middle", axis="vertical").max()) > 4


def test_pictures_of_different_sizes_are_not_rendered(tmp_path):
    first, second = fields()["camera"]
    laid = lay_out(a_plan(camera=[first, {**second, "image_size": (1280, 720)}], **SHORT))
    with pytest.raises(SessionError, match="pictures of one size"):
        film_plan(laid, tmp_path)


def test_a_rate_that_is_not_whole_is_not_rendered(tmp_path):
    with pytest.raises(SessionError, match="whole frames a second"):
        film_plan(lay_out(a_plan(fps=29.97, **SHORT)), tmp_path)


def as_run(folder, prediction):
    """A run folder with what a measurement of this plan would have left."""
    laid, displacement = prediction.laid, prediction.displacement
    names, pixels = [point.name for point in laid.plan.point], laid.pixels
    points = make_points(
        list(laid.priors.names), names, position=pixels, position_std=0 * pixels,
        status=np.full(pixels.shape[:2], "ok", dtype=object),
    )  # fmt: skip
    found = prediction.adjusted
    folder.mkdir()
    solution = CameraSolution(found.rig, found.frame, found.covariance, points, quantities=found.quantities)
    write_solution(folder / "cameras.toml", solution, "key")
    write_dataset(folder / "displacement.nc", displacement)
    write_session(folder / "session.resolved.toml", laid.session)
    return folder


def test_a_run_as_a_plan_is_predicted_as_it_was_measured(tmp_path, prediction):
    plan = plan_from_run(as_run(tmp_path / "run", prediction))
    again = lay_out(plan)
    for before, after in zip(prediction.laid.cameras, again.cameras, strict=True):
        assert after.focal_px == pytest.approx(before.focal_px, rel=1e-6)
        assert after.center == pytest.approx(before.center, abs=1e-3)
        assert after.rotation == pytest.approx(before.rotation, abs=1e-3)
    assert plan.structure.noise_px == pytest.approx(0.01, rel=0.1)
    assert plan.motion.vertical.frequency_hz == pytest.approx(2.2, rel=0.1)
    for before, after in zip(prediction.axes, predict(again).axes, strict=True):
        assert after.scale_std == pytest.approx(before.scale_std, rel=0.3)
        assert after.budget_mm["random"] == pytest.approx(before.budget_mm["random"], rel=0.1)


def test_a_run_without_the_structures_axes_is_named(tmp_path, prediction):
    adjusted = replace(prediction.adjusted, frame=None)
    folder = as_run(tmp_path / "run", replace(prediction, adjusted=adjusted))
    with pytest.raises(ResultsError, match="in the structure's axes"):
        plan_from_run(folder)


@pytest.mark.slow
def test_the_best_places_see_the_points_and_leave_less(prediction):
    area = Area(perpendicular_m=(4.0, 9.0), longitudinal_m=(-3.0, 12.0))
    found = optimise_positions(prediction, area, starts=8, steps=6)
    assert found.left < 1
    assert found.prediction.relative == pytest.approx(found.left * prediction.relative)
    laid = try_lay_out(found.plan)
    assert laid is not None
    assert laid.visible().all()
    for camera in found.plan.camera:
        assert 4.0 <= camera.perpendicular_m <= 9.0
        assert -3.0 <= camera.longitudinal_m <= 12.0


def test_an_area_without_such_places_is_named(prediction):
    with pytest.raises(SessionError, match="got none of"):
        optimise_positions(prediction, Area(perpendicular_m=(0.5, 0.6), longitudinal_m=(50.0, 51.0)))


def test_an_area_runs_from_the_smaller_to_the_larger():
    with pytest.raises(SessionError, match="expected the smaller one first"):
        a_plan(area={"perpendicular_m": (4.0, 2.0), "longitudinal_m": (0.0, 1.0)})


def test_files_are_as_large_as_rate_and_duration_say():
    sizes = list_recordings(a_plan(), [20.0, 20.0])
    assert [(one.camera, one.frames, one.megabytes) for one in sizes] == [("left", 120, 20.0), ("right", 120, 20.0)]


@pytest.mark.slow
def test_the_command_prints_and_writes(tmp_path, capsys):
    path = tmp_path / "plan.toml"
    path.write_text(tomli_w.dumps(fields(**SHORT, point=fields()["point"][1:2])), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["plan", str(path), "-o", str(tmp_path / "out")])
    assert not ended.value.code
    said = capsys.readouterr().out
    assert "limited by: " in said
    assert "What would help most" in said
    table = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert table["points"]["middle"]["vertical"]["expanded_mm"] > 0
    assert sum(table["shares"].values()) == pytest.approx(1, abs=0.01)
    assert table["recordings"][0]["megabytes"] == pytest.approx(12.5)
    assert (tmp_path / "out" / "plan.png").read_bytes().startswith(b"\x89PNG")
