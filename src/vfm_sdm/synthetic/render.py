"""Images of a scene by casting a ray through each pixel; exact to a few thousandths of a pixel in what moves."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from numba import parallel_chunksize
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter

from vfm_sdm.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.synthetic.raycast import (
    EDGE_PX,
    KEEP,
    SEARCH,
    SLACK_PX,
    TABLE_STEP_M,
    TILE,
    CastArrays,
    mark_tiles,
    render_pixels,
    smooth_edges,
)
from vfm_sdm.synthetic.scene import GUARD, Face, Scene

__all__ = ["LUMA_RANGE", "Displacement", "Renderer", "quantize"]

Displacement = Callable[[FloatArray], FloatArray]
"""Displacement at one instant of points at rest, shape (P, 3) to (P, 3) [m], world frame."""

_FaceImage = npt.NDArray[np.int16]
LUMA_RANGE = (16, 235)
"""Black and white of 8-bit video."""
_NEUTRAL_CHROMA = 128
_GRID = 24
_CHUNK_ROWS = 8


class Renderer:
    """Draws one scene through one camera, frame by frame.

    What cannot change is drawn once; a frame draws again only what the moving faces can reach.

    Parameters
    ----------
    scene
        The faces.
    camera
        Its ``cam_from_world`` is in the scene's world frame.
    reach_m
        Largest displacement that will be asked for [m].

    Attributes
    ----------
    luma_at_rest
        Shape (H, W), float, not rounded and not limited to the range of video.
    face_at_rest
        Index in ``scene.faces`` of what each pixel's centre shows, -1 for the sky, shape (H, W).

    Raises
    ------
    CameraError
        The distortion has no inverse somewhere in the image.
    DatasetError
        ``reach_m`` is negative or not finite.

    Notes
    -----
    A moving face's points are displaced each by the value at their own longitudinal coordinate on the face's centre
    line: faces bend, but a cross-section of a face stays rigid. Textures are sampled once a pixel, so they must hold
    nothing finer than two pixels (`vfm_sdm.synthetic.scene.coarsest_pixel`). Edges are seen through a Gaussian point
    spread of 0.8 px; faces narrower in the image than about three pixels may be drawn with gaps.
    """

    def __init__(self, scene: Scene, camera: Camera, *, reach_m: float = 0.02) -> None:
        if not (np.isfinite(reach_m) and reach_m >= 0):
            raise DatasetError(f"reach_m: expected metres >= 0, got {reach_m}; give the largest displacement")
        self.scene = scene
        self.camera = camera
        self._reach_m = float(reach_m)
        self._shift_px = _largest_shift(scene, camera, reach_m)
        self._stations = _Stations(scene.faces, reach_m)
        self._arrays = _cast_arrays(scene, camera, self._stations, self._reach_m)
        self._arrays = self._arrays._replace(candidates=self._candidates())
        height, width = camera.image_size[::-1]
        luma, face = np.empty((height, width), np.float32), np.empty((height, width), np.int16)
        everywhere = np.full((height, width), SEARCH, np.int16), np.ones((height, width), np.bool_)
        self._draw(self._stations.values(None), everywhere, luma, face)
        for array in (luma, face):
            array.flags.writeable = False
        self.luma_at_rest, self.face_at_rest = luma, face
        self._plan = self._plan_pixels()

    def render(self, displacement: Displacement | None = None) -> npt.NDArray[np.float32]:
        """Luma of the displaced scene, shape (H, W), not rounded.

        Raises
        ------
        DatasetError
            The displacement has another shape, is not finite, or is larger than ``reach_m``.
        """
        if displacement is None:
            return self.luma_at_rest.copy()
        values = self._stations.values(displacement)
        largest = float(np.linalg.norm(values, axis=1).max(initial=0))
        if not largest <= self._reach_m:
            raise DatasetError(
                f"displacement: expected at most reach_m = {self._reach_m} m, got {largest} m; make the renderer with "
                "a larger reach_m"
            )
        luma = self.luma_at_rest.copy()
        if not values.any():
            return luma
        self._draw(values, self._plan, luma, self.face_at_rest.copy())
        return luma

    def chroma_at_rest(self) -> npt.NDArray[np.uint8]:
        """Blue and red chroma of half the size, as 4:2:0 video holds them, shape (2, ceil(H/2), ceil(W/2))."""
        tints = np.array([*(face.tint for face in self.scene.faces), (0.0, 0.0)])
        full = tints[self.face_at_rest]
        height, width = full.shape[:2]
        full = np.pad(full, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        mean = full.reshape(full.shape[0] // 2, 2, full.shape[1] // 2, 2, 2).mean(axis=(1, 3))
        planes = np.clip(np.rint(mean + _NEUTRAL_CHROMA), 16, 240).astype(np.uint8)
        return np.ascontiguousarray(planes.transpose(2, 0, 1))

    def _draw(
        self,
        values: FloatArray,
        plan: tuple[_FaceImage, BoolArray],
        luma: npt.NDArray[np.float32],
        face: _FaceImage,
    ) -> None:
        arrays = self._arrays.plain()
        # Small chunks of rows, because most of the work is in some of them.
        with parallel_chunksize(_CHUNK_ROWS):
            render_pixels(arrays, values, plan[0], luma, face)
            smooth_edges(arrays, values, plan[1], luma, face)

    def _candidates(self) -> npt.NDArray[np.int64]:
        """Faces that each tile may show, also when displaced, shape (tiles_v, tiles_u, most); padded with -1."""
        width, height = self.camera.image_size
        marks = np.zeros((len(self.scene.faces), -(-height // TILE), -(-width // TILE)), np.bool_)
        mark_tiles(self._arrays.plain(), self._stations.values(None), marks)
        steps = 1 + (self._shift_px + EDGE_PX) // TILE
        near = np.stack([binary_dilation(mark, np.ones((3, 3), np.bool_), iterations=steps) for mark in marks])
        most = max(1, int(near.sum(axis=0).max()))
        order = np.argsort(~near, axis=0, kind="stable")[:most]
        listed = np.where(np.take_along_axis(near, order, axis=0), order, -1)
        return np.ascontiguousarray(listed.transpose(1, 2, 0))

    def _plan_pixels(self) -> tuple[_FaceImage, BoolArray]:
        """What a frame must draw again, and where it must look for edges (see `render_pixels`, `smooth_edges`)."""
        moving = np.array([*(face.moving for face in self.scene.faces), False])[self.face_at_rest]
        if not moving.any() and self._shift_px == 0:
            return np.full_like(self.face_at_rest, KEEP), np.zeros_like(moving)
        reach = self._shift_px + EDGE_PX
        # What is just outside the image may come in.
        reached = maximum_filter(moving, 2 * reach + 1, mode="nearest") | _border(moving.shape, reach)
        plan = np.where(self._mixed(self._shift_px), SEARCH, self.face_at_rest)
        return np.where(reached, plan, KEEP).astype(np.int16), self._mixed(reach) & reached

    def _mixed(self, radius: int) -> BoolArray:
        """Pixels with more than one face within a square; those at the border, beyond which more may be."""
        lowest = minimum_filter(self.face_at_rest, 2 * radius + 1, mode="nearest")
        highest = maximum_filter(self.face_at_rest, 2 * radius + 1, mode="nearest")
        return np.asarray((lowest != highest) | _border(lowest.shape, radius))


class _Stations:
    """Where the displacement is asked for: along the centre line of every moving face."""

    def __init__(self, faces: tuple[Face, ...], reach_m: float) -> None:
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

    def values(self, displacement: Displacement | None) -> FloatArray:
        """The displacement at all stations, shape (N, 3) [m]; zero for None."""
        if displacement is None or not len(self._positions):
            return np.zeros_like(self._positions)
        values = as_float_array(displacement(self._positions.copy()), "displacement", self._positions.shape)
        if not np.isfinite(values).all():
            raise DatasetError("displacement: expected finite metres, got NaN or infinity; check the motion")
        return np.ascontiguousarray(values)


def quantize(
    luma: npt.NDArray[np.float32], *, noise_std: float = 0.0, rng: np.random.Generator | None = None
) -> npt.NDArray[np.uint8]:
    """Luma as a camera's 8-bit video holds it: with sensor noise, rounded, limited to `LUMA_RANGE`.

    Parameters
    ----------
    luma
        Any shape.
    noise_std
        Standard deviation of Gaussian noise, independent from pixel to pixel, in luma units.
    rng
        Source of the noise.

    Raises
    ------
    DatasetError
        The noise is negative, or has no source.
    """
    if not noise_std >= 0 or (noise_std > 0 and rng is None):
        raise DatasetError(f"noise_std: expected >= 0 and a generator for it, got {noise_std} and {rng}; pass rng")
    noisy = luma
    if rng is not None and noise_std > 0:
        noisy = luma + np.float32(noise_std) * rng.standard_normal(luma.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), *LUMA_RANGE).astype(np.uint8)


def _cast_arrays(scene: Scene, camera: Camera, stations: _Stations, reach_m: float) -> CastArrays:
    lengths = np.array([face.size_m for face in scene.faces])
    unit_u = np.array([face.edge_u for face in scene.faces]) / lengths[:, :1]
    unit_v = np.array([face.edge_v for face in scene.faces]) / lengths[:, 1:]
    normal = np.cross(unit_u, unit_v)
    origin = np.array([face.origin for face in scene.faces])
    offset = [np.sum((origin - camera.center) * axis, axis=1) for axis in (normal, unit_u, unit_v)]
    density = np.array([face.texture.texels_per_m for face in scene.faces])
    guard = np.full(len(scene.faces), GUARD)
    farthest = np.array([np.linalg.norm(face.corners - camera.center, axis=1).max() for face in scene.faces])
    reach = np.where(stations.count > 0, reach_m, 0.0) + SLACK_PX * farthest / camera.focal_px
    texels = np.array([spline.shape[::-1] for spline in scene.splines])
    first = np.cumsum([0] + [spline.size for spline in scene.splines[:-1]])
    table = stations.start - origin[:, 2]
    return CastArrays(
        faces=np.column_stack([normal, unit_u, unit_v, *offset, lengths, density, table, reach, guard]),
        layout=np.column_stack([first, texels, stations.first, stations.count]).astype(np.int64),
        coefficients=np.concatenate([spline.ravel() for spline in scene.splines]),
        rotation=np.ascontiguousarray(camera.rotation.T),
        rays=_pixel_rays(camera),
        candidates=np.zeros((1, 1, 1), np.int64),
        sky=float(scene.sky),
    )


def _pixel_rays(camera: Camera) -> FloatArray:
    """Undistorted rays of all pixel centres and of a border of one pixel, shape (H + 2, W + 2, 2)."""
    width, height = camera.image_size
    u, v = np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1))
    rays = camera.normalize(np.stack([u, v], axis=-1))
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


def _largest_shift(scene: Scene, camera: Camera, reach_m: float) -> int:
    """Bound on how far a moving point shifts in the image [px]; 0 where nothing moves."""
    gains = [_pixels_per_metre(face, camera) for face in scene.faces if face.moving]
    return int(np.ceil(1.1 * reach_m * max(gains))) + 1 if gains else 0


def _pixels_per_metre(face: Face, camera: Camera) -> float:
    """Largest shift in the image of a visible point of the face, for a displacement of 1 m in any direction [px/m]."""
    share = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, _GRID)]), axis=-1).reshape(-1, 2)
    points = face.points3d(share * face.size_m)
    step = 1e-4
    moved = camera.project(points + step * np.vstack([np.zeros(3), np.eye(3)])[:, None])
    margin = 0.05 * np.asarray(camera.image_size)
    with np.errstate(invalid="ignore"):
        seen = np.all((moved[0] > -margin) & (moved[0] < np.asarray(camera.image_size) + margin), axis=1)
    jacobian = ((moved[1:] - moved[0])[:, seen] / step).transpose(1, 2, 0)
    return float(np.linalg.norm(jacobian, ord=2, axis=(1, 2)).max(initial=0.0))
