"""Parts of subsets: what they say of a whole subset's error, against the truth; and what passes before a subset."""

import numpy as np
import pytest
from scipy.special import erf

from moving_frames import digitize, memory_video
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.registration.subsets import SubsetDesign, Warp
from vfm_sdm.stages.tracking.icgn import IcgnTracker

POINT = np.array([[60.0, 60.0]])
MOTION = 0.8 * np.sin(np.arange(100) / 4)
UP = np.array([0.0, 1.0])
U, V = np.meshgrid(np.arange(120.0), np.arange(120.0))


def edge_frames(left, right, covered=()):
    """An edge that moves by other amounts left and right of the point, with 20 px between; dark bars before it."""
    rng, share = np.random.default_rng(3), np.clip((U - 50) / 20, 0, 1)
    frames = []
    for number, (a, b) in enumerate(zip(left, right, strict=True)):
        image = 110 + 30 * erf((V - 60 - a - share * (b - a)) / 2.5)
        if number in covered:
            image[:, 40:55] = 30
        frames.append(digitize(image, rng, 1.0))
    return frames


def track(frames):
    designs = [SubsetDesign(41, Warp.EDGE, across=UP)]
    tracks = IcgnTracker().track(memory_video(frames), POINT, names=["edge"], designs=designs)
    return tracks.isel(point=0)


def error_of(tracks):
    return tracks["position"].values[:, 1] - POINT[0, 1] - MOTION


@pytest.fixture(scope="module")
def clean():
    return track(edge_frames(MOTION, MOTION))


def test_a_subset_of_one_motion_is_taken_at_its_word(clean):
    assert np.std(error_of(clean)) < 0.02
    assert clean["part_noise"].values[0] < 0.02
    assert clean["part_gain_std"].values[0] < 0.015
    assert np.isnan(clean["part_noise"].values[1])  # along the edge


def test_the_gain_of_a_subset_that_holds_less_motion_is_uncertain():
    found = track(edge_frames(MOTION, 0.6 * MOTION))
    gain = np.polyfit(MOTION, found["position"].values[:, 1], 1)[0]
    assert gain < 0.9
    assert 0.5 * (1 - gain) < found["part_gain_std"].values[0] < 2 * (1 - gain)


def test_an_error_that_creeps_over_a_part_is_stated():
    creep = 0.3 * np.sin(np.arange(100) / 13)
    found = track(edge_frames(MOTION, MOTION + creep))
    error = np.std(error_of(found))
    assert error > 0.08
    assert 0.7 * error < found["part_noise"].values[0] < 1.5 * error


def test_what_passes_before_a_part_of_a_subset_is_lost_and_no_more():
    covered = np.arange(50, 54)
    found = track(edge_frames(MOTION, MOTION, covered.tolist()))
    assert (found["status"].values[covered] != Status.OK).all()
    assert (np.delete(found["status"].values, covered) == Status.OK).all()
    assert np.abs(np.delete(error_of(found), covered)).max() < 0.1
