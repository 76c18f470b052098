"""Points on edges from tracks to budget, audit, tables and figures: what is measured counts, and nothing else."""

import csv
import warnings

import numpy as np
import pytest
import xarray as xr

from edge_scene import PLACES, RATE_HZ, make_edge_tracks, make_motion
from vfm_sdm.core.covariances import judged_std
from vfm_sdm.core.datasets import UNMEASURED_STD_PX, Status, make_tracks
from vfm_sdm.core.statuses import CameraMotionStatus, Outcome, RefinementStatus
from vfm_sdm.inputs.session import Session
from vfm_sdm.outputs.plots import save_figures
from vfm_sdm.outputs.results import summarize_displacement, write_displacement, write_export
from vfm_sdm.stages.audit.geometry import check_epipolar_level, check_epipolar_motion
from vfm_sdm.stages.audit.model import AuditInputs
from vfm_sdm.stages.audit.signal import check_refinement, check_signal
from vfm_sdm.stages.audit.tracks import check_camera_motion, check_frozen, check_slip, check_static_points
from vfm_sdm.stages.camera_motion import remove_camera_motion
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.monocular import compute_planar_displacement
from vfm_sdm.stages.displacement.result import state_uncertainty
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.refinement import refine
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.stages.tracking.track_noise import include_track_noise

FRAMES = 300
NAMES = list(PLACES)


@pytest.fixture(scope="module")
def motion():
    return make_motion(FRAMES)


@pytest.fixture(scope="module")
def scene(motion):
    return make_edge_tracks(motion)


@pytest.fixture(scope="module")
def measured(scene):
    """Displacement with its budget, of cameras that are known to 1 %."""
    tracks, rig, frame = scene
    aligned = tracks.assign(
        clock_offset_std=("view", [0.0, 1e-4]),
        bits_per_pixel=("view", [0.2, 0.2]),
    )
    covariance = np.zeros((23, 23))
    covariance[0, 0] = covariance[10, 10] = 0.01**2
    displacement = compute_displacement(tracks, rig, frame=frame, covariance=covariance)
    return state_uncertainty(displacement, displacement, aligned, (rig, frame), None, "longitudinal")


def session(**method):
    points = [{"name": name, "view": "left", "pixel": [100.0, 80.0 + k]} for k, name in enumerate(NAMES)]
    views = [{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4"}]
    return Session(name="b", view=views, site={"baseline": {"value": 4.0, "std": 0.01}}, point=points, method=method)


def test_one_clock_keeps_what_is_known_of_points(scene):
    tracks, _, _ = scene
    views = {str(v): tracks.sel(view=v, drop=True) for v in tracks["view"].values}
    aligned = align_views(views, {"right": 0.4 / RATE_HZ})
    np.testing.assert_array_equal(aligned["edge_across"].values, tracks["edge_across"].values)
    assert aligned["edge_across"].dims == ("view", "point", "pixel")


def test_scatter_across_an_edge_is_found_and_stated():
    """Noise of 0.05 px where 0.01 is stated, across an oblique edge; along it nothing is said."""
    rng = np.random.default_rng(0)
    across = np.array([0.28, 0.96])
    along = np.array([-0.96, 0.28])
    position = rng.normal(0, 0.05, (600, 1, 1)) * across
    covariance = np.tile(
        1e-4 * np.outer(across, across) + UNMEASURED_STD_PX**2 * np.outer(along, along), (600, 1, 1, 1)
    )
    tracks = make_tracks(np.arange(600) / 30, ["edge"], position, covariance, np.zeros((600, 1)), attrs={})
    raised = include_track_noise(tracks.assign(edge_across=(("point", "pixel"), across[None])))
    stated = raised["position_covariance"].values
    assert np.sqrt(across @ stated @ across).mean() == pytest.approx(0.05, rel=0.15)
    np.testing.assert_allclose(along @ stated @ along, UNMEASURED_STD_PX**2, rtol=1e-6)
    assert judged_std(stated, across[None]).max() < 0.1


def test_the_budget_of_a_measured_axis_is_whole(measured, motion):
    flange = measured.sel(point="flange")
    vertical = flange["combined_std"].sel(axis="vertical").values
    assert np.isfinite(vertical).all()
    assert np.isnan(flange["combined_std"].sel(axis="longitudinal")).all()
    parts = flange["uncertainty"].sel(axis="vertical").std("time")
    assert (parts.sel(component=["cameras", "synchronization", "compression"]) > 0).all()
    error = flange["displacement"].sel(axis="vertical").values - motion[:, 0, 1]
    assert np.mean(np.abs(error - error.mean()) < 1.96 * vertical) > 0.9
    assert np.isnan(measured["gain_difference"].sel(point=["flange", "post"])).all()


def test_refinement_leaves_edges_alone_and_says_so(scene, measured):
    tracks, rig, frame = scene
    refinement = refine(tracks, rig, frame)
    assert refinement.status == (RefinementStatus.EDGE, RefinementStatus.EDGE, "ok", "ok")
    edges = refinement.tracks["position"].sel(point=["flange", "post"])
    np.testing.assert_array_equal(edges.values, tracks["position"].sel(point=["flange", "post"]).values)
    refined = compute_displacement(refinement.tracks, rig, frame=frame, refinement_gain=refinement.gain)
    assert np.isfinite(refined["displacement"].sel(point="flange", axis="vertical")).all()
    status = np.array([str(s) for s in refinement.status], dtype=object)
    inputs = AuditInputs(
        session=session(refinement="sgr"), displacement=measured.assign(refinement_status=("point", status))
    )
    assert check_refinement(inputs).outcome == Outcome.PASS


def test_the_audit_looks_at_what_is_measured(scene, measured):
    tracks, rig, frame = scene
    views = {str(v): tracks.sel(view=v, drop=True) for v in tracks["view"].values}
    nowhere = xr.Dataset(coords={"view": []})
    cameras = CameraSolution(rig=rig, frame=frame, status="ok", covariance=None, points=nowhere, epipolar_rms_px=0.1)
    inputs = AuditInputs(
        session=session(), cameras=cameras, tracks=views, aligned=tracks, displacement=measured, unrefined=measured
    )
    # Along the flange, the right view's place is 4 px from the left one's; that is no wrong point.
    for check in (check_epipolar_level, check_epipolar_motion, check_slip, check_frozen):
        assert check(inputs).outcome == Outcome.PASS, check.__name__
    found = check_signal(inputs)
    assert np.isfinite(found.value)
    for axis in ("vertical of post", "lateral of flange", "longitudinal of flange"):
        assert axis not in found.sentence
    motion_px = dict(zip(inputs.moving, inputs.motion_px("left"), strict=True))
    assert motion_px["flange"] == pytest.approx(motion_px["bolts"], rel=0.4)


def test_a_frozen_edge_is_found(scene, measured):
    tracks, _, _ = scene
    views = {str(v): tracks.sel(view=v, drop=True).copy(deep=True) for v in tracks["view"].values}
    views["right"]["position"][150:, 0] = views["right"]["position"][150, 0]
    inputs = AuditInputs(session=session(), tracks=views, aligned=tracks, displacement=measured)
    found = check_frozen(inputs)
    assert found.outcome == Outcome.FAIL
    assert found.where == "flange in right"


def test_static_edges_hide_no_moving_tripod(scene, measured):
    """Points that do not move beside one on an edge: the camera's motion shows in the former."""
    tracks, _, _ = scene
    shaken = {str(v): tracks.sel(view=v, drop=True).copy(deep=True) for v in tracks["view"].values}
    static = session()
    for point in static.point:
        object.__setattr__(point, "static", point.name in ("flange", "paint"))
    inputs = AuditInputs(
        session=static, tracks=shaken, aligned=tracks, displacement=measured, unrefined=measured, camera_motion={}
    )
    assert check_camera_motion(inputs).outcome == Outcome.FAIL
    assert check_static_points(inputs).outcome == Outcome.FAIL


def test_static_edges_help_to_steady_a_camera():
    """Two points and two edges stand still before a camera that pans and tilts."""
    tracks, rig, _ = make_edge_tracks(0 * make_motion(FRAMES))
    shake = 0.8 * np.sin(np.arange(FRAMES) / 4)[:, None] * [1.0, 0.5]
    views = {str(v): tracks.sel(view=v, drop=True).copy(deep=True) for v in tracks["view"].values}
    left = views["left"]
    moved = left["position"].values + shake[:, None]
    across = left["edge_across"].values
    held = left["position"].values + np.einsum("tk,pk->tp", shake, np.nan_to_num(across))[..., None] * across
    left["position"].values[:] = np.where(np.isfinite(across), held, moved)
    steady = remove_camera_motion(views, rig, NAMES)
    assert steady.views["left"].status == CameraMotionStatus.OK
    still = steady.tracks["left"]["position"].sel(point="bolts").std("time")
    assert float(still.max()) < 0.1


def test_tables_and_figures_show_dashes_for_open_axes(measured, scene, tmp_path):
    tracks, _, _ = scene
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_displacement(tmp_path, measured)
        for name in ("mat", "uff"):
            write_export(name, tmp_path, measured)
        views = {str(v): tracks.sel(view=v, drop=True) for v in tracks["view"].values}
        assert save_figures(tmp_path, views, measured, {}, {})
    rows = list(csv.DictReader((tmp_path / "displacement.csv").open()))
    assert rows[5]["flange longitudinal [mm]"] == ""
    assert float(rows[5]["flange vertical std [mm]"]) > 0
    axes = summarize_displacement(measured)["flange"]["axes"]
    assert axes["longitudinal"]["peak_to_peak_mm"] is None
    assert axes["vertical"]["peak_to_peak_mm"] > 3
    assert axes["vertical"]["expanded_uncertainty_mm"] > 0


def test_one_view_measures_an_edge_across():
    across = np.array([[0.05, np.sqrt(1 - 0.05**2)]])
    along = np.array([-across[0, 1], across[0, 0]])
    moved = np.sin(np.arange(90) / 5)
    covariance = np.tile(1e-4 * np.outer(across, across) + UNMEASURED_STD_PX**2 * np.outer(along, along), (90, 1, 1, 1))
    position = 100 + moved[:, None, None] * across
    tracks = make_tracks(np.arange(90) / 30, ["flange"], position, covariance, np.zeros((90, 1)), attrs={})
    tracks = tracks.assign(edge_across=(("point", "pixel"), across))
    found = compute_planar_displacement(tracks, mm_per_px=3.0, scale_std=0.01)
    assert np.isnan(found["displacement"].sel(axis="right")).all()
    np.testing.assert_allclose(found["displacement"].sel(axis="down").values[:, 0], 3 * moved, atol=0.02)
    assert found["displacement_std"].sel(axis="down").max() == pytest.approx(0.05 * 30, rel=0.01)
    assert (found["status"] == Status.OK).all()
    assert isinstance(found, xr.Dataset)
