"""`benchmarks/vggt.py` at its smallest size, and the formulas by which it counts operations."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmark_lines import read_last_line, without_unit

torch = pytest.importorskip("torch")

from torch.nn.attention import SDPBackend, sdpa_kernel  # noqa: E402
from torch.utils.flop_counter import FlopCounterMode  # noqa: E402

from small_networks import ROUNDING_PX  # noqa: E402
from vfm_sdm.networks.vggt.config import VggtConfig  # noqa: E402
from vfm_sdm.networks.vggt.correlation import correlate, make_pyramid  # noqa: E402

FOLDER = Path(__file__).parents[2] / "benchmarks"
TINY = VggtConfig(
    image_size=56, width=32, registers=3, encoder_depth=2, encoder_heads=2, depth=3, heads=2, camera_depth=2,
    camera_heads=2, camera_iterations=3, feature_layers=(0, 1, 1, 2), feature_channels=(8, 12, 16, 20), features=16,
    hidden=24, track_heads=2, track_depth=2, virtual_tracks=5, levels=3, radius=2, track_iterations=3,
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    """Threads that wait for each other on a busy machine take many times as long."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def benchmark():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        yield importlib.import_module("vggt")
        for name in ("vggt", "vggt_costs"):
            sys.modules.pop(name)


@pytest.fixture
def network(benchmark):
    return benchmark.make_network(TINY, torch.device("cpu"), 0, camera=True, track=True).requires_grad_(False)


def counted(run):
    with torch.no_grad(), sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as counter:
        run()
    return counter.get_total_flops()


@pytest.mark.parametrize(("height", "width", "points"), [(42, 70, 1), (56, 56, 3)])
def test_tracking_has_as_many_operations_as_the_formula_says(benchmark, network, height, width, points):
    images, queries = torch.rand(5, 3, height, width), torch.full((points, 1, 2), 20.0)
    formula = benchmark.count_tracking(TINY, 5, height, width, points)
    assert counted(lambda: network.track(images, queries)) == sum(formula.values())
    assert counted(lambda: network.features(images)) == sum(formula.values()) - formula["tracker"]
    assert counted(lambda: network.aggregator(images, (2,))) == (
        formula["encoder"] + formula["within frames"] + formula["across frames"]
    )


def test_cameras_have_as_many_operations_as_the_formula_says(benchmark, network):
    found = counted(lambda: network.estimate_poses(torch.rand(2, 3, 42, 70)))
    assert found == benchmark.count_cameras(TINY, 2, 42, 70)


def test_the_papers_480_frames_are_four_chunks_and_the_stated_number_of_operations(benchmark):
    size = benchmark.SIZES["full"]
    chunks = benchmark.planned_chunks(size.presets["paper"].plan, 480)
    assert chunks == [144] * 4
    # 7.5 s at the 780 to 790 TFLOP/s of an H200.
    assert sum(benchmark.count_chunks(size, "paper", chunks).values()) == pytest.approx(5.92e15, rel=0.002)


def test_whole_volumes_give_the_sampled_correlation(benchmark):
    rng = torch.Generator().manual_seed(3)
    pyramid = make_pyramid(torch.randn(4, 9, 13, 6, generator=rng, dtype=torch.float64), 4)
    tracks = torch.randn(2, 4, 6, generator=rng, dtype=torch.float64)
    positions = 16 * torch.rand(2, 4, 2, generator=rng, dtype=torch.float64) - 2
    whole = benchmark.correlate_volumes(pyramid, tracks, positions, radius=2)
    np.testing.assert_allclose(whole, correlate(pyramid, tracks, positions, radius=2), atol=1e-12)


def test_baseline_yields_the_packages_tracks(benchmark, network):
    """In double precision, where the iterations amplify rounding to 2e-10 px instead of 0.1."""
    device = benchmark.Device("cpu")
    network.double()
    rng = np.random.default_rng(0)
    frames, points = rng.integers(0, 256, (4, 56, 56, 3), np.uint8), rng.uniform(15, 40, (2, 2))
    ours = benchmark.VggtInference(network, device.placement).follow(frames, points)
    plain = benchmark.Baseline(network, device.torch).follow(frames, points)
    assert np.ptp(ours.positions[:, 0], axis=0).max() > 1
    np.testing.assert_allclose(plain.positions, ours.positions, rtol=0, atol=ROUNDING_PX)
    np.testing.assert_allclose(plain.visibility, ours.visibility, rtol=0, atol=ROUNDING_PX)


def test_modelled_memory_grows_with_frames_and_holds_the_weights(benchmark, network):
    few, many = (benchmark.modelled_peak_gb(TINY, frames, 42, 70) for frames in (4, 8))
    tracking = sum(p.numel() for n, p in network.named_parameters() if not n.startswith("camera_head"))
    assert 2 * tracking / 1e9 < few < many < 2 * few


def test_smallest_size_runs_and_says_that_it_is_reduced(benchmark, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "modelled_peak_gb", lambda *_: 1.0)  # some seconds each
    monkeypatch.setattr(sys, "argv", ["vggt.py", "--device", "cpu", "--frames", "9", "--baseline-frames", "8"])
    benchmark.main()
    lines = capsys.readouterr().out.splitlines()
    assert any("reduced size" in line for line in lines)
    assert any("extrapolated" in line for line in lines)
    _, summary = read_last_line("\n".join(lines))
    assert list(without_unit(summary)) == []
    assert summary["reduced"]
    assert summary["frames"] == 9
    assert {"device", "cameras_2_frames_s", "matrix_rate_tflops"} <= set(summary)
    for name in ("paper", "fast"):
        for key in (
            "tracking_480x1_s", "floor_s", "ratio_to_floor", "peak_memory_gb", "six_points_ratio", "baseline_s"
        ):  # fmt: skip
            assert summary[name][key] > 0, (name, key)
        assert summary[name]["frames"] == 9
