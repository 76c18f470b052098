"""The run folder: tracks, displacement and summary written so that they are whole or absent, and read back."""

from vfm_sdm.outputs.results.causes import first_cause
from vfm_sdm.outputs.results.expectation import Worth, describe_expectation
from vfm_sdm.outputs.results.exports import write_displacement, write_export
from vfm_sdm.outputs.results.movement import write_movement
from vfm_sdm.outputs.results.notes import (
    describe_camera_motion,
    describe_clocks,
    describe_recording,
    describe_refinement,
    displacement_notes,
    recording_notes,
)
from vfm_sdm.outputs.results.summary import describe_measurement, read_summary, summarize_displacement, write_summary

__all__ = [
    "Worth",
    "describe_camera_motion",
    "describe_clocks",
    "describe_expectation",
    "describe_measurement",
    "describe_recording",
    "describe_refinement",
    "displacement_notes",
    "first_cause",
    "read_summary",
    "recording_notes",
    "summarize_displacement",
    "write_displacement",
    "write_export",
    "write_movement",
    "write_summary",
]
