"""Frames of one view: open, probe and iterate videos and image sequences, and map regions to full-image pixels.

A pass decodes every frame once, in order, and holds a bounded number of them; the luma is the decoder's own plane,
without colour conversion and, where possible, without a copy. Colours are converted when a frame is asked for them,
and of a region only that much. What went wrong on the way (duplicated and dropped frames, a file that ends early or is
damaged) stands in `Video.report`, never in made-up frames.
"""

from vfm_sdm.inputs.video.camera_tags import CameraTags
from vfm_sdm.inputs.video.passes import PassRecord, PassTally, join_passes
from vfm_sdm.inputs.video.reader import Video, open_images, open_video
from vfm_sdm.inputs.video.records import DecodeReport, DecodeStop, Frame, FrameSource, RgbArray, VideoInfo
from vfm_sdm.inputs.video.region import Region

__all__ = [
    "CameraTags",
    "DecodeReport",
    "DecodeStop",
    "Frame",
    "FrameSource",
    "PassRecord",
    "PassTally",
    "Region",
    "RgbArray",
    "Video",
    "VideoInfo",
    "join_passes",
    "open_images",
    "open_video",
]
