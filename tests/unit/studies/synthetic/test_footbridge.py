from dataclasses import replace

import cv2
import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite, build_footbridge, make_camera
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.motion import modal_displacement
from vfm_sdm.studies.synthetic.render import Renderer


@pytest.fixture(scope="module")
def site():
    return FootbridgeSite()


@pytest.fixture(scope="module")
def cameras(site):
    return site.cameras()


@pytest.fixture(scope="module")
def scene(site):
    return build_footbridge(site, seed=7)


@pytest.fixture(scope="module")
def renderers(scene, cameras):
    return [Renderer(scene, camera, reach_m=0.006) for camera in cameras]


def test_reference_camera_is_level_and_looks_at_the_point_whose_distances_were_measured(site, cameras):
    reference = cameras[0]
    np.testing.assert_allclose(reference.center, 0, atol=1e-12)
    # z_cam = sin(theta) lateral + cos(theta) longitudinal, with tan(theta) = perpendicular / longitudinal.
    theta = np.arctan2(site.perpendicular_m, site.longitudinal_m)
    np.testing.assert_allclose(reference.rotation[2], [np.sin(theta), 0, np.cos(theta)], atol=1e-12)
    np.testing.assert_allclose(reference.rotation[1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(reference.rotation.T, structure_from_cam1(theta), atol=1e-12)
    middle = reference.project([site.perpendicular_m, 0, site.longitudinal_m])
    np.testing.assert_allclose(middle, (np.array(site.image_size) - 1) / 2, atol=1e-9)


def test_structure_is_on_the_right_of_an_observer_who_looks_along_it(site):
    along = make_camera(np.zeros(3), 0.0, focal_px=500.0, image_size=(640, 480))
    u, _ = along.project([site.perpendicular_m, 0.0, 30.0])
    assert u > 320


def test_cameras_stand_as_two_on_one_bank_do(site, cameras):
    first, second = cameras
    assert 3 <= np.linalg.norm(second.center - first.center) <= 4
    for camera in cameras:
        assert camera.center[0] < site.perpendicular_m - 3
        assert 7 < np.linalg.norm(demo_plan(site=site).points[1].position - camera.center) < 12
    # Toed in, towards each other's view.
    assert second.rotation[2] @ first.rotation[2] < np.cos(np.deg2rad(15))


def test_a_millimetre_on_the_girder_is_a_third_to_half_a_pixel(site, cameras):
    for point in demo_plan(site=site).points:
        for camera in cameras:
            down = np.add(point.position, [0, 1e-3, 0])
            pixels = np.linalg.norm(camera.project(down) - camera.project(point.position))
            assert 0.29 < pixels < 0.5, point.name


def test_every_point_is_seen_where_it_should_be_in_both_views(site, scene, cameras, renderers):
    for point in demo_plan(site=site).points:
        for camera, renderer in zip(cameras, renderers, strict=True):
            u, v = np.rint(camera.project(point.position)).astype(int)
            assert 40 < u < site.image_size[0] - 40
            assert 35 < v < site.image_size[1] - 35
            face = scene.faces[renderer.face_at_rest[v, u]]
            offset = (np.array(point.position) - face.origin) @ np.cross(face.edge_u, face.edge_v)
            assert abs(offset) < 1e-9, (point.name, face.name)
            assert face.moving != point.static


@pytest.mark.parametrize("view", [0, 1])
def test_no_texture_is_finer_than_the_pixels_that_show_it(scene, cameras, renderers, view):
    camera, seen = cameras[view], renderers[view].face_at_rest
    rng = np.random.default_rng(0)
    pixels = np.column_stack([rng.integers(0, n, 1000) for n in camera.image_size])
    finest = {}
    for u, v in pixels:
        face = scene.faces[seen[v, u]]
        directions = np.column_stack([camera.normalize(np.add([u, v], d)) for d in ([0, 0], [1, 0], [0, 1])]).T
        rays = np.column_stack([directions, np.ones(3)]) @ camera.rotation
        normal = np.cross(face.edge_u, face.edge_v)
        along = (face.origin - camera.center) @ normal / (rays @ normal)
        places = camera.center + along[:, None] * rays - face.origin
        J = (places[1:] - places[0]) @ np.column_stack([face.edge_u / face.size_m[0], face.edge_v / face.size_m[1]])
        # Wave vectors on the ellipse that bounds the texture's spectrum, as cycles a pixel along u and v of the image.
        angle = np.linspace(0, np.pi, 24)
        waves = np.stack([np.cos(angle), np.sin(angle)]) / np.array(face.texture.shortest_m)[:, None]
        finest[face.name] = max(finest.get(face.name, 0), np.abs(J @ waves).max())
    assert len(finest) > 15
    assert max(finest.values()) < 0.5, finest
    assert finest["web 3"] > 0.15  # and not needlessly blurred


def test_views_share_enough_matches_off_one_plane_for_a_pose(scene, cameras, renderers):
    images = [
        Imager(r.camera.image_size, noise_std=1.0, seed=(k,)).expose(r.luma_at_rest, 0) for k, r in enumerate(renderers)
    ]
    sift = cv2.SIFT_create(3000)
    (first, a), (second, b) = (sift.detectAndCompute(image, None) for image in images)
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(a, b, 2) if m.distance < 0.8 * n.distance]
    x1 = cameras[0].normalize(np.array([first[m.queryIdx].pt for m in pairs]))
    x2 = cameras[1].normalize(np.array([second[m.trainIdx].pt for m in pairs]))
    R = cameras[1].rotation @ cameras[0].rotation.T
    t = cameras[1].translation - R @ cameras[0].translation
    lines = np.column_stack([x1, np.ones(len(x1))]) @ (np.cross(np.eye(3), t).T @ R).T
    distance = np.abs(np.sum(np.column_stack([x2, np.ones(len(x2))]) * lines, axis=1)) / np.hypot(*lines[:, :2].T)
    right = distance * cameras[1].focal_px < 2
    assert right.sum() > 200
    assert right.mean() > 0.8
    at = np.rint([first[m.queryIdx].pt for m in pairs]).astype(int)[right]
    names = [scene.faces[k].name for k in renderers[0].face_at_rest[at[:, 1], at[:, 0]]]
    assert sum(not name.startswith("web") for name in names) > 40


def test_pictures_use_the_range_of_luma_without_leaving_it(renderers):
    for renderer in renderers:
        luma = renderer.luma_at_rest
        assert np.mean((luma < 16) | (luma > 235)) < 0.002
        assert luma.std() > 25


def test_rendered_motion_of_the_demo_is_the_commanded_one(site, cameras, renderers):
    from rendered_scenes import register

    motion = demo_plan(site=site).motion
    for time_s in (0.82, 1.37):
        for camera, renderer in zip(cameras, renderers, strict=True):
            moved = renderer.render(lambda X, t=time_s: modal_displacement([t], X, motion=motion)[0])
            for point in demo_plan(site=site).points[:4]:
                there = point.position + modal_displacement([time_s], [point.position], motion=motion)[0, 0]
                pixel = camera.project(point.position)
                found = register(renderer.luma_at_rest, moved, pixel)
                np.testing.assert_allclose(found, camera.project(there) - pixel, atol=0.002)


def test_texture_of_a_face_does_not_depend_on_the_others(site, scene):
    (second,) = site.further
    wide = build_footbridge(replace(site, further=(replace(second, target_m=second.target_m + 0.5),)), seed=7)
    assert wide.face("web 3").texture.seed == scene.face("web 3").texture.seed
    assert build_footbridge(site, seed=8).face("web 3").texture.seed != scene.face("web 3").texture.seed


def test_faces_that_no_camera_sees_are_left_out(scene):
    names = [face.name for face in scene.faces]
    assert "web 3" in names
    assert "web 8" not in names


def test_cameras_that_do_not_see_the_girder_are_refused(site):
    away = replace(site, longitudinal_m=400.0, further=(replace(site.further[0], target_m=400.0),))
    with pytest.raises(DatasetError, match="site: expected cameras that look at the girder"):
        build_footbridge(away, seed=0)
