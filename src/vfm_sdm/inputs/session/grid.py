"""Many points at once: a polygon on the structure's face, and how far apart points are wanted on it."""

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from vfm_sdm.inputs.session.site import Entry, Name, Pixel, Positive

__all__ = ["Grid"]

_LEAST_AREA_PX = 1.0


def _check_outline(corners: tuple[Pixel, ...]) -> tuple[Pixel, ...]:
    """A polygon whose edges do not cross, around an area."""
    begin = np.array(corners, np.float64)
    along = np.roll(begin, -1, axis=0) - begin

    def side(edge: int, corner: int) -> float:
        """On which side of an edge a corner lies: the sign; and how far, times the edge's length [px2]."""
        off = begin[corner % len(begin)] - begin[edge]
        return float(along[edge, 0] * off[1] - along[edge, 1] * off[0])

    for first in range(len(begin)):
        for second in range(first + 2, len(begin) - (first == 0)):
            apart = side(first, second) * side(first, second + 1), side(second, first) * side(second, first + 1)
            if max(apart) < 0:
                raise ValueError(
                    f"expected corners in order around the polygon, got edges {first + 1} and {second + 1} that cross; "
                    "change the order of the corners"
                )
    # Fans of triangles from the first corner.
    spokes = begin - begin[0]
    area = 0.5 * abs(float(np.sum(spokes[:-1, 0] * spokes[1:, 1] - spokes[:-1, 1] * spokes[1:, 0])))
    if area < _LEAST_AREA_PX:
        raise ValueError(f"expected corners around an area, got {area:.2g} px2; move the corners apart")
    return corners


class Grid(Entry):
    """Points on the structure's face at equal distances, named after the grid, their row and their column."""

    name: Name
    view: Name
    """The view in which the polygon was drawn."""
    polygon: Annotated[tuple[Pixel, ...], Field(min_length=3), AfterValidator(_check_outline)]
    """Corners in the first frame of that view, in order, shape (N, 2) [px]."""
    spacing_m: Positive
    """Distance between neighbours, along the structure and down its face [m]."""

    def point_name(self, row: int, column: int) -> str:
        """Name of one of its points; rows count downwards, columns along the structure, both from 1.

        Parameters
        ----------
        row, column
            Numbers of its row and column.

        Examples
        --------
        >>> corners = ((10.0, 10.0), (90.0, 10.0), (90.0, 40.0))
        >>> Grid(name="deck", view="left", polygon=corners, spacing_m=0.2).point_name(1, 7)
        'deck 01-07'
        """
        return f"{self.name} {row:02d}-{column:02d}"
