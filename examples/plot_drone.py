"""Two drones 20 m from a girder: what hovering does to displacement, a warp of the picture, and poses in space.

The tracks are made of exact pixels with 0.01 px of noise, without films: each camera wanders within half a metre and
two degrees. Four static points at three depths show where it is in every frame; ``steady_tracks`` finds that pose and
maps all points back to where the camera was first. Beside it, as stabilisers of pictures do, every frame is warped so
that the same four points stay where they were: right for one depth, wrong by millimetres for all others.
``vfm-sdm measure`` takes poses by itself where cameras move far and a session has static points.

    python examples/plot_drone.py [FOLDER]
"""

import cv2
import numpy as np
from gallery import BLUE, GREY, INK, VERMILION, finish, headline, new_figure, rms, save
from scipy.spatial.transform import Rotation

from vfm_sdm import compute_displacement
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.stages.camera_motion import follow_depths, steady_tracks
from vfm_sdm.stages.camera_motion.poses import look_from
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.studies.synthetic.hovering import HOVERING_POINTS, STATIC_POINTS, Hover, HoveringSite

NOISE_PX = 0.01
time_s = np.arange(300) / 30
names, places = list(HOVERING_POINTS), np.array(list(HOVERING_POINTS.values()))
site = HoveringSite()
rig = Rig.from_world(site.rig().names, site.rig().cameras, metric=True)
true_mm = np.array([1.0, 3.0, 1.5]) * np.sin(2 * np.pi * time_s[:, None] * [0.7, 1.3, 0.9])

moved = np.repeat(places[None], len(time_s), axis=0)
moved[:, :3] += true_mm[:, None] / 1e3  # the first three points are on the girder
rng = np.random.default_rng(5)
tracks, ways = {}, {}
for number, (view, camera) in enumerate(zip(rig.names, site.rig().cameras, strict=True)):
    turns, ways[view] = Hover(seed=number + 4).motion(time_s)
    at_rest = moved @ camera.rotation.T + camera.translation
    turned = np.einsum("tij,tpj->tpi", Rotation.from_rotvec(turns).as_matrix(), at_rest)
    pixels = look_from(camera, turned + ways[view][:, None])
    position = pixels + rng.normal(0, NOISE_PX, pixels.shape)
    covariance = np.tile(NOISE_PX**2 * np.eye(2), (*position.shape[:2], 1, 1))
    tracks[view] = make_tracks(time_s, names, position, covariance, np.zeros(position.shape[:2]), attrs={})

static = [names.index(name) for name in STATIC_POINTS]
warped = {}
for view, one in tracks.items():
    position = one["position"].values.copy()
    rest = position[0, static].astype(np.float32)
    for frame in range(len(position)):
        warp = cv2.getPerspectiveTransform(position[frame, static].astype(np.float32), rest)
        position[frame] = cv2.perspectiveTransform(position[frame][None], warp)[0]
    warped[view] = one.assign(position=one["position"].copy(data=position))

steady = steady_tracks(tracks, rig, STATIC_POINTS)
results = {}
for case, views in {"pictures warped (homography)": warped, "poses in space": steady.tracks}.items():
    found = compute_displacement(follow_depths(align_views(dict(views)), rig), rig)
    along_site = found["displacement"].sel(point="middle").values @ site.rig().cameras[0].rotation
    results[case] = along_site - along_site.mean(axis=0)

figure = new_figure(10, 6)
grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.3))
motion = steady.views["left"]
for row, axis in enumerate(("right", "down", "forward")):
    axes = figure.add_subplot(grid[row, 0], ylabel="[m]")
    axes.plot(time_s, motion.translation[:, row], color=BLUE, linewidth=1.4, label="found from static points")
    axes.plot(time_s, ways["left"][:, row], color=INK, linewidth=1, linestyle=(0, (2, 2)), label="true")
    error_mm = 1e3 * rms(motion.translation[:, row] - ways["left"][:, row])
    finish(axes, f"left drone, {axis}: error {error_mm:.1f} mm RMS")
    axes.margins(x=0)
    axes.set_ylim(-0.85 if row == 0 else -0.6, 0.6)
    axes.tick_params(labelbottom=row == 2)
    if row == 0:
        axes.legend(fontsize=8, frameon=False, ncols=2, loc="lower left")
axes.set_xlabel("time [s]")

for row, axis in enumerate(("along", "vertical", "depth")):
    axes = figure.add_subplot(grid[row, 1], ylabel="[mm]")
    true = true_mm[:, row] - true_mm[:, row].mean()
    errors = []
    for (case, values), colour in zip(results.items(), (GREY, VERMILION), strict=True):
        errors.append(rms(values[:, row] - true))
        axes.plot(time_s, values[:, row], color=colour, linewidth=1.4, label=case)
    axes.plot(time_s, true, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="truth")
    finish(axes, f"{axis}: error {errors[0]:.1f} mm, then {errors[1]:.2f} mm RMS")
    axes.margins(x=0)
    axes.tick_params(labelbottom=row == 2)
    if row == 0:
        low, high = axes.get_ylim()
        axes.set_ylim(low - 0.35 * (high - low), high)
        axes.legend(fontsize=8, frameon=False, ncols=3, loc="lower left")
axes.set_xlabel("time [s]")

headline(figure, "Two drones that hover within 0.5 m and 2 degrees, and a girder that moves by 3 mm")
save(figure, __file__)
