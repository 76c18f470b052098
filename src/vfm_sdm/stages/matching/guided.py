"""Feature matches along the epipolar lines of cameras that are roughly known."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.stages.matching.detection import Float32Array, ImageFeatures, find_nearest
from vfm_sdm.stages.matching.features import FeatureMatches, unite_versions

__all__ = ["match_guided"]

_RATIO = 0.95
"""Looser than without cameras: along a line there are some per cent of an image's features, and the best of few is less
outstanding by itself."""
_LOCATION_STD_PX = 1.0
"""By which one corner is detected elsewhere in a picture from another place."""
_REACH = 3.0
"""Standard deviations on either side of a line."""
_DRAWS, _SEED = 24, 0
_ROWS = 500
_NEAREST_TO_LENS = 0.1
"""Depth in the second camera over that in the first below which nothing is looked for."""


@dataclass(frozen=True, eq=False)
class _Bands:
    """Where features of the first view may lie in the second, in undistorted pixels from its principal point.

    Parameters
    ----------
    start, end
        The place of each at the least and the greatest depth, shape (N, 2) [px].
    std
        Standard deviation of these places in any direction, shape (N,) [px].
    points
        Features of the second view, shape (M, 2) [px].
    point_std
        Standard deviation of these places that the second camera's intrinsics cause, shape (M,) [px].
    """

    start: FloatArray
    end: FloatArray
    std: FloatArray
    points: FloatArray
    point_std: FloatArray

    def contain(self, rows: IntArray, columns: IntArray) -> BoolArray:
        """Whether features of the second view lie in the band of those of the first, shape (rows, columns)."""
        along, points = self.end[rows] - self.start[rows], self.points[columns]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = np.where(length > 0, along / np.maximum(length, 1e-12), [1.0, 0.0])
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        reach = _REACH * np.sqrt(self.std[rows, None] ** 2 + self.point_std[columns] ** 2)
        aside = across @ points.T - np.einsum("ij,ij->i", across, self.start[rows])[:, None]
        on = along @ points.T - np.einsum("ij,ij->i", along, self.start[rows])[:, None]
        return np.asarray((np.abs(aside) <= reach) & (on >= -reach) & (on <= length + reach))


def match_guided(
    first: ImageFeatures,
    second: ImageFeatures,
    rig: Rig,
    *,
    views: tuple[int, int] = (0, 1),
    depths: tuple[float, float] | None = None,
) -> FeatureMatches:
    """Features that look alike and lie where cameras that are roughly known allow.

    Parameters
    ----------
    first, second
        Features of the images of the two views.
    rig
        The cameras; its covariance says how well they are known, and none that they are exact.
    views
        Positions of the two views in the rig.
    depths
        Least and greatest depth of the scene in the first camera, in the rig's unit of length; by default from the
        distance between the cameras, nearer than which two views hardly resemble each other, to infinity.

    Returns
    -------
    matches
        Pixels in both images and the quality of each match, the best first.

    Notes
    -----
    Each feature is compared with those in a band around its epipolar line between the two depths, three standard
    deviations wide on either side; what the cameras contribute is found by drawing some from the covariance. A match
    must be the best one of its band in both directions, and pass a ratio test against the next best at another place of
    the band, and against the best of as many features drawn from the rest of the image, which are known to be wrong.
    Where structure repeats itself along the line there is no match.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> from vfm_sdm.stages.matching.detection import detect_features
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (240, 340)), 2)
    >>> image = np.rint(128 + 300 * texture).clip(0, 255).astype(np.uint8)
    >>> features = [detect_features(part) for part in (image[:, 20:], image[:, :-20])]
    >>> left = Camera(np.array([[1000.0, 0, 160], [0, 1000, 120], [0, 0, 1]]), (320, 240))
    >>> right = Camera(left.K, (320, 240), cam_from_world=np.array([[1.0, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> matches = match_guided(*features, Rig(("left", "right"), (left, right)))
    >>> np.abs(np.median(matches.points_second - matches.points_first, axis=0)).round().tolist()
    [20.0, 0.0]
    """
    bands = _find_bands(first, second, rig, views, depths)
    return unite_versions(first, second, lambda rows, columns: _match_in_bands(first, second, rows, columns, bands))


def _find_bands(
    first: ImageFeatures,
    second: ImageFeatures,
    rig: Rig,
    views: tuple[int, int],
    depths: tuple[float, float] | None,
) -> _Bands:
    near, far = depths or (rig.baseline(*views), np.inf)
    drawn = [rig]
    if rig.covariance is not None:
        steps = np.random.default_rng(_SEED).multivariate_normal(
            np.zeros(len(rig.covariance)), rig.covariance, size=_DRAWS, method="eigh"
        )
        drawn += [rig.perturbed(step) for step in steps]
    pairs = [(one.cameras[views[0]], one.cameras[views[1]]) for one in drawn]
    focal = pairs[0][1].focal_px
    places = focal * np.array([[_places(first.points, *pair, depth) for depth in (near, far)] for pair in pairs])
    points = focal * np.array([camera.normalize(second.points) for _, camera in pairs])
    moved = np.linalg.norm(places[1:] - places[0], axis=-1) if len(drawn) > 1 else np.zeros((1, 2, len(first)))
    point_moved = np.linalg.norm(points[1:] - points[0], axis=-1) if len(drawn) > 1 else np.zeros((1, len(second)))
    # A band is as wide as its wider end; half of the variance of a vector is that along one direction.
    std = np.sqrt(_LOCATION_STD_PX**2 + (moved**2).mean(axis=0).max(axis=0) / 2)
    return _Bands(places[0, 0], places[0, 1], std, points[0], np.sqrt((point_moved**2).mean(axis=0) / 2))


def _places(points2d: FloatArray, first: Camera, second: Camera, depth: float) -> FloatArray:
    """Normalised coordinates in the second camera, shape (N, 2), of what the first one sees at a depth."""
    R = second.rotation @ first.rotation.T
    t = second.translation - R @ first.translation
    ray = np.column_stack([first.normalize(points2d), np.ones(len(points2d))]) @ R.T
    # As near as the depth, but not so near that it comes beside or behind the second camera.
    inverse = np.full(len(ray), 1 / depth)
    if t[2] < 0:
        inverse = np.minimum(inverse, (1 - _NEAREST_TO_LENS) * ray[:, 2] / -t[2])
    seen = ray + inverse[:, None] * t
    return np.asarray(seen[:, :2] / seen[:, 2:])


def _match_in_bands(
    first: ImageFeatures, second: ImageFeatures, rows: IntArray, columns: IntArray, bands: _Bands
) -> tuple[IntArray, IntArray, FloatArray]:
    """Indices of matched features of one version of each image, and the quality of each match."""
    likeness: Float32Array = first.descriptors[rows] @ second.descriptors[columns].T
    inside = np.concatenate(
        [bands.contain(rows[start : start + _ROWS], columns) for start in range(0, rows.size, _ROWS)]
    )
    rest = _draw_from_the_rest(likeness, inside)
    likeness[~inside] = -1.0
    back, _, back_next = find_nearest(np.ascontiguousarray(likeness.T), first.points[rows], first.place_px)
    best, distance, next_distance = find_nearest(likeness, second.points[columns], second.place_px)
    next_distance = np.minimum(np.minimum(next_distance, back_next[best]), rest)
    number = np.arange(rows.size)
    kept = inside[number, best] & (back[best] == number) & (distance < _RATIO * next_distance)
    return rows[kept], columns[best[kept]], 1.0 - (distance[kept] / next_distance[kept]).astype(np.float64)


def _draw_from_the_rest(likeness: Float32Array, inside: BoolArray) -> Float32Array:
    """Distance to the most similar of features outside each band, drawn as many as a band has on average, (N,)."""
    count = max(1, round(inside.sum() / max(1, len(inside))))
    drawn = np.random.default_rng(_SEED).choice(inside.shape[1], size=min(count, inside.shape[1]), replace=False)
    outside = np.where(inside[:, drawn], np.float32(-1.0), likeness[:, drawn]).max(axis=1)
    distance: Float32Array = np.sqrt(np.maximum(2 - 2 * outside, np.float32(0)))
    return distance
