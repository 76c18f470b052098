"""Named points of the site adjustment: where the views see them is a parameter with a prior."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Site
from vfm_sdm.stages.cameras.site_values import SitePoint

__all__ = ["PointParameters"]


class PointParameters:
    """Pixel errors of the named points in use: those that measurements on site refer to, and those on the face.

    Parameters
    ----------
    points
        Named points by name.
    site
        Ranges, lengths and rectangles, which refer to them.
    on_face
        Names of those on the face.
    views
        Number V of the views.

    Raises
    ------
    CameraError
        A range or length names a point without pixels.
    DatasetError
        A point has pixels for another number of views.

    Attributes
    ----------
    names
        Names of the P points in use.
    size
        Number of parameters, 2 V P.
    """

    def __init__(self, points: Mapping[str, SitePoint], site: Site, on_face: Sequence[str], views: int) -> None:
        for name, point in points.items():
            as_float_array(point.pixels, f"point {name!r}", (views, 2))
        wanted = [r.point for r in site.range]
        for length in site.length:
            wanted += list(length.points)
        for number, rectangle in enumerate(site.rectangle, start=1):
            wanted += rectangle.corner_names(number)
        missing = sorted({name for name in wanted if name not in points})
        if missing:
            raise CameraError(
                f"site: expected pixels in every view for points {missing}, got none; check that they were found"
            )
        self.names = sorted({*wanted, *on_face})
        chosen = [points[name] for name in self.names]
        self._pixels = np.array([one.pixels for one in chosen])
        self._std_px = np.array([one.std_px for one in chosen])
        self.per_point = 2 * views
        self.size = self.per_point * len(self.names)
        self._last: tuple[FloatArray, Rig | None, FloatArray] = (np.empty(0), None, np.empty((0, 3)))

    def triangulate(self, part: FloatArray, rig: Rig) -> dict[str, FloatArray]:
        """Points in the reference camera's frame, shape (3,) each [m].

        Parameters
        ----------
        part
            Whitened pixel errors, shape (size,) [1].
        rig
            Cameras.
        """
        if not self.names:
            return {}
        # Axes move no point: most derivatives ask for the same ones again.
        last_part, last_rig, places = self._last
        if rig is not last_rig or not np.array_equal(part, last_part):
            places = self._triangulate_all(part.reshape(self._std_px.shape), rig)
            self._last = (part.copy(), rig, places)
        return self._named(places)

    def triangulate_shifted(self, part: FloatArray, rig: Rig, step: float) -> Iterator[dict[str, FloatArray]]:
        """Points as they are, then with one pixel error after the other larger by a step.

        Parameters
        ----------
        part, rig
            As of `triangulate`.
        step
            Change of a whitened pixel error [1].

        Yields
        ------
        points
            As of `triangulate`, once and then for each of the `size` parameters.
        """
        # An error moves its own point alone: the same one of all points is shifted in one go.
        shifts = np.concatenate([np.zeros((1, self.per_point)), step * np.eye(self.per_point)])
        shifted = part.reshape(self._std_px.shape) + shifts.reshape(-1, 1, *self._std_px.shape[1:])
        base, *moved = self._triangulate_all(shifted, rig)
        yield self._named(base)
        for point in range(len(self.names)):
            for places in moved:
                points = base.copy()
                points[point] = places[point]
                yield self._named(points)

    def _triangulate_all(self, errors: FloatArray, rig: Rig) -> FloatArray:
        """Points with whitened pixel errors, shape (..., P, V, 2) [1], shape (..., P, 3) [m]."""
        return triangulate(np.moveaxis(self._pixels + self._std_px * errors, -2, 0), rig)

    def _named(self, places: FloatArray) -> dict[str, FloatArray]:
        return dict(zip(self.names, places, strict=True))
