"""The table of docs/field-guide.md: what each reading on site is worth, by predictions of one typical site.

Run as ``python tools/field_guide.py`` to print it, with ``--write`` to put it into the guide.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from vfm_sdm.studies.planning.plan import Plan
from vfm_sdm.studies.planning.prediction import Prediction, predict

GUIDE = Path(__file__).resolve().parents[1] / "docs" / "field-guide.md"
BEGIN, END = "<!-- table: python tools/field_guide.py --write -->", "<!-- end of table -->"

SITE: dict[str, Any] = {
    "name": "footbridge, 10 m away",
    "duration_s": 10.0,
    "structure": {"span_m": 20.0, "bottom_m": 2.0, "top_m": 3.0, "background_m": (2.0, 20.0)},
    "motion": {
        "lateral": {"amplitude_mm": 2.0, "frequency_hz": 1.4},
        "vertical": {"amplitude_mm": 5.0, "frequency_hz": 2.2},
    },
    "point": [
        {"name": "middle", "longitudinal_m": 10.0, "height_m": 2.6},
        {"name": "quarter", "longitudinal_m": 8.0, "height_m": 2.4},
        {"name": "bearing", "longitudinal_m": 9.0, "height_m": 1.8, "perpendicular_m": -0.3, "static": True},
    ],
}
LENS, DISTANCES = 0.05, {"perpendicular_std_m": 0.02, "longitudinal_std_m": 0.05, "level_std_deg": 0.3}
LENGTH = {"points": ("middle", "quarter"), "std_m": 0.005}
BARE: dict[str, Any] = {"baseline_std_m": 0.01, "perpendicular_std_m": 0.02, "longitudinal_std_m": 0.05}


def make_plan(measured: dict[str, Any], **changes: float) -> Plan:
    """The site with these readings; ``lens_std``, ``view`` (factor of the focal length), ``apart`` [m] and ``rate``."""
    apart, focal = changes.get("apart", 4.0), 25.0 * changes.get("longer", 1.0)
    camera = {
        "perpendicular_m": 10.0,
        "height_m": 1.5,
        "bitrate_mbit_s": changes.get("rate", 100.0),
        "lens": {
            "focal_mm": focal,
            "sensor_width_mm": 13.2,
            "relative_std": changes.get("lens_std", LENS),
        },
    }
    cameras = [
        {"name": name, "longitudinal_m": 6.0 - side * apart / 2, **camera}
        for name, side in (("left", -1), ("right", 1))
    ]
    return Plan(**SITE, camera=cameras, measured={**BARE, "level_std_deg": 1.0, **measured})


def list_cases() -> list[tuple[str, Plan]]:
    """What is measured, in words, and the plan with it."""
    range_ = {"point": "middle", "std_m": 0.005}
    further = {"view": "right", "level_std_deg": 0.2, "perpendicular_std_m": 0.02, "longitudinal_std_m": 0.05}
    return [
        ("baseline to 10 mm, focal length to 5 % (EXIF), distances to 2 and 5 cm, cameras level by eye", make_plan({})),
        ("the same with a focal length to 20 % (unknown phone)", make_plan({}, lens_std=0.2)),
        ("+ level read to 0.2 degrees", make_plan({"level_std_deg": 0.2})),
        ("+ baseline to 3 mm", make_plan({"baseline_std_m": 0.003})),
        ("+ range from the first camera to a point, to 5 mm", make_plan({"range": [range_]})),
        ("+ distances and level of the second camera", make_plan({"reading": [further]})),
        ("+ length of 2 m on the structure, to 5 mm", make_plan({"length": [LENGTH]})),
        ("+ pan clip (focal length to 0.22 %)", make_plan({"pan_clip_std": 0.0022})),
        ("+ pan clip and level", make_plan({"pan_clip_std": 0.0022, "level_std_deg": 0.2})),
        (
            "+ pan clip, level and baseline to 3 mm",
            make_plan({"pan_clip_std": 0.0022, "level_std_deg": 0.2, "baseline_std_m": 0.003}),
        ),
        ("first line with cameras 8 m apart instead of 4 m", make_plan({}, apart=8.0)),
        ("first line with lenses 1.4 times as long", make_plan({}, longer=1.4)),
        ("first line at 25 instead of 100 Mbit/s", make_plan({}, rate=25.0)),
    ]


def describe(prediction: Prediction) -> tuple[str, str, str, str]:
    """Scale (k = 2) and expanded uncertainty along both axes, of the worse point."""
    worst = {
        axis: (
            max(2 * one.scale_std for one in prediction.axes if one.axis == axis),
            max(one.expanded_mm for one in prediction.axes if one.axis == axis),
        )
        for axis in ("vertical", "lateral")
    }
    scales = [f"{100 * worst[axis][0]:.1f} %" for axis in ("vertical", "lateral")]
    return (*scales, *(f"{worst[axis][1]:.2f}" for axis in ("vertical", "lateral")))  # type: ignore[return-value]


def make_table() -> str:
    """The table in Markdown."""
    lines = [
        "| measured | scale, vertical | scale, lateral | vertical [mm] | lateral [mm] |",
        "|---|---|---|---|---|",
    ]
    lines += [f"| {words} | {' | '.join(describe(predict(plan)))} |" for words, plan in list_cases()]
    return "\n".join(lines)


def main() -> None:
    """Prints the table, or puts it into the guide."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put the table into docs/field-guide.md")
    options = parser.parse_args()
    table = make_table()
    if not options.write:
        sys.stdout.write(f"{table}\n")
        return
    text = GUIDE.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    GUIDE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
