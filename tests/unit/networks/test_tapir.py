"""TAPIR with small networks of seeded weights: sampling, heads, mixer, chunks, online use, refusals."""

import subprocess
import sys
from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="the networks need torch")

from vfm_sdm.errors import DatasetError, SessionError  # noqa: E402
from vfm_sdm.networks.tapir.config import TapirConfig, refinement_resolutions  # noqa: E402
from vfm_sdm.networks.tapir.initialization import CostVolumeHeads, soft_argmax  # noqa: E402
from vfm_sdm.networks.tapir.mixer import MixerState, TemporalConvolution, TemporalMixer  # noqa: E402
from vfm_sdm.networks.tapir.model import Tapir  # noqa: E402
from vfm_sdm.networks.tapir.results import CausalState, TapirTracks  # noqa: E402
from vfm_sdm.networks.tapir.sampling import correlate_windows, sample_trilinear  # noqa: E402

TINY = TapirConfig(
    iterations=2,
    initial_resolution=(48, 48),
    group_channels=(4, 6, 8, 10),
    extra_blocks=1,
    heatmap_channels=4,
    occlusion_channels=6,
    mixer_channels=8,
    mixer_blocks=2,
)
CAUSAL = replace(TINY, causal=True)
QUERIES = torch.tensor([[0.0, 10.5, 20.25], [2.0, 30.0, 5.0], [4.0, 0.0, 44.0]], dtype=torch.float64)


def seeded(network):
    generator = torch.Generator().manual_seed(7)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) / max(parameter[0].numel(), 4) ** 0.5)
    return network.double().eval()


def random(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


VIDEO = random(5, 40, 44, 3) * 2 - 1


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Networks this small spend their time on waking threads."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def offline():
    return seeded(Tapir(TINY))


@pytest.fixture(scope="module")
def causal():
    return seeded(Tapir(CAUSAL))


def assert_same(one, other, *, atol=1e-9):
    for quantity in ("tracks", "occlusion", "expected_dist"):
        torch.testing.assert_close(getattr(one, quantity), getattr(other, quantity), rtol=0, atol=atol)


# sampling


def test_sampling_a_ramp_returns_the_coordinates():
    t, y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (4, 5, 6)), indexing="ij")
    grid = torch.stack([t, y + 0.5, x + 0.5], dim=1)
    points = torch.tensor([[0.0, 0.5, 0.5], [1.25, 2.0, 3.75], [3.0, 4.5, 5.5], [2.0, 4.0, 1.0]], dtype=torch.float64)
    torch.testing.assert_close(sample_trilinear(grid, points), points, rtol=0, atol=1e-12)


def test_sampling_beyond_the_outermost_centres_holds_the_border():
    grid = random(2, 3, 4, 5)
    points = torch.tensor([[0.0, 0.0, 0.2], [1.0, 4.0, 5.0]], dtype=torch.float64)
    torch.testing.assert_close(sample_trilinear(grid, points), torch.stack([grid[0, :, 0, 0], grid[1, :, 3, 4]]))


def test_windows_at_cell_centres_are_the_cells_with_y_slow_and_zero_outside():
    grid, queries = random(2, 3, 6, 8), random(1, 2, 3, seed=1)
    positions = torch.tensor([[[4.5, 2.5], [0.5, 5.5]]], dtype=torch.float64)
    windows = correlate_windows(grid, positions, queries, radius=1, square_sampling=False).reshape(2, 3, 3)
    cost = torch.einsum("tchw,tc->thw", grid, queries[0])
    torch.testing.assert_close(windows[0], cost[0, 1:4, 3:6])
    corner = torch.zeros(3, 3, dtype=torch.float64)
    corner[:2, 1:] = cost[1, 4:6, 0:2]
    torch.testing.assert_close(windows[1], corner)


def test_square_sampling_looks_up_x_by_the_grid_height():
    grid, queries = random(1, 3, 4, 8), random(1, 1, 3, seed=1)
    at = torch.tensor([[[1.25, 2.5]]], dtype=torch.float64)
    where = {"queries": queries, "radius": 0}
    published = correlate_windows(grid, at, square_sampling=True, **where)
    torch.testing.assert_close(
        published, correlate_windows(grid, at * at.new_tensor([2.0, 1.0]), square_sampling=False, **where)
    )
    square = grid[..., :4]
    torch.testing.assert_close(
        correlate_windows(square, at, square_sampling=True, **where),
        correlate_windows(square, at, square_sampling=False, **where),
    )


# initialisation


def test_soft_argmax_is_the_mean_around_the_best_cell():
    maps = torch.zeros(1, 12, 16, dtype=torch.float64)
    maps[0, 3, 4], maps[0, 3, 8], maps[0, 3, 9], maps[0, 11, 15] = 0.5, 0.25, 0.2, 0.05
    # the last two are five cells away and more
    torch.testing.assert_close(soft_argmax(maps), torch.tensor([[4.5 + 4 / 3, 3.5]], dtype=torch.float64))


def test_heads_find_the_cell_that_looks_like_the_query():
    heads = CostVolumeHeads(TINY).double()
    with torch.no_grad():
        for parameter in heads.parameters():
            parameter.zero_()
        heads.hid1.weight[0, 0, 1, 1] = heads.hid2.weight[0, 0, 1, 1] = 1.0
        heads.occ_out.bias.copy_(torch.tensor([0.25, -0.5]))
    grid = torch.zeros(2, 10, 9, 9, dtype=torch.float64)
    grid[0, :, 2, 6] = grid[1, :, 7, 1] = 5.0
    position, occlusion, expected_dist = heads(torch.ones(1, 10, dtype=torch.float64), grid)
    torch.testing.assert_close(position[0], torch.tensor([[52.0, 20.0], [12.0, 60.0]], dtype=torch.float64))
    assert occlusion.tolist() == [[0.25, 0.25]]
    assert expected_dist.tolist() == [[-0.5, -0.5]]


def test_the_query_frame_starts_at_the_query(offline):
    start = offline.track(VIDEO, QUERIES).iterates[0].tracks
    rows = torch.arange(3)
    torch.testing.assert_close(start[rows, QUERIES[:, 0].long()], QUERIES[:, [2, 1]])


def test_temperature_acts_on_the_initial_positions_only(offline):
    cooler = Tapir(replace(TINY, softmax_temperature=10.0)).double()
    cooler.load_state_dict(offline.state_dict())
    one, other = (network.track(VIDEO, QUERIES).iterates[0] for network in (offline, cooler))
    assert not torch.allclose(one.tracks, other.tracks, atol=1e-3)
    torch.testing.assert_close(one.occlusion, other.occlusion)


# mixer


def test_temporal_convolution_equals_the_grouped_one():
    convolution = seeded(TemporalConvolution(3, 12))
    x = random(2, 7, 3)
    grouped = torch.nn.functional.conv1d(x.transpose(1, 2), convolution.weight, convolution.bias, groups=3)
    torch.testing.assert_close(convolution(x), grouped.transpose(1, 2))


@pytest.mark.parametrize("config", [TINY, CAUSAL])
def test_only_an_offline_mixer_sees_the_future(config):
    mixer = seeded(TemporalMixer(config))
    evidence = random(1, 6, mixer.linear.in_features)
    changed = evidence.clone()
    changed[:, 3] += 1.0
    difference = (mixer(evidence)[0] - mixer(changed)[0]).abs().amax(dim=(0, 2))
    assert (difference[3:] > 1e-6).all()
    assert (difference[2] > 1e-6) == (not config.causal)


def test_causal_mixer_in_parts_is_the_mixer_at_once():
    mixer = seeded(TemporalMixer(CAUSAL))
    evidence = random(2, 6, mixer.linear.in_features)
    whole, end = mixer(evidence)
    parts, state = [], None
    for piece in torch.split(evidence, [1, 3, 2], dim=1):
        made, state = mixer(piece, state)
        parts.append(made)
    torch.testing.assert_close(torch.cat(parts, dim=1), whole)
    torch.testing.assert_close(state.normalized, end.normalized)
    torch.testing.assert_close(state.activated, end.activated)


# the whole network


def test_shapes_iterates_and_types(offline):
    result = offline.track(VIDEO.float(), QUERIES.float(), resolutions=[(48, 48), (64, 80)])
    assert result.tracks.shape == (3, 5, 2)
    assert result.occlusion.shape == result.expected_dist.shape == result.visible.shape == (3, 5)
    assert result.tracks.dtype == torch.float64
    assert result.visible.dtype == torch.bool
    assert len(result.iterates) == 5
    torch.testing.assert_close(result.tracks, (result.iterates[2].tracks + result.iterates[4].tracks) / 2)
    torch.testing.assert_close(result.occlusion, (result.iterates[2].occlusion + result.iterates[4].occlusion) / 2)


def test_shifts_are_pixels_of_the_resized_video_and_logits_start_anew_at_each_resolution():
    network = seeded(Tapir(TINY))
    update = network.torch_pips_mixer.linear_1
    with torch.no_grad():
        update.weight.zero_()
        update.bias.zero_()
        update.bias[:4] = torch.tensor([1.0, -2.0, 0.5, 0.25])
    iterates = network.track(VIDEO, QUERIES, resolutions=[(48, 48), (56, 64)]).iterates
    start = iterates[0]
    first, second = (torch.tensor([44 / w, -2 * 40 / h], dtype=torch.float64) for h, w in ((48, 48), (56, 64)))
    moved = (first, 2 * first, 2 * first + second, 2 * first + 2 * second)
    for iterate, shift, count in zip(iterates[1:], moved, (1, 2, 1, 2), strict=True):
        torch.testing.assert_close(iterate.tracks, start.tracks + shift)
        torch.testing.assert_close(iterate.occlusion, start.occlusion + 0.5 * count)
        torch.testing.assert_close(iterate.expected_dist, start.expected_dist + 0.25 * count)


def test_visible_is_the_product_of_both_probabilities():
    logits = torch.tensor([[-5.0, -5.0, 5.0, -0.5]])
    others = torch.tensor([[-5.0, 5.0, -5.0, -0.5]])
    assert TapirTracks(torch.zeros(1, 4, 2), logits, others).visible.tolist() == [[True, False, False, False]]


def test_runs_repeat_exactly_under_inference_mode(offline):
    with torch.inference_mode():
        one, other = offline.track(VIDEO, QUERIES), offline.track(VIDEO, QUERIES)
    assert_same(one, other, atol=0.0)
    assert_same(one, offline.track(VIDEO, QUERIES))


def test_single_precision_agrees_with_double(offline):
    single = Tapir(TINY)
    single.load_state_dict(offline.state_dict())
    result = single.track(VIDEO, QUERIES)
    assert result.tracks.dtype == torch.float32
    exact = offline.track(VIDEO, QUERIES)
    for quantity in ("tracks", "occlusion", "expected_dist"):
        torch.testing.assert_close(getattr(result, quantity).double(), getattr(exact, quantity), rtol=0, atol=2e-3)


def test_points_do_not_see_one_another(offline):
    together = offline.track(VIDEO, QUERIES)
    for index in range(3):
        alone = offline.track(VIDEO, QUERIES[[index]])
        row = TapirTracks(*(value[[index]] for value in (together.tracks, together.occlusion, together.expected_dist)))
        assert_same(alone, row)


@pytest.mark.parametrize(("frame_chunk", "query_chunk"), [(1, 1), (2, 2), (100, 100)])
def test_chunks_change_nothing(offline, frame_chunk, query_chunk):
    chunked = offline.track(VIDEO, QUERIES, frame_chunk=frame_chunk, query_chunk=query_chunk)
    assert_same(chunked, offline.track(VIDEO, QUERIES, frame_chunk=3, query_chunk=3))
    assert len(chunked.iterates) == 3


def test_a_single_frame_is_a_video(offline):
    result = offline.track(VIDEO[:1], QUERIES[:1])
    assert result.tracks.shape == (1, 1, 2)
    assert result.tracks.isfinite().all()


def test_the_published_quirk_shows_on_wide_grids_only(offline):
    meant = Tapir(replace(TINY, square_sampling=False)).double()
    meant.load_state_dict(offline.state_dict())
    assert_same(meant.track(VIDEO, QUERIES), offline.track(VIDEO, QUERIES))
    wide = [(48, 64)]
    one, other = (network.track(VIDEO, QUERIES, resolutions=wide) for network in (meant, offline))
    assert not torch.allclose(one.occlusion, other.occlusion, atol=1e-4)


def test_equal_resolutions_share_their_features(offline, monkeypatch):
    made = []
    backbone = offline.feature_grids
    monkeypatch.setattr(offline, "feature_grids", lambda *a, **k: made.append(a[1]) or backbone(*a, **k))
    offline.track(VIDEO, QUERIES, resolutions=[(48, 48), (48, 48), (56, 48)])
    assert made == [(48, 48), (56, 48)]


def test_plain_tapir_has_neither_extra_convolutions_nor_a_pooled_grid():
    plain = seeded(Tapir(replace(TINY, pyramid_level=0, extra_convs=False)))
    assert not any(key.startswith("extra_convs") for key in plain.state_dict())
    assert plain.feature_grids(VIDEO, (48, 48)).pooled == ()
    assert plain.track(VIDEO, QUERIES).tracks.isfinite().all()


def test_presets():
    assert TapirConfig.bootstapir() == TapirConfig()
    assert TapirConfig.bootstapir_causal(softmax_temperature=10.0) == TapirConfig(causal=True, softmax_temperature=10.0)
    assert TapirConfig.tapir_panning(square_sampling=False) == TapirConfig(
        pyramid_level=0, extra_convs=False, square_sampling=False
    )


@pytest.mark.parametrize(
    ("image_size", "resolutions"),
    [
        ((256, 256), [(256, 256)]),
        ((96, 128), [(256, 256)]),
        ((256, 384), [(256, 256), (256, 384)]),
        ((294, 294), [(256, 256), (288, 288)]),
        ((2048, 2048), [(256, 256), (512, 512), (1024, 1024), (2048, 2048)]),
        ((1080, 1920), [(256, 256), (408, 496), (664, 976), (1080, 1920)]),
        ((128, 512), [(256, 256), (128, 512)]),
    ],
)
def test_default_resolutions(image_size, resolutions):
    assert list(refinement_resolutions(image_size, (256, 256))) == resolutions


def test_importing_the_package_needs_no_torch():
    code = "import sys, vfm_sdm.networks.tapir.config; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


# online


def run_online(network, video, queries, query_frame, **options):
    features = network.query_features(video[query_frame], queries, **options)
    state = network.initial_state(len(queries), n_resolutions=len(features.resolutions))
    steps = []
    for frame in video:
        steps.append(network.step(frame, features, state))
        state = steps[-1].state
    return TapirTracks(*(torch.stack([step[part] for step in steps], dim=1) for part in range(3))), steps


def test_online_is_offline_up_to_the_query_frame(causal):
    """The offline run differs by the query point as a start in its frame, which a causal network sees from then on."""
    at_the_end = QUERIES.clone()
    at_the_end[:, 0] = 4.0
    offline = causal.track(VIDEO, at_the_end)
    online, steps = run_online(causal, VIDEO, QUERIES * torch.tensor([0.0, 1.0, 1.0]), query_frame=4)
    before = [value[:, :4] for value in (offline.tracks, offline.occlusion, offline.expected_dist)]
    assert_same(
        TapirTracks(online.tracks[:, :4], online.occlusion[:, :4], online.expected_dist[:, :4]), TapirTracks(*before)
    )
    assert not torch.allclose(online.occlusion[:, 4], offline.occlusion[:, 4], atol=1e-6)
    assert steps[0].visible.tolist() == online.visible[:, 0].tolist()


def test_online_answer_is_the_last_resolution(causal):
    resolutions = [(48, 48), (56, 64)]
    at_the_end = QUERIES.clone()
    at_the_end[:, 0] = 4.0
    offline = causal.track(VIDEO, at_the_end, resolutions=resolutions).iterates[-1]
    first = QUERIES * torch.tensor([0.0, 1.0, 1.0])
    online, _ = run_online(causal, VIDEO, first, query_frame=4, resolutions=resolutions)
    torch.testing.assert_close(online.tracks[:, :4], offline.tracks[:, :4])


def test_a_step_leaves_its_state_as_it_was(causal):
    features = causal.query_features(VIDEO[0], QUERIES[:1])
    start = causal.initial_state(1)
    one = causal.step(VIDEO[1], features, start)
    again = causal.step(VIDEO[1], features, start)
    assert torch.equal(one.tracks, again.tracks)
    assert not start.refinements[0].activated.any()
    assert one.state.refinements[0].activated.any()
    later = causal.step(VIDEO[1], features, one.state)
    assert not torch.allclose(later.occlusion, one.occlusion, atol=1e-6)


# refusals


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"iterations": 0}, "every count at least 1"),
        ({"group_channels": (1, 2, 3)}, "four group_channels"),
        ({"pyramid_level": -1}, "pyramid_level and window_radius of at least 0"),
        ({"softmax_temperature": float("nan")}, "softmax_temperature: expected a positive number, got nan"),
        ({"initial_resolution": (250, 256)}, "multiples of 8 px"),
    ],
)
def test_configurations_that_cannot_be(change, match):
    with pytest.raises(SessionError, match=match):
        TapirConfig(**change)


@pytest.mark.parametrize(
    ("video", "match"),
    [
        (VIDEO[0], r"expected shape \(T, H, W, 3\)"),
        (VIDEO[:0], r"got \(0, 40, 44, 3\)"),
        (VIDEO.movedim(-1, 1), "reshape it"),
        ((VIDEO * 127).to(torch.uint8), r"expected floats in \[-1, 1\], got torch.uint8"),
        (VIDEO * 127, "divide and shift"),
        (torch.full((1, 8, 8, 3), torch.nan), "got nan to nan"),
    ],
)
def test_videos_that_are_refused(offline, video, match):
    with pytest.raises(DatasetError, match=match):
        offline.track(video, QUERIES[:1])


@pytest.mark.parametrize(
    ("queries", "match"),
    [
        (QUERIES[0], r"expected shape \(N, 3\)"),
        (QUERIES[:0], r"got \(0, 3\)"),
        (torch.tensor([[5.0, 1.0, 1.0]]), r"from 0 to \(4.0, 40.0, 44.0\), got \(5.0, 1.0, 1.0\)"),
        (torch.tensor([[0.0, 42.0, 1.0]]), "give frame index and pixels"),
        (torch.tensor([[0.0, torch.nan, 1.0]]), "got \\(0.0, nan, 1.0\\)"),
    ],
)
def test_queries_that_are_refused(offline, queries, match):
    with pytest.raises(DatasetError, match=match):
        offline.track(VIDEO, queries)


def test_resolutions_and_chunks_that_are_refused(offline):
    with pytest.raises(SessionError, match=r"multiples of 8 px from 16 px on, got \(48, 50\)"):
        offline.track(VIDEO, QUERIES, resolutions=[(48, 50)])
    with pytest.raises(SessionError, match=r"got \(8, 8\)"):
        offline.track(VIDEO, QUERIES, resolutions=[(8, 8)])
    with pytest.raises(DatasetError, match="resolutions: expected at least one"):
        offline.track(VIDEO, QUERIES, resolutions=[])
    with pytest.raises(DatasetError, match="chunks: expected at least 1, got 0 frames"):
        offline.track(VIDEO, QUERIES, frame_chunk=0)


def test_online_use_that_is_refused(offline, causal):
    with pytest.raises(SessionError, match="expected a causal network"):
        offline.initial_state(1)
    with pytest.raises(DatasetError, match=r"got \(2.0, 30.0, 5.0\)"):
        causal.query_features(VIDEO[0], QUERIES)
    features = causal.query_features(VIDEO[0], QUERIES[:1])
    with pytest.raises(DatasetError, match=r"expected the query frame's size \(40, 44\), got \(20, 44\)"):
        causal.step(VIDEO[0, :20], features, causal.initial_state(1))
    with pytest.raises(DatasetError, match=r"expected 2 refinements .* got 4 of"):
        causal.step(VIDEO[0], features, causal.initial_state(1, n_resolutions=2))
    mixer = causal.initial_state(3).refinements[0]
    with pytest.raises(DatasetError, match="start from initial_state"):
        causal.step(VIDEO[0], features, CausalState((MixerState(mixer.normalized, mixer.activated),) * 2))
