"""Downloads of checkpoints: from Hugging Face by its own client, from plain addresses over https."""

import http.client
import urllib.error
import urllib.request
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.checkpoints import Checkpoint

__all__ = ["download"]

_BLOCK_BYTES = 1 << 20
_TIMEOUT_S = 30.0


def download(
    checkpoint: Checkpoint, folder: Path, *, token: str | None = None, progress: Progress | None = None
) -> Path:
    """Path of the checkpoint's file, after its download into a folder that exists.

    Parameters
    ----------
    checkpoint
        What to download.
    folder
        Folder for the file; what a failure leaves there is the caller's to remove.
    token
        Token of Hugging Face; without one the stored login or ``HF_TOKEN`` is used.
    progress
        Called as bytes arrive, with the checkpoint's name, the bytes that have arrived and those of the whole file.

    Raises
    ------
    BackendUnavailableError
        No network, no access, no such file, or a download cut short.
    OSError
        The folder cannot be written to.
    """
    if checkpoint.on_hub:
        return _from_hub(checkpoint, folder, token, progress)
    return _from_address(checkpoint, folder, progress)


def _from_hub(checkpoint: Checkpoint, folder: Path, token: str | None, progress: Progress | None) -> Path:
    if find_spec("huggingface_hub") is None:
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected the package huggingface_hub, got none; pip install 'vfm-sdm[vfm]'"
        )
    from huggingface_hub import errors, hf_hub_download  # noqa: PLC0415

    try:
        file = hf_hub_download(
            checkpoint.source,
            checkpoint.file_name,
            local_dir=folder,
            token=token,
            tqdm_class=_reporter(progress, checkpoint),
        )
    except errors.RepositoryNotFoundError as error:  # includes gated ones, which look absent without a token
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected access to {checkpoint.page}, got a refusal; accept the terms on that "
            "page, then log in with `hf auth login` or set HF_TOKEN, and fetch again"
        ) from error
    except errors.RemoteEntryNotFoundError as error:
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected {checkpoint.file_name} in {checkpoint.page}, got no such file; "
            "download the weights by hand and give their path instead of the name"
        ) from error
    except _network_errors() as error:
        _no_network(checkpoint, error)
    except OSError as error:
        if error.errno is not None:  # the disk's, not the network's
            raise
        _no_network(checkpoint, error)
    return Path(file)


def _network_errors() -> tuple[type[Exception], ...]:
    """What the client of Hugging Face raises on a bad answer or none, its own errors and those of its transports."""
    from huggingface_hub import errors  # noqa: PLC0415

    transports = (getattr(errors, name, None) for name in ("HTTPError", "XetDownloadError"))
    return (errors.HfHubHTTPError, errors.LocalEntryNotFoundError, *(kind for kind in transports if kind is not None))


def _reporter(progress: Progress | None, checkpoint: Checkpoint) -> type[Any]:
    """A progress bar of Hugging Face that draws nothing and reports bytes instead."""
    from huggingface_hub.utils import tqdm  # type: ignore[attr-defined]  # noqa: PLC0415

    furthest = 0

    class Reporter(tqdm):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **{**options, "disable": True})  # type: ignore[no-untyped-call]

        def update(self, n: float | None = 1) -> None:
            nonlocal furthest
            self.n += n or 0
            # Some transports count twice, what was received and what was written; the further one tells the state.
            furthest = max(furthest, int(self.n))
            if progress is not None:
                progress(checkpoint.name, furthest, checkpoint.size_bytes)

    return Reporter


def _from_address(checkpoint: Checkpoint, folder: Path, progress: Progress | None) -> Path:
    file = folder / checkpoint.file_name
    try:
        with urllib.request.urlopen(checkpoint.page, timeout=_TIMEOUT_S) as response:
            length = response.headers.get("Content-Length")
            total = int(length) if length else None
            done = 0
            with file.open("wb") as stream:
                while block := response.read(_BLOCK_BYTES):
                    stream.write(block)
                    done += len(block)
                    if progress is not None:
                        progress(checkpoint.name, done, total)
    except (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError) as error:
        _no_network(checkpoint, error)
    if total is not None and done != total:
        raise BackendUnavailableError(
            f"weights {checkpoint.name}: expected {total} bytes, got {done}; the download was cut short, fetch it again"
        )
    return file


def _no_network(checkpoint: Checkpoint, error: Exception) -> NoReturn:
    said = " ".join(str(error).split()) or type(error).__name__
    raise BackendUnavailableError(
        f"weights {checkpoint.name}: expected an answer from {checkpoint.page}, got: {said[:200]}; check the network, "
        "or download the file elsewhere and give its path instead of the name"
    ) from error
