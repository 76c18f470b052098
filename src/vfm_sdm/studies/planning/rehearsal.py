"""The rehearsal itself: a planned site measured by the program, from drawn tracks or films, beside its prediction."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.progress import Progress
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.studies.planning.filming import draw_errors, film_plan, true_displacement
from vfm_sdm.studies.planning.layout import Layout
from vfm_sdm.studies.planning.prediction import Prediction, state_axes
from vfm_sdm.studies.planning.simulation import MATCH_STD_PX, adjust, list_matches, measure_exactly, simulate_tracks

__all__ = ["Compared", "ComparedAxis", "Rehearsal", "compare_rehearsal", "rehearse_films", "rehearse_tracks"]


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """A measurement of a planned site of which the truth is known.

    Parameters
    ----------
    displacement
        What was measured, shape (T, P, 3) [mm]; ``None`` where the program found no cameras.
    truth
        Displacement of the same points, at the frames of the reference view [mm].
    status
        Of the cameras.
    """

    displacement: xr.Dataset | None
    truth: xr.Dataset
    status: str


@dataclass(frozen=True)
class ComparedAxis:
    """One point and axis, predicted and achieved.

    Parameters
    ----------
    point, axis
        Of which point, along which axis.
    predicted_mm, achieved_mm
        Expanded uncertainty (k = 2) while the structure moves, root mean square over time [mm].
    error_mm
        Root mean square of the true error over the same samples [mm].
    inside
        Share of samples whose expanded uncertainty holds the truth [1].
    """

    point: str
    axis: str
    predicted_mm: float
    achieved_mm: float
    error_mm: float
    inside: float

    @property
    def ratio(self) -> float:
        """Achieved over predicted expanded uncertainty [1]."""
        return self.achieved_mm / self.predicted_mm


@dataclass(frozen=True)
class Compared:
    """A rehearsal beside its prediction.

    Parameters
    ----------
    axes
        One for every point of the structure and axis.
    status
        Of the cameras.
    expected
        Axes along which motion is expected, with its amplitude [mm].
    """

    axes: tuple[ComparedAxis, ...]
    status: str
    expected: dict[str, float]

    @property
    def ratio(self) -> float:
        """Achieved over predicted, each relative to the expected amplitude and over points and moving axes [1]."""
        return self._relative("achieved_mm") / self._relative("predicted_mm")

    @property
    def achieved(self) -> float:
        """Achieved expanded uncertainty, relative to the expected amplitude, over points and moving axes [1]."""
        return self._relative("achieved_mm")

    @property
    def error_ratio(self) -> float:
        """Root mean square error over the achieved standard deviation, likewise [1]."""
        return 2 * self._relative("error_mm") / self._relative("achieved_mm")

    @property
    def inside(self) -> float:
        """Share of samples along moving axes whose expanded uncertainty holds the truth [1]."""
        return float(np.mean([one.inside for one in self.axes if one.axis in self.expected]))

    def _relative(self, name: str) -> float:
        shares = [getattr(one, name) / self.expected[one.axis] for one in self.axes if one.axis in self.expected]
        return float(np.sqrt(np.mean(np.square(shares))))


def rehearse_films(laid: Layout, folder: Path, *, seed: int = 0, progress: Progress | None = None) -> Rehearsal:
    """Films of a planned site, measured by the program from their files as any session is.

    Parameters
    ----------
    laid
        Geometry of the plan.
    folder
        Gets the films, ``session.toml`` and the run folder ``run``.
    seed
        Of textures, noise, lenses and errors of readings.
    progress
        Called with what is being done.
    """
    filmed = film_plan(laid, folder, seed=seed, progress=progress)
    result = measure(read_session(folder / "session.toml"), folder / "run", progress=progress)
    return Rehearsal(result.displacement, filmed.truth, str(result.cameras.status))


def rehearse_tracks(laid: Layout, *, seed: int = 0) -> Rehearsal:
    """The same without images: lenses, readings, matches and tracks are drawn with the errors that the plan states.

    Parameters
    ----------
    laid
        Geometry of the plan.
    seed
        Of all errors.
    """
    rng = np.random.default_rng([seed, 1])
    true, session = draw_errors(laid, rng)
    noted = Layout(laid.plan, true.cameras, laid.priors, laid.points3d, laid.face_m, laid.motion, session)
    matches = [_disturb(one, rng) for one in list_matches(true)]
    adjusted = adjust(noted, matches)
    displacement = measure_exactly(noted, adjusted, simulate_tracks(noted, seed=seed + 1))
    return Rehearsal(displacement, true_displacement(laid), str(adjusted.status))


def _disturb(matches: Matches, rng: np.random.Generator) -> Matches:
    """Matches with drawn errors."""
    first, second = (
        pixels + MATCH_STD_PX * rng.standard_normal(pixels.shape)
        for pixels in (matches.points_first, matches.points_second)
    )
    return Matches(matches.first, matches.second, first, second, matches.on_face, matches.std_px)


def compare_rehearsal(prediction: Prediction, rehearsal: Rehearsal) -> Compared:
    """Predicted beside achieved uncertainty of every point of the structure.

    Parameters
    ----------
    prediction
        Of the plan.
    rehearsal
        Of the same plan.
    """
    plan, found = prediction.laid.plan, rehearsal.displacement
    expected = {str(axis): one.amplitude_mm for axis, one in plan.motion.by_axis.items()}
    # Without the two distances, or without cameras, nothing is said along the structure's axes.
    if found is None or found.attrs["frame"] != "structure":
        lost = tuple(
            ComparedAxis(one.point, one.axis, one.expanded_mm, float("nan"), float("nan"), 0.0)
            for one in prediction.axes
        )
        return Compared(lost, rehearsal.status, expected)
    achieved = state_axes(found, [point.name for point in plan.moving], plan.still_s)
    errors = found["displacement"] - rehearsal.truth["displacement"].interp(time=found["time"])
    moves = found["time"].values >= plan.still_s + prediction.laid.motion.onset_s
    rows = []
    for before, after in zip(prediction.axes, achieved, strict=True):
        of_axis = {"point": before.point, "axis": before.axis}
        ok = moves & (found["status"].sel(point=before.point).values == Status.OK)
        error = errors.sel(of_axis).values[ok]
        stated = found["expanded_uncertainty"].sel(of_axis).values[ok]
        rows.append(
            ComparedAxis(
                before.point, before.axis, before.expanded_mm, after.expanded_mm, _rms(error),
                float(np.mean(np.abs(error) <= stated)) if error.size else 0.0,
            )
        )  # fmt: skip
    return Compared(tuple(rows), rehearsal.status, expected)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
