"""Hours of film: memory and time of `measure` beside merely decoding, what segments and workers cost, and errors.

A rendered piece of a stereo pair (1920 x 1080 px, 30 frames a second, H.264) is looped by copying its packets: the
motion begins and ends at rest, so that the truth is exact over the joints. Decoding and measuring alternate, in
processes of their own. ``--scaling`` tracks the same films in one piece, in segments, by one and two processes and by
a Dask cluster of two, whose results must be the same bytes.
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
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.inputs.session import read_session, write_session
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode

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
for path in sys.argv[1:]:
    for frame in open_video(path).frames():
        pass
"""
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


def measure_long(piece: Path, folder: Path, minutes: Sequence[float], options: Sequence[str]) -> dict[str, object]:
    """Time, memory and errors of recordings of several lengths."""
    heading = ("recording", "frames", "decode [s]", "measure [s]", "ratio", "peak [MB]", "rms error [mm]")
    print("  ".join(f"{name:>{width}s}" for name, width in zip(heading, COLUMNS, strict=True)))
    summary: dict[str, object] = {}
    peaks = []
    for length in minutes:
        pieces = max(round(60 * length / PIECE_S), 1)
        session = loop(piece, folder / f"{length:g}", pieces)
        films = [str(path) for path in sorted(session.parent.glob("*.mp4"))]
        decode_s, _ = run(DECODE, *films)
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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 60.0], help="lengths of recordings")
    parser.add_argument("--height", type=int, choices=WIDTHS, default=1080)
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--scaling", type=float, default=0.0, help="minutes of film that are tracked in all ways")
    options = parser.parse_args(arguments)
    folder = Path(tempfile.mkdtemp(prefix="vfm-sdm-long-"))
    try:
        piece = make_piece(folder / "piece", options.height)
        work = ["--workers", str(options.workers)] if options.workers else []
        summary: dict[str, object] = {"processors": os.cpu_count(), "height_px": options.height}
        if options.minutes[0] > 0:
            summary |= measure_long(piece, folder, options.minutes, work)
        if options.scaling:
            summary |= compare_workers(piece, folder, options.scaling)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    summary["peak_of_this_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
