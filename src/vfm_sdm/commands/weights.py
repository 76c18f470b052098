"""The commands ``weights list`` and ``weights fetch``: checkpoints of the networks."""

import sys
from typing import Annotated

import cyclopts
from cyclopts import Parameter
from rich.prompt import Confirm
from rich.table import Table
from rich.text import Text

from vfm_sdm.commands.progress import show_progress
from vfm_sdm.commands.terminal import ERR, OUT, plain_table, say
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import fetch_weights, is_licence_accepted, local_weights, weights_folder

__all__ = ["weights", "weights_table"]

weights = cyclopts.App(name="weights", help="Checkpoints of the vision foundation models: list and fetch them.")


@weights.command(name="list")
def list_weights() -> None:
    """Every checkpoint: its network, size and licence, and where it lies or how to fetch it."""
    say(f"weights in {weights_folder()}")
    OUT.print(weights_table())


@weights.command
def fetch(
    name: Annotated[str, Parameter(help="As `vfm-sdm weights list` names it.")],
    *,
    accept_licence: Annotated[
        bool, Parameter(negative="", help="Acknowledge the licence of these weights; remembered.")
    ] = False,
) -> None:
    """Download a checkpoint after its licence was acknowledged; a download cut short leaves nothing behind."""
    accepted = accept_licence or _acknowledged(name)
    with show_progress() as progress:
        path = fetch_weights(
            name,
            accept_licence=accepted,
            progress=lambda what, done, total: progress(
                f"{what}, MB", done // 10**6, None if total is None else total // 10**6
            ),
        )
    say(f"here: {path}")


def _acknowledged(name: str) -> bool:
    """Asks for the licence where a person can answer and has not yet done so."""
    by_hand = name in CHECKPOINTS and CHECKPOINTS[name].by_hand
    if by_hand or is_licence_accepted(name) or local_weights(name).is_file() or not sys.stdin.isatty():
        return False
    one = CHECKPOINTS[name]
    for line in (f"{name}: {one.size} from {one.page}", f"licence: {one.licence}, {one.licence_url}", one.remarks):
        ERR.print(line, highlight=False)
    return Confirm.ask("Have you read this licence, and do you accept it?", console=ERR, default=False)


def weights_table() -> Table:
    """Network, size and licence of every checkpoint, and whether its file is here or how it can be had."""
    table = plain_table()
    for name in ("name", "network", "size", "licence", "here"):
        table.add_column(Text(name), justify="right" if name == "size" else "left")
    for name, one in CHECKPOINTS.items():
        absent = "no" + " (gated)" * one.gated + " (by hand)" * one.by_hand
        here = "yes" if local_weights(name).is_file() else absent
        table.add_row(name, one.network, one.size, one.licence, here)
    table.caption = Text("fetch: vfm-sdm weights fetch NAME, which says how to get those that it cannot")
    table.caption_justify = "left"
    return table
