"""Wall time and memory of `measure` on a 4K 60 fps stereo pair, beside merely decoding the same two files.

The pair shows two textured planes, the near one moving, as an action camera would write them (H.264, about 60 Mbit/s).
Everything is measured in processes of its own, decoding and measuring alternately. The bar: tracking at most 1.3 times
the decoding, at most 10 s for the rest (features, compilation, figures), at most 1.5 GB, and no more than 5 % more
memory for a recording four times as long.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import av
import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, shift

from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session, read_session, write_session

SIZE = (3840, 2160)
FPS = 60
FOCAL_PX = 6000.0
NEAR_M, FAR_M = 20.0, 45.0
BASELINE_M = 4.0
BAND = (slice(600, 1500), slice(200, 3640))  # the near plane in the left view
PHASES = 8
LEAST_FRAMES = 16
POINTS = {"a": (900.0, 900.0), "b": (1500.0, 1200.0), "c": (2200.0, 1000.0), "d": (2900.0, 1150.0)}


def make_rig() -> Rig:
    angle = np.arctan2(BASELINE_M, NEAR_M)
    K = np.array([[FOCAL_PX, 0, (SIZE[0] - 1) / 2], [0, FOCAL_PX, (SIZE[1] - 1) / 2], [0, 0, 1]])
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    second = Camera(K, SIZE, cam_from_world=np.column_stack([R, -R @ [BASELINE_M, 0, 0]]))
    return Rig(("left", "right"), (Camera(K, SIZE), second), metric=True)


def texture(seed: int) -> np.ndarray:
    """Natural-looking grey values, shape (H, W)."""
    rng = np.random.default_rng(seed)
    total = np.zeros(SIZE[::-1], np.float32)
    for sigma in (2.0, 6.0, 20.0):
        noise = gaussian_filter(rng.standard_normal(SIZE[::-1]).astype(np.float32), sigma)
        total += noise / noise.std()
    return 120 + 25 * total


def from_left(rig: Rig, depth_m: float) -> np.ndarray:
    """Homography from the left to the right view through a plane at a depth."""
    camera = rig.cameras[1]
    plane = camera.rotation + np.outer(camera.translation, [0, 0, 1]) / depth_m
    return camera.K @ plane @ np.linalg.inv(rig.cameras[0].K)


def make_frames(view: str, rig: Rig) -> list[np.ndarray]:
    """One period of the motion: the near plane swings by 1.5 px; luma and grey chroma as planar 4:2:0."""
    far, near = texture(1), texture(2)
    frames = []
    for phase in range(PHASES):
        moved = shift(near, (1.5 * np.sin(2 * np.pi * phase / PHASES), 0), order=1, mode="nearest")
        mask = np.zeros(SIZE[::-1], np.float32)
        mask[BAND] = 1
        if view == "right":
            moved = cv2.warpPerspective(moved, from_left(rig, NEAR_M), SIZE)
            mask = cv2.warpPerspective(mask, from_left(rig, NEAR_M), SIZE)
            behind = cv2.warpPerspective(far, from_left(rig, FAR_M), SIZE)
        else:
            behind = far
        luma = np.clip(np.where(mask > 0.5, moved, behind), 16, 235).astype(np.uint8)
        frames.append(np.vstack([luma, np.full((SIZE[1] // 2, SIZE[0]), 128, np.uint8)]))
    return frames


def write_pair(folder: Path, frames: int) -> None:
    """``left.mp4`` and ``right.mp4``, and beside them the first quarter of each as ``short_*.mp4``."""
    rig = make_rig()
    for view in rig.names:
        period = make_frames(view, rig)
        with av.open(str(folder / f"{view}.mp4"), "w") as out:
            stream = out.add_stream("libx264", rate=FPS, options={"preset": "ultrafast", "b": "60M"})
            stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
            for index in range(frames):
                frame = av.VideoFrame.from_ndarray(period[index % PHASES], format="yuv420p")
                frame.pts = index
                out.mux(stream.encode(frame))
            out.mux(stream.encode(None))
        with av.open(str(folder / f"{view}.mp4")) as whole, av.open(str(folder / f"short_{view}.mp4"), "w") as out:
            stream = out.add_stream_from_template(whole.streams.video[0])
            for index, packet in enumerate(whole.demux(video=0)):
                if packet.dts is not None and index < frames // 4:
                    packet.stream = stream
                    out.mux(packet)


def write_sessions(folder: Path) -> dict[str, Path]:
    paths = {}
    for name, prefix in (("long", ""), ("short", "short_")):
        lens = {"focal_px": FOCAL_PX, "relative_std": 0.02}
        session = Session(
            name=f"4K pair, {name}",
            folder=folder,
            view=[{"name": v, "video": f"{prefix}{v}.mp4", "lens": lens} for v in ("left", "right")],
            site={"baseline": {"value": BASELINE_M, "std": 0.01}},
            point=[{"name": n, "view": "left", "pixel": list(uv)} for n, uv in POINTS.items()],
        )
        paths[name] = write_session(folder / f"{name}.toml", session)
    return paths


def decode(paths: list[Path]) -> None:
    for path in paths:
        with av.open(str(path)) as container:
            container.streams.video[0].thread_type = "AUTO"
            for _ in container.decode(video=0):
                pass


def child(task: str, argument: str) -> None:
    """One measurement in this process; its figures as one line of JSON."""
    start = time.perf_counter()
    seconds = {}
    if task == "decode":
        decode([Path(p) for p in argument.split(",")])
    else:
        from vfm_sdm.measurement import measure

        with tempfile.TemporaryDirectory() as out:
            result = measure(read_session(Path(argument)), out)
        seconds = dict(result.summary["seconds"])
        seconds["found"] = float(np.isfinite(result.displacement["displacement"].values).mean())
    wall = time.perf_counter() - start
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"wall_s": wall, "peak_mb": peak_mb, **seconds}))


def run(task: str, argument: str) -> dict[str, float]:
    command = [sys.executable, __file__, "--child", task, "--argument", argument]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    return {**json.loads(done.stdout.splitlines()[-1]), "process_s": time.perf_counter() - start}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=480, help="frames of the long recording")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--child", default=None)
    parser.add_argument("--argument", default="")
    options = parser.parse_args()
    if options.child:
        child(options.child, options.argument)
        return
    if options.frames < LEAST_FRAMES:
        parser.error(
            f"--frames: expected {LEAST_FRAMES} or more, of which a quarter can be audited, got {options.frames}"
        )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_pair(folder, options.frames)
        sessions = write_sessions(folder)
        files = ",".join(str(folder / f"{v}.mp4") for v in ("left", "right"))
        megabit = 8e-6 * (folder / "left.mp4").stat().st_size / (options.frames / FPS)
        print(f"{options.frames} frames a view, {SIZE[0]} x {SIZE[1]} at {FPS} fps, {megabit:.0f} Mbit/s, 4 points")
        decoding, measuring = [], []
        for _ in range(options.repeats):
            decoding.append(run("decode", files))
            measuring.append(run("measure", str(sessions["long"])))
        short = run("measure", str(sessions["short"]))
    decode_s = statistics.median(d["wall_s"] for d in decoding)
    measure_s = statistics.median(m["process_s"] for m in measuring)
    tracking_s = statistics.median(m["tracking"] for m in measuring)
    start_up_s = statistics.median(m["process_s"] - m["tracking"] for m in measuring)
    print(f"{'':24}{'seconds':>10}")
    for what, value in (
        ("decode both, PyAV", decode_s),
        ("measure, whole process", measure_s),
        ("  of it tracking", tracking_s),
        ("  of it all else", start_up_s),
    ):
        print(f"{what:24}{value:10.2f}")
    print("stages:", {k: v for k, v in measuring[-1].items() if k not in ("wall_s", "peak_mb", "process_s")})
    print(
        json.dumps(
            {
                "measure_s": round(measure_s, 2),
                "decode_s": round(decode_s, 2),
                "ratio": round(tracking_s / decode_s, 3),
                "start_up_s": round(start_up_s, 2),
                "bar_s": round(1.3 * decode_s + 10, 2),
                "peak_memory_mb": round(short["peak_mb"]),
                "peak_memory_4x_mb": round(statistics.median(m["peak_mb"] for m in measuring)),
            }
        )
    )


if __name__ == "__main__":
    main()
