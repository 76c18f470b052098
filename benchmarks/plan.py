"""Predicted against achieved expanded uncertainty of planned sites, and optimised against given positions.

Sites are drawn: spans of 8 to 20 m, cameras 5 to 14 m from the face, fields of view of 15 to 35 degrees, textures,
compression, tapes and amplitudes. Simulated sites draw lenses, readings, matches and tracks by the standard deviations
that the plan states, and are measured without images. Rendered sites are filmed by the project's renderer and measured
by the program from the files. What is compared is the expanded uncertainty (k = 2) that the measurement states of a
sample, over points and the axes that move; beside it the true error over the stated one.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from vfm_sdm.studies.planning.layout import try_lay_out
from vfm_sdm.studies.planning.plan import Area, Plan
from vfm_sdm.studies.planning.positions import optimise_positions
from vfm_sdm.studies.planning.prediction import predict
from vfm_sdm.studies.planning.rehearsal import compare_rehearsal, rehearse_films, rehearse_tracks

WITHIN = (0.67, 1.5)
SIZE = (640, 360)


@dataclass(frozen=True)
class Row:
    """One site: achieved over predicted, of the site and of every point and axis; the true error over the stated."""

    seed: int
    predicted: float
    ratio: float
    of_axes: tuple[float, ...]
    error_ratio: float
    inside: float
    status: str
    seconds: float


def draw_plan(seed: int) -> Plan:
    """A site that two cameras see, drawn from a seed."""
    rng = np.random.default_rng([seed, 41])
    while True:
        plan = _draw(rng)
        laid = try_lay_out(plan)
        if laid is not None and laid.visible().all():
            return plan


def _draw(rng: np.random.Generator) -> Plan:
    span, height, depth = rng.uniform(8, 20), rng.uniform(0.5, 4.0), rng.uniform(0.6, 1.3)
    away, view_deg, apart = rng.uniform(5, 14), rng.uniform(15, 35), rng.uniform(0.25, 0.6)
    at = rng.uniform(0.3, 0.7) * span
    first = at + rng.uniform(-0.8, 0.8) * away
    second = first + float(rng.choice([-1, 1])) * apart * away
    focal_px = SIZE[0] / 2 / np.tan(np.radians(view_deg) / 2)
    lens_std = float(rng.choice([0.005, 0.02, 0.05]))
    bits = float(np.exp(rng.uniform(np.log(2), np.log(10))))
    cameras = [
        {
            "name": name, "longitudinal_m": float(place), "perpendicular_m": float(away * factor), "height_m": 1.5,
            "image_size": SIZE, "bitrate_mbit_s": bits,
            "lens": {"focal_px": float(focal_px * rng.uniform(0.95, 1.05)), "relative_std": lens_std},
        }
        for name, place, factor in (("left", first, 1.0), ("right", second, rng.uniform(0.8, 1.2)))
    ]  # fmt: skip
    half = 0.28 * 2 * np.tan(np.radians(view_deg) / 2) * away
    middle = height + depth / 2
    points = [
        {"name": "a", "longitudinal_m": float(at - half * 0.6), "height_m": float(middle + 0.1 * depth)},
        {"name": "b", "longitudinal_m": float(at + half * 0.5), "height_m": float(middle - 0.15 * depth)},
        {
            "name": "still", "longitudinal_m": float(at + 0.2 * half), "height_m": float(height - 0.35),
            "perpendicular_m": -0.2, "static": True,
        },
        {
            "name": "still too", "longitudinal_m": float(at - 0.5 * half), "height_m": float(height - 0.3),
            "perpendicular_m": -0.2, "static": True,
        },
    ]  # fmt: skip
    measured = {
        "baseline_std_m": float(rng.uniform(0.003, 0.02)),
        "perpendicular_std_m": float(rng.uniform(0.01, 0.1)),
        "longitudinal_std_m": float(rng.uniform(0.02, 0.2)),
        "level_std_deg": float(rng.uniform(0.1, 0.5)),
        "range": [{"point": "a", "std_m": 0.01}] if rng.random() < 0.5 else [],
        "length": [{"points": ("a", "b"), "std_m": 0.005}] if rng.random() < 0.3 else [],
        "pan_clip_std": 0.003 if rng.random() < 0.3 else None,
    }
    motion = {
        "lateral": {"amplitude_mm": float(rng.uniform(1, 6)), "frequency_hz": float(rng.uniform(1, 3))},
        "vertical": {"amplitude_mm": float(rng.uniform(2, 12)), "frequency_hz": float(rng.uniform(1, 4))},
    }
    structure = {
        "span_m": float(span), "bottom_m": float(height), "top_m": float(height + depth),
        "contrast": float(rng.uniform(8, 30)), "background_m": (1.0, 12.0),
    }  # fmt: skip
    return Plan(
        name="site", structure=structure, camera=cameras, point=points, measured=measured, motion=motion,
        fps=30.0, duration_s=2.5, still_s=0.5, synchronization="none", time_offset_std_s=2e-4,
    )  # fmt: skip


def study(seed: int, *, rendered: bool, folder: Path) -> Row:
    start = time.perf_counter()
    prediction = predict(draw_plan(seed))
    if rendered:
        rehearsal = rehearse_films(prediction.laid, folder / str(seed), seed=seed)
    else:
        rehearsal = rehearse_tracks(prediction.laid, seed=seed)
    found = compare_rehearsal(prediction, rehearsal)
    return Row(
        seed, prediction.relative, found.ratio, tuple(one.ratio for one in found.axes),
        found.error_ratio, found.inside, found.status, time.perf_counter() - start,
    )  # fmt: skip


@dataclass(frozen=True)
class Moved:
    """Optimised places of one site: uncertainty over that of the given ones, predicted and of drawn measurements."""

    seed: int
    predicted: float
    achieved: float
    tried: int
    seconds: float


def optimise(seed: int, tries: int) -> Moved:
    """The best places in an area a little larger than that between the given ones."""
    start = time.perf_counter()
    given = predict(draw_plan(seed))
    places = np.array([one.place for one in given.laid.plan.camera])
    away, along = places[:, 0], places[:, 1]
    area = Area(
        perpendicular_m=(0.7 * float(away.min()), 1.2 * float(away.max())),
        longitudinal_m=(float(along.min()) - 3.0, float(along.max()) + 3.0),
    )
    found = optimise_positions(given, area, starts=tries, steps=tries)
    achieved = [
        compare_rehearsal(one, rehearse_tracks(one.laid, seed=seed)).achieved for one in (found.prediction, given)
    ]
    return Moved(seed, found.left, achieved[0] / achieved[1], found.tried, time.perf_counter() - start)


def summarize(name: str, rows: Sequence[Row]) -> dict[str, float]:
    """A line of the table, and its figures."""
    ratios = np.array([row.ratio for row in rows])
    axes = np.array([ratio for row in rows for ratio in row.of_axes])
    measured = np.isfinite(ratios)
    figures = {
        "within_share": float(np.mean((ratios >= WITHIN[0]) & (ratios <= WITHIN[1]))),
        "axes_within_share": float(np.mean((axes >= WITHIN[0]) & (axes <= WITHIN[1]))),
        "median_ratio": float(np.median(ratios[measured])) if measured.any() else float("nan"),
        "least_ratio": float(np.min(ratios[measured])) if measured.any() else float("nan"),
        "largest_ratio": float(np.max(ratios[measured])) if measured.any() else float("nan"),
        "inside_share": float(np.mean([row.inside for row in rows if np.isfinite(row.ratio)] or [np.nan])),
        "measured_share": float(measured.mean()),
        "mean_s": float(np.mean([row.seconds for row in rows])),
    }
    print(f"{name:12s}  {len(rows):5d}" + "".join(f"  {value:>12.3f}" for value in figures.values()), flush=True)
    return figures


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--simulated", type=int, default=40, help="sites measured without images")
    parser.add_argument("--rendered", type=int, default=4, help="sites filmed and measured, half a minute each")
    parser.add_argument("--optimised", type=int, default=4, help="sites whose places are optimised, a minute each")
    parser.add_argument("--tries", type=int, default=32, help="places tried before and after the best, a power of two")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    names = ("within", "axes within", "median", "least", "largest", "inside", "measured", "seconds")
    print(f"{'sites':12s}  {'count':>5s}" + "".join(f"  {name:>12s}" for name in names))
    summary: dict[str, object] = {"processors": os.cpu_count()}
    for kind in ("simulated", "rendered"):
        rows = []
        for seed in range(options.first, options.first + getattr(options, kind)):
            with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
                rows.append(study(seed, rendered=kind == "rendered", folder=Path(folder)))
            if options.verbose:
                print(f"    {rows[-1]}", flush=True)
        if rows:
            summary[kind] = {**summarize(kind, rows), "points": len(rows)}
    moved = []
    for seed in range(options.first, options.first + options.optimised):
        with threadpool_limits(1):
            moved.append(optimise(seed, options.tries))
        if options.verbose:
            print(f"    {moved[-1]}", flush=True)
    if moved:
        better = float(np.mean([one.achieved < 1 for one in moved]))
        left = float(np.median([one.achieved for one in moved]))
        print(f"{'optimised':12s}  {len(moved):5d}  better {better:.2f}  median left {left:.2f}")
        summary["optimised"] = {"better_share": better, "median_left_ratio": left, "points": len(moved)}
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
