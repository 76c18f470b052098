"""Files of weights on this machine: where they lie, and how they come here. Needs no PyTorch."""

import os
import shutil
import tempfile
import tomllib
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomli_w
from platformdirs import user_cache_path

from vfm_sdm.core.files import file_hash, replace_file
from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.checkpoints import CHECKPOINTS, Checkpoint
from vfm_sdm.networks.download import download

__all__ = ["fetch_weights", "find_weights", "is_licence_accepted", "local_weights", "weights_folder", "weights_id"]

_SUFFIXES = (".safetensors", ".pt", ".pth")
_LICENCES = "licences.toml"
_HASHES = "hashes.toml"
_ID_DIGITS = 12
_SIZE_TOLERANCE = 0.02
_EARLIER_FOLDER = Path("~/Library/Caches/vfm-sdm/weights")
"""Where macOS had them even with ``XDG_CACHE_HOME`` set; gigabytes that lie there are not fetched again."""


def weights_folder() -> Path:
    """Folder in which fetched weights lie: ``VFM_SDM_WEIGHTS`` if set, else one in the user's cache."""
    if chosen := os.environ.get("VFM_SDM_WEIGHTS"):
        return Path(chosen).expanduser()
    # On Windows the opinion is a folder ``Cache``, in which weights never lay.
    folder = user_cache_path("vfm-sdm", appauthor=False, opinion=False) / "weights"
    if not folder.exists() and _has_weights(_EARLIER_FOLDER.expanduser()):
        return _EARLIER_FOLDER.expanduser()
    return folder


def _has_weights(folder: Path) -> bool:
    return folder.is_dir() and any(file.suffix in _SUFFIXES for file in folder.iterdir())


def local_weights(name: str) -> Path:
    """Where the weights of a registered checkpoint lie once they are fetched; the file need not be there.

    Raises
    ------
    BackendUnavailableError
        No checkpoint has this name.
    """
    return weights_folder() / f"{name}{Path(_checkpoint(name).file_name).suffix}"


def find_weights(name_or_path: str | Path) -> Path:
    """The file of a registered checkpoint or of a local path; asks no network.

    Parameters
    ----------
    name_or_path
        Name in `CHECKPOINTS`, or a file that ends in ``.safetensors``, ``.pt`` or ``.pth``.

    Raises
    ------
    BackendUnavailableError
        There is no such file here; the message says which command brings it.
    """
    if str(name_or_path) in CHECKPOINTS:
        name = str(name_or_path)
        path = local_weights(name)
        if not path.is_file():
            raise BackendUnavailableError(
                f"weights: expected {path}, got no such file; run `vfm-sdm weights fetch {name}`"
            )
        return path
    path = Path(name_or_path).expanduser()
    if path.suffix.lower() not in _SUFFIXES:
        raise BackendUnavailableError(
            f"weights: expected one of {sorted(CHECKPOINTS)} or a file {', '.join(_SUFFIXES)}, got "
            f"{str(name_or_path)!r}; choose one of these (`vfm-sdm weights list`)"
        )
    if not path.is_file():
        raise BackendUnavailableError(f"weights: expected a file, got {str(path)!r}, which is none; correct the path")
    return path


def is_licence_accepted(name: str) -> bool:
    """Whether the licence of a registered checkpoint, as it is now, was acknowledged on this machine.

    Raises
    ------
    BackendUnavailableError
        No checkpoint has this name, or the record of acknowledgements cannot be read.
    """
    recorded = _read_record(_LICENCES).get(name, {})
    return bool(recorded.get("licence") == _checkpoint(name).licence)


def fetch_weights(
    name: str, *, accept_licence: bool = False, token: str | None = None, progress: Progress | None = None
) -> Path:
    """Downloads a registered checkpoint unless it is already here and of its size.

    Parameters
    ----------
    name
        Name in `CHECKPOINTS`.
    accept_licence
        Acknowledges the licence of these weights; remembered beside them, so that it is needed once.
    token
        Access token of Hugging Face, for gated checkpoints; without one the stored login or ``HF_TOKEN`` is used.
    progress
        Called with the checkpoint's name, the bytes that have arrived and those of the whole file.

    Returns
    -------
    Path
        The file; whole, or an error is raised and nothing of it is left.

    Raises
    ------
    BackendUnavailableError
        Unknown name, a checkpoint that only a person can fetch, licence not acknowledged, disk full, no network, no
        access, or a file of another size.
    """
    checkpoint = _checkpoint(name)
    target = local_weights(name)
    if target.is_file() and _has_size(checkpoint, target):
        return target
    if checkpoint.by_hand:
        raise BackendUnavailableError(
            f"weights {name}: expected {target}, got no whole file; no program can fetch it: follow the link on "
            f"{checkpoint.page} ({checkpoint.licence}), and save the file under that name"
        )
    if accept_licence:
        _remember(_LICENCES, name, {"licence": checkpoint.licence, "accepted": datetime.now(UTC)})
    elif not is_licence_accepted(name):
        raise BackendUnavailableError(
            f"weights {name}: expected that its licence is acknowledged ({checkpoint.licence}, "
            f"{checkpoint.licence_url}), got no acknowledgement; read it, then run "
            f"`vfm-sdm weights fetch {name} --accept-licence`"
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _check_space(checkpoint, target.parent)
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{name}-") as folder:
            file = download(checkpoint, Path(folder), token=token, progress=progress)
            _check_size(checkpoint, file)
            file.replace(target)
    except OSError as error:
        raise BackendUnavailableError(
            f"weights {name}: expected to write to {target.parent}, got {error}; "
            "set VFM_SDM_WEIGHTS to a folder that can be written to"
        ) from error
    return target


def weights_id(path: str | Path) -> str:
    """Name of a file of weights and the first 12 digits of its SHA-256, such as ``vggt-1b-0123456789ab``.

    Notes
    -----
    The hash is remembered by path, size and time of change, so that gigabytes are read once.

    Raises
    ------
    BackendUnavailableError
        The file cannot be read.
    """
    file = Path(path).resolve()
    try:
        stat = file.stat()
        known = _read_record(_HASHES).get(str(file), {})
        if (known.get("bytes"), known.get("changed_ns")) == (stat.st_size, stat.st_mtime_ns):
            return f"{file.stem}-{known['sha256'][:_ID_DIGITS]}"
        digest = file_hash(file)
    except OSError as error:
        raise BackendUnavailableError(
            f"weights: expected a file that can be read, got {error}; correct the path"
        ) from error
    with suppress(BackendUnavailableError):  # an unwritable folder costs the time of hashing again, nothing else
        _remember(_HASHES, str(file), {"bytes": stat.st_size, "changed_ns": stat.st_mtime_ns, "sha256": digest})
    return f"{file.stem}-{digest[:_ID_DIGITS]}"


def _checkpoint(name: str) -> Checkpoint:
    if name not in CHECKPOINTS:
        raise BackendUnavailableError(
            f"weights: expected one of {sorted(CHECKPOINTS)}, got {name!r}; choose one of these"
        )
    return CHECKPOINTS[name]


def _check_space(checkpoint: Checkpoint, folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < checkpoint.size_bytes:
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected {checkpoint.size} free in {folder}, got {free / 1e9:.2f} GB; "
            "make room or set VFM_SDM_WEIGHTS to another folder"
        )


def _has_size(checkpoint: Checkpoint, file: Path) -> bool:
    return abs(file.stat().st_size - checkpoint.size_bytes) <= _SIZE_TOLERANCE * checkpoint.size_bytes


def _check_size(checkpoint: Checkpoint, file: Path) -> None:
    found = file.stat().st_size
    if not _has_size(checkpoint, file):
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected about {checkpoint.size_bytes} bytes, got {found}; fetch it again, "
            f"and if the size stays, {checkpoint.page} now holds another file"
        )


def _read_record(file_name: str) -> dict[str, Any]:
    path = weights_folder() / file_name
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise BackendUnavailableError(f"weights: expected TOML in {path}, got {error}; delete this file") from error


def _remember(file_name: str, key: str, entry: dict[str, Any]) -> None:
    path = weights_folder() / file_name
    record = {**_read_record(file_name), key: entry}
    try:
        with replace_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(record), encoding="utf-8")
    except OSError as error:
        raise BackendUnavailableError(
            f"weights: expected to write {path}, got {error}; set VFM_SDM_WEIGHTS to a folder that can be written to"
        ) from error
