"""Leave-one-calibrator-out test of the lens profiles: do intervals hold for a calibrator who is not in the table?

Every calibrator's focal length in every group (camera, mode, picture format, stabilisation) with three calibrators or
more is expected from the table of all others: with mode and state of stabilisation as they are known of it, without
either, and as if nobody had calibrated the model. What lenses of a kind differ by was found over the same values, so
``halves`` finds it over one half of the calibrators and tests the other. Needs the calibrations
(``../shared/data/lens_profiles``, or VFM_SDM_SHARED).
"""

import argparse
import json
import os
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tests")]

from lens_records import NORMAL_95, Held, Record, leave_out, read_records  # noqa: E402
from lens_scatter import fit_all, variants  # noqa: E402

import measurements as m  # noqa: E402
from simulation import SIZE  # noqa: E402
from vfm_sdm.geometry.camera import Camera, Rig  # noqa: E402
from vfm_sdm.inputs.profiles import expect_lens, find_camera, read_setting  # noqa: E402
from vfm_sdm.inputs.profiles.hierarchy import LensKey, chain_of  # noqa: E402
from vfm_sdm.inputs.profiles.lookup import expect_focal, scatter_of  # noqa: E402
from vfm_sdm.inputs.profiles.table import Scatter, read_scatter  # noqa: E402
from vfm_sdm.inputs.profiles.words import CameraClass  # noqa: E402
from vfm_sdm.inputs.session import Lens  # noqa: E402
from vfm_sdm.stages.cameras.profile_checks import Found, compare_with_mode, find_focals  # noqa: E402

Scatters = Mapping[str, Mapping[str, Scatter]]
MODES = {"mode": "mode known", "film": "focal length known", "any": "mode unknown"}


class Tally:
    """Errors of the logarithm of the focal length and half widths of the 95 % intervals."""

    def __init__(self) -> None:
        self.errors: list[float] = []
        self.halves: list[float] = []

    def add(self, held: Held, key: LensKey, scatters: Scatters) -> None:
        found = expect_focal(key, held.others, scatter_of(scatters, key.kind, chain_of(key)))
        self.errors.append(abs(held.log_focal - found.mean))
        self.halves.append(NORMAL_95 * found.std)

    @property
    def share(self) -> float:
        return float(np.mean(np.array(self.errors) <= np.array(self.halves)))

    @property
    def figures(self) -> dict[str, float]:
        return {
            "points": len(self.errors),
            "inside_share": self.share,
            "median_half_interval_share": float(np.expm1(np.median(self.halves))),
            "median_error_share": float(np.expm1(np.median(self.errors))),
        }


def ways(record: Record) -> list[tuple[str, LensKey]]:
    """What may be known of a lens, each with its name."""
    found = []
    for chain, keys in variants(record).items():
        for key in keys:
            state = "stabilisation known" if key.setting.stabilised is not None else "stabilisation unknown"
            found.append((f"{MODES[chain]}, {state}", key))
    unseen = replace(record.key, model="", setting=replace(record.key.setting, stabilised=None))
    return [*found, ("model unknown", unseen)]


def leave_each_out(records: Sequence[Record], kinds: Sequence[str], scatters: Scatters) -> dict[str, dict[str, Tally]]:
    """What holds, by kind of camera and by what is known."""
    tallies: dict[str, dict[str, Tally]] = {kind: defaultdict(Tally) for kind in kinds}
    for kind in kinds:
        for held in leave_out(records, only=kind):
            for name, key in ways(held.record):
                tallies[kind][name].add(held, key, scatters)
            best = ways(held.record)[-2][1]
            tallies[kind]["as known"].add(held, replace(best, setting=held.record.key.setting), scatters)
    return tallies


def leave_halves_out(records: Sequence[Record], kinds: Sequence[str], splits: int) -> dict[str, Tally]:
    """The same, as known, for each half of the calibrators with the scatter that the other half shows."""
    tallies: dict[str, Tally] = defaultdict(Tally)
    people = sorted({record.calibrator for record in records})
    for split in range(splits):
        chosen = np.random.default_rng(split).permutation(len(people))[: len(people) // 2]
        first = frozenset(people[place] for place in chosen)
        for fitted in (first, frozenset(people) - first):
            rows = fit_all(records, fitted)
            scatters = {kind: {name: Scatter(**one) for name, one in chains.items()} for kind, chains in rows.items()}
            for kind in kinds:
                for held in leave_out(records, only=kind):
                    if held.record.calibrator not in fitted:
                        tallies[kind].add(held, held.record.key, scatters)
    return tallies


STATED = (
    ("GoPro HERO7 Black", "Linear", False),
    ("GoPro HERO7 Black", "Wide", True),
    ("iPhone 13", "26mm", None),
    ("Sony a7IV", "35mm", None),
)
WRONG, OF_ITS_KIND = 0.10, 0.01
"""Relative error of a wrong mode, and by how much cameras of one model and mode differ truly."""
TOLD = 0.025
"""Relative standard deviation of a focal length from which on a site tells a wrong mode."""


@cache
def simulate(seed: int, wrong: float, check: str) -> tuple[bool, float]:
    with threadpool_limits(1):
        return simulate_site(seed, wrong, check)


def simulate_site(seed: int, wrong: float, check: str) -> tuple[bool, float]:
    """Whether a stated mode is flagged whose focal length is wrong by so much, and how well the site tells that.

    ``check`` is ``length``, one on the structure known to 2 mm, or ``pan clip``, a focal length known to 0.3 %.
    """
    rng = np.random.default_rng([seed, 4])
    camera, mode, state = STATED[seed % len(STATED)]
    asked = find_camera(camera)
    setting = replace(read_setting([mode], asked.kind), stabilised=state, aspect="16:9")
    key = replace(asked, setting=setting)
    profile = expect_lens(key)
    errors = -np.log1p(wrong * rng.choice([-1, 1])) + rng.normal(0, OF_ITS_KIND, 2)
    fixed = {
        "focal_px": float(np.exp(profile.log_focal.mean)) * SIZE[0],
        "focal_std": profile.log_focal.std,
        "focal_errors": tuple(errors.tolist()),
        "length_std": 0.002,
        "length_error": float(rng.normal(0, 0.002)),
        "duration_s": 0.5,
    }
    if check == "pan clip":
        true = profile.log_focal.mean - errors[0]
        return bool(compare_with_mode(key, Found(true + rng.normal(0, 0.003), 0.003))), 0.003
    made = m.simulate(seed, **fixed)
    prior = Rig(m.VIEWS, tuple(replace_focal(c, fixed["focal_px"]) for c in made.solution.rig.cameras), True, None)
    variances = np.zeros((20, 20))
    variances[[0, 10], [0, 10]] = fixed["focal_std"] ** 2
    stated = {"lens": Lens(camera=camera, mode=mode, stabilised=state)}
    session = made.session.model_copy(update={"view": [v.model_copy(update=stated) for v in made.session.view]})
    frames = {name: np.zeros(SIZE[::-1], np.uint8) for name in m.VIEWS}
    found = list(find_focals(session, frames, replace(prior, covariance=variances), made.solution.rig))
    flagged = any(compare_with_mode(named, focal) for _, named, focal in found)
    return flagged, min((focal.std for _, _, focal in found), default=1.0)


def replace_focal(camera: Camera, focal_px: float) -> Camera:
    return replace(camera, K=camera.K * np.array([[focal_px / camera.focal_px], [focal_px / camera.focal_px], [1.0]]))


def flag_wrong_modes(draws: int, first: int = 0) -> dict[str, dict[str, float]]:
    """Share of simulated sites at which a mode is flagged, wrong and right, by what checks it."""
    found: dict[str, dict[str, float]] = {}
    for check, limit in (("length", 1.0), ("length", TOLD), ("pan clip", 1.0)):
        shares = []
        for error in (WRONG, 0.0):
            results = [simulate(seed, error, check) for seed in range(first, first + draws)]
            shares.append([flagged for flagged, std in results if std <= limit])
        wrong, right = (float(np.mean(one)) if one else float("nan") for one in shares)
        name = f"checked by a {check}" + (f" to {limit:.1%}" if limit < 1 else "")
        found[name] = {"pairs": len(shares[0]), "wrong_flagged_share": wrong, "right_flagged_share": right}
        row = f"{len(shares[0]):6d}  flagged {wrong:.3f}, and where right {right:.3f}"
        print(f"{'wrong mode':14s}  {name:42s}  {row}", flush=True)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=[str(kind) for kind in CameraClass])
    parser.add_argument("--halves", type=int, default=0, help="splits of the calibrators into halves")
    parser.add_argument("--sites", type=int, default=0, help="simulated sites with wrong and right modes")
    options = parser.parse_args(arguments)
    shared = Path(os.environ.get("VFM_SDM_SHARED", ROOT.parent / "shared"))
    records = read_records(shared / "data" / "lens_profiles" / "lens_profiles.csv.gz")
    summary: dict[str, object] = {"pairs": len(records), "processors": os.cpu_count()}
    print(
        f"{'kind':14s}  {'what is known':42s}  {'values':>6s}  {'inside':>6s}  {'+- 95 %':>7s}  {'median error':>12s}"
    )
    for kind, tallies in leave_each_out(records, options.kinds, read_scatter()).items():
        summary[kind] = {name: tally.figures for name, tally in tallies.items()}
        for name, tally in sorted(tallies.items()):
            print(describe(kind, name, tally), flush=True)
    if options.halves:
        halves = leave_halves_out(records, options.kinds, options.halves)
        summary["halves"] = {kind: tally.figures for kind, tally in halves.items()}
        for kind, tally in halves.items():
            print(describe(kind, "as known, scatter of the other half", tally))
    if options.sites:
        summary["sites"] = flag_wrong_modes(options.sites)
    print(json.dumps(summary))


def describe(kind: str, name: str, tally: Tally) -> str:
    one = tally.figures
    return (
        f"{kind:14s}  {name:42s}  {one['points']:6d}  {one['inside_share']:6.3f}  "
        f"{one['median_half_interval_share']:7.3f}  {one['median_error_share']:12.3f}"
    )


if __name__ == "__main__":
    main()
