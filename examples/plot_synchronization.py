"""Two cameras that were started by hand: how late one is, found from the motion that both see.

No clap and no cable: the same motion shows in both views, in other directions and sizes. ``estimate_view_lag`` finds
the lag at which one view explains the other best, to a small part of a frame. A lag that is left in the tracks makes a
false motion of its own, as the last panel shows.

    python examples/plot_synchronization.py [FOLDER]
"""

import numpy as np
from gallery import BLUE, GREY, INK, VERMILION, finish, headline, new_figure, rms, save, simulated_tracks

from vfm_sdm import Rig, compute_displacement
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.synchronize import LagSearch, align_views, estimate_view_lag
from vfm_sdm.studies.synthetic.presets import preset

LATE_S = 0.2374
TRIALS_S = np.array([0.0, 0.001, 0.002, 0.004, 0.008, 0.016, 0.033])
VIEWS = ("left", "right")

# What both cameras see: the right one was started a quarter of a second later, so everything shows up earlier in it.
plan = preset("data-2", "small")
places = [point.position for point in plan.points if not point.static]
time_s = np.arange(round(6.0 * plan.fps)) / plan.fps


def seen(view: int, late_s: float, noise_px: float = 0.02):
    moved = np.array(places) + plan.motion.displacement(time_s + late_s, places)
    return simulated_tracks(time_s, moved, plan.site.cameras()[view], VIEWS[view], noise_px=noise_px, seed=view)


left, right = seen(0, 0.0), seen(1, LATE_S)
found = estimate_view_lag(left, right, search=LagSearch(search_s=1.0))

figure = new_figure(10, 5.4)
grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1))


def draw(axes, offset_s: float, title: str) -> None:
    """Vertical movement of one point in both views, each in its own size."""
    for tracks, shift_s, colour in ((left, 0.0, BLUE), (right, offset_s, VERMILION)):
        moved = tracks["position"].values[:, 0, 1]
        label = f"{tracks.attrs['view']} view"
        axes.plot(time_s + shift_s, (moved - moved.mean()) / moved.std(), color=colour, linewidth=1.3, label=label)
    finish(axes, title)
    axes.set_xlim(2.2, 5.2)
    axes.set_yticks([])
    axes.set_ylabel("movement, scaled")


before, after = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0], xlabel="time of the left view [s]")
draw(before, 0.0, "as recorded: each view on its own clock")
draw(after, found.offset_s, f"on one clock: the right view began {1e3 * found.offset_s:.2f} ms later")
before.tick_params(labelbottom=False)
before.legend(fontsize=8, frameon=False, loc="upper left")

# How well the views explain each other, lag by lag.
search = figure.add_subplot(grid[0, 1], xlabel="lag that is tried [s]", ylabel="correlation")
lags_s = np.linspace(-1, 1, 801)
signals = [tracks["position"].values[:, 0, 1] for tracks in (left, right)]
common = (time_s > 1.0) & (time_s < 5.0)
correlations = [
    np.corrcoef(signals[0][common], np.interp(time_s[common] + lag, time_s, signals[1]))[0, 1] for lag in lags_s
]
search.plot(lags_s, correlations, color=GREY, linewidth=1.1)
search.axvline(found.lag_s, color=VERMILION, linewidth=1.3)
search.text(found.lag_s + 0.03, 1.12, "found", color=VERMILION, fontsize=8)
error_ms, std_ms = 1e3 * (found.offset_s - LATE_S), 1e3 * found.lag_std_s
finish(search, f"found to {error_ms:+.2f} ms, stated: ±{std_ms:.2f} ms")
search.margins(x=0)
search.set_ylim(-1.15, 1.3)

# What an error of the clock would do to displacement.
cost = figure.add_subplot(grid[1, 1], xlabel="error of the clock [ms]", ylabel="error [mm RMS]")
cameras = plan.site.cameras()
rig, frame = Rig.from_world(list(VIEWS), cameras, metric=True), StructureFrame(cameras[0].rotation.T)
truth_mm = 1e3 * plan.motion.displacement(time_s, places)
errors = []
for trial_s in TRIALS_S:
    views = {name: seen(number, number * trial_s, 0.002) for number, name in enumerate(VIEWS)}
    result = compute_displacement(align_views(views), rig, frame=frame)
    off = result["displacement"].values - (truth_mm - truth_mm[0])
    errors.append([rms(off[..., axis] - off[..., axis].mean(axis=0)) for axis in range(2)])
for axis, (name, colour) in enumerate((("lateral", BLUE), ("vertical", VERMILION))):
    cost.plot(1e3 * TRIALS_S, np.array(errors)[:, axis], "o-", color=colour, markersize=3.5, linewidth=1.3, label=name)
cost.axvline(1e3 / plan.fps, color=INK, linewidth=0.9, linestyle=(0, (2, 2)))
cost.text(1e3 / plan.fps - 0.6, cost.get_ylim()[1], "one frame", fontsize=8, ha="right", va="top", color=INK)
finish(cost, "what a wrong clock costs")
cost.legend(fontsize=8, frameon=False, loc="upper left")
cost.set_xlim(left=0)
cost.set_ylim(bottom=0)

headline(figure, f"Two cameras started by hand, {1e3 / plan.fps:.0f} ms a frame: one clock to {abs(error_ms):.2f} ms")
save(figure, __file__)
