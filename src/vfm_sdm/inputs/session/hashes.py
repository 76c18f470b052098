"""Hashes of the files that a session names."""

from pathlib import Path

from vfm_sdm.core.files import file_fingerprint
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.session.recordings import input_files

__all__ = ["InputHashes"]


class InputHashes:
    """Hashes of files, each of which is read once.

    Parameters
    ----------
    whole_files
        Whether files are told from others by their whole content; else large ones are by their size, time stamp and
        sampled blocks (`vfm_sdm.core.files.file_fingerprint`).
    """

    def __init__(self, *, whole_files: bool = False) -> None:
        self._whole_files = whole_files
        self._known: dict[Path, str] = {}

    def of(self, session: Session) -> dict[str, str]:
        """Hashes of the files that a session names, by what it calls them.

        Parameters
        ----------
        session
            The session, or a part of it.

        Raises
        ------
        SessionError
            A file cannot be read.
        VideoError
            No file matches a pattern.
        """
        named = {}
        for name, path in input_files(session):
            if path not in self._known:
                try:
                    self._known[path] = file_fingerprint(path, whole=self._whole_files)
                except OSError as error:
                    raise SessionError(
                        f"{path}: expected a file that can be read, got: {error.strerror}; correct the session"
                    ) from error
            named[name] = self._known[path]
        return named
