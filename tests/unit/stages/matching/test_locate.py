"""The second look for missing points of the structure, on the face whose distance was measured."""

import numpy as np
import pytest

from simulation import intrinsics, looking_at
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.matching import locate
from vfm_sdm.stages.matching.correspondence import Correspondence
from vfm_sdm.stages.matching.expected import expect_on_face
from vfm_sdm.stages.matching.face import know_face
from vfm_sdm.stages.matching.locate import PointFinder
from vfm_sdm.stages.matching.placing import Place

SIZE = (640, 480)
FRAMES = {name: np.zeros(SIZE[::-1], np.uint8) for name in ("left", "right")}
FACE_M, ALONG_M = 8.0, 12.0


def session(**site):
    def point(name, **extra):
        return {"name": name, "view": "left", "pixel": (300.0, 200.0), **extra}

    measured = {
        "baseline": {"value": 3.6, "std": 0.01},
        "structure_side": "right",
        "perpendicular_distance": {"value": FACE_M, "std": 0.03},
        "longitudinal_distance": {"value": ALONG_M, "std": 0.05},
        "face_offset_std": 0.04,
    }
    return Session(
        name="bridge",
        view=[
            {"name": "left", "images": "left/*.png", "fps": 30.0},
            {"name": "right", "images": "right/*.png", "fps": 30.0},
        ],
        site={**measured, **site},
        point=[
            point("web"),
            point("seen"),
            point("abutment", static=True),
            point("named", pixel_in={"right": (310.0, 205.0)}),
        ],
    )


def rig(*, metric=True):
    center = np.array([3.0, 0.0, -2.0])
    second = Camera(intrinsics(900.0, SIZE), SIZE, cam_from_world=looking_at(center, np.array([4.0, 0.0, 12.0])))
    first = Camera(intrinsics(900.0, SIZE), SIZE, cam_from_world=looking_at(np.zeros(3), np.array([0.0, 0.0, 14.0])))
    return Rig.from_world(("left", "right"), [first, second], metric=metric)


FRAME = StructureFrame(structure_from_cam1(compute_view_angle(FACE_M, ALONG_M), side="right"))


@pytest.fixture
def asked(monkeypatch):
    """Records what is searched for, and answers every search with the same place."""
    calls = []

    def find(views, points2d, *, subset_px, given, surface):
        calls.append((points2d, views.matches, surface))
        shape = len(points2d), 2
        return Correspondence(
            np.full(shape, 123.0), np.zeros((*shape, 2)), np.ones(1), np.zeros(1), (PointStatus.OK,) * shape[0]
        )

    monkeypatch.setattr(locate, "find_correspondences", find)
    return calls


def state_before():
    """Points dataset after the first look: one point seen in the right view, the others not found."""
    names = ["web", "abutment", "named", "seen"]
    position = np.full((2, 4, 2), np.nan)
    position[0], position[1, 3] = (300.0, 200.0), (320.0, 190.0)
    status = [[PointStatus.OK] * 4, [PointStatus.NOT_FOUND] * 3 + [PointStatus.OK]]
    return make_points(["left", "right"], names, position=position, position_std=0 * position, status=status)


def looked_again(points, *, rig_known=None, **site):
    return PointFinder(session(**site), FRAMES).find_on_face(points, rig_known or rig(), FRAME)


def test_only_points_of_the_structure_that_nobody_named_there_are_looked_for_again(asked):
    before = state_before()
    after = looked_again(before)
    assert len(asked) == 1
    assert len(asked[0][0]) == 1
    assert after["status"].sel(view="right").values.tolist() == [
        PointStatus.OK,
        PointStatus.NOT_FOUND,
        PointStatus.NOT_FOUND,
        PointStatus.OK,
    ]
    np.testing.assert_array_equal(after["position"].sel(view="right", point="web"), [123.0, 123.0])
    np.testing.assert_array_equal(after["position"].sel(view="right", point="seen"), [320.0, 190.0])
    assert before.identical(state_before())


def test_the_face_is_the_vertical_plane_at_the_measured_distance(asked):
    looked_again(state_before())
    face = asked[0][2]
    np.testing.assert_allclose(face.std, 0.05)
    # What the optical axis of the reference camera meets: FACE_M to the side and ALONG_M ahead.
    depth = np.hypot(FACE_M, ALONG_M)
    np.testing.assert_allclose(
        face.depths(np.array([0.0, 0.0, 1.0]), rig().cameras[0]), depth * (1 + np.array([-1, 1]) * 0.15 / FACE_M)
    )


@pytest.mark.parametrize("case", ["no distance", "no scale"])
def test_without_a_distance_in_metres_there_is_no_second_look(asked, case):
    site = {"perpendicular_distance": None, "longitudinal_distance": None} if case == "no distance" else {}
    before = state_before()
    assert looked_again(before, rig_known=rig(metric=case != "no scale"), **site).identical(before)
    assert asked == []


@pytest.mark.parametrize(("off_px", "kept"), [(1.0, True), (150.0, False)])
def test_a_look_alike_far_from_the_face_is_no_place_of_a_point_on_it(monkeypatch, off_px, kept):
    cameras = rig()
    std = np.concatenate([[1e-3, 1.0, 1.0, 1e-3, *[0.0] * 6], [1e-3, 1.0, 1.0, 1e-3, *[1e-3] * 6]])
    cameras = Rig(cameras.names, cameras.cameras, cameras.metric, np.diag(std**2))
    _, face = know_face(session().site, cameras)
    place = expect_on_face(np.array([[300.0, 200.0]]), cameras, (0, 1), face, on_face=np.array([True])).position[0]

    def find(views, points2d, *, subset_px, given, surface):
        shape = len(points2d), 2
        found = np.tile(place + np.array([off_px, 0.0]), (shape[0], 1))
        ok = (PointStatus.OK,) * shape[0]
        return Correspondence(found, np.zeros((*shape, 2)), np.ones(1), np.zeros(1), ok)

    monkeypatch.setattr(locate, "find_correspondences", find)
    monkeypatch.setattr(locate, "features_near", lambda *_: ())
    nothing = Place(np.full(2, np.nan), np.full((2, 2), np.nan), np.nan, PointStatus.NOT_FOUND)
    monkeypatch.setattr(locate, "place_points", lambda _, pixels, *__, **___: [nothing] * len(pixels))
    points = PointFinder(session(), FRAMES).find(cameras, ()).sel(view="right")
    assert (points["status"].sel(point="web") == PointStatus.OK) == kept
    assert np.isfinite(points["position"].sel(point="web")).all() == kept
    # A point behind the structure may lie anywhere along its line.
    assert points["status"].sel(point="abutment") == PointStatus.OK
