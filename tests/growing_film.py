"""Writes a film with known motion at the pace at which a camera would; `start_film` does so in another process."""

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import av
import numpy as np

from moving_frames import NaturalTexture

__all__ = ["Film", "start_film"]


@dataclass(frozen=True)
class Film:
    """A square picture of 256 px that swings along v, a whole number of pictures in each period."""

    seconds: float = 6.0
    fps: int = 30
    amplitude_px: float = 1.5
    frequency_hz: float = 1.0
    key_frames: int = 15
    options: str = ""
    """Of the muxer, as ``name=value``."""
    at_once: bool = False
    """Whether all is written as fast as possible."""

    @property
    def frames(self) -> int:
        """How many pictures are written."""
        return round(self.seconds * self.fps)

    def moved_px(self, time_s):
        """Motion along v from the first picture on [px]."""
        return self.amplitude_px * np.sin(2 * np.pi * self.frequency_hz * np.asarray(time_s))


def start_film(target, film=None, *, log=None):
    """The process that writes it, when the file is there.

    ``log`` is filled with the monotonic time at which each picture was handed over.
    """
    words = [sys.executable, __file__, str(target), json.dumps(asdict(film or Film())), str(log or "")]
    writer = subprocess.Popen(words)
    while "://" not in str(target) and not Path(target).exists() and writer.poll() is None:
        time.sleep(0.01)
    return writer


def _write(target, film, log):
    texture = NaturalTexture(3)
    pictures = [
        np.clip(texture.image((0.0, film.moved_px(number / film.fps))), 0, 255).round().astype(np.uint8)
        for number in range(min(film.frames, round(film.fps / film.frequency_hz)))
    ]
    options = dict([film.options.split("=", 1)]) if film.options else {}
    options["flush_packets"] = "1"
    form = "mpegts" if "://" in target else None
    handed = []
    with av.open(target, "w", format=form, options=options) as container:
        settings = {"preset": "ultrafast", "tune": "zerolatency", "crf": "12"}
        stream = container.add_stream("libx264", rate=film.fps, options=settings)
        stream.width = stream.height = 256
        stream.pix_fmt, stream.gop_size = "yuv420p", film.key_frames
        begin = time.monotonic()
        for number in range(film.frames):
            if not film.at_once:
                time.sleep(max(0.0, begin + number / film.fps - time.monotonic()))
            luma = np.full((384, 256), 128, np.uint8)
            luma[:256] = pictures[number % len(pictures)]
            frame = av.VideoFrame.from_ndarray(luma, format="yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
            handed.append(time.monotonic())
        container.mux(stream.encode(None))
    if log:
        Path(log).write_text(json.dumps(handed), encoding="utf-8")


if __name__ == "__main__":
    _write(sys.argv[1], Film(**json.loads(sys.argv[2])), sys.argv[3])
