"""First-order propagation against brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulation import gain_error, project_all, simple_rig
from vfm_sdm.geometry.propagation import (
    compute_gain_covariance,
    compute_gain_sensitivity,
    compute_gain_std,
    compute_place_covariance,
    compute_place_sensitivity,
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


def test_errors_of_the_place_become_the_scatter_of_gains():
    """Both pictures of a small motion are moved aside: as where something beside the point was found."""
    rig, rng = simple_rig(distortion=True), np.random.default_rng(2)
    rest = project_all(rig, POINT[None])
    std, motions = np.array([[0.0, 0.0], [12.0, 3.0]]), 1e-3 * np.eye(3)
    moved = [project_all(rig, (POINT + motion)[None]) for motion in motions]
    errors = []
    for _ in range(1500):
        off = (rng.normal(0, 1, (2, 2)) * std)[:, None]
        seen = [triangulate(u + off, rig)[0] - triangulate(rest + off, rig)[0] for u in moved]
        errors.append(np.stack(seen, axis=1) / 1e-3 - np.eye(3))
    changes = compute_place_sensitivity(rest, rig) * std.reshape(1, 4, 1, 1)
    stated = np.sqrt(np.einsum("abb->ab", compute_place_covariance(changes, np.eye(3))[0]))
    scatter = np.std(errors, axis=0)
    np.testing.assert_allclose(stated, scatter, rtol=0.1, atol=0.02 * scatter.max())
    turn = Rotation.from_rotvec([0.1, 0.7, -0.2]).as_matrix()
    turned = compute_place_covariance(changes, turn, refinement_gain=2 * np.eye(3)[None])[0]
    gains = np.einsum("ai,nij,bj->nab", turn, np.array(errors), turn)
    np.testing.assert_allclose(
        np.sqrt(np.einsum("abb->ab", turned)), 2 * gains.std(axis=0), rtol=0.1, atol=0.04 * scatter.max()
    )


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


def test_covariance_of_gains_is_that_of_a_displacement_in_any_direction():
    rig = simple_rig()
    u = project_all(rig, POINT[None])
    std = np.tile([0.01, 5.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 2)
    std[14:20] = [1e-3] * 3 + [0.02] * 3
    everything = np.diag(np.concatenate([std, [0.004, 0.003, 0.005]]) ** 2)
    # Both focal lengths err together in part, as an adjustment leaves them.
    everything[0, 10] = everything[10, 0] = 0.6 * 0.01**2
    rotation = Rotation.from_euler("yx", [0.4, 0.05]).as_matrix()
    refinement = np.array([[[1.0, 0.0, 0.3], [0.0, 1.0, 0.05], [0.0, 0.0, 0.2]]])
    motion = np.array([3e-3, -5e-3, 1e-3])
    ends = project_all(rig, np.stack([POINT, POINT + motion @ rotation]))
    rng = np.random.default_rng(2)
    errors = []
    for step in rng.multivariate_normal(np.zeros(23), everything, 800):
        start, end = triangulate(ends, rig.perturbed(step[:20]))
        turned = Rotation.from_rotvec(step[20:]).as_matrix() @ rotation @ (end - start)
        errors.append(refinement[0] @ (turned - motion))
    sensitivity = compute_gain_sensitivity(u, rig)
    gains = compute_gain_covariance(sensitivity, rotation, everything, refinement_gain=refinement)
    assert gains.shape == (1, 3, 3, 3)
    np.testing.assert_allclose(gains, gains.swapaxes(2, 3), rtol=1e-9, atol=1e-15)
    stated = np.sqrt(np.einsum("b,abc,c->a", motion, gains[0], motion))
    np.testing.assert_allclose(stated, np.std(errors, axis=0), rtol=0.08)


def test_std_of_gains_is_the_diagonal_of_their_covariance():
    rig = simple_rig()
    sensitivity = compute_gain_sensitivity(project_all(rig, POINT[None]), rig)
    covariance = np.diag(np.linspace(1e-4, 5e-4, 23) ** 2)
    gains = compute_gain_covariance(sensitivity, np.eye(3), covariance)
    stated = compute_gain_std(sensitivity, np.eye(3), covariance)
    np.testing.assert_allclose(stated[0] ** 2, np.einsum("abb->ab", gains[0]), rtol=1e-9)
    same = compute_gain_covariance(sensitivity, np.eye(3), covariance, refinement_gain=np.eye(3)[None])
    np.testing.assert_allclose(same, gains, rtol=1e-9, atol=1e-20)
