import numpy as np
import pytest
import scipy.signal
import scipy.stats

from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import band_pass, hampel, shortest_band_pass_s


def test_the_band_is_kept_without_phase_and_the_rest_is_not():
    time_s = np.arange(1920) / 64
    kept, slow, fast = (np.sin(2 * np.pi * f * time_s) for f in (3.0, 0.2, 20.0))
    filtered = band_pass(kept + slow + fast + 5, 64.0, (1.0, 10.0))
    np.testing.assert_allclose(filtered[192:-192], kept[192:-192], atol=2e-3)


def test_it_is_the_forward_and_backward_butterworth_filter():
    values = np.random.default_rng(0).standard_normal((300, 2, 3))
    b, a = scipy.signal.butter(4, (1.0, 10.0), "bandpass", fs=64.0)
    # Of every sample the feedback rounds each product, and what is rounded passes through the feedback itself.
    echo = scipy.signal.lfilter([1.0], a, np.eye(1, 5000)[0])
    allowed = 2 * np.finfo(float).eps * np.abs(a).sum() * np.abs(echo).sum() * np.abs(values).max()
    np.testing.assert_allclose(
        band_pass(values, 64.0, (1.0, 10.0)), scipy.signal.filtfilt(b, a, values, axis=0), rtol=0, atol=allowed
    )
    assert allowed < 1e-8


def test_the_edges_are_at_half_the_amplitude():
    time_s = np.arange(6400) / 64
    filtered = band_pass(np.sin(2 * np.pi * time_s), 64.0, (1.0, 10.0))[1600:4800]
    assert np.ptp(filtered) / 2 == pytest.approx(0.5, abs=2e-3)


def test_runs_between_gaps_are_filtered_alone_and_short_ones_not_at_all():
    values = np.sin(np.arange(400) / 5)
    values[200] = np.nan
    values[300:] = np.nan
    values[250] = np.nan
    filtered = band_pass(values, 30.0, (1.0, 10.0))
    np.testing.assert_array_equal(filtered[:200], band_pass(values[:200], 30.0, (1.0, 10.0)))
    assert shortest_band_pass_s(30.0, (1.0, 10.0)) == 2.0
    assert np.isnan(filtered[200:]).all()


def test_the_filter_start_is_the_least_for_a_high_band():
    assert shortest_band_pass_s(64.0, (10.0, 20.0)) == 28 / 64
    assert np.isfinite(band_pass(np.ones(28), 64.0, (10.0, 20.0))).all()


@pytest.mark.parametrize("band", [(0.0, 10.0), (5.0, 5.0), (1.0, 32.0), (float("nan"), 10.0)])
def test_a_band_that_does_not_fit_is_refused(band):
    with pytest.raises(DatasetError, match=r"expected 0 < low < high < 32 Hz"):
        band_pass(np.zeros(200), 64.0, band)


def test_other_misuse_of_the_band_pass_is_refused():
    with pytest.raises(DatasetError, match="order: expected a positive number"):
        band_pass(np.zeros(200), 64.0, (1.0, 10.0), order=0)
    with pytest.raises(DatasetError, match="expected samples along the first axis"):
        band_pass(3.0, 64.0, (1.0, 10.0))


def test_hampel_replaces_only_the_outliers():
    values = np.sin(np.arange(300) / 10)
    spiky = values.copy()
    spiky[[3, 100, 101, 297]] += [5, -5, 4, 6]
    filtered, replaced = hampel(spiky, 49)
    assert list(np.flatnonzero(replaced)) == [3, 100, 101, 297]
    np.testing.assert_array_equal(filtered[~replaced], values[~replaced])
    assert filtered[100] == np.median(spiky[76:125])
    assert filtered[3] == np.median(spiky[:49])


def test_hampel_counts_scaled_deviations():
    window = np.array([-2.0, -1, 0, 1, 2, 0, 0, 0, 0])
    at = 4
    limit = 3 * 1.4826 * scipy.stats.median_abs_deviation(window[:5])
    for size, outlying in ((limit - 0.01, False), (limit + 0.01, True)):
        values = np.array([-2.0, -1, 0, 1, size])
        assert hampel(values, 5, threshold=3.0)[1][at] == outlying


def test_hampel_treats_each_series_alone():
    values = np.random.default_rng(1).standard_normal((100, 2, 3))
    values[50, 1, 2] = 30
    filtered, replaced = hampel(values, 11)
    alone, alone_replaced = hampel(values[:, 1, 2], 11)
    np.testing.assert_array_equal(filtered[:, 1, 2], alone)
    np.testing.assert_array_equal(replaced[:, 1, 2], alone_replaced)
    assert replaced[50, 1, 2]


@pytest.mark.parametrize("width", [4, 11, 0, -1])
def test_a_window_that_does_not_fit_is_refused(width):
    with pytest.raises(DatasetError, match="width: expected an odd number up to 10"):
        hampel(np.zeros(10), width)
