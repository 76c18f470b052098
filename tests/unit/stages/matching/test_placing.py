"""Points of a girder placed together: stiffeners and balusters that repeat, edges, places without texture, clicks."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from simulation import intrinsics, looking_at
from textures import WaveTexture
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.matching.locate import PointFinder
from vfm_sdm.stages.matching.points import NAMED_STD_PX, named_points

SIZE = (640, 400)
FACE_M, ALONG_M, FOCAL_PX = 9.0, 16.0, 2200.0
FRAME = StructureFrame(structure_from_cam1(compute_view_angle(FACE_M, ALONG_M), side="right"))
TARGET = np.array([0.0, 0.0, np.hypot(FACE_M, ALONG_M)])
CAMERAS = {
    view: Camera(intrinsics(FOCAL_PX, SIZE), SIZE, cam_from_world=looking_at(np.array(center), TARGET))
    for view, center in {"left": (0.0, 0.0, 0.0), "right": (2.6, -0.1, -1.9)}.items()
}
RIG = Rig.from_world(("left", "right"), list(CAMERAS.values()), metric=True)
EXACT = np.zeros((20, 20))
# Rotation to 10 mrad, focal length to 2 %, each by itself: some 20 px in every direction, a third of the spacing.
VAGUE = np.diag(np.square([0.0] * 10 + [0.02, 2.0, 2.0, 0.0, 1e-2, 1e-2, 1e-2, 0.02, 0.02, 0.02]))
SPACING_M, STIFFENER_M = 1.6, 0.12
ALONG = WaveTexture(7, waves=60, shortest_px=8.0, longest_px=80.0)


def on_face(camera, pixels):
    """Where viewing rays meet the face, shape (..., 3) [m]."""
    pixels = np.asarray(pixels, float)
    rays = np.concatenate([camera.normalize(pixels), np.ones((*pixels.shape[:-1], 1))], axis=-1) @ camera.rotation
    lateral = FRAME.rotation[0]
    distance = (FACE_M - camera.center @ lateral) / (rays @ lateral)
    return camera.center + distance[..., None] * rays


def girder(along, down):
    """Grey values of a girder at places (m): equal stiffeners on a plain web, a textured deck, a plain lower flange."""
    place = np.mod(along, SPACING_M)
    grey = np.where(place < STIFFENER_M, 70.0 + 400 * place, 150.0)
    grey = np.where(np.abs(down) > 0.35, 190.0, grey)
    deck = ALONG(along * 120.0, down * 120.0)
    grey = np.where(down < -0.42, deck, grey)
    return np.where(down > 0.95, 40.0, grey)


def picture(camera, paint, seed):
    v, u = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    X = on_face(camera, np.stack([u, v], axis=-1))
    grey = paint(X @ FRAME.rotation[2], X @ FRAME.rotation[1])
    grey = gaussian_filter(grey, 0.7) + np.random.default_rng(seed).normal(0, 1.0, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def pictures(paint):
    return {view: picture(camera, paint, seed) for seed, (view, camera) in enumerate(CAMERAS.items())}


@pytest.fixture(scope="module")
def images():
    return pictures(girder)


def pixel_of(along, down, view="left"):
    """Where a view shows a place of the face, shape (2,) [px]."""
    lateral, vertical, longitudinal = FRAME.rotation
    return CAMERAS[view].project(FACE_M * lateral + down * vertical + along * longitudinal)


PLACES = {
    "stiffener": (16.0 + STIFFENER_M / 2, -0.05),
    "corner": (17.6, 0.35),
    "flange": (16.3, 0.95),
    "web": (16.85, -0.05),
    "deck": (16.2, -0.55),
    "deck 2": (15.6, -0.6),
}
"""Along the structure and down from the reference camera's height [m]."""


def find(images, names, *, covariance=EXACT, rig=RIG, pixel_in=None, **site):
    session = Session(
        name="girder",
        view=[{"name": view, "images": f"{view}/*.png", "fps": 30.0} for view in CAMERAS],
        site={
            "baseline": {"value": RIG.baseline(), "std": 0.01},
            "perpendicular_distance": {"value": FACE_M, "std": 0.02},
            "longitudinal_distance": {"value": ALONG_M, "std": 0.02},
            "reference_camera_level": {"value_deg": 0.0, "std_deg": 0.1},
            "face_offset_std": 0.05,
            **site,
        },
        point=[
            {
                "name": name,
                "view": "left",
                "pixel": tuple(pixel_of(*PLACES[name])),
                "pixel_in": {} if name not in (pixel_in or {}) else {"right": tuple(pixel_in[name])},
            }
            for name in names
        ],
        method={"subset_px": 61},
    )
    known = Rig(rig.names, rig.cameras, True, covariance)
    return PointFinder(session, images).find(known, ()).sel(view="right")


def miss(points, name):
    """How far a point is from where it belongs, shape (2,) [px]."""
    return points["position"].sel(point=name).values - pixel_of(*PLACES[name], "right")


def test_known_cameras_and_face_settle_which_stiffener_it_is(images):
    points = find(images, ["stiffener", "corner"])
    assert set(points["status"].values) == {PointStatus.OK}
    for name in ("stiffener", "corner"):
        assert np.abs(miss(points, name)).max() < 1.0


def test_the_next_stiffener_is_not_taken_where_the_right_one_is_hidden(images):
    u, v = np.rint(pixel_of(*PLACES["stiffener"], "right")).astype(int)
    hidden = images["right"].copy()
    hidden[v - 60 : v + 60, u - 22 : u + 22] = np.random.default_rng(0).integers(60, 200, (120, 44))
    points = find({**images, "right": hidden}, ["stiffener"])
    assert points["status"].item() != PointStatus.OK
    assert np.isnan(points["position"].values).all()


def test_a_stiffener_alone_is_ambiguous_where_geometry_does_not_settle_it(images):
    """Along the line, the next ones lie within what cameras and face leave open."""
    points = find(images, ["stiffener"], covariance=VAGUE, face_offset_std=1.0)
    assert points["status"].item() == PointStatus.AMBIGUOUS


def test_points_that_may_all_be_one_stiffener_further_are_ambiguous_together(images):
    points = find(images, ["stiffener", "corner"], covariance=9 * VAGUE)
    assert PointStatus.OK not in points["status"].values


def test_points_that_are_found_settle_the_others(images):
    """Cameras that are vague put a stiffener half-way to the next one; the deck's texture tells by how much."""
    rng, worst = np.random.default_rng(3), 0.0
    for _ in range(6):
        off = RIG.perturbed(rng.multivariate_normal(np.zeros(20), VAGUE))
        points = find(images, list(PLACES), covariance=VAGUE, rig=off)
        for name in ("stiffener", "corner", "deck", "deck 2"):
            assert points["status"].sel(point=name).item() == PointStatus.OK, name
            worst = max(worst, float(np.abs(miss(points, name)).max()))
    assert worst < 1.5


def test_an_edge_is_placed_where_the_face_crosses_it_with_its_uncertainty_along_it(images):
    points = find(images, ["flange", "deck", "deck 2"], face_offset_std=0.1)
    assert points["status"].sel(point="flange").item() == PointStatus.OK
    std = points["position_std"].sel(point="flange").values
    off = miss(points, "flange")
    # Across the edge a pixel, along it as far as the face allows: 0.1 m off it are some 4 px.
    assert abs(off[1]) < 1.0
    assert std[1] < 2.0
    assert 2.0 < std[0] < 20.0
    assert abs(off[0]) < 3 * std[0]


def test_a_place_without_texture_is_not_found_but_believed_where_it_was_named(images):
    assert find(images, ["web"])["status"].item() in (PointStatus.NOT_FOUND, PointStatus.AMBIGUOUS)
    aside = pixel_of(*PLACES["web"], "right") + np.array([1.0, -1.2])
    points = find(images, ["web"], pixel_in={"web": aside})
    assert points["status"].item() == PointStatus.OK
    np.testing.assert_allclose(points["position"].values[0], aside)
    np.testing.assert_allclose(points["position_std"].values[0], NAMED_STD_PX)


def test_a_named_place_is_registered_where_it_can_be_even_with_cameras_that_are_wrong(images):
    aside = {name: pixel_of(*PLACES[name], "right") + np.array([1.5, -1.0]) for name in ("deck", "stiffener", "flange")}
    wrong = RIG.perturbed(np.concatenate([np.zeros(14), [0.05, -0.03, 0.02], np.zeros(3)]))
    for rig, site in ((RIG, {}), (wrong, {}), (RIG, {"perpendicular_distance": None, "longitudinal_distance": None})):
        points = find(images, list(aside), rig=rig, pixel_in=aside, **site)
        assert set(points["status"].values) == {PointStatus.OK}
        assert np.abs(miss(points, "deck")).max() < 0.5
        assert abs(miss(points, "stiffener")[0]) < 1.0
        assert abs(miss(points, "flange")[1]) < 1.0
        std = points["position_std"].sel(point="flange").values
        assert std[1] < std[0] <= NAMED_STD_PX


def test_a_named_place_tells_the_others_which_stiffener_they_are_on(images):
    """Geometry leaves the stiffener open by itself, as above."""
    given = {"corner": pixel_of(*PLACES["corner"], "right"), "deck": pixel_of(*PLACES["deck"], "right")}
    points = find(images, ["stiffener", *given], covariance=VAGUE, pixel_in=given)
    assert points["status"].sel(point="stiffener").item() == PointStatus.OK
    assert np.abs(miss(points, "stiffener")).max() < 1.0


def test_what_a_session_names_in_both_views_is_known_without_cameras():
    session = Session(
        name="two clicks",
        view=[{"name": view, "images": f"{view}/*.png", "fps": 30.0} for view in CAMERAS],
        site={"baseline": {"value": 4.0, "std": 0.01}},
        point=[{"name": "a", "view": "right", "pixel": (9.0, 8.0), "pixel_in": {"left": (7.0, 6.0)}}],
    )
    points = named_points(session, ["left", "right"])
    assert points["status"].values.ravel().tolist() == [PointStatus.OK] * 2
    np.testing.assert_array_equal(points["position"].values[:, 0], [[7.0, 6.0], [9.0, 8.0]])
    np.testing.assert_array_equal(points["position_std"].values[:, 0], [[NAMED_STD_PX] * 2, [0.0, 0.0]])
    alone = named_points(session, ["right"])
    np.testing.assert_array_equal(alone["position"].values[0, 0], [9.0, 8.0])


def test_a_named_place_among_look_alikes_nearby_stays_within_the_accuracy_of_naming():
    """A pattern that repeats after four pixels: which of them is meant, the user knows to a pixel or two."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    stripes = np.rint(120 + 40 * np.sin(2 * np.pi * u / 4.0) + 40 * np.sin(2 * np.pi * v / 4.0)).astype(np.uint8)
    given = {"deck": pixel_of(*PLACES["deck"], "right")}
    points = find({"left": stripes, "right": stripes}, ["deck"], pixel_in=given)
    assert points["status"].item() == PointStatus.OK
    assert np.abs(miss(points, "deck")).max() < 3 * NAMED_STD_PX
