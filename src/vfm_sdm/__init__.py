"""vfm-sdm: structural displacement in millimetres from two ordinary cameras and one measured length."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vfm_sdm.accelerometer import compute_reference
    from vfm_sdm.cameras.site import adjust_to_site
    from vfm_sdm.displacement import compute_displacement
    from vfm_sdm.evaluation import evaluate
    from vfm_sdm.geometry.camera import Camera, Rig
    from vfm_sdm.geometry.triangulation import triangulate
    from vfm_sdm.measurement import Measurement, measure
    from vfm_sdm.protocol import run_benchmark
    from vfm_sdm.refinement import refine
    from vfm_sdm.results import read_displacement, read_tracks
    from vfm_sdm.session import Session, read_session, write_session
    from vfm_sdm.synthetic.field_test import make_field_test
    from vfm_sdm.tracking.base import find_tracker
    from vfm_sdm.video import open_images, open_video

__version__ = "0.1.0"
__all__ = [
    "Camera",
    "Measurement",
    "Rig",
    "Session",
    "__version__",
    "adjust_to_site",
    "compute_displacement",
    "compute_reference",
    "evaluate",
    "find_tracker",
    "make_field_test",
    "measure",
    "open_images",
    "open_video",
    "read_displacement",
    "read_session",
    "read_tracks",
    "refine",
    "run_benchmark",
    "triangulate",
    "write_session",
]

_HOMES = {
    "Camera": "geometry.camera",
    "Measurement": "measurement",
    "Rig": "geometry.camera",
    "Session": "session",
    "adjust_to_site": "cameras.site",
    "compute_displacement": "displacement",
    "compute_reference": "accelerometer",
    "evaluate": "evaluation",
    "find_tracker": "tracking.base",
    "make_field_test": "synthetic.field_test",
    "measure": "measurement",
    "open_images": "video",
    "open_video": "video",
    "read_displacement": "results",
    "read_session": "session",
    "read_tracks": "results",
    "refine": "refinement",
    "run_benchmark": "protocol",
    "triangulate": "geometry.triangulation",
    "write_session": "session",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when first asked for, so that ``import vfm_sdm`` costs nothing."""
    if name in _HOMES:
        return getattr(import_module(f"vfm_sdm.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'vfm_sdm' has no attribute {name!r}")
