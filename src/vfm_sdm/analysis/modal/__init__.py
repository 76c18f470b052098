"""Modal analysis: frequencies, damping and shapes of a structure from its displacement, with intervals that hold."""

from vfm_sdm.analysis.modal.identify import ModalOptions, identify_modes
from vfm_sdm.analysis.modal.record import check_modes, read_modes, write_modes
from vfm_sdm.analysis.modal.shapes import compute_collinearity, compute_mac

__all__ = [
    "ModalOptions",
    "check_modes",
    "compute_collinearity",
    "compute_mac",
    "identify_modes",
    "read_modes",
    "write_modes",
]
