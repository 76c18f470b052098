"""PoseDiffusion against golden data: every stage of a small network, and the published size, with recipe weights."""

import json
import re
from contextlib import contextmanager

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")

from golden import golden_folder, need_memory, read_arrays, read_shapes, recipe_weights, shapes_of  # noqa: E402
from vfm_sdm.networks.loading import load_weights  # noqa: E402
from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig  # noqa: E402
from vfm_sdm.networks.posediffusion.crop import SquareCrop, crop_pictures  # noqa: E402
from vfm_sdm.networks.posediffusion.denoiser import embed_poses, embed_times  # noqa: E402
from vfm_sdm.networks.posediffusion.encoder import scaled_pictures  # noqa: E402
from vfm_sdm.networks.posediffusion.guidance import PASSES, Guide, ImageMatches, fundamental_matrices  # noqa: E402
from vfm_sdm.networks.posediffusion.model import PoseDiffusion  # noqa: E402
from vfm_sdm.networks.posediffusion.pose import decode_pose, encode_pose  # noqa: E402
from vfm_sdm.networks.posediffusion.schedule import noise_schedule  # noqa: E402

TINY = PoseDiffusionConfig(
    width=48, encoder_depth=3, encoder_heads=3, channels=64, depth=3, heads=4, hidden=96, head_hidden=32
)
NET, MODEL = "image_feature_extractor._net", "diffuser.model"
FLIP = np.array([-1.0, -1.0, 1.0])
MODES = {"all": PASSES[0][0], "focal": PASSES[1][0], "rotation": PASSES[2][0], "translation": PASSES[3][0]}
TOLERANCES = {
    "crop_boxes|resize_scales": 0,
    "image224_.*": 5e-5,
    "vit_in_.*": 2e-4,
    "vit_embedded_.*|vit_block0_.*": 2e-4,
    "vit_class_.*|z|z_size336": 6e-5,
    "pose_embedding|time_sinusoid_.*|time_embedding_.*": 2e-5,
    "denoiser_.*|batch_out": 3e-5,
    "step_t[0-9]*": np.array([2e-4, 3e-6, 3e-6])[:, None, None],  # noise-free vectors, mean, next
    "step_t50_if_x0": 3e-6,
    "chain": 1e-5,
    "p3d_.*|cam_from_world_.*|encoded": 5e-6,
    "K_.*": 1e-3,
    "ggs_F": 5e-7,
    "ggs_sampson": 2e-2,
    "ggs_sampson_below_10": 1e-3,
    "ggs_loss|ggs_capped_mean_(x|iter5)": 5e-4,
    "ggs_grad_.*": 5e-4,  # of the largest
    "ggs_.*_after.*": 3e-6,
    "ggs_iter5": 1e-5,
    "ggs_iter100|ggs_capped_mean_iter100": 3e-2,
    "chain_ggs_iter1": 1e-5,
    "chain_ggs_iter1_capped_mean": 3e-4,
    "chain_ggs_iter5_start": 1e-5,
    "chain_ggs_iter5": 1e-2,
    "chain_ggs_iter5_capped_mean": 4e-2,
    "chain_ggs_iter100": 0.2,
    "chain_ggs_iter100_capped_mean": 0.1,
    "chain_capped_mean": 5e-4,
}
"""In single precision."""
EXACT = {
    "ggs_iter100|ggs_capped_mean_iter100": 1e-2,
    "chain_ggs_iter5": 1e-6,
    "chain_ggs_iter5_capped_mean": 4e-6,
    "chain_ggs_iter100": 0.2,
    "chain_ggs_iter100_capped_mean": 0.1,
    "ggs_sampson|ggs_F|ggs_loss|ggs_grad_.*": 1e-8,
    ".*": 1e-9,
}
"""In double precision; the first that fits. The mean error of the guided chain, for which the data state none, has four
times that of the chain, as in single precision. The long guided chain differs between any two that sum otherwise."""
LONG = "ggs_(capped_mean_)?iter100|chain_ggs_iter100.*"
INPUTS = "pose|images|noise|noise_guided|x|step_noise|ggs_x|kp1|kp2|i12"
SINGLE, DOUBLE = torch.float32, torch.float64


def tolerance_of(name, dtype):
    if dtype == DOUBLE:
        return next(EXACT[pattern] for pattern in EXACT if re.fullmatch(pattern, name))
    (found,) = (TOLERANCES[pattern] for pattern in TOLERANCES if re.fullmatch(pattern, name))
    return found


def all_agree(found, stored, dtype):
    """Every stored array has a tolerance and keeps it; none is left out."""
    faults, compared = {}, 0
    for name, array in stored.items():
        here, there = np.asarray(found[name], dtype=np.float64), np.asarray(array, dtype=np.float64)
        assert here.shape == there.shape, name
        difference, compared = np.abs(here - there), compared + 1
        if name.endswith("_stats"):  # deviation and sum of magnitudes: 1e-6 of themselves
            difference[1:] *= tolerance_of(name, dtype) / (1e-6 * there[1:])
        if name.startswith("ggs_grad"):
            difference /= np.abs(there).max()
        if not np.all(difference <= tolerance_of(name, dtype)):
            faults[name] = difference.max()
    assert compared
    assert not faults


def stored_for(arrays, prefix, dtype, *, long):
    """Arrays under a prefix that belong to a precision, without inputs and, or with nothing but, the long runs."""
    own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
    suffixed = {name: array for name, array in own.items() if name.endswith("_f64") == (dtype == DOUBLE)}
    plain = {name.removesuffix("_f64"): array for name, array in suffixed.items()}
    return {
        name: array
        for name, array in plain.items()
        if not re.fullmatch(INPUTS, name) and bool(re.fullmatch(LONG, name)) == long
    }


@contextmanager
def watched(network, names):
    """Result of the last call of submodules, by name."""
    results = {}

    def watch(name):
        return network.get_submodule(name).register_forward_hook(
            lambda module, arguments, result: results.update({name: result, f"in {name}": arguments[0]})
        )

    hooks = [watch(name) for name in names]
    try:
        yield results
    finally:
        for hook in hooks:
            hook.remove()


def picture_stages(network, pictures, dtype):
    crops = [SquareCrop.of(picture.shape[1], picture.shape[0]) for picture in pictures]
    images = crop_pictures(list(pictures), 224, dtype)
    flat = images.double()
    found = {
        "crop_boxes": [(c.left, c.top, c.left + c.side, c.top + c.side) for c in crops],
        "resize_scales": [c.scale(224) for c in crops],
        "image224_s7": images[..., ::7, ::7],
        "image224_stats": [flat.mean(), flat.std(correction=0), flat.abs().sum()],
    }
    for reduction, (scaled, step) in enumerate(zip(scaled_pictures(images), (7, 4, 3), strict=True), start=1):
        name, wide = f"scale{reduction}", scaled.double()
        with watched(network, [f"{NET}.blocks.0"]) as results:
            found[f"vit_class_{name}"] = network.get_submodule(NET)(scaled)
        found |= {
            f"vit_in_{name}_s{step}": scaled[..., ::step, ::step],
            f"vit_in_{name}_stats": [wide.mean(), wide.std(correction=0), wide.abs().sum()],
            f"vit_embedded_{name}_f0": results[f"in {NET}.blocks.0"][0],
            f"vit_block0_{name}_f0": results[f"{NET}.blocks.0"][0],
        }
    features = network.image_feature_extractor(images)
    larger = network.image_feature_extractor(crop_pictures(list(pictures), 336, dtype))
    return found | {"z": features, "z_size336": larger}


def denoiser_stages(network, x, z):
    parts = {
        "time_embedding": f"{MODEL}.time_embed",
        "denoiser_first": f"{MODEL}._first",
        "denoiser_layer0": f"{MODEL}._trunk.layers.0",
        "denoiser_trunk": f"{MODEL}._trunk",
        "denoiser_head_norm": f"{MODEL}._last.1",
    }
    found = {"pose_embedding": embed_poses(x)}
    for time in (99, 50, 9, 0):
        with watched(network, parts.values()) as results:
            out = network.diffuser.model(x[None], z[None], torch.tensor([time]))
        found |= {f"{name}_t{time}": results[part][0] for name, part in parts.items()}
        found[f"denoiser_in_t{time}"] = results[f"in {MODEL}._first"][0]
        found[f"denoiser_out_t{time}"] = out[0]
        found[f"time_sinusoid_t{time}"] = embed_times(torch.tensor([time], dtype=x.dtype))[0]
    both = [torch.stack([values, values.flip(0)]) for values in (x, z)]
    found["batch_out"] = network.diffuser.model(*both, torch.tensor([70, 3]))
    return found


def step_stages(network, x, z, noise):
    diffusion, found = network.diffuser, {}
    for time in (99, 50, 10, 1, 0):
        clean, mean = diffusion.denoise(x, z, time)
        found[f"step_t{time}"] = torch.stack([clean, mean, diffusion.spread(mean, noise, time)])
    out = diffusion.model(x[None], z[None], torch.tensor([50]))[0]
    return found | {"step_t50_if_x0": diffusion.mean(out, x, 50)}


def camera_arrays(poses):
    rotation, translation, focal = (part.double().numpy() for part in decode_pose(poses))
    return {
        "p3d_R": (FLIP[:, None] * rotation).swapaxes(1, 2),
        "p3d_T": translation * FLIP,
        "p3d_focal": focal,
        "cam_from_world_R": rotation,
        "cam_from_world_t": translation,
    }


def intrinsics(focal, half, center):
    K = np.zeros((len(focal), 3, 3))
    K[:, 0, 0], K[:, 1, 1] = (focal * np.reshape(half, (-1, 1))).T
    K[:, :2, 2], K[:, 2, 2] = center, 1
    return K


def camera_stages(poses, pictures):
    found = camera_arrays(poses)
    crops = [SquareCrop.of(picture.shape[1], picture.shape[0]) for picture in pictures]
    half = np.array([crop.side / 2 for crop in crops])
    center = np.array([(crop.left, crop.top) for crop in crops]) + half[:, None]
    return found | {
        "K_224": intrinsics(found["p3d_focal"], 112, 112),
        "K_image": intrinsics(found["p3d_focal"], half, center),
    }


def guide_of(arrays, dtype, iterations=100):
    first, second = (torch.from_numpy(arrays[name]).to(dtype) for name in ("kp1", "kp2"))
    return Guide(ImageMatches(first, second, torch.from_numpy(arrays["i12"])), iterations=iterations)


def capped(guide, poses):
    return guide.errors(poses).clamp(max=10).mean()


def each_pass(guide, poses, iterations):
    after = []
    for moved, times in PASSES:
        poses = guide.descend(poses, moved, times * iterations)
        after.append(poses)
    return torch.stack(after)


def guidance_stages(guide, x, stored):
    errors, matrices = guide.errors(x), fundamental_matrices(x, 224)
    sign = torch.from_numpy(np.sign((matrices.double().numpy() * stored["ggs_F"]).sum((-1, -2), keepdims=True)))
    passed = each_pass(guide, x, 5)
    found = {
        "ggs_F": matrices * sign,
        "ggs_sampson": errors,
        "ggs_loss": errors[errors < 10].mean(),
        "ggs_capped_mean_x": capped(guide, x),
        "ggs_iter5": passed,
        "ggs_capped_mean_iter5": capped(guide, passed[-1]),
    }
    for name, moved in MODES.items():
        found[f"ggs_grad_{name}"] = guide.gradient(x, moved)
        found |= {f"ggs_{name}_after{count}": guide.descend(x, moved, count) for count in (1, 2, 10)}
    return found


def chain_stages(network, arrays, z, dtype, iterations):
    guide = guide_of(arrays, dtype, iterations)
    chain = network.sample_from(z, torch.from_numpy(arrays["noise_guided"]).to(dtype), guide)
    name = f"chain_ggs_iter{iterations}"
    return {name: chain[90:], f"{name}_capped_mean": capped(guide, chain[-1])}


def run_stages(network, arrays, stored, dtype):
    x, noise, step_noise, ggs_x = (
        torch.from_numpy(arrays[name]).to(dtype) for name in ("x", "noise", "step_noise", "ggs_x")
    )
    found = picture_stages(network, arrays["images"], dtype)
    z = found["z"]
    chain, guide = network.sample_from(z, noise), guide_of(arrays, dtype)
    found |= denoiser_stages(network, x, z) | step_stages(network, x, z, step_noise)
    found |= {"chain": chain, "chain_capped_mean": capped(guide, chain[-1])}
    found |= camera_stages(chain[-1], arrays["images"]) | guidance_stages(guide, ggs_x, stored)
    for iterations in (1, 5):
        found |= chain_stages(network, arrays, z, dtype, iterations)
    errors = stored["ggs_sampson"]
    if dtype == SINGLE:
        found["ggs_sampson_below_10"] = np.asarray(found["ggs_sampson"])[errors < 10]
        found["chain_ggs_iter5_start"] = found["chain_ggs_iter5"][:2]
        stored = stored | {
            "ggs_sampson_below_10": errors[errors < 10],
            "chain_ggs_iter5_start": stored["chain_ggs_iter5"][:2],
        }
    all_agree(found, stored, dtype)


def run_long(network, arrays, stored, dtype):
    z = network.image_feature_extractor(crop_pictures(list(arrays["images"]), 224, dtype))
    guide = guide_of(arrays, dtype)
    passed = each_pass(guide, torch.from_numpy(arrays["ggs_x"]).to(dtype), 100)
    found = {"ggs_iter100": passed, "ggs_capped_mean_iter100": capped(guide, passed[-1])}
    all_agree(found | chain_stages(network, arrays, z, dtype, 100), stored, dtype)


@contextmanager
def reference_conditions():
    """One thread, no gradients but those that guide."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)


@pytest.fixture(scope="module")
def folder():
    return golden_folder("posediffusion")


@pytest.fixture(scope="module")
def tiny(folder):
    return read_arrays(folder / "golden_tiny.npz")


def made(folder, config, dtype):
    with torch.device("meta"):
        network = PoseDiffusion(config).eval().requires_grad_(False)
    load_weights(network, recipe_weights(folder, shapes_of(network)), dtype=dtype)
    return network


def arrays_of(tiny, sequence):
    return {name.removeprefix(sequence): array for name, array in tiny.items() if name.startswith(sequence)}


@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE], ids=["float32", "float64"])
@pytest.mark.parametrize("sequence", ["a/", "b/"])
def test_golden_stages(folder, tiny, sequence, dtype):
    stored = stored_for(tiny, sequence, dtype, long=False)
    with reference_conditions():
        run_stages(made(folder, TINY, dtype), arrays_of(tiny, sequence), stored, dtype)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE], ids=["float32", "float64"])
def test_golden_long_guidance(folder, tiny, dtype):
    """Seven thousand iterations, as published, of two frames; what differs more than rounding is the mean error."""
    with reference_conditions():
        run_long(made(folder, TINY, dtype), arrays_of(tiny, "b/"), stored_for(tiny, "b/", dtype, long=True), dtype)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE], ids=["float32", "float64"])
def test_golden_full_size(folder, dtype):
    """The published size: less than 1 GB of memory."""
    need_memory(1)
    arrays = read_arrays(folder / "golden_full.npz")
    with reference_conditions():
        run_stages_of_full_size(made(folder, None, dtype), arrays, dtype)


def run_stages_of_full_size(network, arrays, dtype):
    run_stages(network, arrays_of(arrays, "two/"), stored_for(arrays, "two/", dtype, long=False), dtype)


@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE], ids=["float32", "float64"])
def test_golden_pose_code(tiny, dtype):
    stored = stored_for(tiny, "posecode/", dtype, long=False)
    poses = torch.from_numpy(tiny["posecode/pose"]).to(dtype)
    found = camera_arrays(poses)
    found["K_120x200"] = intrinsics(found["p3d_focal"], 60, [100, 60])
    found["encoded"] = encode_pose(*decode_pose(poses))
    all_agree(found, stored, dtype)


@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE], ids=["float32", "float64"])
def test_golden_harmonics_of_large_numbers(tiny, dtype):
    stored = tiny["unit/harmonic_out" + ("_f64" if dtype == DOUBLE else "")]
    found = embed_poses(torch.from_numpy(tiny["unit/harmonic_in"]).to(dtype))
    np.testing.assert_allclose(found, stored, rtol=0, atol=2e-5 if dtype == SINGLE else 1e-9)


def test_golden_keypoints_as_published(tiny):
    """The published matches count from pixel centres, the principal point from the corner; ours from the corner."""
    for which, name in enumerate(("kp1", "kp2")):
        picture = tiny["a/images"][tiny["keypoints/i12"][0, which]]
        colmap = tiny[f"keypoints/colmap_frame{tiny['keypoints/i12'][0, which]}"][tiny["keypoints/match"][:, which]]
        crop = SquareCrop.of(picture.shape[1], picture.shape[0])
        found = crop.from_full(colmap.astype(np.float64) - 0.5, 224)
        np.testing.assert_allclose(found, tiny[f"keypoints/{name}"], rtol=0, atol=1e-9)


def test_golden_schedule(tiny):
    found = noise_schedule(100)
    stored = {name.removeprefix("schedule/"): array for name, array in tiny.items() if name.startswith("schedule/")}
    assert found.keys() == stored.keys()
    for name, array in stored.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)


@pytest.mark.parametrize("size", ["tiny", "full"])
def test_golden_manifest(folder, tiny, size):
    manifest = json.loads(str(tiny["manifest_json"])) if size == "tiny" else read_shapes(folder / "manifest.json")
    with torch.device("meta"):
        network = PoseDiffusion(TINY if size == "tiny" else None)
    assert shapes_of(network) == manifest
    assert {value.dtype for value in network.state_dict().values()} == {torch.float32}


@pytest.mark.parametrize("size", ["tiny", "full"])
def test_golden_recipe_has_not_drifted(folder, size):
    arrays = read_arrays(folder / f"golden_{size}.npz")
    manifest = json.loads(str(arrays["manifest_json"])) if size == "tiny" else read_shapes(folder / "manifest.json")
    stored = {name.split("/")[1]: array for name, array in arrays.items() if name.startswith("recipe_check/")}
    weights = recipe_weights(folder, {key: manifest[key] for key in stored})
    for key, array in stored.items():
        np.testing.assert_array_equal(weights[key].flatten()[: array.size], array)


def test_golden_groups_are_all_compared(tiny):
    compared = {"a", "b", "posecode", "unit", "keypoints", "schedule", "recipe_check"}
    assert {name.split("/")[0] for name in tiny if "/" in name} == compared
