"""Cameras stored by OpenCV and by programs that write like it."""

import cv2
import numpy as np
import pytest

from vfm_sdm.errors import CameraError
from vfm_sdm.stages.cameras.file import read_camera, read_opencv_stereo

K = np.array([[800.0, 0.0, 320.5], [0.0, 801.0, 239.5], [0.0, 0.0, 1.0]])
D = np.array([[-0.3, 0.1, 0.001, 0.0005, 0.02]])
ROS = """image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [438.75, 0.0, 305.5, 0.0, 437.25, 243.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36, 0.11, 0.001, 0.0005, 0]
"""


def store(path, **values):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, value)
    storage.release()
    return path


class TestReadCamera:
    @pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
    def test_what_opencv_wrote(self, tmp_path, suffix):
        path = store(
            tmp_path / f"left.{suffix}",
            image_width=640,
            image_height=480,
            camera_matrix=K,
            distortion_coefficients=D,
        )
        camera = read_camera(path, "whatever the view is called")
        np.testing.assert_array_equal(camera.K, K)
        np.testing.assert_array_equal(camera.distortion, D[0])
        assert camera.image_size == (640, 480)

    def test_short_keys_and_given_size(self, tmp_path):
        path = store(tmp_path / "left.yml", K=K, D=D[:, :4])
        camera = read_camera(path, image_size=(640, 480))
        np.testing.assert_array_equal(camera.distortion, [*D[0, :4], 0.0])
        assert camera.image_size == (640, 480)

    def test_ros_file(self, tmp_path):
        (tmp_path / "ros.yaml").write_text(ROS)
        camera = read_camera(tmp_path / "ros.yaml")
        np.testing.assert_array_equal(camera.K, [[438.75, 0, 305.5], [0, 437.25, 243.5], [0, 0, 1]])
        np.testing.assert_array_equal(camera.distortion, [-0.36, 0.11, 0.001, 0.0005, 0])

    def test_one_of_two_cameras(self, tmp_path):
        path = store(tmp_path / "stereo.yml", M1=K, D1=D, M2=2 * K - np.diag([0, 0, 1]), D2=0 * D)
        assert read_camera(path, "left", image_size=(640, 480)).K[0, 0] == 800.0
        assert read_camera(path, "2", image_size=(640, 480)).K[0, 0] == 1600.0
        with pytest.raises(
            CameraError, match=r"expected the name of one of its cameras \(1, 2; left, right\), got 'top'"
        ):
            read_camera(path, "top", image_size=(640, 480))

    def test_the_shipped_samples(self, shared_data):
        folder = shared_data("opencv_chessboards")
        camera = read_camera(folder / "left_intrinsics.yml")
        assert camera.focal_px == pytest.approx(535.91573396)
        assert camera.image_size == (640, 480)
        assert camera.distortion[4] == pytest.approx(0.23839153)
        right = read_camera(folder / "intrinsics.yml", "right", image_size=(640, 480))
        np.testing.assert_allclose(right.K[:2, 2], [334.55744528, 242.05324573])


class TestRefused:
    def test_absent(self, tmp_path, capfd):
        with pytest.raises(CameraError, match="expected a camera file, got none there"):
            read_camera(tmp_path / "none.yml")
        assert capfd.readouterr().err == ""  # OpenCV itself would complain on the terminal

    @pytest.mark.parametrize("text", ["", "image_width: [640\n  foo: : bar", "<xml>", "\x00\x01\x02", "{"])
    def test_not_such_a_file(self, tmp_path, text):
        (tmp_path / "bad.yml").write_text(text)
        with pytest.raises(CameraError, match=r"expected YAML, XML or JSON as OpenCV writes it|expected camera_matrix"):
            read_camera(tmp_path / "bad.yml")

    def test_missing_matrix_names_the_keys_that_are_there(self, tmp_path):
        path = store(tmp_path / "left.yml", image_width=640, other=K)
        with pytest.raises(CameraError, match=r"expected camera_matrix or .*got keys \['image_width', 'other'\]"):
            read_camera(path)

    def test_missing_distortion(self, tmp_path):
        path = store(tmp_path / "left.yml", image_width=640, image_height=480, camera_matrix=K)
        with pytest.raises(CameraError, match="expected distortion_coefficients or"):
            read_camera(path)

    def test_missing_size(self, tmp_path):
        with pytest.raises(CameraError, match="expected image_width and image_height, got none"):
            read_camera(store(tmp_path / "left.yml", camera_matrix=K, distortion_coefficients=D))

    def test_contradicting_size(self, tmp_path):
        (tmp_path / "ros.yaml").write_text(ROS)
        with pytest.raises(CameraError, match=r"expected an image size of \(1280, 720\), got \(640, 480\)"):
            read_camera(tmp_path / "ros.yaml", image_size=(1280, 720))

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("plumb_bob", "equidistant", "expected the model k1, k2, p1, p2, k3, got equidistant"),
            ("image_width", "fisheye_model: 1\nimage_width", "got a fisheye lens"),
            ("rows: 3\n", "rows: 2\n", "expected 2 x 3 numbers, got 9 entries"),
            ("  cols: 3\n", "", "camera_matrix: expected rows, cols and data"),
            ("438.75", "wide", "expected 3 x 3 numbers"),
            ("rows: 3\n  cols: 3", "rows: 1\n  cols: 9", "expected a 3 x 3 camera matrix, got 1 x 9"),
            ("438.75", "-438.75", "positive focal lengths"),
        ],
    )
    def test_faulty_ros_file(self, tmp_path, old, new, message):
        assert old in ROS
        (tmp_path / "ros.yaml").write_text(ROS.replace(old, new))
        with pytest.raises(CameraError, match=message):
            read_camera(tmp_path / "ros.yaml")

    def test_matrix_that_is_a_number(self, tmp_path):
        with pytest.raises(CameraError, match="K: expected rows, cols and data, got another layout"):
            read_camera(store(tmp_path / "left.yml", K=5.0, D=D))

    def test_more_coefficients_than_the_model_has(self, tmp_path):
        path = store(tmp_path / "left.yml", K=K, D=np.full((1, 8), 0.1))
        with pytest.raises(CameraError, match="distortion: expected at most k1, k2, p1, p2, k3"):
            read_camera(path, image_size=(640, 480))


class TestStereo:
    R = cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))[0]
    T = np.array([[-3.3], [0.04], [0.05]])

    def files(self, folder, **extrinsics):
        inside = store(folder / "intrinsics.yml", M1=K, D1=D, M2=K, D2=D)
        return inside, store(folder / "extrinsics.yml", **(extrinsics or {"R": self.R, "T": self.T}))

    def test_pose_of_the_second_camera(self, tmp_path):
        rig = read_opencv_stereo(*self.files(tmp_path), (640, 480))
        assert rig.names == ("left", "right")
        assert not rig.metric
        np.testing.assert_array_equal(rig.cameras[0].cam_from_world, np.eye(3, 4))
        np.testing.assert_array_equal(rig.cameras[1].cam_from_world, np.column_stack([self.R, self.T]))

    def test_unit_makes_it_metric(self, tmp_path):
        rig = read_opencv_stereo(*self.files(tmp_path), (640, 480), names=("a", "b"), unit_m=0.025)
        assert rig.metric
        assert rig.baseline() == pytest.approx(0.025 * np.linalg.norm(self.T))
        with pytest.raises(CameraError, match="unit_m: expected a length above 0 m, got 0"):
            read_opencv_stereo(*self.files(tmp_path), (640, 480), unit_m=0)

    def test_wrong_shapes_and_missing_keys(self, tmp_path):
        with pytest.raises(CameraError, match="expected R of 3 x 3 and T of 3 numbers"):
            read_opencv_stereo(*self.files(tmp_path, R=self.R[:2], T=self.T), (640, 480))
        with pytest.raises(CameraError, match=r"expected T, got keys \['R'\]"):
            read_opencv_stereo(*self.files(tmp_path, R=self.R), (640, 480))
