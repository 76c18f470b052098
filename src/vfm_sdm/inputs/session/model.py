"""The frozen models behind ``session.toml``; unknown keys are refused.

Lengths are metres; pixels follow the convention that the centre of the top-left pixel is (0, 0), order u (right),
v (down). A `Session` reports all its faults at once as one `SessionError`; its parts, built alone in Python, raise
pydantic's ``ValidationError`` (a ``ValueError``).
"""

from collections.abc import Mapping, Sequence
from datetime import timedelta
from glob import escape
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    Strict,
    ValidationError,
    model_serializer,
    model_validator,
)

from vfm_sdm.core.datasets import START
from vfm_sdm.core.sensor_datasets import ACCELERATION_UNITS, SensorUnits
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.faults import cross_faults, field_faults, repeated_names
from vfm_sdm.inputs.session.grid import Grid
from vfm_sdm.inputs.session.lens import Lens
from vfm_sdm.inputs.session.method import Method, table_paths
from vfm_sdm.inputs.session.narrow import narrow
from vfm_sdm.inputs.session.recording_fields import Files, Instant, Interval, count_from
from vfm_sdm.inputs.session.report import Report
from vfm_sdm.inputs.session.site import NO_LETTERS, Entry, Name, Number, Pixel, Positive, Readings, Site

__all__ = ["Chessboard", "Grid", "Point", "Sensor", "Session", "View"]

_Count = Annotated[int, Strict(), Field(ge=3)]
# Becomes a netCDF group and part of a file name. Not made of `Name`: of two `Field`s on one type, pydantic before 2.12
# takes over the default that another field of that type has.
_PLAIN = rf"[^/\\{NO_LETTERS}]"
_ViewName = Annotated[str, Field(min_length=1, pattern=rf"^{_PLAIN}*[^/\\.\s{NO_LETTERS}]{_PLAIN}*$")]
_FrameNumber = Annotated[int, Strict(), Field(ge=0)]
_Since = Annotated[float, Strict(), Field(ge=0, le=1e9)]
_PathField = Annotated[Path, PlainSerializer(lambda path: path.as_posix(), return_type=str)]


class View(Readings):
    """One camera's recording: a ``video``, or ``images`` (a glob pattern) with ``fps``; and what was read at it."""

    name: _ViewName
    video: Files = None
    """A file, a pattern of the chapters of one recording, or their list in the order in which they were recorded."""
    images: Name | None = None
    fps: Positive | None = None
    """Frames a second of an image sequence [Hz]."""
    capture_fps: Positive | None = None
    """Frames a second that the camera took, where a video is stored at another rate: slow motion, time lapse [Hz]."""
    use_s: Interval = None
    """Interval of the recording that is measured from its first frame on, [from] or [from, to] [s]; also times."""
    lens: Lens | None = None
    camera: _PathField | None = None
    """File with the known camera, own TOML or OpenCV YAML."""
    time_offset_s: Number | None = None
    """How much later this view's first frame was taken than the reference view's first frame [s]; roughly, where the
    motion gives it exactly (`Method.synchronization`). 0 counts as stated, nothing does not."""
    time_offset_std_s: Positive | None = None
    """Standard deviation of that [s]; it decides between peaks where the motion alone cannot."""
    start: Instant | None = None
    """When the first frame was taken, with its offset from UTC: another way to state the time offset."""

    @model_validator(mode="before")
    @classmethod
    def _count_interval(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping) and "use_s" in fields:
            return {**fields, "use_s": count_from(fields.get("start"), fields["use_s"])}
        return fields

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.video is None) == (self.images is None):
            found = "neither" if self.video is None else "both"
            raise ValueError(f"expected either video or images, got {found}; give exactly one of them")
        if self.images is not None and self.fps is None:
            raise ValueError("fps: expected frames a second for images, got nothing; add fps = 30.0 or what is true")
        if self.video is not None and self.fps is not None:
            raise ValueError(
                "fps: expected none beside a video, whose own time stamps are used; remove fps, or state capture_fps "
                "for slow motion"
            )
        if self.images is not None and self.capture_fps is not None:
            raise ValueError("capture_fps: expected none beside images, whose fps is their rate; set fps to it")
        return self

    @property
    def interval_s(self) -> tuple[float, float | None]:
        """Interval that is measured, from the recording's first frame [s]; ``None`` stands for its end."""
        from_s, *to_s = self.use_s or (0.0,)
        return from_s, to_s[0] if to_s else None


class Point(Entry):
    """A point to measure, named and placed in a frame of one view: the first, or one in which it has come into view."""

    name: Name
    view: Name
    pixel: Pixel
    static: bool = False
    """Whether it must not move (on the abutment or in the background); used for checks and camera motion."""
    pixel_in: dict[str, Pixel] = Field(default_factory=dict)
    """Positions in other views, by view name, at the same time, where the search must not decide [px]."""
    frame: _FrameNumber | None = None
    """Number of the view's frame in which the point is named, from the first one that is used."""
    time_s: _Since | None = None
    """Another way to state it: time of that frame on the view's own clock, from the same first frame [s]."""

    @model_validator(mode="after")
    def _one_frame(self) -> Self:
        if self.frame is not None and self.time_s is not None:
            raise ValueError(
                f"expected frame or time_s, got both ({self.frame} and {self.time_s:g}); keep one: each says in which "
                "frame the point is named"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_first(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # What says nothing leaves no trace, so that hashes of sessions stay as they were before these fields came.
        fields: dict[str, Any] = dump(self)
        return {key: value for key, value in fields.items() if value is not None or key not in ("frame", "time_s")}

    @property
    def comes_later(self) -> bool:
        """Whether it is named in another frame than the first one."""
        return bool(self.frame or self.time_s)


class Sensor(Entry):
    """A reference sensor's recording and the point it sits at."""

    name: Name
    file: _PathField
    point: Name | None = None
    columns: dict[Literal["time", "lateral", "vertical", "longitudinal"], Name] = Field(default_factory=dict)
    """Column of the file for ``time`` and for each axis; a leading ``-`` before an axis' column reverses its sign."""
    units: SensorUnits | None = None
    """Of acceleration or of displacement; those that the file's header states when left out."""
    sampling_rate_hz: Positive | None = None
    start: Instant | None = None
    """When the first sample was taken, with its offset from UTC."""
    use_as_scale: bool = False
    """Whether this accelerometer says how large motions are: a length standard for the cameras."""
    scale_std: Positive | None = None
    """Relative standard deviation of its sensitivity [1]."""

    @model_validator(mode="after")
    def _complete_scale(self) -> Self:
        if not self.use_as_scale:
            if self.scale_std is not None:
                raise ValueError(
                    "scale_std: expected use_as_scale = true beside it, got none; add it or remove scale_std"
                )
            return self
        lacking = {
            "scale_std": (self.scale_std, "how well its sensitivity is known, such as scale_std = 0.01"),
            "point": (self.point, "the point that it sits at"),
        }
        faults = [
            f"{name}: expected {what}, got nothing; add it" for name, (value, what) in lacking.items() if value is None
        ]
        if self.units not in ACCELERATION_UNITS:
            got = f"{self.units!r}" if self.units else "none"
            faults.append(
                f"units: expected those of acceleration ({', '.join(ACCELERATION_UNITS)}), got {got}; state them"
            )
        if faults:
            raise ValueError(f"use_as_scale: {'; '.join(faults)}")
        return self

    @model_serializer(mode="wrap")
    def _without_scale(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # As of a point: hashes of sessions stay as they were before these fields came.
        fields: dict[str, Any] = dump(self)
        if not self.use_as_scale:
            fields = {key: value for key, value in fields.items() if key not in ("use_as_scale", "scale_std")}
        return fields


class Chessboard(Entry):
    """Calibration pictures of one chessboard: ``images`` (a glob pattern a view), or a file of ready ``corners``."""

    pattern: tuple[_Count, _Count]
    """Inner corners along a row and along a column."""
    square_mm: Positive
    images: dict[str, str] | None = None
    corners: _PathField | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.images is None) == (self.corners is None):
            found = "neither" if self.images is None else "both"
            raise ValueError(f"expected either images or corners, got {found}; give exactly one of them")
        return self


class Session(Entry):
    """A measurement session; the first view is the reference.

    Raises
    ------
    SessionError
        Names every fault of every field at once, one a line.
    """

    name: Name
    view: Annotated[tuple[View, ...], Field(min_length=1)]
    site: Site = Site()
    point: tuple[Point, ...] = ()
    """None where they are still to be found; nothing can be measured then, see `check_points`."""
    grid: tuple[Grid, ...] = ()
    """Many more points on the structure's face, which are found with the cameras that the others gave."""
    sensor: tuple[Sensor, ...] = ()
    method: Method = Method()
    chessboard: Chessboard | None = None
    baseline_visit: _PathField | None = None
    """Run folder of an earlier visit to the same structure, since which rest positions may have changed."""
    report: Report | None = None
    """What a report says beside the results, which do not depend on it."""
    folder: Path = Field(default=Path(), exclude=True)
    """Where relative paths start: the folder of the session's file. Not written to it."""

    def __init__(self, **fields: Any) -> None:
        # Cross checks look at the raw fields, so that they are reported together with faulty fields.
        faults: list[str] = []
        try:
            super().__init__(**fields)
        except ValidationError as error:
            faults += field_faults(error, type(self), fields)
        faults += cross_faults(fields)
        if faults:
            raise SessionError("\n".join(faults))

    @model_serializer(mode="wrap")
    def _without_what_says_nothing(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # As of a point: keys and hashes of sessions without them stay as they were before they came.
        fields: dict[str, Any] = dump(self)
        return {key: value for key, value in fields.items() if value or key not in ("report", "grid")}

    @classmethod
    def partial_faults(cls, fields: Mapping[str, Any]) -> list[str]:
        """What is wrong with a part of a session, in sentences, apart from what is missing.

        Parameters
        ----------
        fields
            Raw content of a file.
        """
        faults = repeated_names(fields)
        try:
            Entry.__init__(cls.__new__(cls), **fields)
        except ValidationError as error:
            faults = field_faults(error, cls, fields, partial=True) + faults
        return faults

    @property
    def scale_sensors(self) -> tuple[Sensor, ...]:
        """Accelerometers that say how large motions are."""
        return tuple(sensor for sensor in self.sensor if sensor.use_as_scale)

    @property
    def reference_view(self) -> View:
        """The first view, whose camera defines the reference frame and whose first frame defines time zero."""
        return self.view[0]

    def check_points(self) -> None:
        """Refuses a session without points, which can be looked at but not measured.

        Raises
        ------
        SessionError
            It names no point.
        """
        if not self.point:
            raise SessionError(
                "point: expected at least 1, got 0; add a [[point]], or let `vfm-sdm points suggest` find the best "
                "places without a click"
            )

    def stated_offset_s(self, view: View) -> float | None:
        """How much later a view begins than the reference view [s]; ``None`` where the session does not say.

        Both begin with what is used of their recordings.
        """
        first, stated_s = self.reference_view.start, view.time_offset_s
        if view.start is not None and first is not None:
            stated_s = (view.start - first).total_seconds()
        return None if stated_s is None else stated_s + self.later_use_s(view)

    def begins_s(self, view: View) -> float:
        """How much later a view begins than the reference view, as stated; where nothing is, recordings begin together.

        In seconds.
        """
        stated_s = self.stated_offset_s(view)
        return self.later_use_s(view) if stated_s is None else stated_s

    def later_use_s(self, view: View) -> float:
        """How much later than in the reference view's recording the interval that is used begins [s]."""
        return view.interval_s[0] - self.reference_view.interval_s[0]

    @property
    def start_attrs(self) -> dict[str, str]:
        """When time is zero, as an attribute of datasets; nothing where the session does not say."""
        first = self.reference_view
        return (
            {} if first.start is None else {START: (first.start + timedelta(seconds=first.interval_s[0])).isoformat()}
        )

    @property
    def resolved_method(self) -> Method:
        """The method with paths as seen from here: a relative one starts at the session's folder."""
        network, sfm = self.method.network, self.method.sfm
        # Names of checkpoints have no suffix, and a name of the matcher's hub is no folder.
        if network.weights and Path(network.weights).suffix:
            network = network.model_copy(update={"weights": str(self.resolve(Path(network.weights).expanduser()))})
        if sfm.model and self.resolve(sfm.model).is_dir():
            sfm = sfm.model_copy(update={"model": str(self.resolve(sfm.model))})
        tables = {
            name: table.model_copy(update={key: self.resolve(path) for key, path in table_paths(table).items()})
            for name, table in self.method.tables.items()
        }
        return self.method.model_copy(update={"network": network, "sfm": sfm, **tables})

    def narrowed(self, reads: Sequence[str]) -> Self:
        """The session with the named fields alone, as `vfm_sdm.inputs.session.narrow` explains."""
        return narrow(self, reads, always=("folder",))

    def as_fields(self) -> dict[str, Any]:
        """Its fields as plain tables, as JSON holds them."""
        return self.model_dump(mode="json", warnings=False)

    def resolve(self, path: Path | str) -> Path:
        """The path as seen from here: a relative one starts at the session's folder."""
        return self.folder / path

    def resolve_pattern(self, pattern: str) -> str:
        """The glob pattern as seen from here; wildcard characters in the session's folder are taken literally."""
        return str(Path(escape(str(self.folder))) / pattern)
