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
        Row and column of every token, shape (..., 2) [patches].
    channels
        Channels of a head. The first half turns with the row by ``channels / 4`` angles [rad], the second with the
        column.

    Returns
    -------
    table
        Cosines and sines, shape (..., 2, channels / 4) [1].

    References
    ----------
    .. [1] Su, J., Lu, Y., Pan, S., Murtadha, A., Wen, B., Liu, Y. (2021). RoFormer: enhanced transformer with rotary
       position embedding. arXiv:2104.09864.
    .. [2] Heo, B., Park, S., Han, D., Yun, S. (2024). Rotary position embedding for vision transformer. European
       Conference on Computer Vision.

    Examples
    --------
    >>> table = turns(torch.tensor([[0, 0], [1, 2]]), 8)
    >>> tuple(table.cosines.shape), table.cosines[0].tolist()
    ((2, 2, 2), [[1.0, 1.0], [1.0, 1.0]])
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
    """Table of a frame's tokens: the special ones at (0, 0), then the patches row by row from (1, 1).

    Parameters
    ----------
    rows, columns
        Patches of a frame along its sides.
    special
        Number of tokens that belong to no patch.
    channels
        Channels of a head.
    device, dtype
        Where the table lies, and its type.

    Returns
    -------
    table
        Cosines and sines, shape (special + rows x columns, 2, channels / 4) [1].
    """
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
        Shape (batch, heads, frames x tokens, channels) [1], frame after frame.
    table
        Table of the tokens of one frame; it is the same for all frames.

    Notes
    -----
    Within each half of the channels, channel j is turned against channel ``j + channels / 4``.

    Examples
    --------
    >>> table = turns(torch.tensor([[0, 0]]), 4)
    >>> rotate(torch.ones(1, 1, 1, 4), table).flatten().tolist()
    [1.0, 1.0, 1.0, 1.0]
    """
    tokens, _, count = table.cosines.shape[-3:]
    first, second = x.unflatten(-1, (2, 2, count)).unflatten(2, (-1, tokens)).unbind(-2)
    cosines, sines = table
    turned = torch.stack([first * cosines - second * sines, second * cosines + first * sines], dim=-2)
    return turned.flatten(2, 3).flatten(-3)
