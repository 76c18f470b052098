"""A footbridge seen by two cameras or more: girder, deck edge and railings move; abutment, slope and trees do not.

All places are metres in the world frame of `vfm_sdm.studies.synthetic.scene`: (lateral, vertical, longitudinal) from
the optical centre of the reference camera.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.studies.synthetic.building import Builder, Material, Triple, along, down
from vfm_sdm.studies.synthetic.scene import Mark, Scene

__all__ = ["FootbridgeSite", "Standpoint", "build_footbridge", "make_camera"]

_BACKDROP_M = 33.0
"""Distance at which the trees have their natural size."""
_POST_SPACING_M = 1.2


def make_camera(
    center: FloatArray,
    angle_rad: float,
    *,
    focal_px: float,
    image_size: tuple[int, int],
    level_rad: tuple[float, float] = (0.0, 0.0),
    k1: float = 0.0,
) -> Camera:
    """A camera in the structural axes whose optical axis meets the longitudinal axis at a horizontal angle.

    Parameters
    ----------
    center
        Optical centre, shape (3,) [m].
    angle_rad
        As in `vfm_sdm.geometry.structure_frame.structure_from_cam1` [rad].
    focal_px
        Focal length; the principal point is the image's centre [px].
    image_size
        Width and height [px].
    level_rad
        Pitch and roll [rad].
    k1
        First radial coefficient of the distortion [1].

    Returns
    -------
    camera
        Camera with K, shape (3, 3) [px], and ``cam_from_world``, shape (3, 4) [m].

    Examples
    --------
    >>> camera = make_camera(np.zeros(3), np.pi / 2, focal_px=1000.0, image_size=(640, 480))
    >>> camera.project([10.0, 0.0, 0.0]).round(6).tolist()
    [319.5, 239.5]
    """
    width, height = image_size
    K = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    R = structure_from_cam1(angle_rad, pitch_rad=level_rad[0], roll_rad=level_rad[1]).T
    pose = np.column_stack([R, -R @ np.asarray(center, np.float64)])
    return Camera(K=K, image_size=image_size, distortion=np.array([k1, 0, 0, 0, 0]), cam_from_world=pose)


@dataclass(frozen=True)
class Standpoint:
    """Where a camera beside the reference one stands, and its lens.

    Parameters
    ----------
    center
        Optical centre [m].
    target_m
        Longitudinal coordinate on the girder's face at which it looks [m].
    focal_px
        Focal length at an image width of 1280 px [px].
    k1
        First radial distortion coefficient [1].
    level_deg
        Pitch and roll [deg].
    """

    center: Triple
    target_m: float
    focal_px: float
    k1: float
    level_deg: tuple[float, float] = (-0.7, 0.9)


@dataclass(frozen=True)
class FootbridgeSite:
    """Where the footbridge and the cameras stand.

    Parameters
    ----------
    perpendicular_m, longitudinal_m
        Distance from the reference camera to the girder's face, and along it to the centre of the reference view [m].
        The reference camera is level.
    focal_px, k1
        Focal length of the reference camera at an image width of 1280 px [px], and its first radial coefficient [1].
    further
        The cameras beside it.
    support_m, span_m
        Longitudinal coordinate of the first support, and distance to the second [m].
    image_size
        Width and height of all views [px].
    bays
        Plates in the span, a multiple of 4, so that the quarter points lie in the middle of a plate.
    bolted_middles
        Whether cross girders are bolted to the middle of every plate.
    backdrop_m
        Distance from the reference camera to the trees [m].
    valley
        Whether the bridge spans a valley: the slope runs on below it, and abutments stand at both supports.
    """

    perpendicular_m: float = 7.0
    longitudinal_m: float = 4.5
    focal_px: float = 3200.0
    k1: float = -0.04
    further: tuple[Standpoint, ...] = (Standpoint((2.0, -0.12, -3.2), 4.4, focal_px=3150.0, k1=-0.03),)
    support_m: float = 0.0
    span_m: float = 12.4
    image_size: tuple[int, int] = (1280, 720)
    bays: int = 8
    bolted_middles: bool = False
    backdrop_m: float = _BACKDROP_M
    valley: bool = False

    def __post_init__(self) -> None:
        if not self.further:
            raise DatasetError("further: expected at least one camera beside the reference, got none; add a Standpoint")
        if self.bays < 4 or self.bays % 4:
            raise DatasetError(f"bays: expected a positive multiple of 4, got {self.bays}; correct it")

    def cameras(self) -> tuple[Camera, ...]:
        """The reference camera and the further ones, in the structural axes."""
        scale = self.image_size[0] / 1280
        reference = make_camera(
            np.zeros(3),
            compute_view_angle(self.perpendicular_m, self.longitudinal_m),
            focal_px=scale * self.focal_px,
            image_size=self.image_size,
            k1=self.k1,
        )
        return (reference, *(self._camera_at(place, scale) for place in self.further))

    def _camera_at(self, place: Standpoint, scale: float) -> Camera:
        center = np.asarray(place.center)
        pitch, roll = np.deg2rad(place.level_deg)
        return make_camera(
            center,
            compute_view_angle(self.perpendicular_m - center[0], place.target_m - center[2]),
            focal_px=scale * place.focal_px,
            image_size=self.image_size,
            level_rad=(pitch, roll),
            k1=place.k1,
        )

    def with_second_at(self, center: Triple) -> Self:
        """The site with the second camera at another optical centre [m]."""
        second, *others = self.further
        return replace(self, further=(replace(second, center=center), *others))

    def scene(self, *, seed: int) -> Scene:
        """The scene; see `build_footbridge`."""
        return build_footbridge(self, seed=seed)

    @property
    def level_deg(self) -> tuple[float, float]:
        """Pitch and roll of the reference camera [deg]."""
        return 0.0, 0.0

    def station(self, share: float) -> float:
        """Longitudinal coordinate of a cross-section [m].

        Parameters
        ----------
        share
            Share of the span, 0 and 1 being the supports [1].

        Examples
        --------
        >>> FootbridgeSite(support_m=2.0, span_m=12.0).station(0.25)
        5.0
        """
        return self.support_m + share * self.span_m


_STEEL = Material(102, 26, tint=(-4, -7), stains=9)
_BRIGHT_STEEL = Material(126, 22, tint=(-4, -7), stains=9)
_CONCRETE = Material(156, 21, tint=(-5, 3), stains=7)
_GALVANISED = Material(140, 14, longest_m=0.2, stains=4)
_SHADED_STEEL = Material(62, 13, tint=(-3, -4))
_MASONRY = Material(134, 17, tint=(-9, 7), stains=10)
_GRASS = Material(94, 21, tint=(-15, -5), longest_m=0.6)
_TREES = Material(78, 17, tint=(-9, -6), longest_m=2.5, blur=1.6)
_SHADED_MASONRY = Material(104, 15, tint=(-8, 6), stains=10)


def _splice(bay_m: float, height_m: float) -> tuple[Mark, ...]:
    """Both ends of a plate: two columns of bolt heads and a dark joint."""
    marks: list[Mark] = []
    for end in (0.0, bay_m):
        marks.append(Mark((end, height_m / 2), (0.006, 100 * height_m), -40))
        for u in (0.06, 0.14):
            marks += _bolts(abs(end - u), np.arange(0.14, height_m - 0.1, 0.08))
    return tuple(marks)


def _connection(bay_m: float, height_m: float) -> tuple[Mark, ...]:
    """The middle of a plate: four columns of bolt heads, the outer ones with every other bolt."""
    rows = np.arange(0.14, height_m - 0.1, 0.08)
    marks: list[Mark] = []
    for u, step in ((-0.24, 2), (-0.09, 1), (0.09, 1), (0.24, 2)):
        marks += _bolts(bay_m / 2 + u, rows[::step])
    return tuple(marks)


def _bolts(u_m: float, rows_m: FloatArray) -> list[Mark]:
    """Bolt heads one below the other, each with its shadow."""
    marks = []
    for v in rows_m:
        marks.append(Mark((u_m + 0.004, float(v) + 0.009), (0.012, 0.010), -56))
        marks.append(Mark((u_m - 0.002, float(v) - 0.004), (0.009, 0.008), 55))
    return marks


def build_footbridge(site: FootbridgeSite, *, seed: int) -> Scene:
    """Scene of the footbridge in the structural axes [m]; faces that no camera of the site sees are left out.

    Parameters
    ----------
    site
        Places of footbridge and cameras.
    seed
        Seed of all textures.

    Raises
    ------
    DatasetError
        The cameras do not see the girder.
    """
    builder = Builder(site.cameras(), seed)
    _add_girder(builder, site)
    _add_railings(builder, site)
    _add_ground(builder, site)
    if not any(face.name.startswith("web ") for face in builder.faces):
        raise DatasetError("site: expected cameras that look at the girder, got none that sees it; turn them")
    return Scene(tuple(builder.faces), sky=205.0)


def _add_girder(builder: Builder, site: FootbridgeSite) -> None:
    """Adds web plates, flanges, stiffeners and the slab's edge; the web lies at the perpendicular distance."""
    X, Z, L = site.perpendicular_m, site.support_m, site.span_m
    bay = L / site.bays
    for number in range(site.bays + 1):
        start = Z + (number - 0.5) * bay
        # Bolted splices; the slab throws a soft shadow on the top of the web.
        shadow = Mark((bay / 2, 0.0), (100 * bay, 0.09), -34)
        middle = _connection(bay, 0.665) if site.bolted_middles else ()
        web = (shadow, *_splice(bay, 0.665), *middle)
        builder.add(f"web {number}", (X, -0.36, start), (along(bay), down(0.665)), _STEEL, moving=True, marks=web)
        slab = (X - 0.14, -0.55, start + 0.4 * bay)
        builder.add(f"slab edge {number}", slab, (along(bay), down(0.19)), _CONCRETE, moving=True)
        flange = (X - 0.1, 0.275, start)
        builder.add(f"bottom flange {number}", flange, (along(bay), down(0.045)), _BRIGHT_STEEL, moving=True)
        for half in (0.25, 0.75):
            at = start + half * bay
            edges = ((0.085, 0.0, 0.0), down(0.6))
            name = f"stiffener {2 * number + int(2 * half)}"
            builder.add(name, (X - 0.085, -0.325, at), edges, _SHADED_STEEL, moving=True)
            corner = (X - 0.085, -0.325, at - 0.03)
            builder.add(f"{name} flange", corner, (along(0.06), down(0.6)), _BRIGHT_STEEL, moving=True)
    builder.add("top flange", (X - 0.1, -0.4, Z), (along(L), down(0.08)), _SHADED_STEEL, moving=True)


def _add_railings(builder: Builder, site: FootbridgeSite) -> None:
    """Adds the railing on the near side of the deck, and the far kerb behind it."""
    X, Z, L = site.perpendicular_m, site.support_m, site.span_m
    for number in range(int(L / _POST_SPACING_M)):
        corner = (X - 0.09, -1.6, Z + (number + 0.25) * _POST_SPACING_M)
        builder.add(f"post {number}", corner, (along(0.06), down(1.1)), _GALVANISED, moving=True)
    for number, height in enumerate((-0.74, -0.94)):
        corner = (X - 0.1, height, Z)
        builder.add(f"rail {number}", corner, (along(L), down(0.045)), _GALVANISED, moving=True)
    builder.add("far kerb", (X + 1.6, -0.78, Z), (along(L), down(0.4)), _CONCRETE, moving=True)


def _add_ground(builder: Builder, site: FootbridgeSite) -> None:
    """Adds what stands still: the abutment's wing wall and coping, a block in front, the slope and the trees."""
    X, middle = site.perpendicular_m, site.longitudinal_m
    start, run = middle - 4.5, 4.6
    slope = (0.0, 0.06 * run, run)
    joints = tuple(Mark((u, 1.0), (0.008, 100.0), -30) for u in (0.7, 2.2, 3.7))
    builder.add(
        "wing wall",
        (X - 0.1, 0.4, start),
        (slope, _downalong(slope, 5.0 if site.valley else 3.0)),
        _CONCRETE,
        marks=joints,
    )
    builder.add("wing wall coping", (X - 0.1, 0.4, start), (slope, (0.35, 0.0, 0.0)), _CONCRETE)
    block = (X - 1.5, 0.56, middle - 0.75)
    depth = 5.0 if site.valley else 1.5
    builder.add("block", block, (along(1.0), down(depth)), _MASONRY)
    builder.add("block side", block, ((0.5, 0.0, 0.0), down(depth)), _SHADED_MASONRY)
    builder.add("block top", block, (along(1.0), (0.5, 0.0, 0.0)), _MASONRY)
    foot, before = (2.0, 10.0) if site.valley else (0.0, 0.0)
    rise = (2.4 * (1 + foot), -1.7 * (1 + foot), 0.0)
    corner = (X + 0.9 - 2.4 * foot, 1.9 + 1.7 * foot, start - before)
    builder.add("bank", corner, (along(30.0 + before), rise), _GRASS)
    if site.valley:
        _add_abutments(builder, site)
    # The trees face the middle of what the cameras look at.
    axes = [camera.rotation[2] for camera in builder.cameras]
    heading = float(np.mean([np.arctan2(axis[0], axis[2]) for axis in axes]))
    across = np.array([np.cos(heading), 0.0, -np.sin(heading)])
    far = site.backdrop_m / _BACKDROP_M
    trees = 33.0 * np.array([np.sin(heading), 0.0, np.cos(heading)]) - 17.0 * across - np.array([0.0, 5.0, 0.0])
    builder.add(
        "trees",
        _triple(far * trees),
        (_triple(far * 34.0 * across), down(far * (16.0 if site.valley else 7.0))),
        _TREES,
    )


def _add_abutments(builder: Builder, site: FootbridgeSite) -> None:
    """Adds the face below the girder's far end, and the side walls at both ends."""
    X, first, last = site.perpendicular_m, site.support_m + 0.4, site.support_m + site.span_m - 0.4
    builder.add("far abutment", (X - 0.6, 0.34, last), ((2.8, 0.0, 0.0), down(4.5)), _SHADED_MASONRY)
    builder.add("far side wall", (X - 0.6, -0.6, last), (along(6.0), down(5.5)), _MASONRY)
    builder.add("near side wall", (X - 0.6, -0.6, first - 6.0), (along(6.0), down(5.5)), _MASONRY)


def _downalong(slope: Triple, length_m: float) -> Triple:
    """Vector at right angles to a slope within its vertical plane, downwards [m]."""
    run = float(np.hypot(slope[1], slope[2]))
    return (0.0, length_m * slope[2] / run, -length_m * slope[1] / run)


def _triple(vector: FloatArray) -> Triple:
    x, y, z = (float(value) for value in vector)
    return x, y, z
