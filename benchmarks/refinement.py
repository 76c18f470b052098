"""Structural geometry refinement: `refine` and SciPy's dense least squares on the same residuals, and how it grows.

The scene is the paper's footbridge: 8 mm lateral, 12 mm vertical, 0.2 mm longitudinal motion peak to peak, noise of
0.02 px in the reference view and 0.1 px in the other. SciPy minimises the residuals of the paper's equation over all
corrections of one point at once, with its own numerical Jacobian, as one would without a solver of one's own: once
with a textbook triangulation (`numpy.linalg.svd` of all frames in one call, no code of vfm-sdm), with which the minimum
is compared, and once with `triangulate`, which is quicker. `refine` is timed with everything around it, from labelled
tracks to labelled tracks. The least time of several rounds counts, because what other programs on the machine take is
only ever added.
"""

import argparse
import json
import os
import resource
import statistics
import time
from collections.abc import Callable

import numpy as np
import xarray as xr
from scipy.optimize import least_squares
from triangulation import TARGET, make_site

from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.refinement import SgrWeights, refine

FPS = 30.0
VIEWS = ("left", "right")
NOISE_PX = (0.02, 0.1)
AMPLITUDE_M = (4e-3, 6e-3, 1e-4)
FREQUENCY_HZ = (2.1, 2.6, 2.9)


def make_scene(frames: int, points: int, seed: int = 0) -> tuple[xr.Dataset, Rig, StructureFrame]:
    rng = np.random.default_rng(seed)
    cameras = make_site()
    clock = np.arange(frames) / FPS
    motion = np.array(AMPLITUDE_M) * np.sin(2 * np.pi * np.outer(clock, FREQUENCY_HZ) + [0.0, 0.7, 1.9])
    points3d = np.array(TARGET) + rng.uniform(-1, 1, (points, 3)) * [0.05, 0.5, 2.5] + motion[:, None]
    names = [f"p{index}" for index in range(points)]
    views = []
    for camera, std in zip(cameras, NOISE_PX, strict=True):
        position = camera.project(points3d) + rng.normal(0, std, (frames, points, 2))
        covariance = np.broadcast_to(std**2 * np.eye(2), (frames, points, 2, 2))
        views.append(make_tracks(clock, names, position, covariance, np.zeros((frames, points)), attrs={}))
    tracks = xr.concat(views, dim="view").assign_coords(view=list(VIEWS)).transpose("view", ...)
    rig = Rig.from_world(VIEWS, cameras, metric=True)
    return tracks, rig, StructureFrame(cameras[0].rotation.T)


def triangulate_by_svd(pixels: np.ndarray, rig: Rig) -> np.ndarray:
    """Textbook linear triangulation of pixels without distortion, shape (2, T, 2) to (T, 3)."""
    rows = []
    for camera, seen in zip(rig.cameras, pixels, strict=True):
        P = camera.K @ camera.cam_from_world
        rows += [seen[:, :1] * P[2] - P[0], seen[:, 1:] * P[2] - P[1]]
    solution = np.linalg.svd(np.stack(rows, axis=1))[2][:, -1]
    return solution[:, :3] / solution[:, 3:]


def dense_residuals(
    tracks: xr.Dataset, rig: Rig, frame: StructureFrame, triangulation: Callable[[np.ndarray, Rig], np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """The five terms of the paper's equation for the first point, second view, by its corrections (T,)."""
    pixels, weights = tracks["position"].values[:, :, 0], SgrWeights()

    def position(correction: np.ndarray) -> np.ndarray:
        moved = pixels.copy()
        moved[1, :, 0] += correction
        return triangulation(moved, rig) @ frame.rotation.T

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.sum(values.reshape(len(values), -1) ** 2, axis=1))))

    baseline = position(np.zeros(pixels.shape[1]))
    origin = baseline[0].copy()
    baseline -= origin
    z, xy = baseline[:, 2], baseline[:, :2]
    level = np.sqrt(weights.longitudinal) / rms(z), np.sqrt(weights.others) / rms(xy)
    rate = np.sqrt(weights.longitudinal_rate) / rms(np.diff(z)), np.sqrt(weights.others_rate) / rms(np.diff(xy, axis=0))
    pixel = np.sqrt(weights.pixel) / rms(pixels[1, :, 0] - pixels[1, 0, 0])

    def residuals(correction: np.ndarray) -> np.ndarray:
        current = position(correction) - origin
        departure = current[:, :2] - xy
        suppressed = current[:, 2]
        return np.concatenate(
            [
                level[0] * suppressed,
                rate[0] * np.diff(suppressed),
                level[1] * departure.ravel(),
                rate[1] * np.diff(departure, axis=0).ravel(),
                pixel * correction,
            ]
        )

    return residuals


def time_refine(frames: int, points: int, rounds: int) -> float:
    scene = make_scene(frames, points)
    refine(*scene)
    seconds = []
    for _ in range(rounds):
        begin = time.perf_counter()
        refine(*scene)
        seconds.append(time.perf_counter() - begin)
    middle = statistics.median(seconds)
    print(
        f"refine  {frames:6d} frames x {points:4d} points  {1e3 * min(seconds):10.2f} ms  (median {1e3 * middle:.2f})"
    )
    return min(seconds)


def time_scipy(
    scene: tuple[xr.Dataset, Rig, StructureFrame], triangulation: Callable[[np.ndarray, Rig], np.ndarray], rounds: int
) -> tuple[float, float, np.ndarray]:
    """Seconds, cost and corrections (T,) of the dense solve."""
    residuals = dense_residuals(*scene, triangulation)
    seconds = []
    for _ in range(rounds):
        begin = time.perf_counter()
        dense = least_squares(residuals, np.zeros(scene[0].sizes["time"]), ftol=1e-10)
        seconds.append(time.perf_counter() - begin)
    print(f"SciPy, {triangulation.__name__:18s}            {1e3 * min(seconds):10.2f} ms  ({dense.njev} Jacobians)")
    return min(seconds), 2 * dense.cost, dense.x


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=101)
    parser.add_argument("--frames", type=int, default=480, help="frames that SciPy solves as well")
    parser.add_argument("--longest", type=int, default=100_000, help="frames of the longest series of the growth")
    parser.add_argument("--points", type=int, default=1000, help="points of the case of many points")
    options = parser.parse_args()
    frames, points = options.frames, options.points
    scene = make_scene(frames, 1)
    refinement = refine(*scene)
    ours_s = time_refine(frames, 1, options.rounds)
    scipy_s, cost, correction = time_scipy(scene, triangulate_by_svd, 2)
    quicker_s, _, _ = time_scipy(scene, triangulate, 2)
    lengths = (options.longest // 10, 3 * options.longest // 10, options.longest)
    growth = {length: time_refine(length, 1, 3) for length in lengths}
    # ru_maxrss is in kilobytes on Linux; taken before the large case of many points.
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of the process up to here {peak_mb:.0f} MB")
    many_s = time_refine(frames, points, 3)
    summary = {
        f"ours_{frames}x1_s": ours_s,
        f"scipy_{frames}x1_s": scipy_s,
        "ratio": scipy_s / ours_s,
        "scipy_with_our_triangulation_s": quicker_s,
        f"ours_{frames}x{points}_s": many_s,
        **{f"ours_{length}x1_s": seconds for length, seconds in growth.items()},
        "relative_cost_difference": abs(float(refinement.cost[0]) - cost) / cost,
        "max_correction_difference_px": float(np.abs(refinement.correction_px[:, 0] - correction).max()),
        "peak_memory_mb": peak_mb,
        "processors": os.cpu_count(),
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
