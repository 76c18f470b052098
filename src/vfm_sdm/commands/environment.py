"""What this machine has: versions, processors, codecs, and which back ends can run."""

import os
import platform
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

import av.codec

from vfm_sdm.networks.availability import Kind, why_unavailable
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import local_weights
from vfm_sdm.stages.cameras.base import ESTIMATORS
from vfm_sdm.stages.tracking.base import TRACKERS

__all__ = ["describe_environment"]

_CODECS = ("h264", "hevc", "mjpeg", "prores", "av1", "vp9")


def describe_environment() -> dict[str, list[str]]:
    """Lines of text by heading, for people."""
    return {
        "versions": [f"python {platform.python_version()} on {platform.system()} {platform.machine()}", *_packages()],
        "processors": [f"{os.cpu_count()} logical cores"],
        "video decoders": [f"{name}: {'yes' if _can_decode(name) else 'no'}" for name in _CODECS],
        "trackers": _backends("tracker", TRACKERS),
        "camera estimators": _backends("cameras", ESTIMATORS),
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


def _backends(kind: Kind, names: Iterable[str]) -> list[str]:
    reasons = {name: why_unavailable(kind, name) for name in sorted(names)}
    return [f"{name}: {'can run' if reason is None else f'cannot run: {reason}'}" for name, reason in reasons.items()]


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
