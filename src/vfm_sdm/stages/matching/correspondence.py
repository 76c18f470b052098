"""The same points in another view: found automatically, refined to sub-pixel, checked back.

The paper lets VGGT's tracking head carry the point from the first to the second video; this is the classical way.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray, as_float_array
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.stages.matching.epipolar import EpipolarBand, epipolar_band
from vfm_sdm.stages.matching.pyramid import MIN_CORRELATION, Level, ViewPair, reduce_pair
from vfm_sdm.stages.matching.starts import (
    TILTS,
    Hypotheses,
    find_depth_range,
    join,
    keep_inside,
    starts_from_depths,
    starts_from_matches,
)
from vfm_sdm.stages.registration.peaks import AMBIGUITY_MARGIN, has_rival
from vfm_sdm.stages.registration.records import Registration, Starts
from vfm_sdm.stages.registration.subsets import register_subset

__all__ = ["RETURN_PX", "Correspondence", "Surface", "find_correspondences", "way_back"]

_DISTINCT_PX = 3.0
RETURN_PX = 0.5
"""Distance by which the way back may miss the point [px]."""
_LEAST_BACK_PX = 13
_AGREEMENT_PX = 1.0
_NEAR_GIVEN = 9
_FIRST_ITERATIONS, _LAST_ITERATIONS = 8, 40
_KEPT_STARTS = 24
"""Places that are carried on after the first iterations: those that resemble the point most."""
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


def find_correspondences(
    views: ViewPair,
    points2d: FloatArray,
    *,
    subset_px: int = 41,
    given: Mapping[int, FloatArray] | None = None,
    surface: Surface | None = None,
) -> Correspondence:
    """Positions in the second view of points named in the first.

    Parameters
    ----------
    views
        The two views.
    points2d
        Shape (P, 2) [px] in the first view.
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
    warp, so convergence at 30 degrees is a matter of the start. The best correlation within the width of the epipolar
    line (`epipolar_band`) wins if no distinct place there comes close to it, and if registration from there back to the
    first image returns to the named point. Where the result is poor, smaller squares are tried, and the one that fits
    best is taken. The search is made in images reduced so far that the square has about 41 px, further reduced where
    the point is not found; the last step is at full size.

    The affine warp leaves out the second order of the perspective: the place found is off by up to about
    ``tan(angle) h^2 / (6 f)`` px for a subset of half width h, a constant that cancels in displacement.
    """
    points = as_float_array(points2d, "points2d", (None, 2))
    height, width = views.images[0].shape
    if not ((points >= 0) & (points <= [width - 1, height - 1])).all():
        raise DatasetError(
            f"points2d: expected pixels inside {width} x {height}, got {points.tolist()}; check the view"
        )
    least = max(1, round(subset_px / _SIZES_PX[0]))
    results: list[_Outcome] = [(None, PointStatus.NOT_FOUND, float("nan"))] * len(points)
    if surface is not None:
        levels = [reduce_pair(views, factor) for factor in range(least, 0, -1)]
        results = [_find_on_surface(levels, point, surface, subset_px) for point in points]
        return _collected(results)
    depths, pair = find_depth_range(views.rig, views.matches), (views.matches.first, views.matches.second)
    bands = [epipolar_band(point, views.rig, pair, depths) for point in points]
    for factor in dict.fromkeys((least, max(1, least - 1), *(least * more for more in _REDUCTIONS))):
        level = reduce_pair(views, factor)
        for index, point in enumerate(points):
            if results[index][1] in (PointStatus.NOT_FOUND, PointStatus.NOT_RETURNED):
                found = _find_one(level, point, subset_px=subset_px, given=(given or {}).get(index), band=bands[index])
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


def _find_one(
    level: Level, point: FloatArray, *, subset_px: int, given: FloatArray | None, band: EpipolarBand
) -> _Outcome:
    """Best registration of one point, its status, and the distance that the way back misses by."""
    place = level.reduced(point)
    depths = find_depth_range(level.pair.rig, level.pair.matches)
    hypotheses = join(
        starts_from_matches(place, level.pair.matches), starts_from_depths(place, *level.pair.cameras, depths, TILTS)
    )
    named = None if given is None else level.reduced(given)
    if named is not None:
        # A position named by hand says where; the map of offsets is that of the places tried next to it.
        nearest = np.argsort(np.linalg.norm(hypotheses.position - named, axis=1))[:_NEAR_GIVEN]
        hypotheses = Hypotheses(np.tile(named, (nearest.size, 1)), hypotheses.affine[nearest])
    outcomes: list[_Outcome] = []
    whole = subset_px if level.factor == 1 else _SIZES_PX[0]
    for size in (whole, *(px for px in _SIZES_PX if px < whole)):
        found = _at_full_size(level, point, _register(level, place, hypotheses, size, _Wanted(named, band)), size)
        outcomes.append(found)
        if found[1] == PointStatus.OK and _correlation(found) >= _CLEAR_CORRELATION:
            break
    good = [one for one in outcomes if one[1] == PointStatus.OK]
    return max(_agreeing(good), key=_correlation) if good else outcomes[0]


def _find_on_surface(levels: list[Level], point: FloatArray, surface: Surface, subset_px: int) -> _Outcome:
    """Registration of one point on a surface: the most certain of those that a well smaller square confirms.

    Where one view is dark or out of focus and seen at a sharp angle, the few pixels of the way back do not suffice.
    Squares of different size see different surroundings: what stands off the surface draws each elsewhere.
    """
    seen: list[tuple[int, Registration]] = []
    for level in levels:
        place = level.reduced(point)
        cameras = level.pair.cameras
        ray = np.append(cameras[0].normalize(place), 1.0)
        normal = surface.in_camera(cameras[0])[0]
        hypotheses = starts_from_depths(place, *cameras, surface.depths(ray, cameras[0]), normal[None])
        for size in (px for px in _SIZES_PX if px * level.factor <= subset_px + level.factor):
            found, state, _ = _register(level, place, hypotheses, size, _Wanted())
            if found is not None and state != PointStatus.AMBIGUOUS and found.correlation[0] >= _SURFACE_CORRELATION:
                seen.append((size * level.factor, level.carry_on(point, found, size)[0]))
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


def _at_full_size(level: Level, point: FloatArray, found: _Outcome, size: int) -> _Outcome:
    """The registration of the reduced images carried on in the images themselves, where that agrees with it."""
    registration, status, miss = found
    if level.factor == 1 or registration is None:
        return found
    carried, agreed = level.carry_on(point, registration, size)
    # Where one view is out of focus, the sharp one does not resemble it at full size. A place that only the reduced
    # images show stands if they leave little doubt: it must return to less than a few pixels, and resemble it well.
    sure = registration.correlation[0] >= _SURE_CORRELATION and level.factor * miss <= _COARSE_RETURN_PX
    return carried, status if agreed or sure or status != PointStatus.OK else PointStatus.NOT_FOUND, level.factor * miss


@dataclass(frozen=True, eq=False)
class _Wanted:
    """Which of the places that resemble a point may be it."""

    named: FloatArray | None = None
    """Where it was named in the reduced image, shape (2,) [px]: the nearest one."""
    band: EpipolarBand | None = None
    """Where the cameras allow it, in the image at full size."""


def _register(level: Level, point: FloatArray, hypotheses: Hypotheses, subset_px: int, wanted: _Wanted) -> _Outcome:
    """As `_find_one`, in the images of a level and with squares of one size."""
    images, named = level.pair.images, wanted.named
    hypotheses = keep_inside(hypotheses, images[1], subset_px)
    if not len(hypotheses.position):
        return None, PointStatus.NOT_FOUND, float("nan")
    tried = _best_starts(images, point, hypotheses, subset_px)
    correlation = np.where(np.isfinite(tried.position).all(axis=1) & tried.converged, tried.correlation, -1.0)
    if wanted.band is not None:
        correlation = np.where(wanted.band.holds(level.full(np.nan_to_num(tried.position))), correlation, -1.0)
    best = int(np.argmax(correlation))
    if named is not None:
        # Of places that look alike, the one next to where the user points.
        alike = np.flatnonzero(correlation > correlation[best] - AMBIGUITY_MARGIN)
        best = int(alike[np.argmin(np.linalg.norm(tried.position[alike] - named, axis=1))])
    if correlation[best] < MIN_CORRELATION:
        return None, PointStatus.NOT_FOUND, float("nan")
    chosen = _take(tried, best)
    if has_rival(correlation, tried.position, best, distinct_px=_DISTINCT_PX):
        return chosen, PointStatus.AMBIGUOUS, float("nan")
    miss = way_back(images, point, chosen, subset_px)
    return chosen, PointStatus.OK if miss <= RETURN_PX else PointStatus.NOT_RETURNED, miss


def way_back(images: tuple[LumaArray, LumaArray], point: FloatArray, there: Registration, subset_px: int) -> float:
    """Distance between a point and where registration from its place in the second image ends in the first [px].

    Parameters
    ----------
    images
        The two views, shape (H, W) each.
    point
        Place in the first view, shape (2,) [px].
    there
        Registration of this point in the second view.
    subset_px
        Side of its subset [px].

    Returns
    -------
    miss
        Infinite where the way back does not converge.
    """
    # The square of the way back must not reach beyond what the way there has seen.
    shrunk = np.linalg.svd(there.affine[0], compute_uv=False)[-1] * subset_px
    size = int(np.clip(shrunk // 2 * 2 + 1, _LEAST_BACK_PX, subset_px))
    back = register_subset(
        images[1], images[0], there.position, Starts(point[None], np.linalg.inv(there.affine)), subset_px=size
    )
    return float(np.linalg.norm(back.position[0] - point)) if back.converged[0] else np.inf


def _best_starts(
    images: tuple[LumaArray, LumaArray], point: FloatArray, hypotheses: Hypotheses, subset_px: int
) -> Registration:
    """Registrations from the starts that resemble the point most after a few steps."""

    def register(chosen: Hypotheses, iterations: int) -> Registration:
        places = np.broadcast_to(point, (len(chosen.position), 2))
        return register_subset(*images, places, chosen, subset_px=subset_px, max_iterations=iterations)

    resemblance = np.nan_to_num(register(hypotheses, _FIRST_ITERATIONS).correlation, nan=-1.0)
    kept = np.argsort(-resemblance, kind="stable")[:_KEPT_STARTS]
    # On soft or noisy textures the steps are short, and the first ones do not end.
    return register(Hypotheses(hypotheses.position[kept], hypotheses.affine[kept]), _LAST_ITERATIONS)


def _take(registration: Registration, index: int) -> Registration:
    fields = registration.__dataclass_fields__
    return Registration(**{name: getattr(registration, name)[index : index + 1] for name in fields})
