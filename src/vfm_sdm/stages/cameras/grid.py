"""Grids: many points on the structure's face, placed in all views by cameras that are known already.

Cameras and face say where a place of one view is seen in another to some pixels along a short line, so that hundreds of
points take no more than a registration each from a few starts on it. What all of them have in common, how far the
surface lies off the measured face, is learnt from those that are found at once.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import sampson_error, triangulate
from vfm_sdm.inputs.session import Grid, Session
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.correspondence import RETURN_PX
from vfm_sdm.stages.matching.detection import to_eight_bit
from vfm_sdm.stages.matching.face import Face, know_face
from vfm_sdm.stages.matching.pyramid import MIN_CORRELATION
from vfm_sdm.stages.registration.peaks import has_rival
from vfm_sdm.stages.registration.records import Registration, Starts
from vfm_sdm.stages.registration.subsets import register_subset

__all__ = ["add_grids"]

StatusArray = npt.NDArray[np.object_]

_MOST_POINTS = 2000
_MOST_NODES = 50 * _MOST_POINTS
"""Of the rectangle around a polygon, from which those inside are taken."""
_NUDGES = np.array([0.0, -0.15, 0.15, -0.3, 0.3])
"""Steps from a node to the places that are tried for it, as shares of the spacing along each axis of the face [1]."""
_NOISE, _GOOD_STD_PX, _USABLE_STD_PX = 2.0, 0.02, 0.1
"""Noise of a picture [levels of 255], and the error that it makes in one frame from which on a texture will do [px]."""
_SEARCH_PX, _SEARCH_STEPS, _FINAL_STEPS = 31, 6, 40
_STRIDE_PX, _MOST_STARTS = 3.0, 60
_REACH_STD = 3.0
_LEAST_SPREAD_M = 0.01
"""Smallest scatter about a surface that is believed [m]: rivets, plates and paint lie so far off it."""
_DISTINCT_PX = 3.0
_SIZES_PX = (41, 31, 23)
"""Sides tried where a larger square holds what one view hides from the other, as stiffeners do [px]."""
_OFF_LINE_PX, _OFF_LINE_MAD = 2.0, 5.0
"""Distance from the epipolar line, less what all points share, beyond which a place is another one."""


def add_grids(session: Session, cameras: CameraSolution, frames: Mapping[str, LumaArray]) -> xr.Dataset:
    """Points dataset of the cameras with the points of all grids behind those that have names of their own.

    Parameters
    ----------
    session
        Its grids, its site and ``method.subset_px``.
    cameras
        Cameras, axes and the P points that have names of their own; without cameras or axes nothing is added, because
        nothing can be measured.
    frames
        First frame of every view, shape (H, W).

    Returns
    -------
    points
        Positions of shape (V, P + G, 2) [px], with ``grid`` (point), the name of the grid that a point belongs to,
        empty for the others. A point that is not placed in a view says why in its ``status``.

    Raises
    ------
    SessionError
        A grid holds no point or too many, its polygon does not lie on the face, or a name is there already.

    Notes
    -----
    A node of the grid without texture gives way to the nearest place within a third of the spacing that has some.
    """
    points, frame = cameras.points, cameras.frame
    if not session.grid or cameras.rig is None or frame is None:
        return points
    rig, face = know_face(session.site, cameras.rig, frame)
    if face is None:
        return points
    face = _shift_to_points(face, points, rig)
    every = [_place_grid(grid, face, rig, frames, session.method.usual_subset_px) for grid in session.grid]
    taken = Counter(str(name) for one in (points, *every) for name in one["point"].values)
    twice = sorted(name for name, times in taken.items() if times > 1)
    if twice:
        raise SessionError(f"grid: expected names that no point has, got {', '.join(twice[:3])}; rename the points")
    named = points.assign(grid=("point", np.full(points.sizes["point"], "", dtype=object)))
    if "frame" in points:
        every = [one.assign(frame=(("view", "point"), np.zeros(one["status"].shape, np.int64))) for one in every]
    return xr.concat([named, *every], "point", combine_attrs="override")


def _shift_to_points(face: Face, points: xr.Dataset, rig: Rig) -> Face:
    """The face where the points near it lie: cameras know that better than a tape does."""
    pixels = points["position"].transpose("view", "point", "pixel").values
    seen = np.isfinite(pixels).all(axis=2).sum(axis=0) >= 2
    if not seen.any():
        return face
    lateral = triangulate(pixels[:, seen], rig) @ face.axes[0]
    near = lateral[np.abs(lateral - face.distance_m) < _REACH_STD * face.std_m]
    return replace(face, distance_m=float(np.median(near)), distance_std_m=0.0) if near.size else face


def _place_grid(grid: Grid, face: Face, rig: Rig, frames: Mapping[str, LumaArray], subset_px: int) -> xr.Dataset:
    """Points dataset of one grid."""
    source = list(frames).index(grid.view)
    names, places, textured = _lay_out(grid, face, rig.cameras[source], frames[grid.view], subset_px)
    shape = (len(frames), len(names))
    position, std = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
    status = np.full(shape, PointStatus.NO_TEXTURE.value, dtype=object)
    position[source, textured], std[source, textured] = places[textured], 0.0
    status[source, textured] = PointStatus.OK
    chosen = np.flatnonzero(textured)
    for target, view in enumerate(frames):
        if target == source or not chosen.size:
            continue
        pair = _Pair((frames[grid.view], frames[view]), rig, (source, target), face, subset_px)
        found, why = pair.find(places[chosen])
        ok = why == PointStatus.OK
        position[target, chosen[ok]] = found.position[ok]
        std[target, chosen[ok]] = np.sqrt(np.einsum("pii->pi", found.covariance[ok]))
        status[target, chosen] = why
    made = make_points(list(frames), names, position=position, position_std=std, status=status)
    return made.assign(grid=("point", np.full(len(names), grid.name, dtype=object)))


def _lay_out(
    grid: Grid, face: Face, camera: Camera, luma: LumaArray, subset_px: int
) -> tuple[list[str], FloatArray, BoolArray]:
    """Names of a grid's points, their pixels (P, 2) in the view in which it was drawn, whether they have texture."""
    corners = np.array(grid.polygon)
    height, width = luma.shape
    if not ((corners >= 0) & (corners <= [width - 1, height - 1])).all():
        raise SessionError(
            f"grid {grid.name!r}: expected a polygon inside {width} x {height}, got {corners.tolist()}; correct it"
        )
    on_face = _meet(corners, camera, face, np.zeros(1))[0] @ face.axes.T
    if not np.isfinite(on_face).all():
        raise SessionError(
            f"grid {grid.name!r}: expected a polygon on the structure's face, got corners whose rays do not meet it; "
            "correct the polygon, or the distances under [site]"
        )
    down, along = np.ptp(on_face[:, 1:], axis=0)
    if (down / grid.spacing_m + 1) * (along / grid.spacing_m + 1) > _MOST_NODES:
        raise SessionError(
            f"grid {grid.name!r}: expected 1 to {_MOST_POINTS} points, got {grid.spacing_m:g} m on a polygon of "
            f"{along:.3g} m by {down:.3g} m on the face; change the spacing or the polygon"
        )
    numbers, nodes = _find_nodes(on_face[:, 1:], grid.spacing_m)
    inside = _is_inside(_see(nodes, camera, face), corners)
    if not 0 < inside.sum() <= _MOST_POINTS:
        raise SessionError(
            f"grid {grid.name!r}: expected 1 to {_MOST_POINTS} points, got {inside.sum()} at {grid.spacing_m:g} m; "
            "change the spacing or the polygon"
        )
    numbers, nodes = numbers[inside], nodes[inside]
    places, textured = _choose_places(nodes, grid, camera, face, luma, subset_px)
    return [grid.point_name(row, column) for row, column in numbers.tolist()], places, textured


def _find_nodes(corners: FloatArray, spacing_m: float) -> tuple[IntArray, FloatArray]:
    """Rows and columns (N, 2) and places (N, 2) [m] of the nodes of a rectangle around corners, in its middle."""
    least, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    counts = np.floor(extent / spacing_m).astype(int) + 1
    begin = least + (extent - (counts - 1) * spacing_m) / 2
    indices = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    return indices + 1, begin + indices * spacing_m


def _choose_places(
    nodes: FloatArray, grid: Grid, camera: Camera, face: Face, luma: LumaArray, subset_px: int
) -> tuple[FloatArray, BoolArray]:
    """Pixel (P, 2) of every node, or of the nearest place beside it that has texture, and whether that has any."""
    steps = np.stack(np.meshgrid(_NUDGES, _NUDGES, indexing="ij"), axis=-1).reshape(-1, 2)
    steps = steps[np.argsort(np.linalg.norm(steps, axis=1), kind="stable")] * grid.spacing_m
    tried = _see((nodes[:, None] + steps).reshape(-1, 2), camera, face)
    expected = _expect_std(luma, subset_px, tried)
    expected = np.where(_is_inside(tried, np.array(grid.polygon)), expected, np.inf).reshape(len(nodes), -1)
    good = expected <= _GOOD_STD_PX
    chosen = np.where(good.any(axis=1), good.argmax(axis=1), expected.argmin(axis=1))
    rows = np.arange(len(nodes))
    return tried.reshape(len(nodes), -1, 2)[rows, chosen], expected[rows, chosen] <= _USABLE_STD_PX


def _expect_std(luma: LumaArray, subset_px: int, places: FloatArray) -> FloatArray:
    """Error in the worst direction of squares around places (N, 2), from the texture alone, shape (N,) [px]."""
    image = to_eight_bit(luma).astype(np.float32)
    along_u, along_v = cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=1 / 8)
    uu, uv, vv = (
        cv2.boxFilter(product, -1, (subset_px, subset_px), normalize=False)
        for product in (along_u * along_u, along_u * along_v, along_v * along_v)
    )
    least = (uu + vv) / 2 - np.hypot((uu - vv) / 2, uv)
    height, width = luma.shape
    columns, rows = np.rint(np.nan_to_num(places, nan=-1.0)).astype(int).T
    half = subset_px // 2 + 1
    room = (columns >= half) & (rows >= half) & (columns < width - half) & (rows < height - half)
    found = least[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    return np.where(room, _NOISE / np.sqrt(np.maximum(found, 1e-9)), np.inf)


def _is_inside(places: FloatArray, polygon: FloatArray) -> BoolArray:
    """Whether pixels (N, 2) lie inside a polygon or on its border, shape (N,)."""
    outline = polygon.astype(np.float32).reshape(-1, 1, 2)
    return np.array(
        [np.isfinite(place).all() and cv2.pointPolygonTest(outline, place, False) >= 0 for place in places], np.bool_
    )


def _meet(pixels: FloatArray, camera: Camera, face: Face, beyond_m: FloatArray) -> FloatArray:
    """Where rays of pixels (N, 2) meet planes behind the face by (K,) [m]; shape (K, N, 3) [m], NaN where none does."""
    normal = face.axes[0]
    rays = np.column_stack([camera.normalize(pixels), np.ones(len(pixels))]) @ camera.rotation
    reach = (face.distance_m + beyond_m[:, None] - normal @ camera.center) / (rays @ normal)
    return camera.center + np.where(reach > 0, reach, np.nan)[..., None] * rays


def _see(nodes: FloatArray, camera: Camera, face: Face) -> FloatArray:
    """Pixels (N, 2) of places (N, 2) on the face, vertical and longitudinal [m]."""
    return camera.project(np.column_stack([np.full(len(nodes), face.distance_m), nodes]) @ face.axes)


def _put(found: Registration, status: StatusArray, rows: IntArray, again: tuple[Registration, StatusArray]) -> None:
    """Enters what another attempt found of some of the rows."""
    ok = again[1] == PointStatus.OK
    for name in found.__dataclass_fields__:
        getattr(found, name)[rows[ok]] = getattr(again[0], name)[ok]
    status[rows[ok]] = PointStatus.OK


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two views of a face, in the second of which places of the first are looked for."""

    images: tuple[LumaArray, LumaArray]
    rig: Rig
    views: tuple[int, int]
    face: Face
    subset_px: int

    def find(self, places: FloatArray) -> tuple[Registration, StatusArray]:
        """Registration of places (P, 2) in the second view, and a `PointStatus` each, shape (P,)."""
        found, status = self._search(places, (-_REACH_STD * self.face.std_m, _REACH_STD * self.face.std_m))
        sure = status == PointStatus.OK
        if sure.sum() < 3 or sure.all():
            return found, status
        off = self._offsets(places[sure], found.position[sure])
        spread = max(MAD_TO_STD * float(np.median(np.abs(off - np.median(off)))), _LEAST_SPREAD_M)
        middle = float(np.median(off))
        again, now = self._search(places[~sure], (middle - _REACH_STD * spread, middle + _REACH_STD * spread))
        _put(found, status, np.flatnonzero(~sure), (again, now))
        return found, status

    def _search(self, places: FloatArray, beyond_m: tuple[float, float]) -> tuple[Registration, StatusArray]:
        """The same between two planes parallel to the face."""
        offsets, there = self._starts(places, np.array(beyond_m))
        maps = self._maps(places)
        count = len(offsets)
        tried = register_subset(
            *self.images,
            np.repeat(places, count, axis=0),
            Starts(there.reshape(-1, 2), np.repeat(maps, count, axis=0)),
            subset_px=min(_SEARCH_PX, self.subset_px),
            max_iterations=_SEARCH_STEPS,
        )
        ended = tried.position.reshape(len(places), count, 2)
        likeness = np.nan_to_num(tried.correlation, nan=-1.0).reshape(len(places), count)
        likeness = np.where(np.isfinite(ended).all(axis=2), likeness, -1.0)
        best, rows = likeness.argmax(axis=1), np.arange(len(places))
        tried_out = likeness[rows, best, None] > -1
        begin = np.where(tried_out, np.nan_to_num(ended[rows, best]), there[:, count // 2])
        found, status = self._register(places, Starts(begin, maps), self.subset_px)
        for size in (px for px in _SIZES_PX if px < self.subset_px):
            left = np.flatnonzero(status != PointStatus.OK)
            if left.size:
                again, now = self._register(places[left], Starts(begin[left], maps[left]), size)
                _put(found, status, left, (again, now))
        for row in np.flatnonzero(status == PointStatus.OK):
            if has_rival(likeness[row], np.nan_to_num(ended[row]), int(best[row]), distinct_px=_DISTINCT_PX):
                status[row] = PointStatus.AMBIGUOUS
        return found, status

    def _register(self, places: FloatArray, starts: Starts, size: int) -> tuple[Registration, StatusArray]:
        """The same from a start each, of squares of one size."""
        found = register_subset(*self.images, places, starts, subset_px=size, max_iterations=_FINAL_STEPS)
        return found, self._judge(places, found, size)

    def _judge(self, places: FloatArray, found: Registration, size: int) -> StatusArray:
        """Whether registrations resemble, lie on their epipolar lines and lead back, as `PointStatus`, shape (P,)."""
        alike = found.converged & np.isfinite(found.position).all(axis=1) & (found.correlation >= MIN_CORRELATION)
        if not alike.any():
            return np.full(len(places), PointStatus.NOT_FOUND.value, dtype=object)
        first, second = self.views
        off = np.full(len(places), np.inf)
        off[alike] = sampson_error(places[alike], found.position[alike], self.rig, first=first, second=second)
        off[alike] -= np.median(off[alike])
        limit = max(_OFF_LINE_PX, _OFF_LINE_MAD * MAD_TO_STD * float(np.median(np.abs(off[alike]))))
        alike &= np.abs(off) <= limit
        status = np.where(alike, PointStatus.OK.value, PointStatus.NOT_FOUND.value).astype(object)
        rows = np.flatnonzero(alike)
        if not rows.size:
            return status
        back = register_subset(
            self.images[1],
            self.images[0],
            found.position[rows],
            Starts(places[rows], np.linalg.inv(found.affine[rows])),
            subset_px=size,
        )
        returned = back.converged & (np.linalg.norm(back.position - places[rows], axis=1) <= RETURN_PX)
        status[rows[~returned]] = PointStatus.NOT_RETURNED
        return status

    def _starts(self, places: FloatArray, beyond_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances behind the face (K,) [m], and where the second view sees places there, shape (P, K, 2) [px]."""
        first, second = (self.rig.cameras[view] for view in self.views)
        ends = second.project(_meet(places, first, self.face, beyond_m))
        lengths = np.linalg.norm(ends[1] - ends[0], axis=-1)
        # A view that looks elsewhere sees none of them.
        length = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
        count = int(np.clip(np.ceil(length / _STRIDE_PX), 1, _MOST_STARTS)) + 1
        offsets = np.linspace(float(beyond_m[0]), float(beyond_m[1]), count)
        seen = second.project(_meet(places, first, self.face, offsets)).swapaxes(0, 1)
        # What the second view cannot see begins far outside of it.
        return offsets, np.nan_to_num(seen, nan=-1e6)

    def _maps(self, places: FloatArray) -> FloatArray:
        """Maps of offsets on the face from the first view to the second, shape (P, 2, 2) [1]."""
        first, second = (self.rig.cameras[view] for view in self.views)
        at = np.zeros(1)
        columns = [
            second.project(_meet(places + step, first, self.face, at)[0])
            - second.project(_meet(places - step, first, self.face, at)[0])
            for step in np.eye(2)
        ]
        maps = np.stack(columns, axis=-1) / 2
        sound = np.isfinite(maps).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(maps))) > 1e-2)
        return np.where(sound[:, None, None], np.nan_to_num(maps), np.eye(2))

    def _offsets(self, places: FloatArray, there: FloatArray) -> FloatArray:
        """How far points lie behind the face, from their pixels in both views, shape (P,) [m]."""
        pixels = np.full((len(self.rig), len(places), 2), np.nan)
        pixels[self.views[0]], pixels[self.views[1]] = places, there
        return np.asarray(triangulate(pixels, self.rig) @ self.face.axes[0] - self.face.distance_m)
