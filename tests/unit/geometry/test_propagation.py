"""First-order propagation against brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulation import gain_error, project_all, simple_rig
from vfm_sdm.geometry.propagation import (
    compute_gain_sensitivity,
    compute_gain_std,
    compute_position_covariance,
    triangulation_jacobian,
)
from vfm_sdm.geometry.triangulation import triangulate

POINT = np.array([0.5, -0.3, 21.0])


def test_pixel_noise_becomes_the_scatter_of_positions():
    rig = simple_rig()
    u = project_all(rig, POINT[None])
    rng = np.random.default_rng(0)
    pixel = np.array([[0.04, 0.01], [0.01, 0.09]])
    noise = rng.multivariate_normal([0, 0], pixel, (2, 20000))
    scatter = np.cov(triangulate(u + noise, rig).T)
    stated = compute_position_covariance(triangulation_jacobian(u, rig), np.broadcast_to(pixel, (2, 1, 1, 2, 2)))
    np.testing.assert_allclose(stated[0, 0], scatter, rtol=0.04, atol=1e-3 * np.abs(scatter).max())


def test_camera_errors_become_the_scatter_of_gains():
    rig = simple_rig(distortion=True)
    u = project_all(rig, POINT[None])
    std = np.tile([0.01, 5.0, 5.0, 0.02, 1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02], 2)
    std[4:10] = 0
    rng = np.random.default_rng(1)
    errors = [gain_error(rig, rig.perturbed(rng.normal(0, std)), POINT) for _ in range(1500)]
    covariance = np.zeros((23, 23))
    covariance[:20, :20] = np.diag(std**2)
    stated = compute_gain_std(compute_gain_sensitivity(u, rig), np.eye(3), covariance)[0]
    np.testing.assert_allclose(np.diag(stated), np.std(errors, axis=0), rtol=0.08)


def test_one_per_cent_of_focal_length_costs_a_few_per_cent_of_depth():
    rig = simple_rig()
    u = project_all(rig, POINT[None])
    covariance = np.zeros((23, 23))
    covariance[0, 0] = 0.01**2
    stated = compute_gain_std(compute_gain_sensitivity(u, rig), np.eye(3), covariance)[0]
    step = np.zeros(20)
    step[0] = 0.01
    expected = gain_error(rig, rig.perturbed(step), POINT)
    np.testing.assert_allclose(np.diag(stated), np.abs(expected), rtol=0.05, atol=1e-4)


def test_an_error_of_the_axes_leaks_motion_from_one_into_another():
    rig = simple_rig()
    u = project_all(rig, POINT[None])
    covariance = np.zeros((23, 23))
    covariance[20:, 20:] = np.diag([0.0, 0.0, 0.005]) ** 2
    rotation = Rotation.from_euler("y", 0.4).as_matrix()
    stated = compute_gain_std(compute_gain_sensitivity(u, rig), rotation, covariance)[0]
    expected = np.zeros((3, 3))
    expected[0, 1] = expected[1, 0] = 0.005
    np.testing.assert_allclose(stated, expected, atol=1e-12)


def test_no_uncertainty_in_none_out():
    rig = simple_rig()
    sensitivity = compute_gain_sensitivity(project_all(rig, POINT[None]), rig)
    assert compute_gain_std(sensitivity, np.eye(3), np.zeros((23, 23))) == pytest.approx(0)
