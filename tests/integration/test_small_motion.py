"""Whether trackers follow motions of a pixel and less: with real weights (`-m weights -n 0 -s`), and what asks them.

`VFM_SDM_TEST_WEIGHTS` names a folder with the files as `vfm-sdm weights fetch` names them (docs/networks.md).
"""

import os
from pathlib import Path

import numpy as np
import pytest

from moving_frames import memory_video
from small_motion import AMPLITUDES_PX, KINDS, POINT, measure_gain, motion, pictures
from vfm_sdm.inputs.session import Network
from vfm_sdm.stages.tracking.base import find_tracker

FOLDER = "VFM_SDM_TEST_WEIGHTS"
CASES = [
    ("vggt", "vggt-1b.safetensors", "fast"),
    ("vggt", "vggt-1b.safetensors", "paper"),
    ("vggt", "vggt-1b-commercial.safetensors", "fast"),
    ("vggt+icgn", "vggt-1b.safetensors", "fast"),
    ("tapir", "bootstapir.pt", "fast"),
    ("tapir", "bootstapir-causal.pt", "fast"),
    ("tapir+icgn", "bootstapir.pt", "fast"),
]


def gain_of(tracker, kind, amplitude_px, frames):
    tracks = tracker.track(memory_video(pictures(kind, amplitude_px, frames), 30.0), POINT[None], names=["plate"])
    return measure_gain(tracks["position"].values[:, 0], amplitude_px)


@pytest.mark.weights
@pytest.mark.parametrize(("name", "weights", "preset"), CASES)
def test_gain_of_small_motion(name, weights, preset):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")
    if not os.environ.get(FOLDER):
        pytest.skip(f"no weights; set {FOLDER} to the folder that holds {weights}")
    path = Path(os.environ[FOLDER]) / weights
    if not path.is_file():
        pytest.skip(f"no weights {path}; vfm-sdm weights fetch {path.stem}")
    on_gpu = torch.cuda.is_available()
    if preset == "paper" and not on_gpu:
        pytest.skip("preset paper takes hours without a GPU")
    tracker = find_tracker(name, network=Network(weights=str(path), preset=preset))
    frames = 60 if on_gpu else 10
    print(f"\n{name}, {weights}, preset {preset}, {frames} frames: gain and noise along u, v")
    for kind in KINDS:
        for amplitude_px in AMPLITUDES_PX:
            found = gain_of(tracker, kind, amplitude_px, frames)
            gain, noise = (" ".join(f"{value:7.3f}" for value in pair) for pair in (found.gain, found.noise_px))
            print(f"  {kind:24} {amplitude_px:3} px: gain {gain}   noise {noise} px   seen {found.found:.0%}")
            # The answer is the figures. A tracker that sees nothing, or moves the wrong way, is broken, not imprecise.
            assert found.found > 0.5
            assert min(found.gain) > -0.2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("amplitude_px", AMPLITUDES_PX)
def test_subset_registration_follows_both_kinds(kind, amplitude_px):
    """The pictures are right: registration, which needs no weights, finds a gain of one in all of them."""
    found = gain_of(find_tracker("icgn", subset_px=41), kind, amplitude_px, 16)
    assert found.found == 1
    np.testing.assert_allclose(found.gain, 1, atol=0.01)
    assert max(found.noise_px) < 0.01


def test_a_blind_tracker_has_no_gain():
    rng = np.random.default_rng(3)
    blind = POINT + rng.normal(0, 0.05, (40, 2))
    found = measure_gain(blind, 1.0)
    np.testing.assert_allclose(found.gain, 0, atol=0.05)
    np.testing.assert_allclose(found.noise_px, 0.05, rtol=0.4)


def test_half_a_gain_is_half():
    found = measure_gain(POINT + 0.5 * motion(1.0, 30), 1.0)
    np.testing.assert_allclose(found.gain, 0.5, atol=1e-12)
    lost = np.full((30, 2), np.nan)
    assert measure_gain(lost, 1.0).found == 0
