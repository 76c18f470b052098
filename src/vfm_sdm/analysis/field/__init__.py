"""The field: displacement of the whole structure along its length, from many points together."""

from vfm_sdm.analysis.field.field import NOT_OF_STRUCTURE, compute_field
from vfm_sdm.analysis.field.record import check_field, extreme_times, read_field, write_field
from vfm_sdm.analysis.field.shapes import compute_mac, find_shapes

__all__ = [
    "NOT_OF_STRUCTURE",
    "check_field",
    "compute_field",
    "compute_mac",
    "extreme_times",
    "find_shapes",
    "read_field",
    "write_field",
]
