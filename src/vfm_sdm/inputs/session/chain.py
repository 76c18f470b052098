"""What products of a session are made of beside its fields and the code: its files, and the parts that it chooses."""

from html import escape
from pathlib import Path
from typing import Any

from vfm_sdm.core.parts import Kind
from vfm_sdm.core.products import Chain
from vfm_sdm.core.registry import code_modules, make, settings_read
from vfm_sdm.core.versions import package_versions
from vfm_sdm.inputs.session.file import session_hash
from vfm_sdm.inputs.session.hashes import InputHashes
from vfm_sdm.inputs.session.model import Session

__all__ = ["SessionChain"]

_MOST = 12
"""Points that are listed by name."""


class SessionChain(Chain[Session]):
    """Products of one session, see `vfm_sdm.core.products.Chain`.

    Parameters
    ----------
    session
        The session.
    folder
        Folder of the products' files; ``None`` keeps all products in memory.
    whole_files
        Whether input files are told from others by their whole content, see `InputHashes`.
    """

    def __init__(self, session: Session, folder: Path | None, *, whole_files: bool = False) -> None:
        super().__init__(session, folder)
        self._session = session
        self._hashes, self._parts = InputHashes(whole_files=whole_files), dict[str, Any]()

    def __repr__(self) -> str:
        """What is measured, what of it is made, and the verdict."""
        made = [name for name in self.products() if name in self._values and self.product(name).kept is not None]
        where = "in memory" if self.folder is None else f"in {self.folder}"
        views, points = len(self._session.view), len(self._session.point)
        return (
            f"<{type(self).__name__} {self._session.name!r}: views {views}, points {points}, {where}; "
            f"made: {', '.join(made) or 'nothing yet'}{self._judgement()}>"
        )

    def _repr_html_(self) -> str:
        """The same as a table of products, for notebooks."""
        rows = "".join(
            f"<tr><td><code>{name}</code></td><td>{self._state_of(name)}</td><td>{escape(self._says(name))}</td></tr>"
            for name in self.products()
        )
        session = self._session
        points = ", ".join(
            escape(point.name) + (" (static)" if point.static else "") for point in session.point[:_MOST]
        )
        more = f" and {len(session.point) - _MOST} more" if len(session.point) > _MOST else ""
        return (
            f"<p><b>{type(self).__name__} {escape(session.name)}</b>{escape(self._judgement())}<br>"
            f"views: {escape(', '.join(view.name for view in session.view))}; points: {points or 'none'}{more}; "
            f"{'in memory' if self.folder is None else escape(str(self.folder))}</p>"
            f"<table><thead><tr><th>product</th><th></th><th></th></tr></thead><tbody>{rows}</tbody></table>"
        )

    def _says(self, name: str) -> str:
        """First line of what is written of a product."""
        return (self.product(name).__doc__ or "").partition("\n")[0].replace("``", "")

    def _state_of(self, name: str) -> str:
        one = self.product(name)
        if name not in self._values:
            return "not yet"
        if name in self.were_given or one.label in self.reused:
            return "given" if name in self.were_given else "read"
        return f"{self.seconds[one.label]:.1f} s" if one.label in self.seconds else "made"

    def _judgement(self) -> str:
        """The verdict of the audit, where there is one."""
        verdict = getattr(self._values.get("audit"), "verdict", None)
        return f"; {verdict}" if verdict else ""

    @property
    def session(self) -> Session:
        """What is measured."""
        self.check_outside("the whole session")
        return self._session

    def check_method(self) -> None:
        """Makes every part that the session asks for, which has to name a point, before any work is done.

        Raises
        ------
        BackendUnavailableError, SessionError
            One of them is unknown or cannot run here; or there is no point.
        """
        self._session.check_points()
        for kind in (kind for name in self.products() for kind in self.product(name).parts):
            self._part(kind)

    def part(self, kind: Kind) -> Any:
        """The part of a kind (``cameras``, ``matchers``, ``trackers``) that the session asks for, made once."""
        self.check_declared(kind)
        return self._part(kind)

    def inputs_of(self, settings: Session) -> dict[str, str]:
        """Hashes of the files that a session names, by what it calls them; each file is read once.

        Raises
        ------
        SessionError
            A file cannot be read.
        VideoError
            No file matches a pattern.
        """
        with self.timed("hashing inputs"):
            return self._hashes.of(settings)

    def part_of(self, kind: Kind) -> dict[str, Any]:
        """Weights of the chosen part."""
        return {"weights": str(getattr(self._part(kind), "weights_id", ""))}

    def part_settings(self, kind: Kind) -> list[str]:
        """Settings that the chosen part reads, and the one that chooses it."""
        return [f"method.{name}" for name in settings_read(kind, self._session.method)]

    def part_modules(self, kind: Kind) -> tuple[str, ...]:
        """Modules of the chosen part."""
        return code_modules(kind, self._session.method)

    def marks(self) -> dict[str, str]:
        """Hash of the whole session, for readers; it takes no part in any key."""
        return {"session_hash": session_hash(self._session)}

    def versions(self) -> dict[str, str]:
        """Versions of the packages that compute."""
        return package_versions()

    def _identity(self, session: Session) -> dict[str, Any]:
        """What a run folder holds results of: one session, one set of inputs."""
        # Products that were given were not made of these files, which need not be there.
        return {
            "session_hash": session_hash(session),
            "input_hashes": {} if self.were_given else self.inputs_of(session),
        }

    def _part(self, kind: Kind) -> Any:
        if kind not in self._parts:
            self._parts[kind] = make(kind, self._session.resolved_method)
        return self._parts[kind]
