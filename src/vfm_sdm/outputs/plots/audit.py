"""One picture of the audit: how far each check is from its limit."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.outputs.plots.drawing import plain_text
from vfm_sdm.stages.audit import Audit

__all__ = ["plot_audit"]

# The palette of Okabe and Ito; the markers tell the outcomes apart without colours.
_STYLE = {
    Outcome.PASS: ("#009E73", "o"),
    Outcome.CAUTION: ("#E69F00", "s"),
    Outcome.FAIL: ("#D55E00", "X"),
    Outcome.NOT_POSSIBLE: ("#999999", "|"),
}
_VERDICT_COLOUR = {
    Verdict.FIT: "#009E73",
    Verdict.CARE: "#E69F00",
    Verdict.NOT_JUDGED: "#E69F00",
    Verdict.REFUSED: "#D55E00",
}
_RANGE = (0.01, 30.0)
_ROW_IN = 0.34
_TEXT_COLUMNS = 92


def plot_audit(audit: Audit, ax: Axes | None = None) -> Axes:
    """Every check as its value over its limit [1], on a logarithmic axis, with its sentence beside it.

    Parameters
    ----------
    audit
        Checks and verdict.
    ax
        Axes to draw into; a new figure when None.
    """
    count = len(audit.checks)
    axes = Figure(figsize=(13.0, 1.2 + _ROW_IN * count)).add_subplot() if ax is None else ax
    axes.axvspan(1.0, _RANGE[1], color="#D55E00", alpha=0.08, linewidth=0)
    axes.axvline(1.0, color="#555555", linewidth=1.0)
    for row, check in enumerate(audit.checks):
        colour, marker = _STYLE[check.outcome]
        # A failure without a value is a failure all the same.
        unknown = _RANGE[0] if check.outcome is Outcome.PASS else _RANGE[1]
        share = float(np.clip(np.nan_to_num(check.share_of_limit, nan=unknown), *_RANGE))
        if check.outcome is not Outcome.NOT_POSSIBLE:
            axes.plot([_RANGE[0], share], [row, row], color=colour, linewidth=1.5, alpha=0.5)
            axes.plot(share, row, marker=marker, color=colour, markersize=7, linestyle="none", clip_on=False)
        shown = textwrap.shorten(check.sentence, _TEXT_COLUMNS, placeholder=" ...")
        axes.annotate(
            plain_text(f"{_format_value(check.value, check.units)}   {shown}"),
            (1.01, row),
            xycoords=("axes fraction", "data"),
            va="center",
            fontsize=8,
            color="#999999" if check.outcome is Outcome.NOT_POSSIBLE else "black",
        )
    axes.set(xscale="log", xlim=_RANGE, ylim=(count - 0.5, -0.5), xlabel="value over limit")
    axes.set_yticks(range(count), [plain_text(f"{check.name}: {check.outcome}") for check in audit.checks], fontsize=8)
    axes.grid(axis="x", alpha=0.3)
    axes.set_title(f"audit: {audit.verdict}", loc="left", color=_VERDICT_COLOUR[audit.verdict], fontweight="bold")
    return axes


def _format_value(value: float, units: str) -> str:
    if not np.isfinite(value):
        return "-"
    if units == "1":
        return f"{100 * value:.0f} %" if value >= 0.1 else f"{100 * value:.2g} %"
    # Of thousands of frames all digits are shorter than a power of ten.
    return f"{value:.0f} {units}".strip() if value >= 1000 else f"{value:.3g} {units}".strip()
