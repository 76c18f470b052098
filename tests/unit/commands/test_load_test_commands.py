"""The commands ``load-test`` and ``passages``: what is shown, what is left out, and what the report makes of it."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from vfm_sdm.analysis.load_test import read_load_test, read_passages_of_run
from vfm_sdm.commands.app import main
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.netcdf import write_displacement
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.outputs.report import find_language
from vfm_sdm.outputs.report.content import Paragraph
from vfm_sdm.outputs.report.sections.load_test import describe_load_test, describe_passages
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

RATE, NOISE_MM, HERTZ = 20, 0.02, 4.0
STATIC = ("pier", "rock")
MOVES_MM = {"mid": 4.0, "pier": 0.0, "rock": 0.33}
"""What each point does in a step that stands from 14 to 26 s, and under a vehicle from 40 to 48 s [mm]."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder of displacement and a session alone, with the tables of a test."""
    folder = tmp_path_factory.mktemp("load test")
    seconds = np.arange(56 * RATE) / RATE
    motion = np.interp(seconds, [11, 14, 26, 29], [0, 1, 1, 0])
    motion += np.sin(np.pi * np.clip((seconds - 40) / 8, 0, 1))
    values = np.random.default_rng(3).normal(0, NOISE_MM, (len(seconds), len(MOVES_MM), 3))
    for number, size in enumerate(MOVES_MM.values()):
        values[:, number, 1] += size * motion
    values[:, 0, 1] += 0.2 * np.sin(2 * np.pi * HERTZ * seconds)
    arrays = DisplacementArrays(
        displacement_mm=values,
        displacement_std_mm=np.full(values.shape, NOISE_MM),
        scale_std=np.full(values.shape[1:], 0.01),
        position_m=np.zeros(values.shape),
        reprojection_error_px=np.zeros(values.shape[:2]),
        status=np.zeros(values.shape[:2]),
    )
    data = make_displacement(seconds, list(MOVES_MM), STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
    budget = (("component", "time", "point", "axis"), np.zeros((len(COMPONENTS), *values.shape)), {"units": "mm"})
    write_displacement(folder, data.assign(uncertainty=budget).assign_coords(component=list(COMPONENTS)))
    session = Session(
        name="site",
        folder=folder,
        view=[{"name": name, "video": f"{name}.mp4"} for name in ("left", "right")],
        site={"baseline": {"value": 3.0, "std": 0.01}},
        point=[{"name": n, "view": "left", "pixel": [9.0, 9.0], "static": n in STATIC} for n in MOVES_MM],
    )
    write_session(folder / SESSION, session)
    (folder / "steps.csv").write_text("load [kN],begin_s,end_s\n0,0,10\n300,15,25\n0,30,39\n")
    (folder / "driven.csv").write_text("begin_s,end_s,speed [km/h]\n40,48,18\n")
    return folder


def ask(words, capsys):
    """What a command that ends well prints as JSON."""
    with pytest.raises(SystemExit) as ended:
        main([*map(str, words), "--json"])
    said = capsys.readouterr()
    assert not ended.value.code, said.err
    return json.loads(said.out)


def cares(section):
    return [block.text for block in section.blocks if isinstance(block, Paragraph) and block.tone == "care"]


def told(describe, run, code):
    """A report's section on a run."""
    displacement = SimpleNamespace(attrs={})
    return describe(SimpleNamespace(folder=run, static=set(STATIC), displacement=displacement), find_language(code))


def test_static_points_of_a_load_test_are_left_out_and_named_where_they_moved(run, capsys):
    said = ask(["load-test", run, run / "steps.csv"], capsys)
    for table in said["tables"]:
        assert {row["point"] for row in table["rows"]} == {"mid"}
    (left,) = [line for line in said["lines"] if "left out" in line]
    assert left == "note: 2 static points are left out of table and figure; all in load_test.csv"
    (moved,) = [line for line in said["lines"] if "moved by" in line]
    assert moved.startswith("note: static point rock moved by 0.3")
    assert "along vertical in step 2: a camera moved" in moved
    assert set(read_load_test(run)["point"].values) == set(MOVES_MM)
    for code, words in (("en", "Static point rock moved by 0.3"), ("de", "Festpunkt rock hat sich in Stufe 2 um 0,3")):
        (one,) = cares(told(describe_load_test, run, code))
        assert one.startswith(words)


def test_passages_say_their_frequency_and_leave_static_points_out(run, capsys):
    said = ask(["passages", run, run / "driven.csv"], capsys)
    assert {row["point"] for row in said["tables"][0]["rows"]} == {"mid"}
    (hertz,) = [line for line in said["lines"] if line.startswith("natural frequency")]
    assert hertz.startswith("natural frequency [Hz]: 4.00, found in the displacement")
    assert any("static point rock moved by 0.3" in line and "passage 1" in line for line in said["lines"])
    found = read_passages_of_run(run)["frequency"]
    assert found.sel(axis="vertical").values == pytest.approx(3 * [HERTZ], abs=0.01)
    assert found.attrs["units"] == "Hz"
    section = told(describe_passages, run, "de")
    assert any("Eigenfrequenz, vertikal: 4,00 Hz, gefunden" in getattr(one, "text", "") for one in section.blocks)
    assert cares(section)[0].startswith("Festpunkt rock hat sich bei Überfahrt 1 um 0,3")


def test_a_frequency_that_was_given_is_said_to_be(run, capsys):
    said = ask(["passages", run, run / "driven.csv", "--frequency", "3.9"], capsys)
    assert any(line.startswith("natural frequency [Hz]: 3.90, given") for line in said["lines"])
    section = told(describe_passages, run, "en")
    assert any("3.90 Hz, as stated" in getattr(one, "text", "") for one in section.blocks)
