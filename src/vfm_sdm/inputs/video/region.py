"""Regions of interest: the one place that maps pixels of a region or a resized canvas to full-image pixels."""

import math
from dataclasses import dataclass, replace
from operator import index
from typing import Self, TypeVar, cast

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, LumaArray, as_float_array
from vfm_sdm.errors import DatasetError

__all__ = ["Region"]

_WHOLE_PIXEL_TOLERANCE = 1e-6
_Image = TypeVar("_Image", bound=LumaArray)


@dataclass(frozen=True)
class Region:
    """A rectangle of the full image, possibly resized to a canvas.

    Parameters
    ----------
    x, y
        Column and row of its top-left pixel in the full image [px].
    width, height
        Size in the full image [px].
    scale_u, scale_v
        Canvas pixels per full-image pixel along each axis [1]; the canvas has a whole number of pixels.

    Raises
    ------
    DatasetError
        A size or scale is not positive, a pixel number is not whole, or the canvas would have a broken pixel.

    Notes
    -----
    Pixel centres have whole coordinates, so a pixel covers half a pixel to each side and resizing maps borders
    onto borders (half-pixel rule): ``canvas + 1/2 = scale (full - corner + 1/2)``. At a scale of one this is a
    plain shift.

    Examples
    --------
    >>> region = Region(100, 50, 40, 20, scale_u=0.5, scale_v=0.5)
    >>> region.from_full([100.5, 50.5]).tolist()
    [0.0, 0.0]
    """

    x: int
    y: int
    width: int
    height: int
    scale_u: float = 1.0
    scale_v: float = 1.0

    def __post_init__(self) -> None:
        for name in ("x", "y", "width", "height"):
            object.__setattr__(self, name, _whole(getattr(self, name), name))
        if self.width < 1 or self.height < 1:
            raise DatasetError(
                f"region: expected a width and height of at least 1 px, got {self.width} x {self.height}; enlarge it"
            )
        for name, length in (("scale_u", self.width), ("scale_v", self.height)):
            scale = float(getattr(self, name))
            object.__setattr__(self, name, scale)
            if not (math.isfinite(scale) and scale > 0):
                raise DatasetError(f"{name}: expected a positive number, got {scale}; give canvas pixels per pixel")
            size = length * scale
            if round(size) < 1 or abs(size - round(size)) > _WHOLE_PIXEL_TOLERANCE:
                raise DatasetError(
                    f"{name}: expected a canvas of whole pixels, got {length} x {scale} = {size}; "
                    "use canvas size / region size"
                )

    @property
    def canvas_size(self) -> tuple[int, int]:
        """Width and height of what `crop` returns [px]."""
        return round(self.width * self.scale_u), round(self.height * self.scale_v)

    @classmethod
    def around(cls, point: npt.ArrayLike, size: int | tuple[int, int], image_size: tuple[int, int]) -> Self:
        """The region of a given size centred on a point, shifted where it would leave the image.

        Parameters
        ----------
        point
            Centre, shape (2,) [px], inside the image.
        size
            Side, or width and height [px]. An odd size is centred on the nearest pixel.
        image_size
            Width and height of the full image [px].

        Raises
        ------
        DatasetError
            The point is not finite or lies outside the image, or the region is larger than the image.

        Examples
        --------
        >>> Region.around([100.2, 3.0], 21, (640, 480)).y
        0
        """
        centre = as_float_array(point, "point", (2,))
        sides = size if isinstance(size, tuple) else (size, size)
        corner = []
        for value, side, length, name in zip(centre, sides, image_size, ("width", "height"), strict=True):
            if _whole(side, name) > length:
                raise DatasetError(
                    f"region {name}: expected at most the image's {length} px, got {side} px; use a smaller region"
                )
            # Half a pixel beyond the outer centres is still image.
            if not -0.5 <= value <= length - 0.5:
                raise DatasetError(
                    f"point: expected a place inside the image of {image_size[0]} x {image_size[1]} px, got "
                    f"{centre.tolist()}; check the point or treat it as outside"
                )
            first = math.floor(value - (side - 1) / 2 + 0.5)
            corner.append(min(max(first, 0), length - side))
        return cls(corner[0], corner[1], sides[0], sides[1])

    def within(self, outer: "Region") -> "Region":
        """The same region in the pixels of a picture that another region, which is not resized, cuts out.

        Parameters
        ----------
        outer
            The region that was cut out of the full image [px].

        Examples
        --------
        >>> inner = Region(110, 60, 20, 10).within(Region(100, 50, 40, 30))
        >>> inner.x, inner.y
        (10, 10)
        """
        return replace(self, x=self.x - outer.x, y=self.y - outer.y)

    def check_inside(self, image_size: tuple[int, int]) -> None:
        """Refuse a region that leaves the image.

        Parameters
        ----------
        image_size
            Width and height of the full image [px].

        Raises
        ------
        DatasetError
            The region leaves the image.
        """
        columns, rows = image_size
        if self.x < 0 or self.y < 0 or self.x + self.width > columns or self.y + self.height > rows:
            raise DatasetError(
                f"region: expected to lie inside the image of {columns} x {rows} px, got columns {self.x} to "
                f"{self.x + self.width - 1} and rows {self.y} to {self.y + self.height - 1}; shift it (Region.around)"
            )

    def crop(self, image: _Image) -> _Image:
        """The region of a full image.

        Parameters
        ----------
        image
            Full image, shape (height, width) or, in colour, (height, width, 3). The result has its type; without
            resizing, it is a view into it.

        Returns
        -------
        part
            Shape (canvas height, canvas width) or, in colour, (canvas height, canvas width, 3).

        Raises
        ------
        DatasetError
            The image has another shape, or the region leaves it.

        Notes
        -----
        Shrinking averages the covered area, enlarging interpolates linearly; both follow the half-pixel rule.

        Examples
        --------
        >>> image = np.arange(12, dtype=np.uint8).reshape(3, 4)
        >>> Region(1, 0, 2, 2).crop(image).tolist()
        [[1, 2], [5, 6]]
        """
        if image.ndim != 2 and image.shape[2:] != (3,):
            raise DatasetError(
                f"image: expected shape (height, width) or (height, width, 3), got {image.shape}; pass one picture"
            )
        self.check_inside((image.shape[1], image.shape[0]))
        part = image[self.y : self.y + self.height, self.x : self.x + self.width]
        if self.canvas_size == (self.width, self.height):
            return cast("_Image", part)
        shrinks = self.scale_u <= 1 and self.scale_v <= 1
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        return cast("_Image", cv2.resize(np.ascontiguousarray(part), self.canvas_size, interpolation=method))

    def to_full(self, points2d: npt.ArrayLike) -> FloatArray:
        """Full-image pixels of canvas pixels.

        Parameters
        ----------
        points2d
            Pixels of the canvas, shape (..., 2) [px].

        Returns
        -------
        points2d
            Pixels of the full image, shape (..., 2) [px].

        Raises
        ------
        DatasetError
            The points have another shape.

        Examples
        --------
        >>> Region(100, 50, 40, 20, scale_u=0.5, scale_v=0.5).to_full([0.0, 0.0]).tolist()
        [100.5, 50.5]
        """
        points = as_float_array(points2d, "points2d", (-1, 2))
        return (points + 0.5) / self._scale - 0.5 + self._corner

    def from_full(self, points2d: npt.ArrayLike) -> FloatArray:
        """Canvas pixels of full-image pixels.

        Parameters
        ----------
        points2d
            Pixels of the full image, shape (..., 2) [px].

        Returns
        -------
        points2d
            Pixels of the canvas, shape (..., 2) [px].

        Raises
        ------
        DatasetError
            The points have another shape.

        Examples
        --------
        >>> Region(100, 50, 40, 20, scale_u=0.5, scale_v=0.5).from_full([100.5, 50.5]).tolist()
        [0.0, 0.0]
        """
        points = as_float_array(points2d, "points2d", (-1, 2))
        return (points - self._corner + 0.5) * self._scale - 0.5

    @property
    def _corner(self) -> FloatArray:
        return np.array([self.x, self.y], dtype=np.float64)

    @property
    def _scale(self) -> FloatArray:
        return np.array([self.scale_u, self.scale_v])


def _whole(value: object, name: str) -> int:
    try:
        return index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise DatasetError(f"region {name}: expected a whole number of pixels, got {value!r}; round it") from error
