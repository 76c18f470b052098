"""Points x frames a second, and error against exact truth: `icgn`, OpenCV's pyramidal Lucas-Kanade, and pyidi.

The same frames, the same points, one process, the calls of all methods interleaved; each is called once before, on
two frames, so that nothing is compiled during the measurement. Every call is the whole way that a user takes, from
frames in memory to displacements: preparation of the reference, checks, results. pyidi is no dependency of vfm-sdm;
where it is missing (`pip install pyidi`), its rows are left out and the ratio is null.

The scene: a texture with amplitudes that fall as 1 / frequency up to 0.3 cycles a pixel, shifted exactly in the
Fourier domain along an ellipse of some pixels, noise of 1 % of the grey range in every frame, 8 bits.
"""

import argparse
import contextlib
import io
import json
import os
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.tracking.icgn import IcgnTracker

try:
    import pyidi
except ImportError:
    pyidi = None

SIZE, CUTOFF, CONTRAST, NOISE = 448, 0.3, 45.0, 2.55
SUBSET_PX = 41
REACHED = 1.1
"""A peer reaches icgn's error when its own is at most this many times as large."""


@dataclass(frozen=True)
class Scene:
    frames: np.ndarray  # (T, H, W) uint8
    shifts: np.ndarray  # (T, 2) px, exact
    points: np.ndarray  # (P, 2) px, whole pixels, because pyidi takes no others
    few: np.ndarray  # indices of the points on which all methods, also the slow ones, are compared


@dataclass
class Method:
    name: str
    run: Callable[[np.ndarray, np.ndarray], np.ndarray]  # frames, points -> displacement (T, P, 2)
    all_points: bool = True
    is_pyidi: bool = False
    seconds: list[float] = field(default_factory=list)
    displacement: np.ndarray | None = None


def make_scene(frame_count: int, seed: int = 0) -> Scene:
    rng = np.random.default_rng(seed)
    frequency = np.fft.fftfreq(SIZE)
    fu, fv = np.meshgrid(frequency, frequency)
    radius = np.hypot(fu, fv)
    amplitude = np.where((radius > 0) & (radius < CUTOFF), 1 / np.maximum(radius, 4 / SIZE), 0)
    spectrum = np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * amplitude
    spectrum *= CONTRAST / np.fft.ifft2(spectrum).real.std()
    t = np.arange(frame_count)
    shifts = np.column_stack([2.3 * np.sin(2 * np.pi * t / 23), 3.1 * np.sin(2 * np.pi * t / 19)])
    frames = np.empty((frame_count, SIZE, SIZE), np.uint8)
    for k, (u, v) in enumerate(shifts):
        gray = 127 + np.fft.ifft2(spectrum * np.exp(-2j * np.pi * (fu * u + fv * v))).real
        frames[k] = np.clip(np.rint(gray + rng.normal(0, NOISE, gray.shape)), 0, 255)
    steps = np.arange(44, SIZE - 43, 21)
    points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return Scene(frames, shifts, points, np.arange(0, len(points), len(points) // 20))


class _Memory:
    """Frames in memory as a source for `Video`."""

    def __init__(self, frames: np.ndarray) -> None:
        self.frames = frames
        height, width = frames.shape[1:]
        self.info = VideoInfo("memory", width, height, 100.0, len(frames), len(frames) / 100, "raw", "gray", 8, 0)

    def stream(self):
        for index, luma in enumerate(self.frames):
            yield Frame(
                index, index / self.info.fps, luma, lambda region, luma=luma: np.dstack([region.crop(luma)] * 3)
            )


def run_icgn(frames: np.ndarray, points: np.ndarray) -> np.ndarray:
    names = [str(k) for k in range(len(points))]
    tracks = IcgnTracker(subset_px=SUBSET_PX).track(Video(_Memory(frames)), points.astype(float), names=names)
    return tracks["position"].values - points


def run_opencv(frames: np.ndarray, points: np.ndarray) -> np.ndarray:
    start = points.astype(np.float32).reshape(-1, 1, 2)
    current = start.copy()
    moved = np.zeros((len(frames), len(points), 2))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-3)
    for k in range(1, len(frames)):
        current, found, _ = cv2.calcOpticalFlowPyrLK(
            frames[0], frames[k], start, current.copy(), winSize=(SUBSET_PX, SUBSET_PX), maxLevel=3,
            criteria=criteria, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )  # fmt: skip
        moved[k] = np.where(found == 1, (current - start)[:, 0], np.nan)
    return moved


def pyidi_runner(method: str, **settings: object) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    def run(frames: np.ndarray, points: np.ndarray) -> np.ndarray:
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            analysis = getattr(pyidi, method)(pyidi.VideoReader(frames, root=folder))
            analysis.set_points(points[:, ::-1])
            analysis.configure(roi_size=(SUBSET_PX, SUBSET_PX), verbose=0, show_pbar=False, **settings)
            analysis.get_displacements(autosave=False)
        return analysis.displacements[:, :, ::-1].transpose(1, 0, 2)

    return run


def make_methods() -> list[Method]:
    methods = [Method("icgn", run_icgn), Method("OpenCV pyramidal LK", run_opencv)]
    if pyidi is None:
        return methods
    return [
        *methods,
        Method("pyidi LucasKanade", pyidi_runner("LucasKanade"), is_pyidi=True),
        Method("pyidi LucasKanade tol 1e-3", pyidi_runner("LucasKanade", tol=1e-3), is_pyidi=True),
        Method("pyidi DIC affine", pyidi_runner("DIC"), False, True),
        Method("pyidi DIC affine tol 1e-3", pyidi_runner("DIC", tol=1e-3), False, True),
        Method("pyidi DIC rigid tol 1e-3", pyidi_runner("DIC", warp="rigid", tol=1e-3), False, True),
    ]


def measure(methods: list[Method], scene: Scene, repeats: int, slow_frames: int) -> None:
    for method in methods:
        method.run(scene.frames[:2], scene.points[scene.few])
    for repeat in range(repeats):
        for method in methods:
            if not method.all_points and repeat > 0:
                continue
            frames = scene.frames if method.all_points else scene.frames[:slow_frames]
            points = scene.points if method.all_points else scene.points[scene.few]
            begin = time.perf_counter()
            method.displacement = method.run(frames, points)
            method.seconds.append(time.perf_counter() - begin)


def errors(method: Method, scene: Scene, slow_frames: int) -> tuple[float, float, float]:
    """RMS and largest bias along an axis on the points and frames common to all, RMS on all that it was given [px]."""
    moved = method.displacement
    error = (moved - scene.shifts[: len(moved), None])[1:]
    common = error[: slow_frames - 1]
    common = common[:, scene.few] if method.all_points else common
    return (
        float(np.sqrt(np.mean(common**2))),
        float(np.abs(common.mean(axis=(0, 1))).max()),
        float(np.sqrt(np.mean(error**2))),
    )


def summarise(methods: list[Method], scene: Scene, slow_frames: int) -> dict[str, object]:
    rows = {}
    print(f"{'method':28s} {'point-frames/s':>15s} {'RMS [px]':>10s} {'bias [px]':>10s} {'RMS, all [px]':>14s}  runs")
    for method in methods:
        frames, points, _ = method.displacement.shape
        speed = (frames - 1) * points / statistics.median(method.seconds)
        rms, bias, rms_all = errors(method, scene, slow_frames)
        rows[method.name] = {"point_frames_per_s": speed, "error_px": rms, "bias_px": bias}
        print(f"{method.name:28s} {speed:15.0f} {rms:10.5f} {bias:10.5f} {rms_all:14.5f}  {len(method.seconds)}")
    ours = rows["icgn"]
    peers = {name: row for name, row in rows.items() if name != "icgn"}
    rivals = {m.name: rows[m.name] for m in methods if m.is_pyidi}
    reaching = {n: r for n, r in rivals.items() if r["error_px"] <= REACHED * ours["error_px"]}
    chosen = max(reaching or rivals, key=lambda n: rivals[n]["point_frames_per_s"], default=None)
    if chosen is not None:
        why = f"reaches icgn's error within {REACHED}" if reaching else "none reaches icgn's error: the fastest overall"
        print(f"\nspeed is compared with {chosen} ({why})")
    ratio = None if chosen is None else ours["point_frames_per_s"] / rivals[chosen]["point_frames_per_s"]
    return {
        "icgn_point_frames_per_s": ours["point_frames_per_s"],
        "icgn_error_px": ours["error_px"],
        "icgn_bias_px": ours["bias_px"],
        "best_peer_error_px": min(row["error_px"] for row in peers.values()),
        "speed_ratio_to_pyidi": ratio,
        "compared_with": chosen,
        "reached_by_pyidi": sorted(reaching),
        "peers": peers,
        "processors": os.cpu_count(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=61)
    parser.add_argument("--slow-frames", type=int, default=10, help="frames for the methods written in Python")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", module="pyidi")
    scene = make_scene(options.frames)
    print(f"{len(scene.frames)} frames of {SIZE} x {SIZE}, {len(scene.points)} points, subsets of {SUBSET_PX} px")
    print(f"errors are compared on {len(scene.few)} points and the first {options.slow_frames} frames")
    if pyidi is None:
        print("pyidi is not installed, its rows are missing: pip install pyidi")
    methods = make_methods()
    measure(methods, scene, options.repeats, options.slow_frames)
    print()
    result = summarise(methods, scene, options.slow_frames)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
