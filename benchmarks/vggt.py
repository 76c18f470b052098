"""VGGT at its real size with random weights: time and memory of cameras and tracks, beside what the device could do.

Cameras of two frames, and 480 frames tracked with one and with six points in one patch, by the way that the tracker
takes (`ChunkStitcher`, `VggtInference`, its presets). The floor is the number of operations of all matrix products and
convolutions, by the formulas of `vggt_costs`, over the rate that the device reaches in one large matrix product.

The baseline is the same tracking without what makes it small and quick: float32, every layer kept, whole correlation
volumes, position embeddings made anew, one pass through the backbone a point, chunks as they are, PyTorch's own choice
of attention. It is timed on fewer frames and extrapolated by operations where `--baseline-frames` says so.

On a CPU a narrower, shallower network, smaller patches and a quarter of the frames are measured, and the summary says
``reduced``. Memory is what PyTorch had allocated at most on a GPU, weights included, and the largest resident size of
the whole process so far on a CPU. Modelled memory is that of one chunk in the real size and bfloat16, from
the shapes of all tensors alone.
"""

import argparse
import json
import platform
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F
from vggt_costs import count_cameras, count_tracking, modelled_peak_gb

from vfm_sdm.networks.device import choose_placement
from vfm_sdm.networks.interface import ChunkTracks
from vfm_sdm.networks.vggt import tracker
from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.inference import VggtInference
from vfm_sdm.networks.vggt.model import Vggt
from vfm_sdm.networks.vggt.rotary import rotary_table
from vfm_sdm.stages.tracking.chunks import ChunkPlan, ChunkStitcher
from vfm_sdm.stages.tracking.network import NetworkPreset
from vfm_sdm.stages.tracking.vggt import PRESETS

CAMERA_SIZE = (294, 518)
MANY = 6


@dataclass(frozen=True)
class Size:
    """What is measured; ``baseline_frames`` of the baseline, the rest is extrapolated."""

    config: VggtConfig
    frames: int
    presets: dict[str, NetworkPreset]
    baseline_frames: int
    reduced: bool = False


SIZES = {
    "full": Size(VggtConfig(), 480, PRESETS, 144),
    "reduced": Size(
        VggtConfig(
            width=128, encoder_depth=4, encoder_heads=2, depth=4, heads=2, camera_depth=2, camera_heads=4,
            feature_layers=(0, 1, 2, 3), feature_channels=(32, 64, 128, 128), features=32, hidden=96, track_heads=4,
            track_depth=2, virtual_tracks=16,
        ),
        120,
        {
            "paper": replace(PRESETS["paper"], plan=ChunkPlan(36, overlap=8), side_px=140, canvas=(252, 140)),
            "fast": replace(PRESETS["fast"], plan=ChunkPlan(8), side_px=140),
        },
        120,
        reduced=True,
    ),
}  # fmt: skip


class Device:
    """Where it runs: its clock, its memory, its rate."""

    def __init__(self, name: str) -> None:
        self.placement = choose_placement(name)
        self.torch = self.placement.device
        self.is_gpu = self.torch.type == "cuda"
        cpu = f"CPU {platform.machine()}, {torch.get_num_threads()} threads"
        self.name = torch.cuda.get_device_name(self.torch) if self.is_gpu else cpu

    def seconds(self, run: Callable[[], object]) -> float:
        self.wait()
        begin = time.perf_counter()
        run()
        self.wait()
        return time.perf_counter() - begin

    def wait(self) -> None:
        if self.is_gpu:
            torch.cuda.synchronize(self.torch)

    def forget_peak(self) -> None:
        if self.is_gpu:
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats(self.torch)

    def peak_gb(self) -> float:
        if self.is_gpu:
            return torch.cuda.max_memory_allocated(self.torch) / 1e9
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9  # kilobytes on Linux

    def matrix_rate(self, dtype: torch.dtype) -> float:
        """Operations a second, the best of several."""
        side, products = (8192, 10) if self.is_gpu else (1536, 1)
        left, right = (torch.randn(side, side, device=self.torch).to(dtype) for _ in range(2))
        out = torch.empty_like(left)

        def multiply() -> None:
            for _ in range(products):
                torch.mm(left, right, out=out)

        multiply()
        return products * 2 * side**3 / min(self.seconds(multiply) for _ in range(7))


def make_network(config: VggtConfig, device: torch.device, seed: int, *, camera: bool, track: bool) -> Vggt:
    """Random weights with which numbers neither grow nor vanish: products with zeros can be quicker than others."""
    with torch.device("meta"):
        network = Vggt(config, camera=camera, track=track)
    network.to_empty(device=device)
    generator = torch.Generator(device).manual_seed(seed)
    with torch.no_grad():
        for name, values in network.named_parameters():
            matrix = values.ndim > 1
            mean = float(not matrix and not name.endswith("bias"))
            values.normal_(mean, values[0].numel() ** -0.5 if matrix else 0.1, generator=generator)
    return network


@dataclass
class Measured:
    """A network that notes the lengths of the chunks it was given."""

    network: "VggtInference | Baseline"
    chunks: list[int] = field(default_factory=list)

    def plan_frames(self, height: int, width: int) -> int | None:
        return self.network.plan_frames(height, width)

    def follow(self, frames: np.ndarray, queries: np.ndarray) -> ChunkTracks:
        found = self.network.follow(frames, queries)
        self.chunks.append(len(frames))
        return found


def track(
    network: "VggtInference | Baseline", preset: NetworkPreset, patches: np.ndarray, points: np.ndarray
) -> list[int]:
    """Follows points through patches as the tracker does; lengths of the chunks."""
    measured = Measured(network)
    stitcher = ChunkStitcher(measured, preset.plan, points)
    for picture in patches:
        stitcher.feed(preset.picture(picture))
    stitcher.finish()
    return measured.chunks


@dataclass(frozen=True)
class Baseline:
    """The same network with none of the savings."""

    network: Vggt
    device: torch.device

    def plan_frames(self, height: int, width: int) -> None:
        return None

    def follow(self, frames: np.ndarray, queries: np.ndarray) -> ChunkTracks:
        tracks = [self._follow_one(frames, query) for query in queries]
        parts = ([track[k] for track in tracks] for k in range(3))
        return ChunkTracks(*(torch.stack(part, dim=1).double().cpu().numpy() for part in parts))

    @torch.inference_mode()
    def _follow_one(self, frames: np.ndarray, query: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
        rotary_table.cache_clear()
        kind = next(self.network.parameters()).dtype
        images = torch.from_numpy(frames).to(self.device, kind).permute(0, 3, 1, 2) / 255
        tokens = self.network.aggregator(images, range(self.network.config.depth))
        head = self.network.track_head
        maps = head.feature_extractor(tokens, (images.shape[-2], images.shape[-1]))
        with patch.object(tracker, "correlate", correlate_volumes):
            found = head.tracker(maps, torch.as_tensor(query, dtype=kind, device=self.device)[None, None])
        return found.positions[-1, 0, 0], found.visibility[0, 0], found.confidence[0, 0]


def correlate_volumes(pyramid: list[Tensor], tracks: Tensor, positions: Tensor, *, radius: int) -> Tensor:
    """As `vfm_sdm.networks.vggt.correlation.correlate`, by the product of every track with every cell of its frame."""
    steps = torch.arange(-radius, radius + 1, device=positions.device, dtype=positions.dtype)
    window = torch.cartesian_prod(steps, steps)
    found = []
    for level, features in enumerate(pyramid):
        rows, columns, channels = features.shape[1:]
        volume = torch.einsum("tsc,shwc->tshw", tracks, features) / channels**0.5
        place = positions.flatten(0, 1)[:, None] / 2**level + window
        limits = place.new_tensor([max(columns - 1, 1), max(rows - 1, 1)])
        grid = (2 * place / limits - 1)[:, None]
        sampled = F.grid_sample(volume.flatten(0, 1)[:, None], grid, padding_mode="zeros", align_corners=True)
        found.append(sampled.reshape(*positions.shape[:2], -1))
    return torch.cat(found, dim=-1)


def picture_size(preset: NetworkPreset) -> tuple[int, int]:
    """Height and width of what the network is given."""
    width, height = preset.canvas or (preset.side_px, preset.side_px)
    return height, width


def count_chunks(size: Size, name: str, chunks: Sequence[int]) -> dict[str, float]:
    """Operations of all chunks with one point, by part of the network."""
    counts = [count_tracking(size.config, frames, *picture_size(size.presets[name]), 1) for frames in chunks]
    return {part: float(sum(count[part] for count in counts)) for part in counts[0]}


def planned_chunks(plan: ChunkPlan, frames: int) -> list[int]:
    """Lengths of the chunks where memory suffices."""
    shared = 1 if plan.anchored else plan.overlap
    return [min(plan.frames, frames - start) for start in range(0, max(frames - shared, 1), plan.frames - shared)]


def measure_cameras(size: Size, device: Device, inference: VggtInference, rate: float) -> dict[str, object]:
    images = np.random.default_rng(1).integers(0, 256, (2, *CAMERA_SIZE, 3), np.uint8)
    inference.estimate_poses(images)
    device.forget_peak()
    seconds = min(device.seconds(lambda: inference.estimate_poses(images)) for _ in range(5))
    floor_s, peak_gb = count_cameras(size.config, 2, *CAMERA_SIZE) / rate, device.peak_gb()
    print(f"cameras, 2 frames of {CAMERA_SIZE[0]} x {CAMERA_SIZE[1]} px")
    print_row("this package", seconds, f"floor {floor_s:.5f} s, peak {peak_gb:.2f} GB")
    return {"cameras_2_frames_s": seconds, "cameras_floor_s": floor_s, "cameras_peak_memory_gb": peak_gb}


def measure_preset(
    size: Size, name: str, scene: tuple[np.ndarray, np.ndarray], device: Device, inference: VggtInference, rate: float
) -> dict[str, object]:
    preset, (patches, points) = size.presets[name], scene
    first_s = device.seconds(lambda: track(inference, preset, patches, points[:1]))
    device.forget_peak()
    chunks: list[int] = []
    one_s = min(first_s, device.seconds(lambda: chunks.extend(track(inference, preset, patches, points[:1]))))
    peak_gb = device.peak_gb()
    many_s = min(device.seconds(lambda: track(inference, preset, patches, points)) for _ in range(2))
    operations = count_chunks(size, name, chunks)
    total = sum(operations.values())
    modelled_gb = modelled_peak_gb(VggtConfig(), PRESETS[name].plan.frames, *picture_size(PRESETS[name]))
    height, width = picture_size(preset)
    print(f"{name}: {len(patches)} frames of {height} x {width} px in {len(chunks)} chunks, the first of {chunks[0]}")
    shares = ", ".join(f"{part} {count / total:.1%}" for part, count in operations.items())
    print_row("floor", total / rate, f"{total:.4g} operations: {shares}")
    print_row("this package, 1 point", one_s, f"{one_s * rate / total:.2f} x floor, peak {peak_gb:.2f} GB")
    print_row(f"this package, {MANY} points", many_s, f"{many_s / one_s:.2f} x one point")
    print_row("first run", first_s, f"real size in bfloat16, modelled peak of a chunk: {modelled_gb:.2f} GB")
    return {
        "tracking_480x1_s": one_s,
        "floor_s": total / rate,
        "ratio_to_floor": one_s * rate / total,
        "peak_memory_gb": peak_gb,
        "modelled_full_size_peak_gb": modelled_gb,
        "six_points_ratio": many_s / one_s,
        "first_run_s": first_s,
        "frames": len(patches),
        "chunks": chunks,
        "operations": operations,
    }


def measure_baseline(
    size: Size, name: str, scene: tuple[np.ndarray, np.ndarray], device: Device, network: Baseline, limit_s: float
) -> dict[str, object]:
    """Null where it does not fit, or where even its floor is beyond the limit."""
    preset, (patches, points) = size.presets[name], scene
    frames = min(size.baseline_frames, len(patches))
    done, total = (
        sum(count_chunks(size, name, planned_chunks(preset.plan, count)).values()) for count in (frames, len(patches))
    )
    result: dict[str, object] = {"baseline_s": None, "baseline_frames": frames, "baseline_peak_memory_gb": None}
    floor_s = done / device.matrix_rate(torch.float32)
    if floor_s > limit_s:
        print(f"  baseline, {name}: left out, {frames} frames would take more than {floor_s:.0f} s")
        return result
    device.forget_peak()
    try:
        seconds = device.seconds(lambda: track(network, preset, patches[:frames], points[:1]))
    except torch.OutOfMemoryError as error:
        print(f"  baseline, {name}: does not fit, {str(error).partition('. ')[0]}")
        return result
    peak_gb, whole_s = device.peak_gb(), seconds * total / done
    how = f"extrapolated by operations from {seconds:.2f} s for {frames} frames" if total > done else "measured"
    print_row(f"baseline, {name}, 1 point", whole_s, f"{how}, peak {peak_gb:.2f} GB; {MANY} points: {MANY} times")
    return result | {"baseline_s": whole_s, "baseline_peak_memory_gb": peak_gb}


def print_row(label: str, seconds: float, note: str) -> None:
    print(f"  {label:28s} {seconds:10.3f} s  {note}")


def measure(size: Size, device: Device, seed: int, limit_s: float) -> dict[str, object]:
    rng = np.random.default_rng(seed)
    side = size.presets["paper"].side_px
    patches = rng.integers(0, 256, (size.frames, side, side, 3), np.uint8)
    scene = patches, rng.uniform(0.25 * side, 0.75 * side, (MANY, 2))
    placement = device.placement
    rate = device.matrix_rate(torch.bfloat16 if placement.reduced else torch.float32)
    print(f"{device.name}, {placement.precision}, matrix products {rate / 1e12:.4g} TFLOP/s")
    if size.reduced:
        print("reduced size: a small network, small patches, few frames; not the published network's speed")

    def network(*, camera: bool = False) -> Vggt:
        return make_network(size.config, placement.device, seed, camera=camera, track=not camera)

    cameras = measure_cameras(size, device, VggtInference(network(camera=True), placement), rate)
    inference = VggtInference(network(), placement)
    summary: dict[str, object] = {
        "device": device.name,
        "reduced": size.reduced,
        "frames": size.frames,
        "precision": placement.precision,
        "matrix_rate_tflops": rate / 1e12,
        "torch": torch.__version__,
        **cameras,
    }
    presets = {name: measure_preset(size, name, scene, device, inference, rate) for name in size.presets}
    del inference
    baseline = Baseline(network(), placement.device)
    return summary | {
        name: result | measure_baseline(size, name, scene, device, baseline, limit_s)
        for name, result in presets.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--size", choices=SIZES, help="the real one on a GPU, a reduced one elsewhere")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--baseline-frames", type=int, help="of which the baseline's time is extrapolated")
    parser.add_argument("--baseline-limit-s", type=float, default=300.0, help="no baseline whose floor is beyond this")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    device = Device(options.device)
    size = SIZES[options.size or ("full" if device.is_gpu else "reduced")]
    size = replace(
        size,
        frames=options.frames or size.frames,
        baseline_frames=options.baseline_frames or size.baseline_frames,
    )
    print(json.dumps(measure(size, device, options.seed, options.baseline_limit_s)))


if __name__ == "__main__":
    main()
