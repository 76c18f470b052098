"""From two videos and one measured length to millimetres: the demonstration, measured and held against the truth.

``measure`` reads a session (`docs/session.md`): two recordings, what was measured on site, and points that were clicked
in the first picture of the left one. It finds the cameras and the points in the other view, tracks, triangulates, and
states an uncertainty for every sample. The recording is synthetic, so the truth is known to compare with.

    python examples/plot_measure.py [FOLDER]
"""

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
from matplotlib.patheffects import withStroke

from vfm_sdm import measure

TITLES = {"left": "left view: the points as they were clicked", "right": "right view: where they were found"}
STATIC = "static points, to see whether the tripods move"

session, truth = demo_session(), true_displacement()
measurement = measure(session, run_folder())
displacement = measurement.displacement.sel(point=POINT)

figure = new_figure(10, 6.2)
grid = figure.add_gridspec(6, 2, width_ratios=(1, 1.25))

# The first pictures of both views with the points.
halo = [withStroke(linewidth=2.2, foreground=INK)]
for row, (view, title) in enumerate(TITLES.items()):
    picture = figure.add_subplot(grid[3 * row : 3 * row + 3, 0])
    picture.imshow(measurement.frames[view], cmap="gray")
    for point in session.point:
        u, v = measurement.points["position"].sel(view=view, point=point.name).values
        colour, shape = ("white", "s") if point.static else ("#FFD54F", "o")
        picture.plot(u, v, shape, markersize=7, mfc="none", mec=colour, mew=1.5, path_effects=halo)
        if not point.static:
            picture.annotate(
                point.name, (u, v), (0, 8), textcoords="offset points", ha="center", fontsize=7.5, color=colour,
                path_effects=halo,
            )  # fmt: skip
    picture.set_title(title, loc="left", fontsize=10, color=INK)
    picture.set(xticks=[], yticks=[])
picture.set_xlabel(f"squares: {STATIC}", fontsize=8, loc="left")

panels = []
for row, (axis, colour) in enumerate(AXIS_COLOURS.items()):
    time_s = displacement["time"].values
    found = displacement["displacement"].sel(axis=axis).values
    true = truth["displacement"].sel(point=POINT, axis=axis).values
    expanded = displacement["expanded_uncertainty"].sel(axis=axis).values
    axes = figure.add_subplot(grid[2 * row : 2 * row + 2, 1], ylabel="[mm]")
    axes.fill_between(time_s, found - expanded, found + expanded, color=colour, alpha=0.22, linewidth=0)
    axes.plot(time_s, found, color=colour, linewidth=1.6, label="measured, with its 95 % interval")
    axes.plot(time_s, true, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="truth")
    finish(axes, f"{axis}: error {rms(found - true):.3f} mm RMS")
    axes.margins(x=0, y=0.08)
    axes.tick_params(labelbottom=row == 2)
    panels.append(axes)
panels[2].set_xlabel("time [s]")
panels[2].set_ylim(-0.55, 0.35)
panels[2].legend(fontsize=8, frameon=False, ncols=2, loc="lower left")
figure.align_ylabels(panels)

headline(figure, f"The middle of a footbridge, measured without a target on it: {measurement.audit.verdict}")
save(figure, __file__)
