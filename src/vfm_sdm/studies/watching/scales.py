"""Millimetres a pixel at the points of a view, as far as it is known before anything is measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session, View
from vfm_sdm.inputs.video import CameraTags
from vfm_sdm.stages.cameras.priors import read_prior
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution
from vfm_sdm.stages.displacement.monocular import scale_factor

__all__ = ["PointScale", "find_places", "find_scales", "read_cameras"]

_FOCAL_STD = 0.15
"""Standard deviation of a focal length beyond which no millimetres are stated [1]."""


@dataclass(frozen=True)
class PointScale:
    """Millimetres a pixel at a point, in the plane through it that faces the camera.

    Parameters
    ----------
    mm_per_px
        The scale [mm/px].
    source
        What it comes from.
    """

    mm_per_px: float
    source: str


def read_cameras(path: Path) -> CameraSolution:
    """The cameras of an earlier run, and the places of its points.

    Parameters
    ----------
    path
        A run folder, or ``cameras.toml`` in it.

    Raises
    ------
    ResultsError
        There is no such file, or ``measure`` did not write it.
    """
    return read_solution(path / "cameras.toml" if path.is_dir() else path)[0]


def find_places(session: Session, view: View, earlier: CameraSolution | None) -> dict[str, FloatArray]:
    """Where points are in the first picture of a view, by name, each of shape (2,) [px]; not of those that come later.

    Parameters
    ----------
    session
        The session's pixels, which count first.
    view
        One of its views.
    earlier
        Cameras of an earlier run, which found the points in every view.
    """
    places = {}
    for point in (one for one in session.point if not one.comes_later):
        pixel = point.pixel if point.view == view.name else point.pixel_in.get(view.name)
        if pixel is not None:
            places[point.name] = np.array(pixel, np.float64)
        elif earlier is not None and {view.name} <= set(earlier.points["view"].values.tolist()):
            found = earlier.points["position"].sel(view=view.name)
            if point.name in found["point"].values and np.isfinite(found.sel(point=point.name)).all():
                places[point.name] = found.sel(point=point.name).values
    return places


def find_scales(
    session: Session,
    view: View,
    image_size: tuple[int, int],
    places: Mapping[str, FloatArray],
    earlier: CameraSolution | None,
) -> dict[str, PointScale]:
    """Millimetres a pixel of the points of which it is known, by name.

    Parameters
    ----------
    session
        The lens, and what was measured on site.
    view
        One of its views.
    image_size
        Width and height of its pictures [px].
    places
        Where points are in it, each of shape (2,) [px].
    earlier
        Cameras of an earlier run.

    Raises
    ------
    CameraError
        A camera file is of another image size.

    Notes
    -----
    In this order: depth over focal length of the cameras of an earlier run; the first ``site.length`` of a session of
    one view; distance over focal length, where the focal length is known to 15 %, of the point's own ``range`` from
    this camera, else of the face's distance (``perpendicular_distance`` with ``longitudinal_distance``, the depth of
    the middle of the picture). The scale is that of the plane that faces the camera: motion towards the camera is not
    seen.
    """
    found = _of_earlier(view, earlier, places)
    if not found and len(session.view) == 1 and session.site.length:
        return _of_length(session, places)
    camera = _known_camera(session, view, image_size)
    if camera is None:
        return found
    depths = _depths(session, view, camera, places)
    stated = {
        name: PointScale(1e3 * depth / camera.focal_px, f"{source} over focal length")
        for name, (depth, source) in depths.items()
    }
    return stated | found


def _of_earlier(view: View, earlier: CameraSolution | None, places: Mapping[str, FloatArray]) -> dict[str, PointScale]:
    if earlier is None or earlier.rig is None or view.name not in earlier.rig.names:
        return {}
    camera = earlier.rig.camera(view.name)
    positions = earlier.points["position"].sel(view=list(earlier.rig.names)).transpose("view", "point", "pixel").values
    points3d = triangulate(positions, earlier.rig)
    depth = (points3d @ camera.rotation.T + camera.translation)[:, 2]
    names = [str(name) for name in earlier.points["point"].values]
    return {
        name: PointScale(float(1e3 * z / camera.focal_px), "cameras of the earlier run")
        for name, z in zip(names, depth, strict=True)
        if name in places and z > 0
    }


def _of_length(session: Session, places: Mapping[str, FloatArray]) -> dict[str, PointScale]:
    length = session.site.length[0]
    ends = [places[name] for name in length.points]
    scale = PointScale(scale_factor(ends[0], ends[1], 1e3 * length.value), f"length {' - '.join(length.points)}")
    return dict.fromkeys(places, scale)


def _known_camera(session: Session, view: View, image_size: tuple[int, int]) -> Camera | None:
    """Intrinsics as the session states them; ``None`` where it does not, or not well enough."""
    if view.camera is None and view.lens is None:
        return None
    # What a live source says of its camera is nothing, and its pixels are square.
    camera, covariance, _ = read_prior(session, view.model_copy(update={"images": None}), image_size, 1.0, CameraTags())
    return camera if np.sqrt(covariance[0, 0]) <= _FOCAL_STD else None


def _depths(
    session: Session, view: View, camera: Camera, places: Mapping[str, FloatArray]
) -> dict[str, tuple[float, str]]:
    """Depth of points along the optical axis [m], and what it comes from."""
    first = session.reference_view.name
    read = session.site if view.name == first else view
    depths: dict[str, tuple[float, str]] = {}
    if read.perpendicular_distance is not None and read.longitudinal_distance is not None:
        depth = float(np.hypot(read.perpendicular_distance.value, read.longitudinal_distance.value))
        depths = dict.fromkeys(places, (depth, "distance of the face"))
    for one in session.site.range:
        if (one.view or first) == view.name and one.point in places:
            slope = camera.normalize(places[one.point])
            depths[one.point] = float(one.value / np.sqrt(1 + slope @ slope)), "range"
    return depths
