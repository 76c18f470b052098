"""VGGT's parts on their own: what depends on what, closed forms, and references that are slower but plain."""

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")

from torch.nn import functional as F  # noqa: E402

from small_networks import ROUNDING_PX  # noqa: E402
from vfm_sdm.errors import DatasetError  # noqa: E402
from vfm_sdm.networks.vggt import feature_head  # noqa: E402
from vfm_sdm.networks.vggt.config import VggtConfig  # noqa: E402
from vfm_sdm.networks.vggt.correlation import correlate, make_pyramid, sample_linear  # noqa: E402
from vfm_sdm.networks.vggt.model import HEADS, Vggt  # noqa: E402
from vfm_sdm.networks.vggt.rotary import rotary_table, rotate, turns  # noqa: E402
from vfm_sdm.networks.vggt.tracker import embed_flow, embed_place  # noqa: E402

SMALL = VggtConfig(
    image_size=56,
    width=32,
    registers=2,
    encoder_depth=1,
    encoder_heads=2,
    depth=4,
    heads=2,
    camera_depth=1,
    camera_heads=2,
    camera_iterations=2,
    feature_layers=(0, 1, 2, 3),
    feature_channels=(8, 8, 8, 8),
    features=16,
    hidden=16,
    track_heads=2,
    track_depth=2,
    virtual_tracks=3,
    levels=3,
    radius=2,
    track_iterations=3,
)
LATER_SWAPPED, FIRST_SWAPPED = [0, 2, 1], [1, 0, 2]


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def random(generator, *shape):
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def random_images(generator, frames, height, width):
    return torch.rand((frames, 3, height, width), generator=generator, dtype=torch.float64)


def random_network(generator, config=SMALL, **heads):
    """Double precision, weights of ordinary size."""
    with torch.device("meta"):
        network = Vggt(config, **heads).requires_grad_(False)
    state = {}
    for key, value in network.state_dict().items():
        noise = random(generator, *value.shape)
        if value.ndim == 1:
            state[key] = 0.1 * noise + (not key.endswith("bias"))
        else:
            state[key] = noise / math.prod(value.shape[1:]) ** 0.5 if key.endswith("weight") else 0.5 * noise
    network.load_state_dict(state, assign=True)
    return network


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """The networks are too small for more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def network():
    return random_network(seeded())


@pytest.fixture(scope="module")
def tracker(network):
    return network.track_head.tracker


@pytest.fixture(scope="module")
def features():
    """Maps of five frames, as for images of 28 x 42 px."""
    return random(seeded(1), 5, SMALL.features, 14, 21)


@pytest.fixture(scope="module")
def queries():
    """Column and row of six points [px]."""
    return torch.rand((6, 2), generator=seeded(2), dtype=torch.float64) * torch.tensor([42.0, 28.0])


def same(found, expected, tolerance=ROUNDING_PX):
    torch.testing.assert_close(found, expected, rtol=0, atol=tolerance)


def differ(found, other, least=1e-3):
    assert (found - other).abs().max() > least


def decoupled(network):
    """The same network, whose points cannot see the virtual tracks."""
    other = random_network(seeded())
    other.load_state_dict(network.state_dict())
    for block in other.track_head.tracker.updateformer.space_point2virtual_blocks:
        block.cross_attn.out_proj.weight.zero_()
        block.cross_attn.out_proj.bias.zero_()
    return other


# Points, groups and frames


def test_groups_run_together_as_alone(tracker, features, queries):
    groups = queries.unflatten(0, (3, 2))
    together = tracker(features, groups)
    for index in range(3):
        alone = tracker(features, groups[index : index + 1])
        same(together.positions[:, index], alone.positions[:, 0])
        same(together.visibility[index], alone.visibility[0])
        same(together.confidence[index], alone.confidence[0])


def test_points_of_a_group_see_each_other_through_the_virtual_tracks_only(network, tracker, features, queries):
    differ(tracker(features, queries[None]).positions[:, 0], tracker(features, queries[:, None]).positions[:, :, 0])
    blind = decoupled(network).track_head.tracker
    same(blind(features, queries[None]).positions[:, 0], blind(features, queries[:, None]).positions[:, :, 0])


def test_order_of_points_does_not_matter(tracker, features, queries):
    order = [3, 0, 5, 1, 2, 4]
    same(tracker(features, queries[order][None]).positions, tracker(features, queries[None]).positions[:, :, order])


def test_tracks_start_at_the_queries(tracker, features, queries):
    tracks = tracker(features, queries[None])
    assert tracks.positions.shape == (SMALL.track_iterations, 1, 6, 5, 2)
    assert tracks.visibility.shape == tracks.confidence.shape == (1, 6, 5)
    assert torch.equal(tracks.positions[:, 0, :, 0], queries.expand(SMALL.track_iterations, -1, -1))
    differ(tracks.positions[:, 0, :, 1:], queries[:, None].expand(-1, 4, -1))
    assert ((tracks.visibility > 0) & (tracks.visibility < 1) & (tracks.confidence > 0)).all()


def test_one_frame_is_its_own_first(tracker, features, queries):
    same(tracker(features[:1], queries[None]).positions[-1, 0, :, 0], queries, 0)


def test_tracks_know_the_first_frame_but_no_order_of_the_others(tracker, features, queries):
    usual = tracker(features[:3], queries[None]).positions
    same(tracker(features[LATER_SWAPPED], queries[None]).positions, usual[:, :, :, LATER_SWAPPED])
    differ(tracker(features[FIRST_SWAPPED], queries[None]).positions, usual[:, :, :, FIRST_SWAPPED])


def test_tokens_and_poses_know_the_first_frame_but_no_order_of_the_others(network):
    images = random_images(seeded(3), 3, 28, 42)
    tokens, poses = network.aggregator(images, (3,))[3], network.estimate_poses(images)
    assert poses.shape == (SMALL.camera_iterations, 3, 9)
    same(network.aggregator(images[LATER_SWAPPED], (3,))[3], tokens[LATER_SWAPPED])
    same(network.estimate_poses(images[LATER_SWAPPED]), poses[:, LATER_SWAPPED])
    differ(network.aggregator(images[FIRST_SWAPPED], (3,))[3], tokens[FIRST_SWAPPED])
    differ(network.estimate_poses(images[FIRST_SWAPPED]), poses[:, FIRST_SWAPPED])


def test_frames_see_each_other(network):
    images = random_images(seeded(3), 3, 28, 42)
    differ(network.features(images[:1]), network.features(images)[:1])


# Correlation and sampling


def on_grid(positions, rows, columns):
    """Cells to the coordinates of `grid_sample` with aligned corners; a side of one cell has no scale."""
    return 2 * positions / torch.tensor([max(columns - 1, 1), max(rows - 1, 1)]) - 1


def whole_volume_correlation(pyramid, tracks, positions, radius):
    steps = torch.arange(-radius, radius + 1)
    offsets = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), dim=-1)  # columns first, so that they are slow
    found = []
    for level, maps in enumerate(pyramid):
        volume = torch.einsum("tsc,shwc->tshw", tracks, maps).flatten(0, 1) / tracks.shape[-1] ** 0.5
        places = (positions / 2**level)[:, :, None, None] + offsets
        grid = on_grid(places.flatten(0, 1), *maps.shape[1:3])
        window = F.grid_sample(volume[:, None], grid, padding_mode="zeros", align_corners=True)
        found.append(window.reshape(*tracks.shape[:2], -1))
    return torch.cat(found, dim=-1)


def places_on(rows, columns, count, generator):
    """Corners, cells, places between, on and beyond the border; shape (count + 9, 2)."""
    limit = torch.tensor([columns - 1.0, rows - 1.0], dtype=torch.float64)
    chosen = [[0, 0], [1, 1], [0.5, 0.25], [1, 0.5], [0, 0.999], [-0.5, 0.5], [1.01, 1.2], [-40, 3], [30, -1e4]]
    between = torch.rand((count, 2), generator=generator, dtype=torch.float64) * 1.4 - 0.2
    return torch.cat([torch.tensor(chosen, dtype=torch.float64), between]) * limit.clamp(min=1)


@pytest.mark.parametrize(
    ("rows", "columns", "levels"), [(12, 17, 3), (8, 5, 3), (5, 9, 2), (1, 6, 1), (1, 1, 1), (4, 4, 3)]
)
@pytest.mark.parametrize("radius", [0, 1, 4])
def test_correlation_of_windows_is_that_of_the_whole_volume(rows, columns, levels, radius):
    generator = seeded(rows * 100 + columns)
    pyramid = make_pyramid(random(generator, 3, rows, columns, 6), levels)
    positions = torch.stack([places_on(rows, columns, 8, generator) for _ in range(3)], dim=1)
    tracks = random(generator, len(positions), 3, 6)
    found = correlate(pyramid, tracks, positions, radius=radius)
    assert found.shape == (len(positions), 3, levels * (2 * radius + 1) ** 2)
    same(found, whole_volume_correlation(pyramid, tracks, positions, radius))


def test_windows_vary_the_column_slowest():
    maps = torch.zeros(1, 5, 5, 1)
    maps[0, 2, 3] = 1  # one cell to the right of the centre
    window = correlate([maps], torch.ones(1, 1, 1), torch.tensor([[[2.0, 2.0]]]), radius=1).reshape(3, 3)
    assert window.tolist() == [[0, 0, 0], [0, 0, 0], [0, 1, 0]]


def test_pyramid_averages_two_by_two_and_drops_the_odd_rest():
    finest = random(seeded(4), 2, 7, 5, 3)
    pyramid = make_pyramid(finest, 3)
    assert [tuple(level.shape) for level in pyramid] == [(2, 7, 5, 3), (2, 3, 2, 3), (2, 1, 1, 3)]
    assert pyramid[0] is finest
    same(pyramid[1], finest[:, :6, :4].reshape(2, 3, 2, 2, 2, 3).mean(dim=(2, 4)))
    same(pyramid[2][:, 0, 0], pyramid[1][:, :2, :2].mean(dim=(1, 2)))


@pytest.mark.parametrize(("rows", "columns"), [(6, 9), (1, 7), (7, 1), (1, 1)])
def test_linear_samples_are_those_of_grid_sample(rows, columns):
    maps, places = random(seeded(5), rows, columns, 4), places_on(rows, columns, 12, seeded(6))
    grid = on_grid(places, rows, columns)[None, :, None]
    expected = F.grid_sample(maps.permute(2, 0, 1)[None], grid, padding_mode="border", align_corners=True)
    same(sample_linear(maps, places), expected[0, :, :, 0].T)


# Embeddings


@pytest.mark.parametrize(("rows", "columns"), [(6, 9), (1, 7), (1, 1)])
def test_place_embedding_is_a_sampled_table(rows, columns):
    channels, places = 20, places_on(rows, columns, 12, seeded(7))
    frequencies = 10000.0 ** (-torch.arange(5, dtype=torch.float64) / 5)
    row, column = (torch.arange(n, dtype=torch.float64)[:, None] * frequencies for n in (rows, columns))
    by_row, by_column = (torch.cat([angles.sin(), angles.cos()], dim=1) for angles in (row, column))
    table = torch.cat([by_column.expand(rows, -1, -1), by_row[:, None].expand(-1, columns, -1)], dim=2)
    same(embed_place(places, (rows, columns), channels), sample_linear(table, places), 1e-5)


def test_flow_embedding_has_its_closed_form():
    x, y = -0.7310, 0.0125
    frequencies = [2 * j * 1000 / 16 for j in range(8)]
    expected = [f(w * value) for value in (x, y) for w in frequencies for f in (math.sin, math.cos)]
    found = embed_flow(torch.tensor([[x, y]], dtype=torch.float64), 16)
    same(found, torch.tensor([expected], dtype=torch.float64), 1e-12)


def test_rotation_turns_pairs_of_channels():
    x, positions = random(seeded(8), 1, 1, 3, 16), torch.tensor([[2, 5], [0, 0], [7, 1]])
    turned = rotate(x, turns(positions, 16)).numpy()
    for token, place in enumerate(positions.tolist()):
        for half, coordinate in enumerate(place):
            for j in range(4):
                angle = coordinate * 100 ** (-2 * j / 8)
                matrix = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
                pair = [8 * half + j, 8 * half + j + 4]
                np.testing.assert_allclose(turned[0, 0, token, pair], matrix @ x.numpy()[0, 0, token, pair], atol=1e-6)


def test_products_of_rotated_tokens_depend_on_the_difference_of_places():
    query, key = random(seeded(9), 2, 1, 1, 6, 16)
    here, there = torch.randint(0, 30, (2, 6, 2), generator=seeded(10))

    def products(offset):
        offset = torch.tensor(offset)
        return (rotate(query, turns(here + offset, 16)) * rotate(key, turns(there + offset, 16))).sum(-1)

    same(products([11, 4]), products([0, 0]), 1e-4)
    differ(products([11, 4]), (query * rotate(key, turns(there, 16))).sum(-1))


def test_special_tokens_do_not_turn_and_patches_count_from_one():
    options = {"special": 3, "channels": 16, "device": torch.device("cpu"), "dtype": torch.float64}
    table = rotary_table(2, 3, **options)
    x = random(seeded(11), 1, 1, 18, 16)  # two frames
    turned = rotate(x, table)
    assert torch.equal(turned[:, :, [0, 1, 2, 9, 10, 11]], x[:, :, [0, 1, 2, 9, 10, 11]])
    places = torch.tensor([[r, c] for r in (1, 2) for c in (1, 2, 3)])
    for start in (3, 12):
        same(turned[:, :, start : start + 6], rotate(x[:, :, start : start + 6], turns(places, 16)), 1e-6)


# The image encoder's position table


def test_position_table_is_used_as_it_is_at_its_own_size(network):
    encoder = network.aggregator.patch_embed
    images = random_images(seeded(12), 1, 56, 56)
    tokens, special = encoder.embed(images), 1 + SMALL.registers
    patches = encoder.patch_embed(images).flatten(2).transpose(1, 2)
    assert torch.equal(tokens[:, special:], patches + encoder.pos_embed[:, 1:])
    assert torch.equal(tokens[:, :1], encoder.cls_token + encoder.pos_embed[:, :1])
    assert torch.equal(tokens[:, 1:special], encoder.register_tokens)


@pytest.mark.parametrize("size", [(28, 112), (112, 28), (14, 14), (70, 84)])
def test_position_table_is_resampled_elsewhere(network, size):
    encoder = network.aggregator.patch_embed
    blank = torch.zeros(1, 3, *size, dtype=torch.float64)
    places = encoder.embed(blank)[:, 1 + SMALL.registers :] - encoder.patch_embed.proj.bias
    table = encoder.pos_embed[:, 1:].float().unflatten(1, (4, 4)).permute(0, 3, 1, 2)
    grid = (size[0] // 14, size[1] // 14)
    expected = F.interpolate(table, size=grid, mode="bicubic", antialias=True, align_corners=False)
    same(places, expected.flatten(2).transpose(1, 2).double(), 1e-6)


# What is kept, and what is left out


def test_layers_that_nobody_asked_for_are_not_kept_nor_computed(network):
    images, computed = random_images(seeded(13), 2, 28, 28), []
    hooks = [
        block.register_forward_hook(lambda *_, layer=layer: computed.append(layer))
        for layer, block in enumerate(network.aggregator.global_blocks)
    ]
    few = network.aggregator(images, (2, 0))
    for hook in hooks:
        hook.remove()
    every = network.aggregator(images, range(SMALL.depth))
    assert sorted(few) == [0, 2]
    assert computed == [0, 1, 2]
    assert sorted(every) == [0, 1, 2, 3]
    assert all(torch.equal(few[layer], every[layer]) for layer in few)
    assert every[0].shape == (2, SMALL.special_tokens + 4, 2 * SMALL.width)


def test_layers_are_kept_in_the_precision_asked_for(network):
    images = random_images(seeded(13), 2, 28, 28)
    kept, usual = network.aggregator(images, (3,), keep_dtype=torch.bfloat16)[3], network.aggregator(images, (3,))[3]
    assert kept.dtype == torch.bfloat16
    assert torch.equal(kept, usual.to(torch.bfloat16))


def test_few_frames_at_a_time_give_the_same_maps(network, monkeypatch):
    images, passes = random_images(seeded(14), 5, 28, 42), []
    at_once = network.features(images)
    assert at_once.shape == (5, SMALL.features, 14, 21)
    monkeypatch.setattr(feature_head, "_FRAMES", 2)
    hook = network.track_head.feature_extractor.scratch.register_forward_hook(lambda *_: passes.append(1))
    same(network.features(images), at_once, 1e-12)
    hook.remove()
    assert len(passes) == 3


@pytest.mark.parametrize(
    ("heads", "left_out"),
    [
        ({}, ("depth_head", "point_head")),
        ({"camera": False}, ("camera_head", "depth_head", "point_head")),
        ({"track": False}, ("track_head", "depth_head", "point_head")),
        ({"camera": False, "track": False}, HEADS),
    ],
)
def test_heads_are_built_when_asked_for(heads, left_out):
    with torch.device("meta"):
        network = Vggt(SMALL, **heads)
    assert sorted(network.heads_left_out) == sorted(left_out)
    built = {key.split(".")[0] for key in network.state_dict()}
    assert built == {"aggregator", *HEADS} - set(left_out)


def test_published_size_can_be_built_without_memory():
    with torch.device("meta"):
        network = Vggt()
    assert network.config == VggtConfig()
    assert all(parameter.is_meta for parameter in network.parameters())
    assert sum(parameter.numel() for parameter in network.parameters()) > 1e9


def test_smallest_images():
    assert (SMALL.smallest_side, VggtConfig().smallest_side) == (8, 128)
    network, images = random_network(seeded()), random_images(seeded(15), 2, 14, 14)
    tracks = network.track(images, torch.tensor([[[3.0, 4.0]]], dtype=torch.float64))
    assert network.features(images).shape == (2, SMALL.features, 7, 7)
    assert make_pyramid(torch.zeros(1, 7, 7, 1), SMALL.levels)[-1].shape == (1, 1, 1, 1)
    assert tracks.positions.isfinite().all()
    assert network.estimate_poses(images[:1]).isfinite().all()


def test_same_images_give_the_same_bits(network, queries):
    images = random_images(seeded(16), 3, 28, 42)
    first, again = (network.track(images, queries[None]) for _ in range(2))
    assert torch.equal(first.positions, again.positions)
    assert torch.equal(first.visibility, again.visibility)
    assert torch.equal(network.estimate_poses(images), network.estimate_poses(images))


def test_half_precision_stays_near_and_spares_what_is_read_off(queries):
    network = random_network(seeded()).float()
    images, start = random_images(seeded(17), 3, 28, 42).float(), queries[None].float()
    heard = []
    hook = network.camera_head.register_forward_hook(lambda _, arguments, result: heard.append((arguments[0], result)))
    with torch.autocast("cpu", dtype=torch.bfloat16):
        maps, tracks, poses = network.features(images), network.track(images, start), network.estimate_poses(images)
    hook.remove()
    assert {x.dtype for x in (maps, tracks.positions, tracks.visibility, tracks.confidence, poses)} == {torch.float32}
    exact = network.features(images)
    assert (maps - exact).norm() < 0.05 * exact.norm()
    same(poses, network.estimate_poses(images), 0.1)
    same(tracks.positions[0], network.track(images, start).positions[0], 0.5)
    ((tokens, result),) = heard
    assert torch.equal(network.camera_head(tokens), result)  # the head itself did not run in half precision


# Refusals


@pytest.mark.parametrize(
    "shape", [(3, 28, 28), (1, 2, 3, 28, 28), (2, 1, 28, 28), (2, 28, 28, 3), (2, 3, 28, 30), (2, 3, 27, 28)]
)
@pytest.mark.parametrize("use", ["estimate_poses", "features"])
def test_images_of_another_shape_are_refused(network, shape, use):
    with pytest.raises(DatasetError, match=r"multiples of 14, got \(.*\); resize or crop"):
        getattr(network, use)(torch.zeros(shape, dtype=torch.float64))


def test_images_too_small_for_the_pyramid_are_refused():
    network = random_network(seeded(), VggtConfig(**{**vars(SMALL), "levels": 5}))
    images = torch.zeros(1, 3, 28, 56, dtype=torch.float64)
    with pytest.raises(DatasetError, match="at least 32 px a side for tracking, got 56 x 28; use larger patches"):
        network.features(images)
    assert network.estimate_poses(images).shape == (2, 1, 9)  # cameras need no pyramid
    assert network.features(torch.zeros(1, 3, 42, 42, dtype=torch.float64)).shape == (1, SMALL.features, 21, 21)
    assert make_pyramid(torch.zeros(1, 16, 16, 1), 5)[-1].shape == (1, 1, 1, 1)


def test_integer_images_are_refused(network):
    with pytest.raises(DatasetError, match="floating"):
        network.features(torch.zeros(1, 3, 28, 28, dtype=torch.uint8))


def test_queries_that_are_no_number_harm_their_own_group_only(tracker, features, queries):
    groups = queries.unflatten(0, (3, 2)).clone()
    groups[1, 0, 0] = torch.nan
    tracks = tracker(features, groups)
    same(tracks.positions[:, [0, 2]], tracker(features, groups[[0, 2]]).positions)
    assert tracks.positions[-1, 1, 0, 1:].isnan().all()


def test_gradients_can_be_had_after_inference():
    rotary_table.cache_clear()
    network, images = random_network(seeded()).requires_grad_(True), random_images(seeded(18), 2, 28, 28)
    with torch.inference_mode():
        network.estimate_poses(images)
    network.estimate_poses(images).sum().backward()
    assert network.aggregator.camera_token.grad.abs().sum() > 0
