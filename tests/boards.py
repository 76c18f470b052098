"""Simulated pictures of a chessboard, for tests that need exact truth."""

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.cameras.chessboard.detection import board_points

PATTERN = (9, 6)
SQUARE_M = 0.025
BOARD = board_points(PATTERN, SQUARE_M)
IMAGE_SIZE = (1280, 720)


def make_rig(views: int = 2) -> Rig:
    """Converging cameras 0.2 m apart, a little unlike each other."""
    names, cameras = [], []
    for index in range(views):
        focal = 1200.0 * (1 + 0.01 * index)
        K = np.array([[focal, 0, 640 + 5 * index], [0, 1.002 * focal, 360 - 4 * index], [0, 0, 1.0]])
        R = Rotation.from_euler("yx", [13.0 * index, 2.0 * index], degrees=True).as_matrix()
        pose = np.column_stack([R, [-0.2 * index, 0.003 * index, 0.02 * index]])
        distortion = np.array([-0.1 - 0.02 * index, 0.05, 0.0, 0.0, 0.0])
        names.append(("left", "right", "third")[index])
        cameras.append(Camera(K, IMAGE_SIZE, distortion, pose))
    return Rig(tuple(names), tuple(cameras), True)


def board_poses(rng: np.random.Generator, count: int, *, tilt_deg: float = 25.0) -> FloatArray:
    """Poses of the board in the first camera's frame, shape (P, 3, 4), in view of every camera of `make_rig`."""
    R = Rotation.from_rotvec(np.radians(rng.uniform(-tilt_deg, tilt_deg, (count, 3)))).as_matrix()
    center = rng.uniform([-0.08, -0.07, 0.75], [0.1, 0.07, 1.0], (count, 3))
    t = center - R @ np.append(BOARD.mean(axis=0), 0.0)
    return np.concatenate([R, t[:, :, None]], axis=-1)


def see_board(rig: Rig, poses: FloatArray, board: FloatArray = BOARD) -> dict[str, list[FloatArray]]:
    """Exact corners of each view in each pose, shape (N, 2) each [px]."""
    flat = np.column_stack([board, np.zeros(len(board))])
    points3d = np.einsum("pij,nj->pni", poses[:, :, :3], flat) + poses[:, None, :, 3]
    return {name: list(camera.project(points3d)) for name, camera in zip(rig.names, rig.cameras, strict=True)}


def add_noise(
    corners: dict[str, list[FloatArray]], rng: np.random.Generator, std_px: float
) -> dict[str, list[FloatArray]]:
    """Corners with independent Gaussian noise."""
    return {name: [c + rng.normal(0, std_px, c.shape) for c in found] for name, found in corners.items()}


def render_board(camera: Camera, pose: FloatArray, *, samples: int = 4) -> np.ndarray:
    """Picture of a chessboard with a white margin by a camera without distortion, uint8 (H, W)."""
    width, height = camera.image_size
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    u = (np.arange(width)[:, None] + offsets).ravel()
    v = (np.arange(height)[:, None] + offsets).ravel()
    rays = np.stack([*np.meshgrid(u, v), np.ones((v.size, u.size))], axis=-1)
    board_from_pixel = np.linalg.inv(camera.K @ np.column_stack([pose[:, 0], pose[:, 1], pose[:, 3]]))
    plane = rays @ board_from_pixel.T
    column = np.floor(plane[..., 0] / plane[..., 2] / SQUARE_M)
    row = np.floor(plane[..., 1] / plane[..., 2] / SQUARE_M)
    inside = (column >= -1) & (column < PATTERN[0]) & (row >= -1) & (row < PATTERN[1])
    dark = inside & ((column + row) % 2 == 0)
    fine = np.where(dark, 30.0, 220.0)
    return fine.reshape(height, samples, width, samples).mean(axis=(1, 3)).round().astype(np.uint8)
