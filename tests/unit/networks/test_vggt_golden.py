"""VGGT against golden data: every stage of a small network, and the published size, with weights made by a recipe."""

import copy
import json
import re
from contextlib import contextmanager

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")

from golden import golden_folder, need_memory, read_arrays, read_shapes, recipe_weights, shapes_of  # noqa: E402
from vfm_sdm.networks.loading import load_weights  # noqa: E402
from vfm_sdm.networks.vggt.config import VggtConfig  # noqa: E402
from vfm_sdm.networks.vggt.model import Vggt  # noqa: E402
from vfm_sdm.networks.vggt.pose import decode_pose, encode_pose  # noqa: E402
from vfm_sdm.networks.vggt.rotary import rotate, turns  # noqa: E402

TINY = VggtConfig(
    width=64,
    encoder_depth=2,
    encoder_heads=2,
    depth=6,
    heads=4,
    camera_heads=4,
    feature_layers=(1, 2, 4, 5),
    feature_channels=(16, 24, 32, 40),
    features=32,
    hidden=48,
)
AGGREGATOR, ENCODER = "aggregator", "aggregator.patch_embed"
FUSION, TRACKER = "track_head.feature_extractor.scratch", "track_head.tracker"
WATCHED = (
    AGGREGATOR,
    ENCODER,
    f"{ENCODER}.blocks.0",
    f"{AGGREGATOR}.frame_blocks.0",
    f"{AGGREGATOR}.global_blocks.0",
    "camera_head.poseLN_modulation",
    "camera_head.trunk",
    "camera_head.pose_branch",
    *(f"{FUSION}.layer{level}_rn" for level in (1, 2, 3, 4)),
    *(f"{FUSION}.refinenet{level}" for level in (1, 2, 3, 4)),
    f"{TRACKER}.corr_mlp",
    f"{TRACKER}.updateformer",
)
ITERATIONS_PX = np.array([1e-4, 3e-4, 2e-3, 5e-3])[:, None, None, None]
"""The flow embedding is stiff: rounding grows from iteration to iteration."""
TOLERANCES = {
    "patch_tokens|dino_embedded_f0|(frame|global)_block0_f0|agg_layer.*": 3e-5,
    "cam_modulation_it|cam_trunk_in_it": 3e-5,
    "cam_delta_it|pose_enc_it|pose_enc_it_negfov|extrinsics": 3e-6,
    "intrinsics": 1e-3,
    "dpt_.*": 1e-3,
    "n._corr_it1|n._update_in_it1|n._update_out_it1": 3e-5,
    "n._update_in_it2": 3e-2,
    "n._track_it": ITERATIONS_PX,
    "n._vis|n._conf": 3e-4,
    "pose_enc_it_f64": 1e-6,
    "n._track_it_f64": 2e-4,
}
INPUTS = "images|n._query|.*_idx"


def off_by(found, stored, tolerance, *, relative=0.0):
    """What is wrong with an array, or nothing."""
    found, stored = np.asarray(found, dtype=np.float64), stored.astype(np.float64)
    if found.shape != stored.shape:
        return f"shape {found.shape} instead of {stored.shape}"
    difference = np.abs(found - stored)
    return None if np.all(difference <= tolerance + relative * np.abs(stored)) else f"off by {difference.max():.3g}"


def agree(found, stored, tolerance):
    fault = off_by(found, stored, tolerance)
    assert fault is None, fault


def all_agree(found, stored, tolerances):
    """Every stored array has a tolerance of its own and keeps it."""
    faults = {}
    for name, array in stored.items():
        if re.fullmatch(INPUTS, name):
            continue
        (tolerance,) = (tolerances[pattern] for pattern in tolerances if re.fullmatch(pattern, name))
        if name.endswith("_stats"):  # mean, deviation, sum of magnitudes
            faults[name] = off_by(found[name][:1], array[:1], tolerance)
            faults[name] = faults[name] or off_by(found[name][1:], array[1:], 0, relative=1e-6)
        else:
            faults[name] = off_by(found[name], array, tolerance)
    assert faults
    assert not {name: fault for name, fault in faults.items() if fault}


def summary(name, values, stored):
    """What stands for an array that is too large to be stored."""
    flat = values.double().flatten()
    stats = torch.stack([flat.mean(), flat.std(correction=0), flat.abs().sum()])
    found = {"shape": np.array(values.shape), "stats": stats, "samples": flat[torch.from_numpy(stored[f"{name}_idx"])]}
    return {f"{name}_{part}": value for part, value in found.items()}


@contextmanager
def watched(network, names):
    """Every call of submodules: arguments and result, by name."""
    calls = {name: [] for name in names}

    def watch(name):
        def note(module, arguments, result):
            calls[name].append((arguments, result))

        return network.get_submodule(name).register_forward_hook(note)

    hooks = [watch(name) for name in names]
    try:
        yield calls
    finally:
        for hook in hooks:
            hook.remove()


@contextmanager
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def as_network_images(images, dtype=torch.float32):
    return (torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255).to(dtype)


def decoded(poses, images):
    extrinsics, intrinsics = decode_pose(poses[-1].double().numpy(), (images.shape[3], images.shape[2]))
    return {"extrinsics": extrinsics, "intrinsics": intrinsics}


@pytest.fixture(scope="module")
def folder():
    return golden_folder("vggt")


@pytest.fixture(scope="module")
def tiny(folder):
    return read_arrays(folder / "golden_tiny.npz")


@pytest.fixture(scope="module")
def networks(folder, tiny):
    """The small network in single and in double precision."""
    weights = recipe_weights(folder, json.loads(str(tiny["manifest_json"])))
    found = {}
    for dtype in (torch.float32, torch.float64):
        found[dtype] = Vggt(TINY).requires_grad_(False)
        load_weights(found[dtype], weights, optional_prefixes=found[dtype].heads_left_out, dtype=dtype)
    return found


@pytest.fixture(scope="module")
def network(networks):
    return networks[torch.float32]


@pytest.fixture(
    scope="module",
    params=[(dtype, sequence) for dtype in (torch.float32, torch.float64) for sequence in "ab"],
    ids=lambda param: f"{param[0]}-{param[1]}".removeprefix("torch."),
)
def stages(request, networks, tiny):
    """Arrays of a sequence as stored, and as they are here."""
    dtype, sequence = request.param
    stored = {name[2:]: array for name, array in tiny.items() if name.startswith(f"{sequence}/")}
    images = as_network_images(stored["images"], dtype)
    with one_thread(), torch.inference_mode():
        found = run_stages(networks[dtype], images, stored)
    if dtype == torch.float64:
        found |= {f"{name}_f64": found[name] for name in ("pose_enc_it", "n1_track_it", "n3_track_it")}
    else:
        stored = {name: array for name, array in stored.items() if not name.endswith("_f64")}
    return found, stored


def run_stages(network, images, stored):
    with watched(network, WATCHED) as calls:
        poses = network.estimate_poses(images)
        maps = network.features(images)
    found = token_stages(calls) | camera_stages(network, calls, poses) | decoded(poses, images)
    found |= feature_stages(calls, maps, stored)
    for points in (1, 3):
        queries = torch.from_numpy(stored[f"n{points}_query"]).to(images.dtype)[None]
        with watched(network, WATCHED) as calls:
            tracks = network.track_head.tracker(maps, queries)
        found |= {f"n{points}_{name}": array for name, array in tracker_stages(calls, tracks).items()}
    return found


def token_stages(calls):
    """Tokens; `features` ran last, and it keeps all layers that are stored."""
    (_, patch_tokens), ((embedded,), _) = calls[ENCODER][0], calls[f"{ENCODER}.blocks.0"][0]
    within, across = (calls[f"{AGGREGATOR}.{kind}_blocks.0"][0][1] for kind in ("frame", "global"))
    layers = calls[AGGREGATOR][-1][1]
    found = {
        "patch_tokens": patch_tokens,
        "dino_embedded_f0": embedded[0],
        "frame_block0_f0": within[0],
        "global_block0_f0": across[0, : within.shape[1]],
    }
    for layer, tokens in layers.items():
        found |= {f"agg_layer{layer}": tokens, f"agg_layer{layer}_first_last_frame": tokens[[0, -1]]}
    return found


def camera_stages(network, calls, poses):
    narrowing = copy.deepcopy(network.camera_head)
    narrowing.pose_branch.fc2.bias[7:] = torch.tensor([-0.05, -0.3])
    camera_tokens = calls[AGGREGATOR][0][1][TINY.depth - 1][:, 0]
    return {
        "cam_modulation_it": torch.cat([result for _, result in calls["camera_head.poseLN_modulation"]]),
        "cam_trunk_in_it": torch.cat([arguments[0] for arguments, _ in calls["camera_head.trunk"]]),
        "cam_delta_it": torch.cat([result for _, result in calls["camera_head.pose_branch"]]),
        "pose_enc_it": poses,
        "pose_enc_it_negfov": narrowing(camera_tokens),
    }


def feature_stages(calls, maps, stored):
    found = summary("dpt_fmap", maps, stored) | {"dpt_fmap_frame1": maps[1]}
    for level in (1, 2, 3, 4):
        reduced, fused = (calls[f"{FUSION}.{name}"][0][1][0] for name in (f"layer{level}_rn", f"refinenet{level}"))
        found |= {f"dpt_rn{level}_f0": reduced, f"dpt_fuse{level}_f0": fused}
        found[f"dpt_fuse{level}_f0_s3"] = fused[:, ::3, ::3]
    return found


def tracker_stages(calls, tracks):
    """Stages of one group of points."""
    updates = calls[f"{TRACKER}.updateformer"]
    return {
        "corr_it1": calls[f"{TRACKER}.corr_mlp"][0][0][0],
        "update_in_it1": updates[0][0][0][0],
        "update_out_it1": updates[0][1][0],
        "update_in_it2": updates[1][0][0][0],
        "track_it": tracks.positions[:, 0].transpose(1, 2),
        "vis": tracks.visibility[0].T,
        "conf": tracks.confidence[0].T,
    }


def test_golden_stages(stages):
    found, stored = stages
    all_agree(found, stored, TOLERANCES)


UNITS = {
    "vit_block0_small": f"{ENCODER}.blocks.0",
    "vit_norm_small": f"{ENCODER}.norm",
    "camera_block0_small": "camera_head.trunk.0",
    "dpt_norm_small": "track_head.feature_extractor.norm",
    "rcu": f"{FUSION}.refinenet2.resConfUnit1",
    "time_block0_small": f"{TRACKER}.updateformer.time_blocks.0",
    "virtual2point0_small": f"{TRACKER}.updateformer.space_virtual2point_blocks.0",
    "updateformer": f"{TRACKER}.updateformer",
    "ffeat_norm_small": f"{TRACKER}.ffeat_norm",
    "fmap_norm_small": f"{TRACKER}.fmap_norm",
}
"""Submodules with stored arguments and results; inputs of ``small`` ones pin the epsilons of the norms."""


def unit(tiny, name):
    arrays = {key.rsplit("_", 1)[1]: array for key, array in tiny.items() if key.startswith(f"unit/{name}_")}
    return {key: torch.from_numpy(array) for key, array in arrays.items()}


@pytest.mark.parametrize("name", UNITS)
def test_golden_unit(network, tiny, name):
    arrays = unit(tiny, name)
    arguments = [arrays[key] for key in ("in0", "in1") if key in arrays]
    agree(network.get_submodule(UNITS[name])(*arguments), tiny[f"unit/{name}_out"], 1e-5)


def test_golden_unit_rotary(tiny):
    arrays = unit(tiny, "rope")
    table = turns(arrays["in1"][:, None, None], arrays["in0"].shape[-1])
    agree(rotate(arrays["in0"], table), tiny["unit/rope_out"], 1e-5)


def test_golden_unit_block_with_places(network, tiny):
    arrays = unit(tiny, "frame_block0_small")
    table = turns(arrays["pos"][:, None, None], TINY.width // TINY.heads)
    agree(network.aggregator.frame_blocks[0](arrays["in0"], table), tiny["unit/frame_block0_small_out"], 1e-5)


def test_golden_unit_camera_norm(network, tiny):
    head, tokens = copy.deepcopy(network.camera_head), unit(tiny, "camera_adaln_small")["in0"]
    linear, width = head.poseLN_modulation[1], tokens.shape[-1]
    linear.weight.zero_()
    linear.bias.zero_()
    linear.bias[2 * width :] = 1  # shift and scale zero, gate one: the norm alone is added
    normed = head.modulated(tokens, torch.zeros(1, tokens.shape[1], 9)) - tokens
    agree(normed, tiny["unit/camera_adaln_small_out"], 1e-5)


def test_golden_units_are_all_compared(tiny):
    compared = {*UNITS, "rope", "frame_block0_small", "camera_adaln_small"}
    assert {name.removeprefix("unit/").rsplit("_", 1)[0] for name in tiny if name.startswith("unit/")} == compared


def test_golden_position_table_at_its_own_size(network, tiny):
    y, x, c = np.ogrid[:518, :518, :3]
    pixels = (x * (3 + c) // 7 + y * (5 + 2 * c) // 9 + x * y // (900 + 100 * c)) % 256
    with watched(network, [ENCODER]) as calls, torch.inference_mode():
        network.aggregator(as_network_images(pixels[None].astype(np.uint8)), (0,))
    agree(calls[ENCODER][0][1][0, ::13], tiny["square518/patch_tokens_every13"], 3e-5)


def test_golden_pose_code(tiny):
    height, width = (int(side) for side in tiny["posecode/image_hw"])
    extrinsics, intrinsics = decode_pose(tiny["posecode/pose_enc"].astype(float), (width, height))
    agree(extrinsics, tiny["posecode/extrinsics"], 3e-6)
    agree(intrinsics, tiny["posecode/intrinsics"], 1e-3)
    agree(encode_pose(extrinsics, intrinsics, (width, height)), tiny["posecode/reencoded"], 3e-6)


def test_golden_recipe_has_not_drifted(folder, tiny):
    shapes = json.loads(str(tiny["manifest_json"]))
    stored = {name.split("/")[1]: array for name, array in tiny.items() if name.startswith("recipe_check/")}
    weights = recipe_weights(folder, {key: shapes[key] for key in stored})
    for key, array in stored.items():
        np.testing.assert_array_equal(weights[key].flatten()[: array.size], array)


@pytest.mark.parametrize("size", ["tiny", "full"])
@pytest.mark.parametrize(
    ("heads", "left_out"),
    [
        ({}, ("depth_head", "point_head")),
        ({"track": False}, ("track_head", "depth_head", "point_head")),
        ({"camera": False}, ("camera_head", "depth_head", "point_head")),
    ],
    ids=["both", "camera", "track"],
)
def test_golden_manifest(folder, tiny, size, heads, left_out):
    manifest = json.loads(str(tiny["manifest_json"])) if size == "tiny" else read_shapes(folder / "manifest.json")
    with torch.device("meta"):
        network = Vggt(TINY if size == "tiny" else None, **heads)
    assert network.heads_left_out == left_out
    prefixes = tuple(f"{head}." for head in left_out)
    assert shapes_of(network) == {key: shape for key, shape in manifest.items() if not key.startswith(prefixes)}
    assert {value.dtype for value in network.state_dict().values()} == {torch.float32}
    assert not list(network.buffers())


@pytest.fixture(scope="module")
def full(folder):
    return read_arrays(folder / "golden_full.npz")


@pytest.fixture(scope="module")
def full_network(folder):
    need_memory(8)
    with torch.device("meta"):
        network = Vggt().requires_grad_(False)
    network.load_state_dict(recipe_weights(folder, shapes_of(network)), assign=True)
    return network


FULL_TOLERANCES = {
    "patch_tokens_.*": 3e-5,
    "agg_layer.*": 5e-5,
    "pose_enc_it|extrinsics": 3e-6,
    "intrinsics": 2e-3,
    "dpt_fmap_.*|n1_track_it": 1e-3,
    "n1_vis|n1_conf": 1e-6,
}


@pytest.mark.slow
@pytest.mark.parametrize("sequence", ["cam294x518", "track294x294"])
def test_golden_full_size(full_network, full, sequence):
    """The published size: needs 8 GB of free memory (5.6 GB at most are used) and 3 minutes on two idle cores."""
    stored = {name.split("/")[1]: array for name, array in full.items() if name.startswith(f"{sequence}/")}
    images, layers = as_network_images(stored["images"]), full_network.config.feature_layers
    with watched(full_network, [ENCODER]) as calls, torch.inference_mode():
        tokens = full_network.aggregator(images, layers)
        poses = full_network.camera_head(tokens[layers[-1]][:, 0])
        found = {"pose_enc_it": poses} | decoded(poses, images)
        found |= summary("patch_tokens", calls[ENCODER][0][1], stored)
        for layer, values in tokens.items():
            found |= summary(f"agg_layer{layer}", values, stored)
        if "n1_query" in stored:
            maps = full_network.track_head.feature_extractor(tokens, tuple(images.shape[-2:]))
            tracks = full_network.track_head.tracker(maps, torch.from_numpy(stored["n1_query"])[None])
            found |= summary("dpt_fmap", maps, stored)
            found |= {"n1_track_it": tracks.positions[:, 0].transpose(1, 2)}
            found |= {"n1_vis": tracks.visibility[0].T, "n1_conf": tracks.confidence[0].T}
    all_agree(found, stored, FULL_TOLERANCES)
