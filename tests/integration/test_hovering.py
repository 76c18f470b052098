"""Two cameras that hover by half a metre and two degrees, rendered, filmed and measured as anyone would."""

from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm import Measurement, Session
from vfm_sdm.core.statuses import Outcome, Verdict
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.stages.cameras.file import write_rig
from vfm_sdm.studies.synthetic.hovering import HOVERING_POINTS, STATIC_POINTS, Hover, HoveringSite, film_hovering
from vfm_sdm.studies.synthetic.recording import write_video

FRAMES, FPS = 44, 20
SITE = HoveringSite(focal_px=1730.0, image_size=(640, 480))
STD = dict.fromkeys(CAMERA_PARAMETERS, 0.0) | {"log_focal": 0.002, "cx": 1.0, "cy": 1.0, "k1": 0.002}
FURTHER = STD | dict.fromkeys(("rx", "ry", "rz"), 5e-4) | dict.fromkeys(("tx", "ty", "tz"), 0.01)


def girder_m():
    """Displacement along the girder, down and away, shape (T, 3) [m]."""
    time_s = np.arange(FRAMES)[:, None] / FPS
    return np.array([1.0, 3.0, 1.5]) / 1e3 * np.sin(2 * np.pi * time_s * [1.1, 2.3, 1.7])


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drones")
    rig, places = SITE.rig(), np.array(list(HOVERING_POINTS.values()))
    covariance = np.diag(np.square([*STD.values(), *FURTHER.values()]))
    known = Rig.from_world(rig.names, rig.cameras, metric=True)
    write_rig(folder / "cameras.toml", replace(known, covariance=covariance))
    scene, views = SITE.scene(), []
    options = {"crf": "4", "preset": "veryfast", "tune": "grain", "threads": "1"}
    for number, (view, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        frames = film_hovering(scene, camera, Hover(seed=number + 5), girder_m(), fps=FPS)
        video = write_video(folder / f"{view}.mp4", frames, fps=FPS, options=options)
        views.append({"name": view, "video": video, "camera": folder / "cameras.toml"})
    pixels = [camera.project(places).tolist() for camera in rig.cameras]
    points = [
        {"name": name, "view": "left", "pixel": left, "pixel_in": {"right": right}, "static": name in STATIC_POINTS}
        for name, left, right in zip(HOVERING_POINTS, *pixels, strict=True)
    ]
    method = {"cameras": "file", "synchronization": "none", "refinement": "none", "subset_px": 41, "injection": False}
    return Measurement(Session(name="drones", folder=folder, view=views, point=points, method=method))


@pytest.mark.slow
def test_hovering_cameras_measure_to_a_tenth_of_a_millimetre_at_twenty_metres(measured):
    moving = measured.displacement.isel(point=slice(0, 3))
    error = moving["displacement"].values @ SITE.rig().cameras[0].rotation - 1e3 * girder_m()[:, None]
    error -= error.mean(axis=0)
    assert (np.sqrt(np.mean(error**2, axis=(0, 1))) < 0.1).all()  # a pixel is 11.6 mm
    assert measured.displacement["camera_motion_status"].values.tolist() == ["followed", "followed"]


@pytest.mark.slow
def test_the_audit_says_that_the_cameras_moved_far(measured):
    checks = {check.name: check for check in measured.audit.checks}
    assert measured.audit.verdict == Verdict.CARE
    assert checks["tripods"].outcome == Outcome.CAUTION
    assert "moved far" in checks["tripods"].sentence
    for name in ("static points", "halves of a subset", "stabilised video", "samples missing"):
        assert checks[name].outcome == Outcome.PASS, checks[name].sentence
