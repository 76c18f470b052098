"""Modes: how often the 95 % intervals hold, wrong poles, shapes, on records of known structures.

A chain of five masses (1.2 to 8.1 Hz, damping 1.5 %, noise of 1 % of the motion, 30 frames a second) and the girder of
the virtual footbridge (two lateral and three vertical modes, 1.57 to 13.8 Hz, damping 1.0 to 1.6 %; six points, 0.02 to
0.05 mm of noise, 60 frames a second), both driven by white noise and begun in the midst of their motion. A pole is
wrong where no mode of its shape (MAC 0.8) is as near in frequency as the record tells (see `tolerance`), or where
another pole has taken that mode. Records of noise alone have no modes.

Ranges are those in which the true share lies with 95 % if poles are independent trials. ``stated`` is the share of MACs
above the one that the standard deviations of a shape give a chance of 5 % to lie below; it should be 95 %.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.stats import chi2

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from intervals import range_of_share  # noqa: E402
from vfm_sdm.analysis.modal import ModalOptions, compute_mac, identify_modes  # noqa: E402
from vfm_sdm.core.datasets import STRUCTURE_AXES  # noqa: E402
from vfm_sdm.studies.synthetic.presets import preset  # noqa: E402
from vibrating import oscillate  # noqa: E402

STIFFNESS = 2 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1)
STIFFNESS[-1, -1] = 1
STATIONS = np.array([1 / 8, 1 / 4, 3 / 8, 1 / 2, 5 / 8, 3 / 4])
GIRDER_NOISE_MM = (0.03, 0.02, 0.05)


def as_displacement(values: np.ndarray, rate_hz: float, noise_mm: tuple[float, float, float]) -> xr.Dataset:
    """A displacement dataset of values of shape (T, P, 3) [mm], along a structure of 30 m."""
    frames, points, _ = values.shape
    place = np.zeros((frames, points, 3))
    place[:, :, 2] = np.linspace(3, 27, points)
    dims = ("time", "point", "axis")
    return xr.Dataset(
        {
            "displacement": (dims, values, {"units": "mm"}),
            "displacement_std": (dims, np.broadcast_to(noise_mm, values.shape).copy(), {"units": "mm"}),
            "position": (dims, place, {"units": "m"}),
            "status": (dims[:2], np.zeros((frames, points), np.int8)),
        },
        {
            "time": np.arange(frames) / rate_hz,
            "point": [f"p{index}" for index in range(points)],
            "axis": list(STRUCTURE_AXES),
        },
    )


def make_chain(duration_s: float, rng: np.random.Generator) -> tuple[xr.Dataset, np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, and true frequencies [Hz], damping ratios and shapes (M, P, 3)."""
    squares, shapes = np.linalg.eigh(STIFFNESS)
    frequency, damping = 1.2 * np.sqrt(squares / squares[0]), np.full(5, 0.015)
    count = round(30 * duration_s)
    modal = [oscillate(f, z, count, 30.0, rng) / f**1.5 for f, z in zip(frequency, damping, strict=True)]
    moved = np.stack(modal, axis=1) @ shapes.T
    noise = 0.01 * float(moved.std())
    values, true = np.full((count, 5, 3), np.nan), np.zeros((5, 5, 3))
    values[:, :, 1], true[:, :, 1] = moved + noise * rng.normal(size=moved.shape), shapes.T
    return as_displacement(values, 30.0, (noise, noise, noise)), frequency, damping, true


def make_girder(duration_s: float, rng: np.random.Generator, *, moves: bool = True) -> tuple:
    """As `make_chain`; it may stand still."""
    modes = preset("data-1").motion.modes
    count = round(60 * duration_s)
    values = np.array(GIRDER_NOISE_MM) * rng.normal(size=(count, len(STATIONS), 3))
    true = np.zeros((len(modes), len(STATIONS), 3))
    for number, mode in enumerate(modes):
        axis = STRUCTURE_AXES.index(mode.axis)
        true[number, :, axis] = mode.shape(STATIONS)
        size = (2.31 / mode.frequency_hz) ** 1.5 * (0.011 / mode.damping_ratio) ** 0.5 if moves else 0.0
        values[:, :, axis] += size * np.outer(
            oscillate(mode.frequency_hz, mode.damping_ratio, count, 60.0, rng), true[number, :, axis]
        )
    frequency, damping = (np.array([getattr(mode, n) for mode in modes]) for n in ("frequency_hz", "damping_ratio"))
    return as_displacement(values, 60.0, GIRDER_NOISE_MM), frequency, damping, true


COLUMNS = ("length", "found", "wrong", "f holds", "(true share)", "damping", "(true share)", "MAC 5 %", "least")
COLUMNS += ("of mode", "stated", "f error", "a record")
WIDTHS = (7, 8, 7, 9, 14, 9, 14, 9, 8, 9, 9, 9, 10)
"""Of the columns."""


def tolerance(frequency: np.ndarray, damping: np.ndarray, duration_s: float) -> np.ndarray:
    """How far a pole may lie from a mode to be its own, over the mode's frequency, shape (M,).

    Half of the half-power bandwidth, z f: a pole within it stands on the mode's peak. Of a short record four standard
    deviations of what noise-free white excitation lets anybody know, sqrt(z / (2 pi f T)) of the frequency (Au 2014,
    Mechanical Systems and Signal Processing 48, 15-33): one in 16,000 lies beyond. Neither asks what the pole says of
    itself: a wide interval makes no pole right.
    """
    return np.maximum(damping, 4 * np.sqrt(damping / (2 * np.pi * frequency * duration_s)))


def score(
    found: xr.Dataset, frequency: np.ndarray, damping: np.ndarray, true: np.ndarray, *, duration_s: float
) -> list[tuple]:
    """Of every pole: whether it is right and its intervals hold, MAC, error of the frequency, mode, and MAC stated."""
    rows, taken = [], set()
    reach = tolerance(frequency, damping, duration_s)
    flat = true.reshape(len(true), -1).astype(complex)
    for number in range(found.sizes["mode"]):
        one = found.isel(mode=number)
        hertz = float(one["frequency"])
        mac = compute_mac(np.nan_to_num(one["shape"].values).reshape(1, -1), flat)[0]
        near = np.abs(hertz / frequency - 1)
        mode = int(np.where(mac > 0.8, near, np.inf).argmin())
        right = bool(near[mode] < reach[mode] and mac[mode] > 0.8 and mode not in taken)
        taken.add(mode)
        holds = [
            float(one[f"{name}_low"]) <= value[mode] <= float(one[f"{name}_high"])
            for name, value in (("frequency", frequency), ("damping_ratio", damping))
        ]
        rows.append((right, *holds, mac[mode], hertz / frequency[mode] - 1, mode, stated_mac(one)))
    return rows


def stated_mac(one: xr.Dataset) -> float:
    """MAC with the true shape that lies below it with 5 % by the standard deviations of a shape.

    What is missing to 1 is the sum of the squares of the errors, complex normal deviates, over that of the shape;
    its quantile is that of a chi-squared variable of the same mean and variance.
    """
    variance = np.nan_to_num(one["shape_std"].values).ravel() ** 2 / np.nansum(np.abs(one["shape"].values) ** 2)
    freedom = 2 * variance.sum() ** 2 / (variance**2).sum()
    return float(1 - variance.sum() * chi2.ppf(0.95, freedom) / freedom)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="records of every kind")
    parser.add_argument("--seconds", type=float, nargs="+", default=[16, 60, 300], help="lengths of the records")
    options = parser.parse_args()
    figures: dict[str, float] = {}
    print(f"{'structure':10s}" + "".join(map(str.rjust, COLUMNS, WIDTHS)))
    for name, make in (("chain", make_chain), ("girder", make_girder)):
        for seconds in options.seconds:
            begin, rows = time.process_time(), []
            for seed in range(options.runs):
                displacement, *truth = make(seconds, np.random.default_rng([seed, round(seconds)]))
                axes = ("vertical",) if name == "chain" else STRUCTURE_AXES
                rows += score(identify_modes(displacement, ModalOptions(axes=axes)), *truth, duration_s=seconds)
            each = (time.process_time() - begin) / options.runs
            table = np.array([row for row in rows if row[0]], dtype=float).reshape(-1, 7)
            wrong = len(rows) - len(table)
            found = len(table) / (5 * options.runs)
            ranges = [range_of_share(int(table[:, column].sum()), len(table)) for column in (1, 2)]
            f_holds, z_holds = table[:, 1].mean(), table[:, 2].mean()
            low, error, least = np.quantile(table[:, 3], 0.05), table[:, 4].std(), table[table[:, 3].argmin()]
            between = [f"{one[0]:.3f}-{one[1]:.3f}" for one in ranges]
            cells = (f"{seconds:g} s", f"{found:.3f}", str(wrong), f"{f_holds:.3f}", between[0], f"{z_holds:.3f}")
            cells += (between[1], f"{low:.4f}", f"{least[3]:.3f}", f"{truth[0][int(least[5])]:.3g} Hz")
            cells += (f"{(table[:, 3] > table[:, 6]).mean():.3f}", f"{100 * error:.2f} %", f"{each:.2f} s")
            print(f"{name:10s}" + "".join(map(str.rjust, cells, WIDTHS)), flush=True)
            of_kind = {
                "modes_found_share": found,
                "wrong_poles_share": wrong / max(len(rows), 1),
                "frequency_interval_holds_share": f_holds,
                "frequency_interval_holds_low_share": ranges[0][0],
                "frequency_interval_holds_high_share": ranges[0][1],
                "damping_interval_holds_share": z_holds,
                "damping_interval_holds_low_share": ranges[1][0],
                "damping_interval_holds_high_share": ranges[1][1],
                "mac_least_ratio": least[3],
                "mac_above_stated_share": (table[:, 3] > table[:, 6]).mean(),
                "mac_of_one_in_twenty_ratio": low,
                "frequency_error_relative": error,
                "processor_time_s": each,
            }
            figures |= {f"{name}_{seconds:g}_s_{key}": round(float(value), 5) for key, value in of_kind.items()}
    poles = sum(
        identify_modes(make_girder(options.seconds[0], np.random.default_rng(seed), moves=False)[0]).sizes["mode"]
        for seed in range(options.runs)
    )
    print(f"poles in {options.runs} records of noise alone: {poles}")
    print(json.dumps({**figures, "poles_a_record_of_noise_ratio": poles / options.runs}))


if __name__ == "__main__":
    main()
