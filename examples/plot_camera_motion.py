"""A tripod in the wind: what the camera's own motion does to displacement, and what static points do about it.

The tracks are those of the demonstration; to the right view's, a sway of the camera is added that nobody would notice
in the picture. Points on the abutment do not move, so what they seem to do is the camera's doing, and ``steady_tracks``
takes it out of all points of the view. ``vfm-sdm measure`` does so by itself where a session has static points.

    python examples/plot_camera_motion.py [FOLDER]
"""

import numpy as np
from gallery import (
    BLUE,
    GREY,
    INK,
    POINT,
    VERMILION,
    demo_session,
    finish,
    headline,
    new_figure,
    rms,
    run_folder,
    save,
    true_displacement,
)  # fmt: skip

from vfm_sdm import Measurement, compute_displacement
from vfm_sdm.stages.camera_motion import steady_tracks
from vfm_sdm.stages.synchronize import align_views

session = demo_session()
measurement = Measurement(session, run_folder())
cameras, tracks = measurement.cameras, dict(measurement.tracks)
static = [point.name for point in session.point if point.static]
truth = true_displacement()["displacement"].sel(point=POINT)

# A sway of some hundredths of a degree: to and fro, and up and down in gusts.
time_s = tracks["right"]["time"].values
sway_px = np.stack(
    [0.8 * np.sin(2 * np.pi * 0.9 * time_s), 1.1 * np.sin(2 * np.pi * 1.7 * time_s) * np.sin(1.1 * time_s)], axis=1
)
tracks["right"] = tracks["right"].copy(deep=True)
tracks["right"]["position"].values += sway_px[:, None]

steady = steady_tracks(tracks, cameras.rig, static)
results = {}
for case, views in {"with the sway": tracks, "static points used": steady.tracks}.items():
    result = compute_displacement(
        align_views(dict(views)), cameras.rig, frame=cameras.frame, still_interval_s=session.method.still_interval_s
    )
    results[case] = result["displacement"].sel(point=POINT)

figure = new_figure(10, 5.4)
grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.25))

motion = steady.views["right"]
focal = cameras.rig.cameras[1].K[0, 0]
rotation_deg = np.degrees(motion.rotation)
known_deg = np.degrees(np.stack([-sway_px[:, 1], sway_px[:, 0]], axis=1) / focal)
for row, (name, column) in enumerate((("pitch", 0), ("yaw", 1))):
    axes = figure.add_subplot(grid[row, 0], ylabel="[0.001 degree]")
    estimated, added = rotation_deg[:, column], known_deg[:, column]
    sign = np.sign(np.corrcoef(estimated, added)[0, 1])
    axes.plot(time_s, 1e3 * estimated, color=BLUE, linewidth=1.4, label="found from static points")
    axes.plot(time_s, 1e3 * sign * (added - added.mean()), color=INK, linewidth=1, linestyle=(0, (2, 2)), label="added")
    finish(axes, f"{name} of the right camera")
    axes.margins(x=0)
    axes.tick_params(labelbottom=row == 1)
axes.set_xlabel("time [s]")
axes.legend(fontsize=8, frameon=False, ncols=2, loc="lower left")
low, high = axes.get_ylim()
axes.set_ylim(low - 0.3 * (high - low), high)

for row, axis in enumerate(("lateral", "vertical")):
    axes = figure.add_subplot(grid[row, 1], ylabel="[mm]")
    true = truth.sel(axis=axis).values
    errors = []
    for (case, found), colour in zip(results.items(), (GREY, VERMILION), strict=True):
        values = found.sel(axis=axis).values
        errors.append(rms(values - true))
        axes.plot(time_s, values, color=colour, linewidth=1.4, label=case)
    axes.plot(time_s, true, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="truth")
    finish(axes, f"{axis} of {POINT}: error {errors[0]:.2f} mm, then {errors[1]:.3f} mm RMS")
    axes.margins(x=0)
    axes.tick_params(labelbottom=row == 1)
axes.set_xlabel("time [s]")
axes.legend(fontsize=8, frameon=False, ncols=3, loc="lower left")
low, high = axes.get_ylim()
axes.set_ylim(low - 0.25 * (high - low), high)

headline(figure, "A tripod that sways by a pixel, and what two static points leave of it")
save(figure, __file__)
