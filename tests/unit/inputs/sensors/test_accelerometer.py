from itertools import pairwise

import numpy as np
import pytest
import scipy.integrate
import scipy.interpolate
import scipy.signal
import scipy.stats

from vfm_sdm.core.sensor_datasets import make_acceleration
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.sensors.accelerometer import (
    RecipeSettings,
    amplitude_response,
    compute_reference,
    detect_onset,
    integrate,
    resample,
)

RATE = 64.0
AXES = ("lateral", "vertical", "longitudinal")


def dataset(values, rate=RATE, start=0.0, **attrs):
    """Values (T,) or (T, A) as one sensor's dataset."""
    values = np.asarray(values, float).reshape(len(values), -1)
    time_s = start + np.arange(len(values)) / rate
    return make_acceleration(
        time_s, ["a"], AXES[: values.shape[1]], values[:, None], sampling_rate_hz=rate, attrs=attrs
    )


def sine(frequency_hz, rate=RATE, duration_s=30.0):
    """Acceleration [m/s2] of a displacement of 1 mm."""
    omega = 2 * np.pi * frequency_hz
    return -1e-3 * omega**2 * np.sin(omega * np.arange(round(duration_s * rate)) / rate)


def steady_part(reference, frequency_hz):
    """Amplitude [mm] and phase [deg] of the sine, leaving out 2 s at each end where the filter rings.

    What it rings with is integrated twice, so that the rest carries a slow curve, fitted by a polynomial.
    """
    time_s, values = reference["time"].values, reference["displacement"].values[:, 0, 0]
    inside = (time_s > 2) & (time_s < time_s[-1] - 2)
    phase = 2 * np.pi * frequency_hz * time_s[inside]
    curve = np.polynomial.legendre.legvander(np.linspace(-1, 1, inside.sum()), 6)
    model = np.column_stack([np.sin(phase), np.cos(phase), curve])
    a, b = np.linalg.lstsq(model, values[inside])[0][:2]
    return np.hypot(a, b), np.degrees(np.arctan2(b, a))


def swinging(onset_s, time_s):
    """Displacement of damped modes that start from rest, lateral and vertical [m]."""
    since = np.maximum(time_s - onset_s, 0)
    size = np.exp(-0.15 * since) * scipy.stats.norm.cdf((since - 1) / 0.25)
    return np.column_stack([2e-3 * size * np.sin(9 * since), 3e-3 * size * np.sin(15 * since), 0 * since])


def ringing(onset_s, seed=0, duration_s=16.0, noise=1.4e-3):
    """What a tri-axial sensor feels of it, with gravity, bias and noise [m/s2]."""
    time_s = np.arange(round(duration_s * RATE)) / RATE
    fine = np.arange(-1, duration_s + 1, 1e-3)
    motion = scipy.interpolate.make_interp_spline(fine, swinging(onset_s, fine), k=5).derivative(2)(time_s)
    return motion + [0.1, -9.7, 0.05] + noise * np.random.default_rng(seed).standard_normal(motion.shape)


@pytest.mark.parametrize("frequency", [1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0])
@pytest.mark.parametrize(("rate", "integration"), [(64.0, "spline"), (512.0, "trapezoid")])
def test_a_sine_keeps_amplitude_and_phase_inside_the_band(frequency, rate, integration):
    settings = RecipeSettings(onset_s=0.0, integration=integration)
    amplitude, phase = steady_part(compute_reference(dataset(sine(frequency, rate), rate), settings), frequency)
    assert amplitude == pytest.approx(1, abs=5e-3)
    assert phase == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize("frequency", [1.0, 1.3, 2.0, 3.0, 5.0, 8.0, 10.0])
@pytest.mark.parametrize("integration", ["trapezoid", "spline"])
def test_the_response_in_closed_form_is_what_a_sine_becomes(frequency, integration):
    settings = RecipeSettings(onset_s=0.0, integration=integration)
    amplitude, phase = steady_part(compute_reference(dataset(sine(frequency)), settings), frequency)
    assert amplitude == pytest.approx(float(amplitude_response(frequency, RATE, settings)), abs=1e-3)
    assert phase == pytest.approx(0, abs=0.1)


def test_the_trapezoid_loses_amplitude_at_64_hz():
    response = amplitude_response(np.array([3.0, 5.0]), RATE, RecipeSettings())
    filtered = amplitude_response(np.array([3.0, 5.0]), RATE, RecipeSettings(integration="spline"))
    np.testing.assert_allclose(1 - response / filtered, [0.0144, 0.0397], atol=5e-4)


def poles_and_zeros():
    """Zeros, poles and gain of the recipe's band-pass."""
    return scipy.signal.butter(4, [1 / 32, 10 / 32], "bandpass", output="zpk")


def pole_by_pole(values):
    """The band-pass forwards and backwards, a complex pole at a time, over ends turned about their last sample.

    Not by the transfer function, whose coefficients alone carry three million times their rounding: its eight poles
    crowd at the lower edge of the band.
    """
    zeros, poles, gain = poles_and_zeros()
    values = np.concatenate([2 * values[0] - values[27:0:-1], values, 2 * values[-1] - values[-2:-29:-1]])
    for _ in range(2):
        values = gain * (values - values[0])  # as if it had been so for ever, of which the band holds nothing
        for zero, pole in zip(zeros, poles, strict=True):
            values = scipy.signal.lfilter([1, -zero], [1, -pole], values)
        values = values.real[::-1]
    return values[27:-27]


def independent_recipe(values, first):
    """The recipe for one axis, written anew: poles instead of sections, loops instead of windows."""
    segment = values[first:] * 1.0
    clean = segment.copy()
    for i in range(len(segment)):
        begin = min(max(i - 24, 0), len(segment) - 49)
        window = segment[begin : begin + 49]
        middle = np.median(window)
        spread = scipy.stats.median_abs_deviation(window) * 1.4826
        if abs(segment[i] - middle) > 3.5 * spread:
            clean[i] = middle
    filtered = pole_by_pole(clean - np.mean(clean))
    time_s = np.arange(len(values))[first:] / RATE
    velocity = scipy.integrate.cumulative_trapezoid(filtered, time_s, initial=0)
    velocity -= np.polyval(np.polyfit(time_s, velocity, 1), time_s)
    displacement = 1000 * scipy.integrate.cumulative_trapezoid(velocity, time_s, initial=0)
    grid = np.arange(len(values) * 30 // 64) / 30
    spline = scipy.interpolate.make_interp_spline(time_s, displacement, k=3)
    return np.where(grid >= time_s[0], spline(grid), np.nan)


def test_the_recipe_equals_an_independent_one():
    values = ringing(onset_s=3.0)
    values[[300, 301, 700], [0, 1, 1]] += [4.0, -5.0, 6.0]
    reference = compute_reference(dataset(values))
    first = round(reference.attrs["onset_s"] * RATE)
    assert reference["outliers"].values[0, :2].min() >= 1
    # Each of eight poles, passed twice, adds a rounding that it keeps for 1 / (1 - |pole|) samples. An acceleration
    # that is off by as much all the time is off by half the square of the time once it has been integrated twice.
    _, poles, _ = poles_and_zeros()
    rounding = 2 * np.sum(1 / (1 - np.abs(poles))) * np.finfo(float).eps
    for axis in range(3):
        found, felt = reference["displacement"].values[:, 0, axis], values[first:, axis]
        allowed_mm = 1e3 * rounding * np.abs(felt - felt.mean()).max() * (len(felt) / RATE) ** 2 / 2
        expected = independent_recipe(values[:, axis], first)
        np.testing.assert_allclose(found, expected, rtol=0, atol=allowed_mm, equal_nan=True)
        assert allowed_mm < 1e-7


def test_the_reference_covers_the_recording_and_is_nan_before_the_onset():
    reference = compute_reference(dataset(ringing(onset_s=4.0), start=100.0, start_utc="2026-11-20T10:00:00+00:00"))
    onset = reference.attrs["onset_s"]
    assert 103.5 <= onset <= 104.1
    assert reference.attrs["onset_status"] == "detected"
    assert reference.attrs["start_utc"] == "2026-11-20T10:00:00+00:00"
    assert reference.attrs["band_hz"] == [1.0, 10.0]
    np.testing.assert_allclose(reference["time"].values, 100 + np.arange(480) / 30)
    known = np.isfinite(reference["displacement"].values).all(axis=(1, 2))
    np.testing.assert_array_equal(known, reference["time"].values >= onset)
    # At rest, and by the recipe zero at the onset itself.
    assert abs(reference["displacement"].values[known][0]).max() < 0.1


def test_spikes_move_neither_the_onset_nor_the_displacement():
    values, spiky = ringing(onset_s=4.0), ringing(onset_s=4.0)
    spiky[[60, 130, 400, 800], [1, 0, 1, 0]] += 5.0
    clean, treated = compute_reference(dataset(values)), compute_reference(dataset(spiky))
    assert treated.attrs["onset_s"] == clean.attrs["onset_s"]
    assert treated["outliers"].values.sum() >= 2
    difference = treated["displacement"].values - clean["displacement"].values
    # The median in place of a sample of the motion is itself an error, only a smaller one.
    assert np.nanmax(abs(difference)) < 0.2 * np.nanmax(abs(clean["displacement"].values))
    untreated = compute_reference(dataset(spiky), RecipeSettings(hampel_threshold=1e9))
    spoiled = untreated["displacement"].values - clean["displacement"].values
    assert np.nanmax(abs(spoiled)) > 4 * np.nanmax(abs(difference))


def test_drift_of_the_sensor_does_not_reach_the_displacement():
    values = ringing(onset_s=4.0)
    drift = 0.02 * np.linspace(0, 1, len(values))[:, None]
    settings = RecipeSettings(onset_s=3.5)
    still, drifting = (compute_reference(dataset(v), settings)["displacement"].values for v in (values, values + drift))
    # Integrated twice as it is, the drift would be more than 100 mm.
    assert np.nanmax(abs(drifting - still)) < 0.2


@pytest.mark.parametrize("onset_s", [2.5, 6.0, 9.3])
def test_the_onset_is_found_just_before_the_motion(onset_s):
    values = ringing(onset_s, seed=int(10 * onset_s))
    onset = detect_onset(values, RATE, RecipeSettings()) / RATE
    assert onset >= onset_s - 0.55
    assert abs(swinging(onset_s, np.array([onset]))).max() < 1e-5


def test_horizontal_motion_alone_is_an_onset_in_spite_of_gravity():
    values = ringing(5.0)
    values[:, 1] = values[0, 1]
    onset = detect_onset(values, RATE, RecipeSettings()) / RATE
    assert onset >= 4.45
    assert abs(swinging(5.0, np.array([onset]))).max() < 1e-4


@pytest.mark.parametrize("values", [ringing(1e9), np.zeros((640, 3)), np.full((640, 3), 0.1)])
def test_without_an_onset_the_whole_recording_counts_and_says_so(values):
    reference = compute_reference(dataset(values))
    assert reference.attrs["onset_status"] == "not detected: whole recording used"
    assert reference.attrs["onset_s"] == 0
    assert np.isfinite(reference["displacement"].values).all()


def test_sensors_share_the_earliest_onset():
    values = np.stack([ringing(6.0), ringing(4.0, seed=1)], axis=1)
    time_s = np.arange(len(values)) / RATE
    together = compute_reference(make_acceleration(time_s, ["a", "b"], AXES, values, sampling_rate_hz=RATE))
    alone = compute_reference(dataset(values[:, 1]))
    assert together.attrs["onset_s"] == alone.attrs["onset_s"]
    np.testing.assert_allclose(together["displacement"].values[:, 1], alone["displacement"].values[:, 0], atol=1e-12)


def test_a_given_onset_is_used():
    reference = compute_reference(dataset(ringing(4.0)), RecipeSettings(onset_s=2.01))
    assert reference.attrs["onset_status"] == "given"
    assert reference.attrs["onset_s"] == pytest.approx(129 / 64)


def test_both_rules_integrate_a_straight_line_exactly():
    ramp = np.arange(9.0)[:, None]
    for rule in ("trapezoid", "spline"):
        np.testing.assert_allclose(integrate(ramp, 2.0, rule=rule), ramp**2 / 4, atol=1e-12)


def test_resampling_is_nan_outside_and_exact_at_the_samples():
    time_s = np.arange(10) / 10
    values = np.cos(time_s)[:, None]
    found = resample(values, time_s, np.array([-0.1, 0.0, 0.5, 0.9 + 1e-9, 1.0]))[:, 0]
    np.testing.assert_allclose(found, [np.nan, *np.cos([0, 0.5, 0.9]), np.nan], atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"hampel_window_s": 0.0}, r"expected values > 0, got \{'hampel_window_s': 0.0\}"),
        ({"onset_floor_m_s2": -1.0}, "onset_floor_m_s2: expected a value >= 0, got -1"),
        ({"quiet_s": 0.2}, "quiet_s: expected at least onset_window_s"),
        ({"integration": "simpson"}, "expected 'trapezoid' or 'spline'"),
        ({"rate_hz": 20.0}, "rate_hz: expected more than twice"),
    ],
)
def test_settings_out_of_range_are_refused(changes, match):
    with pytest.raises(DatasetError, match=match):
        RecipeSettings(**changes)


def test_what_the_recipe_cannot_use_is_refused():
    values = ringing(4.0)
    broken = values.copy()
    broken[200, 1] = np.nan
    with pytest.raises(DatasetError, match=r"got 1 without, the first at 3.125 s"):
        compute_reference(dataset(broken))
    with pytest.raises(DatasetError, match=r"expected at least 40 Hz for a band up to 10 Hz, got 32"):
        compute_reference(dataset(values, rate=32.0))
    with pytest.raises(DatasetError, match=r"from the onset on, got 1.00 s after 15.00 s"):
        compute_reference(dataset(values), RecipeSettings(onset_s=15.0))
    with pytest.raises(DatasetError, match=r"onset_s: expected a time from 0.000 to 15.984 s"):
        compute_reference(dataset(values), RecipeSettings(onset_s=16.5))
    with pytest.raises(DatasetError, match="expected 0 < low < high"):
        compute_reference(dataset(values), RecipeSettings(band_hz=(0.0, 10.0)))
    with pytest.raises(DatasetError, match="expected at least onset_window_s"):
        compute_reference(dataset(values[:20]))


def test_a_longer_edge_of_rest_changes_little():
    """The onset may be early by a window; the displacement must not depend on that."""
    values = ringing(4.0)
    runs = [
        compute_reference(dataset(values), RecipeSettings(onset_s=s))["displacement"].values for s in (3.5, 3.75, 4.0)
    ]
    for first, second in pairwise(runs):
        both = np.isfinite(first + second)
        assert abs(first - second)[both].max() < 0.15 * np.nanmax(abs(first))


def status_of(values, where, code):
    """Status of a recording, one axis of it marked."""
    codes = np.zeros((len(values), 1, values.shape[1]), np.int8)
    codes[where, 0, 1] = code
    return (("time", "sensor", "axis"), codes)


def test_missing_samples_are_filled_where_they_are_few_and_left_out_where_they_are_many():
    values = ringing(4.0)
    whole = compute_reference(dataset(values))
    few, many = values.copy(), values.copy()
    few[300::40, 1] = np.nan
    many[480:520, 1] = np.nan
    filled = compute_reference(dataset(few).assign(status=status_of(values, slice(300, None, 40), 1)))
    difference = np.abs(filled["displacement"].values - whole["displacement"].values)
    assert np.nanmax(difference) < 0.02 * np.nanmax(np.abs(whole["displacement"].values))
    assert "missing" in filled.attrs["notes"][0]
    parted = compute_reference(dataset(many).assign(status=status_of(values, slice(480, 520), 1)))
    np.testing.assert_array_equal(parted["displacement"].values[:, 0, 0], whole["displacement"].values[:, 0, 0])
    lost = np.isnan(parted["displacement"].values[:, 0, 1])
    time_s = parted["time"].values
    # The filter rings for a period of the lower edge beside a gap.
    np.testing.assert_array_equal(lost, (time_s < whole.attrs["onset_s"]) | ((time_s > 6.49) & (time_s < 9.124)))
    assert "from 7.5 to 8.10938 s, are missing" in parted.attrs["notes"][0]


@pytest.mark.parametrize("limits", [(-9.9, -9.5), (-99, -9.5)])
def test_what_hangs_on_clipped_samples_is_left_out(limits):
    values = ringing(4.0)
    whole = compute_reference(dataset(values))
    cut = values.copy()
    cut[:, 1] = np.clip(cut[:, 1], *limits)
    reference = compute_reference(dataset(cut))
    clipped = np.abs(cut[:, 1] - values[:, 1]) > 0
    lost = np.isnan(reference["displacement"].values[:, 0, 1])
    stamps = np.flatnonzero(clipped) / RATE
    assert lost[(reference["time"].values >= stamps[0]) & (reference["time"].values <= stamps[-1])].all()
    assert any("clipped at the end of the sensor's range" in note for note in reference.attrs["notes"])
    np.testing.assert_array_equal(reference["displacement"].values[:, 0, 0], whole["displacement"].values[:, 0, 0])


def test_a_recording_without_a_whole_piece_is_refused():
    values = ringing(4.0)
    cut = np.clip(values, *np.quantile(values[256:], [0.45, 0.55], axis=0))
    with pytest.raises(
        DatasetError, match=r"expected 2.00 s in one piece, got less in every axis; .* clipped at the end"
    ):
        compute_reference(dataset(cut), RecipeSettings(onset_s=4.0))


def test_units_that_no_sensor_at_rest_reads_are_refused_or_named():
    values = ringing(4.0)
    with pytest.raises(
        DatasetError, match=r"got 9\.\d+ g, which no sensor at rest reads: the file seems to be in m/s2"
    ):
        compute_reference(dataset(values * 9.80665))
    with pytest.raises(DatasetError, match=r"seems to be in another unit; state it with --units"):
        compute_reference(dataset(values * 1000))
    with pytest.raises(DatasetError, match=r"expected a structure's vibration, got [\d.]+ g half of the time"):
        compute_reference(dataset((values - np.median(values, axis=0)) * 1e4))
    (note,) = compute_reference(dataset(values / 9.80665)).attrs["notes"]
    assert "reads 0.99 m/s2 on average, which would be gravity in g" in note


def test_a_slow_sensor_and_a_coarse_one_are_named():
    held = np.repeat(ringing(4.0, duration_s=64.0)[::4], 4, axis=0)
    notes = compute_reference(dataset(held, rate=4 * RATE)).attrs["notes"]
    assert any("every value is repeated 4 times" in note for note in notes)
    coarse = np.round(ringing(4.0) / 0.3) * 0.3
    assert any(
        "resolution is coarse, steps of 0.3" in note for note in compute_reference(dataset(coarse)).attrs["notes"]
    )
