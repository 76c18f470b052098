"""What was measured on site: lengths and levels, each with its standard deviation; and what all tables share."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, model_validator

__all__ = [
    "NO_LETTERS",
    "Entry",
    "Length",
    "Level",
    "Lines",
    "Measured",
    "Name",
    "Number",
    "Pixel",
    "Positive",
    "Range",
    "Ratio",
    "Readings",
    "Rectangle",
    "SensedMotion",
    "Site",
    "not_below",
]

# Strict numbers, because pydantic would otherwise take "4.0" and true for numbers without a word.


def not_below(least: float) -> AfterValidator:
    """A bound of positive numbers, in the words of an error.

    Parameters
    ----------
    least
        Smallest number that is taken, in the unit of the field.
    """

    def check(value: float) -> float:
        if value < least:
            raise ValueError(f"expected at least {least:g}, got {value:g}; correct it")
        return value

    return AfterValidator(check)


# Letters that names and texts do not have: control characters, what is no character, which HTML and XML refuse, breaks
# of lines, and what turns the direction of the text behind it, such as the numbers of a report.
NO_LETTERS = r"\x00-\x1f\x7f-\x9f\x{2028}-\x{202e}\x{2066}-\x{2069}\x{fdd0}-\x{fdef}\x{fff9}-\x{fffb}" + "".join(
    rf"\x{{{plane:x}fffe}}\x{{{plane:x}ffff}}" for plane in range(17)
)

# Bounds that nothing on earth reaches: beyond them arithmetic overflows, and the number is a slip of the pen.
Number = Annotated[float, Strict(), Field(ge=-1e9, le=1e9)]
Positive = Annotated[float, Strict(), Field(gt=0, le=1e9), not_below(1e-9)]
_Metres = Annotated[float, Strict(), Field(ge=0, le=1e5)]
_PositiveMetres = Annotated[float, Strict(), Field(gt=0, le=1e5), not_below(1e-7)]
Name = Annotated[str, Field(min_length=1, pattern=rf"^[^{NO_LETTERS}]*[^\s{NO_LETTERS}][^{NO_LETTERS}]*$")]
_Degrees = Annotated[float, Strict(), Field(ge=-180, le=180)]
_PositiveDegrees = Annotated[float, Strict(), Field(gt=0, le=180), not_below(1e-6)]
_Coordinate = Annotated[Number, Field(ge=-0.5)]  # the image begins half a pixel before the first centre
Pixel = tuple[_Coordinate, _Coordinate]


class Entry(BaseModel):
    """A table of the session file: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Measured(Entry):
    """A length measured on site with its standard deviation [m]."""

    value: _Metres
    std: _PositiveMetres


def _not_zero(length: Measured) -> Measured:
    if length.value <= 0:
        raise ValueError(f"expected a length > 0 m, got {length.value:g}; measure it again")
    return length


Distance = Annotated[Measured, AfterValidator(_not_zero)]


class Level(Entry):
    """Inclination of a camera read from a spirit level.

    Pitch is the inclination of the optical axis, positive when the camera looks upwards; roll is the rotation about
    it, positive when the camera's right-hand side is lowered. ``value_deg`` stands for each that is not given.
    """

    value_deg: _Degrees = 0.0
    pitch_deg: _Degrees | None = None
    roll_deg: _Degrees | None = None
    std_deg: Annotated[float, Strict(), Field(gt=0, le=180), not_below(1e-6)]

    @property
    def pitch(self) -> float:
        """Inclination of the optical axis, positive upwards [deg]."""
        return self.value_deg if self.pitch_deg is None else self.pitch_deg

    @property
    def roll(self) -> float:
        """Rotation about the optical axis, positive with the right-hand side lowered [deg]."""
        return self.value_deg if self.roll_deg is None else self.roll_deg


class Readings(Entry):
    """What was read at a camera other than the reference camera; each of it helps to find its pose."""

    level: Level | None = None
    perpendicular_distance: Distance | None = None
    """Distance from this camera to the structure's face, at a right angle to it."""
    longitudinal_distance: Measured | None = None
    """Distance along the structure, from the foot of that perpendicular to the centre of this view."""
    stands: Literal["left", "right"] | None = None
    """On which side of the reference camera this one stands, for an observer who looks where that one looks."""


class Range(Entry):
    """Distance from a camera's optical centre to a point [m]; the reference view's camera when none is named."""

    point: Name
    view: Name | None = None
    value: _PositiveMetres
    std: _PositiveMetres


class Length(Entry):
    """Distance between two points [m]."""

    points: tuple[Name, Name]
    value: _PositiveMetres
    std: _PositiveMetres


class Lines(Entry):
    """How well the structure's straight edges keep its axes; their table says that edges are used."""

    out_of_square_std_deg: _PositiveDegrees = 1.0
    """Standard deviation of the angles between vertical, longitudinal and lateral edges from the right one."""
    out_of_plumb_std_deg: _PositiveDegrees = 1.0
    """Standard deviation of the structure's own level from the horizon, about each horizontal axis."""


class Ratio(Entry):
    """A ratio of two lengths with its standard deviation [1]."""

    value: Positive
    std: Positive


class Rectangle(Entry):
    """Four corners that are a rectangle, from the top left one clockwise: ``points``, or ``corners`` in two views."""

    points: tuple[Name, Name, Name, Name] | None = None
    """Names of points."""
    corners: dict[Name, tuple[Pixel, Pixel, Pixel, Pixel]] | None = None
    """Their pixels in the first frames, by view."""
    std_px: Positive = 1.5
    """Standard deviation of these pixels."""
    aspect: Ratio | None = None
    """Width over height."""
    out_of_square_std_deg: _PositiveDegrees = 1.0
    """Standard deviation of its angles from the right one."""

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.points is None) == (self.corners is None):
            found = "neither" if self.points is None else "both"
            raise ValueError(f"expected either points or corners, got {found}; give exactly one of them")
        if self.points is not None and len(set(self.points)) < len(self.points):
            raise ValueError(f"points: expected four different ones, got {list(self.points)}; name each corner once")
        if self.corners is not None and len(self.corners) < 2:
            raise ValueError(f"corners: expected two views, got {list(self.corners)}; add them in another one")
        return self

    def corner_names(self, number: int) -> tuple[str, ...]:
        """Names of its four corners.

        Parameters
        ----------
        number
            Its place among the rectangles, from 1.
        """
        return self.points or tuple(f"rectangle {number}, corner {corner}" for corner in range(1, 5))


class SensedMotion(Entry):
    """A motion whose size a sensor told; not of a session's file, but found from it (`Sensor.use_as_scale`)."""

    point: Name
    sensor: Name
    rest: dict[str, tuple[Number, Number]]
    """Pixels of the point at rest, by view."""
    moved: dict[str, tuple[Number, Number]]
    """Its pixels after a small motion along the axis that the sensor shows best, by view."""
    length: Positive
    """Length of that motion by the sensor [m]."""
    std: Positive
    """Its standard deviation [m]."""


class Site(Entry):
    """Lengths that a tape measure, a laser or the drawings gave, and level readings."""

    baseline: Distance | None = None
    """Distance between the optical centres of the first two views."""
    perpendicular_distance: Distance | None = None
    """Distance from the reference camera to the structure's face, at a right angle to it."""
    longitudinal_distance: Measured | None = None
    """Distance along the structure, from the foot of that perpendicular to the centre of the reference view."""
    structure_side: Literal["right", "left"] = "right"
    """Side of the reference camera on which the structure's face lies, for an observer looking where it looks."""
    face_offset_std: _PositiveMetres = 0.1
    """Standard deviation of the distance of points from the face whose distance was measured [m]."""
    reference_camera_level: Level | None = None
    range: tuple[Range, ...] = ()
    length: tuple[Length, ...] = ()
    rectangle: tuple[Rectangle, ...] = ()
    lines: Lines | None = None
    """Straight edges of the structure as observations; they are not used when left out."""
    motion: tuple[SensedMotion, ...] = Field(default=(), exclude=True)
    """What sensors say of the size of motions; found, and not written to the session's file."""

    @model_validator(mode="after")
    def _both_distances(self) -> Self:
        if (self.perpendicular_distance is None) != (self.longitudinal_distance is None):
            missing = "longitudinal" if self.longitudinal_distance is None else "perpendicular"
            raise ValueError(
                f"expected both distances or neither, got no {missing}_distance; "
                "add it, or remove the other and measure in the camera's axes"
            )
        return self
