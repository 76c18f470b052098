"""Rotary position embedding in two dimensions (Su et al., 2021; Heo et al., 2024)."""

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["RotaryTable", "rotary_table", "rotate", "turns"]

_BASE = 100.0


class RotaryTable(NamedTuple):
    """Cosines and sines of one frame's tokens, shape (tokens, 2, channels / 4): for rows, then for columns."""

    cosines: Tensor
    sines: Tensor


def turns(positions: Tensor, channels: int) -> RotaryTable:
    """Table for tokens at given places.

    Parameters
    ----------
    positions
        Row and column of every token, shape (..., 2).
    channels
        Of a head. The first half turns with the row, the second with the column, by ``channels / 4`` frequencies each.
    """
    # In single precision whatever the network's, as the published network does.
    count = channels // 4
    frequencies = _BASE ** (-torch.arange(count, device=positions.device, dtype=torch.float32) / count)
    angles = positions.float().unsqueeze(-1) * frequencies
    return RotaryTable(angles.cos(), angles.sin())


@lru_cache(maxsize=8)
def rotary_table(
    rows: int, columns: int, *, special: int, channels: int, device: torch.device, dtype: torch.dtype
) -> RotaryTable:
    """Table of a frame's tokens: ``special`` ones at (0, 0), then the patches row by row from (1, 1)."""
    with torch.inference_mode(False):  # the table outlives the mode of the first one who asks for it
        grid = torch.cartesian_prod(torch.arange(rows, device=device), torch.arange(columns, device=device)) + 1
        places = torch.cat([torch.zeros(special, 2, device=device, dtype=grid.dtype), grid.reshape(-1, 2)])
        table = turns(places, channels)
        return RotaryTable(table.cosines.to(dtype), table.sines.to(dtype))


def rotate(x: Tensor, table: RotaryTable) -> Tensor:
    """Heads' channels turned by their tokens' places.

    Parameters
    ----------
    x
        Shape (batch, heads, frames x tokens, channels), frame after frame.
    table
        Of the tokens of one frame; the same for all.

    Notes
    -----
    Within each half of the channels, channel j is turned against channel ``j + channels / 4``.
    """
    tokens, _, count = table.cosines.shape[-3:]
    first, second = x.unflatten(-1, (2, 2, count)).unflatten(2, (-1, tokens)).unbind(-2)
    cosines, sines = table
    turned = torch.stack([first * cosines - second * sines, second * cosines + first * sines], dim=-2)
    return turned.flatten(2, 3).flatten(-3)
