"""Names, settings, the hierarchy of groups, and what the table says of lenses."""

import gzip
import hashlib
from dataclasses import replace
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest

from vfm_sdm.inputs.profiles import (
    CameraClass,
    LensKey,
    Setting,
    aspect_of,
    expect_any,
    expect_lens,
    find_camera,
    find_tagged,
    read_setting,
)
from vfm_sdm.inputs.profiles import table as tables
from vfm_sdm.inputs.profiles.hierarchy import Moments, collect_moments, expect
from vfm_sdm.inputs.profiles.lookup import expect_focal, scatter_of
from vfm_sdm.inputs.profiles.table import SCATTER, TABLE, ProfileTable, Scatter, read_scatter, read_table
from vfm_sdm.inputs.profiles.words import class_of, plain_model


@pytest.mark.parametrize(
    ("texts", "kind", "expected"),
    [
        (["4K 16:9 Linear", "NO-EIS"], CameraClass.ACTION, Setting("linear", None, False, "16:9")),
        (["Wide", "", "HS EIS"], CameraClass.ACTION, Setting("wide", None, True)),
        (["Wide", "EIS off"], CameraClass.ACTION, Setting("wide", None, False)),
        (["HyperView 8:7"], CameraClass.ACTION, Setting("hyperview", None, None, "8:7")),
        (["Wide"], CameraClass.PHONE, Setting("main")),
        (["ultra wide 13mm 0.5x"], CameraClass.PHONE, Setting("ultra wide", 13.0)),
        (["Back Telephoto camera (51mm equiv.)"], CameraClass.PHONE, Setting("tele", 51.0)),
        (["Sigma 18-35mm f/1.8 @ 24.00mm"], CameraClass.CAMERA, Setting("", 24.0)),
        (["Tamron 28-75mm"], CameraClass.CAMERA, Setting()),
        (["steady shot off", "Zeiss Batis 25mm"], CameraClass.CAMERA, Setting("", 25.0, False)),
        (["Zeiss"], CameraClass.CAMERA, Setting()),
        (["back camera 5.1mm f/1.6"], CameraClass.PHONE, Setting()),
        (["0,5 Wide"], CameraClass.PHONE, Setting("ultra wide")),
        (["无防抖"], CameraClass.ACTION, Setting("", None, False)),
    ],
)
def test_what_texts_say_of_a_lens(texts, kind, expected):
    assert read_setting(texts, kind) == expected


@pytest.mark.parametrize(
    ("brand", "written", "plain"),
    [
        ("GoPro", "HERO 5 black", "hero5black"),
        ("GoPro", "H22.01.02.01.00", "hero11black"),
        ("Samsung", "SM-S908B", "s22ultra"),
        ("Sony", "ILCE-7M4", "a7iv"),
        ("Sony", "ILCE-6400", "a6400"),
        ("DJI", "FC3411", "air2s"),
        ("Panasonic", "Lumix GH5", "gh5"),
    ],
)
def test_one_camera_has_one_name(brand, written, plain):
    assert plain_model(brand, written) == plain
    assert plain in set(read_table().model[read_table().brand == brand.casefold()])


@pytest.mark.parametrize(
    ("brand", "model", "kind"),
    [
        ("apple", "iphone13", "phone"),
        ("xiaomi", "yi4k", "action camera"),
        ("xiaomi", "mi10", "phone"),
        ("dji", "osmoaction3", "action camera"),
        ("dji", "mavic2pro", "drone"),
        ("samsung", "nx500", "camera"),
        ("sony", "xperia1v", "phone"),
        ("sony", "a7iv", "camera"),
    ],
)
def test_kinds_of_cameras(brand, model, kind):
    assert class_of(brand, model) == kind


@pytest.mark.parametrize(("size", "name"), [((3840, 2160), "16:9"), ((1440, 1920), "4:3"), ((1000, 500), "2:1")])
def test_formats(size, name):
    assert aspect_of(*size) == name


def test_a_level_counts_as_much_as_it_tells():
    """Closed form: a precision-weighted mean, level by level."""
    scatter = Scatter({"brand": 0.3, "model": 0.1}, own=0.2, freedom=1e9, widen={})
    moments = Moments(("kind", "brand", "model"), np.array([500.0, 10, 2]), np.array([0.0, 0.5, 1.0]), 0.08)
    brand_gain = 0.3**2 / (0.3**2 + (0.2**2 + 0.1**2) / 10)
    mean, variance = brand_gain * 0.5, (1 - brand_gain) * 0.3**2
    gain = (variance + 0.1**2) / (variance + 0.1**2 + 0.2**2 / 2)
    found = expect(moments, scatter)
    assert found.mean == pytest.approx(mean + gain * (1.0 - mean))
    assert found.std == pytest.approx(np.sqrt((1 - gain) * (variance + 0.1**2) + 0.2**2))
    # A level without calibrators adds what lenses differ by there, and nothing else.
    empty = expect(replace(moments, count=np.array([500.0, 10, 0]), squares=0.0), scatter)
    assert (empty.mean, empty.std) == pytest.approx((brand_gain * 0.5, np.sqrt(variance + 0.1**2 + 0.2**2)))


def test_levels_hold_what_their_groups_hold():
    rows = [
        {"kind": "phone", "brand": "a", "model": model, "name": model, "mode": "", "film": film, "aspect": "16:9",
         "stabilised": "", "order": 1, "calibrators": count, "log_focal": log, "log_focal_squares": 0.1,
         "corner1": 0, "corner2": 0, "corner3": 0, "corner_squares": 0, "residual": 0, "readout_ms": 0}
        for model, film, count, log in (("x", "0", 2, 0.0), ("x", "26", 1, 0.3), ("y", "0", 3, 1.0))
    ]  # fmt: skip
    table = ProfileTable.from_rows(rows)
    key = LensKey(CameraClass.PHONE, "a", "x", Setting(aspect="16:9"))
    moments = collect_moments(table, key, values=table.log_focal, squares=table.log_focal_squares)
    assert moments.levels == ("kind", "brand", "model", "aspect")
    np.testing.assert_allclose(moments.count, [6, 6, 3, 3])
    np.testing.assert_allclose(moments.mean, [3.3 / 6, 3.3 / 6, 0.1, 0.1])
    assert moments.squares == pytest.approx(0.2 + 2 * 0.1**2 + 0.2**2)


def key_of(camera, mode="", stabilised=None, aspect="16:9"):
    found = find_camera(camera)
    setting = read_setting([mode], found.kind)
    return replace(found, setting=replace(setting, stabilised=stabilised, aspect=aspect))


@pytest.mark.parametrize(
    ("key", "view_deg"),
    [
        # GoPro states 86 degrees for Linear of that camera; Apple's lens of 26 mm sees 65 on 3:2, video some less.
        (key_of("GoPro HERO7 Black", "Linear", False), (80, 90)),
        (key_of("iPhone 13", "26mm"), (55, 70)),
        (key_of("DJI Mini 2"), (65, 78)),
        # 35 mm on a sensor 36 mm wide: 54 degrees, some less in video.
        (key_of("Sony a7IV", "35mm"), (40, 56)),
        (LensKey(CameraClass.PHONE), (55, 75)),
    ],
)
def test_known_fields_of_view(key, view_deg):
    focal = expect_lens(key).log_focal
    assert view_deg[0] < np.degrees(2 * np.arctan(0.5 / np.exp(focal.mean))) < view_deg[1]


@pytest.mark.parametrize("camera", ["GoPro HERO7 Black", "GoPro HERO8 Black", "Insta360 OneR", "iPhone 13"])
@pytest.mark.parametrize("mode", ["", "Linear", "Wide", "26mm"])
def test_what_is_not_known_never_makes_an_interval_shorter(camera, mode):
    known = [expect_lens(key_of(camera, mode, state)).log_focal.std for state in (True, False)]
    assert expect_lens(key_of(camera, mode)).log_focal.std >= max(known)


def test_less_and_less_said_of_a_camera():
    keys = [key_of("GoPro HERO7 Black", "Linear", False), key_of("GoPro HERO7 Black", "Linear"),
            key_of("GoPro HERO7 Black"), LensKey(CameraClass.ACTION)]  # fmt: skip
    stds = [expect_lens(key).log_focal.std for key in keys]
    assert all(one < other for one, other in pairwise(stds))
    assert stds[-1] < expect_any().std


def test_nothing_known_reaches_from_the_widest_lenses_to_14_degrees():
    wide = expect_any()
    assert wide.mean + 2 * wide.std >= np.log(0.5 / np.tan(np.radians(7))) - 1e-9
    assert wide.mean - 2 * wide.std < np.log(0.35)


def test_distortion_of_a_wide_and_of_a_linear_mode():
    linear, wide = (expect_lens(key_of("GoPro HERO7 Black", mode, True)) for mode in ("Linear", "Wide"))
    assert abs(linear.corner).max() < 0.02
    assert wide.corner[0] < -0.2
    assert max(linear.residual, wide.residual) < 1e-3
    # Where the mode is not known either may be true.
    assert expect_lens(key_of("GoPro HERO7 Black")).corner_std > 2 * linear.corner_std
    assert linear.readout_ms >= 0


@pytest.mark.parametrize("mode", ["HyperView", "SuperView"])
def test_modes_that_no_radial_distortion_describes(mode):
    assert not expect_lens(key_of("GoPro HERO11 Black", mode)).described


def test_cameras_by_name():
    assert find_camera("gopro hero 11 black") == LensKey(CameraClass.ACTION, "gopro", "hero11black")
    assert find_camera("Sony").model == ""
    assert find_camera("Action Camera") == LensKey(CameraClass.ACTION)
    with pytest.raises(ValueError, match=r"got 'iPhome 13'; nearest: 'Apple iPhone 13'"):
        find_camera("iPhome 13")
    with pytest.raises(ValueError, match=r"got 'qqqq'; choose one"):
        find_camera("qqqq")


def test_cameras_that_files_name():
    assert find_tagged("GoPro", "HD7.01") == LensKey(CameraClass.ACTION, "gopro", "hero7black")
    # A model that nobody calibrated is one of its maker.
    assert find_tagged("Apple", "iPhone 77") == LensKey(CameraClass.PHONE, "apple", "")
    assert find_tagged("", "iPhone 13").brand == "apple"
    assert find_tagged("Unheard", "of") is None
    assert find_tagged("", "of") is None
    assert find_tagged("NIKON CORPORATION", "NIKON Z 6").model == "z6"
    assert find_tagged("DJI", "FC9999") == LensKey(CameraClass.DRONE, "dji", "")
    # One whose name only begins like a maker's.
    assert find_tagged("Minolta", "of") is None


def test_the_table_is_small_and_the_one_of_this_code(monkeypatch):
    folder = files("vfm_sdm.inputs.profiles")
    for name, checksum in tables._SHA256.items():
        assert hashlib.sha256(folder.joinpath(name).read_bytes()).hexdigest() == checksum
    assert len(folder.joinpath(TABLE).read_bytes()) < 150_000
    assert "CC0" in folder.joinpath("LICENSE-profiles").read_text(encoding="utf-8")
    text = gzip.decompress(folder.joinpath(TABLE).read_bytes()).decode()
    assert len(text.splitlines()) == len(read_table()) + 1
    monkeypatch.setitem(tables._SHA256, SCATTER, "0")
    read_scatter.cache_clear()
    with pytest.raises(OSError, match=r"scatter.json: expected the file that this version was made with"):
        read_scatter()
    monkeypatch.undo()
    read_scatter.cache_clear()


def test_few_calibrations_take_the_scatter_of_action_cameras():
    scatter = read_scatter()
    assert "mode" not in scatter["drone"]
    assert scatter_of(scatter, CameraClass.DRONE, "mode") is scatter["action camera"]["mode"]
    key = LensKey(CameraClass.DRONE, "dji", "mini2", Setting("wide", None, None, "16:9"))
    assert expect_focal(key, read_table(), scatter_of(scatter, CameraClass.DRONE, "mode")).std > 0
