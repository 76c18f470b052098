"""Likeness of tracks' features with the feature maps around them, at several scales.

Only the windows are sampled: of a map of h x w cells, (2 r + 2)^2 cells a track and frame are read, and no volume of
all products is made.
"""

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

__all__ = ["clamp_to", "correlate", "make_pyramid", "sample_linear"]


def make_pyramid(features: Tensor, levels: int) -> list[Tensor]:
    """Feature maps, and the same averaged over ever more cells.

    Parameters
    ----------
    features
        Maps of S frames, shape (S, h, w, C) [1].
    levels
        Number of maps a frame; each averages 2 x 2 cells of the one before.

    Returns
    -------
    pyramid
        Shape (S, h / 2^level, w / 2^level, C) each.

    Examples
    --------
    >>> [tuple(features.shape) for features in make_pyramid(torch.zeros(1, 8, 12, 3), 3)]
    [(1, 8, 12, 3), (1, 4, 6, 3), (1, 2, 3, 3)]
    """
    pyramid = [features]
    for _ in range(levels - 1):
        coarser = F.avg_pool2d(pyramid[-1].permute(0, 3, 1, 2), 2)
        pyramid.append(coarser.permute(0, 2, 3, 1).contiguous())
    return pyramid


def correlate(pyramid: list[Tensor], tracks: Tensor, positions: Tensor, *, radius: int) -> Tensor:
    """Products of tracks' features with windows of the maps around their positions.

    Parameters
    ----------
    pyramid
        Maps of S frames (`make_pyramid`), shape (S, h, w, C) each [1].
    tracks
        Features of T tracks, shape (T, S, C) [1].
    positions
        Column and row on the finest map, shape (T, S, 2) [cells].
    radius
        Windows reach so many cells to each side.

    Returns
    -------
    correlation
        Shape (T, S, levels x (2 radius + 1)^2) [1], divided by the root of C; the column varies slowest. Zero outside.

    Notes
    -----
    A product with an interpolated feature is the interpolation of products, and all cells of a window share one
    fraction, so that (2 radius + 2)^2 products make the window.

    Examples
    --------
    >>> pyramid = make_pyramid(torch.ones(1, 8, 8, 4), 2)
    >>> found = correlate(pyramid, torch.ones(1, 1, 4), torch.full((1, 1, 2), 3.5), radius=1)
    >>> tuple(found.shape), found[0, 0, 4].item()
    ((1, 1, 18), 2.0)
    """
    scaled = tracks / tracks.shape[-1] ** 0.5
    frames = torch.arange(positions.shape[1], device=positions.device)[:, None, None]
    reach = torch.arange(-radius, radius + 2, device=positions.device)
    found = []
    for level, features in enumerate(pyramid):
        rows, columns = features.shape[1:3]
        place = positions / 2**level
        corner = place.nan_to_num().floor()
        u, v = (place - corner)[..., None, None, :].unbind(-1)
        # A side of one cell is that cell everywhere: coordinates have no scale on it.
        column = (corner[..., 0, None, None].long() + reach[:, None]) * (columns > 1)
        row = (corner[..., 1, None, None].long() + reach) * (rows > 1)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cells = features[frames, row.clamp(0, rows - 1), column.clamp(0, columns - 1)]
        products = (cells * scaled[:, :, None, None]).sum(-1) * inside
        across = (1 - u) * products[:, :, :-1] + u * products[:, :, 1:]
        window = (1 - v) * across[..., :-1] + v * across[..., 1:]
        found.append(window.flatten(2))
    return torch.cat(found, dim=-1)


def clamp_to(positions: Tensor, rows: int, columns: int) -> Tensor:
    """Columns and rows (..., 2) moved onto a grid of so many cells; NaN stays.

    The limits are plain numbers: to bring a tensor of them to a GPU would wait for all that runs there.
    """
    column, row = positions.unbind(-1)
    return torch.stack([column.clamp(0, columns - 1), row.clamp(0, rows - 1)], dim=-1)


def sample_linear(features: Tensor, positions: Tensor) -> Tensor:
    """Features of one map at places between its cells, bilinear.

    Parameters
    ----------
    features
        Map of one frame, shape (h, w, C) [1].
    positions
        Column and row, shape (T, 2) [cells]; outside the map, its border counts.

    Returns
    -------
    sampled
        Shape (T, C) [1].

    Examples
    --------
    >>> features = torch.arange(4.0).reshape(2, 2, 1)
    >>> sample_linear(features, torch.tensor([[0.5, 0.5]])).item()
    1.5
    """
    place = clamp_to(positions, features.shape[0], features.shape[1])
    # A position that is not a number stays one, but no cell has such an index.
    corner = place.nan_to_num().floor()
    u, v = (place - corner).unsqueeze(-1).unbind(1)
    left, top = corner.long().unbind(1)
    right, bottom = clamp_to(corner + 1, features.shape[0], features.shape[1]).long().unbind(1)
    upper = (1 - u) * features[top, left] + u * features[top, right]
    lower = (1 - u) * features[bottom, left] + u * features[bottom, right]
    return (1 - v) * upper + v * lower
