"""The command ``modes``: files, figures and what the report makes of them."""

import json

import numpy as np
import pytest
from PIL import Image

from vfm_sdm.analysis.modal import read_modes
from vfm_sdm.commands.app import main
from vfm_sdm.core.netcdf import write_dataset
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import find_language
from vfm_sdm.outputs.report.sections.modes import describe_modes
from vibrating import FREQUENCY_HZ, vibrate

pytest.importorskip("pyoma2")
pyuff = pytest.importorskip("pyuff")


@pytest.fixture(scope="module")
def run(tmp_path_factory):

    folder = tmp_path_factory.mktemp("a rün [1]")
    write_dataset(folder / "displacement.nc", vibrate(60.0))
    main_ended(["modes", str(folder)], 0)
    return folder


def main_ended(words, status):
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code in ((status, None) if status == 0 else (status,))


def test_files_are_there_and_films_move(run):
    assert {path.name for path in run.iterdir()} >= {"modes.nc", "modes.csv", "modes.uff", "figures"}
    assert read_modes(run)["frequency"].values == pytest.approx(FREQUENCY_HZ, rel=0.02)
    films = sorted((run / "figures").glob("mode_*.gif"))
    assert len(films) == 3
    with Image.open(films[0]) as film:
        assert film.n_frames > 10
        first = np.asarray(film.convert("L"), dtype=int)
        film.seek(film.n_frames // 2)
        assert np.abs(np.asarray(film.convert("L"), dtype=int) - first).max() > 50


def test_another_program_reads_the_shapes(run):
    modes = read_modes(run)
    sets = pyuff.UFF(str(run / "modes.uff")).read_sets()
    assert [one["type"] for one in sets] == [164, 15, 82, 55, 55, 55]
    assert list(sets[2]["nodes"]) == [1, 2, 3, 4, 5, 6]
    for number, one in enumerate(sets[3:]):
        hertz = abs(one["eig"]) / 2 / np.pi
        assert hertz == pytest.approx(float(modes["frequency"][number]), rel=1e-5)
        assert -one["eig"].real / abs(one["eig"]) == pytest.approx(float(modes["damping_ratio"][number]), rel=1e-4)
        shape = np.stack([one["r1"], one["r2"], one["r3"]], axis=1)
        np.testing.assert_allclose(shape, modes["shape"][number].values, atol=1e-5)


def test_json_has_the_table(run, capsys):
    main_ended(["modes", str(run), "--no-animate", "--axis", "vertical", "--json"], 0)
    content = json.loads(capsys.readouterr().out)
    rows = content["tables"][0]["rows"]
    assert [row["Hz"] for row in rows] == pytest.approx(list(FREQUENCY_HZ[1:]), rel=0.02)
    assert any("band 0.2 to 12 Hz" in line for line in content["lines"])


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A run folder of a single view: motion in the picture, whose places are not known."""
    folder = tmp_path_factory.mktemp("one view")
    seen = vibrate(30.0).isel(axis=[0, 1], point=[1]).assign_coords(axis=["right", "down"])
    seen = seen.assign(position=seen["position"] * np.nan).assign_attrs(frame="image plane")
    write_dataset(folder / "displacement.nc", seen)
    return folder


def test_modes_of_a_single_view_are_those_in_the_picture(picture, capsys):
    main_ended(["modes", str(picture), "--json"], 0)
    content = json.loads(capsys.readouterr().out)
    assert [row["Hz"] for row in content["tables"][0]["rows"]] == pytest.approx(FREQUENCY_HZ, rel=0.08)
    lines = "\n".join(content["lines"])
    # Two channels in 20 blocks: (20 - 1) 2.
    assert "2 channels along right, down, 30.0 s at 30 Hz, band 0.267 to 12 Hz, order up to 38;" in lines
    assert "the order of the model is 38 at most, not 40" in lines
    assert "what moves towards the camera is not seen" in lines
    modes = read_modes(picture)
    assert (modes.attrs["axes"], modes.attrs["highest_order"]) == ("right, down", 38)
    assert modes["pole_order"].max() <= 38
    assert not list((picture / "figures").glob("*.gif"))
    one, *_ = [one for one in pyuff.UFF(str(picture / "modes.uff")).read_sets() if one["type"] == 55]
    np.testing.assert_allclose(np.stack([one["r1"], one["r2"]], axis=1), modes["shape"][0].values, atol=1e-5)
    assert not np.any(one["r3"])


@pytest.mark.parametrize("axes", [("right", "down"), ("right", "down", "forward")])
def test_the_report_shows_modes_along_other_axes(run, axes):
    modes = read_modes(run).isel(axis=range(len(axes))).assign_coords(axis=list(axes))
    inputs = ReportInputs.__new__(ReportInputs)
    object.__setattr__(inputs, "modes", modes.assign_attrs(axes=", ".join(axes)))
    object.__setattr__(inputs, "displacement", modes)
    section = describe_modes(inputs, find_language("de"))
    assert ", ".join({"right": "rechts", "down": "unten", "forward": "vorn"}[axis] for axis in axes) in (
        section.blocks[0].text
    )
    assert [block.kind for block in section.blocks].count("figure") == 2


def test_without_a_mode_the_data_did_not_allow_a_result(tmp_path, capsys):

    write_dataset(tmp_path / "displacement.nc", vibrate(20.0, moves=False))
    main_ended(["modes", str(tmp_path)], 3)
    assert "no mode is clear of noise" in capsys.readouterr().err


@pytest.mark.parametrize(("code", "words"), [("en", "Stabilisation diagram"), ("de", "Stabilisierungsdiagramm")])
def test_the_report_has_settings_and_figures(run, code, words):
    modes = read_modes(run)
    inputs = ReportInputs.__new__(ReportInputs)
    object.__setattr__(inputs, "modes", modes)
    object.__setattr__(inputs, "displacement", modes)
    section = describe_modes(inputs, find_language(code))
    kinds = [block.kind for block in section.blocks]
    assert kinds.count("figure") == 2
    assert kinds.count("table") == 2
    assert str(modes.attrs["channels"]) in section.blocks[0].text
    assert any(words in block.caption for block in section.blocks if block.kind == "figure")
