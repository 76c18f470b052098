"""Faces and boxes of given materials for a scene, with textures as fine as all its cameras can bear."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import BLACK
from vfm_sdm.studies.synthetic.lighting import Light
from vfm_sdm.studies.synthetic.scene import Face, Mark, Texture, coarsest_pixel

__all__ = ["Builder", "Material", "Side", "Triple", "along", "down"]

Triple = tuple[float, float, float]
Side = Literal["front", "near", "top", "bottom"]
"""Of a box: towards the reference camera's side, towards the span's beginning, up, down."""

_PIXELS_PER_WAVELENGTH = 2.6
"""Shortest wavelength of a texture, in sizes of the coarsest pixel that sees it."""
_NORMALS: dict[Side, Triple] = {
    "front": (-1.0, 0.0, 0.0),
    "near": (0.0, 0.0, -1.0),
    "top": (0.0, -1.0, 0.0),
    "bottom": (0.0, 1.0, 0.0),
}


@dataclass(frozen=True)
class Material:
    """Appearance of a surface; stains are counted per square metre.

    Parameters
    ----------
    mean, contrast
        Mean luma, and standard deviation of the texture.
    tint
        Blue and red chroma difference from grey.
    longest_m
        Wavelength beyond which the texture's spectrum is flat [m].
    stains
        Number of stains a square metre.
    blur
        Shortest wavelength, in multiples of the finest texture that the cameras can bear; more for what is out of
        focus.
    slope
        Fall of the texture's spectrum, see `vfm_sdm.studies.synthetic.scene.Texture`; 0 for grain.
    gloss
        Luma of the sun's reflection at the mirror's direction, and exponent of its fall.
    stain_depth
        How much darker the faintest and the darkest stain are [luma].
    """

    mean: float
    contrast: float
    tint: tuple[float, float] = (0.0, 0.0)
    longest_m: float = 0.3
    stains: float = 0.0
    blur: float = 1.0
    slope: float = 0.85
    gloss: tuple[float, float] = (0.0, 1.0)
    stain_depth: tuple[float, float] = (10.0, 32.0)


@dataclass
class Builder:
    """Collects the faces that a camera can see, each with a texture as fine as all cameras can bear.

    Parameters
    ----------
    cameras
        All cameras that will see the scene.
    seed
        Seed of all textures.
    light
        What falls on the faces: their luma is then linear in light. Without it, the materials' luma is that of the
        faces.
    """

    cameras: tuple[Camera, ...]
    seed: int
    light: Light | None = None
    faces: list[Face] = field(default_factory=list)

    def add(
        self,
        name: str,
        corner: Triple,
        edges: tuple[Triple, Triple],
        material: Material,
        *,
        moving: bool = False,
        marks: tuple[Mark, ...] = (),
    ) -> None:
        """Adds a face, or nothing where no camera sees it.

        Parameters
        ----------
        name
            Decides the look of the texture.
        corner, edges
            As of a `Face` [m].
        material
            Its appearance.
        moving
            Whether it moves with the structure.
        marks
            Drawn on it, before the light.
        """
        edge_u, edge_v = np.asarray(edges[0], np.float64), np.asarray(edges[1], np.float64)
        pixel = coarsest_pixel(corner, edge_u, edge_v, self.cameras)
        if pixel is None:
            return
        # From the name, so that a face keeps its look when others are added or leave the picture.
        seed = [self.seed, *name.encode()]
        rng = np.random.default_rng(seed)
        size = (float(np.linalg.norm(edge_u)), float(np.linalg.norm(edge_v)))
        finest = _PIXELS_PER_WAVELENGTH * material.blur
        texture = Texture(
            seed=int(rng.integers(2**32)),
            mean=material.mean,
            contrast=material.contrast,
            shortest_m=(finest * pixel[0], finest * pixel[1]),
            longest_m=material.longest_m,
            slope=material.slope,
            marks=(*marks, *_stains(material, size, rng)),
        )
        face = Face(name, np.asarray(corner), edge_u, edge_v, texture, moving, material.tint)
        self.faces.append(face if self.light is None else _in_light(face, self.light, self._normal(face), material))

    def add_box(
        self,
        name: str,
        box: tuple[Triple, Triple],
        material: Material,
        *,
        sides: tuple[Side, ...] = ("front", "near"),
        moving: bool = False,
        marks: tuple[Mark, ...] = (),
    ) -> None:
        """Adds sides of a box that a camera sees.

        Parameters
        ----------
        name
            Of the box; its sides are told apart by theirs.
        box
            Corner with the smallest coordinates, and lengths along the axes [m].
        material, moving
            As in `add`.
        sides
            Which sides; those that no camera is in front of are left out.
        marks
            On the front, from its upper corner towards the span's beginning, along the structure and down.
        """
        corner, (dx, dy, dz) = box
        x, y, _ = corner
        faces: dict[Side, tuple[Triple, tuple[Triple, Triple]]] = {
            "front": (corner, (along(dz), down(dy))),
            "near": (corner, ((dx, 0.0, 0.0), down(dy))),
            "top": (corner, (along(dz), (dx, 0.0, 0.0))),
            "bottom": ((x, y + dy, corner[2]), (along(dz), (dx, 0.0, 0.0))),
        }
        for side in sides:
            origin, edges = faces[side]
            if any((camera.center - origin) @ _NORMALS[side] > 0 for camera in self.cameras):
                on_it = marks if side == "front" else ()
                self.add(f"{name} {side}", origin, edges, material, moving=moving, marks=on_it)

    def _normal(self, face: Face) -> FloatArray:
        """Unit normal of a face towards the cameras, shape (3,) [1]."""
        normal = np.cross(face.edge_u, face.edge_v)
        center = face.origin + 0.5 * (face.edge_u + face.edge_v)
        seen_from = np.mean([camera.center for camera in self.cameras], axis=0)
        return np.asarray(normal / np.linalg.norm(normal) * np.sign(normal @ (seen_from - center)))


def _in_light(face: Face, light: Light, normal: FloatArray, material: Material) -> Face:
    """The face with its texture as bright as the light makes it; black is 16."""
    share, texture = light.irradiance(normal), face.texture
    marks = tuple(replace(mark, luma=share * mark.luma) for mark in texture.marks)
    mean = BLACK + share * (texture.mean - BLACK)
    texture = replace(texture, mean=mean, contrast=share * texture.contrast, marks=marks)
    return replace(face, texture=texture, gloss=material.gloss)


def _stains(material: Material, size_m: tuple[float, float], rng: np.random.Generator) -> list[Mark]:
    """Dark spots and, one in three, streaks that run down."""
    marks = []
    for _ in range(rng.poisson(material.stains * size_m[0] * size_m[1])):
        radius = rng.uniform(0.006, 0.025)
        length = radius * (rng.uniform(2, 6) if rng.random() < 1 / 3 else rng.uniform(0.7, 1.4))
        center = (rng.uniform(0, size_m[0]), rng.uniform(0, size_m[1]))
        marks.append(Mark(center, (radius, length), -rng.uniform(*material.stain_depth)))
    return marks


def along(length_m: float) -> Triple:
    """Vector along the structure [m]."""
    return (0.0, 0.0, length_m)


def down(height_m: float) -> Triple:
    """Vector downwards [m]."""
    return (0.0, height_m, 0.0)
