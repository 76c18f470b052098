"""Fusion of video and accelerometer: error, coverage of the intervals, and the scale that a sensor gives.

Records are simulated: 30 frames a second of five modes from 1.7 to 38 Hz and a passage, seen as means over the
exposure, with noise from frame to frame and slow errors; a sensor of 200 Hz with noise, gain, misalignment, lag and
drift of its clock; a second of the video is missing. The sensitivity of the sensor is drawn to 1 %, as the scale is
stated. Coverage is the share of samples inside their 95 % intervals. With ``--film`` a footbridge is rendered, filmed,
measured and fused as well, with modes up to 38.5 Hz; with ``--hour`` an hour is fused.

``best`` is the ratio that no procedure betters which knows nothing of the motion beforehand, though it knew all noise
levels, clocks and gains (`least_error_mm`). Ranges are those in which the mean over all records lies with 95 %.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from intervals import range_of_mean_share, range_of_share  # noqa: E402
from vfm_sdm.analysis.fusion import FusionSettings, fuse, read_session_acceleration  # noqa: E402
from vfm_sdm.core.arrays import FloatArray  # noqa: E402
from vfm_sdm.core.statuses import FusionStatus  # noqa: E402
from vfm_sdm.inputs.session import read_session  # noqa: E402
from vfm_sdm.measurement import Measurement  # noqa: E402
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test  # noqa: E402
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite  # noqa: E402
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode  # noqa: E402
from vfm_sdm.studies.synthetic.plan import MountedAccelerometer  # noqa: E402
from vfm_sdm.studies.synthetic.sensed_point import STATIC, SensedPoint, record_point  # noqa: E402
from vfm_sdm.studies.synthetic.sensors import Accelerometer  # noqa: E402

CASES = {
    "good sensor": SensedPoint(),
    "no slow errors": SensedPoint(slow_share=0.0),
    "large slow errors": SensedPoint(slow_share=0.8),
    "phone": SensedPoint(sensor_noise=2e-3),
}
"""The phone has 200 micro-g in a band of 1 Hz, the good sensor 30."""
NORMAL_95, SCALE_STD = 1.96, 0.01
AXIS, POINT = "vertical", "1/2 span"
FILM_MODES = (
    Mode("vertical", 2.2, 2.5, damping_ratio=0.012),
    Mode("vertical", 6.1, 0.8, damping_ratio=0.015, half_waves=3),
    Mode("vertical", 17.3, 0.25, damping_ratio=0.01, half_waves=3),
    Mode("vertical", 38.5, 0.1, damping_ratio=0.004, half_waves=3),
    Mode("lateral", 1.4, 1.8, damping_ratio=0.01),
)


def errors_of(fused: xr.Dataset, truth: xr.Dataset) -> FloatArray:
    """Errors at the sensor's samples, which the truth has at their true times [mm]."""
    time_s, true_s = fused["time"].values, truth["time"].values
    first = int(np.argmin(np.abs(true_s - time_s[0])))
    part = slice(first, first + len(time_s))
    exact = truth["displacement"].sel(axis=AXIS).values
    slope = np.gradient(exact, true_s)
    expected = exact[part] + slope[part] * (time_s - true_s[part])
    return np.asarray(fused["displacement"].sel(axis=AXIS).values - expected)


def least_error_mm(what: SensedPoint) -> float:
    """Error of the best linear estimate of any motion from both records [mm].

    At a frequency f the sensor knows displacement with a power of error of ``noise / (2 pi f)**4``, the video with that
    of its own errors. Weighted by their inverses (Wiener's filter with nothing known of the signal) they leave ``1 / (1
    / video + 1 / sensor)``, to be summed up over all frequencies; beyond half the frame rate the sensor is alone.
    """
    line = np.linspace(1e-4, what.fps / 2, 200_001)
    keep = np.exp(-1 / (what.slow_s * what.fps))
    lasting = (1 - keep**2) / (1 + keep**2 - 2 * keep * np.cos(2 * np.pi * line / what.fps))
    video = what.video_std_mm**2 / what.fps * (1 + what.slow_share**2 * lasting)
    sensor = (1e3 * what.sensor_noise) ** 2 / (2 * np.pi * line) ** 4
    beyond = (1e3 * what.sensor_noise) ** 2 / (2 * np.pi) ** 4 / (3 * line[-1] ** 3)
    return float(np.sqrt(2 * np.trapezoid(video * sensor / (video + sensor), line) + 2 * beyond))


def judge_record(what: SensedPoint, seed: int) -> dict[str, float] | None:
    """Figures of one record; ``None`` where the lag is not told."""
    gain = 1 + SCALE_STD * float(np.random.default_rng((seed, 3)).standard_normal())
    gap_s = (0.4 * what.duration_s, 0.4 * what.duration_s + 1)
    displacement, acceleration, truth = record_point(replace(what, gap_s=gap_s, gain=gain), seed)
    settings = FusionSettings(gain_std=3.0)
    fused = fuse(displacement, acceleration, "mid", axes=[AXIS], static=STATIC, settings=settings)
    if fused.attrs["status"] != FusionStatus.OK:
        return None
    one = fused.sel(axis=AXIS)
    error, bridged = errors_of(fused, truth), one["status"].values == 1
    inside = np.abs(error) < NORMAL_95 * one["displacement_std"].values
    series = displacement["displacement"].sel(point="mid", axis=AXIS).values
    exact = np.interp(displacement["time"].values, truth["time"].values, truth["displacement"].sel(axis=AXIS).values)
    found, std = float(one["gain"]), float(one["gain_std"])
    return {
        "fused_mm": float(np.sqrt(np.mean(error[~bridged] ** 2))),
        "video_mm": float(np.sqrt(np.nanmean((series - exact) ** 2))),
        "inside": float(inside.mean()),
        "inside_gaps": float(inside[bridged].mean()),
        "scale_error": 1 / found - 1,
        "scale_std": float(np.hypot(std / found, SCALE_STD)),
        "lag_std_ms": 1e3 * float(one["lag_std"]),
    }


def judge_case(name: str, what: SensedPoint, count: int) -> dict[str, float]:
    """Figures of many records, printed as a row."""
    found = [one for seed in range(count) if (one := judge_record(what, seed)) is not None]
    table = {key: np.array([one[key] for one in found]) for key in found[0]}
    fused, video = (float(np.sqrt(np.mean(table[key] ** 2))) for key in ("fused_mm", "video_mm"))
    deviation = table["scale_error"] / table["scale_std"]
    best = least_error_mm(what) / (what.video_std_mm * np.hypot(1, what.slow_share))
    low, high = range_of_mean_share(table["inside"])
    held = int(np.sum(np.abs(deviation) < NORMAL_95))
    scale_low, scale_high = range_of_share(held, len(found))
    result = {
        "fused_error_mm": fused,
        "video_error_mm": video,
        "error_ratio": fused / video,
        "best_ratio": float(best),
        "inside_share": float(table["inside"].mean()),
        "inside_low_share": low,
        "inside_high_share": high,
        "inside_gaps_share": float(table["inside_gaps"].mean()),
        "scale_error_rms_relative": float(np.sqrt(np.mean(table["scale_error"] ** 2))),
        "scale_std_relative": float(table["scale_std"].mean()),
        "scale_inside_share": held / len(found),
        "scale_inside_low_share": scale_low,
        "scale_inside_high_share": scale_high,
        "lag_std_ms": float(table["lag_std_ms"].mean()),
        "no_lag_share": 1 - len(found) / count,
    }
    print(
        f"{name:<18}  {fused:8.4f}  {video:8.4f}  {fused / video:5.2f}  {best:5.2f}  "
        f"{100 * result['inside_share']:5.1f} ({100 * low:.1f} to {100 * high:.1f})  "
        f"{100 * result['inside_gaps_share']:6.1f}  {100 * result['scale_error_rms_relative']:7.2f}  "
        f"{100 * result['scale_std_relative']:7.2f}  {held} of {len(found)} ({100 * scale_low:.0f} to "
        f"{100 * scale_high:.0f} %)",
        flush=True,
    )
    return result


def judge_hour() -> dict[str, float]:
    """Time that an hour takes."""
    displacement, acceleration, _ = record_point(SensedPoint(duration_s=3600.0), 1)
    begin = time.process_time()
    fuse(displacement, acceleration, "mid", axes=[AXIS], static=STATIC)
    taken = time.process_time() - begin
    print(f"an hour of both, one axis: {taken:.0f} s of one processor")
    return {"hour_processor_s": taken}


def judge_film(duration_s: float) -> dict[str, float]:
    """A rendered film: errors beside the truth once both are scaled to it, and the scale without a baseline."""
    site = FootbridgeSite(image_size=(640, 360))
    plan = demo_plan(duration_s=duration_s, site=site)
    phone = Accelerometer(
        "phone", rate_hz=200.0, noise_g_per_sqrt_hz=50e-6, bias_g=(2e-3, -3e-3, 1e-3),
        misalignment_deg=(1.0, -1.0, 0.5), clock_offset_s=-1.237, clock_rate=1.00003,
    )  # fmt: skip
    motion = ModalMotion(FILM_MODES, support_m=site.support_m, span_m=site.span_m)
    recordings = tuple(replace(one, exposure_s=1 / 90) for one in plan.recordings)
    accelerometers = (MountedAccelerometer(phone, POINT),)
    plan = replace(plan, motion=motion, accelerometers=accelerometers, recordings=recordings)
    with tempfile.TemporaryDirectory() as folder:
        session = read_session(make_field_test(Path(folder, "film"), plan))
        [sensor] = session.sensor
        sensor = sensor.model_copy(update={"use_as_scale": True, "scale_std": SCALE_STD})
        bare = session.site.model_copy(update={"baseline": None})
        session = session.model_copy(update={"sensor": (sensor,), "site": bare})
        displacement = Measurement(session).displacement
        if displacement is None:
            raise SystemExit("the film gave no displacement")
        acceleration, point = read_session_acceleration(session, "phone")
    static = [one.name for one in session.point if one.static]
    fused = fuse(displacement, acceleration, point, axes=[AXIS], static=static)
    place = [one.position for one in plan.points if one.name == point]
    begin_s = float(plan.frame_times(0)[0])
    video = displacement.sel(point=point, axis=AXIS)

    def compare(time_s: FloatArray, values: FloatArray) -> tuple[float, float]:
        exact = 1e3 * motion.displacement(time_s + begin_s, place)[:, 0, 1]
        known = np.isfinite(values)
        slope, shift = np.polyfit(exact[known], values[known], 1)
        return float(slope), float(np.sqrt(np.mean((values - slope * exact - shift)[known] ** 2)))

    gain, of_video = compare(video["time"].values, video["displacement"].values)
    _, of_fused = compare(fused["time"].values, fused["displacement"].sel(axis=AXIS).values)
    scale_std = float(video["scale_std"])
    print(
        f"film of {duration_s:g} s, no baseline: fused {of_fused:.4f} mm, video {of_video:.4f} mm, scale off by "
        f"{100 * (gain - 1):+.2f} %, known to {100 * scale_std:.2f} %"
    )
    return {
        "film_fused_error_mm": of_fused,
        "film_video_error_mm": of_video,
        "film_error_ratio": of_fused / of_video,
        "film_scale_error_relative": gain - 1,
        "film_scale_std_relative": scale_std,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a row a case, and all figures as a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=50, help="simulated records of each case")
    parser.add_argument("--duration", type=float, default=60.0, help="their length in seconds")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--film", type=float, default=0.0, help="seconds of a rendered film; none if 0")
    parser.add_argument("--hour", action="store_true", help="fuse an hour, too")
    chosen = parser.parse_args(arguments)
    heads = f"{'fused mm':>8}  {'video mm':>8}  {'ratio':>5}  {'best':>5}  {'95 %':>5} {'(true share)':>14}"
    print(f"{'case':<18}  {heads}  {'gaps':>6}  {'scale %':>7}  {'stated':>7}  95 % (true share)")
    result: dict[str, object] = {"records": chosen.records, "duration_s": chosen.duration}
    with threadpool_limits(1):
        for name in chosen.cases:
            what = replace(CASES[name], duration_s=chosen.duration)
            result[name.replace(" ", "_")] = judge_case(name, what, chosen.records)
        result |= judge_film(chosen.film) if chosen.film else {}
        result |= judge_hour() if chosen.hour else {}
    result["processors"] = os.cpu_count() or 1
    print(json.dumps(result))


if __name__ == "__main__":
    main()
