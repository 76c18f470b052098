"""One suite over every tracker: what any of them promises, whatever its method.

Networks have random weights here. What they promise without knowing anything is tested on them as on all; that they
follow a motion is shown with stand-ins (`tests/unit/tracking`) and with real weights (`-m weights`).
"""

from collections import namedtuple
from contextlib import nullcontext

import cv2
import numpy as np
import pytest

from plugins import example_package, example_parts, installed
from small_networks import NETWORK_TRACKERS, ROUNDING_PX, in_double, small_tracker
from textures import WaveTexture
from vfm_sdm.core.datasets import Status, check_tracks
from vfm_sdm.core.parts import BUILT_IN
from vfm_sdm.errors import BackendUnavailableError, DatasetError
from vfm_sdm.inputs.video import open_images
from vfm_sdm.stages.tracking.base import find_tracker

TRACKERS = [*(name for name in BUILT_IN["trackers"] if name != "file"), "lucas-kanade"]
"""Those of this package, and the example of CONTRIBUTING.md; one that only reads tracks sees nothing (its own tests:
``tests/unit/stages/tracking/test_file_tracker.py``)."""
SHAPE = (220, 260)
FRAMES = 12
POINTS = np.array([[80.25, 90.5], [170.0, 120.75], [120.5, 150.0]])
ACCURACY_PX = {"icgn": 0.01, "template": 0.06, "lucas-kanade": 0.05}
"""Largest error on a clean texture; the template's resolution is 1/16 px."""


@pytest.fixture(scope="module", autouse=True)
def example(tmp_path_factory):
    with installed(tmp_path_factory.mktemp("site"), example_parts(), example_package()):
        yield


def motion(frame):
    return 2.5 * np.sin(2 * np.pi * frame / 9), 1.5 * np.cos(2 * np.pi * frame / 7) - 1.5


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip")
    texture = WaveTexture(3)
    for frame in range(FRAMES):
        image = np.clip(np.rint(texture.image(SHAPE, motion(frame))), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{frame:03}.png"), image)
    return str(folder / "*.png")


@pytest.fixture(params=sorted(TRACKERS))
def tracker(request, tmp_path):
    return small_tracker(request.param, tmp_path)


@pytest.fixture(params=sorted(set(TRACKERS) - set(NETWORK_TRACKERS)))
def seeing(request):
    """A tracker that needs no weights to see."""
    return find_tracker(request.param)


Tracked = namedtuple("Tracked", ["tracker", "tracks", "seen"])
"""A tracker, its tracks of the clip, and how many frames it said that it had seen, each time that it said so."""


@pytest.fixture(scope="module")
def track_once(clip, tmp_path_factory):
    """`Tracked` by name of the tracker: networks take a second for what many tests look at."""
    found = {}

    def of_name(name):
        if name not in found:
            tracker, seen = small_tracker(name, tmp_path_factory.mktemp("tracker")), []
            tracks = track(tracker, clip, progress=lambda what, done, total: seen.append(done))
            found[name] = Tracked(tracker, tracks, seen)
        return found[name]

    return of_name


@pytest.fixture(params=sorted(TRACKERS))
def tracked(request, track_once):
    return track_once(request.param)


def track(tracker, clip, points=POINTS, names=("a", "b", "c"), **options):
    return tracker.track(open_images(clip, 30.0), points, names=list(names), **options)


def test_follows_a_known_motion(seeing, clip):
    tracks = check_tracks(track(seeing, clip))
    true = POINTS + np.array([motion(i) for i in range(FRAMES)])[:, None]
    assert np.abs(tracks["position"].values - true).max() <= ACCURACY_PX[seeing.name]
    assert (tracks["status"].values == Status.OK).all()


def test_says_what_it_is(tracked):
    tracks = check_tracks(tracked.tracks)
    assert tracks.attrs["tracker"] == tracked.tracker.name
    assert (tracks.attrs["image_width"], tracks.attrs["image_height"]) == SHAPE[::-1]
    assert list(tracks["point"].values) == ["a", "b", "c"]
    np.testing.assert_allclose(tracks["time"].values, np.arange(FRAMES) / 30, atol=1e-9)


def test_states_a_covariance_for_every_position(tracked):
    tracks = tracked.tracks
    covariance = tracks["position_covariance"].values
    found = np.isfinite(tracks["position"].values).all(axis=-1)
    assert np.isfinite(covariance[found]).all()
    assert (np.linalg.eigvalsh(covariance[found]) >= 0).all()
    assert (np.einsum("tpii->tp", covariance)[1:][found[1:]] > 0).all()


def test_a_position_is_missing_where_the_status_says_so(tracked):
    tracks = tracked.tracks
    gone = np.isin(tracks["status"].values, [Status.LOST, Status.OUTSIDE])
    np.testing.assert_array_equal(np.isnan(tracks["position"].values).any(axis=2), gone)
    np.testing.assert_array_equal(np.isnan(tracks["position_covariance"].values).any(axis=(2, 3)), gone)


def test_the_reference_frame_is_as_given(tracked):
    np.testing.assert_allclose(tracked.tracks["position"].values[0], POINTS, atol=1e-9)


def test_is_deterministic(tracked, clip):
    again = track(tracked.tracker, clip)
    np.testing.assert_array_equal(tracked.tracks["position"].values, again["position"].values)


def test_points_do_not_influence_each_other(tracker, clip):
    network = tracker.name in NETWORK_TRACKERS
    with in_double(tracker) if network else nullcontext():
        together = track(tracker, clip)["position"].values[:, 1]
        alone = track(tracker, clip, POINTS[1:2], names=("b",))["position"].values[:, 0]
    np.testing.assert_allclose(alone, together, rtol=0, atol=ROUNDING_PX if network else 1e-9)


@pytest.mark.parametrize("name", NETWORK_TRACKERS)
def test_networks_say_which_weights_and_precision(name, track_once):
    attrs = track_once(name).tracks.attrs
    assert attrs["weights"].startswith("random-")
    assert attrs["precision"] == "float32"


def test_reference_frame_may_be_another_one(seeing, clip):
    start = POINTS + np.array(motion(5))
    tracks = track(seeing, clip, start, reference_frame=5)
    true = POINTS + np.array([motion(i) for i in range(FRAMES)])[:, None]
    assert np.abs(tracks["position"].values - true).max() <= ACCURACY_PX[seeing.name]


def test_missing_is_nan_and_named(seeing, tmp_path):
    """A texture that vanishes: no number may stand for it."""
    texture = WaveTexture(4)
    for frame in range(6):
        image = texture.image(SHAPE) if frame < 3 else np.random.default_rng(frame).normal(128, 3, SHAPE)
        cv2.imwrite(str(tmp_path / f"{frame}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))
    tracks = track(seeing, str(tmp_path / "*.png"))
    assert (tracks["status"].values[:3] == Status.OK).all()
    assert (tracks["status"].values[3:] == Status.LOST).all()
    assert np.isnan(tracks["position"].values[3:]).all()


def test_progress_counts_every_frame(tracked):
    assert tracked.seen[-1] == FRAMES
    assert tracked.seen == sorted(tracked.seen)


def test_names_and_points_must_agree(tracker, clip):
    with pytest.raises(DatasetError, match="expected one distinct name a point, got 3 points and names"):
        track(tracker, clip, names=("a", "b"))


def test_points_outside_the_image_are_refused(tracker, clip):
    with pytest.raises(DatasetError, match=r"inside 260 x 220, got a at \[500.0, 20.0\]"):
        track(tracker, clip, np.array([[500.0, 20.0]]), names=("a",))


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(
        BackendUnavailableError,
        match=r"expected one of \['file', 'icgn', 'lucas-kanade', 'tapir',.*\], got 'ignc'; did you mean 'icgn'",
    ):
        find_tracker("ignc")
