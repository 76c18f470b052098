"""Points carried from one view to another by a network's tracker (section VFM-based marker-free 2D point-tracking)."""

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.session import Network
from vfm_sdm.inputs.video import Region, RgbArray
from vfm_sdm.networks.interface import SEEN, ChunkNetwork, RgbFrames
from vfm_sdm.stages.matching.network_view import network_view
from vfm_sdm.stages.tracking.vggt import VggtTracker

__all__ = ["VggtMatcher", "locate_points"]


class VggtMatcher:
    """Matcher ``vggt``: the network's tracker takes two views for two frames.

    Parameters
    ----------
    network
        Weights, device and precision.

    Raises
    ------
    BackendUnavailableError
        PyTorch or the weights are not here.
    """

    name = "vggt"

    def __init__(self, *, network: Network | None = None) -> None:
        self._tracker = VggtTracker(network=network)

    @property
    def weights_id(self) -> str:
        """Identity of the network's weights."""
        return self._tracker.weights_id

    def locate(self, first: RgbArray, second: RgbArray, points2d: FloatArray) -> FloatArray:
        """Places of points of one view in another, see `locate_points`.

        Parameters
        ----------
        first, second
            First frames of the two views in colour, shape (height, width, 3).
        points2d
            Points in the first view, shape (P, 2) [px].
        """
        return locate_points(self._tracker.inference, first, second, points2d)


def locate_points(
    network: ChunkNetwork,
    first: RgbArray,
    second: RgbArray,
    points2d: FloatArray,
    *,
    side_px: int = 294,
    multiple: int = 14,
) -> FloatArray:
    """Places of points of one view in another, shape (P, 2) [px]; NaN where they are not seen.

    Parameters
    ----------
    network
        Network that follows the points.
    first, second
        First frames of the two views in colour, shape (height, width, 3).
    points2d
        Points in the first view, shape (P, 2) [px].
    side_px, multiple
        Side of the patches around them, and the length that it is a multiple of [px].

    Raises
    ------
    MemoryError
        Two pictures do not fit the memory.

    Notes
    -----
    Both pictures are two frames of one sequence. The paper crops the region of the second view by hand; here the whole
    frames, reduced, tell where it is, and patches at full resolution then tell the point.
    """
    view, (in_first, in_second) = network_view([first, second])
    rough = in_second.to_full(_follow_pair(network, view, in_first.from_full(points2d)))
    found = np.full(points2d.shape, np.nan)
    height, width = second.shape[:2]
    shortest = np.minimum(first.shape[1::-1], second.shape[1::-1])
    sides = (np.minimum(side_px, shortest) // multiple * multiple).tolist()
    for row in np.flatnonzero(((rough >= 0) & (rough <= [width - 1, height - 1])).all(axis=1)):
        here = Region.around(points2d[row], (sides[0], sides[1]), (first.shape[1], first.shape[0]))
        there = Region.around(rough[row], (sides[0], sides[1]), (width, height))
        pictures = np.stack([here.crop(first), there.crop(second)])
        found[row] = there.to_full(_follow_pair(network, pictures, here.from_full(points2d[row : row + 1])))[0]
    return found


def _follow_pair(network: ChunkNetwork, pictures: RgbFrames, queries: FloatArray) -> FloatArray:
    """Places (N, 2) in the second picture of points of the first; NaN where the network calls them hidden."""
    tracks = network.follow(pictures, queries)
    return np.where(tracks.visibility[1, :, None] >= SEEN, tracks.positions[1], np.nan)
