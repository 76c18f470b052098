from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.analysis.evaluation.metrics import correlation, coverage, gain, nrmse_range, rppae, score, skill
from vfm_sdm.errors import DatasetError
from vfm_sdm.signals.filters import band_pass

TIME = np.arange(600) / 30
MOTION = np.sin(2 * np.pi * 2.2 * TIME) * np.exp(-0.1 * TIME)
PAIRED = [nrmse_range, correlation, rppae, skill, gain]


def test_the_papers_metrics_by_hand():
    estimate = [0.0, 1, 2, 3, 4, 5, 6, 7, 8, 11]
    reference = [0.0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert nrmse_range(estimate, reference) == pytest.approx(np.sqrt(4 / 10) / 9)
    assert rppae(estimate, reference) == pytest.approx(2 / 9)
    assert rppae(reference, estimate) == pytest.approx(2 / 11)
    assert correlation(estimate, reference) == pytest.approx(np.corrcoef(estimate, reference)[0, 1])
    assert skill(estimate, reference) == pytest.approx(1 - np.var([0.0] * 9 + [2]) * 10 / 82.5)
    assert gain(estimate, reference)[0] == pytest.approx(np.polyfit(reference, estimate, 1)[0])


@given(offset=st.floats(-10, 10), factor=st.floats(0.1, 5))
def test_what_each_metric_sees_of_offset_and_factor(offset, factor):
    estimate = factor * MOTION + offset
    assert correlation(estimate, MOTION) == pytest.approx(1)
    assert gain(estimate, MOTION)[0] == pytest.approx(factor)
    assert rppae(estimate, MOTION) == pytest.approx(abs(factor - 1), abs=1e-12)
    assert skill(estimate, MOTION) == pytest.approx(1 - (factor - 1) ** 2)
    error = np.sqrt(np.mean(((factor - 1) * MOTION + offset) ** 2)) / np.ptp(MOTION)
    assert nrmse_range(estimate, MOTION) == pytest.approx(error)


def test_predicting_nothing_has_no_skill():
    assert skill(np.zeros(600), MOTION) == 0
    assert np.isnan(correlation(np.zeros(600), MOTION))
    assert skill(-MOTION, MOTION) == pytest.approx(-3)


@pytest.mark.parametrize("metric", PAIRED)
def test_only_samples_known_in_both_count(metric):
    rng = np.random.default_rng(1)
    estimate, reference = MOTION + 0.1 * rng.standard_normal(600), MOTION.copy()
    estimate[:50], reference[-70:] = np.nan, np.nan
    np.testing.assert_allclose(metric(estimate, reference), metric(estimate[50:-70], reference[50:-70]))


@pytest.mark.parametrize("metric", PAIRED)
def test_misuse_of_a_metric_is_refused(metric):
    with pytest.raises(DatasetError, match=r"estimate: expected shape \(600\), got \(599,\)"):
        metric(MOTION[1:], MOTION)
    with pytest.raises(DatasetError, match=r"reference: expected shape \(any\), got \(600, 1\)"):
        metric(MOTION[:, None], MOTION[:, None])
    with pytest.raises(DatasetError, match="expected at least 10 samples known together with the reference, got 9"):
        metric(MOTION[:9], MOTION[:9])
    with pytest.raises(DatasetError, match="expected a signal that moves, got 2 throughout"):
        metric(MOTION, np.full(600, 2.0))


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_the_gain_has_an_honest_standard_deviation(memory):
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((400, 700))
    for i in range(1, 700):
        noise[:, i] += memory * noise[:, i - 1]
    # Motion slow against the noise's memory: here the textbook's standard error is too small by a factor of 2 to 3.
    slow = np.sin(2 * np.pi * 0.3 * TIME)
    gains = np.array([gain(1.1 * slow + n, slow) for n in noise[:, 100:]])
    assert gains[:, 0].mean() == pytest.approx(1.1, abs=0.03)
    assert np.sqrt(np.mean(gains[:, 1] ** 2)) == pytest.approx(gains[:, 0].std(), rel=0.2)


def test_coverage_counts_samples_inside_the_interval():
    estimate, reference = np.arange(20.0), np.arange(20.0)
    estimate[:5] += 0.9
    estimate[5:7] += 1.1
    std = np.full(20, 0.5)
    assert coverage(estimate, std, reference) == pytest.approx(18 / 20)
    assert coverage(estimate, std, reference, k=1) == pytest.approx(13 / 20)
    estimate[19], std[18] = np.nan, np.nan
    assert coverage(estimate, std, reference) == pytest.approx(16 / 18)
    assert np.isnan(coverage(estimate, np.full(20, np.nan), reference))


def test_coverage_of_normal_noise():
    rng = np.random.default_rng(4)
    assert coverage(0.3 * rng.standard_normal(20000), np.full(20000, 0.3), np.zeros(20000)) == pytest.approx(
        0.9545, abs=0.006
    )


def test_misuse_of_coverage_is_refused():
    std = np.ones(600)
    with pytest.raises(DatasetError, match=r"estimate_std: expected shape \(600\)"):
        coverage(MOTION, std[1:], MOTION)
    with pytest.raises(DatasetError, match="k: expected a factor > 0, got 0"):
        coverage(MOTION, std, MOTION, k=0)
    with pytest.raises(DatasetError, match="expected values >= 0, got -1"):
        coverage(MOTION, -std, MOTION)
    with pytest.raises(DatasetError, match="expected at least 10 samples"):
        coverage(MOTION, std, np.full(600, np.nan))


def test_a_score_holds_every_figure():
    rng = np.random.default_rng(5)
    estimate = MOTION + 0.05 * rng.standard_normal(600) + 3
    std = np.full(600, 0.05)
    found = score(estimate, MOTION, estimate_std=std)
    assert found.nrmse_range == nrmse_range(estimate, MOTION)
    assert found.correlation == correlation(estimate, MOTION)
    assert found.rppae == rppae(estimate, MOTION)
    assert (found.gain, found.gain_std) == gain(estimate, MOTION)
    assert found.skill == skill(estimate, MOTION)
    assert found.coverage == coverage(estimate, std, MOTION) == 0
    assert found.offset == pytest.approx(3, abs=0.01)
    assert (found.samples, found.band_hz, found.offset_removed) == (600, None, False)
    assert list(asdict(found))[:3] == ["nrmse_range", "correlation", "rppae"]
    assert np.isnan(score(estimate, MOTION).lag_s)
    assert np.isnan(score(estimate, MOTION).coverage)


def test_a_score_without_the_offset():
    estimate = MOTION + 0.05 * np.random.default_rng(5).standard_normal(600) + 3
    found = score(estimate, MOTION, estimate_std=np.full(600, 0.05), remove_offset=True)
    level = estimate - np.mean(estimate - MOTION)
    assert found.nrmse_range == pytest.approx(nrmse_range(level, MOTION))
    assert found.coverage == coverage(level, np.full(600, 0.05), MOTION) > 0.9
    assert found.offset == pytest.approx(3, abs=0.01)
    assert found.offset_removed


def test_a_score_in_a_band():
    slow = 4 * np.sin(2 * np.pi * 0.15 * TIME)
    reference = MOTION.copy()
    reference[:60] = np.nan
    estimate = MOTION + slow
    assert score(estimate, reference).correlation < 0.5
    found = score(estimate, reference, rate_hz=30.0, band_hz=(1.0, 10.0), estimate_std=np.full(600, 1e-9))
    assert found.band_hz == (1.0, 10.0)
    assert found.correlation > 0.99
    assert found.samples == 540
    assert found.coverage < 0.1  # of the samples as measured
    filtered = [band_pass(values, 30.0, (1.0, 10.0)) for values in (estimate, reference)]
    assert found.nrmse_range == nrmse_range(*filtered)
    assert abs(found.offset) < 0.01


def test_misuse_of_a_score_is_refused():
    with pytest.raises(DatasetError, match="rate_hz: expected the sampling rate for filtering, got None"):
        score(MOTION, MOTION, band_hz=(1.0, 10.0))
    with pytest.raises(DatasetError, match="expected at least 10 samples"):
        score(MOTION, np.full(600, np.nan))
