"""Runs of the same films: values of each, by person, beside what they state."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vfm_sdm.outputs.plots.about import About
from vfm_sdm.outputs.plots.drawing import BLUE, GREY, ORANGE, VERMILION, plain_text

__all__ = ["draw_repeatability"]

_WIDTH_IN, _ROW_IN, _MOST = 12.0, 0.34, 40
_COLOURS = (BLUE, VERMILION, ORANGE, GREY)


def draw_repeatability(result: xr.Dataset, quantity: str, about: About) -> Figure:
    """Values of the runs less their mean, a row a point, a panel an axis; bars are the stated standard uncertainty.

    Parameters
    ----------
    result
        Of `vfm_sdm.analysis.repeatability.compare_runs`.
    quantity
        Quantity that is shown; of ``displacement``, the root mean square difference from the mean of all.
    about
        What is said of the run in whose folder it stands.
    """
    one = result.sel(quantity=quantity).isel(point=slice(_MOST))
    people = list(dict.fromkeys(str(name) for name in one["person"].values))
    rows = one.sizes["point"]
    figure = Figure(figsize=(_WIDTH_IN, 1.7 + _ROW_IN * rows), layout="constrained")
    words = "difference from the mean of all, RMS" if quantity == "displacement" else f"{quantity} less its mean"
    figure.suptitle(plain_text(f"{words}: {about.line}"), ha="left", x=0.01, fontsize="medium")
    panels = figure.subplots(1, one.sizes["axis"], sharey=True, squeeze=False)[0]
    for axes, axis in zip(panels, one["axis"].values, strict=True):
        of_axis = one.sel(axis=axis)
        values = of_axis["value"].transpose("run", "point").values
        shown = values if quantity == "displacement" else values - values.mean(axis=0)
        stated = of_axis["stated_std"].values
        left = np.zeros(rows) if quantity == "displacement" else -stated
        axes.barh(np.arange(rows), stated - left, left=left, color="#e4e4e4", height=0.7, label="stated")
        for number, person in enumerate(people):
            mine = np.flatnonzero(of_axis["person"].values == person)
            for run in mine:
                label = plain_text(person) if run == mine[0] else None
                colour = _COLOURS[number % len(_COLOURS)]
                axes.plot(shown[run], np.arange(rows), "o", color=colour, markersize=4, label=label, alpha=0.8)
        axes.set_title(str(axis), loc="left", fontsize="small")
        axes.set_xlabel("[mm]")
    panels[0].set_yticks(np.arange(rows), [plain_text(about.named(str(name))) for name in one["point"].values])
    panels[0].invert_yaxis()
    panels[0].legend(fontsize="small", frameon=False)
    return figure
