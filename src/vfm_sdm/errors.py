"""Errors of vfm-sdm: one base class, each error also a built-in, so that callers may catch either.

Misuse raises one of these with a message of the form "expected ..., got ...; do ...". Estimation that fails on
the data is not an exception: it is NaN with a named status in the result.
"""

__all__ = [
    "BackendUnavailableError",
    "CameraError",
    "DatasetError",
    "DeviceMemoryError",
    "ResultsError",
    "SessionError",
    "VfmSdmError",
    "VideoError",
]


class VfmSdmError(Exception):
    """Base class of every error that vfm-sdm raises on purpose."""


class SessionError(VfmSdmError, ValueError):
    """A session file or a setting in it is missing, unknown or contradicts another one."""


class DatasetError(VfmSdmError, ValueError):
    """Labelled data or an array has other dimensions, units or values than the function needs."""


class VideoError(VfmSdmError, OSError):
    """A video or image sequence cannot be opened, or holds no usable frame."""


class CameraError(VfmSdmError, ValueError):
    """Camera parameters or calibration input are malformed or insufficient."""


class ResultsError(VfmSdmError, OSError):
    """A run folder cannot be written, or a file in it cannot be read back."""


class BackendUnavailableError(VfmSdmError, ImportError):
    """A named back end is unknown or cannot run here (package, weights or device missing)."""


class DeviceMemoryError(BackendUnavailableError, MemoryError):
    """A network does not fit the memory of its device."""
