"""What is easily confused on site: every confusion is another reading of the same notes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.inputs.session import Level, Measured, Readings, Site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["FREE_STD", "Confusion", "Statements", "list_confusions", "with_poses"]

FREE_STD = 0.5
"""Standard deviation of rotations [rad] and translations [m] above which a prior leaves a pose free."""
_UNITS = ((1e-3, "in millimetres"), (0.3048, "in feet"), (1e3, "in kilometres, or divided by 1000 once too often"))
_LEAST_STD = 0.003
"""Relative standard deviation left at least to a length in another unit, for it may have been noted in metres."""
_SITES_M = (0.05, 500.0)
"""Distances between two cameras that occur [m]."""
_ALIKE = 0.01
"""Relative difference below which two values are one and cannot be confused."""


@dataclass(frozen=True, eq=False)
class Statements:
    """Everything that is stated of cameras and site: arguments of `vfm_sdm.stages.cameras.site.adjust_to_site`."""

    rig: Rig
    matches: tuple[Matches, ...]
    site: Site
    points: Mapping[str, SitePoint]
    readings: Mapping[str, Readings]
    edges: tuple[StraightEdges, ...] = ()

    @property
    def free_poses(self) -> bool:
        """Whether the relative pose of two views is to be found from matches, and not stated."""
        if len(self.rig) != 2 or self.rig.covariance is None or not self.matches:
            return False
        std = np.sqrt(np.diag(self.rig.covariance))[len(CAMERA_PARAMETERS) + 4 :]
        return bool((std >= FREE_STD).all())


@dataclass(frozen=True, eq=False)
class Confusion:
    """Another reading of what was stated.

    Parameters
    ----------
    name
        What would be confused.
    advice
        What was expected, what is stated, and what to do.
    read
        The statements as they were meant.
    """

    name: str
    advice: str
    read: Statements


def with_poses(rig: Rig, posed: Rig) -> Rig:
    """A rig at the poses of another, with its own lenses and priors.

    Parameters
    ----------
    rig, posed
        Rigs of the same views.
    """
    moved = [replace(own, cam_from_world=c.cam_from_world) for own, c in zip(rig.cameras, posed.cameras, strict=True)]
    return replace(rig, cameras=tuple(moved))


def list_confusions(stated: Statements) -> Iterator[Confusion]:
    """Every simple confusion that the statements leave room for.

    Parameters
    ----------
    stated
        Statements as they stand in the session.
    """
    yield from _confuse_views(stated)
    if stated.site.perpendicular_distance is not None:
        yield from _confuse_distances(stated)
        yield from _confuse_side(stated)
    yield from _confuse_levels(stated)
    yield from _confuse_units(stated)


def _confuse_views(stated: Statements) -> Iterator[Confusion]:
    """Recordings of two views exchanged, and their lenses."""
    rig, names = stated.rig, stated.rig.names
    sizes = {camera.image_size for camera in rig.cameras}
    if not stated.free_poses or len(sizes) > 1:
        return
    first, second = rig.cameras
    pair = " and ".join(map(repr, names))
    matches = tuple(replace(m, points_first=m.points_second, points_second=m.points_first) for m in stated.matches)
    points = {
        name: replace(one, pixels=one.pixels[::-1], std_px=np.broadcast_to(one.std_px, one.pixels.shape)[::-1])
        for name, one in stated.points.items()
    }
    back = second.rotation.T
    moved = replace(second, cam_from_world=np.column_stack([back, -back @ second.translation]))
    edges = tuple(replace(one, view=1 - one.view) for one in stated.edges)
    read = replace(stated, rig=replace(rig, cameras=(first, moved)), matches=matches, points=points, edges=edges)
    advice = (
        f"expected the recording of either camera under its name, got {pair} the other way round, do: exchange them"
    )
    yield Confusion("recordings of the two views", advice, read)
    if abs(np.log(first.focal_px / second.focal_px)) > _ALIKE:
        cameras = tuple(_with_lens(own, other) for own, other in zip(rig.cameras, rig.cameras[::-1], strict=True))
        advice = (
            f"expected the lens of either camera under its name, got those of {pair} the other way round, do: exchange "
            "them"
        )
        swapped = replace(rig, cameras=cameras, covariance=_swap_lenses(np.asarray(rig.covariance)))
        yield Confusion("lenses of the two views", advice, replace(stated, rig=swapped))


def _with_lens(camera: Camera, other: Camera) -> Camera:
    return replace(camera, K=other.K, distortion=other.distortion)


def _swap_lenses(covariance: FloatArray) -> FloatArray:
    """Covariance with the priors of two lenses exchanged, shape (20, 20)."""
    size = len(CAMERA_PARAMETERS)
    order = np.arange(2 * size)
    order[:4], order[size : size + 4] = np.arange(size, size + 4), np.arange(4)
    return covariance[np.ix_(order, order)]


def _confuse_distances(stated: Statements) -> Iterator[Confusion]:
    """The two distances of a camera exchanged, and those of two cameras."""
    site = stated.site
    own = (site.perpendicular_distance, site.longitudinal_distance)
    reference = stated.rig.names[0]
    if (swapped := _swapped(*own)) is not None:
        yield _exchanged(reference, own, replace(stated, site=site.model_copy(update=swapped)))
    for view, read in stated.readings.items():
        theirs = (read.perpendicular_distance, read.longitudinal_distance)
        if (swapped := _swapped(*theirs)) is not None:
            yield _exchanged(view, theirs, _with_reading(stated, view, swapped))
        if None in theirs or None in own:
            continue
        keys = ("perpendicular_distance", "longitudinal_distance")
        other = _with_reading(stated, view, dict(zip(keys, own, strict=True)))
        other = replace(other, site=site.model_copy(update=dict(zip(keys, theirs, strict=True))))
        advice = f"expected those of {reference!r} under [site], got those of {view!r} there, do: exchange them"
        yield Confusion(f"distances of {reference!r} and {view!r}", advice, other)


def _swapped(across: Measured | None, along: Measured | None) -> dict[str, Measured] | None:
    """Both distances exchanged; ``None`` where that would change nothing or gives none."""
    if across is None or along is None or along.value <= 0 or abs(np.log(across.value / along.value)) < _ALIKE:
        return None
    return {"perpendicular_distance": along, "longitudinal_distance": across}


def _exchanged(view: str, distances: tuple[Measured | None, Measured | None], read: Statements) -> Confusion:
    across, along = (0.0 if one is None else one.value for one in distances)
    advice = (
        f"expected {along:g} m across and {across:g} m along the structure, got them the other way round, do: exchange "
        "perpendicular_distance and longitudinal_distance"
    )
    return Confusion(f"distances of {view!r}", advice, read)


def _with_reading(stated: Statements, view: str, update: Mapping[str, object]) -> Statements:
    changed = stated.readings[view].model_copy(update=dict(update))
    return replace(stated, readings={**stated.readings, view: changed})


def _confuse_side(stated: Statements) -> Iterator[Confusion]:
    """The structure on the other side of the reference camera."""
    stands = stated.site.structure_side
    other = "left" if stands == "right" else "right"
    read = replace(stated, site=stated.site.model_copy(update={"structure_side": other}))
    yield Confusion("side of the structure", f"expected {other!r}, got {stands!r}, do: correct structure_side", read)


def _confuse_levels(stated: Statements) -> Iterator[Confusion]:
    """Signs of pitch and roll, and the two exchanged."""
    reference = stated.site.reference_camera_level
    if reference is not None:
        for what, level in _misread(reference):
            read = replace(stated, site=stated.site.model_copy(update={"reference_camera_level": level}))
            yield _misread_level(stated.rig.names[0], what, (reference, level), read)
    for view, reading in stated.readings.items():
        if reading.level is not None:
            for what, level in _misread(reading.level):
                read = _with_reading(stated, view, {"level": level})
                yield _misread_level(view, what, (reading.level, level), read)


def _misread(level: Level) -> Iterator[tuple[str, Level]]:
    """What may be misread of a level, and the level as it was meant; changes below its noise are none."""
    pitch, roll = level.pitch, level.roll
    for what, other in (
        ("sign of the pitch", (-pitch, roll)),
        ("sign of the roll", (pitch, -roll)),
        ("signs of the level", (-pitch, -roll)),
        ("pitch and roll", (roll, pitch)),
    ):
        if np.abs(np.subtract(other, (pitch, roll))).max() > level.std_deg:
            yield what, level.model_copy(update={"pitch_deg": other[0], "roll_deg": other[1]})


def _misread_level(view: str, what: str, levels: tuple[Level, Level], read: Statements) -> Confusion:
    stated, meant = levels
    advice = (
        f"expected pitch {meant.pitch:g} and roll {meant.roll:g} deg, got {stated.pitch:g} and {stated.roll:g}, do: "
        "correct the level (pitch is positive upwards, roll with the right-hand side lowered)"
    )
    return Confusion(f"{what} of {view!r}", advice, read)


def _confuse_units(stated: Statements) -> Iterator[Confusion]:
    """The baseline in another unit than metres: poses start from it, and would not come back from a thousandfold one.

    Other lengths need no start: what everything else gives for them tells their unit.
    """
    baseline = stated.site.baseline
    if baseline is None or not stated.free_poses:
        return
    for factor, unit in _UNITS:
        value = baseline.value * factor
        if not _SITES_M[0] < value < _SITES_M[1]:
            continue
        meant = Measured(value=value, std=max(baseline.std * factor, _LEAST_STD * value))
        covariance = _scale_poses(np.asarray(stated.rig.covariance), factor)
        length = replace(stated.rig.scaled(value / stated.rig.baseline()), covariance=covariance)
        advice = f"expected {value:.4g} m, got {baseline.value:g} {unit}, do: state it in metres"
        site = stated.site.model_copy(update={"baseline": meant})
        yield Confusion("baseline", advice, replace(stated, rig=length, site=site))


def _scale_poses(covariance: FloatArray, factor: float) -> FloatArray:
    """Covariance of a rig's parameters with all lengths scaled, shape (10 V, 10 V)."""
    scale = np.ones(len(CAMERA_PARAMETERS))
    scale[-3:] = factor
    both = np.tile(scale, len(covariance) // len(scale))
    return np.asarray(covariance * np.outer(both, both))
