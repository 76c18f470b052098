"""An encoder set as that of a recording: same codec, kinds of frames, quantisers, and habits where the stream says."""

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import cast

import av
import numpy as np
from av.video.frame import PictureType
from llvmlite.binding import get_host_cpu_features

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import Region
from vfm_sdm.inputs.video.coding import BLOCK_PX, CodedClip
from vfm_sdm.inputs.video.luma import luma_plane

__all__ = ["ClipEncoder"]

_FACTOR = re.compile(r"\brc=crf\b.*?\bcrf=([\d.]+)")
_INTRA, _PREDICTED, _BOTH = 1, 2, 3
_RATE = 30
_DOUBLING = 6.0
"""Steps of the quantiser that double its width, H.264 8.5.9 and HEVC 8.6.4."""
_RELATIVE_ACTIVITY = re.compile(r"^x265.*\baq-mode=[2-4]\b")
_ACTIVITY_POWER, _ACTIVITY_SQUARE = 0.1, 11.0
"""How x265 makes quantisers of activity: its exponent, and the square of it that changes nothing."""
_X264 = {
    "ref": "ref", "me": "me", "subme": "subme", "me_range": "merange", "mixed_ref": "mixed-refs", "trellis": "trellis",
    "8x8dct": "8x8dct", "cabac": "cabac", "fast_pskip": "fast-pskip", "decimate": "dct-decimate",
    "chroma_qp_offset": "chroma-qp-offset", "bframes": "bframes", "b_pyramid": "b-pyramid", "weightb": "weightb",
    "weightp": "weightp", "qcomp": "qcomp", "mbtree": "mbtree", "rc_lookahead": "rc-lookahead",
    "ip_ratio": "ipratio", "pb_ratio": "pbratio", "psy": "psy",
}  # fmt: skip
"""Settings that x264 writes into the stream, and their names among its options."""
_X265 = (
    "ref", "bframes", "b-pyramid", "ctu", "min-cu-size", "rect", "amp", "max-tu-size", "tu-inter-depth",
    "tu-intra-depth", "limit-tu", "rdoq-level", "signhide", "max-merge", "limit-refs", "limit-modes", "me", "subme",
    "merange", "weightp", "weightb", "sao", "rd", "early-skip", "rskip", "psy-rd", "psy-rdoq", "qcomp", "ipratio",
    "pbratio", "aq-mode", "aq-strength", "cutree", "qg-size", "strong-intra-smoothing", "rc-lookahead", "temporal-mvp",
    "b-intra", "fast-intra", "tskip", "deblock",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class ClipEncoder:
    """Encodes small pictures as those of a recording were.

    Parameters
    ----------
    clip
        The recording: codec, layout, kinds of frames.
    quantisers
        Quantisers of the recording at the place, shape (T,).
    shift
        Added to the quantisers, or to the quality that x264 or x265 were asked for.

    Notes
    -----
    x264 and x265 write their settings into the stream. With these, and a constant rate factor (crf), an encoder chooses
    the quantisers of a part of the picture much as it did in the whole: its tree of predictions and the adaptation to
    the blocks' activity are local. Other encoders are imitated by constant quantisers for each kind of frame.
    """

    clip: CodedClip
    quantisers: FloatArray
    shift: float = 0.0

    @classmethod
    def of(cls, clip: CodedClip, subset: Region, region: Region) -> "ClipEncoder":
        """The encoder for a part of a recording's picture.

        Parameters
        ----------
        clip
            The recording.
        subset
            What is compared, in pixels of the whole picture.
        region
            What is encoded, in pixels of the whole picture.
        """
        shift = 0.0
        if _RELATIVE_ACTIVITY.search(clip.encoder) is not None:
            shift = _activity_shift(clip.first, clip.bit_depth, subset, region)
        return cls(clip, clip.quantisers_of(subset), shift)

    @property
    def by_quality(self) -> bool:
        """Whether the encoder's own rate factor chooses the quantisers."""
        return self._factor is not None

    @property
    def _factor(self) -> float | None:
        found = _FACTOR.search(self.clip.encoder)
        return None if found is None else float(found[1])

    @property
    def _quality(self) -> str:
        return f"{(self._factor or 0.0) + self.shift:.2f}"

    def run(self, luma: LumaArray) -> LumaArray:
        """Pictures as the recording would show them.

        Parameters
        ----------
        luma
            As many pictures as the clip has frames, or fewer, shape (T, H, W), H and W even.

        Raises
        ------
        VideoError
            This build of FFmpeg has no encoder of the codec, or the encoder refuses the pictures.
        """
        try:
            return self._run(luma)
        except (av.FFmpegError, ValueError) as error:
            raise VideoError(
                f"{self.clip.codec}: expected an encoder in PyAV, got: {error}; install PyAV with x264 and x265"
            ) from error

    def _run(self, luma: LumaArray) -> LumaArray:
        height, width = luma.shape[1:]
        avc = self.clip.codec == "h264"
        encoder = av.CodecContext.create("libx264" if avc else "libx265", "w")
        encoder.width, encoder.height, encoder.pix_fmt = width, height, self._pixel_format
        encoder.framerate, encoder.time_base = Fraction(_RATE), Fraction(1, _RATE)
        encoder.options = self._x264() if avc else self._x265()
        decoder = cast("av.VideoCodecContext", av.CodecContext.create(self.clip.codec, "r"))
        packets = []
        grey = np.full((height // 2, width), 1 << (self.clip.bit_depth - 1), luma.dtype)
        for number, picture in enumerate(luma):
            frame = av.VideoFrame.from_ndarray(np.concatenate([picture, grey]), format=self._pixel_format)
            frame.pts, frame.time_base = number, encoder.time_base
            frame.pict_type = PictureType(int(self.clip.frame_types[number]))
            packets += encoder.encode(frame)
        packets += encoder.encode(None)
        if encoder.extradata:
            decoder.extradata = encoder.extradata
        frames = [frame for packet in [*packets, None] for frame in decoder.decode(packet)]
        if len(frames) != len(luma):
            raise VideoError(f"{self.clip.codec}: expected {len(luma)} pictures, got {len(frames)}; report this file")
        return cast("LumaArray", np.array([luma_plane(frame) for frame in frames]))

    @property
    def _pixel_format(self) -> str:
        return "yuv420p" if self.clip.bit_depth == 8 else f"yuv420p{self.clip.bit_depth}le"

    def _x264(self) -> dict[str, str]:
        params = {"threads": "1", "scenecut": "0", "keyint": "infinite", **_instructions_of_x264()}
        if self.by_quality:
            return {"crf": self._quality, "x264-params": _joined(params | _settings_of_x264(self.clip.encoder))}
        levels = self._levels()
        return {"qp": str(levels.predicted), "x264-params": _joined(params | levels.ratios())}

    def _x265(self) -> dict[str, str]:
        params = {"log-level": "none", "pools": "1", "frame-threads": "1", "scenecut": "0", "keyint": "-1"}
        if self.by_quality:
            return {"crf": self._quality, "x265-params": _joined(params | _settings_of_x265(self.clip.encoder))}
        levels = self._levels()
        return {"x265-params": _joined(params | levels.ratios() | {"qp": str(levels.predicted)})}

    def _levels(self) -> "_Levels":
        """Constant quantisers of each kind of frame."""
        types, known = self.clip.frame_types, np.isfinite(self.quantisers)
        means = {
            kind: float(self.quantisers[known & (types == kind)].mean()) + self.shift
            for kind in (_INTRA, _PREDICTED, _BOTH)
            if (known & (types == kind)).any()
        }
        predicted = means.get(_PREDICTED, means.get(_INTRA, 26.0))
        return _Levels(
            max(round(predicted), 1),
            2 ** ((predicted - means.get(_INTRA, predicted)) / _DOUBLING),
            2 ** ((means.get(_BOTH, predicted) - predicted) / _DOUBLING),
            _longest_run(types == _BOTH),
        )


@dataclass(frozen=True)
class _Levels:
    """Quantiser of predicted frames, those of the other kinds as ratios of widths, and the most B frames in a row."""

    predicted: int
    ip_ratio: float
    pb_ratio: float
    run: int

    def ratios(self) -> dict[str, str]:
        return {"ipratio": f"{self.ip_ratio:.3f}", "pbratio": f"{self.pb_ratio:.3f}", "bframes": str(self.run)}


@cache
def _instructions_of_x264() -> dict[str, str]:
    """Option of x264 that leaves out instructions with which the same pictures give other bytes from run to run.

    With AVX-512 its look ahead (mbtree) depends on what lies in memory: six different streams of 14 of one clip, and
    one of 14 with AVX2.
    """
    return {"asm": "avx2"} if get_host_cpu_features().get("avx512f") else {}


def _settings_of_x264(text: str) -> dict[str, str]:
    """Options of x264, from what it wrote into a stream."""
    said = dict(re.findall(r"\b(\w+)=([-\w.:,]+)", text))
    params = {name: said[key] for key, name in _X264.items() if key in said}
    # Several numbers in one word, of which some are options of their own.
    for key, names in (("aq", ("aq-mode", "aq-strength")), ("deadzone", ("deadzone-inter", "deadzone-intra"))):
        params |= dict(zip(names, re.split("[:,]", said[key]), strict=False)) if key in said else {}
    for key, name, first in (("psy_rd", "psy-rd", 0), ("deblock", "deblock", 1)):
        numbers = re.split("[:,]", said.get(key, ""))[first:]
        params |= {name: ",".join(numbers)} if len(numbers) == 2 else {}
    return params


def _settings_of_x265(text: str) -> dict[str, str]:
    """Options of x265, from what it wrote into a stream."""
    words = text.partition("options:")[2].split()
    said = {word.partition("=")[0]: word.partition("=")[2] or "1" for word in words}
    said |= {word[3:]: "0" for word in words if word.startswith("no-") and "=" not in word}
    return {name: said[name].replace(":", ",") for name in _X265 if name in said}


def _longest_run(values: BoolArray) -> int:
    longest = run = 0
    for value in values.tolist():
        run = run + 1 if value else 0
        longest = max(longest, run)
    return longest


def _activity_shift(first: LumaArray, bit_depth: int, subset: Region, region: Region) -> float:
    """Quantiser that x265 would give a part in the whole picture, less the one in a region of it by itself.

    Its adaptation to activity (aq-mode 2) compares each block with the mean of the picture.
    """
    columns, rows = first.shape[1] // BLOCK_PX, first.shape[0] // BLOCK_PX
    blocks = first[: rows * BLOCK_PX, : columns * BLOCK_PX].astype(np.float64) / (1 << (bit_depth - 8))
    variance = blocks.reshape(rows, BLOCK_PX, columns, BLOCK_PX).var(axis=(1, 3))
    activity = (variance * BLOCK_PX**2 + 1) ** _ACTIVITY_POWER

    def part(of: Region) -> FloatArray:
        first_row, first_column = max(of.y // BLOCK_PX, 0), max(of.x // BLOCK_PX, 0)
        last_row, last_column = -(-(of.y + of.height) // BLOCK_PX), -(-(of.x + of.width) // BLOCK_PX)
        return np.asarray(activity[first_row:last_row, first_column:last_column])

    def offset(picture: FloatArray) -> float:
        mean, square = picture.mean(), (picture**2).mean()
        return float(mean * (part(subset).mean() - mean + 0.5 * (square - _ACTIVITY_SQUARE) / mean))

    if not (part(subset).size and part(region).size):
        return 0.0
    return offset(activity) - offset(part(region))


def _joined(params: dict[str, str]) -> str:
    return ":".join(f"{name}={value}" for name, value in params.items())
