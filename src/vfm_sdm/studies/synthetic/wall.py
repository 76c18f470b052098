"""What stands far behind a bridge: a wall of stones that repeat, with windows, leaves before it, and the sky above."""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.building import Builder, Material, Triple, down
from vfm_sdm.studies.synthetic.lighting import Light
from vfm_sdm.studies.synthetic.scene import Mark, Scene

__all__ = ["Foliage", "Masonry", "build_backdrop"]

_REPEAT = (4, 6)
"""Stones and courses after which the wall looks the same again."""


@dataclass(frozen=True)
class Foliage:
    """Leaves around a place on the wall.

    Parameters
    ----------
    center_m
        Place along the wall from its middle to the right, and height, down [m].
    radius_m
        Standard deviations to the side and in height [m].
    count, leaf_m
        Number of leaves and their size [m].
    """

    center_m: tuple[float, float]
    radius_m: tuple[float, float]
    count: int = 300
    leaf_m: float = 0.14


@dataclass(frozen=True)
class Masonry:
    """The wall.

    Parameters
    ----------
    distance_m
        From the reference camera to its middle, along the mean direction of view [m].
    material
        Of the mortar; stones are drawn on it.
    stone_m, joint_m
        Length and height of a stone with its joint, and the joint's width [m].
    stone_luma
        Mean and standard deviation of the stones' luma over that of the mortar.
    half_m
        Half the wall's length, and its top and bottom as vertical coordinates [m].
    windows
        Places along the wall, from its middle to the right, and tops of windows of 1.2 by 1.7 m [m].
    turn_deg
        Rotation about the vertical from facing the cameras [deg].
    foliage
        Leaves before it.
    leaf
        Their material.
    sky
        Luma above the wall.
    """

    distance_m: float
    material: Material
    stone_m: tuple[float, float]
    joint_m: float
    stone_luma: tuple[float, float]
    half_m: float
    height_m: tuple[float, float]
    leaf: Material
    windows: tuple[tuple[float, float], ...] = ()
    turn_deg: float = 0.0
    foliage: tuple[Foliage, ...] = ()
    sky: float = 190.0


def build_backdrop(wall: Masonry, cameras: tuple[Camera, ...], light: Light, *, seed: int) -> Scene:
    """The wall as a scene of its own.

    Parameters
    ----------
    wall
        What it looks like.
    cameras
        All cameras of the site.
    light
        Sun and sky; its shadows do not reach so far.
    seed
        Seed of textures and leaves.
    """
    builder = Builder(cameras, seed, light)
    heading = float(np.mean([np.arctan2(camera.rotation[2][0], camera.rotation[2][2]) for camera in cameras]))
    facing = heading + np.deg2rad(wall.turn_deg)
    middle = wall.distance_m * np.array([np.sin(heading), 0.0, np.cos(heading)])
    across = np.array([np.cos(facing), 0.0, -np.sin(facing)])
    top, bottom = wall.height_m
    corner = _triple(middle - wall.half_m * across + np.array([0.0, top, 0.0]))
    size = (2 * wall.half_m, bottom - top)
    marks = (*_stones(wall, size, seed), _coping(wall))
    builder.add("wall", corner, (_triple(2 * wall.half_m * across), down(size[1])), wall.material, marks=marks)
    towards = -np.array([np.sin(facing), 0.0, np.cos(facing)])
    _add_windows(builder, wall, (middle, across, towards))
    for number, foliage in enumerate(wall.foliage):
        _add_leaves(builder, f"leaf {number}", foliage, wall.leaf, (middle, across, towards))
    return Scene(tuple(builder.faces), sky=wall.sky)


def _stones(wall: Masonry, size_m: tuple[float, float], seed: int) -> list[Mark]:
    """Stones in running bond, whose luma repeats exactly."""
    (length, height), (mean, spread) = wall.stone_m, wall.stone_luma
    luma = mean + spread * np.random.default_rng([seed, 1]).standard_normal(_REPEAT)
    half = (0.5 * (length - wall.joint_m), 0.5 * (height - wall.joint_m))
    stones = []
    for course in range(int(size_m[1] / height) + 1):
        for number in range(int(size_m[0] / length) + 2):
            center = ((number + 0.5 * (course % 2)) * length, (course + 0.5) * height)
            value = float(luma[number % _REPEAT[0], course % _REPEAT[1]])
            stones.append(Mark(center, (0.25 * wall.joint_m, 0.25 * wall.joint_m), value, half_m=half))
    return stones


def _coping(wall: Masonry) -> Mark:
    base = wall.material.mean + wall.stone_luma[0]
    return Mark((0.0, 0.12), (0.02, 0.02), 150 - base, half_m=(10 * wall.half_m, 0.12))


def _add_windows(builder: Builder, wall: Masonry, frame: tuple[FloatArray, FloatArray, FloatArray]) -> None:
    """Adds windows with two dark panes in a pale frame, a little before the wall."""
    middle, across, towards = frame
    for number, (along_m, top_m) in enumerate(wall.windows):
        corner = middle + along_m * across + np.array([0.0, top_m, 0.0]) + 0.02 * towards
        edges = _triple(1.36 * across), down(1.86)
        builder.add(f"window {number}", _triple(corner), edges, Material(175, 1.0, blur=wall.material.blur))
        for pane, start in enumerate((0.09, 0.72)):
            inner = corner + start * across + np.array([0.0, 0.09, 0.0]) + 0.02 * towards
            edges = _triple(0.55 * across), down(1.68)
            glass = Material(19, 0.5, blur=wall.material.blur)
            builder.add(f"window {number} pane {pane}", _triple(inner), edges, glass)


def _add_leaves(
    builder: Builder, name: str, foliage: Foliage, leaf: Material, frame: tuple[FloatArray, FloatArray, FloatArray]
) -> None:
    """Adds leaves in all directions, the inner ones darker."""
    rng = np.random.default_rng([builder.seed, *name.encode()])
    middle, across, towards = frame
    for number in range(foliage.count):
        sideways, up, ahead = rng.standard_normal(3)
        dark = np.exp(-0.5 * (sideways**2 + up**2)) * np.exp(-abs(ahead))
        shade = replace(leaf, mean=16 + (leaf.mean - 16) * rng.uniform(0.5, 1.3) * (1 - 0.5 * float(dark)))
        center = middle + (foliage.center_m[0] + foliage.radius_m[0] * sideways) * across
        center = center + np.array([0.0, foliage.center_m[1] + foliage.radius_m[1] * up, 0.0])
        center = center + (0.3 + 0.5 * abs(ahead)) * towards
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        length = foliage.leaf_m * rng.uniform(0.7, 1.3)
        edges = _triple(length * axes[0]), _triple(0.6 * length * axes[1])
        builder.add(f"{name} {number}", _triple(center), edges, shade)


def _triple(vector: FloatArray) -> Triple:
    x, y, z = (float(value) for value in vector)
    return x, y, z
