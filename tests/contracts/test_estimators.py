"""One suite over every camera estimator: what any of them promises, whatever its method."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest

from boards import add_noise, board_poses, see_board
from golden import golden_folder, load_recipe, read_shapes
from known_cameras import (
    KnownCameras,
    KnownGuidedCameras,
    Pictures,
    as_colors,
    network_cameras,
    with_pictures,
    write_pictures,
)
from rooms import BASELINE_M, SIZE, room_frames, room_rig, room_session
from vfm_sdm.core.parts import BUILT_IN
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import BackendUnavailableError, CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.inputs.session import FirstFrames, Network, open_views
from vfm_sdm.stages.cameras.base import CameraEstimate, find_estimator
from vfm_sdm.stages.cameras.chessboard.detection import board_points
from vfm_sdm.stages.cameras.file import write_rig
from vfm_sdm.stages.cameras.network_rig import related_matches
from vfm_sdm.stages.cameras.site import compare_rigs

ESTIMATORS = BUILT_IN["cameras"]
NETWORKS = {name for name, part in ESTIMATORS.items() if part.needs is not None and part.needs.checkpoints}
"""Estimators whose weights cannot be had here: they run with a stand-in that knows the room, or with random weights."""
USES_IMAGES = {name for name, part in ESTIMATORS.items() if "baseline" in part.requires}
NEEDS_FEATURES = USES_IMAGES - NETWORKS
NEEDS_TWO_VIEWS = {"chessboard", *USES_IMAGES}
PACKAGES = {name: part.needs.packages[0] for name, part in ESTIMATORS.items() if part.needs is not None}

PATTERN, SQUARE_M = (9, 6), 0.25
RESIZED = (518, 392)
"""What VGGT makes of the room's pictures."""
KNOWN = {"vggt": lambda rig, shown: KnownCameras(rig, shown, [RESIZED] * 2), "posediffusion": KnownGuidedCameras}
"""Stand-ins that know the room, by estimator."""
FOCAL_FACTOR = 1.005
"""How much too long the stated focal lengths are: half of their standard deviation."""
FILE_STD = np.array([1e-3, 0.5, 0.5, 1e-3, *[1e-3] * 3, *[2e-3] * 3])


@pytest.fixture(scope="module")
def room():
    """The true rig, and what its cameras see."""
    rig = room_rig(2)
    return rig, Pictures(room_frames(rig))


@pytest.fixture(params=sorted(ESTIMATORS))
def name(request):
    package = PACKAGES.get(request.param)
    if package is not None and find_spec(package) is None:
        pytest.skip(f"{request.param!r} needs {package}, which is not installed")
    return request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory, room):
    """All that an estimator may read: a camera file of known accuracy, corners of a chessboard, the first pictures."""
    made, rng = tmp_path_factory.mktemp("room"), np.random.default_rng(5)
    truth = room[0]
    std = np.concatenate([FILE_STD * [1, 1, 1, 1, *[0] * 6], FILE_STD])
    stated = truth.perturbed(rng.normal(0, std))
    stated = stated.scaled(BASELINE_M / stated.baseline())
    write_rig(made / "rig.toml", Rig(truth.names, stated.cameras, True, np.diag(std**2)))
    board = board_points(PATTERN, SQUARE_M)
    # Poses for a board a tenth of the size, moved into the middle of the room.
    poses = board_poses(rng, 12) * np.array([1, 1, 1, 10.0])
    poses[:, :, 3] += [-0.1, 0.1, 1.0]
    corners = add_noise(see_board(truth, poses, board), rng, 0.1)
    np.savez(made / "corners.npz", board_xy_mm=1e3 * board, **{view: np.array(seen) for view, seen in corners.items()})
    write_pictures(made, truth.names, as_colors(room[1]))
    return made


def session_for(name, folder, rig, **more):
    """A session with what the estimator needs, and with nothing that answers for it."""
    fields = dict(more)
    if name == "file":
        fields["view"] = [{"name": n, "video": f"{n}.mp4", "camera": "rig.toml"} for n in rig.names]
    if name == "chessboard":
        fields["chessboard"] = {"pattern": PATTERN, "square_mm": 1e3 * SQUARE_M, "corners": "corners.npz"}
    session = room_session(rig, focal_factor=FOCAL_FACTOR, folder=folder, **fields)
    return with_pictures(session) if name in NETWORKS else session


def asked(name, folder, rig, frames, room):
    """What the estimator answers; one that wants colours sees the recordings, the first view of ``frames`` first."""
    session = session_for(name, folder, rig)
    if name in NETWORKS:
        videos = open_views(session)
        frames = FirstFrames({view: videos[view] for view in frames})
    return estimator_for(name, folder, room).estimate(session, frames)


def estimator_for(name, folder, room=None):
    """The estimator; a network knows the room where one is given, else it has random weights."""
    if name not in NETWORKS:
        return find_estimator(name)
    return network_cameras(name, folder, None if room is None else KNOWN[name](room[0], as_colors(room[1])))


@pytest.fixture(scope="module")
def estimates(room, folder):
    """Estimate by name, of a network that knows the room; made once."""
    made = {}

    def estimate(name):
        if name not in made:
            rig, frames = room
            made[name] = asked(name, folder, rig, frames, room)
        return made[name]

    return estimate


def test_finds_a_camera_for_every_view(name, estimates, room):
    estimate = estimates(name)
    assert isinstance(estimate, CameraEstimate)
    assert estimate.status == "ok"
    assert estimate.rig.names == room[0].names
    assert [camera.image_size for camera in estimate.rig.cameras] == [SIZE] * 2


def test_the_first_camera_is_the_origin(name, estimates):
    np.testing.assert_allclose(estimates(name).rig.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)


def test_the_rig_is_metric_and_has_the_measured_baseline(name, estimates):
    rig = estimates(name).rig
    assert rig.metric
    assert rig.baseline() == pytest.approx(BASELINE_M, abs=0.015)


def test_the_covariance_is_one(name, estimates):
    covariance = estimates(name).rig.covariance
    size = 2 * len(CAMERA_PARAMETERS)
    assert covariance.shape == (size, size)
    assert np.isfinite(covariance).all()
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
    # In units of the standard deviations, or the largest would hide the others.
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std).clip(1e-30)
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    assert (std[:3] > 0).all()


def test_the_origin_is_certain(name, estimates):
    covariance = estimates(name).rig.covariance
    np.testing.assert_array_equal(covariance[4:10], 0.0)


def test_truth_lies_within_the_stated_uncertainty(name, estimates, room):
    rig = estimates(name).rig
    difference = compare_rigs(room[0], rig)
    std = np.sqrt(np.diag(rig.covariance))
    assert (np.abs(difference) <= 4 * std + 1e-9).all()


def test_pose_agrees_with_truth(name, estimates, room):
    difference = compare_rigs(room[0], estimates(name).rig)[-6:]
    assert np.abs(difference[:3]).max() < np.radians(0.3)
    assert np.abs(difference[3:]).max() < 0.03 * BASELINE_M


def test_matches_are_pixels_of_both_images(name, estimates):
    for matches in estimates(name).matches:
        assert 0 <= matches.first < matches.second < 2
        for points in (matches.points_first, matches.points_second):
            assert len(points) >= 30
            assert ((points >= -0.5) & (points <= np.array(SIZE) - 0.5)).all()


def test_image_based_estimators_hand_on_their_matches(name, estimates):
    assert bool(estimates(name).matches) == (name in USES_IMAGES)


def test_is_deterministic(name, estimates, room, folder):
    rig, frames = room
    first, second = estimates(name), asked(name, folder, rig, frames, room)
    assert first.status == second.status == "ok"
    for a, b in zip(first.rig.cameras, second.rig.cameras, strict=True):
        # Where an array lies in memory decides the order in which a matrix product is summed, and that rounding whether
        # an adjustment takes one more step: it stops where the cost falls by less than 1e-12 of itself, that is within
        # 1e-6 standard deviations of its minimum, here some 1e-3 of a pixel's or a metre's.
        np.testing.assert_allclose(a.K, b.K, rtol=1e-9)
        np.testing.assert_allclose(a.cam_from_world, b.cam_from_world, rtol=0, atol=1e-9)
    np.testing.assert_allclose(first.rig.covariance, second.rig.covariance, rtol=1e-6, atol=1e-18)
    assert [len(m) for m in first.matches] == [len(m) for m in second.matches]


def test_the_first_frame_is_the_reference_view(name, room, folder):
    rig, frames = room
    swapped = Pictures({view: frames[view] for view in reversed(rig.names)})
    truth = Rig.from_world(rig.names[::-1], rig.cameras[::-1], metric=True)
    found = asked(name, folder, rig, swapped, room).rig
    assert found.names == truth.names
    np.testing.assert_allclose(found.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)
    difference = compare_rigs(truth, found)[-6:]
    assert np.abs(difference[:3]).max() < np.radians(0.3)
    assert np.abs(difference[3:]).max() < 0.03 * BASELINE_M


def test_frames_are_not_changed(name, estimates, room):
    before = {view: frame.copy() for view, frame in room[1].items()}
    estimates(name)
    for view, frame in room[1].items():
        np.testing.assert_array_equal(frame, before[view])


def test_featureless_frames_are_a_named_failure(name, room, folder):
    if name not in NEEDS_FEATURES:
        pytest.skip(f"{name!r} does not rest on features")
    rig, _ = room
    flat = Pictures({view: np.full(SIZE[::-1], 90, np.uint8) for view in rig.names})
    estimate = find_estimator(name).estimate(session_for(name, folder, rig), flat)
    assert (estimate.rig, estimate.matches) == (None, ())
    assert estimate.status != "ok"
    assert "left and right: 0 of 0 matches agree" in estimate.notes[-1]


def test_one_view_is_refused(name, room, folder):
    if name not in NEEDS_TWO_VIEWS:
        pytest.skip(f"{name!r} needs no second view")
    rig, frames = room
    with pytest.raises(CameraError, match=r"expected at least two views, got \['left'\]; add a \[\[view\]\]"):
        estimator_for(name, folder).estimate(session_for(name, folder, rig), Pictures({"left": frames["left"]}))


def test_a_missing_baseline_is_refused(name, room, folder):
    if name not in USES_IMAGES:
        pytest.skip(f"{name!r} has its scale from elsewhere")
    rig, frames = room
    session = room_session(rig).model_copy(
        update={"site": room_session(rig).site.model_copy(update={"baseline": None})}
    )
    with pytest.raises(CameraError, match=rf"{name}: expected site\.baseline, got none; measure the distance"):
        estimator_for(name, folder).estimate(session, frames)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(BackendUnavailableError, match=r"cameras: expected one of \[") as caught:
        find_estimator("sfn")
    assert all(repr(known) in str(caught.value) for known in ESTIMATORS)


def test_a_missing_package_is_one_line_that_says_what_to_do(name, monkeypatch):
    if name not in PACKAGES:
        pytest.skip(f"{name!r} needs the core only")
    monkeypatch.setitem(sys.modules, PACKAGES[name], None)
    with pytest.raises(BackendUnavailableError, match=r"pip install 'vfm-sdm\[") as caught:
        find_estimator(name)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def recipe_file(tmp_path_factory):
    """A file of weights of the published size for PoseDiffusion, made by the recipe, wrapped as training leaves it."""
    torch = pytest.importorskip("torch", reason="PoseDiffusion needs torch")
    data, file = golden_folder("posediffusion"), tmp_path_factory.mktemp("weights") / "co3d_model1.pth"
    state = load_recipe(data).state_dict(read_shapes(data / "manifest.json"))
    torch.save({f"module.{key}": torch.from_numpy(values) for key, values in state.items()}, file)
    yield file
    file.unlink()


def test_posediffusion_with_recipe_weights_keeps_its_promises(recipe_file, room, folder, monkeypatch):
    """The real network on the room: whatever it answers is complete, named, and the same again."""
    rig, _ = room
    # Matched once: that matches are the same again is shown of all estimators above.
    found_once = []

    def match_once(*given):
        if not found_once:
            found_once.append(related_matches(*given))
        return found_once[0]

    monkeypatch.setattr("vfm_sdm.stages.cameras.posediffusion.related_matches", match_once)
    session = session_for("posediffusion", folder, rig)
    found = []
    for _ in range(2):
        estimator = find_estimator("posediffusion", network=Network(weights=str(recipe_file), device="cpu"))
        estimator.inference.iterations = 1
        found.append(estimator.estimate(session, FirstFrames(open_views(session))))
    first, second = found
    assert first.status in ("ok", CameraStatus.CONTRADICTION, CameraStatus.NOT_A_CAMERA, CameraStatus.ONE_PLACE)
    assert (first.status, first.notes) == (second.status, second.notes)
    assert estimator.weights_id.startswith("co3d_model1-")
    assert (first.rig is None) == (first.status in (CameraStatus.NOT_A_CAMERA, CameraStatus.ONE_PLACE))
    if first.rig is not None:
        assert first.rig.names == rig.names
        assert first.rig.baseline() == pytest.approx(BASELINE_M)
        np.testing.assert_allclose(first.rig.cameras[0].cam_from_world, np.eye(3, 4), atol=1e-12)
        assert np.isfinite(first.rig.covariance).all()
        for a, b in zip(first.rig.cameras, second.rig.cameras, strict=True):
            np.testing.assert_allclose(a.K, b.K, rtol=1e-12)
            np.testing.assert_allclose(a.cam_from_world, b.cam_from_world, rtol=0, atol=1e-12)
