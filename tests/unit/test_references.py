"""Names and paths that docstrings and documents refer to are there."""

import importlib
import re
from functools import cache
from pathlib import Path

import pytest

from vfm_sdm.core.parts import KINDS

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")),
    *sorted((ROOT / "docs").glob("*.md")),
]
# Decisions tell what was true when they were taken.
NAME = re.compile(r"`(vfm_sdm(?:\.\w+)+)`")
LINK = re.compile(r"\]\(((?!https?:|#)[^)#\s]+)")


@cache
def is_there(dotted: str) -> bool:
    """Whether a dotted name is a module, something in one, or a group of entry points."""
    if dotted in {kind.group for kind in KINDS.values()}:
        return True
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError as error:
            if error.name is not None and not error.name.startswith("vfm_sdm"):
                return True  # needs a package that is not here
            continue
        for name in parts[length:]:
            if not hasattr(found, name):
                return name in getattr(found, "__dataclass_fields__", {}) or name in getattr(found, "model_fields", {})
            found = getattr(found, name)
        return True
    return False


@pytest.mark.parametrize(
    "package",
    sorted(p.name for p in (ROOT / "src" / "vfm_sdm").iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()),
)
def test_docstrings_refer_to_what_there_is(package):
    missing = []
    place = ROOT / "src" / "vfm_sdm" / package
    for path in place.rglob("*.py") if place.is_dir() else [place]:
        text = path.read_text(encoding="utf-8")
        missing += [f"{path.name}: {name}" for name in NAME.findall(text) if not is_there(name)]
    assert missing == []


def test_titles_of_docstrings_stand_in_lines_of_their_own():
    title = re.compile(
        r"^.*\b(?:Notes|Parameters|Returns|Raises|References|Examples|Attributes) -{3,}.*$", re.MULTILINE
    )
    joined = [hit for path in (ROOT / "src").rglob("*.py") for hit in title.findall(path.read_text(encoding="utf-8"))]
    assert joined == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_documents_refer_to_what_there_is(document):
    text = document.read_text(encoding="utf-8")
    assert [name for name in NAME.findall(text) if not is_there(name)] == []
    assert [link for link in LINK.findall(text) if not (document.parent / link).exists()] == []
