"""``plan.json`` and ``plan.png``: everything that is said of a plan, in an output folder."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from vfm_sdm.core.files import write_file, write_json
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import ResultsError
from vfm_sdm.studies.planning.advice import Advice, list_advice, view_angles
from vfm_sdm.studies.planning.drawing import draw_site
from vfm_sdm.studies.planning.plan import Plan
from vfm_sdm.studies.planning.prediction import Prediction, predict
from vfm_sdm.studies.planning.shares import Share, list_shares

__all__ = ["PlanReport", "list_recordings", "study_plan", "write_report"]


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
    """

    prediction: Prediction
    shares: tuple[Share, ...]
    advice: tuple[Advice, ...]

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


def study_plan(plan: Plan, *, progress: Progress | None = None) -> PlanReport:
    """Prediction, shares and advice of a plan.

    Parameters
    ----------
    plan
        The plan.
    progress
        Called with what is being done.

    Raises
    ------
    SessionError
        Two cameras do not see every point of the structure.
    """
    prediction = predict(plan)
    shares = tuple(list_shares(prediction))
    return PlanReport(prediction, shares, tuple(list_advice(prediction, progress=progress)))


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


def write_report(folder: Path, report: PlanReport, *, further: dict[str, Any] | None = None) -> list[Path]:
    """Writes ``plan.json`` and ``plan.png``; earlier ones are replaced only when the new ones are complete.

    Parameters
    ----------
    folder
        Output folder; made when absent.
    report
        What is said of the plan.
    further
        Further tables of ``plan.json``.

    Raises
    ------
    ResultsError
        The folder cannot be written to.
    """
    prediction, plan = report.prediction, report.prediction.laid.plan
    table = {
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
        **(further or {}),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        drawn = write_file(folder / "plan.png", draw_site(prediction.laid))
    except OSError as error:
        raise ResultsError(f"{folder}: expected a folder to write to, got: {error}; choose another") from error
    return [write_json(folder / "plan.json", table, label="plan"), drawn]


def _by_point(prediction: Prediction) -> dict[str, dict[str, Any]]:
    points: dict[str, dict[str, Any]] = {}
    for one in prediction.axes:
        figures = asdict(one)
        del figures["point"], figures["axis"]
        points.setdefault(one.point, {})[one.axis] = figures
    return points
