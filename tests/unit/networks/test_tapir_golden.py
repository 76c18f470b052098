"""TAPIR against the golden data: manifests, every stored stage of eight runs, offline and online."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the networks need torch")

from golden import golden_folder, load_recipe, read_arrays, read_shapes  # noqa: E402
from vfm_sdm.networks.tapir.config import TapirConfig  # noqa: E402
from vfm_sdm.networks.tapir.features import FeatureGrids  # noqa: E402
from vfm_sdm.networks.tapir.model import Tapir  # noqa: E402

TRACKS_PX, LOGITS, FEATURES, MIXER, STATE = 1e-3, 1e-4, 1e-5, 5e-5, 2e-4
"""Tolerances of the golden data's README, for float32 on another machine."""

CONFIGS = {
    "boots_offline_A": TapirConfig.bootstapir(),
    "boots_offline_A_temp10": TapirConfig.bootstapir(softmax_temperature=10.0),
    "causal_offline_A": TapirConfig.bootstapir_causal(),
    "panning_offline_A": TapirConfig.tapir_panning(),
    "boots_offline_B": TapirConfig.bootstapir(),
    "boots_offline_B_xfixed": TapirConfig.bootstapir(square_sampling=False),
}


def read_manifest(config):
    name = "manifest.json" if config.extra_convs else "manifest_tapir_panning.json"
    return read_shapes(golden_folder("tapir") / name)


@pytest.fixture(scope="module")
def golden():
    return read_arrays(golden_folder("tapir") / "golden.npz")


@pytest.fixture(scope="module")
def recipe():
    return load_recipe(golden_folder("tapir"))


@pytest.fixture(scope="module")
def stand_in_weights(recipe):
    config = TapirConfig.bootstapir()
    return {key: torch.from_numpy(value) for key, value in recipe.state_dict(read_manifest(config)).items()}


@pytest.fixture(scope="module")
def build(stand_in_weights, recipe):
    """Networks with stand-in weights; the backbone sees each frame once, whatever the number of runs over it."""
    frames_seen = {}

    def build_network(config):
        manifest = read_manifest(config)
        weights = {
            key: stand_in_weights[key]
            if tuple(stand_in_weights[key].shape) == tuple(shape)
            else torch.from_numpy(recipe.tensor(key, shape))
            for key, shape in manifest.items()
        }
        with torch.device("meta"):
            network = Tapir(config)
        network.load_state_dict(weights, strict=True, assign=True)
        backbone = network.feature_grids

        def feature_grids(video, resolution, *, frame_chunk=16):
            keys = [(config.extra_convs, resolution, frame.numpy().tobytes()) for frame in video]
            new = [index for index, key in enumerate(keys) if key not in frames_seen]
            if new:
                made = backbone(video[new], resolution, frame_chunk=4)
                for place, index in enumerate(new):
                    frames_seen[keys[index]] = [grid[place] for grid in (made.hires, made.lowres, *made.pooled)]
            scales = zip(*(frames_seen[key] for key in keys), strict=True)
            hires, lowres, *pooled = (torch.stack(frames) for frames in scales)
            return FeatureGrids(hires, lowres, tuple(pooled), resolution)

        network.feature_grids = feature_grids
        return network.eval()

    return build_network


def read_video(golden, name):
    return torch.from_numpy(golden[f"video{name}"]).float() / 255 * 2 - 1


def assert_checksums(golden, prefix, values, tolerance):
    values = values.numpy()
    assert values.shape == tuple(golden[f"{prefix}_shape"])
    flat = values.astype(np.float64).ravel()
    np.testing.assert_allclose(flat[golden[f"{prefix}_idx"]], golden[f"{prefix}_samples"], rtol=0, atol=tolerance)
    mean, std, absolute = golden[f"{prefix}_stats"]
    assert flat.mean() == pytest.approx(mean, abs=tolerance)
    assert flat.std() == pytest.approx(std, abs=tolerance)
    assert np.abs(flat).sum() == pytest.approx(absolute, rel=1e-5)


@pytest.mark.parametrize(
    "config", [TapirConfig.bootstapir(), TapirConfig.bootstapir_causal(), TapirConfig.tapir_panning()]
)
def test_golden_manifest_matches_both_ways(config):
    with torch.device("meta"):
        network = Tapir(config)
    assert {key: list(value.shape) for key, value in network.state_dict().items()} == read_manifest(config)


def test_golden_recipe_has_not_drifted(golden, stand_in_weights):
    checks = [key for key in golden if key.startswith("recipe_check/")]
    assert len(checks) == 4
    for check in checks:
        made = stand_in_weights[check.removeprefix("recipe_check/")].numpy().ravel()
        np.testing.assert_allclose(made[: golden[check].size], golden[check], rtol=0, atol=1e-7)


@pytest.mark.parametrize("run", CONFIGS)
def test_golden_offline_run(golden, build, run):
    name = run.split("_")[2]
    with torch.inference_mode():
        result = build(CONFIGS[run]).track(read_video(golden, name), torch.from_numpy(golden[f"queries{name}"]))
    tolerances = {"tracks": TRACKS_PX, "occlusion": LOGITS, "expected_dist": LOGITS}
    assert len(result.iterates) == 1 + len(golden[f"{run}/iter_tracks"])
    for quantity, tolerance in tolerances.items():
        got = getattr(result, quantity).numpy()
        np.testing.assert_allclose(got, golden[f"{run}/{quantity}"], rtol=0, atol=tolerance)
        for iterate, stored in zip(result.iterates, golden[f"{run}/iter_{quantity}"], strict=False):
            np.testing.assert_allclose(getattr(iterate, quantity).numpy(), stored, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(result.visible.numpy(), golden[f"{run}/visible"])


@pytest.mark.parametrize("name", ["A", "B"])
def test_golden_stages(golden, build, name):
    run = f"boots_offline_{name}"
    network = build(CONFIGS[run])
    calls, levels = [], []
    network.torch_pips_mixer.register_forward_hook(lambda _, given, made: calls.append((given[0], made[0])))
    remembered = network.feature_grids

    def feature_grids(*given, **options):
        levels.append(remembered(*given, **options))
        return levels[-1]

    network.feature_grids = feature_grids
    video, queries = read_video(golden, name), torch.from_numpy(golden[f"queries{name}"])
    with torch.inference_mode():
        network.track(video, queries)

    for stored, got in (("mixer_in_it1", calls[0][0]), ("mixer_out_it1", calls[0][1]), ("mixer_in_it2", calls[1][0])):
        np.testing.assert_allclose(got.numpy(), golden[f"{run}/{stored}"], rtol=0, atol=MIXER)
    made = {grids.resolution: grids for grids in levels}
    assert len(made) == len(levels)  # equal neighbours are shared
    for level, resolution in enumerate(golden[f"{run}/resolutions"]):
        grids = made[tuple(resolution)]
        points = grids.at(queries, tuple(video.shape[1:3]))
        for scale in ("hires", "lowres"):
            assert_checksums(golden, f"{run}/{scale}{level}", getattr(grids, scale).movedim(1, -1), FEATURES)
            stored = golden[f"{run}/query_{scale}{level}"]
            np.testing.assert_allclose(getattr(points, scale).numpy(), stored, rtol=0, atol=FEATURES)


@pytest.mark.parametrize("name", ["A", "B"])
def test_golden_online_run(golden, build, name):
    run = f"causal_online_{name}"
    network = build(TapirConfig.bootstapir_causal())
    video = read_video(golden, name)[: golden[f"{run}/online_tracks"].shape[1]]
    queries = torch.from_numpy(golden["queries_online" if name == "A" else "queriesB"].copy())
    queries[:, 0] = 0
    steps = []
    with torch.inference_mode():
        features = network.query_features(video[0], queries)
        state = network.initial_state(len(queries), n_resolutions=len(features.resolutions))
        for frame in video:
            steps.append(network.step(frame, features, state))
            state = steps[-1].state
    tolerances = {"tracks": TRACKS_PX, "occlusion": LOGITS, "expected_dist": LOGITS}
    for quantity, tolerance in tolerances.items():
        got = np.stack([getattr(step, quantity).numpy() for step in steps], axis=1)
        np.testing.assert_allclose(got, golden[f"{run}/online_{quantity}"], rtol=0, atol=tolerance)
    for iteration in (1, 4):
        mixer = state.refinements[iteration - 1]
        for block in (0, 11):
            stored = f"{run}/state_it{iteration}_block_{block}_causal"
            assert_checksums(golden, f"{stored}_1", mixer.normalized[block], STATE)
            assert_checksums(golden, f"{stored}_2", mixer.activated[block], STATE)
