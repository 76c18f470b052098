"""The rig of ``multidic_cylinder`` from its control object, which other tests measure with."""

import numpy as np
import pytest

from multidic import IMAGE_SIZE, MATLAB_ORIGIN, read_control_points, resect, rig_from_control_points
from vfm_sdm.geometry.triangulation import triangulate


@pytest.fixture(scope="module")
def folder(shared_data):
    return shared_data("multidic_cylinder")


@pytest.fixture(scope="module")
def rig(folder):
    return rig_from_control_points(folder)


def test_control_points_are_reprojected(folder):
    for points3d, points2d in read_control_points(folder).values():
        camera, error = resect(points3d, points2d)
        assert len(points3d) >= 140
        assert error < 0.45
        assert camera.image_size == IMAGE_SIZE


def test_rig_agrees_with_the_linear_solution(rig):
    # 11-parameter DLT: 180.13 mm, 2612 and 2619 px. It has two parameters more, and its errors are some per mille.
    assert rig.metric
    assert rig.baseline() * 1e3 == pytest.approx(180.13, abs=1.0)
    assert rig.cameras[0].focal_px == pytest.approx(2612, rel=0.005)
    assert rig.cameras[1].focal_px == pytest.approx(2619, rel=0.005)
    np.testing.assert_allclose(rig.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)


def test_tracks_of_another_program_give_the_reference_motion(rig, folder):
    stored = np.load(folder / "ncorr_tracks.npz")
    points3d = triangulate(np.stack([stored["cam201"], stored["cam202"]]) - MATLAB_ORIGIN, rig) * 1e3
    motion = points3d - points3d[0]
    magnitude = np.linalg.norm(motion.mean(axis=1), axis=-1)
    np.testing.assert_allclose(magnitude, [0, 0.424, 0.900, 1.394, 1.878], atol=0.006)
    assert np.linalg.norm(motion - motion.mean(axis=1, keepdims=True), axis=-1).max(axis=1)[4] < 0.2
