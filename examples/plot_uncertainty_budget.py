"""Where the uncertainty comes from, and whether it is right: the budget of one point, and its errors in its intervals.

Each sample's uncertainty is the root of the sum of squares of five components (`docs/conventions.md`). Which one is the
largest says what to do better next time: a longer baseline, a better lens, a clap for the clocks, a higher bit rate.

    python examples/plot_uncertainty_budget.py [FOLDER]
"""

import numpy as np
from gallery import (
    AXIS_COLOURS,
    INK,
    POINT,
    demo_session,
    finish,
    headline,
    new_figure,
    rms,
    run_folder,
    save,
    true_displacement,
)  # fmt: skip

from vfm_sdm import Measurement

session, truth = demo_session(), true_displacement()
result = Measurement(session, run_folder()).displacement.sel(point=POINT)
moving = result["time"].values > session.method.still_interval_s[1]
error = result["displacement"] - truth["displacement"].sel(point=POINT)

figure = new_figure(10, 5.0)
grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.15))

# Left: components, root mean square over the time in which the bridge moves.
budget = figure.add_subplot(grid[:, 0], xlabel="standard uncertainty, RMS while the bridge moves [mm]")
components = [str(name) for name in result["component"].values if result["uncertainty"].sel(component=name).any()]
rows = [*components, "combined", "actual error"]
for shift, (axis, colour) in enumerate(AXIS_COLOURS.items()):
    parts = [rms(result["uncertainty"].sel(component=name, axis=axis).values[moving]) for name in components]
    combined = rms(result["combined_std"].sel(axis=axis).values[moving])
    values = [*parts, combined, rms(error.sel(axis=axis).values[moving])]
    places = np.arange(len(rows)) + 0.27 * (shift - 1)
    bars = budget.barh(places, values, height=0.25, color=colour, label=axis)
    bars[-1].set(facecolor="white", edgecolor=colour, hatch="////")
    for place, value in zip(places, values, strict=True):
        text = f" {value:.3f}" if value >= 0.0005 else " < 0.001"
        budget.text(value, place, text, va="center", fontsize=7, color=INK)
budget.set_yticks(range(len(rows)), rows)
budget.invert_yaxis()
budget.axhline(len(components) - 0.5, color=INK, linewidth=0.8)
budget.margins(x=0.16)
budget.legend(fontsize=8, frameon=False, loc="upper right")
finish(budget, "components of the budget", grid="x")

# Right: the interval around zero, and the error in it.
panels = []
for row, (axis, colour) in enumerate(AXIS_COLOURS.items()):
    axes = figure.add_subplot(grid[row, 1], ylabel="[mm]")
    time_s, off = result["time"].values, error.sel(axis=axis).values
    expanded = result["expanded_uncertainty"].sel(axis=axis).values
    axes.fill_between(time_s, -expanded, expanded, color=colour, alpha=0.2, linewidth=0)
    axes.plot(time_s, off, color=colour, linewidth=1.1)
    within = np.mean(np.abs(off) <= expanded)
    finish(axes, f"{axis}: {100 * within:.0f} % of errors within the expanded uncertainty")
    axes.margins(x=0)
    axes.tick_params(labelbottom=row == 2)
    panels.append(axes)
panels[2].set_xlabel("time [s]")
figure.align_ylabels(panels)

headline(figure, f"{POINT}: what the uncertainty is made of, and the errors that it has to cover")
save(figure, __file__)
