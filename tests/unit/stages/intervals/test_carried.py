"""What an interval takes over from those before it."""

import itertools

import numpy as np
import pytest
import xarray as xr

from simulation import project_all, simple_rig
from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status
from vfm_sdm.inputs.session import Point, Session, View
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.intervals import Carried
from vfm_sdm.stages.intervals.carried import _Clock
from vfm_sdm.stages.intervals.division import Interval, divide_tracks
from vfm_sdm.stages.intervals.join import JoinedDisplacement
from vfm_sdm.stages.synchronize import align_views

RIG = simple_rig(3)
CLOCK = np.arange(60) / 30
POINTS = np.array([[0.5, -0.2, 21.0], [-1.5, 0.3, 25.0]])
HALVES = slice(0, 30), slice(30, 60)


def tracks_of(hidden=()):
    """Three views of two points that were clicked half a pixel aside in each."""
    rng = np.random.default_rng(4)
    wave = np.outer(np.sin(9 * CLOCK), [2e-3, 5e-3, 0.0])[:, None]
    seen = project_all(RIG, POINTS + wave) + rng.normal(0, 0.5, (3, 1, 2, 2))
    for view, frames, point in hidden:
        seen[view, frames, point] = np.nan
    names = ["p", "q"]
    return align_views({n: stated_tracks(seen[i], 0.02, CLOCK, names=names) for i, n in enumerate(RIG.names)})


def measure_first(tracks):
    """Displacement of the first half, and what it tells the second."""
    begin = Carried(divided=True)
    first = compute_displacement(begin.put_into(tracks.isel(time=HALVES[0])), RIG)
    return first, begin.after(0.0, {}, None, first, first)


@pytest.mark.parametrize(
    "hidden",
    [
        [(2, HALVES[0], 0)],
        [(2, HALVES[1], 0)],
        [(2, slice(0, 45), 0), (1, slice(10, 20), 1)],
        [(1, HALVES[0], 0), (2, slice(40, 50), 1)],
    ],
)
def test_a_view_that_joins_later_makes_no_step(hidden):
    """The views disagree by half a pixel, which is some millimetres."""
    tracks = tracks_of(hidden)
    whole = compute_displacement(tracks, RIG)
    first, carried = measure_first(tracks)
    second = compute_displacement(carried.put_into(tracks.isel(time=HALVES[1])), RIG)
    joined = np.concatenate([first["displacement"], second["displacement"]])
    # What is taken off one view is known as well as its place beside the others' is at that distance.
    np.testing.assert_allclose(joined, whole["displacement"].values, atol=0.03)
    alone = compute_displacement(tracks.isel(time=HALVES[1]), RIG)["displacement"].values
    assert np.abs(alone - joined[30:]).max() > 0.5
    assert (second["status"].values == Status.OK).all()


def test_a_view_that_shares_nothing_with_those_before_is_not_trusted():
    tracks = tracks_of([(2, HALVES[0], 0), (1, HALVES[1], 0)])
    _, carried = measure_first(tracks)
    second = compute_displacement(carried.put_into(tracks.isel(time=HALVES[1])), RIG)
    assert (second["status"].sel(point="p").values == Status.UNRELIABLE).all()
    assert (second["status"].sel(point="q").values == Status.OK).all()


def test_a_point_that_is_seen_later_has_its_own_origin():
    tracks = tracks_of([(view, HALVES[0], 0) for view in range(3)])
    _, carried = measure_first(tracks)
    second = compute_displacement(carried.put_into(tracks.isel(time=HALVES[1])), RIG)
    assert np.abs(second["displacement"].sel(point="p").values[0]).max() < 1e-9
    assert np.abs(second["displacement"].sel(point="q").values[0]).max() > 0.1


def make_session(**right):
    views = (View(name="left", video="l.mp4"), View(name="right", video="r.mp4", **right))
    return Session(
        name="s",
        view=views,
        site={"baseline": {"value": 4.0, "std": 0.01}},
        point=(Point(name="p", view="left", pixel=(1.0, 1.0)),),
    )


def test_clocks_go_on_at_their_rate_and_are_known_less_the_longer_ago():
    session = make_session(time_offset_s=0.2, time_offset_std_s=0.01)
    view = session.view[1]
    assert Carried().clock(session, view, 600.0) == (0.2, 0.01)
    carried = Carried(clocks={"right": _Clock(600.0, 0.3, 1e-3, 1 + 1e-5)})
    offset_s, std_s = carried.clock(session, view, 1200.0)
    assert offset_s == pytest.approx(0.3 + 600 * 1e-5)
    assert std_s == pytest.approx(np.hypot(1e-3, 600 * 5e-5))


def test_what_is_used_of_a_recording_counts_once():
    session = make_session(use_s=(4.0,))
    carried = Carried(clocks={"right": _Clock(0.0, 4.3, 1e-3, 1.0)})
    part = Interval(600.0, 1200.0).session(session, carried)
    assert part.stated_offset_s(part.view[1]) == pytest.approx(4.3)


def test_clocks_that_nobody_knows_stay_unknown():
    session = make_session()
    assert Carried().clock(session, session.view[1], 600.0) == (None, None)


def clock_of(duration_s):
    return xr.Dataset(coords={"time": np.arange(0.0, duration_s, 1.0)})


@pytest.mark.parametrize(("duration_s", "count"), [(60.0, 1), (890.0, 1), (910.0, 2), (3600.0, 6)])
def test_intervals_are_about_as_long_as_asked_for(duration_s, count):
    found = divide_tracks(clock_of(duration_s), make_session())
    assert len(found) == count
    assert found[0].begin_s == 0
    assert found[-1].holds(duration_s - 1)
    assert all(one.end_s == other.begin_s for one, other in itertools.pairwise(found))
    assert all(300 <= one.end_s - one.begin_s <= 900 for one in found if count > 1)


def test_sets_of_views_are_counted_through_all_intervals():
    tracks = tracks_of([(2, HALVES[0], 0), (2, HALVES[0], 1), (0, slice(40, 60), 0)])
    joined = JoinedDisplacement(None)
    for number, half in enumerate(HALVES):
        one = compute_displacement(tracks.isel(time=half), RIG)
        joined.append(Interval(float(number), number + 1.0), one.assign_coords(time=one["time"] - number))
    found = joined.finish([False, True]).load()
    whole = compute_displacement(tracks, RIG)
    for point in ("p", "q"):
        names = [found["visibility"].values[code] for code in found["seen_by"].sel(point=point).values]
        assert names == [whole["visibility"].values[code] for code in whole["seen_by"].sel(point=point).values]
    assert found["gain_covariance_seen_by"].sizes["visibility"] == len(found["visibility"])
    assert found["status"].values[:30].max() == Status.OK
    assert found["status"].values[30:].min() == Status.UNRELIABLE
