"""Cameras from hard pairs of pictures: blurred, dark, seen at a wide angle, full of what repeats.

Each pair is a first picture of two views whose cameras are known, degraded, with a session as an engineer would write
it: readings off by draws from their standard deviations, lenses known to 2 % and off by about 1 %. A pair is

- right: status `ok`, the second camera turned by at most 1 degree from its true direction (or by at most 3 and within
  three standard deviations as stated), and the scale of a vertical displacement within three of its own;
- refused: no cameras, or another status;
- WRONG: status `ok`, and not right.

Rendered bridges, and a drawn wall whose tiles are all alike; where the folder of shared data is at hand, the film of a
footbridge by another renderer and photographs of a cylinder.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vfm_sdm.core.registry import make
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Method, Session, read_session
from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.cameras.file import read_rig
from vfm_sdm.stages.cameras.site import compare_rigs
from vfm_sdm.stages.cameras.solve import solve_cameras
from vfm_sdm.stages.cameras.two_view import TwoViewCameras
from vfm_sdm.studies.synthetic.field_test import demo_plan
from vfm_sdm.studies.synthetic.film import film_view
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.plan import Preset
from vfm_sdm.studies.synthetic.presets import SURFACES, preset
from vfm_sdm.studies.synthetic.survey import make_sessions

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared" / "data"
BLUR_PX, GREY_LEVELS, DARK_NOISE = (1.0, 2.0, 3.0), (25, 10), 1.0
TURN_DEG, WIDE_TURN_DEG, WITHIN = 1.0, 3.0, 3.0
TILE_M, TILE_PX = 0.8, 160


@dataclass(frozen=True)
class Base:
    """Pictures (H, W), true cameras, and sessions by what was measured."""

    frames: dict[str, np.ndarray]
    rig: Rig
    sessions: dict[str, Session]


@dataclass(frozen=True)
class Row:
    name: str
    readings: str
    verdict: str
    status: str
    turn_deg: float
    scale: float
    scale_std: float
    cpu_s: float


def converged(plan: Preset, degrees: float) -> Preset:
    """The second camera as far from the middle as the first, at an angle to it; both look at the same place."""
    site, target = plan.site, np.array([plan.site.perpendicular_m, 0.0, plan.site.longitudinal_m])
    now = np.degrees(np.arctan2(target[0], target[2]))
    turn = degrees if now + degrees <= 95 else -degrees
    centre = target - Rotation.from_euler("y", turn, degrees=True).apply(target)
    moved = site.with_second_at(tuple(float(x) for x in centre))
    if isinstance(moved, FootbridgeSite):
        second = replace(moved.further[0], target_m=site.longitudinal_m)
        return replace(plan, site=replace(moved, further=(second,)))
    first, second, *_ = moved.tripods
    return replace(plan, site=replace(moved, tripods=(first, replace(second, target_m=site.longitudinal_m))))


def draw_wall(plan: Preset, view: int) -> np.ndarray:
    """A wall of equal tiles, each with a window, at the distance of the structure's face."""
    rng = np.random.default_rng(5)
    spectrum = np.fft.rfft2(rng.standard_normal((TILE_PX, TILE_PX)))
    frequency = np.hypot(np.fft.rfftfreq(TILE_PX)[None], np.fft.fftfreq(TILE_PX)[:, None])
    tile = np.fft.irfft2(spectrum * (frequency < 0.2) / np.maximum(frequency, 0.02))
    tile = 130 + 14 * tile / tile.std()
    tile[40:120, 50:110] -= 60
    camera = plan.site.cameras()[view]
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    rays = np.column_stack([camera.normalize(pixels), np.ones(len(pixels))]) @ camera.rotation
    depth = (plan.site.perpendicular_m - camera.center[0]) / rays[:, 0]
    places = (camera.center + rays * depth[:, None])[:, [2, 1]] / TILE_M * TILE_PX % TILE_PX
    places = (places.reshape(height, width, 2) + 1).astype(np.float32)
    tiled = np.pad(tile, 1, mode="wrap").astype(np.float32)
    luma = cv2.remap(tiled, places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    noise = np.random.default_rng(view).normal(0, 1, luma.shape)
    return np.clip(np.rint(luma + noise), 16, 235).astype(np.uint8)


def make_rendered(name: str, degrees: float | None, width: int) -> Base:
    plan = demo_plan() if name in ("demo", "wall") else preset(name, "small")
    plan = replace(plan, site=replace(plan.site, image_size=(width, width * 9 // 16)))
    plan = plan if degrees is None else converged(plan, degrees)
    if name == "wall":
        frames = [draw_wall(plan, view) for view in range(2)]
    else:
        scene = plan.site.scene(seed=plan.seed)
        frames = [next(film_view(plan, scene, view)[0]) for view in range(2)]
    rig = Rig.from_world(plan.views, plan.site.cameras(), metric=True)
    return Base(dict(zip(plan.views, frames, strict=True)), rig, list_sessions(make_sessions(plan, Path())))


def list_sessions(files: dict[str, Session]) -> dict[str, Session]:
    full = files["session.toml"]
    distances = {"perpendicular_distance": None, "longitudinal_distance": None}
    bare = full.model_copy(update={"site": full.site.model_copy(update=distances)})
    return {"face": full, "baseline": bare, "further": files.get("session_further.toml", full)}


def make_footbridge() -> Base:
    folder = SHARED / "rendered_footbridge"
    session = read_session(folder / "session.toml")
    frames = {view.name: open_video(session.resolve(view.video)).first_frame().luma.copy() for view in session.view}
    return Base(frames, read_rig(folder / "cameras_true.toml"), list_sessions({"session.toml": session}))


def make_cylinder() -> Base:
    sys.path.insert(0, str(ROOT / "tests"))
    from multidic import VIEWS, rig_from_control_points

    folder = SHARED / "multidic_cylinder"
    files = {name: sorted((folder / "speckled").glob(f"{name}_*.jpg"))[0] for name in VIEWS}
    frames = {name: cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for name, file in files.items()}
    rig = rig_from_control_points(folder)
    views = [
        {"name": n, "images": f"speckled/{n}_*.jpg", "fps": 1.0, "lens": {"focal_px": f, "relative_std": 0.02}}
        for n, f in zip(VIEWS, (1.01 * rig.cameras[0].focal_px, 0.99 * rig.cameras[1].focal_px), strict=True)
    ]
    point = {"name": "p", "view": VIEWS[0], "pixel": [1290.0, 1640.0]}
    site = {"baseline": {"value": rig.baseline() + 0.0003, "std": 0.0005}}
    session = Session(name="cylinder", folder=folder, view=views, site=site, point=[point])
    return Base(frames, rig, {"baseline": session})


def blurred(luma: np.ndarray, sigma_px: float, seed: int) -> np.ndarray:
    soft = cv2.GaussianBlur(luma.astype(np.float32), (0, 0), sigma_px)
    return finish(soft, seed)


def darkened(luma: np.ndarray, levels: int, seed: int) -> np.ndarray:
    """Contrast from the 5th to the 95th percentile reduced to some grey levels, with noise of one."""
    low, high = np.percentile(luma, [5, 95])
    return finish(16 + (luma - low) * levels / max(high - low, 1), seed)


def finish(luma: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, DARK_NOISE, luma.shape)
    return np.clip(np.rint(luma + noise), 0, 255).astype(np.uint8)


DEGRADED: dict[str, Callable[[np.ndarray, int], np.ndarray] | None] = {"as it is": None}
DEGRADED |= {f"blur {s:g} px": lambda luma, seed, s=s: blurred(luma, s, seed) for s in BLUR_PX}
DEGRADED |= {f"dark {n}": lambda luma, seed, n=n: darkened(luma, n, seed) for n in GREY_LEVELS}


def list_pairs(width: int) -> list[tuple[str, Callable[[], Base], str, str]]:
    """Name, what makes the pictures, degradation and readings of each pair."""
    pairs = []
    for name in ("data-1", "data-4", *SURFACES, "demo"):
        make = partial(make_rendered, name, None, width)
        pairs += [(name, make, how, "face") for how in ("as it is", "blur 2 px", "dark 10")]
        pairs += [(name, make, how, "baseline") for how in ("as it is", "blur 1 px", "dark 25")]
        if name in SURFACES:
            pairs += [(name, make, how, "further") for how in ("as it is", "blur 3 px")]
    for name in ("data-4", "surface-2", "demo"):
        for degrees in (30.0, 45.0):
            make = partial(make_rendered, name, degrees, width)
            pairs += [(f"{name}, {degrees:g} deg", make, "as it is", readings) for readings in ("face", "baseline")]
    for readings in ("face", "baseline"):
        pairs += [
            ("wall", partial(make_rendered, "wall", None, width), how, readings) for how in ("as it is", "dark 25")
        ]
    if (SHARED / "rendered_footbridge").is_dir():
        pairs += [
            ("footbridge", make_footbridge, how, "face") for how in ("as it is", "blur 1 px", "blur 2 px", "dark 25")
        ]
        pairs += [("footbridge", make_footbridge, "as it is", "baseline")]
    if (SHARED / "multidic_cylinder").is_dir():
        pairs += [("cylinder", make_cylinder, how, "baseline") for how in ("as it is", "blur 3 px", "dark 10")]
    return pairs


def scale_of(rig: Rig, pixels: np.ndarray) -> float:
    """Distance in space of two places from their pixels, shape (2 views, 2 places, 2), over 10 mm."""
    ends = triangulate(pixels, rig)
    return float(np.linalg.norm(ends[1] - ends[0]) / 0.01)


def judge_scale(rig: Rig, truth: Rig) -> tuple[float, float]:
    """Scale of a vertical displacement where the true optical axes meet, and its standard deviation as stated [1]."""
    centres = np.array([[(c.image_size[0] - 1) / 2, (c.image_size[1] - 1) / 2] for c in truth.cameras])
    place = triangulate(centres, truth)
    ends = place + np.array([[0, -0.005, 0], [0, 0.005, 0]])
    pixels = np.stack([camera.project(ends) for camera in truth.cameras])
    if rig.covariance is None:
        return scale_of(rig, pixels), 0.0
    std = np.sqrt(np.diag(rig.covariance))
    steps = 1e-3 * np.diag(std)[std > 0]
    slopes = [(scale_of(rig.perturbed(s), pixels) - scale_of(rig.perturbed(-s), pixels)) / 2e-3 for s in steps]
    slope = np.zeros(len(std))
    slope[std > 0] = np.array(slopes) / std[std > 0]
    return scale_of(rig, pixels), float(np.sqrt(slope @ rig.covariance @ slope))


def measure(name: str, base: Base, how: str, readings: str, cameras: TwoViewCameras) -> Row:
    degrade = DEGRADED[how]
    frames = {
        view: luma if degrade is None else degrade(luma, number)
        for number, (view, luma) in enumerate(base.frames.items())
    }
    start = time.process_time()
    found = solve_cameras(base.sessions[readings], frames, cameras)
    cpu_s = time.process_time() - start
    if found.rig is None:
        return Row(f"{name}, {how}", readings, "refused", found.status, np.nan, np.nan, np.nan, cpu_s)
    away = compare_rigs(found.rig, base.rig)[14:17]
    covariance = found.rig.covariance[14:17, 14:17]
    turn = float(np.degrees(np.linalg.norm(away)))
    inside = bool(away @ np.linalg.pinv(covariance) @ away <= chi2.ppf(0.9973, 3))
    scale, scale_std = judge_scale(found.rig, base.rig)
    right = turn <= TURN_DEG or (turn <= WIDE_TURN_DEG and inside)
    right = right and abs(scale - 1) <= WITHIN * scale_std
    verdict = "refused" if found.status != "ok" else "right" if right else "WRONG"
    return Row(f"{name}, {how}", readings, verdict, found.status, turn, scale, scale_std, cpu_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=1280, help="of rendered pictures [px]")
    parser.add_argument("--only", nargs="+", default=[""], help="beginnings of the names of pairs")
    parser.add_argument("--most", type=int, default=None, help="number of pairs")
    parser.add_argument("--matching", default="sift", help="who matches features, as in a session")
    options = parser.parse_args()
    cameras = make("cameras", Method(matching=options.matching))
    pairs = [one for one in list_pairs(options.width) if f"{one[0]}, {one[2]}".startswith(tuple(options.only))]
    print(f"{'pair':30s}  {'readings':8s}  {'verdict':8s}  {'turned [deg]':>12s}  {'scale':>7s}  {'its std':>7s}  "
          f"{'CPU [s]':>7s}  status")  # fmt: skip
    bases, rows = lru_cache(maxsize=1)(lambda made: made()), []
    makes: dict[str, Callable[[], Base]] = {}
    for name, made, how, readings in pairs[: options.most]:
        # One object for each scene, so that its pictures are made once.
        base = bases(makes.setdefault(name, made))
        row = measure(name, base, how, readings, cameras)
        rows.append(row)
        print(f"{row.name:30s}  {row.readings:8s}  {row.verdict:8s}  {row.turn_deg:12.2f}  {row.scale:7.3f}  "
              f"{row.scale_std:7.3f}  {row.cpu_s:7.1f}  {row.status}", flush=True)  # fmt: skip
    count = {verdict: sum(row.verdict == verdict for row in rows) for verdict in ("right", "refused", "WRONG")}
    print(f"\n{len(rows)} pairs: {count['right']} right, {count['refused']} refused, {count['WRONG']} WRONG")
    share = {f"{verdict.lower()}_share": number / len(rows) for verdict, number in count.items()}
    cpu = {"cpu_mean_s": float(np.mean([r.cpu_s for r in rows])), "cpu_largest_s": max(r.cpu_s for r in rows)}
    print(json.dumps({"pairs": len(rows), **share, **cpu, "processors": os.cpu_count()}))


if __name__ == "__main__":
    main()
