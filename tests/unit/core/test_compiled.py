"""Compiled functions on disk: a change in any file that they are made of is noticed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import vfm_sdm

HELPER = """
from numba import njit

@njit
def times(x):
    return {factor} * x
"""
KERNEL = """
from numba import njit
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.core.helper import times

@njit(cache=True)
{decorator}
def kernel(x):
    return times(x)
"""
ASK = """
from vfm_sdm.core.kernel import kernel
print(kernel(3), sum(kernel.stats.cache_hits.values()))
"""


@pytest.fixture
def small_package(tmp_path: Path) -> Path:
    """A package of this name with a kernel whose helper stands in another file."""
    core = tmp_path / "vfm_sdm" / "core"
    core.mkdir(parents=True)
    for name in ("__init__.py", "core/__init__.py"):
        (tmp_path / "vfm_sdm" / name).touch()
    for name in ("code.py", "compiled.py"):
        shutil.copy(Path(vfm_sdm.__file__).parent / "core" / name, core)
    return core


def ask(core: Path) -> list[int]:
    """What a new process computes with the kernel, and how often it found it on disk."""
    environment = {**os.environ, "PYTHONPATH": str(core.parents[1])}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", ASK], env=environment, cwd=core.parents[1], capture_output=True, text=True, check=True
    )
    return [int(word) for word in done.stdout.split()]


@pytest.mark.parametrize(("decorator", "after"), [("@cached_by_code", [15, 0]), ("", [6, 1])])
def test_a_change_of_a_helper_elsewhere_is_noticed(small_package, decorator, after):
    (small_package / "kernel.py").write_text(KERNEL.format(decorator=decorator), encoding="utf-8")
    (small_package / "helper.py").write_text(HELPER.format(factor=2), encoding="utf-8")
    assert ask(small_package) == [6, 0]
    assert ask(small_package) == [6, 1]
    (small_package / "helper.py").write_text(HELPER.format(factor=5), encoding="utf-8")
    # Without the decorator numba runs what it compiled before.
    assert ask(small_package) == after
