"""An encoder set as that of a recording: same codec, kinds of frames, quantisers, and habits where the stream says."""

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import cast

import av
import numpy as np
from av.video.frame import PictureType

from vfm_sdm.core.arrays import BoolArray, FloatArray, LumaArray
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.coding import CodedClip, quantisers_of_picture
from vfm_sdm.inputs.video.luma import luma_plane

__all__ = ["ClipEncoder", "Encoded"]

_INTRA, _PREDICTED, _BOTH = 1, 2, 3
_RATE = 30
_DOUBLING = 6.0
"""Steps of the quantiser that double its width, H.264 8.5.9 and HEVC 8.6.4."""
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
class Encoded:
    """A clip after the encoder and the decoder.

    Parameters
    ----------
    luma
        Pictures, shape (T, H, W).
    quantisers
        Mean quantiser of the middle of each picture, shape (T,); NaN where the codec does not tell.
    """

    luma: LumaArray
    quantisers: FloatArray


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

    @property
    def by_quality(self) -> bool:
        """Whether the encoder's own rate factor chooses the quantisers."""
        return self._factor is not None

    @property
    def _factor(self) -> float | None:
        found = re.search(r"\brc=crf\b.*?\bcrf=([\d.]+)", self.clip.encoder)
        return None if found is None else float(found[1])

    def shifted(self, step: float) -> "ClipEncoder":
        """The encoder with other quantisers.

        Parameters
        ----------
        step
            Added to every quantiser.
        """
        return replace(self, shift=self.shift + step)

    def run(self, luma: LumaArray) -> Encoded:
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

    def _run(self, luma: LumaArray) -> Encoded:
        height, width = luma.shape[1:]
        avc = self.clip.codec == "h264"
        encoder = cast("av.VideoCodecContext", av.CodecContext.create("libx264" if avc else "libx265", "w"))
        encoder.width, encoder.height, encoder.pix_fmt = width, height, self._pixel_format
        encoder.framerate, encoder.time_base = Fraction(_RATE), Fraction(1, _RATE)
        encoder.options = self._x264() if avc else self._x265()
        decoder = cast("av.VideoCodecContext", av.CodecContext.create(self.clip.codec, "r"))
        if avc:
            decoder.options = {"export_side_data": "venc_params"}
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
        middle = [quantisers_of_picture(frame) for frame in frames]
        return Encoded(
            cast("LumaArray", np.array([luma_plane(frame) for frame in frames])),
            np.array([np.nan if q is None else q[1:-1, 1:-1].mean() for q in middle]),
        )

    @property
    def _pixel_format(self) -> str:
        return "yuv420p" if self.clip.bit_depth == 8 else f"yuv420p{self.clip.bit_depth}le"

    def _x264(self) -> dict[str, str]:
        params = {"threads": "1", "scenecut": "0", "keyint": "infinite"}
        if self.clip.encoder.startswith("x264") and self._factor is not None:
            said = dict(re.findall(r"\b(\w+)=([-\w.:,]+)", self.clip.encoder))
            params |= {name: said[key].replace(":", ",") for key, name in _X264.items() if key in said}
            for name, key, parts in (
                ("psy-rd", "psy_rd", slice(0, 2)), ("deblock", "deblock", slice(1, 3)), ("aq", "aq", slice(0, 2)),
            ):  # fmt: skip
                values = re.split("[:,]", said.get(key, ""))[parts]
                if name == "aq":
                    params |= dict(zip(("aq-mode", "aq-strength"), values, strict=False)) if values[0] else {}
                elif len(values) == 2:
                    params[name] = ",".join(values)
            if "deadzone" in said:
                params |= dict(zip(("deadzone-inter", "deadzone-intra"), said["deadzone"].split(","), strict=False))
            return {"crf": f"{self._factor + self.shift:.2f}", "x264-params": _joined(params)}
        levels = self._levels()
        params |= {"ipratio": f"{levels.ip_ratio:.3f}", "pbratio": f"{levels.pb_ratio:.3f}", "bframes": str(levels.run)}
        return {"qp": str(levels.predicted), "x264-params": _joined(params)}

    def _x265(self) -> dict[str, str]:
        params = {"log-level": "none", "pools": "1", "frame-threads": "1", "scenecut": "0", "keyint": "-1"}
        if self.clip.encoder.startswith("x265") and self._factor is not None:
            words = self.clip.encoder.partition("options:")[2].split()
            said = {w.partition("=")[0]: w.partition("=")[2] or "1" for w in words}
            said |= {w[3:]: "0" for w in words if w.startswith("no-") and "=" not in w}
            params |= {name: said[name].replace(":", ",") for name in _X265 if name in said}
            return {"crf": f"{self._factor + self.shift:.2f}", "x265-params": _joined(params)}
        levels = self._levels()
        params |= {"ipratio": f"{levels.ip_ratio:.3f}", "pbratio": f"{levels.pb_ratio:.3f}", "bframes": str(levels.run)}
        params["qp"] = str(levels.predicted)
        return {"x265-params": _joined(params)}

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
    predicted: int
    ip_ratio: float
    pb_ratio: float
    run: int


def _longest_run(values: BoolArray) -> int:
    longest = run = 0
    for value in values.tolist():
        run = run + 1 if value else 0
        longest = max(longest, run)
    return longest


def _joined(params: dict[str, str]) -> str:
    return ":".join(f"{name}={value}" for name, value in params.items())
