"""Prints the lowest versions that ``pyproject.toml`` allows, a line each, as constraints for pip.

    python tools/lowest_versions.py test > lowest.txt
    pip install -e . -c lowest.txt

Extras are named on the command line; those that an extra names in turn are left out, so that ``test`` alone gives the
tools of the tests without the networks' packages.
"""

import argparse
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
_FLOOR = re.compile(r"(?P<name>[A-Za-z0-9._-]+)>=(?P<version>[0-9][0-9A-Za-z.]*)$")


def lowest_versions(project: Mapping[str, Any], extras: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Name and lowest version of each requirement, in the file's order.

    Parameters
    ----------
    project
        Content of ``pyproject.toml``.
    extras
        Which optional dependencies are wanted beside the others.

    Raises
    ------
    ValueError
        An extra is unknown, or a requirement has no lowest version.
    """
    optional = project["project"]["optional-dependencies"]
    if unknown := sorted(set(extras) - set(optional)):
        raise ValueError(f"expected extras among {', '.join(optional)}, got {', '.join(unknown)}")
    own_extras = f"{project['project']['name']}["
    for requirement in [*project["project"]["dependencies"], *(line for extra in extras for line in optional[extra])]:
        if requirement.startswith(own_extras):
            continue
        found = _FLOOR.match(requirement)
        if found is None:
            raise ValueError(f"pyproject.toml: expected NAME>=VERSION, got {requirement!r}; give it a lowest version")
        yield found["name"], found["version"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the constraints; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("extras", nargs="*")
    options = parser.parse_args(arguments)
    with PROJECT.open("rb") as file:
        project = tomllib.load(file)
    try:
        # A name in two extras is one constraint.
        lowest = dict(lowest_versions(project, options.extras))
    except ValueError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.writelines(f"{name}=={version}\n" for name, version in lowest.items())
    return 0


if __name__ == "__main__":
    sys.exit(main())
