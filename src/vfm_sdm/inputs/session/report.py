"""What a report says of a measurement beside its results: the table ``[report]`` of a session."""

from datetime import date, datetime
from typing import Annotated

from pydantic import BeforeValidator, Field

from vfm_sdm.inputs.session.site import NO_LETTERS, Entry, Name

__all__ = ["Report"]


def _day(value: object) -> object:
    """A date as TOML or text has it; pydantic would take numbers for seconds since 1970."""
    if isinstance(value, datetime):
        return value.date()
    if not isinstance(value, str | date):
        raise ValueError(f"expected a date such as 2026-11-20, got {value!r}; correct it")  # noqa: TRY004
    return value


_LINES = rf"([^{NO_LETTERS}]|[\t\n])*"
_Text = Annotated[str, Field(min_length=1, pattern=rf"^{_LINES}[^\s{NO_LETTERS}]{_LINES}$")]
_Day = Annotated[date, BeforeValidator(_day)]


class Report(Entry):
    """Words for the first page of a report; results do not depend on them."""

    client: Name | None = None
    project: Name | None = None
    place: Name | None = None
    date: _Day | None = None
    """Day of the recordings."""
    measured_by: Name | None = None
    cameras: Name | None = None
    """Cameras, lenses and tripods, in words."""
    weather: Name | None = None
    remarks: _Text | None = None
    """Anything else that a reader must know; may have several lines."""
