"""Hours of light that changes: what is kept, and how far tracks drift, with and without renewed reference frames.

A relief (`vfm_sdm.studies.synthetic.relief`) moves by known parts of a pixel while the light turns around it: by half a
circle in an hour, so that what was dark is bright in the end, or there and back, as from morning to evening and to the
next morning. The films have few frames a second, because light, not motion, is the question here. Drift is the mean
error over the last segment; stated is the standard deviation of the positions there. Without renewal, the recording is
tracked in one piece.
"""

import argparse
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import Status, make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.inputs.video import Video, open_images
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.segments import Work
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.stages.tracking.views import track_views
from vfm_sdm.studies.synthetic.relief import Relief

SIZE = (200, 150)
POINTS = np.array([[50.3, 45.2], [150.0, 45.4], [100.1, 75.0], [50.0, 105.3], [150.6, 104.7]])
NOISE = 1.5
"""Noise of a pixel [grey levels]."""
LIGHT = {"half a turn": lambda part: 180 * part, "there and back": lambda part: 180 * (1 - abs(1 - 2 * part))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1800, help="frames of a film")
    parser.add_argument("--minutes", type=float, default=60, help="length of a film")
    parser.add_argument("--segment-s", type=float, default=60, help="nominal length of a segment")
    parser.add_argument("--seeds", type=int, default=3, help="films of each kind")
    options = parser.parse_args()
    fps = options.frames / (60 * options.minutes)
    heading = f"{'light':16}{'renewal':10}{'kept [1]':>10}{'lost [1]':>10}{'references':>12}{'drift [px]':>12}"
    print(heading + f"{'stated [px]':>13}{'drift / stated: rms':>21}{'worst':>8}")
    quantities: dict[str, float] = {}
    for light in LIGHT:
        films = [Film(light, options.frames, fps, seed) for seed in range(options.seeds)]
        for renewal, length_s in (("with", options.segment_s), ("without", np.inf)):
            rows = [film.follow(length_s, options.segment_s) for film in films]
            kept, lost, count = (float(np.mean([row[k] for row in rows])) for k in range(3))
            drift, stated = (np.concatenate([row[k] for row in rows]) for k in (3, 4))
            rms, usual = (float(np.sqrt(np.mean(values**2))) if values.size else np.nan for values in (drift, stated))
            ratio = np.abs(drift) / stated
            of_rms = float(np.sqrt(np.mean(ratio**2))) if ratio.size else np.nan
            print(f"{light:16}{renewal:10}{kept:10.3f}{lost:10.3f}{count:12.1f}{rms:12.3f}{usual:13.3f}", end="")
            print(f"{of_rms:21.2f}{ratio.max(initial=0):8.2f}")
            name = f"{light} {renewal}".replace(" ", "_")
            quantities |= {f"{name}_kept_share": kept, f"{name}_lost_share": lost}
            if ratio.size:
                quantities |= {f"{name}_drift_px": rms, f"{name}_drift_ratio_to_stated": of_rms}
    print(json.dumps({**quantities, "frames": options.frames}))


class Film:
    """A film of a relief under changing light, written as images for each pass over it."""

    def __init__(self, light: str, frames: int, fps: float, seed: int) -> None:
        self.light, self.fps, self.seed = LIGHT[light], fps, seed
        number = np.arange(frames)
        moved = np.column_stack([2.3 * np.sin(0.195 * number), 1.1 * np.sin(0.295 * number + 1)])
        self.moved = moved - moved[0]

    def follow(self, length_s: float, last_s: float) -> tuple[float, float, int, np.ndarray, np.ndarray]:
        """Shares kept and lost, number of references, drift and its stated standard deviation over the last seconds."""
        with tempfile.TemporaryDirectory() as folder:
            tracks = track(self.write(Path(folder)), length_s)
        status = tracks["status"].values
        error = tracks["position"].values - POINTS - self.moved[:, None]
        last = tracks["time"].values > tracks["time"].values[-1] - last_s
        known = np.isfinite(error[last]).any(axis=(0, 2))
        drift = np.nanmean(error[last][:, known], axis=0).ravel()
        variance = np.einsum("tpii->tpi", tracks["position_covariance"].values[last][:, known])
        references = tracks.sizes.get("reference_frame", 1)
        ok, lost = (status == Status.OK).mean(), (status == Status.LOST).mean()
        return float(ok), float(lost), references, drift, np.sqrt(np.nanmean(variance, axis=0)).ravel()

    def write(self, folder: Path) -> Video:
        relief, rng = Relief(self.seed, SIZE), np.random.default_rng(self.seed + 100)
        parts = np.linspace(0, 1, len(self.moved))
        for number, (part, shift) in enumerate(zip(parts.tolist(), self.moved.tolist(), strict=True)):
            light = relief.picture((shift[0], shift[1]), self.light(part))
            gray = 110 + 160 * (light - light.mean()) + rng.normal(0, NOISE, light.shape)
            cv2.imwrite(str(folder / f"{number:06}.png"), np.clip(gray, 0, 255).round().astype(np.uint8))
        return open_images(folder / "*.png", fps=self.fps)


def track(video: Video, length_s: float) -> xr.Dataset:
    names = [f"p{number}" for number in range(len(POINTS))]
    unknown = np.full(2, np.nan)
    choice = SubsetChoice(SubsetDesign(41), unknown, unknown, 1.0, PointStatus.OK, unknown)
    status = [["ok"] * len(names)]
    points = make_points(["left"], names, position=POINTS[None], position_std=0 * POINTS[None], status=status)
    subsets = {"left": dict.fromkeys(names, choice)}
    return track_views({"left": video}, points, IcgnTracker(), subsets=subsets, work=Work(length_s))["left"]


if __name__ == "__main__":
    main()
