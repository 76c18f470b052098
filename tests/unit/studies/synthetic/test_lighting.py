"""Reflections and shadows where geometry says that they are."""

import numpy as np
import pytest
from rendered_scenes import directions_at, plain_camera

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.lighting import Canopy, Light, Shading, canopy_density, compute_reflection
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.scene import Face, Scene, Texture

CAMERA = plain_camera(160, 120, focal_px=300.0)
CANOPY = Canopy((0.0, 0.0, 10.0), radius_m=0.8, leaf_m=0.3, depth=0.7, sway_m=0.1, seed=3)
LIGHT = Light((0.3, -0.5, -1.0), sun=0.7, canopy=CANOPY)


def lit_scene(light, gloss=(0.0, 1.0), moving=False):
    """A renderer of a wall 10 m away that fills the picture."""
    texture = Texture(0, 100.0, 0.0, (0.2, 0.2))
    corner, u, v = np.array([-4.0, -4.0, 10.0]), np.array([8.0, 0, 0]), np.array([0, 8.0, 0])
    face = Face("wall", corner, u, v, texture, moving, gloss=gloss)
    return Renderer(Scene((face,), light=light), CAMERA)


def shade(renderer):
    pose = CAMERA.cam_from_world
    return Shading(renderer.scene.light, planes=renderer.face_planes, rays=renderer.rays, pose=pose)


def test_light_on_a_face_is_lamberts():
    normal = np.array([0.0, 0.0, -1.0])
    cosine = 1 / np.linalg.norm(LIGHT.to_sun)
    assert LIGHT.irradiance(normal) == pytest.approx(0.3 + 0.7 * cosine)
    assert LIGHT.sun_share(normal) == pytest.approx(0.7 * cosine / (0.3 + 0.7 * cosine))
    assert LIGHT.irradiance(-normal) == pytest.approx(0.3)
    assert LIGHT.sun_share(-normal) == 0


def test_a_reflection_is_brightest_in_the_mirrors_direction():
    # The camera looks along z; the sun's mirror image in the wall is seen in this direction.
    light = Light((0.1, -0.15, -1.0))
    reflected = lit_scene(light, gloss=(40.0, 400.0)).render() - lit_scene(light).render()
    expected = CAMERA.project([0.1, -0.15, 1.0])
    row, column = np.unravel_index(np.argmax(reflected), reflected.shape)
    np.testing.assert_allclose([column, row], expected, atol=1.0)
    assert reflected.max() == pytest.approx(40.0, rel=0.01)
    # Off it, the cosine of the angle between the normal and half-way, to the power of the exponent.
    ray = directions_at(CAMERA, np.array([20.0, 90.0]))
    half = light.direction - ray / np.linalg.norm(ray)
    assert reflected[90, 20] == pytest.approx(40 * (-half[2] / np.linalg.norm(half)) ** 400, rel=1e-3, abs=1e-3)


def test_shadows_lie_where_the_leaves_hide_the_sun():
    renderer = lit_scene(LIGHT)
    share = shade(renderer).share(renderer.face_at_rest, 2.0)
    assert 1 - CANOPY.depth - 1e-6 <= share.min() < 1 - CANOPY.depth + 0.15
    # Far from the canopy's middle, as seen from the sun, no light is taken.
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1)
    points = 10 * directions_at(CAMERA, pixels)
    apart = points - np.asarray(CANOPY.center)
    apart -= (apart @ LIGHT.direction)[..., None] * LIGHT.direction
    distance = np.linalg.norm(apart, axis=-1) / CANOPY.radius_m
    assert share[distance > 4].min() > 0.995
    assert share[distance < 1].std() > 0.05


def test_shadows_sway_and_do_not_follow_the_structure():
    renderer = lit_scene(LIGHT, moving=True)
    shading = shade(renderer)
    first, later = (shading.share(renderer.face_at_rest, time_s) for time_s in (0.0, 1.0))
    assert np.abs(first - later).max() > 0.05
    luma = renderer.render(lambda points: np.tile([0.01, 0.01, 0.0], (len(points), 1)))
    np.testing.assert_array_equal(shading.share(renderer.face_drawn, 0.0), first)
    drawn = shading.draw(luma, renderer.face_drawn, 0.0)
    assert drawn.shape == luma.shape
    middle = np.s_[10:-10, 10:-10]
    assert np.corrcoef(drawn[middle].ravel(), first[middle].ravel())[0, 1] > 0.99


def test_faces_turned_from_the_sun_reflect_nothing_of_it():
    light = Light((0.0, 0.0, 1.0))
    np.testing.assert_array_equal(lit_scene(light, gloss=(40.0, 2.0)).render(), lit_scene(light).render())


def test_two_cameras_see_the_reflection_at_different_places():
    light, wall, normal = Light((0.0, 0.0, -1.0)), np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 10.0]]), np.array([0, 0, 1.0])
    first, second = (
        compute_reflection(light, (40.0, 50.0), normal=normal, points3d=wall, center=np.array(center))
        for center in ([0.0, 0.0, 0.0], [2.0, 0.0, 0.0])
    )
    assert first[0] > first[1]
    assert second[1] > second[0]


def test_the_pattern_of_leaves_repeats_without_a_seam():
    density = canopy_density(CANOPY).astype(float)
    inner = np.abs(np.diff(density, axis=0)).mean()
    assert np.abs(density[0] - density[-1]).mean() < 1.5 * inner
    np.testing.assert_array_equal(density, canopy_density(CANOPY))


def test_impossible_lights_are_refused():
    with pytest.raises(DatasetError, match="light: expected a direction and a share in"):
        Light((0.0, 0.0, 0.0))
    with pytest.raises(DatasetError, match="light: expected a canopy, got none"):
        shade(lit_scene(Light((0.3, -0.5, -1.0))))
    with pytest.raises(DatasetError, match="canopy: expected sizes > 0 m and depth in"):
        Canopy((0.0, 0.0, 0.0), radius_m=0.0)
