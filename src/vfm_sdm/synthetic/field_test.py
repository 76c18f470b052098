"""Synthetic field tests: a footbridge filmed by two cameras, written as a normal session folder with its truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm import __version__
from vfm_sdm.arrays import FloatArray
from vfm_sdm.datasets import STRUCTURE_AXES, Status, make_displacement
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.files import replace_file
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.session import Lens, Level, Measured, Method, Point, Range, Session, Site, View, write_session
from vfm_sdm.synthetic.footbridge import FootbridgeSite, build_footbridge
from vfm_sdm.synthetic.motion import ModalMotion, Mode, modal_displacement
from vfm_sdm.synthetic.recording import write_video
from vfm_sdm.synthetic.render import Renderer, quantize
from vfm_sdm.synthetic.scene import Scene

__all__ = ["DemoPoint", "demo_motion", "demo_points", "make_demo"]

Progress = Callable[[int, int], None]
"""Called with the number of frames written so far and the number of all."""

_VIEWS = ("left", "right")
_FILES = ("left.mp4", "right.mp4", "session.toml", "truth.nc")
_FPS = 30
_NOISE_STD = 1.0
"""Sensor noise in luma units of 8 bits."""
# Some 60 Mbit/s, as action cameras write 4K: harder compression would be the largest error of the demonstration.
_ENCODER = {"crf": "4", "preset": "veryfast", "tune": "grain", "threads": "2"}
_SHORTEST_S = 0.5
_SENSOR_WIDTH_MM = 6.17
_MODES = (
    Mode("vertical", 2.2, 4.5, damping_ratio=0.012),
    Mode("vertical", 6.1, 0.5, damping_ratio=0.015, half_waves=2),
    Mode("lateral", 1.4, 1.8, damping_ratio=0.010),
    Mode("longitudinal", 2.2, 0.25, damping_ratio=0.012, half_waves=0),
)


@dataclass(frozen=True)
class DemoPoint:
    """A named point of the footbridge.

    Parameters
    ----------
    name
        As in the session.
    position
        At rest, in the world frame of `vfm_sdm.synthetic.scene` [m].
    static
        Whether it stands still.
    """

    name: str
    position: tuple[float, float, float]
    static: bool = False


def demo_points(site: FootbridgeSite) -> tuple[DemoPoint, ...]:
    """Three points on the girder's web, one on the slab's edge, two on the abutment."""
    face = site.perpendicular_m
    return (
        DemoPoint("1/4 span", (face, 0.02, site.station(1 / 4))),
        DemoPoint("3/8 span", (face, -0.02, site.station(3 / 8))),
        DemoPoint("1/2 span", (face, 0.02, site.station(1 / 2))),
        DemoPoint("deck edge", (face - 0.14, -0.455, site.station(0.44))),
        DemoPoint("abutment", (face - 0.1, 0.79, site.longitudinal_m - 0.5), static=True),
        DemoPoint("abutment corner", (face - 0.1, 0.77, site.longitudinal_m - 1.1), static=True),
    )


def demo_motion(site: FootbridgeSite) -> ModalMotion:
    """Two vertical modes, one lateral mode and a small slide along the structure, after 0.4 s at rest."""
    return ModalMotion(_MODES, support_m=site.support_m, span_m=site.span_m)


def make_demo(
    folder: Path | str,
    *,
    seed: int = 2026,
    duration_s: float = 3.0,
    site: FootbridgeSite | None = None,
    progress: Progress | None = None,
) -> Path:
    """Writes a synthetic stereo recording as a session folder and returns its ``session.toml``.

    Parameters
    ----------
    folder
        New, empty, or an earlier demo, which is replaced. Gets ``left.mp4``, ``right.mp4``, ``session.toml`` and
        ``truth.nc``, the displacement dataset's layout, exact.
    seed
        Of textures, sensor noise and errors of the measurements on site; the same seed gives the same bytes.
    duration_s
        At 30 frames a second [s].
    site
        Places of footbridge and cameras.
    progress
        Called with the number of frames written so far and the number of all.

    Raises
    ------
    SessionError
        The recording would be too short.
    ResultsError
        The folder holds files of these names that are not an earlier demo, or cannot be written.
    VideoError
        A video cannot be written.

    Notes
    -----
    Lengths in the session are the true ones with errors as of a tape, a laser and a spirit level; focal lengths are
    off by about 1 %. The displacement in ``truth.nc`` is along the true structural axes, relative to the rest.
    """
    if not duration_s >= _SHORTEST_S:
        raise SessionError(f"duration_s: expected at least {_SHORTEST_S} s, got {duration_s}; make it longer")
    site = FootbridgeSite() if site is None else site
    target = _prepare(Path(folder))
    time_s = np.arange(round(duration_s * _FPS)) / _FPS
    motion = demo_motion(site)
    cameras = site.cameras()
    try:
        with replace_file(target / "truth.nc") as temporary:
            _truth(time_s, site, motion, seed=seed).to_netcdf(temporary, engine="h5netcdf")
    except OSError as error:
        raise ResultsError(f"{target}: expected to write truth.nc, got: {error}; choose another folder") from error
    scene = build_footbridge(site, seed=seed)
    for number, (name, camera) in enumerate(zip(_VIEWS, cameras, strict=True)):
        done = number * len(time_s)

        def report(frames: int, done: int = done) -> None:
            if progress is not None:
                progress(done + frames, len(cameras) * len(time_s))

        _write_view(target / f"{name}.mp4", scene, camera, motion, time_s, (seed, number), report)
    # Last, so that a folder whose making was cut short is no session.
    return write_session(target / "session.toml", _session(site, cameras, target, seed=seed))


def _prepare(folder: Path) -> Path:
    """The folder, made and without an earlier demo's session file."""
    present = [name for name in _FILES if (folder / name).exists()]
    if present and "truth.nc" not in present:
        raise ResultsError(f"{folder}: expected a new folder or an earlier demo, got {present}; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "session.toml").unlink(missing_ok=True)
    except OSError as error:
        raise ResultsError(f"{folder}: expected a folder to write to, got: {error}; choose another") from error
    return folder


def _truth(time_s: FloatArray, site: FootbridgeSite, motion: ModalMotion, *, seed: int) -> xr.Dataset:
    points = demo_points(site)
    rest = np.array([point.position for point in points])
    moving = ~np.array([point.static for point in points])
    displacement = modal_displacement(time_s, rest, motion=motion) * moving[:, None]
    shape = displacement.shape
    return make_displacement(
        time_s,
        [point.name for point in points],
        STRUCTURE_AXES,
        displacement_mm=1e3 * displacement,
        displacement_std_mm=np.zeros(shape),
        scale_std=np.zeros(shape[1:]),
        position_m=rest + displacement,
        reprojection_error_px=np.zeros(shape[:2]),
        status=np.full(shape[:2], Status.OK),
        attrs={
            "title": "exact displacement of a synthetic field test",
            "frame": "structure",
            "baseline_m": float(np.linalg.norm(site.second_center)),
            "seed": seed,
            "vfm_sdm_version": __version__,
        },
    )


def _write_view(
    path: Path,
    scene: Scene,
    camera: Camera,
    motion: ModalMotion,
    time_s: FloatArray,
    seed: tuple[int, int],
    report: Callable[[int], None],
) -> None:
    stations = np.linspace(motion.support_m, motion.support_m + motion.span_m, 200)
    along = np.column_stack([np.zeros((200, 2)), stations])
    largest = np.linalg.norm(modal_displacement(time_s, along, motion=motion), axis=2).max()
    renderer = Renderer(scene, camera, reach_m=1.01 * float(largest) + 1e-6)

    def frames() -> Iterator[npt.NDArray[np.uint8]]:
        for number, time in enumerate(time_s):
            luma = renderer.render(partial(_displacement_at, float(time), motion=motion))
            yield quantize(luma, noise_std=_NOISE_STD, rng=np.random.default_rng([*seed, number]))
            report(number + 1)

    write_video(path, frames(), fps=_FPS, chroma=renderer.chroma_at_rest(), options=_ENCODER)


def _displacement_at(time_s: float, positions: FloatArray, *, motion: ModalMotion) -> FloatArray:
    return np.asarray(modal_displacement([time_s], positions, motion=motion)[0])


def _session(site: FootbridgeSite, cameras: tuple[Camera, Camera], folder: Path, *, seed: int) -> Session:
    """What an engineer would have noted: every value with an error of the size of its standard deviation."""
    rng = np.random.default_rng([seed, len(_VIEWS)])

    def error(std: float) -> float:
        return std * float(np.clip(rng.standard_normal(), -2, 2))

    def tape(exact: float, std: float) -> Measured:
        return Measured(value=round(exact + error(std), 3), std=std)

    points = demo_points(site)
    ranged = points[1]
    return Session(
        name="synthetic footbridge",
        view=tuple(
            View(
                name=name,
                video=Path(f"{name}.mp4"),
                lens=Lens(
                    focal_mm=round(camera.focal_px * (1 + error(0.01)) * _SENSOR_WIDTH_MM / camera.image_size[0], 2),
                    sensor_width_mm=_SENSOR_WIDTH_MM,
                    relative_std=0.02,
                ),
            )
            for name, camera in zip(_VIEWS, cameras, strict=True)
        ),
        site=Site(
            baseline=tape(float(np.linalg.norm(site.second_center)), 0.005),
            perpendicular_distance=tape(site.perpendicular_m, 0.01),
            longitudinal_distance=tape(site.longitudinal_m, 0.02),
            reference_camera_level=Level(value_deg=round(error(0.1), 2), std_deg=0.1),
            range=(
                Range(
                    point=ranged.name,
                    value=round(float(np.linalg.norm(ranged.position)) + error(0.005), 3),
                    std=0.005,
                ),
            ),
        ),
        point=tuple(
            Point(
                name=point.name,
                view=_VIEWS[0],
                pixel=tuple(float(x) for x in np.round(cameras[0].project(point.position), 3)),
                static=point.static,
            )
            for point in points
        ),
        method=Method(subset_px=61, still_interval_s=(0.0, demo_motion(site).still_s)),
        folder=folder,
    )
