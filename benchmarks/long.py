"""Hours of film: memory and time of `measure` beside merely decoding, what segments and workers cost, and errors.

A rendered piece of a stereo pair (1920 x 1080 px, 30 frames a second, H.264) is looped by copying its packets: the
motion begins and ends at rest, so that the truth is exact over the joints. Decoding and measuring alternate, in
processes of their own, and with ``--workers`` so many processes share each of both. ``--scaling`` tracks the same films
in one piece, in segments, by one and two processes and by a Dask cluster of two, whose results must be the same bytes.
``--day`` measures hours of simulated tracks of ten points, with traffic and quiet times, a settling tripod and a
drifting clock, through everything behind tracking.
"""

import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from fractions import Fraction
from multiprocessing import get_context
from pathlib import Path

import av
import numpy as np
import xarray as xr

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from measurements import Simulated, simulate  # noqa: E402
from vfm_sdm.core.arrays import time_blocks  # noqa: E402
from vfm_sdm.core.block_files import BlockFile, time_variables  # noqa: E402
from vfm_sdm.core.datasets import make_tracks  # noqa: E402
from vfm_sdm.core.netcdf import read_displacement  # noqa: E402
from vfm_sdm.core.statuses import Verdict  # noqa: E402
from vfm_sdm.inputs.session import read_session, write_session  # noqa: E402
from vfm_sdm.measurement import Measurement  # noqa: E402
from vfm_sdm.outputs.plots import describe_run, save_figures  # noqa: E402
from vfm_sdm.outputs.results import describe_measurement, write_displacement  # noqa: E402
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test  # noqa: E402
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite  # noqa: E402
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode  # noqa: E402

DAY_FPS = 30.0
PIECE_S = 4.4
"""Length of the piece: 0.4 s at rest, and a whole number of periods of every mode [s]."""
MODES = (
    Mode("vertical", 2.25, 4.5, damping_ratio=0.0),
    Mode("vertical", 6.0, 0.5, damping_ratio=0.0, half_waves=2),
    Mode("lateral", 1.5, 1.8, damping_ratio=0.0),
)
POINTS = ("1/4 span", "3/8 span", "1/2 span", "abutment")
COLUMNS = (9, 7, 10, 11, 6, 9, 14)
WIDTHS = {1080: 1920, 720: 1280, 360: 640}


def make_piece(folder: Path, height: int) -> Path:
    """Session of one piece of film."""
    site = FootbridgeSite(image_size=(WIDTHS[height], height))
    plan = demo_plan(duration_s=PIECE_S, site=site)
    plan = replace(
        plan,
        motion=ModalMotion(MODES, support_m=site.support_m, span_m=site.span_m),
        points=tuple(point for point in plan.points if point.name in POINTS),
        recordings=tuple(replace(one, crf=18) for one in plan.recordings),
        encoder={"preset": "veryfast", "tune": "fastdecode", "threads": "2", "g": str(plan.frames)},
    )
    return make_field_test(folder, plan)


def loop(session: Path, folder: Path, pieces: int) -> Path:
    """The session with films that show the piece so many times."""
    folder.mkdir(parents=True)
    settings = read_session(session)
    for view in settings.view:
        _loop_film(session.with_name(f"{view.name}.mp4"), folder / f"{view.name}.mp4", pieces)
    # Cameras as they are: what is asked here is what length does to tracks.
    known = session.with_name("cameras_true.toml")
    views = tuple(
        view.model_copy(update={"video": folder / f"{view.name}.mp4", "camera": known, "lens": None})
        for view in settings.view
    )
    method = settings.method.model_copy(update={"injection": False, "cameras": "file"})
    return write_session(folder / "session.toml", settings.model_copy(update={"view": views, "method": method}))


def _loop_film(source: Path, target: Path, pieces: int) -> None:
    with av.open(str(source)) as container:
        stream = container.streams.video[0]
        base, frames = stream.time_base, stream.frames
        packets = [
            (bytes(packet), packet.pts, packet.dts, packet.is_keyframe, packet.duration)
            for packet in container.demux(stream)
            if packet.size
        ]
        with av.open(str(target), "w") as written:
            copy = written.add_stream_from_template(stream)
            step = round(Fraction(frames, 30) / base)
            for number in range(pieces):
                for data, pts, dts, is_key, duration in packets:
                    packet = av.Packet(data)
                    packet.pts, packet.dts, packet.duration = pts + number * step, dts + number * step, duration
                    packet.time_base, packet.is_keyframe, packet.stream = base, is_key, copy
                    written.mux(packet)


def run(code: str, *arguments: str) -> tuple[float, float]:
    """Seconds and peak memory [MB] of a process."""
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    if status:
        raise SystemExit(f"a process ended with {status}")
    return seconds, usage.ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


DECODE = """
import sys
from vfm_sdm.inputs.video import open_video
for path in sys.argv[2:]:
    film = open_video(path)
    for frame in (film.on_one_thread() if int(sys.argv[1]) else film).frames():
        pass
"""


def decode(films: Sequence[str], workers: int) -> float:
    """Seconds of decoding films: one after the other, or shared by so many processes, each on a thread of its own."""
    begin = time.perf_counter()
    shares = [films[number :: workers or 1] for number in range(workers or 1)]
    processes = [subprocess.Popen([sys.executable, "-c", DECODE, str(workers), *share]) for share in shares if share]
    if sum(process.wait() for process in processes):
        raise SystemExit("decoding: a process failed")
    return time.perf_counter() - begin


COMMAND = "import sys; from vfm_sdm.commands.app import main; main(sys.argv[1:])"
"""The command line, in a process that this one can ask for its memory."""


def error_mm(run_folder: Path, session: Path) -> float:
    """Root mean square error of lateral and vertical displacement of what moves, of the last piece [mm]."""
    truth, found = read_displacement(session.parent / "truth.nc"), read_displacement(run_folder)
    frames = truth.sizes["time"]
    names = [name for name in POINTS if name != "abutment"]
    axes = ["lateral", "vertical"]
    last = found["displacement"].sel(point=names, axis=axes).values[-frames:]
    true = truth["displacement"].sel(point=names, axis=axes).values
    return float(np.sqrt(np.nanmean((last - true) ** 2)))


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def measure_long(piece: Path, folder: Path, minutes: Sequence[float], workers: int) -> dict[str, object]:
    """Time, memory and errors of recordings of several lengths."""
    options = ["--workers", str(workers)] if workers else []
    heading = ("recording", "frames", "decode [s]", "measure [s]", "ratio", "peak [MB]", "rms error [mm]")
    print("  ".join(f"{name:>{width}s}" for name, width in zip(heading, COLUMNS, strict=True)))
    summary: dict[str, object] = {}
    peaks = []
    for length in minutes:
        pieces = max(round(60 * length / PIECE_S), 1)
        session = loop(piece, folder / f"{length:g}", pieces)
        films = [str(path) for path in sorted(session.parent.glob("*.mp4"))]
        decode_s = decode(films, workers)
        out = folder / f"run-{length:g}"
        measure_s, peak = run(COMMAND, "measure", str(session), "-o", str(out), *options)
        rms = error_mm(out, piece)
        peaks.append(peak)
        frames = round(pieces * PIECE_S * 30)
        ratio = measure_s / decode_s
        cells = (
            f"{length:g} min",
            frames,
            f"{decode_s:.1f}",
            f"{measure_s:.1f}",
            f"{ratio:.2f}",
            f"{peak:.0f}",
            f"{rms:.4f}",
        )
        print("  ".join(f"{cell:>{width}}" for cell, width in zip(cells, COLUMNS, strict=True)), flush=True)
        summary[f"minutes_{length:g}"] = {
            "decode_s": decode_s, "measure_s": measure_s, "ratio_to_decoding": ratio, "peak_mb": peak, "rms_mm": rms,
        }  # fmt: skip
        for film in films:
            Path(film).unlink()
    summary["peak_ratio_longest_to_shortest"] = peaks[-1] / peaks[0]
    return summary


def compare_workers(piece: Path, folder: Path, minutes: float) -> dict[str, object]:
    """Seconds of tracking the same films in all ways; raises where they differ."""
    session = loop(piece, folder / "scaling", max(round(60 * minutes / PIECE_S), 4))
    whole, segments = (
        _with_segments(session, name, length_s) for name, length_s in (("whole", 1e6), ("segments", 7.5 * minutes))
    )
    ways = {
        "one piece, this process": (whole, []),
        "segments, this process": (segments, []),
        "segments, one process": (segments, ["--workers", "1"]),
        "segments, two processes": (segments, ["--workers", "2"]),
    }
    seconds: dict[str, float] = {}
    bytes_of: dict[str, str] = {}
    print(f"{'tracked in':28s}  {'seconds':>8s}")
    with LocalDask() as address:
        if address:
            ways["segments, Dask of two"] = (segments, ["--scheduler", address])
        for name, (path, options) in ways.items():
            out = folder / "tracks" / name.replace(" ", "-")
            # Cameras first, so that tracking alone is timed.
            run(COMMAND, "cameras", str(path), "-o", str(out))
            seconds[name], _ = run(COMMAND, "track", str(path), "-o", str(out), *options)
            bytes_of[name] = digest(out / "tracks.nc")
            print(f"{name:28s}  {seconds[name]:8.1f}", flush=True)
    same = {bytes_of[name] for name in ways if name.startswith("segments")}
    if len(same) != 1:
        raise SystemExit("workers: expected the same bytes of all, got different ones")
    one, two = seconds["segments, one process"], seconds["segments, two processes"]
    found = {
        "speedup_two_processes": one / two,
        "segments_to_one_piece": seconds["segments, this process"] / seconds["one piece, this process"],
    }
    if "segments, Dask of two" in seconds:
        found["dask_to_processes"] = seconds["segments, Dask of two"] / two
    timed = {f"tracking_{name.replace(', ', '_').replace(' ', '_')}_s": value for name, value in seconds.items()}
    return {"scaling_minutes": minutes, **timed, **found}


def _with_segments(session: Path, name: str, length_s: float) -> Path:
    """The session with another length of segments."""
    settings = read_session(session)
    method = settings.method.model_copy(update={"segment_s": length_s})
    return write_session(session.with_name(f"{name}.toml"), settings.model_copy(update={"method": method}))


class LocalDask:
    """A Dask cluster of two workers on this machine; its address, or nothing where Dask is not there."""

    def __enter__(self) -> str:
        try:
            from distributed import LocalCluster
        except ImportError:
            self._cluster = None
            return ""
        self._cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50)
        return str(self._cluster.scheduler_address)

    def __exit__(self, *_: object) -> None:
        if self._cluster is not None:
            self._cluster.close()


def simulate_day(folder: Path, hours: float) -> tuple[Measurement, xr.DataArray]:
    """A measurement of tracks in files, of which only what is looked at is read; and the truth every minute [mm]."""
    simulated = simulate(
        11, vertical_mm=20.0, lateral_mm=8.0, track_std_px=(0.01, 0.01), synchronization="motion", duration_s=10.0,
        time_offset_std_s=0.05, range_std=0.05, length_std=0.005,
    )  # fmt: skip
    names = [str(name) for name in simulated.solution.points["point"].values]
    twice = [*names, *(f"{name} again" for name in names)]
    points = xr.concat([simulated.solution.points] * 2, "point").assign_coords(point=twice)
    session = simulated.session.model_copy(
        update={
            "point": tuple(
                point.model_copy(update={"name": f"{point.name}{suffix}"})
                for suffix in ("", " again")
                for point in simulated.session.point
            )
        }
    )
    frames = round(hours * 3600 * DAY_FPS)
    tracks = {
        view: _simulate_tracks(folder / f"{number}.nc", simulated, number, twice, frames)
        for number, view in enumerate(simulated.rig.names)
    }
    measurement = Measurement(session).given(
        cameras=replace(simulated.solution, points=points), tracks=tracks, frames={}, injection=None
    )
    time_s = np.arange(0, hours * 3600, 60.0)
    return measurement, xr.DataArray(
        day_motion(time_s, twice), dims=("time", "point", "axis"), coords={"time": time_s, "point": twice}
    )


def day_motion(time_s: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Motion of all points along the axes, shape (T, P, 3) [mm]: traffic half of the time, warmth over the day.

    The frequency of 2.2 Hz changes by 0.3 Hz, so that the motion does not repeat itself and tells the clocks.
    """
    traffic = np.clip(np.sin(2 * np.pi * time_s / 2400.0), 0, 1) ** 2
    warmth = 2.0 * np.sin(2 * np.pi * time_s / 86400.0)
    wave = np.stack(
        [
            2.0 * traffic * np.sin(2 * np.pi * 1.4 * time_s),
            8.0 * traffic * np.sin(2 * np.pi * (2.2 * time_s - 27.0 * np.cos(time_s / 90.0))) + warmth,
            0 * time_s,
        ],
        axis=-1,
    )
    moving = np.array([name.startswith("p") for name in names])
    return wave[:, None] * moving[:, None]


def _simulate_tracks(path: Path, simulated: Simulated, view: int, names: Sequence[str], frames: int) -> xr.Dataset:
    """Tracks of one view in a file: noise, a tripod that settles, the second clock 20 ppm fast."""
    rng, camera = np.random.default_rng(view), simulated.rig.cameras[view]
    places = np.concatenate([simulated.points3d] * 2)
    std = simulated.conditions.track_std_px[view]
    file = BlockFile(path)
    for block in time_blocks(frames, size=65536):
        own_s = np.arange(block.start, block.stop) / DAY_FPS
        true_s = own_s * (1 - 2e-5 * view) + (simulated.conditions.time_offset_s if view else 0.0)
        moved = places + day_motion(true_s, names) / 1e3 @ simulated.frame.rotation
        settled = 0.4 * view * (1 - np.exp(-true_s / 7200.0))[:, None, None]
        seen = np.asarray(camera.project(moved)) + settled + rng.normal(0, std, (len(own_s), len(names), 2))
        covariance = np.broadcast_to(std**2 * np.eye(2), (*seen.shape, 2))
        file.append(make_tracks(own_s, list(names), seen, covariance, np.zeros(seen.shape[:2], int), attrs={}))
    last = make_tracks(own_s[:1], list(names), seen[:1], covariance[:1], np.zeros((1, len(names)), int), attrs={})
    return file.finish(last.drop_vars(time_variables(last)))


def measure_day(folder: Path, hours: float) -> dict[str, object]:
    """Time, memory and errors of hours of tracks through everything behind tracking."""
    seconds: dict[str, float] = {}

    def timed(name: str, begin: float) -> float:
        now = time.perf_counter()
        seconds[name] = now - begin
        print(f"{name:28s}  {seconds[name]:8.1f} s  peak {peak_mb():6.0f} MB", flush=True)
        return now

    clock = time.perf_counter()
    measurement, truth = simulate_day(folder, hours)
    clock = timed("simulation", clock)
    displacement, audit = measurement.displacement, measurement.audit
    clock = timed("displacement and audit", clock)
    write_displacement(folder / "run", displacement)
    clock = timed("files", clock)
    summary = describe_measurement(measurement.cameras, measurement.tracks, displacement, audit)
    clock = timed("summary", clock)
    save_figures(
        folder / "run", measurement.tracks, displacement, {}, {}, about=describe_run(measurement.session, audit)
    )
    timed("figures", clock)
    found = displacement.sel(time=truth["time"], method="nearest").load()
    error = found["displacement"].values - truth.values
    held = np.abs(error) <= found["expanded_uncertainty"].values
    moving = [str(name).startswith("p") for name in truth["point"].values]
    verdicts = [str(one.verdict) for one in audit.intervals]
    figures = {
        "recording_s": 3600 * hours,
        "frames": displacement.sizes["time"],
        "points": displacement.sizes["point"],
        "fit_share": verdicts.count(Verdict.FIT) / max(len(verdicts), 1),
        "verdict": str(audit.verdict),
        "rms_vertical_mm": float(np.sqrt(np.nanmean(error[:, moving, 1] ** 2))),
        "rms_lateral_mm": float(np.sqrt(np.nanmean(error[:, moving, 0] ** 2))),
        "inside_share": float(held[:, moving].mean()),
        "share_valid": float(np.mean([one["coverage_valid"] for one in summary["points"].values()])),
        **{f"{name.split()[0]}_s": value for name, value in seconds.items()},
        "peak_mb": peak_mb(),
        "file_mb": (folder / "run" / "displacement.nc").stat().st_size / 1e6,
    }
    print({verdict: verdicts.count(verdict) for verdict in set(verdicts)}, figures["verdict"], flush=True)
    return figures


def peak_mb() -> float:
    """Peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 60.0], help="lengths of recordings")
    parser.add_argument("--height", type=int, choices=WIDTHS, default=1080)
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--scaling", type=float, default=0.0, help="minutes of film that are tracked in all ways")
    parser.add_argument("--day", type=float, default=0.0, help="hours of simulated tracks behind tracking, alone")
    options = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="vfm-sdm-long-"))
    try:
        if options.day:
            print(json.dumps({"processors": os.cpu_count(), **measure_day(folder, options.day)}))
            return
        # In a process of its own: what this one once took counts as a peak of all that it starts.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as renderer:
            piece = renderer.submit(make_piece, folder / "piece", options.height).result()
        summary: dict[str, object] = {
            "processors": os.cpu_count(),
            "height_px": options.height,
            "workers": options.workers,
        }
        if options.minutes[0] > 0:
            summary |= measure_long(piece, folder, options.minutes, options.workers)
        if options.scaling:
            summary |= compare_workers(piece, folder, options.scaling)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    summary["peak_of_this_mb"] = peak_mb()
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
