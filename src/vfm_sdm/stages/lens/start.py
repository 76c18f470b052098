"""A first focal length, and the camera's attitudes with it."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.stages.lens.key_frames import KeyFrames
from vfm_sdm.stages.lens.sightings import Pair

__all__ = ["chain_turns", "search_focal"]

_FIELDS_DEG = (4.0, 130.0)
_TRIALS = 60
_ROUNDS = 3
_SAMPLE = 150
_TRUNCATED = 0.003
"""Error over the longer side beyond which a match tells nothing of the focal length."""


def search_focal(keys: KeyFrames, pairs: list[Pair], image_size: tuple[int, int]) -> float:
    """Focal length with which rotations explain the pairs best [px].

    Parameters
    ----------
    keys, pairs
        Key frames and their matches.
    image_size
        Width and height [px].

    Notes
    -----
    Every focal length of a grid gives rays, every pair its best rotation between them; what counts is the median error.
    There is no focal length at which this fails, while closed forms from homographies may have no real solution.
    """
    longer = max(image_size)
    fields = np.radians(np.geomspace(*_FIELDS_DEG, _TRIALS))
    focals = longer / 2 / np.tan(fields / 2)
    centre = (np.array(image_size) - 1) / 2
    rng = np.random.default_rng(0)
    chosen = []
    for pair in pairs:
        rows = pair.rows if len(pair.rows) <= _SAMPLE else rng.permutation(pair.rows)[:_SAMPLE]
        chosen.append((keys.features[pair.first].points[rows[:, 0]], keys.features[pair.second].points[rows[:, 1]]))
    cost = [
        sum(np.minimum(_errors(a, b, centre, focal)[1], _TRUNCATED * longer).sum() for a, b in chosen)
        for focal in focals
    ]
    return float(focals[int(np.argmin(cost))])


def chain_turns(
    keys: KeyFrames, pairs: list[Pair], image_size: tuple[int, int], focal_px: float
) -> tuple[IntArray, FloatArray]:
    """Attitudes of the key frames that pairs connect.

    Parameters
    ----------
    keys, pairs
        Key frames and their matches.
    image_size
        Width and height [px].
    focal_px
        Focal length [px].

    Returns
    -------
    connected
        Numbers of the key frames of the largest connected part, shape (K,).
    attitudes
        Of all key frames, shape (F, 3, 3); the identity where a frame is not connected.
    """
    count = len(keys.features)
    centre = (np.array(image_size) - 1) / 2
    weight = coo_array(
        ([1.0 / len(pair.rows) for pair in pairs], ([p.first for p in pairs], [p.second for p in pairs])),
        shape=(count, count),
    )
    tree = minimum_spanning_tree(weight.tocsr())
    turns = {}
    for pair in pairs:
        a, b = keys.features[pair.first].points[pair.rows[:, 0]], keys.features[pair.second].points[pair.rows[:, 1]]
        turns[pair.first, pair.second] = _errors(a, b, centre, focal_px)[0]
    attitudes = np.tile(np.eye(3), (count, 1, 1))
    best: IntArray = np.zeros(0, np.intp)
    best_parents = best
    for root in range(count):
        if root in best:
            continue
        order, parents = breadth_first_order(tree, root, directed=False)
        if len(order) > len(best):
            best = order
            best_parents = parents
    for node in best[1:]:
        parent = int(best_parents[node])
        turn = turns[parent, node] if (parent, node) in turns else turns[node, parent].T
        attitudes[node] = turn @ attitudes[parent]
    return np.sort(best), attitudes


def _errors(first: FloatArray, second: FloatArray, centre: FloatArray, focal: float) -> tuple[FloatArray, FloatArray]:
    """Rotation of the second camera against the first (3, 3), and errors of the pairs (N,) [px], robustly."""
    rays = [np.column_stack([(points - centre) / focal, np.ones(len(points))]) for points in (first, second)]
    units = [one / np.linalg.norm(one, axis=1, keepdims=True) for one in rays]
    weights = np.ones(len(first))
    for _ in range(_ROUNDS):
        turn = Rotation.align_vectors(units[1], units[0], weights=weights)[0].as_matrix()
        error = focal * np.linalg.norm(units[1] - units[0] @ turn.T, axis=1)
        weights = 1 / np.maximum(error, max(float(np.median(error)), 1e-9))
    return turn, error
