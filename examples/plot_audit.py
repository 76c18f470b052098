"""What an audit sees: the same recording as it was noted, and with one clock noted wrongly by a tenth of a second.

Every measurement is checked, and each check says how near its value is to the limit from which on it is a caution. A
wrong clock makes displacement that looks perfectly plausible. The audit refuses it, and names what to look at.

    python examples/plot_audit.py [FOLDER]
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np
from gallery import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PALE,
    VERMILION,
    demo_session,
    finish,
    headline,
    new_figure,
    run_folder,
    save,
)  # fmt: skip
from matplotlib.ticker import StrMethodFormatter

from vfm_sdm import Measurement

COLOURS = {"pass": BLUE, "caution": ORANGE, "fail": VERMILION, "not possible": GREY}
LEAST, MOST = 0.005, 30.0
WRONG_S = 0.1

right = Measurement(demo_session(), run_folder())
audits = {"as noted": right.audit}

# The second recording starts when the session says; here the session is wrong. Cameras and tracks are still the same.
views = [
    view.model_copy(update={"time_offset_s": WRONG_S if view.name == "right" else None}) for view in right.session.view
]
with tempfile.TemporaryDirectory() as folder:
    copy = shutil.copytree(run_folder(), Path(folder) / "run")
    wrong = Measurement(right.session.model_copy(update={"view": tuple(views)}), copy)
    audits[f"right clock wrong by {WRONG_S:g} s"] = wrong.audit

figure = new_figure(10, 5.4)
columns = figure.subplots(1, 2, sharey=True)
for axes, (case, audit) in zip(columns, audits.items(), strict=True):
    names = [check.name for check in audit.checks]
    shares = np.array([check.share_of_limit for check in audit.checks])
    drawn = np.clip(np.nan_to_num(shares, nan=LEAST), LEAST, MOST)
    colours = [COLOURS[str(check.outcome)] for check in audit.checks]
    axes.axvspan(1, MOST, color=PALE, alpha=0.5, linewidth=0)
    axes.barh(names, drawn - LEAST, left=LEAST, height=0.62, color=colours)
    for row, check in enumerate(audit.checks):
        if str(check.outcome) == "not possible":
            axes.text(LEAST * 1.15, row, "not possible", va="center", fontsize=7.5, color=GREY, style="italic")
        elif drawn[row] <= LEAST:
            axes.text(LEAST * 1.15, row, "nothing found", va="center", fontsize=7.5, color=BLUE)
        elif str(check.outcome) != "pass":
            axes.text(drawn[row] * 1.12, row, check.where, va="center", fontsize=7.5, color=INK)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_xlim(LEAST, MOST)
    axes.set_xlabel("value over its limit: from 1 on, a caution")
    axes.axvline(1, color=INK, linewidth=1)
    finish(axes, f"{case}: {audit.verdict}", grid="x")
columns[0].invert_yaxis()
columns[1].tick_params(labelleft=False)

headline(figure, "A clock that is wrong by three frames makes plausible displacement, and an audit that refuses it")
save(figure, __file__)
