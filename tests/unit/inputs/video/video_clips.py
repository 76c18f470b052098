"""Small recordings whose every pixel and time stamp is known."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

RATE = 25
TIME_BASE = Fraction(1, 12800)
LOSSLESS = {
    "libx264": {"qp": "0", "preset": "ultrafast", "bf": "0"},
    "libx265": {"preset": "ultrafast", "x265-params": "lossless=1:log-level=none"},
}
# A picture type of every kind (two levels of B), small groups, and checksums in HEVC.
REAL = {
    "libx264": {"crf": "20", "preset": "medium", "bf": "3"},
    "libx265": {"crf": "20", "preset": "fast", "x265-params": "hash=1:log-level=none:keyint=12:bframes=3"},
}
FRONT = {"movflags": "faststart"}


def scene(count, size=(198, 134), bits=8, seed=0):
    """Distinct pictures (height, width) of a moving texture; the width is no multiple of a decoder's alignment."""
    width, height = size
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.random((height, width + count)), (0, 0), 2)
    texture = (texture - texture.min()) / np.ptp(texture)
    values = np.rint(16 + texture * (2**bits - 33)).astype(np.uint8 if bits == 8 else np.uint16)
    return [np.ascontiguousarray(values[:, i : i + width]) for i in range(count)]


def picture(luma, pixel_format):
    """A decoded picture with this luma and no colour."""
    height, width = luma.shape
    frame = av.VideoFrame(width, height, pixel_format)
    for index, plane in enumerate(frame.planes):
        rows = np.frombuffer(plane, luma.dtype).reshape(plane.height, -1)
        if index == 0:
            rows[:, :width] = luma
        else:
            rows[:] = 128 if luma.dtype == np.uint8 else 512
    return frame


def write_clip(
    path,
    lumas,
    *,
    codec="libx264",
    pixel_format="yuv420p",
    options=None,
    container_options=None,
    stamps=None,
    rotation=None,
    edit=None,
    metadata=None,
):
    """Encode pictures; ``stamps`` in units of `TIME_BASE`, ``edit`` changes the finished list of packets."""
    options = LOSSLESS[codec] if options is None else options
    stamps = [round(i / RATE / TIME_BASE) for i in range(len(lumas))] if stamps is None else stamps
    with av.open(str(path), "w", options=container_options or {}) as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream(codec, rate=RATE, options=options)
        stream.height, stream.width = lumas[0].shape
        stream.pix_fmt = pixel_format
        stream.time_base = stream.codec_context.time_base = TIME_BASE
        if rotation is not None:
            stream.set_display_rotation(rotation)
        packets = []
        for luma, stamp in zip(lumas, stamps, strict=True):
            frame = picture(luma, pixel_format)
            frame.pts, frame.time_base = stamp, TIME_BASE
            packets += stream.encode(frame)
        packets += stream.encode(None)
        for packet in edit(packets) if edit else packets:
            container.mux(packet)
    return Path(path)


def write_colors(path, size, *, codec="libx264", pixel_format="yuv420p", options=None, count=2, rotation=None, seed=0):
    """Encode pictures of strong colours that differ from each other."""
    width, height = size
    rng = np.random.default_rng(seed)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE, options=options or {})
        stream.width, stream.height, stream.pix_fmt = width, height, pixel_format
        if rotation is not None:
            stream.set_display_rotation(rotation)
        for _ in range(count):
            # Patches of a few pixels, so that borders between colours lie everywhere, and single pixels on top.
            coarse = rng.integers(0, 256, (height // 5, width // 5, 3), dtype=np.uint8)
            rgb = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC).astype(int)
            rgb = np.clip(rgb + rng.integers(-30, 31, rgb.shape), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format=pixel_format)))
        container.mux(stream.encode(None))
    return Path(path)


def decoded(path):
    """All pictures of a sound file as the decoder gives them, by a plain loop of PyAV."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray()[: frame.height].copy() for frame in container.decode(video=0)]


def packet_places(path):
    """Place and size in the file of each packet, in decoding order."""
    with av.open(str(path)) as container:
        return [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]


def shown_as(path, number):
    """Index of the frame that the packet with this number in decoding order holds."""
    with av.open(str(path)) as container:
        stamps = [packet.pts for packet in container.demux(video=0) if packet.size]
    return sorted(stamps).index(stamps[number])


def damage(path, target, place, data):
    """A copy of the file with other bytes at one place."""
    content = bytearray(Path(path).read_bytes())
    content[place : place + len(data)] = data
    Path(target).write_bytes(content)
    return Path(target)


def cut(path, target, size):
    """The first ``size`` bytes of a file."""
    Path(target).write_bytes(Path(path).read_bytes()[:size])
    return Path(target)
