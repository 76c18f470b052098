"""Chessboard calibration: simulated and real boards, bad pairs, and the estimator."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from boards import BOARD, IMAGE_SIZE, PATTERN, SQUARE_M, add_noise, board_poses, make_rig, see_board
from vfm_sdm.core.statuses import BoardStatus, CameraStatus
from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.chessboard.estimator import ChessboardCameras, board_points, calibrate_camera, calibrate_rig
from vfm_sdm.stages.cameras.chessboard.order import agree_on_order, board_symmetries

SIZES = {"left": IMAGE_SIZE, "right": IMAGE_SIZE, "third": IMAGE_SIZE}


def simulated(seed=0, *, poses=10, views=2, noise_px=0.1, tilt_deg=25.0):
    rng = np.random.default_rng(seed)
    rig = make_rig(views)
    corners = see_board(rig, board_poses(rng, poses, tilt_deg=tilt_deg))
    return rig, add_noise(corners, rng, noise_px)


def sizes(corners):
    return {view: SIZES[view] for view in corners}


class TestTruth:
    @pytest.mark.parametrize("views", [2, 3])
    def test_exact_corners_give_the_exact_rig(self, views):
        rig, corners = simulated(views=views, noise_px=0.0)
        found = calibrate_rig(corners, BOARD, sizes(corners))
        assert found.rig.names == rig.names
        assert found.rig.metric
        for a, b in zip(found.rig.cameras, rig.cameras, strict=True):
            np.testing.assert_allclose(a.K, b.K, atol=1e-4)
            np.testing.assert_allclose(a.distortion, b.distortion, atol=1e-5)
            np.testing.assert_allclose(a.cam_from_world, b.cam_from_world, atol=1e-7)
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=1e-8)
        assert max(found.rms.values()) < 1e-5
        assert found.dropped == {}
        assert found.reordered == ()

    def test_all_distortion_terms_when_freed(self):
        rig = make_rig()
        coefficients = np.array([-0.15, 0.08, 0.002, -0.001, 0.02])
        bent = tuple(Camera(c.K, IMAGE_SIZE, coefficients, c.cam_from_world) for c in rig.cameras)
        corners = see_board(Rig(rig.names, bent, True), board_poses(np.random.default_rng(0), 12))
        found = calibrate_rig(corners, BOARD, SIZES, fix_tangential=False, fix_k3=False)
        np.testing.assert_allclose(found.rig.cameras[1].distortion, coefficients, atol=1e-3)
        stiff = calibrate_rig(corners, BOARD, SIZES)
        np.testing.assert_array_equal(stiff.rig.cameras[1].distortion[2:], 0.0)

    def test_board_twice_as_large_doubles_the_baseline(self):
        _, corners = simulated()
        once, twice = (calibrate_rig(corners, factor * BOARD, SIZES) for factor in (1, 2))
        # Where the minimisation stops, next to what the corners tell.
        assert twice.baseline_m == pytest.approx(2 * once.baseline_m, abs=1e-4 * twice.baseline_std_m)
        assert twice.baseline_std_m == pytest.approx(2 * once.baseline_std_m, rel=1e-6)

    def test_swapped_views_agree(self):
        _, corners = simulated()
        there = calibrate_rig(corners, BOARD, SIZES)
        back = calibrate_rig(dict(reversed(corners.items())), BOARD, SIZES)
        assert back.rig.names == ("right", "left")
        assert back.baseline_m == pytest.approx(there.baseline_m, rel=1e-8)
        assert back.baseline_std_m == pytest.approx(there.baseline_std_m, rel=1e-3)
        np.testing.assert_allclose(back.rig.camera("left").K, there.rig.camera("left").K, rtol=1e-6)

    def test_hidden_corners_are_left_out(self):
        rig, corners = simulated(noise_px=0.0)
        corners["right"][2][:25] = np.nan
        found = calibrate_rig(corners, BOARD, SIZES)
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=1e-8)
        assert found.dropped == {}

    def test_one_camera_alone(self):
        rig, corners = simulated(noise_px=0.0)
        found = calibrate_camera(corners["right"], BOARD, IMAGE_SIZE)
        np.testing.assert_allclose(found.camera.K, rig.cameras[1].K, atol=1e-3)
        np.testing.assert_array_equal(found.camera.cam_from_world, np.eye(3, 4))
        assert found.covariance.shape == (10, 10)
        np.testing.assert_array_equal(found.covariance[4:], 0.0)
        assert list(found.reprojection_error) == [f"picture {i + 1}" for i in range(10)]


def test_stated_standard_deviations_are_those_of_the_errors():
    """Known truth, 0.2 px noise, 15 poses, 30 times: error over stated standard deviation has unit size."""
    scores = []
    for trial in range(30):
        rig, corners = simulated(seed=100 + trial, poses=15, noise_px=0.2)
        found = calibrate_rig(corners, BOARD, SIZES)
        std = np.sqrt(np.diag(found.rig.covariance))
        scores.append(
            [
                (found.baseline_m - rig.baseline()) / found.baseline_std_m,
                *(
                    np.log(a.focal_px / b.focal_px) / std[10 * i]
                    for i, (a, b) in enumerate(zip(found.rig.cameras, rig.cameras, strict=True))
                ),
                (found.rig.cameras[1].K[0, 2] - rig.cameras[1].K[0, 2]) / std[11],
                *((found.rig.cameras[1].translation - rig.cameras[1].translation) / std[17:20]),
            ]
        )
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert rms.min() > 0.7
    assert rms.max() < 1.4


class TestBadPairs:
    def test_missing_corners_are_named_with_the_view(self):
        rig, corners = simulated(noise_px=0.0)
        corners["left"][1] = None
        corners["right"][2] = None
        corners["left"][3] = corners["right"][3] = None
        corners["right"][4][5:] = np.nan  # five corners fix nothing
        found = calibrate_rig(corners, BOARD, SIZES, names=[f"n{i}" for i in range(10)])
        assert found.dropped == {
            "n1": "no corners in 'left'",
            "n2": "no corners in 'right'",
            "n3": "no corners in 'left' and 'right'",
            "n4": "fewer than 8 corners in 'right'",
        }
        assert list(found.reprojection_error) == ["n0", "n5", "n6", "n7", "n8", "n9"]
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=1e-8)

    def test_turned_corners_are_put_in_order(self):
        rig, corners = simulated(noise_px=0.05)
        straight = calibrate_rig(corners, BOARD, SIZES)
        for pose in (2, 7):
            corners["right"][pose] = corners["right"][pose][::-1]
        found = calibrate_rig(corners, BOARD, SIZES)
        assert found.reordered == ("pair 3", "pair 8")
        assert found.dropped == {}
        assert found.baseline_m == pytest.approx(straight.baseline_m, abs=1e-4 * straight.baseline_std_m)
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=4 * found.baseline_std_m)

    @pytest.mark.parametrize("symmetry", [1, 2, 3])
    def test_square_board_begun_at_any_corner(self, symmetry):
        rig, board = make_rig(), board_points((6, 6), SQUARE_M)
        corners = see_board(rig, board_poses(np.random.default_rng(0), 10), board)
        corners["right"][4] = corners["right"][4][board_symmetries(board)[symmetry][1]]
        found = calibrate_rig(corners, board, SIZES)
        assert found.reordered == ("pair 5",)
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=1e-8)

    def test_a_few_degrees_of_tilt_tell_the_order(self):
        _, corners = simulated(seed=3, tilt_deg=4.0)
        corners["right"][4] = corners["right"][4][::-1]
        assert calibrate_rig(corners, BOARD, SIZES).reordered == ("pair 5",)

    def test_pair_whose_order_is_ambiguous_is_dropped(self, monkeypatch):
        # Boards so alike that nothing tells the order do not calibrate either, so the verdict is put in by hand.
        def doubtful(first, second, board):
            order = agree_on_order(first, second, board)
            return (
                replace(order, reasons=(BoardStatus.AMBIGUOUS_ORDER, *order.reasons[1:])) if len(first) == 10 else order
            )

        monkeypatch.setattr("vfm_sdm.stages.cameras.chessboard.pairs.agree_on_order", doubtful)
        rig, corners = simulated(noise_px=0.0)
        found = calibrate_rig(corners, BOARD, SIZES)
        assert found.dropped == {"pair 1": BoardStatus.AMBIGUOUS_ORDER}
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=1e-8)

    def test_pair_turned_back_and_forth_ends_as_ambiguous(self, monkeypatch):
        def restless(first, second, board):
            order = agree_on_order(first, second, board)
            return replace(order, turns=np.array([1] + [0] * 9)) if len(first) == 10 else order

        monkeypatch.setattr("vfm_sdm.stages.cameras.chessboard.pairs.agree_on_order", restless)
        _, corners = simulated(noise_px=0.0)
        found = calibrate_rig(corners, BOARD, SIZES)
        assert found.dropped == {"pair 1": BoardStatus.AMBIGUOUS_ORDER}
        assert found.reordered == ()

    @pytest.mark.parametrize("fault", ["one corner", "shifted", "other pose"])
    def test_pair_with_wrong_corners_is_dropped(self, fault):
        rig, corners = simulated(noise_px=0.1)
        wrong = corners["right"][6].copy()
        if fault == "one corner":
            wrong[20] += [15.0, -9.0]
        elif fault == "shifted":
            wrong += [0.0, 9.0]  # smooth, so that only the other view can contradict it
        else:
            wrong = corners["right"][5].copy()
        corners["right"][6] = wrong
        found = calibrate_rig(corners, BOARD, SIZES)
        assert list(found.dropped) == ["pair 7"]
        assert found.baseline_m == pytest.approx(rig.baseline(), abs=4 * found.baseline_std_m)
        if fault != "other pose":
            assert "far above the others (limit" in found.dropped["pair 7"]

    def test_good_pairs_are_all_kept(self):
        for seed in range(5):
            _, corners = simulated(seed=seed, noise_px=0.5)
            assert calibrate_rig(corners, BOARD, SIZES).dropped == {}

    def test_with_three_views_only_the_failing_link_goes(self):
        rig, corners = simulated(views=3, noise_px=0.0)
        corners["third"][2] = None
        corners["left"][5] = None
        found = calibrate_rig(corners, BOARD, SIZES)
        assert found.dropped == {
            "pair 3 (left, third)": "no corners in 'third'",
            "pair 6 (left, right)": "no corners in 'left'",
            "pair 6 (left, third)": "no corners in 'left'",
        }
        assert set(found.reprojection_error["pair 3"]) == {"left", "right"}
        assert found.rig.baseline(0, 2) == pytest.approx(rig.baseline(0, 2), abs=1e-7)

    def test_too_few_pairs_name_the_dropped_ones(self):
        _, corners = simulated(poses=4)
        corners["left"][0] = corners["right"][1] = None
        message = (
            r"expected at least 3 usable pairs for \['right'\], got \[2\] of 4 \(pair 1: no corners in 'left'; pair 2"
        )
        with pytest.raises(CameraError, match=message):
            calibrate_rig(corners, BOARD, SIZES)

    def test_views_must_have_as_many_pictures(self):
        _, corners = simulated()
        corners["right"].pop()
        with pytest.raises(CameraError, match=r"as many pictures in every view, got \{'left': 10, 'right': 9\}"):
            calibrate_rig(corners, BOARD, SIZES)
        with pytest.raises(CameraError, match="'names': 3"):
            calibrate_camera(corners["left"], BOARD, IMAGE_SIZE, names=["a", "b", "c"])

    def test_corners_outside_the_image(self):
        _, corners = simulated()
        corners["right"][3] = corners["right"][3] + 2000
        with pytest.raises(CameraError, match="corners of 'right', picture 4: expected pixels inside the image"):
            calibrate_rig(corners, BOARD, SIZES)

    def test_corners_of_another_board(self):
        _, corners = simulated()
        with pytest.raises(DatasetError, match=r"'left', picture 1: expected shape \(35, 2\), got \(54, 2\)"):
            calibrate_rig(corners, board_points((7, 5), 0.02), SIZES)

    def test_corners_in_a_line_start_nothing(self):
        line = [np.column_stack([np.linspace(10, 1200, 54), np.full(54, 300.0 + i)]) for i in range(4)]
        with pytest.raises(CameraError, match=r"could not start from them"):
            calibrate_camera(line, BOARD, IMAGE_SIZE)


class TestRealData:
    def test_duodic_baseline_is_that_of_matlab(self, shared_data):
        folder = shared_data("duodic_uniaxial")
        stored = np.load(folder / "chessboard_corners.npz")
        matlab = json.loads((folder / "matlab_stereo_calibration.json").read_text())
        corners = {name: list(stored[name] - 1.0) for name in ("cam1", "cam2")}  # MATLAB counts from (1, 1)
        size = tuple(matlab["image_size_wh"])
        found = calibrate_rig(corners, stored["board_xy_mm"] / 1e3, {"cam1": size, "cam2": size})
        assert found.dropped == {}
        assert found.baseline_m * 1e3 == pytest.approx(matlab["baseline_mm"], abs=1e-3)
        np.testing.assert_allclose(found.rig.cameras[1].rotation, matlab["R"], atol=2e-5)
        for name, camera in zip(("camera1", "camera2"), found.rig.cameras, strict=True):
            expected = np.array(matlab[name]["K"]) - [[0, 0, 1], [0, 0, 1], [0, 0, 0]]
            np.testing.assert_allclose(camera.K, expected, atol=0.2)
        # Corner errors of 0.57 px that are alike within a picture: far from independent, and said so.
        assert found.pose_scatter > 5
        assert 5e-5 < found.baseline_std_m < 5e-4

    def test_duodic_halves_differ_as_much_as_stated(self, shared_data):
        stored = np.load(shared_data("duodic_uniaxial") / "chessboard_corners.npz")
        size = (2448, 2048)
        rng = np.random.default_rng(0)
        scores = []
        for _ in range(4):
            order = rng.permutation(37)
            halves = [
                calibrate_rig(
                    {name: list(stored[name][half] - 1.0) for name in ("cam1", "cam2")},
                    stored["board_xy_mm"] / 1e3,
                    {"cam1": size, "cam2": size},
                )
                for half in (order[:18], order[18:])
            ]
            difference = [np.log(h.rig.cameras[0].focal_px) for h in halves], [h.baseline_m for h in halves]
            std = [np.sqrt(h.rig.covariance[0, 0]) for h in halves], [h.baseline_std_m for h in halves]
            scores.append([np.diff(d)[0] / np.hypot(*s) for d, s in zip(difference, std, strict=True)])
        rms = np.sqrt(np.mean(np.square(scores), axis=0))
        assert rms.max() < 1.8  # independent corner errors would be stated with 2.3 and 5.8

    def test_matlab_tracks_triangulate_to_the_stored_points(self, shared_data):
        folder = shared_data("duodic_uniaxial")
        matlab = json.loads((folder / "matlab_stereo_calibration.json").read_text())
        stored = np.load(folder / "tracks_and_reference_3d.npz")
        poses = [np.eye(3, 4), np.column_stack([matlab["R"], matlab["t_mm"]])]
        cameras = [
            Camera(np.array(matlab[name]["K"]), (2448, 2048), np.array(matlab[name]["dist_k1_k2_p1_p2"]), pose)
            for name, pose in zip(("camera1", "camera2"), poses, strict=True)
        ]
        points3d = triangulate(np.stack([stored["cam1"], stored["cam2"]]), Rig(("a", "b"), tuple(cameras)))
        difference = points3d - stored["points3d_mm"]
        assert np.nanmax(np.abs(difference)) < 1e-3

    @pytest.mark.parametrize("name", ["201", "202"])
    def test_multidic_intrinsics(self, shared_data, name):
        folder = shared_data("multidic_cylinder") / "checkerboard"
        stored = np.load(folder / "corners_matlab.npz")
        reference = json.loads((folder / "opencv_intrinsics_reference.json").read_text())[f"opencv_{name}"]
        found = calibrate_camera(
            list(stored[f"cam{name}"] - 1.0),
            stored["board_xyz_mm"][:, :2].astype(float) / 1e3,
            (2464, 3280),
            fix_tangential=False,
        )
        np.testing.assert_allclose(found.camera.K[[0, 1], [0, 1]], np.diag(reference["K"])[:2], rtol=1e-5)
        assert found.rms == pytest.approx(reference["rms"], rel=1e-3)
        assert found.dropped == {}
        # Few pictures say so: the stated deviation covers what five of them give.
        few = calibrate_camera(
            list(stored[f"cam{name}"][::5] - 1.0), stored["board_xyz_mm"][:, :2].astype(float) / 1e3, (2464, 3280)
        )
        error = np.log(few.camera.focal_px / found.camera.focal_px)
        assert abs(error) < 2.5 * np.sqrt(few.covariance[0, 0])
        assert np.sqrt(few.covariance[0, 0]) < 0.03


def frames(*names, size=IMAGE_SIZE):
    return {name: np.zeros((size[1], size[0]), np.uint8) for name in names}


def session(folder, baseline=None, **chessboard):
    return Session(
        name="s",
        view=[{"name": name, "video": f"{name}.mp4"} for name in ("left", "right")],
        site={"baseline": {"value": baseline or 0.2, "std": 0.0005}},
        point=[{"name": "p", "view": "left", "pixel": (1.0, 1.0)}],
        chessboard={"pattern": PATTERN, "square_mm": SQUARE_M * 1e3, **chessboard} if chessboard else None,
        folder=folder,
    )


def save_corners(folder, corners, board=BOARD, **changes):
    arrays = {view: np.array(found) for view, found in corners.items()} | {"board_xy_mm": board * 1e3} | changes
    np.savez(folder / "corners.npz", **{name: array for name, array in arrays.items() if array is not None})


class TestEstimator:
    def test_ready_corners(self, tmp_path):
        rig, corners = simulated(noise_px=0.1)
        corners["right"][1][:] = np.nan
        save_corners(tmp_path, corners)
        estimate = ChessboardCameras().estimate(session(tmp_path, corners="corners.npz"), frames("left", "right"))
        assert estimate.status == "ok"
        assert estimate.rig.names == ("left", "right")
        assert estimate.rig.covariance.shape == (20, 20)
        assert estimate.rig.baseline() == pytest.approx(rig.baseline(), rel=2e-3)
        assert "9 pairs used, 1 dropped" in estimate.notes[0]
        assert "chessboard pair pair 2 dropped: no corners in 'right'" in estimate.notes

    def test_opencv_pictures(self, shared_data):
        folder = shared_data("opencv_chessboards")
        made = session(folder, 0.0828, images={"left": "left??.jpg", "right": "right??.jpg"})
        estimate = ChessboardCameras().estimate(made, frames("left", "right", size=(640, 480)))
        assert estimate.status == "ok"
        assert estimate.rig.baseline() * 1e3 == pytest.approx(82.8, abs=0.2)
        assert estimate.rig.cameras[0].focal_px == pytest.approx(532.3, rel=0.003)
        assert estimate.rig.cameras[1].focal_px == pytest.approx(534.9, rel=0.003)
        dropped = [note for note in estimate.notes if "dropped: no corners in" in note]
        assert [note.split()[2] for note in dropped] == [f"left{n}/right{n}" for n in ("01", "04", "05")]
        assert "10 pairs used, 3 dropped; reprojection error left 0.27" in estimate.notes[0]
        assert any("independent errors" in note for note in estimate.notes)

    def test_measured_baseline_that_disagrees_is_a_status(self, tmp_path):
        _, corners = simulated()
        save_corners(tmp_path, corners)
        estimate = ChessboardCameras().estimate(session(tmp_path, 0.21, corners="corners.npz"), frames("left", "right"))
        assert estimate.status == CameraStatus.BASELINES_DISAGREE
        assert "measured 0.2100 m" in estimate.notes[-1]
        assert "standard deviations; check the size of the squares and the tape" in estimate.notes[-1]

    def test_options_reach_the_calibration(self, tmp_path):
        _, corners = simulated()
        save_corners(tmp_path, corners)
        made = session(tmp_path, corners="corners.npz")
        free = ChessboardCameras(fix_tangential=False, fix_k3=False).estimate(made, frames("left", "right"))
        assert np.all(free.rig.cameras[0].distortion != 0)

    def test_no_chessboard(self, tmp_path):
        with pytest.raises(CameraError, match=r"expected a \[chessboard\] in the session, got none"):
            ChessboardCameras().estimate(session(tmp_path), frames("left", "right"))

    def test_one_view(self, tmp_path):
        with pytest.raises(CameraError, match=r"expected at least two views, got \['left'\]"):
            ChessboardCameras().estimate(session(tmp_path, corners="corners.npz"), frames("left"))

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"right": None}, r"expected arrays \['left', 'right', 'board_xy_mm'\], got no \['right'\]"),
            ({"board_xy_mm": None}, r"got no \['board_xy_mm'\]"),
            ({"board_xy_mm": BOARD[:-1] * 1e3}, r"expected board_xy_mm of shape \(54, 2\).* got \(53, 2\)"),
            ({"board_xy_mm": BOARD}, "expected corners 25 mm apart as in the session, got 0.025 mm"),
            ({"left": np.zeros((3, 50, 2))}, r"expected 'left' of shape \(poses, 54, 2\), got \(3, 50, 2\)"),
            ({"left": np.zeros((3, 54, 2))}, "expected as many pictures in every view"),
            ({"left": np.array([["a"]])}, "expected an npz file of numbers, got none"),
        ],
    )
    def test_faulty_file_of_corners(self, tmp_path, changes, message):
        save_corners(tmp_path, simulated()[1], **changes)
        with pytest.raises(CameraError, match=message):
            ChessboardCameras().estimate(session(tmp_path, corners="corners.npz"), frames("left", "right"))

    def test_absent_or_foreign_file_of_corners(self, tmp_path):
        (tmp_path / "text.npz").write_text("no archive")
        np.save(tmp_path / "plain.npy", np.zeros(3))
        for name in ("none.npz", "text.npz"):
            with pytest.raises(CameraError, match="expected an npz file of numbers, got none that can be read"):
                ChessboardCameras().estimate(session(tmp_path, corners=name), frames("left", "right"))
        with pytest.raises(CameraError, match="expected an npz file of numbers, got a single array"):
            ChessboardCameras().estimate(session(tmp_path, corners="plain.npy"), frames("left", "right"))

    def test_corners_of_another_image_size(self, tmp_path):
        save_corners(tmp_path, simulated()[1])
        with pytest.raises(CameraError, match="expected pixels inside the image of 640 x 480"):
            ChessboardCameras().estimate(
                session(tmp_path, corners="corners.npz"), frames("left", "right", size=(640, 480))
            )


class TestPictures:
    @pytest.fixture
    def folder(self, tmp_path):
        for view in ("left", "right"):
            for number in (1, 2, 10):
                cv2.imwrite(str(tmp_path / f"{view}{number}.png"), np.full((48, 64), 128, np.uint8))
        return tmp_path

    def estimate(self, folder, size=(64, 48), **images):
        images = images or {"left": "left*.png", "right": "right*.png"}
        return ChessboardCameras().estimate(session(folder, images=images), frames("left", "right", size=size))

    def test_pictures_without_a_board_are_named_in_pairs_of_natural_order(self, folder):
        message = r"got \[0\] of 3 \(left1/right1: no corners in 'left' and 'right'; left2/right2: .*left10/right10"
        with pytest.raises(CameraError, match=message):
            self.estimate(folder)

    def test_differing_counts(self, folder):
        (folder / "right2.png").unlink()
        with pytest.raises(CameraError, match=r"as many pictures in every view, got \{'left': 3, 'right': 2\}"):
            self.estimate(folder)

    def test_no_pictures(self, folder):
        with pytest.raises(CameraError, match=r"chessboard\.images: .*top"):
            self.estimate(folder, left="left*.png", right="top*.png")

    def test_view_without_a_pattern(self, folder):
        with pytest.raises(CameraError, match=r"expected a pattern for every view, got none for \['right'\]"):
            self.estimate(folder, left="left*.png")

    def test_pictures_of_another_size_than_the_recording(self, folder):
        with pytest.raises(CameraError, match=r"left1\.png: expected 1280 x 720 pixels .* got 64 x 48"):
            self.estimate(folder, size=IMAGE_SIZE)

    def test_unreadable_picture(self, folder):
        (folder / "right2.png").write_bytes(b"no picture")
        with pytest.raises(CameraError, match=r"right2\.png: expected a picture of 8 or 16 bit, got none"):
            self.estimate(folder)
