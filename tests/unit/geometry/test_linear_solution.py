"""The quick solution of the linear triangulation against the singular value decomposition that defines it."""

import numpy as np
import pytest

from simulation import project_all, scene_points, simple_rig
from vfm_sdm.geometry import triangulation
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate


def by_decomposition(points2d: np.ndarray, rig: Rig) -> np.ndarray:
    rows = []
    for camera, pixels in zip(rig.cameras, points2d, strict=True):
        x, pose, focal = camera.normalize(pixels), camera.cam_from_world, np.diag(camera.K)
        rows += [focal[axis] * (x[:, axis, None] * pose[2] - pose[axis]) for axis in range(2)]
    solution = np.linalg.svd(np.stack(rows, axis=1))[2][:, -1]
    return solution[:, :3] / solution[:, 3:]


@pytest.mark.parametrize("noise_px", [0.0, 0.1, 3.0, 100.0, 3000.0])
@pytest.mark.parametrize("views", [2, 3])
def test_same_points_at_any_noise(views, noise_px):
    rng = np.random.default_rng(4)
    rig = simple_rig(views)
    pixels = project_all(rig, scene_points(rng, 300))
    pixels = pixels + rng.normal(0, noise_px, pixels.shape)
    np.testing.assert_allclose(triangulate(pixels, rig), by_decomposition(pixels, rig), rtol=1e-9, atol=1e-9)


def test_far_points_are_as_exact_as_with_the_decomposition():
    rig = simple_rig()
    points3d = np.array([[0.0, 0.0, 10.0**power] for power in range(1, 6)])
    pixels = project_all(rig, points3d)
    error, defined = (np.abs(f(pixels, rig) - points3d).max(axis=1) for f in (triangulate, by_decomposition))
    assert (error <= 10 * defined + 1e-12).all()


def test_decomposition_is_only_for_the_few(monkeypatch):
    rng = np.random.default_rng(5)
    rig = simple_rig()
    pixels = project_all(rig, scene_points(rng, 300)) + rng.normal(0, 0.3, (2, 300, 2))
    pixels[0, 7] = np.nan
    asked = []
    decompose = triangulation._solve_by_svd
    monkeypatch.setattr(triangulation, "_solve_by_svd", lambda A: asked.append(A.shape[-1]) or decompose(A))
    found = triangulate(pixels, rig)
    assert asked == [1]
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [7]
