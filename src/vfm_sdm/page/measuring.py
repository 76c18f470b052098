"""What the page's own process does: measures a session's file, and says on standard output how far it is."""

import json
import signal
import sys

from vfm_sdm.core.progress import Progress
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure

__all__: list[str] = []

_EVERY = 10
"""Frames between two reports of one step."""


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
