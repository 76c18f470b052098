"""The site drawn to scale: places are where the lengths say."""

import re

import numpy as np
import pytest

from measurements import simulate
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Site
from vfm_sdm.page.sketch import draw_site

KNOWN = {
    "baseline": {"value": 3.0, "std": 0.005},
    "perpendicular_distance": {"value": 8.0, "std": 0.01},
    "longitudinal_distance": {"value": 6.0, "std": 0.01},
}


def _squares(svg):
    """Centres of the cameras in the plan, by the order of views."""
    return [(float(x) + 6, float(y) + 6) for x, y in re.findall(r'<rect x="([-\d.]+)" y="([-\d.]+)" width="12"', svg)]


def test_too_little_is_told():
    assert "State both distances" in draw_site(Site(), ["left", "right"], None, {})


@pytest.mark.parametrize("side", ["left", "right"])
def test_distances_are_to_scale(side):
    svg = draw_site(Site(**KNOWN, structure_side=side), ["left", "right"], None, {})
    [first, second] = _squares(svg)
    ray = re.search(r'<line x1="([\d.]+)" y1="([\d.]+)" x2="([\d.]+)" y2="([\d.]+)" stroke="#1565c0"', svg)
    x1, y1, x2, y2 = (float(one) for one in ray.groups())
    assert np.allclose(first, (x1, y1), atol=0.2)
    # The face is 8 m away where the picture's centre is 6 m along it.
    assert abs(x2 - x1) / (y1 - y2) == pytest.approx(6 / 8, rel=2e-3)
    # Who faces the structure and has it on the right looks to the left.
    assert (x2 < x1) == (side == "right")
    metre = (y1 - y2) / 8
    assert np.hypot(second[0] - first[0], second[1] - first[1]) == pytest.approx(3 * metre, rel=5e-3)


def test_swapped_distances_are_seen():
    swapped = {
        **KNOWN,
        "perpendicular_distance": {"value": 6.0, "std": 0.01},
        "longitudinal_distance": {"value": 8.0, "std": 0.01},
    }
    assert draw_site(Site(**KNOWN), ["left"], None, {}) != draw_site(Site(**swapped), ["left"], None, {})


def test_points_lie_where_they_are_by_the_pictures():
    one = simulate(3)
    site = one.session.site
    pixels = np.array([camera.project(one.points3d) for camera in one.rig.cameras])
    names = [str(name) for name in one.solution.points["point"].values]
    svg = draw_site(site, list(one.rig.names), one.rig, {n: (pixels[:, k], False) for k, n in enumerate(names)})
    plan = svg.split("</svg>")[0]
    face = float(re.search(r'x2="720" y1="([\d.]+)"', plan)[1])
    camera = _squares(plan)[0]
    metre = (camera[1] - face) / site.perpendicular_distance.value
    marks = re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="4"', plan)
    true = one.points3d @ one.frame.rotation.T
    for (x, y), place in zip(marks, true, strict=True):
        # The drawing takes its axes from the distances, which are measured to some centimetres.
        assert (camera[1] - float(y)) / metre == pytest.approx(place[0], abs=0.03 * np.linalg.norm(place))
        assert (float(x) - camera[0]) / metre == pytest.approx(-place[2], abs=0.03 * np.linalg.norm(place))


@pytest.mark.parametrize("side", ["left", "right"])
def test_left_is_left_in_both_drawings(side):
    """Points of the face follow each other in plan and elevation as in the reference camera's picture."""
    one = simulate(3)
    rotation = structure_from_cam1(compute_view_angle(8.0, 6.0), side=side)
    ahead = rotation[2] @ [0.0, 0.0, 1.0] * 10.0
    along = ahead + np.linspace(-2, 2, 5)
    face = np.stack([np.full(5, 8.0), np.linspace(0.3, 0.6, 5), along], axis=1) @ rotation
    pixels = np.array([camera.project(face) for camera in one.rig.cameras])
    points = {f"p{k}": (pixels[:, k], False) for k in range(5)}
    baseline = float(np.linalg.norm(one.rig.cameras[1].center - one.rig.cameras[0].center))
    site = Site(**{**KNOWN, "baseline": {"value": baseline, "std": 0.005}}, structure_side=side)
    for drawing in draw_site(site, list(one.rig.names), one.rig, points).split("</svg>")[:2]:
        across = [float(x) for x in re.findall(r'<circle cx="([-\d.]+)" cy="[-\d.]+" r="4"', drawing)]
        assert len(across) == 5
        assert np.argsort(across).tolist() == np.argsort(pixels[0, :, 0]).tolist()


def test_names_stay_text():
    svg = draw_site(Site(**KNOWN), ["<script>alert(1)</script>"], None, {})
    assert "<script" not in svg
    assert "&lt;script&gt;" in svg
