"""Where and how precisely a network runs, and how many frames fit the memory that is free there."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

from vfm_sdm.errors import BackendUnavailableError, DeviceMemoryError
from vfm_sdm.networks.interface import Precision

__all__ = ["Placement", "choose_placement", "one_thread"]

_ATTENTION = [
    SDPBackend.CUDNN_ATTENTION,
    SDPBackend.FLASH_ATTENTION,
    SDPBackend.EFFICIENT_ATTENTION,
    SDPBackend.MATH,
]
"""Kernels of attention, the fastest on recent GPUs first; PyTorch takes the first that can do it."""
_USABLE = 0.8
"""Share of the free memory that is used; the rest is for fragmentation and for other programs."""
_NO_MEMORY = ("out of memory", "can't allocate memory", "not enough memory", "ALLOC_FAILED")
_MEMINFO = Path("/proc/meminfo")


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
        """Inference on this device.

        Raises
        ------
        DeviceMemoryError
            The computation does not fit the memory.

        Notes
        -----
        In float32, convolutions are not rounded to the 10 bits of TF32 either, which PyTorch does by default.
        """
        autocast = torch.autocast(self.device.type, torch.bfloat16) if self.reduced else nullcontext()
        convolutions = torch.backends.cudnn.flags(enabled=True, allow_tf32=self.reduced)
        try:
            with torch.inference_mode(), autocast, convolutions, sdpa_kernel(_ATTENTION, set_priority=True):
                yield
        except RuntimeError as error:  # PyTorch's own for GPUs is one, too
            if not any(words in str(error) for words in _NO_MEMORY):
                raise
            raise DeviceMemoryError(
                f"device {self.device}: expected room for the network, got {str(error).splitlines()[0][:120]!r}; close "
                "other programs on it, or set another device under [method.network]"
            ) from error

    def free_bytes(self) -> int | None:
        """Memory that a network may use [byte]; ``None`` where the system does not tell."""
        if self.device.type == "cuda":
            held = torch.cuda.memory_reserved(self.device) - torch.cuda.memory_allocated(self.device)
            return int(_USABLE * (torch.cuda.mem_get_info(self.device)[0] + held))
        if self.device.type != "cpu" or not _MEMINFO.is_file():
            return None
        # Not what is unused: files that were read, such as the weights, lie in memory that can be had at once.
        lines = dict(line.split(":", 1) for line in _MEMINFO.read_text(encoding="ascii").splitlines())
        return int(_USABLE * 1024 * int(lines["MemAvailable"].split()[0]))


def choose_placement(device: str = "auto", precision: Precision = "auto") -> Placement:
    """The named device, and the precision of computations on it.

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

    Examples
    --------
    >>> choose_placement("cpu").precision
    'float32'
    """
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        chosen = torch.device("" if device == "meta" else device)
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        raise BackendUnavailableError(
            f"device: expected one that PyTorch can use here, got {device!r}; "
            'set device = "cpu", or install a build of PyTorch for it'
        ) from error
    # Older GPUs emulate it, at a loss.
    has_bfloat16 = chosen.type == "cuda" and torch.cuda.get_device_capability(chosen) >= (8, 0)
    return Placement(chosen, precision == "bfloat16" or (precision == "auto" and has_bfloat16))


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which PyTorch computes on one thread of the processor, so that sums have one order on any machine.

    Notes
    -----
    The number is the process's own: other networks that run meanwhile have one thread, too.

    Examples
    --------
    >>> with one_thread():
    ...     torch.get_num_threads()
    1
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
