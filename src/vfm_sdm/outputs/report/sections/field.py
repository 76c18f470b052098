"""The displacement field: the line along the structure at its extremes, and the shapes in which it moved."""

import numpy as np

from vfm_sdm.analysis.field import extreme_times
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.outputs.report.content import Block, Cell, Paragraph, Section, Table
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language
from vfm_sdm.outputs.report.sections.outdated import warn_outdated

__all__ = ["describe_field"]

_AXIS = "vertical"
_STATIONS = 11


def describe_field(inputs: ReportInputs, language: Language) -> Section | None:
    """The line along the structure with its band; nothing where no field was computed.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    field = inputs.field
    if field is None:
        return None
    one = field.sel(axis=_AXIS)
    begin, end = (language.write(float(value), 2) for value in one["station"].values[[0, -1]])
    blocks: list[Block] = [
        *warn_outdated(inputs, field, "field", language),
        Paragraph(language.say("field head", count=int(one["used"].sum()), begin=begin, end=end)),
    ]
    left_out = int((one["used"].values == 0).sum()) - len(inputs.static)
    if left_out > 0:
        blocks.append(Paragraph(language.say("field left out", count=left_out)))
    times_s = extreme_times(field, _AXIS)
    rows = []
    for row in np.unique(np.linspace(0, one.sizes["station"] - 1, _STATIONS).round().astype(int)):
        cells = [language.cell(float(one["station"].values[row]), 2)]
        for time_s in times_s:
            here = one.isel(station=row).sel(time=time_s, method="nearest")
            value, half = float(here["displacement"]), NORMAL_95 * float(here["displacement_std"])
            cells.append(Cell(f"{language.write(value, 2)} ± {language.write(half, 2)}", value))
        rows.append(tuple(cells))
    heads = [language.say("field at", seconds=language.write(time_s, 2)) for time_s in times_s]
    caption = language.say("table field", axis=language.word("axis", _AXIS))
    blocks.append(Table(caption, (language.say("station m"), *heads), tuple(rows), words=0))
    frequencies = [value for value in one["shape_frequency"].values.tolist() if np.isfinite(value)]
    if frequencies:
        listed = ", ".join(language.write(value, 2) for value in frequencies)
        blocks.append(Paragraph(language.say("field shapes", frequencies=listed)))
    return Section(language.say("title field"), tuple(blocks))
