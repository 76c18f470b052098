"""Keys that cannot lie: every field of a session and every input file, changed one at a time.

The table says who reads a field; what is made of a product that changed changes, too.
"""

from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from vfm_sdm.core import code
from vfm_sdm.core.parts import BUILT_IN
from vfm_sdm.core.products import Product
from vfm_sdm.core.registry import settings_read
from vfm_sdm.inputs.session import Session
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.points import named_points

# Fields by name, and the products that read them; `summary` reads all, and `audit` these tables as a whole.
READERS = {
    "name": ("figures",),
    "view.name": ("recordings", "cameras", "aligned", "displacement", "intervals", "audit"),
    "view.video": ("recordings", "intervals", "audit"),
    "view.images": ("recordings", "cameras", "intervals", "audit"),
    "view.fps": ("recordings", "intervals", "audit"),
    "view.capture_fps": ("recordings", "intervals", "audit"),
    "view.lens": ("cameras", "intervals", "audit"),
    "view.camera": ("cameras", "intervals", "audit"),
    "view.level": ("cameras", "intervals", "audit"),
    "view.perpendicular_distance": ("cameras", "intervals", "audit"),
    "view.longitudinal_distance": ("cameras", "intervals", "audit"),
    "view.stands": ("cameras", "intervals", "audit"),
    "view.time_offset_s": ("aligned", "intervals", "audit"),
    "view.time_offset_std_s": ("aligned", "intervals", "audit"),
    "view.start": ("aligned", "displacement", "intervals", "audit"),
    "view.use_s": ("recordings", "aligned", "displacement", "intervals", "audit"),
    "site": ("cameras", "intervals", "audit"),
    "site.length": ("cameras", "displacement", "intervals", "audit"),
    "point.name": ("expectation", "cameras", "points", "steady", "aligned", "displacement", "intervals", "audit"),
    "point.view": ("expectation", "cameras", "points", "intervals", "audit"),
    "point.pixel": ("expectation", "cameras", "points", "displacement", "intervals", "audit"),
    "point.static": ("cameras", "steady", "aligned", "intervals", "audit"),
    "point.pixel_in": ("expectation", "cameras", "points", "intervals", "audit"),
    # Of these and of when views begin, `reference_frames` tells the numbers of frames, and is told by them.
    "point.frame": ("reference_frames", "points", "intervals", "audit"),
    "point.time_s": ("reference_frames", "points", "intervals", "audit"),
    "sensor": (),
    "baseline_visit": ("revisit",),
    "report": (),
    "chessboard": ("cameras",),
    "method.tracker": ("expectation", "subsets", "tracks", "displacement", "intervals", "audit"),
    "method.cameras": ("cameras", "displacement", "intervals", "audit"),
    "method.segment_s": ("tracks", "intervals", "audit"),
    "method.interval_s": ("intervals", "audit"),
    "method.correspondence": ("cameras", "intervals", "audit"),
    "method.refinement": ("refinement", "displacement", "intervals", "audit"),
    # Points are told by their pixels, and without cameras grids have none.
    "grid": (),
    "method.sgr": ("refinement", "displacement", "intervals", "audit"),
    "method.synchronization": ("aligned", "intervals", "audit"),
    "method.camera_motion": ("steady", "intervals", "audit"),
    "method.injection": ("injection", "intervals", "audit"),
    "method.scale_limit": ("intervals", "audit"),
    "method.still_interval_s": ("aligned", "refinement", "unrefined", "displacement", "intervals", "audit"),
    "method.subset_px": ("expectation", "cameras", "subsets", "tracks", "intervals", "audit"),
    "method.network": ("intervals", "audit"),
    "method.matching": ("cameras", "intervals", "audit"),
    "method.sfm": ("intervals", "audit"),
}


CORNERS = dict.fromkeys(("left", "right"), ((10.0, 10.0), (90.0, 10.0), (90.0, 50.0), (10.0, 50.0)))


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session in which every table is there, and files of a few bytes; nothing is decoded or solved."""
    monkeypatch.setattr("vfm_sdm.inputs.session.recorded.open_views", lambda session: {})
    monkeypatch.setattr("vfm_sdm.measurement.solve_cameras", solution_of)
    monkeypatch.setattr("vfm_sdm.inputs.session.recorded.find_reference_frames", frames_of)
    monkeypatch.setattr(Measurement, "part_of", lambda self, kind: {})
    monkeypatch.setattr(Measurement, "part", lambda self, kind: None)
    for name in (
        "left/000.png",
        "left/001.png",
        "right.mp4",
        "rig.toml",
        "board.png",
        "corners.csv",
        "other.toml",
        "lens.toml",
        "third.mp4",
        "visit/cameras.toml",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode() * 8)
    level = {"pitch_deg": 0.0, "roll_deg": 0.0, "std_deg": 0.1}
    return Session(
        name="bridge",
        folder=tmp_path,
        view=[
            {"name": "left", "images": "left/*.png", "fps": 30.0, "lens": {"focal_px": 900.0}, "camera": "rig.toml"},
            {
                **{"name": "right", "video": "right.mp4", "time_offset_s": 0.1, "time_offset_std_s": 0.01},
                **{"level": level, "stands": "right", "use_s": [0.5, 9.0]},
                "lens": {"camera": "GoPro HERO7 Black", "mode": "Linear", "stabilised": False},
                **{name: {"value": 6.0, "std": 0.02} for name in ("perpendicular_distance", "longitudinal_distance")},
            },
            {"name": "third", "video": "third.mp4", "lens": {"file": "lens.toml"}},
        ],
        site={
            "baseline": {"value": 4.0, "std": 0.01},
            "perpendicular_distance": {"value": 9.0, "std": 0.02},
            "longitudinal_distance": {"value": 5.0, "std": 0.02},
            "range": [{"point": "mid", "value": 11.0, "std": 0.01}],
            "length": [{"points": ["mid", "end"], "value": 2.0, "std": 0.01}],
            "rectangle": [{"corners": CORNERS, "aspect": {"value": 2.0, "std": 0.01}}],
            "lines": {"out_of_square_std_deg": 1.0},
        },
        point=[
            {"name": "mid", "view": "left", "pixel": [100.0, 80.0], "pixel_in": {"right": [90.0, 80.0]}},
            {"name": "end", "view": "left", "pixel": [200.0, 80.0], "static": True},
            {"name": "late", "view": "left", "pixel": [240.0, 80.0], "frame": 12},
        ],
        grid=[{"name": "web", "view": "left", "polygon": [[10, 10], [90, 10], [90, 50]], "spacing_m": 0.2}],
        sensor=[{"name": "acc", "file": "corners.csv", "point": "mid", "columns": {"time": "t"}, "units": "g"}],
        baseline_visit="visit",
        report={"client": "city", "date": "2026-11-20"},
        chessboard={"pattern": [7, 5], "square_mm": 30.0, "images": {"left": "board.png"}},
        method={"still_interval_s": [0.0, 1.0], "matching": "sift"},
    )


def frames_of(session: Session, videos: Any) -> dict[str, dict[str, int]]:
    """Frames by their stated numbers, or of 10 a second, in the points' own views."""
    found: dict[str, dict[str, int]] = {}
    for point in (one for one in session.point if one.comes_later):
        found.setdefault(point.view, {})[point.name] = point.frame or round(10 * (point.time_s or 0))
    return found


def solution_of(session: Session, *_: Any, reference_frames: Any, **__: Any) -> CameraSolution:
    """Points where the session names them, and nothing of the cameras."""
    views = sorted({view for point in session.point for view in (point.view, *point.pixel_in)})
    return CameraSolution(None, None, None, named_points(session, views, reference_frames))


def leaves(model: BaseModel, prefix: str = "") -> list[str]:
    """Dotted names of all fields that hold no table of fields; of a list of tables, those of any of them."""
    found: dict[str, None] = {}
    # What is not written says nothing: `site.motion` is found, and fields of later versions leave no trace.
    written = model.model_dump(warnings=False)
    for name in (one for one in type(model).model_fields if one in written):
        value = getattr(model, name)
        tables = [one for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, BaseModel)]
        for one in tables:
            found |= dict.fromkeys(leaves(one, f"{prefix}{name}."))
        if not tables and (prefix or name != "folder"):
            found[f"{prefix}{name}"] = None
    # A table that is missing in one view and there in another is no leaf.
    return [leaf for leaf in found if not any(one.startswith(f"{leaf}.") for one in found)]


def changed(model: Any, path: str) -> Any:
    """The model with another value in one field, valid or not: keys do not ask."""
    name, _, rest = path.partition(".")
    value = getattr(model, name)
    if rest and isinstance(value, tuple):
        # Of a list of tables, one in which the field is, best one in which it says something.
        place = max(range(len(value)), key=lambda n: (leads(value[n], rest), says(value[n], rest)))
        new: Any = tuple(changed(one, rest) if n == place else one for n, one in enumerate(value))
    elif rest:
        new = changed(value, rest)
    else:
        new = other(name, value)
    return model.model_copy(update={name: new})


def leads(model: Any, path: str) -> bool:
    """Whether all tables on the way to a field are there."""
    name, _, rest = path.partition(".")
    return model is not None and (not rest or leads(getattr(model, name), rest))


def says(model: Any, path: str) -> bool:
    """Whether a field holds something."""
    for name in path.split("."):
        model = getattr(model, name, None)
    return bool(model)


def other(name: str, value: Any) -> Any:
    """Another value of a field."""
    special = {"tracker": "template", "cameras": "file", "correspondence": "vggt", "video": Path("rig.toml")}
    special |= {"matching": "xfeat"}
    special |= {"images": "left/*0.png", "camera": Path("other.toml"), "corners": Path("corners.csv"), "view": "right"}
    special |= {"start": datetime(2026, 11, 20, tzinfo=UTC), "range": (), "length": ()}
    if name in special and not isinstance(value, dict):
        return special[name]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return f"{value}x"
    if isinstance(value, date):
        return value + timedelta(days=1)
    if isinstance(value, Path):
        return value.with_name("other.toml")
    if isinstance(value, dict):
        return {"left": "board*.png"} if name == "images" else {}
    if isinstance(value, tuple):
        return tuple(v + 1 if isinstance(v, int | float) else f"{v}x" for v in value)
    return {"weights": "mine", "matcher": "lightglue", "model": "folder"}.get(name, 7.0) if value is None else value


def expected(field: str) -> set[str]:
    """Products whose keys change with a field: those that read it, and those made of them."""
    name = max((known for known in READERS if f"{field}.".startswith(f"{known}.")), key=len, default=None)
    assert name is not None, f"{field}: a new field; say in READERS who reads it"
    found = {*READERS[name], "summary"}
    for product in Measurement.products():
        needs = set(Measurement.product(product).needs)
        # Points are told by their pixels, so that other cameras alone do not change them, frames by their numbers, and
        # what sensors say of the scale by its content, here nothing.
        if needs & found and product not in ("points", "reference_frames", "sensor_scale"):
            found.add(product)
    return found


def keys(measurement: Measurement) -> dict[str, str]:
    return {name: measurement.key(name) for name in measurement.products()}


def wrong_keys(kind: type[Measurement], session: Session) -> list[str]:
    """Fields whose change does not change the keys of exactly the products that depend on it."""
    before, wrong = keys(kind(session)), []
    for field in leaves(session):
        after = keys(kind(changed(session, field)))
        found = {name for name in before if before[name] != after[name]}
        if found != expected(field):
            wrong.append(f"{field}: {sorted(found ^ expected(field))}")
    return wrong


def test_every_field_changes_the_keys_of_what_depends_on_it_and_of_nothing_else(session):
    assert len(list(leaves(session))) > 60
    assert wrong_keys(Measurement, session) == []


@pytest.mark.parametrize(
    ("product", "forgotten", "noticed"),
    [
        ("cameras", "view.lens", "view.lens.focal_px"),
        ("aligned", "view.time_offset_s", "view.time_offset_s"),
        ("refinement", "method.sgr", "method.sgr.longitudinal"),
    ],
)
def test_a_dependency_that_is_left_out_is_noticed(session, product, forgotten, noticed):
    def without(one: Product) -> Product:
        lacking = Product.__new__(Product)
        lacking.__dict__.update(one.__dict__, reads=tuple(read for read in one.reads if read != forgotten))
        return lacking

    members = {name: Measurement.product(name) for name in Measurement.products()}
    forgetful = type("Forgetful", (Measurement,), members | {product: without(members[product])})
    assert any(line.startswith(noticed) for line in wrong_keys(forgetful, session))


@pytest.mark.parametrize(
    ("kind", "word"), [("trackers", "tracker"), ("cameras", "cameras"), ("matchers", "correspondence")]
)
def test_settings_of_a_back_end_count_where_it_is_chosen(session, kind, word):
    product = {"trackers": "tracks"}.get(kind, "cameras")
    for name in BUILT_IN[kind]:
        method = session.method.model_copy(update={word: name})
        chosen = session.model_copy(update={"method": method})
        read = {f"method.{field}" for field in settings_read(kind, method)} | set(Measurement.product(product).reads)
        before = Measurement(chosen).key(product)
        for field in (leaf for leaf in leaves(chosen) if leaf.startswith("method.") and leaf != f"method.{word}"):
            if field in {"method.cameras", "method.correspondence", "method.matching"}:
                continue  # these choose other back ends
            counts = any(f"{field}.".startswith(f"{one}.") for one in read)
            differs = Measurement(changed(chosen, field)).key(product) != before
            assert differs == counts or (product == "cameras" and differs), (name, field)


@pytest.mark.parametrize("cameras", ["two-view", "sfm"])
def test_who_matches_features_is_in_the_key_of_the_cameras(session, cameras):
    """SIFT's cameras were reused where SuperPoint's had been asked for."""

    def key(matching):
        method = session.method.model_copy(update={"cameras": cameras, "matching": matching})
        return Measurement(session.model_copy(update={"method": method})).key("cameras")

    names = ["auto", "sift", "xfeat", "superpoint+lightglue", "superpoint+superglue"]
    assert len({key(name) for name in names}) == len(names)


FILES = {
    "left/001.png": {"recordings", "frames", "cameras", "tracks"},
    "right.mp4": {"recordings", "frames", "cameras", "tracks"},
    "rig.toml": {"cameras"},
    "lens.toml": {"cameras"},
    "board.png": {"cameras"},
}


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("whole_files", [False, True])
def test_a_byte_of_an_input_file_changes_what_was_made_of_it(session, file, whole_files):
    def found() -> dict[str, str]:
        return keys(Measurement(session, whole_files=whole_files))

    before = found()
    path = session.folder / file
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(bytes(content))
    after = found()
    different = {name for name in before if before[name] != after[name]}
    assert FILES[file] <= different
    assert "points" not in different
    assert ("tracks" in different) == ("tracks" in FILES[file])


def test_a_file_that_is_not_read_changes_nothing(session):
    before = keys(Measurement(session))
    for unread in ("corners.csv", "other.toml"):
        (session.folder / unread).write_bytes(b"something else")
    assert keys(Measurement(session)) == before


@pytest.mark.parametrize(
    ("module", "different", "same"),
    [
        ("stages.synchronize.lag", {"aligned", "displacement", "audit"}, {"recordings", "cameras", "tracks", "steady"}),
        # By a method that two products call.
        ("stages.displacement.stereo", {"unrefined", "displacement"}, {"cameras", "tracks", "aligned"}),
        # What keeps a product: tracks in another form must not be read.
        ("core.netcdf", {"tracks", "displacement"}, {"recordings", "frames"}),
    ],
)
def test_the_code_of_a_stage_is_in_the_keys_of_what_it_makes(session, monkeypatch, module, different, same):
    before = keys(Measurement(session))
    read = code._text
    monkeypatch.setattr(code, "_text", lambda name: read(name) + "# edited" * (name == f"vfm_sdm.{module}"))
    code.code_hash.cache_clear()
    after = keys(Measurement(session))
    code.code_hash.cache_clear()
    found = {name for name in before if before[name] != after[name]}
    assert different <= found
    assert not same & found
