"""Lines of a structure that two cameras see, tracked across only, with exactly known motion in space."""

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from vfm_sdm.core.datasets import UNMEASURED_STD_PX, make_tracks
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame

RATE_HZ = 30.0
DIRECTIONS = {"flange": (0.0, 0.0, 1.0), "post": (0.0, 1.0, 0.0), "bolts": None, "paint": None}
"""Structural direction of each line; ``None`` for points that are seen whole."""
PLACES = {
    "flange": (9.6, 0.6, 21.0),
    "post": (9.6, -0.7, 22.0),
    "bolts": (9.6, 0.2, 20.0),
    "paint": (9.6, 0.3, 23.5),
}
_K = np.array([[7600.0, 0, 640], [0, 7600, 360], [0, 0, 1]])


def make_rig():
    """Two cameras beside a structure, and its axes: lateral, vertical, longitudinal in the first camera's frame."""
    first, second = (
        Rotation.from_euler("yx", [-yaw, pitch], degrees=True).as_matrix().T for yaw, pitch in ((24.0, 1.5), (15.0, 2))
    )
    center = np.array([3.6, 0.15, -1.4])
    poses = [np.eye(4)[:3], np.column_stack([second @ first.T, -second @ center])]
    poses[1][:, :3] = second @ first.T
    cameras = tuple(Camera(_K, (1280, 720), cam_from_world=pose) for pose in poses)
    # Structure frame to first camera: X_cam = first X_structure.
    return Rig(("left", "right"), cameras, metric=True), StructureFrame(first.T)


def make_motion(frames, seed=0):
    """Displacement of every point along the structural axes, shape (T, P, 3) [mm]."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(frames) / RATE_HZ
    motion = np.zeros((frames, len(PLACES), 3))
    for axis, (amplitude, frequency) in enumerate(((1.6, 2.9), (2.8, 2.3), (0.2, 2.3))):
        for point in range(len(PLACES)):
            wave = np.sin(2 * np.pi * frequency * time_s + 0.2 * rng.normal()) * np.sin(np.pi * time_s / time_s[-1])
            motion[:, point, axis] = amplitude * (1 + 0.1 * rng.normal()) * wave
    return motion


def make_edge_tracks(motion, *, noise_px=0.02, beside_px=(0.0, 4.0), seed=1):
    """Synchronised tracks of the points of `PLACES`.

    The second view's place of an edge lies ``beside_px`` along it from where the first view's is.
    """
    rig, frame = make_rig()
    rng = np.random.default_rng(seed)
    names = list(PLACES)
    structure = np.array([PLACES[name] for name in names])
    views = []
    for camera, beside in zip(rig.cameras, beside_px, strict=True):
        position = camera.project((structure + motion / 1e3) @ frame.rotation)
        at_rest = camera.project(structure @ frame.rotation)
        noise = rng.normal(0, noise_px, position.shape)
        covariance = np.tile(noise_px**2 * np.eye(2), (*position.shape[:2], 1, 1))
        across = np.full((len(names), 2), np.nan)
        tracked = position + noise
        for point, name in enumerate(names):
            if DIRECTIONS[name] is None:
                continue
            step = camera.project((structure[point] + 1e-3 * np.array(DIRECTIONS[name])) @ frame.rotation)
            along = (step - at_rest[point]) / np.linalg.norm(step - at_rest[point])
            across[point] = [-along[1], along[0]]
            moved = (tracked[:, point] - at_rest[point]) @ across[point]
            tracked[:, point] = at_rest[point] + beside * along + moved[:, None] * across[point]
            covariance[:, point] += (UNMEASURED_STD_PX**2 - noise_px**2) * np.outer(along, along)
        one = make_tracks(
            np.arange(len(motion)) / RATE_HZ, names, tracked, covariance, np.zeros(position.shape[:2]), attrs={}
        )
        views.append(one.assign(edge_across=(("point", "pixel"), across, {"units": "1"})))
    tracks = xr.concat(views, "view").assign_coords(view=list(rig.names))
    return tracks, rig, frame
