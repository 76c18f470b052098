"""Images of a scene by casting a ray through each pixel; exact to a few thousandths of a pixel in what moves."""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
from numba import parallel_chunksize
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter, minimum_filter

from vfm_sdm.core.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.cast_arrays import (
    EDGE_PX,
    MIXED,
    MIXED_FRONT,
    NORMAL,
    OFFSET,
    SLACK_PX,
    TABLE_STEP_M,
    TILE,
    CastArrays,
)
from vfm_sdm.studies.synthetic.edges import smooth_edges
from vfm_sdm.studies.synthetic.lighting import compute_reflection
from vfm_sdm.studies.synthetic.raycast import mark_tiles, move_pixels, render_pixels
from vfm_sdm.studies.synthetic.scene import GUARD, Face, Scene

__all__ = ["Displacement", "Renderer"]

Displacement = Callable[[FloatArray], FloatArray]
"""Displacement at one instant of points at rest, shape (P, 3) to (P, 3) [m], world frame."""

_FaceImage = npt.NDArray[np.int16]
_NEUTRAL_CHROMA = 128
_GRID = 24
_NEAR_IMAGE = 0.25
"""Share of the image's size beyond its border that a displacement may bring in."""
_CHUNK_ROWS = 8
_RAY_STEP = 16


class Renderer:
    """Draws one scene through one camera, frame by frame.

    What cannot change is drawn once; a frame draws again only what the moving faces can reach.

    Parameters
    ----------
    scene
        Faces and sky.
    camera
        The camera, with ``cam_from_world`` in the scene's world frame.
    reach_m
        Largest displacement that will be asked for [m].
    backdrop
        Luma where there is no face, shape (H, W); the scene's sky when ``None``.

    Attributes
    ----------
    luma_at_rest
        Luma without displacement, shape (H, W), not rounded and not limited to the range of video.
    face_at_rest
        Index in ``scene.faces`` of what each pixel's centre shows, -1 for the sky, shape (H, W).

    Raises
    ------
    CameraError
        The distortion has no inverse somewhere in the image.
    DatasetError
        ``reach_m`` is negative or not finite, or the backdrop has another shape than the image.

    Notes
    -----
    A moving face's points are displaced each by the value at their own longitudinal coordinate on the face's centre
    line: faces bend, but a cross-section of a face stays rigid. Textures are sampled once a pixel, so they must hold
    nothing finer than two pixels (`vfm_sdm.studies.synthetic.scene.coarsest_pixel`). Edges are seen through a Gaussian
    point spread of 0.8 px; faces narrower in the image than about three pixels may be drawn with gaps.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        *,
        reach_m: float = 0.02,
        backdrop: npt.NDArray[np.float32] | None = None,
    ) -> None:
        if not (np.isfinite(reach_m) and reach_m >= 0):
            raise DatasetError(f"reach_m: expected metres >= 0, got {reach_m}; give the largest displacement")
        self.scene = scene
        self.camera = camera
        self._reach_m = float(reach_m)
        self._shift_px = int(np.ceil(1.05 * reach_m * self.pixels_per_metre))
        self._stations = _Stations(scene, reach_m)
        height, width = camera.image_size[::-1]
        sky = np.full((height, width), scene.sky, np.float32) if backdrop is None else backdrop
        if sky.shape != (height, width):
            raise DatasetError(
                f"backdrop: expected shape {(height, width)}, got {sky.shape}; draw it with the same camera"
            )
        self._arrays = _cast_arrays(scene, camera, self._stations, self._reach_m, sky)
        self._arrays = self._arrays._replace(candidates=self._candidates())
        luma, face = np.empty((height, width), np.float32), np.empty((height, width), np.int16)
        arrays = self._arrays.plain(self._stations.values(None))
        render_pixels(arrays, luma, face)
        smooth_edges(arrays, np.ones((height, width), np.bool_), luma, face, (0, height))
        for array in (luma, face):
            array.flags.writeable = False
        self.luma_at_rest, self.face_at_rest = luma, face
        self._moving = np.array([*(face.moving for face in scene.faces), False])
        self._tiles = _MovingTiles(self._moving, camera, self._arrays, face)
        self._plan = self._plan_pixels()
        # Kept from frame to frame, because fresh memory costs as much as drawing.
        self._face, self._edges = face.copy(), np.zeros(face.shape, np.bool_)

    @property
    def pixels_per_metre(self) -> float:
        """Bound on how far a moving point shifts in the image for a displacement of 1 m [px/m]."""
        return max((_pixels_per_metre(face, self.camera) for face in self.scene.faces if face.moving), default=0.0)

    def render(
        self,
        displacement: Displacement | None = None,
        *,
        rows: tuple[int, int] | None = None,
        into: npt.NDArray[np.float32] | None = None,
    ) -> npt.NDArray[np.float32]:
        """Luma of the displaced scene.

        Parameters
        ----------
        displacement
            Displacement of points of the scene [m]; ``None`` for none.
        rows
            First row to draw, and the one after the last; all when ``None``.
        into
            Picture whose rows are drawn anew and which is returned, shape (H, W); a picture at rest when ``None``. A
            rolling shutter is drawn band by band.

        Returns
        -------
        luma
            Shape (H, W), in units of 8-bit video, not rounded.

        Raises
        ------
        DatasetError
            The displacement has another shape, is not finite, or is larger than ``reach_m``.
        """
        luma = self.luma_at_rest.copy() if into is None else into
        first, last = (0, len(luma)) if rows is None else rows
        if into is not None:
            luma[first:last] = self.luma_at_rest[first:last]
        values = self._stations.values(displacement)
        largest = float(np.linalg.norm(values, axis=1).max(initial=0))
        if not largest <= self._reach_m:
            raise DatasetError(
                f"displacement: expected at most reach_m = {self._reach_m} m, got {largest} m; make the renderer with "
                "a larger reach_m"
            )
        if not values.any() or not self._tiles.any:
            self._face[first:last] = self.face_at_rest[first:last]
            return luma
        # The point spread reaches into the rows about the band, which show what they would at that instant.
        around = max(0, first - EDGE_PX), min(len(luma), last + EDGE_PX)
        kept = {row: luma[row].copy() for row in (*range(around[0], first), *range(last, around[1]))}
        face, edges = self._face, self._edges
        face[around[0] : around[1]] = self.face_at_rest[around[0] : around[1]]
        arrays = self._arrays.plain(self._stations.in_face_axes(values))
        reached, alone, front = self._plan
        plan = (reached, alone, self._tiles.shifts(values, self._stations, around), self._moving, front)
        # Small chunks of rows, because most of the work is in some of them.
        with parallel_chunksize(_CHUNK_ROWS):
            move_pixels(arrays, plan, luma, face, edges, around)
            smooth_edges(arrays, edges, luma, face, (first, last))
        for row, before in kept.items():
            luma[row] = before
        return luma

    @property
    def face_drawn(self) -> _FaceImage:
        """What each pixel's centre showed in the picture drawn last, as `face_at_rest`; overwritten by the next."""
        return self._face

    @property
    def rays(self) -> FloatArray:
        """Undistorted rays (x/z, y/z) of all pixel centres in the camera's axes, shape (H, W, 2) [1]."""
        return self._arrays.rays[1:-1, 1:-1]

    @property
    def face_planes(self) -> FloatArray:
        """Normal of every face in the camera's axes [1] and the distance of its plane along it [m], shape (F, 4)."""
        return self._arrays.faces[:, [NORMAL, NORMAL + 1, NORMAL + 2, OFFSET]]

    def depth_at_rest(self) -> FloatArray:
        """Distance of what each pixel shows, along the optical axis; infinite for the sky, shape (H, W) [m]."""
        planes = np.vstack([self.face_planes, [0.0, 0.0, 1.0, np.inf]])[self.face_at_rest]
        return np.asarray(planes[..., 3] / (np.sum(planes[..., :2] * self.rays, axis=-1) + planes[..., 2]))

    def chroma_at_rest(self, behind: "Renderer | None" = None) -> npt.NDArray[np.uint8]:
        """Blue and red chroma of half the size, as 4:2:0 video holds them, shape (2, ceil(H/2), ceil(W/2)).

        Parameters
        ----------
        behind
            Renderer of the backdrop with the same camera.
        """
        full = self._tints()
        if behind is not None:
            full = np.where((self.face_at_rest < 0)[..., None], behind._tints(), full)
        height, width = full.shape[:2]
        full = np.pad(full, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        mean = full.reshape(full.shape[0] // 2, 2, full.shape[1] // 2, 2, 2).mean(axis=(1, 3))
        planes = np.clip(np.rint(mean + _NEUTRAL_CHROMA), 16, 240).astype(np.uint8)
        return np.ascontiguousarray(planes.transpose(2, 0, 1))

    def _tints(self) -> FloatArray:
        """Chroma differences of what each pixel shows, shape (H, W, 2)."""
        tints = np.array([*(face.tint for face in self.scene.faces), (0.0, 0.0)])
        return np.asarray(tints[self.face_at_rest])

    def _candidates(self) -> npt.NDArray[np.int64]:
        """Faces that each tile may show, also when displaced, shape (tiles_v, tiles_u, most); padded with -1."""
        width, height = self.camera.image_size
        marks = np.zeros((len(self.scene.faces), -(-height // TILE), -(-width // TILE)), np.bool_)
        mark_tiles(self._arrays.plain(self._stations.values(None)), marks)
        steps = 1 + (self._shift_px + EDGE_PX) // TILE
        near = np.stack([binary_dilation(mark, np.ones((3, 3), np.bool_), iterations=steps) for mark in marks])
        most = max(1, int(near.sum(axis=0).max()))
        order = np.argsort(~near, axis=0, kind="stable")[:most]
        listed = np.where(np.take_along_axis(near, order, axis=0), order, -1)
        return np.ascontiguousarray(listed.transpose(1, 2, 0))

    def _plan_pixels(self) -> tuple[BoolArray, _FaceImage, BoolArray]:
        """Pixels that a frame may change, the only face around each, and the faces in front (see `move_pixels`)."""
        moving, face = self._moving[self.face_at_rest], self.face_at_rest
        # What is just outside the image may come in.
        reach = self._shift_px + EDGE_PX
        reached = maximum_filter(moving, 2 * reach + 1, mode="nearest") | _border(moving.shape, reach)
        near = 2 * (EDGE_PX + 1 + self._tiles.spread_px(self._reach_m)) + 1
        lowest, highest = minimum_filter(face, near, mode="nearest"), maximum_filter(face, near, mode="nearest")
        mixed = (lowest != highest) | _border(face.shape, near // 2)
        front = self._tiles.faces_in_front(self._arrays, self._moving)
        several = np.where(maximum_filter(front[face], near, mode="nearest"), MIXED_FRONT, MIXED)
        return reached, np.where(mixed, several, face).astype(np.int16), front


class _Stations:
    """Places at which the displacement is asked for: along the centre line of every moving face."""

    def __init__(self, scene: Scene, reach_m: float) -> None:
        faces = scene.faces
        self.start = np.zeros(len(faces))
        self.count = np.zeros(len(faces), np.int64)
        lines = [np.zeros((0, 3))]
        for number, face in enumerate(faces):
            if face.moving:
                center = face.origin + 0.5 * (face.edge_u + face.edge_v)
                half = 0.5 * (abs(face.edge_u[2]) + abs(face.edge_v[2])) + reach_m
                count = int(np.ceil(2 * half / TABLE_STEP_M)) + 1
                line = np.tile(center, (count, 1))
                line[:, 2] += TABLE_STEP_M * np.arange(count) - half
                self.start[number], self.count[number] = line[0, 2], count
                lines.append(line)
        self.first = np.cumsum(self.count) - self.count
        self._positions = np.concatenate(lines)
        self._axes = np.repeat(_face_axes(scene), self.count, axis=0)
        self._order = np.argsort(self._positions[:, 2], kind="stable")

    def in_face_axes(self, values: FloatArray) -> FloatArray:
        """Displacements along each face's normal and unit vectors u and v, shape (N, 3) [m]."""
        return np.ascontiguousarray(np.einsum("nai,ni->na", self._axes, values))

    def near(self, values: FloatArray, longitudinal: FloatArray) -> FloatArray:
        """Displacement of whatever moves near a longitudinal coordinate.

        Parameters
        ----------
        values
            Displacement at the N stations, shape (N, 3) [m].
        longitudinal
            Longitudinal coordinates, shape (...) [m].

        Returns
        -------
        displacement
            Shape (..., 3) [m].
        """
        places = self._positions[self._order, 2]
        return np.stack([np.interp(longitudinal, places, values[self._order, axis]) for axis in range(3)], axis=-1)

    def values(self, displacement: Displacement | None) -> FloatArray:
        """The displacement at all stations, shape (N, 3) [m]; zero for None."""
        if displacement is None or not len(self._positions):
            return np.zeros_like(self._positions)
        values = as_float_array(displacement(self._positions.copy()), "displacement", self._positions.shape)
        if not np.isfinite(values).all():
            raise DatasetError("displacement: expected finite metres, got NaN or infinity; check the motion")
        return np.ascontiguousarray(values)


class _MovingTiles:
    """Shifts of points of the moving faces in the image, in the middle of each tile or of the nearest with one."""

    def __init__(self, moving: BoolArray, camera: Camera, arrays: CastArrays, face_at_rest: _FaceImage) -> None:
        height, width = face_at_rest.shape
        rows, columns = (np.minimum(np.arange(0, n, TILE) + TILE // 2, n - 1) for n in (height, width))
        face = face_at_rest[np.ix_(rows, columns)]
        seen = moving[face]
        self.any = bool(moving.any())
        self._jacobian = np.zeros((*face.shape, 2, 3))
        self._longitudinal = np.zeros(face.shape)
        self._seen = seen
        if not seen.any():
            return
        rays = arrays.rays[np.ix_(rows + 1, columns + 1)]
        self._rays = np.concatenate([rays, np.ones((*face.shape, 1))], axis=-1)
        normal = arrays.faces[face[seen], NORMAL : NORMAL + 3]
        distance = arrays.faces[face[seen], OFFSET] / np.sum(normal * self._rays[seen], axis=1)
        points = camera.center + distance[:, None] * self._rays[seen] @ camera.rotation
        step = 1e-3
        moved = camera.project(points + step * np.vstack([np.zeros(3), np.eye(3)])[:, None])
        jacobian = np.zeros_like(self._jacobian)
        jacobian[seen] = ((moved[1:] - moved[0]) / step).transpose(1, 2, 0)
        nearest = distance_transform_edt(~seen, return_distances=False, return_indices=True)
        self._jacobian = jacobian[tuple(nearest)]
        longitudinal = np.zeros(face.shape)
        longitudinal[seen] = points[:, 2]
        self._longitudinal = longitudinal[tuple(nearest)]

    def shifts(self, values: FloatArray, stations: "_Stations", rows: tuple[int, int]) -> FloatArray:
        """Shift of moving points in each tile, shape (tiles_v, tiles_u, 2) [px]; zero but in these rows of pixels."""
        shifts = np.zeros(self._jacobian.shape[:3])
        band = slice(rows[0] // TILE, -(-rows[1] // TILE))
        displacement = stations.near(values, self._longitudinal[band])
        shifts[band] = np.einsum("tuij,tuj->tui", self._jacobian[band], displacement)
        return shifts

    def spread_px(self, reach_m: float) -> int:
        """Bound on how far shifts differ between points that are near each other in the image [px]."""
        if not self._seen.any():
            return 0
        size = (5, 5, 1, 1)
        spread = maximum_filter(self._jacobian, size) - minimum_filter(self._jacobian, size)
        return int(np.ceil(reach_m * np.linalg.norm(spread, axis=(2, 3)).max()))

    def faces_in_front(self, arrays: CastArrays, moving: BoolArray) -> BoolArray:
        """Still faces that may hide a moving one, shape (F + 1,), the last for the sky."""
        front = np.zeros(len(moving), np.bool_)
        if not self._seen.any():
            return front
        listed = arrays.candidates
        with np.errstate(divide="ignore", invalid="ignore"):
            normal = arrays.faces[listed, NORMAL : NORMAL + 3]
            along = arrays.faces[listed, OFFSET] / np.einsum("tuki,tui->tuk", normal, self._rays)
        usable = (listed >= 0) & (along > 0)
        farthest = np.where(usable & moving[listed], along, -np.inf).max(axis=2, keepdims=True)
        front[listed[usable & ~moving[listed] & (along < farthest)]] = True
        return front


def _cast_arrays(
    scene: Scene, camera: Camera, stations: _Stations, reach_m: float, sky: npt.NDArray[np.float32]
) -> CastArrays:
    lengths = np.array([face.size_m for face in scene.faces])
    axes = _face_axes(scene)
    origin = np.array([face.origin for face in scene.faces])
    offset = np.einsum("fai,fi->fa", axes, origin - camera.center)
    density = np.array([face.texture.texels_per_m for face in scene.faces])
    guard = np.full(len(scene.faces), GUARD)
    farthest = np.array([np.linalg.norm(face.corners - camera.center, axis=1).max() for face in scene.faces])
    reach = np.where(stations.count > 0, reach_m, 0.0) + SLACK_PX * farthest / camera.focal_px
    texels = np.array([spline.shape[::-1] for spline in scene.splines])
    first = np.cumsum([0] + [spline.size for spline in scene.splines[:-1]])
    table = stations.start - origin[:, 2]
    seen = (axes @ camera.rotation.T).reshape(-1, 9)
    return CastArrays(
        faces=np.column_stack([seen, offset, lengths, density, table, reach, guard, axes[:, 1:, 2]]),
        layout=np.column_stack([first, texels, stations.first, stations.count]).astype(np.int64),
        coefficients=np.concatenate([spline.ravel() for spline in _splines(scene, camera)]),
        rays=_pixel_rays(camera),
        candidates=np.zeros((1, 1, 1), np.int64),
        sky=np.ascontiguousarray(sky, np.float32),
    )


def _splines(scene: Scene, camera: Camera) -> Iterator[npt.NDArray[np.float32]]:
    """Coefficients of the textures of all faces with the reflections that this camera sees."""
    for face, spline in zip(scene.faces, scene.splines, strict=True):
        if scene.light is None or face.gloss[0] == 0:
            yield spline
            continue
        rows, columns = spline.shape
        along = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) - GUARD
        normal = np.cross(face.edge_u, face.edge_v)
        # A reflection is so smooth that its values are its coefficients.
        reflected = compute_reflection(
            scene.light,
            face.gloss,
            normal=normal / np.linalg.norm(normal),
            points3d=face.points3d(along / face.texture.texels_per_m),
            center=camera.center,
        )
        yield (spline + reflected).astype(np.float32)


def _face_axes(scene: Scene) -> FloatArray:
    """Normal and unit vectors u and v of every face, shape (F, 3, 3)."""
    units = np.array([[face.edge_u / face.size_m[0], face.edge_v / face.size_m[1]] for face in scene.faces])
    return np.concatenate([np.cross(units[:, :1], units[:, 1:]), units], axis=1)


def _pixel_rays(camera: Camera) -> FloatArray:
    """Undistorted rays of all pixel centres and of a border of one pixel, shape (H + 2, W + 2, 2)."""
    width, height = camera.image_size
    # A lens is smooth: undone on a coarse grid, it is interpolated to a billionth of a pixel.
    u, v = (np.linspace(-1.0, n, max(8, 1 + -(-n // _RAY_STEP))) for n in (width, height))
    coarse = camera.normalize(np.stack(np.meshgrid(u, v), axis=-1))
    rays = np.full((height + 2, width + 2, 2), np.nan)
    if np.isfinite(coarse).all():
        for axis in range(2):
            spline = RectBivariateSpline(v, u, coarse[..., axis], kx=5, ky=5)
            rays[..., axis] = spline(np.arange(-1.0, height + 1), np.arange(-1.0, width + 1))
    if not np.isfinite(rays).all():
        raise CameraError(
            f"distortion: expected one that can be undone all over the image, got {camera.distortion.tolist()}; "
            "use smaller coefficients"
        )
    return np.ascontiguousarray(rays)


def _border(shape: tuple[int, ...], width: int) -> BoolArray:
    """Pixels less than ``width`` from the border of the image."""
    border = np.ones(shape, np.bool_)
    border[width : shape[0] - width, width : shape[1] - width] = False
    return border


def _pixels_per_metre(face: Face, camera: Camera) -> float:
    """Largest shift of a point of the face in or near the image, for a displacement of 1 m in any direction [px/m]."""
    share = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, _GRID)]), axis=-1).reshape(-1, 2)
    points = face.points3d(share * face.size_m)
    step = 1e-4
    moved = camera.project(points + step * np.vstack([np.zeros(3), np.eye(3)])[:, None])
    margin = _NEAR_IMAGE * np.asarray(camera.image_size)
    with np.errstate(invalid="ignore"):
        seen = np.all((moved[0] > -margin) & (moved[0] < np.asarray(camera.image_size) + margin), axis=1)
    jacobian = ((moved[1:] - moved[0])[:, seen] / step).transpose(1, 2, 0)
    return float(np.linalg.norm(jacobian, ord=2, axis=(1, 2)).max(initial=0.0))
