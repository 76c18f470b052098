"""The file of a lens: kept whole, scaled to other sizes of the same shape, and refused with advice."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from vfm_sdm.core.files import file_hash
from vfm_sdm.errors import CameraError, ResultsError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Lens, Session
from vfm_sdm.stages.cameras.culprits import Suspect, advise_on_lens
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.lens.file import KnownLens, read_lens, write_lens

K = np.array([[2000.0, 0.0, 970.0], [0.0, 2000.0, 530.0], [0.0, 0.0, 1.0]])
STD = np.array([1e-3, 2.0, 3.0, 0.01])
COVARIANCE = np.outer(STD, STD) * (np.eye(4) + 0.3 * (np.eye(4, k=3) + np.eye(4, k=-3)))


@pytest.fixture
def known():
    return KnownLens(Camera(K, (1920, 1080), np.array([-0.1, 0.02, 0, 0, 0])), COVARIANCE)


@pytest.fixture
def path(known, tmp_path):
    (tmp_path / "pan.mp4").write_bytes(b"a clip")
    settings, found = {"nearest_m": 50.0}, {"notes": ["one", "two"]}
    return write_lens(tmp_path / "lens.toml", known, clip=tmp_path / "pan.mp4", settings=settings, found=found)


def test_what_was_written_is_read(known, path):
    again = read_lens(path)
    np.testing.assert_array_equal(again.camera.K, K)
    np.testing.assert_array_equal(again.camera.distortion, known.camera.distortion)
    np.testing.assert_array_equal(again.covariance, COVARIANCE)
    assert again.camera.image_size == (1920, 1080)
    document = tomllib.loads(path.read_text())
    assert document["clip"] == {"name": "pan.mp4", "sha256": file_hash(path.parent / "pan.mp4")}
    assert document["settings"] == {"nearest_m": 50.0}
    assert document["found"] == {"notes": ["one", "two"]}


@pytest.mark.parametrize("size", [(3840, 2160), (960, 540), (1280, 720), (854, 480)])
def test_pictures_of_another_size_see_the_same_rays(known, path, size):
    scaled = read_lens(path, image_size=size)
    scale = size[0] / 1920
    pixels = np.array([[0.0, 0.0], [1919.0, 1079.0], [500.0, 800.0]])
    rays = known.camera.normalize(pixels)
    np.testing.assert_allclose(scaled.camera.normalize((pixels + 0.5) * scale - 0.5), rays, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(scaled.covariance)), STD * [1, scale, scale, 1])
    assert scaled.scaled_from == (1920, 1080)
    assert np.linalg.eigvalsh(scaled.covariance / np.outer(STD, STD)).min() > 0


@pytest.mark.parametrize("size", [(1080, 1920), (1920, 1440), (4096, 2160), (1920, 1200)])
def test_pictures_of_another_shape_are_refused(path, size):
    expected = (
        rf"lens.toml: lens file: expected a lens for pictures of {size[0]} x {size[1]} px.*got one for 1920 x 1080"
    )
    with pytest.raises(CameraError, match=expected):
        read_lens(path, image_size=size)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fx = 2000.0", "fx = -1.0", "fx: expected"),
        ("fx = 2000.0", "", "fx: expected a value, got nothing"),
        ("fx = 2000.0", "fx = 2000.0\nfocus = 3", "focus: expected one of the keys"),
        ('"k1"', '"k2"', "expected covariance_parameters .*use a file written by this version"),
        ("vfm-sdm lens 1", "vfm-sdm cameras 1", "format"),
        ("image_size = [", "image_size = [[", "expected TOML"),
    ],
)
def test_a_faulty_file_is_refused_with_what_is_wrong(path, old, new, message):
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CameraError, match=message):
        read_lens(path)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (COVARIANCE * 0, "expected variances > 0"),
        (COVARIANCE + np.outer(STD, STD) * 2 * (np.eye(4, k=1)), "expected a symmetric"),
        (COVARIANCE + 3 * np.outer(STD, STD) * (np.eye(4, k=1) + np.eye(4, k=-1)), "expected a symmetric, positive"),
    ],
)
def test_what_is_no_covariance_is_refused(known, path, covariance, message):
    write_lens(path, KnownLens(known.camera, covariance), clip=path.parent / "pan.mp4")
    with pytest.raises(CameraError, match=message):
        read_lens(path)


def test_a_file_that_is_not_there_says_how_to_make_it(tmp_path):
    with pytest.raises(CameraError, match=r"expected a lens file, got none.*vfm-sdm lens"):
        read_lens(tmp_path / "lens.toml")


def test_a_file_that_cannot_be_written_leaves_nothing(known, path):
    with pytest.raises(ResultsError):
        write_lens(path / "below.toml", known, clip=path.parent / "pan.mp4")
    assert sorted(one.name for one in path.parent.iterdir()) == ["lens.toml", "pan.mp4"]


def session(folder: Path, lens: dict[str, object]) -> Session:
    return Session(
        name="bridge",
        folder=folder,
        view=[{"name": name, "video": f"{name}.mp4", "lens": lens} for name in ("left", "right")],
        site={"baseline": {"value": 4.0, "std": 0.01}},
        point=[{"name": "mid", "view": "left", "pixel": [100.0, 80.0]}],
    )


@pytest.mark.parametrize("size", [(1920, 1080), (3840, 2160)])
def test_the_prior_of_a_session_has_the_whole_covariance(path, size):
    frames = {name: np.zeros(size[::-1], np.uint8) for name in ("left", "right")}
    priors = read_priors(session(path.parent, {"file": "lens.toml"}), frames, estimator="two-view")
    expected = read_lens(path, image_size=size)
    for camera, covariance in zip(priors.cameras, priors.intrinsics_covariance, strict=True):
        np.testing.assert_array_equal(camera.K, expected.camera.K)
        np.testing.assert_array_equal(camera.distortion, expected.camera.distortion)
        np.testing.assert_array_equal(covariance, expected.covariance)
    assert bool(priors.notes) == (size != (1920, 1080))


def test_a_lens_of_another_shape_is_refused_by_the_session(path):
    frames = {name: np.zeros((1080, 1080), np.uint8) for name in ("left", "right")}
    with pytest.raises(CameraError, match="film the pan clip in the mode of the recording"):
        read_priors(session(path.parent, {"file": "lens.toml"}), frames, estimator="two-view")


def test_a_lens_file_that_everything_contradicts_asks_for_another_clip():
    suspect = Suspect("focal left", "px", 2000.0, 2300.0, 10.0, drop=30.0, rank=900.0)
    assert "film the pan clip again" in advise_on_lens(suspect, Lens(file="lens.toml"))
