"""Interpolation in feature grids: at query points, and in the windows that the refinement correlates.

Grids are (T, C, h, w). Coordinates are in cells with the centre of the top-left cell at (0.5, 0.5), so that another
grid of the same image needs only a multiplication by the ratio of the sizes.
"""

import itertools

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

__all__ = ["correlate_windows", "sample_trilinear"]


def sample_trilinear(grid: Tensor, points: Tensor) -> Tensor:
    """Features of a grid at points between its frames and cells.

    Parameters
    ----------
    grid
        Features of T frames, shape (T, C, h, w) [1].
    points
        Frame index, row and column, shape (N, 3) [frames, cells, cells].

    Returns
    -------
    features
        Shape (N, C) [1], interpolated linearly between frames and cells; beyond the outermost cell centres the border's
        value holds.

    Examples
    --------
    >>> grid = torch.arange(4.0).reshape(1, 1, 2, 2)
    >>> sample_trilinear(grid, torch.tensor([[0.0, 1.0, 1.0]])).tolist()
    [[1.5]]
    """
    frames, _, height, width = grid.shape
    last = points.new_tensor([frames - 1, height - 1, width - 1])
    position = torch.minimum((points - points.new_tensor([0.0, 0.5, 0.5])).clamp_min(0.0), last)
    lower = position.floor()
    features = grid.new_zeros(len(points), grid.shape[1])
    for corner in itertools.product((0.0, 1.0), repeat=3):
        offset = points.new_tensor(corner)
        weight = (1.0 - (position - lower - offset).abs()).prod(dim=-1, keepdim=True)
        t, y, x = torch.minimum(lower + offset, last).long().unbind(-1)
        features += weight * grid[t, :, y, x]
    return features


def correlate_windows(
    grid: Tensor, positions: Tensor, queries: Tensor, *, radius: int, square_sampling: bool
) -> Tensor:
    """Dot products of query features with the grid's cells around a position of every frame.

    Parameters
    ----------
    grid
        Features of T frames, shape (T, C, h, w) [1].
    positions
        Window centres as x, y, shape (N, T, 2) [cells].
    queries
        Features to compare with, shape (N, T, C) [1].
    radius
        Cells on either side of the centre.
    square_sampling
        Divide x by the grid's height as well (see ``TapirConfig``).

    Returns
    -------
    products
        Shape (N, T, (2 radius + 1)^2) [1], y the slow and x the fast index; cells outside the grid are zero.

    Notes
    -----
    Only the windows are interpolated: memory is N T C (2 radius + 1)^2 numbers, independent of the grid's size.

    Examples
    --------
    >>> grid = torch.eye(3)[None, None]
    >>> centre, query = torch.full((1, 1, 2), 1.5), torch.ones(1, 1, 1)
    >>> products = correlate_windows(grid, centre, query, radius=1, square_sampling=False)
    >>> products.reshape(3, 3).round().tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    height, width = grid.shape[2:]
    steps = torch.arange(-radius, radius + 1, dtype=positions.dtype, device=positions.device)
    offsets = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1).reshape(-1, 2)
    extent = positions.new_tensor([height if square_sampling else width, height])
    cells = 2.0 * (positions.transpose(0, 1)[:, :, None] + offsets) / extent - 1.0
    window = F.grid_sample(grid, cells, padding_mode="zeros", align_corners=False)
    return torch.einsum("tcnk,ntc->ntk", window, queries)
