"""Small films of a moving surface with a still one beside it, and faults that lie in the pixels.

Two known cameras; the truth is exact. Everything from the choice of subsets to the audit is the project's own.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import xarray as xr

from measurements import points_dataset
from moving_frames import memory_video
from simulation import intrinsics, looking_at, project_all
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.subset_design import design_subsets
from vfm_sdm.stages.tracking.views import track_views

__all__ = ["FILM_FAULTS", "Film", "film_measurement"]

SIZE, DEPTH, FPS, FRAMES = (480, 260), 10.0, 30.0, 90
STILL_S = 0.5
SUBSET_PX = 41
MOVING = {"a": (-1.2, -0.1), "b": (0.3, 0.25)}
STATIC = {"s": (2.0, -0.4), "t": (2.2, 0.5)}
"""Places on the face [m], X to the right and Y down."""
NOISE = 1.0
_EDGE_M = 1.3
"""Where the still surface begins."""
_FINE = 4
"""Samples of a surface in a pixel, along each side: cubic interpolation then errs by less than a thousandth of one."""
_PX_M = 0.0125
_WIDE_M, _HIGH_M = 4.2, 2.4
_NORMAL = np.array([-0.2, 0.0, 1.0])

Picture = np.ndarray
Spoil = Callable[[dict[str, Picture], "Film", np.random.Generator], None]


@dataclass(frozen=True, eq=False)
class Film:
    """Two cameras, the true motion (T, 3) [mm] of the moving surface and the places of all points (P, 3) [m]."""

    rig: Rig
    motion_mm: FloatArray
    places: FloatArray

    def pixels(self, view: str) -> FloatArray:
        """Where a view sees the first moving point in every frame, shape (T, 2) [px]."""
        return self.rig.cameras[self.rig.names.index(view)].project(self.places[0] + self.motion_mm / 1e3)


def make_film(rng: np.random.Generator) -> Film:
    turn = np.radians(20.0)
    target = np.array([0.0, 0.0, DEPTH])
    centers = [np.zeros(3), target + DEPTH * np.array([np.sin(turn), 0.0, -np.cos(turn)])]
    cameras = [Camera(intrinsics(800.0, SIZE), SIZE, cam_from_world=looking_at(c, target)) for c in centers]
    inner, pose = [1e-3, 0.15, 0.15, 1e-3], [1e-4] * 3 + [2e-3] * 3
    std = np.concatenate([inner, [0.0] * 6, inner, pose])
    rig = Rig.from_world(("left", "right"), cameras, metric=True)
    rig = Rig(rig.names, rig.cameras, rig.metric, np.diag(std**2))
    time_s = np.arange(FRAMES) / FPS
    begun = np.clip((time_s - STILL_S) / 0.4, 0, 1) ** 2
    hertz, phase = rng.uniform(1.2, 2.6, 3), rng.uniform(0, 2 * np.pi, 3)
    wave = np.sin(2 * np.pi * hertz * (time_s - STILL_S)[:, None] + phase)
    motion_mm = begun[:, None] * wave * rng.uniform(8, 16) * [0.8, 1.0, 0.1]
    flat = np.array([*MOVING.values(), *STATIC.values()])
    places = np.column_stack([flat, DEPTH + 0.2 * flat[:, 0]])
    return Film(rig, motion_mm, places)


def surface(rng: np.random.Generator, contrast: float) -> Picture:
    """A random surface, `_FINE` samples a pixel, mean 128 grey levels."""
    shape = tuple(round(side / _PX_M * _FINE) for side in (_HIGH_M, _WIDE_M))
    rough = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), 1.5 * _FINE)
    return 128 + contrast * rough / rough.std()


def look(surface_: Picture, camera: Camera, displacement_m: FloatArray) -> tuple[Picture, FloatArray]:
    """A surface on the displaced plane as a camera sees it, shape (H, W), and X of the plane at every pixel [m]."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    rays = np.concatenate([camera.normalize(np.stack([u, v], axis=-1)), np.ones((*u.shape, 1))], axis=-1)
    rays = rays @ camera.rotation
    anchor = np.array([0.0, 0.0, DEPTH]) + displacement_m
    distance = ((anchor - camera.center) @ _NORMAL) / (rays @ _NORMAL)
    X = camera.center + distance[..., None] * rays - displacement_m
    columns = (X[..., 0] / _PX_M * _FINE + surface_.shape[1] / 2).astype(np.float32)
    rows = (X[..., 1] / _PX_M * _FINE + surface_.shape[0] / 2).astype(np.float32)
    return cv2.remap(surface_, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), X[..., 0]


def shoot(film: Film, front: Picture, behind: Picture) -> dict[str, Picture]:
    """Grey levels of every view, without noise, shape (T, H, W)."""
    stacks = {}
    for view, camera in zip(film.rig.names, film.rig.cameras, strict=True):
        still, X = look(behind, camera, np.zeros(3))
        beside = X > _EDGE_M
        moved = [look(front, camera, d / 1e3)[0] for d in film.motion_mm]
        stacks[view] = np.stack([np.where(beside, still, one) for one in moved])
    return stacks


def film_measurement(seed: int, fault: str = "") -> tuple[Measurement, Film]:
    """The measurement of a film, with one of `FILM_FAULTS` or none."""
    rng = np.random.default_rng([seed, 5])
    film = make_film(rng)
    front, behind = surface(rng, rng.uniform(15, 40)), surface(rng, 30.0)
    if fault == "a look-alike after a loss":
        _draw_dots(front, rng)
    stacks = shoot(film, front, behind)
    if fault:
        FILM_FAULTS[fault](stacks, film, rng)
    noisy = {view: np.rint(stack + rng.normal(0, NOISE, stack.shape)) for view, stack in stacks.items()}
    seen = {view: np.clip(stack, 0, 255).astype(np.uint8) for view, stack in noisy.items()}
    return _measure(film, _calibrated(film.rig, rng), seen), film


def _calibrated(rig: Rig, rng: np.random.Generator) -> Rig:
    """The cameras as a calibration of the stated uncertainty gives them."""
    std = np.sqrt(np.diag(np.asarray(rig.covariance))).reshape(len(rig), -1)
    cameras = [camera.perturbed(rng.normal(0, 1, one.size) * one) for camera, one in zip(rig.cameras, std, strict=True)]
    return Rig(rig.names, tuple(cameras), rig.metric, rig.covariance)


def _measure(film: Film, rig: Rig, stacks: dict[str, Picture]) -> Measurement:
    names = [*MOVING, *STATIC]
    pixels = project_all(film.rig, film.places)
    points = points_dataset({name: pixels[:, number] for number, name in enumerate(names)})
    session = Session(
        name="film",
        view=[
            {
                "name": view,
                "video": f"{view}.mp4",
                "camera": "rig.toml",
                "time_offset_s": 0.0,
                "time_offset_std_s": 1e-4,
            }
            for view in film.rig.names
        ],
        point=[
            {
                "name": name,
                "view": film.rig.names[0],
                "pixel": [float(x) for x in pixels[0, n]],
                "static": name in STATIC,
            }
            for n, name in enumerate(names)
        ],
        method={
            "cameras": "file",
            "subset_px": SUBSET_PX,
            "still_interval_s": (0.0, STILL_S),
            "synchronization": "none",
        },
    )
    covariance = np.pad(np.asarray(rig.covariance), (0, 3))
    solution = CameraSolution(rig, None, covariance, points)
    videos = {view: memory_video(stack, fps=FPS) for view, stack in stacks.items()}
    subsets = {}
    for number, (view, video) in enumerate(videos.items()):
        chosen = design_subsets(video, pixels[number], names, subset_px=SUBSET_PX)
        subsets[view] = dict(zip(names, chosen, strict=True))
    tracks = track_views(videos, points, IcgnTracker(), subsets=subsets)
    frames = {view: stack[0] for view, stack in stacks.items()}
    return Measurement(session).given(cameras=solution, tracks=tracks, frames=frames)


def film_errors(measurement: Measurement, film: Film) -> xr.DataArray:
    """Displacement less the truth of the moving points along the first two axes [mm]."""
    shown = measurement.displacement["displacement"]
    chosen = shown.sel(point=list(MOVING)).isel(axis=[0, 1])
    turned = film.motion_mm @ _axes(chosen)
    origin = turned[np.arange(FRAMES) / FPS <= STILL_S].mean(axis=0)
    return chosen - (turned - origin)[: chosen.sizes["time"], None, :]


def _axes(chosen: xr.DataArray) -> FloatArray:
    """Axes of displacement in the world, as columns, shape (3, 2)."""
    return np.eye(3)[:, : chosen.sizes["axis"]]


def _draw_dots(front: Picture, rng: np.random.Generator) -> None:
    """Equal dots on white squares at an even pitch, the first one at the first point."""
    pitch = rng.uniform(26, 40) * _FINE
    rows, columns = (side / 2 for side in front.shape)
    u = columns + MOVING["a"][0] / _PX_M * _FINE
    v = rows + MOVING["a"][1] / _PX_M * _FINE
    for number in range(4):
        middle = (round(u + number * pitch), round(v))
        half = round(0.45 * pitch)
        corners = (middle[0] - half, middle[1] - 2 * half), (middle[0] + half, middle[1] + 2 * half)
        cv2.rectangle(front, *corners, 200, -1)
        cv2.circle(front, middle, round(0.25 * pitch), 60, -1)
    front[:] = cv2.GaussianBlur(front, (0, 0), 0.8 * _FINE)


def _hide(stacks: dict[str, Picture], film: Film, rng: np.random.Generator) -> None:
    """Something is held before the first dot for a while, in one view."""
    view = film.rig.names[int(rng.integers(2))]
    first = int(rng.integers(25, 40))
    for k in range(first, first + int(rng.integers(5, 30))):
        u, v = np.rint(film.pixels(view)[k]).astype(int)
        stacks[view][k, max(v - 45, 0) : v + 45, max(u - 30, 0) : u + 18] = 110


def _shadow(stacks: dict[str, Picture], film: Film, rng: np.random.Generator) -> None:
    """A shadow's edge, soft or sharp, sways over the first point in both views."""
    depth, soft, sway = rng.uniform(0.3, 0.6), np.exp(rng.uniform(np.log(1.0), np.log(12.0))), rng.uniform(2, 8)
    hertz, phase = rng.uniform(0.5, 1.2), rng.uniform(0, 2 * np.pi)
    side = rng.choice([-1, 1])
    for view, stack in stacks.items():
        middle = film.pixels(view)[0, 1]
        for k in range(len(stack)):
            edge = middle + sway * np.sin(2 * np.pi * hertz * k / FPS + phase)
            away = side * (np.arange(SIZE[1]) - edge) / soft
            stack[k] *= (1 - depth / (1 + np.exp(np.clip(away, -50, 50))))[:, None]


def _band(stacks: dict[str, Picture], film: Film, rng: np.random.Generator) -> None:
    """A still band (cable, hand rail, background) over a tenth to nearly a half of the first point's square."""
    share, edge = rng.uniform(0.08, 0.45), int(rng.integers(4))
    wide = round(share * SUBSET_PX)
    length = 140
    rough = cv2.GaussianBlur(rng.standard_normal((wide, length)).astype(np.float32), (0, 0), 1.5)
    band = 128 + rng.uniform(5, 40) * rough / rough.std()
    half = SUBSET_PX // 2 + 1
    for view, stack in stacks.items():
        u, v = np.rint(film.pixels(view)[0]).astype(int)
        along = slice(0, length)
        if edge < 2:
            rows = slice(v + half - wide, v + half) if edge == 0 else slice(v - half + 1, v - half + 1 + wide)
            columns = slice(max(u - length // 2, 0), u + length // 2)
            stack[:, rows, columns] = band[:, -(columns.stop - columns.start) :]
        else:
            columns = slice(u + half - wide, u + half) if edge == 2 else slice(u - half + 1, u - half + 1 + wide)
            rows = slice(max(v - length // 2, 0), v + length // 2)
            stack[:, rows, columns] = band.T[along][-(rows.stop - rows.start) :]


FILM_FAULTS: dict[str, Spoil] = {
    "a look-alike after a loss": _hide,
    "a moving shadow": _shadow,
    "a still band": _band,
}
"""By fault: what puts it into the pictures."""
