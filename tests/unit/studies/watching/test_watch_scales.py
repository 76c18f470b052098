"""Millimetres a pixel and places of points, before anything is measured."""

import numpy as np
import pytest

from vfm_sdm.core.datasets import make_points
from vfm_sdm.errors import CameraError, ResultsError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.solution import CameraSolution, write_solution
from vfm_sdm.studies.watching.scales import find_places, find_scales, read_cameras

SIZE = (1280, 720)
POINTS = [
    {"name": "mid", "view": "left", "pixel": [639.5, 359.5]},
    {"name": "pier", "view": "left", "pixel": [1139.5, 359.5], "pixel_in": {"right": [700.0, 360.0]}},
]


def make_session(views=("left", "right"), point=POINTS, lens=None, site=None, **view):
    lens = {"focal_px": 1000.0} if lens is None else lens
    site = {"baseline": {"value": 4.0, "std": 0.01}} | (site or {})
    fields = [{"name": name, "video": f"{name}.ts", "lens": lens, **view} for name in views]
    return Session(name="bridge", view=fields, point=point, site=site)


def scales(session, name="left", earlier=None):
    view = next(view for view in session.view if view.name == name)
    found = find_scales(session, view, SIZE, find_places(session, view, earlier), earlier)
    return {point: (one.mm_per_px, one.source) for point, one in found.items()}


def earlier_run():
    """Cameras 4 m apart that look the same way, and two points 20 m and 25 m away."""
    K = np.array([[2000.0, 0, 639.5], [0, 2000.0, 359.5], [0, 0, 1]])
    right = np.column_stack([np.eye(3), [-4.0, 0, 0]])
    rig = Rig(("left", "right"), (Camera(K, SIZE), Camera(K, SIZE, cam_from_world=right)), metric=True)
    points3d = np.array([[1.0, 0.5, 20.0], [2.0, -0.5, 25.0]])
    position = np.stack([camera.project(points3d) for camera in rig.cameras])
    std, status = np.full((2, 2, 2), 0.1), np.full((2, 2), "ok")
    points = make_points(["left", "right"], ["mid", "pier"], position=position, position_std=std, status=status)
    return CameraSolution(rig, None, None, points)


def test_range_over_focal_length_counts_along_the_axis():
    session = make_session(site={"range": [{"point": name, "value": 20.0, "std": 0.01} for name in ("mid", "pier")]})
    found = scales(session)
    assert found["mid"] == (pytest.approx(20.0), "range over focal length")
    # 500 px beside the middle at a focal length of 1000 px: the distance is longer than the depth.
    assert found["pier"][0] == pytest.approx(20.0 / np.sqrt(1.25))
    assert scales(session, "right") == {}


def test_a_range_counts_before_the_faces_distance():
    distance = {
        "perpendicular_distance": {"value": 12.0, "std": 0.01},
        "longitudinal_distance": {"value": 9.0, "std": 0.1},
    }
    session = make_session(site=distance | {"range": [{"point": "mid", "value": 14.0, "std": 0.01}]})
    assert scales(session) == {
        "mid": (pytest.approx(14.0), "range over focal length"),
        "pier": (pytest.approx(15.0), "distance of the face over focal length"),
    }
    # What was read at another camera counts there.
    fields = session.as_fields()
    fields["view"][1] |= distance
    assert scales(Session(**fields), "right") == {
        "pier": (pytest.approx(15.0), "distance of the face over focal length")
    }


def test_the_length_of_a_single_view():
    length = {"length": [{"points": ["mid", "pier"], "value": 10.0, "std": 0.01}]}
    session = make_session(views=("left",), point=[POINTS[0], {**POINTS[1], "pixel_in": {}}], site=length)
    assert scales(session) == dict.fromkeys(("mid", "pier"), (pytest.approx(20.0), "length mid - pier"))


def test_no_lens_no_millimetres():
    ranges = {"range": [{"point": "mid", "value": 20.0, "std": 0.01}]}
    session = make_session(site=ranges)
    blind = session.model_copy(update={"view": tuple(v.model_copy(update={"lens": None}) for v in session.view)})
    assert scales(blind) == {}
    assert scales(make_session(site=ranges, lens={"focal_px": 1000.0, "relative_std": 0.3})) == {}
    assert scales(make_session()) == {}


def test_cameras_of_an_earlier_run_know_places_and_distances(tmp_path):
    run = earlier_run()
    write_solution(tmp_path / "cameras.toml", run, "key")
    for path in (tmp_path, tmp_path / "cameras.toml"):
        earlier = read_cameras(path)
        session = make_session()
        places = find_places(session, session.view[1], earlier)
        assert places["pier"].tolist() == [700.0, 360.0]  # the session's own pixel counts first
        np.testing.assert_allclose(places["mid"], run.points["position"].sel(view="right", point="mid"))
        found = scales(session, "right", earlier)
        assert found["mid"] == (pytest.approx(10.0), "cameras of the earlier run")
        assert found["pier"] == (pytest.approx(12.5), "cameras of the earlier run")
    assert "mid" not in find_places(session, session.view[1], None)
    with pytest.raises(ResultsError):
        read_cameras(tmp_path / "nothing")


def test_a_camera_file_of_another_size(tmp_path):
    from vfm_sdm.stages.cameras.file import write_rig

    camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    write_rig(tmp_path / "left.toml", Rig(("left",), (camera,)))
    session = make_session(camera=str(tmp_path / "left.toml"))
    with pytest.raises(CameraError, match="image size"):
        scales(session)
