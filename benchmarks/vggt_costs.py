"""What VGGT costs, without running it: operations by formula, memory by the shapes of all tensors.

Operations are two for every multiplication with its addition, in matrix products, attention and convolutions; nothing
else is counted. One chunk of frames at a time.
"""

import weakref
from collections.abc import Iterable

import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.nn import functional as F
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.inference import reduce_matrices
from vfm_sdm.networks.vggt.model import Vggt
from vfm_sdm.networks.vggt.rotary import rotary_table


def count_block(tokens: int, seen: int, width: int) -> int:
    """Queries, keys, values, projection and MLP of every token; scores and mixture with the tokens that it sees."""
    return 24 * tokens * width**2 + 4 * tokens * seen * width


def count_convolution(cells: int, inputs: int, outputs: int, side: int) -> int:
    """By the cells on the side that is not enlarged: of the result, or of the input of a transposed convolution."""
    return 2 * cells * inputs * outputs * side**2


def count_backbone(config: VggtConfig, frames: int, height: int, width: int) -> dict[str, int]:
    c = config
    patches = (height // c.patch_size) * (width // c.patch_size)
    tokens = patches + c.special_tokens
    within = count_block(frames * tokens, tokens, c.width)
    across = count_block(frames * tokens, frames * tokens, c.width)
    patch_embedding = count_convolution(frames * patches, 3, c.width, c.patch_size)
    return {
        "encoder": patch_embedding + c.encoder_depth * within,
        "within frames": c.depth * within,
        "across frames": c.depth * across,
    }


def count_feature_head(config: VggtConfig, frames: int, height: int, width: int) -> int:
    rows, columns = height // config.patch_size, width // config.patch_size
    f, channels = config.features, config.feature_channels
    grid = rows * columns
    cells = (16 * grid, 4 * grid, grid, -(-rows // 2) * -(-columns // 2))
    total = sum(count_convolution(grid, 2 * config.width, count, 1) for count in channels)
    total += sum(count_convolution(grid, channels[k], channels[k], side) for k, side in ((0, 4), (1, 2)))
    total += count_convolution(cells[3], channels[3], channels[3], 3)
    finer = (4 * cells[0], *cells[:3])
    for k, count in enumerate(channels):
        convolutions = 2 if k == 3 else 4  # of residual units: the coarsest map has one, the others two
        total += count_convolution(cells[k], count, f, 3) + convolutions * count_convolution(cells[k], f, f, 3)
        total += count_convolution(finer[k], f, f, 1)
    return frames * (total + count_convolution(finer[0], f, f, 3))


def count_tracker(config: VggtConfig, frames: int, points: int) -> int:
    """Every point with virtual tracks of its own."""
    c, f, h = config, config.features, config.hidden
    virtual = c.virtual_tracks * frames
    windows = c.levels * (2 * c.radius + 1) ** 2
    around = 2 * frames * (windows * h + h * f + (3 * f + 4) * h + h * (f + 2) + f * f)
    level = count_block(frames + virtual, frames, h)  # over time
    level += count_block(virtual, c.virtual_tracks, h)
    # Cross attention, both ways: 20 h^2 for whoever asks, 4 h^2 for whoever is asked.
    level += 2 * 4 * virtual * h + (20 + 4) * (frames + virtual) * h**2
    return points * (c.track_iterations * (around + c.track_depth * level) + 2 * 2 * frames * f)


def count_tracking(config: VggtConfig, frames: int, height: int, width: int, points: int) -> dict[str, int]:
    """One chunk, by part."""
    return {
        **count_backbone(config, frames, height, width),
        "feature maps": count_feature_head(config, frames, height, width),
        "tracker": count_tracker(config, frames, points),
    }


def count_cameras(config: VggtConfig, frames: int, height: int, width: int) -> int:
    w = 2 * config.width
    once = 2 * frames * (9 * w + w * 3 * w + w * w // 2 + w // 2 * 9)
    once += config.camera_depth * count_block(frames, frames, w)
    return sum(count_backbone(config, frames, height, width).values()) + config.camera_iterations * once


class _Allocated(TorchDispatchMode):
    """Bytes of the tensors that live at the same time, at most."""

    def __init__(self, already: Iterable[Tensor]) -> None:
        super().__init__()
        self.now = self.peak = 0
        self._known: set[int] = set()
        for tensor in already:
            self._add(tensor.untyped_storage())

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        for tensor in tree_leaves(result):
            if isinstance(tensor, Tensor):
                self._add(tensor.untyped_storage())
        return result

    def _add(self, storage: torch.UntypedStorage) -> None:
        key, size = storage._cdata, storage.nbytes()
        if key not in self._known:
            self._known.add(key)
            self.now += size
            self.peak = max(self.peak, self.now)
            weakref.finalize(storage, self._drop, key, size)

    def _drop(self, key: int, size: int) -> None:
        self._known.discard(key)
        self.now -= size


class _AsOnGpu(TorchFunctionMode):
    """Attention that makes no table of scores, and autocast that normalises in float32, as on GPUs."""

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function is F.scaled_dot_product_attention:
            return torch.empty_like(args[0])
        if function in (F.layer_norm, F.group_norm) and torch.is_autocast_enabled("cpu"):
            args = (args[0].float(), *args[1:])
        return function(*args, **(kwargs or {}))


def modelled_peak_gb(config: VggtConfig, frames: int, height: int, width: int) -> float:
    """Most memory that tracking one point through a chunk takes on a GPU in bfloat16, weights included.

    What kernels take for themselves and what fragmentation wastes is not in it.
    """
    with torch.device("meta"):
        network = Vggt(config, camera=False)
        reduce_matrices(network.aggregator)
    shapes = {key: (value.shape, value.dtype) for key, value in network.state_dict().items()}
    rotary_table.cache_clear()
    with FakeTensorMode(), torch.no_grad():
        state = {key: torch.empty(shape, dtype=dtype) for key, (shape, dtype) in shapes.items()}
        network.load_state_dict(state, assign=True)
        allocated = _Allocated(network.parameters())
        with torch.autocast("cpu", torch.bfloat16), allocated, _AsOnGpu():
            network.track(torch.empty(frames, 3, height, width), torch.zeros(1, 1, 2))
    rotary_table.cache_clear()  # tables without values
    return allocated.peak / 1e9
