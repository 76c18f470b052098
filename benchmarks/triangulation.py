"""Triangulation of two views: `triangulate`, a loop of one singular value decomposition a point, and OpenCV.

The same points in one process, the calls interleaved, many rounds; the least time of each counts, because what other
programs on the machine take is only ever added. Every method starts from full-image
pixels without distortion and ends with points in space; OpenCV takes projection matrices, made beforehand.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import compute_view_angle
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.studies.synthetic.footbridge import make_camera

SIZE = (3840, 2160)
FOCAL_PX = 15500.0
CENTERS = ((0.0, 0.0, 0.0), (2.2, -0.05, -3.3))
TARGET = (9.8, 0.0, 22.4)
NOISE_PX = 0.1


def make_site() -> tuple[Camera, ...]:
    """Two cameras that look at the middle of a girder, in its axes: lateral, vertical, longitudinal."""
    return tuple(
        make_camera(
            np.array(center),
            compute_view_angle(TARGET[0] - center[0], TARGET[2] - center[2]),
            focal_px=FOCAL_PX,
            image_size=SIZE,
        )
        for center in CENTERS
    )


def make_pixels(cameras: tuple[Camera, ...], count: int, seed: int = 0) -> np.ndarray:
    """Noisy pixels of points around the target, shape (2, count, 2)."""
    rng = np.random.default_rng(seed)
    points3d = np.array(TARGET) + rng.uniform(-1, 1, (count, 3)) * [0.1, 0.5, 2.5]
    exact = np.stack([camera.project(points3d) for camera in cameras])
    return exact + rng.normal(0, NOISE_PX, exact.shape)


def loop_of_svds(pixels: np.ndarray, matrices: list[np.ndarray]) -> np.ndarray:
    points3d = np.empty((pixels.shape[1], 3))
    for index in range(len(points3d)):
        rows = []
        for P, (u, v) in zip(matrices, pixels[:, index], strict=True):
            rows += [u * P[2] - P[0], v * P[2] - P[1]]
        solution = np.linalg.svd(np.array(rows))[2][-1]
        points3d[index] = solution[:3] / solution[3]
    return points3d


def opencv(pixels: np.ndarray, matrices: list[np.ndarray]) -> np.ndarray:
    homogeneous = cv2.triangulatePoints(*matrices, np.ascontiguousarray(pixels[0].T), np.ascontiguousarray(pixels[1].T))
    return (homogeneous[:3] / homogeneous[3]).T


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=480)
    parser.add_argument("--rounds", type=int, default=101)
    options = parser.parse_args()
    rig = Rig.from_world(("left", "right"), make_site(), metric=True)
    pixels = make_pixels(make_site(), options.points)
    matrices = [camera.K @ camera.cam_from_world for camera in rig.cameras]
    methods: dict[str, Callable[[], np.ndarray]] = {
        "triangulate": lambda: triangulate(pixels, rig),
        "loop of SVDs": lambda: loop_of_svds(pixels, matrices),
        "OpenCV": lambda: opencv(pixels, matrices),
    }
    results = {name: run() for name, run in methods.items()}
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(options.rounds):
        for name, run in methods.items():
            begin = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - begin)
    least = {name: min(values) for name, values in seconds.items()}
    ours = results["triangulate"]
    difference = {name: float(np.abs(found - ours).max()) for name, found in results.items()}
    print(f"{options.points} points, two views")
    print(f"{'method':14s} {'median [ms]':>12s} {'least [ms]':>12s} {'differs [m]':>12s}")
    for name, values in seconds.items():
        print(f"{name:14s} {1e3 * statistics.median(values):12.3f} {1e3 * least[name]:12.3f} {difference[name]:12.1e}")
    summary = {
        "ours_s": least["triangulate"],
        "svd_loop_s": least["loop of SVDs"],
        "opencv_s": least["OpenCV"],
        "ratio_to_svd_loop": least["loop of SVDs"] / least["triangulate"],
        "ratio_to_opencv": least["OpenCV"] / least["triangulate"],
        "max_difference_m": max(difference.values()),
        "points": options.points,
        "processors": os.cpu_count(),
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
