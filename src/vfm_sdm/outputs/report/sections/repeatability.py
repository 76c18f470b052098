"""The same films measured by several people."""

import numpy as np
import xarray as xr

from vfm_sdm.analysis.repeatability import read_repeatability
from vfm_sdm.outputs.report.content import Block, Cell, Paragraph, Section, Table, Tone
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import UNKNOWN, Language
from vfm_sdm.outputs.report.sections.outdated import warn_outdated

__all__ = ["describe_repeatability"]

_SHOWN = ("displacement", "peak_to_peak")
_MOST_POINTS = 40


def describe_repeatability(inputs: ReportInputs, language: Language) -> Section | None:
    """Repeatability and reproducibility beside what is stated; nothing where no runs were compared.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    result = read_repeatability(inputs.folder)
    if result is None:
        return None
    people = sorted({str(name) for name in result["person"].values})
    head = language.say("repeatability head", count=result.sizes["run"], people=len(people), names=", ".join(people))
    blocks: list[Block] = [*warn_outdated(inputs, result, "repeat", language), Paragraph(head)]
    blocks += _tell_origins(result, language)
    blocks += [_tabulate(result.sel(quantity=quantity), quantity, language) for quantity in _SHOWN]
    return Section(language.say("title repeatability"), tuple(blocks))


def _tell_origins(result: xr.Dataset, language: Language) -> list[Block]:
    """What the runs measure from, where it is not the same."""
    blocks: list[Block] = []
    for name in ("origin", "start"):
        stated = [str(one) for one in result[name].values]
        if len(set(stated)) > 1:
            # An interval of seconds may follow the words.
            told = (
                ", ".join([language.word("origin", first), *rest]) for first, *rest in (s.split(", ") for s in stated)
            )
            listed = "; ".join(f"{run}: {one or UNKNOWN}" for run, one in zip(result["run"].values, told, strict=True))
            blocks.append(Paragraph(language.say(f"{name} differs", listed=listed), "care"))
    points = result["point"].values[result["first_frame_differs"].values.astype(bool)]
    if points.size:
        blocks.append(Paragraph(language.say("first frame differs", points=", ".join(map(str, points[:5]))), "care"))
    return blocks


def _tabulate(result: xr.Dataset, quantity: str, language: Language) -> Table:
    rows: list[tuple[Cell, ...]] = []
    tones: list[Tone] = []
    for point in result["point"].values[:_MOST_POINTS]:
        for number, axis in enumerate(result["axis"].values):
            one = result.sel(point=point, axis=axis)
            over = float(one["consistency"])
            rows.append(
                (
                    Cell(str(point) if number == 0 else ""),
                    Cell(language.word("axis", str(axis))),
                    _with_interval(one, "repeatability", language),
                    _with_interval(one, "reproducibility", language),
                    language.digits(float(one["stated_std"]), 2),
                    language.cell(over, 2),
                )
            )
            tones.append("care" if over > 1 else "")
    heads = ("point", "axis", "one person", "different persons", "stated", "consistency")
    caption = language.say("table repeatability", quantity=language.word("quantity", quantity))
    return Table(caption, tuple(map(language.say, heads)), tuple(rows), words=2, tones=tuple(tones))


def _with_interval(one: xr.Dataset, name: str, language: Language) -> Cell:
    value, low, high = (float(one[f"{name}{end}"]) for end in ("", "_low", "_high"))
    if not np.isfinite(value):
        return Cell(UNKNOWN)
    limits = f" ({language.write(low, 3)} – {language.write(high, 3)})" if np.isfinite(low) else ""
    return Cell(f"{language.write(value, 3)}{limits}", value)
