"""The names of the package: what the stub promises to type checkers is what the package has."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import vfm_sdm


def promised() -> dict[str, str]:
    """Module of every name that the stub imports."""
    stub = ast.parse(Path(vfm_sdm.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    # Without ``as`` a stub's import is private to it, and type checkers see nothing.
    return {alias.asname: f"vfm_sdm.{node.module}" for node in imports for alias in node.names}


def test_stub_and_package_have_the_same_names():
    assert sorted(vfm_sdm.__all__) == sorted([*promised(), "__version__"])
    assert sorted(dir(vfm_sdm)) == sorted(promised())


@pytest.mark.parametrize(("name", "module"), promised().items())
def test_every_public_name_is_public_where_it_lives(name, module):
    home = import_module(module)
    assert getattr(vfm_sdm, name) is getattr(home, name)
    assert name in home.__all__


def test_unknown_names_are_attribute_errors():
    assert not hasattr(vfm_sdm, "mesure")


def test_importing_has_no_heavy_side_effect():
    heavy = "{'torch', 'numpy', 'scipy', 'xarray', 'numba', 'cv2', 'av', 'matplotlib'}"
    code = f"import sys, vfm_sdm; print(*({heavy} & set(sys.modules)), *(m for m in sys.modules if 'vfm_sdm.' in m))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"
