"""A 4K 60 fps H.264 stereo pair as two action cameras write it, made quickly, for timing the whole way.

One still a view is rendered; around each of four points a patch then goes up and down by spline interpolation, in
phases that repeat, and sensor noise is added. Cheap, and exact only at the points: made for measuring time, not error.

    python benchmarks/make_4k_pair.py FOLDER [--frames 120]
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import shift as spline_shift

from vfm_sdm.session import Lens, Level, Measured, Method, Point, Range, Session, Site, View, write_session
from vfm_sdm.synthetic.field_test import demo_points
from vfm_sdm.synthetic.footbridge import FootbridgeSite, build_footbridge
from vfm_sdm.synthetic.recording import write_video
from vfm_sdm.synthetic.render import Renderer, quantize

VIEWS = ("left", "right")
STILL_S = 0.2
FREQUENCY_HZ = 2.0
AMPLITUDE_M = 0.004
NOISE_STD = 1.5
NOISE_FIELDS = 4
PATCH_PX = 256
"""Half the side of a moving patch."""
ENCODER = {"preset": "ultrafast", "b": "80M", "maxrate": "100M", "bufsize": "80M", "g": "30"}


def site_of(size: tuple[int, int]) -> FootbridgeSite:
    """The demo's footbridge through lenses without distortion."""
    return FootbridgeSite(image_size=size, k1=(0.0, 0.0))


def moving_points(site: FootbridgeSite) -> list:
    return [point for point in demo_points(site) if not point.static]


def still(view: int, size: tuple[int, int], seed: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Luma and chroma of one view at rest."""
    # Textures as fine as half the width can show: sharper than most action cameras, and quicker to make.
    scene = build_footbridge(site_of((size[0] // 2, size[1] // 2)), seed=seed)
    renderer = Renderer(scene, site_of(size).cameras()[view], reach_m=0.0)
    return quantize(renderer.luma_at_rest), renderer.chroma_at_rest()


def patches(luma: npt.NDArray[np.uint8], view: int, size: tuple[int, int], phases: int) -> list[list[tuple]]:
    """For each phase, each point's window and what is seen in it."""
    site = site_of(size)
    camera = site.cameras()[view]
    result: list[list[tuple]] = [[] for _ in range(phases)]
    for point in moving_points(site):
        rest = np.array(point.position)
        u, v = np.rint(camera.project(rest)).astype(int)
        half = min(PATCH_PX, u, v, size[0] - 1 - u, size[1] - 1 - v)
        window = (slice(v - half, v + half + 1), slice(u - half, u + half + 1))
        ground = luma[window].astype(np.float32)
        distance = np.abs(np.arange(-half, half + 1)) / half
        ramp = np.clip(2.0 - 2.0 * distance, 0, 1).astype(np.float32)
        weight = np.outer(ramp, ramp)
        for phase in range(phases):
            moved = rest + [0, AMPLITUDE_M * np.sin(2 * np.pi * phase / phases), 0]
            du, dv = camera.project(moved) - camera.project(rest)
            shifted = spline_shift(ground, (dv, du), order=3, mode="nearest")
            seen = ground + weight * (shifted - ground)
            result[phase].append((window, np.clip(np.rint(seen), 16, 235).astype(np.uint8)))
    return result


def frames_of(view: int, luma: npt.NDArray, size: tuple[int, int], fps: int, frames: int, seed: int) -> Iterator:
    phases = round(fps / FREQUENCY_HZ)
    moving = patches(luma, view, size, phases)
    rng = np.random.default_rng([seed, view])
    noise = [
        np.rint(NOISE_STD * rng.standard_normal(luma.shape, dtype=np.float32)).astype(np.int8)
        for _ in range(NOISE_FIELDS)
    ]
    start = round(STILL_S * fps)
    for number in range(frames):
        frame = luma.copy()
        for window, seen in moving[max(number - start, 0) % phases]:
            frame[window] = seen
        field = np.roll(noise[number % NOISE_FIELDS], int(rng.integers(luma.shape[0])), axis=0)
        noisy = np.add(frame, field, dtype=np.int16)
        yield np.clip(noisy, 16, 235, out=noisy).astype(np.uint8)


def write_test_video(
    path: Path | str,
    *,
    size: tuple[int, int] = (3840, 2160),
    fps: int = 60,
    frames: int = 120,
    seed: int = 1,
    view: int = 0,
) -> Path:
    """One view of the pair; ``view`` is 0 for the left, 1 for the right camera."""
    luma, chroma = still(view, size, seed)
    return write_video(path, frames_of(view, luma, size, fps, frames, seed), fps=fps, chroma=chroma, options=ENCODER)


def make_pair(
    folder: Path | str, *, size: tuple[int, int] = (3840, 2160), fps: int = 60, frames: int = 120, seed: int = 1
) -> Path:
    """Both views and their ``session.toml`` with four points; returns the session's path."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(VIEWS):
        write_test_video(target / f"{name}.mp4", size=size, fps=fps, frames=frames, seed=seed, view=number)
    return write_session(target / "session.toml", session_of(target, size))


def session_of(folder: Path, size: tuple[int, int]) -> Session:
    site = site_of(size)
    cameras = site.cameras()
    points = moving_points(site)
    return Session(
        name="4K pair for timing",
        folder=folder,
        view=[
            View(name=name, video=Path(f"{name}.mp4"), lens=Lens(focal_px=camera.focal_px, relative_std=0.02))
            for name, camera in zip(VIEWS, cameras, strict=True)
        ],
        site=Site(
            baseline=Measured(value=float(np.linalg.norm(site.second_center)), std=0.005),
            perpendicular_distance=Measured(value=site.perpendicular_m, std=0.01),
            longitudinal_distance=Measured(value=site.longitudinal_m, std=0.02),
            reference_camera_level=Level(std_deg=0.1),
            range=(Range(point=points[1].name, value=float(np.linalg.norm(points[1].position)), std=0.005),),
        ),
        point=[
            Point(name=p.name, view=VIEWS[0], pixel=tuple(map(float, cameras[0].project(p.position)))) for p in points
        ],
        method=Method(still_interval_s=(0.0, STILL_S)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    start = time.perf_counter()
    session = make_pair(arguments.folder, frames=arguments.frames, seed=arguments.seed)
    taken_s = time.perf_counter() - start
    megabytes = [(arguments.folder / f"{name}.mp4").stat().st_size / 1e6 for name in VIEWS]
    print(f"{session}: {arguments.frames} frames a view in {taken_s:.1f} s")
    for name, size in zip(VIEWS, megabytes, strict=True):
        print(f"  {name:6s} {size:8.1f} MB  {size * 8 * 60 / arguments.frames:6.1f} Mbit/s")
    print(json.dumps({"made_s": round(taken_s, 2), "frames": arguments.frames, "megabytes": megabytes}))


if __name__ == "__main__":
    main()
