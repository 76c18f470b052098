"""Feature matches before any geometric check, on textures whose true displacement is known."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.matching import features
from vfm_sdm.stages.matching.detection import add_stretched, detect_features, find_mutual, to_eight_bit
from vfm_sdm.stages.matching.features import FeatureMatches, keep_one_a_place, match_detected, match_features


def textured(rng, shape=(300, 400)):
    noise = gaussian_filter(rng.normal(size=shape), 2)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)


def share_right(matches, true_second, tolerance_px=2.0):
    """Number of matches within a tolerance of the truth, and of all."""
    apart = np.linalg.norm(matches.points_second - true_second(matches.points_first), axis=1)
    return int((apart < tolerance_px).sum()), len(matches)


class TestMatchFeatures:
    def test_matches_of_a_shifted_image_are_the_shift(self):
        image = textured(np.random.default_rng(1), (340, 460))
        found = match_features(image[20:320, 30:430], image[10:310, 5:405])
        assert len(found) > 50
        np.testing.assert_allclose(np.median(found.points_second - found.points_first, axis=0), [25, 10], atol=0.05)

    def test_large_images_are_reduced_without_a_shift_of_half_a_pixel(self):
        small = textured(np.random.default_rng(2), (500, 1200))
        # Every pixel becomes a block of 3 x 3, so pixel k of the small image is centred on 3 k + 1 of the large one.
        large = np.kron(small, np.ones((3, 3), np.uint8))
        found = match_features(small, large)
        assert len(found) > 100
        apart = found.points_second - (3 * found.points_first + 1)
        np.testing.assert_allclose(np.median(apart, axis=0), 0, atol=0.2)

    def test_nothing_to_match_is_an_empty_set(self):
        flat = np.full((200, 200), 90, np.uint8)
        found = match_features(flat, flat)
        assert found.points_first.shape == found.points_second.shape == (0, 2)

    @pytest.mark.parametrize("axis", [0, 1])
    @pytest.mark.parametrize("swapped", [False, True])
    def test_a_view_compressed_to_half_in_one_direction_is_matched(self, axis, swapped):
        image = textured(np.random.default_rng(3), (300, 400))
        factor = np.array([0.5, 1.0] if axis == 0 else [1.0, 0.5])
        size = tuple(int(n) for n in np.rint(np.array(image.shape[::-1]) * factor))
        oblique = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        pair = (oblique, image) if swapped else (image, oblique)
        gain = 1 / factor if swapped else factor
        found = match_features(*pair)
        right, total = share_right(found, lambda u: (u + 0.5) * gain - 0.5)
        plain = match_detected(*map(detect_features, pair))
        assert right > 80
        assert right > 0.8 * total
        # Without the stretched versions there are far fewer.
        assert right > 2 * len(plain)

    def test_the_same_corner_has_the_same_digits_in_every_version(self):
        image = textured(np.random.default_rng(4))
        found = add_stretched(detect_features(image), image)
        plain = {tuple(u) for u in found.points[found.version == 0]}
        stretched = [tuple(u) for u in found.points[found.version > 0]]
        assert np.mean([u in plain for u in stretched]) > 0.5

    def test_look_alikes_within_one_view_count(self, monkeypatch):
        rng = np.random.default_rng(6)
        tile, rest = textured(rng, (200, 100)), textured(rng, (200, 300))
        image = np.hstack([tile, tile, tile, rest])
        noisy = [np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8) for _ in range(2)]
        # The second view shows one tile alone: in it nothing tells that there are more.
        pair = [detect_features(noisy[0]), detect_features(noisy[1][:, 200:])]
        found = match_detected(*pair)
        monkeypatch.setattr(features, "find_alike", lambda _, rows: np.full(rows.size, np.inf, np.float32))
        unaware = match_detected(*pair)
        apart = [m.points_first - m.points_second - [200, 0] for m in (found, unaware)]
        right, unaware_right = (np.abs(one).max(axis=1) < 5 for one in apart)
        assert right.sum() > 0.95 * unaware_right.sum()
        assert (~right).sum() < 0.85 * (~unaware_right).sum()
        assert np.median(found.quality[right]) > 0.7
        assert np.median(found.quality[~right]) < 0.5
        assert (np.diff(found.quality) <= 0).all()
        assert ((found.quality > 0) & (found.quality <= 1)).all()


class TestFeatureMatches:
    def test_refuse_arrays_of_different_length(self):
        with pytest.raises(DatasetError, match="feature matches: expected arrays of one length, got 2, 2 and 1"):
            FeatureMatches(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(1))

    def test_one_a_place_in_either_image(self):
        first = np.array([[10.0, 10.0], [11.0, 10.0], [50.0, 10.0], [90.0, 10.0]])
        second = np.array([[10.0, 10.0], [99.0, 10.0], [10.0, 11.0], [70.0, 10.0]])
        kept = keep_one_a_place(FeatureMatches(first, second, [0.9, 0.5, 0.4, 0.1]), 2.5)
        assert kept.quality.tolist() == [0.9, 0.1]


def test_sixteen_bit_is_stretched():
    image = np.array([[100, 1100], [600, 350]], np.uint16)
    assert to_eight_bit(image).tolist() == [[0, 255], [128, 64]]


def test_mutual_pairs_and_their_rivals_are_those_of_a_search_one_by_one():
    rng = np.random.default_rng(4)
    likeness = rng.uniform(0, 0.99, (60, 50)).astype(np.float32)
    places = rng.uniform(0, 40, (60, 2)), rng.uniform(0, 40, (50, 2))
    rows, columns, distance, rival = find_mutual(likeness.copy(), places, (6.0, 6.0))
    mutual = [(i, j) for i, j in enumerate(likeness.argmax(axis=1)) if likeness[:, j].argmax() == i]
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == mutual
    for (i, j), near, far in zip(mutual, distance, rival, strict=True):
        elsewhere = np.linalg.norm(places[1] - places[1][j], axis=1) > 6
        others = np.linalg.norm(places[0] - places[0][i], axis=1) > 6
        best = max(likeness[i, elsewhere].max(), likeness[others, j].max())
        assert near == pytest.approx(np.sqrt(2 - 2 * likeness[i, j]), rel=1e-5)
        assert far == pytest.approx(np.sqrt(2 - 2 * best), rel=1e-5)
