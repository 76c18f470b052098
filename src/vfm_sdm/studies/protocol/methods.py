"""The methods that the paper's protocol compares, and which of them can run here."""

from dataclasses import dataclass
from typing import Literal

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.availability import why_unavailable

__all__ = ["MONOCULAR", "OURS", "WITHOUT_SGR", "Comparison", "Method", "comparisons", "why_not"]

Refinement = Literal["none", "sgr"]


@dataclass(frozen=True)
class Method:
    """One way from recordings to displacement.

    Parameters
    ----------
    label
        As in the tables.
    tracker, cameras, refinement
        As in ``[method]`` of a session.
    """

    label: str
    tracker: str = "icgn"
    cameras: str = "two-view"
    refinement: Refinement = "none"

    @property
    def run_name(self) -> str:
        """Folder of its cameras and tracks; refinements share it."""
        return f"{self.tracker}+{self.cameras}"


@dataclass(frozen=True)
class Comparison:
    """Methods beside each other in one table.

    Parameters
    ----------
    name
        Of the table's files.
    title
        What is compared.
    methods
        Columns of the table.
    axes
        Axes that all methods measure.
    """

    name: str
    title: str
    methods: tuple[Method, ...]
    axes: tuple[str, ...] = ("vertical", "lateral")


OURS = Method("with SGR", refinement="sgr")
WITHOUT_SGR = Method("without SGR")
MONOCULAR = Method("monocular target tracking", tracker="template", cameras="none: scale factor, left view")
_NO_PICTURES = "the field tests hold no pictures of a chessboard"


def comparisons() -> tuple[Comparison, ...]:
    """The paper's four comparisons; methods that cannot run here are among them (`why_not`)."""
    return (
        Comparison("refinement", "with and without structural geometry refinement (SGR)", (WITHOUT_SGR, OURS)),
        Comparison("baseline", "stereo with SGR against monocular target tracking", (OURS, MONOCULAR), ("vertical",)),
        Comparison(
            "cameras",
            "camera parameter estimation, without SGR",
            (
                Method("two-view and site adjustment"),
                Method("known cameras", cameras="file"),
                Method("chessboard", cameras="chessboard"),
                Method("VGGT", cameras="vggt"),
                Method("SfM", cameras="sfm"),
            ),
        ),
        Comparison(
            "trackers",
            "point tracking, without SGR",
            (
                Method("icgn"),
                Method("template", tracker="template"),
                Method("VGGT", tracker="vggt"),
                Method("BootsTAPIR", tracker="tapir"),
                Method("VGGT + icgn", tracker="vggt+icgn"),
            ),
        ),
    )


def why_not(method: Method) -> str | None:
    """Why a method cannot run on the field tests here; ``None`` when it can."""
    if method == MONOCULAR:
        return None
    if method.cameras == "chessboard":
        return _NO_PICTURES
    try:
        return why_unavailable("trackers", method.tracker) or why_unavailable("cameras", method.cameras)
    except BackendUnavailableError as error:
        return str(error)
