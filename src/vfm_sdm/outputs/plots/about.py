"""What every figure of a run says of it: session, date, verdict, positive directions, static points."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from vfm_sdm.core.datasets import START
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit import Audit

__all__ = ["About", "describe_run", "positive_direction"]

_POSITIVE: Mapping[str, Mapping[str, str]] = {
    "structure": {
        "lateral": "away from the reference camera",
        "vertical": "down",
        "longitudinal": "along the structure, to the left for one who faces it from the camera",
    },
    "reference camera": {"right": "to its right", "down": "down", "forward": "away from it"},
    "image plane": {"right": "to the right of the picture", "down": "down in the picture"},
}


def positive_direction(frame: str, axis: str) -> str:
    """In which direction displacement along an axis is positive, in words; empty where nobody says.

    Parameters
    ----------
    frame
        Frame of the displacement, such as ``structure``.
    axis
        Name of the axis.

    Examples
    --------
    >>> positive_direction("structure", "vertical")
    'down'
    """
    return _POSITIVE.get(frame, {}).get(axis, "")


@dataclass(frozen=True, eq=False)
class About:
    """What figures say beside their data.

    Parameters
    ----------
    session
        Name of the session.
    static
        Names of the points that must not move.
    audit
        Checks and verdict; ``None`` where there are none.
    start
        When time is zero (ISO 8601); empty where nobody says.
    """

    session: str = ""
    static: frozenset[str] = frozenset()
    audit: Audit | None = None
    start: str = ""

    @property
    def line(self) -> str:
        """Session, date and verdict in one line; empty where none is known.

        Examples
        --------
        >>> About("footbridge", start="2026-05-04T12:30:00+00:00").line
        'footbridge, 2026-05-04 12:30 UTC'
        """
        date = "date not stated" * bool(self.session)
        if self.start:
            date = f"{datetime.fromisoformat(self.start):%Y-%m-%d %H:%M %Z}"
        verdict = "" if self.audit is None else f"verdict: {self.audit.verdict}"
        return ", ".join(part for part in (self.session, date, verdict) if part)

    def named(self, point: str) -> str:
        """The point's name, with what it is where it must not move.

        Parameters
        ----------
        point
            Name of the point.

        Examples
        --------
        >>> About(static=frozenset({"pier"})).named("pier")
        'pier (static)'
        """
        return f"{point} (static)" if point in self.static else point


def describe_run(session: Session, audit: Audit | None) -> About:
    """What the figures of a run say of it.

    Parameters
    ----------
    session
        What is measured: its name, its static points, and when its reference view began.
    audit
        Checks and verdict; ``None`` where there are none.
    """
    static = frozenset(point.name for point in session.point if point.static)
    return About(session.name, static, audit, session.start_attrs.get(START, ""))
