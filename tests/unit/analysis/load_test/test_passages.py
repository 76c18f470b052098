"""Passages over a beam that is solved exactly: amplification and influence lines hold within what is stated."""

import csv

import numpy as np
import pytest
from scipy.signal import lsim

from vfm_sdm.analysis.load_test import Axle, Passage, judge_passages, read_axles, read_passages, read_passages_of_run
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.core.netcdf import write_displacement
from vfm_sdm.core.statuses import PassageStatus
from vfm_sdm.errors import DatasetError

LENGTH_M, FIRST_HZ, DAMPING = 30.0, 3.4, 0.015
TRUCK = (Axle(0.0, 70.0), Axle(3.6, 115.0), Axle(5.0, 115.0))
RATE_HZ = 30
COMPLIANCE_MM_KN = 0.012
BEGIN_S, AFTER_S = 6.0, 8.0
MODES = (1, 2, 3)


def influence(x):
    """Deflection at mid-span under 1 kN at x on a simply supported beam, by its first modes [mm]."""
    inside = (x >= 0) & (x <= LENGTH_M)
    terms = [np.sin(n * np.pi / 2) * np.sin(n * np.pi * x / LENGTH_M) / n**4 for n in MODES]
    return COMPLIANCE_MM_KN * np.where(inside, np.sum(terms, axis=0), 0.0)


def crossing(speed, *, axles=TRUCK, first_hz=FIRST_HZ):
    """Passage, times, total and static displacement at mid-span of a beam that axles cross [s], [mm]."""
    end_s = BEGIN_S + (LENGTH_M + axles[-1].behind_m) / speed
    fine = np.arange(0, end_s + AFTER_S, 1 / (RATE_HZ * 10))
    total, static = np.zeros_like(fine), np.zeros_like(fine)
    places = [speed * (fine - BEGIN_S) - axle.behind_m for axle in axles]
    for n in MODES:
        load = sum(
            axle.load_kn * np.where((x >= 0) & (x <= LENGTH_M), np.sin(n * np.pi * x / LENGTH_M), 0)
            for axle, x in zip(axles, places, strict=True)
        )
        shape = np.sin(n * np.pi / 2) * COMPLIANCE_MM_KN / n**4
        omega = 2 * np.pi * first_hz * n**2
        _, answer, _ = lsim(([omega**2], [1, 2 * DAMPING * omega, omega**2]), load, fine)
        total += shape * answer
        static += shape * load
    return Passage(BEGIN_S, end_s, speed), fine[::10], total[::10], static[::10]


def displacement_of(time_s, values_mm, *, noise_mm=0.0, scale_std=0.0, seed=0):
    """A displacement dataset of one point that moves vertically."""
    full = np.zeros((len(time_s), 1, 3))
    full[:, 0, 1] = values_mm
    full += np.random.default_rng(seed).normal(0, noise_mm, full.shape)
    return make_displacement(
        time_s,
        ["mid"],
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=full,
            displacement_std_mm=np.full(full.shape, max(noise_mm, 1e-6)),
            scale_std=np.full((1, 3), scale_std),
            position_m=np.zeros(full.shape),
            reprojection_error_px=np.zeros(full.shape[:2]),
            status=np.zeros(full.shape[:2]),
        ),
        attrs={"frame": "structure"},
    )


def vertical(result):
    return result.sel(point="mid", axis="vertical").isel(passage=0)


@pytest.mark.parametrize("speed", [6.0, 10.0, 16.0])
def test_amplification_without_noise_is_that_of_the_beam(speed):
    passage, time_s, total, static = crossing(speed)
    one = vertical(judge_passages(displacement_of(time_s, total), [passage]))
    assert str(one["status"].values) == PassageStatus.OK
    truth = total.max() / static.max()
    assert float(one["amplification"]) == pytest.approx(truth, abs=0.02)
    assert float(one["amplification_high"] - one["amplification_low"]) < 0.06
    assert float(one["largest_total"]) == pytest.approx(total.max(), abs=0.01 * total.max())


def test_intervals_of_amplification_hold_under_noise():
    """Over 40 crossings of different speeds, beams and noise."""
    held, true, found = [], [], []
    for seed in range(40):
        rng = np.random.default_rng([seed, 7])
        speed, first_hz = rng.uniform(5, 17), rng.uniform(3, 4.5)
        passage, time_s, total, static = crossing(speed, first_hz=first_hz)
        data = displacement_of(time_s, total, noise_mm=0.04, seed=seed)
        one = vertical(judge_passages(data, [passage], frequency_hz=first_hz))
        true.append(total.max() / static.max())
        found.append(float(one["amplification"]))
        held.append(float(one["amplification_low"]) <= true[-1] <= float(one["amplification_high"]))
    assert np.mean(held) >= 0.84  # 95 % less three standard deviations of 40 draws
    # The correction for the largest of noisy values leaves no bias that counts.
    assert abs(np.mean(np.subtract(found, true))) < 0.01


@pytest.mark.parametrize("noise_mm", [0.0, 0.03])
def test_influence_line_is_found_from_several_axles(noise_mm):
    passage, time_s, total, _ = crossing(3.0)
    data = displacement_of(time_s, total * 1.01, noise_mm=noise_mm, scale_std=0.01)
    one = vertical(judge_passages(data, [passage], frequency_hz=FIRST_HZ, axles=TRUCK))
    truth = influence(one["along"].values)
    assert one["along"].values[-1] == pytest.approx(LENGTH_M)
    error = one["influence"].values - truth
    assert np.abs(error).max() < 0.03 * truth.max()
    assert one["influence"].attrs["units"] == "mm/kN"
    inside = np.abs(error)[5:-5] <= 2.5 * one["influence_std"].values[5:-5]
    assert inside.mean() > 0.8
    # The vehicle as it is bends more than its axles would one by one at mid-span's own place.
    assert float(one["static"].max()) > 250 * truth.max()


def test_static_curve_is_over_the_place_of_the_first_axle():
    axle = (Axle(0.0, 100.0),)
    passage, time_s, total, _ = crossing(4.0, axles=axle)
    one = vertical(judge_passages(displacement_of(time_s, total), [passage], frequency_hz=FIRST_HZ))
    assert np.abs(one["static"].values - 100 * influence(one["place"].values)).max() < 0.03 * 1.2
    assert "influence" not in one


def test_what_cannot_be_told_has_a_name():
    passage, time_s, total, _ = crossing(10.0)

    def status(values, passage=passage, **options):
        result = judge_passages(displacement_of(time_s, values, noise_mm=0.01), [passage], **options)
        one = vertical(result)
        assert np.isnan(float(one["amplification"])) == (str(one["status"].values) != PassageStatus.OK)
        return str(one["status"].values)

    assert status(total) == PassageStatus.OK
    holes = total.copy()
    holes[(time_s > 7) & (time_s < 7.5)] = np.nan
    assert status(holes) == PassageStatus.GAPS
    assert status(total, Passage(0.5, 3.9)) == PassageStatus.GAPS
    assert status(np.zeros_like(total)) == PassageStatus.NO_FREQUENCY
    assert status(np.zeros_like(total), frequency_hz=3.4) == PassageStatus.IN_NOISE
    assert status(total, Passage(BEGIN_S, BEGIN_S + 0.5)) == PassageStatus.TOO_FAST
    assert status(total, frequency_hz=400.0) == PassageStatus.TOO_FAST
    with pytest.raises(DatasetError, match="expected them within the recording"):
        judge_passages(displacement_of(time_s, total), [Passage(1.0, 500.0)])


def test_a_vibration_without_a_static_part_has_no_amplification():
    time_s = np.arange(600) / RATE_HZ
    swing = 4 * np.sin(2 * np.pi * 2.5 * time_s) * (time_s > 5)
    found = vertical(judge_passages(displacement_of(time_s, swing, noise_mm=0.01), [Passage(5.0, 9.0)]))
    assert str(found["status"].values) == PassageStatus.IN_NOISE
    assert np.isnan(float(found["amplification"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frequency_hz": -1.0}, "expected that of the structure, above 0 Hz, got -1"),
        ({"frequency_hz": np.nan}, "above 0 Hz, got nan"),
        ({"axles": (Axle(0.0, 60.0), Axle(40.0, 60.0))}, "expected a vehicle that is shorter than its way, 32 m"),
        ({"axles": TRUCK, "passages": [Passage(6.0, 10.0)]}, "expected passages whose speed is stated, got none"),
    ],
)
def test_what_cannot_be_of_structure_and_vehicle_is_refused(options, message):
    time_s = np.arange(600) / RATE_HZ
    given = {"passages": [Passage(6.0, 10.0, 8.0)], **options}
    with pytest.raises(DatasetError, match=message):
        judge_passages(displacement_of(time_s, np.zeros(600)), **given)


def test_one_sample_that_is_missing_is_bridged():
    passage, time_s, total, _ = crossing(8.0)
    values = total.copy()
    values[200] = np.nan
    whole, bridged = (vertical(judge_passages(displacement_of(time_s, v), [passage])) for v in (total, values))
    assert float(bridged["amplification"]) == pytest.approx(float(whole["amplification"]), abs=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("begin_s,end\n3,4\n", "expected columns begin_s and end_s"),
        ("begin_s,end_s,speed\n3,4,5\n", "expected the speed in m/s or km/h, got no unit"),
        ("begin_s,end_s\n3,4\n3.5,6\n", "expected passages one after the other"),
        ("begin_s,end_s,speed [m/s]\n3,4,-5\n", "expected speeds above 0"),
        ("begin_s [min],end_s\n3,4\n", "expected begin_s in s, got min"),
    ],
)
def test_tables_that_cannot_be_meant_are_refused(tmp_path, text, message):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_passages(tmp_path / "p.csv")


def test_tables_have_capitals_commas_and_unknown_speeds(tmp_path):
    (tmp_path / "p.csv").write_text("Passage;Begin_s;End_s;Speed [km/h]\n1;12,5;15;-\n2;20;22;36\n")
    first, second = read_passages(tmp_path / "p.csv")
    assert (first.begin_s, second.speed_m_s) == (12.5, 10.0)
    assert np.isnan(first.speed_m_s)


@pytest.mark.parametrize("text", ["", "60", "1:60", "0:60,0:70", "0:60,3", "0:0", "0:1.2.3"])
def test_axles_that_cannot_be_meant_are_refused(text):
    with pytest.raises(DatasetError, match="expected metres behind the first axle and kN"):
        read_axles(text)


def test_files_and_the_command_say_what_was_judged(command, tmp_path):
    passage, time_s, total, _ = crossing(8.0)
    write_displacement(tmp_path, displacement_of(time_s, total, noise_mm=0.02, scale_std=0.01))
    table = tmp_path / "passages [1].csv"
    table.write_text(f"begin_s,end_s,speed [km/h]\n{passage.begin_s},{passage.end_s},28.8\n")
    code, out, err = command("passages", tmp_path, table, "--axles", "0:70,3.6:115,5:115", "--frequency", "3.4")
    assert code == 0, err
    assert "28.8" in out
    kept = read_passages_of_run(tmp_path)
    one = kept.isel(passage=0).sel(point="mid", axis="vertical")
    (row,) = [row for row in csv.DictReader((tmp_path / "passages.csv").open()) if row["axis"] == "vertical"]
    assert float(row["amplification"]) == pytest.approx(float(one["amplification"]), rel=1e-5)
    assert float(row["largest_static_mm"]) == pytest.approx(float(one["largest_static"]), rel=1e-5)
    assert row["status"] == "ok"
    # Two standard deviations of the scale are its least uncertainty.
    assert float(one["static_uncertainty"]) > 0.02 * float(one["largest_static"])
    assert (tmp_path / "figures" / "passages.png").stat().st_size > 10_000
    code, _, err = command("passages", tmp_path, table, "--axis", "lateral")
    assert code == 3
    assert "no amplification is known along lateral: no frequency" in " ".join(err.split())
    # The table of the results is no table of passages, and none that is given may be written over.
    kept = (tmp_path / "passages.csv").read_bytes()
    code, _, err = command("passages", tmp_path, tmp_path / "passages.csv")
    assert code == 1
    assert "expected a table elsewhere" in err
    assert (tmp_path / "passages.csv").read_bytes() == kept
    (tmp_path / "passages.nc").unlink()
    assert read_passages_of_run(tmp_path) is None
