import numpy as np
import pytest

from vfm_sdm.datasets import Status, make_tracks
from vfm_sdm.errors import DatasetError
from vfm_sdm.synchronize import align_views


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


def test_different_points_are_refused():
    with pytest.raises(DatasetError, match="expected points"):
        align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK, points=("q",))})


def test_recordings_that_do_not_overlap_are_refused():
    with pytest.raises(DatasetError, match="expected recordings that overlap"):
        align_views({"left": moving_tracks(CLOCK), "right": moving_tracks(CLOCK)}, {"right": 10.0})
