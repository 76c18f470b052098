"""The lens from a pan clip: errors and intervals of the focal length over many drawn clips.

Lenses of 14, 40 and 65 degrees turn before a distant scene (300 to 3000 m) and before a near one (12 to 60 m, the lens
8 cm beside the point of rotation), with a rolling shutter of 20 ms. Sightings are simulated (`tests/turning.py`), and
with ``--rendered`` clips are rendered, compressed and looked at as a whole, with levers of 0 to 10 cm. Coverage is the
share of draws whose focal length lies inside its 95 % interval.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from turning import draw_lever, draw_plan, look, true_values  # noqa: E402
from vfm_sdm.core.statuses import LensStatus  # noqa: E402
from vfm_sdm.core.threads import small_algebra  # noqa: E402
from vfm_sdm.inputs.video import open_video  # noqa: E402
from vfm_sdm.stages.lens.adjustment import adjust_clip  # noqa: E402
from vfm_sdm.stages.lens.clip import estimate_lens  # noqa: E402
from vfm_sdm.stages.lens.scene import PanScene  # noqa: E402
from vfm_sdm.studies.synthetic.pan_clip import write_pan_clip  # noqa: E402

VIEWS_DEG = (14, 40, 65)
SCENES = {"distant": (300.0, 3000.0), "near": (12.0, 60.0)}
LEVER_M, MOST_LEVER_M, READOUT_S, NORMAL_95 = 0.08, 0.1, 0.02, 1.96
RENDERED_SIZE, RENDERED_FPS = (960, 540), 30


def simulated(seed: int, view_deg: int, scene: str) -> tuple[float, float]:
    """Error of the logarithm of the focal length and its standard deviation [1]."""
    lever = draw_lever(seed, 0.0 if scene == "distant" else LEVER_M)
    plan = draw_plan(seed, view_deg, distance_m=SCENES[scene], lever_m=lever, readout_s=READOUT_S)
    adjusted = adjust_clip(*look(plan))
    return float(adjusted.lens[0] - true_values(plan)[0]), float(np.sqrt(adjusted.covariance[0, 0]))


def rendered(seed: int, view_deg: int, scene: str) -> tuple[float, float] | None:
    """The same of a rendered clip; ``None`` where it gives no lens."""
    rng = np.random.default_rng((seed, 12))
    lever = draw_lever(seed, rng.uniform(0, MOST_LEVER_M))
    plan = draw_plan(
        seed, view_deg, size=RENDERED_SIZE, fps=RENDERED_FPS, distance_m=SCENES[scene], lever_m=lever,
        readout_s=rng.uniform(0, READOUT_S), exposure_s=0.002,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = write_pan_clip(Path(folder, "pan.mp4"), plan)
        estimate = estimate_lens(open_video(path), PanScene(*plan.distance_m))
    if estimate.status != LensStatus.OK or estimate.camera is None:
        print(f"{view_deg} {scene} seed {seed}: {estimate.status}: {'; '.join(estimate.notes)}", flush=True)
        return None
    return float(np.log(estimate.camera.focal_px / plan.camera.focal_px)), estimate.focal_std


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20, help="simulated clips of each class")
    parser.add_argument("--rendered", type=int, default=0, help="rendered clips of each class")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--views", type=int, nargs="+", default=VIEWS_DEG)
    parser.add_argument("--scenes", nargs="+", default=tuple(SCENES))
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    print(f"{'clips':26s}  {'draws':>5s}  {'median std':>10s}  {'rms error':>10s}  {'coverage':>8s}  {'cpu [s]':>7s}")
    summary: dict[str, object] = {"draws": options.draws, "clips": options.rendered, "processors": os.cpu_count()}
    for kind, clip, count in (("simulated", simulated, options.draws), ("rendered", rendered, options.rendered)):
        for view_deg in options.views if count else ():
            for scene in options.scenes:
                found, begin = [], time.process_time()
                for seed in range(options.first, options.first + count):
                    with small_algebra():
                        one = clip(seed, view_deg, scene)
                    if one is not None:
                        found.append(one)
                    if options.verbose and one is not None:
                        print(f"  {kind} {view_deg} {scene} {seed}: {one[0]:+.4%} +- {one[1]:.4%}", flush=True)
                cpu_s = (time.process_time() - begin) / count
                if not found:
                    continue
                error, std = np.array(found).T
                row = (np.median(std), np.sqrt(np.mean(error**2)), np.mean(np.abs(error) <= NORMAL_95 * std))
                name = f"{kind}, {view_deg} deg, {scene}"
                print(
                    f"{name:26s}  {len(found):5d}  {row[0]:10.3%}  {row[1]:10.3%}  {row[2]:8.3f}  {cpu_s:7.1f}",
                    flush=True,
                )
                key = f"{kind}_{view_deg}deg_{scene}"
                summary[key] = {
                    "focal_std_share": float(row[0]), "focal_rms_share": float(row[1]),
                    "coverage_share": float(row[2]), "cpu_mean_s": cpu_s,
                }  # fmt: skip
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
