"""Blind injection: known motion put into a recording's own pictures, encoded as it was, tracked, and compared."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import trusted_values
from vfm_sdm.inputs.video import Region, Video
from vfm_sdm.inputs.video.coding import CodedClip, read_coded_clip
from vfm_sdm.inputs.video.memory import video_in_memory
from vfm_sdm.stages.tracking.base import Tracker
from vfm_sdm.stages.tracking.injection.encoder import ClipEncoder
from vfm_sdm.stages.tracking.injection.gains import compute_gain, smooth_motion
from vfm_sdm.stages.tracking.injection.source import Source, measure_looks

__all__ = ["inject"]

_FRAMES = 255
_FEWEST = 60
_PASSES = 3
_MARGIN_PX = 8
"""Room around a subset in its full motion, for interpolation and prediction [px]."""
_GRID_PX = {"h264": 16, "hevc": 64}


@dataclass(frozen=True, eq=False)
class Place:
    """A part of the picture around a point, and the motion that is put into it.

    Parameters
    ----------
    region
        The part with its margin [px].
    center
        The point in it, shape (2,) [px].
    shifts
        Motion of the point as it was tracked, shape (T, 2) [px].
    motion
        Motion to put in, shape (T, 2) [px].
    margin_px
        Width of the margin [px].
    """

    region: Region
    center: FloatArray
    shifts: FloatArray
    motion: FloatArray
    margin_px: int

    @classmethod
    def plan(cls, position: FloatArray, subset_px: int, codec: str) -> "Place":
        motion = smooth_motion(position)
        largest = int(np.ceil(np.abs(motion).max()))
        reach, grid, margin = subset_px // 2 + _MARGIN_PX + largest, _GRID_PX[codec], 16 + largest
        low = np.floor((position[0] - reach) / grid) * grid
        high = np.ceil((position[0] + reach + 1) / grid) * grid
        x, y = (low - margin).astype(int).tolist()
        width, height = (high - low + 2 * margin).astype(int).tolist()
        return cls(Region(x, y, width, height), position[0] - [x, y], position - position[0], -motion, margin)


def inject_point(clip, crop, place, tracker, subset_px, passes=_PASSES, verbose=False):
    intra = clip.frame_types == 1
    wanted = measure_looks(crop, tuple(place.center), place.shifts, intra, subset_px)
    source = Source.estimate(crop, place.shifts, noise=wanted.noise, margin_px=place.margin_px)
    half = subset_px // 2
    x, y = (np.rint(place.center) - half + [place.region.x, place.region.y]).astype(int).tolist()
    encoder = ClipEncoder(clip, clip.quantisers_of(Region(x, y, subset_px, subset_px)))
    inside = place.center - place.margin_px
    found = []
    for number in range(passes):
        rng = np.random.default_rng([number, 12])
        pictures = source.render(place.motion, clip.bit_depth, rng)
        encoded = encoder.run(pictures)
        one = tracker.track(video_in_memory(encoded.luma, fps=30.0, bit_depth=clip.bit_depth), inside[None], names=["a"])
        position = trusted_values(one, "position")[:, 0]
        shifts = position - inside
        got = measure_looks(encoded.luma, tuple(inside), shifts, intra, subset_px)
        gains = [compute_gain(position[:, k], place.motion[:, k]) for k in (0, 1)]
        found.append(gains)
        if verbose:
            print("   pass", number, *["%.4f+-%.4f n%.3f" % (g.gain, g.std, g.noise) for g in gains], "noise %.2f (want %.2f got %.2f)" % (source.noise, wanted.noise, got.noise),
                  "f", np.round(source.factors, 2), "c", np.round(got.contrast / wanted.contrast, 2), "q %.1f %.1f" % (np.nanmean(encoder.quantisers), np.nanmean(encoded.quantisers)), flush=True)
        source = source.corrected(wanted, got)
    return found
