"""BootsTAPIR as a tracker: the paper's second network (its table of point tracking strategies)."""

from vfm_sdm.networks.interface import ChunkNetwork
from vfm_sdm.stages.tracking.chunks import ChunkPlan
from vfm_sdm.stages.tracking.network import NetworkPreset, NetworkTracker

__all__ = ["PRESET", "TapirTracker"]

PRESET = NetworkPreset("anchored", ChunkPlan(96), 256, multiple=8, least_px=64)
"""Patches of 256 px, the resolution that it works at, so that nothing is resized; chunks that all begin with the
reference frame, whose features are looked for in every other frame: nothing drifts."""


class TapirTracker(NetworkTracker):
    """Tracker ``tapir``: it has one preset and one precision; the name of its weights tells whether they are causal."""

    name = "tapir"

    @property
    def preset(self) -> NetworkPreset:
        """The only preset."""
        return PRESET

    def load(self) -> ChunkNetwork:
        """The network with its weights on its device."""
        from vfm_sdm.networks.tapir.inference import TapirInference  # noqa: PLC0415  (PyTorch is optional)

        return TapirInference.load(str(self.weights), device=self.settings.device)
