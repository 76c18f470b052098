"""Many points at once: a polygon on the structure's face, and how far apart points are wanted on it."""

from typing import Annotated

from pydantic import Field

from vfm_sdm.inputs.session.site import Entry, Name, Pixel, Positive

__all__ = ["Grid"]


class Grid(Entry):
    """Points on the structure's face at equal distances, named after the grid, their row and their column."""

    name: Name
    view: Name
    """The view in which the polygon was drawn."""
    polygon: Annotated[tuple[Pixel, ...], Field(min_length=3)]
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
