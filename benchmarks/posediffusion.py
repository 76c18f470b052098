"""Time and memory of PoseDiffusion's cameras of two frames, with and without matches that guide it, on a processor.

Random weights of the published size: time and memory do not depend on their values, except that unguided chains of
random weights may run away. Matches come from two true cameras, to which the descent starts near.

    python benchmarks/posediffusion.py [--iterations 100] [--matches 500]
"""

import argparse
import json
import resource
import sys
import time

import numpy as np
import torch

from vfm_sdm.networks.posediffusion.guidance import GUIDED_STEPS, PASSES, Guide, ImageMatches
from vfm_sdm.networks.posediffusion.model import PoseDiffusion
from vfm_sdm.networks.posediffusion.pose import decode_pose


def make_scene(matches: int) -> tuple[torch.Tensor, ImageMatches]:
    """Pose vectors of two cameras, a little off, and points that both see [px]."""
    rng = np.random.default_rng(0)
    turned = [0.0, 0.1, 0.0]
    poses = torch.tensor([[0, 0, 0, 1, 0, 0, 0, -0.6, -0.6], [0.3, 0, 0, 1, *turned, -0.6, -0.6]], dtype=torch.float32)
    rotation, translation, focal = decode_pose(poses)
    points = torch.tensor(rng.uniform([-0.2, -0.2, 3], [0.2, 0.2, 5], (matches, 3)), dtype=torch.float32)
    seen = points @ rotation.mT + translation[:, None]
    pixels = seen[..., :2] / seen[..., 2:] * focal[:, None] * 112 + 112
    off = torch.tensor(rng.normal(0, 1e-3, (2, 9)), dtype=torch.float32)
    return poses + off, ImageMatches(pixels[0], pixels[1], torch.tensor([[0, 1]]).expand(matches, 2))


def main() -> None:
    """The table, and its figures as one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=100, help="iterations of a pass; published: 100")
    parser.add_argument("--matches", type=int, default=500)
    wanted = parser.parse_args()
    torch.manual_seed(0)
    network = PoseDiffusion().eval().requires_grad_(False)
    near, matches = make_scene(wanted.matches)
    guide, seconds = Guide(matches, iterations=wanted.iterations), {}
    with torch.inference_mode():
        begin = time.perf_counter()
        network.sample(torch.rand(2, 3, 224, 224), torch.randn(100, 2, 9))
        seconds["unguided_2_frames_s"] = time.perf_counter() - begin
        begin = time.perf_counter()
        for _ in range(GUIDED_STEPS):
            guide.refine(near)
        guidance = time.perf_counter() - begin
    count = GUIDED_STEPS * wanted.iterations * sum(times for _, times in PASSES)
    seconds["guided_2_frames_s"] = seconds["unguided_2_frames_s"] + guidance
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9
    print(f"PoseDiffusion, published size, two frames, {torch.get_num_threads()} CPU thread(s)")
    print(f"{'':24} {'time, s':>8}")
    for name, value in seconds.items():
        print(f"{name.split('_')[0]:24} {value:8.2f}")
    print(f"{'an iteration':24} {guidance / count:8.4f}")
    print(f"{count} iterations on {wanted.matches} matches, {1e3 * guidance / count:.2f} ms each; peak {peak:.2f} GB")
    figures = {
        **{name: round(value, 3) for name, value in seconds.items()},
        "iteration_ms": round(1e3 * guidance / count, 3),
        "iterations": count,
        "matches": wanted.matches,
        "peak_memory_gb": round(peak, 3),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
