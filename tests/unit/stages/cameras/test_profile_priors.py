"""Priors of cameras by their profiles: stated, named by a file, contradicted, and of nothing at all."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import IFD, Base

from tagged_films import write_tagged
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.profiles import Setting, expect_any, expect_lens, find_camera
from vfm_sdm.inputs.session import FirstFrames, Lens, Session
from vfm_sdm.inputs.video import CameraTags, open_video
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.cameras.profile_priors import prior_of_stated, prior_of_tags, prior_of_unknown

HD = (1920, 1080)
GOPRO = CameraTags("GoPro", "HERO7 Black", ("Linear",), None, False)


def session_of(folder, lens=None, **source):
    views = [{"name": name, "lens": lens, **source} for name in ("left", "right")]
    point = {"name": "p", "view": "left", "pixel": [10.0, 10.0]}
    return Session(
        name="bridge", folder=folder, view=views, point=[point], site={"baseline": {"value": 1.0, "std": 0.01}}
    )


def priors_of(session, size=HD):
    frames = {name: np.zeros(size[::-1], np.uint8) for name in ("left", "right")}
    return read_priors(session, frames, estimator="two-view")


@pytest.mark.parametrize("size", [HD, HD[::-1]])
def test_a_stated_camera_becomes_the_prior(tmp_path, size):
    lens = {"camera": "GoPro HERO7 Black", "mode": "4K Wide", "stabilised": True}
    priors = priors_of(session_of(tmp_path, lens, video="a.mp4"), size)
    setting = Setting("wide", None, True, "16:9")
    profile = expect_lens(replace(find_camera("GoPro HERO7 Black"), setting=setting))
    camera, covariance = priors.cameras[0], priors.intrinsics_covariance[0]
    assert camera.focal_px / 1920 == pytest.approx(np.exp(profile.log_focal.mean))
    assert covariance[0, 0] == pytest.approx(profile.log_focal.std**2)
    corner = np.hypot(*HD) / 2 / camera.focal_px
    np.testing.assert_allclose(camera.distortion[[0, 1, 4]] * corner ** np.array([2, 4, 6]), profile.corner)
    assert np.sqrt(covariance[3, 3]) * corner**2 == pytest.approx(profile.corner_std)
    assert "'GoPro HERO7 Black', wide, 16:9, stabilised" in priors.notes[0]
    assert "calibrators of the model" in priors.notes[0]
    # What the lens bends is seen all over the picture, and none of it folds.
    across = np.stack(np.meshgrid(*(np.linspace(0, side - 1, 9) for side in size)), axis=-1).reshape(-1, 2)
    assert np.isfinite(camera.normalize(across)).all()


def test_a_camera_most_of_whose_modes_are_too_wide_needs_its_mode(tmp_path):
    with pytest.raises(CameraError, match=r"unknown mode, 4:3.*state the mode, best a linear one"):
        prior_of_stated(Lens(camera="GoPro HERO7 Black"), (1440, 1080), CameraTags())


def test_nothing_known_is_any_lens():
    prior = prior_of_unknown()
    assert (np.log(prior.focal), prior.relative_std) == pytest.approx((expect_any().mean, expect_any().std))
    assert "nothing known of the lens" in prior.notes[0]


@pytest.mark.parametrize("mode", ["HyperView", "SuperView"])
def test_a_mode_that_the_camera_model_does_not_describe_is_refused(mode):
    lens = Lens(camera="GoPro HERO11 Black", mode=mode)
    with pytest.raises(CameraError, match=r"GoPro HERO11 Black.*does not describe; film in a linear mode, or"):
        prior_of_stated(lens, HD, CameraTags())
    tags = CameraTags("GoPro", "HERO11 Black", (mode,))
    prior = prior_of_tags(tags, HD)
    assert prior.relative_std == expect_any().std
    assert "its profile is not used" in prior.notes[-1]


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ({"mode": "XAVC S"}, "names no field of view"),
        ({"mode": "4:3 Linear"}, "is 4:3, and the picture 16:9"),
        ({"mode": "Linear", "stabilised": True}, "not stabilised, and the session the opposite"),
        ({"mode": "Wide"}, "states the mode 'wide', and the file 'linear'"),
    ],
)
def test_what_is_odd_of_a_statement_is_noted(lens, words):
    prior = prior_of_stated(Lens(camera="GoPro HERO7 Black", **lens), HD, GOPRO)
    assert any(words in note for note in prior.notes)


def test_another_camera_than_the_file_names_is_noted():
    lens = Lens(camera="iPhone 13")
    assert any("the file names 'GoPro HERO7 Black'" in note for note in prior_of_stated(lens, HD, GOPRO).notes)
    same = CameraTags("Apple", "iPhone 13", ("iPhone 13 back camera 5.1mm f/1.6",), 26.0)
    assert len(prior_of_stated(lens, HD, same).notes) == 1
    assert len(prior_of_stated(Lens(camera="GoPro HERO7 Black", mode="Linear", stabilised=False), HD, GOPRO).notes) == 1
    # A lens of 77 mm is not the main one.
    tele = replace(same, film_mm=77.0)
    notes = prior_of_stated(Lens(camera="iPhone 13", mode="1x"), HD, tele).notes
    assert any("a lens of 77 mm" in note for note in notes)


def test_a_film_that_names_its_camera_needs_no_lens(tmp_path):
    tags = {
        "com.apple.quicktime.make": "Apple",
        "com.apple.quicktime.model": "iPhone 13",
        "com.apple.quicktime.camera.focal_length.35mm_equivalent": "26",
    }
    video = open_video(write_tagged(tmp_path / "a.mov", tags))
    frames = FirstFrames({"left": video, "right": video})
    priors = read_priors(session_of(tmp_path, video="a.mov"), frames, estimator="two-view")
    key = replace(find_camera("iPhone 13"), setting=Setting("", 26.0, None, "4:3"))
    focal = expect_lens(key).log_focal
    assert priors.cameras[0].focal_px / 96 == pytest.approx(np.exp(focal.mean))
    assert priors.intrinsics_covariance[0, 0, 0] == pytest.approx(focal.std**2)
    assert "the file names 'Apple iPhone 13', 26 mm" in priors.notes[0]


def test_a_film_of_an_unknown_camera_is_of_any_lens(tmp_path):
    assert prior_of_tags(CameraTags("Unheard", "of"), HD) is None
    assert prior_of_tags(CameraTags(), HD) is None
    video = open_video(
        write_tagged(tmp_path / "a.mov", {"com.android.manufacturer": "Unheard", "com.android.model": "of"})
    )
    priors = read_priors(
        session_of(tmp_path, video="a.mov"), FirstFrames({"left": video, "right": video}), estimator="two-view"
    )
    assert "nothing known of the lens" in priors.notes[0]


def photographs(folder, film_mm=None):
    exif = Image.Exif()
    exif[Base.Make], exif[Base.Model] = "Apple", "iPhone 13"
    if film_mm is not None:
        exif.get_ifd(IFD.Exif)[Base.FocalLengthIn35mmFilm] = film_mm
    Image.fromarray(np.zeros((72, 96), np.uint8)).save(folder / "0.jpg", exif=exif)


def test_photographs_name_their_camera(tmp_path):
    photographs(tmp_path)
    priors = priors_of(session_of(tmp_path, images="*.jpg", fps=30.0), (96, 72))
    assert "the file names 'Apple iPhone 13'" in priors.notes[0]
    photographs(tmp_path, film_mm=26)
    assert "focal length from EXIF" in priors_of(session_of(tmp_path, images="*.jpg", fps=30.0), (96, 72)).notes[0]
    stated = session_of(tmp_path, {"camera": "GoPro HERO7 Black", "mode": "Linear"}, images="*.jpg", fps=30.0)
    assert "the file names 'Apple iPhone 13'" in priors_of(stated, (96, 72)).notes[0]


def test_a_pixel_that_is_wider_than_high(tmp_path):
    prior = prior_of_stated(Lens(camera="iPhone 13"), (1440 * 4 / 3, 1080), CameraTags())
    assert "16:9" in prior.notes[0]
    assert isinstance(priors_of(session_of(tmp_path, {"camera": "phone"}, video="a.mp4")).cameras[0], Camera)
