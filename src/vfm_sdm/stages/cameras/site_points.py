"""Named points of the site adjustment: where the views see them is a parameter with a prior."""

from collections.abc import Mapping, Sequence

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
        self._points = [points[name] for name in self.names]
        self.per_point = 2 * views
        self.size = self.per_point * len(self.names)

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
        errors = part.reshape(len(self.names), len(rig), 2)
        pixels = np.stack([one.pixels for one in self._points])
        pixels = pixels + np.stack([one.std_px for one in self._points]) * errors
        return dict(zip(self.names, triangulate(pixels.swapaxes(0, 1), rig), strict=True))
