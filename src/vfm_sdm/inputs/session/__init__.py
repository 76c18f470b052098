"""The measurement session: what was filmed, measured on site and wanted, and its file ``session.toml``."""

from vfm_sdm.core.files import file_hash
from vfm_sdm.inputs.session.chain import SessionChain
from vfm_sdm.inputs.session.defaults import Defaults, read_defaults
from vfm_sdm.inputs.session.exif import lens_from_exif, tags_from_exif
from vfm_sdm.inputs.session.file import read_session, session_hash, write_session
from vfm_sdm.inputs.session.lens import Lens
from vfm_sdm.inputs.session.method import Method, Network, Sfm, Sgr
from vfm_sdm.inputs.session.model import Chessboard, Grid, Point, Sensor, Session, View
from vfm_sdm.inputs.session.recorded import RecordedChain
from vfm_sdm.inputs.session.recordings import (
    RECORDED,
    FirstFrames,
    camera_tags,
    input_files,
    open_views,
    picture_of,
    pixel_aspect,
    quiet_frames,
)
from vfm_sdm.inputs.session.reference_frames import find_reference_frames
from vfm_sdm.inputs.session.report import Report
from vfm_sdm.inputs.session.site import (
    Length,
    Level,
    Lines,
    Measured,
    Range,
    Ratio,
    Readings,
    Rectangle,
    SensedMotion,
    Site,
)

__all__ = [
    "RECORDED",
    "Chessboard",
    "Defaults",
    "FirstFrames",
    "Grid",
    "Length",
    "Lens",
    "Level",
    "Lines",
    "Measured",
    "Method",
    "Network",
    "Point",
    "Range",
    "Ratio",
    "Readings",
    "RecordedChain",
    "Rectangle",
    "Report",
    "SensedMotion",
    "Sensor",
    "Session",
    "SessionChain",
    "Sfm",
    "Sgr",
    "Site",
    "View",
    "camera_tags",
    "file_hash",
    "find_reference_frames",
    "input_files",
    "lens_from_exif",
    "open_views",
    "picture_of",
    "pixel_aspect",
    "quiet_frames",
    "read_defaults",
    "read_session",
    "session_hash",
    "tags_from_exif",
    "write_session",
]
