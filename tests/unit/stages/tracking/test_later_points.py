"""Points that are hidden in the first frame, named in a later one: tracked where they are seen, to their full size."""

import cv2
import numpy as np
import pytest
import xarray as xr

from drifting_plate import FPS, POINTS, motion, pictures
from vfm_sdm.core.datasets import Status, make_points
from vfm_sdm.core.executors import ProcessWorkers
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.video import open_images
from vfm_sdm.stages.tracking.base import check_later_points
from vfm_sdm.stages.tracking.design.samples import find_hidden
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.segments import Work
from vfm_sdm.stages.tracking.subset_design import design_subsets
from vfm_sdm.stages.tracking.template import TemplateTracker
from vfm_sdm.stages.tracking.views import track_views

FRAMES, GONE, NAMED = 60, 24, 37
"""Frames in all; the one in which the lorry has left; the one in which the hidden points are named."""
NAMES = ("a", "b", "c", "d")
HIDDEN = ("b", "c")
HOME, MOVED = np.array([POINTS[name] for name in NAMES]), motion(FRAMES)
LATE = np.array([name in HIDDEN for name in NAMES])


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """The plate, whose right half a lorry hides for the first 24 frames."""
    folder, rng = tmp_path_factory.mktemp("lorry"), np.random.default_rng(1)
    lorry = 90 + 400 * cv2.GaussianBlur(rng.normal(0, 1, (141, 195)), (0, 0), 4.0)
    for number, picture in enumerate(pictures(MOVED)):
        if number < GONE:
            picture[:141, 125:] = np.clip(lorry + rng.normal(0, 1.5, lorry.shape), 16, 235).round().astype(np.uint8)
        cv2.imwrite(str(folder / f"{number:03}.png"), picture)
    return open_images(folder / "*.png", fps=FPS)


def points_of(numbers, places=None):
    """Points of a view named in frames of these numbers, where they are there."""
    position = HOME + MOVED[numbers] - MOVED[0] if places is None else places
    points = make_points(["cam"], NAMES, position=position[None], position_std=0 * position[None], status=[["ok"] * 4])
    return points.assign(frame=(("view", "point"), np.array([numbers])))


LATER = np.where(LATE, NAMED, 0)


def track(video, numbers=LATER, *, tracker=None, segment_s=60.0, subsets=None, executor=None, places=None):
    tracker = tracker or IcgnTracker(subset_px=31)
    work = Work(segment_s, executor)
    return track_views({"cam": video}, points_of(numbers, places), tracker, subsets=subsets, work=work)["cam"]


def designed(video):
    found = {}
    for number in sorted({*LATER.tolist()}):
        names = [name for name, own in zip(NAMES, LATER, strict=True) if own == number]
        places = points_of(LATER)["position"].sel(view="cam", point=names).values
        choices = design_subsets(video, places, names, reference_frame=number)
        found |= dict(zip(names, choices, strict=True))
    return {"cam": found}


def errors(tracks):
    return tracks["position"].values - (HOME + (MOVED - MOVED[0])[:, None])


def check(tracks, *, within_px=0.05):
    """Hidden points are lost before, and all are where they are."""
    status, late = tracks["status"].values, LATE
    assert not np.isin(status[: GONE - 1, late], [Status.OK, Status.UNRELIABLE]).any()
    assert (status[:, ~late] == Status.OK).all()
    assert (status[GONE:, late] == Status.OK).all()
    assert np.nanmax(np.abs(errors(tracks))) < within_px
    named = tracks["position"].values[NAMED, late]
    np.testing.assert_allclose(named, (HOME + MOVED[NAMED] - MOVED[0])[late], atol=1e-6)


@pytest.mark.parametrize("segment_s", [60.0, 1.0])
@pytest.mark.parametrize("tracker", [IcgnTracker(subset_px=31), TemplateTracker(subset_px=31)])
def test_a_point_behind_a_lorry_is_lost_there_and_right_after_it(video, tracker, segment_s):
    tracks = track(video, tracker=tracker, segment_s=segment_s)
    assert tracks.attrs["recording"]["segments"] == (1 if segment_s > 10 else 6)
    check(tracks, within_px=0.05 if tracker.name == "icgn" else 0.1)
    np.testing.assert_array_equal(tracks["reference"].values, np.broadcast_to(LATER, (FRAMES, 4)))


@pytest.mark.slow
def test_designed_subsets_are_those_of_the_frame_that_shows_the_point(video):
    subsets = designed(video)
    # Two fifths of the samples show the lorry, and none of them votes: all of a plate moves with its points.
    assert all(choice.believed > 0.9 and choice.design is not None for choice in subsets["cam"].values())
    found = {}
    for segment_s in (60.0, 1.0):
        tracks = track(video, tracker=IcgnTracker(), subsets=subsets, segment_s=segment_s)
        late = tracks["status"].values[:, LATE]
        assert (late[GONE + 5 :] == Status.OK).all()
        assert not (late[: GONE - 5] == Status.OK).any()
        ok = tracks["status"].values == Status.OK
        # The error is stated: of the reference frame's noise, which all frames of a point share, and of their own.
        std = np.sqrt(np.einsum("tpii->tpi", tracks["position_covariance"].values))[ok]
        error = np.abs(errors(tracks)[ok])
        assert error.max() < 0.05
        assert 0.3 < np.sqrt(np.mean((error / np.maximum(std, 1e-3)) ** 2)) < 2.0
        found[segment_s] = tracks["position"].values
    both = np.isfinite(found[60.0]) & np.isfinite(found[1.0])
    np.testing.assert_allclose(found[1.0][both], found[60.0][both], atol=2e-3)


def test_it_does_not_matter_who_tracks(video):
    here = track(video, segment_s=2.0)
    with ProcessWorkers(1) as workers:
        there = track(video, segment_s=2.0, executor=workers)
    xr.testing.assert_identical(there.drop_attrs(), here.drop_attrs())


def test_a_point_that_was_there_all_along_is_tracked_back_to_the_first_frame(video):
    numbers = np.array([NAMED, NAMED, NAMED, 59])
    first = track(video, np.zeros(4, int), places=np.where(LATE[:, None], HOME[0], HOME))
    for segment_s in (60.0, 1.0):
        tracks = track(video, numbers, segment_s=segment_s)
        assert (tracks["status"].values[:, ~LATE] == Status.OK).all()
        assert np.abs(errors(tracks)[:, ~LATE]).max() < 0.05
        # Compared with another frame, whose noise is another.
        np.testing.assert_allclose(tracks["position"].values[:, ~LATE], first["position"].values[:, ~LATE], atol=0.03)


def test_trackers_that_begin_with_the_first_frame_refuse_such_points(video):
    class Other:
        name = "other"

        def track(self, video, points2d, *, names, reference_frame=0, progress=None):
            raise AssertionError

    with pytest.raises(SessionError, match=r"'b', 'c': expected points of the first frame.*'other'.*choose tracker"):
        track(video, tracker=Other())
    check_later_points(Other(), [])


def test_frames_that_show_something_else_are_told():
    rng = np.random.default_rng(0)
    plate = cv2.GaussianBlur(rng.normal(128, 90, (121, 121)), (0, 0), 2.0)
    others = cv2.GaussianBlur(rng.normal(128, 90, (121, 121)), (0, 0), 2.0)
    shown = [np.roll(plate, 25, axis=0) + rng.normal(0, 2, plate.shape), others, np.full_like(plate, 7.0)]
    frames = np.clip([plate, *shown], 0, 255).astype(np.uint8)
    assert find_hidden(frames, 41).tolist() == [False, True, True]
