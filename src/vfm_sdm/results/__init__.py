"""The run folder: tracks, displacement and summary written so that they are whole or absent, and read back."""

from vfm_sdm.results.exports import write_mat, write_uff
from vfm_sdm.results.netcdf import read_displacement, read_tracks, write_displacement, write_tracks
from vfm_sdm.results.notes import (
    describe_camera_motion,
    describe_clocks,
    describe_recording,
    describe_refinement,
    displacement_notes,
    recording_notes,
)
from vfm_sdm.results.summary import dominant_frequency, read_summary, summarize_displacement, write_json, write_summary

__all__ = [
    "describe_camera_motion",
    "describe_clocks",
    "describe_recording",
    "describe_refinement",
    "displacement_notes",
    "dominant_frequency",
    "read_displacement",
    "read_summary",
    "read_tracks",
    "recording_notes",
    "summarize_displacement",
    "write_displacement",
    "write_json",
    "write_mat",
    "write_summary",
    "write_tracks",
    "write_uff",
]
