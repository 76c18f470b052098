"""Removal of camera motion against cameras that really move, on a site like the paper's and on rendered pictures."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulation import intrinsics, looking_at, simple_rig
from stated_tracks import stated_tracks
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.video import Frame, Video, VideoInfo
from vfm_sdm.stages.camera_motion import remove_camera_motion
from vfm_sdm.stages.camera_motion.estimation import LEVER_ARM_M, compute_motion_jacobian
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.synchronize import align_views
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.studies.synthetic.render import Renderer
from vfm_sdm.studies.synthetic.scene import Face, Scene, Texture, coarsest_pixel

FPS = 60.0
VIEWS = ("left", "right")
TARGET = np.array([9.8, 0.0, 22.4])
RIG = Rig.from_world(
    VIEWS,
    [
        Camera(intrinsics(15500.0), (3840, 2160), np.zeros(5), looking_at(center, TARGET))
        for center in (np.zeros(3), np.array([2.7, -0.1, -2.95]))
    ],
    metric=True,
)
# In the axes of the left camera: the structure at 24 m, what stands still before and behind it.
MOVING = np.array([[0.0, 0.0, 24.4], [-1.2, 0.3, 23.0]])
STATIC = np.array([[-2.1, 1.2, 21.0], [1.9, 1.3, 24.0], [1.6, -1.5, 30.0], [-1.0, -1.6, 33.0], [0.4, 1.5, 27.0]])
NAMES = ["mid", "quarter", *(f"static {k}" for k in range(len(STATIC)))]
SHAKE_RAD = 2 / 15500 * np.sqrt(2)
"""Amplitude whose root mean square moves the picture by 2 px."""


def steady(frames=240):
    return {view: np.zeros((frames, 6)) for view in VIEWS}


def shake(frames=240, *, amplitude=SHAKE_RAD, arm_m=1.0, seed=0):
    """Rotation about all axes and translation of each camera, smooth, shape (T, 6)."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(frames)[:, None] / FPS
    motion = {}
    for view in VIEWS:
        wave = np.sin(2 * np.pi * rng.uniform(0.4, 4.0, 6) * time_s + rng.uniform(0, 6, 6))
        motion[view] = amplitude * wave * np.repeat([1.0, arm_m], 3)
    return motion


def moved(camera, motion):
    """The camera after a motion: what is at X in its axes comes to R(w) X + s."""
    R = Rotation.from_rotvec(motion[:3]).as_matrix()
    return replace(camera, cam_from_world=np.column_stack([R @ camera.rotation, R @ camera.translation + motion[3:]]))


def structure_mm(frames=240):
    """Displacement of the moving points along the left camera's axes, shape (T, 3)."""
    time_s = np.arange(frames)[:, None] / FPS
    return np.array([3.0, 6.0, 2.0]) * np.sin(2 * np.pi * time_s * [1.6, 2.3, 2.9])


def pixels(motion):
    """Exact pixels of moving, then static points in each view, shape (T, P, 2)."""
    frames = len(motion["left"])
    everything = np.repeat(np.vstack([MOVING, STATIC])[None], frames, axis=0)
    everything[:, : len(MOVING)] += structure_mm(frames)[:, None] / 1e3
    position = {}
    for view, camera in zip(VIEWS, RIG.cameras, strict=True):
        R = Rotation.from_rotvec(motion[view][:, :3]).as_matrix()
        at_rest = everything @ camera.rotation.T + camera.translation
        in_camera = np.einsum("tij,tpj->tpi", R, at_rest) + motion[view][:, None, 3:]
        position[view] = Camera(camera.K, camera.image_size).project(in_camera)
    return position


@cache
def still_pixels(frames=240):
    """What cameras at rest see."""
    return pixels(steady(frames))


def tracks_of(position, *, std_px=0.0, stated_px=None, seed=None):
    """Tracks with white noise, and its stated size where that differs."""
    rng = np.random.default_rng(seed)
    tracks = {}
    for view, exact in position.items():
        noise = rng.normal(0, std_px, exact.shape) if seed is not None else 0.0
        stated = std_px if stated_px is None else stated_px
        tracks[view] = stated_tracks(exact + noise, stated, FPS, names=NAMES[: exact.shape[1]], view=view)
    return tracks


def static_names(count=5):
    return [f"static {k}" for k in range(count)]


def about_mean(values):
    return values - values.mean(axis=0)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


# --- geometry --------------------------------------------------------------------------------------------------------


def test_jacobian_is_the_derivative_of_the_moved_camera():
    camera = simple_rig(2, distortion=True).cameras[1]
    X = np.array([[1.0, -0.7, 18.0], [-2.0, 1.5, 33.0]])
    jacobian = compute_motion_jacobian(camera, X)
    for parameter, step in enumerate([1e-5] * 3 + [1e-4] * 3):
        change = step * np.eye(6)[parameter]
        slope = (moved(camera, change).project(X) - moved(camera, -change).project(X)) / (2 * step)
        np.testing.assert_allclose(jacobian[..., parameter], slope, rtol=1e-6, atol=1e-4)


# --- without noise ---------------------------------------------------------------------------------------------------


def test_motion_is_recovered_and_removed():
    motion = shake()
    position, still = pixels(motion), still_pixels()
    found = remove_camera_motion(tracks_of(position), RIG, static_names())
    for view in VIEWS:
        one = found.views[view]
        assert one.status == "ok"
        assert one.applied
        np.testing.assert_allclose(one.rotation, about_mean(motion[view])[:, :3], atol=0.01 * SHAKE_RAD)
        np.testing.assert_allclose(one.translation, about_mean(motion[view])[:, 3:], atol=2e-5)
        left = about_mean(found.tracks[view]["position"].values - still[view])
        assert rms(about_mean(position[view] - still[view])) > 2
        # What is left is of second order in the shift: (3 px)^2 / (2 f).
        assert np.abs(left).max() < 2e-3
        assert one.rms_before_px > 2
        assert one.rms_after_px < 2e-3


@pytest.mark.parametrize("amplitude", [0.0, SHAKE_RAD])
def test_true_displacement_stays(amplitude):
    tracks = tracks_of(pixels(shake(amplitude=amplitude)))
    corrected = remove_camera_motion(tracks, RIG, static_names()).tracks
    displacement = compute_displacement(align_views(corrected), RIG)["displacement"].values[:, :2]
    truth = structure_mm()[:, None] - structure_mm()[:1, None]
    # One per cent of the smallest amplitude.
    np.testing.assert_allclose(about_mean(displacement), about_mean(truth + 0 * displacement), atol=0.02)
    if amplitude:
        shaken = compute_displacement(align_views(tracks), RIG)["displacement"].values[:, :2]
        assert rms(about_mean(shaken - truth)) > 10


def test_translation_alone_is_seen_at_every_depth():
    motion = steady()
    motion["right"][:, 3] = 0.003 * np.sin(np.arange(240) / 9)
    found = remove_camera_motion(tracks_of(pixels(motion)), RIG, static_names())
    assert found.views["left"].status == "still"
    np.testing.assert_allclose(found.views["right"].translation[:, 0], about_mean(motion["right"])[:, 3], atol=2e-5)
    left = about_mean(found.tracks["right"]["position"].values - still_pixels()["right"])
    assert np.abs(left).max() < 0.005


def test_knocked_tripod_leaves_no_step():
    motion = steady()
    motion["left"][100:, :3] = [4e-4, -6e-4, 3e-4]  # 11 px
    found = remove_camera_motion(tracks_of(pixels(motion)), RIG, static_names())
    left = found.tracks["left"]["position"].values - still_pixels()["left"]
    assert np.abs(left[100:].mean(axis=0) - left[:100].mean(axis=0)).max() < 0.01


# --- noise -----------------------------------------------------------------------------------------------------------


def random_motion(seed, frames=400, spread=5e-5):
    """Drawn from the prior of the estimate: independent from frame to frame."""
    rng = np.random.default_rng(seed)
    scale = spread * np.repeat([1.0, LEVER_ARM_M], 3)
    return {view: rng.normal(0, 1, (frames, 6)) * scale for view in VIEWS}


@pytest.mark.parametrize(("count", "stated"), [(1, 0.02), (2, 0.02), (5, 0.02), (5, 0.04), (5, 0.01)])
def test_uncertainty_is_honest(count, stated):
    """Also where the tracks understate or overstate their noise, as long as there are points enough to see it."""
    motion = random_motion(3)
    exact, still = pixels(motion), still_pixels(400)
    tracks = tracks_of(exact, std_px=0.02, stated_px=stated, seed=4)
    found = remove_camera_motion(tracks, RIG, static_names(count))
    for view in VIEWS:
        assert found.views[view].applied
        error = about_mean(found.tracks[view]["position"].values - still[view])
        # The tracks' own covariance is theirs to state; what the correction adds is ours.
        own = tracks[view]["position_covariance"].values - 0.02**2 * np.eye(2)
        covariance = found.tracks[view]["position_covariance"].values - own
        chi_square = np.einsum("tpi,tpij,tpj->tp", error, np.linalg.inv(covariance), error)
        points = chi_square[:, : 2 + (count if count > 1 else 0)]
        np.testing.assert_allclose(points.mean(axis=0), 2.0, rtol=0.2)
        one = found.views[view]
        true = about_mean(motion[view])
        ratio = np.column_stack([one.rotation - true[:, :3], one.translation - true[:, 3:]])
        ratio /= np.column_stack([one.rotation_std, one.translation_std])
        assert 0.8 < rms(ratio) < 1.2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stated", [0.01, 0.02, 0.05])
def test_still_cameras_are_left_alone(seed, stated):
    """Whatever the tracks say of their noise."""
    tracks = tracks_of(still_pixels(), std_px=0.02, stated_px=stated, seed=seed)
    for count in (0, 1, 2, 3, 5):
        found = remove_camera_motion(tracks, RIG, static_names(count))
        for view in VIEWS:
            assert found.tracks[view] is tracks[view]
            assert found.views[view].status in {"still", "no gain", "no static points"}


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_tracks_that_drift_each_for_itself_are_left_alone(count):
    """Slow errors of the tracks, three times their stated noise, agree with some camera motion by chance."""
    statuses = set()
    for seed in range(4):
        rng = np.random.default_rng(seed)
        position = {}
        for view, still in still_pixels().items():
            walk = np.cumsum(rng.normal(0, 1, still.shape), axis=0)
            position[view] = still + 0.03 * walk / walk.std(axis=0)
        tracks = tracks_of(position, std_px=0.01, seed=seed)
        found = remove_camera_motion(tracks, RIG, static_names(count))
        for view in VIEWS:
            assert found.tracks[view] is tracks[view]
            statuses.add(found.views[view].status)
    assert statuses == ({"still"} if count == 1 else {"still", "no gain"})


def test_motion_below_the_noise_is_reduced():
    """The prior shrinks the estimate, so that what is removed never adds more noise than it takes motion."""
    motion = shake(amplitude=0.015 / 15500 * np.sqrt(2))
    still = still_pixels()
    noisy = tracks_of(pixels(motion), std_px=0.02, seed=1)
    found = remove_camera_motion(noisy, RIG, static_names())
    for view in VIEWS:
        assert found.views[view].status == "ok"
        before = about_mean(noisy[view]["position"].values - still[view])[:, :2]
        after = about_mean(found.tracks[view]["position"].values - still[view])[:, :2]
        assert rms(after) < rms(before)


# --- few, missing and bad points -------------------------------------------------------------------------------------


def test_one_static_point_gives_pan_and_tilt():
    motion = shake(arm_m=0.0)
    for view in VIEWS:
        motion[view][:, 2] = 0.0
    tracks = tracks_of(pixels(motion), std_px=0.02, seed=2)
    found = remove_camera_motion(tracks, RIG, ["static 1"])
    for view in VIEWS:
        one = found.views[view]
        assert one.status == "one static point"
        assert one.rms_before_px > 2
        assert np.isnan(one.rms_after_px)
        error = about_mean(found.tracks[view]["position"].values - still_pixels()[view])
        assert rms(error[:, :2]) < 0.2
        # Nothing corrects the point itself.
        own = NAMES.index("static 1")
        np.testing.assert_array_equal(
            found.tracks[view]["position"].values[:, own], tracks[view]["position"].values[:, own]
        )
        assert (found.tracks[view]["status"].values[:, own] == Status.UNRELIABLE).all()
        assert (found.tracks[view]["status"].values[:, :2] == Status.OK).all()


def test_static_points_are_corrected_by_the_others():
    """So that one that moves still shows it, and does not look still by its own doing."""
    position = pixels(shake())
    position["left"][:, 2] += [0.0, 0.3]
    position["left"][::2, 2] -= [0.0, 0.6]
    found = remove_camera_motion(tracks_of(position, std_px=0.02, seed=0), RIG, static_names()).views["left"]
    assert found.status == "ok"
    assert found.point_rms_after_px[0] > 0.3
    assert found.point_rms_after_px[0] == found.point_rms_after_px.max()


def test_gaps_make_no_steps():
    position = pixels(shake())
    still = still_pixels()
    missing = np.random.default_rng(5).random((240, len(STATIC))) < 0.3
    missing[60:80] = True
    missing[:, 0] |= np.arange(240) < 120  # a point that appears when the camera has drifted
    tracks = tracks_of(position, std_px=0.02, seed=1)
    for view in VIEWS:
        tracks[view]["position"].values[:, 2:][missing] = np.nan
        tracks[view]["status"].values[:, 2:][missing] = Status.LOST
    found = remove_camera_motion(tracks, RIG, static_names())
    none = missing.all(axis=1)
    for view in VIEWS:
        assert found.views[view].status == "ok"
        after = found.tracks[view]
        error = (after["position"].values - still[view])[:, :2]
        assert rms(about_mean(error[~none])) < 0.05
        few = ~none & (missing.sum(axis=1) > 2)
        assert np.abs(error[few].mean(axis=0) - error[~none & ~few].mean(axis=0)).max() < 0.03
        # Without any static point: as tracked, marked, and with the recording's usual shift as its uncertainty.
        np.testing.assert_array_equal(after["position"].values[none, :2], tracks[view]["position"].values[none, :2])
        assert (after["status"].values[none, :2] == Status.UNRELIABLE).all()
        assert (after["status"].values[~none, :2] == Status.OK).all()
        std = np.sqrt(after["position_covariance"].values[none, 0, 0, 0])
        assert ((std > 1) & (std < 5)).all()
        assert np.isnan(found.views[view].rotation[none]).all()
        assert np.isfinite(found.views[view].rotation[~none]).all()
        assert np.isnan(after["position"].values[:, 2:][missing]).all()


def test_reference_frame_without_stated_noise_gets_no_more_say():
    """Trackers give the reference frame a covariance of zero."""
    tracks = tracks_of(pixels(shake()), std_px=0.02, seed=1)
    before = {view: tracks[view].copy(deep=True) for view in VIEWS}
    for view in VIEWS:
        tracks[view]["position_covariance"].values[0] = 0.0
    found, plain = (remove_camera_motion(t, RIG, static_names()) for t in (tracks, before))
    np.testing.assert_allclose(found.views["left"].rotation, plain.views["left"].rotation, atol=1e-9)


def test_static_point_that_moves_alone_changes_nothing():
    position = {view: still.copy() for view, still in still_pixels().items()}
    wave = 0.5 * np.sin(np.arange(240) / 5)
    for view in VIEWS:
        position[view][:, 2] += wave[:, None] * [0.3, 1.0]
    tracks = tracks_of(position, std_px=0.02, seed=0)
    for count in (2, 3, 5):
        found = remove_camera_motion(tracks, RIG, static_names(count))
        for view in VIEWS:
            assert found.views[view].status in {"no gain", "still"}
            assert found.views[view].point_rms_before_px[0] > 0.3
            assert found.tracks[view] is tracks[view]


def test_camera_that_has_left_its_known_rest_is_taken_out_though_it_keeps_still():
    """As in a later part of a long recording, whose tripod has settled before it."""
    rest = {v: dict(zip(static_names(), still[0, len(MOVING) :], strict=True)) for v, still in still_pixels().items()}
    settled = {view: one + 5e-5 * np.repeat([1.0, 0.0], 3) for view, one in steady().items()}
    tracks = tracks_of(pixels(settled), std_px=0.02, seed=0)
    found = remove_camera_motion(tracks, RIG, static_names(), rest)
    for view in VIEWS:
        assert found.views[view].status == "ok"
        away = found.tracks[view]["position"].values - still_pixels()[view]
        # Before it was 0.8 px. A mean of 240 frames of 0.02 px, of five points that tell six parameters.
        assert np.abs(away.mean(axis=0)).max() < 0.01
    alone = remove_camera_motion(tracks, RIG, static_names())
    assert all(alone.views[view].status in {"no gain", "still"} for view in VIEWS)


def test_static_point_that_slipped_from_its_known_rest_changes_nothing():
    rest = {v: dict(zip(static_names(), still[0, len(MOVING) :], strict=True)) for v, still in still_pixels().items()}
    position = {view: still.copy() for view, still in still_pixels().items()}
    for view in VIEWS:
        position[view][:, 2] += [0.3, 0.5]
    tracks = tracks_of(position, std_px=0.02, seed=0)
    for count in (2, 3, 5):
        found = remove_camera_motion(tracks, RIG, static_names(count), rest)
        for view in VIEWS:
            assert found.views[view].status in {"no gain", "still"}
            assert found.tracks[view] is tracks[view]


def test_point_without_depth_is_not_corrected_but_marked():
    tracks = tracks_of(pixels(shake()), std_px=0.02, seed=0)
    tracks["right"]["position"].values[:, [1, 3]] = np.nan
    tracks["right"]["status"].values[:, [1, 3]] = Status.LOST
    found = remove_camera_motion(tracks, RIG, static_names())
    left = found.tracks["left"]
    assert found.views["left"].static == ("static 0", "static 2", "static 3", "static 4")
    for point in (1, 3):
        np.testing.assert_array_equal(left["position"].values[:, point], tracks["left"]["position"].values[:, point])
        assert (left["status"].values[:, point] == Status.UNRELIABLE).all()
    alone = remove_camera_motion(tracks, RIG, ["static 1"]).views["left"]
    assert alone.status == "no static points"
    assert np.isnan(alone.rotation).all()
    assert np.isnan(alone.rms_before_px)


# --- rendered pictures -----------------------------------------------------------------------------------------------

SIZE = (480, 300)
FOCAL_PX = 1200.0
RENDERED_FPS = 20.0
RENDERED = Rig.from_world(
    VIEWS,
    [
        Camera(intrinsics(FOCAL_PX, SIZE), SIZE, np.array([-0.05]), looking_at(center, np.array([0.0, 0.0, 10.0])))
        for center in (np.zeros(3), np.array([2.0, -0.1, 0.5]))
    ],
    metric=True,
)
SITE_POINTS = {
    "girder left": (-0.5, 0.02, 10.0),
    "girder right": (0.4, -0.05, 10.0),
    "block": (-0.4, 0.75, 8.5),
    "pier": (0.6, 0.8, 9.4),
    "wall left": (-0.9, -1.0, 13.0),
    "wall right": (0.8, -0.9, 13.0),
}
"""Two points on the girder that moves; the others stand still."""


def rendered_site():
    """A girder between a block and a pier in front of it and a wall behind it; axes of the left camera."""
    plates = {
        "girder": ((-1.0, -0.4, 10.0), (2.2, 0.0, 0.0), (0.0, 0.8, 0.0)),
        "block": ((-1.0, 0.5, 8.5), (1.1, 0.0, 0.0), (0.0, 1.0, 0.0)),
        "pier": ((0.3, 0.5, 9.4), (0.9, 0.0, 0.0), (0.0, 1.2, 0.0)),
        "wall": ((-4.0, -3.0, 13.0), (7.0, 0.0, 0.0), (0.0, 6.0, 0.0)),
    }
    faces = []
    for number, (name, (corner, u, v)) in enumerate(plates.items()):
        pixel = coarsest_pixel(corner, u, v, RENDERED.cameras)
        texture = Texture(number, 110.0, 25.0, (2.8 * pixel[0], 2.8 * pixel[1]), longest_m=0.3)
        faces.append(Face(name, np.array(corner), np.array(u), np.array(v), texture, moving=name == "girder"))
    return Scene(tuple(faces))


def girder_mm(frames):
    """Lateral, vertical, longitudinal displacement of the girder, shape (T, 3); at rest at first."""
    time_s = np.maximum(np.arange(frames) / RENDERED_FPS - 0.3, 0.0)[:, None]
    return np.array([1.5, 3.0, 0.5]) * np.sin(2 * np.pi * time_s * [1.1, 0.8, 1.7])


class Pictures:
    """Frames in memory as a source for `Video`."""

    def __init__(self, frames):
        self.frames = frames
        seconds = len(frames) / RENDERED_FPS
        self.info = VideoInfo("memory", *SIZE, RENDERED_FPS, len(frames), seconds, "raw", "gray", 8, 0)

    def stream(self):
        return (Frame(number, number / RENDERED_FPS, luma, None) for number, luma in enumerate(self.frames))


def film(scene, motion):
    """Tracks in pictures of the site through cameras that move, with noise of one grey level."""
    rng = np.random.default_rng(11)
    tracks = {}
    for view, camera in zip(VIEWS, RENDERED.cameras, strict=True):
        frames, renderer = [], Renderer(scene, camera, reach_m=0.006)
        for change, d in zip(motion[view], girder_mm(len(motion[view])), strict=True):
            if change.any():
                renderer = Renderer(scene, moved(camera, change), reach_m=0.006)
            luma = renderer.render(lambda positions, d=d: np.tile(d / 1e3, (len(positions), 1)))
            frames.append(np.clip(np.rint(luma + rng.normal(0, 1, luma.shape)), 0, 255).astype(np.uint8))
        points = camera.project(np.array(list(SITE_POINTS.values())))
        tracks[view] = IcgnTracker().track(Video(Pictures(frames)), points, names=list(SITE_POINTS))
    return tracks


def girder_displacement(tracks):
    """Of the points on the girder, shape (T, 2, 3) [mm]."""
    return compute_displacement(align_views(tracks), RENDERED)["displacement"].values[:, :2]


def test_rendered_tripod_shake_of_two_pixels_is_reduced_tenfold():
    frames = 36
    motion = shake(frames, amplitude=2 / FOCAL_PX * np.sqrt(2), arm_m=LEVER_ARM_M, seed=3)
    for view in VIEWS:
        motion[view] -= motion[view][0]  # the cameras are known as they stood in the first frame
    scene = rendered_site()
    static = list(SITE_POINTS)[2:]
    tracks = film(scene, motion)
    found = remove_camera_motion(tracks, RENDERED, static)
    truth = girder_mm(frames)[:, None]
    before = about_mean(girder_displacement(tracks) - truth)
    after = about_mean(girder_displacement(found.tracks) - truth)
    reduction = np.sqrt(np.mean(before**2, axis=(0, 1)) / np.mean(after**2, axis=(0, 1)))
    for view in VIEWS:
        assert found.views[view].status == "ok"
        assert found.views[view].rms_before_px > 2
        assert found.views[view].rms_after_px < 0.1 * found.views[view].rms_before_px
    assert (reduction > 10).all()


def test_rendered_still_cameras_are_left_alone():
    tracks = film(rendered_site(), steady(20))
    found = remove_camera_motion(tracks, RENDERED, list(SITE_POINTS)[2:])
    for view in VIEWS:
        change = found.tracks[view]["position"].values - tracks[view]["position"].values
        assert np.abs(change).max() < 0.01


# --- refusals --------------------------------------------------------------------------------------------------------


def test_refusals():
    tracks = tracks_of(still_pixels(5))
    with pytest.raises(DatasetError, match="expected metres"):
        remove_camera_motion(tracks, Rig(RIG.names, RIG.cameras, metric=False), static_names())
    with pytest.raises(DatasetError, match="expected views"):
        remove_camera_motion({"left": tracks["left"]}, RIG, static_names())
    with pytest.raises(DatasetError, match="'right': expected points"):
        remove_camera_motion({**tracks, "right": tracks["right"].isel(point=[1, 0, 2, 3, 4, 5, 6])}, RIG, [])
    for names in (["pier"], ["static 0", "static 0"]):
        with pytest.raises(DatasetError, match="expected distinct names"):
            remove_camera_motion(tracks, RIG, names)
