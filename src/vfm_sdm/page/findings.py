"""What was found out about the points so far: what each is worth in a view, and where it is; and that as a drawing."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from vfm_sdm.outputs.results import Worth
from vfm_sdm.page.sight import Counterpart, Subset

__all__ = ["LIGHTS", "Findings"]

LIGHTS = {
    Worth.GOOD: "#2e7d32", Worth.PART: "#9ccc65", Worth.EDGE: "#f9a825", Worth.UNKNOWN: "#9e9e9e",
    Worth.REFUSED: "#c62828",
}  # fmt: skip
"""Colours of what a point is worth."""
_NOT_LOOKED = "#ffffff"
_FOUND = ("ok", "named")
_ARM_PX = 3


class Findings:
    """Findings by point; those of a point that was moved or removed since are not shown.

    Examples
    --------
    >>> found, point = Findings(), {"name": "mid", "view": "left", "pixel": [1.0, 2.0]}
    >>> found.add_counterparts(point, {"right": Counterpart((3.0, 4.0), "ok")})
    >>> found.places([point], "right")
    {'mid': (3.0, 4.0)}
    >>> found.places([{**point, "pixel": [1.5, 2.0]}], "right")
    {}
    """

    def __init__(self) -> None:
        self._subsets: dict[tuple[str, float, float], Subset] = {}
        self._elsewhere: dict[tuple[Any, ...], dict[str, Counterpart]] = {}

    def add_subset(self, view: str, pixel: tuple[float, float], subset: Subset) -> None:
        """Keeps what a pixel is worth.

        Parameters
        ----------
        view, pixel
            The view, and the place in it [px].
        subset
            What it is worth.
        """
        self._subsets[view, *pixel] = subset

    def subset(self, view: str, pixel: Sequence[float]) -> Subset | None:
        """What a pixel is worth; ``None`` where nobody looked yet.

        Parameters
        ----------
        view, pixel
            The view, and the place in it [px].
        """
        return self._subsets.get((view, float(pixel[0]), float(pixel[1])))

    def add_counterparts(self, point: Mapping[str, Any], found: dict[str, Counterpart]) -> None:
        """Keeps where a point is in the other views.

        Parameters
        ----------
        point
            Its table in the session.
        found
            Its places, by view.
        """
        self._elsewhere[_key(point)] = found

    def counterparts(self, point: Mapping[str, Any]) -> dict[str, Counterpart]:
        """Where a point is in the other views; nothing where nobody looked since it was moved.

        Parameters
        ----------
        point
            Its table in the session.
        """
        return self._elsewhere.get(_key(point), {})

    def places(self, points: Sequence[Mapping[str, Any]], view: str) -> dict[str, tuple[float, float]]:
        """Where points are in a view, named or found [px], by name.

        Parameters
        ----------
        points
            Their tables in the session.
        view
            The view.
        """
        found = {}
        for point in points:
            there = self.counterparts(point).get(view)
            named = point["pixel"] if point["view"] == view else point.get("pixel_in", {}).get(view)
            if named is not None:
                found[point["name"]] = (float(named[0]), float(named[1]))
            elif there is not None and there.pixel is not None:
                found[point["name"]] = there.pixel
        return found

    def light(self, points: Sequence[Mapping[str, Any]], view: str, name: str) -> tuple[str, str]:
        """Colour of what a point is worth in a view, and that in words.

        Parameters
        ----------
        points
            Tables of all points.
        view, name
            The view, and the point.
        """
        at = self.places(points, view).get(name)
        subset = None if at is None else self.subset(view, at)
        if subset is None:
            return _NOT_LOOKED, f"{view}: not looked at yet"
        return LIGHTS[subset.worth], f"{view}: {subset.words}"

    def describe(self, point: Mapping[str, Any]) -> str:
        """A point's places and worth, in a sentence.

        Parameters
        ----------
        point
            Its table in the session.
        """
        at = point["pixel"]
        own = self.subset(point["view"], at)
        said = [f"{point['view']} ({at[0]:.1f}, {at[1]:.1f}): {own.words if own else '...'}"]
        for view, one in self.counterparts(point).items():
            place = "" if one.pixel is None else f" ({one.pixel[0]:.1f}, {one.pixel[1]:.1f})"
            advice = "" if one.status in _FOUND else "; choose it, then 'place the chosen point' and click it there"
            said.append(f"{view}{place}: {one.status}{advice}")
        return " · ".join(said)

    def draw(
        self, points: Sequence[Mapping[str, Any]], view: str, *, size: tuple[int, int], chosen: str, area: str = ""
    ) -> str:
        """Subsets at their true size, points and the chosen point's epipolar line, as SVG over the view's picture.

        Parameters
        ----------
        points
            Tables of all points.
        view
            The view.
        size
            Width and height of its picture [px].
        chosen
            Name of the chosen point.
        area
            More to draw, as SVG.
        """
        marks = [area]
        for point in points:
            there = self.counterparts(point).get(view)
            if point["name"] == chosen and there is not None and len(there.line) > 1:
                corners = " ".join(f"{u:.1f},{v:.1f}" for u, v in there.line)
                marks.append(
                    f'<polyline points="{corners}" fill="none" stroke="#4fc3f7" stroke-width="1.5" '
                    'stroke-dasharray="6 4"/>'
                )
        for name, (u, v) in self.places(points, view).items():
            subset = self.subset(view, (u, v))
            colour = LIGHTS[subset.worth] if subset else _NOT_LOOKED
            half = subset.side_px / 2 if subset else 0.0
            thick = 4 if name == chosen else 2
            marks.append(
                f'<g class="vs-point" data-point="{escape(name)}" fill="none" stroke="{colour}" stroke-width="{thick}">'
                f'<rect x="{u - half}" y="{v - half}" width="{2 * half}" height="{2 * half}"/>'
                f'<path class="vs-mark" d="M{u - _ARM_PX} {v}h{2 * _ARM_PX}M{u} {v - _ARM_PX}v{2 * _ARM_PX}"/>'
                f'<text x="{u + half + 2}" y="{v - half - 2}">{escape(name)}</text></g>'
            )
        box = f"-0.5 -0.5 {size[0]} {size[1]}"
        return f'<svg viewBox="{box}" preserveAspectRatio="none">{"".join(marks)}</svg>'


def _key(point: Mapping[str, Any]) -> tuple[Any, ...]:
    """What a search in the other views begins with."""
    named = tuple((view, *place) for view, place in sorted(point.get("pixel_in", {}).items()))
    return point["view"], *point["pixel"], named, bool(point.get("static"))
