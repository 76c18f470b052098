"""What this machine has: versions, processors, codecs, and which back ends can run."""

import os
import platform
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

import av.codec

from vfm_sdm.cameras.base import ESTIMATORS
from vfm_sdm.tracking.base import TRACKERS

__all__ = ["describe_environment"]

_CODECS = ("h264", "hevc", "mjpeg", "prores", "av1", "vp9")


def describe_environment() -> dict[str, list[str]]:
    """Lines of text by heading, for people."""
    return {
        "versions": [f"python {platform.python_version()} on {platform.system()} {platform.machine()}", *_packages()],
        "processors": [f"{os.cpu_count()} logical cores"],
        "video decoders": [f"{name}: {'yes' if _can_decode(name) else 'no'}" for name in _CODECS],
        "trackers": [f"{name}: can run" for name in sorted(TRACKERS)],
        "camera estimators": [f"{name}: can run" for name in sorted(ESTIMATORS)],
        "vision foundation models": [_torch()],
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


def _torch() -> str:
    if find_spec("torch") is None:
        return "not in this version, and PyTorch is not installed; the classical back ends above need neither"
    return f"not in this version (PyTorch {version('torch')} is installed)"
