"""Tracks of designed subsets: edges, masks, points that are left out, and what the tracks say of them."""

import numpy as np
import pytest
from scipy.special import erf

from moving_frames import NOISE, NaturalTexture, digitize, memory_video
from vfm_sdm.core.datasets import UNMEASURED_STD_PX, Status, check_tracks
from vfm_sdm.stages.registration.subsets import SubsetDesign, Warp
from vfm_sdm.stages.tracking.icgn import IcgnTracker

SIZE = 256
ACROSS = np.array([0.6, 0.8])
ALONG = np.array([-0.8, 0.6])


@pytest.fixture(scope="module")
def texture():
    return NaturalTexture(21, contrast=28)


def track(frames, points, designs):
    names = [f"point {k}" for k in range(len(points))]
    return check_tracks(IcgnTracker().track(memory_video(frames), points, names=names, designs=designs))


def edge_frame(moved, rng, hidden=False):
    u, v = np.meshgrid(np.arange(200.0), np.arange(200.0))
    distance = (u - 100) * ACROSS[0] + (v - 100) * ACROSS[1] - moved
    image = 110 + 30 * erf(distance / 2.5)
    if hidden:
        image[60:140, 60:140] = 128
    return digitize(image, rng, 1.0)


def test_an_edge_is_followed_across(texture):
    rng = np.random.default_rng(1)
    moved = 3 * np.sin(np.arange(60) / 6)
    points = np.array([[100.0, 100.0], [88.3, 108.6]])
    designs = [SubsetDesign(41, Warp.EDGE, across=ACROSS)] * 2
    tracks = track([edge_frame(m, rng) for m in moved], points, designs)
    step = tracks["position"].values - points
    assert (tracks["status"] == Status.OK).all()
    np.testing.assert_allclose(step @ ALONG, 0, atol=1e-9)
    error = step @ ACROSS - moved[:, None]
    assert np.sqrt(np.mean(error**2)) < 0.02
    covariance = tracks["position_covariance"].values
    np.testing.assert_allclose(ALONG @ covariance @ ALONG, UNMEASURED_STD_PX**2, rtol=1e-6)
    assert tracks["warp"].values.tolist() == ["edge", "edge"]
    np.testing.assert_allclose(tracks["edge_across"].values, [ACROSS, ACROSS])


def test_a_hidden_edge_is_found_again_after_a_jump_across():
    rng = np.random.default_rng(4)
    moved = np.repeat([0.0, 12.0], 6)
    hidden = np.arange(12) == 5
    frames = [edge_frame(m, rng, h) for m, h in zip(moved, hidden, strict=True)]
    tracks = track(frames, np.array([[100.0, 100.0]]), [SubsetDesign(41, Warp.EDGE, across=ACROSS)])
    status = tracks["status"].values[:, 0]
    assert status[5] == Status.LOST
    assert (np.delete(status, 5) == Status.OK).all()
    step = np.delete(tracks["position"].values[:, 0] - [100, 100], 5, axis=0)
    np.testing.assert_allclose(step @ ACROSS, np.delete(moved, 5), atol=0.06)
    np.testing.assert_allclose(step @ ALONG, 0, atol=1e-9)


def test_another_tracker_does_not_move_an_edge_along():
    rng = np.random.default_rng(3)
    frames = [edge_frame(m, rng) for m in (0.0, 0.5, 1.0)]
    expected = np.array([100.0, 100.0]) + np.array([0.0, 0.5, 1.0])[:, None, None] * ACROSS + 2 * ALONG
    design = SubsetDesign(41, Warp.EDGE, across=ACROSS)
    tracker = IcgnTracker().starting_from(expected)
    tracks = tracker.track(memory_video(frames), np.array([[100.0, 100.0]]), names=["edge"], designs=[design])
    step = tracks["position"].values[:, 0] - [100, 100]
    np.testing.assert_allclose(step @ ALONG, 0, atol=1e-9)
    np.testing.assert_allclose(step @ ACROSS, [0.0, 0.5, 1.0], atol=0.05)


def test_what_is_masked_does_not_pull(texture):
    """The right of the subset shows a background that stands still; a search after a jump leaves it out, too."""
    rng = np.random.default_rng(2)
    still = NaturalTexture(5, contrast=28).image()
    mask = np.ones((41, 41), np.bool_)
    mask[:, 18:] = False
    shifts = np.column_stack([np.repeat([0.0, 0.4, 9.3], 4), np.zeros(12)])
    frames = []
    for shift in shifts:
        image = texture.image(-shift)
        image[:, 127:] = still[:, 127:]
        frames.append(digitize(image, rng, NOISE))
    point = np.array([[128.0, 120.0]])
    tracks = track(frames, point, [SubsetDesign(41, Warp.TRANSLATION, mask=mask)])
    assert (tracks["status"] == Status.OK).all()
    np.testing.assert_allclose(tracks["position"].values[:, 0] - point, -shifts, atol=0.04)
    assert tracks["believed"].values.item() == pytest.approx(18 / 41)


def test_a_point_without_a_design_is_not_tracked(texture):
    frames = [digitize(texture.image((s, 0.0))) for s in (0.0, 0.3)]
    points = np.array([[128.0, 128.0], [80.3, 110.7]])
    tracks = track(frames, points, [None, SubsetDesign(31, Warp.SIMILARITY)])
    assert (tracks["status"].values == [[Status.LOST, Status.OK]] * 2).all()
    assert np.isnan(tracks["position"].values[:, 0]).all()
    np.testing.assert_allclose(tracks["position"].values[1, 1] - points[1], [0.3, 0.0], atol=0.01)
    assert tracks["warp"].values.tolist() == ["", "similarity"]
    assert tracks["subset_px"].values.tolist() == [0, 31]


def test_without_designs_tracks_say_nothing_of_them(texture):
    tracks = track([digitize(texture.image())] * 2, np.array([[128.0, 128.0]]), None)
    assert not {"warp", "edge_across", "believed", "subset_px"} & set(tracks.variables)


def test_halves_state_their_own_noise(texture):
    """The halves of a masked subset, of which the right one has few pixels, move together within what they state."""
    rng = np.random.default_rng(6)
    mask = np.ones((41, 41), np.bool_)
    mask[:, 30:] = False
    shifts = np.column_stack([np.sin(np.arange(80) / 3), np.zeros(80)])
    frames = [digitize(texture.image(shift), rng, NOISE) for shift in shifts]
    tracks = track(frames, np.array([[128.0, 120.0]]), [SubsetDesign(41, Warp.TRANSLATION, mask=mask)])
    apart, covariance = tracks["half_difference"].values[4::4, 0], tracks["half_covariance"].values[4::4, 0]
    square = np.einsum("ti,tij,tj->t", apart, np.linalg.inv(covariance), apart) / 2
    assert 0.5 < square.mean() < 1.8
    assert np.isnan(tracks["half_covariance"].values[1]).all()
