"""A footbridge filmed twice: later the cameras stand elsewhere and zoom otherwise, and the span has settled."""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.motion import compute_station
from vfm_sdm.studies.synthetic.plan import Preset, SitePoint
from vfm_sdm.studies.synthetic.scene import Scene

MOVED = (0.25, 0.06, -0.2)
"""How far the reference camera is moved between the visits [m]: lateral, vertical, longitudinal."""
STATIC = {
    "grass": (210.0, 540.0),
    "wall left": (800.0, 650.0),
    "wall right": (1000.0, 680.0),
    "block left": (260.0, 680.0),
    "block right": (480.0, 660.0),
}
"""Pixels of static points in the first reference view."""
MOVING = ("1/4 span", "3/8 span", "1/2 span")


@dataclass(frozen=True)
class LaterSite(FootbridgeSite):
    """The site of another visit, seen from a reference camera elsewhere: its origin is that camera."""

    earlier: FootbridgeSite | None = None
    moved: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def scene(self, *, seed: int) -> Scene:
        """What the earlier visit filmed, from the new origin."""
        scene = self.earlier.scene(seed=seed)
        return replace(scene, faces=tuple(replace(f, origin=f.origin - np.array(self.moved)) for f in scene.faces))


@dataclass(frozen=True)
class Settled:
    """A motion about a rest position that has settled: most at midspan, nothing at the supports.

    Parameters
    ----------
    motion
        The motion itself.
    settlement_mm
        At midspan, downwards.
    """

    motion: object
    settlement_mm: float

    @property
    def support_m(self):
        return self.motion.support_m

    @property
    def span_m(self):
        return self.motion.span_m

    @property
    def still_s(self):
        return self.motion.still_s

    def settled(self, positions):
        """Change of the rest position, shape (P, 3) [m]."""
        station = compute_station(positions, support_m=self.support_m, span_m=self.span_m)
        return np.sin(np.pi * station)[:, None] * [0.0, 1e-3 * self.settlement_mm, 0.0]

    def displacement(self, time_s, positions):
        return self.motion.displacement(time_s, positions) + self.settled(positions)

    def acceleration(self, time_s, positions):
        return self.motion.acceleration(time_s, positions)


def look_up(scene, camera, pixel):
    """What a pixel of a camera shows, in the scene's axes [m]."""
    ray = np.append(camera.normalize(np.array(pixel)), 1.0) @ camera.rotation
    distances = {}
    for face in scene.faces:
        edges = np.stack([face.edge_u, face.edge_v])
        normal = np.cross(*edges)
        distance = (face.origin - camera.center) @ normal / (ray @ normal)
        along = (camera.center + distance * ray - face.origin) @ edges.T / (edges**2).sum(axis=1)
        if distance > 0 and ((along >= 0) & (along <= 1)).all():
            distances[distance] = face
    nearest = min(distances)
    assert not distances[nearest].moving
    return tuple((camera.center + nearest * ray).tolist())


def first_plan(*, seed=5, duration_s=0.6):
    plan = demo_plan(seed=seed, duration_s=duration_s)
    site = plan.site
    kept = [p for p in plan.points if p.name in MOVING]
    scene, camera = site.scene(seed=seed), site.cameras()[0]
    static = [SitePoint(name, look_up(scene, camera, pixel), static=True) for name, pixel in STATIC.items()]
    return replace(plan, points=(*kept, *static), ranged="3/8 span")


def second_plan(first: Preset, *, settlement_mm=2.0, zoom=1.04, moved=MOVED, seed=11):
    site, (x, y, z) = first.site, moved
    second = site.further[0]
    later = LaterSite(
        perpendicular_m=site.perpendicular_m - x,
        longitudinal_m=site.longitudinal_m - z + 0.05,
        focal_px=zoom * site.focal_px,
        k1=site.k1,
        further=(
            replace(
                second,
                center=(second.center[0] - x + 0.15, second.center[1] - y + 0.05, second.center[2] - z - 0.2),
                target_m=second.target_m - z - 0.03,
                focal_px=zoom * second.focal_px,
            ),
        ),
        support_m=site.support_m - z,
        earlier=site,
        moved=moved,
    )
    points = tuple(replace(p, position=tuple(np.subtract(p.position, moved).tolist())) for p in first.points)
    motion = Settled(replace(first.motion, support_m=later.support_m), settlement_mm)
    return replace(first, site=later, points=points, motion=motion)
