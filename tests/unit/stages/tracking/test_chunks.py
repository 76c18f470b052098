"""Chunks of a recording, joined: exact wherever the network is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from standins import KnownMotion, numbered, swaying
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.stages.tracking.chunks import ChunkPlan, ChunkStitcher

QUERIES = np.array([[60.25, 70.5], [80.0, 64.75]])
PAPER, ANCHORED = ChunkPlan(12, overlap=4), ChunkPlan(12)


def stitch(network, plan, frames):
    stitcher = ChunkStitcher(network, plan, QUERIES)
    for index in range(frames):
        stitcher.feed(numbered(index))
    return stitcher.finish(), stitcher


def truth(frames):
    return QUERIES + (np.array([swaying(i) for i in range(frames)]) - swaying(0))[:, None]


@pytest.mark.parametrize("plan", [PAPER, ANCHORED, ChunkPlan(144, overlap=32), ChunkPlan(32)])
@pytest.mark.parametrize("frames", [1, 2, 5, 11, 12, 13, 20, 21, 50, 400])
def test_a_known_motion_comes_out_exactly(plan, frames):
    found, _ = stitch(KnownMotion(swaying), plan, frames)
    np.testing.assert_allclose(found.positions, truth(frames), atol=1e-9)
    assert found.visibility.shape == found.confidence.shape == (frames, 2)


@settings(max_examples=60, deadline=None)
@given(st.integers(8, 40), st.integers(0, 19), st.integers(1, 130))
def test_any_plan_is_exact(length, overlap, frames):
    found, _ = stitch(KnownMotion(swaying), ChunkPlan(length, overlap=min(overlap, length // 2)), frames)
    np.testing.assert_allclose(found.positions, truth(frames), atol=1e-9)


def test_the_papers_recording_takes_four_calls():
    network = KnownMotion(swaying)
    stitch(network, ChunkPlan(144, overlap=32), 480)
    assert [(numbers[0], numbers[-1]) for numbers, _, _ in network.calls] == [
        (0, 143),
        (112, 255),
        (224, 367),
        (336, 479),
    ]


def test_a_chunk_starts_where_the_one_before_ended():
    network = KnownMotion(swaying)
    stitch(network, PAPER, 40)
    for numbers, queries, _ in network.calls[1:]:
        np.testing.assert_allclose(queries, truth(40)[numbers[0]], atol=1e-9)


def test_an_offset_of_a_whole_chunk_is_taken_out_at_the_overlap():
    network = KnownMotion(swaying, bias=lambda call: [0.3 * call, -0.1 * call])
    found, _ = stitch(network, PAPER, 60)
    np.testing.assert_allclose(found.positions, truth(60), atol=1e-9)


def test_anchored_chunks_do_not_add_up_errors():
    network = KnownMotion(swaying, bias=lambda call: [0.2, 0.0])
    found, _ = stitch(network, ANCHORED, 200)
    error = found.positions[1:] - truth(200)[1:]
    np.testing.assert_allclose(error, np.broadcast_to([0.2, 0.0], error.shape), atol=1e-9)
    assert {numbers[0] for numbers, _, _ in network.calls} == {0}
    for _, queries, _ in network.calls:
        np.testing.assert_array_equal(queries, QUERIES)


def test_hidden_frames_do_not_decide_the_offset():
    """A chunk that calls the overlap hidden says nothing about where it was."""
    network = KnownMotion(swaying, bias=lambda call: [5.0, 0.0] if call > 1 else [0, 0], visibility=lambda i: 0.0)
    found, _ = stitch(network, PAPER, 20)
    assert found.positions[19, 0, 0] - truth(20)[19, 0, 0] == pytest.approx(5.0)


@pytest.mark.parametrize("plan", [ChunkPlan(64, overlap=16), ChunkPlan(64)])
@pytest.mark.parametrize("fits", [8, 13, 40])
def test_memory_that_runs_out_makes_smaller_chunks_of_the_same_result(plan, fits):
    network = KnownMotion(swaying, fits=fits)
    found, stitcher = stitch(network, plan, 150)
    np.testing.assert_allclose(found.positions, truth(150), atol=1e-9)
    assert 8 <= stitcher.plan.frames <= fits


def test_memory_may_run_out_later_than_in_the_first_chunk():
    """The frames that chunks share are then more than a chunk may hold."""
    network = KnownMotion(swaying)
    stitcher = ChunkStitcher(network, ChunkPlan(64, overlap=16), QUERIES)
    for index in range(170):
        network.fits = 8 if index > 130 else None
        stitcher.feed(numbered(index))
    found = stitcher.finish()
    np.testing.assert_allclose(found.positions, truth(170), atol=1e-9)
    assert stitcher.plan.frames == 8


def test_memory_that_is_planned_with_is_not_exceeded():
    network = KnownMotion(swaying, plan=20)
    found, stitcher = stitch(network, ChunkPlan(144, overlap=32), 90)
    np.testing.assert_allclose(found.positions, truth(90), atol=1e-9)
    assert max(len(numbers) for numbers, _, _ in network.calls) == 20
    assert stitcher.plan.overlap == 5


def test_no_memory_at_all_is_one_line():
    with pytest.raises(
        BackendUnavailableError, match=r"expected room for 8 frames of 140 x 140 px.*set another device"
    ):
        stitch(KnownMotion(swaying, fits=4), ANCHORED, 30)
