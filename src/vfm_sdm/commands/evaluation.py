"""The commands ``reference`` and ``evaluate``: what sensors say, and how a measurement compares with it."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import xarray as xr
from cyclopts import Parameter
from rich.table import Table
from rich.text import Text

from vfm_sdm.analysis.evaluation import (
    Evaluation,
    EvaluationRow,
    ReferenceClock,
    evaluate_run,
    read_sensors,
    write_evaluation,
    write_reference,
)
from vfm_sdm.commands.options import name_values
from vfm_sdm.commands.terminal import (
    OUT,
    add_name_column,
    fail,
    note,
    number_text,
    plain_table,
    say,
    say_rest,
    shown_rows,
)
from vfm_sdm.core.sensor_datasets import SensorUnits
from vfm_sdm.inputs.sensors.accelerometer import RecipeSettings
from vfm_sdm.inputs.sensors.outliers import HampelUse

__all__ = ["evaluate", "evaluation_table", "reference"]


@Parameter(name="*")
@dataclass(frozen=True)
class RecipeOptions:
    """Options of the recipe from acceleration to displacement."""

    onset: Annotated[float | None, Parameter(help="When the motion begins on the sensor's clock, in seconds.")] = None
    band: Annotated[tuple[float, float], Parameter(help="Lowest and highest frequency in Hz.")] = (1.0, 10.0)
    integration: Annotated[Literal["trapezoid", "spline"], Parameter(help="Rule of integration.")] = "trapezoid"

    hampel: Annotated[
        HampelUse,
        Parameter(
            help="Replace outliers: on, as in the paper; off; auto, lone samples alone where it would cut impacts."
        ),
    ] = "auto"

    def settings(self) -> RecipeSettings:
        """Settings of the recipe as the library knows them."""
        return RecipeSettings(onset_s=self.onset, band_hz=self.band, integration=self.integration, hampel=self.hampel)


@Parameter(name="*")
@dataclass(frozen=True)
class ClockOptions:
    """Options of the clock of a reference beside that of the video."""

    synchronize: Annotated[
        bool | None, Parameter(help="Estimate the lag of the reference's clock; left out, only of sensors.")
    ] = None
    search: Annotated[float, Parameter(help="Seconds around --start-lag in which the lag is searched.")] = 5.0
    start_lag: Annotated[float, Parameter(help="Lag of the reference in seconds, as far as it is known.")] = 0.0

    def settings(self) -> ReferenceClock:
        """The reference's clock as the library knows it."""
        return ReferenceClock(self.search, self.start_lag, synchronize=self.synchronize)


_RECIPE, _CLOCK = RecipeOptions(), ClockOptions()


def reference(
    *files: Annotated[Path, Parameter(help="CSV files of any usual dialect, one a sensor, on one clock.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File to write, such as reference.nc.")],
    sensor: Annotated[tuple[str, ...], Parameter(help="Name of the sensor in each file; that of the file else.")] = (),
    column: Annotated[
        tuple[str, ...],
        Parameter(
            help="Which column holds what, such as vertical=-az or 'time=t in ms'; again for each. - reverses the sign."
        ),
    ] = (),
    units: Annotated[
        SensorUnits | None, Parameter(help="Of the files' values; those of their header else, and g where it has none.")
    ] = None,
    rate: Annotated[float | None, Parameter(help="Samples a second, for files without a time column.")] = None,
    recipe: RecipeOptions = _RECIPE,
) -> None:
    """Accelerometers' recordings to reference displacement, by the paper's recipe: writes a netCDF file.

    Recordings of displacement (units mm, m, cm or um) are taken as they are.
    """
    result = read_sensors(
        files,
        sensors=sensor,
        columns=name_values(column, "--column") or None,
        units=units,
        sampling_rate_hz=rate,
        settings=recipe.settings(),
    )
    OUT.print(reference_table(result))
    note(result.attrs.get("notes", ()))
    say(f"written: {write_reference(output, result)}")


def evaluate(
    run: Annotated[Path, Parameter(help="Run folder with displacement.nc.")],
    against: Annotated[
        Path, Parameter(help="truth.nc, a file of `vfm-sdm reference`, or a sensor's CSV file that the session names.")
    ],
    *,
    pair: Annotated[tuple[str, ...], Parameter(help="point=sensor; again for each. Those of the session else.")] = (),
    axis: Annotated[tuple[str, ...], Parameter(help="Axis to compare; again for each.")] = ("lateral", "vertical"),
    band: Annotated[tuple[float, float] | None, Parameter(help="Filter both to these frequencies in Hz.")] = None,
    clock: ClockOptions = _CLOCK,
) -> None:
    """Compare a measurement with a reference: prints the figures and writes evaluation.json into the run folder."""
    result = evaluate_run(
        run,
        against,
        pairs=name_values(pair, "--pair") or None,
        axes=axis,
        band_hz=band,
        clock=clock.settings(),
    )
    OUT.print(evaluation_table(result))
    note(result.notes)
    say(f"written: {write_evaluation(run, result)}")
    if not result.scored_rows:
        fail(f"no figures: {result.notes[-1]}")


def reference_table(reference: xr.Dataset) -> Table:
    """Onset, samples, replaced outliers and peak-to-peak of each sensor of a reference dataset."""
    low, high = reference.attrs["band_hz"]
    title = Text(
        f"Reference displacement, {low:g} to {high:g} Hz, onset {reference.attrs.get('onset_status', 'given')}"
    )
    table = plain_table(title)
    axes = [str(axis) for axis in reference["axis"].values]
    for name in ("sensor", "onset [s]", "samples", "outliers", *(f"{axis} p-p [mm]" for axis in axes)):
        if name == "sensor":
            add_name_column(table, name, reference["sensor"].values)
        else:
            table.add_column(Text(name), justify="right")
    for sensor in reference["sensor"].values:
        one = reference.sel(sensor=sensor)
        spans = one["displacement"].max("time") - one["displacement"].min("time")
        table.add_row(
            str(sensor),
            f"{reference.attrs['onset_s']:.3f}",
            str(int(one["displacement"].notnull().all("axis").sum())),
            str(int(one["outliers"].sum())) if "outliers" in one else "-",
            *(number_text(float(span), "{:.3f}") for span in spans),
        )
    return table


def evaluation_table(evaluation: Evaluation) -> Table:
    """The paper's metrics and what they hide, a point and axis, with mean and standard deviation of the former.

    ``cover`` is the share of samples whose stated interval, nominally 95 %, holds the reference.
    """
    title = f"Compared with {evaluation.reference_name}"
    if evaluation.band_hz is not None:
        title += ", {:g} to {:g} Hz".format(*evaluation.band_hz)
    lag = evaluation.synchronization
    if lag is not None and lag.ok:
        title += f", lag {1e3 * lag.lag_s:.1f} +- {1e3 * lag.lag_std_s:.1f} ms"
    table = plain_table(title, dense=True)
    add_name_column(table, "point", [row.point for row in evaluation.rows])
    table.add_column("axis", no_wrap=True)
    for name in ("NRMSE", "corr.", "RPPAE", "gain", "skill", "lag ms", "cover %", "RMS mm"):
        table.add_column(name, justify="right", no_wrap=True)
    previous, points = None, list(dict.fromkeys(row.point for row in evaluation.rows))
    shown = {*points[: shown_rows(len(points))]}
    for row in (row for row in evaluation.rows if row.point in shown):
        table.add_row("" if row.point == previous else row.point, row.axis, *_figures(row))
        previous = row.point
    table.add_section()
    metrics = evaluation.mean_and_std().values()
    counted = f"{len(evaluation.scored_rows)} of {len(evaluation.rows)}"
    table.add_row("mean", counted, *(number_text(mean, "{:.3f}") for mean, _ in metrics))
    table.add_row("std", "", *(number_text(std, "{:.3f}") for _, std in metrics), end_section=True)
    return say_rest(table, len(points), "evaluation.json")


def _figures(row: EvaluationRow) -> Iterator[str]:
    score = row.score
    for value in (score.nrmse_range, score.correlation, score.rppae, score.gain, score.skill):
        yield number_text(value, "{:.3f}")
    yield number_text(score.lag_s, "{:.1f}", 1e3)
    yield number_text(score.coverage, "{:.0f}", 100)
    yield number_text(row.rms_error_mm, "{:.3f}")
