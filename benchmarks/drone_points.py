"""Which static points a camera that hovers needs: errors by exact pixels with noise, without films.

The site of `drone.py`: two cameras 45 degrees apart, 20 m from a girder. Errors are root mean squares over frames and
three points on the girder, about their mean; they grow in proportion to the noise of the tracks.
"""

import argparse
import json

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm import compute_displacement
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.camera_motion import follow_depths, steady_tracks
from vfm_sdm.stages.camera_motion.poses import look_from
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.studies.synthetic.hovering import HOVERING_POINTS, STATIC_POINTS, Hover, HoveringSite

FPS = 25.0
AXES = ("along", "vertical", "depth")
GIRDER = np.array([place for name, place in HOVERING_POINTS.items() if name not in STATIC_POINTS])
FOUR = np.array([HOVERING_POINTS[name] for name in STATIC_POINTS])
FURTHER = np.array([[-0.4, -1.1, -1.0], [1.6, 1.0, 0.2], [1.7, -1.0, 1.0], [-1.8, -0.9, 0.5]])
CASES = {
    "four at three depths": (FOUR, 0.5, 2.0),
    "eight at five depths": (np.vstack([FOUR, FURTHER]), 0.5, 2.0),
    "three of the four": (FOUR[:3], 0.5, 2.0),
    "the four within half the space": (FOUR * [0.5, 0.5, 1.0], 0.5, 2.0),
    "four on one wall": (FOUR * [1.0, 1.0, 0.0] + [0.0, 0.0, 3.0], 0.5, 2.0),
    "four, within 1 m and 5 degrees": (FOUR, 1.0, 5.0),
    "four, within 0.1 m and 0.5 degrees": (FOUR, 0.1, 0.5),
}


def error_mm(static: np.ndarray, reach: tuple[float, float], noise_px: float, frames: int) -> np.ndarray:
    """Displacement error along the site's axes, shape (3,) [mm]."""
    site, rng, time_s = HoveringSite(), np.random.default_rng(0), np.arange(frames) / FPS
    rig = Rig.from_world(site.rig().names, site.rig().cameras, metric=True)
    true_mm = np.array([1.0, 3.0, 1.5]) * np.sin(2 * np.pi * time_s[:, None] * [0.7, 1.3, 0.9])
    places = np.repeat(np.vstack([GIRDER, static])[None], frames, axis=0)
    places[:, : len(GIRDER)] += true_mm[:, None] / 1e3
    names, tracks = [f"point {k}" for k in range(places.shape[1])], {}
    for number, (view, camera) in enumerate(zip(rig.names, site.rig().cameras, strict=True)):
        turns, way = Hover(*reach, seed=number).motion(time_s)
        at_rest = places @ camera.rotation.T + camera.translation
        turned = np.einsum("tij,tpj->tpi", Rotation.from_rotvec(turns).as_matrix(), at_rest)
        position = look_from(camera, turned + way[:, None])
        position = position + rng.normal(0, noise_px, position.shape)
        covariance = np.tile(noise_px**2 * np.eye(2), (*position.shape[:2], 1, 1))
        tracks[view] = make_tracks(time_s, names, position, covariance, np.zeros(position.shape[:2]), attrs={})
    steady = steady_tracks(tracks, rig, names[len(GIRDER) :])
    found = compute_displacement(follow_depths(align_views(dict(steady.tracks)), rig), rig)
    moving = found["displacement"].values[:, : len(GIRDER)] @ site.rig().cameras[0].rotation
    error = moving - true_mm[:, None]
    return np.asarray(np.sqrt(np.nanmean((error - np.nanmean(error, axis=0)) ** 2, axis=(0, 1))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=300, help="frames, 25 a second")
    parser.add_argument("--noise-px", type=float, default=0.01, help="of the tracks [px]")
    options = parser.parse_args()
    print(f"{'static points':<38}" + "".join(f"{axis + ' [mm]':>16}" for axis in AXES))
    figures: dict[str, float] = {"frames": options.frames, "noise_px": options.noise_px}
    for name, (static, reach_m, reach_deg) in CASES.items():
        error = error_mm(static, (reach_m, reach_deg), options.noise_px, options.frames)
        print(f"{name:<38}" + "".join(f"{value:>16.3f}" for value in error))
        figures |= {f"{name}, {axis}_mm": float(value) for axis, value in zip(AXES, error, strict=True)}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
