"""A small plan with everything in it, for tests of planning."""

from typing import Any

from vfm_sdm.studies.planning.plan import Plan

__all__ = ["a_plan", "fields"]


def fields(**changes: Any) -> dict[str, Any]:
    """Tables of a plan: a footbridge seen by two cameras of 20 degrees."""
    lens = {"focal_mm": 15.5, "sensor_width_mm": 6.17, "relative_std": 0.02}
    camera = {"height_m": 1.5, "image_size": (1920, 1080), "lens": lens, "bitrate_mbit_s": 40.0}
    return {
        "name": "footbridge",
        "duration_s": 4.0,
        "structure": {"span_m": 12.0, "bottom_m": 1.1, "top_m": 1.9, "noise_px": 0.01},
        "motion": {
            "lateral": {"amplitude_mm": 2.0, "frequency_hz": 1.4},
            "vertical": {"amplitude_mm": 5.0, "frequency_hz": 2.2},
        },
        "camera": [
            {"name": "left", "perpendicular_m": 7.0, "longitudinal_m": 2.0, **camera},
            {"name": "right", "perpendicular_m": 6.0, "longitudinal_m": -1.2, **camera},
        ],
        "point": [
            {"name": "quarter", "longitudinal_m": 5.0, "height_m": 1.5},
            {"name": "middle", "longitudinal_m": 6.0, "height_m": 1.6},
            {"name": "wall", "longitudinal_m": 5.5, "height_m": 0.9, "perpendicular_m": -0.3, "static": True},
        ],
        "measured": {"baseline_std_m": 0.005, "perpendicular_std_m": 0.01, "longitudinal_std_m": 0.02},
        **changes,
    }


def a_plan(**changes: Any) -> Plan:
    """The plan of these tables."""
    return Plan(**fields(**changes))
