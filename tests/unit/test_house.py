"""The house is in order by `tools/house.py`, its picture is of today's imports, and each count can fail."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ROOT / "tools"


@pytest.fixture(scope="module")
def house() -> ModuleType:
    """`tools/house.py` as a module."""
    sys.path.insert(0, str(TOOLS))
    try:
        import house
    finally:
        sys.path.remove(str(TOOLS))
    return house


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package in order: a command uses a stage, which uses the core."""
    folder = tmp_path / "small"
    write(folder / "__init__.py", "")
    write(folder / "core" / "arrays.py", "def half(x):\n    return x / 2\n")
    write(folder / "stages" / "tracking" / "base.py", "from small.core.arrays import half\n")
    write(folder / "commands" / "app.py", "from small.stages.tracking import base\nfrom small.core import arrays\n")
    return folder


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def run(*words: object) -> tuple[int, list[str]]:
    """Exit status and lines of the script, run as people run it."""
    command = [sys.executable, str(TOOLS / "house.py"), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, [line.strip() for line in (done.stdout + done.stderr).splitlines()]


def test_the_house_is_in_order() -> None:
    status, lines = run()
    assert status == 0, "\n".join(lines)


def test_the_picture_is_that_of_todays_imports(house: ModuleType) -> None:
    rooms = house.between_rooms(house.read_imports(house.PACKAGE))
    drawn = (ROOT / "docs" / "house.svg").read_text(encoding="utf-8")
    assert drawn == house.draw(rooms), "draw it anew: python tools/house.py --picture docs/house.svg"


def test_imports_are_those_that_the_import_linter_sees(house: ModuleType) -> None:
    grimp = pytest.importorskip("grimp")
    graph = grimp.build_graph("vfm_sdm", exclude_type_checking_imports=True, cache_dir=None)
    found = {
        name.removeprefix("vfm_sdm."): {
            target.removeprefix("vfm_sdm.") for target in graph.find_modules_directly_imported_by(name) - {"vfm_sdm"}
        }
        for name in graph.modules - {"vfm_sdm"}
    }
    imports = house.read_imports(house.PACKAGE)
    assert imports.pop("__init__") == set()
    assert imports == found


def test_a_package_in_order_passes(package: Path) -> None:
    status, lines = run(package)
    assert status == 0
    assert "ok   modules at the root: 1 (limit 4)" in lines
    assert "rooms: 3, arrows between them: 3" in lines


BODY = "    x = 1\n"
BEYOND = {
    "modules at the root: 5": (
        {f"{name}.py": "" for name in ("__main__", "errors", "measurement", "loose")},
        ["__init__.py", "__main__.py", "errors.py", "loose.py", "measurement.py"],
    ),
    "files over 500 lines: 1": (
        {"core/long.py": "x = 1\n" * 501, "core/full.py": "x = 1\n" * 500},
        ["core/long.py:1 501"],
    ),
    "functions over 60 lines without their docstring: 1": (
        {"core/long.py": f'def fits():\n    """One.\n\n    Two.\n    """\n{BODY * 59}\n\ndef long():\n{BODY * 60}'},
        ["core/long.py:67 long 61"],
    ),
    "functions over 6 arguments: 2": (
        {
            "core/many.py": "def many(a, /, b, c, *, d, e, f, g):\n    pass\n\n\nclass C:\n"
            "    def six(self, a, b, c, d, e, f):\n        pass\n\n"
            "    def seven(self, a, b, c, d, e, f, g):\n        pass\n"
        },
        ["core/many.py:1 many 7", "core/many.py:9 seven 7"],
    ),
    "circles of modules: 1": (
        {"core/a.py": "from small.core.b import x\n", "core/b.py": "def late():\n    import small.core.a\n"},
        ["core.a -> core.b -> core.a"],
    ),
    "circles of rooms: 1": (
        {"core/a.py": "from small.stages.tracking.c import x\n", "stages/tracking/c.py": ""},
        ["core -> stages.tracking -> core"],
    ),
}


@pytest.mark.parametrize("says", BEYOND)
def test_what_is_beyond_its_limit_is_named(package: Path, says: str) -> None:
    files, places = BEYOND[says]
    for name, text in files.items():
        write(package / name, text)
    status, lines = run(package)
    assert status == 1
    over = next(index for index, line in enumerate(lines) if line.startswith("OVER"))
    assert lines[over].startswith(f"OVER {says} (limit ")
    assert lines[over + 1 : over + 1 + len(places)] == places
    assert sum(line.startswith("OVER") for line in lines) == 1


def test_imports_for_type_checkers_make_no_circle(package: Path) -> None:
    write(
        package / "core" / "a.py",
        "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from small.stages.tracking import base\n",
    )
    assert run(package)[0] == 0


def test_the_picture_leaves_out_what_a_longer_way_tells(package: Path, tmp_path: Path) -> None:
    picture = tmp_path / "small.svg"
    assert run(package, "--picture", picture)[0] == 0
    drawn = ET.parse(picture).getroot()
    texts = [element.text for element in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert texts[:-1] == ["commands", "stages", "core", "commands", "tracking", "core"]
    arrows = [element for element in drawn.iter("{http://www.w3.org/2000/svg}path") if "marker-end" in element.attrib]
    assert len(arrows) == 2  # commands -> tracking -> core; that commands use the core follows


def test_circles_are_not_drawn(package: Path, tmp_path: Path) -> None:
    write(package / "core" / "a.py", "from small.stages.tracking.base import x\n")
    status, lines = run(package, "--picture", tmp_path / "small.svg")
    assert status == 2
    assert "expected rooms without circles to draw" in lines[-1]
    assert not (tmp_path / "small.svg").exists()
