"""The command ``vfm-sdm``: each command parses, calls one library function, and prints a short summary.

A command is imported when it is asked for: most of the time of a short one would be spent on what others need.
"""

import sys
from collections.abc import Sequence
from contextlib import nullcontext

import cyclopts
from cyclopts import Parameter

from vfm_sdm import __version__
from vfm_sdm.commands.terminal import ERR, Ending, as_json, show_all_letters
from vfm_sdm.errors import VfmSdmError

__all__ = ["app", "main"]

_COMMANDS = {
    "demo": "demo:demo",
    "measure": "measuring:measure_command",
    "cameras": "measuring:cameras",
    "track": "measuring:track",
    "displacement": "measuring:displacement",
    "reference": "evaluation:reference",
    "evaluate": "evaluation:evaluate",
    "benchmark": "benchmark:benchmark_command",
    "weights": "weights:weights",
    "info": "environment:info",
    "batch": "batch:batch_command",
    "page": "page:page_command",
    "accept": "acceptance:accept",
    "verify": "acceptance:verify",
    "report": "report:report",
    "frames": "frames:frames",
    "lens": "lens:lens",
    "plan": "planning:plan",
    "load-test": "load_test:load_test",
    "passages": "passages:passages",
    "fuse": "fuse:fuse_command",
    "field": "field:field_command",
    "modes": "modes:modes",
    "points": "points:points",
    "repeat": "repeat:repeat",
    "watch": "watch:watch",
}
"""Where each command is, in this package."""
_OWN_JSON = {"batch", "page", "watch"}
"""Commands that have a form of their own, or none."""

app = cyclopts.App(
    name="vfm-sdm",
    help="Structural displacement in millimetres from two ordinary cameras and one measured length.\n\n"
    "Every command takes --json: its tables are one JSON object then. Exit status: 0 done, 1 the input cannot be used "
    "or a test was not passed, 2 the command line cannot be understood, 3 the data did not allow a result, 4 the audit "
    "says not to use the result, 130 interrupted.",
    version=__version__,
    # Nobody needs a word for an empty list.
    default_parameter=Parameter(negative_iterable=()),
    # Else its message would be swallowed.
    suppress_keyboard_interrupt=False,
)
for _name, _place in _COMMANDS.items():
    app.command(f"{__package__}.{_place}", name=_name)


def main(words: Sequence[str] | None = None) -> None:
    """Entry point: runs a command; an expected error ends with status 1 and its message alone, Ctrl-C with 130.

    Parameters
    ----------
    words
        The command line without the program's name; that of the process when ``None``.
    """
    show_all_letters()
    typed = list(sys.argv[1:] if words is None else words)
    if not {*typed} & {*_COMMANDS}:
        app.resolved_commands()  # help says what each one does
    # What is no option is the command first; a run folder may be called as one.
    asked = "--json" in typed and next((word for word in typed if word != "--json"), "") not in _OWN_JSON
    try:
        with as_json() if asked else nullcontext():
            app([word for word in typed if word != "--json"] if asked else typed)
    except VfmSdmError as error:
        ERR.print(f"vfm-sdm: {error}", style="red", highlight=False, soft_wrap=True)
        sys.exit(Ending.ERROR)
    except KeyboardInterrupt:
        ERR.print("vfm-sdm: interrupted; finished stages are kept and the next run reuses them")
        sys.exit(Ending.INTERRUPTED)
