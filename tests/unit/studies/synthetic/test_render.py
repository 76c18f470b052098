from math import erf

import numpy as np
import pytest
from rendered_scenes import (
    blurred,
    directions_at,
    nearest_faces,
    plain_camera,
    plain_face,
    register,
)

from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.studies.synthetic.cast_arrays import BLUR_PX
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.scene import Face, Mark, Scene, Texture

DISTORTION = (-0.3, 0.1, 0.002, -0.001)
BACK = plain_face("back", 60.0, (-3, -2, 9), (6, 0, 0), (0, 4, 0))


def rigid(shift):
    return lambda positions: np.tile(shift, (len(positions), 1))


def bend(amplitude, start, span):
    return lambda positions: np.outer(np.sin(np.pi * np.clip((positions[:, 2] - start) / span, 0, 1)), amplitude)


# --- exactness of motion ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def oblique():
    """A long face at 35 degrees to the optical axis, before a wall, through a lens with distortion."""
    camera = plain_camera(420, 300, focal_px=1500.0, distortion=(-0.2, 0.1), yaw=np.deg2rad(35))
    girder = Face(
        "girder", np.array([5.0, -0.9, 3.5]), np.array([0, 0, 8.0]), np.array([0, 1.8, 0]),
        Texture(5, 110.0, 22.0, (0.036, 0.018)), moving=True,
    )  # fmt: skip
    trees = Face(
        "trees", np.array([14.0, -6, 2.0]), np.array([0, 0, 40.0]), np.array([0, 12.0, 0]),
        Texture(6, 90.0, 20.0, (0.15, 0.06)),
    )  # fmt: skip
    return Scene((girder, trees)), camera


@pytest.fixture(scope="module")
def oblique_renderer(oblique):
    return Renderer(*oblique, reach_m=0.01)


@pytest.mark.parametrize(
    "amplitude",
    [(0.0011, 0, 0), (-0.004, 0, 0), (0, 0.0007, 0), (0, 0.0043, 0), (0, 0, 0.0023), (0.002, -0.0031, 0.0012)],
)
def test_rendered_motion_is_the_commanded_one_to_two_thousandths_of_a_pixel(oblique, oblique_renderer, amplitude):
    scene, camera = oblique
    displacement = bend(np.array(amplitude), 3.5, 8.0)
    moved = oblique_renderer.render(displacement)
    for along in ([2.2, 0.9], [3.6, 0.6], [4.7, 1.1]):
        point = scene.face("girder").points3d(along)
        pixel = camera.project(point)
        commanded = camera.project(point + displacement(point[None])[0]) - pixel
        rendered = register(oblique_renderer.luma_at_rest, moved, pixel)
        assert np.abs(commanded).max() > 0.02
        np.testing.assert_allclose(rendered, commanded, atol=0.002)


@pytest.mark.parametrize("tilt", [0.0, 0.03, 0.5])
def test_edges_move_as_exactly_as_the_texture(tilt):
    camera = plain_camera(140, 120, focal_px=1500.0)
    u, v = np.array([np.cos(tilt), np.sin(tilt), 0]), np.array([-np.sin(tilt), np.cos(tilt), 0])
    corner = np.array([0.005, -0.003, 5.0])
    face = Face("plate", corner, 0.5 * u, 0.4 * v, Texture(1, 100.0, 8.0, (0.014, 0.014)), moving=True)
    renderer = Renderer(Scene((face,), sky=200.0), camera, reach_m=0.005)
    for shift in ([0.0021, 0, 0], [0, -0.0012, 0], [-0.0006, 0.0027, 0.002]):
        moved = renderer.render(rigid(shift))
        commanded = camera.project(corner + shift) - camera.project(corner)
        rendered = register(renderer.luma_at_rest, moved, camera.project(corner))
        np.testing.assert_allclose(rendered, commanded, atol=0.002)


def test_drawing_again_what_moved_is_drawing_the_moved_scene(oblique, oblique_renderer):
    scene, camera = oblique
    shift = np.array([-0.006, 0.005, 0.004])
    girder, trees = scene.faces
    there = Face("girder", girder.origin + shift, girder.edge_u, girder.edge_v, girder.texture)
    anew = Renderer(Scene((there, trees)), camera).luma_at_rest
    np.testing.assert_allclose(oblique_renderer.render(rigid(shift)), anew, atol=2e-3)


def test_what_enters_the_image_from_outside_is_drawn():
    camera = plain_camera(60, 40, focal_px=1000.0)
    left = (-0.5 - 60 / 2 - 2.2) / 1000 * 5  # the edge is 2.7 px outside the image
    plate = plain_face("plate", 220.0, (left - 1, -1, 5), (1.0, 0, 0), (0, 2, 0), moving=True)
    renderer = Renderer(Scene((plate, BACK)), camera, reach_m=0.03)
    assert np.ptp(renderer.luma_at_rest) < 1
    moved = renderer.render(rigid([0.025, 0, 0]))  # 5 px
    assert moved[20, 0] > 210
    assert moved[20, 8] == pytest.approx(60, abs=0.5)


def test_no_displacement_leaves_the_picture_as_it_is(oblique_renderer):
    still = oblique_renderer.render()
    np.testing.assert_array_equal(still, oblique_renderer.luma_at_rest)
    np.testing.assert_array_equal(oblique_renderer.render(rigid([0.0, 0, 0])), still)
    still[:] = 0  # a copy: the next frame is not touched
    assert oblique_renderer.luma_at_rest.std() > 5


def test_displacement_of_a_scene_that_stands_still_changes_nothing():
    renderer = Renderer(Scene((BACK,)), plain_camera())
    np.testing.assert_array_equal(renderer.render(rigid([0.01, 0, 0])), renderer.luma_at_rest)


# --- faces, edges, lens ----------------------------------------------------------------------------------------------


def test_straight_edge_is_seen_through_a_gaussian_point_spread():
    camera = plain_camera(40, 30, focal_px=100.0)
    edge_px = 18.3
    left = (edge_px - 19.5) / 100 * 5
    front = plain_face("front", 200.0, (left, -3, 5), (4, 0, 0), (0, 6, 0))
    image = Renderer(Scene((BACK, front)), camera).luma_at_rest
    share = [0.5 * (1 + erf((u - edge_px) / (np.sqrt(2) * BLUR_PX))) for u in range(40)]
    # The point spread is cut where 1e-4 of it is left.
    np.testing.assert_allclose(image[15, 4:36], 60 + 140 * np.array(share[4:36]), atol=0.05)


def box():
    """A cube that shows its nearest corner."""
    angles = np.deg2rad([10, 130, 250])
    e = 0.3 * np.column_stack([np.sqrt(2 / 3) * np.cos(angles), np.sqrt(2 / 3) * np.sin(angles), [np.sqrt(1 / 3)] * 3])
    sides = [plain_face(f"side {k}", 120.0 + 50 * k, (0.01, 0.02, 5), e[k], e[(k + 1) % 3]) for k in range(3)]
    return (BACK, *sides)


def girder():
    """Stiffeners that end at the web and are hidden in part behind their flanges."""
    web = plain_face("web", 60.0, (-3, -2, 6), (6, 0, 0), (0, 4, 0), moving=True)
    parts = [web]
    for name, at in (("right", 0.3), ("left", -0.3)):
        parts.append(plain_face(f"{name} plate", 150.0, (at, -0.3, 5.6), (0, 0, 0.4), (0, 0.6, 0), moving=True))
        parts.append(plain_face(f"{name} flange", 200.0, (at - 0.1, -0.3, 5.6), (0.2, 0, 0), (0, 0.6, 0), moving=True))
    return tuple(parts)


def plates():
    left = plain_face("left", 60.0, (-1, -0.5, 6), (1.02, 0, 0), (0, 1, 0), moving=True)
    return left, plain_face("right", 150.0, (0.02, -0.5, 6), (1, 0, 0), (0, 1, 0), moving=True)


def tilted_plate():
    return BACK, plain_face("front", 180.0, (-0.5, -0.4, 5), (1.0, 0.06, 0), (-0.048, 0.8, 0), moving=True)


@pytest.mark.parametrize(
    ("faces", "inner", "border"),
    # One edge is blended in closed form; where three faces meet, and at the border of the image, by 64 rays; at the
    # corners of a silhouette that are no right angles, by the product of two edges' shares.
    [(girder(), 0.5, 5), (plates(), 0.5, 5), (tilted_plate(), 0.5, 5), (box(), 15, 15)],
    ids=["girder", "plates", "tilted", "box"],
)
@pytest.mark.parametrize("shift", [(0, 0, 0), (0.004, 0.003, -0.006)], ids=["rest", "moved"])
def test_pictures_are_those_of_a_brute_force_ray_caster(faces, inner, border, shift):
    scene, camera = Scene(faces, sky=240.0), plain_camera(48, 36, focal_px=230.0, distortion=DISTORTION, yaw=0.04)
    image = Renderer(scene, camera, reach_m=0.01).render(rigid(shift))
    expected = blurred(scene, camera, sigma=BLUR_PX, shift=shift)
    error = np.abs(image - expected)
    assert np.ptp(expected) > 80
    assert error[3:-3, 3:-3].max() < inner
    assert error.max() < border
    assert np.percentile(error[3:-3, 3:-3], 95) < 0.15 * inner + 0.05


@pytest.mark.parametrize("order", [1, -1])
def test_nearest_face_hides_the_others_in_whatever_order_they_are_listed(order):
    camera = plain_camera(48, 36, focal_px=230.0, distortion=DISTORTION)
    scene = Scene(box()[::order], sky=240.0)
    pixels = np.stack(np.meshgrid(np.arange(48), np.arange(36)), axis=-1)
    expected = nearest_faces(scene, directions_at(camera, pixels), camera.center)
    np.testing.assert_array_equal(Renderer(scene, camera).face_at_rest, expected)
    assert len(np.unique(expected)) == 4


def test_what_lies_behind_the_camera_is_not_seen():
    behind = plain_face("behind", 10.0, (-3, -2, -5), (6, 0, 0), (0, 4, 0))
    image = Renderer(Scene((behind,), sky=222.0), plain_camera()).luma_at_rest
    assert np.all(image == 222.0)


def test_lens_distortion_is_honoured():
    straight = plain_camera(200, 160, focal_px=200.0)
    bent = plain_camera(200, 160, focal_px=200.0, distortion=DISTORTION)
    spots = [(0.8, 0.6), (0.9, 2.4), (3.3, 0.8), (3.4, 2.5)]
    marks = tuple(Mark(spot, (0.05, 0.05), -80.0) for spot in spots)
    wall = Face("wall", np.array([-2, -1.6, 5.0]), np.array([4.0, 0, 0]), np.array([0, 3.2, 0]),
                Texture(0, 150.0, 0.0, (0.1, 0.1), marks=marks))  # fmt: skip
    image = Renderer(Scene((wall,)), bent).luma_at_rest
    for spot in spots:
        expected = bent.project(wall.points3d(spot))
        u0, v0 = np.rint(expected).astype(int)
        window = (slice(v0 - 10, v0 + 11), slice(u0 - 10, u0 + 11))
        depth = 150.0 - image[window]
        v, u = np.mgrid[window]
        found = np.array([(u * depth).sum(), (v * depth).sum()]) / depth.sum()
        np.testing.assert_allclose(found, expected, atol=0.03)  # the centre of a spot's image is not its centre's image
        assert np.linalg.norm(straight.project(wall.points3d(spot)) - expected) > 0.3


def test_refuses_a_lens_that_has_no_inverse():
    with pytest.raises(CameraError, match="distortion: expected one that can be undone all over the image"):
        Renderer(Scene((BACK,)), plain_camera(400, 300, focal_px=120.0, distortion=(-0.5,)))


@pytest.mark.parametrize(
    ("displacement", "message"),
    [
        (lambda positions: positions[:, :2], r"displacement: expected shape"),
        (lambda positions: np.full_like(positions, np.nan), "displacement: expected finite metres"),
        (rigid([0, 0.02, 0]), r"displacement: expected at most reach_m = 0.01 m, got 0.02"),
    ],
)
def test_refuses_displacements_that_it_cannot_draw(oblique_renderer, displacement, message):
    with pytest.raises(DatasetError, match=message):
        oblique_renderer.render(displacement)


def test_rows_drawn_band_by_band_at_one_instant_make_the_whole_picture(oblique_renderer):
    displacement = bend(np.array([0.002, -0.0031, 0.0012]), 3.5, 8.0)
    whole = oblique_renderer.render(displacement)
    bands = oblique_renderer.luma_at_rest.copy()
    for first in range(0, len(whole), 32):
        oblique_renderer.render(displacement, rows=(first, min(first + 32, len(whole))), into=bands)
    np.testing.assert_array_equal(bands, whole)
    again = oblique_renderer.render(rigid([0.0, 0, 0]), rows=(0, 32), into=bands)
    assert again is bands
    np.testing.assert_array_equal(bands[:32], oblique_renderer.luma_at_rest[:32])
    np.testing.assert_array_equal(bands[32:], whole[32:])


@pytest.mark.parametrize("reach", [-0.1, np.nan, np.inf])
def test_refuses_a_reach_that_is_none(reach):
    with pytest.raises(DatasetError, match="reach_m: expected metres >= 0"):
        Renderer(Scene((BACK,)), plain_camera(), reach_m=reach)


# --- what the video holds --------------------------------------------------------------------------------------------


def test_chroma_shows_the_tints_of_the_faces():
    left = Face("left", np.array([-9.0, -9, 5]), np.array([9.0, 0, 0]), np.array([0, 18.0, 0]),
                Texture(0, 90.0, 0.0, (0.5, 0.5)), tint=(-20.0, 10.0))  # fmt: skip
    planes = Renderer(Scene((left,)), plain_camera(31, 20, focal_px=40.0)).chroma_at_rest()
    assert planes.shape == (2, 10, 16)
    assert tuple(planes[:, 5, 2]) == (108, 138)
    assert tuple(planes[:, 5, 13]) == (128, 128)
