"""VGGT as a tracker (section VFM-based marker-free 2D point-tracking; settings from Implementation details)."""

from pathlib import Path

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.inputs.session import Network
from vfm_sdm.networks.interface import ChunkNetwork
from vfm_sdm.stages.tracking.chunks import ChunkPlan
from vfm_sdm.stages.tracking.network import NetworkPreset, NetworkTracker

__all__ = ["PRESETS", "VggtTracker"]

_PATCH_PX = 14
_LEAST_PX = 128
_OTHER_HEAD = "tracker_fixed"
"""Part of the names of weights with the same keys and shapes that belong to another feature head."""

PRESETS = {
    "paper": NetworkPreset("paper", ChunkPlan(144, overlap=32), 294, _PATCH_PX, _LEAST_PX, canvas=(518, 294)),
    "fast": NetworkPreset("fast", ChunkPlan(32), 294, _PATCH_PX, _LEAST_PX),
}
"""``paper``: patches of 294 px at the top left of a black picture of 294 x 518 px, chunks of 144 frames that overlap by
32 and are joined there. ``fast``: nothing around the patches, and short chunks that all begin with the reference frame:
less arithmetic, because attention grows with the square of a chunk's tokens, and no drift."""


class VggtTracker(NetworkTracker):
    """Tracker ``vggt``: the network VGGT with its tracking head.

    Parameters
    ----------
    network
        Weights, preset, device and precision.

    Raises
    ------
    BackendUnavailableError
        PyTorch or the weights are not here, or the weights belong to another feature head.

    Notes
    -----
    The released tracking head was trained on rigid scenes. Whether it follows a small motion of an object in a still
    picture has to be tested with the weights at hand (``pytest -m weights``, docs/networks.md).
    """

    name = "vggt"

    def __init__(self, *, network: Network | None = None) -> None:
        chosen = (network or Network()).weights or ""
        if _OTHER_HEAD in Path(chosen).name.replace("-", "_"):
            raise BackendUnavailableError(
                f"tracker vggt: expected weights of the published feature head, got {chosen!r}, whose head adds a "
                "position embedding that could not be checked against reference numbers; choose vggt-1b"
            )
        super().__init__(network=network)

    @property
    def preset(self) -> NetworkPreset:
        """The preset that the settings name."""
        return PRESETS[self.settings.preset]

    def load(self) -> ChunkNetwork:
        """The network without its camera head, on its device."""
        from vfm_sdm.networks.vggt.inference import VggtInference  # noqa: PLC0415  (PyTorch is optional)

        settings = self.settings
        return VggtInference.load(str(self.weights), device=settings.device, precision=settings.precision, track=True)
