"""Drawings as SVG: lines, bands, texts, and panels with axes and grid; text is escaped, and numbers are short."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, unbroken_runs
from vfm_sdm.outputs.report.language import Language, count_decimals

__all__ = ["WIDTH", "Drawing", "Letters", "Panel", "nice_ticks", "shorten", "span_of"]

WIDTH = 720.0
"""Width of all drawings; on paper a unit is a quarter of a millimetre."""
_TEXT = 11.5
_INK, _GRID = "#222222", "#d8d8d8"
_NO_LETTERS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_LETTER = 0.56
"""Width of a letter over its height, about."""


class Letters(TypedDict, total=False):
    """How a text is written: which end lies at its place (``start``, ``middle``, ``end``), height and colour.

    ``halo`` is the colour of an edge around the letters, before pictures; ``turned`` text runs upwards.
    """

    anchor: str
    size: float
    colour: str
    bold: bool
    halo: str
    turned: bool


@dataclass
class Drawing:
    """An SVG drawing that grows.

    Parameters
    ----------
    height
        Its height.
    label
        What it shows, for readers who do not see it.
    width
        Its width.
    """

    height: float
    label: str
    width: float = WIDTH
    _parts: list[str] = field(default_factory=list)

    def line(self, points: npt.ArrayLike, colour: str = _INK, *, width: float = 1.0, dash: str = "") -> None:
        """A line through points.

        Parameters
        ----------
        points
            Corners, shape (N, 2).
        colour, width
            Of the line.
        dash
            Lengths of dashes and gaps.
        """
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<polyline points="{_corners(points)}" fill="none" stroke="{colour}" stroke-width="{width:g}"'
            f' stroke-linejoin="round"{dashes}/>'
        )

    def area(self, points: npt.ArrayLike, colour: str, *, opacity: float = 1.0, edge: str = "none") -> None:
        """A filled area.

        Parameters
        ----------
        points
            Its corners, shape (N, 2).
        colour, opacity, edge
            Of its inside, and the colour of its edge.
        """
        self._parts.append(
            f'<polygon points="{_corners(points)}" fill="{colour}" fill-opacity="{opacity:g}" stroke="{edge}"/>'
        )

    def dot(self, place: npt.ArrayLike, radius: float, colour: str, *, filled: bool = True) -> None:
        """A disc, or a circle.

        Parameters
        ----------
        place, radius
            Its place, shape (2,), and size.
        colour, filled
            Its colour, and whether it is a disc.
        """
        x, y = np.asarray(place, dtype=float)
        fill = colour if filled else "none"
        self._parts.append(
            f'<circle cx="{_short(x)}" cy="{_short(y)}" r="{radius:g}" fill="{fill}" stroke="{colour}"'
            ' stroke-width="1.2"/>'
        )

    def text(self, x: float, y: float, text: str, **letters: Unpack[Letters]) -> None:
        """Text, on its baseline.

        Parameters
        ----------
        x, y
            Its place.
        text
            What it says.
        letters
            How it is written, see `Letters`.
        """
        anchor, size = letters.get("anchor", "start"), letters.get("size", _TEXT)
        halo, colour = letters.get("halo", ""), letters.get("colour", _INK)
        style = ' font-weight="bold"' if letters.get("bold") else ""
        turn = f' transform="rotate(-90 {_short(x)} {_short(y)})"' if letters.get("turned") else ""
        begin = f'<text x="{_short(x)}" y="{_short(y)}" font-size="{size:g}" text-anchor="{anchor}"{style}{turn}'
        shown = _escape(text)
        if halo:
            self._parts.append(f'{begin} fill="none" stroke="{halo}" stroke-width="3">{shown}</text>')
        self._parts.append(f'{begin} fill="{colour}">{shown}</text>')

    def arrow(self, start: npt.ArrayLike, end: npt.ArrayLike, colour: str, *, width: float = 1.8) -> None:
        """An arrow.

        Parameters
        ----------
        start, end
            Its ends, shape (2,).
        colour, width
            Of the arrow.
        """
        a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        length = float(np.linalg.norm(b - a))
        if length == 0:
            return
        along = (b - a) / length
        across = np.array([-along[1], along[0]])
        head = min(8.0, 0.6 * length)
        self.line([a, b - 0.7 * head * along], colour, width=width)
        self.area([b, b - head * (along + 0.4 * across), b - head * (along - 0.4 * across)], colour)

    def picture(self, data: str, x: float, y: float, width: float, height: float) -> None:
        """A picture inside the drawing.

        Parameters
        ----------
        data
            Its ``data:`` address.
        x, y, width, height
            Its place and size.
        """
        self._parts.append(
            f'<image href="{data}" x="{_short(x)}" y="{_short(y)}" width="{_short(width)}" height="{_short(height)}"/>'
        )

    def svg(self) -> str:
        """The element ``<svg>``."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_short(self.width)} {_short(self.height)}"'
            f' role="img" aria-label="{_escape(self.label)}" font-family="Helvetica, Arial, sans-serif">'
            f"{''.join(self._parts)}</svg>"
        )


@dataclass(frozen=True)
class Panel:
    """A rectangle of a drawing with a scale along each side.

    Parameters
    ----------
    drawing
        The drawing.
    box
        Left, top, right and bottom edge.
    x_range, y_range
        Values at left and right, and at bottom and top edge.
    language
        How numbers are written.
    """

    drawing: Drawing
    box: tuple[float, float, float, float]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    language: Language

    def place(self, x: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Places of values, shape (N, 2).

        Parameters
        ----------
        x, y
            Values, shape (N,).
        """
        left, top, right, bottom = self.box
        (x0, x1), (y0, y1) = self.x_range, self.y_range
        across = left + (np.asarray(x, dtype=float) - x0) / (x1 - x0) * (right - left)
        down = bottom - (np.asarray(y, dtype=float) - y0) / (y1 - y0) * (bottom - top)
        return np.stack(np.broadcast_arrays(across, down), axis=-1)

    def frame(self, *, x_label: str = "", y_label: str = "", x_numbers: bool = True, y_ticks: int = 4) -> None:
        """Grid, numbers and labels.

        Parameters
        ----------
        x_label, y_label
            What the scales show.
        x_numbers
            Whether the lower scale has numbers.
        y_ticks
            About how many numbers stand at the left, if any.
        """
        left, top, right, bottom = self.box
        draw = self.drawing
        xs = nice_ticks(*self.x_range, about=max(int((right - left) / 70), 2))
        ys = nice_ticks(*self.y_range, y_ticks) if y_ticks else []
        for ticks, upright in ((xs, True), (ys, False)):
            decimals = count_decimals(ticks[1] - ticks[0], 1) if len(ticks) > 1 else 1
            for value in ticks:
                x, y = self.place([value if upright else self.x_range[0]], [self.y_range[0] if upright else value])[0]
                draw.line([[x, bottom], [x, top]] if upright else [[left, y], [right, y]], _GRID, width=0.6)
                shown = self.language.write(value, decimals)
                if upright and x_numbers:
                    draw.text(x, bottom + 13, shown, anchor="middle", size=10)
                elif not upright:
                    draw.text(left - 5, y + 3.5, shown, anchor="end", size=10)
        draw.line([[left, top], [left, bottom], [right, bottom]], "#888888", width=0.8)
        if x_label:
            draw.text((left + right) / 2, bottom + 27, x_label, anchor="middle", size=10.5)
        if y_label:
            draw.text(left - 44, (top + bottom) / 2, y_label, anchor="middle", size=10.5, turned=True)

    def curve(self, x: FloatArray, lowest: FloatArray, highest: FloatArray, colour: str, *, width: float = 0.9) -> None:
        """A line that goes up and down in every column, broken where there is no value.

        Parameters
        ----------
        x, lowest, highest
            Columns and their limits, shape (C,).
        colour, width
            Of the line.
        """
        for run in unbroken_runs(np.isfinite(lowest)):
            corners = np.stack([self.place(x[run], lowest[run]), self.place(x[run], highest[run])], axis=1)
            once = np.abs(corners[:, 0, 1] - corners[:, 1, 1]) < 0.05
            flat = [row[:1] if single else row for row, single in zip(corners, once, strict=True)]
            points = np.concatenate(flat)
            if len(points) == 1:
                self.drawing.dot(points[0], 0.6, colour)
            else:
                self.drawing.line(points, colour, width=width)

    def band(self, x: FloatArray, lowest: FloatArray, highest: FloatArray, colour: str) -> None:
        """An area between limits, broken where there are none.

        Parameters
        ----------
        x, lowest, highest
            Columns and their limits, shape (C,).
        colour
            Of the area.
        """
        for run in unbroken_runs(np.isfinite(lowest) & np.isfinite(highest)):
            above, below = self.place(x[run], highest[run]), self.place(x[run], lowest[run])
            self.drawing.area(np.concatenate([above, below[::-1]]), colour, opacity=0.25)


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers between two limits.

    Parameters
    ----------
    low, high
        The limits.
    about
        About how many.

    Examples
    --------
    >>> nice_ticks(-0.9, 2.3, 3)
    [0.0, 1.0, 2.0]
    """
    if not (np.isfinite([low, high]).all() and high > low):
        return [low]
    rough = (high - low) / max(about, 1)
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(power * next(factor for factor in (1, 2, 5, 10) if factor * power >= 0.75 * rough))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(np.round(n * step, 12)) for n in range(first, last + 1)]


def shorten(text: str, room: float, size: float = _TEXT) -> str:
    """A text that fits a room of a drawing, with dots where it was too long.

    Parameters
    ----------
    text
        The text.
    room
        Width that it may have.
    size
        Height of its letters.

    Examples
    --------
    >>> shorten("a very long name of a point", 60.0)
    'a very l…'
    """
    most = max(int(room / (_LETTER * size)), 2)
    return text if len(text) <= most else text[: most - 1] + "…"


def span_of(values: Iterable[FloatArray], *, margin: float = 0.06) -> tuple[float, float]:
    """Lowest and highest of all values, with some room on either side; 1 wide where there is nothing to see.

    Parameters
    ----------
    values
        Arrays of any shape.
    margin
        Room as a share of the span.
    """
    known: Sequence[FloatArray] = [one[np.isfinite(one)] for one in values]
    joined = np.concatenate([one.ravel() for one in known]) if known else np.zeros(0)
    if not joined.size:
        return -0.5, 0.5
    low, high = float(joined.min()), float(joined.max())
    room = margin * (high - low) if high > low else 0.5 * max(abs(high), 1.0)
    return low - room, high + room


def _escape(text: str) -> str:
    """A text as XML, which has no letters for some codes."""
    return escape(_NO_LETTERS.sub("\ufffd", text))


def _corners(points: npt.ArrayLike) -> str:
    return " ".join(f"{_short(x)},{_short(y)}" for x, y in np.asarray(points, dtype=float))


def _short(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
