"""Modes that everything else contradicts."""

from dataclasses import replace

import numpy as np
import pytest

from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.profiles import CROP, expect_lens, find_camera, read_setting
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.profile_checks import Found, compare_with_mode, compare_with_profiles

SIZE = (1920, 1080)
SITE = {"baseline": {"value": 1.0, "std": 0.01}}


def key_of(camera, mode, stabilised):
    found = find_camera(camera)
    setting = replace(read_setting([mode], found.kind), aspect="16:9", stabilised=stabilised)
    return replace(found, setting=setting)


LINEAR = key_of("GoPro HERO7 Black", "Linear", False)


@pytest.mark.parametrize(
    ("key", "away", "std", "words"),
    [
        (
            LINEAR,
            -np.log(CROP),
            0.01,
            "10 % longer than calibrators of 'gopro hero7black', linear, 16:9, not",
        ),
        (LINEAR, -np.log(CROP), 0.01, "nearer lies: stabilised"),
        (key_of("GoPro HERO7 Black", "Linear", True), np.log(CROP), 0.01, "nearer lies: not stabilised"),
        (LINEAR, 0.04, 0.01, ""),
        (LINEAR, -0.04, 0.01, ""),
        # Nobody knows it well enough to say.
        (LINEAR, -np.log(CROP), 0.06, ""),
        # Without a mode nothing is stated that could be wrong.
        (key_of("GoPro HERO7 Black", "", False), 0.1, 0.01, ""),
        (key_of("iPhone 13", "26mm", None), 0.1, 0.01, "11 % longer"),
    ],
)
def test_a_crop_is_noticed_where_the_focal_length_is_told(key, away, std, words):
    said = compare_with_mode(key, Found(expect_lens(key).log_focal.mean + away, std))
    assert (words in said) if words else not said


def test_another_mode_is_named():
    key = key_of("GoPro HERO8 Black", "Wide", False)
    narrow = replace(key, setting=replace(key.setting, mode="linear"))
    means = [expect_lens(one).log_focal.mean for one in (key, narrow)]
    away = means[1] - means[0]
    assert "nearer lies" in compare_with_mode(key, Found(means[0] + np.sign(away) * max(abs(away), 0.06), 0.005))


def rig(log_focal, std):
    K = np.diag([np.exp(log_focal) * SIZE[0], np.exp(log_focal) * SIZE[0], 1.0])
    cameras = (Camera(K, SIZE), Camera(K, SIZE).perturbed([0] * 7 + [1, 0, 0]))
    covariance = np.zeros((20, 20))
    covariance[[0, 10], [0, 10]] = std**2
    return Rig(("left", "right"), cameras, True, covariance)


@pytest.mark.parametrize(
    ("moved", "std", "noted"),
    [
        # Half of the way to a value that is as well known as the profile: that value is 10 % off.
        (0.5, np.sqrt(0.5), False),
        (0.98, np.sqrt(0.02), True),
        (0.3, np.sqrt(0.7), False),
    ],
)
def test_the_profile_is_taken_out_of_what_it_drew_to_itself(tmp_path, moved, std, noted):
    focal = expect_lens(LINEAR).log_focal
    lens = {"camera": "GoPro HERO7 Black", "mode": "Linear", "stabilised": False}
    session = Session(
        name="bridge",
        folder=tmp_path,
        view=[{"name": name, "video": "a.mp4", "lens": lens} for name in ("left", "right")],
        point=[{"name": "p", "view": "left", "pixel": [1.0, 1.0]}],
        site=SITE,
    )
    frames = {name: np.zeros(SIZE[::-1], np.uint8) for name in ("left", "right")}
    found = compare_with_profiles(
        session, frames, rig(focal.mean, focal.std), rig(focal.mean + moved * np.log(1.1), std * focal.std)
    )
    assert [note[:12] for note in found] == (["view 'left':", "view 'right'"] if noted else [])


def test_known_cameras_and_unknown_ones_are_not_compared(tmp_path):
    views = [{"name": "left", "video": "a.mp4", "camera": "rig.toml"}, {"name": "right", "video": "a.mp4"}]
    point = [{"name": "p", "view": "left", "pixel": [1.0, 1.0]}]
    session = Session(name="bridge", folder=tmp_path, view=views, point=point, site=SITE)
    frames = {name: np.zeros(SIZE[::-1], np.uint8) for name in ("left", "right")}
    assert compare_with_profiles(session, frames, rig(0.0, 0.1), rig(0.5, 0.01)) == []
    without = replace(rig(0.0, 0.1), covariance=None)
    assert compare_with_profiles(session, frames, without, rig(0.5, 0.01)) == []
