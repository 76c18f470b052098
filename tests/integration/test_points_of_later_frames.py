"""A measurement with points that are hidden in the first frame and named in a later one."""

import cv2
import numpy as np
import pytest

from scenes import DEPTH, FPS, POINTS, make_rig, motion_mm, render
from textures import WaveTexture
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import SessionError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import (
    Session,
    read_session,
    write_session,
)
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.stages.cameras.file import write_rig
from vfm_sdm.stages.cameras.solution import read_solution

pytestmark = pytest.mark.slow

FRAMES, GONE, NAMED, BEHIND = 36, 9, 14, 4
"""Frames in all; those that the lorry hides; the one of the names; by which the right view begins later."""
HIDDEN = ("b", "c")
NORMAL = np.array([-0.2, 0.0, 1.0])


def points3d(rig):
    """The points in the first frame [m]."""
    camera = rig.cameras[0]
    rays = np.column_stack([camera.normalize(np.array(list(POINTS.values()))), np.ones(len(POINTS))])
    return DEPTH * NORMAL[2] * rays / (rays @ NORMAL)[:, None]


def pixel(rig, name, frame):
    """Where a point is in the left view [px]."""
    at = points3d(rig)[list(POINTS).index(name)] + motion_mm(frame) / 1e3
    return rig.cameras[0].project(at[None])[0].tolist()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The moving plane, two of whose three points a lorry hides at first; the right view begins four frames later."""
    folder, rig, texture = tmp_path_factory.mktemp("lorry"), make_rig(), WaveTexture(8)
    rng = np.random.default_rng(3)
    lorry = np.clip(120 + 300 * cv2.GaussianBlur(rng.normal(0, 1, (64, 64)), (0, 0), 2.5), 0, 255).astype(np.uint8)
    for view, camera in zip(rig.names, rig.cameras, strict=True):
        (folder / view).mkdir()
        for frame in range(BEHIND if view == "right" else 0, FRAMES):
            picture = render(camera, texture, motion_mm(frame) / 1e3)
            for name in HIDDEN if frame < GONE else ():
                u, v = np.rint(camera.project(points3d(rig)[[list(POINTS).index(name)]])[0]).astype(int)
                picture[v - 32 : v + 32, u - 32 : u + 32] = lorry
            noisy = picture + rng.normal(0, 0.5, picture.shape)
            cv2.imwrite(str(folder / view / f"{frame:03}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    std = np.concatenate([[1e-3, 0.5, 0.5, 1e-3, *[0.0] * 6], [1e-3, 0.5, 0.5, 1e-3, *[1e-4] * 3, *[1e-3] * 3]])
    write_rig(folder / "rig.toml", Rig(rig.names, rig.cameras, rig.metric, np.diag(std**2)))
    named = {"b": {"frame": NAMED}, "c": {"time_s": NAMED / FPS + 0.004}}
    session = Session(
        name="behind a lorry",
        folder=folder,
        view=[
            {"name": view, "images": f"{view}/*.png", "fps": FPS, "camera": "rig.toml", "time_offset_s": offset_s}
            for view, offset_s in (("left", 0.0), ("right", BEHIND / FPS))
        ],
        point=[
            {
                "name": name,
                "view": "left",
                "pixel": pixel(rig, name, NAMED if name in named else 0),
                **named.get(name, {}),
            }
            for name in POINTS
        ],
        method={"cameras": "file", "synchronization": "none", "injection": False},
    )
    return write_session(folder / "session.toml", session)


@pytest.fixture(scope="module")
def measured(recorded, tmp_path_factory):
    return measure(read_session(recorded), tmp_path_factory.mktemp("run"))


def with_points(session, **fields):
    points = tuple(p.model_copy(update=fields) if p.name in HIDDEN else p for p in session.point)
    return session.model_copy(update={"point": points})


def check_truth(displacement):
    for name in POINTS:
        one = displacement.sel(point=name)
        ok = one["status"].values == Status.OK
        frames = np.rint(one["time"].values * FPS).astype(int)
        assert ok[frames >= GONE].all()
        assert ok[frames < GONE - 1].any() == (name not in HIDDEN)
        truth = np.array([motion_mm(frame) for frame in frames])
        truth = truth - truth[ok.argmax()]
        error, std = one["displacement"].values - truth, one["displacement_std"].values
        scale = one["scale_std"].values * np.abs(truth)
        # The origin's error is that of one more sample; three standard deviations of all that is stated.
        assert (np.abs(error[ok]) < 3 * np.hypot(np.sqrt(2) * std, scale)[ok] + 0.02).all(), name
        assert np.nanmax(std) < 1.0


def test_displacement_is_the_truth_from_where_the_points_are_seen(measured):
    check_truth(measured.displacement)
    points = measured.points
    assert points["frame"].sel(view="left").values.tolist() == [0, NAMED, NAMED]
    assert points["frame"].sel(view="right").values.tolist() == [0, NAMED - BEHIND, NAMED - BEHIND]
    assert (points["status"].values == "ok").all()


def test_places_in_the_other_view_are_those_of_the_same_time(measured):
    rig = make_rig()
    for name in HIDDEN:
        at = points3d(rig)[list(POINTS).index(name)] + motion_mm(NAMED) / 1e3
        there = rig.cameras[1].project(at[None])[0]
        np.testing.assert_allclose(measured.points["position"].sel(view="right", point=name), there, atol=0.1)


def test_the_run_folder_says_and_shows_in_which_frames_they_are(measured, recorded):
    points = read_solution(measured.folder / "cameras.toml")[0].points
    assert points["frame"].identical(measured.points["frame"])
    drawn = {path.name for path in measured.figures}
    expected = {"points_left.png", f"points_left_frame_{NAMED}.png", f"points_right_frame_{NAMED - BEHIND}.png"}
    assert expected <= drawn
    again = Measurement(read_session(recorded), measured.folder)
    assert again.key("tracks") == measured.key("tracks")
    assert again.cameras.points["frame"].identical(points["frame"])
    assert "cameras" in again.reused
    earlier = Measurement(with_points(read_session(recorded), frame=NAMED - 1, time_s=None))
    assert earlier.key("cameras") != measured.key("cameras")


def test_networks_refuse_them_before_any_work(recorded, monkeypatch):
    session = read_session(recorded)
    measurement = Measurement(session)
    tracker = type("Network", (), {"name": "vggt"})()
    monkeypatch.setattr(measurement, "_part", lambda kind: tracker)
    with pytest.raises(SessionError, match=r"'b', 'c': expected points of the first frame.*'vggt'"):
        measurement.run("tracks")
