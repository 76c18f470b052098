"""The whole way with the networks' back ends: settings of the session reach them, their results reach millimetres.

Stand-ins take the place of trained networks: one that follows points by plain correlation, and the true cameras.
"""

import numpy as np
import pytest

from passes import count_passes
from scenes import FRAMES, motion_mm, write_scene
from standins import MatchingNetwork
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.inputs.session import Method, Network, read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.stages.tracking.vggt import VggtTracker

pytest.importorskip("torch", reason="PyTorch is not installed; pip install 'vfm-sdm[vfm]'")

pytestmark = pytest.mark.usefixtures("undrawn")

TRUE_MM = np.array([motion_mm(i) for i in range(FRAMES)])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture
def session(recorded, tmp_path):
    def with_method(**fields):
        weights = tmp_path / "mine.safetensors"
        weights.write_bytes(b"stands for weights")
        network = Network(weights=str(weights), device="cpu")
        found = read_session(recorded)
        method = Method(**{**found.method.model_dump(), "network": network, **fields})
        return found.model_copy(update={"method": method})

    return with_method


@pytest.fixture
def matching(monkeypatch):
    monkeypatch.setattr(VggtTracker, "load", lambda self: MatchingNetwork())


@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_network_and_registration_give_the_truth(session, matching, preset, tmp_path):
    chosen = session(tracker="vggt+icgn")
    network = chosen.method.network.model_copy(update={"preset": preset})
    chosen = chosen.model_copy(update={"method": chosen.method.model_copy(update={"network": network})})
    result = measure(chosen, tmp_path / "run")
    error = result.displacement["displacement"].values - TRUE_MM[:, None]
    assert np.abs(error[..., :2]).max() < 0.08
    assert np.abs(error[..., 2]).max() < 0.25
    for tracks in result.tracks.values():
        assert tracks.attrs["tracker"] == "vggt+icgn"
        assert tracks.attrs["weights"].startswith("mine-")
        assert tracks.attrs["preset"] == preset
        assert float(tracks["disagreement"].max()) < 1.0
    assert result.summary["versions"]["torch"]


@pytest.mark.parametrize(("tracker", "passes"), [("vggt", 1), ("vggt+icgn", 2)])
def test_the_network_and_the_registration_decode_once_each(session, matching, monkeypatch, tracker, passes):
    counted = count_passes(monkeypatch)
    result = measure(session(tracker=tracker, correspondence="vggt"))
    assert set(result.made.values()) == {1}
    assert set(counted["passes"].values()) == {passes}
    assert set(counted["opened"].values()) == {1}


def test_a_network_alone_says_what_it_does_not_know(session, matching):
    result = measure(session(tracker="vggt"))
    error = result.displacement["displacement"].values - TRUE_MM[:, None]
    seen = result.displacement["status"].values[1:] == Status.OK
    stated = result.displacement["expanded_uncertainty"].values
    # Whole pixels of 12 mm: the result is poor, and its uncertainty (k = 2) says so.
    assert seen.mean() > 0.9
    assert np.median(stated[1:][seen][:, :2]) > 3
    assert np.sqrt(np.mean((error[1:][seen] / stated[1:][seen])[:, :2] ** 2)) < 1
    gain = next(check for check in result.audit.checks if check.name == "gain of injected shifts")
    assert gain.outcome.value == "caution"
    assert "not known" in gain.sentence


def test_the_network_carries_points_to_the_other_view(session, matching, monkeypatch):
    asked = []

    def locate(network, first, second, points2d):
        asked.append((type(network).__name__, first.shape, len(points2d)))
        return np.full(points2d.shape, np.nan)

    monkeypatch.setattr("vfm_sdm.stages.matching.network.locate_points", locate)
    chosen = session(correspondence="vggt")
    solution = Measurement(chosen).cameras
    assert {(name, count) for name, _, count in asked} == {("MatchingNetwork", len(chosen.point))}
    # It saw nothing, so the points were looked for as without it.
    plain = Measurement(session()).cameras
    np.testing.assert_allclose(solution.points["position"], plain.points["position"], atol=1e-9)


def test_a_place_that_the_network_names_is_registered(session, matching, monkeypatch):
    plain = Measurement(session()).cameras
    true = plain.points["position"].sel(view="right").values
    monkeypatch.setattr("vfm_sdm.stages.matching.network.locate_points", lambda *args: true + np.array([0.8, -0.6]))
    found = Measurement(session(correspondence="vggt")).cameras
    np.testing.assert_allclose(found.points["position"].sel(view="right"), true, atol=0.05)


@pytest.mark.parametrize("fields", [{"tracker": "vggt"}, {"tracker": "tapir+icgn"}, {"correspondence": "vggt"}])
def test_missing_weights_stop_before_any_work(session, fields, tmp_path):
    with pytest.raises(BackendUnavailableError, match=r"expected a file, got .*absent\.pt"):
        measure(session(**fields, network=Network(weights=str(tmp_path / "absent.pt"))), tmp_path / "run")
    with pytest.raises(BackendUnavailableError, match="vfm-sdm weights fetch"):
        measure(session(**fields, network=Network()), tmp_path / "run")


def test_another_weights_file_means_other_tracks(session, matching, tmp_path):
    folder = tmp_path / "run"
    measure(session(tracker="vggt+icgn"), folder)
    again = Measurement(session(tracker="vggt+icgn"), folder)
    assert again.tracks
    assert again.reused == ["cameras", "tracking"]
    other = tmp_path / "other.safetensors"
    other.write_bytes(b"other")
    network = Network(weights=str(other), device="cpu")
    changed = Measurement(session(tracker="vggt+icgn", network=network), folder)
    assert changed.tracks
    assert "tracking" not in changed.reused
