"""Grids on the face of the virtual footbridge: points where they truly are in both views, and faults that are named."""

from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.grids import grid_points, without_grids
from vfm_sdm.errors import SessionError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.inputs.session import Grid, Measured, Session, Site, View
from vfm_sdm.stages.cameras.grid import add_grids
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.film import film_view

WEB = ((300.0, 275.0), (1000.0, 265.0), (1000.0, 455.0), (300.0, 440.0))


@pytest.fixture(scope="module")
def plan():
    return demo_plan(seed=3, duration_s=0.5)


@pytest.fixture(scope="module")
def frames(plan):
    scene = plan.site.scene(seed=plan.seed)
    return {name: next(iter(film_view(plan, scene, number)[0])) for number, name in enumerate(("left", "right"))}


@pytest.fixture(scope="module")
def cameras(plan):
    views = plan.site.cameras()
    size = len(CAMERA_PARAMETERS) * len(views)
    rig = Rig.from_world(("left", "right"), views, metric=True)
    # The reference camera's axes, turned to the structure's; the site's world has these axes already.
    rotation = views[0].rotation.T
    pixels = np.stack([view.project(np.array([[plan.site.perpendicular_m, 0.0, 4.4]])) for view in views])
    points = make_points(
        ["left", "right"], ["mid"], position=pixels, position_std=np.full((2, 1, 2), 0.1), status=[["ok"], ["ok"]]
    )
    return CameraSolution(rig, StructureFrame(rotation, 1e-8 * np.eye(3)), 1e-12 * np.eye(size + 3), points)


def session(**fields):
    grid = {"name": "web", "view": "left", "polygon": WEB, "spacing_m": 0.2, **fields}
    site = Site(
        baseline=Measured(value=3.8, std=0.01),
        perpendicular_distance=Measured(value=7.02, std=0.02),
        longitudinal_distance=Measured(value=4.5, std=0.02),
    )
    views = tuple(View(name=name, video=f"{name}.mp4") for name in ("left", "right"))
    return Session(name="grid", view=views, site=site, grid=(Grid(**grid),))


def test_points_lie_where_both_views_show_the_same_place(plan, frames, cameras):
    found = add_grids(session(), cameras, frames)
    assert without_grids(found)["point"].values.tolist() == ["mid"]
    names = grid_points(found)
    assert 20 < len(names) < 200
    assert all(name.startswith("web 0") for name in names)
    many = found.sel(point=names)
    ok = (many["status"] == "ok").all("view").values
    assert ok.mean() > 0.5
    left, right = (many["position"].sel(view=view).values[ok] for view in ("left", "right"))
    first, second = plan.site.cameras()
    rays = np.column_stack([first.normalize(left), np.ones(len(left))]) @ first.rotation
    reach = (plan.site.perpendicular_m - first.center[0]) / rays[:, 0]
    off = np.linalg.norm(second.project(first.center + reach[:, None] * rays) - right, axis=1)
    # What stands off the web (stiffeners, splice plates) lies elsewhere in the second view.
    assert np.median(off) < 0.3
    assert np.quantile(off, 0.8) < 1.0
    assert (many["position_std"].sel(view="left").values[ok] == 0).all()
    assert np.isnan(many["position"].sel(view="right").values[~ok]).all()


def test_neighbours_are_as_far_apart_as_asked(plan, frames, cameras):
    found = add_grids(session(), cameras, frames)
    first = plan.site.cameras()[0]
    places = {}
    for name in grid_points(found):
        pixel = found["position"].sel(view="left", point=name).values
        if np.isfinite(pixel).all():
            ray = np.append(first.normalize(pixel), 1.0) @ first.rotation
            places[name] = first.center + (plan.site.perpendicular_m - first.center[0]) / ray[0] * ray
    steps = [
        places[f"web 02-{column + 1:02d}"][2] - places[f"web 02-{column:02d}"][2]
        for column in range(1, 30)
        if {f"web 02-{column + 1:02d}", f"web 02-{column:02d}"} <= set(places)
    ]
    assert len(steps) > 5
    # A node may give way to texture by a third of the spacing.
    assert np.abs(np.abs(steps) - 0.2).max() < 0.2 * 0.61
    assert np.median(np.abs(steps)) == pytest.approx(0.2, rel=0.05)


def test_a_plain_surface_gets_no_points(frames, cameras):
    plain = {view: np.full_like(luma, 128) for view, luma in frames.items()}
    found = add_grids(session(), cameras, plain)
    many = found.sel(point=grid_points(found))
    assert set(np.unique(many["status"].values)) == {"no texture to follow"}
    assert np.isnan(many["position"].values).all()


def test_faults_are_named(frames, cameras):
    with pytest.raises(SessionError, match="polygon inside 1280 x 720"):
        add_grids(session(polygon=((10.0, 10.0), (5000.0, 10.0), (20.0, 30.0))), cameras, frames)
    with pytest.raises(SessionError, match=r"expected 1 to 2000 points, got \d+ at 0\.015 m"):
        add_grids(session(spacing_m=0.015), cameras, frames)
    named = cameras.points.assign_coords(point=["web 01-01"])
    twice = CameraSolution(cameras.rig, cameras.frame, cameras.covariance, named)
    with pytest.raises(SessionError, match="grid: expected names that no point has, got web 01-0"):
        add_grids(session(), twice, frames)


@pytest.mark.parametrize("spacing_m", [1e-3, 1e-5, 1e-9])
def test_millions_of_points_are_refused_before_they_are_laid_out(spacing_m, frames, cameras):
    with pytest.raises(SessionError, match=rf"got {spacing_m:g} m on a polygon of \d\.\d+ m by \d\.\d+ m on the face"):
        add_grids(session(spacing_m=spacing_m), cameras, frames)


@pytest.mark.parametrize(
    ("polygon", "said"),
    [
        ((WEB[0], WEB[2], WEB[1], WEB[3]), "edges 1 and 3 that cross"),
        ((WEB[0], WEB[1], WEB[3], WEB[2]), "edges 2 and 4 that cross"),
        ((WEB[0], WEB[1], WEB[1]), "around an area, got 0 px2"),
    ],
)
def test_polygons_that_cross_themselves_or_are_lines_are_refused(polygon, said):
    with pytest.raises(ValueError, match=said):
        session(polygon=polygon)
    # Either way round and with a corner that turns inwards there is nothing to cross.
    session(polygon=WEB[::-1])
    session(polygon=(*WEB[:2], (500.0, 300.0), WEB[3]))


def test_a_view_that_looks_elsewhere_finds_no_point(frames, cameras):
    left, right = cameras.rig.cameras
    away = np.column_stack([np.diag([-1.0, 1.0, -1.0]) @ right.rotation, [0.0, 0.0, -1.0]])
    rig = Rig(cameras.rig.names, (left, replace(right, cam_from_world=away)), True)
    found = add_grids(session(spacing_m=0.5), replace(cameras, rig=rig), frames)
    many = found.sel(point=grid_points(found))
    assert (many["status"].sel(view="left") == "ok").any()
    assert not (many["status"].sel(view="right") == "ok").any()
    assert np.isnan(many["position"].sel(view="right").values).all()


def test_without_cameras_nothing_is_added(frames, cameras):
    alone = CameraSolution(None, None, None, cameras.points)
    assert "grid" not in add_grids(session(), alone, frames)


def test_a_grid_needs_a_face_and_two_views():
    views = (View(name="left", video="left.mp4"),)
    grid = Grid(name="web", view="lft", polygon=WEB, spacing_m=0.2)
    with pytest.raises(SessionError) as caught:
        Session(name="grid", view=views, grid=(grid,))
    assert "grid[web]: expected the distances of the face" in str(caught.value)
    assert "grid[web]: expected two views or more, got one" in str(caught.value)
    assert "did you mean 'left'?" in str(caught.value)


def test_a_session_without_grids_says_nothing_of_them():
    views = (View(name="left", video="left.mp4"),)
    assert "grid" not in Session(name="none", view=views).as_fields()
