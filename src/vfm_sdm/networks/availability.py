"""Availability of back ends: the packages and weights that each needs, and advice where one is missing."""

from importlib.util import find_spec
from pathlib import Path

from vfm_sdm.core.parts import KINDS, Kind, Needs
from vfm_sdm.core.registry import parts_of
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import (
    fetch_weights,
    find_weights,
    is_licence_accepted,
    local_weights,
    weights_folder,
)

__all__ = ["choose_weights", "default_checkpoint", "require_torch", "why_unavailable"]

_TITLES = {"torch": "PyTorch"}


def why_unavailable(kind: Kind, name: str) -> str | None:
    """Reason why a back end cannot run here and what to do, in one line; ``None`` when it can.

    Parameters
    ----------
    kind, name
        Kind and name of the back end. Every part of a combination such as ``vggt+icgn`` has to run.

    Returns
    -------
    reason
        Sentence for the user; ``None`` when the back end can run.

    Notes
    -----
    The back ends are not imported and no weights are read, so that a list of all back ends is fast.

    Examples
    --------
    >>> print(why_unavailable("trackers", "icgn"))
    None
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
        for known in needs.all_checkpoints:
            if not local_weights(known).is_file():
                return (
                    f"expected weights ({' and '.join(needs.all_checkpoints)}) in {weights_folder()}, got no {known}; "
                    f"run `vfm-sdm weights fetch {known}`"
                )
    return None


def choose_weights(kind: Kind, name: str, wanted: str | None) -> Path:
    """File of weights that a back end runs with.

    A checkpoint whose licence was acknowledged is fetched now, on its first use.

    Parameters
    ----------
    kind, name
        Kind and name of the back end.
    wanted
        Name of a checkpoint, or a file, for all networks of a session. A checkpoint of another network is ignored;
        then, and when ``None``, the back end takes its own (`default_checkpoint`).

    Returns
    -------
    path
        File of the weights.

    Raises
    ------
    BackendUnavailableError
        The weights are not here, and nobody has acknowledged their licence or they cannot be fetched.
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
            f"{KINDS[kind].word}: expected a back end with weights, got {name!r}; it runs without, name none"
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
    """Those of a back end and of every part that it is made of; none where only the core is needed."""
    return [part.needs for part in parts_of(kind, name).values() if part.needs is not None]


def _no_package(package: str, extra: str) -> str:
    wanted = f"'vfm-sdm[{extra}]'" if extra else package
    return f"expected {_TITLES.get(package, package)}, got none; pip install {wanted}"
