"""The command ``info``: versions, processors and codecs of this machine, and which back ends can run."""

import os
import platform
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

import av.codec

from vfm_sdm.commands.terminal import OUT, say
from vfm_sdm.core.parts import KINDS, Kind
from vfm_sdm.core.registry import find, part_names
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.availability import why_unavailable
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import local_weights

__all__ = ["describe_environment", "info"]

_CODECS = ("h264", "hevc", "mjpeg", "prores", "av1", "vp9")


def info() -> None:
    """Versions, processors, codecs, and which back ends can run here and why others cannot."""
    for name, lines in describe_environment().items():
        OUT.print(name, style="bold")
        for line in lines:
            say(f"  {line}")


def describe_environment() -> dict[str, list[str]]:
    """Lines of text by heading, for people."""
    return {
        "versions": [f"python {platform.python_version()} on {platform.system()} {platform.machine()}", *_packages()],
        "processors": [f"{os.cpu_count()} logical cores"],
        "video decoders": [f"{name}: {'yes' if _can_decode(name) else 'no'}" for name in _CODECS],
        **{info.title: _parts(kind) for kind, info in KINDS.items()},
        "vision foundation models": [*_torch(), *_checkpoints()],
    }


def _packages() -> list[str]:
    names = [requirement.split(">")[0].split(";")[0].strip() for requirement in requires("vfm-sdm") or []]
    core = [name for name, text in zip(names, requires("vfm-sdm") or [], strict=True) if "extra ==" not in text]
    lines = [f"vfm-sdm {version('vfm-sdm')}"]
    for name in core:
        try:
            lines.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            lines.append(f"{name} missing")
    return lines


def _can_decode(name: str) -> bool:
    try:
        return av.codec.Codec(name, "r").name is not None
    except (ValueError, av.codec.codec.UnknownCodecError):
        return False


def _parts(kind: Kind) -> list[str]:
    """Every part of a kind: whether it can run here, and which package brings it where that is another one."""
    return [f"{name}: {_state(kind, name)}" for name in part_names(kind)]


def _state(kind: Kind, name: str) -> str:
    try:
        brought = find(kind, name).distribution
        reason = why_unavailable(kind, name)
    except BackendUnavailableError as error:
        return f"cannot run: {error}"
    return ("can run" if reason is None else f"cannot run: {reason}") + (f" ({brought})" if brought else "")


def _torch() -> list[str]:
    if find_spec("torch") is None:
        return ["PyTorch: not installed; pip install 'vfm-sdm[vfm]' (the classical back ends above do without)"]
    cuda = import_module("torch").cuda
    devices = [cuda.get_device_properties(number) for number in range(cuda.device_count())]
    lines = [f"CUDA device {n}: {one.name}, {one.total_memory / 1e9:.0f} GB" for n, one in enumerate(devices)]
    return [f"PyTorch {version('torch')}", *(lines or ["CUDA device: none; the networks run on the processors"])]


def _checkpoints() -> list[str]:
    places = {name: local_weights(name) for name in CHECKPOINTS}
    return [
        f"weights {name}: {path if path.is_file() else f'not here; vfm-sdm weights fetch {name}'}"
        for name, path in places.items()
    ]
