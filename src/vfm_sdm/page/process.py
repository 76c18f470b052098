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

__all__ = ["MeasureProcess", "Step"]

_MOST_LINES = 500


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
        arguments = [sys.executable, "-m", "vfm_sdm.page.measuring", str(session), str(run)]
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
