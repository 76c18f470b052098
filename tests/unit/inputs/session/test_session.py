import glob
import re
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from pydantic import ValidationError

from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import (
    Chessboard,
    Length,
    Lens,
    Level,
    Measured,
    Method,
    Network,
    Point,
    Range,
    Report,
    Sensor,
    Session,
    Sfm,
    Sgr,
    Site,
    View,
    lens_from_exif,
    read_session,
    session_hash,
    write_session,
)
from vfm_sdm.stages.refinement import SgrSettings, SgrWeights

DESIGN = """
name = "footbridge 2026-11-20"
[[view]]
name = "left"
video = "left.mp4"
lens = { focal_mm = 25.0, sensor_width_mm = 6.17, relative_std = 0.02 }
[[view]]
name = "right"
images = "right/*.jpg"
fps = 30.0
lens = { focal_px = 15560.0 }
time_offset_s = -0.25
[site]
baseline = { value = 4.00, std = 0.01 }
perpendicular_distance = { value = 9.80, std = 0.02 }
longitudinal_distance = { value = 0, std = 0.05 }
reference_camera_level = { value_deg = 1.0, roll_deg = -0.5, std_deg = 0.3 }
[[site.range]]
point = "1/2 span"
value = 22.0
std = 0.1
[[site.length]]
points = ["1/2 span", "abutment"]
value = 3.0
std = 0.01
[[point]]
name = "1/2 span"
view = "left"
pixel = [1921.5, 1080]
pixel_in = { right = [1800.0, 1070.5] }
[[point]]
name = "abutment"
view = "right"
pixel = [10.0, -0.5]
static = true
[[sensor]]
name = "acc-1"
file = "acc1.csv"
point = "1/2 span"
columns = { time = "t", vertical = "az" }
units = "g"
sampling_rate_hz = 200
[method]
refinement = "sgr"
still_interval_s = [0.0, 2.0]
"""


def write_design(folder: Path, text: str = DESIGN) -> Path:
    path = folder / "session.toml"
    path.write_text(text, encoding="utf-8")
    return path


def make_files(folder: Path) -> None:
    (folder / "right").mkdir()
    for name in ("left.mp4", "acc1.csv", "right/0001.jpg"):
        (folder / name).write_bytes(b"")


def small(**changes: object) -> Session:
    fields: dict[str, object] = {
        "name": "small",
        "view": [{"name": "left", "video": "l.mp4"}, {"name": "right", "video": "r.mp4"}],
        "site": {"baseline": {"value": 4.0, "std": 0.01}},
        "point": [{"name": "a", "view": "left", "pixel": [1.0, 2.0]}],
    }
    return Session(**(fields | changes))


def test_reads_the_session_file_of_the_specification(tmp_path):
    make_files(tmp_path)
    session = read_session(write_design(tmp_path))
    assert session.reference_view.name == "left"
    assert session.view[0].lens == Lens(focal_mm=25.0, sensor_width_mm=6.17, relative_std=0.02)
    assert session.view[1].lens.relative_std == 0.02
    assert (session.view[1].fps, session.view[1].time_offset_s) == (30.0, -0.25)
    assert session.site.baseline == Measured(value=4.0, std=0.01)
    assert session.site.longitudinal_distance.value == 0
    assert session.site.structure_side == "right"
    assert session.site.face_offset_std == 0.1
    assert session.site.range == (Range(point="1/2 span", value=22.0, std=0.1),)
    assert session.site.length[0].points == ("1/2 span", "abutment")
    assert session.point[0].pixel == (1921.5, 1080.0)
    assert session.point[0].pixel_in == {"right": (1800.0, 1070.5)}
    assert (session.point[0].static, session.point[1].static) == (False, True)
    assert session.sensor[0].columns == {"time": "t", "vertical": "az"}
    assert session.method == Method(refinement="sgr", still_interval_s=(0.0, 2.0))
    assert (session.method.tracker, session.method.cameras, session.method.subset_px) == ("icgn", "two-view", None)
    assert session.folder == tmp_path
    assert session.resolve(session.view[0].video) == tmp_path / "left.mp4"


def test_paths_start_at_the_files_folder_even_after_a_change_of_folder(tmp_path, monkeypatch):
    make_files(tmp_path)
    write_design(tmp_path)
    monkeypatch.chdir(tmp_path)
    session = read_session("session.toml")
    monkeypatch.chdir("/")
    assert session.resolve("left.mp4").is_file()
    assert session.resolve(tmp_path / "x") == tmp_path / "x"


def test_patterns_take_wildcards_in_the_folders_name_literally(tmp_path):
    folder = tmp_path / "bridge [2026]"
    folder.mkdir()
    make_files(folder)
    session = read_session(write_design(folder))
    assert session.resolve_pattern("right/*.jpg") == f"{glob.escape(str(tmp_path))}/bridge [[]2026]/right/*.jpg"


def test_a_session_without_points_is_only_for_what_finds_them(tmp_path):
    session = small(point=[])
    assert session.point == ()
    with pytest.raises(SessionError, match=r"point: expected at least 1, got 0; .*vfm-sdm points suggest"):
        session.check_points()
    for name in ("l.mp4", "r.mp4"):
        (tmp_path / name).write_bytes(b"")
    path = write_session(tmp_path / "session.toml", session.model_copy(update={"folder": tmp_path}))
    assert read_session(path, points_needed=False).point == ()
    with pytest.raises(SessionError, match=r"session.toml: point: expected at least 1, got 0"):
        read_session(path)


def test_level_angles_fall_back_to_the_common_value():
    level = Level(value_deg=1.0, roll_deg=-0.5, std_deg=0.3)
    assert (level.pitch, level.roll) == (1.0, -0.5)
    assert (Level(pitch_deg=2.0, std_deg=1).pitch, Level(pitch_deg=2.0, std_deg=1).roll) == (2.0, 0.0)


def test_focal_prior_in_pixels():
    # 25 mm over 6.17 mm sensor width of 3840 pixels: the paper's field test.
    assert Lens(focal_mm=25.0, sensor_width_mm=6.17).focal_prior_px(3840) == pytest.approx(15559.16, abs=0.01)
    assert Lens(focal_px=2615.0).focal_prior_px(1) == 2615.0
    with pytest.raises(SessionError, match="image_width: expected pixels > 0, got 0"):
        Lens(focal_px=2615.0).focal_prior_px(0)


def test_incomplete_lens_without_validation_has_no_focal_length():
    with pytest.raises(SessionError, match="lens: expected a focal length"):
        Lens.model_construct(focal_px=None, focal_mm=None, sensor_width_mm=None).focal_prior_px(100)


@pytest.mark.parametrize("path", ["session2.toml", "runs/1/session.resolved.toml"])
def test_written_session_reads_back_and_leads_to_the_same_files(tmp_path, path):
    make_files(tmp_path)
    session = read_session(write_design(tmp_path))
    written = write_session(tmp_path / path, session)
    again = read_session(written)
    assert [again.resolve(view.video).resolve() for view in again.view if view.video] == [tmp_path / "left.mp4"]
    if Path(path).parent == Path():
        assert again == session
        assert session_hash(again) == session_hash(session)
    else:
        assert again.view[1].images == "../../right/*.jpg"
    assert tomllib.loads(written.read_text(encoding="utf-8"))["method"]["tracker"] == "icgn"


def test_a_sensors_start_survives_the_file(tmp_path):
    sensor = {
        "name": "s",
        "file": "a.csv",
        "columns": {"vertical": "-az"},
        "units": "g",
        "start": "2026-11-20T11:15:30.25+01:00",
    }
    for name in ("l.mp4", "r.mp4", "a.csv"):
        (tmp_path / name).touch()
    written = write_session(tmp_path / "session.toml", small(sensor=[sensor], folder=tmp_path))
    (again,) = read_session(written).sensor
    assert again.start == datetime(2026, 11, 20, 10, 15, 30, 250000, tzinfo=UTC)
    assert again.columns == {"vertical": "-az"}
    native = written.read_text().replace('"2026-11-20T11:15:30.250000+01:00"', "2026-11-20T10:15:30.25Z")
    assert native != written.read_text()
    written.write_text(native)
    assert read_session(written).sensor[0].start == again.start


def test_clocks_and_refinement_of_the_file(tmp_path):
    make_files(tmp_path)
    clock = "time_offset_s = -0.25\ntime_offset_std_s = 0.05\nstart = 2026-11-20T10:15:30.25Z"
    weights = 'longitudinal = 2.5\npixel = 0.1\nsuppressed_axis = "lateral"\nuncertain_view = "right"'
    text = DESIGN.replace("time_offset_s = -0.25", clock)
    text += f'synchronization = "none"\n[method.sgr]\n{weights}\n'
    session = read_session(write_design(tmp_path, text))
    assert session.view[0].start is None
    assert session.view[0].time_offset_std_s is None
    assert session.view[1].start == datetime(2026, 11, 20, 10, 15, 30, 250000, tzinfo=UTC)
    assert session.view[1].time_offset_std_s == 0.05
    assert session.method.synchronization == "none"
    expected = Sgr(longitudinal=2.5, pixel=0.1, suppressed_axis="lateral", uncertain_view="right")
    assert session.method.sgr == expected
    again = read_session(write_session(tmp_path / "again.toml", session))
    assert again == session
    assert session_hash(again) == session_hash(session)
    unlike = session.model_copy(update={"method": session.method.model_copy(update={"sgr": Sgr()})})
    assert session_hash(unlike) != session_hash(session)


def test_refinement_and_synchronisation_are_the_paper_s_when_left_out():
    method = small().method
    assert method.synchronization == "motion"
    defaults, weights = SgrSettings(), SgrWeights()
    assert (method.sgr.suppressed_axis, method.sgr.uncertain_view) == (
        defaults.suppressed_axis,
        defaults.uncertain_view,
    )
    for name in ("longitudinal", "longitudinal_rate", "others", "others_rate", "pixel"):
        assert getattr(method.sgr, name) == getattr(weights, name)


def test_chapters_and_lens_files_are_looked_for_and_move_along(tmp_path):
    (tmp_path / "site").mkdir()
    for name in ("GX01.MP4", "GX02.MP4", "one[1].mp4", "lens.toml"):
        (tmp_path / "site" / name).touch()
    views = [
        {"name": "list", "video": ["GX01.MP4", "GX02.MP4"], "lens": {"file": "lens.toml"}},
        {"name": "pattern", "video": "GX*.MP4", "lens": {"camera": "phone"}},
        {"name": "brackets", "video": "one[1].mp4"},
    ]
    (tmp_path / "May").mkdir()
    point = {"name": "a", "view": "list", "pixel": [1.0, 2.0]}
    site = {"baseline": {"value": 4.0, "std": 0.01}}
    session = Session(name="x", view=views, point=[point], site=site, baseline_visit="../May", folder=tmp_path / "site")
    write_session(tmp_path / "site" / "session.toml", session)
    assert read_session(tmp_path / "site" / "session.toml") == session
    moved = read_session(write_session(tmp_path / "runs" / "October" / "session.toml", session))
    assert str(moved.baseline_visit) == "../../May"
    assert [str(one) for one in moved.view[0].video] == ["../../site/GX01.MP4", "../../site/GX02.MP4"]
    assert str(moved.view[0].lens.file) == "../../site/lens.toml"
    assert moved.view[1].lens.camera == "phone"
    for name in ("GX02.MP4", "lens.toml"):
        (tmp_path / "site" / name).unlink()
    with pytest.raises(SessionError) as caught:
        read_session(tmp_path / "runs" / "October" / "session.toml")
    assert "view[list].video: expected a file at ../../site/GX02.MP4, got no such file" in str(caught.value)
    assert "view[list].lens.file: expected a file at ../../site/lens.toml, got no such file" in str(caught.value)
    (tmp_path / "site" / "GX01.MP4").unlink()
    with pytest.raises(SessionError, match=r"view\[pattern\].video: expected files that match .*GX\*.MP4, got none"):
        read_session(tmp_path / "runs" / "October" / "session.toml")
    (tmp_path / "May").rmdir()
    with pytest.raises(SessionError, match=r"baseline_visit: expected the run folder of an .* at \.\./\.\./May"):
        read_session(tmp_path / "runs" / "October" / "session.toml")


def test_chessboard_paths_move_along(tmp_path):
    board = {"pattern": [9, 6], "square_mm": 12.0, "images": {"left": "cal/l*.png", "right": "cal/r*.png"}}
    session = small(chessboard=board, folder=tmp_path)
    again = read_session(write_session(tmp_path / "out" / "session.toml", session), check_files=False)
    assert again.chessboard.images == {"left": "../cal/l*.png", "right": "../cal/r*.png"}
    absolute = small(chessboard={"pattern": [9, 6], "square_mm": 12.0, "corners": tmp_path / "c.npz"}, folder=tmp_path)
    again = read_session(write_session(tmp_path / "out" / "session.toml", absolute), check_files=False)
    assert again.chessboard.corners == tmp_path / "c.npz"


names = st.text(
    st.characters(exclude_categories=["Cs", "Cc", "Cf", "Cn", "Zl", "Zp"], exclude_characters=["/", "\\"]),
    min_size=1,
    max_size=20,
).filter(lambda name: re.search(r"[^\s.]", name))
lengths = st.floats(1.0, 10.0)


@settings(max_examples=30, deadline=None)
@given(name=names, view=names, point=names, value=lengths, std=lengths, u=st.floats(-0.5, 1e5), static=st.booleans())
def test_any_session_survives_the_file(tmp_path_factory, name, view, point, value, std, u, static):
    folder = tmp_path_factory.mktemp("session")
    session = Session(
        name=name,
        view=(View(name=view, images="*.png", fps=value, lens=Lens(focal_px=value, relative_std=std)),),
        site=Site(baseline=Measured(value=value, std=std), range=(Range(point=point, value=value, std=std),)),
        point=(Point(name=point, view=view, pixel=(u, 0.0), static=static),),
        folder=folder,
    )
    again = read_session(write_session(folder / "s.toml", session), check_files=False)
    assert again == session
    assert session_hash(again) == session_hash(session)


def test_hash_depends_on_every_setting_and_on_nothing_else(tmp_path):
    session = small()
    assert session_hash(session) == session_hash(small(folder=tmp_path))
    assert session_hash(session) == session_hash(small(method={"tracker": "icgn"}))
    assert session_hash(session) != session_hash(small(method={"subset_px": 43}))
    assert session_hash(session) != session_hash(small(name="other"))
    assert len(session_hash(session)) == 64


def test_failed_write_keeps_the_earlier_session(tmp_path, monkeypatch):
    target = write_session(tmp_path / "s.toml", small())
    before = target.read_bytes()

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ResultsError, match=r"s.toml: expected to write it, got: No space left on device"):
        write_session(target, small(name="other"))
    monkeypatch.undo()
    assert target.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_session_is_frozen():
    session = small()
    with pytest.raises(ValidationError, match="frozen"):
        session.name = "other"


def test_all_faults_are_reported_at_once_with_advice(tmp_path):
    path = write_design(
        tmp_path,
        """
name = "x"
metod = 1
folder = "elsewhere"
[[view]]
name = "left"
video = "left.mp4"
lens = { focal_mm = 25.0, sensor_widht_mm = 6.17 }
[[view]]
name = "left"
images = "a/*.jpg"
fps = "30"
[site]
perpendicular_distance = { value = 0.0, std = 0.02 }
structure_side = "up"
[[site.range]]
point = "mid"
value = nan
std = 1.0
[[point]]
name = "1/2 span"
view = "lft"
pixel = [1921.5, -3]
[method]
subset_px = 40
""",
    )
    with pytest.raises(SessionError) as caught:
        read_session(path)
    text = str(caught.value)
    for expected in (
        "session.toml: 13 faults",
        "view[left].lens.sensor_widht_mm: expected one of the keys focal_mm, sensor_width_mm, focal_px, ",
        "did you mean 'sensor_width_mm'",
        "metod: expected one of the keys",
        "did you mean 'method'",
        "folder: expected no such key",
        "view[left].fps: expected a valid number, got '30'",
        "view[left].name: expected a name of its own, got it 2 times",
        "site.perpendicular_distance: expected a length > 0 m, got 0",
        "site.structure_side: expected 'right' or 'left', got 'up'",
        "site.range[1].value: expected a finite number, got nan",
        "site.range[1].point: expected the name of a point (1/2 span), got 'mid'",
        "point[1/2 span].pixel[2]: expected greater than or equal to -0.5, got -3",
        "point[1/2 span].view: expected the name of a view (left, left), got 'lft'; did you mean 'left'?",
        "method.subset_px: expected an odd number of pixels >= 9, got 40",
    ):
        assert expected in text, expected


# What is wrong, and the message that says so.
FAULTS = {
    "no view": ({"view": []}, r"view: expected at least 1, got 0; add one"),
    "no name": ({"name": ""}, r"name: expected"),
    "view is no array": ({"view": {"name": "left"}}, r"view: expected a list of values or \[\[view\]\] tables"),
    "site is an array": ({"site": [{}]}, r"site: expected one table \[site\]"),
    "nameless view": ({"view": [{"video": "l.mp4"}]}, r"view\[1\].name: expected a value, got nothing; add name = "),
    "slash in view": (
        {"view": [{"name": "a/b", "video": "l"}]},
        r"name: expected a name without slashes, .* got 'a/b'",
    ),
    **{
        f"name of {name!a}": (
            {"name": name},
            r"name: expected letters that can be seen, without control characters",
        )
        for name in (" ", "a\x07", "a\u0085", "a\u2028b", "\u202e2026", "a\ufffe", "a\ufdd0", "\U0001ffff")
    },
    "blank view": ({"view": [{"name": " .", "video": "l"}]}, r"name: expected a name without slashes"),
    "turned view": ({"view": [{"name": "a\u2067", "video": "l"}]}, r"name: expected a name without slashes"),
    "no recording": ({"view": [{"name": "left"}]}, r"view\[left\]: expected either video or images, got neither"),
    "two recordings": (
        {"view": [{"name": "left", "video": "l", "images": "*", "fps": 1.0}]},
        r"expected either video or images, got both",
    ),
    "images without fps": ({"view": [{"name": "left", "images": "*"}]}, r"fps: expected frames a second for images"),
    "video with fps": ({"view": [{"name": "left", "video": "l", "fps": 1}]}, r"fps: expected none beside a video"),
    "negative fps": ({"view": [{"name": "left", "images": "*", "fps": -1}]}, r"fps: expected greater than 0, got -1"),
    "half a lens": (
        {"view": [{"name": "left", "video": "l", "lens": {"focal_mm": 25.0}}]},
        r"view\[left\].lens: expected focal_px, focal_mm with sensor_width_mm, .*, got no sensor_width_mm",
    ),
    "two lenses": (
        {"view": [{"name": "left", "video": "l", "lens": {"focal_mm": 25.0, "focal_px": 1.0}}]},
        r"lens: expected one of focal_px, .*, got focal_mm with sensor_width_mm and focal_px",
    ),
    "a focal length beside a camera": (
        {"view": [{"name": "left", "video": "l", "lens": {"camera": "phone", "focal_px": 900.0}}]},
        r"lens: expected one of focal_px, .*, got focal_px and camera; keep one of them",
    ),
    "a camera with another interval": (
        {"view": [{"name": "left", "video": "l", "lens": {"camera": "phone", "relative_std": 0.05}}]},
        r"lens: relative_std: expected none beside camera, whose profiles tell it; remove it",
    ),
    "a mode of no camera": (
        {"view": [{"name": "left", "video": "l", "lens": {"focal_px": 900.0, "mode": "Linear"}}]},
        r"lens: mode, stabilised: expected them beside camera, got no camera; add it",
    ),
    "a camera without profiles": (
        {"view": [{"name": "left", "video": "l", "lens": {"camera": "GoPro HERO11 Blakc"}}]},
        r"lens: camera: expected a camera with profiles, or one of 'phone', .*nearest: 'GoPro HERO11 Black'",
    ),
    "a camera of several makers": (
        {"view": [{"name": "left", "video": "l", "lens": {"camera": "S9"}}]},
        r"lens: camera: expected one camera, got 'S9', which several makers have",
    ),
    "a lens of its own beside a file": (
        {"view": [{"name": "left", "video": "l", "lens": {"file": "lens.toml", "focal_px": 900.0}}]},
        r"lens: expected one of focal_px, .*, got focal_px and file; keep one of them",
    ),
    "a lens file with another interval": (
        {"view": [{"name": "left", "video": "l", "lens": {"file": "lens.toml", "relative_std": 0.05}}]},
        r"lens: relative_std: expected none beside a lens file, which states its own; remove it",
    ),
    "no lens": (
        {"view": [{"name": "left", "video": "l", "lens": {"relative_std": 0.05}}]},
        r"lens: expected focal_px, focal_mm with sensor_width_mm, file, or camera, got none",
    ),
    "certain lens": (
        {"view": [{"name": "left", "video": "l", "lens": {"focal_px": 25.0, "relative_std": 0.0}}]},
        r"relative_std: expected greater than 0, got 0.0",
    ),
    "certain length": ({"site": {"baseline": {"value": 4.0, "std": 0}}}, r"baseline.std: expected greater than 0"),
    "negative length": ({"site": {"baseline": {"value": -4.0, "std": 1}}}, r"baseline.value: expected .* -4.0"),
    "zero baseline": ({"site": {"baseline": {"value": 0, "std": 1}}}, r"site.baseline: expected a length > 0 m, got 0"),
    "yes as length": ({"site": {"baseline": {"value": True, "std": 1}}}, r"baseline.value: expected .* got True"),
    "infinite length": ({"site": {"baseline": {"value": float("inf"), "std": 1}}}, r"finite number, got inf"),
    "no baseline": ({"site": {}}, r"site.baseline: expected the measured distance between the cameras, got nothing"),
    "no baseline for VGGT": (
        {"site": {}, "method": {"cameras": "vggt"}},
        r"site.baseline: expected the measured distance between the cameras, got nothing",
    ),
    "no baseline for PoseDiffusion": (
        {"site": {}, "method": {"cameras": "posediffusion"}},
        r"site.baseline: expected the measured distance between the cameras, got nothing",
    ),
    "no baseline for structure from motion": (
        {"site": {}, "method": {"cameras": "sfm"}},
        r"site.baseline: expected the measured distance between the cameras, got nothing",
    ),
    "one distance": (
        {"site": {"baseline": {"value": 4.0, "std": 1.0}, "perpendicular_distance": {"value": 4.0, "std": 1.0}}},
        r"site: expected both distances or neither, got no longitudinal_distance",
    ),
    "other distance": (
        {"site": {"baseline": {"value": 4.0, "std": 1.0}, "longitudinal_distance": {"value": 4.0, "std": 1.0}}},
        r"site: expected both distances or neither, got no perpendicular_distance",
    ),
    "range view": (
        {"site": {"range": [{"point": "a", "view": "up", "value": 1.0, "std": 1.0}]}},
        r"site.range\[1\].view: expected the name of a view \(left, right\), got 'up'",
    ),
    "length point": (
        {"site": {"length": [{"points": ["a", "b"], "value": 1.0, "std": 1.0}]}},
        r"site.length\[1\].points: expected the name of a point \(a\), got 'b'; use one of these or add",
    ),
    "length to itself": (
        {"site": {"length": [{"points": ["a", "a"], "value": 1.0, "std": 1.0}]}},
        r"expected two different points, got 'a' twice",
    ),
    "length of three": (
        {"site": {"length": [{"points": ["a", "b", "c"], "value": 1.0, "std": 1.0}]}},
        r"site.length\[1\].points: expected 2 values, got",
    ),
    "two levels": (
        {
            "view": [{"name": "left", "video": "l", "level": {"std_deg": 1.0}}],
            "site": {"reference_camera_level": {"std_deg": 1.0}},
        },
        r"site.reference_camera_level: expected one level of the reference camera, got another in view\[left\].level",
    ),
    "same point twice": (
        {"point": [{"name": "a", "view": "left", "pixel": [1.0, 2.0]}] * 2},
        r"point\[a\].name: expected a name of its own, got it 2 times",
    ),
    "NaN pixel": (
        {"point": [{"name": "a", "view": "left", "pixel": [float("nan"), 2.0]}]},
        r"point\[a\].pixel\[1\]: expected a finite number, got nan",
    ),
    "pixel in unknown view": (
        {"point": [{"name": "a", "view": "left", "pixel": [1.0, 2.0], "pixel_in": {"up": [1.0, 2.0]}}]},
        r"point\[a\].pixel_in: expected the name of a view",
    ),
    "pixel in own view": (
        {"point": [{"name": "a", "view": "left", "pixel": [1.0, 2.0], "pixel_in": {"left": [1.0, 2.0]}}]},
        r"point\[a\].pixel_in: expected other views, got its own 'left'",
    ),
    "sensor point": (
        {"sensor": [{"name": "s", "file": "f", "point": "b"}]},
        r"sensor\[s\].point: expected the name of a point",
    ),
    "same sensor twice": ({"sensor": [{"name": "s", "file": "f"}] * 2}, r"sensor\[s\].name: expected a name of its"),
    "falling interval": (
        {"method": {"still_interval_s": [2.0, 1.0]}},
        r"method.still_interval_s: expected 0 <= start < end in seconds, got \[2.0, 1.0\]",
    ),
    "small subset": ({"method": {"subset_px": 7}}, r"subset_px: expected an odd number of pixels >= 9, got 7"),
    "fractional subset": ({"method": {"subset_px": 41.0}}, r"subset_px: expected a valid integer, got 41.0"),
    "unknown refinement": ({"method": {"refinement": "SGR"}}, r"refinement: expected 'none' or 'sgr', got 'SGR'"),
    "no chessboard": ({"method": {"cameras": "chessboard"}}, r"chessboard: expected a table \[chessboard\]"),
    "chessboard from nowhere": (
        {"chessboard": {"pattern": [9, 6], "square_mm": 1.0}},
        r"chessboard: expected either images or corners, got neither",
    ),
    "chessboard twice": (
        {"chessboard": {"pattern": [9, 6], "square_mm": 1.0, "images": {"left": "*"}, "corners": "c"}},
        r"chessboard: expected either images or corners, got both",
    ),
    "chessboard of unknown view": (
        {"chessboard": {"pattern": [9, 6], "square_mm": 1.0, "images": {"up": "*"}}},
        r"chessboard.images: expected the name of a view",
    ),
    "chessboard of one view": (
        {
            "method": {"cameras": "chessboard"},
            "chessboard": {"pattern": [9, 6], "square_mm": 1.0, "images": {"left": "*"}},
        },
        r"chessboard.images: expected a pattern for view 'right', got none",
    ),
    "no camera file": (
        {"method": {"cameras": "file"}},
        r'view\[left\].camera: expected a file for cameras = "file", got nothing',
    ),
    "start as a number": (
        {"sensor": [{"name": "s", "file": "a.csv", "start": 5}]},
        r"sensor\[s\].start: expected a date and time such as 2026-11-20T10:15:30.25Z, got 5",
    ),
    "start without a time zone": (
        {"sensor": [{"name": "s", "file": "a.csv", "start": "2026-11-20T10:00:00"}]},
        r"sensor\[s\].start: expected .* timezone",
    ),
    "start of a view as a number": (
        {"view": [{"name": "left", "video": "l", "start": 5}]},
        r"view\[left\].start: expected a date and time such as 2026-11-20T10:15:30.25Z, got 5",
    ),
    "start of a view without a time zone": (
        {"view": [{"name": "left", "video": "l", "start": "2026-11-20T10:00:00"}]},
        r"view\[left\].start: expected .* timezone",
    ),
    "certain offset": (
        {"view": [{"name": "left", "video": "l", "time_offset_std_s": 0.0}]},
        r"view\[left\].time_offset_std_s: expected greater than 0, got 0.0",
    ),
    "unknown synchronisation": (
        {"method": {"synchronization": "audio"}},
        r"method.synchronization: expected 'motion' or 'none', got 'audio'",
    ),
    "negative weight": (
        {"method": {"sgr": {"others_rate": -1.0}}},
        r"method.sgr.others_rate: expected greater than or equal to 0, got -1.0",
    ),
    "certain pixel": ({"method": {"sgr": {"pixel": 0}}}, r"method.sgr.pixel: expected greater than 0, got 0"),
    "suppressed axis": (
        {"method": {"sgr": {"suppressed_axis": "up"}}},
        r"method.sgr.suppressed_axis: expected 'lateral', 'vertical' or 'longitudinal', got 'up'",
    ),
    "weight of nothing": (
        {"method": {"sgr": {"longitudnal": 1.0}}},
        r"method.sgr.longitudnal: expected one of the keys .*; did you mean 'longitudinal'\?",
    ),
    "unknown matcher of features": (
        {"method": {"matching": "orb"}},
        r"method.matching: expected one of \['aliked\+lightglue', 'auto', 'sift', .*\], got 'orb'; choose one of these",
    ),
    "unknown matcher as it was named before": (
        {"method": {"sfm": {"features": "superpoint", "matcher": "loftr"}}},
        r"method.matching: expected one of \[.*\], got 'superpoint\+loftr'",
    ),
    "matcher named in two ways": (
        {"method": {"matching": "sift", "sfm": {"features": "superpoint"}}},
        r"method: expected features in one place, got matching and sfm.features = 'superpoint\+superglue'; remove",
    ),
    "model for SIFT": (
        {"method": {"matching": "sift", "sfm": {"model": "folder"}}},
        r"method: expected matching = 'superpoint\+lightglue' or 'superpoint\+superglue' for sfm.model, got 'sift'",
    ),
    "units of a sensor": (
        {"sensor": [{"name": "s", "file": "a.csv", "units": "ft"}]},
        r"sensor\[s\].units: expected 'g', 'mg', 'm/s2', .* 'cm' or 'um', got 'ft'",
    ),
    "column of no axis": (
        {"sensor": [{"name": "s", "file": "a.csv", "columns": {"up": "z"}}]},
        r"sensor\[s\].columns.up.*expected 'time', 'lateral', 'vertical' or 'longitudinal', got 'up'",
    ),
    "unknown key": ({"weather": "fog"}, r"weather: expected one of the keys name, view, .* got an unknown one; remove"),
    "long text": ({"site": "x" * 200}, r"site: expected one table \[site\], got 'x{56}\.\.\.;"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_named(fault):
    changes, message = FAULTS[fault]
    small()  # the session without the fault is fine
    with pytest.raises(SessionError, match=message):
        small(**changes)


@pytest.mark.parametrize("cameras", ["file", "chessboard"])
def test_cameras_that_know_lengths_need_no_baseline(cameras):
    view = [{"name": name, "video": f"{name}.mp4", "camera": "rig.toml"} for name in ("left", "right")]
    board = {"pattern": [9, 6], "square_mm": 12.0, "corners": "c.npz"}
    assert small(view=view, site={}, chessboard=board, method={"cameras": cameras}).site.baseline is None


@pytest.mark.parametrize(
    "text",
    [
        'matching = "superpoint+lightglue"\nsfm = { model = "folder" }\n',
        'sfm = { features = "superpoint", matcher = "lightglue", model = "folder" }\n',
    ],
)
def test_matching_is_read_and_written_also_as_it_was_named_before(tmp_path, text):
    make_files(tmp_path)
    method = f'[method]\ncameras = "sfm"\n{text}'
    session = read_session(write_design(tmp_path, DESIGN[: DESIGN.index("[method]")] + method))
    assert (session.method.matching, session.method.sfm) == ("superpoint+lightglue", Sfm(model="folder"))
    assert read_session(write_session(tmp_path / "again.toml", session)) == session
    assert (Method().matching, Method().sfm) == ("sift", Sfm(model=None))
    assert Method(sfm={"features": "sift"}).matching == "sift"
    assert Method(sfm={"features": "superpoint"}).matching == "superpoint+superglue"


def test_one_view_needs_no_baseline():
    view = [{"name": "left", "video": "l.mp4"}]
    assert small(view=view, site={}).site.baseline is None


def test_parts_built_alone_refuse_faults_too():
    with pytest.raises(ValueError, match="either images or corners"):
        Chessboard(pattern=(9, 6), square_mm=1.0)


def test_missing_files_are_named_together(tmp_path):
    path = write_design(tmp_path)
    with pytest.raises(SessionError) as caught:
        read_session(path)
    text = str(caught.value)
    assert "view[left].video: expected a file at left.mp4, got no such file" in text
    assert "sensor[acc-1].file: expected a file at acc1.csv" in text
    assert "view[right].images: expected files that match right/*.jpg, got none" in text
    assert "3 faults" in text
    assert read_session(path, check_files=False).name == "footbridge 2026-11-20"


def test_missing_chessboard_files_are_named(tmp_path):
    board = {"pattern": [9, 6], "square_mm": 12.0, "images": {"left": "l*.png"}}
    path = write_session(tmp_path / "s.toml", small(chessboard=board, folder=tmp_path))
    with pytest.raises(SessionError, match=r"chessboard.images.left: expected files that match l\*.png"):
        read_session(path)
    (tmp_path / "c.npz").mkdir()
    board = {"pattern": [9, 6], "square_mm": 12.0, "corners": "c.npz"}
    path = write_session(tmp_path / "s.toml", small(chessboard=board, folder=tmp_path))
    with pytest.raises(SessionError, match=r"chessboard.corners: expected a file at c.npz, got a folder"):
        read_session(path)


def test_unreadable_session_files_are_explained(tmp_path):
    with pytest.raises(SessionError, match=r"none.toml: expected a session file, got no such file; check the path"):
        read_session(tmp_path / "none.toml")
    with pytest.raises(SessionError, match=r"expected a readable session file, got: Is a directory"):
        read_session(tmp_path)
    with pytest.raises(SessionError, match=r"session.toml: expected TOML, got: .*line 3, column"):
        read_session(write_design(tmp_path, '\nname = "x"\nview = = 2\n'))
    (tmp_path / "latin.toml").write_bytes('name = "Brücke"'.encode("latin-1"))
    with pytest.raises(SessionError, match=r"latin.toml: expected text in UTF-8, got another at byte 10"):
        read_session(tmp_path / "latin.toml")


def test_single_fault_is_one_line(tmp_path):
    make_files(tmp_path)
    with pytest.raises(SessionError) as caught:
        read_session(write_design(tmp_path, DESIGN.replace('"sgr"', '"all"')))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'session.toml'}: method.refinement: expected")


def test_byte_order_mark_is_no_fault(tmp_path):
    make_files(tmp_path)
    assert read_session(write_design(tmp_path, "\ufeff" + DESIGN)).view[0].name == "left"


def save_photograph(path: Path, size: tuple[int, int], tags: dict[int, object]) -> Path:
    image = Image.new("L", size)
    exif = image.getexif()
    exif.get_ifd(0x8769).update(tags)
    image.save(path, exif=exif)
    return path


def test_exif_film_equivalent_focal_length(tmp_path):
    # On 3:2 images, the diagonal rule and the width rule are one: 50 mm on 36 mm wide film.
    path = save_photograph(tmp_path / "a.jpg", (600, 400), {0xA405: 50})
    lens = lens_from_exif(path)
    assert lens.focal_prior_px(600) == pytest.approx(600 * 50 / 36)
    assert lens.relative_std == 0.05
    # On 4:3, the same diagonal angle: focal / diagonal is that of film.
    lens = lens_from_exif(save_photograph(tmp_path / "b.jpg", (400, 300), {0xA405: 26}))
    assert lens.focal_prior_px(400) == pytest.approx(500 * 26 / (36**2 + 24**2) ** 0.5)


@pytest.mark.parametrize(("unit", "per_unit_mm"), [(2, 25.4), (3, 10.0), (4, 1.0)])
def test_exif_focal_plane_resolution(tmp_path, unit, per_unit_mm):
    # 25 mm lens and 0.01 mm pixels: 2500 px; the file is half as wide as the picture taken.
    tags = {
        0x920A: IFDRational(25, 1),
        0xA20E: IFDRational(int(100 * per_unit_mm * 10), 10),
        0xA210: unit,
        0xA002: 1200,
        0xA405: 0,
    }
    lens = lens_from_exif(save_photograph(tmp_path / "a.jpg", (600, 400), tags))
    assert lens.focal_prior_px(600) == pytest.approx(1250.0)


def test_exif_that_does_not_tell_gives_none(tmp_path):
    assert lens_from_exif(save_photograph(tmp_path / "a.jpg", (600, 400), {})) is None
    only_focal = {0x920A: IFDRational(25, 1)}
    assert lens_from_exif(save_photograph(tmp_path / "b.jpg", (600, 400), only_focal)) is None
    broken = {0x920A: IFDRational(25, 0), 0xA20E: IFDRational(100, 1)}
    assert lens_from_exif(save_photograph(tmp_path / "c.jpg", (600, 400), broken)) is None
    odd_unit = {0x920A: IFDRational(25, 1), 0xA20E: IFDRational(100, 1), 0xA210: 9}
    assert lens_from_exif(save_photograph(tmp_path / "d.jpg", (600, 400), odd_unit)) is None


def test_exif_of_no_image(tmp_path):
    with pytest.raises(SessionError, match=r"none.jpg: expected a photograph, got no such file"):
        lens_from_exif(tmp_path / "none.jpg")
    (tmp_path / "text.jpg").write_text("no image")
    with pytest.raises(SessionError, match=r"text.jpg: expected a photograph, got no readable image"):
        lens_from_exif(tmp_path / "text.jpg")


DOCS = Path(__file__).parents[4] / "docs" / "session.md"


def test_examples_of_the_manual_are_valid(tmp_path):
    blocks = re.findall(r"```toml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    whole = [block for block in blocks if block.startswith("name")]
    assert len(whole) == 2
    for block in whole:
        read_session(write_design(tmp_path, block), check_files=False)
    board = next(block for block in blocks if block.startswith("[chessboard]"))
    session = read_session(write_design(tmp_path, whole[0] + board), check_files=False)
    assert session.chessboard.pattern == (9, 6)
    lengths = next(block for block in blocks if block.startswith("[[site.range]]"))
    text = whole[0].replace(
        "[[point]]", lengths + '[[point]]\nname = "1/4 span"\nview = "left"\npixel = [1, 1]\n[[point]]'
    )
    assert read_session(write_design(tmp_path, text), check_files=False).site.length[0].value == 7.5


def test_every_key_is_in_the_manual():
    text = DOCS.read_text(encoding="utf-8")
    listed = (View, Lens, Level, Site, Range, Length, Point, Sensor, Chessboard, Report)
    for model in (Session, *listed, Method, Sgr, Network, Sfm):
        for name, field in model.model_fields.items():
            assert field.exclude or re.search(rf"\b{name}\b", text), f"{model.__name__}.{name}"


def test_python_example_of_the_manual_runs(tmp_path, monkeypatch):
    code = re.findall(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)[0]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "left.mp4").touch()
    (tmp_path / "right.mp4").touch()
    lines = code.replace('session = read_session("session.toml")\n', "")
    exec(lines, {})
    assert read_session("session.toml").point[0].name == "1/2 span"
