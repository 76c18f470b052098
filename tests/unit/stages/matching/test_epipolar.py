"""Epipolar lines with the width that the cameras' covariance gives them."""

import numpy as np
import pytest

from simulation import intrinsics, looking_at
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.epipolar import camera_steps, epipolar_band

SIZE = (640, 480)
STD = np.array([0.0] * 10 + [0.01, 2.0, 2.0, 0.01, 2e-3, 2e-3, 2e-3, 0.01, 0.01, 0.01])


def rig(covariance=None):
    target = np.array([0.0, 0.0, 12.0])
    cameras = [
        Camera(intrinsics(900.0, SIZE), SIZE, cam_from_world=looking_at(np.array(center), target))
        for center in ((0.0, 0.0, 0.0), (3.0, 0.4, -1.0))
    ]
    return (
        Rig.from_world(("left", "right"), cameras, metric=True)
        if covariance is None
        else Rig(("left", "right"), rig().cameras, True, covariance)
    )


POINT = np.array([350.0, 220.0])


def place(cameras, depth):
    first, second = cameras
    return second.project(np.append(first.normalize(POINT), 1.0) * depth)


def test_exact_cameras_leave_a_few_pixels():
    band = epipolar_band(POINT, rig(np.zeros((20, 20))), (0, 1), (8.0, 16.0))
    on = place(rig().cameras, 11.0)
    along = place(rig().cameras, 11.1) - on
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    assert band.holds(np.stack([on, on + 3 * across, on - 3 * across])).all()
    assert not band.holds(np.stack([on + 7 * across, on - 7 * across])).any()
    far = place(rig().cameras, 1000.0)
    assert not band.holds(far[None] + 60 * along / np.linalg.norm(along))[0]


def test_the_width_is_that_of_lines_of_cameras_drawn_from_their_covariance():
    known = rig(np.diag(STD**2))
    band, rng = epipolar_band(POINT, known, (0, 1), (8.0, 16.0)), np.random.default_rng(0)
    line = place(known.cameras, 10.6667)
    along = place(known.cameras, 10.7) - line
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    drawn = [place(known.perturbed(rng.normal(0, 1, 20) * STD).cameras, 10.6667) for _ in range(400)]
    spread = np.std((np.array(drawn) - line) @ across)
    assert band.half_width == pytest.approx(4 * np.hypot(spread, 1.0), rel=0.1)
    assert band.holds(np.array(drawn)).mean() > 0.99


def test_large_covariances_stay_finite_and_unknown_ones_are_wide():
    vague = epipolar_band(POINT, rig(np.diag((100 * STD) ** 2)), (0, 1), (8.0, 16.0))
    sharp = epipolar_band(POINT, rig(np.diag(STD**2)), (0, 1), (8.0, 16.0))
    assert np.isfinite(vague.half_width)
    assert vague.half_width == pytest.approx(100 * np.sqrt(sharp.half_width**2 - 16), rel=0.05)
    steps = camera_steps(rig(np.diag((100 * STD) ** 2)), (0, 1))
    assert max(length for _, length in steps) < 1
    assert epipolar_band(POINT, rig(), (0, 1), (8.0, 16.0)).half_width > 20


def test_a_line_that_the_second_camera_does_not_see_holds_nothing():
    band = epipolar_band(POINT, rig(), (0, 1), (-16.0, -8.0))
    assert not band.holds(np.array([[320.0, 240.0]])).any()
