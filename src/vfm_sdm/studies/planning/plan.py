"""``PLAN.toml``: cameras, structure, motion and what will be measured, in the axes of the structure.

Places are given as somebody on site would: ``perpendicular_m`` is the distance from the structure's face, at a right
angle to it, on the cameras' side; ``longitudinal_m`` runs along the structure from its first support, to the left for
somebody who faces the structure; ``height_m`` is above any level, such as the ground's.
"""

import tomllib
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, Strict, ValidationError, model_validator

from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import Lens
from vfm_sdm.inputs.session.faults import field_faults
from vfm_sdm.inputs.session.site import Entry, Name, Number, Positive

__all__ = [
    "Area",
    "Measurements",
    "Motions",
    "Plan",
    "PlannedCamera",
    "PlannedLength",
    "PlannedPoint",
    "PlannedRange",
    "ReadingsAt",
    "Structure",
    "Vibration",
    "read_plan",
]

_Axis = Literal["lateral", "vertical", "longitudinal"]
_Pixels = Annotated[int, Strict(), Field(ge=16, le=100_000)]
_Share = Annotated[float, Strict(), Field(gt=0, le=1)]


class PlannedCamera(Entry):
    """Where a camera will stand, where it will look, and its lens; the first one is the reference."""

    name: Name
    perpendicular_m: Positive
    longitudinal_m: Number
    height_m: Number = 1.5
    looks_at: tuple[Number, Number] | None = None
    """Longitudinal and height of the place on the face that the picture's middle shows [m]; the middle of the points of
    the structure when left out."""
    image_size: tuple[_Pixels, _Pixels] = (3840, 2160)
    lens: Lens | None = None
    bitrate_mbit_s: Positive | None = None
    """Of the recording [Mbit/s]; it decides how large the file becomes and how much motion the codec loses."""

    @property
    def place(self) -> tuple[float, float, float]:
        """Perpendicular, longitudinal and height of its optical centre [m]."""
        return self.perpendicular_m, self.longitudinal_m, self.height_m


class Structure(Entry):
    """What is filmed: a face between two supports, and what lies behind it."""

    span_m: Positive
    bottom_m: Number
    """Height of the lower edge of the face [m]."""
    top_m: Number
    """Height of the upper edge of the face [m]."""
    face_offset_std_m: Positive = 0.1
    """Standard deviation of the distance of points from the face whose distance is measured [m]."""
    background_m: tuple[Positive, Positive] = (2.0, 15.0)
    """Nearest and farthest of what is seen behind the face, from the face [m]."""
    noise_px: Positive | None = None
    """Standard deviation of one frame's track [px]; from the contrast when left out."""
    contrast: Positive = 15.0
    """Standard deviation of the surface's texture [grey levels of 8 bits]."""

    @model_validator(mode="after")
    def _top_above_bottom(self) -> Self:
        if not self.top_m > self.bottom_m:
            raise ValueError(f"expected top_m above bottom_m, got {self.top_m:g} and {self.bottom_m:g} m; swap them")
        return self


class PlannedPoint(Entry):
    """A point to measure, or one that stands still (``static``)."""

    name: Name
    longitudinal_m: Number
    height_m: Number
    perpendicular_m: Number = 0.0
    """How far it stands out of the face, towards the cameras [m]; negative behind it."""
    static: bool = False


class Vibration(Entry):
    """Expected motion along an axis, at the middle of the span."""

    amplitude_mm: Positive
    frequency_hz: Positive


class Motions(Entry):
    """Expected motion along the axes of the structure."""

    lateral: Vibration | None = None
    vertical: Vibration | None = None
    longitudinal: Vibration | None = None

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.by_axis:
            raise ValueError(f"expected motion along one of {', '.join(STRUCTURE_AXES)}, got none; add one")
        return self

    @property
    def by_axis(self) -> dict[_Axis, Vibration]:
        """The expected motions by axis."""
        known: tuple[_Axis, ...] = ("lateral", "vertical", "longitudinal")
        return {axis: found for axis in known if (found := getattr(self, axis)) is not None}


class PlannedRange(Entry):
    """A distance from a camera to a point that will be measured; of the first camera when none is named."""

    point: Name
    view: Name | None = None
    std_m: Positive


class PlannedLength(Entry):
    """A length between two points that will be measured."""

    points: tuple[Name, Name]
    std_m: Positive


class ReadingsAt(Entry):
    """What will be read at a camera beside the first."""

    view: Name
    level_std_deg: Positive | None = None
    perpendicular_std_m: Positive | None = None
    longitudinal_std_m: Positive | None = None


class Measurements(Entry):
    """What will be measured on site, each with the standard deviation of its tool."""

    baseline_std_m: Positive = 0.01
    perpendicular_std_m: Positive = 0.02
    longitudinal_std_m: Positive = 0.05
    level_std_deg: Positive = 0.2
    """Of the first camera's spirit level [deg]."""
    pan_clip_std: _Share | None = None
    """Relative standard deviation of every focal length from a pan clip [1]; no pan clip when left out."""
    reading: tuple[ReadingsAt, ...] = ()
    range: tuple[PlannedRange, ...] = ()
    length: tuple[PlannedLength, ...] = ()


class Area(Entry):
    """Where cameras may stand: a rectangle before the structure."""

    perpendicular_m: tuple[Positive, Positive]
    """Nearest and farthest from the face [m]."""
    longitudinal_m: tuple[Number, Number]
    """First and last place along the structure [m]."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for name, (first, last) in (("perpendicular_m", self.perpendicular_m), ("longitudinal_m", self.longitudinal_m)):
            if not first < last:
                raise ValueError(f"{name}: expected the smaller one first, got {first:g} and {last:g} m; swap them")
        return self


class Plan(Entry):
    """A site as it is planned.

    Raises
    ------
    SessionError
        Names every fault of every field at once, one a line.

    Examples
    --------
    >>> camera = {"perpendicular_m": 8.0, "height_m": 1.5, "lens": {"focal_px": 4000.0}}
    >>> plan = Plan(
    ...     name="bridge",
    ...     structure={"span_m": 12.0, "bottom_m": 1.0, "top_m": 2.0},
    ...     camera=[{"name": name, "longitudinal_m": at, **camera} for name, at in (("left", 6.0), ("right", 2.0))],
    ...     point=[{"name": "middle", "longitudinal_m": 6.0, "height_m": 1.5}],
    ...     motion={"vertical": {"amplitude_mm": 5.0, "frequency_hz": 2.0}},
    ... )
    >>> plan.frames, plan.camera[0].name
    (600, 'left')
    """

    name: Name
    structure: Structure
    camera: Annotated[tuple[PlannedCamera, ...], Field(min_length=2)]
    point: Annotated[tuple[PlannedPoint, ...], Field(min_length=1)]
    motion: Motions
    measured: Measurements = Measurements()
    fps: Positive = 30.0
    duration_s: Positive = 20.0
    still_s: Positive = 1.0
    """How long the structure is at rest at first [s]."""
    synchronization: Literal["motion", "none"] = "motion"
    time_offset_std_s: Positive | None = None
    """Standard deviation with which the cameras' starts are known [s], for ``synchronization = "none"``."""
    area: Area | None = None
    """Where the best places of the cameras are looked for."""
    folder: Path = Field(default=Path(), exclude=True)
    """Where relative paths of lenses start: the folder of the plan's file. Not written to it."""

    def __init__(self, **fields: Any) -> None:
        faults: list[str] = []
        try:
            super().__init__(**fields)
        except ValidationError as error:
            faults += field_faults(error, type(self), fields)
        else:
            faults += list(_cross_faults(self))
        if faults:
            raise SessionError("\n".join(faults))

    @property
    def frames(self) -> int:
        """Number of frames of each recording."""
        return round(self.duration_s * self.fps)

    @property
    def moving(self) -> tuple[PlannedPoint, ...]:
        """The points of the structure."""
        return tuple(point for point in self.point if not point.static)


def read_plan(path: Path | str) -> Plan:
    """The plan in a TOML file.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    SessionError
        The file is missing or is not TOML, or lists every fault in it, one a line.
    """
    source = Path(path)
    try:
        fields = tomllib.loads(source.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError as error:
        raise SessionError(f"{source}: expected a plan, got no such file; check the path") from error
    except OSError as error:
        raise SessionError(f"{source}: expected a readable plan, got: {error.strerror}; check it") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SessionError(f"{source}: expected TOML in UTF-8, got: {error}; correct that line") from error
    if "folder" in fields:
        raise SessionError(f"{source}: folder: expected no such key, it is where the file lies; remove it")
    try:
        return Plan(**fields, folder=source.absolute().parent)
    except SessionError as error:
        lines = str(error).splitlines()
        head = f"{source}: " if len(lines) == 1 else f"{source}: {len(lines)} faults\n  "
        raise SessionError(head + "\n  ".join(lines)) from error


def _cross_faults(plan: Plan) -> Iterator[str]:
    """Contradictions between entries, one sentence each."""
    views, points = [one.name for one in plan.camera], [one.name for one in plan.point]
    for kind, names in (("camera", views), ("point", points)):
        for name in sorted({name for name in names if names.count(name) > 1}):
            yield f"{kind}: expected every name once, got {name!r} twice; rename one"
    for one, other in combinations(plan.camera, 2):
        if one.place == other.place:
            yield f"camera: expected cameras at different places, got {one.name!r} and {other.name!r} at one; move one"
    if not plan.moving:
        yield "point: expected a point of the structure, got static ones alone; add one"
    yield from _measured_faults(plan.measured, views, points)
    if not plan.still_s + 1 <= plan.duration_s:
        least = plan.still_s + 1
        yield f"duration_s: expected {least:g} s, a second more than still_s, got {plan.duration_s:g} s; extend it"
    for axis, vibration in plan.motion.by_axis.items():
        if not vibration.frequency_hz < plan.fps / 2:
            yield (
                f"motion.{axis}.frequency_hz: expected less than half of fps, {plan.fps / 2:g} Hz, got "
                f"{vibration.frequency_hz:g}; record faster"
            )


def _measured_faults(measured: Measurements, views: list[str], points: list[str]) -> Iterator[str]:
    """Readings of what is not planned."""
    for label, name in _names_of_points(measured):
        if name not in points:
            yield f"measured.{label}: expected one of the points {points}, got {name!r}; correct it"
    for label, view in _names_of_views(measured):
        if view not in views:
            yield f"measured.{label}: expected one of the cameras {views}, got {view!r}; correct it"
    for number, length in enumerate(measured.length, start=1):
        if length.points[0] == length.points[1]:
            yield f"measured.length[{number}]: expected two points, got {length.points[0]!r} twice; name the other end"
    if any(reading.view == views[0] for reading in measured.reading):
        yield f"measured.reading: expected a camera beside the first, got {views[0]!r}; state its stds in [measured]"


def _names_of_points(measured: Measurements) -> Iterator[tuple[str, str]]:
    for number, one in enumerate(measured.range, start=1):
        yield f"range[{number}].point", one.point
    for number, length in enumerate(measured.length, start=1):
        yield from ((f"length[{number}].points", name) for name in length.points)


def _names_of_views(measured: Measurements) -> Iterator[tuple[str, str]]:
    for number, one in enumerate(measured.range, start=1):
        if one.view is not None:
            yield f"range[{number}].view", one.view
    for number, reading in enumerate(measured.reading, start=1):
        yield f"reading[{number}].view", reading.view
