"""Two people measure the same films, one of them twice: what their results differ by, beside what they state.

Each reads the tape again and points at the same marks again, by a pixel or so beside. What a person does alike every
time, here a tape that is held a little slack, is in the reproducibility and not in the repeatability. As
``vfm-sdm repeat`` does it.

    python examples/plot_repeat.py [FOLDER]
"""

import numpy as np
from gallery import BLUE, GREY, POINT, VERMILION, demo_session, finish, folder, headline, new_figure, run_folder, save

from vfm_sdm import Measurement
from vfm_sdm.analysis.repeatability import RepeatedRun, compare_runs

HABIT_M = {"anna": 0.0, "ben": 0.008}
READING_M, POINTING_PX = 0.002, 0.7
COLOURS = {"anna": BLUE, "ben": VERMILION}

session = demo_session()
# Gains of injected motion take as long as all else, and would be the same for all.
method = session.method.model_copy(update={"injection": False})
rng = np.random.default_rng(3)
runs = [RepeatedRun("anna 1", "anna", Measurement(session, run_folder()).displacement, {})]
for name in ("anna 2", "ben 1"):
    person = name.split()[0]
    baseline = session.site.baseline
    read = baseline.model_copy(update={"value": baseline.value + HABIT_M[person] + rng.normal(0, READING_M)})
    points = tuple(
        point.model_copy(update={"pixel": tuple(np.add(point.pixel, rng.normal(0, POINTING_PX, 2)).tolist())})
        for point in session.point
    )
    noted = session.model_copy(
        update={"site": session.site.model_copy(update={"baseline": read}), "point": points, "method": method}
    )
    runs.append(RepeatedRun(name, person, Measurement(noted, folder() / name).displacement, {}))
result = compare_runs(runs)

figure = new_figure(10, 5.2)
left, right = figure.subplots(1, 2, width_ratios=(1.3, 1))
mean = sum(run.displacement["displacement"] for run in runs) / len(runs)
of_point = {"point": POINT, "axis": "vertical"}
for run in runs:
    apart = 1e3 * (run.displacement["displacement"] - mean).sel(of_point)
    style = "-" if run.name.endswith("1") else ":"
    left.plot(run.displacement["time"], apart, style, color=COLOURS[run.person], linewidth=1, label=run.name)
left.set(xlabel="time [s]", ylabel="[um]")
finish(left, f"vertical displacement of {POINT} less the mean of all")
left.legend(fontsize=8, frameon=False, ncols=2)

moving = [point.name for point in session.point if not point.static]
chosen = result.sel(quantity="displacement", axis="vertical", point=moving)
rows = np.arange(len(moving))
for shift, name, colour, label in (
    (-0.25, "repeatability", BLUE, "one person"),
    (0.0, "reproducibility", VERMILION, "different persons"),
    (0.25, "stated_std", GREY, "stated by the runs"),
):
    right.barh(rows + shift, 1e3 * chosen[name], height=0.22, color=colour, label=label)
right.set_yticks(rows, moving)
right.invert_yaxis()
right.set_xlabel("standard deviation [um]")
finish(right, "vertical, all samples", grid="x")
right.legend(fontsize=8, frameon=False)

one = result.sel(quantity="displacement", **of_point)
headline(figure, f"Results of two people differ by {1e3 * float(one['reproducibility']):.0f} um, "
                 f"those of one by {1e3 * float(one['repeatability']):.0f} um")  # fmt: skip
save(figure, __file__)
