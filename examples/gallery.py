"""What the examples share: the demonstration's recording, made and measured once, and the look of the figures.

The recording takes a minute to film. It is kept in the folder that the variable ``VFM_SDM_EXAMPLES`` names, or else in
``vfm-sdm-examples`` among the temporary files, with its run folder beside it: whoever measures it again gets what is
there.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vfm_sdm import Camera, Session, read_displacement, read_session
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.studies.synthetic.field_test import make_demo

# The palette of Okabe and Ito, which stays distinguishable with colour-blindness and in grey.
BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"
INK, GREY, PALE = "#222222", "#767676", "#E4E4E4"
AXIS_COLOURS = {"lateral": BLUE, "vertical": VERMILION, "longitudinal": GREEN}
POINT = "1/2 span"


def folder() -> Path:
    """Folder that all examples share."""
    named = os.environ.get("VFM_SDM_EXAMPLES")
    return Path(named) if named else Path(tempfile.gettempdir()) / "vfm-sdm-examples"


def run_folder() -> Path:
    """Run folder of the measurement as the session notes it."""
    return folder() / "run"


def demo_session() -> Session:
    """Session of the demonstration: two cameras film a footbridge for three seconds, at rest for the first 0.4 s."""
    path = folder() / "recording" / "session.toml"
    return read_session(path if path.exists() else make_demo(path.parent))


def true_displacement() -> xr.Dataset:
    """What the structure of the demonstration really did, a displacement dataset (T, P, 3) [mm]."""
    return read_displacement(demo_session().folder / "truth.nc")


def new_figure(width: float = 9.0, height: float = 5.0) -> Figure:
    """An empty figure with room between its parts."""
    figure = Figure(figsize=(width, height), dpi=150, layout="constrained", facecolor="white")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08, wspace=0.04, hspace=0.04)
    return figure


def finish(axes: Axes, title: str = "", *, grid: str = "y") -> Axes:
    """Axes without what tells nothing: no box, a pale grid, the title at the left."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(colors=INK, labelsize=8)
    axes.xaxis.label.set_size(9)
    axes.yaxis.label.set_size(9)
    axes.set_axisbelow(True)
    if grid:
        axes.grid(axis=grid, color=PALE, linewidth=0.8)
    if title:
        axes.set_title(title, loc="left", fontsize=10, color=INK)
    return axes


def headline(figure: Figure, text: str) -> None:
    """What the figure says, in one sentence above it."""
    figure.suptitle(text, x=0.01, ha="left", fontsize=11.5, fontweight="bold", color=INK)


def rms(values: npt.ArrayLike) -> float:
    """Root mean square of the known values."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def save(figure: Figure, script: str) -> Path:
    """Writes the figure of ``plot_NAME.py`` as ``NAME.png``, to the folder on the command line or a temporary one."""
    target = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
    target.mkdir(parents=True, exist_ok=True)
    path = target / f"{Path(script).stem.removeprefix('plot_')}.png"
    figure.savefig(path)
    print(f"written: {path}")
    return path


def simulated_tracks(
    time_s: npt.ArrayLike, points3d: npt.ArrayLike, camera: Camera, view: str, *, noise_px: float, seed: int
) -> xr.Dataset:
    """Tracks of points that a camera sees, with white noise of the standard deviation that they state.

    Parameters
    ----------
    time_s
        Time stamps, shape (T,) [s].
    points3d
        Places of the points in every frame, shape (T, P, 3), in the frame of the camera's pose [m].
    camera, view
        The camera and its name.
    noise_px
        Standard deviation along u and v [px].
    seed
        Of the noise.
    """
    exact = camera.project(np.asarray(points3d, float))
    noise = np.random.default_rng(seed).normal(0, noise_px, exact.shape)
    covariance = np.broadcast_to(noise_px**2 * np.eye(2), (*exact.shape, 2))
    names = [f"point {number + 1}" for number in range(exact.shape[1])]
    width, height = camera.image_size
    attrs = {"tracker": "simulated", "view": view, "image_width": width, "image_height": height}
    return make_tracks(time_s, names, exact + noise, covariance, np.zeros(exact.shape[:2], int), attrs=attrs)
