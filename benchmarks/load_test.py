"""Load tests that are simulated: whether levels lie inside their intervals and probabilities are frequencies.

Steps of 0.5 to 5 mm with 0.3 mm of vibration on top, whose strength beats, a scale known to 2 %, and noise of 0.05 mm a
sample. A plain mean of each step with the standard error of its samples stands beside the level that is judged.

    python benchmarks/load_test.py [--tests N] [--figure FILE]
"""

import argparse
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from vfm_sdm.analysis.load_test import LoadPlan, LoadStep, judge_load_test
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement
from vfm_sdm.stages.displacement.uncertainty import COMPONENTS

LOADS = np.array([0.0, 100.0, 200.0, 300.0, 150.0, 0.0])
STAND_S, MOVE_S, RATE_HZ = 20.0, 8.0, 20.0
NOISE_MM, VIBRATION_MM, SCALE_STD = 0.05, 0.3, 0.02
BINS = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def simulate(seed):
    """Displacement of one test, its plan, and what is true: levels, ratio and residual share."""
    rng = np.random.default_rng(seed)
    largest, ratio, residual = rng.uniform(0.5, 5.0), rng.uniform(0.9, 1.1), rng.uniform(0.12, 0.18)
    calculated = largest * LOADS / LOADS.max()
    levels = ratio * calculated
    levels[-1] = residual * levels.max()
    begin = np.arange(len(LOADS)) * (STAND_S + MOVE_S)
    time_s = np.arange(round((begin[-1] + STAND_S) * RATE_HZ)) / RATE_HZ
    edges = np.column_stack([begin, begin + STAND_S]).ravel()
    static = np.interp(time_s, edges, np.repeat(levels, 2))
    beat = 1 + 0.5 * np.sin(2 * np.pi * rng.uniform(0.02, 0.1) * time_s + rng.uniform(0, 6))
    wave = np.sqrt(2) * VIBRATION_MM * beat * np.sin(2 * np.pi * rng.uniform(1.2, 4) * time_s + rng.uniform(0, 6))
    values = np.zeros((len(time_s), 1, 3))
    values[:, 0, 1] = (static + wave) * (1 + rng.normal(0, SCALE_STD)) + rng.normal(0, NOISE_MM, len(time_s))
    arrays = DisplacementArrays(
        displacement_mm=values,
        displacement_std_mm=np.full(values.shape, NOISE_MM),
        scale_std=np.full((1, 3), SCALE_STD),
        position_m=np.zeros(values.shape),
        reprojection_error_px=np.zeros(values.shape[:2]),
        status=np.zeros(values.shape[:2]),
    )
    data = make_displacement(time_s, ["mid"], STRUCTURE_AXES, arrays, attrs={"frame": "structure"})
    budget = np.zeros((len(COMPONENTS), *values.shape))
    budget[COMPONENTS.index("random")] = NOISE_MM
    budget[COMPONENTS.index("cameras")] = SCALE_STD * np.abs(values)
    data = data.assign(uncertainty=(("component", "time", "point", "axis"), budget, {"units": "mm"}))
    steps = tuple(
        LoadStep(load, at, at + STAND_S, {("mid", "vertical"): value})
        for load, at, value in zip(LOADS, begin, calculated, strict=True)
    )
    return data.assign_coords(component=list(COMPONENTS)), LoadPlan(steps, "kN"), levels, ratio, residual


def plain_levels(data, plan):
    """Means of the steps less the first one's, and the half width of 95 % that the scatter of the samples gives."""
    time_s, values = data["time"].values, data["displacement"].values[:, 0, 1]
    parts = [values[(time_s >= step.begin_s) & (time_s <= step.end_s)] for step in plan.steps]
    mean = np.array([part.mean() for part in parts])
    error = np.array([part.std() / np.sqrt(len(part)) for part in parts])
    return mean - mean[0], 1.96 * np.hypot(error, error[0])


def tabulate(name, said, true):
    """Rows of a reliability diagram: mean probability that was said, share that was true, and its chance."""
    print(f"\n{name + ' exceeded, said':>28}  {'true in':>8}  {'chance +-':>9}  {'tests':>6}")
    rows = []
    for low, high in pairwise(BINS):
        inside = (said >= low) & ((said < high) | (high == BINS[-1]))
        if not inside.any():
            continue
        spread = float(np.sqrt(np.sum(said[inside] * (1 - said[inside]))) / inside.sum())
        rows.append((float(said[inside].mean()), float(true[inside].mean()), spread))
        print(f"{rows[-1][0]:>28.3f}  {rows[-1][1]:>8.3f}  {2 * spread:>9.3f}  {int(inside.sum()):>6}")
    return rows


def draw(diagrams, path):
    """Reliability diagrams: on the diagonal, a probability is a frequency."""
    figure = Figure(figsize=(9, 4.4), layout="constrained")
    for axes, (name, rows) in zip(figure.subplots(1, len(diagrams)), diagrams.items(), strict=True):
        said, true, spread = np.array(rows).T
        axes.plot([0, 1], [0, 1], color="#767676", linewidth=0.8)
        axes.errorbar(said, true, yerr=2 * spread, marker="o", linestyle="none", color="#0072B2", capsize=3)
        axes.set(xlabel="probability that was said", ylabel="share of the tests in which it was true")
        axes.set_title(f"limit of the {name}", loc="left")
    figure.savefig(path, dpi=130)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--tests", type=int, default=200, help="number of simulated tests")
    parser.add_argument("--figure", type=Path, help="file for the reliability diagrams")
    options = parser.parse_args()
    held, plain, widths, ratios, residuals = [], [], [], [], []
    for seed in range(options.tests):
        data, plan, levels, ratio, residual = simulate(seed)
        one = judge_load_test(data, plan).sel(point="mid", axis="vertical")
        expanded = one["expanded_uncertainty"].values[1:]
        held.append(np.abs(one["deflection"].values - levels)[1:] <= expanded)
        mean, half = plain_levels(data, plan)
        plain.append((np.abs(mean - levels) <= half)[1:])
        widths.append(expanded)
        ratios.append((float(one["ratio_exceeded"][3]), ratio > one.attrs["ratio_limit"]))
        residuals.append((float(one["residual_exceeded"]), residual > one.attrs["residual_limit"]))
    print(f"{options.tests} tests of 0.5 to 5 mm with {VIBRATION_MM} mm of vibration")
    print(f"{'levels inside their intervals':>40}  {np.mean(held):.3f}")
    print(f"{'of plain means with standard errors':>40}  {np.mean(plain):.3f}")
    print(f"{'half width, median [mm]':>40}  {np.median(widths):.3f}")
    diagrams = {
        name: tabulate(name, *(np.array(column, float) for column in zip(*pairs, strict=True)))
        for name, pairs in (("ratio", ratios), ("residual", residuals))
    }
    if options.figure is not None:
        draw(diagrams, options.figure)
    most = max((abs(said - true) / max(2 * spread, 1e-9)) for rows in diagrams.values() for said, true, spread in rows)
    figures = {
        "draws": options.tests,
        "inside_share": float(np.mean(held)),
        "inside_share_plain": float(np.mean(plain)),
        "half_width_median_mm": float(np.median(widths)),
        "worst_ratio_to_chance": float(most),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
