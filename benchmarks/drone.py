"""Two cameras that hover like drones, against the truth: poses in space, and a warp of the picture beside them.

Every frame is cast ray by ray from its own pose: each camera wanders within half a metre and two degrees of where it
was in the first frame, 20 m from a girder that moves by millimetres. Four static points stand at three depths: a block
before the girder, a pier beside it, two on a wall behind it. The films are H.264 files, tracked as usual. Then, of the
same tracks:

- nothing: as if the cameras stood still;
- similarity, homography: each frame is warped so that the four static points stay where they were in the first one,
  which is what stabilisers of pictures do;
- pose: what vfm-sdm does.

Depth is along the middle between the cameras' lines of sight. Errors are root mean squares over frames and the three
points on the girder, about their mean. "Stated" is the standard deviation of the result
of "pose", "limit" what noise of the
tracks as large as it is makes with cameras that stand still: what is more comes from the pose.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from vfm_sdm import compute_displacement
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.camera_motion import follow_depths, steady_tracks
from vfm_sdm.stages.camera_motion.poses import look_from
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.subset_design import design_subsets
from vfm_sdm.studies.synthetic.hovering import HOVERING_POINTS, STATIC_POINTS, Hover, HoveringSite, film_hovering
from vfm_sdm.studies.synthetic.recording import write_video

FPS = 25.0
NAMES = list(HOVERING_POINTS)
PLACES = np.array(list(HOVERING_POINTS.values()))
MOVING = len(NAMES) - len(STATIC_POINTS)
DRAWS = 2000
AXES = ("along", "vertical", "depth")
ENCODER = {"crf": "4", "preset": "veryfast", "tune": "grain", "threads": "2"}


def girder_m(frames: int) -> np.ndarray:
    """Displacement of the girder along it, down and away, shape (T, 3) [m]; at rest in the first frame."""
    time_s = np.arange(frames)[:, None] / FPS
    grown = 1 - np.exp(-time_s / 0.2)
    return 1e-3 * np.array([1.0, 3.0, 1.5]) * grown * np.sin(2 * np.pi * time_s * [1.1, 2.3, 1.7])


def hover_of(view: int, options: argparse.Namespace) -> Hover:
    return Hover(options.reach_m, options.reach_deg, seed=2 * options.seed + view)


def true_pixels(site: HoveringSite, view: int, options: argparse.Namespace) -> np.ndarray:
    """Where a hovering camera sees the points, shape (T, P, 2) [px]."""
    camera, moved = site.rig().cameras[view], np.repeat(PLACES[None], options.frames, axis=0)
    moved[:, :MOVING] += girder_m(options.frames)[:, None]
    turns, way = hover_of(view, options).motion(np.arange(options.frames) / FPS)
    R = Rotation.from_rotvec(turns).as_matrix()
    at_rest = moved @ camera.rotation.T + camera.translation
    return look_from(camera, np.einsum("tij,tpj->tpi", R, at_rest) + way[:, None])


def film_and_track(site: HoveringSite, folder: Path, options: argparse.Namespace) -> dict[str, xr.Dataset]:
    """Tracks of both views in films of hovering cameras."""
    scene, rig, tracks = site.scene(), site.rig(), {}
    for number, (view, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        frames = film_hovering(scene, camera, hover_of(number, options), girder_m(options.frames), fps=FPS)
        video = open_video(write_video(folder / f"{view}.mp4", frames, fps=int(FPS), options=ENCODER))
        pixels = camera.project(PLACES)
        designs = None
        if not options.whole_squares:
            designs = [choice.design for choice in design_subsets(video, pixels, NAMES)]
        tracks[view] = IcgnTracker().track(video, pixels, names=NAMES, designs=designs)
    return tracks


def warped(tracks: dict[str, xr.Dataset], kind: str) -> dict[str, xr.Dataset]:
    """Tracks in pictures that are warped so that the static points stay where they were."""
    static, found = [NAMES.index(name) for name in STATIC_POINTS], {}
    for view, one in tracks.items():
        position = one["position"].values.copy()
        rest = position[0, static]
        for frame in range(len(position)):
            now = position[frame, static]
            if kind == "homography":
                warp = cv2.getPerspectiveTransform(now.astype(np.float32), rest.astype(np.float32))
            else:
                warp = np.vstack([cv2.estimateAffinePartial2D(now, rest, method=cv2.LMEDS)[0], [0, 0, 1]])
            position[frame] = cv2.perspectiveTransform(position[frame][None], warp)[0]
        found[view] = one.assign(position=one["position"].copy(data=position))
    return found


def errors_mm(tracks: dict[str, xr.Dataset], site: HoveringSite, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Error and stated standard deviation along the axes of the site, each of shape (3,) [mm]."""
    found = compute_displacement(follow_depths(align_views(tracks), rig), rig).isel(point=slice(0, MOVING))
    R = site.rig().cameras[0].rotation
    error = found["displacement"].values @ R - 1e3 * girder_m(found.sizes["time"])[:, None]
    error -= np.nanmean(error, axis=0)
    # The pixels of two views, each with its own covariance, along the axes of the site.
    slopes = found["pixel_sensitivity"].transpose("point", "axis", "view", "pixel").values
    along = np.einsum("ai,pavk->pivk", R, slopes)
    covariance = align_views(tracks)["position_covariance"].values[:, :, :MOVING]
    variance = np.einsum("pivk,vtpkl,pivl->tpi", along, covariance, along)
    return np.sqrt(np.nanmean(error**2, axis=(0, 1))), np.sqrt(np.nanmean(variance, axis=(0, 1)))


def limit_mm(site: HoveringSite, rig: Rig, tracks: dict[str, xr.Dataset], noise_px: dict[str, float]) -> np.ndarray:
    """Scatter of displacement by cameras that stand still and tracks as noisy as these, shape (3,) [mm]."""
    rng, still = np.random.default_rng(0), {}
    for view, camera in zip(rig.names, site.rig().cameras, strict=True):
        noisy = camera.project(PLACES) + rng.normal(0, noise_px[view], (DRAWS, len(NAMES), 2))
        base = tracks[view].isel(time=np.zeros(DRAWS, int))
        base = base.assign_coords(time=("time", np.arange(DRAWS) / FPS, {"units": "s"}))
        still[view] = base.assign(position=base["position"].copy(data=noisy))
    alone = compute_displacement(align_views(still), rig).isel(point=slice(0, MOVING))["displacement"].values
    return np.asarray((alone @ site.rig().cameras[0].rotation).std(axis=0).mean(axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100, help="frames of each film, 25 a second")
    parser.add_argument("--width", type=int, default=960, help="of the pictures [px]; the field of view stays")
    parser.add_argument("--reach-m", type=float, default=0.5, help="how far the cameras wander [m]")
    parser.add_argument("--reach-deg", type=float, default=2.0, help="how far they turn [deg]")
    parser.add_argument("--seed", type=int, default=0, help="of the wandering")
    parser.add_argument("--whole-squares", action="store_true", help="do not choose the subsets, which takes longer")
    options = parser.parse_args()
    whole = HoveringSite()
    size = (options.width, 2 * round(options.width * whole.image_size[1] / whole.image_size[0] / 2))
    site = replace(whole, focal_px=whole.focal_px * options.width / whole.image_size[0], image_size=size)
    rig = Rig.from_world(site.rig().names, site.rig().cameras, metric=True)
    with tempfile.TemporaryDirectory() as folder:
        tracks = film_and_track(site, Path(folder), options)
    noise_px = {}
    for number, (view, one) in enumerate(tracks.items()):
        error = one["position"].values - true_pixels(site, number, options)
        noise_px[view] = float(np.sqrt(np.nanmean((error - np.nanmean(error, axis=0)) ** 2)))
    steady = steady_tracks(tracks, rig, STATIC_POINTS)
    shifts = [motion.rms_before_px for motion in steady.views.values()]
    rows = {"nothing": tracks, "similarity": warped(tracks, "similarity"), "homography": warped(tracks, "homography")}
    rows["pose"] = dict(steady.tracks)
    results = {name: errors_mm(of_row, site, rig)[0] for name, of_row in rows.items()}
    results["stated"] = errors_mm(rows["pose"], site, rig)[1]
    results["limit"] = limit_mm(site, rig, tracks, noise_px)
    of_pixel_mm = 1e3 * site.distance_m / site.focal_px
    print(
        f"{options.frames} frames of {size[0]} x {size[1]} px, hovering within {options.reach_m:g} m and "
        f"{options.reach_deg:g} degrees at {site.distance_m:g} m; a pixel is {of_pixel_mm:.1f} mm"
    )
    print(
        f"shift of the static points {shifts[0]:.0f} and {shifts[1]:.0f} px (rms), "
        f"error of the tracks {min(noise_px.values()):.4f} to {max(noise_px.values()):.4f} px"
    )
    print(f"{'':<12}" + "".join(f"{axis + ' [mm]':>16}" for axis in AXES))
    for name, values in results.items():
        print(f"{name:<12}" + "".join(f"{value:>16.3f}" for value in values))
    print(f"status: {', '.join(str(motion.status) for motion in steady.views.values())}")
    figures = {
        "frames": options.frames,
        "track_error_px": max(noise_px.values()),
        "shift_px": max(shifts),
        **{f"{name}_rmse_{axis}_mm": float(of[k]) for name, of in results.items() for k, axis in enumerate(AXES)},
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
