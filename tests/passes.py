"""Counts what a run opens and decodes."""

from collections import Counter

import pytest

from vfm_sdm.inputs.session import recordings
from vfm_sdm.inputs.video import Video

__all__ = ["count_passes"]


def count_passes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Counter[str]]:
    """By what is done (``opened``, ``first``, ``passes``), how often for each recording; filled while a run goes on."""
    found: dict[str, Counter[str]] = {"opened": Counter(), "first": Counter(), "passes": Counter()}
    frames, first_frame = Video.frames, Video.first_frame

    def count_frames(video, **options):
        if options.get("stop") is None:
            found["passes"][video.info.source] += 1
        return frames(video, **options)

    def count_first(video):
        found["first"][video.info.source] += 1
        return first_frame(video)

    for name in ("open_video", "open_images"):
        opener = getattr(recordings, name)

        def count_open(*args, opener=opener, **options):
            video = opener(*args, **options)
            found["opened"][video.info.source] += 1
            return video

        monkeypatch.setattr(recordings, name, count_open)
    monkeypatch.setattr(Video, "frames", count_frames)
    monkeypatch.setattr(Video, "first_frame", count_first)
    return found
