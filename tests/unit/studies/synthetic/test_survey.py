"""What the engineer noted on real surfaces, and the files of such a field test."""

from dataclasses import replace

import av
import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.datasets import check_displacement
from vfm_sdm.inputs.session import read_session
from vfm_sdm.stages.cameras.file import read_rig
from vfm_sdm.studies.synthetic.field_test import make_field_test
from vfm_sdm.studies.synthetic.girder_bridge import find_on_face
from vfm_sdm.studies.synthetic.presets import SURFACES, preset
from vfm_sdm.studies.synthetic.survey import make_sessions

FILES = {
    "left.mp4",
    "right.mp4",
    "session.toml",
    "session_further.toml",
    "truth.nc",
    "points_true.nc",
    "cameras_true.toml",
}


def tiny(name):
    """A fifth of a second of few pixels before a bare wall."""
    plan = preset(name, "small")
    wall = replace(plan.site.surfaces.wall, foliage=(), windows=())
    site = replace(plan.site, image_size=(320, 180), surfaces=replace(plan.site.surfaces, wall=wall))
    return replace(plan, site=site, duration_s=0.2)


@pytest.fixture(scope="module", params=SURFACES)
def made(request, tmp_path_factory):
    plan = tiny(request.param)
    return plan, make_field_test(tmp_path_factory.mktemp(request.param), plan)


def test_folder_holds_both_sessions_films_and_truth(made):
    plan, path = made
    assert {file.name for file in path.parent.iterdir()} == FILES
    for view in plan.views:
        with av.open(str(path.with_name(f"{view}.mp4"))) as container:
            shapes = [(frame.width, frame.height) for frame in container.decode(video=0)]
        assert shapes == [(320, 180)] * 6
    with xr.open_dataset(path.with_name("truth.nc"), engine="h5netcdf") as truth:
        check_displacement(truth.load())
        assert list(truth["point"].values) == [point.name for point in plan.points]
        assert truth.attrs["second_view_offset_s"] == plan.recordings[1].start_s


def test_truth_projects_to_the_true_points_with_the_true_cameras(made):
    plan, path = made
    rig = read_rig(path.with_name("cameras_true.toml"))
    with xr.open_dataset(path.with_name("points_true.nc"), engine="h5netcdf") as points:
        points.load()
    with xr.open_dataset(path.with_name("truth.nc"), engine="h5netcdf") as truth:
        truth.load()
    assert np.all(points["status"].values == "ok")
    reference = plan.site.cameras()[0]
    rest = truth["position"].values[0] @ reference.rotation.T
    for view in plan.views:
        np.testing.assert_allclose(
            rig.camera(view).project(rest), points["position"].sel(view=view).values, atol=1e-6, err_msg=view
        )
    given = np.array([point.pixel for point in read_session(path).point])
    np.testing.assert_allclose(given, points["position"].sel(view="left").values, atol=6e-4)


def test_a_point_behind_something_is_not_found_in_that_view(made):
    plan, path = made
    hidden = replace(plan.points[0], position=(plan.points[0].position[0] + 0.5, *plan.points[0].position[1:]))
    changed = replace(plan, points=(*plan.points[1:], hidden), ranged=None)
    made_again = make_field_test(path.parent, changed)
    with xr.open_dataset(made_again.with_name("points_true.nc"), engine="h5netcdf") as points:
        status = points["status"].sel(point="bolts").values
        assert np.all(status == "not found in the other view")
        assert np.isnan(points["position"].sel(point="bolts").values).all()
        assert np.all(points["status"].sel(point="concrete").values == "ok")
    make_field_test(path.parent, plan)


@pytest.mark.parametrize("name", SURFACES)
def test_readings_have_errors_of_the_size_that_they_state(name, tmp_path):
    plan, shares, lenses = preset(name, "small"), [], []
    site, (first, second) = plan.site, plan.site.cameras()
    places = {point.name: np.array(point.position) for point in plan.points}
    for seed in range(12):
        session = make_sessions(replace(plan, seed=seed), tmp_path)["session_further.toml"]
        found = session.site
        exact = [
            (found.baseline, plan.baseline_m),
            (found.perpendicular_distance, site.perpendicular_m),
            (found.longitudinal_distance, site.longitudinal_m),
        ]
        read, seen = session.view[1], find_on_face(second, site.perpendicular_m)
        exact.append((read.perpendicular_distance, site.perpendicular_m - second.center[0]))
        exact.append((read.longitudinal_distance, seen[2] - second.center[2]))
        for ranged, camera in zip(found.range, (first, second), strict=True):
            exact.append((ranged, float(np.linalg.norm(places[ranged.point] - camera.center))))
        for length in found.length:
            exact.append((length, float(np.linalg.norm(np.subtract(*(places[p] for p in length.points))))))
        shares += [(reading.value - value) / reading.std for reading, value in exact]
        for level, tripod in zip((found.reference_camera_level, session.view[1].level), site.tripods, strict=True):
            read = np.array([level.pitch_deg, level.roll_deg])
            shares += ((read - tripod.level_deg) / level.std_deg).tolist()
        for view, camera in zip(session.view, (first, second), strict=True):
            lenses.append(view.lens.focal_prior_px(1280) / camera.focal_px - 1)
    assert np.abs(shares).max() <= 2.15
    assert 0.75 < np.std(shares) < 1.1
    # Stated to 2 %, off by 1 %.
    assert 0.005 < np.std(lenses) < 0.013
    assert np.abs(lenses).max() < 0.0205


def test_further_readings_are_added_to_the_same_session(made):
    _, path = made
    session, further = read_session(path), read_session(path.with_name("session_further.toml"))
    assert further.point == session.point
    assert further.method == session.method
    assert [view.lens for view in further.view] == [view.lens for view in session.view]
    assert further.site.range[:1] == session.site.range
    assert (len(session.site.range), len(further.site.range)) == (1, 2)
    assert further.site.range[1].view == "right"
    assert (len(session.site.length), len(further.site.length)) == (0, 3)
    assert all(view.level is None and view.perpendicular_distance is None for view in session.view)
    assert further.view[1].longitudinal_distance is not None
