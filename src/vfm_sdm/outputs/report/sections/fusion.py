"""Fusion with an accelerometer: what was found of both, and the fused histories."""

import numpy as np
import xarray as xr

from vfm_sdm.analysis.fusion import read_fusion
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.outputs.plots.drawing import BLUE, VERMILION, reduce_band, reduce_line
from vfm_sdm.outputs.report.content import Block, Cell, Figure, Paragraph, Section, Table
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, Panel, span_of
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language, count_decimals
from vfm_sdm.outputs.report.sections.outdated import warn_outdated
from vfm_sdm.stages.displacement.uncertainty import COVERAGE_FACTOR

__all__ = ["describe_fusion_section"]

_LEFT, _MIDDLE, _CLOSE, _TOP, _HEIGHT, _BOTTOM = 62.0, 440.0, 500.0, 10.0, 130.0, 34.0
_FRAMES_SHOWN = 30
"""Frames of the video in the close look."""


def describe_fusion_section(inputs: ReportInputs, language: Language) -> Section | None:
    """Lag, gain and noise along every axis, and drawings; nothing where nothing was fused.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    fused = read_fusion(inputs.folder)
    if fused is None or not fused.sizes["time"]:
        return None
    point, sensor = str(fused.attrs["point"]), str(fused.attrs["sensor"])
    highest, rate = (
        language.write(float(value), 0) for value in (fused.attrs["band_hz"][1], fused.attrs["sampling_rate_hz"])
    )
    head = Paragraph(language.say("fusion head", point=point, sensor=sensor, highest=highest, rate=rate))
    axes = [str(axis) for axis in fused["axis"].values]
    names = ("lag", "gain", "p2p", "video", "fused", "innovation", "bridged")
    columns = (language.say("axis"), *(language.say(f"fusion {name}") for name in names))
    table = Table(
        language.say("table fusion"), columns, tuple(_list_cells(fused.sel(axis=axis), axis, language) for axis in axes)
    )
    blocks: list[Block] = [*warn_outdated(inputs, fused, "fuse", language), head, table]
    for axis in axes:
        caption = language.say("figure fusion", axis=language.word("axis", axis))
        blocks.append(Figure(caption, _draw(inputs, fused.sel(axis=axis), point, axis, language)))
    notes = fused.attrs.get("notes", ())
    told = [language.tell(str(one)) for one in ([notes] if isinstance(notes, str) else notes)]
    return Section(language.say("title fusion"), (*blocks, *language.listed(told)))


def _list_cells(one: xr.Dataset, axis: str, language: Language) -> tuple[Cell, ...]:
    """A row of the table."""
    values = one["displacement"].values
    bridged = 100 * float(np.mean(one["status"].values == 1))
    noise = float(one["displacement_std"].median())
    return (
        Cell(language.word("axis", axis)),
        _state(1e3 * float(one["lag"]), 1e3 * float(one["lag_std"]), language),
        _state(float(one["gain"]), float(one["gain_std"]), language),
        language.digits(float(np.nanmax(values) - np.nanmin(values)), 4),
        language.digits(float(one["video_std"]), 2),
        language.digits(noise, 2),
        language.digits(float(one["innovation_rms"]), 2),
        language.cell(bridged, 1),
    )


def _state(value: float, std: float, language: Language) -> Cell:
    """A value with its expanded uncertainty, to the digits that this has."""
    decimals = count_decimals(COVERAGE_FACTOR * std, 2)
    return Cell(f"{language.write(value, decimals)} ± {language.write(COVERAGE_FACTOR * std, decimals)}", value)


def _draw(inputs: ReportInputs, one: xr.Dataset, point: str, axis: str, language: Language) -> str:
    """The fused history, and a second of it with the values of the video, as SVG."""
    drawing = Drawing(_TOP + _HEIGHT + _BOTTOM, language.say("figure history label", point=point))
    time_s, values, std = (one[name].values for name in ("time", "displacement", "displacement_std"))
    low, high = values - COVERAGE_FACTOR * std, values + COVERAGE_FACTOR * std
    video_s = inputs.displacement["time"].values
    seen = inputs.displacement[["displacement", "status"]].sel(point=[point])
    row = [str(name) for name in seen["axis"].values].index(axis)
    video = trusted_values(seen.transpose("time", "point", "axis"), "displacement")[:, 0, row]
    begin = _find_liveliest(time_s, values, video_s)
    end = begin + _FRAMES_SHOWN * float(np.median(np.diff(video_s)))
    for left, right, inside in ((_LEFT, _MIDDLE, None), (_CLOSE, WIDTH - 12.0, (begin, end))):
        chosen = slice(None) if inside is None else (time_s >= inside[0]) & (time_s <= inside[1])
        at, lowest, highest = reduce_band(time_s[chosen], low[chosen], high[chosen])
        box = (left, _TOP, right, _TOP + _HEIGHT)
        shown = (video_s >= at[0]) & (video_s <= at[-1]) & np.isfinite(video)
        dots = [] if inside is None else [video[shown]]
        panel = Panel(drawing, box, span_of([at], margin=0.0), span_of([lowest, highest, *dots]), language)
        name = f"{language.word('axis', axis)} [mm]" if inside is None else ""
        panel.frame(x_label=language.say("time s"), y_label=name, y_ticks=4)
        panel.band(at, lowest, highest, BLUE)
        line_s, line = reduce_line(time_s[chosen], values[chosen])
        panel.curve(line_s, line, line, BLUE)
        if inside is not None:
            for place in panel.place(video_s[shown], video[shown]):
                drawing.dot(place, 1.6, VERMILION)
    return drawing.svg()


def _find_liveliest(time_s: FloatArray, values: FloatArray, video_s: FloatArray) -> float:
    """Beginning of the stretch in which displacement moves fastest [s]."""
    speed = np.square(np.nan_to_num(np.diff(values)))
    count = max(int(_FRAMES_SHOWN * np.median(np.diff(video_s)) / np.median(np.diff(time_s))), 1)
    return float(time_s[int(np.argmax(np.convolve(speed, np.ones(min(count, speed.size)), "valid")))])
