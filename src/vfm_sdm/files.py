"""Files that are either whole or absent: atomic writing, and the hash that identifies a file's content."""

import hashlib
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["file_hash", "replace_file"]

_BLOCK_BYTES = 1 << 20


@contextmanager
def replace_file(path: Path | str) -> Iterator[Path]:
    """A temporary path to write to; it takes the name ``path`` only when the block ends without an error.

    A failed write leaves an earlier file as it was and nothing half-written beside it.

    Parameters
    ----------
    path
        The file to make or replace; its folder is made when absent.

    Raises
    ------
    OSError
        The folder cannot be made or written to.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    # In the same folder, because a rename is atomic only within one file system; with the same suffix, because some
    # writers choose the format by it or append it when it is missing.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    try:
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def file_hash(path: Path | str) -> str:
    """SHA-256 of a file's content as 64 hexadecimal digits, read in blocks.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
