"""Films of a planned site by the project's own renderer: a girder of the planned contrast before its background."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.rig_draws import draw_normal
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.studies.planning.layout import Layout, note
from vfm_sdm.studies.synthetic.building import Builder, Material, along, down
from vfm_sdm.studies.synthetic.disturbances import Disturbances
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.footbridge import Standpoint
from vfm_sdm.studies.synthetic.plan import Preset, Recording, Site, SiteErrors, SitePoint
from vfm_sdm.studies.synthetic.recording import write_video
from vfm_sdm.studies.synthetic.scene import Scene

__all__ = ["Filmed", "PlannedSite", "draw_errors", "film_plan", "true_displacement"]

_PLATE_M = 1.6
_BLOCK_M = 0.5
"""Half the side of what a static point lies on [m]."""
_LARGEST_ERROR = 2.0
"""Errors of readings and lenses beyond this many standard deviations are not drawn."""
_CRF = 0
"""Quality of a recording whose bit rate is not stated: as good as not compressed, as it is predicted."""
_ENCODER = {"preset": "veryfast", "threads": "1"}
_CONCRETE = Material(150, 18, tint=(-5, 3), stains=7)
_BANK = Material(94, 20, tint=(-15, -5), longest_m=0.6)
_HOUSES = Material(128, 18, tint=(-9, 7), longest_m=2.0)


@dataclass(frozen=True, eq=False)
class PlannedSite:
    """A planned site for the renderer, in the interface of the virtual field tests.

    Parameters
    ----------
    laid
        Geometry of the plan, with the true cameras.
    """

    laid: Layout

    @property
    def perpendicular_m(self) -> float:
        """Distance from the reference camera to the face [m]."""
        return self.laid.face_m[0]

    @property
    def longitudinal_m(self) -> float:
        """Longitudinal coordinate on the face of what the middle of the reference view shows [m]."""
        return float(self.laid.points3d[~self.laid.static][:, 2].mean())

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of all pictures [px]."""
        return self.laid.cameras[0].image_size

    @property
    def level_deg(self) -> tuple[float, float]:
        """Pitch and roll of the reference camera [deg]."""
        return float(-np.degrees(np.arcsin(self.laid.cameras[0].rotation[2, 1]))), 0.0

    @property
    def further(self) -> tuple[Standpoint, ...]:
        """The cameras beside the reference."""
        return tuple(
            Standpoint(_triple(camera.center), 0.0, camera.focal_px, float(camera.distortion[0]))
            for camera in self.laid.cameras[1:]
        )

    def cameras(self) -> tuple[Camera, ...]:
        """The cameras in the structural axes."""
        return self.laid.cameras

    def scene(self, *, seed: int) -> Scene:
        """Plates of the face, what static points lie on, a near bank below and what is far above.

        Parameters
        ----------
        seed
            Seed of all textures.
        """
        laid, structure = self.laid, self.laid.plan.structure
        lateral, upper, lower, start, end = laid.face_m
        builder = Builder(laid.cameras, seed)
        steel = Material(118, structure.contrast, tint=(-4, -7), stains=3)
        plates = max(round((end - start) / _PLATE_M), 1)
        length = (end - start) / plates
        for number in range(plates):
            corner = (lateral, upper, start + number * length)
            builder.add(f"plate {number}", corner, (along(length), down(lower - upper)), steel, moving=True)
        for number, at in enumerate(laid.points3d[laid.static]):
            corner = (float(at[0]), float(at[1]) - _BLOCK_M, float(at[2]) - _BLOCK_M)
            builder.add(f"block {number}", corner, (along(2 * _BLOCK_M), down(2 * _BLOCK_M)), _CONCRETE)
        near, far = structure.background_m
        middle, reach = 0.5 * (upper + lower), (end - start) + 4 * (lateral + far)
        low = (lateral + near, middle, 0.5 * (start + end) - 0.5 * reach)
        builder.add("bank", low, (along(reach), down(lateral + near)), _BANK)
        high = (lateral + far, middle - (lateral + far), 0.5 * (start + end) - 0.5 * reach)
        builder.add("houses", high, (along(reach), down(2 * (lateral + far))), _HOUSES)
        return Scene(tuple(builder.faces), sky=205.0)


@dataclass(frozen=True, eq=False)
class Filmed:
    """Films of a planned site.

    Parameters
    ----------
    laid
        Geometry with the true cameras, whose lenses are not quite what is noted.
    session
        As noted, every reading with an error of the size of its standard deviation; it lies in ``session.toml``.
    truth
        ``displacement`` (time, point, axis) [mm] at the frames of the reference view, relative to the rest.
    """

    laid: Layout
    session: Session
    truth: xr.Dataset


def film_plan(laid: Layout, folder: Path, *, seed: int = 0, progress: Progress | None = None) -> Filmed:
    """Writes the films of a planned site and the session that belongs to them.

    Parameters
    ----------
    laid
        Geometry of the plan.
    folder
        Folder to write to; made when absent.
    seed
        Of textures, noise, lenses and errors of readings.
    progress
        Called with the number of frames that were written.

    Raises
    ------
    SessionError
        The pictures differ in size, or their sides are odd.
    ResultsError
        The folder cannot be written to.
    """
    sizes = {camera.image_size for camera in laid.cameras}
    if len(sizes) > 1 or any(side % 2 for size in sizes for side in size):
        raise SessionError(f"camera: expected pictures of one size with even sides to render, got {sizes}; change them")
    true, session = draw_errors(laid, np.random.default_rng([seed, 1]))
    preset = _preset(true, seed)
    scene = preset.site.scene(seed=seed)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"{folder}: expected a folder to write to, got: {error}; choose another") from error
    for view, name in enumerate(preset.views):
        frames, chroma = film_view(preset, scene, view)
        rate = preset.recordings[view].disturbances.bits_per_pixel
        quality = (
            {"b": str(round(rate * math.prod(preset.site.image_size) * preset.fps))} if rate else {"crf": str(_CRF)}
        )
        counted = _count(frames, view * preset.frames, 2 * preset.frames, progress)
        write_video(folder / f"{name}.mp4", counted, fps=preset.fps, chroma=chroma, options={**quality, **_ENCODER})
    session = session.model_copy(update={"folder": folder.absolute()})
    write_session(folder / "session.toml", session)
    return Filmed(true, session, true_displacement(laid))


def true_displacement(laid: Layout) -> xr.Dataset:
    """Displacement of all points at the frames of the reference view, (time, point, axis) [mm].

    Parameters
    ----------
    laid
        Geometry of the plan.
    """
    clock = np.arange(laid.plan.frames) / laid.plan.fps
    moved = laid.motion.displacement(clock, laid.points3d) * ~laid.static[:, None]
    return xr.Dataset(
        {"displacement": (("time", "point", "axis"), 1e3 * moved, {"units": "mm"})},
        coords={"time": clock, "point": [one.name for one in laid.plan.point], "axis": list(STRUCTURE_AXES)},
    )


def draw_errors(laid: Layout, rng: np.random.Generator) -> tuple[Layout, Session]:
    """True cameras with lenses drawn from their priors, and readings with drawn errors.

    Parameters
    ----------
    laid
        Geometry of the plan.
    rng
        Source of the errors.
    """
    cameras = []
    for camera, covariance in zip(laid.cameras, laid.priors.intrinsics_covariance, strict=True):
        limit = _LARGEST_ERROR * np.sqrt(np.diag(covariance))
        step = np.clip(draw_normal(covariance, 1, rng)[0], -limit, limit)
        cameras.append(camera.perturbed([*step, *[0.0] * 6]))
    true = replace(laid, cameras=tuple(cameras))
    return true, _misread(note(true), rng)


def _misread(session: Session, rng: np.random.Generator) -> Session:
    """The session with an error of the size of its standard deviation in every reading."""

    def error(std: float) -> float:
        return std * float(np.clip(rng.standard_normal(), -_LARGEST_ERROR, _LARGEST_ERROR))

    def tape(table: dict[str, object]) -> dict[str, object]:
        changed = dict(table)
        for key, std in (("value", "std"), ("pitch_deg", "std_deg"), ("roll_deg", "std_deg")):
            if isinstance(value := table.get(key), float) and isinstance(spread := table.get(std), float):
                changed[key] = value + error(spread)
        return changed

    fields = session.model_dump()
    site = fields["site"]
    for key, table in site.items():
        if isinstance(table, dict):
            site[key] = tape(table)
        elif key in ("range", "length"):
            site[key] = [tape(one) for one in table]
    for view in fields["view"]:
        for key in ("level", "perpendicular_distance", "longitudinal_distance"):
            if view[key] is not None:
                view[key] = tape(view[key])
    return Session(**fields)


def _preset(laid: Layout, seed: int) -> Preset:
    """The virtual field test of a plan."""
    plan = laid.plan
    if plan.fps != round(plan.fps):
        raise SessionError(f"fps: expected whole frames a second to render, got {plan.fps:g}; round it")
    return Preset(
        name=plan.name,
        size="planned",
        description="a planned site",
        # The renderer asks a site for no more than this one has; the studies that vary sites vary the others.
        site=cast("Site", PlannedSite(laid)),
        motion=laid.motion,
        points=tuple(
            SitePoint(one.name, _triple(at), one.static) for one, at in zip(plan.point, laid.points3d, strict=True)
        ),
        recordings=tuple(_recording(laid, number) for number in range(len(plan.camera))),
        views=laid.priors.names,
        accelerometers=(),
        fps=round(plan.fps),
        duration_s=plan.duration_s,
        still_s=plan.still_s,
        errors=SiteErrors(),
        seed=seed,
    )


def _recording(laid: Layout, number: int) -> Recording:
    rate = laid.plan.camera[number].bitrate_mbit_s
    if rate is None:
        return Recording(exposure_s=0.0, crf=_CRF)
    bits = 1e6 * rate / laid.plan.fps / math.prod(laid.cameras[number].image_size)
    return Recording(exposure_s=0.0, disturbances=Disturbances(bits_per_pixel=bits))


def _count(frames: Iterator[np.ndarray], done: int, total: int, progress: Progress | None) -> Iterator[np.ndarray]:
    for number, frame in enumerate(frames, start=done + 1):
        yield frame
        if progress is not None:
            progress("filming", number, total)


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z
