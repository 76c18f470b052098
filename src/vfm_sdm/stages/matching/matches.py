"""Pixels of the same scene points in two views."""

from dataclasses import dataclass, field

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, as_float_array
from vfm_sdm.errors import CameraError

__all__ = ["Matches"]


@dataclass(frozen=True, eq=False)
class Matches:
    """Pixels of the same scene points in two views.

    Parameters
    ----------
    first, second
        Indices of the two views in the rig; they differ.
    points_first, points_second
        Full-image pixels in each view, shape (N, 2) each [px]; row i of both is the same scene point.
    on_face
        Whether each lies on the structure's face, shape (N,); none when left out.
    std_px
        Standard deviation of pixels that somebody pointed at [px]; 0 of features, whose errors the residuals show.

    Raises
    ------
    CameraError
        The two views are the same or negative, or the arrays differ in length.
    DatasetError
        An array is not of shape (N, 2).

    Examples
    --------
    >>> len(Matches(0, 1, [[10.0, 20.0]], [[12.0, 20.5]]))
    1
    """

    first: int
    second: int
    points_first: FloatArray
    points_second: FloatArray
    on_face: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    std_px: float = 0.0

    def __post_init__(self) -> None:
        if self.first == self.second or min(self.first, self.second) < 0:
            raise CameraError(
                f"matches: expected two different views, got {self.first} and {self.second}; "
                "give the index of each view in the rig"
            )
        for name in ("points_first", "points_second"):
            frozen = as_float_array(getattr(self, name), name, (None, 2)).copy()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)
        if len(self.points_first) != len(self.points_second):
            raise CameraError(
                f"matches: expected as many points in both views, got {len(self.points_first)} and "
                f"{len(self.points_second)}; keep only the points found in both"
            )
        if not self.on_face.size:
            object.__setattr__(self, "on_face", np.zeros(len(self), dtype=np.bool_))
        if self.on_face.shape != (len(self),):
            raise CameraError(
                f"matches: expected {len(self)} values of on_face, got {self.on_face.shape}; give one for each match"
            )

    def __len__(self) -> int:
        return len(self.points_first)

    def chosen(self, rows: IntArray | BoolArray) -> "Matches":
        """Matches of these rows.

        Parameters
        ----------
        rows
            Indices of the matches, shape (M,), or whether to take each, shape (N,).

        Examples
        --------
        >>> matches = Matches(0, 1, [[10.0, 20.0], [11.0, 21.0]], [[12.0, 20.5], [13.0, 21.5]])
        >>> matches.chosen(np.array([False, True])).points_first.tolist()
        [[11.0, 21.0]]
        """
        first, second = self.points_first[rows], self.points_second[rows]
        return Matches(self.first, self.second, first, second, self.on_face[rows], self.std_px)
