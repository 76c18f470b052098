"""vfm-sdm: structural displacement in millimetres from two ordinary cameras and one measured length."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vfm_sdm.analysis.evaluation import evaluate
    from vfm_sdm.core.netcdf import read_displacement, read_tracks
    from vfm_sdm.geometry.camera import Camera, Rig
    from vfm_sdm.geometry.triangulation import triangulate
    from vfm_sdm.inputs.sensors.accelerometer import compute_reference
    from vfm_sdm.inputs.session import Session, read_session, write_session
    from vfm_sdm.inputs.video import open_images, open_video
    from vfm_sdm.measurement import Measurement, measure
    from vfm_sdm.stages.cameras.site import adjust_to_site
    from vfm_sdm.stages.displacement.stereo import compute_displacement
    from vfm_sdm.stages.refinement import refine
    from vfm_sdm.stages.tracking.base import find_tracker
    from vfm_sdm.studies.protocol import run_benchmark
    from vfm_sdm.studies.synthetic.field_test import make_field_test

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
    "Session": "inputs.session",
    "adjust_to_site": "stages.cameras.site",
    "compute_displacement": "stages.displacement.stereo",
    "compute_reference": "inputs.sensors.accelerometer",
    "evaluate": "analysis.evaluation",
    "find_tracker": "stages.tracking.base",
    "make_field_test": "studies.synthetic.field_test",
    "measure": "measurement",
    "open_images": "inputs.video",
    "open_video": "inputs.video",
    "read_displacement": "core.netcdf",
    "read_session": "inputs.session",
    "read_tracks": "core.netcdf",
    "refine": "stages.refinement",
    "run_benchmark": "studies.protocol",
    "triangulate": "geometry.triangulation",
    "write_session": "inputs.session",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when first asked for, so that ``import vfm_sdm`` costs nothing."""
    if name in _HOMES:
        return getattr(import_module(f"vfm_sdm.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'vfm_sdm' has no attribute {name!r}")
