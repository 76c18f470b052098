"""Pixels of the same scene points in two views."""

from dataclasses import dataclass

from vfm_sdm.core.arrays import FloatArray, as_float_array
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

    Raises
    ------
    CameraError
        The two views are the same or negative, or the two arrays differ in length.
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

    def __len__(self) -> int:
        return len(self.points_first)
