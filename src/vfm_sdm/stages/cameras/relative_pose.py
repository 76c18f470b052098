"""Relative pose of two views from their matches alone, and how well matches would agree by chance."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import poselib

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.matching.matches import Matches

__all__ = [
    "Agreement",
    "chance_agreement",
    "count_places",
    "estimate_relative_pose",
    "halve_matches",
    "measure_agreement",
    "number_cells",
]

_CELLS = 16
"""Cells along the longer side of an image; matches of one cell count once."""
_INDEPENDENT = 4
_NEIGHBOURS = 8
_SHUFFLES = 3


def count_places(agree: BoolArray, matches: Matches, cameras: tuple[Camera, Camera]) -> IntArray:
    """Number of places in the images where matches agree: of cells, in the image where they are fewer.

    Parameters
    ----------
    agree
        Which of N matches agree with each of K poses, shape (K, N).
    matches
        The matches [px].
    cameras
        Cameras of the two views, for the sizes of their images.

    Returns
    -------
    places
        Shape (K,).

    Notes
    -----
    Features crowd where a pattern repeats, and many of them may be matched to one. Cells of a sixteenth of the longer
    side of the image count neither twice.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> first, second = [[10.0, 9.0], [300.0, 9.0], [600.0, 9.0]], [[10.0, 9.0], [12.0, 9.0], [600.0, 9.0]]
    >>> matches = Matches(0, 1, first, second)
    >>> count_places(np.ones((1, 3), dtype=bool), matches, (camera, camera)).tolist()
    [2]
    """
    counts = []
    for member in _cell_members(matches, cameras):
        counts.append(((agree.astype(np.float32) @ member) > 0).sum(axis=1))
    return np.asarray(np.minimum(counts[0], counts[1]))


@dataclass(frozen=True)
class Agreement:
    """How far matches agree with a pose.

    Parameters
    ----------
    support
        Sum over the places of the images of the share of each one's matches that agree, in the image where it is less.
    std
        Standard deviation of that where the agreement is chance.
    share
        Support over the number of places [1].
    """

    support: float
    std: float
    share: float


def halve_matches(matches: Matches, cameras: tuple[Camera, Camera], splits: int) -> list[BoolArray]:
    """Random halves of the places in the first image, with all their matches.

    Parameters
    ----------
    matches
        N matches [px].
    cameras
        Cameras of the two views, for the sizes of their images.
    splits
        Number of ways of halving.

    Returns
    -------
    halves
        Which matches are in the one half, shape (N,) each; the others are in the other half.

    Notes
    -----
    Matches of one place repeat each other, so that halves of matches would not be independent.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> pixels = [[10.0, 9.0], [12.0, 9.0], [600.0, 9.0]]
    >>> [half] = halve_matches(Matches(0, 1, pixels, pixels), (camera, camera), 1)
    >>> bool(half[0] == half[1]), bool(half[0] == half[2])
    (True, False)
    """
    member = _cell_members(matches, cameras)[0]
    rng = np.random.default_rng(0)
    cells = member.shape[1]
    return [member[:, rng.permutation(cells)[: cells // 2]].sum(axis=1) > 0 for _ in range(splits)]


def measure_agreement(agree: BoolArray, matches: Matches, cameras: tuple[Camera, Camera]) -> Agreement:
    """How far matches agree with a pose, each place in the images with one vote.

    Parameters
    ----------
    agree
        Which of N matches agree, shape (N,).
    matches
        The matches [px].
    cameras
        Cameras of the two views, for the sizes of their images.

    Notes
    -----
    Up to four matches of a place count as independent: more of them repeat each other.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> pixels = [[10.0, 9.0], [12.0, 9.0], [600.0, 9.0]]
    >>> measure_agreement(np.array([True, False, True]), Matches(0, 1, pixels, pixels), (camera, camera)).support
    1.5
    """
    if not len(matches):
        return Agreement(0.0, 1.0, 0.0)
    found = []
    chance = float(agree.mean())
    for member in _cell_members(matches, cameras):
        count = member.sum(axis=0)
        variance = chance * (1 - chance) * (1 / np.minimum(count, _INDEPENDENT)).sum()
        support = float((agree @ member / count).sum())
        found.append(Agreement(support, float(np.sqrt(max(variance, 1e-3))), support / len(count)))
    return min(found, key=lambda one: one.support)


def _cell_members(matches: Matches, cameras: tuple[Camera, Camera]) -> list[npt.NDArray[np.float32]]:
    """Which match lies in which cell of either image, shape (N, cells in use) each."""
    members = []
    for number in number_cells(matches, cameras):
        member = np.zeros((len(number), int(number.max(initial=-1)) + 1), dtype=np.float32)
        member[np.arange(len(number)), number] = 1
        members.append(member)
    return members


def number_cells(
    matches: Matches, cameras: tuple[Camera, Camera]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Numbers of the cells in which matches lie, of those in use, see `count_places`, shape (N,) for either image.

    Parameters
    ----------
    matches
        N matches [px].
    cameras
        Cameras of the two views, for the sizes of their images.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> pixels = [[10.0, 9.0], [300.0, 9.0], [12.0, 9.0]]
    >>> number_cells(Matches(0, 1, pixels, pixels), (camera, camera))[0].tolist()
    [0, 1, 0]
    """
    numbers = []
    for places, camera in zip((matches.points_first, matches.points_second), cameras, strict=True):
        column, row = (places // (max(camera.image_size) / _CELLS)).astype(int).T
        numbers.append(np.unique(row * _CELLS + column, return_inverse=True)[1].ravel().astype(np.int64))
    return numbers[0], numbers[1]


def chance_agreement(matches: Matches, cameras: tuple[Camera, Camera]) -> Agreement:
    """How far matches agree with a pose by chance, when both ends of every match are unrelated.

    Parameters
    ----------
    matches
        N matches of two views [px].
    cameras
        Intrinsics and distortion of the cameras.

    Returns
    -------
    agreement
        The best of a few shuffles.

    Notes
    -----
    Poses are sought among matches whose second pixels were dealt out anew to others of nearly the same height. What
    repeats along a structure (railings, windows, bricks) lies at the same height in both views and agrees with a pose
    just as well then: such an agreement says nothing of the pose. It is the a-contrario argument of [1]_ with a
    background that was drawn from the pictures themselves, instead of a uniform one.

    References
    ----------
    .. [1] Moisan, L., Stival, B. (2004). A probabilistic criterion to detect rigid point matches between two images and
       estimate the fundamental matrix. International Journal of Computer Vision 57(3), 201-218.

    Examples
    --------
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> first, second = np.random.default_rng(0).uniform(0, 480, (2, 40, 2))
    >>> matches = Matches(0, 1, first, second)
    >>> _, agree = estimate_relative_pose(first, second, camera, camera)
    >>> real, chance = measure_agreement(agree, matches, (camera, camera)), chance_agreement(matches, (camera, camera))
    >>> real.support < chance.support + 3 * chance.std
    True
    """
    rng = np.random.default_rng(0)
    order = np.argsort(matches.points_second[:, 1], kind="stable")
    found = [measure_agreement(np.zeros(len(matches), dtype=np.bool_), matches, cameras)]
    for _ in range(_SHUFFLES):
        dealt = order.copy()
        for start in range(0, len(order), _NEIGHBOURS):
            group = order[start : start + _NEIGHBOURS]
            # A turn by a random step leaves no match as it was.
            dealt[start : start + _NEIGHBOURS] = np.roll(group, rng.integers(1, max(2, len(group))))
        second = np.empty_like(matches.points_second)
        second[order] = matches.points_second[dealt]
        shuffled = Matches(matches.first, matches.second, matches.points_first, second)
        _, agree = estimate_relative_pose(shuffled.points_first, second, *cameras)
        found.append(measure_agreement(agree, shuffled, cameras))
    return max(found, key=lambda one: one.support)


def estimate_relative_pose(
    points_first: FloatArray, points_second: FloatArray, first: Camera, second: Camera, *, most_iterations: int = 20000
) -> tuple[FloatArray, BoolArray]:
    """Pose of the second camera in the first one's frame, with unit translation, and the matches that agree.

    Parameters
    ----------
    points_first, points_second
        Matched pixels in the two views, shape (N, 2) [px].
    first, second
        Intrinsics and distortion of the cameras.
    most_iterations
        Samples that are tried at most.

    Returns
    -------
    cam2_from_cam1
        Rotation and unit translation, shape (3, 4) [1].
    inliers
        Which matches agree, shape (N,); all False when no pose was found.

    Notes
    -----
    LO-RANSAC [2]_ over the five-point solver [1]_, as in PoseLib, on undistorted pixels. The threshold is wide (a
    thousandth of the image width) because the focal lengths may still be some per cent off.

    References
    ----------
    .. [1] Nistér, D. (2004). An efficient solution to the five-point relative pose problem. IEEE Transactions on
       Pattern Analysis and Machine Intelligence 26(6), 756-770.
    .. [2] Chum, O., Matas, J., Kittler, J. (2003). Locally optimized RANSAC. DAGM Symposium on Pattern Recognition.

    Examples
    --------
    >>> first = Camera(np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]), (640, 480))
    >>> second = Camera(first.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> points3d = np.random.default_rng(0).uniform([-3, -2, 10], [3, 2, 20], (50, 3))
    >>> pose, inliers = estimate_relative_pose(first.project(points3d), second.project(points3d), first, second)
    >>> bool(np.allclose(pose[:, 3], [-1, 0, 0], atol=1e-4)), int(inliers.sum())
    (True, 50)
    """
    if len(points_first) < 5:
        return np.eye(3, 4), np.zeros(len(points_first), dtype=bool)
    threshold = max(1.0, 1e-3 * first.image_size[0])
    pixels = [
        c.normalize(points) * [c.K[0, 0], c.K[1, 1]] + c.K[:2, 2]
        for c, points in ((first, points_first), (second, points_second))
    ]
    pose, info = poselib.estimate_relative_pose(
        *pixels,
        *(_make_poselib_camera(c) for c in (first, second)),
        {"max_epipolar_error": threshold, "max_iterations": most_iterations, "min_iterations": 500, "seed": 0},
        {},
    )
    translation = np.asarray(pose.t, dtype=np.float64)
    length = float(np.linalg.norm(translation))
    inliers = np.asarray(info["inliers"], dtype=bool)
    if length == 0:
        return np.eye(3, 4), np.zeros(len(points_first), dtype=bool)
    return np.column_stack([np.asarray(pose.R), translation / length]), inliers


def _make_poselib_camera(camera: Camera) -> dict[str, object]:
    """PoseLib's camera with the intrinsics of ours [px], without distortion."""
    width, height = camera.image_size
    K = camera.K
    return {"model": "PINHOLE", "width": width, "height": height, "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
