"""Scene points that three views or more see, chained from the matches of pairs, and their reprojection errors.

The epipolar lines of pairs do not determine the distance of a third camera in a row with the other two: a move along
the row leaves all of them as they are. The rays of three views through one point determine it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["SharedPoints", "chain_matches"]


@dataclass(frozen=True, eq=False)
class SharedPoints:
    """Pixels of scene points in the same three views or more.

    Parameters
    ----------
    views
        Indices of the views in the rig.
    pixels
        Pixels of the N points in these views, shape (views, N, 2) [px].
    """

    views: tuple[int, ...]
    pixels: FloatArray

    @property
    def constraints(self) -> int:
        """Number of independent equations on the cameras that the rays of one point give."""
        return 2 * len(self.views) - 3

    def thinned(self, chosen: IntArray) -> "SharedPoints":
        """Points of these indices.

        Parameters
        ----------
        chosen
            Indices of the points, shape (M,).

        Returns
        -------
        points
            M points in the same views.

        Examples
        --------
        >>> points = SharedPoints((0, 1, 2), np.zeros((3, 5, 2)))
        >>> points.constraints, points.thinned(np.array([0, 4])).pixels.shape
        (3, (3, 2, 2))
        """
        return SharedPoints(self.views, self.pixels[:, chosen])

    def errors(self, rig: Rig) -> FloatArray:
        """Reprojected minus seen pixels of the triangulated points.

        Parameters
        ----------
        rig
            Cameras of all views.

        Returns
        -------
        errors
            Errors in all views, shape (N, 2 views) [px]; NaN where a point has no position in front of all views.

        Notes
        -----
        Where every pixel coordinate has independent noise of one pixel, the sum of a point's squared errors has a
        chi-square distribution with `constraints` degrees of freedom.
        """
        part = Rig(tuple(rig.names[v] for v in self.views), tuple(rig.cameras[v] for v in self.views))
        points3d = triangulate(self.pixels, part)
        apart = np.stack([camera.project(points3d) for camera in part.cameras]) - self.pixels
        return np.asarray(apart.transpose(1, 0, 2).reshape(len(points3d), -1))


def chain_matches(matches: Sequence[Matches]) -> tuple[list[Matches], list[SharedPoints]]:
    """Matches that are connected through a pixel of a common view, as points of several views.

    Parameters
    ----------
    matches
        Matches of pairs of views; a feature that is matched in several pairs has exactly the same pixel [px] in them.

    Returns
    -------
    pairs
        Matches of features that two views see, one item for each of ``matches``.
    shared
        Points that three views or more see, grouped by these views. Chains with two pixels in one view contain a wrong
        match; their matches stay pairs.

    Examples
    --------
    >>> a, b, c = (np.array([[u, 5.0], [u, 9.0]]) for u in (1.0, 2.0, 3.0))
    >>> pairs, shared = chain_matches([Matches(0, 1, a, b), Matches(1, 2, b[:1], c[:1])])
    >>> [len(pair.points_first) for pair in pairs]
    [1, 0]
    >>> [(points.views, points.pixels[:, 0].tolist()) for points in shared]
    [((0, 1, 2), [[1.0, 5.0], [2.0, 5.0], [3.0, 5.0]])]
    """
    if len(matches) < 2:
        return list(matches), []
    offsets = np.cumsum([0, *(2 * len(m.points_first) for m in matches)])
    features = [_list_features(m) for m in matches]
    number = np.unique(np.concatenate(features), axis=0, return_inverse=True)[1].ravel()
    chains = _Chains(int(number.max(initial=-1)) + 1)
    ends = []
    for m, start in zip(matches, offsets[:-1], strict=True):
        count = len(m.points_first)
        first, second = number[start : start + count], number[start + count : start + 2 * count]
        ends.append(first)
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            chains.join(a, b)
    whole = _find_whole_chains(np.concatenate(features), number, chains)
    shared: dict[tuple[int, ...], list[FloatArray]] = {}
    for by_view in whole.values():
        views = tuple(sorted(by_view))
        shared.setdefault(views, []).append(np.stack([by_view[view] for view in views]))
    pairs = []
    for m, first in zip(matches, ends, strict=True):
        alone: BoolArray = np.array([chains.root(a) not in whole for a in first.tolist()], dtype=np.bool_)
        pairs.append(m.chosen(alone))
    return pairs, [SharedPoints(views, np.stack(points, axis=1)) for views, points in sorted(shared.items())]


class _Chains:
    """Disjoint sets of numbered features."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def root(self, feature: int) -> int:
        """Feature that represents the set of this feature."""
        while self._parent[feature] != feature:
            self._parent[feature] = self._parent[self._parent[feature]]
            feature = self._parent[feature]
        return feature

    def join(self, a: int, b: int) -> None:
        """Unite the sets of two features."""
        self._parent[self.root(a)] = self.root(b)


def _list_features(matches: Matches) -> FloatArray:
    """View and pixel of both ends, first ends first, shape (2 N, 3)."""
    sides = ((matches.first, matches.points_first), (matches.second, matches.points_second))
    return np.concatenate([np.column_stack([np.full(len(points), view), points]) for view, points in sides])


def _find_whole_chains(features: FloatArray, number: IntArray, chains: _Chains) -> dict[int, dict[int, FloatArray]]:
    """Pixel in each view, by root, of chains through three views or more that have one pixel in each."""
    chosen = np.unique(number, return_index=True)[1]
    found: dict[int, list[FloatArray]] = {}
    for feature, row in enumerate(chosen.tolist()):
        found.setdefault(chains.root(feature), []).append(features[row])
    whole = {}
    for root, members in found.items():
        by_view = {int(member[0]): member[1:] for member in members}
        if len(by_view) == len(members) >= 3:
            whole[root] = by_view
    return whole
