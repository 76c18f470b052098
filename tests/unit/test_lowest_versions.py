"""Lowest versions are read from `pyproject.toml`, and what CI installs otherwise is not below them."""

import importlib.util
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def tool():
    """`tools/lowest_versions.py` as a module."""
    spec = importlib.util.spec_from_file_location("lowest_versions", ROOT / "tools" / "lowest_versions.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def made(dependencies, **extras):
    return {"project": {"name": "bridge", "dependencies": dependencies, "optional-dependencies": extras}}


def numbers(version):
    return tuple(int(part) for part in version.split("."))


def test_every_requirement_has_a_lowest_version(tool, capsys):
    extras = list(PROJECT["project"]["optional-dependencies"])
    assert tool.main(extras) == 0
    lines = capsys.readouterr().out.split()
    assert len(lines) == len(set(lines)) > 20
    assert any(line.startswith("numpy==") for line in lines)
    assert any(line.startswith("torch==") for line in lines)


def test_extras_of_an_extra_are_left_out(tool):
    project = made(["numpy>=2.1"], vfm=["torch>=2.6"], test=["pytest>=8", "bridge[vfm]"])
    assert dict(tool.lowest_versions(project, ["test"])) == {"numpy": "2.1", "pytest": "8"}


def test_what_ci_installs_is_not_below(tool):
    lowest = dict(tool.lowest_versions(PROJECT, list(PROJECT["project"]["optional-dependencies"])))
    pinned = dict(
        line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")
    )
    both = {name.replace("_", "-"): version for name, version in lowest.items()}
    assert len(pinned.keys() & both.keys()) > 15
    assert [name for name, version in pinned.items() if numbers(version) < numbers(both.get(name, "0"))] == []


def test_a_requirement_without_a_floor_and_an_unknown_extra_are_refused(tool, capsys):
    with pytest.raises(ValueError, match="expected NAME>=VERSION, got 'numpy'; give it a lowest version"):
        list(tool.lowest_versions(made(["numpy"]), []))
    with pytest.raises(ValueError, match="expected extras among vfm, got sfm"):
        list(tool.lowest_versions(made([], vfm=[]), ["sfm"]))
    assert tool.main(["speed"]) == 1
    assert "expected extras among vfm, sfm, cluster, page, report, modal, test, lint" in capsys.readouterr().err
