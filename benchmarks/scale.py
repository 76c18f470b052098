"""Calibration of the scale by simulation: intervals, contradictions and their culprits over many drawn sites.

Sites, lenses, readings and matches are drawn with the standard deviations that the session states for them
(`tests/measurements.py`), with fields of view of 14 to 90 degrees. The prior of the lenses is one of: none; true at 20,
5 or 2 %; that of simulated pan clips, one for each lens, with neither range nor length on site; stated as 2 % and wrong
by 10 to 50 % in both views, as with a wrong sensor width, or in one. Where it is true the share of scales inside their
95 % interval is the coverage; where it is false every scale has to be inside its interval or flagged, and the culprit
named. ``--rendered`` takes rendered pictures of presets in place of simulated matches.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from pairs import Base, make_rendered  # noqa: E402

import measurements as m  # noqa: E402
from simulation import SIZE, gain_error, project_all  # noqa: E402
from turning import draw_lever, draw_plan, look, true_values  # noqa: E402
from vfm_sdm.core.registry import make  # noqa: E402
from vfm_sdm.core.statuses import CameraStatus  # noqa: E402
from vfm_sdm.geometry.camera import Rig  # noqa: E402
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std  # noqa: E402
from vfm_sdm.geometry.triangulation import triangulate  # noqa: E402
from vfm_sdm.inputs.profiles import expect_any  # noqa: E402
from vfm_sdm.inputs.session import Lens, Method  # noqa: E402
from vfm_sdm.stages.audit.lenses import find_unseen_lens_error  # noqa: E402
from vfm_sdm.stages.cameras.site_cameras import ALL_FOCALS  # noqa: E402
from vfm_sdm.stages.cameras.solution import CameraSolution  # noqa: E402
from vfm_sdm.stages.cameras.solve import solve_cameras  # noqa: E402
from vfm_sdm.stages.cameras.two_view import TwoViewCameras  # noqa: E402
from vfm_sdm.stages.lens.adjustment import adjust_clip  # noqa: E402
from vfm_sdm.stages.lens.clip import judge_lens, merge_radial  # noqa: E402

PRIORS = ("none", "20 %", "5 %", "2 %", "pan clip", "both wrong", "one wrong")
PAN_CLIP = "pan clip"
FALSE = ("both wrong", "one wrong")
RENDERED = tuple((name, None) for name in ("data-1", "data-4", "surface-1", "surface-2", "demo"))
RENDERED += tuple((name, 30.0) for name in ("data-4", "surface-2", "demo"))
"""Presets of which pictures are rendered, and the angle at which the second camera stands where it is another [deg]."""
RENDERED_WIDTH = 1280
LEVER_M, DISTANT_M, READOUT_S, NOISE_PX = 0.05, (300.0, 3000.0), 0.02, 0.5
"""Of pan clips; noise is that of a feature in pictures 3840 px wide."""
ANY_LENS = expect_any()
"""What is taken of a lens of which nothing is known."""
NORMAL_95, LIMIT, CAUTION = 1.96, 0.05, 4.0


@dataclass(frozen=True)
class Draw:
    """One site: error of the vertical scale, its stated standard deviation, and what was said of it.

    Without cameras the error is NaN: it is flagged by its status, and left out where intervals are counted.
    """

    seed: int
    prior: str
    view_deg: float
    wrong: float
    wrong_view: str
    error: float = np.nan
    std: float = np.nan
    status: str = ""
    contradiction: float = 0.0
    worst: str = ""
    culprits: tuple[str, ...] = ()
    unchecked: float = 0.0
    cpu_s: float = 0.0

    @property
    def inside(self) -> bool:
        return abs(self.error) <= NORMAL_95 * self.std

    @property
    def named_right(self) -> bool:
        """Whether the first culprit is what is wrong."""
        return self.culprits[:1] == (self.truly_wrong,)

    @property
    def among_named(self) -> bool:
        """Whether what is wrong is among the culprits that are named."""
        return self.truly_wrong in self.culprits

    @property
    def truly_wrong(self) -> str:
        return ALL_FOCALS if self.prior == "both wrong" else f"focal {self.wrong_view}"

    @property
    def flagged(self) -> bool:
        """Whether anything keeps the result from being fit to use."""
        said = self.status != CameraStatus.OK or self.contradiction > CAUTION
        return said or 2 * self.std > LIMIT or self.unchecked > LIMIT


@dataclass(frozen=True)
class Stated:
    """What is noted of both lenses: one focal length [px], its relative standard deviation, and how wrong it is."""

    focal_px: float
    std: float
    errors: np.ndarray
    wrong: float = 0.0
    wrong_view: str = ""


def draw_lens(rng: np.random.Generator, prior: str, true_px: float) -> Stated:
    """What is noted of lenses of this focal length [px]; ``errors`` are the logarithms of noted over true ones."""
    if prior == "none":
        focal = float(np.exp(ANY_LENS.mean)) * max(SIZE)
        return Stated(focal, ANY_LENS.std, np.log(focal / true_px) + rng.normal(0, 0.01, 2) * [0, 1])
    if prior == PAN_CLIP:
        return Stated(true_px, 0.0, np.zeros(2))
    std = 0.02 if prior in FALSE else float(prior.split(maxsplit=1)[0]) / 100
    errors = rng.normal(0, std, 2)
    if prior not in FALSE:
        return Stated(true_px, std, errors)
    wrong = float(rng.choice([-1, 1]) * rng.uniform(np.log(1.1), np.log(1.5)))
    # All that is noted of a lens is one focal length for both, and `Conditions` states errors of the noted one.
    chosen = np.ones(2) if prior == "both wrong" else np.eye(2)[rng.integers(2)]
    focal = true_px * np.exp(wrong) if prior == "both wrong" else true_px
    return Stated(float(focal), std, errors + wrong * chosen, wrong, m.VIEWS[int(chosen.argmax())])


def draw(seed: int, prior: str) -> Draw:
    """A simulated site of this seed with this prior of its lenses."""
    rng, noise, lens = (np.random.default_rng([seed, stream]) for stream in range(3))
    view_deg = lens.uniform(14, 90)
    stated = draw_lens(lens, prior, SIZE[0] / 2 / np.tan(np.radians(view_deg) / 2))
    drawn = m.draw_conditions(rng)
    corner_std = float(lens.choice([0.0, 0.025]))
    c = replace(
        drawn, focal_px=stated.focal_px, focal_std=stated.std, focal_errors=tuple(float(e) for e in stated.errors),
        distortion_std=corner_std, distortion_errors=tuple(lens.normal(0, corner_std, 2) if corner_std else (0.0, 0.0)),
        duration_s=0.5,
    )  # fmt: skip
    if prior == PAN_CLIP:
        c = with_pan_clips(replace(c, range_std=None, length_std=None), seed, view_deg)
    start = time.process_time()
    rig, frame, pitch = m._true_rig(c, noise)
    points3d = m._place_points(rig, frame, c, noise)
    clicked = project_all(rig, points3d) + noise.normal(0, 0.5, (2, len(points3d), 2))
    session = m._session(c, rig, points3d, clicked, pitch, "none")
    solution = m._solve(c, session, rig, clicked, noise)
    cpu_s = time.process_time() - start
    return judge(Draw(seed, prior, view_deg, stated.wrong, stated.wrong_view), solution, rig, points3d[0], cpu_s)


def with_pan_clips(c: m.Conditions, seed: int, view_deg: float) -> m.Conditions:
    """The conditions with errors and covariances of lenses from a simulated pan clip each, at a distant scene."""
    errors, covariances = [], []
    for view in range(2):
        lever = draw_lever(seed + 1000 * view, LEVER_M)
        plan = draw_plan(
            seed + 1000 * view, view_deg, size=SIZE, distance_m=DISTANT_M, lever_m=lever, readout_s=READOUT_S
        )
        adjusted = adjust_clip(*look(plan, noise_px=NOISE_PX))
        estimate = judge_lens(adjusted, (np.arange(40) + 0.5) * plan.duration_s / 40)
        off = adjusted.lens[:5] - true_values(plan)
        # The one coefficient of a lens file stands for both.
        radial = np.diag(merge_radial(np.diag([0.0, 0, 0, 0, 1.0]), plan.camera))[3] ** 0.5
        errors.append([*off[:3], off[3] + radial * off[4]])
        covariances.append(estimate.covariance)
    log_focal, cu, cv, k1 = np.array(errors).T
    corner = np.hypot(*SIZE) / 2 / c.focal_px
    return replace(
        c, focal_errors=tuple(log_focal.tolist()), focal_std=float(np.sqrt(covariances[0][0, 0])),
        centre_errors_px=(float(cu[0]), float(cv[0]), float(cu[1]), float(cv[1])),
        distortion_errors=tuple((k1 * corner**2).tolist()), lens_covariances=tuple(covariances),
    )  # fmt: skip


def draw_rendered(seed: int, prior: str) -> Draw:
    """The same of the first pictures of a rendered site: its cameras, readings and places are those of its preset."""
    lens = np.random.default_rng([seed, 2])
    name, degrees = RENDERED[seed % len(RENDERED)]
    base = rendered(name, degrees)
    readings = sorted(base.sessions)[lens.integers(len(base.sessions))]
    cameras = base.rig.cameras
    stated = draw_lens(lens, prior, cameras[0].focal_px)
    noted = [camera.focal_px * np.exp(error) for camera, error in zip(cameras, stated.errors, strict=True)]
    lenses = [None if prior == "none" else Lens(focal_px=float(px), relative_std=stated.std) for px in noted]
    session = base.sessions[readings]
    views = [v.model_copy(update={"lens": one}) for v, one in zip(session.view, lenses, strict=True)]
    start = time.process_time()
    solution = solve_cameras(session.model_copy(update={"view": tuple(views)}), base.frames, matching())
    cpu_s = time.process_time() - start
    view_deg = 2 * np.degrees(np.arctan(cameras[0].image_size[0] / 2 / cameras[0].focal_px))
    wrong_view = session.view[m.VIEWS.index(stated.wrong_view)].name if stated.wrong_view else ""
    found = Draw(seed, prior, float(view_deg), stated.wrong, wrong_view)
    if solution.rig is None:
        return replace(found, status=str(solution.status), cpu_s=cpu_s)
    middle = np.array([[(c.image_size[0] - 1) / 2, (c.image_size[1] - 1) / 2] for c in cameras])
    return judge(found, solution, base.rig, triangulate(middle, base.rig), cpu_s)


@lru_cache(maxsize=len(RENDERED))
def rendered(name: str, degrees: float | None) -> Base:
    return make_rendered(name, degrees, RENDERED_WIDTH)


@lru_cache(maxsize=1)
def matching() -> TwoViewCameras:
    return make("cameras", Method())


def judge(one: Draw, solution: CameraSolution, truth: Rig, place: np.ndarray, cpu_s: float) -> Draw:
    """The draw with what was found of the vertical scale at a place of the scene, shape (3,) [m]."""
    sensitivity = compute_gain_sensitivity(project_all(truth, place[None]), solution.rig)
    stated = np.diag(compute_gain_std(sensitivity, np.eye(3), solution.covariance)[0])
    off = max(solution.quantities, key=lambda q: q.contradiction)
    return replace(
        one,
        error=float(gain_error(truth, solution.rig, place)[1]),
        std=float(stated[1]),
        status=str(solution.status),
        contradiction=off.contradiction,
        worst=off.name,
        culprits=tuple(suspect.name for suspect in solution.suspects),
        unchecked=float(unchecked(solution, sensitivity)),
        cpu_s=cpu_s,
    )


def unchecked(solution: CameraSolution, sensitivity: np.ndarray) -> float:
    """Error of the vertical scale that a wrong lens could cause unseen [1]."""
    return find_unseen_lens_error(solution, np.pad(sensitivity[0, :, 1, 1], (0, 3)))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=10, help="sites for each prior")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--priors", nargs="+", default=PRIORS)
    parser.add_argument("--rendered", action="store_true", help="rendered pictures in place of simulated matches")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args(arguments)
    names = ("inside", "inside_or_flagged", "flagged", "care_though_inside", "culprit_right", "among_named", "named")
    widths = [max(len(name), 7) for name in names]
    heads = "".join(f"  {name:>{width}s}" for name, width in zip(names, widths, strict=True))
    print(f"{'prior of the lenses':20s}  {'draws':>5s}  {'scale rms':>9s}{heads}")
    summary: dict[str, object] = {"pairs": options.draws, "processors": os.cpu_count()}
    cpu_s = []
    for prior in options.priors:
        found = []
        for seed in range(options.first, options.first + options.draws):
            with threadpool_limits(1):
                found.append((draw_rendered if options.rendered else draw)(seed, prior))
            if options.verbose:
                print(describe(found[-1]), flush=True)
        shares = (
            np.mean([d.inside for d in found if np.isfinite(d.error)] or [0.0]),
            np.mean([d.inside or d.flagged for d in found]),
            np.mean([d.flagged for d in found]),
            np.mean([d.flagged and 2 * d.std <= LIMIT for d in found]),
            np.mean([d.named_right for d in found if d.culprits] or [0.0]),
            np.mean([d.among_named for d in found if d.culprits] or [0.0]),
            np.mean([bool(d.culprits) for d in found]),
        )
        spread = float(np.sqrt(np.mean([d.error**2 for d in found if np.isfinite(d.error)] or [np.nan])))
        cpu_s += [d.cpu_s for d in found]
        row = "".join(f"  {share:{width}.3f}" for share, width in zip(shares, widths, strict=True))
        print(f"{prior:20s}  {len(found):5d}  {spread:9.2%}{row}", flush=True)
        summary[prior] = {f"{name}_share": float(share) for name, share in zip(names, shares, strict=True)}
    summary["cpu_mean_s"] = float(np.mean(cpu_s))
    print(json.dumps(summary))


def describe(d: Draw) -> str:
    return (
        f"{d.seed:4d} {d.prior:10s} view {d.view_deg:3.0f} wrong {d.wrong:+.2f} {d.wrong_view:5s} "
        f"error {d.error:+.3f} std {d.std:.3f} "
        f"{'in ' if d.inside else 'OUT'} {'flag' if d.flagged else '    '} {d.status[:22]:22s} "
        f"w {d.contradiction:5.1f} {d.worst:26s} culprit {' / '.join(d.culprits)} unchecked {d.unchecked:.3f}"
    )


if __name__ == "__main__":
    main()
