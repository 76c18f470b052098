"""Modes of a beam whose modes are known."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.analysis.modal import (
    ModalOptions,
    compute_collinearity,
    compute_mac,
    identify_modes,
    read_modes,
    write_modes,
)
from vfm_sdm.analysis.modal.oscillation import estimate_oscillation
from vfm_sdm.analysis.modal.poles import find_poles
from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import ModeStatus
from vfm_sdm.errors import BackendUnavailableError, DatasetError
from vibrating import DAMPING, FREQUENCY_HZ, NOISE_MM, RATE_HZ, oscillate, true_shapes, vibrate

pytest.importorskip("pyoma2")


@pytest.fixture(scope="module")
def found():
    return identify_modes(vibrate(300.0, static=2), static=frozenset({"rest 0", "rest 1"}))


def test_frequency_damping_and_shape_are_the_true_ones(found):
    assert found.sizes["mode"] == 3
    assert found["frequency"].values == pytest.approx(FREQUENCY_HZ, rel=5e-3)
    for name, true in (("frequency", FREQUENCY_HZ), ("damping_ratio", DAMPING)):
        low, high = found[f"{name}_low"].values, found[f"{name}_high"].values
        middle = found[name].values
        assert np.all((low < middle) & (middle < high))
        # Three of them at once lie inside somewhat wider ones in nearly any record.
        assert np.all((low - (middle - low) < true) & (true < high + (high - middle)))
    shapes = found["shape"].values[:, :6].reshape(3, -1)
    assert np.diag(compute_mac(shapes, true_shapes().reshape(3, -1))) == pytest.approx(1, abs=0.02)
    assert np.abs(shapes).max(axis=1) == pytest.approx(1)
    assert np.abs(shapes.imag).max() < 0.2


def test_points_that_do_not_count_are_nan(found):
    assert np.isnan(found["shape"].sel(point=["rest 0", "rest 1"]).values).all()
    assert np.isfinite(found["shape"].sel(point="p0").values).all()


def test_an_axis_that_is_not_asked_for_is_nan():
    displacement = vibrate(60.0)
    displacement["status"][:, 2] = Status.LOST
    modes = identify_modes(displacement, ModalOptions(axes=("vertical",)))
    assert modes["frequency"].values == pytest.approx(FREQUENCY_HZ[1:], rel=0.02)
    assert np.isnan(modes["shape"].sel(axis=["lateral", "longitudinal"]).values).all()
    assert np.isnan(modes["shape"].sel(point="p2").values).all()


def test_settings_are_stated(found):
    assert found.attrs["sampling_rate_hz"] == RATE_HZ
    assert found.attrs["band_hz"] == pytest.approx([0.2, 0.4 * RATE_HZ])
    assert "trend" in found.attrs["detrending"]
    assert "pyOMA-2" in found.attrs["method"]
    assert found.attrs["channels"] == 18


def test_the_rms_of_a_mode_is_its_motion(found):
    # Standard deviation 1/f mm at the point where the shape is largest, of some periods only.
    assert found["rms"].values[1:] == pytest.approx(1 / FREQUENCY_HZ[1:], rel=0.3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_has_no_modes(seed):
    assert identify_modes(vibrate(20.0, seed=seed, moves=False)).sizes["mode"] == 0


def test_a_short_record_says_so():
    modes = identify_modes(vibrate(16.0, seed=4))
    assert str(ModeStatus.DAMPING_UNKNOWN) in modes["status"].values
    wide = (modes["damping_ratio_high"] - modes["damping_ratio_low"]) > modes["damping_ratio"]
    assert list(modes["status"].values == str(ModeStatus.DAMPING_UNKNOWN)) == list(wide.values)


def test_a_driven_frequency_is_no_mode():
    displacement = vibrate(200.0, seed=5)
    time_s = displacement["time"].values
    displacement["displacement"][:, :6, 1] += 0.3 * np.sin(2 * np.pi * 4.0 * time_s)[:, None] * [1, 2, 3, 3, 2, 1]
    modes = identify_modes(displacement)
    assert not np.any(np.abs(modes["frequency"].values - 4.0) < 0.1)
    reasons = {one["reason"] for one in modes.attrs["left_out"] if abs(one["frequency_hz"] - 4.0) < 0.1}
    # Without damping it is no pole at all, else it is named.
    assert reasons <= {str(ModeStatus.DRIVEN), str(ModeStatus.TWIN)}


def test_of_more_modes_than_asked_for_the_clearest_stay():
    modes = identify_modes(vibrate(60.0), ModalOptions(most_modes=1))
    assert modes.sizes["mode"] == 1
    assert {one["reason"] for one in modes.attrs["left_out"]} >= {str(ModeStatus.TOO_MANY)}


def test_the_same_record_has_the_same_modes():
    one, other = (identify_modes(vibrate(30.0)) for _ in range(2))
    xr.testing.assert_identical(one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": ("up",)}, "expected some of lateral, vertical, longitudinal, got up"),
        ({"axes": ()}, "got none"),
        ({"band_hz": (0.1, 5.0)}, "eight periods in 20 s"),
        ({"band_hz": (1.0, 40.0)}, "half the frame rate"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    with pytest.raises(DatasetError, match=message):
        identify_modes(vibrate(20.0), ModalOptions(**options))


@pytest.mark.parametrize("wrong", [{"most_modes": 0}, {"most_order": 4}])
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(DatasetError, match="expected one mode or more and an order of 12 or more"):
        ModalOptions(**wrong)


def test_too_little_is_refused():
    with pytest.raises(DatasetError, match="expected 100 frames or more, got 30"):
        identify_modes(vibrate(1.0))
    lost = vibrate(20.0)
    lost["status"][:] = Status.LOST
    with pytest.raises(DatasetError, match="expected a point with 90% of its samples ok"):
        identify_modes(lost)


def test_without_the_library_the_extra_is_named(monkeypatch):
    from vfm_sdm.analysis.modal import library

    library.load_library.cache_clear()
    monkeypatch.setitem(__import__("sys").modules, "pyoma2.functions", None)
    with pytest.raises(BackendUnavailableError, match=r"pip install 'vfm-sdm\[modal\]'"):
        library.load_library()


def test_the_library_changes_nothing_outside(capsys):
    import logging

    from vfm_sdm.analysis.modal.library import load_library

    before = np.geterr()
    load_library.cache_clear()
    load_library()
    find_poles(vibrate(20.0)["displacement"].values[:, :, 1] / NOISE_MM, RATE_HZ, most_order=12)
    assert np.geterr() == before
    assert not logging.getLogger("pyoma2").handlers
    assert capsys.readouterr() == ("", "")


def test_intervals_of_one_oscillation_hold():
    """Of 100 short records, 95 % intervals of frequency and damping hold in 90 or more (chance of fewer: 1 in 100)."""
    holds = np.zeros(2)
    for seed in range(100):
        series = oscillate(2.0, 0.015, 320, 20.0, np.random.default_rng(seed))
        one = estimate_oscillation(series, 0.05, 2.0, damping_ratio=0.015, band_hz=(1.4, 2.6))
        holds += [
            one.frequency_hz.low <= 2.0 <= one.frequency_hz.high,
            one.damping_ratio.low <= 0.015 <= one.damping_ratio.high,
        ]
    assert np.all(holds >= 90)
    assert np.all(holds < 100)


def test_the_frequency_is_that_of_a_structure_that_a_force_drives():
    """Its peak is steeper above than below, so that half an oscillation would put it 1.3 % too low here."""
    found = [
        estimate_oscillation(
            oscillate(2.0, 0.05, 4000, 20.0, np.random.default_rng(seed)),
            0.05, 2.0, damping_ratio=0.05, band_hz=(1.2, 2.8),
        ).frequency_hz.value
        for seed in range(6)
    ]  # fmt: skip
    # Each is known to 0.5 % by the length of its record.
    assert np.mean(found) == pytest.approx(2.0, rel=0.005)


def test_collinearity_of_phases():
    assert compute_collinearity(np.exp(0.3j) * np.array([1, -2, 3])) == pytest.approx(1)
    assert compute_collinearity(np.array([1, 1j, -1, -1j])) == pytest.approx(0, abs=1e-12)


def test_files_hold_the_same(found, tmp_path):
    paths = write_modes(tmp_path, found)
    again = read_modes(tmp_path)
    for name in found.data_vars:
        np.testing.assert_array_equal(again[name].values, found[name].values)
    assert again.attrs["left_out"] == found.attrs["left_out"]
    rows = paths[1].read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 3 * 8 * 3
    assert rows[0].startswith("mode,frequency_hz,frequency_low_hz,") or "frequency" in rows[0]
    assert read_modes(tmp_path / "nothing") is None


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_modes_of_one_shape_far_from_each_other_are_both_found(seed):
    """As where the points stand on a part of the span alone."""
    shapes = true_shapes()[[1, 1, 2]]
    found = identify_modes(vibrate(60.0, seed=seed, frequency_hz=(1.6, 4.1, 6.1), shapes=shapes))
    assert np.allclose(found["frequency"].values, [1.6, 4.1, 6.1], rtol=0.02)
    held = (found["frequency_low"].values <= [1.6, 4.1, 6.1]) & (found["frequency_high"].values >= [1.6, 4.1, 6.1])
    assert held.sum() >= 2
