"""Commands are imported when they are asked for, and help tells all of them."""

import subprocess
import sys

import pytest

from vfm_sdm.commands.app import app

COMMANDS = sorted(app.resolved_commands())


def loaded_after(code):
    """Names of this package's and heavy modules that a fresh process has loaded after some code."""
    code += "\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {*done.stdout.split("\n")[-2].split()}


@pytest.mark.parametrize("name", [name for name in COMMANDS if not name.startswith("-")])
def test_help_of_the_program_says_what_every_command_does(command, name):
    _, out, _ = command("--help")
    (line,) = (line for line in out.splitlines() if line.startswith(f"│ {name} "))
    assert len(line.removeprefix(f"│ {name}").strip(" │").split()) > 1  # also on a narrow terminal


def test_what_needs_no_measurement_loads_none():
    loaded = loaded_after("""
from vfm_sdm.commands.app import main
try:
    main(["page", "--help"])
except SystemExit:
    pass
""")
    assert "vfm_sdm.commands.page" in loaded
    assert not {"numpy", "xarray", "vfm_sdm.measurement"} & loaded


def test_the_page_is_there_before_what_measures():
    pytest.importorskip("nicegui")
    loaded = loaded_after("import vfm_sdm.page.state, vfm_sdm.page.server, vfm_sdm.page.steps.films")
    assert not {"vfm_sdm.measurement", "matplotlib", "scipy.stats", "numba"} & loaded
