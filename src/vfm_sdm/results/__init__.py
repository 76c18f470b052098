"""The run folder: tracks, displacement and summary written so that they are whole or absent, and read back."""

from vfm_sdm.results.exports import write_mat, write_uff
from vfm_sdm.results.netcdf import read_displacement, read_tracks, write_displacement, write_tracks
from vfm_sdm.results.summary import dominant_frequency, read_summary, summarize_displacement, write_summary

__all__ = [
    "dominant_frequency",
    "read_displacement",
    "read_summary",
    "read_tracks",
    "summarize_displacement",
    "write_displacement",
    "write_mat",
    "write_summary",
    "write_tracks",
    "write_uff",
]
