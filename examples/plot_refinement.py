"""Structural geometry refinement on simulated tracks: lateral displacement before and after, beside the truth.

The site, the motion and the noise are those of the virtual field test ``data-3``: the right view is the poorer one.

    python examples/plot_refinement.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vfm_sdm import Rig, compute_displacement, refine
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.studies.synthetic.presets import preset

NOISE_PX = {"left": 0.02, "right": 0.10}

# Where the point is, what it does, and what both cameras see of it.
plan = preset("data-3", "small")
time_s, point = plan.frame_times(0), plan.points[1]
moved_m = plan.motion.displacement(time_s, [point.position])  # (T, 1, 3)
cameras = plan.site.cameras()
rig = Rig.from_world(list(NOISE_PX), cameras, metric=True)
frame = StructureFrame(cameras[0].rotation.T)

rng = np.random.default_rng(3)
views = []
for camera, (view, std) in zip(cameras, NOISE_PX.items(), strict=True):
    seen = camera.project(np.array(point.position) + moved_m)
    covariance = np.broadcast_to(std**2 * np.eye(2), (len(time_s), 1, 2, 2))
    attrs = {"tracker": "simulated", "view": view, "image_width": 1920, "image_height": 1080}
    noisy = seen + rng.normal(0, std, seen.shape)
    views.append(make_tracks(time_s, [point.name], noisy, covariance, np.zeros((len(time_s), 1), int), attrs=attrs))
tracks = xr.concat(views, dim=xr.Variable("view", list(NOISE_PX)), combine_attrs="drop_conflicts")

still = (0.0, plan.still_s)
refinement = refine(tracks, rig, frame, still_interval_s=still)
truth_mm = 1e3 * moved_m[:, 0, 0]
figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.add_subplot(xlabel="time [s]", ylabel="lateral [mm]")
for label, of in (("without refinement", tracks), ("with refinement", refinement.tracks)):
    result = compute_displacement(of, rig, frame=frame, still_interval_s=still)
    lateral_mm = result["displacement"].sel(axis="lateral").values[:, 0]
    rms_mm = float(np.sqrt(np.mean((lateral_mm - truth_mm) ** 2)))
    axes.plot(time_s, lateral_mm, lw=0.9, label=f"{label}, RMS error {rms_mm:.3f} mm")
axes.plot(time_s, truth_mm, "k", lw=0.9, label="truth")
axes.set_title(f"{point.name}: {refinement.status[0]}, share of the prior {refinement.prior_share[0]:.2f}")
axes.legend()
folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
folder.mkdir(parents=True, exist_ok=True)
figure.savefig(folder / "refinement.png", dpi=120)
print(f"written: {folder / 'refinement.png'}")
