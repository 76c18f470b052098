"""The command ``watch``: what a set-up shows before the real recording, on the terminal or as lines of JSON."""

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.options import name_values
from vfm_sdm.commands.terminal import OUT, note, plain_table, say_json
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.studies.watching.scales import read_cameras
from vfm_sdm.studies.watching.view import Light, PointNow, ViewNow
from vfm_sdm.studies.watching.watch import Watch, doubt_point, doubt_view

__all__ = ["draw_trace", "watch"]

_MINUTE_S = 60.0
_TRACE_CHARACTERS = 20
_ROOM_FOR_TRACE = 72
"""Columns of a terminal from which on it has room for traces."""
_BESIDE_POINTS = 8
"""Lines of a view beside those of its points."""
_BRAILLE = 0x2800
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of the dots of a Braille character, row by row."""
_COUNTS = ("came", "measured", "dropped", "while_choosing", "damaged", "before", "missing")
_VIEW_FIELDS = (
    "source",
    "state",
    "time_s",
    *_COUNTS,
    "rate_hz",
    "kept_hz",
    "latency_s",
    "worst_latency_s",
    "elsewhere",
)


@Parameter(name="*")
@dataclass(frozen=True)
class Times:
    """How long, and how often."""

    seconds: Annotated[float | None, Parameter(help="End after so many seconds.")] = None
    every: Annotated[float, Parameter(help="Seconds between two reports.")] = 1.0
    idle_s: Annotated[float, Parameter(help="A source that brings nothing new for so many seconds has ended.")] = 10.0

    def check(self) -> None:
        """Refuses times that are not positive.

        Raises
        ------
        SessionError
            One of them is not.
        """
        for name, value in {"--seconds": self.seconds, "--every": self.every, "--idle-s": self.idle_s}.items():
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SessionError(f"{name}: expected a positive number of seconds, got {value}; correct it")


_TIMES = Times()


def watch(
    session: Annotated[Path, Parameter(help="The session's file, with points; docs/watch.md.")],
    *,
    source: Annotated[
        tuple[str, ...],
        Parameter(
            help="VIEW=SOURCE, again for each view: a file that grows, an address (rtsp://...), a camera's number or "
            "/dev/video0. The session's video file else."
        ),
    ] = (),
    cameras: Annotated[
        Path | None, Parameter(help="An earlier run folder: its cameras give millimetres and points in every view.")
    ] = None,
    times: Times = _TIMES,
    json_lines: Annotated[
        bool, Parameter(name="--json", negative="", help="One JSON object a report, for programs.")
    ] = False,
) -> None:
    """Live check on site: what every point does now, light, rate and latency. Ctrl-C ends it."""
    times.check()
    settings = read_session(session, check_files=False)
    earlier = None if cameras is None else read_cameras(cameras)
    watched = Watch(settings, name_values(source, "--source"), earlier=earlier, idle_s=times.idle_s)
    began, reason = time.monotonic(), "every source has ended"
    with _told_to_end() as end, _display(json_lines=json_lines) as show, watched:
        while watched.running:
            left_s = np.inf if times.seconds is None else began + times.seconds - time.monotonic()
            if left_s <= 0:
                reason = f"{times.seconds:g} s are over"
                break
            if end.wait(min(times.every, left_s)):
                reason = "told to end"
                break
            show(time.monotonic() - began, watched.look())
    last = watched.look()
    if json_lines:
        _print_line(time.monotonic() - began, last, ended=reason)
        return
    OUT.print(_report(last))
    note(watched.notes)
    OUT.print(f"ended after {time.monotonic() - began:.1f} s: {reason}", highlight=False)


@contextmanager
def _told_to_end() -> Iterator[Event]:
    """An event that Ctrl-C and a polite ``kill`` set; a second one interrupts at once."""
    end = Event()

    def tell(*_: object) -> None:
        if end.is_set():
            raise KeyboardInterrupt
        end.set()

    before = {one: signal.signal(one, tell) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield end
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


@contextmanager
def _display(*, json_lines: bool) -> Iterator[Any]:
    """What shows a report: lines of JSON, or a table that changes; nothing where output is no terminal."""
    if json_lines:
        yield _print_line
    elif OUT.is_terminal:
        with Live(console=OUT, auto_refresh=False, transient=True) as live:
            yield lambda _, views: live.update(_report(views), refresh=True)
    else:
        yield lambda *_: None


def _report(views: Sequence[ViewNow]) -> Group:
    """Tables of all views."""
    lines = sum(_BESIDE_POINTS + 2 * len(view.points) for view in views)
    rows = 2 if lines <= OUT.height or not OUT.is_terminal else 1
    return Group(*(part for view in views for part in _report_view(view, rows)))


def _report_view(view: ViewNow, rows: int) -> Iterator[RenderableType]:
    yield Text(f"{view.name}: {view.source}, {view.state}", style="bold")
    if view.light is None:
        return
    choosing = f" ({view.while_choosing} before the first)" if view.while_choosing else ""
    yield Text(
        f" {_number(view.kept_hz, 1)} of {_number(view.rate_hz, 1)} pictures a second; "
        f"{_number(view.latency_s, 2)} s late, at most {_number(view.worst_latency_s, 2)}"
    )
    yield Text(f" {view.came - view.before} pictures came, {view.dropped} dropped{choosing}")
    light = view.light
    yield Text(f" light {light.mean:.0%}, white {light.saturated:.1%}, {light.change:+.0%} since the start")
    if all(one.motion is None for one in view.points):
        return
    yield _point_table(view.points, rows)
    scales = {one.scale.source for one in view.points if one.scale is not None}
    if scales:
        yield Text(f" mm from {' and '.join(sorted(scales))}; motion towards the camera is not seen")
    for point in view.points:
        if doubts := doubt_point(point):
            yield Text(f" {point.point.name}: {'; '.join(doubts)}", style="yellow")
    for doubt in doubt_view(view):
        yield Text(f" {doubt}", style="red")


def _point_table(points: Sequence[PointNow], rows: int) -> Table:
    table = plain_table()
    table.add_column(Text("point"), overflow="fold")
    for name in ("u, v px", "p-p px", "p-p mm", "S/N", "lost"):
        table.add_column(Text(name), justify="right", no_wrap=True)
    drawn = not OUT.options.ascii_only and OUT.width >= _ROOM_FOR_TRACE
    if drawn:
        table.add_column(Text("last minute"), no_wrap=True, overflow="crop")
    for one in points:
        motion = one.motion
        if motion is None:
            table.add_row(Text(one.point.name), *["-"] * 5, *[""] * drawn)
            continue
        scale = np.nan if one.scale is None else one.scale.mm_per_px
        cells = [
            " ".join(_number(value, 2, sign="+") for value in motion.now_px),
            _number(motion.peak_px, 2),
            _number(motion.peak_px * scale, 2),
            _number(motion.signal_to_noise, 0),
            f"{motion.lost:.0%}",
        ]
        trace = [draw_trace(motion.time_s, motion.trace_px, _TRACE_CHARACTERS, rows)] * drawn
        style = "yellow" if doubt_point(one) else ""
        table.add_row(Text(one.point.name), *cells, *trace, style=style)
    return table


def _number(value: float, digits: int, sign: str = "") -> str:
    return f"{value:{sign}.{digits}f}" if np.isfinite(value) else "-"


def draw_trace(time_s: FloatArray, values: FloatArray, columns: int, rows: int) -> str:
    """The last minute of a signal in Braille dots, upwards in the picture: from the least to the largest at each time.

    Parameters
    ----------
    time_s
        Times, increasing, shape (T,) [s].
    values
        The signal, positive downwards as v is, shape (T,); NaN where it is not known, which leaves a gap.
    columns, rows
        Characters that it takes.

    Examples
    --------
    >>> print(draw_trace(np.linspace(0, 60, 400), np.sin(np.linspace(0, 6.28, 400)), 8, 2))
    ⠀⠀⠀⠀⡴⠋⠙⢦
    ⠳⣄⣠⠞⠀⠀⠀⠀
    """
    wide, high = 2 * columns, 4 * rows
    dots = np.zeros((high, wide), np.bool_)
    known = np.isfinite(values) & (time_s > time_s[-1] - _MINUTE_S)
    if known.any():
        column = ((time_s[known] - time_s[-1]) / _MINUTE_S * wide + wide - 1e-6).astype(int).clip(0)
        low, span = values[known].min(), np.ptp(values[known])
        level = np.rint((values[known] - low) / (span or 1.0) * (high - 1)).astype(int)
        for one in np.unique(column):
            of_column = level[column == one]
            dots[of_column.min() : of_column.max() + 1, one] = True
    bits = np.array(_DOTS)
    cells = dots.reshape(rows, 4, columns, 2).transpose(0, 2, 1, 3)
    return "\n".join("".join(chr(_BRAILLE + int(bits[cell].sum())) for cell in line) for line in cells)


def _print_line(elapsed_s: float, views: Sequence[ViewNow], ended: str | None = None) -> None:
    """One report as a line of JSON."""
    line = {"elapsed_s": elapsed_s, "ended": ended, "views": {view.name: _view_fields(view) for view in views}}
    say_json(_plain(line))


def _view_fields(view: ViewNow) -> dict[str, Any]:
    fields = {name: getattr(view, name) for name in _VIEW_FIELDS}
    points = {one.point.name: _point_fields(one) for one in view.points}
    return fields | {"light": _light_fields(view.light), "doubts": doubt_view(view), "points": points}


def _light_fields(light: Light | None) -> dict[str, float] | None:
    return None if light is None else {name: getattr(light, name) for name in ("mean", "saturated", "change")}


def _point_fields(one: PointNow) -> dict[str, Any]:
    doubts = doubt_point(one)
    fields: dict[str, Any] = {"trusted": not doubts, "doubts": doubts, "light": _light_fields(one.light)}
    if one.motion is None:
        return fields
    names = ("now_px", "rms_px", "peak_px", "noise_px", "signal_to_noise", "along", "samples", "lost", "unreliable")
    fields |= {name: getattr(one.motion, name) for name in names}
    if one.scale is not None:
        scale = one.scale.mm_per_px
        fields |= {"mm_per_px": scale, "scale_source": one.scale.source, "now_mm": one.motion.now_px * scale}
        fields |= {"peak_mm": one.motion.peak_px * scale, "rms_mm": one.motion.rms_px * scale}
    return fields


def _plain(value: Any) -> Any:
    """Values as JSON has them: arrays as lists, and null for what is not a number."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
