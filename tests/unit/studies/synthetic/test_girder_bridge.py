"""The girder bridge of real surfaces: its lenses, and pictures against the truth."""

from dataclasses import replace

import numpy as np
import pytest
from rendered_scenes import register

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.girder_bridge import GirderBridgeSite, find_on_face
from vfm_sdm.studies.synthetic.presets import SURFACES, preset
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.scene import find_hidden

POINTS = ("bolts", "concrete", "flange", "paint", "stiffener", "post", "post base")
STATIC = ("abutment corner", "abutment face", "backwall")


def without_leaves(plan, **changes):
    """The plan before a bare wall, which is drawn faster."""
    surfaces = plan.site.surfaces
    bare = replace(surfaces, wall=replace(surfaces.wall, foliage=(), windows=surfaces.wall.windows[:4]))
    return replace(plan, site=replace(plan.site, surfaces=bare, **changes))


@pytest.fixture(scope="module", params=SURFACES)
def plan(request):
    return without_leaves(preset(request.param, "small"))


@pytest.fixture(scope="module")
def scene(plan):
    return plan.site.scene(seed=plan.seed)


def test_lenses_are_off_centre_and_tangential_distortion_can_be_undone(plan):
    for camera, tripod in zip(plan.site.cameras(), plan.site.tripods, strict=True):
        width, height = camera.image_size
        offset = camera.K[:2, 2] - [(width - 1) / 2, (height - 1) / 2]
        np.testing.assert_allclose(offset, tripod.principal_px)
        assert np.abs(offset).min() > 5
        assert np.abs(camera.distortion[2:4]).min() > 5e-4
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7)), axis=-1)
        rays = np.concatenate([camera.normalize(grid), np.ones((*grid.shape[:-1], 1))], axis=-1)
        points = camera.center + 20.0 * rays @ camera.rotation
        np.testing.assert_allclose(camera.project(points), grid, atol=1e-6)
        # It matters: the tangential part alone shifts corners by more than tracking resolves.
        radial = replace(camera, distortion=camera.distortion * [1, 1, 0, 0, 1])
        assert np.abs(radial.project(points) - grid).max() > 0.05


def test_distances_are_those_to_the_middle_of_the_picture(plan):
    site, camera = plan.site, plan.site.cameras()[0]
    seen = camera.project([site.perpendicular_m, find_on_face(camera, site.perpendicular_m)[1], site.longitudinal_m])
    np.testing.assert_allclose(seen, (np.array(camera.image_size) - 1) / 2, atol=1e-6)
    # The optical axis meets the face elsewhere, by more than the reading's standard deviation.
    assert abs(site.longitudinal_m - site.tripods[0].target_m) > plan.errors.longitudinal_m


def test_the_second_surface_is_seen_wider_and_at_more_convergence():
    first, second = (preset(name, "small").site for name in SURFACES)
    angles, fields = [], []
    for site in (first, second):
        axes = [camera.rotation[2] for camera in site.cameras()]
        angles.append(np.degrees(np.arccos(axes[0] @ axes[1])))
        fields.append(np.degrees(2 * np.arctan(640 / site.cameras()[0].focal_px)))
    assert 7 < angles[0] < 11
    assert 14 < angles[1] < 22
    assert 9 < fields[0] < 11
    assert 18 < fields[1] < 25


def test_points_are_seen_in_both_views_on_their_surfaces(plan, scene):
    assert tuple(point.name for point in plan.points) == (*POINTS, *STATIC)
    positions = np.array([point.position for point in plan.points])
    for camera in plan.site.cameras():
        pixels = camera.project(positions)
        # A square of 61 px about each is inside.
        assert np.all((pixels > 31) & (pixels < np.array(camera.image_size) - 32))
        assert not find_hidden(scene, camera, positions).any()
        renderer = Renderer(scene, camera, reach_m=0.0)
        for point, (u, v) in zip(plan.points, np.rint(pixels).astype(int), strict=True):
            around = renderer.face_at_rest[v - 2 : v + 3, u - 2 : u + 3].ravel()
            faces = [scene.faces[k] for k in around if k >= 0]
            on = [
                face
                for face in faces
                if abs((np.array(point.position) - face.origin) @ np.cross(face.edge_u, face.edge_v))
                < 1e-9 * np.prod(face.size_m) + 1e-12
            ]
            assert on, point.name
            assert all(face.moving != point.static for face in on), point.name


def test_pictures_move_as_commanded_where_the_structure_has_texture_or_edges(plan, scene):
    view = 1 - SURFACES.index(plan.name)
    camera = plan.site.cameras()[view]
    renderer = Renderer(scene, camera)
    rest, errors = renderer.render(), {name: [] for name in ("bolts", "concrete", "paint", "stiffener")}
    for shift in np.array([[0.5, -1.1, 0.0], [-0.9, 0.7, 0.1], [1.3, 2.2, 0.0], [-0.2, -2.6, -0.1]]) * 1e-3:
        moved = renderer.render(lambda points, shift=shift: np.tile(shift, (len(points), 1)))
        for point in plan.points:
            if point.name in errors:
                at = np.array(point.position)
                expected = camera.project(at + shift) - camera.project(at)
                errors[point.name].append(register(rest, moved, camera.project(at)) - expected)
    assert np.abs(errors["concrete"]).max() < 0.003
    assert np.abs(errors["paint"]).max() < 0.003
    # Across its edge; along it nothing tells.
    assert np.abs(np.array(errors["stiffener"])[:, 0]).max() < 0.006
    # Many small faces meet in few pixels, which are drawn by 64 samples.
    assert np.sqrt(np.mean(np.square(errors["bolts"]))) < 0.012


def test_what_is_behind_is_far_and_out_of_focus(plan, scene):
    camera = plan.site.cameras()[0]
    near = Renderer(scene, camera, reach_m=0.0).depth_at_rest()
    far = Renderer(scene.backdrop, camera, reach_m=0.0).depth_at_rest()
    seen = np.isfinite(near)
    assert 0.5 < seen.mean() < 0.95
    assert np.median(far[~seen & np.isfinite(far)]) > near[seen].max()
    point = np.array(plan.points[0].position)
    u, v = np.rint(camera.project(point)).astype(int)
    assert near[v, u] == pytest.approx(camera.rotation[2] @ (point - camera.center), abs=0.06)


def test_the_wall_repeats_exactly(plan, scene):
    wall = scene.backdrop.face("wall").texture
    length, height = plan.site.surfaces.wall.stone_m
    stones = {tuple(np.round(mark.center_m, 6)): mark.luma for mark in wall.marks if mark.half_m[0] > 0}
    repeats = [
        (luma, stones[right])
        for (u, v), luma in stones.items()
        if v < 3 * height and (right := tuple(np.round((u + 4 * length, v), 6))) in stones
    ]
    assert len(repeats) > 20
    assert len({first for first, _ in repeats}) > 5
    assert all(first == second for first, second in repeats)


def test_frames_show_the_motion_of_the_truth(plan):
    # Without noise and shadows, and linear in light, but through lens and depth of field.
    light = replace(plan.site.light, canopy=None)
    photometry = replace(plan.recordings[0].photometry, full_well_e=0.0, read_noise_e=0.0, vignetting=0.0)
    bare = without_leaves(plan, light=light)
    recordings = tuple(replace(r, photometry=photometry, start_s=0.0) for r in bare.recordings)
    moving = replace(bare, recordings=recordings, fps=3, duration_s=3.0)
    scene = moving.site.scene(seed=moving.seed)
    names = ["bolts", "abutment face"]
    rest = np.array([p.position for p in moving.points if p.name in names])
    moves = np.array([not p.static for p in moving.points if p.name in names])
    view = SURFACES.index(plan.name)
    camera, times = moving.site.cameras()[view], moving.frame_times(view)
    frames = [f.astype(float) for f in film_view(moving, scene, view)[0]]
    errors, shifts = [], []
    for number in (5, 7, 8):
        moved = rest + moves[:, None] * moving.motion.displacement([times[number]], rest)[0]
        shifts.append(camera.project(moved) - camera.project(rest))
        errors.append([register(frames[0], frames[number], camera.project(x)) for x in rest] - shifts[-1])
    assert np.abs(shifts).max() > 0.3
    # Rounding to whole luma units.
    assert np.sqrt(np.mean(np.square(errors))) < 0.012
    assert np.abs(errors).max() < 0.03


@pytest.mark.slow
def test_films_differ_by_every_stage_of_lens_and_sensor():
    plan = without_leaves(preset("surface-1", "small"), image_size=(640, 360))
    scene, recording = plan.site.scene(seed=plan.seed), plan.recordings[0]
    shown = {}
    for name, change in {
        "all": {},
        "pinhole": {"aperture_mm": 0.0},
        "no vignetting": {"vignetting": 0.0},
        "no noise": {"full_well_e": 0.0},
        "other tone": {"shoulder": 0.0},
    }.items():
        recordings = (replace(recording, photometry=replace(recording.photometry, **change)), plan.recordings[1])
        shown[name] = next(film_view(replace(plan, recordings=recordings), scene, 0)[0]).astype(float)
    reference = shown.pop("all")
    for name, frame in shown.items():
        assert np.abs(frame - reference).mean() > 0.05, name
    # Vignetting darkens the corners only.
    brighter = shown["no vignetting"] - reference
    assert brighter[:20, :20].mean() > 4
    assert abs(brighter[165:195, 300:340].mean()) < 0.5
    # What is far behind is sharper through a pinhole.
    behind = Renderer(scene, plan.site.cameras()[0], reach_m=0.0).face_at_rest < 0
    gradient = {k: np.abs(np.diff(f, axis=1))[behind[:, 1:]].mean() for k, f in {**shown, "all": reference}.items()}
    assert gradient["pinhole"] > gradient["all"]


def test_impossible_sites_are_refused(plan):
    with pytest.raises(DatasetError, match="tripods: expected at least two, the first at the origin"):
        replace(plan.site, tripods=plan.site.tripods[:1])
    with pytest.raises(DatasetError, match="tripods: expected at least two, the first at the origin"):
        replace(plan.site, tripods=plan.site.tripods[::-1])


def test_the_second_camera_can_be_moved(plan):
    moved = plan.site.with_second_at((1.0, 0.0, -1.0))
    assert isinstance(moved, GirderBridgeSite)
    np.testing.assert_allclose(moved.cameras()[1].center, [1.0, 0.0, -1.0], atol=1e-12)
    assert moved.tripods[0] == plan.site.tripods[0]
