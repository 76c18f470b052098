"""Structural geometry refinement on simulated tracks: lateral displacement before and after, beside the truth.

The site, the motion and the noise are those of the virtual field test ``data-3``: the right view is the poorer one. A
bridge hardly moves along itself, so what seems to be longitudinal motion is mostly noise of the poorer view, which
``refine`` corrects; lateral displacement gains by it.

    python examples/plot_refinement.py [FOLDER]
"""

import xarray as xr
from gallery import BLUE, GREY, INK, finish, headline, new_figure, rms, save, simulated_tracks

from vfm_sdm import Rig, compute_displacement, refine
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.studies.synthetic.presets import preset

NOISE_PX = {"left": 0.02, "right": 0.10}
COLOURS = {"without refinement": GREY, "with refinement": BLUE}

# Where the point is, what it does, and what both cameras see of it.
plan = preset("data-3", "small")
time_s, point = plan.frame_times(0), plan.points[1]
moved_m = plan.motion.displacement(time_s, [point.position])  # (T, 1, 3)
cameras = plan.site.cameras()
rig = Rig.from_world(list(NOISE_PX), cameras, metric=True)
frame = StructureFrame(cameras[0].rotation.T)
views = [
    simulated_tracks(time_s, moved_m + point.position, camera, view, noise_px=std_px, seed=number)
    for number, (camera, (view, std_px)) in enumerate(zip(cameras, NOISE_PX.items(), strict=True))
]
tracks = xr.concat(views, dim=xr.Variable("view", list(NOISE_PX)), combine_attrs="drop_conflicts")

still = (0.0, plan.still_s)
refinement = refine(tracks, rig, frame, still_interval_s=still)

figure = new_figure(10, 5.0)
panels = figure.subplots(2, 1, sharex=True)
errors = {}
for axes, axis, column in zip(panels, ("lateral", "longitudinal"), (0, 2), strict=True):
    truth_mm = 1e3 * moved_m[:, 0, column]
    for (label, colour), seen in zip(COLOURS.items(), (tracks, refinement.tracks), strict=True):
        result = compute_displacement(seen, rig, frame=frame, still_interval_s=still)
        found = result["displacement"].sel(axis=axis).values[:, 0]
        errors[axis, label] = rms(found - truth_mm)
        axes.plot(time_s, found, color=colour, linewidth=1.1, label=f"{label}: error {errors[axis, label]:.2f} mm RMS")
    axes.plot(time_s, truth_mm, color=INK, linewidth=1.2, label="truth")
    axes.set_ylabel("[mm]")
    finish(axes, axis)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.25 * (high - low))
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper left")
panels[1].set(xlabel="time [s]", xlim=(time_s[0], time_s[-1]))
figure.align_ylabels(panels)

gained = errors["lateral", "without refinement"] / errors["lateral", "with refinement"]
headline(figure, f"{point.name}: refinement makes the lateral error {gained:.1f} times smaller")
save(figure, __file__)
