"""Right and wrong focal lengths stated for real pairs: the scale is in its interval, or nobody calls it fit to use."""

import json
from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.core.statuses import CameraStatus, Verdict
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Measured, Method, Point, Session, Site
from vfm_sdm.measurement import measure
from vfm_sdm.stages.audit.lenses import find_unseen_lens_error
from vfm_sdm.stages.cameras.solve import solve_cameras
from vfm_sdm.stages.cameras.two_view import TwoViewCameras
from vfm_sdm.stages.matching.base import FeatureMatches

NORMAL_95, LIMIT = 1.96, 0.05
WRONG_AND_STATED = [(wrong, 0.02) for wrong in (0.75, 0.9, 1.0, 1.1, 1.25)]
WRONG_AND_STATED += [(0.9, 0.1), (1.1, 0.1), (0.75, 0.25), (1.25, 0.25)]
"""What a focal length is noted as, over the true one, and the standard deviation that is noted for it [1]."""
MATLAB_ORIGIN = 1.0
VIEWS = ("cam1", "cam2")
CYLINDER_FOCAL_PX, CYLINDER_MM = 2615.0, 1.878


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "stated"), WRONG_AND_STATED)
def test_a_cylinder(shared_data, wrong, stated):
    lens = {"focal_px": wrong * CYLINDER_FOCAL_PX, "relative_std": stated}
    session = Session(
        name="cylinder",
        folder=shared_data("multidic_cylinder"),
        view=[{"name": n, "images": f"speckled/{n}_*.jpg", "fps": 1.0, "lens": lens} for n in ("201", "202")],
        site=Site(baseline=Measured(value=0.18013, std=0.0005)),
        point=[Point(name=f"p{u}", view="201", pixel=(u, 1640.0)) for u in (1230.0, 1290.0, 1350.0)],
        method=Method(synchronization="none"),
    )
    result = measure(session)
    moved = np.linalg.norm(result.displacement["displacement"].values[-1], axis=-1)
    error = float(1 - CYLINDER_MM / moved.mean())
    std = float(result.displacement["scale_std"].values.max())
    assert abs(error) <= NORMAL_95 * std or (is_false(wrong, stated) and result.audit.verdict != Verdict.FIT)


def is_false(wrong, stated):
    """Whether what is stated of a lens excludes what is true."""
    return abs(np.log(wrong)) > NORMAL_95 * stated


class Told:
    """Pixels of the same places in both pictures, from another program."""

    def __init__(self, first, second):
        self.pixels = first, second

    def match(self, images):
        return {(0, 1): FeatureMatches(*self.pixels, np.ones(len(self.pixels[0])))}


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "stated"), WRONG_AND_STATED)
def test_a_rubber_strip(shared_data, wrong, stated):
    folder = shared_data("duodic_uniaxial")
    tracks = np.load(folder / "tracks_and_reference_3d.npz")
    pixels = np.stack([tracks["cam1"], tracks["cam2"]], axis=1) - MATLAB_ORIGIN
    pixels = pixels[:, :, np.isfinite(pixels).all(axis=(0, 1, 3))]
    rig = _calibrated(json.loads((folder / "matlab_stereo_calibration.json").read_text()))
    lens = {"focal_px": wrong * rig.cameras[0].focal_px, "relative_std": stated}
    told = np.linspace(0, pixels.shape[2] - 1, 24).astype(int)
    session = Session(
        name="strip",
        view=[{"name": n, "video": f"{n}.mp4", "lens": lens} for n in VIEWS],
        site=Site(baseline=Measured(value=rig.baseline(), std=0.0005)),
        point=[
            Point(
                name=f"p{i}", view=VIEWS[0], pixel=tuple(pixels[0, 0, i]), pixel_in={VIEWS[1]: tuple(pixels[0, 1, i])}
            )
            for i in told
        ],
        method=Method(synchronization="none"),
    )
    grey = np.random.default_rng(0).integers(100, 150, (2048, 2448)).astype(np.uint8)
    solution = solve_cameras(session, dict.fromkeys(VIEWS, grey), TwoViewCameras(features=Told(*pixels[0])))
    moved = pixels[[0, -1]][:, :, told[-1]].transpose(1, 0, 2)
    true, found = (np.diff(triangulate(moved, one), axis=0)[0] for one in (rig, solution.rig))
    error = float(1 - np.linalg.norm(true) / np.linalg.norm(found))
    # The strip was pulled along the pictures' rows.
    sensitivity = compute_gain_sensitivity(moved[:, :1], solution.rig)
    std = float(compute_gain_std(sensitivity, np.eye(3), solution.covariance)[0, 0, 0])
    unseen = find_unseen_lens_error(solution, np.pad(sensitivity[0, :, 0, 0], (0, 3)))
    flagged = solution.status != CameraStatus.OK or max(2 * std, unseen) > LIMIT
    assert abs(error) <= NORMAL_95 * std or (is_false(wrong, stated) and flagged)


def _calibrated(stored):
    """The calibration that is stored with the data [px, m], first pixel centre at (0, 0)."""
    cameras = []
    for name in ("camera1", "camera2"):
        K = np.array(stored[name]["K"])
        K[:2, 2] -= MATLAB_ORIGIN
        cameras.append(Camera(K, tuple(stored["image_size_wh"]), np.array([*stored[name]["dist_k1_k2_p1_p2"], 0.0])))
    pose = np.column_stack([stored["R"], np.array(stored["t_mm"]) * 1e-3])
    return Rig(VIEWS, (cameras[0], replace(cameras[1], cam_from_world=pose)), True)
