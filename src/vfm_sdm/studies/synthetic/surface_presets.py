"""Two virtual field tests of real surfaces: what a first user's bridge shows, which neither markers nor bolts cover.

Both are girder bridges (`vfm_sdm.studies.synthetic.girder_bridge`) filmed by lenses with depth of field, vignetting and
distortion of all kinds, and by sensors with photon noise and a tone curve. They differ in everything else: `surface-1`
is seen through telephoto lenses, `surface-2` through wider ones at twice the convergence, with other surfaces.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

from vfm_sdm.studies.synthetic.amplitudes import PeakToPeak, scale_to_amplitudes
from vfm_sdm.studies.synthetic.building import Material
from vfm_sdm.studies.synthetic.excitation import BendingMode, ForcedMotion
from vfm_sdm.studies.synthetic.girder_bridge import GirderBridgeSite, Surfaces, Tripod
from vfm_sdm.studies.synthetic.lighting import Canopy, Light
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian
from vfm_sdm.studies.synthetic.photometry import Photometry
from vfm_sdm.studies.synthetic.plan import FurtherReadings, Preset, Recording, SiteErrors, SitePoint
from vfm_sdm.studies.synthetic.wall import Foliage, Masonry

__all__ = ["SURFACES", "SurfaceName", "surface_preset"]

SurfaceName = Literal["surface-1", "surface-2"]
SURFACES: tuple[SurfaceName, ...] = get_args(SurfaceName)

_FULL_WIDTH, _SMALL_WIDTH = 3840, 1280
_SMALL_S = 8.0
"""Duration at small size, in which the amplitudes are reached: the motion is the same at both sizes."""
_STILL_S = 0.6
_MARGIN_S = 3.0
"""Motion beyond the videos, for clocks that start late."""
_STATIC = ("abutment corner", "abutment face", "backwall")
_LENGTHS = (("bolts", "stiffener"), ("bolts", "flange"), ("bolts", "abutment corner"))


@dataclass(frozen=True)
class _Surface:
    """Values that differ between the tests; amplitudes (vertical, lateral) at a third and at half the span [mm]."""

    description: str
    site: GirderBridgeSite
    recordings: tuple[Recording, Recording]
    people: tuple[Pedestrian, ...]
    amplitudes_mm: tuple[tuple[float, float], tuple[float, float]]
    seed: int


def surface_preset(name: SurfaceName, *, small: bool, bars_alike: bool = False) -> Preset:
    """A field test of real surfaces, with bars of the railing of which each looks like the next or not.

    See `vfm_sdm.studies.synthetic.presets.preset` and `vfm_sdm.studies.synthetic.girder_bridge.GirderBridgeSite`.
    """
    width, fps, duration_s = (_SMALL_WIDTH, 30, _SMALL_S) if small else (_FULL_WIDTH, 60, 16.0)
    surface = _SURFACES[name]((width, width * 9 // 16))
    surface = replace(surface, site=replace(surface.site, bars_alike=bars_alike))
    return Preset(
        name=name,
        size="small" if small else "full",
        description=surface.description,
        site=surface.site,
        motion=_make_motion(surface, duration_s),
        points=tuple(SitePoint(point, at, point in _STATIC) for point, at in surface.site.points().items()),
        recordings=surface.recordings,
        accelerometers=(),
        fps=fps,
        duration_s=duration_s,
        still_s=_STILL_S,
        errors=SiteErrors(length_m=0.005),
        seed=surface.seed,
        ranged="bolts",
        further=FurtherReadings(ranged="bolts", lengths=_LENGTHS),
        refinement="none",
        subset_px=61 if small else 181,
        encoder={"preset": "medium", "threads": "2"},
    )


def _make_motion(surface: _Surface, duration_s: float) -> ForcedMotion:
    site = surface.site
    motion = ForcedMotion(
        modes=(
            BendingMode("vertical", 3.1, 11e3, damping_ratio=0.011, end_restraint=0.1),
            BendingMode("vertical", 9.4, 11e3, damping_ratio=0.014, half_waves=2, end_restraint=0.1),
            BendingMode("lateral", 2.2, 7e3, damping_ratio=0.011, end_restraint=0.5),
            BendingMode("lateral", 6.3, 7e3, damping_ratio=0.013, half_waves=2, end_restraint=0.5),
        ),
        people=surface.people,
        support_m=site.support_m,
        span_m=site.span_m,
        duration_s=duration_s + _MARGIN_S,
    )
    for axis, (half, third) in zip(("vertical", "lateral"), surface.amplitudes_mm, strict=True):
        targets = PeakToPeak(axis, 1 / 2, half), PeakToPeak(axis, 2 / 3, third)
        motion = scale_to_amplitudes(motion, targets, duration_s=_SMALL_S)
    return motion


def _surfaces_1() -> Surfaces:
    """Sea-green gloss paint, weathered concrete, red brick."""
    paint = Material(72, 3.2, tint=(2, -12), slope=0.3, stains=1.2, stain_depth=(2, 9), gloss=(26.0, 9.0))
    concrete = Material(120, 3.5, tint=(-4, 2), longest_m=0.8, slope=1.1, stains=2.5, stain_depth=(3, 12))
    return Surfaces(
        paint=paint,
        bolt=Material(32, 5.0, tint=(-3, 5), stains=0.0, gloss=(20.0, 12.0)),
        deck=concrete,
        abutment=Material(74, 5.0, tint=(-5, 3), longest_m=1.0, slope=1.1, stains=3.0, stain_depth=(4, 16)),
        railing=Material(56, 1.6, tint=(5, -2), slope=0.3, gloss=(30.0, 14.0)),
        wall=Masonry(
            distance_m=46.0,
            material=Material(150, 2.0, tint=(-14, 18)),
            stone_m=(0.26, 0.082),
            joint_m=0.014,
            stone_luma=(-80.0, 6.0),
            half_m=13.0,
            height_m=(-4.0, 5.0),
            leaf=Material(62, 6.0, tint=(-24, -10)),
            windows=tuple((-9.3 + 2.6 * number, top) for number in range(8) for top in (-3.1, 0.3)),
            turn_deg=-14.0,
            foliage=(
                Foliage((-0.9, -3.3), (0.45, 0.45), count=420, leaf_m=0.12),
                Foliage((1.9, -4.2), (0.6, 0.5), count=520, leaf_m=0.12),
                Foliage((4.0, 0.8), (0.45, 0.25), count=420, leaf_m=0.12),
            ),
            sky=170.0,
        ),
    )


def _surface_1(image_size: tuple[int, int]) -> _Surface:
    """Sea-green gloss paint, weathered concrete, red brick; low sun along the bridge."""
    site = GirderBridgeSite(
        perpendicular_m=9.55,
        deck_m=-1.02,
        tripods=(
            Tripod(
                (0.0, 0.0, 0.0),
                22.4,
                7450.0,
                (2.3, 0.5),
                principal_px=(14.5, -8.0),
                distortion=(-0.3, 0.5, 0.0028, -0.0021, 0.0),
            ),
            Tripod(
                (3.35, -0.11, -1.95),
                22.3,
                7300.0,
                (2.35, -0.8),
                principal_px=(-11.0, 7.0),
                distortion=(-0.22, 0.3, -0.0023, 0.0029, 0.0),
            ),
        ),
        surfaces=_surfaces_1(),
        light=Light(
            (-0.42, -0.42, 0.80),
            sun=0.72,
            canopy=Canopy((9.5, -0.9, 21.0), 0.65, leaf_m=0.13, depth=0.45, sway_m=0.04, seed=7),
        ),
        support_m=10.2,
        span_m=16.2,
        image_size=image_size,
    )
    photometry = Photometry(
        aperture_mm=14.0, focus_m=23.5, vignetting=0.22, full_well_e=6500, read_noise_e=6, shoulder=1.3
    )
    return _Surface(
        description="telephoto; gloss paint, weathered concrete, bolts, railing before brick; moving shadows",
        site=site,
        recordings=(
            Recording(exposure_s=1 / 250, noise_std=0.0, crf=19, photometry=photometry),
            Recording(exposure_s=1 / 250, noise_std=0.0, crf=19, photometry=photometry, start_s=0.1462),
        ),
        people=(
            Pedestrian("jumping", 74, 3.05, 0.7, 0.55, contact_ratio=0.5, seed=51),
            Pedestrian("running", 70, 2.7, 0.8, 0.15, speed_m_s=2.4, seed=52),
        ),
        amplitudes_mm=((6.8, 5.9), (4.3, 3.6)),
        seed=111,
    )


def _surfaces_2() -> Surfaces:
    """Iron-oxide paint, pale concrete, ashlar."""
    return Surfaces(
        paint=Material(52, 2.0, tint=(-8, 18), slope=0.5, stains=2.5, stain_depth=(2, 10), gloss=(14.0, 6.0)),
        bolt=Material(165, 14.0, tint=(2, -1), gloss=(30.0, 8.0)),
        deck=Material(125, 5.0, tint=(-2, 1), longest_m=0.5, slope=0.8, stains=4.0, stain_depth=(4, 18)),
        abutment=Material(92, 7.0, tint=(-8, 5), longest_m=0.7, slope=0.9, stains=6.0, stain_depth=(5, 25)),
        railing=Material(40, 2.0, tint=(-2, -6), slope=0.5, gloss=(18.0, 10.0)),
        wall=Masonry(
            distance_m=34.0,
            material=Material(105, 3.0, tint=(-12, 8), blur=1.4),
            stone_m=(0.55, 0.26),
            joint_m=0.022,
            stone_luma=(-22.0, 7.0),
            half_m=16.0,
            height_m=(-6.4, 5.0),
            leaf=Material(60, 9.0, tint=(-22, -8), blur=1.4),
            windows=tuple((-11.0 + 2.9 * number, -4.6) for number in range(8)),
            turn_deg=9.0,
            foliage=(
                Foliage((-3.0, -4.4), (1.1, 0.7), count=500, leaf_m=0.2),
                Foliage((5.5, 0.5), (0.9, 0.6), count=400),
            ),
            sky=150.0,
        ),
    )


def _surface_2(image_size: tuple[int, int]) -> _Surface:
    """Iron-oxide paint, board-marked pale concrete, sandstone; wider lenses, larger convergence, high sun."""
    site = GirderBridgeSite(
        perpendicular_m=7.6,
        deck_m=-1.15,
        tripods=(
            Tripod(
                (0.0, 0.0, 0.0),
                10.4,
                3450.0,
                (4.2, -0.4),
                principal_px=(-9.0, 6.5),
                distortion=(-0.12, 0.09, -0.0012, 0.0009, 0.0),
            ),
            Tripod(
                (2.45, -0.2, -3.1),
                10.2,
                3560.0,
                (3.1, 0.9),
                principal_px=(7.0, 10.0),
                distortion=(-0.09, 0.05, 0.0010, -0.0013, 0.0),
            ),
        ),
        surfaces=_surfaces_2(),
        light=Light(
            (-0.55, -0.80, 0.25),
            sun=0.6,
            canopy=Canopy((7.6, -1.1, 9.6), 0.7, leaf_m=0.16, depth=0.35, sway_m=0.07, seed=17),
        ),
        support_m=-2.4,
        span_m=15.2,
        bay_m=1.05,
        splice=4,
        post_m=1.4,
        bar_m=0.16,
        bar_width_m=0.02,
        measured_post=2,
        image_size=image_size,
    )
    photometry = Photometry(
        aperture_mm=16.0, focus_m=12.5, vignetting=0.35, full_well_e=4200, read_noise_e=8, shoulder=1.0
    )
    return _Surface(
        description="wider lenses; matt paint, pale concrete, bolts, railing before ashlar; moving shadows",
        site=site,
        recordings=(
            Recording(exposure_s=1 / 500, noise_std=0.0, crf=20, photometry=photometry, start_s=0.0),
            Recording(exposure_s=1 / 500, noise_std=0.0, crf=20, photometry=photometry, start_s=-0.2291),
        ),
        people=(
            Pedestrian("running", 76, 2.95, 0.7, 0.2, speed_m_s=2.2, seed=61),
            Pedestrian("jumping", 68, 2.3, 0.9, 0.6, contact_ratio=0.55, seed=62),
        ),
        amplitudes_mm=((8.6, 7.7), (5.1, 4.2)),
        seed=112,
    )


_SURFACES: dict[SurfaceName, Callable[[tuple[int, int]], _Surface]] = {
    "surface-1": _surface_1,
    "surface-2": _surface_2,
}
