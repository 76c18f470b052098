"""Where and how precisely a network runs, and how many frames fit the memory that is free there."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Literal

import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

from vfm_sdm.errors import BackendUnavailableError

__all__ = ["Placement", "choose_placement"]

Precision = Literal["auto", "float32", "bfloat16"]

_ATTENTION = [
    SDPBackend.CUDNN_ATTENTION,
    SDPBackend.FLASH_ATTENTION,
    SDPBackend.EFFICIENT_ATTENTION,
    SDPBackend.MATH,
]
"""Kernels of attention, the fastest on recent GPUs first; PyTorch takes the first that can do it."""
_USABLE = 0.8
"""Share of the free memory that is planned with; the rest is for what fragmentation and others take."""
_NO_MEMORY = ("out of memory", "can't allocate memory", "not enough memory")


@dataclass(frozen=True)
class Placement:
    """Device and precision of a network.

    Parameters
    ----------
    device
        Where it runs.
    reduced
        Whether matrix products are in bfloat16; what positions and cameras are computed from stays in float32.
    """

    device: torch.device
    reduced: bool

    @property
    def precision(self) -> str:
        """``bfloat16`` or ``float32``."""
        return "bfloat16" if self.reduced else "float32"

    @contextmanager
    def running(self) -> Iterator[None]:
        """Inference on this device; memory that runs out raises `MemoryError`."""
        autocast = torch.autocast(self.device.type, torch.bfloat16) if self.reduced else nullcontext()
        try:
            with torch.inference_mode(), autocast, sdpa_kernel(_ATTENTION, set_priority=True):
                yield
        except RuntimeError as error:  # PyTorch's own for GPUs is one, too
            if not any(words in str(error) for words in _NO_MEMORY):
                raise
            if self.device.type == "cuda":
                torch.cuda.empty_cache()
            raise MemoryError(str(error).partition("\n")[0]) from error

    def free_bytes(self) -> int | None:
        """Memory that can be planned with; ``None`` where the system does not tell."""
        if self.device.type == "cuda":
            held = torch.cuda.memory_reserved(self.device) - torch.cuda.memory_allocated(self.device)
            return int(_USABLE * (torch.cuda.mem_get_info(self.device)[0] + held))
        try:
            return int(_USABLE * os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, ValueError, OSError):
            return None


def choose_placement(device: str = "auto", precision: Precision = "auto") -> Placement:
    """The device of this name and how to compute on it.

    Parameters
    ----------
    device
        ``auto`` (a GPU where there is one), or a name that PyTorch knows, such as ``cpu`` or ``cuda:1``.
    precision
        ``auto`` is ``bfloat16`` on GPUs that have it and ``float32`` elsewhere.

    Raises
    ------
    BackendUnavailableError
        There is no such device here.
    """
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        chosen = torch.device(device)
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        raise BackendUnavailableError(
            f"device: expected one that PyTorch can use here, got {device!r}; "
            'set device = "cpu", or install a build of PyTorch for it'
        ) from error
    has_bfloat16 = chosen.type == "cuda" and torch.cuda.is_bf16_supported()
    return Placement(chosen, precision == "bfloat16" or (precision == "auto" and has_bfloat16))
