"""The table of profiles is made as it says: lenses in our model's words, groups, calibrators left out."""

import csv
import gzip
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.profiles.table import read_table

TOOLS = Path(__file__).resolve().parents[4] / "tools"
SIZE = (1920.0, 1080.0)


@pytest.fixture(scope="module")
def tool():
    """`tools/lens_records.py` as a module."""
    sys.path.insert(0, str(TOOLS))
    try:
        return importlib.import_module("lens_records")
    finally:
        sys.path.remove(str(TOOLS))


def drawn(angle, focal, fisheye):
    """Radius at which OpenCV's fisheye model draws a ray that comes at this angle [px]."""
    return focal * angle * (1 + sum(k * angle ** (2 * n) for n, k in enumerate(fisheye, start=1)))


def test_a_pinhole_has_no_distortion(tool):
    # The tangent's own series: x = t + t^3 / 3 + 2 t^5 / 15 + 17 t^7 / 315 + 62 t^9 / 2835.
    order, log_focal, corner, residual = tool.describe_lens(1500.0, [1 / 3, 2 / 15, 17 / 315, 62 / 2835], SIZE)
    assert order == 1
    assert np.exp(log_focal) * 1920 == pytest.approx(1500, rel=1e-3)
    np.testing.assert_allclose(corner, 0, atol=1e-3)
    assert residual < 1e-4


@pytest.mark.parametrize("focal", [1000.0, 1300.0, 2000.0])
def test_our_model_draws_what_the_calibration_draws(tool, focal):
    """Equidistant lenses: the further they see, the more coefficients they take."""
    order, log_focal, corner, residual = tool.describe_lens(focal, [0.0, 0.0, 0.0, 0.0], SIZE)
    assert order == {1000.0: 3, 1300.0: 2, 2000.0: 1}[focal]
    ours = np.exp(log_focal) * 1920
    radius = np.hypot(*SIZE) / 2 / ours
    k1, k2, k3 = np.array(corner) / radius ** np.array([2, 4, 6])
    camera = Camera(np.diag([ours, ours, 1.0]), (1920, 1080), np.array([k1, k2, 0, 0, k3]))
    angle = np.linspace(0.01, np.hypot(*SIZE) / 2 / focal * 0.98, 50)
    seen = camera.project(np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1))[:, 0]
    assert np.abs(seen - drawn(angle, focal, [0, 0, 0, 0])).max() < 8 * residual * 1920
    assert residual <= 1e-3


def test_lenses_that_see_too_much_are_not_described(tool):
    assert tool.describe_lens(800.0, [0.0, 0.0, 0.0, 0.0], SIZE)[0] == 0
    # A polynomial that turns back within the picture is no calibration.
    assert tool.describe_lens(800.0, [-0.5, 0.0, 0.0, 0.0], SIZE) is None


ROWS = """\
GoPro,HERO7 Black,Linear,,NO-EIS,1.00,1,a
GoPro,HERO7 Black,Linear,,NO-EIS,1.02,1,a
GoPro,Hero 7 black,Linear,,no eis,1.05,1,b
GoPro,HERO7 Black,linear,,NO-EIS,0.95,1,c
GoPro,HERO7 Black,Linear,,HS EIS,1.10,1,c
GoPro,HERO7 Black,Linear,Anamorphic 1.33x,NO-EIS,1.00,1,d
GoPro,HERO7 Black,Linear,,NO-EIS,1.00,1.33,d
"""


@pytest.fixture
def records(tool, tmp_path):
    columns = (
        "brand,model,lens,setting,note,width_px,height_px,fx_px,fy_px,k1,k2,k3,k4,rms_px,readout_ms,stretch_h,stretch_v,"
        "calibrator"
    )
    path = tmp_path / "lens_profiles.csv.gz"
    with gzip.open(path, "wt", encoding="utf-8") as file:
        file.write(columns + "\n")
        for *texts, scale, stretch, person in csv.reader(ROWS.splitlines()):
            focal = float(scale) * 1000
            file.write(",".join(texts) + f",1920,1080,{focal},{focal},0.3333,0.1333,0.054,0.0219,0.5,-8,{stretch},1,")
            file.write(f"{person}\n")
    return tool.read_records(path)


def test_a_group_has_one_value_of_every_calibrator(tool, records):
    rows = tool.group_records(records)
    assert [(row["stabilised"], row["calibrators"]) for row in rows] == [("off", 3), ("on", 1)]
    values = np.log(np.array([1.01, 1.05, 0.95]) * 1000 / 1920)
    assert rows[0]["log_focal"] == pytest.approx(values.mean(), abs=2e-3)
    assert rows[0]["log_focal_squares"] == pytest.approx(((values - values.mean()) ** 2).sum(), rel=0.05)
    assert (rows[0]["name"], rows[0]["readout_ms"]) == ("GoPro HERO7 Black", 8)


def test_who_is_left_out_is_in_no_group(tool, records):
    held = {one.record.calibrator: one for one in tool.leave_out(records)}
    assert set(held) == {"a", "b", "c"}
    assert held["a"].others.calibrators.tolist() == [2, 1]
    assert held["a"].others.log_focal[0] == pytest.approx(np.log(np.sqrt(1.05 * 0.95) * 1000 / 1920), abs=2e-3)
    # All that the calibrator did is out, in other groups, too.
    assert held["c"].others.calibrators.tolist() == [2, 0]


def test_the_table_of_the_package_is_that_of_the_calibrations(tool, shared_data):
    table = read_table()
    rows = tool.group_records(tool.read_records(shared_data("lens_profiles") / "lens_profiles.csv.gz"))
    assert len(rows) == len(table)
    assert [row["model"] for row in rows] == table.model.tolist()
    np.testing.assert_allclose([row["log_focal"] for row in rows], table.log_focal, atol=1e-3)
