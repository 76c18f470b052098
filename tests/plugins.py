"""A package of parts as somebody else would publish it, made of the examples in CONTRIBUTING.md."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import invalidate_caches
from pathlib import Path

CONTRIBUTING = Path(__file__).resolve().parents[1] / "CONTRIBUTING.md"


def blocks(language: str) -> list[str]:
    """Code of a language in CONTRIBUTING.md."""
    return re.findall(rf"```{language}\n(.*?)```", CONTRIBUTING.read_text(encoding="utf-8"), re.DOTALL)


def example_modules() -> dict[str, str]:
    """Text of every example's module by file name."""
    found = (re.match(r"# (\w+\.py)\n(.*)", block, re.DOTALL) for block in blocks("python"))
    return {match[1]: match[2] for match in found if match is not None}


def example_package() -> dict[str, str]:
    """Text of every module of the example by dotted name."""
    return {f"river_tools.{name.removesuffix('.py')}": text for name, text in example_modules().items()}


def registry_lines() -> dict[str, str]:
    """The examples' lines of the registry by the table that they belong to."""
    found = (
        re.match(r"# the line under (_\w+) in core/parts.py\n(.*)", block, re.DOTALL) for block in blocks("python")
    )
    return {match[1]: match[2] for match in found if match is not None}


def example_project(folder: Path) -> Path:
    """Writes the example as a project that can be installed; its folder."""
    (folder / "river_tools").mkdir(parents=True)
    (folder / "river_tools" / "__init__.py").touch()
    for name, text in example_modules().items():
        (folder / "river_tools" / name).write_text(text, encoding="utf-8")
    (folder / "pyproject.toml").write_text(blocks("toml")[0], encoding="utf-8")
    return folder


def example_parts() -> dict[str, dict[str, str]]:
    """Entry points of the example by group and name."""
    return tomllib.loads(blocks("toml")[0])["project"]["entry-points"]


@contextmanager
def installed(
    folder: Path,
    parts: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str] | None = None,
    *,
    name: str = "river-tools",
    version: str = "1.2",
) -> Iterator[None]:
    """Lets a folder be as if a package were installed in it.

    Parameters
    ----------
    folder
        What becomes a place of imports.
    parts
        Entry points by group and name.
    modules
        Text by dotted name of modules to write.
    name, version
        Of the package.
    """
    for module, text in (modules or {}).items():
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in one.items()) for group, one in parts.items()]
    (info / "entry_points.txt").write_text("\n".join(lines))
    with importable(folder):
        yield


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Puts a folder where imports look first; what was imported from it is forgotten afterwards."""
    sys.path.insert(0, str(folder))
    invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None) or "").startswith(f"{folder}/"):
                del sys.modules[name]
        invalidate_caches()
