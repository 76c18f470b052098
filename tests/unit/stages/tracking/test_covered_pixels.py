"""What covers some pixels of a designed subset for a frame, a rain streak or a leaf, does not move its point."""

import numpy as np
import pytest
from scipy.special import erf

from moving_frames import NaturalTexture, digitize, memory_video
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.registration.subsets import SubsetDesign, Warp
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.lone_errors import include_lone_errors

SIZE, FRAMES, NOISE = 192, 40, 2.0
MIDDLE = np.array([96.0, 96.0])
COVERED = (6, 13, 19)
u, v = np.meshgrid(np.arange(float(SIZE)), np.arange(float(SIZE)))


def streak(place_px, slant_deg, *, lift=0.12, sigma_px=1.5, length_px=10):
    """Share by which a drop's streak lifts luma to white, centred at a place (2,), slanted from the vertical."""
    along = np.array([np.sin(np.deg2rad(slant_deg)), np.cos(np.deg2rad(slant_deg))])
    du, dv = u - place_px[0], v - place_px[1]
    side, run = du * along[1] - dv * along[0], du * along[0] + dv * along[1]
    ends = (erf((run + length_px / 2) / 2) - erf((run - length_px / 2) / 2)) / 2
    return lift * ends * np.exp(-((side / sigma_px) ** 2) / 2)


def follow(scene, moved, cover, design):
    """Errors (T, 2) [px], standard deviations of u [px] and status of a point in the scene's frames, some covered."""
    rng, frames = np.random.default_rng(3), []
    for number, shift in enumerate(moved):
        image = scene(shift)
        frames.append(digitize(cover(image, shift) if number in COVERED else image, rng, NOISE))
    tracks = IcgnTracker(subset_px=41).track(memory_video(frames), MIDDLE[None], names=["p"], designs=[design])
    tracks = include_lone_errors(tracks)  # what is left of it is stated
    error = tracks["position"].values[:, 0] - MIDDLE - moved
    return error, np.sqrt(tracks["position_covariance"].values[:, 0, 0, 0]), tracks["status"].values[:, 0]


def edge(shift):
    return 100 + 40 * erf((u - MIDDLE[0] - shift[0]) / 2.0)


@pytest.mark.parametrize("slant_deg", [0.0, 4.0, 8.0])
@pytest.mark.parametrize("beside_px", [-2.0, 0.0])
def test_a_streak_along_an_edge_does_not_move_it(slant_deg, beside_px):
    moved = np.stack([2 * np.sin(np.arange(FRAMES) / 10), np.zeros(FRAMES)], axis=1)

    def cover(image, shift):
        share = streak(MIDDLE + np.array([shift[0] + beside_px, 0]), slant_deg)
        return image + share * (255 - image)

    error, _, status = follow(edge, moved, cover, SubsetDesign(41, Warp.EDGE, across=np.array([1.0, 0.0])))
    assert (status == Status.OK).all()
    assert np.abs(error[:, 0]).max() < 0.1  # 0.14 to 0.2 px where all pixels count alike


@pytest.mark.parametrize("warp", [Warp.TRANSLATION, Warp.SIMILARITY, Warp.AFFINE])
def test_a_leaf_before_a_tenth_of_a_subset_does_not_move_it(warp):
    texture = NaturalTexture(8, size=SIZE, contrast=25)
    moved = np.stack([2 * np.sin(np.arange(FRAMES) / 3), np.cos(np.arange(FRAMES) / 4) - 1], axis=1)

    def cover(image, shift):
        leaf = np.hypot(u - MIDDLE[0] - 12, v - MIDDLE[1] + 9) < 7
        return np.where(leaf, 60.0, image)

    error, std, status = follow(texture.image, moved, cover, SubsetDesign(41, warp))
    seen = status == Status.OK
    assert np.abs(error[seen]).max() < 0.04
    assert seen[np.setdiff1d(np.arange(FRAMES), COVERED)].all()
    assert (np.abs(error[seen, 0][1:]) < 5 * std[seen][1:]).all()


@pytest.mark.parametrize("warp", [Warp.TRANSLATION, Warp.AFFINE])
def test_noise_alone_is_weighed_as_before(warp):
    texture = NaturalTexture(9, size=SIZE, contrast=25)
    moved = np.stack([2 * np.sin(np.arange(FRAMES) / 3), np.zeros(FRAMES)], axis=1)
    error, std, status = follow(texture.image, moved, lambda image, _: image, SubsetDesign(41, warp))
    assert (status == Status.OK).all()
    assert 0.5 < np.sqrt(np.mean((error[1:, 0] / std[1:]) ** 2)) < 1.5
