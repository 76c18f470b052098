"""The run folder: results of one session and one set of inputs, written by one process at a time.

`RunFolder.opened` is how a run enters it; `RunFolder.check_whole` is what a reader asks before it believes it.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vfm_sdm.core.block_files import ScratchFile
from vfm_sdm.core.files import file_hash, remove_orphans, write_json
from vfm_sdm.core.one_writer import held_alone
from vfm_sdm.errors import ResultsError

__all__ = ["SESSION", "RunFolder"]

SESSION = "session.resolved.toml"
"""The session that is measured in a folder, with all its settings."""

_SUMMARY, _FIGURES = "summary.json", "figures"
_ANALYSES = ("field", "fused", "load_test", "modes", "passages", "repeatability")
"""What commands add to a run: files of these names, and figures."""
_RESULTS = (
    *("displacement.*", "movement_*.nc", "revisit.csv", "evaluation.json", "acceptance_*.json", _SUMMARY),
    *("report.html", "report.pdf"),
    *(f"{stem}.{kind}" for stem in _ANALYSES for kind in ("nc", "csv")),
    *("modes.uff", "field.mp4", "field.gif", "field.pvd"),
    *(
        f"{_FIGURES}/{stem}"
        for stem in (
            *("trajectory_*.png", "displacement_*.png", "points_*.png", "audit.png"),
            *(f"{stem}.png" for stem in _ANALYSES),
            *("field_map.png", "modes_*.png", "mode_*.gif"),
        )
    ),
)
"""What is said of a measurement. Cameras, points and tracks stand under keys of their own, which tell what they are
worth to another session."""
_IDENTITY = ("session_hash", "input_hashes")


class RunFolder:
    """A folder of results.

    Parameters
    ----------
    path
        The folder; it need not exist.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    @property
    def record(self) -> dict[str, Any]:
        """What ``summary.json`` holds; empty where there is none, or a damaged one."""
        try:
            found = json.loads((self.path / _SUMMARY).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    @contextmanager
    def opened(self, identity: Mapping[str, Any]) -> Iterator[None]:
        """The folder for this process alone, without results of other sessions or inputs.

        Parameters
        ----------
        identity
            ``session_hash`` and ``input_hashes`` of what is measured.

        Raises
        ------
        ResultsError
            Another process writes to the folder, or nobody can.
        """
        with held_alone(
            self.path,
            "run",
            expected="a folder that no other run writes to",
            advice="wait for it, or choose another -o",
        ):
            ScratchFile.clear(self.path)
            self._prepare(identity)
            yield

    def check_inputs_stay(self, inputs: Iterable[Path], written: Iterable[str]) -> None:
        """Refuses to overwrite what is measured.

        Parameters
        ----------
        inputs
            Files that the session reads.
        written
            Names of files that a run writes to the folder, beside what it says of the measurement.

        Raises
        ------
        ResultsError
            One of the inputs would be overwritten or removed.
        """
        taken = {self.path.resolve() / name for name in written} | {path.resolve() for path in self._results()}
        for path in inputs:
            if path.resolve() in taken:
                raise ResultsError(
                    f"{self.path}: expected a folder in which nothing is overwritten that the session reads, got "
                    f"{path.name}; choose another -o"
                )

    def add(self, content: Mapping[str, Any]) -> Path:
        """Puts entries into ``summary.json``, in the place of those of the same name; its path.

        Parameters
        ----------
        content
            See `vfm_sdm.core.files.write_json`.

        Raises
        ------
        ResultsError
            The file cannot be written.
        """
        return write_json(self.path / _SUMMARY, {**self.record, **content}, label="summary")

    def keep_figures(self, paths: list[Path]) -> None:
        """Removes the figures that an earlier run drew and this one did not.

        Parameters
        ----------
        paths
            Figures of this run.
        """
        for path in self._results():
            if path.parent.name == _FIGURES and path not in paths:
                path.unlink(missing_ok=True)

    def check_whole(self, product: str, marks: Mapping[str, Any]) -> tuple[str, ...]:
        """Refuses a result that is not of the run which the folder describes; notes on one that is.

        Parameters
        ----------
        product
            Name of the product, such as ``displacement``.
        marks
            What its file says of itself: ``key`` and ``session_hash``.

        Returns
        -------
        notes
            Sentences that a reader of the result must know.

        Raises
        ------
        ResultsError
            The result, the session and ``summary.json`` belong to different runs, or to one that was cut short.
        """
        record, own = self.record, str(marks.get("session_hash", ""))
        if not record or not own:
            return ()
        products = record.get("products")
        stated = products.get(product) if isinstance(products, dict) else None
        if record.get("session_hash") != own or (stated is not None and stated != marks.get("key")):
            raise ResultsError(
                f"{self.path}: expected results of one run, got {product} of session {own[:8]} that summary.json of "
                f"session {str(record.get('session_hash'))[:8]} does not know: runs of different sessions are mixed, "
                "or one was cut short; run `vfm-sdm measure` again"
            )
        session = self.path / SESSION
        try:
            found = file_hash(session) if session.exists() else None
        except OSError as error:
            raise ResultsError(
                f"{session}: expected the session that was measured, got: {error.strerror}; run `vfm-sdm measure` again"
            ) from error
        if found is not None and record.get("session_file") not in (None, found):
            raise ResultsError(
                f"{self.path}: expected results of one session, got another {SESSION} beside {product} and "
                "summary.json; run `vfm-sdm measure` again"
            )
        if record.get("finished") is False:
            return ("the session in this folder is not measured to its end; `vfm-sdm measure` finishes it",)
        return ()

    def _prepare(self, identity: Mapping[str, Any]) -> None:
        for folder in (self.path, self.path / _FIGURES):
            remove_orphans(folder)
        record = self.record
        if not all(record.get(name) == identity[name] for name in _IDENTITY):
            for path in self._results():
                path.unlink(missing_ok=True)
            self.add({"finished": False, **identity})

    def _results(self) -> list[Path]:
        return [path for pattern in _RESULTS for path in sorted(self.path.glob(pattern)) if path.is_file()]
