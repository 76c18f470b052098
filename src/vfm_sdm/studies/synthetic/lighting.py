"""Light of a sun that changes a picture between view and view and from frame to frame: reflections, moving shadows.

Both lie still in the world while the structure moves through them by millimetres, so that they are drawn over the
picture of a displaced scene: a reflection depends on the direction in which a plane is seen, a shadow on where a ray
meets it.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.cast_arrays import BLUR_PX, FaceImage
from vfm_sdm.studies.synthetic.defects import BLACK, compute_wandering

__all__ = ["Canopy", "Light", "Shading", "canopy_density"]

_CELLS = 256
"""Side of the square of cells that holds the pattern of the leaves, and repeats."""
_CELLS_PER_LEAF = 8
_THINNEST = 0.35
"""Standard deviations of the pattern above its mean from which on leaves are dense: about a third of the area."""
_SHARPNESS = 2.2
"""Steps from light to shade within about half a leaf, as the sun's disc draws leaves some 5 m away."""
_SWAY_HZ = (0.15, 0.9)


@dataclass(frozen=True)
class Canopy:
    """Leaves between sun and structure, whose shadows sway.

    Parameters
    ----------
    center
        World point in the middle of what they shade [m].
    radius_m
        Standard deviation of the shaded area across the sun's rays [m].
    leaf_m
        Size of a shadow [m].
    depth
        Share of the sun's light that is taken where leaves are dense [1].
    sway_m
        Standard deviation of the leaves' movement [m].
    seed
        Seed of the pattern and its movement.

    Raises
    ------
    DatasetError
        A size is not positive, or the share is not in [0, 1].
    """

    center: tuple[float, float, float]
    radius_m: float
    leaf_m: float = 0.12
    depth: float = 0.8
    sway_m: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        if not (min(self.radius_m, self.leaf_m) > 0 and 0 <= self.depth <= 1 and self.sway_m >= 0):
            raise DatasetError(f"canopy: expected sizes > 0 m and depth in [0, 1], got {self}; correct them")


@dataclass(frozen=True)
class Light:
    """Sun and sky.

    Parameters
    ----------
    to_sun
        Direction to the sun in the world frame, of any length.
    sun
        Share of the light on a face that looks straight at the sun which comes from it; the rest is the sky's [1].
    canopy
        What takes some of the sun's light.

    Raises
    ------
    DatasetError
        The direction has no length, or the share is not in [0, 1].

    Examples
    --------
    >>> light = Light((-1.0, 0.0, 0.0), sun=0.75)
    >>> light.irradiance(np.array([-1.0, 0.0, 0.0])), light.irradiance(np.array([0.0, 0.0, 1.0]))
    (1.0, 0.25)
    """

    to_sun: tuple[float, float, float]
    sun: float = 0.65
    canopy: Canopy | None = None

    def __post_init__(self) -> None:
        if not (np.linalg.norm(self.to_sun) > 0 and 0 <= self.sun <= 1):
            raise DatasetError(f"light: expected a direction and a share in [0, 1], got {self}; correct them")

    @property
    def direction(self) -> FloatArray:
        """Unit vector to the sun in the world frame, shape (3,) [1]."""
        return np.asarray(np.asarray(self.to_sun) / np.linalg.norm(self.to_sun))

    def irradiance(self, normal: FloatArray) -> float:
        """Light on a face, relative to one that looks straight at the sun (Lambert's law) [1].

        Parameters
        ----------
        normal
            Unit vector out of the face, world frame, shape (3,) [1].
        """
        return 1 - self.sun + self.sun * max(0.0, float(normal @ self.direction))

    def sun_share(self, normal: FloatArray) -> float:
        """Share of the light on a face that comes from the sun [1]; the normal as in `irradiance`."""
        return 1 - (1 - self.sun) / self.irradiance(normal)


def canopy_density(canopy: Canopy) -> npt.NDArray[np.float32]:
    """How dense leaves are on a square of cells that repeats, shape (256, 256), from 0 to 1.

    Parameters
    ----------
    canopy
        Its seed decides the pattern.

    Examples
    --------
    >>> density = canopy_density(Canopy((0.0, 0.0, 0.0), 1.0))
    >>> density.shape, bool(density.min() >= 0 and density.max() <= 1), bool(0.2 < density.mean() < 0.6)
    ((256, 256), True, True)
    """
    spectrum = np.fft.rfft2(np.random.default_rng(canopy.seed).standard_normal((_CELLS, _CELLS)))
    frequency = np.hypot(np.fft.fftfreq(_CELLS)[:, None], np.fft.rfftfreq(_CELLS)) * _CELLS_PER_LEAF
    noise = np.fft.irfft2(spectrum * np.exp(-2.0 * frequency**2) * (frequency > 0), s=(_CELLS, _CELLS))
    noise /= noise.std()
    return np.asarray(0.5 + 0.5 * np.tanh(_SHARPNESS * (noise - _THINNEST)), np.float32)


class Shading:
    """Reflections and shadows of a light as one camera sees them.

    Parameters
    ----------
    light
        Sun and canopy.
    surfaces
        Share of the sun, luma of its reflection and exponent of its fall, shape (F, 3), of all faces.
    planes
        Normals in the camera's axes and distances [m], shape (F, 4); see `Renderer.face_planes`.
    rays
        Rays through all pixels, shape (H, W, 2) [1]; see `Renderer.rays`.
    pose
        ``cam_from_world``, shape (3, 4) [1 and m].
    """

    def __init__(
        self, light: Light, surfaces: FloatArray, *, planes: FloatArray, rays: FloatArray, pose: FloatArray
    ) -> None:
        self._light, self._rays = light, np.ascontiguousarray(rays)
        self._faces = np.ascontiguousarray(np.column_stack([planes, surfaces]))
        sun = light.direction
        across = np.cross(sun, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        axes = np.stack([sun, across, np.cross(sun, across)]) @ pose[:, :3].T
        center = np.zeros(3) if light.canopy is None else pose[:, :3] @ light.canopy.center + pose[:, 3]
        self._frame = np.ascontiguousarray(np.vstack([axes, center]))

    @cached_property
    def _density(self) -> npt.NDArray[np.float32]:
        canopy = self._light.canopy
        return np.zeros((1, 1), np.float32) if canopy is None else canopy_density(canopy)

    def maps(self, face: FaceImage, time_s: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """What shadows leave of the light, and the luma of reflections.

        Parameters
        ----------
        face
            Index of the face that each pixel shows, -1 for none, shape (H, W).
        time_s
            Time of the picture [s].

        Returns
        -------
        share, reflected
            Shape (H, W) each, [1] and luma of linear light above black.
        """
        canopy = self._light.canopy
        share, reflected = np.ones(face.shape, np.float32), np.zeros(face.shape, np.float32)
        sway, settings = np.zeros(4), np.zeros(3)
        if canopy is not None:
            moved = [compute_wandering([time_s], _SWAY_HZ, seed=canopy.seed + n)[0] for n in (1, 2)]
            sway = canopy.sway_m * np.concatenate(moved)
            settings = np.array([canopy.depth, 1 / canopy.radius_m, _CELLS_PER_LEAF / canopy.leaf_m])
        _shade(self._faces, self._rays, self._frame, self._density, np.append(settings, sway), face, share, reflected)
        return share, reflected

    def draw(self, luma: npt.NDArray[np.float32], face: FaceImage, time_s: float) -> npt.NDArray[np.float32]:
        """The picture in this light; see `maps`.

        Parameters
        ----------
        luma
            Linear light of the textures, shape (H, W), black is 16.
        face, time_s
            As in `maps`.

        Notes
        -----
        What a pixel's centre shows decides the light of all of it; the maps are blurred as edges are, so that a
        silhouette is as soft in them as in the picture.
        """
        share, reflected = (
            cv2.GaussianBlur(image, (7, 7), BLUR_PX, borderType=cv2.BORDER_REPLICATE)
            for image in self.maps(face, time_s)
        )
        lit: npt.NDArray[np.float32] = np.float32(BLACK) + (luma - np.float32(BLACK)) * share + reflected
        return lit


@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def _shade(
    faces: FloatArray,
    rays: FloatArray,
    frame: FloatArray,
    density: npt.NDArray[np.float32],
    settings: FloatArray,
    face: FaceImage,
    share: npt.NDArray[np.float32],
    reflected: npt.NDArray[np.float32],
) -> None:
    """Fills `Shading.maps`.

    Parameters
    ----------
    faces
        Normal, distance of the plane, share of the sun, luma and exponent of the reflection, shape (F, 7).
    rays, face, share, reflected
        Images of shape (H, W, ...).
    frame
        Rows: direction to the sun and two across it, and the middle of the shadows, in the camera's axes, shape (4, 3).
    density
        The leaves' pattern.
    settings
        Depth of the shadows [1], inverse of their radius [1/m], cells a metre, and the sway of two layers [m].
    """
    height, width = face.shape
    for row in nb.prange(height):
        for column in range(width):
            k = face[row, column]
            if k < 0 or (faces[k, 4] <= 0 and faces[k, 5] <= 0):
                continue
            x, y = rays[row, column, 0], rays[row, column, 1]
            slope = faces[k, 0] * x + faces[k, 1] * y + faces[k, 2]
            along = faces[k, 3] / slope
            taken = 0.0
            if settings[0] > 0:
                a, b = 0.0, 0.0
                for axis in range(3):
                    place = along * (x if axis == 0 else y if axis == 1 else 1.0) - frame[3, axis]
                    a += frame[1, axis] * place
                    b += frame[2, axis] * place
                inside = np.exp(-0.5 * (a * a + b * b) * settings[1] * settings[1])
                if inside > 1e-3:
                    cells = settings[2]
                    first = _between(density, (a + settings[3]) * cells, (b + settings[4]) * cells)
                    second = _between(density, (b + settings[5]) * cells, (a + settings[6]) * cells)
                    taken = settings[0] * inside * (1 - (1 - first) * (1 - second))
            share[row, column] = 1 - faces[k, 4] * taken
            if faces[k, 5] > 0:
                # Half-way between the sun and the camera; the normal is turned to the camera.
                size = np.sqrt(x * x + y * y + 1)
                h = frame[0, 0] - x / size, frame[0, 1] - y / size, frame[0, 2] - 1 / size
                cosine = (faces[k, 0] * h[0] + faces[k, 1] * h[1] + faces[k, 2] * h[2]) / np.sqrt(
                    h[0] * h[0] + h[1] * h[1] + h[2] * h[2]
                )
                cosine = -cosine if slope > 0 else cosine
                if cosine > 0:
                    reflected[row, column] = faces[k, 5] * cosine ** faces[k, 6] * (1 - taken)


@nb.njit(error_model="numpy", forceinline=True)
def _between(density: npt.NDArray[np.float32], x: float, y: float) -> float:
    """The pattern between its cells, linear; it repeats."""
    i, j = int(np.floor(x)), int(np.floor(y))
    s, t = x - i, y - j
    n = density.shape[0]
    above = (1 - s) * density[j % n, i % n] + s * density[j % n, (i + 1) % n]
    below = (1 - s) * density[(j + 1) % n, i % n] + s * density[(j + 1) % n, (i + 1) % n]
    return float((1 - t) * above + t * below)
