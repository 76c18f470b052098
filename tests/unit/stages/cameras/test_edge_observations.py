"""Edges of the structure in the adjustment: which belong to an axis, what they tell, and who is named when they lie."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import measurements as m
from simulation import SIZE, intrinsics, project_all
from structure_edges import draw_directions, draw_edges
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Lines, Site
from vfm_sdm.stages.cameras.edge_axes import find_edge_axes
from vfm_sdm.stages.cameras.edge_errors import edge_errors
from vfm_sdm.stages.cameras.edge_groups import group_edges
from vfm_sdm.stages.cameras.site_lines import EdgeResiduals
from vfm_sdm.stages.matching.straight_edges import StraightEdges

AXES = structure_from_cam1(np.radians(50.0), pitch_rad=np.radians(4.0), roll_rad=np.radians(-2.0))
CAMERA = Camera(intrinsics(4000.0), SIZE)
BESIDE = CAMERA.perturbed([0, 0, 0, 0, 0.01, 0.08, 0.02, -3.0, 0.1, 0.3])
RIG = Rig(("left", "right"), (CAMERA, BESIDE), True)

FIXED = {"focal_std": 0.05, "focal_errors": (0.05, 0.04), "distortion_std": 0.025, "distortion_errors": (0.02, -0.02)}
FIXED |= {"range_std": None, "length_std": None, "duration_s": 0.5, "focal_px": 3500.0}


def solve(seed, *, lines=True, distances=True, square_deg=1.0, true_deg=None, **fixed):
    """Cameras of a drawn site with its edges, and the truth."""
    rng, noise, bridge = (np.random.default_rng([seed, stream]) for stream in range(3))
    c = replace(m.draw_conditions(rng), **FIXED | fixed)
    rig, frame, pitch = m._true_rig(c, noise)
    points3d = m._place_points(rig, frame, c, noise)
    clicked = project_all(rig, points3d) + noise.normal(0, 0.5, (2, len(points3d), 2))
    session = m._session(c, rig, points3d, clicked, pitch, "none")
    along = draw_directions(bridge, square_deg) if true_deg is None else _lean(true_deg)
    edges = draw_edges(bridge, rig, along @ frame.rotation)
    update = {"lines": Lines(out_of_square_std_deg=square_deg) if lines else None}
    if not distances:
        update |= {"perpendicular_distance": None, "longitudinal_distance": None}
    session = session.model_copy(update={"site": session.site.model_copy(update=update)})
    return m._solve(c, session, rig, clicked, noise, edges), rig, frame.rotation


def _lean(degrees):
    """Longitudinal edges that rise by an angle."""
    along = np.eye(3)
    along[2, 1] = np.tan(np.radians(degrees))
    return along


def test_an_edge_that_leads_to_its_vanishing_point_has_no_error_whatever_the_lens():
    lens = replace(CAMERA, distortion=np.array([-0.2, 0.1, 1e-3, 0, 0]))
    post = lens.project(np.array([2.0, 0.5, 20.0]) + np.outer([-1.5, -0.2, 1.5], AXES[1]))
    errors = edge_errors(post[None], lens, AXES[1])
    assert np.abs([errors.slope_px, errors.bow_px]).max() < 1e-6
    straight = edge_errors(post[None], CAMERA, AXES[1])
    assert np.abs(straight.bow_px[0]) > 0.01
    turned = edge_errors(post[None], lens, AXES[1] + 0.01 * AXES[2])
    assert abs(turned.slope_px[0]) > 1


def test_edges_of_other_directions_are_left_out_however_many():
    rng = np.random.default_rng(0)
    own = draw_edges(rng, RIG, AXES, members=(0, 40, 40), foreign=0)
    wires = draw_edges(rng, RIG, AXES + np.outer([0.0, 0.0, 0.06], AXES[1]), members=(0, 0, 30), foreign=60)
    both = [_join(a, b) for a, b in zip(own, wires, strict=True)]
    known = RIG.perturbed(np.concatenate([[0.03, *[0] * 9], [0.03, 0, 0, 0, 0.01, -0.02, 0.01, 0, 0, 0]]))
    groups = group_edges(both, known, Rotation.from_rotvec([0.01, 0.01, -0.01]).as_matrix() @ AXES)
    for group, mine in zip(groups, own, strict=True):
        right = group.rows < len(mine)
        assert right.mean() > 0.9
        assert np.array_equal(group.axis[right], np.where(group.rows[right] < 40, 1, 2))
        assert right.sum() > 40


def _join(a: StraightEdges, b: StraightEdges) -> StraightEdges:
    parts = (np.concatenate([getattr(a, n), getattr(b, n)]) for n in ("places", "slope_std_px", "bow_std_px"))
    return StraightEdges(a.view, *parts)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("angle_deg", [15.0, 50.0, 80.0])
def test_axes_are_found_from_edges_alone(side, angle_deg):
    axes = structure_from_cam1(np.radians(angle_deg), pitch_rad=np.radians(6), roll_rad=np.radians(-3), side=side)
    edges = draw_edges(np.random.default_rng(1), RIG, axes, members=(8, 40, 40), foreign=30)
    found = find_edge_axes(edges, RIG, Site(structure_side=side))
    assert np.degrees(Rotation.from_matrix(found.rotation @ axes.T).magnitude()) < 1.5
    unsaid = find_edge_axes(edges, RIG, Site())
    assert unsaid.side == side


def test_edges_without_order_give_no_axes():
    edges = draw_edges(np.random.default_rng(2), RIG, AXES, members=(0, 0, 0), foreign=15)
    assert find_edge_axes(edges, RIG, Site()) is None


def test_the_slant_of_members_is_found_from_what_is_left():
    edges = draw_edges(np.random.default_rng(3), RIG, AXES, members=(0, 80, 80), foreign=10, slant_deg=0.4)
    residuals = EdgeResiduals(group_edges(edges, RIG, AXES), RIG, AXES)
    residuals.weigh(RIG, AXES)
    # Shared by both views it is stated as for one: between the true one and that over the square root of two.
    assert 0.2 < np.degrees(residuals.noise.slant_rad) < 0.5
    left = residuals.residuals(RIG, AXES)
    assert 0.3 < np.sqrt(np.sum(left[left != 0] ** 2) / len(left[left != 0])) < 1.2


def test_edges_narrow_focal_lengths_and_distortion_and_their_intervals_hold():
    without, rig, _ = solve(5, lines=False)
    with_edges, _, _ = solve(5)
    for index, place in ((0, 0), (0, 3), (1, 10), (1, 13)):
        std = [np.sqrt(one.rig.covariance[place, place]) for one in (without, with_edges)]
        assert std[1] < 0.8 * std[0]
        found, true = with_edges.rig.cameras[index], rig.cameras[index]
        error = np.log(found.focal_px / true.focal_px) if place % 10 == 0 else found.distortion[0] - true.distortion[0]
        assert abs(error) < 3 * std[1]
    assert any(note.startswith("straight edges used:") for note in with_edges.notes)


def test_axes_come_from_edges_where_nobody_measured_the_distances():
    without, _, _ = solve(6, lines=False, distances=False)
    assert without.frame is None
    found, _, truth = solve(6, distances=False)
    error = Rotation.from_matrix(found.frame.rotation @ truth.T).as_rotvec()
    std = np.sqrt(np.diag(found.frame.covariance))
    assert np.all(np.abs(error) < 3 * std)
    assert np.degrees(std.max()) < 2.0
    assert any("the axes come from them" in note for note in found.notes)


@pytest.mark.parametrize("anew", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_structure_that_is_not_square_is_named(monkeypatch, anew):
    if not anew:
        # By the linear test at the one solution, without every alternative solved anew.
        monkeypatch.setattr(m, "explain_contradiction", lambda stated, adjusted: adjusted)
    right = {"focal_std": 0.003, "focal_errors": (0.001, -0.001), "level_std": 0.1, "level_errors": (0.0, 0.0)}
    found, _, _ = solve(7, square_deg=0.1, true_deg=3.0, **right)
    assert found.suspects
    assert found.suspects[0].name == "angle between vertical and longitudinal edges"
    assert "out_of_square_std_deg" in found.suspects[0].advice


def test_a_square_structure_is_not_doubted():
    right = {"focal_std": 0.003, "focal_errors": (0.001, -0.001), "level_std": 0.1, "level_errors": (0.0, 0.0)}
    found, _, _ = solve(7, square_deg=0.1, true_deg=0.0, **right)
    assert not found.suspects
