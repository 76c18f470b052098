"""VGGT on images as NumPy arrays: loaded once, run where there is room."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self, cast
from weakref import WeakValueDictionary

import numpy as np
import torch
from torch import nn

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.networks.device import Placement, choose_placement
from vfm_sdm.networks.interface import ChunkTracks, Precision, RgbFrames
from vfm_sdm.networks.loading import load_weights
from vfm_sdm.networks.vggt.model import HEADS, Vggt

__all__ = ["VggtInference", "reduce_matrices"]

_CHANNEL_BYTES = 50
"""Peak memory of a token's channel in the aggregator: residual, queries, keys, values, hidden units [byte]."""
_FEATURE_BYTES = 10
"""Peak memory of a feature map's value: the maps, the same normalised, and the coarser levels [byte]."""


_LOADED: "WeakValueDictionary[tuple[str | int, ...], VggtInference]" = WeakValueDictionary()
"""Networks that somebody holds, by their weights and where they run."""


class VggtInference:
    """A network on its device.

    Parameters
    ----------
    network
        Network with its weights; it is moved to the device, and its matrices are rounded there if the placement says
        so.
    placement
        Where and how it runs.

    Raises
    ------
    DeviceMemoryError
        The device has no room for the weights.
    """

    def __init__(self, network: Vggt, placement: Placement) -> None:
        self.placement = placement
        if placement.reduced:
            reduce_matrices(network.aggregator)
        with placement.running(), torch.inference_mode(False):
            self.network = network.eval().to(placement.device)

    @classmethod
    def load(
        cls,
        weights: str,
        *,
        device: str = "auto",
        precision: Precision = "auto",
        camera: bool = False,
        track: bool = False,
    ) -> Self:
        """The published network with the heads that are asked for; the others are neither built nor read.

        Whoever loads the same weights to the same device gets the same network while somebody holds it: cameras,
        matcher and tracker of a run share the 3.6 GB that they have in common.

        Parameters
        ----------
        weights
            Name or path of the weights.
        device
            ``auto`` (a GPU where there is one), or a name that PyTorch knows.
        precision
            Precision of matrix products; ``auto`` is bfloat16 on GPUs that have it.
        camera, track
            Whether the camera head and the tracking head are built.

        Raises
        ------
        BackendUnavailableError
            The weights are not here or are others, or there is no such device.
        """
        placement = choose_placement(device, precision)
        heads = {"camera_head": camera, "track_head": track}
        # A file that was replaced meanwhile is another one.
        known = Path(weights)
        file = (known.stat().st_size, known.stat().st_mtime_ns) if known.is_file() else ()
        key = (weights, *file, str(placement.device), placement.precision)
        found = _LOADED.get(key)
        if found is None:
            with torch.device("meta"):
                network = Vggt(camera=camera, track=track)
            load_weights(network, weights, optional_prefixes=network.heads_left_out, dtype=torch.float32)
            found = _LOADED[key] = cls(network, placement)
        found._add_heads(weights, [name for name, wanted in heads.items() if wanted])
        return cast(Self, found)

    def _add_heads(self, weights: str, names: Sequence[str]) -> None:
        """Builds and reads those of the named heads that are not here yet."""
        for name in names:
            if not hasattr(self.network, name):
                with torch.device("meta"):
                    whole = Vggt(camera=name == "camera_head", track=name == "track_head")
                head = nn.ModuleDict({name: getattr(whole, name)})
                others = ("aggregator", *(other for other in HEADS if other != name))
                load_weights(head, weights, optional_prefixes=others, dtype=torch.float32)
                with self.placement.running(), torch.inference_mode(False):
                    setattr(self.network, name, head[name].eval().to(self.placement.device))

    def estimate_poses(self, images: RgbFrames) -> FloatArray:
        """Pose vectors of images that are seen together.

        Parameters
        ----------
        images
            Red, green and blue, shape (S, H, W, 3); the first frame's camera is the origin.

        Returns
        -------
        poses
            Pose vectors (`vfm_sdm.networks.vggt.pose`), shape (S, 9).

        Raises
        ------
        DatasetError
            The images' sides are not multiples of a patch.
        DeviceMemoryError
            The images do not fit the memory.
        """
        with self.placement.running():
            return self.network.estimate_poses(self._tensor(images))[-1].cpu().double().numpy()

    def follow(self, frames: RgbFrames, queries: FloatArray) -> ChunkTracks:
        """Points of the first frame followed through all, each as if alone, after one pass through the backbone.

        Parameters
        ----------
        frames
            Red, green and blue, shape (S, H, W, 3).
        queries
            Column and row in the first frame, shape (N, 2) [px].

        Raises
        ------
        DatasetError
            The frames' sides are not multiples of a patch, or too short.
        DeviceMemoryError
            The frames do not fit the memory.
        """
        with self.placement.running():
            points = torch.as_tensor(queries, dtype=self._dtype, device=self.placement.device)
            # Groups of one: points of one group would see each other.
            tracks = self.network.track(self._tensor(frames), points[:, None])
            found = (tracks.positions[-1], tracks.visibility, tracks.confidence)
            return ChunkTracks(*(part[:, 0].transpose(0, 1).cpu().double().numpy() for part in found))

    @property
    def precision(self) -> str:
        """Precision of its matrix products: ``float32`` or ``bfloat16``."""
        return self.placement.precision

    def plan_frames(self, height: int, width: int) -> int | None:
        """How many frames of one size fit the free memory; ``None`` where that is not known.

        Parameters
        ----------
        height, width
            Size of a frame, shape (height, width, 3) [px].
        """
        free = self.placement.free_bytes()
        if free is None:
            return None
        config = self.network.config
        tokens = (height // config.patch_size) * (width // config.patch_size) + config.special_tokens
        kept = len(config.feature_layers) * 2 * config.width * (2 if self.placement.reduced else 4)
        working = config.width * _CHANNEL_BYTES * (1 if self.placement.reduced else 2)
        maps = config.features * (height // 2) * (width // 2) * _FEATURE_BYTES
        # The tokens are gone when the tracker runs.
        return int(free // max(tokens * (kept + working), maps))

    @property
    def _dtype(self) -> torch.dtype:
        return self.network.aggregator.camera_token.dtype

    def _tensor(self, images: RgbFrames) -> torch.Tensor:
        pixels = torch.from_numpy(np.ascontiguousarray(images)).to(self.placement.device)
        return pixels.permute(0, 3, 1, 2).to(self._dtype) / 255


def reduce_matrices(module: nn.Module) -> None:
    """Rounds the weights of matrix products to bfloat16, the type they are multiplied in.

    Parameters
    ----------
    module
        Network whose linear and convolution layers are changed, whatever their shape.

    Notes
    -----
    Half the memory, and nothing is converted twice.

    Examples
    --------
    >>> layer = nn.Linear(2, 2)
    >>> reduce_matrices(layer)
    >>> layer.weight.dtype
    torch.bfloat16
    """
    for layer in module.modules():
        if isinstance(layer, nn.Linear | nn.Conv2d):
            layer.to(torch.bfloat16)
