"""The measurement in a process of its own, which goes on when the page is closed and is stopped without loss."""

import json
import os
import signal
import subprocess
import sys
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import IO

from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure

__all__ = ["MeasureProcess", "Step"]

_MOST_LINES = 500
_EVERY = 10
"""Frames between two reports of one step."""


@dataclass(frozen=True)
class Step:
    """What is being done.

    Parameters
    ----------
    what
        In words.
    done, total
        How much of it; ``None`` where nobody knows.
    """

    what: str = ""
    done: int = 0
    total: int | None = None


class MeasureProcess:
    """Measures a session's file in another process.

    Parameters
    ----------
    session
        The file.
    run
        Run folder.
    """

    def __init__(self, session: Path, run: Path) -> None:
        self.lines: deque[str] = deque(maxlen=_MOST_LINES)
        self.step = Step("begins")
        arguments = [sys.executable, "-m", "vfm_sdm.page.process", str(session), str(run)]
        self._process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", errors="replace",
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        self._reader = Thread(target=self._read, args=(self._process.stdout,), daemon=True)
        self._reader.start()

    @property
    def status(self) -> int | None:
        """Exit status; ``None`` while it works."""
        return self._process.poll()

    def stop(self) -> None:
        """Ends it as Ctrl-C would: what is tracked so far is kept."""
        if self.status is None:
            self._process.send_signal(signal.SIGINT if os.name != "nt" else signal.SIGTERM)

    def wait(self, timeout_s: float | None = None) -> int:
        """Its exit status, once it has ended and all it said was read.

        Parameters
        ----------
        timeout_s
            How long to wait at most [s].
        """
        status = self._process.wait(timeout_s)
        self._reader.join(timeout_s)
        return status

    def _read(self, stream: IO[str] | None) -> None:
        for line in stream or ():
            try:
                found = json.loads(line)
                step = Step(str(found["what"]), int(found["done"]), found["total"])
            except (ValueError, KeyError, TypeError):
                self.lines.append(line.rstrip())
                continue
            if step.what != self.step.what:
                self.lines.append(step.what)
            self.step = step


def _report() -> Progress:
    """Progress as lines of JSON, of each step not more than every so many frames."""
    last = [""]

    def say(what: str, done: int, total: int | None) -> None:
        if what != last[0] or done % _EVERY == 0 or done == total:
            last[0] = what
            sys.stdout.write(json.dumps({"what": what, "done": done, "total": total}) + "\n")

    return say


def _main(session: str, run: str) -> int:
    """Measures, and says how it went; the exit statuses are those of the command line."""
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a page begun in the background hands on that it is ignored
    try:
        found = measure(read_session(session), run, progress=_report())
    except VfmSdmError as error:
        sys.stdout.write(f"{error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stdout.write("stopped; what is done is kept, and the next run goes on\n")
        return 130
    for note in found.summary["notes"]:
        sys.stdout.write(f"{note}\n")
    sys.stdout.write(f"cameras: {found.cameras.status}\n")
    if found.audit is not None:
        sys.stdout.write(f"verdict: {found.audit.verdict}\n")
    return 0 if found.displacement is not None else 3


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
