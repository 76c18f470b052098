"""What straight edges of the structure are worth, by simulation: scale, focal length, distortion and axes.

Sites, lenses, readings and matches are drawn as in `benchmarks/scale.py`, without ranges and lengths. Members of the
structure run along axes that are off the right angle by draws from the stated standard deviation; each is out of line
by 0.2 degrees, and a part of all edges has any direction. Every site is solved without and with its edges: where the
two distances that give the axes were measured, where they were not, and where not even the level was read.

``--rectangles`` solves sites with a taped rectangle in place of edges: its aspect to 2 mm in a side, its corners
pointed to half a pixel in views of 27 degrees from 22 m, both lenses known to 5 % and both centres known.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import measurements as m  # noqa: E402
from simulation import SIZE, gain_error, project_all, site_trial  # noqa: E402
from structure_edges import draw_directions, draw_edges  # noqa: E402
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std  # noqa: E402
from vfm_sdm.inputs.session import Lines, Measured, Ratio, Rectangle, Site  # noqa: E402
from vfm_sdm.stages.cameras.site import adjust_to_site  # noqa: E402
from vfm_sdm.stages.cameras.site_values import SitePoint  # noqa: E402
from vfm_sdm.stages.cameras.solution import CameraSolution  # noqa: E402

READINGS = ("distances", "level alone", "nothing")
NORMAL_95 = 1.96
FIGURES = (
    "scale_inside_share", "scale_std_relative", "scale_rms_relative", "focal_inside_share", "focal_std_relative",
    "axes_inside_share", "axes_std_deg", "ok_share",
)  # fmt: skip
FOREIGN, MEMBERS = 30, (0, 60, 60)


@dataclass(frozen=True)
class Draw:
    """One site with one set of readings: errors over stated standard deviations, and these."""

    seed: int
    readings: str
    lines: bool
    status: str
    scale: tuple[float, float]
    """Error of the vertical scale, and its standard deviation [1]."""
    focal: tuple[float, float]
    """The same of the logarithm of the first focal length."""
    axes: tuple[float, float]
    """Largest standardised error of the axes, and the largest of their standard deviations [deg]; NaN without axes."""
    cpu_s: float


def draw(seed: int, readings: str, *, lines: bool, square_deg: float = 1.0, true_deg: float | None = None) -> Draw:
    """A site of this seed; members are off the right angle as stated, or by `true_deg`."""
    rng, noise, lens, bridge = (np.random.default_rng([seed, stream]) for stream in range(4))
    view_deg = lens.uniform(14, 60)
    true_px = SIZE[0] / 2 / np.tan(np.radians(view_deg) / 2)
    c = replace(
        m.draw_conditions(rng), focal_px=float(true_px), focal_std=0.05, focal_errors=tuple(lens.normal(0, 0.05, 2)),
        distortion_std=0.025, distortion_errors=tuple(lens.normal(0, 0.025, 2)), range_std=None, length_std=None,
        duration_s=0.5,
    )  # fmt: skip
    rig, frame, pitch = m._true_rig(c, noise)
    points3d = m._place_points(rig, frame, c, noise)
    clicked = project_all(rig, points3d) + noise.normal(0, 0.5, (2, len(points3d), 2))
    session = m._session(c, rig, points3d, clicked, pitch, "none")
    along = draw_directions(bridge, square_deg if true_deg is None else true_deg, 0.0 if readings == "nothing" else 1.0)
    edges = draw_edges(bridge, rig, along @ frame.rotation, members=MEMBERS, foreign=FOREIGN)
    session = session.model_copy(update={"site": _site(session.site, readings, lines, square_deg)})
    start = time.process_time()
    solution = m._solve(c, session, rig, clicked, noise, edges)
    cpu_s = time.process_time() - start
    sensitivity = compute_gain_sensitivity(project_all(rig, points3d[:1]), solution.rig)
    stated = np.diag(compute_gain_std(sensitivity, np.eye(3), solution.covariance)[0])
    error = float(gain_error(rig, solution.rig, points3d[0])[1])
    focal = float(np.log(solution.rig.cameras[0].focal_px / rig.cameras[0].focal_px))
    focal_std = float(np.sqrt(solution.rig.covariance[0, 0]))
    axes = _axes(solution, frame.rotation)
    return Draw(seed, readings, lines, str(solution.status), (error, float(stated[1])), (focal, focal_std), axes, cpu_s)


def _site(site: Site, readings: str, lines: bool, square_deg: float) -> Site:
    """The site as far as it was measured."""
    update: dict[str, object] = {"lines": Lines(out_of_square_std_deg=square_deg) if lines else None}
    if readings != "distances":
        update |= {"perpendicular_distance": None, "longitudinal_distance": None}
    if readings == "nothing":
        update["reference_camera_level"] = None
    return site.model_copy(update=update)


def _axes(solution: CameraSolution, truth: np.ndarray) -> tuple[float, float]:
    if solution.frame is None:
        return float("nan"), float("nan")
    error = Rotation.from_matrix(solution.frame.rotation @ truth.T).as_rotvec()
    std = np.sqrt(np.diag(solution.frame.covariance))
    return float(np.abs(error / std).max()), float(np.degrees(std.max()))


@dataclass(frozen=True)
class Kind:
    """A rectangle: its width [m], twice its height; how far it is turned [deg], and out of square, as stated [deg]."""

    width_m: float
    turned_deg: float
    square_deg: float

    def __str__(self) -> str:
        return f"{self.width_m:g} m, turned {self.turned_deg:g}, square to {self.square_deg:g} deg"


KINDS = tuple(Kind(width, turned, square) for width in (4.0, 8.0) for turned in (30.0, 50.0) for square in (0.02, 0.2))
SIDE_STD_M, CORNER_STD_PX = 0.002, 0.5


def draw_rectangle(seed: int, kind: Kind) -> tuple[float, float]:
    """Error of the logarithm of the first focal length, and its standard deviation."""
    rng = np.random.default_rng(seed)
    trial = site_trial(rng)
    corners = kind.width_m / 4 * np.array([[-2.0, -1, 0], [2, -1, 0], [2, 1, 0], [-2, 1, 0]])
    # Out of square as stated: a shear, and one end longer than the other.
    off = np.radians(rng.normal(0, kind.square_deg, 2))
    corners[:, 0] += off[0] * corners[:, 1] + off[1] * corners[:, 0] * corners[:, 1] / kind.width_m
    turned = Rotation.from_euler("y", kind.turned_deg, degrees=True).apply(corners) + np.array([0.0, 0.0, 22.0])
    pixels = project_all(trial.truth, turned)
    pixels = pixels + rng.normal(0, CORNER_STD_PX, pixels.shape)
    std = 2 * SIDE_STD_M / (kind.width_m / 2)
    rectangle = Rectangle(
        points=tuple("abcd"),
        aspect=Ratio(value=2 + rng.normal(0, std), std=std),
        out_of_square_std_deg=kind.square_deg,
    )
    site = Site(baseline=Measured(value=trial.truth.baseline(), std=0.01), rectangle=(rectangle,))
    points = {name: SitePoint(pixels[:, index], CORNER_STD_PX) for index, name in enumerate("abcd")}
    found = adjust_to_site(trial.prior, [trial.matches], site, points).rig
    error = float(np.log(found.cameras[0].focal_px / trial.truth.cameras[0].focal_px))
    return error, float(np.sqrt(found.covariance[0, 0]))


def tabulate_rectangles(count: int) -> dict[str, dict[str, float]]:
    """Prints and returns what every kind of rectangle tells of the focal length."""
    print(f"\n{'rectangle':40s}  {'focal_std_%':>12s}  {'focal_rms_%':>12s}  {'inside':>12s}")
    summary = {}
    for kind in KINDS:
        with threadpool_limits(1):
            found = np.array([draw_rectangle(seed, kind) for seed in range(count)])
        std, rms = float(np.median(found[:, 1])), float(np.sqrt(np.mean(found[:, 0] ** 2)))
        inside = float(np.mean(np.abs(found[:, 0]) <= NORMAL_95 * found[:, 1]))
        print(f"{kind!s:40s}  {100 * std:12.2f}  {100 * rms:12.2f}  {inside:12.2f}", flush=True)
        summary[str(kind)] = {"std_relative": std, "rms_relative": rms, "inside_share": inside}
    return summary


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=10, help="sites for each set of readings")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--readings", nargs="+", default=READINGS)
    parser.add_argument("--true-deg", type=float, default=None, help="out of square in truth, where not as stated")
    parser.add_argument("--rectangles", type=int, default=0, help="sites with each kind of rectangle")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    heads = ("scale_inside", "scale_std", "scale_rms", "focal_inside", "focal_std", "axes_inside", "axes_std_deg", "ok")
    print(f"{'readings':14s} {'edges':5s}" + "".join(f"  {head:>12s}" for head in heads))
    summary: dict[str, object] = {"pairs": options.draws, "processors": os.cpu_count()}
    cpu_s = []
    for readings in options.readings:
        for lines in (False, True):
            found = []
            for seed in range(options.first, options.first + options.draws):
                with threadpool_limits(1):
                    found.append(draw(seed, readings, lines=lines, true_deg=options.true_deg))
                if options.verbose:
                    print(found[-1], flush=True)
            cpu_s += [d.cpu_s for d in found]
            row = _summarise(found)
            cells = "".join(f"  {value:12.3f}" for value in row)
            print(f"{readings:14s} {'yes' if lines else 'no':5s}{cells}", flush=True)
            name = f"{readings}, {'with' if lines else 'without'} edges"
            summary[name] = dict(zip(FIGURES, row, strict=True))
    summary["cpu_mean_s"] = float(np.mean(cpu_s))
    if options.rectangles:
        summary["rectangles"] = tabulate_rectangles(options.rectangles)
    print(json.dumps(summary))


def _summarise(found: Sequence[Draw]) -> tuple[float, ...]:
    scale, focal = np.array([d.scale for d in found]), np.array([d.focal for d in found])
    axes = np.array([d.axes for d in found])
    # Three angles: the largest of three standard normal draws.
    joint = 2.39
    return (
        float(np.mean(np.abs(scale[:, 0]) <= NORMAL_95 * scale[:, 1])),
        float(np.median(scale[:, 1])),
        float(np.sqrt(np.mean(scale[:, 0] ** 2))),
        float(np.mean(np.abs(focal[:, 0]) <= NORMAL_95 * focal[:, 1])),
        float(np.median(focal[:, 1])),
        float(np.mean(axes[:, 0] <= joint)) if np.isfinite(axes).all() else float("nan"),
        float(np.median(axes[:, 1])),
        float(np.mean([d.status == "ok" for d in found])),
    )


if __name__ == "__main__":
    main()
