"""The displacement field: line, bands and shapes against the truth, and what hundreds of points cost.

Two parts. Errors of a beam's points are drawn many times (`tests/fields.py`): independent ones, such as neighbours
share, gains, one scale error for all; the share of stations and times inside the 95 % band is the coverage. With
``--film`` the preset ``data-1`` in its small size is rendered, measured with its seven points and with a grid besides,
and the field is held against the true motion at every station. Bending shapes are compared with those that the same
procedure finds in the true motion at the stations: shapes of modes show only where one mode moves the structure alone.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from fields import draw_field  # noqa: E402
from intervals import range_of_mean_share  # noqa: E402
from vfm_sdm.analysis.field import compute_field, compute_mac, find_shapes  # noqa: E402
from vfm_sdm.core.datasets import STRUCTURE_AXES  # noqa: E402
from vfm_sdm.core.grids import grid_points  # noqa: E402
from vfm_sdm.inputs.session import Grid, Session, read_session  # noqa: E402
from vfm_sdm.measurement import Measurement, measure  # noqa: E402
from vfm_sdm.studies.synthetic.field_test import make_field_test  # noqa: E402
from vfm_sdm.studies.synthetic.presets import preset  # noqa: E402

WEB = ((40.0, 458.0), (1890.0, 418.0), (1890.0, 655.0), (40.0, 608.0))
"""The web of the girder in the left view of ``data-1``, small [px]."""
NORMAL_95 = 1.96


def simulate(draws: int, points: int) -> dict[str, Any]:
    """Coverage and error over drawn fields."""
    inside, errors = [], []
    for seed in range(draws):
        drawn = draw_field(seed, points=points)
        field = compute_field(drawn.displacement, stations=31)
        true = drawn.truth(field["station"].values)
        error = np.abs(field["displacement"].values - true)
        inside.append((error <= NORMAL_95 * field["displacement_std"].values).mean(axis=(0, 1)))
        row = np.abs(true[..., 1]).max(axis=1).argmax()
        errors.append(error[row, :, 1].max() / np.abs(true[row, :, 1]).max())
    print(f"\ndrawn beams  {draws}   points each  {points}")
    print(f"{'axis':<14}{'inside the 95 % band':>22}{'true share':>18}{'one beam in 10 below, above':>32}{'worth':>8}")
    spread = {}
    for axis, shares in zip(STRUCTURE_AXES, np.transpose(inside), strict=True):
        low, high = range_of_mean_share(shares)
        few, many = np.quantile(shares, [0.1, 0.9])
        # So many independent samples would scatter as much as the shares of single beams do.
        worth = shares.mean() * (1 - shares.mean()) / np.var(shares) if draws > 1 and np.ptp(shares) > 0 else 1.0
        spread[axis] = {"low_share": low, "high_share": high, "tenth_share": few, "nine_tenths_share": many}
        print(
            f"{axis:<14}{100 * shares.mean():>20.1f} %{100 * low:>9.1f} to {100 * high:.1f} %"
            f"{100 * few:>20.1f} %, {100 * many:>6.1f} %{worth:>8.1f}"
        )
    print(f"line of the largest deflection, error over its maximum: {100 * np.median(errors):.2f} % in the median")
    return {
        "draws": draws,
        "points": points,
        "inside_share": {a: float(s) for a, s in zip(STRUCTURE_AXES, np.mean(inside, axis=0), strict=True)},
        "inside_range": {a: {key: float(value) for key, value in one.items()} for a, one in spread.items()},
        "line_error_share": float(np.median(errors)),
    }


def timed(session: Session, folder: Path) -> tuple[Measurement, dict[str, float]]:
    """A measurement as the command makes it, forecast included, with its seconds."""
    begin, cpu = time.perf_counter(), time.process_time()
    measurement = measure(session, folder, forecast=lambda expected: None)
    return measurement, {"wall_s": time.perf_counter() - begin, "cpu_s": time.process_time() - cpu}


def film(folder: Path, spacing_m: float) -> dict[str, Any]:
    """The rendered preset with seven points, and with a grid besides."""
    plan = preset("data-1", "small")
    session = read_session(make_field_test(folder / "recording", plan))
    # What is compiled at first use belongs to neither.
    _, seven = timed(session, folder / "seven")
    grid = Grid(name="web", view="left", polygon=WEB, spacing_m=spacing_m)
    measurement, many = timed(session.model_copy(update={"grid": (grid,)}), folder / "many")
    displacement = measurement.displacement
    if displacement is None or measurement.audit is None:
        raise SystemExit(f"no displacement: {measurement.cameras.status}")
    static = [point.name for point in session.point if point.static]
    begin = time.perf_counter()
    field = compute_field(displacement, static=static, still_interval_s=session.method.still_interval_s)
    took_s = time.perf_counter() - begin
    station, time_s = field["station"].values, field["time"].values
    places = np.column_stack([np.full(len(station), plan.site.perpendicular_m), 0 * station, station])
    true = 1e3 * plan.motion.displacement(time_s, places)
    error = field["displacement"].values - true
    inside = (np.abs(error) <= NORMAL_95 * field["displacement_std"].values).mean(axis=(0, 1))
    row = np.abs(true[..., 1]).max(axis=1).argmax()
    line = np.abs(error[row]).max(axis=0) / np.abs(true[..., :]).max(axis=(0, 1))
    shapes, _ = find_shapes(true, time_s)
    mac = [compute_mac(field["shape"].values[n, :, 1], shapes[n, :, 1]) for n in range(3)]
    names = grid_points(displacement)
    print(f"\ndata-1, small: grid of {len(names)} points, {int(field['used'].sum('point').max())} points used")
    print(f"{'axis':<14}{'error of the line':>20}{'inside the band':>18}")
    for axis, share, held in zip(STRUCTURE_AXES, line, inside, strict=True):
        print(f"{axis:<14}{100 * share:>18.2f} %{100 * held:>16.1f} %")
    print("MAC of vertical shapes  " + "  ".join(f"{one:.4f}" for one in mac))
    print(f"verdict  {measurement.audit.verdict}")
    print(f"{'points':<10}{'wall s':>10}{'cpu s':>10}\n{'seven':<10}{seven['wall_s']:>10.1f}{seven['cpu_s']:>10.1f}")
    print(f"{'grid':<10}{many['wall_s']:>10.1f}{many['cpu_s']:>10.1f}\nfield  {took_s:.1f} s")
    return {
        "points": len(names),
        "line_error_share": {a: float(s) for a, s in zip(STRUCTURE_AXES, line, strict=True)},
        "inside_share": {a: float(s) for a, s in zip(STRUCTURE_AXES, inside, strict=True)},
        "mac_ratio": [float(one) for one in mac],
        "seven_points": seven,
        "grid": many,
        "wall_ratio": many["wall_s"] / seven["wall_s"],
        "cpu_ratio": many["cpu_s"] / seven["cpu_s"],
        "field_s": took_s,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200, help="beams that are drawn")
    parser.add_argument("--points", type=int, default=200, help="points of each")
    parser.add_argument("--film", action="store_true", help="also render and measure data-1 (some ten minutes)")
    parser.add_argument("--spacing", type=float, default=0.155, help="of the grid on the film [m]")
    parser.add_argument("--folder", type=Path, help="where the film is kept; a temporary folder when left out")
    options = parser.parse_args()
    found = simulate(options.draws, options.points)
    if options.film:
        with tempfile.TemporaryDirectory() as temporary:
            found["film"] = film(options.folder or Path(temporary), options.spacing)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
