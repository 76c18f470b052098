"""The virtual field tests: twins of the paper's sequences Data-1 to Data-4, two of real surfaces, four hostile ones.

Of the twins, baselines, monitored points, conditions and peak-to-peak amplitudes are the paper's (its tables of data
sets and of amplitudes, and the appendix on phones); everything else is chosen to be plausible for such a bridge. The
others are those of `vfm_sdm.studies.synthetic.surface_presets` and `vfm_sdm.studies.synthetic.hostile_presets`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.amplitudes import PeakToPeak, scale_to_amplitudes
from vfm_sdm.studies.synthetic.defects import Glare, Stabilization
from vfm_sdm.studies.synthetic.excitation import BendingMode, ForcedMotion
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite, Standpoint
from vfm_sdm.studies.synthetic.hostile_presets import HOSTILE, HostileName, hostile_preset
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian
from vfm_sdm.studies.synthetic.plan import MountedAccelerometer, Preset, Recording, SiteErrors, SitePoint
from vfm_sdm.studies.synthetic.sensors import Accelerometer
from vfm_sdm.studies.synthetic.surface_presets import SURFACES, SurfaceName, surface_preset

__all__ = [
    "HOSTILE",
    "PRESETS",
    "SIZES",
    "SURFACES",
    "HostileName",
    "Preset",
    "PresetName",
    "Size",
    "SurfaceName",
    "preset",
]

PresetName = Literal["data-1", "data-2", "data-3", "data-4"]
Size = Literal["full", "small"]
PRESETS: tuple[PresetName, ...] = get_args(PresetName)
SIZES: tuple[Size, ...] = get_args(Size)

_FULL_WIDTH = 3840
_FULL_SUBSET_PX = 121
_STILL_S = 1.0
_MARGIN_S = 3.0
"""Motion beyond the videos, for clocks that start late and sensors that record longer."""
_SPAN_M = 28.8
_BAYS = 12
_MODES = (
    BendingMode("vertical", 2.31, 19e3, damping_ratio=0.011, end_restraint=0.16),
    BendingMode("vertical", 6.9, 19e3, damping_ratio=0.013, half_waves=2, end_restraint=0.16),
    BendingMode("vertical", 13.8, 19e3, damping_ratio=0.016, half_waves=3, end_restraint=0.16),
    BendingMode("lateral", 1.57, 10e3, damping_ratio=0.010, end_restraint=0.66),
    BendingMode("lateral", 4.4, 10e3, damping_ratio=0.012, half_waves=2, end_restraint=0.66),
)
"""The same bridge in all tests."""
_TELEPHOTO = (25.0 / 6.17, 24.2 / 6.17)
"""Focal lengths of both cameras over the sensor width [1]."""
_PHONE = (1.50, 1.44)
_Share = tuple[str, float]
_QUARTER, _MIDDLE, _THREE_QUARTERS = ("1/4 span", 1 / 4), ("1/2 span", 1 / 2), ("3/4 span", 3 / 4)


@dataclass(frozen=True)
class _Sequence:
    """Values that differ between the tests, at full size; lengths in metres, amplitudes (vertical, lateral) in mm."""

    description: str
    perpendicular_m: float
    longitudinal_m: float
    baseline_m: float
    direction: tuple[float, float, float]
    """Direction from the reference camera to the second one, of any length."""
    second_target_m: float
    support_m: float
    focal_widths: tuple[float, float]
    monitored: tuple[_Share, _Share]
    amplitudes_mm: tuple[tuple[float, float], tuple[float, float]]
    people: tuple[Pedestrian, ...]
    recordings: tuple[Recording, Recording]
    seed: int
    within_assumptions: bool = True


def preset(name: PresetName | SurfaceName | HostileName, size: Size = "full") -> Preset:
    """A virtual field test.

    Parameters
    ----------
    name
        ``data-1`` to ``data-4``, ``surface-1``, ``surface-2``, ``hostile-1`` to ``hostile-4``.
    size
        ``full``: 3840 x 2160 px, 60 fps, 16 s. ``small``: half the width (of the others than ``data-...`` a third),
        half the frame rate and 8 s, with the same field of view and the same amplitudes.

    Raises
    ------
    DatasetError
        There is no such test or size.

    Examples
    --------
    >>> test = preset("data-4", "small")
    >>> test.fps, test.duration_s, test.site.image_size
    (30, 8.0, (1920, 1080))
    """
    names = (*PRESETS, *SURFACES, *HOSTILE)
    if name not in names or size not in SIZES:
        raise DatasetError(f"preset: expected one of {names} in {SIZES}, got {name!r} in {size!r}; use one of them")
    if name == "surface-1" or name == "surface-2":  # noqa: PLR1714 (mypy does not narrow by `in`)
        return surface_preset(name, small=size == "small")
    if name == "hostile-1" or name == "hostile-2" or name == "hostile-3" or name == "hostile-4":  # noqa: PLR1714
        return hostile_preset(name, small=size == "small")
    sequence = _SEQUENCES[name]()
    width, fps, duration_s = (_FULL_WIDTH, 60, 16.0) if size == "full" else (_FULL_WIDTH // 2, 30, 8.0)
    site = _make_site(sequence, width)
    points = _make_points(sequence, site)
    sensors = tuple(
        MountedAccelerometer(
            Accelerometer(
                name=f"acc-{number + 1}",
                bias_g=(0.004, -0.003, 0.002),
                misalignment_deg=(0.3, -0.2, 0.25),
                # Both sensors share a clock that started before the cameras.
                clock_offset_s=-2.371,
            ),
            point=share[0],
        )
        for number, share in enumerate(sequence.monitored)
    )
    return Preset(
        name=name,
        size=size,
        description=sequence.description,
        site=site,
        motion=_make_motion(sequence, site, duration_s),
        points=points,
        recordings=tuple(_scale_recording(recording, width / _FULL_WIDTH) for recording in sequence.recordings),
        accelerometers=sensors,
        fps=fps,
        duration_s=duration_s,
        still_s=_STILL_S,
        errors=SiteErrors(),
        seed=sequence.seed,
        within_assumptions=sequence.within_assumptions,
        # The same piece of the structure at both sizes.
        subset_px=_FULL_SUBSET_PX if size == "full" else _FULL_SUBSET_PX // 2 + 1,
        # Where the accelerometers sit is known from the drawings.
        known_length=(sequence.monitored[0][0], sequence.monitored[1][0]),
    )


def _make_site(sequence: _Sequence, width: int) -> FootbridgeSite:
    direction = np.asarray(sequence.direction)
    x, y, z = (sequence.baseline_m * direction / np.linalg.norm(direction)).tolist()
    first, second = (1280 * widths for widths in sequence.focal_widths)
    return FootbridgeSite(
        perpendicular_m=sequence.perpendicular_m,
        longitudinal_m=sequence.longitudinal_m,
        focal_px=first,
        k1=-0.05,
        further=(Standpoint((x, y, z), sequence.second_target_m, focal_px=second, k1=0.04),),
        support_m=sequence.support_m,
        span_m=_SPAN_M,
        image_size=(width, width * 9 // 16),
        bays=_BAYS,
        bolted_middles=True,
        backdrop_m=62.0,
        valley=True,
    )


def _make_points(sequence: _Sequence, site: FootbridgeSite) -> tuple[SitePoint, ...]:
    """Both monitored points, two more that move, and three on what stands still."""
    face, middle = site.perpendicular_m, site.longitudinal_m
    between = (sequence.monitored[0][1] + sequence.monitored[1][1]) / 2
    web = tuple(SitePoint(name, (face, 0.0, site.station(share))) for name, share in sequence.monitored)
    return (
        *web,
        SitePoint("web between", (face, 0.0, site.station(between))),
        SitePoint("deck edge", (face - 0.14, -0.455, site.station(between - 0.03))),
        SitePoint("abutment", (face - 0.1, 1.05, middle - 0.9), static=True),
        SitePoint("abutment corner", (face - 0.1, 0.95, middle - 2.6), static=True),
        SitePoint("block", (face - 1.5, 0.95, middle - 0.3), static=True),
    )


def _make_motion(sequence: _Sequence, site: FootbridgeSite, duration_s: float) -> ForcedMotion:
    motion = ForcedMotion(
        modes=_MODES,
        people=sequence.people,
        support_m=site.support_m,
        span_m=site.span_m,
        duration_s=duration_s + _MARGIN_S,
    )
    for number, axis in enumerate(("vertical", "lateral")):
        first, second = (
            PeakToPeak(axis, share, amplitude[number])
            for (_, share), amplitude in zip(sequence.monitored, sequence.amplitudes_mm, strict=True)
        )
        motion = scale_to_amplitudes(motion, (first, second), duration_s=duration_s)
    return motion


def _scale_recording(recording: Recording, scale: float) -> Recording:
    """The recording with pixels of another size."""
    path = recording.stabilization
    return replace(
        recording,
        defocus_px=scale * recording.defocus_px,
        stabilization=None if path is None else replace(path, drift_px=scale * path.drift_px),
    )


def _data_1() -> _Sequence:
    return _Sequence(
        description="sunny; glare in the left view; four people run and jump",
        perpendicular_m=9.6,
        longitudinal_m=22.0,
        baseline_m=3.96,
        direction=(2.75, -0.06, -2.85),
        second_target_m=22.6,
        support_m=7.0,
        focal_widths=_TELEPHOTO,
        monitored=(_MIDDLE, _THREE_QUARTERS),
        amplitudes_mm=((11.94, 9.70), (8.30, 7.79)),
        people=(
            Pedestrian("running", 78, 2.9, 1.05, 0.15, speed_m_s=3.1, seed=11),
            Pedestrian("jumping", 70, 2.1, 1.40, 0.62, contact_ratio=0.45, seed=12),
            Pedestrian("running", 66, 3.15, 1.90, 0.85, speed_m_s=-2.7, seed=13),
            Pedestrian("walking", 82, 1.9, 1.20, 0.35, speed_m_s=1.4, seed=14),
        ),
        recordings=(
            Recording(glare=Glare(0.5, center=(0.2, 0.1), seed=15)),
            Recording(start_s=0.1373),
        ),
        seed=101,
    )


def _data_2() -> _Sequence:
    return _Sequence(
        description="sunny; the left view out of focus; two people run and jump",
        perpendicular_m=9.8,
        longitudinal_m=22.4,
        baseline_m=4.00,
        direction=(2.7, -0.10, -2.95),
        second_target_m=23.2,
        support_m=13.8,
        focal_widths=_TELEPHOTO,
        monitored=(_QUARTER, _MIDDLE),
        amplitudes_mm=((12.15, 4.30), (17.37, 7.28)),
        people=(
            Pedestrian("jumping", 75, 2.25, 1.05, 0.44, contact_ratio=0.5, seed=21),
            Pedestrian("running", 68, 2.95, 1.50, 0.10, speed_m_s=2.9, seed=22),
        ),
        recordings=(
            Recording(defocus_px=2.6),
            Recording(start_s=-0.2118, clock_rate=1 + 15e-6),
        ),
        seed=102,
    )


def _data_3() -> _Sequence:
    return _Sequence(
        description="cloudy; the right view out of focus and dark; two people run and jump",
        perpendicular_m=9.9,
        longitudinal_m=22.8,
        baseline_m=4.97,
        direction=(3.35, -0.08, -3.65),
        second_target_m=23.8,
        support_m=14.2,
        focal_widths=_TELEPHOTO,
        monitored=(_QUARTER, _MIDDLE),
        amplitudes_mm=((7.54, 1.54), (10.95, 2.24)),
        people=(
            Pedestrian("running", 72, 2.85, 1.05, 0.30, speed_m_s=2.5, seed=31),
            Pedestrian("jumping", 64, 2.3, 1.80, 0.52, contact_ratio=0.6, seed=32),
        ),
        recordings=(
            Recording(exposure_s=1 / 240, noise_std=1.4),
            Recording(exposure_s=1 / 120, defocus_px=2.2, light=0.45, noise_std=2.2, start_s=0.3291),
        ),
        seed=103,
    )


def _data_4() -> _Sequence:
    phone = Recording(exposure_s=1 / 240, rolling_shutter_s=0.010, noise_std=1.2, sharpening=0.9, crf=16)
    return _Sequence(
        description="cloudy, clear; two phones that stabilise and sharpen; two people run and jump",
        perpendicular_m=7.4,
        longitudinal_m=13.5,
        baseline_m=3.51,
        direction=(2.2, -0.05, -2.7),
        second_target_m=13.9,
        support_m=6.6,
        focal_widths=_PHONE,
        monitored=(_QUARTER, _MIDDLE),
        amplitudes_mm=((7.8, 1.9), (11.2, 2.8)),
        people=(
            Pedestrian("running", 72, 2.9, 1.05, 0.20, speed_m_s=2.6, seed=41),
            Pedestrian("jumping", 77, 2.2, 1.60, 0.48, contact_ratio=0.55, seed=42),
        ),
        recordings=(
            replace(phone, stabilization=Stabilization(follow=0.6, drift_px=1.5, seed=43)),
            replace(phone, stabilization=Stabilization(follow=0.4, drift_px=1.0, seed=45), start_s=0.0877),
        ),
        seed=104,
        within_assumptions=False,
    )


_SEQUENCES: dict[PresetName, Callable[[], _Sequence]] = {
    "data-1": _data_1,
    "data-2": _data_2,
    "data-3": _data_3,
    "data-4": _data_4,
}
