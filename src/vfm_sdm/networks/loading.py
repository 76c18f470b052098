"""Reads weights and puts them into PyTorch modules. Its functions need PyTorch, the import of this file does not."""

import pickle
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.availability import require_torch
from vfm_sdm.networks.weights import find_weights

if TYPE_CHECKING:
    import torch

__all__ = ["load_weights", "read_state"]

_NESTS = ("model", "state_dict", "model_state_dict")
_SHOWN = 5


@dataclass(frozen=True)
class _Contents:
    """What a set of weights holds; a tensor is read only when it is asked for."""

    label: str
    shapes: dict[str, tuple[int, ...]]
    read: Callable[[str], "torch.Tensor"]

    def unwrapped(self, prefix: str) -> "_Contents":
        keys = {key.removeprefix(prefix): key for key in self.shapes}
        return _Contents(self.label, {k: self.shapes[key] for k, key in keys.items()}, lambda k: self.read(keys[k]))


def read_state(name_or_path: str | Path, *, dtype: "torch.dtype | None" = None) -> dict[str, "torch.Tensor"]:
    """Every tensor of a file of weights, by its key.

    Parameters
    ----------
    name_or_path
        As for `find_weights`. Files of PyTorch are read with ``weights_only``, so that nothing in them is executed.
    dtype
        Floating-point tensors are converted to it; kept as stored when ``None``.

    Returns
    -------
    dict
        Tensors of the stored shapes on the CPU, mapped from the file: pages that are not used take no memory.

    Raises
    ------
    BackendUnavailableError
        There is no such file, it is truncated, or it holds something else than named tensors.
    """
    with _open(find_weights(name_or_path)) as contents:
        return {key: _convert_type(contents.read(key), dtype) for key in contents.shapes}


def load_weights(
    module: "torch.nn.Module",
    source: "str | Path | Mapping[str, torch.Tensor]",
    *,
    optional_prefixes: Sequence[str] = (),
    wrapped_in: str = "",
    dtype: "torch.dtype | None" = None,
) -> None:
    """Puts weights into a module, key by key: none may be missing, left over or of another shape.

    Parameters
    ----------
    module
        Its parameters and persistent buffers are replaced, not written to, so that a module on the ``meta`` device
        never holds memory of its own; afterwards they lie on the CPU.
    source
        Name or file as for `find_weights`, or tensors by key.
    optional_prefixes
        Keys that begin with one of these and that the module lacks are skipped without being read: heads that were
        not built.
    wrapped_in
        Prefix that training may have put in front of every key; it is taken off where it is.
    dtype
        Floating-point tensors are converted to it; kept as stored when ``None``.

    Raises
    ------
    BackendUnavailableError
        There is no such file, it cannot be read, its keys or shapes are not those of the module, or its values are not
        all numbers; the message counts the differences and names the first five of each kind.

    Examples
    --------
    >>> import torch
    >>> layer = torch.nn.Linear(2, 1, bias=False)
    >>> load_weights(layer, {"weight": torch.tensor([[3.0, 4.0]])})
    >>> layer(torch.ones(1, 2)).item()
    7.0
    """
    with _open_contents(source) as stored:
        contents = stored.unwrapped(wrapped_in)
        expected = {key: tuple(value.shape) for key, value in module.state_dict().items()}
        optional = tuple(optional_prefixes)
        offered = {key for key in contents.shapes if key in expected or not key.startswith(optional)}
        faults = _list_differences(expected, contents.shapes, offered)
        if faults:
            raise BackendUnavailableError(
                f"weights {contents.label}: expected the {len(expected)} tensors of {type(module).__name__}, got "
                f"{'; '.join(faults)}; give the file that belongs to this network (`vfm-sdm weights list`)"
            )
        state = {key: _convert_type(contents.read(key), dtype) for key in expected}
        damaged = [key for key, tensor in state.items() if not _is_finite(tensor)]
        if damaged:
            named = ", ".join(damaged[:_SHOWN]) + (", ..." if len(damaged) > _SHOWN else "")
            raise BackendUnavailableError(
                f"weights {contents.label}: expected numbers, got values that are none in {len(damaged)} tensors "
                f"({named}); the file is damaged, fetch it again or give another"
            )
    module.load_state_dict(state, strict=True, assign=True)


def _list_differences(
    expected: Mapping[str, tuple[int, ...]], found: Mapping[str, tuple[int, ...]], offered: set[str]
) -> list[str]:
    """One text a kind of difference: count, and the first few keys with their shapes."""
    kinds = {
        "missing": [f"{key} {_format_shape(expected[key])}" for key in expected if key not in offered],
        "unexpected": [f"{key} {_format_shape(found[key])}" for key in found if key in offered and key not in expected],
        "of another shape": [
            f"{key} {_format_shape(found[key])} instead of {_format_shape(shape)}"
            for key, shape in expected.items()
            if key in offered and found[key] != shape
        ],
    }
    return [
        f"{len(lines)} {kind} ({', '.join(lines[:_SHOWN])}{', ...' if len(lines) > _SHOWN else ''})"
        for kind, lines in kinds.items()
        if lines
    ]


def _format_shape(shape: tuple[int, ...]) -> str:
    return "x".join(map(str, shape)) or "scalar"


def _is_finite(tensor: "torch.Tensor") -> bool:
    """Whether all values are numbers: their sum is, in a precision that no sum of weights exceeds."""
    import torch  # noqa: PLC0415

    return not tensor.is_floating_point() or bool(torch.isfinite(tensor.sum(dtype=torch.float64)))


def _convert_type(tensor: "torch.Tensor", dtype: "torch.dtype | None") -> "torch.Tensor":
    return tensor if dtype is None or not tensor.is_floating_point() else tensor.to(dtype)


@contextmanager
def _open_contents(source: "str | Path | Mapping[str, torch.Tensor]") -> Iterator[_Contents]:
    if isinstance(source, Mapping):
        yield _describe_tensors("given as tensors", source)
        return
    with _open(find_weights(source)) as contents:
        yield contents


@contextmanager
def _open(path: Path) -> Iterator[_Contents]:
    require_torch(f"weights {path.name}")
    if path.suffix.lower() != ".safetensors":
        yield _describe_tensors(path.name, _read_zip(path))
        return
    if find_spec("safetensors") is None:
        raise BackendUnavailableError(
            f"weights {path.name}: expected the package safetensors, got none; pip install 'vfm-sdm[vfm]'"
        )
    from safetensors import SafetensorError, safe_open  # noqa: PLC0415

    try:
        file = safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        _unreadable(path, "safetensors", error)
    with file as stream:
        shapes = {key: tuple(stream.get_slice(key).get_shape()) for key in stream.keys()}  # noqa: SIM118
        yield _Contents(path.name, shapes, stream.get_tensor)


def _describe_tensors(label: str, tensors: "Mapping[str, torch.Tensor]") -> _Contents:
    return _Contents(label, {key: tuple(value.shape) for key, value in tensors.items()}, tensors.__getitem__)


def _read_zip(path: Path) -> "dict[str, torch.Tensor]":
    """Named tensors of a file of ``torch.save``, taken out of the usual nesting."""
    import torch  # noqa: PLC0415

    # The format before 2020 is a bare pickle; none of the checkpoints uses it, and foreign files pass for it.
    try:
        archive = zipfile.is_zipfile(path)
    except zipfile.BadZipFile:  # of the end of an archive that names parts elsewhere
        archive = False
    if not archive:
        _unreadable(path, "a checkpoint of PyTorch (a zip archive)", "no zip archive")
    try:
        stored: Any = torch.load(path, map_location="cpu", mmap=True, weights_only=True)
    except (RuntimeError, ValueError, OSError, EOFError, LookupError, pickle.UnpicklingError) as error:
        _unreadable(path, "a checkpoint of PyTorch that holds tensors only", error)
    while isinstance(stored, Mapping) and (nest := next((name for name in _NESTS if name in stored), None)):
        stored = stored[nest]
    if not (isinstance(stored, Mapping) and stored and all(isinstance(v, torch.Tensor) for v in stored.values())):
        _unreadable(path, "tensors by key", f"{type(stored).__name__} with other content")
    return dict(stored)


def _unreadable(path: Path, expected: str, found: Exception | str) -> NoReturn:
    said = found if isinstance(found, str) else str(found).strip().partition("\n")[0][:160] or type(found).__name__
    raise BackendUnavailableError(
        f"weights {path}: expected {expected}, got {said}; the file is truncated or foreign, "
        "fetch it again or give another"
    ) from (None if isinstance(found, str) else found)
