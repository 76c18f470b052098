"""The paper's protocol on a field test so small that it can be run, killed and run again."""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from golden import golden_folder, load_recipe, read_shapes
from vfm_sdm.core.products import Chain
from vfm_sdm.errors import ResultsError
from vfm_sdm.studies.protocol import Case, run_benchmark
from vfm_sdm.studies.protocol.figures import save_protocol_figures
from vfm_sdm.studies.protocol.methods import MONOCULAR, WITH_SGR, WITHOUT_SGR, ComparedMethod, comparisons, why_not
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.motion import Mode
from vfm_sdm.studies.synthetic.plan import MountedAccelerometer, Recording
from vfm_sdm.studies.synthetic.sensors import Accelerometer

pytestmark = pytest.mark.slow

OFFSET_S, SENSOR_S = 0.173, -1.3
MONITORED = {"1/4 span": "acc-1", "1/2 span": "acc-2"}
AGAINST = ("truth", "accelerometers")
COMPARISONS = [f"{name}_against_{a}" for name in ("refinement", "baseline", "cameras", "trackers") for a in AGAINST]
OTHERS = ["datasets", "amplitudes", "reference_against_truth", "clocks", "outside_assumptions", "cost"]
FORMS = ("csv", "md")
METRICS = ("NRMSE range", "correlation", "RPPAE", "gain", "skill")
MODES = (
    Mode("vertical", 2.2, 6.0, damping_ratio=0.03),
    Mode("vertical", 3.7, 3.0, damping_ratio=0.02),
    Mode("lateral", 1.7, 3.0, damping_ratio=0.03),
    Mode("lateral", 3.1, 1.5, damping_ratio=0.02),
)
FIGURES = ("trajectories", "refinement", "displacement", "comparison", "parity")


def tiny_plan(name, size="small", *, width=512, duration_s=4.5):
    """The demonstration's bridge with sensors and an offset between the cameras; ``data-4`` outside the assumptions."""
    plan = demo_plan(seed=3, duration_s=duration_s, site=FootbridgeSite(image_size=(width, width * 9 // 16)))
    sensors = tuple(
        MountedAccelerometer(Accelerometer(sensor, clock_offset_s=SENSOR_S), point)
        for point, sensor in MONITORED.items()
    )
    recording = Recording(exposure_s=0.0, crf=4)
    return replace(
        plan,
        name=name,
        size=size,
        fps=24,
        motion=replace(plan.motion, modes=MODES),
        recordings=(recording, replace(recording, start_s=OFFSET_S)),
        accelerometers=sensors,
        refinement="sgr",
        synchronization="motion",
        subset_px=31,
        within_assumptions=name != "data-4",
    )


@pytest.fixture(scope="module", autouse=True)
def _tiny():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vfm_sdm.studies.protocol.benchmark.preset", tiny_plan)
        yield


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    """One whole run, which the tests share; those that change something copy its folder."""
    return run_benchmark(tmp_path_factory.mktemp("protocol"), names=("data-2",), sensitivity=False)


@pytest.fixture
def copy(benchmark, tmp_path):
    """A folder with everything that the run has made but tables and figures."""
    for part in ("field_tests", "runs"):
        shutil.copytree(benchmark.folder / part, tmp_path / part)
    return tmp_path


def tables_of(folder, names):
    return {f"{name}.{form}": (folder / "tables" / f"{name}.{form}").read_bytes() for name in names for form in FORMS}


def rows_of(folder, name):
    with (folder / "tables" / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def refinement_only(monkeypatch):
    """Runs make the first comparison and no figures, which saves half of their time."""
    monkeypatch.setattr("vfm_sdm.studies.protocol.benchmark.comparisons", lambda: comparisons()[:1])
    monkeypatch.setattr("vfm_sdm.studies.protocol.benchmark.save_protocol_figures", lambda *_args: [])
    return [*COMPARISONS[:2], *(name for name in OTHERS if name != "cost")]


def refuse(*_args, **_kwargs):
    raise AssertionError("a finished stage was run again")


def refuse_making(monkeypatch, name):
    """From here on a product may be read from a run folder and not be made; its key stays what it was."""
    fetch = Chain._fetch

    def refuse_it(chain, wanted):
        found = fetch(chain, wanted)
        assert wanted.name != name or not chain.made.get(name), f"{name} was made again"
        return found

    monkeypatch.setattr(Chain, "_fetch", refuse_it)


def test_every_table_is_written_with_its_cases_mean_and_std(benchmark):
    names = {path.name for path in (benchmark.folder / "tables").iterdir()}
    assert names == {f"{name}.{form}" for name in (*COMPARISONS, *OTHERS) for form in FORMS}
    assert set(benchmark.tables) == {*COMPARISONS, *OTHERS}
    for name in COMPARISONS:
        rows = rows_of(benchmark.folder, name)
        axes = ("vertical",) if name.startswith("baseline") else ("vertical", "lateral")
        cases = [(row["dataset"], row["point"], row["axis"]) for row in rows[:-2]]
        assert cases == [("data-2", point, axis) for point in MONITORED for axis in axes], name
        assert [row["dataset"] for row in rows[-2:]] == ["mean", "std"]
        for column in [column for column in rows[0] if ": " in column and rows[0][column]]:
            values = [float(row[column]) for row in rows[:-2]]
            assert float(rows[-2][column]) == pytest.approx(np.mean(values)), (name, column)
            assert float(rows[-1][column]) == pytest.approx(np.std(values)), (name, column)


def test_methods_that_cannot_run_are_listed_with_the_reason(benchmark):
    reasons = {
        comparison.name: {one.label: why_not(one) for one in comparison.methods if why_not(one) is not None}
        for comparison in comparisons()
    }
    assert set(reasons["trackers"]) == {"VGGT", "BootsTAPIR", "VGGT + icgn"}
    assert {"chessboard", "VGGT", "PoseDiffusion"} <= set(reasons["cameras"])
    assert all("vfm-sdm weights fetch" in why or "vfm-sdm[vfm]" in why for why in reasons["trackers"].values())
    for name in ("cameras", "trackers"):
        expected = reasons[name]
        for against in AGAINST:
            table = benchmark.tables[f"{name}_against_{against}"]
            assert len(table.notes) == len(expected)
            text = (benchmark.folder / "tables" / f"{table.name}.md").read_text(encoding="utf-8")
            for method, why in expected.items():
                assert f"{method} could not run: {why}" in table.notes
                assert f"- {method} could not run: {why}" in text
                column = table.columns.index(f"correlation: {method}")
                assert np.isnan([row[column] for row in table.rows]).all()
    for name in ("refinement_against_truth", "baseline_against_accelerometers"):
        assert benchmark.tables[name].notes == ()


def test_posediffusion_runs_where_its_weights_are(benchmark, copy, monkeypatch, tmp_path_factory):
    """With recipe weights, whose cameras mean nothing: it takes part, and its row says what came of it."""
    torch = pytest.importorskip("torch", reason="PoseDiffusion needs torch")
    data, weights = golden_folder("posediffusion"), tmp_path_factory.mktemp("weights")
    state = load_recipe(data).state_dict(read_shapes(data / "manifest.json"))
    torch.save({k: torch.from_numpy(v) for k, v in state.items()}, weights / "posediffusion-co3d.pth")
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(weights))
    # Fewer iterations of the guidance, whose number decides its time.
    monkeypatch.setattr("vfm_sdm.networks.posediffusion.guidance.PASSES", ((slice(0, 9), 1),))
    wanted = [replace(one, methods=one.methods[:1]) for one in comparisons() if one.name == "cameras"]
    (method,) = (one for one in comparisons()[2].methods if one.label == "PoseDiffusion")
    assert why_not(method) is None
    shown = tuple(replace(one, methods=(*one.methods, method)) for one in wanted)
    monkeypatch.setattr("vfm_sdm.studies.protocol.benchmark.comparisons", lambda: shown)
    monkeypatch.setattr("vfm_sdm.studies.protocol.benchmark.save_protocol_figures", lambda *_args: [])
    again = run_benchmark(copy, names=("data-2",), sensitivity=False)
    run = again.results["data-2"].runs[method]
    assert run.cameras is not None or run.status != "ok"
    notes = again.tables["cameras_against_truth"].notes
    assert not any("could not run" in note for note in notes)
    assert run.displacement is not None or any("PoseDiffusion on data-2" in note for note in notes)


def test_figures_of_the_methods_are_what_they_must_be_on_an_easy_recording(benchmark):
    means = {against: benchmark.tables[f"refinement_against_{against}"].rows[-2] for against in AGAINST}
    columns = benchmark.tables["refinement_against_truth"].columns
    for against, limit in (("truth", 0.02), ("accelerometers", 0.03)):
        assert means[against][columns.index("NRMSE range: with SGR")] < limit
        assert means[against][columns.index("correlation: with SGR")] > 0.99
        assert means[against][columns.index("skill: with SGR")] > 0.99
    table = benchmark.tables["baseline_against_truth"]
    ours, monocular = (table.columns.index(f"NRMSE range: {m.label}") for m in (WITH_SGR, MONOCULAR))
    for row in table.rows[:-2]:
        assert row[ours] < row[monocular] < 0.05


def test_scores_of_the_tables_are_those_of_the_evaluations(benchmark):
    result = benchmark.results["data-2"]
    case = Case("data-2", "1/2 span", "lateral")
    evaluation = result.test.against_truth(result.runs[WITHOUT_SGR].displacement)
    expected = evaluation.row(case.point, case.axis).score
    table = benchmark.tables["refinement_against_truth"]
    row = next(row for row in table.rows if row[:3] == ("data-2", "1/2 span", "lateral"))
    assert row[table.columns.index("RPPAE: without SGR")] == pytest.approx(expected.rppae)
    assert result.score("truth", WITH_SGR, case) != result.score("truth", WITHOUT_SGR, case)
    assert result.score("truth", MONOCULAR, case) is None
    assert result.score("truth", ComparedMethod("never run"), case) is None


def test_clocks_are_the_true_ones(benchmark):
    rows = rows_of(benchmark.folder, "clocks")
    assert [row["clock"] for row in rows] == ["second view", "accelerometers"]
    for row, true, within_ms in zip(rows, (OFFSET_S, SENSOR_S), (1.0, 3.0), strict=True):
        assert float(row["true offset [s]"]) == pytest.approx(true, abs=1e-9)
        assert float(row["found [s]"]) == pytest.approx(true, abs=1e-3 * within_ms)
        assert float(row["error [ms]"]) == pytest.approx(1e3 * (float(row["found [s]"]) - true), abs=1e-6)
        assert abs(float(row["error [ms]"])) < within_ms
        assert row["status"] == "ok"


def test_amplitudes_of_all_sources_agree_and_the_reference_has_an_error_of_its_own(benchmark):
    for row in rows_of(benchmark.folder, "amplitudes"):
        truth = float(row["truth"])
        assert truth > 1.0
        for source in ("without SGR", "with SGR", "accelerometers"):
            assert float(row[source]) == pytest.approx(truth, rel=0.08), (row, source)
    mean = next(row for row in rows_of(benchmark.folder, "reference_against_truth") if row["dataset"] == "mean")
    assert 1e-4 < float(mean["NRMSE range: truth"]) < 0.03
    dataset = rows_of(benchmark.folder, "datasets")[0]
    assert dataset["monitored points"] == "1/4 span, 1/2 span"
    assert dataset["each video"] == "512 x 288 px, 24 fps, 4.5 s"


def test_cost_of_every_stage(benchmark):
    rows = {row["task"]: row for row in rows_of(benchmark.folder, "cost")}
    stages = ["camera parameter estimation", "point tracking", "triangulation", "triangulation + SGR"]
    assert list(rows) == stages
    for row in rows.values():
        total, calls = float(row["total [ms]"]), int(row["calls"])
        assert float(row["time a call [ms]"]) * calls == pytest.approx(total)
        assert 10 < float(row["peak memory of the process [MB]"]) < 1e5
    assert rows["point tracking"]["calls"] == "2"
    assert rows["point tracking"]["input"] == "108 frames, 6 points"
    assert float(rows["camera parameter estimation"]["total [ms]"]) > 100
    assert float(rows["triangulation + SGR"]["total [ms]"]) > float(rows["triangulation"]["total [ms]"])


def test_figures_exist(benchmark):
    names = {path.name for path in benchmark.figures}
    expected = {f"data-2_{stem}_{what}.png" for stem in ("1-4_span", "1-2_span") for what in FIGURES}
    assert names == expected | {"data-2_camera_poses.png"}
    assert {path.name for path in (benchmark.folder / "figures").iterdir()} == names
    for path in benchmark.figures:
        assert path.read_bytes().startswith(b"\x89PNG")


def test_the_summary_puts_the_means_beside_the_paper_s(benchmark):
    document = json.loads((benchmark.folder / "benchmark.json").read_text(encoding="utf-8"))
    assert document["paper"] == {"NRMSE range": 0.15, "correlation": 0.73, "RPPAE": 0.11}
    assert document["size"] == "small"
    assert document["seconds"] == pytest.approx(benchmark.seconds, abs=0.06)
    readme = (benchmark.folder / "README.md").read_text(encoding="utf-8")
    for against in AGAINST:
        table = benchmark.tables[f"refinement_against_{against}"]
        for metric in METRICS:
            mean = table.rows[-2][table.columns.index(f"{metric}: with SGR")]
            assert document["means_with_sgr"][against][metric] == pytest.approx(mean)
        shown = " | ".join(f"{document['means_with_sgr'][against][metric]:.3f}" for metric in METRICS)
        assert f"| against {against} | {shown} |" in readme
    for name in benchmark.tables:
        assert f"(tables/{name}.md)" in readme


def test_a_second_run_does_nothing_again_and_writes_the_same_tables(benchmark, copy, monkeypatch):
    for name in ("cameras", "tracks"):
        refuse_making(monkeypatch, name)
    monkeypatch.setattr("vfm_sdm.studies.synthetic.field_test.film_view", refuse)
    monkeypatch.setattr("vfm_sdm.studies.protocol.benchmark.save_protocol_figures", lambda *_args: [])
    again = run_benchmark(copy, names=("data-2",), sensitivity=False)
    same = [*COMPARISONS, *(name for name in OTHERS if name != "cost")]
    assert tables_of(copy, same) == tables_of(benchmark.folder, same)
    before, after = ({row[0]: row for row in run.tables["cost"].rows} for run in (benchmark, again))
    # What these stages cost when they were run, not what reading their results costs.
    for task in ("camera parameter estimation", "point tracking"):
        assert after[task] == before[task]


def test_a_killed_run_goes_on_and_gives_the_same_tables(benchmark, copy, refinement_only, monkeypatch):
    shutil.rmtree(copy / "runs")

    def kill_at(step):
        def progress(what, _done, _total):
            if what == step:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_benchmark(copy, names=("data-2",), sensitivity=False, progress=progress)
        assert not (copy / "README.md").exists()

    kill_at("tracking right")
    refuse_making(monkeypatch, "cameras")
    kill_at("data-2: with SGR")
    refuse_making(monkeypatch, "tracks")
    resumed = run_benchmark(copy, names=("data-2",), sensitivity=False)
    # Costs are those of the two runs that were killed, not of reading what they left.
    assert all(row[5] > 100 for row in resumed.tables["cost"].rows[:2])
    assert tables_of(copy, refinement_only) == tables_of(benchmark.folder, refinement_only)


def test_a_killed_camera_is_filmed_again_and_the_finished_one_is_not(tmp_path, monkeypatch):
    plan = tiny_plan("data-2", width=160, duration_s=0.5)
    make_field_test(tmp_path / "whole", plan)

    def kill(what, done, total):
        if done > 0.75 * total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_field_test(tmp_path / "killed", plan, progress=kill)
    assert not (tmp_path / "killed" / "session.toml").exists()
    filmed = []
    from vfm_sdm.studies.synthetic.film import film_view

    def count(plan, scene, view):
        filmed.append(view)
        return film_view(plan, scene, view)

    monkeypatch.setattr("vfm_sdm.studies.synthetic.field_test.film_view", count)
    make_field_test(tmp_path / "killed", plan)
    assert filmed == [1]
    for path in (tmp_path / "whole").iterdir():
        assert (tmp_path / "killed" / path.name).read_bytes() == path.read_bytes(), path.name
    # Another exposure is another film, of that view alone.
    first, second = plan.recordings
    make_field_test(tmp_path / "killed", replace(plan, recordings=(replace(first, noise_std=2.0), second)))
    assert filmed == [1, 0]


def test_a_field_test_outside_the_assumptions_is_no_result(benchmark, copy, refinement_only, monkeypatch):
    for part in ("field_tests", "runs"):
        shutil.copytree(copy / part / "data-2-small", copy / part / "data-4-small")
    monkeypatch.setattr(
        "vfm_sdm.studies.protocol.benchmark.save_protocol_figures",
        lambda folder, results, rows: save_protocol_figures(folder, {"data-4": results["data-4"]}, rows),
    )
    both = run_benchmark(copy, names=("data-2", "data-4"), sensitivity=False)
    outside = both.tables["outside_assumptions"]
    assert outside.title.startswith("OUTSIDE THE METHOD'S ASSUMPTIONS")
    assert outside.title.endswith("not a result")
    assert [row[0] for row in outside.rows] == ["data-4"] * 4 + ["mean", "std"]
    named = {name for name, table in both.tables.items() if any(row[0] == "data-4" for row in table.rows)}
    assert named == {"outside_assumptions", "datasets", "clocks"}
    # Neither means nor anything else of the results change.
    alike = [name for name in refinement_only if name not in named]
    assert tables_of(copy, alike) == tables_of(benchmark.folder, alike)
    assert set(both.results["data-4"].runs) == {WITHOUT_SGR, WITH_SGR}
    shown = {path.name for path in both.figures}
    assert {"data-4_1-4_span_trajectories.png", "data-4_1-2_span_trajectories.png"} <= shown
    assert not [name for name in shown if any(what in name for what in FIGURES[1:])]


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="expected a folder to write to"):
        run_benchmark(tmp_path / "file" / "out")
