"""TAPIR on frames as NumPy arrays: loaded once, run where there is room."""

from pathlib import Path
from typing import Self

import numpy as np
import torch

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.networks.device import Placement, choose_placement
from vfm_sdm.networks.interface import ChunkTracks, RgbFrames
from vfm_sdm.networks.loading import load_weights
from vfm_sdm.networks.tapir.config import TapirConfig
from vfm_sdm.networks.tapir.model import Tapir

__all__ = ["TapirInference", "choose_config"]

_FRAME_PIXEL_BYTES = 100
"""Peak memory of a pixel of a frame: feature grids, and what passes the backbone in its chunk [byte]."""
_CORNER = 0.5
"""Shift of the pixel origin [px]: TAPIR has the image's corner at (0, 0), this package the top-left pixel's centre."""


def choose_config(weights: str | Path) -> TapirConfig:
    """Configuration of the network that a file of weights belongs to, told by the file's name.

    Parameters
    ----------
    weights
        Name or path of the weights.

    Notes
    -----
    Causal weights have the same keys and shapes as others, so only the name tells them apart.

    Examples
    --------
    >>> choose_config("causal_bootstapir_checkpoint.pt").causal
    True
    """
    name = Path(weights).name
    if "panning" in name:
        return TapirConfig.tapir_panning()
    return TapirConfig.bootstapir_causal() if "causal" in name else TapirConfig.bootstapir()


class TapirInference:
    """A network on its device.

    Parameters
    ----------
    network
        Network with its weights; it is moved to the device.
    placement
        Where it runs, in float32: its soft arg-max weighs cells by their distance from the corner, of which reduced
        precision would leave half a pixel.

    Raises
    ------
    DeviceMemoryError
        The device has no room for the weights.
    """

    def __init__(self, network: Tapir, placement: Placement) -> None:
        self.placement = placement
        with placement.running(), torch.inference_mode(False):
            self.network = network.eval().to(placement.device)

    @classmethod
    def load(cls, weights: str, *, device: str = "auto") -> Self:
        """The published network.

        Parameters
        ----------
        weights
            Name or path of the weights.
        device
            ``auto`` (a GPU where there is one), or a name that PyTorch knows.

        Raises
        ------
        BackendUnavailableError
            The weights are not here or are others, or there is no such device.
        """
        placement = choose_placement(device, "float32")
        with torch.device("meta"):
            network = Tapir(choose_config(weights))
        load_weights(network, weights, dtype=torch.float32)
        return cls(network, placement)

    def follow(self, frames: RgbFrames, queries: FloatArray) -> ChunkTracks:
        """Points of the first frame followed through all; each is independent of the others.

        Parameters
        ----------
        frames
            Red, green and blue, shape (S, H, W, 3).
        queries
            Column and row in the first frame, shape (N, 2) [px].

        Raises
        ------
        DatasetError
            The frames have another shape.
        DeviceMemoryError
            The frames do not fit the memory.
        """
        with self.placement.running():
            pixels = torch.from_numpy(np.ascontiguousarray(frames)).to(self.placement.device)
            places = torch.as_tensor(queries + _CORNER, dtype=self._dtype, device=self.placement.device)
            asked = torch.cat([torch.zeros_like(places[:, :1]), places.flip(1)], dim=1)
            found = self.network.track(pixels.to(self._dtype) / 255 * 2 - 1, asked)
            position = found.tracks.transpose(0, 1).cpu().double().numpy() - _CORNER
            seen, near = (
                torch.sigmoid(-logits).T.cpu().double().numpy() for logits in (found.occlusion, found.expected_dist)
            )
            # The published rule: seen and near at once with more than even odds.
            return ChunkTracks(position, seen, seen * near)

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
        return None if free is None else int(free // (height * width * _FRAME_PIXEL_BYTES))

    @property
    def _dtype(self) -> torch.dtype:
        return next(self.network.parameters()).dtype
