"""The deflection line of a whole girder, from a grid of points on its web: with its band, beside the truth.

``[[grid]]`` names a polygon in one picture and a spacing in metres. Its points are placed in both views by the cameras
that the named points gave, tracked, and judged one by one; ``compute_field`` brings them together. The recording is
synthetic, so the line is known at every station.

    python examples/plot_field.py [FOLDER]
"""

import numpy as np
from gallery import BLUE, GREY, INK, VERMILION, demo_session, finish, folder, headline, new_figure, save

from vfm_sdm import measure
from vfm_sdm.analysis.field import compute_field, extreme_times
from vfm_sdm.inputs.session import Grid
from vfm_sdm.studies.synthetic.field_test import demo_plan

AXIS, BAND = "vertical", 1.96
POLYGON = ((45.0, 285.0), (1235.0, 262.0), (1235.0, 452.0), (45.0, 435.0))

session = demo_session()
# The web of the girder between the named points, in the left view.
grid = Grid(name="web", view="left", polygon=POLYGON, spacing_m=0.15)
measurement = measure(session.model_copy(update={"grid": (grid,)}), folder() / "run-field")
static = [point.name for point in session.point if point.static]
still = session.method.still_interval_s
field = compute_field(measurement.displacement, static=static, still_interval_s=still)

plan, station = demo_plan(), field["station"].values
places = np.column_stack([np.full(len(station), plan.site.perpendicular_m), 0 * station, station])
truth = 1e3 * plan.motion.displacement(field["time"].values, places)[..., 1]

figure = new_figure(10, 6.4)
above, below = figure.subplots(2, 1, height_ratios=(1, 1.1))

above.imshow(measurement.frames["left"], cmap="gray")
pixels = measurement.points["position"].sel(view="left").values
used = field["used"].sel(axis=AXIS).values.astype(bool)
above.plot(*pixels[used].T, "o", markersize=3, color="#FFD54F", markeredgewidth=0)
above.plot(*pixels[~used].T, "x", markersize=4, color=VERMILION)
above.set_title(f"{used.sum()} points make the line; crosses were left out or stand still", loc="left", fontsize=10)
above.set(xticks=[], yticks=[])

for time_s, colour in zip(extreme_times(field, AXIS), (VERMILION, BLUE), strict=False):
    row = int(np.abs(field["time"].values - time_s).argmin())
    line, std = (field[name].sel(axis=AXIS).values[row] for name in ("displacement", "displacement_std"))
    below.fill_between(station, line - BAND * std, line + BAND * std, color=colour, alpha=0.25, linewidth=0)
    below.plot(station, line, color=colour, linewidth=1.8, label=f"{time_s:.2f} s, 95 % band")
    below.plot(station, truth[row], color=INK, linewidth=0.9, linestyle="--", label="truth" if colour == BLUE else "_")
below.axhline(0, color=GREY, linewidth=0.6)
below.invert_yaxis()
below.set_xlabel("along the structure [m]")
below.set_ylabel("vertical, positive down [mm]")
below.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(0.02, 0.42))
finish(below, "the line at its two extremes")
headline(figure, "Many points, one line: how the whole girder bends, and how well that is known")
save(figure, __file__)
