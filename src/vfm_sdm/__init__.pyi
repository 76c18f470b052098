# The public names of the package and where each of them lives: this file is the list that type checkers read, and the
# one from which `vfm_sdm` imports a name when it is first asked for.
from .analysis.evaluation import ReferenceClock as ReferenceClock
from .analysis.evaluation import evaluate as evaluate
from .core.netcdf import read_displacement as read_displacement
from .core.netcdf import read_tracks as read_tracks
from .geometry.camera import Camera as Camera
from .geometry.camera import Rig as Rig
from .geometry.triangulation import triangulate as triangulate
from .inputs.sensors.accelerometer import compute_reference as compute_reference
from .inputs.session import Session as Session
from .inputs.session import read_session as read_session
from .inputs.session import write_session as write_session
from .inputs.video import open_images as open_images
from .inputs.video import open_video as open_video
from .measurement import Measurement as Measurement
from .measurement import measure as measure
from .stages.cameras.site import adjust_to_site as adjust_to_site
from .stages.displacement.stereo import compute_displacement as compute_displacement
from .stages.refinement import refine as refine
from .stages.tracking.base import find_tracker as find_tracker
from .studies.protocol import run_benchmark as run_benchmark
from .studies.synthetic.field_test import make_field_test as make_field_test

__version__: str
