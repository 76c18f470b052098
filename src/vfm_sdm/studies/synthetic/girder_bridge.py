"""A painted plate girder under a concrete deck with a railing, before a wall: the surfaces that a first user films.

What stands far behind is a scene of its own, `Scene.backdrop`. All places are metres in the world frame of
`vfm_sdm.studies.synthetic.scene`. Luma of materials is linear in light: black 16, white 235.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.structure_frame import compute_view_angle
from vfm_sdm.studies.synthetic.building import Builder, Material, Triple, along, down
from vfm_sdm.studies.synthetic.footbridge import make_camera
from vfm_sdm.studies.synthetic.lighting import Light
from vfm_sdm.studies.synthetic.scene import Mark, Scene
from vfm_sdm.studies.synthetic.wall import Masonry, build_backdrop

__all__ = ["GirderBridgeSite", "Surfaces", "Tripod", "find_on_face"]

# Heights [m], vertical coordinates relative to the underside of the deck, down.
_WEB = 0.62
_SLAB = 0.27
_FLANGE = 0.022
_RAILING = 1.15
# Places across the bridge, relative to the structure's face, away from the cameras [m].
_FASCIA, _EDGE, _PLATE, _WEB_X = -0.10, 0.0, 0.088, 0.10
_POST = (-0.07, 0.06)
"""Front of the posts, and their depth."""
_WASHER = 0.030
"""Between nuts and the plate: what ends at a plane nearer than about four pixels' change of depth is blended wrongly
(`vfm_sdm.studies.synthetic.edges`)."""


@dataclass(frozen=True)
class Tripod:
    """Where a camera stands, and its lens.

    Parameters
    ----------
    center
        Optical centre [m].
    target_m
        Longitudinal coordinate on the structure's face that the optical axis meets [m].
    focal_px
        Focal length at an image width of 1280 px [px].
    level_deg
        Pitch and roll [deg].
    principal_px
        Principal point from the middle of the picture at an image width of 1280 px, right and down [px].
    distortion
        Coefficients k1, k2, p1, p2, k3 [1].
    """

    center: Triple
    target_m: float
    focal_px: float
    level_deg: tuple[float, float]
    principal_px: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Surfaces:
    """Materials of the bridge and of what stands around it."""

    paint: Material
    bolt: Material
    deck: Material
    abutment: Material
    railing: Material
    wall: Masonry


@dataclass(frozen=True)
class GirderBridgeSite:
    """Where bridge and cameras stand, and what they are made of.

    Parameters
    ----------
    perpendicular_m
        Distance from the reference camera to the structure's face, the free edges of the stiffeners [m].
    deck_m
        Vertical coordinate of the underside of the deck, negative above the reference camera [m].
    tripods
        Of the reference camera, whose centre is the origin, and of the further ones.
    surfaces, light
        Materials, sun and shadows.
    support_m, span_m
        Longitudinal coordinate of the first support, and distance to the second [m].
    bay_m, splice
        Distance between stiffeners [m], and the number of the bay with a bolted splice, counted from the far end.
    post_m, bar_m, bar_width_m
        Distances between posts and between bars of the railing, and width of a bar [m].
    bars_alike
        Whether the railing's bars have neither grain nor stains, so that each looks like the next; one of them is then
        a point, too.
    measured_post
        Number of the post that is measured, counted from the far end.
    image_size
        Width and height of all views [px].

    Raises
    ------
    DatasetError
        There is one camera only, or the reference camera is not at the origin.
    """

    perpendicular_m: float
    deck_m: float
    tripods: tuple[Tripod, ...]
    surfaces: Surfaces
    light: Light
    support_m: float
    span_m: float
    bay_m: float = 1.3
    splice: int = 5
    post_m: float = 1.15
    bar_m: float = 0.14
    bar_width_m: float = 0.016
    bars_alike: bool = False
    measured_post: int = 3
    image_size: tuple[int, int] = (1280, 720)

    def __post_init__(self) -> None:
        if len(self.tripods) < 2 or any(self.tripods[0].center):
            raise DatasetError(
                "tripods: expected at least two, the first at the origin, got centres "
                f"{[tripod.center for tripod in self.tripods]}; add one, or move the origin"
            )

    @property
    def further(self) -> tuple[Tripod, ...]:
        """The tripods beside the reference camera's."""
        return self.tripods[1:]

    def with_second_at(self, center: Triple) -> Self:
        """The site with the second camera at another optical centre [m]."""
        first, second, *others = self.tripods
        return replace(self, tripods=(first, replace(second, center=center), *others))

    @property
    def level_deg(self) -> tuple[float, float]:
        """Pitch and roll of the reference camera [deg]."""
        return self.tripods[0].level_deg

    @property
    def longitudinal_m(self) -> float:
        """Longitudinal coordinate on the structure's face of what the middle of the reference view shows [m]."""
        return float(find_on_face(self.cameras()[0], self.perpendicular_m)[2])

    def cameras(self) -> tuple[Camera, ...]:
        """The reference camera and the further ones, in the structural axes."""
        return tuple(self._camera_at(tripod) for tripod in self.tripods)

    def _camera_at(self, tripod: Tripod) -> Camera:
        scale, center = self.image_size[0] / 1280, np.asarray(tripod.center)
        pitch, roll = np.deg2rad(tripod.level_deg)
        camera = make_camera(
            center,
            compute_view_angle(self.perpendicular_m - center[0], tripod.target_m - center[2]),
            focal_px=scale * tripod.focal_px,
            image_size=self.image_size,
            level_rad=(pitch, roll),
        )
        K = camera.K.copy()
        K[:2, 2] += scale * np.asarray(tripod.principal_px)
        return replace(camera, K=K, distortion=np.asarray(tripod.distortion))

    def station(self, share: float) -> float:
        """Longitudinal coordinate of a cross-section [m], from its share of the span [1]."""
        return self.support_m + share * self.span_m

    @property
    def end_m(self) -> float:
        """Longitudinal coordinate of the far support [m]."""
        return self.support_m + self.span_m

    def stiffener_m(self, number: int) -> float:
        """Longitudinal coordinate of a stiffener, counted from the far end [m]."""
        return self.end_m - 0.2 - number * self.bay_m

    def post_at_m(self, number: int) -> float:
        """Longitudinal coordinate of the middle of a post, counted from the far end [m]."""
        return self.end_m - 0.55 - number * self.post_m

    def bar_at_m(self, number: int) -> float:
        """Longitudinal coordinate of the middle of a bar of the railing, counted from the far end [m]."""
        return self.post_at_m(0) + 0.3 - (number + 0.5) * self.bar_m

    def points(self) -> dict[str, Triple]:
        """Places on the surfaces by name; the last three stand still [m]."""
        X, Y, end = self.perpendicular_m, self.deck_m, self.end_m
        bolts = self.stiffener_m(self.splice) + 0.5 * self.bay_m
        post = self.post_at_m(self.measured_post)
        first, second = (self.stiffener_m(self.splice - number) for number in (1, 2))
        # The bar nearest to the middle between two posts.
        nearest = round((self.bar_at_m(0) - post + 0.5 * self.post_m) / self.bar_m)
        bar = (X + _POST[0] + 0.5 * _POST[1], Y - _SLAB - 0.5 * _RAILING + 0.02, self.bar_at_m(nearest))
        return {
            **({"bar": bar} if self.bars_alike else {}),
            "bolts": (X + _PLATE, Y + 0.31, bolts),
            "concrete": (X + _FASCIA, Y - 0.5 * _SLAB, bolts - 0.12),
            "flange": (X - 0.02, Y + _WEB + 0.5 * _FLANGE, first + 0.27 * self.bay_m),
            "paint": (X + _WEB_X, Y + 0.42, first + 0.55 * self.bay_m),
            "stiffener": (X + _EDGE, Y + 0.45, second),
            "post": (X + _POST[0], Y - _SLAB - 0.50, post - 0.025),
            "post base": (X + _POST[0] - 0.02, Y - _SLAB - 0.025, post - 0.06),
            "abutment corner": (X - 0.3, Y + 0.75, end - 0.33),
            "abutment face": (X - 0.3, Y + 1.0, end + 0.45),
            "backwall": (X - 0.05, Y + 0.20, end + 0.60),
        }

    def scene(self, *, seed: int) -> Scene:
        """The bridge and its abutment, with what is far behind as backdrop.

        Parameters
        ----------
        seed
            Seed of all textures.
        """
        cameras = self.cameras()
        builder = Builder(cameras, seed, self.light)
        _add_girder(builder, self)
        _add_splice(builder, self)
        _add_deck(builder, self)
        _add_railing(builder, self)
        _add_abutment(builder, self)
        backdrop = build_backdrop(self.surfaces.wall, cameras, self.light, seed=seed)
        return Scene(tuple(builder.faces), backdrop=backdrop, light=self.light)


def find_on_face(camera: Camera, perpendicular_m: float) -> FloatArray:
    """Point of the plane of a structure's face that the middle of a picture shows, shape (3,) [m].

    Parameters
    ----------
    camera
        Camera in the structural axes.
    perpendicular_m
        Lateral coordinate of the face [m].

    Examples
    --------
    >>> camera = make_camera(np.zeros(3), np.pi / 4, focal_px=1000.0, image_size=(640, 480))
    >>> find_on_face(camera, 10.0).round(6).tolist()
    [10.0, 0.0, 10.0]
    """
    middle = camera.normalize((np.asarray(camera.image_size) - 1) / 2)
    ray = np.append(middle, 1.0) @ camera.rotation
    return np.asarray(camera.center + ray * (perpendicular_m - camera.center[0]) / ray[0])


def _visible(site: GirderBridgeSite) -> tuple[float, float]:
    """Longitudinal coordinates between which the bridge may be in a picture, with a metre to spare [m]."""
    places = []
    for camera in site.cameras():
        width, height = camera.image_size
        for u in (0, width - 1):
            for v in (0, height - 1):
                ray = np.append(camera.normalize([u, v]), 1.0) @ camera.rotation
                across = site.perpendicular_m + 0.1 - camera.center[0]
                places.append(float(camera.center[2] + across * ray[2] / ray[0]) if ray[0] > 0 else np.inf)
    return min(places) - 1.0, min(max(places) + 1.0, site.end_m)


def _add_girder(builder: Builder, site: GirderBridgeSite) -> None:
    """Adds web, stiffeners and flange of the near girder, and the far girder behind it."""
    X, Y = site.perpendicular_m, site.deck_m
    paint, bay = site.surfaces.paint, site.bay_m
    first, end = _visible(site)
    # The sun's height and azimuth give the shadow's depth below the deck and its reach beside the stiffeners.
    sun = site.light.direction
    below = (_WEB_X - _FASCIA) * sun[1] / sun[0]
    beside = (_WEB_X - _EDGE) * sun[2] / sun[0]
    normal = np.array([-1.0, 0.0, 0.0])
    taken = site.light.sun_share(normal)
    shade = Mark((bay / 2, 0.0), (0.012, 0.012), 0.0, half_m=(bay, float(abs(below))), taken=taken)
    number = 0
    while site.stiffener_m(number) > first:
        z = site.stiffener_m(number)
        length = min(bay, end - z)
        # What the deck shades already is not shaded again.
        center, half = (0.0 if beside > 0 else length, 0.5 * (_WEB + abs(below))), 0.5 * (_WEB - abs(below))
        cast = Mark(center, (0.012, 0.012), 0.0, half_m=(float(abs(beside)), max(half, 0.01)), taken=taken)
        web = (X + _WEB_X, Y, z)
        builder.add(f"web {number}", web, (along(length), down(_WEB)), paint, moving=True, marks=(shade, cast))
        edge = (X + _EDGE, Y, z)
        builder.add(f"stiffener {number}", edge, ((_WEB_X - _EDGE, 0.0, 0.0), down(_WEB)), paint, moving=True)
        number += 1
    flange = (X - 0.02, Y + _WEB, first)
    builder.add("flange", flange, (along(end - first), down(_FLANGE)), paint, moving=True)
    far = replace(paint, mean=0.3 * paint.mean + 0.7 * 16, contrast=0.3 * paint.contrast, gloss=(0.0, 1.0))
    builder.add("far web", (X + 1.9, Y, first), (along(end - first), down(_WEB + _FLANGE)), far, moving=True)


def _add_splice(builder: Builder, site: GirderBridgeSite) -> None:
    """Adds a plate on the web with four by four bolts, nuts outside."""
    X, Y = site.perpendicular_m, site.deck_m
    width, height, top = 0.56, 0.46, 0.08
    middle = site.stiffener_m(site.splice) + 0.5 * site.bay_m
    at = [(u, v) for u in (-0.2, -0.12, 0.12, 0.2) for v in (0.06, 0.17, 0.28, 0.39)]
    washer = tuple(
        Mark((0.5 * width + u - 0.016, v + 0.014), (0.008, 0.008), 0.0, half_m=(0.034, 0.026), taken=0.7) for u, v in at
    )
    corner = (X + _PLATE, Y + top, middle - 0.5 * width)
    size = (_WEB_X - _PLATE, height, width)
    builder.add_box("splice", (corner, size), site.surfaces.paint, moving=True, marks=washer)
    for number, (u, v) in enumerate(at):
        nut = (X + _PLATE - 0.052, Y + top + v - 0.018, middle + u - 0.018)
        builder.add_box(f"nut {number}", (nut, (0.052 - _WASHER, 0.036, 0.036)), site.surfaces.bolt, moving=True)


def _add_deck(builder: Builder, site: GirderBridgeSite) -> None:
    """Adds the deck's fascia with its joints, its end and its underside."""
    X, Y = site.perpendicular_m, site.deck_m
    first, end = _visible(site)
    deck = site.surfaces.deck
    corner, size = (X + _FASCIA, Y - _SLAB, first), (2.2, _SLAB, end + 0.25 - first)
    run = Mark((0.0, _SLAB), (100.0, 0.02), -18)
    builder.add_box("deck", (corner, size), deck, sides=("front",), moving=True, marks=(run,))
    soffit = replace(deck, mean=0.4 * deck.mean + 0.6 * 16)
    under = (X + _FASCIA, Y, first)
    builder.add("deck bottom", under, (along(end + 0.25 - first), (0.2, 0.0, 0.0)), soffit, moving=True)


def _add_railing(builder: Builder, site: GirderBridgeSite) -> None:
    """Adds posts on base plates with anchor bolts, bars between two rails, and the handrail."""
    X, top = site.perpendicular_m, site.deck_m - _SLAB
    steel = site.surfaces.railing
    first = _visible(site)[0]
    last = site.post_at_m(0) + 0.3
    front, depth = X + _POST[0], _POST[1]
    # Round bars look alike from everywhere: flat ones that face the cameras.
    center = np.mean([camera.center for camera in builder.cameras], axis=0)
    view = np.array([front + 0.5 * depth, 0.0, last - 3 * site.post_m]) - center
    heading = np.array([view[2], 0.0, -view[0]]) / np.hypot(view[0], view[2])
    number = 0
    while (z := site.post_at_m(number)) > first:
        builder.add_box(
            f"post {number}", ((front, top - _RAILING, z - 0.025), (depth, _RAILING, 0.05)), steel, moving=True
        )
        base = (front - 0.02, top - 0.05, z - 0.06)
        builder.add_box(f"base {number}", (base, (depth + 0.04, 0.05, 0.12)), steel, moving=True)
        for place, along_m in enumerate((-0.048, 0.022)):
            nut = (front - 0.012, top - 0.085, z + along_m)
            builder.add_box(f"anchor {number} {place}", (nut, (0.026, 0.035, 0.026)), site.surfaces.bolt, moving=True)
        number += 1
    bars = int((last - first) / site.bar_m)
    bar_steel = replace(steel, contrast=0.0, stains=0.0) if site.bars_alike else steel
    for number in range(bars):
        z = site.bar_at_m(number)
        start = np.array([front + 0.5 * depth, top - _RAILING + 0.17, z]) - 0.5 * site.bar_width_m * heading
        width = site.bar_width_m * heading
        x, y, w = (float(value) for value in start)
        edges = ((float(width[0]), 0.0, float(width[2])), down(_RAILING - 0.30))
        builder.add(f"bar {number}", (x, y, w), edges, bar_steel, moving=True)
    for name, up, height in (("low rail", 0.13, 0.03), ("high rail", _RAILING - 0.15, 0.03), ("hand", _RAILING, 0.055)):
        corner = (front + 0.01, top - up - 0.5 * height, first)
        builder.add_box(name, (corner, (0.04, height, last - first)), steel, moving=True, sides=("front", "bottom"))


def _add_abutment(builder: Builder, site: GirderBridgeSite) -> None:
    """Adds the abutment at the far end: bearing wall, seat, backwall and wing wall, which stand still."""
    X, Y, end = site.perpendicular_m, site.deck_m, site.end_m
    stone = site.surfaces.abutment
    seat = Y + _WEB + _FLANGE + 0.06
    joints = tuple(Mark((0.0, v), (100.0, 0.006), -22) for v in (0.36, 1.2))
    ties = tuple(Mark((0.25 + 0.45 * n, 0.36 + 0.42 * m), (0.012, 0.012), -60) for n in range(6) for m in range(3))
    builder.add_box("seat", ((X - 0.3, seat, end - 0.33), (0.5, 3.5, 2.2)), stone, marks=(*joints, *ties))
    builder.add("bearing wall", (X + 0.2, seat, end - 0.33), ((2.6, 0.0, 0.0), down(3.5)), stone)
    builder.add_box("bearing", ((X + 0.0, Y + _WEB + _FLANGE, end - 0.25), (0.24, 0.06, 0.3)), site.surfaces.bolt)
    cracks = (Mark((0.0, 0.42), (100.0, 0.005), -20), Mark((0.55, 0.9), (0.006, 0.3), -18))
    builder.add_box("backwall", ((X - 0.05, Y - _SLAB - 0.06, end + 0.30), (2.4, 1.2, 0.9)), stone, marks=cracks)
    builder.add_box("wing wall", ((X + 0.12, Y - _SLAB + 0.05, end + 1.2), (1.0, 4.0, 9.0)), stone, marks=joints)
    coping = (X + 0.05, Y - _SLAB - 0.03, end + 1.2)
    builder.add_box(
        "coping", (coping, (0.4, 0.10, 9.0)), replace(stone, mean=1.1 * stone.mean), sides=("front", "near")
    )
