"""Which back ends can run here: the packages and weights each needs, and what to do where one is missing."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import (
    fetch_weights,
    find_weights,
    is_licence_accepted,
    local_weights,
    weights_folder,
)

__all__ = ["BACKEND_NEEDS", "Kind", "Needs", "choose_weights", "default_checkpoint", "require_torch", "why_unavailable"]

Kind = Literal["tracker", "cameras"]

_TITLES = {"torch": "PyTorch"}


@dataclass(frozen=True)
class Needs:
    """What a back end needs beyond the core.

    Parameters
    ----------
    extra
        Of this package, which brings the packages.
    packages
        Names to import.
    checkpoints
        Registered weights that it can run with as it is set by default, the preferred one first; any of them will do.
    """

    extra: str
    packages: tuple[str, ...]
    checkpoints: tuple[str, ...] = ()


_VGGT = Needs("vfm", ("torch", "safetensors"), ("vggt-1b", "vggt-1b-commercial"))
_TAPIR = Needs("vfm", ("torch",), ("bootstapir",))

BACKEND_NEEDS: dict[Kind, dict[str, Needs]] = {
    "tracker": {"vggt": _VGGT, "tapir": _TAPIR},
    "cameras": {"vggt": _VGGT, "sfm": Needs("sfm", ("pycolmap",))},
}
"""Needs by the word of ``[method]`` and the name; whatever is not named here needs the core only."""


def why_unavailable(kind: Kind, name: str) -> str | None:
    """Why a back end cannot run here and what to do, in one line; ``None`` when it can.

    Parameters
    ----------
    kind
        Word of ``[method]`` in a session.
    name
        Of the back end; of a combination such as ``vggt+icgn`` every part has to run.

    Notes
    -----
    Imports nothing and reads no weights, so that a list of all back ends costs nothing.
    """
    for needs in _needs(kind, name):
        for package in needs.packages:
            if find_spec(package) is None:
                return _no_package(package, needs.extra)
        if needs.checkpoints and not any(local_weights(known).is_file() for known in needs.checkpoints):
            return (
                f"expected weights ({' or '.join(needs.checkpoints)}) in {weights_folder()}, got none; "
                f"run `vfm-sdm weights fetch {needs.checkpoints[0]}`"
            )
    return None


def choose_weights(kind: Kind, name: str, wanted: str | None) -> Path:
    """The file of weights that a back end runs with.

    Parameters
    ----------
    kind, name
        As in `why_unavailable`.
    wanted
        Name of a checkpoint or a file, for all networks of a session. A checkpoint of another network says nothing
        here; then, and when ``None``, the back end takes its own (`default_checkpoint`).

    Raises
    ------
    BackendUnavailableError
        The weights are not here, and nobody has acknowledged their licence or they cannot be fetched.

    Notes
    -----
    A checkpoint whose licence was acknowledged is fetched now, on its first use.
    """
    chosen = default_checkpoint(kind, name)
    if wanted and not (wanted in CHECKPOINTS and CHECKPOINTS[wanted].network != CHECKPOINTS[chosen].network):
        chosen = wanted
    if chosen in CHECKPOINTS and not local_weights(chosen).is_file() and is_licence_accepted(chosen):
        return fetch_weights(chosen)
    return find_weights(chosen)


def default_checkpoint(kind: Kind, name: str) -> str:
    """Name of the checkpoint that a back end runs with by default: the first that is here, else the preferred one.

    Raises
    ------
    BackendUnavailableError
        The back end runs without weights.
    """
    known = [checkpoint for needs in _needs(kind, name) for checkpoint in needs.checkpoints]
    if not known:
        raise BackendUnavailableError(
            f"{kind}: expected a back end with weights, got {name!r}; it runs without, name none"
        )
    return next((checkpoint for checkpoint in known if local_weights(checkpoint).is_file()), known[0])


def require_torch(user: str) -> None:
    """Nothing where PyTorch is installed.

    Parameters
    ----------
    user
        What needs it; begins the message.

    Raises
    ------
    BackendUnavailableError
        PyTorch is not installed.
    """
    if find_spec("torch") is None:
        raise BackendUnavailableError(f"{user}: {_no_package('torch', 'vfm')}")


def _needs(kind: Kind, name: str) -> list[Needs]:
    """Those of every part of a combination; none where only the core is needed."""
    return [BACKEND_NEEDS[kind][part] for part in name.split("+") if part in BACKEND_NEEDS[kind]]


def _no_package(package: str, extra: str) -> str:
    return f"expected {_TITLES.get(package, package)}, got none; pip install 'vfm-sdm[{extra}]'"
