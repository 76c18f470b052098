"""Cameras of the real data set ``multidic_cylinder`` from its control object, for tests that need a known rig."""

import csv
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig

IMAGE_SIZE = (2464, 3280)
VIEWS = ("201", "202")
MATLAB_ORIGIN = 1.0
"""The control object's centroids come from MATLAB, which counts the first pixel's centre as (1, 1)."""

_FOCAL_GUESS_PX = 2600.0
_STEP = np.array([1e-2, 10.0, 10.0, 1e-2, *[1e-2] * 3, *[1e-2] * 3])
"""Sizes of change of the ten parameters that move the pixels comparably."""


def read_control_points(folder: Path) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Known points, shape (N, 3) [m], and their centroids, shape (N, 2) [px, first centre at (0, 0)], by view."""
    with (folder / "calibration_object" / "control_points.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    points = {}
    for view in VIEWS:
        chosen = [row for row in rows if row["camera"] == view]
        points3d = np.array([[float(row[key]) for key in ("X_mm", "Y_mm", "Z_mm")] for row in chosen]) * 1e-3
        points2d = np.array([[float(row[key]) for key in ("u_px", "v_px")] for row in chosen]) - MATLAB_ORIGIN
        points[view] = points3d, points2d
    return points


def resect(points3d: FloatArray, points2d: FloatArray, *, fixed: tuple[str, ...] = ()) -> tuple[Camera, float]:
    """Camera from points of known position, and the root mean square reprojection error [px].

    Focal length (one for both directions), principal point, k1 and pose are free, but for the ``fixed`` ones.
    """
    width, height = IMAGE_SIZE
    K = np.array([[_FOCAL_GUESS_PX, 0, (width - 1) / 2], [0, _FOCAL_GUESS_PX, (height - 1) / 2], [0, 0, 1.0]])
    _, rotation, translation = cv2.solvePnP(points3d, points2d, K, None, flags=cv2.SOLVEPNP_SQPNP)
    start = Camera(K, IMAGE_SIZE, cam_from_world=np.column_stack([cv2.Rodrigues(rotation)[0], translation]))
    free = np.array([name not in fixed for name in CAMERA_PARAMETERS])

    def moved(x: FloatArray) -> Camera:
        delta = np.zeros(len(CAMERA_PARAMETERS))
        delta[free] = x * _STEP[free]
        return start.perturbed(delta)

    solution = least_squares(lambda x: (moved(x).project(points3d) - points2d).ravel(), np.zeros(free.sum()))
    return moved(solution.x), float(np.sqrt(2 * solution.cost / len(points2d)))


def rig_from_control_points(folder: Path, *, fixed: tuple[str, ...] = ()) -> Rig:
    """Metric rig of both cameras by resection of the control object, in pixels with the first centre at (0, 0).

    Parameters
    ----------
    folder
        Of the data set.
    fixed
        Parameters of `CAMERA_PARAMETERS` kept at their start: 2600 px, the image centre, no distortion.
    """
    cameras = [resect(*points, fixed=fixed)[0] for points in read_control_points(folder).values()]
    return Rig.from_world(VIEWS, cameras, metric=True)
