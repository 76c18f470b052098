"""Injected gain against true gain: plates of several contrasts before a wall, H.264 and HEVC of several qualities.

Motion, texture and noise are known to the script; injection sees only the files. The gain of one recording is itself
known to its scatter (`scatter` in the table: that of the slope of the track over the motion), so that the rms
difference is stated as it is and less what scatter and injection state of themselves. A point whose gain injection
does not state, because it scatters by more than a tenth, is counted.
"""

import argparse
import json
import os
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.injection.gains import compute_gain
from vfm_sdm.stages.tracking.injection.inject import inject
from vfm_sdm.stages.tracking.track_noise import include_track_noise

FPS, SUBSET_PX, PLATE_PX, GAP_PX, TILE_PX = 30, 61, 112, 32, 256
AMPLITUDES_PX, NOISE, STILL_FRAMES = (0.6, 1.0), 1.5, 18
CODECS = {"h264": "libx264", "hevc": "libx265"}


@dataclass(frozen=True)
class Row:
    codec: str
    crf: int
    contrast: float
    true: np.ndarray  # gain of the track over the known motion, (u, v)
    scatter: np.ndarray
    true_noise: np.ndarray
    gain: np.ndarray
    std: np.ndarray
    noise: np.ndarray


def make_texture(seed: int) -> np.ndarray:
    """Spectrum of a texture with a standard deviation of 1, amplitudes as 1 / frequency up to 0.3 cycles a pixel."""
    fu, fv = np.fft.rfftfreq(TILE_PX)[None], np.fft.fftfreq(TILE_PX)[:, None]
    radius = np.hypot(fu, fv)
    amplitude = np.where((radius > 0) & (radius < 0.3), 1 / np.maximum(radius, 6 / TILE_PX), 0)
    spectrum = np.fft.rfft2(np.random.default_rng(seed).standard_normal((TILE_PX, TILE_PX))) * amplitude
    return spectrum / np.fft.irfft2(spectrum).std()


def moved(spectrum: np.ndarray, shift: np.ndarray) -> np.ndarray:
    fu, fv = np.fft.rfftfreq(TILE_PX)[None], np.fft.fftfreq(TILE_PX)[:, None]
    return np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (fu * shift[0] + fv * shift[1])))


def make_motion(frames: int) -> np.ndarray:
    t = np.arange(frames) / FPS
    modes = [(1.37, 1.0, 0.4, 0.0), (2.83, 0.6, 2.0, 1.0), (4.4, 0.25, 1.0, 2.0)]
    motion = sum(
        a * np.column_stack([np.sin(2 * np.pi * f * t + pu), np.sin(2 * np.pi * f * t + pv)]) for f, a, pu, pv in modes
    )
    motion = motion * np.clip((np.arange(frames) - STILL_FRAMES) / 20, 0, 1)[:, None]
    return motion * AMPLITUDES_PX / motion[STILL_FRAMES:].std(axis=0)


def make_frames(contrasts: list[float], motion: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames (T, H, W) with a plate of each contrast in a row, and their centres."""
    height = TILE_PX
    width = -(-(len(contrasts) * (PLATE_PX + GAP_PX) + GAP_PX) // 16) * 16
    wall = np.tile(moved(make_texture(seed + 1000), np.zeros(2)), (1, -(-width // TILE_PX)))[:, :width]
    points = np.array(
        [[GAP_PX + PLATE_PX / 2 + k * (PLATE_PX + GAP_PX), height / 2] for k in range(len(contrasts))], float
    )
    plates = [make_texture(100 * seed + k) for k in range(len(contrasts))]
    rows, columns = np.mgrid[:height, :width].astype(float)
    rng, frames = np.random.default_rng(seed), []
    for shift in motion:
        picture = 118 + 18 * wall
        for (u, v), contrast, plate in zip(points, contrasts, plates, strict=True):
            share = np.clip(PLATE_PX / 2 - np.abs(columns - u - shift[0]) + 0.5, 0, 1)
            share = share * np.clip(PLATE_PX / 2 - np.abs(rows - v - shift[1]) + 0.5, 0, 1)
            surface = np.roll(moved(plate, shift), int(u), axis=1)
            surface = np.tile(surface, (1, -(-width // TILE_PX)))[:, :width]
            picture = share * (128 + contrast * surface) + (1 - share) * picture
        frames.append(np.clip(np.rint(picture + rng.normal(0, NOISE, picture.shape)), 16, 235).astype(np.uint8))
    return np.array(frames), points


def write(path: Path, frames: np.ndarray, codec: str, crf: int, preset: str) -> None:
    height, width = frames.shape[1:]
    options = {"crf": str(crf), "preset": preset} | ({"x265-params": "log-level=none"} if codec == "hevc" else {})
    grey = np.full((height // 2, width), 128, np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(CODECS[codec], rate=Fraction(FPS), options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for number, luma in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.concatenate([luma, grey]), format="yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def measure(options: argparse.Namespace) -> tuple[list[Row], float, float]:
    tracker, motion = IcgnTracker(subset_px=SUBSET_PX), make_motion(options.frames)
    names = [f"{contrast:g}" for contrast in options.contrasts]
    rows, tracking_s, injection_s = [], 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            frames, points = make_frames(options.contrasts, motion, seed)
            for codec in options.codecs:
                for crf in options.crf:
                    path = Path(folder) / f"{codec}.mp4"
                    write(path, frames, codec, crf, options.preset)
                    video, start = open_video(path), time.perf_counter()
                    tracks = include_track_noise(tracker.track(video, points, names=names))
                    middle = time.perf_counter()
                    found = inject(video, tracks, tracker)
                    tracking_s += middle - start
                    injection_s += time.perf_counter() - middle
                    for k, contrast in enumerate(options.contrasts):
                        position = tracks["position"].values[:, k]
                        true = [compute_gain(position[:, axis], motion[:, axis]) for axis in (0, 1)]
                        one = found.isel(point=k)
                        by_point = (one[f"injected_{name}"].values for name in ("gain", "gain_std", "noise"))
                        truth = (np.array([getattr(g, name) for g in true]) for name in ("gain", "std", "noise"))
                        rows.append(Row(codec, crf, contrast, *truth, *by_point))
    return rows, tracking_s, injection_s


def rms(values: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def summarise(rows: list[Row]) -> dict[str, object]:
    print(f"{'codec':6s} {'crf':>4s} {'contrast':>9s}  {'true gain':>16s}  {'injected gain':>16s}  "
          f"{'its std':>16s}  {'noise, injected':>16s}  {'scatter':>8s}")  # fmt: skip
    for codec, crf, contrast in dict.fromkeys((r.codec, r.crf, r.contrast) for r in rows):
        alike = [r for r in rows if (r.codec, r.crf, r.contrast) == (codec, crf, contrast)]
        mean = {n: np.mean([getattr(r, n) for r in alike], axis=0) for n in ("true", "gain", "std", "true_noise")}
        noise, scatter = np.mean([r.noise for r in alike], axis=0), np.mean([r.scatter for r in alike])
        texts = [f"{mean[n][0]:.4f}  {mean[n][1]:.4f}" for n in ("true", "gain", "std")]
        texts.append(f"{mean['true_noise'].mean():.3f}  {noise.mean():.3f}")
        print(f"{codec:6s} {crf:4d} {contrast:9g}  " + "  ".join(f"{t:>16s}" for t in texts) + f"  {scatter:8.4f}")
    known = [(r, k) for r in rows for k in (0, 1) if np.isfinite([r.true[k], r.gain[k]]).all()]
    error = np.array([r.gain[k] - r.true[k] for r, k in known])
    scatter = np.array([np.hypot(r.scatter[k], r.std[k]) for r, k in known])
    loss = np.array([1 - r.true[k] for r, k in known])
    share = loss > 0.02
    result = {
        "relative_difference_rms": rms(error),
        "relative_scatter_rms": rms([r.scatter[k] for r, k in known]),
        "relative_loss_rms": rms(loss),
        "relative_difference_mean": float(error.mean()) if len(error) else float("nan"),
        "difference_ratio_to_stated_std": rms(error / scatter),
        "difference_share_of_loss": rms(error[share]) / rms(loss[share]) if share.any() else float("nan"),
        "share_not_stated": 1 - len(known) / max(2 * len(rows), 1),
    }
    print()
    for name, value in result.items():
        print(f"{name:30s}  {value:.4f}")
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=255)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--contrasts", type=float, nargs="+", default=[3, 6, 12, 25, 50])
    parser.add_argument("--crf", type=int, nargs="+", default=[18, 23, 28])
    parser.add_argument("--codecs", nargs="+", default=list(CODECS))
    parser.add_argument("--preset", default="medium")
    options = parser.parse_args()
    print(f"{options.frames} frames, {options.seeds} recordings each, motion {AMPLITUDES_PX} px rms, noise {NOISE}\n")
    rows, tracking_s, injection_s = measure(options)
    result = summarise(rows)
    print(f"{'tracking, injection [s]':30s}  {tracking_s:.1f}  {injection_s:.1f}")
    result |= {"tracking_s": tracking_s, "injection_s": injection_s, "processors": os.cpu_count()}
    print(json.dumps(result))


if __name__ == "__main__":
    main()
