"""``plan.json`` and ``plan.png``: everything that is said of a plan, in an output folder."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomli_w

from vfm_sdm.core.files import write_file, write_json
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.threads import small_algebra
from vfm_sdm.errors import ResultsError
from vfm_sdm.studies.planning.advice import Advice, list_advice, view_angles
from vfm_sdm.studies.planning.drawing import draw_site
from vfm_sdm.studies.planning.plan import Plan
from vfm_sdm.studies.planning.positions import Positions, optimise_positions
from vfm_sdm.studies.planning.prediction import Prediction, predict
from vfm_sdm.studies.planning.rehearsal import Compared, compare_rehearsal, rehearse_films
from vfm_sdm.studies.planning.shares import Share, list_shares

__all__ = ["PlanReport", "RecordingSize", "list_recordings", "study_plan", "write_report"]

_PLACE = ("perpendicular_m", "longitudinal_m", "height_m")


@dataclass(frozen=True, eq=False)
class PlanReport:
    """Everything that is said of a plan.

    Parameters
    ----------
    prediction
        Uncertainty of every point and axis.
    shares
        Of all sources, the largest first.
    advice
        What would help, most first.
    positions
        Best places of the cameras; ``None`` where the plan names no area.
    rehearsal
        The plan measured from films, beside its prediction; ``None`` where that was not asked for.
    """

    prediction: Prediction
    shares: tuple[Share, ...]
    advice: tuple[Advice, ...]
    positions: Positions | None = None
    rehearsal: Compared | None = None

    @property
    def limiting(self) -> str:
        """Name of the source that limits most."""
        return self.shares[0].source


@dataclass(frozen=True)
class RecordingSize:
    """Field of view and size of a camera's recording.

    Parameters
    ----------
    camera
        Its name.
    view_deg
        Horizontal field of view [deg].
    frames
        Number of frames.
    megabytes
        Size of the file [MB]; NaN where the bit rate is not stated.
    """

    camera: str
    view_deg: float
    frames: int
    megabytes: float


def study_plan(plan: Plan, *, films: Path | None = None, progress: Progress | None = None) -> PlanReport:
    """Prediction, shares and advice of a plan, and what else it asks for.

    Parameters
    ----------
    plan
        The plan; where it names an area, the best places in it are looked for.
    films
        Folder for films of the site, which are then measured by the program; ``None`` for none.
    progress
        Called with what is being done.

    Raises
    ------
    SessionError
        Two cameras do not see every point of the structure, or nowhere in the area do they.
    """
    with small_algebra():
        prediction = predict(plan)
        shares = tuple(list_shares(prediction))
        advice = tuple(list_advice(prediction, progress=progress))
        positions = None if plan.area is None else optimise_positions(prediction, plan.area, progress=progress)
    rehearsal = None
    if films is not None:
        rehearsal = compare_rehearsal(prediction, rehearse_films(prediction.laid, films, progress=progress))
    return PlanReport(prediction, shares, advice, positions, rehearsal)


def list_recordings(plan: Plan, view_deg: list[float]) -> list[RecordingSize]:
    """Size of every camera's recording.

    Parameters
    ----------
    plan
        The plan.
    view_deg
        Horizontal field of view of every camera [deg].
    """
    return [
        RecordingSize(
            one.name,
            angle,
            plan.frames,
            float("nan") if one.bitrate_mbit_s is None else one.bitrate_mbit_s * plan.duration_s / 8,
        )
        for one, angle in zip(plan.camera, view_deg, strict=True)
    ]


def write_report(folder: Path, report: PlanReport) -> list[Path]:
    """Writes ``plan.json``, ``plan.png`` and ``plan.toml``, of better places ``best.png`` and ``best.toml``, too.

    Earlier ones are replaced only when the new ones are complete.

    Parameters
    ----------
    folder
        Output folder; made when absent.
    report
        What is said of the plan.

    Raises
    ------
    ResultsError
        The folder cannot be written to.
    """
    prediction, plan = report.prediction, report.prediction.laid.plan
    table: dict[str, Any] = {
        "name": plan.name,
        "plan": plan.model_dump(mode="json", exclude_none=True),
        "relative_uncertainty": prediction.relative,
        "camera_status": str(prediction.adjusted.status),
        "points": _by_point(prediction),
        "shares": {one.source: one.share for one in report.shares},
        "limiting": report.limiting,
        "advice": [{"what": one.sentence, "left": one.left} for one in report.advice],
        "recordings": [asdict(one) for one in list_recordings(plan, view_angles(prediction.laid))],
        "notes": list(prediction.adjusted.notes),
    }
    drawn = {"plan": prediction}
    if (positions := report.positions) is not None:
        places = {one.name: dict(zip(_PLACE, one.place, strict=True)) for one in positions.plan.camera}
        table["positions"] = {"left": positions.left, "tried": positions.tried, "cameras": places}
        drawn["best"] = positions.prediction
    if (rehearsal := report.rehearsal) is not None:
        table["rehearsal"] = {
            "camera_status": rehearsal.status,
            "ratio": rehearsal.ratio,
            "error_ratio": rehearsal.error_ratio,
            "inside": rehearsal.inside,
            "axes": [asdict(one) for one in rehearsal.axes],
        }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = [write_json(folder / "plan.json", table, label="plan")]
        for name, one in drawn.items():
            written.append(write_file(folder / f"{name}.png", draw_site(one.laid)))
            fields = one.laid.plan.model_dump(mode="json", exclude_none=True)
            written.append(write_file(folder / f"{name}.toml", tomli_w.dumps(fields)))
    except OSError as error:
        raise ResultsError(f"{folder}: expected a folder to write to, got: {error}; choose another") from error
    return written


def _by_point(prediction: Prediction) -> dict[str, dict[str, Any]]:
    points: dict[str, dict[str, Any]] = {}
    for one in prediction.axes:
        figures = asdict(one)
        del figures["point"], figures["axis"]
        points.setdefault(one.point, {})[one.axis] = figures
    return points
