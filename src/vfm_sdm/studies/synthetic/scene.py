"""A scene of textured rectangles in the structure's axes.

World frame: the structural axes with the reference camera's optical centre as origin: lateral (horizontal, away from
that camera), vertical (down), longitudinal (along the structure). It is right-handed with the structure on the right
of an observer who looks along the longitudinal axis. Lengths are metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.ndimage import spline_filter
from scipy.special import erf

from vfm_sdm.core.arrays import BoolArray, FloatArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import BLACK
from vfm_sdm.studies.synthetic.lighting import Light

__all__ = ["Face", "Mark", "Scene", "Texture", "coarsest_pixel", "find_hidden", "texture_luma"]

TEXELS_PER_WAVELENGTH = 4
"""Texels in the shortest wavelength; fewer let the spline's image spectra through."""
GUARD = 8
"""Texels drawn beyond each edge of a face, so that it can be looked at a little beyond them."""
_TAPER_START = 0.6
_SMALLEST_MARK = 0.4
"""Least standard deviation of a mark in shortest wavelengths, where its spectrum has fallen to 4 %."""
_GRID = 48
_VISIBLE_MARGIN = 0.05


@dataclass(frozen=True)
class Mark:
    """A spot on a surface: a stain, a bolt, a joint, a brick or a shadow.

    Parameters
    ----------
    center_m
        Place of its centre along the face's edges u and v, from its origin [m].
    radius_m
        Standard deviations of its Gaussian profile along u and v [m]; raised to what the texture can hold.
    luma
        Change of luma at its centre, negative for dark.
    half_m
        Half the lengths along u and v of a rectangle whose edges are as soft as the radius says [m]; 0 for a spot.
    taken
        Share of the luma above black that it takes, as a shadow does [1]; it acts after the marks before it.
    """

    center_m: tuple[float, float]
    radius_m: tuple[float, float]
    luma: float
    half_m: tuple[float, float] = (0.0, 0.0)
    taken: float = 0.0


@dataclass(frozen=True)
class Texture:
    """Luma of a surface: band-limited 1/f noise, as natural surfaces have it, with marks on it.

    Parameters
    ----------
    seed
        Seed of ``numpy.random.default_rng``.
    mean, contrast
        Mean and standard deviation of the noise in luma units of 8 bits.
    shortest_m
        Shortest wavelength along the face's edges u and v [m]; nothing finer is there, so that a camera whose pixels
        are smaller than half of it sees no aliasing.
    longest_m
        Wavelength beyond which the spectrum is flat [m].
    slope
        Amplitude falls with frequency to the power of minus this; 1 gives every octave the same contrast.
    marks
        Spots drawn over the noise.
    """

    seed: int
    mean: float
    contrast: float
    shortest_m: tuple[float, float]
    longest_m: float = 0.5
    slope: float = 1.0
    marks: tuple[Mark, ...] = ()

    @property
    def texels_per_m(self) -> FloatArray:
        """Number of texels a metre along u and v, shape (2,) [1/m]."""
        return TEXELS_PER_WAVELENGTH / np.asarray(self.shortest_m)

    def __post_init__(self) -> None:
        if min(*self.shortest_m, self.longest_m) <= 0 or not np.isfinite([*self.shortest_m, self.longest_m]).all():
            raise DatasetError(
                f"texture: expected wavelengths > 0 m, got {self.shortest_m} and {self.longest_m}; give metres"
            )


@dataclass(frozen=True, eq=False)
class Face:
    """A textured rectangle.

    Parameters
    ----------
    name
        Name of what it shows.
    origin
        One corner in the world frame, shape (3,) [m].
    edge_u, edge_v
        Vectors from that corner along two sides, at right angles, shape (3,) [m].
    texture
        Luma of the surface.
    moving
        Whether it moves with the structure.
    tint
        Blue and red chroma difference from grey, units of 8 bits.
    gloss
        Luma of the sun's reflection where the face mirrors it, and exponent of its fall
        (`vfm_sdm.studies.synthetic.lighting.compute_reflection`).

    Raises
    ------
    DatasetError
        An edge has no length, the edges are not at right angles, or a shape is wrong.
    """

    name: str
    origin: FloatArray
    edge_u: FloatArray
    edge_v: FloatArray
    texture: Texture
    moving: bool = False
    tint: tuple[float, float] = (0.0, 0.0)
    gloss: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        for field in ("origin", "edge_u", "edge_v"):
            frozen = as_float_array(getattr(self, field), f"{self.name}.{field}", (3,)).copy()
            frozen.flags.writeable = False
            object.__setattr__(self, field, frozen)
        lengths = self.size_m
        # Written so that NaN fails it too.
        if not (min(lengths) > 0 and abs(self.edge_u @ self.edge_v) <= 1e-9 * lengths[0] * lengths[1]):
            raise DatasetError(
                f"{self.name}: expected two edges at right angles, got {self.edge_u.tolist()} and "
                f"{self.edge_v.tolist()}; make it a rectangle"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Lengths of the edges u and v [m]."""
        return float(np.linalg.norm(self.edge_u)), float(np.linalg.norm(self.edge_v))

    @property
    def corners(self) -> FloatArray:
        """The four corners in the world frame, shape (4, 3) [m]."""
        return np.array([self.origin + a * self.edge_u + b * self.edge_v for a in (0, 1) for b in (0, 1)])

    def points3d(self, along_m: npt.ArrayLike) -> FloatArray:
        """World points of the face.

        Parameters
        ----------
        along_m
            Distances along the edges u and v, shape (..., 2) [m].

        Returns
        -------
        points3d
            World frame, shape (..., 3) [m].

        Raises
        ------
        DatasetError
            The distances have another shape.

        Examples
        --------
        >>> texture = Texture(seed=0, mean=120, contrast=20, shortest_m=(0.05, 0.05))
        >>> face = Face("web", np.array([7.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0]), np.array([0.0, 1.0, 0.0]), texture)
        >>> face.points3d([1.5, 0.5]).tolist()
        [7.0, 0.5, 1.5]
        """
        distances = as_float_array(along_m, "along_m", (-1, 2))
        directions = np.stack([self.edge_u / self.size_m[0], self.edge_v / self.size_m[1]])
        return np.asarray(self.origin + distances @ directions)


@dataclass(frozen=True, eq=False)
class Scene:
    """Faces, and what is seen where there is none.

    Parameters
    ----------
    faces
        Faces in any order; the nearest one on a ray is seen.
    sky
        Luma beyond all faces.
    backdrop
        What is seen instead of the sky: a scene far behind that stands still, drawn once and out of focus.
    light
        Sun whose reflections and moving shadows are drawn; without it, the light is in the textures alone.

    Raises
    ------
    DatasetError
        There is no face, or a name appears twice.
    """

    faces: tuple[Face, ...]
    sky: float = 200.0
    backdrop: "Scene | None" = None
    light: Light | None = None

    def __post_init__(self) -> None:
        names = [face.name for face in self.faces]
        if not names or len(set(names)) != len(names):
            raise DatasetError(f"scene: expected at least one face and distinct names, got {names}; rename them")

    @cached_property
    def splines(self) -> tuple[npt.NDArray[np.float32], ...]:
        """Coefficients of the cubic B-spline through the texels of each face, shape (n_v, n_u)."""
        return tuple(
            spline_filter(texture_luma(face.texture, face.size_m), order=3, mode="mirror").astype(np.float32)
            for face in self.faces
        )

    def face(self, name: str) -> Face:
        """The face of a name.

        Parameters
        ----------
        name
            Name of the face.

        Raises
        ------
        DatasetError
            No face has this name.
        """
        for face in self.faces:
            if face.name == name:
                return face
        raise DatasetError(f"face {name!r}: expected one of {[face.name for face in self.faces]}; correct the name")


def texture_luma(texture: Texture, size_m: tuple[float, float]) -> FloatArray:
    """Luma of a texture on a grid of texels that begins `GUARD` texels before the origin.

    Parameters
    ----------
    texture
        Texture to draw.
    size_m
        Lengths along u and v to cover [m].

    Returns
    -------
    luma
        Shape (n_v, n_u), in units of 8-bit video.

    Notes
    -----
    White noise is shaped in the frequency domain, so the band limit is exact: zero beyond the ellipse
    ``(f_u shortest_u)^2 + (f_v shortest_v)^2 = 1``.

    Examples
    --------
    >>> texture = Texture(seed=0, mean=120, contrast=20, shortest_m=(0.05, 0.05))
    >>> face = Face("web", np.array([7.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0]), np.array([0.0, 1.0, 0.0]), texture)
    >>> luma = texture_luma(texture, face.size_m)
    >>> round(float(luma.mean())), round(float(luma.std()))
    (120, 20)
    """
    texel = 1 / texture.texels_per_m
    n_u, n_v = (int(n) + 2 * GUARD for n in np.ceil(np.asarray(size_m) / texel))
    # Transforms of lengths with large prime factors take several times as long: the texture may be a little larger.
    n_u, n_v = next_fast_len(n_u, real=True), next_fast_len(n_v)
    f_u, f_v = np.fft.rfftfreq(n_u, texel[0]), np.fft.fftfreq(n_v, texel[1])[:, None]
    rho = np.hypot(f_u * texture.shortest_m[0], f_v * texture.shortest_m[1])
    floor = np.sqrt(texture.shortest_m[0] * texture.shortest_m[1]) / texture.longest_m
    taper = np.cos(0.5 * np.pi * np.clip((rho - _TAPER_START) / (1 - _TAPER_START), 0, 1)) ** 2
    spectrum = np.fft.rfft2(np.random.default_rng(texture.seed).standard_normal((n_v, n_u)))
    spectrum *= taper * np.maximum(rho, floor) ** -texture.slope
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, s=(n_v, n_u))
    luma = texture.mean + noise * (texture.contrast / max(float(noise.std()), 1e-12))
    for mark in texture.marks:
        _draw(luma, mark, texel, np.asarray(texture.shortest_m))
    return luma


def _draw(luma: FloatArray, mark: Mark, texel: FloatArray, shortest: FloatArray) -> None:
    """Adds a mark in place; the window of 5 standard deviations cuts it where it is below 4e-6 of its height."""
    profiles, windows = [], []
    for axis in range(2):
        radius = max(mark.radius_m[axis], _SMALLEST_MARK * shortest[axis])
        center = mark.center_m[axis] / texel[axis] + GUARD
        half = mark.half_m[axis]
        reach = (half + 5 * radius) / texel[axis]
        first, last = max(0, int(center - reach)), min(luma.shape[1 - axis], int(center + reach) + 2)
        distance = (np.arange(first, last) - center) * texel[axis]
        if half > 0:
            ends = (erf((distance + sign * half) / (np.sqrt(2) * radius)) for sign in (1, -1))
            profiles.append(0.5 * np.subtract(*ends))
        else:
            profiles.append(np.exp(-0.5 * (distance / radius) ** 2))
        windows.append(slice(first, max(first, last)))
    profile = np.outer(profiles[1], profiles[0])
    area = luma[windows[1], windows[0]]
    if mark.taken > 0:
        area -= mark.taken * profile * (area - BLACK)
    area += mark.luma * profile


def find_hidden(scene: Scene, camera: Camera, points3d: npt.ArrayLike, *, clearance_m: float = 0.01) -> BoolArray:
    """Which points a camera does not see at rest, because a face is before them or they are outside the picture.

    Parameters
    ----------
    scene
        Its faces hide each other; the backdrop hides nothing.
    camera
        The camera.
    points3d
        Points on faces, world frame, shape (P, 3) [m].
    clearance_m
        How much nearer than the point a face must be to hide it [m].

    Returns
    -------
    hidden
        Shape (P,).

    Examples
    --------
    >>> texture = Texture(seed=0, mean=120, contrast=20, shortest_m=(0.05, 0.05))
    >>> face = Face("web", np.array([-1.0, -1.0, 5.0]), np.array([2.0, 0, 0]), np.array([0, 2.0, 0]), texture)
    >>> camera = Camera(np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]), (640, 480))
    >>> find_hidden(Scene((face,)), camera, [[0.0, 0.0, 5.0], [0.0, 0.0, 6.0], [3.0, 0.0, 5.0]]).tolist()
    [False, True, True]
    """
    points = as_float_array(points3d, "points3d", (None, 3))
    pixel = camera.project(points)
    with np.errstate(invalid="ignore"):
        hidden = ~np.all((pixel >= 0) & (pixel <= np.asarray(camera.image_size) - 1), axis=1)
    rays = points - camera.center
    length = np.linalg.norm(rays, axis=1)
    for face in scene.faces:
        normal = np.cross(face.edge_u, face.edge_v)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = normal @ (face.origin - camera.center) / (rays @ normal)
            hit = camera.center + share[:, None] * rays - face.origin
            a, b = (hit @ edge / (edge @ edge) for edge in (face.edge_u, face.edge_v))
            before = (share > 0) & ((1 - share) * length > clearance_m)
            hidden |= before & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
    return np.asarray(hidden)


def coarsest_pixel(
    origin: npt.ArrayLike, edge_u: npt.ArrayLike, edge_v: npt.ArrayLike, cameras: Sequence[Camera]
) -> tuple[float, float] | None:
    """Size on a rectangle of the coarsest pixel that sees it, along each edge [m]; None where no camera sees it.

    Parameters
    ----------
    origin, edge_u, edge_v
        Corner and edges as of a `Face`, shape (3,) [m].
    cameras
        All cameras that a texture must suit; occlusion is not considered.

    Notes
    -----
    A texture whose shortest wavelengths are n times these sizes has no frequency above 1 / n cycles a pixel in any
    image. A wave with wave vector f (cycles a metre along u and v) has the frequency ``J^-T f`` in the image, where J
    holds the derivatives of the pixel by the distances along u and v; the columns of ``J^-T`` bound each edge alone,
    and both sizes are raised by the largest singular value that is left for waves between the two.

    Examples
    --------
    >>> camera = Camera(np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]), (640, 480))
    >>> sizes = coarsest_pixel([-1.0, -1.0, 10.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [camera])
    >>> np.round(sizes, 4).tolist()
    [0.01, 0.01]
    """
    corner, u, v = (as_float_array(x, "rectangle", (3,)) for x in (origin, edge_u, edge_v))
    lengths = np.linalg.norm([u, v], axis=1)
    a, b = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, _GRID)]))
    points = corner + a[:, None] * u + b[:, None] * v
    step = 1e-4
    inverses = [np.zeros((0, 2, 2))]
    for camera in cameras:
        pixel = camera.project(points)
        margin = _VISIBLE_MARGIN * np.asarray(camera.image_size)
        with np.errstate(invalid="ignore"):
            seen = np.all((pixel > -margin) & (pixel < np.asarray(camera.image_size) + margin), axis=1)
        by_u = (camera.project(points[seen] + step * u / lengths[0]) - pixel[seen]) / step
        by_v = (camera.project(points[seen] + step * v / lengths[1]) - pixel[seen]) / step
        J = np.stack([by_u, by_v], axis=-1)
        # A face seen edge-on has no area and no usable texture there.
        inverses.append(np.linalg.inv(J[np.abs(np.linalg.det(J)) > 1e-3]).transpose(0, 2, 1))
    waves = np.concatenate(inverses)
    if not len(waves):
        return None
    sizes = np.linalg.norm(waves, axis=1).max(axis=0)
    sizes *= np.linalg.norm(waves / sizes, ord=2, axis=(1, 2)).max()
    return float(sizes[0]), float(sizes[1])
