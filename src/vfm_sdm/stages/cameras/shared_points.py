"""Scene points that three views or more see: chained from the matches of pairs, weighed by what they say together.

The epipolar lines of pairs do not tell how far a third camera stands when it is in a row with the other two: moved
along the row, it keeps all of them. Only rays of three views through one point do.
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
        Shape (views, N, 2) [px].
    """

    views: tuple[int, ...]
    pixels: FloatArray

    @property
    def constraints(self) -> int:
        """How many independent equations the rays of one point give on the cameras."""
        return 2 * len(self.views) - 3

    def thinned(self, chosen: IntArray) -> "SharedPoints":
        """The points of these indices."""
        return SharedPoints(self.views, self.pixels[:, chosen])

    def errors(self, rig: Rig) -> FloatArray:
        """Reprojected less seen pixels of the triangulated points, shape (N, 2 views) [px].

        Their squares sum up to a chi-square of `constraints` degrees of freedom where every pixel coordinate has
        independent noise of one pixel. NaN where a point has no place in front of all views.
        """
        part = Rig(tuple(rig.names[v] for v in self.views), tuple(rig.cameras[v] for v in self.views))
        points3d = triangulate(self.pixels, part)
        apart = np.stack([camera.project(points3d) for camera in part.cameras]) - self.pixels
        return np.asarray(apart.transpose(1, 0, 2).reshape(len(points3d), -1))


def chain_matches(matches: Sequence[Matches]) -> tuple[list[Matches], list[SharedPoints]]:
    """Matches that hang together through a pixel of a common view, as points of several views.

    Parameters
    ----------
    matches
        Matches of pairs of views; a feature that is matched in several pairs has the same pixel, to the last digit.

    Returns
    -------
    pairs
        The matches of features that two views see, one for each of ``matches``.
    shared
        The others, by the views that see them. Chains with two pixels in one view are wrong somewhere and stay pairs.
    """
    if len(matches) < 2:
        return list(matches), []
    offsets = np.cumsum([0, *(2 * len(m.points_first) for m in matches)])
    features = [_features(m) for m in matches]
    number = np.unique(np.concatenate(features), axis=0, return_inverse=True)[1].ravel()
    chains = _Chains(int(number.max(initial=-1)) + 1)
    ends = []
    for m, start in zip(matches, offsets[:-1], strict=True):
        count = len(m.points_first)
        first, second = number[start : start + count], number[start + count : start + 2 * count]
        ends.append(first)
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            chains.join(a, b)
    whole = _whole_chains(np.concatenate(features), number, chains)
    shared: dict[tuple[int, ...], list[FloatArray]] = {}
    for by_view in whole.values():
        views = tuple(sorted(by_view))
        shared.setdefault(views, []).append(np.stack([by_view[view] for view in views]))
    pairs = []
    for m, first in zip(matches, ends, strict=True):
        alone: BoolArray = np.array([chains.root(a) not in whole for a in first.tolist()], dtype=np.bool_)
        pairs.append(Matches(m.first, m.second, m.points_first[alone], m.points_second[alone]))
    return pairs, [SharedPoints(views, np.stack(points, axis=1)) for views, points in sorted(shared.items())]


class _Chains:
    """Sets of numbered features that are joined two by two."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def root(self, feature: int) -> int:
        """What tells the set of a feature from others."""
        while self._parent[feature] != feature:
            self._parent[feature] = self._parent[self._parent[feature]]
            feature = self._parent[feature]
        return feature

    def join(self, a: int, b: int) -> None:
        """Makes the sets of two features one."""
        self._parent[self.root(a)] = self.root(b)


def _features(matches: Matches) -> FloatArray:
    """View and pixel of both ends, first ends first, shape (2 N, 3)."""
    sides = ((matches.first, matches.points_first), (matches.second, matches.points_second))
    return np.concatenate([np.column_stack([np.full(len(points), view), points]) for view, points in sides])


def _whole_chains(features: FloatArray, number: IntArray, chains: _Chains) -> dict[int, dict[int, FloatArray]]:
    """By root, the pixel in each view of chains through three views or more that have one pixel in each."""
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
