"""Networks of the real structure with few channels and random weights: they run in a moment and know nothing."""

from contextlib import contextmanager

import pytest

from vfm_sdm.core.parts import BUILT_IN
from vfm_sdm.core.registry import parts_of
from vfm_sdm.inputs.session import Network
from vfm_sdm.stages.tracking.base import find_tracker

NETWORK_TRACKERS = tuple(
    name
    for name in BUILT_IN["trackers"]
    if any(part.needs is not None and part.needs.checkpoints for part in parts_of("trackers", name).values())
)
ROUNDING_PX = 1e-6
"""How far two ways of computing one track may differ in double precision [px].

Networks of random weights amplify: a query that is moved by 1e-9 px moves its track by 3e-4 px (up to twice as much
with other seeds). A position of 100 px is rounded by 1e-14 px, which becomes 3e-9 px; the bound allows for some hundred
such roundings in one direction, and 2e-8 px is the most that was seen. In single precision it would be pixels.
"""


def small_vggt(seed=0, **heads):
    """A `Vggt` whose weights a seed decides."""
    torch = pytest.importorskip("torch")
    from vfm_sdm.networks.vggt.config import VggtConfig
    from vfm_sdm.networks.vggt.model import Vggt

    config = VggtConfig(
        width=32,
        encoder_depth=1,
        encoder_heads=2,
        depth=4,
        heads=2,
        camera_depth=1,
        camera_heads=2,
        feature_layers=(0, 1, 2, 3),
        feature_channels=(8, 8, 8, 8),
        features=16,
        hidden=48,
        track_heads=4,
        track_depth=2,
        virtual_tracks=8,
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = Vggt(config, **heads)
        with torch.no_grad():
            for values in network.parameters():
                # Attention whose weights begin at zero sees nothing, neither other points nor other frames.
                if values.ndim > 1 and not values.is_meta and not values.any():
                    values.normal_(0.0, values.shape[-1] ** -0.5)
    return network


def small_tapir(seed=0):
    """A `Tapir` whose weights a seed decides."""
    torch = pytest.importorskip("torch")
    from vfm_sdm.networks.tapir.config import TapirConfig
    from vfm_sdm.networks.tapir.model import Tapir

    config = TapirConfig(
        pyramid_level=1,
        extra_convs=True,
        causal=False,
        initial_resolution=(64, 64),
        group_channels=(8, 8, 16, 16),
        extra_blocks=1,
        mixer_channels=32,
        mixer_blocks=2,
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return Tapir(config)


def small_posediffusion(seed=0):
    """A `PoseDiffusion` whose weights a seed decides."""
    torch = pytest.importorskip("torch")
    from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig
    from vfm_sdm.networks.posediffusion.model import PoseDiffusion

    config = PoseDiffusionConfig(
        width=32, encoder_depth=1, encoder_heads=2, channels=32, depth=1, heads=2, hidden=48, head_hidden=16
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return PoseDiffusion(config)


def posediffusion_on_cpu(iterations=1, **options):
    from vfm_sdm.networks.device import choose_placement
    from vfm_sdm.networks.posediffusion.inference import PoseDiffusionInference

    return PoseDiffusionInference(small_posediffusion(**options), choose_placement("cpu"), iterations=iterations)


def vggt_on_cpu(**options):
    from vfm_sdm.networks.device import choose_placement
    from vfm_sdm.networks.vggt.inference import VggtInference

    return VggtInference(small_vggt(**options), choose_placement("cpu"))


def tapir_on_cpu():
    from vfm_sdm.networks.device import choose_placement
    from vfm_sdm.networks.tapir.inference import TapirInference

    return TapirInference(small_tapir(), choose_placement("cpu"))


@contextmanager
def in_double(inference):
    """The network of an inference or tracker computes in double precision meanwhile: for comparisons.

    In single precision, one track computed in two ways, with others or alone, differs by what the processor's kernels
    make of another number of rows.
    """
    owner = getattr(inference, "follower", inference)
    network = getattr(owner, "inference", owner).network
    network.double()
    try:
        yield
    finally:
        network.float()


def small_tracker(name, folder, **options):
    """The tracker of this name; one that runs a network gets a small one, and a file that stands for its weights."""
    if name not in NETWORK_TRACKERS:
        return find_tracker(name, **options)
    pytest.importorskip("torch")
    weights = folder / "random.safetensors"
    weights.write_bytes(b"stands for weights")
    tracker = find_tracker(name, network=Network(weights=str(weights), device="cpu"), **options)
    follower = getattr(tracker, "follower", tracker)
    follower.__dict__["inference"] = vggt_on_cpu(camera=False) if "vggt" in name else tapir_on_cpu()
    return tracker
