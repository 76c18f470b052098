"""Golden data of the networks: inputs, and what comes out of every stage with weights made by a recipe."""

import importlib.util
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Arrays = dict[str, np.ndarray]
Shapes = dict[str, list[int]]

_ROOT = Path(__file__).resolve().parents[1]
_MEMORY_INFO = Path("/proc/meminfo")


def golden_folder(network: str) -> Path:
    """Folder of a network's golden data; the test skips where they are not at hand."""
    folder = Path(os.environ.get("VFM_SDM_SHARED", _ROOT.parent / "shared")) / "golden" / network
    if not folder.is_dir():
        pytest.skip(f"golden data of {network!r} are not here; set VFM_SDM_SHARED to the folder that holds golden/")
    return folder


def read_arrays(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def read_shapes(path: Path) -> Shapes:
    """Manifest of a checkpoint: shape by key."""
    return json.loads(path.read_text(encoding="utf-8"))


def load_recipe(folder: Path) -> Any:
    """Module whose ``tensor(key, shape)`` makes the weights that the golden data were computed with."""
    spec = importlib.util.spec_from_file_location(f"recipe_{folder.name}", folder / "weights_recipe.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shapes_of(module: Any) -> Shapes:
    """Shape by key of a PyTorch module's state."""
    return {key: list(value.shape) for key, value in module.state_dict().items()}


def recipe_weights(folder: Path, shapes: Mapping[str, list[int]]) -> dict[str, Any]:
    """Tensors by key."""
    import torch

    recipe = load_recipe(folder)
    return {key: torch.from_numpy(recipe.tensor(key, shape)) for key, shape in shapes.items()}


def need_memory(gigabytes: float) -> None:
    """Skips the test where less memory is free; where nobody says how much that is, it runs."""
    if not _MEMORY_INFO.is_file():
        return
    lines = dict(line.split(":") for line in _MEMORY_INFO.read_text(encoding="ascii").splitlines())
    free = int(lines["MemAvailable"].split()[0]) * 1024 / 1e9
    if free < gigabytes:
        pytest.skip(f"needs {gigabytes:g} GB of free memory, here are {free:.1f} GB")
