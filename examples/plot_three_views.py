"""A third camera: what it adds to the accuracy, and what happens while someone stands in its way.

The site and the motion are those of the virtual field test ``data-3``, seen by three cameras with the same noise. All
views that see a point triangulate it, each with the weight of its noise; two are enough. So a third one makes every
sample better, and a view that is hidden for a while costs accuracy but no sample.

    python examples/plot_three_views.py [FOLDER]
"""

from itertools import combinations

import numpy as np
import xarray as xr
from gallery import (
    AXIS_COLOURS,
    GREY,
    INK,
    PALE,
    PURPLE,
    finish,
    headline,
    new_figure,
    rms,
    save,
    simulated_tracks,
)  # fmt: skip

from vfm_sdm import Rig, compute_displacement
from vfm_sdm.core.datasets import Status
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.studies.synthetic.footbridge import make_camera
from vfm_sdm.studies.synthetic.presets import preset

NOISE_PX = 0.03
HIDDEN_S = (3.0, 4.5)
THIRD_M = (1.0, 0.1, 12.0)
"""Where the third camera stands, from the first: a good way along the bridge [m]."""

plan = preset("data-3", "small")
point = np.array(plan.points[1].position)
time_s = plan.frame_times(0)
moved_m = plan.motion.displacement(time_s, [tuple(point)])  # (T, 1, 3)
left, right = plan.site.cameras()
towards = point - np.array(THIRD_M)
third = make_camera(
    np.array(THIRD_M),
    compute_view_angle(towards[0], towards[2]),
    focal_px=float(left.K[0, 0]),
    image_size=left.image_size,
)
cameras = {"left": left, "right": right, "third": third}

views = {
    name: simulated_tracks(time_s, point + moved_m, camera, name, noise_px=NOISE_PX, seed=number)
    for number, (name, camera) in enumerate(cameras.items())
}
# Someone stands in front of the third camera.
hidden = (time_s >= HIDDEN_S[0]) & (time_s < HIDDEN_S[1])
covered = views["third"].copy(deep=True)
covered["position"].values[hidden] = np.nan
covered["status"].values[hidden] = Status.LOST


def measured(tracks: dict[str, xr.Dataset]) -> xr.Dataset:
    """Displacement from some of the views."""
    rig = Rig.from_world(list(tracks), [cameras[name] for name in tracks], metric=True)
    frame = StructureFrame(cameras[next(iter(tracks))].rotation.T)
    return compute_displacement(align_views(tracks), rig, frame=frame, still_interval_s=(0.0, plan.still_s))


def error_mm(displacement: xr.Dataset) -> np.ndarray:
    """Error along the three axes, shape (T, 3) [mm]."""
    return displacement["displacement"].values[:, 0] - 1e3 * moved_m[:, 0]


cases = {" + ".join(names): {name: views[name] for name in names} for names in combinations(cameras, 2)}
cases["all three"] = views
errors = {case: error_mm(measured(tracks)) for case, tracks in cases.items()}
with_gap = measured({**views, "third": covered})

figure = new_figure(10, 5.4)
grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))

# From above: where the cameras stand and what they look at.
above = figure.add_subplot(grid[0, 0], xlabel="along the bridge [m]", ylabel="towards it [m]")
face, half = float(point[0]), 5.0
above.plot([point[2] - half, point[2] + half], [face, face], color=GREY, linewidth=5, solid_capstyle="butt")
above.text(point[2] + half, face - 0.7, "bridge", fontsize=8, color=GREY, ha="right", va="top")
for name, camera in cameras.items():
    x, z = camera.center[0], camera.center[2]
    above.plot([z, point[2]], [x, face], color=PALE, linewidth=1.4, zorder=0)
    above.plot(z, x, "o", color=PURPLE if name == "third" else INK, markersize=6)
    above.annotate(name, (z, x), (7, -3), textcoords="offset points", fontsize=8, color=INK)
above.plot(point[2], face, "s", color="white", markeredgecolor=INK, markersize=6)
above.set_aspect("equal")
above.margins(0.12)
finish(above, "the site from above", grid="")

bars = figure.add_subplot(grid[1, 0], ylabel="error [mm RMS]")
for shift, (axis, colour) in enumerate(AXIS_COLOURS.items()):
    values = [rms(off[:, shift]) for off in errors.values()]
    places = np.arange(len(errors)) + 0.27 * (shift - 1)
    bars.bar(places, values, width=0.25, color=colour, label=axis)
    for place, value in zip(places, values, strict=True):
        bars.text(place, value, f"{value:.2f}", ha="center", va="bottom", fontsize=6.5, color=INK)
bars.set_xticks(range(len(errors)), list(errors))
bars.margins(y=0.14)
bars.legend(fontsize=7.5, frameon=False, loc="upper right", ncols=1)
finish(bars, "pairs, and all three together")

panels = []
for row, axis in enumerate(("lateral", "longitudinal")):
    axes = figure.add_subplot(grid[row, 1], ylabel="[mm]")
    column = list(AXIS_COLOURS).index(axis)
    off = error_mm(with_gap)[:, column]
    std = with_gap["displacement_std"].sel(axis=axis).values[:, 0]
    axes.axvspan(*HIDDEN_S, color=PALE, alpha=0.6, linewidth=0)
    axes.fill_between(time_s, -2 * std, 2 * std, color=AXIS_COLOURS[axis], alpha=0.22, linewidth=0)
    axes.plot(time_s, off, color=AXIS_COLOURS[axis], linewidth=0.9)
    finish(axes, f"{axis}: error, and two stated standard deviations")
    axes.margins(x=0)
    axes.tick_params(labelbottom=row == 1)
    panels.append(axes)
panels[0].margins(y=0.15)
panels[0].text(
    sum(HIDDEN_S) / 2, panels[0].get_ylim()[1], "third view hidden", ha="center", va="top", fontsize=8, color=INK
)
panels[1].set_xlabel("time [s]")
figure.align_ylabels(panels)

known = float(np.isfinite(with_gap["displacement"].values).mean())
headline(figure, f"A third camera makes every sample better, and hiding it costs none: {100 * known:g} % are known")
save(figure, __file__)
