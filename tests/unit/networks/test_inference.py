"""Networks on arrays: placement, memory, mapping of pixels, and weights from a file."""

import gc
import os

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")

from safetensors.torch import save_file  # noqa: E402

from small_networks import ROUNDING_PX, in_double, small_tapir, small_vggt, tapir_on_cpu, vggt_on_cpu  # noqa: E402
from vfm_sdm.errors import BackendUnavailableError, DatasetError  # noqa: E402
from vfm_sdm.networks.device import Placement, choose_placement  # noqa: E402
from vfm_sdm.networks.tapir import inference as tapir_inference  # noqa: E402
from vfm_sdm.networks.tapir.inference import TapirInference, choose_config  # noqa: E402
from vfm_sdm.networks.vggt import inference as vggt_inference  # noqa: E402
from vfm_sdm.networks.vggt.inference import VggtInference  # noqa: E402

QUERIES = np.array([[60.25, 70.5], [80.0, 64.75], [90.0, 100.0]])


@pytest.fixture(scope="module")
def frames():
    return np.random.default_rng(0).integers(0, 256, (4, 140, 154, 3), dtype=np.uint8)


@pytest.fixture(scope="module", params=["vggt", "tapir"])
def inference(request):
    return vggt_on_cpu(camera=False) if request.param == "vggt" else tapir_on_cpu()


def test_tracks_of_a_chunk_are_finite_and_start_near_the_queries(inference, frames):
    found = inference.follow(frames[:, :136, :152] if isinstance(inference, TapirInference) else frames, QUERIES)
    assert found.positions.shape == (4, 3, 2)
    assert found.visibility.shape == found.confidence.shape == (4, 3)
    assert np.isfinite(found.positions).all()
    assert found.positions.dtype == np.float64
    for share in (found.visibility, found.confidence):
        assert (share >= 0).all()
        assert (share <= 1).all()


def test_vggt_gives_the_query_back_in_the_first_frame(frames):
    found = vggt_on_cpu(camera=False).follow(frames, QUERIES)
    np.testing.assert_allclose(found.positions[0], QUERIES, atol=1e-5)


def test_points_of_a_chunk_are_followed_as_if_alone(inference, frames):
    """Points that see each other differ by a pixel and more."""
    pictures = frames[:, :136, :152] if isinstance(inference, TapirInference) else frames
    with in_double(inference):
        together = inference.follow(pictures, QUERIES).positions
        alone = [inference.follow(pictures, query[None]).positions[:, 0] for query in QUERIES]
    np.testing.assert_allclose(np.stack(alone, axis=1), together, rtol=0, atol=ROUNDING_PX)


def test_tapir_measures_from_the_centre_of_the_first_pixel(frames):
    """The network has the corner at (0, 0): half a pixel goes in and comes out."""
    inference = tapir_on_cpu()
    video = torch.from_numpy(frames[:, :136, :152]).float() / 255 * 2 - 1
    asked = torch.tensor([[0.0, v + 0.5, u + 0.5] for u, v in QUERIES])
    with inference.placement.running():
        expected = inference.network.track(video, asked).tracks.transpose(0, 1).numpy() - 0.5
    np.testing.assert_allclose(inference.follow(frames[:, :136, :152], QUERIES).positions, expected, atol=1e-5)


def test_poses_are_those_of_the_last_iteration(frames):
    inference = vggt_on_cpu(track=False)
    with inference.placement.running():
        expected = inference.network.estimate_poses(torch.from_numpy(frames).permute(0, 3, 1, 2).float() / 255)[-1]
    np.testing.assert_array_equal(inference.estimate_poses(frames), expected.double().numpy())


def test_wrong_sizes_are_refused(frames):
    with pytest.raises(DatasetError, match="multiples of 14"):
        vggt_on_cpu().estimate_poses(frames[:, :139])
    with pytest.raises(DatasetError, match="at least 128 px"):
        vggt_on_cpu().follow(frames[:, :126, :126], QUERIES[:1])


def test_memory_decides_how_many_frames_fit(inference, monkeypatch):
    monkeypatch.setattr(Placement, "free_bytes", lambda self: 10**9)
    one, quarter = inference.plan_frames(140, 140), inference.plan_frames(280, 280)
    assert one > 0
    assert one / 5 < quarter < one / 3.5
    monkeypatch.setattr(Placement, "free_bytes", lambda self: None)
    assert inference.plan_frames(140, 140) is None


def test_the_published_network_plans_the_papers_chunk_into_ten_gigabytes(monkeypatch):
    """Of a 144-frame chunk with reduced precision, without the weights (2 GB); the paper needed 41.2 GB."""
    with torch.device("meta"):
        network = vggt_inference.Vggt(camera=False)
    inference = VggtInference.__new__(VggtInference)
    inference.network, inference.placement = network, Placement(torch.device("cpu"), reduced=True)
    monkeypatch.setattr(Placement, "free_bytes", lambda self: 8 * 10**9)
    assert inference.plan_frames(294, 518) >= 144


def test_reduced_precision_halves_matrices_and_spares_what_positions_are_read_off():
    inference = VggtInference(small_vggt(), Placement(torch.device("cpu"), reduced=True))
    network = inference.network
    assert network.aggregator.frame_blocks[0].attn.qkv.weight.dtype == torch.bfloat16
    assert network.aggregator.frame_blocks[0].norm1.weight.dtype == torch.float32
    assert network.track_head.feature_extractor.projects[0].weight.dtype == torch.float32
    assert network.camera_head.pose_branch.fc1.weight.dtype == torch.float32
    assert inference.precision == "bfloat16"
    frames = np.random.default_rng(1).integers(0, 256, (3, 140, 140, 3), dtype=np.uint8)
    assert np.isfinite(inference.follow(frames, QUERIES).positions).all()
    assert np.abs(inference.estimate_poses(frames) - vggt_on_cpu().estimate_poses(frames)).max() < 0.05


def test_memory_that_runs_out_is_a_memory_error():
    placement = choose_placement("cpu")
    with pytest.raises(MemoryError, match="can't allocate memory"), placement.running():
        raise RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 1 bytes")
    with pytest.raises(MemoryError, match="out of memory"), placement.running():
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB")
    with pytest.raises(RuntimeError, match="shapes"), placement.running():
        raise RuntimeError("shapes do not fit")


def test_a_real_shortage_is_recognised():
    with pytest.raises(MemoryError), choose_placement("cpu").running():
        torch.empty(2**50, dtype=torch.uint8)


def test_devices_that_are_not_here_are_refused():
    with pytest.raises(BackendUnavailableError, match="expected one that PyTorch can use here, got 'quantum'; set"):
        choose_placement("quantum")
    if not torch.cuda.is_available():
        with pytest.raises(BackendUnavailableError, match="got 'cuda:0'"):
            choose_placement("cuda:0")
        assert choose_placement().device.type == "cpu"
    assert choose_placement("cpu", "bfloat16").precision == "bfloat16"
    assert choose_placement("cpu").precision == "float32"
    assert choose_placement("cpu").free_bytes() is None or choose_placement("cpu").free_bytes() > 10**6


@pytest.mark.parametrize(
    ("name", "causal", "level"),
    [("bootstapir.pt", False, 1), ("causal_bootstapir_checkpoint.pt", True, 1), ("tapir-panning.pt", False, 0)],
)
def test_the_name_of_the_weights_tells_the_network(name, causal, level):
    config = choose_config(f"/some/folder/{name}")
    assert (config.causal, config.pyramid_level) == (causal, level)


def assert_same_weights(found, expected):
    """Bit for bit, where results are so only if both lie in memory alike; what was left out is not compared."""
    left_out = getattr(found, "heads_left_out", ())
    expected = {key: value for key, value in expected.state_dict().items() if not key.startswith(left_out)}
    found = found.state_dict()
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[key], value) for key, value in expected.items())


def test_weights_of_a_file_are_loaded_strictly_and_unused_heads_are_skipped(tmp_path, monkeypatch, frames):
    whole = small_vggt(seed=4)
    others = {"depth_head.norm.weight": torch.zeros(3), "point_head.norm.weight": torch.zeros(3)}
    state = {key: value.contiguous() for key, value in whole.state_dict().items()}
    save_file({**state, **others}, tmp_path / "vggt.safetensors")
    monkeypatch.setattr(vggt_inference, "Vggt", lambda **heads: small_vggt(seed=9, **heads))
    loaded = VggtInference.load(str(tmp_path / "vggt.safetensors"), device="cpu", track=True)
    assert loaded.network.heads_left_out == ("camera_head", "depth_head", "point_head")
    assert_same_weights(loaded.network, whole)
    assert np.isfinite(loaded.follow(frames, QUERIES).positions).all()
    del state["track_head.tracker.fmap_norm.weight"]
    save_file(state, tmp_path / "cut.safetensors")
    with pytest.raises(BackendUnavailableError, match=r"1 missing \(track_head.tracker.fmap_norm.weight 16\)"):
        VggtInference.load(str(tmp_path / "cut.safetensors"), device="cpu", track=True)


def test_tapir_loads_its_file(tmp_path, monkeypatch, frames):
    torch.save(small_tapir(seed=3).state_dict(), tmp_path / "bootstapir.pt")
    monkeypatch.setattr(tapir_inference, "Tapir", lambda config: small_tapir(seed=8))
    loaded = TapirInference.load(str(tmp_path / "bootstapir.pt"), device="cpu")
    assert_same_weights(loaded.network, small_tapir(seed=3))
    assert np.isfinite(loaded.follow(frames[:, :136, :152], QUERIES).positions).all()


def test_one_network_serves_all_who_load_the_same_weights(tmp_path, monkeypatch, frames):
    whole = small_vggt(seed=4)
    path = tmp_path / "vggt.safetensors"
    save_file({key: value.contiguous() for key, value in whole.state_dict().items()}, path)
    built = []

    def build(**heads):
        built.append(heads)
        return small_vggt(seed=9, **heads)

    monkeypatch.setattr(vggt_inference, "Vggt", build)
    tracker = VggtInference.load(str(path), device="cpu", track=True)
    aggregator = tracker.network.aggregator
    cameras = VggtInference.load(str(path), device="cpu", camera=True)
    assert cameras is tracker
    assert cameras.network.aggregator is aggregator
    # The second one added its head; its weights are those of the file.
    assert built == [{"camera": False, "track": True}, {"camera": True, "track": False}]
    assert_same_weights(cameras.network, whole)
    assert VggtInference.load(str(path), device="cpu", track=True, camera=True) is tracker
    assert len(built) == 2
    # Other weights under the same name are another network.
    save_file({key: value.contiguous() for key, value in small_vggt(seed=5).state_dict().items()}, path)
    os.utime(path, ns=(1, 1))
    assert VggtInference.load(str(path), device="cpu", track=True) is not tracker


def test_a_network_that_nobody_holds_is_let_go(tmp_path, monkeypatch):
    path = tmp_path / "vggt.safetensors"
    save_file({key: value.contiguous() for key, value in small_vggt(seed=4).state_dict().items()}, path)
    monkeypatch.setattr(vggt_inference, "Vggt", lambda **heads: small_vggt(seed=9, **heads))
    known = len(vggt_inference._LOADED)
    held = VggtInference.load(str(path), device="cpu", track=True)
    assert len(vggt_inference._LOADED) == known + 1
    del held
    gc.collect()
    assert len(vggt_inference._LOADED) == known
