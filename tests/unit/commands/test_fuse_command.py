"""`vfm-sdm fuse` on a simulated run: table, files and figure, the section of the report, and where it declines."""

import json

import numpy as np
import pytest

from vfm_sdm.commands.app import main
from vfm_sdm.core.netcdf import read_displacement, write_displacement
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.outputs.report import find_language
from vfm_sdm.outputs.report.sections.fusion import describe_fusion_section
from vfm_sdm.studies.synthetic.sensed_point import STATIC, SensedPoint, record_point


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder of displacement and a session alone, whose name needs care."""
    folder = tmp_path_factory.mktemp("Brücke [1] run")
    displacement, acceleration, _ = record_point(SensedPoint(duration_s=15.0, gap_s=(6.0, 6.5)), 2)
    write_displacement(folder, displacement)
    rows = zip(acceleration["time"].values, acceleration["acceleration"].values[:, 0], strict=True)
    lines = ["time,lateral,vertical", *(f"{t:.6f},{a[0]:.6f},{a[1]:.6f}" for t, a in rows)]
    (folder / "phone.csv").write_text("\n".join(lines))
    sensor = {"name": "phone", "file": "phone.csv", "point": "mid", "units": "m/s2"}
    gauge = {"name": "gauge", "file": "phone.csv", "point": "mid", "units": "mm"}
    session = Session(
        name="site",
        folder=folder,
        view=[{"name": name, "video": f"{name}.mp4"} for name in ("left", "right")],
        site={"baseline": {"value": 3.0, "std": 0.01}},
        point=[{"name": n, "view": "left", "pixel": [9.0, 9.0], "static": n in STATIC} for n in ("mid", *STATIC)],
        sensor=[sensor, gauge, {**sensor, "name": "loose", "point": None}],
    )
    write_session(folder / SESSION, session)
    return folder


def ask(words, capsys):
    """Exit status and both outputs of a command line."""
    try:
        main([str(word) for word in words])
        status = 0
    except SystemExit as ended:
        status = ended.code or 0
    said = capsys.readouterr()
    return status, said.out, said.err


def test_a_table_files_and_a_figure(run, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    monkeypatch.setenv("TERM", "dumb")
    status, out, err = ask(["fuse", run, "--sensor", "phone", "--axis", "vertical", "--json"], capsys)
    assert status == 0, err
    said = json.loads(out)
    rows = {row["quantity"]: row["vertical"] for row in said["tables"][0]["rows"]}
    gain, gain_std = (float(one) for one in rows["gain, video over sensor"].split(" +- "))
    assert abs(gain - 1 / 1.02) < 4 * gain_std < 0.05
    assert float(rows["noise, fused [mm]"]) < float(rows["noise of the video alone [mm]"])
    assert float(rows["noise, bridged [mm]"]) >= float(rows["noise, fused [mm]"])
    for name in ("fused.nc", "fused.csv", "figures/fused.png"):
        assert (run / name).stat().st_size > 1000


def test_the_report_has_a_section_in_both_languages(run, capsys):
    if not (run / "fused.nc").exists():
        ask(["fuse", run, "--sensor", "phone", "--axis", "vertical"], capsys)

    class Inputs:
        folder, displacement = run, read_displacement(run)

    for code, title in (("en", "Fusion with an accelerometer"), ("de", "Fusion mit einem Beschleunigungssensor")):
        section = describe_fusion_section(Inputs, find_language(code))
        assert section.title == title
        kinds = [block.kind for block in section.blocks]
        assert kinds[:3] == ["paragraph", "table", "figure"]
        assert np.isfinite([cell.value for cell in section.blocks[1].rows[0][1:]]).all()

    class Other(Inputs):
        folder = run / "figures"

    assert describe_fusion_section(Other, find_language("en")) is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--sensor", "other"], "expected one of the session's (phone, gauge, loose), got 'other'"),
        (["--sensor", "gauge"], "expected acceleration"),
        (["--sensor", "loose"], "expected the point that the sensor sits at"),
        (["--sensor", "phone", "--axis", "longitudinal"], "axes: expected some of"),
        (["--sensor", "phone", "--session", "nowhere.toml"], "expected a session that names the sensor"),
    ],
)
def test_what_cannot_be_fused_is_one_sentence(run, words, said, capsys):
    status, _, err = ask(["fuse", run, *words], capsys)
    assert status == 1
    assert said in " ".join(err.split())


def test_data_that_allow_no_fusion_end_with_status_3(run, capsys):
    words = ["fuse", run, "--sensor", "phone", "--search", "0.2", "--start-lag", "-3"]
    status, _, err = ask(words, capsys)
    assert status == 3
    assert "no fusion" in err
