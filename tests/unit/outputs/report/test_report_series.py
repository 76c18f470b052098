"""Values of series with their uncertainty against closed forms, and how they are drawn."""

import numpy as np
import pytest

from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement
from vfm_sdm.outputs.report.series import describe_series, reduce_series
from vfm_sdm.signals.spectrum import amplitude_spectrum

RATE_HZ = 50.0
NOISE_MM, SCALE = 0.05, 0.01


def series_of(values, *, status=None, seed=None, noise=NOISE_MM):
    """Values of one point, whose vertical displacement is given [mm]."""
    count = len(values)
    moved = np.zeros((count, 1, 3))
    moved[:, 0, 1] = values
    if seed is not None:
        moved += np.random.default_rng(seed).normal(0, noise, moved.shape)
    arrays = DisplacementArrays(
        displacement_mm=moved,
        displacement_std_mm=np.full(moved.shape, noise),
        scale_std=np.full((1, 3), SCALE),
        position_m=np.zeros(moved.shape),
        reprojection_error_px=np.zeros((count, 1)),
        status=np.zeros((count, 1), int) if status is None else status[:, None],
    )
    data = make_displacement(np.arange(count) / RATE_HZ, ["mid"], STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
    return describe_series(data, "mid", "vertical"), data


def test_extremes_have_the_uncertainty_of_their_samples():
    time_s = np.arange(500) / RATE_HZ
    found, _ = series_of(3 * np.sin(2 * np.pi * time_s))
    assert found.highest.value == pytest.approx(3, rel=1e-2)
    assert time_s[np.argmax(np.sin(2 * np.pi * time_s))] == found.highest.at_s
    assert found.highest.expanded == pytest.approx(2 * np.hypot(NOISE_MM, SCALE * found.highest.value))
    assert found.lowest.expanded == pytest.approx(2 * np.hypot(NOISE_MM, SCALE * found.lowest.value))


def test_root_mean_square_knows_its_scale_and_is_not_lost_in_noise():
    time_s = np.arange(5000) / RATE_HZ
    loud, _ = series_of(3 * np.sin(2 * np.pi * time_s))
    # Of loud motion the scale is all that matters: 1 % of it, twice.
    assert loud.rms.value == pytest.approx(3 / np.sqrt(2), rel=1e-4)
    assert loud.rms.expanded == pytest.approx(2 * SCALE * loud.rms.value, rel=0.02)
    # Of noise alone nothing is claimed.
    quiet, _ = series_of(np.zeros(5000), seed=1)
    assert quiet.rms.value == pytest.approx(NOISE_MM, rel=0.05)
    assert quiet.rms.expanded >= 0.7 * 2 * quiet.rms.value


@pytest.mark.parametrize("seed", range(8))
def test_a_shift_is_found_within_its_uncertainty(seed):
    count = 1000
    found, _ = series_of(np.where(np.arange(count) < 500, 0.0, 5.0), seed=seed)
    ends = count // 5
    assert abs(found.shift.value - 5) < 1.5 * found.shift.expanded
    # The scale of 5 mm, and the mean of the noise.
    assert found.shift.expanded == pytest.approx(2 * np.hypot(0.05, NOISE_MM * np.sqrt(2 / ends)), rel=0.1)


def test_a_swing_that_goes_on_makes_the_shift_uncertain():
    """The stretches hold no whole number of periods."""
    time_s = np.arange(200) / RATE_HZ
    found, _ = series_of(10 * np.sin(2 * np.pi * 0.9 * time_s))
    assert abs(found.shift.value) < found.shift.expanded


def test_too_few_samples_tell_no_shift_and_none_at_all_tell_nothing():
    status = np.full(100, Status.LOST)
    status[:3] = Status.OK
    few, _ = series_of(np.ones(100), status=status)
    assert np.isnan(few.shift.value)
    assert few.highest.value == 1
    none, _ = series_of(np.ones(100), status=np.full(100, Status.LOST))
    assert np.isnan([none.highest.value, none.rms.value, none.shift.value, none.combined_mm]).all()
    assert none.summary["peak_to_peak_mm"] is None
    assert none.spectrum[0].size == 0


def test_drawn_curves_keep_extremes_and_gaps():
    time_s = np.arange(100_000) / 100
    values = np.sin(time_s)
    values[40_000:60_000] = np.nan
    values[77_777] = 9.0
    curve = reduce_series(time_s, values, np.full(100_000, 0.5), columns=200)
    assert curve.time_s.size == 200
    assert np.nanmax(curve.highest) == 9.0
    assert np.nanmax(curve.band_highest) == 9.5
    assert np.isnan(curve.lowest).sum() == pytest.approx(40, abs=1)
    assert reduce_series(np.zeros(0), np.zeros(0), np.zeros(0)).time_s.size == 0


def test_an_uncertainty_that_is_not_known_hides_no_line():
    curve = reduce_series(np.arange(10.0), np.arange(10.0), np.full(10, np.nan))
    assert curve.band_highest.tolist() == curve.highest.tolist() == list(range(10))


def test_spectra_show_amplitudes():
    time_s = np.arange(30_000) / RATE_HZ
    values = 0.7 * np.sin(2 * np.pi * 3.0 * time_s) + 0.2 * np.sin(2 * np.pi * 8.0 * time_s) + 0.01 * time_s
    frequency_hz, amplitude = amplitude_spectrum(time_s, values, most_lines=400)
    assert frequency_hz.size <= 400
    near = np.abs(frequency_hz - 3.0) < 0.2
    assert amplitude[near].max() == pytest.approx(0.7, rel=0.16)
    assert amplitude[np.abs(frequency_hz - 8.0) < 0.2].max() == pytest.approx(0.2, rel=0.16)
    assert amplitude[(frequency_hz > 4) & (frequency_hz < 7)].max() < 0.01
