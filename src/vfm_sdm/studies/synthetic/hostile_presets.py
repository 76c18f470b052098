"""Four virtual field tests that are unkind: the real surfaces in bad weather, light and company.

Every disturbance has its own switch (`vfm_sdm.studies.synthetic.disturbances.Disturbances`). Each test has those that
come together on one day; the four together have all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from vfm_sdm.studies.synthetic.disturbances import Disturbances
from vfm_sdm.studies.synthetic.exposure import ExposureStep, Flicker
from vfm_sdm.studies.synthetic.obstacles import Branch, Passer
from vfm_sdm.studies.synthetic.optics import LateralColour, Shake
from vfm_sdm.studies.synthetic.plan import Blunder, Preset
from vfm_sdm.studies.synthetic.surface_presets import SurfaceName, surface_preset
from vfm_sdm.studies.synthetic.timing import Timing
from vfm_sdm.studies.synthetic.weather import Haze, Rain

__all__ = ["HOSTILE", "HostileName", "hostile_preset"]

HostileName = Literal["hostile-1", "hostile-2", "hostile-3", "hostile-4"]
HOSTILE: tuple[HostileName, ...] = get_args(HostileName)

# The encoder of a camera knows no block tree.
_H264 = {"preset": "medium", "threads": "2", "x264-params": "mbtree=0"}
_HEVC = {"codec": "libx265", "preset": "veryfast", "x265-params": "log-level=none:pools=1:frame-threads=1:cutree=0"}
_SEED_STEP = 100


@dataclass(frozen=True)
class _Hostility:
    """Values that differ between the tests; disturbances of the left and of the right view."""

    surface: SurfaceName
    description: str
    disturbances: tuple[Disturbances, Disturbances]
    encoder: Mapping[str, str]
    sharpening: float = 0.0
    bars_alike: bool = False
    blunders: tuple[Blunder, ...] = ()


def hostile_preset(name: HostileName, *, small: bool) -> Preset:
    """A hostile field test; see `vfm_sdm.studies.synthetic.presets.preset`."""
    hostility = _HOSTILITIES[name]()
    plan = surface_preset(hostility.surface, small=small, bars_alike=hostility.bars_alike)
    return replace(
        plan,
        name=name,
        description=hostility.description,
        recordings=tuple(
            replace(recording, sharpening=hostility.sharpening, disturbances=disturbances)
            for recording, disturbances in zip(plan.recordings, hostility.disturbances, strict=True)
        ),
        encoder=hostility.encoder,
        blunders=hostility.blunders,
        seed=plan.seed + _SEED_STEP * (1 + HOSTILE.index(name)),
    )


def _hostile_1() -> _Hostility:
    """Sharpened H.264 at 0.1 bits a pixel, cheap lenses; the exposure steps, people pass."""
    return _Hostility(
        surface="surface-1",
        description="sharpening, lateral colour, exposure steps, passers-by; H.264 at 0.1 bits a pixel",
        sharpening=0.8,
        encoder=_H264,
        disturbances=(
            Disturbances(
                lateral_colour=LateralColour(red=8e-4, blue=-11e-4),
                exposure_steps=(ExposureStep(2.9, 1.25), ExposureStep(5.6, 0.9)),
                passers=(Passer("person", 12.0, 1.4, 4.2), Passer("person", 9.0, -1.3, 6.9)),
                bits_per_pixel=0.1,
            ),
            Disturbances(
                lateral_colour=LateralColour(red=-6e-4, blue=9e-4),
                exposure_steps=(ExposureStep(3.4, 0.85),),
                passers=(Passer("person", 10.0, 1.4, 3.1),),
                bits_per_pixel=0.1,
            ),
        ),
    )


def _hostile_2() -> _Hostility:
    """HEVC at 0.05 bits a pixel of a variable rate; haze, wind on the tripods, a tape misread by half a metre."""
    return _Hostility(
        surface="surface-2",
        description="haze, wind, variable frame rate, a blunder of the tape; HEVC at 0.05 bits a pixel",
        encoder=_HEVC,
        disturbances=(
            Disturbances(
                haze=Haze(250.0),
                shake=Shake((90.0, 120.0, 60.0)),
                timing=Timing(variation=0.06),
                bits_per_pixel=0.05,
            ),
            Disturbances(
                haze=Haze(250.0),
                shake=Shake((70.0, 150.0, 80.0)),
                timing=Timing(variation=0.04),
                bits_per_pixel=0.05,
            ),
        ),
        blunders=(Blunder("length 1", 0.5),),
    )


def _hostile_3() -> _Hostility:
    """HEVC at 0.3 bits a pixel under lamps in the rain; leaves before the lens, frames lost and repeated."""
    return _Hostility(
        surface="surface-1",
        description="rain, flicker, leaves, dropped and repeated frames, equal balusters; HEVC at 0.3 bits a pixel",
        encoder=_HEVC,
        disturbances=(
            Disturbances(
                rain=Rain(120.0),
                flicker=Flicker(0.06, frequency_hz=100.0),
                branches=(Branch((0.08, 0.12), (0.05, 0.05), leaves=70),),
                timing=Timing(dropped=0.015, repeated=0.01),
                bits_per_pixel=0.3,
            ),
            Disturbances(
                rain=Rain(120.0),
                flicker=Flicker(0.06, frequency_hz=100.0),
                branches=(Branch((0.92, 0.1), (0.05, 0.06), leaves=80),),
                timing=Timing(dropped=0.01, repeated=0.015),
                bits_per_pixel=0.3,
            ),
        ),
        bars_alike=True,
    )


def _hostile_4() -> _Hostility:
    """H.264 at 0.02 bits a pixel; vehicles, some haze and wind, lateral colour, a baseline misread by 0.3 m."""
    return _Hostility(
        surface="surface-2",
        description="vehicles, wind, lateral colour, equal balusters, a blunder of the baseline; "
        "H.264 at 0.02 bits a pixel",
        sharpening=0.5,
        encoder=_H264,
        disturbances=(
            Disturbances(
                haze=Haze(500.0),
                passers=(Passer("vehicle", 5.0, 7.0, 3.3), Passer("person", 6.0, -1.5, 5.5)),
                shake=Shake((60.0, 60.0, 40.0)),
                lateral_colour=LateralColour(red=5e-4, blue=7e-4),
                exposure_steps=(ExposureStep(4.4, 1.1),),
                bits_per_pixel=0.02,
            ),
            Disturbances(
                haze=Haze(500.0),
                passers=(Passer("vehicle", 5.0, -8.0, 4.8),),
                shake=Shake((50.0, 80.0, 40.0)),
                lateral_colour=LateralColour(red=-7e-4, blue=6e-4),
                bits_per_pixel=0.02,
            ),
        ),
        bars_alike=True,
        blunders=(Blunder("baseline", 0.3),),
    )


_HOSTILITIES: dict[HostileName, Callable[[], _Hostility]] = {
    "hostile-1": _hostile_1,
    "hostile-2": _hostile_2,
    "hostile-3": _hostile_3,
    "hostile-4": _hostile_4,
}
