"""Versions of the programs that a result depends on."""

import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version

__all__ = ["package_versions"]

_PACKAGES = ("vfm-sdm", "numpy", "scipy", "xarray", "av", "opencv-python-headless", "numba", "poselib")
_OPTIONAL = ("torch", "pycolmap", "transformers")


def package_versions() -> dict[str, str]:
    """Versions of Python, of this package and of the packages that it computes with, by name."""
    return dict(_read_versions())


@cache
def _read_versions() -> dict[str, str]:
    """Versions as they are when they are first asked for: every product's key holds them, and reading takes 5 ms."""
    found = {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}
    for name in _OPTIONAL:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
