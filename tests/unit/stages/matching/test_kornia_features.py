"""Matching by trained networks, with their published weights, on rendered views of known cameras."""

import sys

import numpy as np
import pytest

from rooms import room_frames, room_rig
from trained_weights import copy_trained_weights
from vfm_sdm.core.registry import make
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.geometry.triangulation import sampson_error
from vfm_sdm.inputs.session import Method, Network
from vfm_sdm.networks.availability import why_unavailable
from vfm_sdm.stages.matching.kornia_features import AUTOMATIC, KorniaMatcher, choose_matcher


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return copy_trained_weights(tmp_path_factory.mktemp("weights"))


@pytest.fixture
def weights(folder, monkeypatch):
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(folder))
    return folder


@pytest.fixture(scope="module")
def pair():
    rig = room_rig(size=(640, 480))
    return rig, list(room_frames(rig).values())


@pytest.mark.parametrize("name", AUTOMATIC)
class TestTrained:
    def test_most_matches_agree_with_the_true_cameras(self, weights, pair, name):
        rig, images = pair
        found = make("features", Method(matching=name)).match(images)[0, 1]
        error = np.abs(sampson_error(found.points_first, found.points_second, rig))
        assert len(found) > 200
        assert (error < 2).mean() > 0.9
        assert np.median(error) < 0.6
        assert ((found.quality > 0) & (found.quality <= 1)).all()
        assert (np.diff(found.quality) <= 0).all()

    def test_reduced_images_keep_their_pixels(self, weights, pair, name):
        image = pair[1][0]
        large = np.kron(image, np.ones((4, 4), np.uint8))[:1600, :2048]
        found = make("features", Method(matching=name)).match([image, large])[0, 1]
        # Pixel k of the small image is centred on 4 k + 1.5 of the large one, which is reduced to half.
        apart = found.points_second - (4 * found.points_first + 1.5)
        assert len(found) > 100
        np.testing.assert_allclose(np.median(apart, axis=0), 0, atol=1.0)

    def test_nothing_to_match_is_an_empty_set(self, weights, name):
        flat = np.full((96, 128), 90, np.uint8)
        found = make("features", Method(matching=name)).match([flat, flat])[0, 1]
        assert found.points_first.shape == (len(found), 2)

    def test_without_its_weights(self, weights, tmp_path, monkeypatch, name):
        monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path))
        assert "vfm-sdm weights fetch" in why_unavailable("features", name)
        with pytest.raises(BackendUnavailableError, match=r"expected .* got no such file; run `vfm-sdm weights fetch"):
            make("features", Method(matching=name))

    def test_keys_of_cameras_tell_its_weights_from_others(self, weights, name):
        chosen, automatic, without = (make("cameras", Method(matching=m)).weights_id for m in (name, "auto", "sift"))
        assert len(chosen.split("+")) == 2
        assert all(len(one.rpartition("-")[2]) == 12 for one in chosen.split("+"))
        assert (chosen == automatic) == (name == AUTOMATIC[0])
        assert without == ""


class TestAutomatic:
    def test_takes_a_network_whose_weights_are_here(self, weights):
        assert isinstance(choose_matcher(network=Network()), KorniaMatcher)

    def test_takes_sift_without_weights_and_reads_no_network(self, tmp_path, monkeypatch):
        monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path))
        assert make("features", Method(matching="auto")) is None
        assert make("features", Method(matching="sift")) is None

    def test_three_views_have_all_pairs_and_one_set_of_features(self, weights, pair):
        images = [*pair[1], pair[1][0][::2, ::2]]
        found = make("features", Method(matching="xfeat")).match(images)
        assert sorted(found) == [(0, 1), (0, 2), (1, 2)]
        first = {tuple(u) for u in found[0, 1].points_first}
        assert sum(tuple(u) in first for u in found[0, 2].points_first) > 0.5 * len(found[0, 2])


def test_without_kornia(monkeypatch, tmp_path):
    pytest.importorskip("torch")
    monkeypatch.setitem(sys.modules, "kornia.feature", None)
    with pytest.raises(BackendUnavailableError, match="matching by xfeat: expected the package kornia, got none"):
        KorniaMatcher("xfeat")
