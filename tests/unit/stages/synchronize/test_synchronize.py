import time

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve
from scipy.spatial.transform import Rotation

from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement, make_tracks
from vfm_sdm.core.statuses import ClockStatus, ClockUse
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.synchronize import (
    LagSearch,
    Samples,
    Synchronization,
    align_views,
    estimate_lag,
    estimate_sensor_lag,
    estimate_view_lag,
    synchronize_views,
)
from vfm_sdm.stages.synchronize.channels import compare_points


def moving_tracks(time_s, *, shift_s=0.0, points=("p",), status=None):
    """A 2 Hz motion of 3 px seen by a camera whose clock starts ``shift_s`` late."""
    time_s = np.asarray(time_s, float)
    count = len(points)
    wave = 100 + 3 * np.sin(2 * np.pi * 2 * (time_s + shift_s))
    position = np.repeat(np.stack([wave, wave + 50], axis=-1)[:, None], count, axis=1)
    covariance = np.broadcast_to(np.eye(2) * 1e-4, (time_s.size, count, 2, 2))
    codes = np.zeros((time_s.size, count), int) if status is None else status
    position = np.where(np.isin(codes, [Status.LOST, Status.OUTSIDE])[..., None], np.nan, position)
    return make_tracks(time_s, list(points), position, covariance, codes, attrs={"tracker": "test"})


CLOCK = np.arange(120) / 60


def find_lag(time_a, values_a, time_b, values_b, *, groups=None, positive_gain=False, band_hz=(0.5, 12.0), **search):
    """`estimate_lag` of two recordings, with the fields of its search by name."""
    return estimate_lag(
        Samples(time_a, values_a),
        Samples(time_b, values_b),
        search=LagSearch(**search),
        groups=groups,
        positive_gain=positive_gain,
        band_hz=band_hz,
    )


def test_equal_clocks_are_not_resampled():
    left, right = moving_tracks(CLOCK), moving_tracks(CLOCK + 1e-7)
    both = align_views({"left": left, "right": right})
    assert both.attrs["resampled"] == ""
    assert both["position"].dims == ("view", "time", "point", "pixel")
    np.testing.assert_array_equal(both["position"].values[1], right["position"].values)


@pytest.mark.parametrize("shift_s", [0.0071, -0.113, 0.25])
def test_an_offset_is_taken_out_without_touching_the_amplitude(shift_s):
    views = {"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK, shift_s=shift_s)}
    both = align_views(views, {"right": shift_s})
    difference = both["position"].values[1] - both["position"].values[0]
    assert np.nanmax(np.abs(difference[3:-3])) < 2e-3
    assert np.isfinite(difference).mean() > 0.97


def test_only_the_common_time_is_kept():
    both = align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK[:60])}, {"right": 0.5})
    assert both["time"].values[0] == pytest.approx(0.5)
    assert both["time"].values[-1] == pytest.approx(0.5 + CLOCK[59])


def test_gaps_stay_gaps():
    status = np.zeros((120, 1), int)
    status[40:50] = Status.LOST
    views = {"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK, shift_s=0.0083, status=status)}
    both = align_views(views, {"right": 0.0083})
    missing = np.isnan(both["position"].values[1, :, 0, 0])
    assert missing[41:50].all()
    assert missing.sum() <= 13
    assert (both["status"].values[1, missing, 0] == Status.LOST).all()


def test_covariances_are_interpolated_by_straight_lines_and_known_where_the_position_is():
    right = moving_tracks(CLOCK, points=("p", "q"))
    right["position_covariance"] = right["position_covariance"] * xr.DataArray(1 + CLOCK, dims="time")
    lost = {"time": slice(40, 50), "point": 1}
    right["position"][lost] = right["position_covariance"][lost] = np.nan
    # Stamps of the other view meet those of this one at every second frame, and lie between them at the others.
    both = align_views({"left": moving_tracks(np.arange(240) / 120, points=("p", "q")), "right": right})
    covariance = both["position_covariance"].values[1]
    expected = 1e-4 * (1 + both["time"].values)
    np.testing.assert_allclose(covariance[:, 0, 0, 0], expected, rtol=1e-12)
    np.testing.assert_array_equal(covariance[:, 0, 0, 1], 0.0)
    known = np.isfinite(both["position"].values[1, :, 1, 0])
    np.testing.assert_array_equal(np.isfinite(covariance[:, 1, 0, 0]), known)
    np.testing.assert_allclose(covariance[known, 1, 0, 0], expected[known], rtol=1e-12)


def test_different_points_are_refused():
    with pytest.raises(DatasetError, match="expected points"):
        align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK, points=("q",))})


def test_recordings_that_do_not_overlap_are_refused():
    with pytest.raises(DatasetError, match="expected recordings that overlap"):
        align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK)}, {"right": 10.0})


def test_a_damaged_recording_is_named_where_nothing_overlaps():
    damaged = moving_tracks(CLOCK).isel(time=slice(1)).assign_attrs(recording={"status": "corrupt"})
    with pytest.raises(DatasetError, match=r"the recording of 'right' is damaged \(corrupt\), 1 of its frames"):
        align_views({"left": moving_tracks(CLOCK), "right": damaged})


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_resampling_keeps_the_amplitude_of_sines(share):
    frequency = share * 30
    truth = 3 * np.sin(2 * np.pi * frequency * CLOCK + 0.3)
    tracks = moving_tracks(CLOCK)
    tracks["position"][:, 0, 0] = 100 + truth
    both = align_views({"left": tracks, "right": tracks}, {"right": 0.5 / 60})
    want = 3 * np.sin(2 * np.pi * frequency * (both["time"].values - 0.5 / 60) + 0.3)
    inner = slice(10, -10)
    got = both["position"].values[1, inner, 0, 0] - 100
    gain = np.dot(got, want[inner]) / np.dot(want[inner], want[inner])
    assert gain == pytest.approx(1, abs=6e-4)
    assert np.abs(got - want[inner]).max() < 3 * 6e-4


def test_a_slow_clock_is_stretched():
    """The right camera's clock counts 0.999 s a second, so its stamps are too small."""
    ratio, offset = 1.001, 0.2
    own = np.arange(600) / 60
    wave = 100 + 3 * np.sin(2 * np.pi * 2 * (own * ratio + offset))
    right = moving_tracks(own)
    right["position"][:, 0, 0] = wave
    both = align_views({"left": moving_tracks(own), "right": right}, {"right": offset}, {"right": ratio})
    difference = both["position"].values[1, 5:-5, 0, 0] - both["position"].values[0, 5:-5, 0, 0]
    assert np.nanmax(np.abs(difference)) < 2e-3


def test_an_absurd_rate_ratio_is_refused():
    with pytest.raises(DatasetError, match="expected a rate ratio near 1"):
        align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK)}, None, {"right": 2.0})


# Lags. Truth is a continuous motion (lateral, vertical, longitudinal), sampled by each side at its own times.


def bridge_motion(rng, duration_s):
    """Damped modes struck by impulses or shaken at random; peak to peak about 1, as a function of time, (T, 3)."""
    fine = np.arange(-12, duration_s + 4, 0.004)
    random_forces = rng.random() < 0.5
    axes = []
    for low, high in ((1.4, 1.9), (2.2, 2.8), (2.0, 4.0)):
        motion = np.zeros(fine.size)
        for frequency, size in ((rng.uniform(low, high), 1.0), (rng.uniform(5, 7), 0.15)):
            force = rng.normal(size=fine.size) if random_forces else np.zeros(fine.size)
            strikes = rng.integers(2250, fine.size - 1000, 4)
            force[strikes] += rng.uniform(0.5, 1, 4) * (200 if random_forces else 1)
            damping, delay = 2 * np.pi * frequency * rng.uniform(0.005, 0.02), np.arange(0, 10, 0.004)
            response = fftconvolve(force, np.exp(-damping * delay) * np.sin(2 * np.pi * frequency * delay))
            motion += size * response[: fine.size] / np.ptp(response[3000 : fine.size])
        axes.append(motion)
    return CubicSpline(fine, np.stack(axes, axis=-1))


def two_views(
    rng, *, lag_s, rates=(60, 60), duration_s=12.0, amplitude_px=5.0, noise_px=0.05, points=2, longitudinal=0.03
):
    """What two oblique cameras see of a bridge: times and (T, 2 P) pixels of each."""
    motion = bridge_motion(rng, duration_s)
    sides = []
    for rate, shift, angle in zip(rates, (0.0, lag_s), rng.uniform(-0.6, 0.6, 2), strict=True):
        clock = np.arange(int(duration_s * rate)) / rate
        seen = motion(clock - shift) * [1, 1, longitudinal] * amplitude_px
        pixels = []
        for _ in range(points):
            mixture = np.array([[0.6 * np.cos(angle), 0.1 * rng.normal(), np.sin(angle)], [0.1 * rng.normal(), 1, 0]])
            pixels.append(seen @ mixture.T + noise_px * rng.normal(size=(clock.size, 2)) + rng.uniform(0, 2000, 2))
        sides += [clock, np.hstack(pixels)]
    return sides


def pairs(points):
    return [((2 * i, 2 * i + 1),) * 2 for i in range(points)]


def as_tracks(clock, pixels, points=("p", "q"), status=None):
    shape = (clock.size, len(points))
    codes = np.zeros(shape, int) if status is None else status
    position = np.where((codes == Status.LOST)[..., None], np.nan, pixels.reshape(*shape, 2))
    return make_tracks(clock, list(points), position, np.zeros((*shape, 2, 2)) + np.eye(2) * 1e-3, codes, attrs={})


@pytest.mark.parametrize(("rates", "trials"), [((60, 60), 60), ((30, 30), 30), ((60, 60 / 1.001), 30)])
def test_lag_of_a_view_within_a_millisecond_and_its_stated_interval(rates, trials):
    errors, stds = [], []
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        lag = rng.uniform(-0.5, 0.5)
        setting = {"duration_s": rng.uniform(8, 16), "amplitude_px": rng.uniform(1.5, 10)}
        views = two_views(rng, lag_s=lag, rates=rates, noise_px=rng.uniform(0.02, 0.1), **setting)
        found = find_lag(*views, search_s=1.0, groups=pairs(2))
        if found.ok:
            errors.append(found.lag_s - lag)
            stds.append(found.lag_std_s)
    errors, stds = np.array(errors), np.array(stds)
    assert errors.size >= 0.85 * trials
    assert np.sqrt(np.mean(errors**2)) < 1e-3
    assert np.mean(np.abs(errors) < 1.96 * stds) >= 0.88
    assert np.sqrt(np.mean((errors / stds) ** 2)) > 0.5


@pytest.mark.parametrize("lag", [3.3137, -2.0083])
def test_lag_of_several_seconds(lag):
    found = find_lag(*two_views(np.random.default_rng(5), lag_s=lag, duration_s=16.0), search_s=5.0, groups=pairs(2))
    assert found.lag_s == pytest.approx(lag, abs=1e-3)
    assert found.offset_s == pytest.approx(-found.lag_s)


def test_gaps_and_drift_do_not_shift_the_lag():
    clock_a, a, clock_b, b = two_views(np.random.default_rng(2), lag_s=0.1234)
    a, b = a + 20 * (clock_a / 12)[:, None] ** 2, b - 10 * np.cos(clock_b / 3)[:, None]
    a[200:230], b[500:503] = np.nan, np.nan
    kept = np.delete(np.arange(clock_b.size), slice(300, 320))
    found = find_lag(clock_a, a, clock_b[kept], b[kept], search_s=1.0, groups=pairs(2))
    assert found.lag_s == pytest.approx(0.1234, abs=max(1e-3, 3 * found.lag_std_s))
    assert found.lag_std_s < 1e-3


def sines(rng, *, noise=0.02, frequency=2.3, lag=0.0371):
    clock = np.arange(960) / 60
    a = np.sin(2 * np.pi * frequency * clock)[:, None] * [0.2, 1] + noise * rng.normal(size=(960, 2))
    b = np.sin(2 * np.pi * frequency * (clock - lag))[:, None] * [-0.2, 1] + noise * rng.normal(size=(960, 2))
    return clock, a, clock, b


@pytest.mark.parametrize("noise", [1e-6, 0.02, 0.1])
def test_periodic_motion_has_no_unique_lag(noise):
    for seed in range(5):
        found = find_lag(*sines(np.random.default_rng(seed), noise=noise), search_s=1.0)
        assert found.status == ClockStatus.NOT_UNIQUE == "peak not unique"
        assert np.isnan(found.lag_s)
        assert np.isnan(found.lag_std_s)
        assert np.min(np.abs(np.array(found.candidates) - 0.0371)) < 2e-3


def test_points_in_trembling_air_tell_the_lag_of_motion_in_a_narrow_band():
    clock, frequencies = np.arange(255) / 30, np.linspace(1.5, 3.0, 12)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        air = rng.normal(0, 0.5, size=(2, 315, 4))
        for frame in range(1, 315):  # 0.8 of it is left from frame to frame
            air[:, frame] = 0.8 * air[:, frame - 1] + 0.6 * air[:, frame]
        waves = rng.normal(0, 12**-0.5, size=(2, 12))
        views = []
        for time_s, of_view in zip((clock, clock - 0.137), air, strict=True):
            phase = 2 * np.pi * np.outer(time_s, frequencies)
            views.append((np.cos(phase) @ waves[0] + np.sin(phase) @ waves[1])[:, None] + of_view[60:])
        found = find_lag(clock, views[0], clock, views[1], search_s=3.0, groups=[((k,), (k,)) for k in range(4)])
        assert found.ok
        assert abs(found.lag_s - 0.137) < 3 * found.lag_std_s < 0.02


def test_a_start_value_decides_between_equal_peaks():
    views = sines(np.random.default_rng(0))
    found = find_lag(*views, search_s=2.0, start_lag_s=0.05, start_std_s=0.03)
    assert found.lag_s == pytest.approx(0.0371, abs=1e-3)
    vague = find_lag(*views, search_s=2.0, start_lag_s=0.05, start_std_s=0.3)
    assert vague.status == ClockStatus.NOT_UNIQUE


def test_a_start_value_known_to_less_than_a_frame_is_no_edge():
    rng = np.random.default_rng(2)
    clock = np.arange(480) / 60
    truth = CubicSpline(np.arange(-60, 600) / 60, np.cumsum(rng.normal(size=660)))
    first, second = truth(clock)[:, None], truth(clock - 0.0107)[:, None]
    found = find_lag(clock, first, clock, second, search_s=2.0, start_lag_s=0.01, start_std_s=0.001)
    assert found.ok, found.status
    assert found.lag_s == pytest.approx(0.0107, abs=1e-3)


def test_noise_has_no_lag():
    rng = np.random.default_rng(0)
    clock = np.arange(960) / 60
    found = [
        find_lag(clock, rng.normal(size=(960, 2)), clock, rng.normal(size=(960, 2)), search_s=2.0) for _ in range(8)
    ]
    assert sum(one.status == ClockStatus.NO_MOTION for one in found) >= 7
    assert not any(one.ok for one in found)
    still = find_lag(clock, np.ones((960, 2)), clock, np.ones((960, 2)), search_s=2.0)
    assert not still.ok


def test_short_recordings_and_searches_beside_the_lag_are_named():
    clock_a, a, clock_b, b = two_views(np.random.default_rng(1), lag_s=0.2)
    short = find_lag(clock_a[:150], a[:150], clock_b[:150], b[:150], search_s=1.0, groups=pairs(2))
    assert short.status == ClockStatus.TOO_SHORT
    apart = find_lag(clock_a, a, clock_b + 100, b, search_s=1.0, groups=pairs(2))
    assert apart.status == ClockStatus.TOO_SHORT
    beside = find_lag(clock_a, a, clock_b, b, search_s=0.1, start_lag_s=0.05, groups=pairs(2))
    assert beside.status == ClockStatus.AT_EDGE
    assert np.isnan(beside.lag_s)


@pytest.mark.parametrize("ratio", [1 + 50e-6, 1 - 100e-6])
def test_clock_rate_of_a_long_recording(ratio):
    rng, offset = np.random.default_rng(4), 0.31
    motion, own = bridge_motion(rng, 92), np.arange(90 * 60) / 60
    a = 5 * motion(own)[:, :2] + 0.05 * rng.normal(size=(own.size, 2))
    b = 5 * motion(own * ratio + offset)[:, :2] @ [[0.8, 0.3], [-0.2, 1]] + 0.05 * rng.normal(size=(own.size, 2))
    found = find_lag(own, a, own, b, search_s=1.0)
    assert found.ok
    assert found.rate_ratio == pytest.approx(ratio, abs=4 * found.rate_ratio_std)
    assert found.rate_ratio_std < 2e-5
    assert found.offset_s == pytest.approx(offset, abs=1e-3)
    views = {"a": as_tracks(own, a, ("p",)), "b": as_tracks(own, b, ("p",))}
    both = align_views(views, {"b": found.offset_s}, {"b": found.rate_ratio})
    assert both.sizes["time"] > 5300


def test_below_a_minute_the_rate_is_taken_as_equal():
    found = find_lag(*two_views(np.random.default_rng(5), lag_s=0.1), search_s=1.0, groups=pairs(2))
    assert found.rate_ratio == 1.0
    assert np.isnan(found.rate_ratio_std)


def test_tracks_of_views_give_what_align_views_takes():
    clock_a, a, clock_b, b = two_views(np.random.default_rng(5), lag_s=-0.2183)
    status = np.zeros((clock_b.size, 2), int)
    status[100:120, 0] = Status.LOST
    status[400:420, 1] = Status.UNRELIABLE
    b[400:420, 2:] += 30
    views = {"left": as_tracks(clock_a, a), "right": as_tracks(clock_b, b, status=status)}
    found = synchronize_views(views, start_offsets_s={"right": 0.2})
    assert found["left"] == Synchronization(0.0, 0.0, 1.0, "ok", candidates=(0.0,))
    assert found["right"].lag_s == pytest.approx(-0.2183, abs=1e-3)
    both = align_views(views, {name: one.offset_s for name, one in found.items()})
    assert both.sizes["time"] == pytest.approx(clock_a.size - 13, abs=1)
    one = estimate_view_lag(views["left"], views["right"], points=["p"])
    assert one.lag_s == pytest.approx(-0.2183, abs=2e-3)


def test_start_offsets_have_the_sign_of_align_views():
    clock_a, a, clock_b, b = two_views(np.random.default_rng(5), lag_s=-3.2, duration_s=16.0)
    views = {"left": as_tracks(clock_a, a), "right": as_tracks(clock_b, b)}
    assert synchronize_views(views, start_offsets_s={"right": 3.0}, search_s=0.5)["right"].ok
    assert not synchronize_views(views, start_offsets_s={"right": -3.0}, search_s=0.5)["right"].ok


# Points that are lost, have gaps, lie on edges or move otherwise.


def point_views(seed=5, *, lag_s=-0.137, points=6, duration_s=8.5):
    """What two cameras see of points that move alike: names, and tracks by view at 30 frames a second."""
    rng = np.random.default_rng(seed)
    views = two_views(rng, lag_s=lag_s, rates=(30, 30), duration_s=duration_s, amplitude_px=2.5, points=points)
    names = tuple("abcdefgh"[:points])
    return names, {"left": as_tracks(*views[:2], names), "right": as_tracks(*views[2:], names)}


def lose(tracks, point, part=slice(None)):
    where = {"time": part, "point": list(tracks["point"].values).index(point)}
    tracks["status"][where], tracks["position"][where] = Status.LOST, np.nan


def test_lost_points_do_not_stop_the_others():
    _, views = point_views()
    # Of six points, four are lost in one of the views or both; two common seconds are too few to count.
    lose(views["left"], "a", slice(13, None))
    lose(views["right"], "b")
    lose(views["left"], "c", slice(150, None))
    lose(views["right"], "c", slice(None, 120))
    lose(views["left"], "d")
    lose(views["right"], "d")
    found = synchronize_views(views)["right"]
    assert found.lag_s == pytest.approx(-0.137, abs=1e-3)
    expected = [ClockUse.TOO_FEW] * 4 + [ClockUse.USED] * 2
    assert list(found.uses) == expected
    pair = estimate_view_lag(views["left"], views["right"], points=["e", "f"])
    assert (found.lag_s, found.lag_std_s) == (pair.lag_s, pair.lag_std_s)


def test_all_lost_is_too_short():
    names, views = point_views(points=2)
    for name in names:
        lose(views["left"], name, slice(45, None))
    found = synchronize_views(views)["right"]
    assert found.status == ClockStatus.TOO_SHORT
    assert set(found.uses) == {ClockUse.TOO_FEW}


def test_points_count_where_they_have_samples():
    """Each is lost for about two seconds in either view, at different times; nothing is filled in."""
    errors, ratios, uses = [], [], []
    for seed in range(20):
        names, views = point_views(seed, points=4)
        for number, name in enumerate(names):
            lose(views["left"], name, slice(20 * number, 20 * number + 60))
            lose(views["right"], name, slice(40 + 30 * number, 90 + 30 * number))
        found = synchronize_views(views)["right"]
        uses += found.uses
        if found.ok:
            errors.append(found.lag_s + 0.137)
            ratios.append(errors[-1] / found.lag_std_s)
    assert len(errors) >= 17
    # In some films the structure hardly moves while both views see a point.
    assert uses.count(ClockUse.USED) >= 0.9 * len(uses)
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_a_lag_that_no_point_has_samples_for_is_not_ruled_out():
    """All points are seen in the first half of one film and in the second of the other: only far lags can be seen."""
    for seed in range(5):
        names, views = point_views(seed)
        for name in names:
            lose(views["left"], name, slice(128, None))
            lose(views["right"], name, slice(None, 128))
        assert synchronize_views(views, search_s=8.0)["right"].status == ClockStatus.TOO_SHORT


def test_a_point_that_moves_otherwise_is_left_out_and_named():
    _, views = point_views(points=4)
    right = views["right"]
    # The second camera follows something that does the same 0.4 s later, ten times as much.
    late = np.roll(right["position"].values[:, 0], 12, axis=0)
    right["position"][:, 0] = late.mean(axis=0) + 10 * (late - late.mean(axis=0))
    found = synchronize_views(views)["right"]
    assert found.lag_s == pytest.approx(-0.137, abs=1e-3)
    assert list(found.uses) == [ClockUse.DISAGREES] + [ClockUse.USED] * 3


def test_points_that_see_noise_or_stand_still_do_not_blur_the_peak():
    _, views = point_views(points=8)
    rng = np.random.default_rng(3)
    for tracks in views.values():
        tracks["position"][:, 2:] = 300 + 0.3 * rng.normal(size=(tracks.sizes["time"], 6, 2))
    found = synchronize_views(views)["right"]
    assert found.lag_s == pytest.approx(-0.137, abs=1e-3)
    assert list(found.uses[:2]) == [ClockUse.USED] * 2
    assert set(found.uses[2:]) == {ClockUse.NO_MOTION}


def test_two_points_that_contradict_each_other_give_no_lag():
    _, views = point_views(points=2)
    views["right"]["position"][:, 0] = np.roll(views["right"]["position"].values[:, 0], 12, axis=0)
    found = synchronize_views(views)["right"]
    assert found.status == ClockStatus.NOT_UNIQUE
    apart = np.abs(np.array(found.candidates)[:, None] - [-0.137, 0.263])
    assert apart.min(axis=0).max() < 2e-3


def test_many_periodic_points_have_no_unique_lag_either():
    rng = np.random.default_rng(0)
    parts = [sines(rng) for _ in range(4)]
    a, b = (np.hstack([part[side] for part in parts]) for side in (1, 3))
    names = tuple("pqrs")
    views = {"left": as_tracks(parts[0][0], a, names), "right": as_tracks(parts[0][0], b, names)}
    assert synchronize_views(views)["right"].status == ClockStatus.NOT_UNIQUE


def test_an_edge_counts_by_the_motion_across_it():
    names, views = point_views(points=2)
    free = synchronize_views(views)["right"]
    across = {"left": np.array([0.2, 0.98]), "right": np.array([-0.1, -0.99])}
    for view, tracks in views.items():
        direction = across[view] / np.linalg.norm(across[view])
        position = tracks["position"].values
        rest = position.mean(axis=0)
        tracks["position"][:] = rest + ((position - rest) @ direction)[..., None] * direction
        along = np.array([-direction[1], direction[0]])
        tracks["position_covariance"][:] = 1e-3 * np.outer(direction, direction) + 1e6 * np.outer(along, along)
    found = synchronize_views(views)["right"]
    assert found.lag_s == pytest.approx(-0.137, abs=2e-3)
    assert found.lag_std_s < 5 * free.lag_std_s
    values, _, groups = compare_points(views["left"], views["right"], names, None)
    assert groups == [((0,), (0,)), ((1,), (1,))]
    assert np.ptp(values[:, 0]) == pytest.approx(np.ptp(position_across(views["left"], across["left"])), rel=1e-6)


def position_across(tracks, direction):
    return tracks["position"].values[:, 0] @ (direction / np.linalg.norm(direction))


def test_known_cameras_compare_what_both_see_alike():
    """Motion along the structure, a quarter period behind the lateral one, looks different in the two cameras."""
    K = np.array([[3000.0, 0, 640], [0, 3000, 360], [0, 0, 1]])
    turned = Rotation.from_euler("y", 25, degrees=True).as_matrix()
    right = Camera(K, (1280, 720), cam_from_world=np.column_stack([turned, -turned @ [6.0, 0.3, 3.0]]))
    rig = Rig(("left", "right"), (Camera(K, (1280, 720)), right), metric=True)
    rng, clock = np.random.default_rng(1), np.arange(255) / 30
    fast = CubicSpline(np.arange(-60, 400) / 30, np.cumsum(rng.normal(size=460)) * 2e-4)
    places = np.array([[0.5, 0.2, 20.0], [1.5, -0.4, 22.0], [2.5, 0.5, 24.0]])

    def seen(camera, time_s):
        wave = 2 * np.pi * 2.1 * time_s
        motion = np.column_stack([0.02 * np.cos(wave), 0.002 * np.cos(wave) + fast(time_s), 0.06 * np.sin(wave)])
        pixels = np.stack([camera.project(motion + place) for place in places], axis=1)
        return as_tracks(clock, pixels + 0.02 * rng.normal(size=pixels.shape), ("a", "b", "c"))

    left, late = seen(rig.cameras[0], clock), seen(rig.cameras[1], clock + 0.137)
    known = estimate_view_lag(left, late, rig=rig)
    assert known.lag_s == pytest.approx(-0.137, abs=max(1e-3, 3 * known.lag_std_s))
    assert known.lag_std_s < 1e-3
    blind = estimate_view_lag(left, late)
    assert not blind.ok or abs(blind.lag_s + 0.137) > 3 * abs(known.lag_s + 0.137)


def vision_and_sensor(rng, lag_s):
    """Displacement from 30 fps video and at 64 Hz from a sensor, with slightly different gains."""
    motion = bridge_motion(rng, 18)
    clock, sensor_clock = np.arange(480) / 30, np.arange(1100) / 64
    seen, sensed = motion(clock) * [2, 6, 0.2], motion(sensor_clock - lag_s) * [2.2, 5.8, 0.2]
    shape = (480, 1, 3)
    displacement = make_displacement(
        clock,
        ["p"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=(seen + 0.15 * rng.normal(size=seen.shape))[:, None],
            displacement_std_mm=np.full(shape, 0.15),
            scale_std=np.zeros((1, 3)),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=np.zeros(shape[:2], int),
        ),
        attrs={"frame": "structure"},
    )
    values = (sensed + 0.03 * rng.normal(size=sensed.shape))[:, None]
    reference = xr.Dataset(
        {"displacement": (("time", "sensor", "axis"), values, {"units": "mm"})},
        coords={"time": sensor_clock, "sensor": ["acc-1"], "axis": list(STRUCTURE_AXES)},
    )
    return displacement, reference


def test_lag_of_a_sensor_within_three_milliseconds():
    errors, stds = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        lag = rng.uniform(-0.5, 0.5)
        found = estimate_sensor_lag(*vision_and_sensor(rng, lag), pairs=[("p", "acc-1")])
        if found.ok:
            errors.append(found.lag_s - lag)
            stds.append(found.lag_std_s)
    assert len(errors) >= 25
    assert np.sqrt(np.mean(np.square(errors))) < 3e-3
    assert np.mean(np.abs(errors) < 1.96 * np.array(stds)) >= 0.85


def test_a_sensor_upside_down_is_not_matched_half_a_period_off():
    clock, a, _, b = sines(np.random.default_rng(0), lag=0.0)
    free = find_lag(clock, a[:, 1:], clock, -b[:, 1:], search_s=0.15)
    signed = find_lag(clock, a[:, 1:], clock, -b[:, 1:], search_s=0.15, positive_gain=True)
    assert abs(free.lag_s) < 1e-2
    assert not signed.ok


def test_views_of_a_short_recording_are_not_matched_half_a_period_off():
    """The true lag needs more overlap than there is; the nearest other one would turn the motion upside down."""
    clock = np.arange(105) / 30
    motion = np.column_stack([0.5 * np.sin(2 * np.pi * 1.6 * clock), 4 * np.sin(2 * np.pi * 2.3 * clock + 0.4)])
    later = np.column_stack(
        [0.5 * np.sin(2 * np.pi * 1.6 * (clock - 0.22)), 4 * np.sin(2 * np.pi * 2.3 * (clock - 0.22) + 0.4)]
    )
    rng = np.random.default_rng(1)
    values = [m + rng.normal(0, 0.01, m.shape) for m in (motion, later)]
    assert not find_lag(clock, values[0], clock, values[1], search_s=2.0, positive_gain=True).ok


def test_pictures_taken_one_by_one_are_too_slow_for_the_band():
    clock, a, _, b = sines(np.random.default_rng(0))
    found = find_lag(clock * 60, a, clock * 60, b, search_s=5.0)
    assert (found.status, found.ok) == (ClockStatus.TOO_SLOW, False)


def test_misuse_of_lags_is_refused():
    clock, a, _, b = sines(np.random.default_rng(0))
    for message, change in {
        "expected finite, increasing": {"time_a": clock[::-1]},
        "expected shape": {"values_a": a[:-1]},
        "expected positive seconds": {"search_s": 0.0},
        "expected positive seconds .*start_std_s=-1": {"start_std_s": -1},
        "expected positive seconds .*start_lag_s=nan": {"start_lag_s": np.nan},
        "expected channels below 2 and 2": {"groups": [((0,), (2,))]},
        "expected as many channels": {"positive_gain": True, "groups": [((0,), (0, 1))]},
        "expected 0 < low < high": {"band_hz": (30.0, 20.0)},
    }.items():
        options = {"time_a": clock, "values_a": a, "time_b": clock, "values_b": b, "search_s": 1.0, **change}
        with pytest.raises(DatasetError, match=message):
            find_lag(**options)


def test_misuse_of_datasets_is_refused():
    left, right = moving_tracks(CLOCK), moving_tracks(CLOCK, points=("q",))
    with pytest.raises(DatasetError, match="points: expected some of"):
        estimate_view_lag(left, right)
    with pytest.raises(DatasetError, match="views: expected one tracks dataset"):
        synchronize_views({})
    displacement, reference = vision_and_sensor(np.random.default_rng(0), 0.0)
    with pytest.raises(DatasetError, match="reference: expected a variable"):
        estimate_sensor_lag(displacement, reference.rename(displacement="d"), pairs=[("p", "acc-1")])
    with pytest.raises(DatasetError, match="pairs: expected points"):
        estimate_sensor_lag(displacement, reference, pairs=[("p", "acc-2")])
    with pytest.raises(DatasetError, match="axes: expected some of"):
        estimate_sensor_lag(displacement, reference, pairs=[("p", "acc-1")], axes=("up",))


def test_six_points_take_well_under_a_second():
    views = two_views(np.random.default_rng(0), lag_s=0.2, duration_s=16.0, points=6)
    begin = time.process_time()  # a busy machine takes longer
    assert find_lag(*views, search_s=2.0, groups=pairs(6)).ok
    assert time.process_time() - begin < 1.0


def test_noise_does_not_pull_the_lag_towards_half_samples():
    """A fit along the interpolated signal's own derivative is 1.2 ms off here, on average."""
    errors = []
    for seed in range(30):
        views = two_views(np.random.default_rng(seed), lag_s=6.25 / 60, amplitude_px=1.0)
        found = find_lag(*views, search_s=0.5, groups=pairs(2))
        errors += [found.lag_s - 6.25 / 60] if found.ok else []
    assert len(errors) >= 20
    assert abs(np.mean(errors)) < 4e-4
