"""The methods that the paper's protocol compares, and which of them can run here."""

from dataclasses import dataclass
from typing import Literal

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.availability import why_unavailable

__all__ = ["MONOCULAR", "WITHOUT_SGR", "WITH_SGR", "ComparedMethod", "Comparison", "comparisons", "why_not"]

Refinement = Literal["none", "sgr"]


@dataclass(frozen=True)
class ComparedMethod:
    """One way from recordings to displacement.

    Parameters
    ----------
    label
        Name in the tables.
    tracker, cameras, refinement
        Settings as in ``[method]`` of a session.
    """

    label: str
    tracker: str = "icgn"
    cameras: str = "two-view"
    refinement: Refinement = "none"

    @property
    def run_name(self) -> str:
        """Name of the folder of its cameras and tracks; refinements share it."""
        return f"{self.tracker}+{self.cameras}"


@dataclass(frozen=True)
class Comparison:
    """Methods that stand beside each other in one table.

    Parameters
    ----------
    name
        Name of the table's files.
    title
        What is compared.
    methods
        Columns of the table.
    axes
        Axes that all methods measure.
    """

    name: str
    title: str
    methods: tuple[ComparedMethod, ...]
    axes: tuple[str, ...] = ("vertical", "lateral")


WITH_SGR = ComparedMethod("with SGR", refinement="sgr")
WITHOUT_SGR = ComparedMethod("without SGR")
MONOCULAR = ComparedMethod("monocular target tracking", tracker="template", cameras="none: scale factor, left view")
_NO_PICTURES = "the field tests hold no pictures of a chessboard"


def comparisons() -> tuple[Comparison, ...]:
    """The paper's four comparisons; methods that cannot run here are among them (`why_not`)."""
    return (
        Comparison("refinement", "with and without structural geometry refinement (SGR)", (WITHOUT_SGR, WITH_SGR)),
        Comparison(
            "baseline", "stereo with SGR against monocular target tracking", (WITH_SGR, MONOCULAR), ("vertical",)
        ),
        Comparison(
            "cameras",
            "camera parameter estimation, without SGR",
            (
                ComparedMethod("two-view and site adjustment"),
                ComparedMethod("known cameras", cameras="file"),
                ComparedMethod("chessboard", cameras="chessboard"),
                ComparedMethod("VGGT", cameras="vggt"),
                ComparedMethod("PoseDiffusion", cameras="posediffusion"),
                ComparedMethod("SfM", cameras="sfm"),
            ),
        ),
        Comparison(
            "trackers",
            "point tracking, without SGR",
            (
                ComparedMethod("icgn"),
                ComparedMethod("template", tracker="template"),
                ComparedMethod("VGGT", tracker="vggt"),
                ComparedMethod("BootsTAPIR", tracker="tapir"),
                ComparedMethod("VGGT + icgn", tracker="vggt+icgn"),
            ),
        ),
    )


def why_not(method: ComparedMethod) -> str | None:
    """Reason why a method cannot run on the field tests here; ``None`` when it can.

    Parameters
    ----------
    method
        One of the methods of `comparisons`.

    Examples
    --------
    >>> why_not(WITH_SGR) is None, why_not(ComparedMethod("chessboard", cameras="chessboard"))
    (True, 'the field tests hold no pictures of a chessboard')
    """
    if method == MONOCULAR:
        return None
    if method.cameras == "chessboard":
        return _NO_PICTURES
    try:
        return why_unavailable("trackers", method.tracker) or why_unavailable("cameras", method.cameras)
    except BackendUnavailableError as error:
        return str(error)
