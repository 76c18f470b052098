"""Simulated rigs, points and matches with known truth, for tests."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.matches import Matches

SIZE = (3840, 2160)


def looking_at(center: FloatArray, target: FloatArray) -> FloatArray:
    """cam_from_world of a level camera that looks at a point (world: x right, y down, z forward)."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return np.column_stack([R, -R @ center])


def intrinsics(focal: float, size: tuple[int, int] = SIZE, offset: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    return np.array([[focal, 0, (size[0] - 1) / 2 + offset[0]], [0, focal, (size[1] - 1) / 2 + offset[1]], [0, 0, 1.0]])


def simple_rig(views: int = 2, *, distortion: bool = False) -> Rig:
    """Cameras 4 m apart that look at a point 22 m away; the first one is the world frame."""
    target = np.array([0.0, 0.0, 22.0])
    cameras = []
    for index in range(views):
        k = [0.3, -0.2, 1e-3, -5e-4, 0.1] if distortion else np.zeros(5)
        center = np.array([4.0 * index, 0.1 * index, 0.5 * index])
        cameras.append(Camera(intrinsics(8000 + 100 * index), SIZE, np.asarray(k), looking_at(center, target)))
    return Rig.from_world([f"view {i}" for i in range(views)], cameras, metric=True)


def scene_points(rng: np.random.Generator, count: int) -> FloatArray:
    """Points at many depths in front of `simple_rig`, shape (count, 3) [m]."""
    return np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-2, 2, count), rng.uniform(15, 40, count)])


def project_all(rig: Rig, points3d: FloatArray) -> FloatArray:
    return np.stack([camera.project(points3d) for camera in rig.cameras])


@dataclass(frozen=True)
class SiteTrial:
    """One simulated site: the true rig, a prior rig, noisy matches, a true point and its pixels."""

    truth: Rig
    prior: Rig
    matches: Matches
    point: FloatArray
    pixels: FloatArray


def site_trial(
    rng: np.random.Generator,
    *,
    focal_std: float = 0.05,
    center_std: float = 0.0,
    corner_distortion_std: float = 0.0,
    shared_error_px: float = 0.2,
) -> SiteTrial:
    """Two cameras 4 m apart, 22 m away, whose true intrinsics are drawn from the priors that the adjustment is told.

    Matches have independent noise, and errors that all matches of one part of the image share.
    """
    focal = 8000.0
    diagonal = float(np.hypot(*SIZE))
    k1_std = corner_distortion_std / (diagonal / 2 / focal) ** 2
    target = np.array([0.0, 0.0, 22.0])
    cameras = []
    for center in (np.zeros(3), np.array([4.0, 0.0, -1.0])):
        offset = tuple(rng.normal(0, center_std * diagonal, 2)) if center_std else (0.0, 0.0)
        k1 = rng.normal(0, k1_std) if k1_std else 0.0
        K = intrinsics(focal * np.exp(rng.normal(0, focal_std)), offset=offset)
        cameras.append(Camera(K, SIZE, np.array([k1, 0, 0, 0, 0]), looking_at(center, target)))
    truth = Rig.from_world(("a", "b"), cameras, metric=True)
    X = np.column_stack([rng.uniform(-5, 5, 800), rng.uniform(-3, 3, 800), rng.uniform(15, 45, 800)])
    u = project_all(truth, X)
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))]
    cell = (u[0, :, 0] * 6 // SIZE[0] * 6 + u[0, :, 1] * 6 // SIZE[1]).astype(int)
    u = u + rng.normal(0, shared_error_px, (2, 36, 2))[:, cell] + rng.normal(0, 0.35, u.shape)
    # The prior pose is off as a five-point solution with wrong focal lengths is: by a degree and a few decimetres.
    start = []
    for camera in truth.cameras:
        step = np.zeros(10)
        if start:
            step[4:7], step[7:10] = rng.normal(0, 0.01, 3), rng.normal(0, 0.05, 3)
        moved = camera.perturbed(step)
        start.append(Camera(intrinsics(focal), SIZE, np.zeros(5), moved.cam_from_world))
    inner = np.array([focal_std, center_std * diagonal, center_std * diagonal, k1_std])
    std = np.concatenate([inner, np.zeros(6), inner, [1.0] * 3, [8.0] * 3])
    prior = Rig(("a", "b"), tuple(start), False, np.diag(std**2))
    point = np.array([0.2, -0.1, 22.0])
    return SiteTrial(truth, prior, Matches(0, 1, u[0], u[1]), point, project_all(truth, point[None])[:, 0])


@dataclass(frozen=True)
class PlacedCameras:
    """Cameras at given places: the true rig, a prior rig that is off, and noisy pixels (V, N, 2) of common points."""

    truth: Rig
    prior: Rig
    pixels: FloatArray

    def pairs(self, *, common: bool = True) -> list[Matches]:
        """Matches of every further view with the first, of the same points in all views or of others in each."""
        part = self.pixels.shape[1] // (len(self.truth) - 1)
        chosen = [slice(None) if common else slice(k * part, (k + 1) * part) for k in range(len(self.truth) - 1)]
        return [Matches(0, k + 1, self.pixels[0, s], self.pixels[k + 1, s]) for k, s in enumerate(chosen)]


def placed_cameras(
    centers: list[tuple[float, float, float]], *, seed: int = 0, focal_std: float = 0.01, shared_error_px: float = 0.1
) -> PlacedCameras:
    """Cameras at these places that look at one spot; errors and priors as in `site_trial`, poses free."""
    rng = np.random.default_rng([seed, len(centers)])
    names = tuple("abcdef"[: len(centers)])
    cameras = []
    for center in centers:
        K = intrinsics(8000 * float(np.exp(rng.normal(0, focal_std))))
        cameras.append(Camera(K, SIZE, np.zeros(5), looking_at(np.array(center), np.array([0.0, 0.0, 22.0]))))
    truth = Rig.from_world(names, cameras, metric=True)
    X = np.column_stack([rng.uniform(-5, 5, 1500), rng.uniform(-3, 3, 1500), rng.uniform(15, 45, 1500)])
    u = project_all(truth, X)
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))][:, :600]
    cell = (u[0, :, 0] * 6 // SIZE[0] * 6 + u[0, :, 1] * 6 // SIZE[1]).astype(int)
    u = u + rng.normal(0, shared_error_px, (len(names), 36, 2))[:, cell] + rng.normal(0, 0.35, u.shape)
    start = []
    for camera in truth.cameras:
        step = np.zeros(10)
        if start:
            step[4:7], step[7:10] = rng.normal(0, 0.005, 3), rng.normal(0, 0.03, 3)
        start.append(Camera(intrinsics(8000.0), SIZE, np.zeros(5), camera.perturbed(step).cam_from_world))
    free = [focal_std, 0.0, 0.0, 0.0, *[1.0] * 3, *[2 * truth.baseline()] * 3]
    std = np.array([focal_std, *[0.0] * 9, *free * (len(names) - 1)])
    return PlacedCameras(truth, Rig(names, tuple(start), False, np.diag(std**2)), u)


def gain_error(truth: Rig, rig: Rig, point: FloatArray) -> FloatArray:
    """Relative error of small displacements along the reference camera's axes, measured with a wrong rig; (3,)."""
    from vfm_sdm.geometry.triangulation import triangulate

    errors = []
    for axis in range(3):
        step = 1e-3 * np.eye(3)[axis]
        ends = triangulate(project_all(truth, np.stack([point + step, point - step])), rig)
        errors.append((ends[0] - ends[1])[axis] / 2e-3 - 1)
    return np.array(errors)
