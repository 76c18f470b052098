"""Fusion: displacement from standstill to a sensor's band, of the video and of an accelerometer together."""

from vfm_sdm.analysis.fusion.fuse import FusionSettings, fuse, search_about_start
from vfm_sdm.analysis.fusion.record import check_fusion, read_fusion, write_fusion
from vfm_sdm.analysis.fusion.sources import read_session_acceleration

__all__ = [
    "FusionSettings",
    "check_fusion",
    "fuse",
    "read_fusion",
    "read_session_acceleration",
    "search_about_start",
    "write_fusion",
]
