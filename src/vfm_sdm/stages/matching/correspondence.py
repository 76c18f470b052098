"""The same points in another view: found automatically, refined to sub-pixel, checked back.

The paper lets VGGT's tracking head carry the point from the first to the second video; this is the classical way.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from vfm_sdm.core.arrays import FloatArray, LumaArray, as_float_array
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.triangulation import in_front_of_all, triangulate
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.registration.peaks import AMBIGUITY_MARGIN, has_rival
from vfm_sdm.stages.registration.subsets import Registration, register_subset

__all__ = ["Correspondence", "Surface", "find_correspondences"]


_MIN_CORRELATION = 0.7
_DISTINCT_PX = 3.0
_RETURN_PX = 0.5
_LEAST_BACK_PX = 13
_AGREEMENT_PX = 1.0
_NEIGHBOURS = 24
_NEAR_GIVEN = 9
_MAX_EPIPOLAR_STEP_PX = 4.0
"""Distance between tried depths along the epipolar line: inside the reach of the sub-pixel registration."""
_MAX_HYPOTHESES = 400
_FIRST_ITERATIONS, _LAST_ITERATIONS = 8, 40
_KEPT_STARTS = 24
"""Places that are carried on after the first iterations: those that resemble the point most."""
_TILTS = np.array([[np.sin(t), 0.0, np.cos(t)] for t in np.radians([0.0, -50.0, 50.0, -70.0, 70.0])])
"""Normals of the small planes that are tried, in the first camera's frame: turned about its vertical."""
_SURFACE_STD = 3.0
_SURFACE_CORRELATION = 0.8
_WELL_SMALLER = 0.8
"""A square confirms another if its side is at most this share of the other's."""
_SIZES_PX = (41, 31, 21)
"""Sides tried, in pixels of the level, where a larger square holds what one view hides from the other, as stiffeners
hide parts of a girder."""
_CLEAR_CORRELATION = 0.95
_SURE_CORRELATION, _COARSE_RETURN_PX = 0.9, 1.5
_REDUCTIONS = (2, 4)
"""Further reductions of both images where a point is not found: in a small picture a sharp view resembles one that is
out of focus."""
_WANDER_PX = 1.5
"""How far, in pixels of the reduced images, the place found there may be off."""
_SOFTENING_PX = 1.0
_GREY_LEVELS = 64
"""Grey levels of a reduced image in one of the original: rounding must not matter."""


_Outcome = tuple[Registration | None, str, float]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Where points of one view lie in another.

    Parameters
    ----------
    points2d
        Shape (P, 2) [px] in the second view; NaN unless the status is ``ok``.
    covariance
        Shape (P, 2, 2) [px2].
    correlation
        Normalised cross-correlation of the matched subsets, shape (P,).
    return_error
        Distance between the named point and where the way back ends, shape (P,) [px].
    status
        ``ok`` or the reason why there is no position, length P.
    """

    points2d: FloatArray
    covariance: FloatArray
    correlation: FloatArray
    return_error: FloatArray
    status: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Surface:
    """A plane that points lie on: ``normal . X = distance`` in the rig's world frame.

    Parameters
    ----------
    normal
        Unit vector, shape (3,).
    distance
        From the origin, in the rig's unit of length.
    std
        Standard deviation of how far points lie off it, same unit.
    """

    normal: FloatArray
    distance: float
    std: float

    def depths(self, ray: FloatArray, camera: Camera) -> tuple[float, float]:
        """Nearest and farthest depth in a camera at which a ray (3,) meets it, three standard deviations each way."""
        inwards, offset = self.in_camera(camera)
        reach = np.array([-_SURFACE_STD, _SURFACE_STD]) * self.std
        near, far = sorted((offset + reach) / (inwards @ ray))
        return float(near), float(far)

    def in_camera(self, camera: Camera) -> tuple[FloatArray, float]:
        """Normal and distance in a camera's frame."""
        inwards = camera.rotation @ self.normal
        return inwards, float(self.distance + inwards @ camera.translation)


@dataclass(frozen=True, eq=False)
class _Hypotheses:
    """Places to try: positions (H, 2) in the second view, and affine maps (H, 2, 2) of reference offsets."""

    position: FloatArray
    affine: FloatArray


def find_correspondences(
    images: tuple[LumaArray, LumaArray],
    points2d: FloatArray,
    rig: Rig,
    *,
    matches: Matches,
    subset_px: int = 41,
    given: Mapping[int, FloatArray] | None = None,
    surface: Surface | None = None,
) -> Correspondence:
    """Positions in the second view of points named in the first.

    Parameters
    ----------
    images
        First frames of the views ``matches.first`` and ``matches.second``.
    points2d
        Shape (P, 2) [px] in the view ``matches.first``.
    rig
        Approximate cameras; the scale does not matter.
    matches
        Feature matches between the two views; may be empty.
    subset_px
        Side of the compared square [px].
    given
        Positions that a user named in the second view, by index of the point; tried first.
    surface
        Where the points are known to lie, such as the structure's face; only places on it are tried then.

    Raises
    ------
    DatasetError
        Points are not pixels of the first image.

    Notes
    -----
    Places to try are the affine map of neighbouring matches, and points at a sequence of depths on the viewing ray,
    each as a small plane facing the camera or tilted about the vertical. Every one is refined by IC-GN with an affine
    warp, so convergence at 30 degrees is a matter of the start. The best correlation wins if no distinct place comes
    close to it, and if registration from there back to the first image returns to the named point. Where the result is
    poor, smaller squares are tried, and the one that fits best is taken. The search is made in images reduced so far
    that the square has about 41 px, further reduced where the point is not found; the last step is at full size. The
    affine warp
    leaves out the second order of the perspective: the place found is off by up to about ``tan(angle) h^2 / (6 f)`` px
    for a subset of half width h, a constant that cancels in displacement.
    """
    points = as_float_array(points2d, "points2d", (None, 2))
    height, width = images[0].shape
    if not ((points >= 0) & (points <= [width - 1, height - 1])).all():
        raise DatasetError(
            f"points2d: expected pixels inside {width} x {height}, got {points.tolist()}; check the view"
        )
    least = max(1, round(subset_px / _SIZES_PX[0]))
    results: list[_Outcome] = [(None, PointStatus.NOT_FOUND, float("nan"))] * len(points)
    if surface is not None:
        levels = [_reduced(images, rig, matches, factor) for factor in range(least, 0, -1)]
        results = [_find_on_surface(images, levels, point, surface, subset_px) for point in points]
        return _collected(results)
    for factor in dict.fromkeys((least, max(1, least - 1), *(least * more for more in _REDUCTIONS))):
        level = _reduced(images, rig, matches, factor)
        for index, point in enumerate(points):
            if results[index][1] in (PointStatus.NOT_FOUND, PointStatus.NOT_RETURNED):
                found = _find_one(images, level, point, subset_px=subset_px, given=(given or {}).get(index))
                if found[1] == PointStatus.OK or results[index][0] is None:
                    results[index] = found
    return _collected(results)


def _collected(results: list[_Outcome]) -> Correspondence:
    status = tuple(outcome[1] for outcome in results)
    count = len(results)
    position, covariance = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
    correlation, return_error = np.full(count, np.nan), np.full(count, np.nan)
    for index, (registration, state, miss) in enumerate(results):
        return_error[index] = miss
        if registration is not None:
            correlation[index] = registration.correlation[0]
        if registration is not None and state == PointStatus.OK:
            position[index], covariance[index] = registration.position[0], registration.covariance[0]
    return Correspondence(position, covariance, correlation, return_error, status)


@dataclass(frozen=True, eq=False)
class _Level:
    """Both images reduced by a whole number, with cameras and matches to go with them."""

    factor: int
    images: tuple[LumaArray, LumaArray]
    cameras: tuple[Camera, Camera]
    rig: Rig
    matches: Matches

    def reduced(self, points2d: FloatArray) -> FloatArray:
        return (points2d + 0.5) / self.factor - 0.5

    def full(self, points2d: FloatArray) -> FloatArray:
        return (points2d + 0.5) * self.factor - 0.5


def _reduced(images: tuple[LumaArray, LumaArray], rig: Rig, matches: Matches, factor: int) -> _Level:
    pair = rig.cameras[matches.first], rig.cameras[matches.second]
    if factor == 1:
        return _Level(1, images, pair, rig, matches)
    small = tuple(_reduced_image(image, factor) for image in images)
    cameras = tuple(_reduced_camera(camera, factor) for camera in rig.cameras)
    level = _Level(factor, (small[0], small[1]), (cameras[matches.first], cameras[matches.second]), rig, matches)
    moved = Matches(
        matches.first, matches.second, level.reduced(matches.points_first), level.reduced(matches.points_second)
    )
    return replace(level, rig=Rig(rig.names, cameras, metric=rig.metric), matches=moved)


def _reduced_image(image: LumaArray, factor: int) -> LumaArray:
    """Means over squares of pixels, blurred a little: what only a view in focus shows is gone from both."""
    height, width = (n // factor * factor for n in image.shape)
    blocks = image[:height, :width].astype(np.float32).reshape(height // factor, factor, width // factor, factor)
    soft = gaussian_filter(blocks.mean(axis=(1, 3)), _SOFTENING_PX)
    levels: LumaArray = np.rint(np.clip(_GREY_LEVELS * soft, 0, np.iinfo(np.uint16).max)).astype(np.uint16)
    return levels


def _reduced_camera(camera: Camera, factor: int) -> Camera:
    K = camera.K.copy()
    K[:2, :2] /= factor
    K[:2, 2] = (K[:2, 2] + 0.5) / factor - 0.5
    size = camera.image_size[0] // factor, camera.image_size[1] // factor
    return replace(camera, K=K, image_size=size)


def _find_one(
    images: tuple[LumaArray, LumaArray], level: _Level, point: FloatArray, *, subset_px: int, given: FloatArray | None
) -> _Outcome:
    """Best registration of one point, its status, and the distance that the way back misses by."""
    place = level.reduced(point)
    depths = _depth_range(level.rig, level.matches)
    hypotheses = _join(_from_matches(place, level.matches), _from_depths(place, *level.cameras, depths, _TILTS))
    named = None if given is None else level.reduced(given)
    if named is not None:
        # A position named by hand says where; the map of offsets is that of the places tried next to it.
        nearest = np.argsort(np.linalg.norm(hypotheses.position - named, axis=1))[:_NEAR_GIVEN]
        hypotheses = _Hypotheses(np.tile(named, (nearest.size, 1)), hypotheses.affine[nearest])
    outcomes: list[_Outcome] = []
    whole = subset_px if level.factor == 1 else _SIZES_PX[0]
    for size in (whole, *(px for px in _SIZES_PX if px < whole)):
        found = _at_full_size(images, level, point, _register(level.images, place, hypotheses, size, named), size)
        outcomes.append(found)
        if found[1] == PointStatus.OK and _correlation(found) >= _CLEAR_CORRELATION:
            break
    good = [one for one in outcomes if one[1] == PointStatus.OK]
    return max(_agreeing(good), key=_correlation) if good else outcomes[0]


def _find_on_surface(
    images: tuple[LumaArray, LumaArray], levels: list[_Level], point: FloatArray, surface: Surface, subset_px: int
) -> _Outcome:
    """Registration of one point on a surface: the most certain of those that a well smaller square confirms.

    Where one view is dark or out of focus and seen at a sharp angle, the few pixels of the way back do not suffice.
    Squares of different size see different surroundings: what stands off the surface draws each elsewhere.
    """
    seen: list[tuple[int, Registration]] = []
    for level in levels:
        place = level.reduced(point)
        ray = np.append(level.cameras[0].normalize(place), 1.0)
        normal = surface.in_camera(level.cameras[0])[0]
        hypotheses = _from_depths(place, *level.cameras, surface.depths(ray, level.cameras[0]), normal[None])
        for size in (px for px in _SIZES_PX if px * level.factor <= subset_px + level.factor):
            found, state, _ = _register(level.images, place, hypotheses, size, None)
            if found is not None and state != PointStatus.AMBIGUOUS and found.correlation[0] >= _SURFACE_CORRELATION:
                seen.append((size * level.factor, _carried_on(images, level, point, found, size)[0]))
    confirmed: list[_Outcome] = []
    for side, one in seen:
        smaller = [other.position[0] for other_side, other in seen if other_side <= _WELL_SMALLER * side]
        apart = min((float(np.linalg.norm(one.position[0] - place)) for place in smaller), default=np.inf)
        if apart <= _AGREEMENT_PX:
            confirmed.append((one, PointStatus.OK, apart))
    return min(confirmed, key=_variance, default=(None, PointStatus.NOT_FOUND, float("nan")))


def _variance(outcome: _Outcome) -> float:
    return np.inf if outcome[0] is None else float(np.trace(outcome[0].covariance[0]))


def _agreeing(good: list[_Outcome]) -> list[_Outcome]:
    """Those that end where the largest square does: a smaller one finds look-alikes more easily."""
    places = [np.full(2, np.nan) if found is None else found.position[0] for found, _, _ in good]
    return [one for one, place in zip(good, places, strict=True) if np.linalg.norm(place - places[0]) <= _AGREEMENT_PX]


def _correlation(outcome: _Outcome) -> float:
    return -1.0 if outcome[0] is None else float(outcome[0].correlation[0])


def _at_full_size(
    images: tuple[LumaArray, LumaArray], level: _Level, point: FloatArray, found: _Outcome, size: int
) -> _Outcome:
    """The registration of the reduced images carried on in the images themselves, where that agrees with it."""
    registration, status, miss = found
    if level.factor == 1 or registration is None:
        return found
    carried, agreed = _carried_on(images, level, point, registration, size)
    # Where one view is out of focus, the sharp one does not resemble it at full size. A place that only the reduced
    # images show stands if they leave little doubt: it must return to less than a few pixels, and resemble it well.
    sure = registration.correlation[0] >= _SURE_CORRELATION and level.factor * miss <= _COARSE_RETURN_PX
    return carried, status if agreed or sure or status != PointStatus.OK else PointStatus.NOT_FOUND, level.factor * miss


def _carried_on(
    images: tuple[LumaArray, LumaArray], level: _Level, point: FloatArray, registration: Registration, size: int
) -> tuple[Registration, bool]:
    """A registration of reduced images in pixels of the images themselves, and whether these agree with it."""
    if level.factor == 1:
        return registration, True
    start = level.full(registration.position)
    odd = size * level.factor // 2 * 2 + 1
    fine = register_subset(images[0], images[1], point[None], start, registration.affine, subset_px=odd)
    near = np.linalg.norm(fine.position[0] - start[0]) <= _WANDER_PX * level.factor
    if bool(fine.converged[0]) and fine.correlation[0] >= _MIN_CORRELATION and near:
        return fine, True
    return replace(registration, position=start, covariance=level.factor**2 * registration.covariance), False


def _register(
    images: tuple[LumaArray, LumaArray],
    point: FloatArray,
    hypotheses: _Hypotheses,
    subset_px: int,
    named: FloatArray | None,
) -> _Outcome:
    """As `_find_one`, in the images of a level and with squares of one size."""
    hypotheses = _inside(hypotheses, images[1], subset_px)
    if not len(hypotheses.position):
        return None, PointStatus.NOT_FOUND, float("nan")
    tried = _best_starts(images, point, hypotheses, subset_px)
    correlation = np.where(np.isfinite(tried.position).all(axis=1) & tried.converged, tried.correlation, -1.0)
    best = int(np.argmax(correlation))
    if named is not None:
        # Of places that look alike, the one next to where the user points.
        alike = np.flatnonzero(correlation > correlation[best] - AMBIGUITY_MARGIN)
        best = int(alike[np.argmin(np.linalg.norm(tried.position[alike] - named, axis=1))])
    if correlation[best] < _MIN_CORRELATION:
        return None, PointStatus.NOT_FOUND, float("nan")
    chosen = _take(tried, best)
    if has_rival(correlation, tried.position, best, distinct_px=_DISTINCT_PX):
        return chosen, PointStatus.AMBIGUOUS, float("nan")
    # The square of the way back must not reach beyond what the way there has seen.
    shrunk = np.linalg.svd(chosen.affine[0], compute_uv=False)[-1] * subset_px
    size = int(np.clip(shrunk // 2 * 2 + 1, _LEAST_BACK_PX, subset_px))
    back = register_subset(
        images[1], images[0], chosen.position, point[None], np.linalg.inv(chosen.affine), subset_px=size
    )
    miss = float(np.linalg.norm(back.position[0] - point))
    return chosen, PointStatus.OK if back.converged[0] and miss <= _RETURN_PX else PointStatus.NOT_RETURNED, miss


def _best_starts(
    images: tuple[LumaArray, LumaArray], point: FloatArray, hypotheses: _Hypotheses, subset_px: int
) -> Registration:
    """Registrations from the starts that resemble the point most after a few steps."""

    def register(chosen: _Hypotheses, iterations: int) -> Registration:
        places = np.broadcast_to(point, (len(chosen.position), 2))
        return register_subset(
            *images, places, chosen.position, chosen.affine, subset_px=subset_px, max_iterations=iterations
        )

    resemblance = np.nan_to_num(register(hypotheses, _FIRST_ITERATIONS).correlation, nan=-1.0)
    kept = np.argsort(-resemblance, kind="stable")[:_KEPT_STARTS]
    # On soft or noisy textures the steps are short, and the first ones do not end.
    return register(_Hypotheses(hypotheses.position[kept], hypotheses.affine[kept]), _LAST_ITERATIONS)


def _from_matches(point: FloatArray, matches: Matches) -> _Hypotheses:
    """Affine maps fitted to the nearest matches, for a few sizes of the neighbourhood."""
    count = len(matches.points_first)
    positions, affines = [], []
    if count >= 4:
        order = cKDTree(matches.points_first).query(point, k=min(count, _NEIGHBOURS))[1]
        for size in (4, 8, 16, _NEIGHBOURS):
            chosen = np.atleast_1d(order)[:size]
            if chosen.size < min(size, 4):
                continue
            offsets = matches.points_first[chosen] - point
            design = np.column_stack([np.ones(chosen.size), offsets])
            if np.linalg.matrix_rank(design, tol=1e-3) < 3:
                continue
            # Median-like weights in three rounds: one wrong match among the neighbours must not carry the map away.
            weight = np.ones(chosen.size)
            for _ in range(3):
                solution = np.linalg.lstsq(
                    design * weight[:, None], matches.points_second[chosen] * weight[:, None], rcond=None
                )[0]
                residual = np.linalg.norm(design @ solution - matches.points_second[chosen], axis=1)
                weight = 1 / np.sqrt(1 + (residual / (np.median(residual) + 0.5)) ** 2)
            positions.append(solution[0])
            affines.append(solution[1:].T)
    return _Hypotheses(np.array(positions).reshape(-1, 2), np.array(affines).reshape(-1, 2, 2))


def _depth_range(rig: Rig, matches: Matches) -> tuple[float, float]:
    """Nearest and farthest depth to try: what the matches span, widened; else what the rig sees."""
    baseline = float(np.linalg.norm(rig.cameras[matches.first].center - rig.cameras[matches.second].center))
    pair = Rig(("a", "b"), (rig.cameras[matches.first], rig.cameras[matches.second]))
    points3d = triangulate(np.stack([matches.points_first, matches.points_second]), pair)
    camera = pair.cameras[0]
    depth = (points3d @ camera.rotation.T + camera.translation)[in_front_of_all(points3d, pair), 2]
    if depth.size < 8:
        return baseline, 50 * baseline
    near, far = np.percentile(depth, [2, 98])
    return 0.7 * float(near), 1.5 * float(far)


def _from_depths(
    point: FloatArray, first: Camera, second: Camera, depths: tuple[float, float], normals: FloatArray
) -> _Hypotheses:
    """Points on the viewing ray, equally spaced along the epipolar line, each as small planes with normals (N, 3)."""
    ray = np.append(first.normalize(point), 1.0)

    def pixel(depth: FloatArray) -> FloatArray:
        world = (depth[:, None] * ray - first.translation) @ first.rotation
        return second.project(world)

    inverse = np.linspace(1 / depths[0], 1 / depths[1], 2000)
    line = pixel(1 / inverse)
    visible = np.isfinite(line).all(axis=1)
    inverse, line = inverse[visible], line[visible]
    if len(line) < 2:
        return _Hypotheses(np.empty((0, 2)), np.empty((0, 2, 2)))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    count = int(np.clip(np.ceil(travelled[-1] / _MAX_EPIPOLAR_STEP_PX), 2, _MAX_HYPOTHESES))
    tried = 1 / np.interp(np.linspace(0, travelled[-1], count), travelled, inverse)
    positions = pixel(tried)
    everything = [_Hypotheses(positions, _plane_maps(point, first, second, tried, n)) for n in normals]
    return _join(*everything)


def _plane_maps(point: FloatArray, first: Camera, second: Camera, depths: FloatArray, normal: FloatArray) -> FloatArray:
    """Affine maps of offsets from the first to the second image through planes at depths on the point's ray."""
    ray = np.append(first.normalize(point), 1.0)
    columns = []
    for axis in range(2):
        moved = []
        for sign in (1.0, -1.0):
            beside = np.append(first.normalize(point + sign * np.eye(2)[axis]), 1.0)
            depth = depths * (ray @ normal) / (beside @ normal)
            moved.append(second.project((depth[:, None] * beside - first.translation) @ first.rotation))
        columns.append((moved[0] - moved[1]) / 2)
    return np.stack(columns, axis=-1)


def _join(*parts: _Hypotheses) -> _Hypotheses:
    return _Hypotheses(np.concatenate([p.position for p in parts]), np.concatenate([p.affine for p in parts]))


def _inside(hypotheses: _Hypotheses, image: LumaArray, subset_px: int) -> _Hypotheses:
    """Those hypotheses whose subset lies inside the image and is neither squeezed flat nor blown up."""
    height, width = image.shape
    margin = subset_px // 2 + 2
    position = hypotheses.position
    inside = ((position >= margin) & (position <= [width - 1 - margin, height - 1 - margin])).all(axis=1)
    # Planes tilted out of a camera's sight have no map at all.
    defined = np.asarray(np.isfinite(hypotheses.affine).all(axis=(1, 2)))
    area = np.abs(np.linalg.det(np.where(defined[:, None, None], hypotheses.affine, 0.0)))
    kept = inside & (area > 0.1) & (area < 10)
    return _Hypotheses(position[kept], hypotheses.affine[kept])


def _take(registration: Registration, index: int) -> Registration:
    fields = registration.__dataclass_fields__
    return Registration(**{name: getattr(registration, name)[index : index + 1] for name in fields})
