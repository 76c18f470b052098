"""Every command as a user would type it."""

import json
import re
import subprocess
import sys

import cv2
import numpy as np
import pytest

from scenes import write_scene
from turning import draw_plan, look
from vfm_sdm.analysis.evaluation.metrics import Score
from vfm_sdm.commands import lens as lens_command
from vfm_sdm.commands.terminal import OUT
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.inputs.session import Session, read_session, write_session
from vfm_sdm.outputs.results import write_displacement
from vfm_sdm.stages.lens.adjustment import adjust_clip
from vfm_sdm.stages.lens.clip import judge_lens
from vfm_sdm.stages.lens.file import read_lens
from vfm_sdm.stages.lens.scene import PanScene
from vfm_sdm.studies.protocol import Benchmark, Case
from vfm_sdm.studies.protocol.tables import comparison_table
from vfm_sdm.studies.synthetic.pan_clip import write_pan_clip
from vfm_sdm.studies.synthetic.presets import PRESETS


@pytest.fixture(scope="module")
def session_file(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"), frames=5)


def test_measure(command, session_file, tmp_path, request):
    status, out, _ = command("measure", session_file, "-o", tmp_path / "run")
    assert status == 0
    assert "cameras: ok" in out
    assert "p-p" in out
    assert "measure site.perpendicular_distance" in out
    assert (tmp_path / "run" / "displacement.csv").exists()
    assert (tmp_path / "run" / "figures" / "audit.png").exists()
    request.getfixturevalue("undrawn")  # once is enough
    status, out, _ = command("measure", session_file, "-o", tmp_path / "run", "--export", "mat", "--export", "uff")
    assert status == 0
    assert (tmp_path / "run" / "displacement.mat").exists()
    assert (tmp_path / "run" / "displacement.uff").exists()
    assert "reused from the run folder: cameras, tracking" in out
    rows = (tmp_path / "run" / "displacement.csv").read_text().splitlines()
    status, _, _ = command("measure", session_file, "-o", tmp_path / "run", "--csv-every", "2")
    assert status == 0
    assert (tmp_path / "run" / "displacement.csv").read_text().splitlines() == [rows[0], *rows[1::2]]
    status, _, said = command("measure", session_file, "-o", tmp_path / "run", "--csv-every", "0")
    assert (status, "--csv-every: expected 1 or more, got 0" in said) == (1, True)


def test_stages_one_by_one(command, session_file, tmp_path):
    status, out, _ = command("cameras", session_file, "-o", tmp_path)
    assert status == 0
    assert "focal left" in out
    assert (tmp_path / "cameras.toml").exists()
    status, out, _ = command("track", session_file, "-o", tmp_path)
    assert status == 0
    assert "[px]" in out
    assert (tmp_path / "tracks.nc").exists()
    status, out, _ = command("displacement", session_file, "-o", tmp_path)
    assert status == 0
    assert (tmp_path / "displacement.nc").exists()


def vibration(time_s):
    """Displacement [m] along all axes, at rest for the first second; shape (T, 3)."""
    swell = np.clip((time_s - 1) / 2, 0, 1) ** 3
    beat = np.sin(2 * np.pi * 2.3 * time_s + 0.8 * np.sin(0.7 * time_s)) * swell
    return 1e-3 * beat[:, None] * [2.0, 4.0, 0.1]


@pytest.fixture(scope="module")
def sensor_file(tmp_path_factory):
    """An accelerometer's file, 1.5 s behind the video, with a column of another name and the other sign."""
    stamps, step = np.arange(20 * 64) / 64, 1e-3
    before, now, after = (vibration(stamps - 1.5 + shift) for shift in (-step, 0, step))
    acceleration = (before - 2 * now + after) / step**2 / 9.80665 + [0, -1, 0]
    rows = np.column_stack([stamps, acceleration * [1, -1, 1]])
    path = tmp_path_factory.mktemp("sensor") / "acc.csv"
    lines = [",".join(f"{value:.9f}" for value in row) for row in rows]
    path.write_text("\n".join(["time,lateral,up,longitudinal", *lines]) + "\n")
    return path


@pytest.fixture
def run_folder(tmp_path):
    """A run folder with the displacement of one point, exact but for a little noise."""
    time_s = np.arange(450) / 30
    values = 1e3 * vibration(time_s)[:, None] + 0.01 * np.random.default_rng(1).standard_normal((450, 1, 3))
    displacement = make_displacement(
        time_s,
        ["mid"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(values.shape, 0.01),
            scale_std=np.zeros((1, 3)),
            position_m=np.zeros(values.shape),
            reprojection_error_px=np.zeros((450, 1)),
            status=np.zeros((450, 1), int),
        ),
        attrs={"frame": "structure"},
    )
    write_displacement(tmp_path / "run", displacement)
    return tmp_path / "run"


def test_reference_and_evaluate(command, sensor_file, run_folder, tmp_path):
    columns = [f"--column={name}" for name in ("lateral=lateral", "vertical=-up")]
    status, out, _ = command("reference", sensor_file, "-o", tmp_path / "ref.nc", "--sensor", "acc-1", *columns)
    assert status == 0
    assert "onset detected" in out
    assert "acc-1" in out
    assert "longitudinal" not in out
    status, out, _ = command("evaluate", run_folder, tmp_path / "ref.nc", "--pair", "mid=acc-1")
    assert status == 0
    assert re.search(r"Compared with sensors acc-1, 1 to 10 Hz, lag (149|150)\d\.\d \+- 0\.\d ms", out)
    assert re.search("mean +2 of 2 ", out)
    written = json.loads((run_folder / "evaluation.json").read_text())
    assert written["mean"]["correlation"] > 0.99
    assert written["synchronization"]["lag_s"] == pytest.approx(1.5, abs=2e-3)
    options = ["--no-synchronize", "--start-lag", "1.5", "--axis", "vertical", "--band", "1.5", "6"]
    status, out, _ = command("evaluate", run_folder, tmp_path / "ref.nc", "--pair", "mid=acc-1", *options)
    assert status == 0
    assert re.search(r"Compared with sensors acc-1, 1\.5 to 6 Hz *\n", out)
    assert re.search("mean +1 of 1 ", out)
    status, out, _ = command("evaluate", run_folder, run_folder / "displacement.nc")
    assert status == 0
    assert "100" in out


def test_a_file_that_speaks_for_itself_needs_no_options(command, tmp_path):
    time_s = np.arange(1600) / 200
    felt = -9.80665 + 2 * np.sin(2 * np.pi * 2.1 * time_s) + np.random.default_rng(0).normal(0, 1e-3, 1600)
    lines = ["Logger 7", "Time [ms];Vertical [m/s²]"]
    lines += [f"{5 * n};{value:.6f}".replace(".", ",") for n, value in enumerate(np.maximum(felt, -11.0))]
    (tmp_path / "acc.csv").write_text("\n".join(lines), encoding="utf-16")
    status, out, err = command("reference", tmp_path / "acc.csv", "-o", tmp_path / "ref.nc", "--hampel", "off")
    assert status == 1
    assert "clipped at the end of the sensor's range" in err
    lines[2:] = [f"{5 * n};{value:.6f}".replace(".", ",") for n, value in enumerate(felt)]
    lines[500] = lines[500].split(";")[0] + ";"
    (tmp_path / "acc.csv").write_text("\n".join(lines), encoding="utf-16")
    status, out, _ = command("reference", tmp_path / "acc.csv", "-o", tmp_path / "ref.nc")
    assert status == 0
    assert "vertical p-p" in out
    assert "note: 'acc', vertical: 1 samples, from 2.49 to 2.49 s, are missing" in " ".join(out.split())


def test_a_path_is_printed_in_one_piece(command, monkeypatch, sensor_file, tmp_path):
    monkeypatch.setattr(OUT, "width", 30)
    output = tmp_path / "my [bold] bridge, spring and autumn" / "ref.nc"
    status, out, _ = command("reference", sensor_file, "-o", output, "--column=vertical=-up")
    assert status == 0
    assert f"written: {output}\n" in out


def test_a_reference_that_does_not_fit_is_refused(command, sensor_file, run_folder, tmp_path):
    status, _, err = command("reference", sensor_file, "-o", tmp_path / "ref.nc")
    assert status == 1
    assert "expected a column 'vertical'" in err
    status, _, err = command("reference", sensor_file, "-o", tmp_path / "ref.nc", "--column", "vertical")
    assert status == 1
    assert "--column: expected name=value, each name once, got 'vertical'" in err
    status, _, err = command("evaluate", run_folder, sensor_file)
    assert status == 1
    assert "convert the file with `vfm-sdm reference`" in err


def test_no_lag_is_status_three(command, sensor_file, run_folder, tmp_path):
    command("reference", sensor_file, "-o", tmp_path / "ref.nc", "--column=vertical=-up", "--onset", "2")
    options = ["--pair", "mid=acc", "--search", "0.1", "--start-lag", "20"]
    status, out, err = command("evaluate", run_folder, tmp_path / "ref.nc", *options)
    assert status == 3
    assert "no figures: lag of the reference unknown: too short" in err
    assert re.search("mean +0 of 1 ", out)
    assert json.loads((run_folder / "evaluation.json").read_text())["mean"]["correlation"] is None


@pytest.fixture
def benchmark_calls(monkeypatch):
    """What the command asks the library for; the library answers with two small tables."""
    case = Case("data-2", "mid", "vertical")
    score = Score(0.0312, 0.987, 0.02, 1.0, 0.01, 0.9, 0.95, 0.0, 0.0, 100, None, False)
    tables = {
        name: comparison_table(name, f"THE {name}", {"with SGR": {case: score}}, cases=cases)
        for name, cases in (
            ("refinement_against_truth", [case]),
            ("refinement_against_accelerometers", [case]),
            ("outside_assumptions", []),
        )
    }
    calls = []

    def run(folder, **options):
        calls.append((folder, options))
        return Benchmark(folder, dict(tables), {}, [], 90.0)

    monkeypatch.setattr("vfm_sdm.commands.benchmark.run_benchmark", run)
    return calls, tables, case, score


def test_benchmark(command, benchmark_calls, tmp_path):
    calls, tables, case, score = benchmark_calls
    status, out, _ = command("benchmark", "-o", tmp_path / "out")
    assert status == 0
    folder, options = calls.pop()
    assert folder == tmp_path / "out"
    progress = options.pop("progress")
    progress("filming", 1, 2)
    assert options == {"size": "small", "names": PRESETS, "sensitivity": True}
    assert "with SGR, against truth" in out
    assert "with SGR, against accelerometers" in out
    assert re.search(r"data-2 +mid +vertical +0\.031 +0\.987 +0\.020", out)
    assert re.search(r"README.md, tables and figures beside it; 1\.5 min", out)
    # Field tests outside the assumptions are shown apart, and only where there are any.
    assert "THE outside_assumptions" not in out
    tables["outside_assumptions"] = comparison_table("o", "THE outside", {"with SGR": {case: score}}, cases=[case])
    words = ["--size", "full", "--data", "data-4", "--data", "data-1", "--no-sensitivity"]
    status, out, _ = command("benchmark", "-o", tmp_path / "out", *words)
    assert status == 0
    options = calls.pop()[1]
    assert (options["size"], options["names"], options["sensitivity"]) == ("full", ("data-4", "data-1"), False)
    assert "THE outside" in out


def test_a_benchmark_of_what_is_not_there_is_refused(command, benchmark_calls, tmp_path):
    for words in (["--data", "data-5"], ["--size", "huge"]):
        assert command("benchmark", "-o", tmp_path, *words)[0] != 0
    assert command("benchmark")[0] != 0
    assert benchmark_calls[0] == []


def test_info(command):
    status, out, _ = command("info")
    assert status == 0
    for expected in (
        "numpy",
        "icgn: can run",
        "two-view: can run",
        "h264: yes",
        "hevc: yes",
        "vision foundation models",
    ):
        assert expected in out


def test_version_and_help(command):
    assert command("--version")[1].strip() == "0.1.0"
    status, out, _ = command("--help")
    assert status == 0
    for name in ("demo", "measure", "track", "cameras", "displacement", "reference", "evaluate", "benchmark", "info"):
        assert name in out


def test_a_missing_session_is_one_line_and_a_status(command, tmp_path):
    status, out, err = command("measure", tmp_path / "none.toml", "-o", tmp_path / "run")
    assert status == 1
    assert out == ""
    assert err.startswith("vfm-sdm: ")
    assert "none.toml" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_a_missing_option_says_so(command, session_file):
    status, _, err = command("measure", session_file)
    assert status != 0
    assert "output" in err.lower()


def test_no_result_from_the_data_is_status_three(command, session_file, tmp_path):
    session = read_session(session_file)
    fields = {**session.model_dump(), "folder": session.folder, "view": [session.view[0].model_dump()]}
    alone = write_session(tmp_path / "alone.toml", Session(**{**fields, "method": {"cameras": "two-view"}}))
    status, _, err = command("measure", alone, "-o", tmp_path / "run")
    assert status == 3
    assert "one view" in err
    assert (tmp_path / "run" / "tracks.nc").exists()


def test_installed_as_a_command():
    done = subprocess.run([sys.executable, "-m", "vfm_sdm", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0.1.0"


def test_a_pan_clip_gives_no_lens_where_the_camera_stands_still(command, tmp_path):
    plan = draw_plan(0, 40, size=(320, 180), fps=10, duration_s=1.0, turn_deg=(0.1, 0.1, 0.1))
    clip = write_pan_clip(tmp_path / "pan.mp4", plan)
    status, _, err = command("lens", clip, "-o", tmp_path / "lens.toml")
    assert status == 3
    assert "no lens: the camera hardly turns" in err
    assert "pan, tilt and roll the camera" in err
    assert [path.name for path in tmp_path.iterdir()] == ["pan.mp4"]


def test_a_pan_clip_gives_a_lens_file(command, tmp_path, monkeypatch):
    """The way from an estimate to the file; the estimate itself is simulated."""
    plan = draw_plan(0, 40, size=(320, 180), fps=10, duration_s=0.5, distance_m=(300.0, 3000.0))
    clip = write_pan_clip(tmp_path / "pan.mp4", plan)
    estimate = judge_lens(adjust_clip(*look(plan, frames=12, points=300)), np.arange(12.0))
    scenes = []
    monkeypatch.setattr(lens_command, "estimate_lens", lambda video, scene: scenes.append(scene) or estimate)
    words = ["--nearest", 300, "--farthest", 3000, "--lever", 0.02]
    status, out, _ = command("lens", clip, "-o", tmp_path / "lens.toml", *words)
    assert status == 0
    assert scenes == [PanScene(300.0, 3000.0, 0.02)]
    assert "field of view" in out
    assert "principal" in out  # a narrow terminal breaks the line
    known = read_lens(tmp_path / "lens.toml")
    np.testing.assert_allclose(known.camera.K, estimate.camera.K)
    np.testing.assert_allclose(known.covariance, estimate.covariance)
    picture = cv2.imread(str(tmp_path / "lens.png"))
    assert picture.shape[1] == 1500
    (tmp_path / "lens.png").unlink()
    status, *_ = command("lens", clip, "-o", tmp_path / "lens.toml", *words, "--no-figure")
    assert status == 0
    assert not (tmp_path / "lens.png").exists()
    scenes.clear()
    status, _, err = command("lens", clip, "-o", tmp_path / "lens.toml", "--nearest", 3000, "--farthest", 300)
    assert status == 1
    assert "expected 0 < nearest <= farthest distance" in err
