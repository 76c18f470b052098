"""Accelerometers as length standards: what they say of the size of motions, for the adjustment of the cameras."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import xarray as xr

from vfm_sdm.analysis.fusion.fuse import FusionSettings, fuse
from vfm_sdm.analysis.fusion.sources import read_session_acceleration
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus, FusionStatus
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Measured, SensedMotion, Sensor, Session
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = ["SensorScale", "find_contradiction", "find_sensor_scale", "first_session"]

_STAND_IN = Measured(value=3.0, std=3.0)
"""Baseline with which cameras are first solved where none was measured [m]: a session's usual one, or any other."""
_STAND_IN_STD = 0.5
"""Relative standard deviation of the baseline that stands in then: nothing beside what the sensor says."""
_GAIN_STD = 3.0
"""Of the sensor's gain beside cameras of any scale [1]."""
_VERTICAL = "vertical"
_LEVEL_STD, _CROSS_STD = 0.05, 0.5
"""Of the share of one axis that another one shows [1]: in vertical, which gravity tells to three degrees, and in the
others, because a sensor may lie turned as it likes; its length is that of all axes."""
_LEAST_UPRIGHT = 0.5
"""Share of gravity that a vertical axis must feel [1]: 60 degrees."""
_LEAST_GAIN = 5.0
"""Standard deviations that a gain must be above zero for the sensor to tell a length."""
_MOST_SCATTER = 2.0
"""Scatter of the video about the sensor over what the video states, above which they do not see the same motion [1]."""
_CONTRADICTS, _LEAST_APART = 4.0, 0.05
"""Difference of sizes along two axes that one sensor cannot have: in standard deviations, and relative [1]."""
_G = 9.80665
_NO_GRAVITY, _LIKE_GRAVITY = 0.05, 0.05
"""Of gravity: what a sensor reads that holds none, and how far one may be off that holds it [1]."""
_STEP = 1e-3
"""Length of the motion that is put into the adjustment, over the distance of the point."""
_OF_GAIN = ("compression", "subset")
"""Components of the budget by which the video sees motion too large or too small, whatever its cameras."""


@dataclass(frozen=True)
class SensorScale:
    """What the sensors of a session say of lengths.

    Parameters
    ----------
    motion
        Motions and their lengths; empty where no sensor is a length standard, or none saw the motion.
    baseline
        Baseline that stands in where none was measured.
    notes
        What was found, in sentences.
    """

    motion: tuple[SensedMotion, ...] = ()
    baseline: Measured | None = None
    notes: tuple[str, ...] = ()

    def as_table(self) -> dict[str, Any]:
        """Its content as plain tables."""
        of_baseline = None if self.baseline is None else self.baseline.model_dump()
        return {"motion": [one.model_dump() for one in self.motion], "baseline": of_baseline, "notes": list(self.notes)}

    def put_into(self, session: Session) -> Session:
        """The session with these lengths among those of its site.

        Parameters
        ----------
        session
            The session, or a part of it.
        """
        site = session.site.model_copy(update={"motion": self.motion})
        if self.baseline is not None:
            site = site.model_copy(update={"baseline": self.baseline})
        return session.model_copy(update={"site": site})

    def judge(self, solution: CameraSolution) -> CameraSolution:
        """The cameras with what there is to say of the sensors; none where nothing tells their scale.

        Parameters
        ----------
        solution
            Cameras that were adjusted to the lengths.
        """
        found = replace(solution, notes=(*solution.notes, *self.notes))
        if self.baseline is None or self.motion or solution.rig is None:
            return found
        lost: dict[str, Any] = {"rig": None, "frame": None, "covariance": None, "contributions": ()}
        return replace(found, **lost, quantities=(), status=CameraStatus.NO_LENGTH)

    @classmethod
    def none(cls) -> Self:
        """Of a session without such sensors."""
        return cls()


def first_session(session: Session) -> Session:
    """The session as it is measured first, in any scale: the sensors' points, what is static, and what lengths name.

    Parameters
    ----------
    session
        The session.
    """
    site = session.site
    wanted = {sensor.point for sensor in session.scale_sensors} | {one.point for one in site.range}
    wanted |= {name for one in site.length for name in one.points}
    wanted |= {name for one in site.rectangle for name in one.points or ()}
    points = tuple(point for point in session.point if point.static or point.name in wanted)
    if site.baseline is None:
        site = site.model_copy(update={"baseline": _STAND_IN})
    return session.model_copy(
        update={"point": points, "site": site, "sensor": (), "report": None, "baseline_visit": None}
    )


def find_sensor_scale(
    session: Session, measure: Callable[[Session], tuple[CameraSolution, xr.Dataset | None]]
) -> SensorScale:
    """What the session's sensors say of the size of motions; nothing where none is a length standard.

    Parameters
    ----------
    session
        The session.
    measure
        Function that measures a session in any scale, to its cameras and displacement.

    Raises
    ------
    SessionError, DatasetError
        A sensor's file cannot be read.

    Notes
    -----
    Displacement of the sensor's point is measured with cameras whose scale may be anything, and fused with the
    acceleration (`vfm_sdm.analysis.fusion.fuse`): the gain that comes out is how much too large these cameras see the
    motion. A small motion of the point along the axis that tells this best, as pixels of all views, then has a known
    length, like any two marks between which somebody held a tape.
    """
    if not session.scale_sensors:
        return SensorScale.none()
    cameras, displacement = measure(first_session(session))
    motion: list[SensedMotion] = []
    notes: list[str] = []
    for sensor in session.scale_sensors:
        found, note = (
            (None, "the cameras were not found")
            if displacement is None
            else (_read_length(session, sensor, cameras, displacement))
        )
        motion += [] if found is None else [found]
        notes.append(note if found is not None else f"sensor {sensor.name} tells no length: {note}")
    baseline = None
    if session.site.baseline is None:
        here = 1.0 if cameras.rig is None else cameras.rig.baseline()
        if motion:
            here *= motion[0].length / _length_in(cameras, motion[0])
        baseline = Measured(value=here, std=_STAND_IN_STD * here)
        notes.append("no baseline was measured: the scale rests on the sensors and on other lengths of the site")
    return SensorScale(tuple(motion), baseline, tuple(notes))


def _read_length(
    session: Session, sensor: Sensor, cameras: CameraSolution, displacement: xr.Dataset
) -> tuple[SensedMotion | None, str]:
    """The motion whose length a sensor tells, or the reason why it does not."""
    acceleration, point = read_session_acceleration(session, sensor.name)
    rest = np.nanmedian(acceleration["acceleration"].values[:, 0], axis=0)
    axes = [str(axis) for axis in acceleration["axis"].values]
    doubt = _doubt_rest(rest, axes)
    if doubt:
        return None, doubt
    static = [one.name for one in session.point if one.static]
    found: dict[str, xr.Dataset] = {}
    reasons: list[str] = []
    for chosen, cross_std in (([_VERTICAL], _LEVEL_STD), ([axis for axis in axes if axis != _VERTICAL], _CROSS_STD)):
        if not {*chosen} <= {*axes} or not chosen:
            continue
        settings = FusionSettings(gain_std=_GAIN_STD, cross_std=cross_std)
        levelled = _level(acceleration, rest, axes)
        fused = fuse(displacement, levelled, point, axes=chosen, static=static, settings=settings)
        reasons.append(str(fused.attrs["status"]))
        if fused.attrs["status"] == FusionStatus.OK:
            found |= {str(axis): fused.sel(axis=axis) for axis in fused["axis"].values}
    if not found:
        return None, reasons[0]
    clear = {axis: one for axis, one in found.items() if float(one["size"]) > _LEAST_GAIN * float(one["size_std"])}
    if not clear:
        return None, str(FusionStatus.NO_MOTION)
    spreads = {
        axis: float(
            np.hypot(float(one["size_std"] / one["size"]), _spread_gain(displacement.sel(point=point, axis=axis)))
        )
        for axis, one in clear.items()
    }
    contradiction = find_contradiction(found, {axis: float(clear[axis]["size"]) for axis in clear}, spreads)
    if contradiction:
        return None, f"{contradiction}; check that it sits at {point} and that nothing filters it"
    axis = min(spreads, key=lambda one: spreads[one])
    gain, std = float(found[axis]["size"]), float(np.hypot(spreads[axis], sensor.scale_std or 0.0))
    before, moved = _place_motion(cameras, point, [str(a) for a in displacement["axis"].values].index(axis))
    if not before:
        return None, f"point {point} is not seen in two views"
    one = SensedMotion(point=point, sensor=sensor.name, rest=before, moved=moved, length=1.0, std=1.0)
    length = _length_in(cameras, one) / gain
    note = f"scale by sensor {sensor.name}: motion of {point} along {axis} known to {100 * std:.2g} %"
    if not _holds_gravity(rest):
        note += "; its record holds no gravity and nothing checks its units"
    return one.model_copy(update={"length": length, "std": std * length}), note


def _holds_gravity(rest: FloatArray) -> bool:
    return float(np.linalg.norm(rest)) >= _NO_GRAVITY * _G


def _doubt_rest(rest: FloatArray, axes: list[str]) -> str:
    """Words where what a sensor reads at rest (A,) [m/s2] is neither gravity along vertical nor nothing; else none."""
    felt = float(np.linalg.norm(rest))
    if not _holds_gravity(rest):
        return ""
    least = (1 - _LIKE_GRAVITY) * _G if _VERTICAL in axes else 0.0
    if not least <= felt <= (1 + _LIKE_GRAVITY) * _G:
        return (
            f"it reads {felt:.2f} m/s2 at rest, neither gravity nor nothing; check its units and its columns; name "
            "those of all three axes where it is not upright"
        )
    if _VERTICAL in axes and abs(rest[axes.index(_VERTICAL)]) < _LEAST_UPRIGHT * felt:
        return "its vertical axis does not feel gravity; check its units and its columns"
    return ""


def _level(acceleration: xr.Dataset, rest: FloatArray, axes: list[str]) -> xr.Dataset:
    """The acceleration along axes that are turned upright, as gravity shows them; as it is where it holds none."""
    if _VERTICAL not in axes or not _holds_gravity(rest):
        return acceleration
    down = np.zeros(len(axes))
    down[axes.index(_VERTICAL)] = np.copysign(1.0, rest[axes.index(_VERTICAL)])
    felt = rest / np.linalg.norm(rest)
    # The smallest rotation that takes what is felt to where down is.
    both = felt + down
    turn = np.eye(len(axes)) - np.outer(both, both) / (1 + felt @ down) + 2 * np.outer(down, felt)
    return acceleration.assign(
        acceleration=acceleration["acceleration"].copy(data=acceleration["acceleration"].values @ turn.T)
    )


def find_contradiction(
    found: Mapping[str, xr.Dataset], sizes: Mapping[str, float], spreads: Mapping[str, float]
) -> str:
    """Words on what video and sensor cannot both have seen of one motion; none where there is nothing.

    Parameters
    ----------
    found
        The fusion by axis, as `vfm_sdm.analysis.fusion.fuse` describes it.
    sizes, spreads
        What it says of the sensor's size, and its relative standard deviation, along those axes that tell it [1].
    """
    for axis, one in found.items():
        scatter = float(one["stated_ratio"])
        if scatter > _MOST_SCATTER:
            return f"along {axis} the video scatters {scatter:.1f} times as much about it as it states"
        if not int(one["bands_agree"]):
            return f"along {axis} its motion has another size at some frequencies than at others"
    largest, least = (choose(sizes, key=lambda axis: sizes[axis]) for choose in (max, min))
    apart = float(np.log(sizes[largest] / sizes[least]))
    if apart > max(_LEAST_APART, _CONTRADICTS * float(np.hypot(spreads[largest], spreads[least]))):
        return f"the video over it is {np.exp(apart):.2f} times as large along {largest} as along {least}"
    return ""


def _spread_gain(series: xr.Dataset) -> float:
    """Relative standard deviation of the size of motion in the video, beside its cameras [1]."""
    if "uncertainty" not in series:
        return 0.0
    parts = series["uncertainty"].sel(component=list(_OF_GAIN))
    moved = float((series["displacement"] ** 2).mean())
    return float(np.sqrt(float((parts**2).sum("component").mean()) / moved)) if moved > 0 else 0.0


def _place_motion(
    cameras: CameraSolution, point: str, axis: int
) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]:
    """Pixels of a point, and after a small motion along an axis, by view; none where fewer than two see it."""
    rig = cameras.rig
    if rig is None:
        return {}, {}
    pixels = cameras.points["position"].sel(point=point, view=list(rig.names)).transpose("view", "pixel").values
    seen = np.isfinite(pixels).all(axis=1)
    if seen.sum() < 2:
        return {}, {}
    place = triangulate(pixels, rig)
    rotation = np.eye(3) if cameras.frame is None else cameras.frame.rotation
    ends = place, place + _STEP * float(np.linalg.norm(place)) * rotation[axis]
    rest, moved = (
        {
            name: _pair(camera.project(end))
            for name, camera, known in zip(rig.names, rig.cameras, seen, strict=True)
            if known
        }
        for end in ends
    )
    return rest, moved


def _pair(pixel: FloatArray) -> tuple[float, float]:
    return float(pixel[0]), float(pixel[1])


def _length_in(cameras: CameraSolution, motion: SensedMotion) -> float:
    """Length of a motion in the scale of these cameras [m]."""
    if cameras.rig is None:
        return 1.0
    nowhere = (np.nan, np.nan)
    ends = [[pixels.get(view, nowhere) for view in cameras.rig.names] for pixels in (motion.rest, motion.moved)]
    return float(np.linalg.norm(np.subtract(*triangulate(np.stack(ends, axis=1), cameras.rig))))
