"""Light of a sun that changes a picture between view and view and from frame to frame: reflections, moving shadows.

A reflection depends on the direction in which a face is seen; it is part of the face's texture for one camera. Shadows
of leaves lie in the world while the structure moves through them by millimetres: they are drawn over the picture.
"""

from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.cast_arrays import BLUR_PX, FaceImage
from vfm_sdm.studies.synthetic.defects import BLACK, compute_wandering

__all__ = ["Canopy", "Light", "Shading", "canopy_density", "compute_reflection"]

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
    """Leaves above the structure, whose shadows sway; they take the light of the sun and of the sky behind them.

    Parameters
    ----------
    center
        World point in the middle of what they shade [m].
    radius_m
        Standard deviation of the shaded area across the sun's rays [m].
    leaf_m
        Size of a shadow [m].
    depth
        Share of the light that is taken where leaves are dense [1].
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
    depth: float = 0.5
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


def compute_reflection(
    light: Light, gloss: tuple[float, float], *, normal: FloatArray, points3d: FloatArray, center: FloatArray
) -> FloatArray:
    """Luma of the sun's reflection in a glossy face, above black, shape (...).

    Parameters
    ----------
    light
        The sun.
    gloss
        Luma in the mirror's direction, and exponent.
    normal
        Unit normal of the face, to either side, shape (3,) [1].
    points3d
        Points of the face, world frame, shape (..., 3) [m].
    center
        Optical centre of the camera, shape (3,) [m].

    Notes
    -----
    ``luma (n . h)^exponent`` with h half-way between the directions to sun and camera; none on a face that is turned
    from the sun.

    References
    ----------
    .. [1] Blinn, J. F. (1977). Models of light reflection for computer synthesized pictures. SIGGRAPH Computer Graphics
       11(2), 192-198.

    Examples
    --------
    >>> wall, ahead = np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, 1.0])
    >>> sun = Light((0.0, 0.0, -1.0))
    >>> float(compute_reflection(sun, (40.0, 20.0), normal=ahead, points3d=wall, center=np.zeros(3)))
    40.0
    """
    sun, view = light.direction, center - points3d
    distance = np.linalg.norm(view, axis=-1)
    towards = normal * np.sign(np.mean(view @ normal))
    if float(towards @ sun) <= 0:
        return np.zeros(distance.shape)
    cosine = (float(towards @ sun) + view @ towards / distance) / np.sqrt(2 + 2 * (view @ sun) / distance)
    return np.asarray(gloss[0] * np.clip(cosine, 0, 1) ** gloss[1])


class Shading:
    """Shadows of a canopy as one camera sees them.

    Parameters
    ----------
    light
        Sun and canopy.
    planes
        Normals in the camera's axes and distances [m], shape (F, 4); see `Renderer.face_planes`.
    rays
        Rays through all pixels, shape (H, W, 2) [1]; see `Renderer.rays`.
    pose
        ``cam_from_world``, shape (3, 4) [1 and m].

    Raises
    ------
    DatasetError
        The light has no canopy.
    """

    def __init__(self, light: Light, *, planes: FloatArray, rays: FloatArray, pose: FloatArray) -> None:
        if light.canopy is None:
            raise DatasetError("light: expected a canopy, got none; shadows need one")
        self._canopy, self._rays, self._planes = light.canopy, np.ascontiguousarray(rays), np.ascontiguousarray(planes)
        self._density = canopy_density(light.canopy)
        sun = light.direction
        across = np.cross(sun, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(sun, across)]) @ pose[:, :3].T
        center = pose[:, :3] @ light.canopy.center + pose[:, 3]
        self._frame = np.ascontiguousarray(np.vstack([axes, center]))

    def share(self, face: FaceImage, time_s: float) -> npt.NDArray[np.float32]:
        """What shadows leave of the light, shape (H, W) [1].

        Parameters
        ----------
        face
            Index of the face that each pixel shows, -1 for none, shape (H, W).
        time_s
            Time of the picture [s].
        """
        canopy, left = self._canopy, np.ones(face.shape, np.float32)
        sway = [compute_wandering([time_s], _SWAY_HZ, seed=canopy.seed + n)[0] for n in (1, 2)]
        settings = [canopy.depth, 1 / canopy.radius_m, _CELLS_PER_LEAF / canopy.leaf_m]
        moved = np.concatenate([settings, *(canopy.sway_m * s for s in sway)])
        _shade(self._planes, self._rays, (self._frame, self._density, moved), face, left)
        return left

    def draw(self, luma: npt.NDArray[np.float32], face: FaceImage, time_s: float) -> npt.NDArray[np.float32]:
        """The picture with its shadows.

        Parameters
        ----------
        luma
            Linear light of the scene, shape (H, W), black is 16.
        face, time_s
            As in `share`.

        Notes
        -----
        What a pixel's centre shows decides the shadow on all of it. At a silhouette before something that is not in
        the shadow, that is wrong by up to half a pixel; blurred as edges are, it averages out along a slanted edge.
        """
        share = cv2.GaussianBlur(self.share(face, time_s), (7, 7), BLUR_PX, borderType=cv2.BORDER_REPLICATE)
        lit: npt.NDArray[np.float32] = np.float32(BLACK) + (luma - np.float32(BLACK)) * share
        return lit


@nb.njit(cache=True, error_model="numpy", parallel=True)
@cached_by_code
def _shade(
    planes: FloatArray,
    rays: FloatArray,
    canopy: tuple[FloatArray, npt.NDArray[np.float32], FloatArray],
    face: FaceImage,
    share: npt.NDArray[np.float32],
) -> None:
    """Fills `Shading.share`.

    Parameters
    ----------
    planes, rays, face, share
        As in `Shading`.
    canopy
        Two directions across the sun's rays and the middle of the shadows in the camera's axes, shape (3, 3); the
        leaves' pattern; depth of the shadows [1], inverse of their radius [1/m], cells a metre, and the sway of two
        layers [m], shape (7,).
    """
    frame, density, settings = canopy
    height, width = face.shape
    for row in nb.prange(height):
        for column in range(width):
            k = face[row, column]
            if k < 0:
                continue
            x, y = rays[row, column, 0], rays[row, column, 1]
            along = planes[k, 3] / (planes[k, 0] * x + planes[k, 1] * y + planes[k, 2])
            px, py, pz = along * x - frame[2, 0], along * y - frame[2, 1], along - frame[2, 2]
            a = frame[0, 0] * px + frame[0, 1] * py + frame[0, 2] * pz
            b = frame[1, 0] * px + frame[1, 1] * py + frame[1, 2] * pz
            inside = np.exp(-0.5 * (a * a + b * b) * settings[1] * settings[1])
            if inside > 1e-3:
                cells = settings[2]
                first = _between(density, (a + settings[3]) * cells, (b + settings[4]) * cells)
                second = _between(density, (b + settings[5]) * cells, (a + settings[6]) * cells)
                share[row, column] = 1 - settings[0] * inside * (1 - (1 - first) * (1 - second))


@nb.njit(error_model="numpy", forceinline=True)
def _between(density: npt.NDArray[np.float32], x: float, y: float) -> float:
    """The pattern between its cells, linear; it repeats."""
    i, j = int(np.floor(x)), int(np.floor(y))
    s, t = x - i, y - j
    n = density.shape[0]
    above = (1 - s) * density[j % n, i % n] + s * density[j % n, (i + 1) % n]
    below = (1 - s) * density[(j + 1) % n, i % n] + s * density[(j + 1) % n, (i + 1) % n]
    return float((1 - t) * above + t * below)
