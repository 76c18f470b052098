"""Films whose metadata name a camera."""

from collections.abc import Mapping
from pathlib import Path

import av
import numpy as np

__all__ = ["write_tagged"]


def write_tagged(path: Path, tags: Mapping[str, str], *, size: tuple[int, int] = (96, 72)) -> Path:
    """A film of three grey frames of a size (width, height) [px] with these tags in its container."""
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as container:
        container.metadata.update(tags)
        stream = container.add_stream("libx264", rate=30, options={"preset": "ultrafast"})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        for level in (90, 100, 110):
            picture = av.VideoFrame.from_ndarray(np.full((*size[::-1], 3), level, np.uint8), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path
