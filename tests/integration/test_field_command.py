"""The command `field` on a run folder: its files, what it says, its faults; the animation's pictures, VTK files."""

from xml.etree import ElementTree

import av
import numpy as np
import pytest
from PIL import Image

from fields import draw_field
from vfm_sdm.analysis.field import compute_field, read_field
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Measured, Point, Session, Site, View, write_session
from vfm_sdm.outputs.plots import About
from vfm_sdm.outputs.plots.animation import FieldPicture, write_gif, write_mp4
from vfm_sdm.outputs.plots.field import draw_heat_map
from vfm_sdm.outputs.results import write_displacement
from vfm_sdm.outputs.results.vtk import write_vtk

K = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]])
ACROSS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""From a camera that looks at the face from the front to the structure's axes."""


@pytest.fixture(scope="module")
def drawn():
    return draw_field(5, points=60, frames=45, bad=1)


@pytest.fixture(scope="module")
def field(drawn):
    return compute_field(drawn.displacement, stations=9)


@pytest.fixture(scope="module")
def moving(field):
    camera = Camera(K, (640, 360), cam_from_world=np.column_stack([np.eye(3), [-8.0, -0.4, 6.0]]))
    picture = np.random.default_rng(0).integers(0, 255, (360, 640), dtype=np.uint8)
    return FieldPicture.of(picture, camera, field["point_place"].values, ACROSS), camera


def test_the_command(command, tmp_path, drawn):
    run = tmp_path / "a run [1] öff"
    run.mkdir()
    write_displacement(run, drawn.displacement)
    site = Site(baseline=Measured(value=4.0, std=0.01))
    views = tuple(View(name=name, video=f"{name}.mp4") for name in ("left", "right"))
    session = Session(name="beam", view=views, site=site, point=(Point(name="web 001", view="left", pixel=(1.0, 1.0)),))
    write_session(run / SESSION, session)
    status, out, err = command("field", run, "--stations", "9", "--time", "0.5")
    assert (status, err) == (0, "")
    assert "Deflection line at 0.50 s in mm" in out
    assert f"{drawn.bad[0]}" in out
    assert "departs from its neighbours" in out
    assert "nothing is drawn over the first frame: " in out
    assert "shapes in which it moved: " in out
    assert (run / "figures" / "field.png").stat().st_size > 10_000
    assert read_field(run).sizes["station"] == 9
    assert len((run / "field.csv").read_text(encoding="utf-8").splitlines()) == 10
    assert (run / "field.pvd").exists()
    status, _, err = command("field", run, "--time", "50")
    assert (status, err) == (1, "vfm-sdm: --time: expected times from 0 to 1.47 s, got 50.0; correct them\n")
    status, _, err = command("field", run, "--axis", "up")
    assert status == 1
    assert "--axis: expected one of lateral, vertical, longitudinal, got up" in err


def test_pixels_of_the_structure_move_as_it_does_and_others_stand(field, moving):
    picture, camera = moving
    place = field["point_place"].values[30]
    u, v = np.rint(camera.project(place @ ACROSS)).astype(int)
    moved = camera.project((place + np.array([0, 1e-3, 0])) @ ACROSS) - camera.project(place @ ACROSS)
    np.testing.assert_allclose(picture.slope[v, u, :, 1], moved, atol=0.05 * np.abs(moved).max())
    assert picture.station_m[v, u] == pytest.approx(place[2], abs=0.05)
    assert np.abs(picture.slope[:20]).max() < 1e-6
    factor = picture.magnification(field)
    frames = list(picture.frames(field, factor, most=10))
    assert len(frames) == 10
    changed = np.abs(frames[0].astype(int) - frames[5]) > 20
    assert changed[v - 5 : v + 6, u - 5 : u + 6].any()
    assert not changed[300:].any()


def test_films_hold_all_pictures(field, moving, tmp_path):
    film = write_mp4(tmp_path / "field.mp4", moving[0].frames(field, 10, most=12), 30.0)
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]
    assert len(frames) == 12
    assert frames[0].shape == (360, 640)
    with Image.open(write_gif(tmp_path / "field.gif", moving[0].frames(field, 10, most=12), 30.0)) as gif:
        assert gif.n_frames == 6
        assert gif.info["duration"] == pytest.approx(67, abs=7)


def test_vtk_files_hold_points_and_vectors_in_metres(field, tmp_path):
    listed = ElementTree.parse(write_vtk(tmp_path, field)).getroot().findall("Collection/DataSet")
    assert len(listed) == field.sizes["time"]
    last = ElementTree.parse(tmp_path / listed[-1].attrib["file"]).getroot()
    arrays = {one.attrib["Name"]: np.array((one.text or "").split(), float) for one in last.iter("DataArray")}
    np.testing.assert_allclose(
        arrays["displacement"].reshape(-1, 3), field["displacement"].values[-1] / 1000, atol=1e-12
    )
    np.testing.assert_allclose(arrays["points"].reshape(-1, 3), field["position"].values, rtol=1e-8)
    assert arrays["connectivity"].tolist() == list(range(9))
    assert float(listed[-1].attrib["timestep"]) == pytest.approx(float(field["time"][-1]), abs=1e-6)


def test_the_heat_map_marks_points_left_out(field, drawn, moving):
    picture, camera = moving
    places = camera.project(field["point_place"].values @ ACROSS)
    figure = draw_heat_map(field, picture.picture, places, "vertical", About("beam"))
    out = int((field["used"].sel(axis="vertical").values == 0).sum())
    assert out >= len(drawn.bad)
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == [f"left out ({out})"]
