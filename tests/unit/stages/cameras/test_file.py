"""Camera files in the project's own TOML, and the estimator that reads them."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from boards import make_rig
from vfm_sdm.errors import CameraError, ResultsError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.geometry.rig_views import select_views
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.file import FileCameras, read_camera, read_rig, write_rig

INTRINSICS = """
[[camera]]
name = "left"
image_size = [1280, 720]
fx = 1200
fy = 1201.5
cx = 640.0
cy = 360.0
distortion = [-0.1, 0.05]
"""


def rig_with_covariance(views=2):
    rig = make_rig(views)
    spread = np.random.default_rng(5).normal(size=(10 * views, 50)) / 7
    spread[4:10] = 0
    return Rig(rig.names, rig.cameras, True, spread @ spread.T)


def assert_same(found, expected):
    assert found.names == expected.names
    assert found.metric == expected.metric
    if expected.covariance is None:
        assert found.covariance is None
    else:
        np.testing.assert_array_equal(found.covariance, expected.covariance)
    for a, b in zip(found.cameras, expected.cameras, strict=True):
        assert a.image_size == b.image_size
        for name in ("K", "distortion", "cam_from_world"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def edited(tmp_path, old, new):
    path = tmp_path / "edited.toml"
    assert old in INTRINSICS
    path.write_text(INTRINSICS.replace(old, new))
    return path


class TestRoundTrip:
    @pytest.mark.parametrize("rig", [make_rig(2), rig_with_covariance(3)], ids=["plain", "covariance"])
    def test_every_bit_survives(self, tmp_path, rig):
        write_rig(tmp_path / "cameras.toml", rig)
        assert_same(read_rig(tmp_path / "cameras.toml"), rig)

    def test_awkward_numbers_survive(self, tmp_path):
        K = np.array([[1e3 / 3, 1e-17, 0.1 + 0.2], [0, 5e-324 + 1e3, -0.0], [0, 0, 1.0]])
        rig = Rig(("a b.ü",), (Camera(K, (1, 1), np.full(5, 1e-300)),), False)
        write_rig(tmp_path / "cameras.toml", rig)
        assert_same(read_rig(tmp_path / "cameras.toml"), rig)

    def test_parameters_are_named_beside_the_covariance(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", rig_with_covariance())
        document = tomllib.loads((tmp_path / "cameras.toml").read_text())
        assert tuple(document["covariance_parameters"]) == CAMERA_PARAMETERS
        assert document["metric"] is True

    def test_extra_values_are_kept_for_the_reader(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig(), extra={"rms_px": 0.25, "notes": ["one"]})
        assert tomllib.loads((tmp_path / "cameras.toml").read_text())["extra"] == {"rms_px": 0.25, "notes": ["one"]}
        assert_same(read_rig(tmp_path / "cameras.toml"), make_rig())

    def test_extra_that_toml_cannot_hold_is_refused_and_the_old_file_kept(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig())
        with pytest.raises(CameraError, match="extra: expected numbers, strings, lists and tables"):
            write_rig(tmp_path / "cameras.toml", make_rig(3), extra={"what": None})
        assert_same(read_rig(tmp_path / "cameras.toml"), make_rig())
        assert [path.name for path in tmp_path.iterdir()] == ["cameras.toml"]

    def test_failed_write_leaves_nothing_half_written(self, tmp_path, monkeypatch):
        def full_disk(self, *_, **__):
            raise OSError("disk full")

        monkeypatch.setattr(Path, "write_bytes", full_disk)
        with pytest.raises(ResultsError, match="disk full"):
            write_rig(tmp_path / "cameras.toml", make_rig())
        assert list(tmp_path.iterdir()) == []


class TestReadRig:
    def test_single_camera_needs_no_pose(self, tmp_path):
        path = tmp_path / "left.toml"
        path.write_text(INTRINSICS)
        rig = read_rig(path)
        assert rig.names == ("left",)
        np.testing.assert_array_equal(rig.cameras[0].cam_from_world, np.eye(3, 4))
        np.testing.assert_array_equal(rig.cameras[0].distortion, [-0.1, 0.05, 0, 0, 0])
        assert rig.cameras[0].K[1, 1] == 1201.5

    def test_several_cameras_need_poses(self, tmp_path):
        path = tmp_path / "both.toml"
        path.write_text(INTRINSICS + INTRINSICS.replace("left", "right"))
        with pytest.raises(
            CameraError, match=r"expected rotation and translation of every camera.*\['left', 'right'\]"
        ):
            read_rig(path)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("[[camera]]", "colour = 1\n[[camera]]", "colour"),
            ("fx = 1200", "fx = 1200\nfocal = 5", r"camera\[left\]\.focal"),
            ("fx = 1200", "fx = -1200", r"camera\[left\]\.fx: expected"),
            ("fx = 1200", "fx = true", r"camera\[left\]\.fx: expected"),
            ("fx = 1200", 'fx = "1200"', r"camera\[left\]\.fx: expected"),
            ("fx = 1200", "fx = nan", r"camera\[left\]\.fx: expected"),
            ("fx = 1200\n", "", r"camera\[left\]\.fx: expected a value"),
            ("[1280, 720]", "[1280.5, 720]", r"camera\[left\]\.image_size"),
            ("[-0.1, 0.05]", "[1, 2, 3, 4, 5, 6]", r"camera\[left\]\.distortion"),
            ("cx = 640.0", "translation = [0, 0, 0]\ncx = 640.0", "expected rotation and translation or neither"),
            ('name = "left"', 'name = ""', r"camera\[1\]\.name"),
            ("[[camera]]", 'format = "other 2"\n[[camera]]', "format"),
            ("[[camera]]", "covariance = [[1.0]]\n[[camera]]", "expected covariance_parameters"),
            ("[[camera]]", "[[camera]", "expected TOML"),
        ],
    )
    def test_faults_are_named(self, tmp_path, old, new, message):
        with pytest.raises(CameraError, match=message):
            read_rig(edited(tmp_path, old, new))

    def test_all_faults_at_once(self, tmp_path):
        path = edited(tmp_path, "fx = 1200\nfy = 1201.5", "fx = 0\nfy = -3")
        with pytest.raises(CameraError, match=r"fx: .*; camera\[left\]\.fy: "):
            read_rig(path)

    def test_covariance_of_another_size(self, tmp_path):
        parameters = f"covariance_parameters = {list(CAMERA_PARAMETERS)}\n"
        path = edited(tmp_path, "[[camera]]", parameters + "covariance = [[1.0, 0.0], [0.0, 1.0]]\n[[camera]]")
        with pytest.raises(CameraError, match="expected a covariance of 10 x 10"):
            read_rig(path)

    def test_impossible_camera(self, tmp_path):
        pose = "rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\ntranslation = [0, 0, 0]\nfx"
        with pytest.raises(CameraError, match="cam_from_world: expected a rotation"):
            read_rig(edited(tmp_path, "fx", pose))

    def test_repeated_name(self, tmp_path):
        path = tmp_path / "both.toml"
        path.write_text(INTRINSICS + INTRINSICS)
        with pytest.raises(CameraError, match=r"expected distinct camera names, got \['left', 'left'\]"):
            read_rig(path)

    def test_absent_or_not_text(self, tmp_path):
        with pytest.raises(CameraError, match="expected a camera file, got none"):
            read_rig(tmp_path / "none.toml")
        (tmp_path / "noise.toml").write_bytes(b"\xff\xfe\x00\x01")
        with pytest.raises(CameraError, match="expected TOML"):
            read_rig(tmp_path / "noise.toml")


class TestReadCamera:
    def test_single_camera_whatever_its_name(self, tmp_path):
        (tmp_path / "lens.toml").write_text(INTRINSICS)
        assert read_camera(tmp_path / "lens.toml", "right").K[0, 0] == 1200.0

    def test_one_of_several_by_name(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig(3))
        camera = read_camera(tmp_path / "cameras.toml", "third")
        np.testing.assert_array_equal(camera.K, make_rig(3).camera("third").K)
        with pytest.raises(CameraError, match=r"expected one of its cameras \['left', 'right', 'third'\], got None"):
            read_camera(tmp_path / "cameras.toml")


def session(folder, method="file", **cameras):
    views = [{"name": n, "video": f"{n}.mp4"} | ({"camera": c} if c else {}) for n, c in cameras.items()]
    point = [{"name": "p", "view": next(iter(cameras)), "pixel": (1.0, 1.0)}]
    site = {"baseline": {"value": 0.2, "std": 0.001}}
    return Session(name="s", view=views, site=site, point=point, method={"cameras": method}, folder=folder)


def frames(*names, size=(1280, 720)):
    return {name: np.zeros((size[1], size[0]), np.uint8) for name in names}


class TestFileCameras:
    def test_one_file_for_both(self, tmp_path):
        rig = rig_with_covariance()
        write_rig(tmp_path / "cameras.toml", rig)
        made = session(tmp_path, left="cameras.toml", right="cameras.toml")
        estimate = FileCameras().estimate(made, frames("left", "right"))
        assert estimate.status == "ok"
        assert estimate.notes == ()
        assert estimate.rig.metric
        np.testing.assert_allclose(estimate.rig.covariance, rig.covariance, atol=1e-15)
        # To the rounding of a product of poses.
        found, true = (r.cameras[1].cam_from_world for r in (estimate.rig, rig))
        np.testing.assert_allclose(found, true, rtol=0, atol=8 * np.finfo(float).eps * np.abs(true).max())

    def test_first_view_of_the_session_becomes_the_reference(self, tmp_path):
        rig = rig_with_covariance(3)
        write_rig(tmp_path / "cameras.toml", rig)
        made = session(tmp_path, third="cameras.toml", left="cameras.toml")
        found = FileCameras().estimate(made, frames("third", "left")).rig
        expected = select_views(rig, ("third", "left"))
        assert_same(found, expected)
        np.testing.assert_allclose(found.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)
        assert found.baseline() == pytest.approx(rig.baseline(0, 2))

    def test_a_file_a_view_in_a_common_frame(self, tmp_path):
        rig = rig_with_covariance()
        for index, name in enumerate(rig.names):
            write_rig(tmp_path / f"{name}.toml", Rig((name,), (rig.cameras[index],), True))
        made = session(tmp_path, left="left.toml", right="right.toml")
        estimate = FileCameras().estimate(made, frames("left", "right"))
        assert estimate.rig.baseline() == pytest.approx(rig.baseline())
        assert estimate.rig.covariance is None
        assert "without a joint covariance" in estimate.notes[0]

    def test_not_metric_is_said(self, tmp_path):
        rig = make_rig()
        write_rig(tmp_path / "cameras.toml", Rig(rig.names, rig.cameras, False))
        made = session(tmp_path, left="cameras.toml", right="cameras.toml")
        estimate = FileCameras().estimate(made, frames("left", "right"))
        assert not estimate.rig.metric
        assert "not metric" in estimate.notes[0]

    def test_intrinsics_only_points_to_two_view(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig())
        (tmp_path / "left.toml").write_text(INTRINSICS)
        made = session(tmp_path, left="left.toml", right="cameras.toml")
        with pytest.raises(CameraError, match=r"got intrinsics only; use cameras = 'two-view'"):
            FileCameras().estimate(made, frames("left", "right"))

    def test_opencv_file_points_to_two_view(self, tmp_path):
        made = session(tmp_path, left="left.yml", right="left.yml")
        with pytest.raises(CameraError, match=r"expected a TOML file with poses.* got \.yml; use cameras = 'two-view'"):
            FileCameras().estimate(made, frames("left", "right"))

    def test_views_without_a_file_are_named(self, tmp_path):
        made = session(tmp_path, "two-view", left="cameras.toml", right=None)
        with pytest.raises(CameraError, match=r"expected a camera file for every view, got none for \['right'\]"):
            FileCameras().estimate(made, frames("left", "right"))

    def test_file_without_the_view(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig())
        made = session(tmp_path, left="cameras.toml", top="cameras.toml")
        with pytest.raises(CameraError, match=r"expected a camera named 'top', got \['left', 'right'\]"):
            FileCameras().estimate(made, frames("left", "top"))

    def test_image_size_must_be_that_of_the_recording(self, tmp_path):
        write_rig(tmp_path / "cameras.toml", make_rig())
        made = session(tmp_path, left="cameras.toml", right="cameras.toml")
        with pytest.raises(
            CameraError, match="camera 'left': expected the recording's 1920 x 1080 pixels, got 1280 x 720"
        ):
            FileCameras().estimate(made, frames("left", "right", size=(1920, 1080)))

    def test_metric_and_not_metric_files_do_not_mix(self, tmp_path):
        rig = make_rig()
        for index, name in enumerate(rig.names):
            write_rig(tmp_path / f"{name}.toml", Rig((name,), (rig.cameras[index],), bool(index)))
        made = session(tmp_path, left="left.toml", right="right.toml")
        with pytest.raises(CameraError, match="expected files that are all metric or none"):
            FileCameras().estimate(made, frames("left", "right"))
