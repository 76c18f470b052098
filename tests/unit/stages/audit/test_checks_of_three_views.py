"""Checks of three views: which of them, or which two, are at fault."""

import numpy as np
import pytest

from simulation import project_all, simple_rig
from vfm_sdm.core.datasets import Status, make_points, make_tracks
from vfm_sdm.core.statuses import CameraStatus, Outcome
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit.geometry import check_agreement, check_epipolar_level, check_epipolar_motion, check_site
from vfm_sdm.stages.audit.model import AuditInputs
from vfm_sdm.stages.audit.tracks import check_camera_motion, check_frozen, check_static_points, check_tracked
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.agreement import compute_gain_difference
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.synchronize import align_views

RIG = simple_rig(3)
FRAME = StructureFrame(structure_from_cam1(0.42, pitch_rad=0.03))
CLOCK = np.arange(120) / 30
NAMES = ("p", "q", "s", "t")
PLACES = np.array([[0.5, -0.2, 21.0], [-1.5, 0.3, 25.0], [1.0, 0.5, 24.0], [-0.7, 0.6, 19.0]])
CHECKS = (
    check_agreement,
    check_camera_motion,
    check_epipolar_level,
    check_epipolar_motion,
    check_frozen,
    check_static_points,
    check_tracked,
)


def pixels() -> np.ndarray:
    """Two points that move and two that do not, with a little noise; shape (V, T, P, 2) [px]."""
    waves = [5 * np.sin(2 * np.pi * 1.4 * CLOCK), 12 * np.sin(2 * np.pi * 2.2 * CLOCK), 0 * CLOCK]
    motion = np.array(waves).T[:, None] * np.array([1, 1, 0, 0])[:, None]
    u = project_all(RIG, PLACES + (motion / 1e3) @ FRAME.rotation)
    return u + np.random.default_rng(0).normal(0, 0.005, u.shape)


def inputs_of(u: np.ndarray, *, status: str = "ok") -> AuditInputs:
    """A measurement of these pixels; NaN is lost."""
    covariance = np.broadcast_to(0.005**2 * np.eye(2), (*u.shape[1:], 2))
    tracks = {
        name: make_tracks(CLOCK, NAMES, own, covariance, np.where(np.isnan(own[..., 0]), Status.LOST, 0), attrs={})
        for name, own in zip(RIG.names, u, strict=True)
    }
    aligned = align_views(tracks)
    session = Session(
        name="three",
        site={"baseline": {"value": 4.0, "std": 0.01}},
        view=[{"name": name, "video": f"{name}.mp4"} for name in RIG.names],
        point=[{"name": n, "view": RIG.names[0], "pixel": [9.0, 9.0], "static": n in ("s", "t")} for n in NAMES],
    )
    points = make_points(
        RIG.names, NAMES, position=u[:, 0], position_std=np.zeros((3, 4, 2)), status=np.full((3, 4), "ok", object)
    )
    displacement = compute_displacement(aligned, RIG, frame=FRAME)
    difference = compute_gain_difference(aligned, displacement, RIG, FRAME)
    displacement = displacement.assign(gain_difference=("point", difference))
    solution = CameraSolution(RIG, FRAME, None, points, status=status)
    return AuditInputs(
        session=session,
        cameras=solution,
        tracks=tracks,
        aligned=aligned,
        displacement=displacement,
        unrefined=displacement,
        camera_motion={},
    )


@pytest.mark.parametrize("check", CHECKS)
def test_nothing_is_wrong(check):
    assert check(inputs_of(pixels())).outcome == Outcome.PASS


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("view", [0, 1, 2])
def test_a_point_that_one_view_does_not_see_is_no_fault(check, view):
    """A moving point is hidden for a second, a static one is never seen by this view."""
    u = pixels()
    u[view, 40:70, 0] = np.nan
    u[view, :, 2] = np.nan
    assert check(inputs_of(u)).outcome == Outcome.PASS


@pytest.mark.parametrize("view", [0, 1, 2])
def test_another_place_in_one_view_is_found_whichever_it_is(view):
    u = pixels()
    u[view, :, 1] += [0.0, 40.0]
    check = check_epipolar_level(inputs_of(u))
    assert check.outcome == Outcome.FAIL
    assert check.where.startswith("q in ")
    assert RIG.names[view] in check.where


def test_a_track_that_moves_differently_is_named_with_its_views():
    """Seen by the second and third view only, so that no pair with the first one could show it."""
    u = pixels()
    u[0, :, 1] = np.nan
    u[2, :, 1, 1] += 1.5 * np.sin(2 * np.pi * 0.9 * CLOCK)
    check = check_epipolar_motion(inputs_of(u))
    assert check.outcome != Outcome.PASS
    assert check.where == "q in view 1 and view 2"


def test_a_view_that_shows_less_is_found():
    u = pixels()
    rest = u[2, :, 0].mean(axis=0)
    u[2, :, 0] = rest + 0.85 * (u[2, :, 0] - rest)
    check = check_agreement(inputs_of(u))
    assert (check.outcome, check.where) == (Outcome.CAUTION, "p")
    assert check.value == pytest.approx(0.16, abs=0.03)


def test_a_camera_that_moves_is_found_by_the_static_points_that_it_sees():
    u = pixels()
    u[2, :, 3] = np.nan
    u[2] += 1.5 * np.sin(2 * np.pi * 0.5 * CLOCK)[:, None, None]
    check = check_camera_motion(inputs_of(u))
    assert check.outcome != Outcome.PASS
    assert check.where == RIG.names[2]


def test_a_camera_whose_distance_nobody_knows_is_a_failure():
    assert check_site(inputs_of(pixels(), status=CameraStatus.UNKNOWN_DISTANCE)).outcome == Outcome.FAIL
