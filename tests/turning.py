"""Sightings of a turning camera with known truth: the plan of a pan clip, seen without rendering it."""

from dataclasses import replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.distortion import distort, squared_fold_radius
from vfm_sdm.stages.lens.scene import PanScene, begin_adjustment
from vfm_sdm.stages.lens.turning_camera import LENS, LensClip, Sightings, TurningCamera
from vfm_sdm.studies.synthetic.pan_clip import PanClip

RATE_STEP_S = 1e-3


def draw_plan(seed: int, view_deg: float, *, size: tuple[int, int] = (1920, 1080), **more) -> PanClip:
    """A clip with a lens of this field of view: centre and distortion drawn as such lenses have them."""
    rng = np.random.default_rng((seed, 9))
    width, height = size
    focal = width / 2 / np.tan(np.radians(view_deg / 2))
    corner = np.hypot(width, height) / 2 / focal
    cu, cv = (width - 1) / 2 + rng.normal(0, 0.005 * width), (height - 1) / 2 + rng.normal(0, 0.005 * width)
    K = np.array([[focal, 0, cu], [0, focal, cv], [0, 0, 1.0]])
    camera = Camera(K, size, np.array([rng.normal(0, 0.02) / corner**2]))
    turns = {"turn_deg": (0.8 * view_deg, 0.4 * view_deg, 20.0), "seed": seed, "duration_s": 8.0}
    return PanClip(camera, **(turns | more))


def draw_lever(seed: int, length_m: float) -> tuple[float, float, float]:
    direction = np.random.default_rng((seed, 10)).normal(size=3)
    x, y, z = length_m * direction / np.linalg.norm(direction)
    return float(x), float(y), float(z)


def look(
    plan: PanClip, *, frames: int = 40, points: int = 1000, noise_px: float = 0.25, share: float = 0.6
) -> tuple[TurningCamera, LensClip]:
    """Where an adjustment starts, and sightings of places that are spread over all pictures."""
    rng = np.random.default_rng((plan.seed, 11))
    camera, (width, height) = plan.camera, plan.camera.image_size
    time_s = (np.arange(frames) + 0.5) * plan.duration_s / frames
    attitudes = plan.attitude(time_s)
    at = rng.integers(frames, size=points)
    slopes = camera.normalize(rng.uniform(0, 1, (points, 2)) * (width - 1, height - 1))
    rays = np.concatenate([slopes, np.ones((points, 1))], axis=1)
    directions = attitudes[at].inv().apply(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    nearness = 1 / rng.uniform(*plan.distance_m, points)
    frame, point = (index.ravel() for index in np.meshgrid(np.arange(frames), np.arange(points), indexing="ij"))
    pixel = _see(plan, time_s[frame], directions[point], nearness[point])
    inside = ((pixel >= 0) & (pixel <= (width - 1, height - 1))).all(axis=1) & (rng.random(len(pixel)) < share)
    growth = 1 + plan.focus_growth * (time_s[frame] / plan.duration_s)[:, None]
    pixel = camera.K[:2, 2] + (pixel - camera.K[:2, 2]) * growth + rng.normal(0, noise_px, pixel.shape)
    kept = inside & (np.bincount(point[inside], minlength=points) >= 3)[point]
    order = np.flatnonzero(kept)[np.argsort(point[kept], kind="stable")]
    _, numbered = np.unique(point[order], return_inverse=True)
    ends = [plan.attitude(time_s + sign * RATE_STEP_S) for sign in (-1, 1)]
    steps = [(attitudes * ends[0].inv()).as_rotvec(), (ends[1] * attitudes.inv()).as_rotvec()]
    rate, change = (steps[0] + steps[1]) / (2 * RATE_STEP_S), (steps[1] - steps[0]) / RATE_STEP_S**2
    seen = Sightings(frame[order], numbered, pixel[order], rate, change)
    focal = camera.focal_px * np.exp(rng.normal(0, 0.05))
    return begin_adjustment(seen, attitudes.as_matrix(), (focal, camera.image_size), PanScene(*plan.distance_m))


def _see(plan: PanClip, time_s: FloatArray, directions: FloatArray, nearness: FloatArray) -> FloatArray:
    """Pixels (N, 2), each of a row at its own time; NaN behind the camera."""
    camera, height = plan.camera, plan.camera.image_size[1]
    delay = np.zeros(len(time_s))
    for _ in range(5 if plan.readout_s else 1):
        rays = plan.attitude(time_s + delay).apply(directions) - nearness[:, None] * np.asarray(plan.lever_m)
        ahead = np.where(rays[:, 2:] > 0.1, rays[:, 2:], np.nan)
        slopes = rays[:, :2] / ahead
        # Beyond its fold the distortion's polynomial brings back what lies outside the picture.
        slopes[(slopes**2).sum(axis=1) > 0.9 * squared_fold_radius(camera.distortion)] = np.nan
        pixel = camera.pixels(distort(slopes, camera.distortion))
        delay = np.nan_to_num(plan.readout_s * (np.clip(pixel[:, 1], 0, height) - (height - 1) / 2) / height)
    return pixel


def true_values(plan: PanClip) -> FloatArray:
    """The first five of `LENS`, shape (5,)."""
    camera = plan.camera
    return np.array([np.log(camera.focal_px), *camera.K[:2, 2], *camera.distortion[:2]])


def misled(clip: LensClip, **prior: tuple[float, float]) -> LensClip:
    """The clip with other prior means and standard deviations, by name of `LENS`."""
    mean, std = (one.copy() for one in clip.prior)
    for name, (value, spread) in prior.items():
        mean[LENS.index(name)], std[LENS.index(name)] = value, spread
    return replace(clip, prior=(mean, std))
