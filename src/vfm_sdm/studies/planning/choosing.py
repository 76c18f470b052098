"""Which candidates are structure and which are still background, and the best of each, well spread."""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.studies.planning.trial_tracks import Tried

__all__ = ["MOVES", "Motion", "choose_spread_along", "choose_spread_out", "judge_motion"]

_CLEAR = 3.0
"""Times the noise that the structure's motion must have to tell structure and background apart."""
_STILL = 0.05
"""Share of the structure's motion up to which a place is still: a static point that moves takes as much out of it."""
MOVES = 0.2
"""Share of the structure's usual motion from which a place moves with it; what moves less may be leaves, or near a
support, where there is little to measure."""
_BETTER = 75
"""Per cent of the places on the face that move less than what is taken for the structure's usual motion."""
_FEWEST_STILL = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """How candidates move in trial tracks.

    Parameters
    ----------
    moved_px
        Root mean square motion beyond noise, the largest over views, shape (P,) [px]; NaN where none was followed.
    noise_px
        Noise of one frame in the view of that motion, shape (P,) [px].
    structure_px
        Usual motion of the structure's better moving quarter [px].
    tells
        Whether that is clear of noise, so that motion tells structure and background apart.
    """

    moved_px: FloatArray
    noise_px: FloatArray
    structure_px: float
    tells: bool

    @property
    def clear_of_noise(self) -> BoolArray:
        """Which candidates are seen to move, shape (P,)."""
        return np.asarray(self.moved_px > _CLEAR * self.noise_px)

    @property
    def with_structure(self) -> BoolArray:
        """Which candidates are seen to move as the structure does, shape (P,)."""
        return np.asarray(self.clear_of_noise & (self.moved_px >= MOVES * self.structure_px))

    @property
    def still(self) -> BoolArray:
        """Which candidates do not move beyond noise and, where the structure moves, hardly beside it, shape (P,)."""
        limit = np.maximum(_STILL * self.structure_px, self.noise_px) if self.tells else self.noise_px
        return np.asarray((self.moved_px <= limit) & ~self.clear_of_noise)


def judge_motion(tried: list[Tried], on_face: BoolArray) -> Motion:
    """How candidates move beyond noise and beyond what all that lies off the face does alike.

    Parameters
    ----------
    tried
        Trial tracks of every view.
    on_face
        Which of the P candidates lie on the structure's face, shape (P,).

    Notes
    -----
    A camera that moves moves everything. The median motion of what lies off the face is taken out where three places or
    more show it and it makes them calmer.
    """
    rows = [_excess(_steadied(one, ~on_face)) for one in tried]
    moved, noise = (np.array(part) for part in zip(*rows, strict=True))
    most = np.argmax(np.nan_to_num(moved, nan=-1.0), axis=0)
    moved_px, noise_px = (part[most, np.arange(len(on_face))] for part in (moved, noise))
    face, around = (np.isfinite(moved_px) & part for part in (on_face, ~on_face))
    if not face.any():
        return Motion(moved_px, noise_px, 0.0, tells=False)
    usual = float(np.percentile(moved_px[face], _BETTER))
    beside = float(np.median(moved_px[around])) if around.any() else 0.0
    tells = bool(usual > _CLEAR * max(float(np.median(noise_px[face])), beside))
    # An abutment on the plane of the face does not make the structure's motion less.
    moving = face & (moved_px > _CLEAR * noise_px) if tells else face
    return Motion(moved_px, noise_px, float(np.percentile(moved_px[moving], _BETTER)), tells)


def _steadied(tried: Tried, off_face: BoolArray) -> Tried:
    """Trial tracks without the motion that most of what lies off the face shares."""
    around = tried.moved[:, off_face & (tried.followed > 0)]
    if around.shape[1] < _FEWEST_STILL:
        return tried
    seen: BoolArray = np.asarray(np.isfinite(around).any(axis=(1, 2)))
    common = np.where(seen[:, None], np.nanmedian(np.where(seen[:, None, None], around, 0.0), axis=1), 0.0)
    calmer = np.nanmedian(np.nanstd(around - common[:, None], axis=0))
    if not calmer < np.nanmedian(np.nanstd(around, axis=0)):
        return tried
    return replace(tried, moved=tried.moved - common[:, None])


def _excess(tried: Tried) -> tuple[FloatArray, FloatArray]:
    """Root mean square motion beyond noise, and noise, shape (P,) [px] each."""
    seen: BoolArray = np.asarray(np.isfinite(tried.moved).all(axis=2))
    square = np.sum(np.where(seen[..., None], tried.moved, 0.0) ** 2, axis=(0, 2)) / np.maximum(seen.sum(axis=0), 1)
    noise = np.einsum("pii->p", tried.covariance)
    moved = np.where(seen.any(axis=0), np.sqrt(np.maximum(square - noise, 0.0)), np.nan)
    return moved, np.sqrt(noise)


def choose_spread_along(along: FloatArray, cost: FloatArray, usable: BoolArray, count: int) -> list[int]:
    """The best candidate of each of equal parts of the span; where parts have none, the farthest from those taken.

    Parameters
    ----------
    along
        Place along the span, shape (P,) [m].
    cost
        What makes one worse than another, shape (P,), in any unit.
    usable
        Which may be taken, shape (P,).
    count
        Number wanted; fewer where fewer are usable, or only close to others: two are half a part apart at least.

    Returns
    -------
    rows
        Indices in their order along the span.

    Examples
    --------
    >>> along, cost = np.array([0.0, 0.4, 3.0, 9.5, 10.0]), np.array([2.0, 1.0, 1.0, 1.0, 3.0])
    >>> choose_spread_along(along, cost, np.ones(5, dtype=bool), 2)
    [1, 3]
    >>> choose_spread_along(along, cost, np.ones(5, dtype=bool), 4)
    [1, 2, 3]
    """
    rows = np.flatnonzero(usable & np.isfinite(along) & np.isfinite(cost))
    if not rows.size or count < 1:
        return []
    start, length = along[rows].min(), max(float(np.ptp(along[rows])), 1e-9) / count
    part = np.minimum(((along[rows] - start) / length).astype(int), count - 1)
    chosen: list[int] = []

    def apart() -> FloatArray:
        """How far each lies from those taken [m]."""
        return np.asarray(np.abs(along[rows][:, None] - along[chosen]).min(axis=1, initial=np.inf))

    for one in range(count):
        free = np.flatnonzero((part == one) & (apart() >= length / 2))
        if free.size:
            chosen.append(int(rows[free[np.argmin(cost[rows[free]])]]))
    while len(chosen) < count and (distance := apart()).max() >= length / 2:
        chosen.append(int(rows[np.argmax(distance)]))
    return sorted(chosen, key=lambda row: float(along[row]))


def choose_spread_out(pixels: FloatArray, cost: FloatArray, usable: BoolArray, count: int) -> list[int]:
    """The best candidate, then always the farthest from those taken, among the better half.

    Parameters
    ----------
    pixels
        Places in a picture, shape (P, 2) [px].
    cost, usable, count
        As of `choose_spread_along`.

    Examples
    --------
    >>> pixels, cost = np.array([[0.0, 0.0], [9.0, 0.0], [400.0, 300.0]]), np.array([1.0, 1.5, 2.0])
    >>> choose_spread_out(pixels, cost, np.ones(3, dtype=bool), 2)
    [0, 2]
    """
    rows = np.flatnonzero(usable & np.isfinite(cost))
    rows = rows[np.argsort(cost[rows], kind="stable")][: max(2 * count, (rows.size + 1) // 2)]
    chosen = [int(row) for row in rows[: min(count, 1)]]
    while chosen and len(chosen) < min(count, rows.size):
        left = np.setdiff1d(rows, chosen)
        apart = np.linalg.norm(pixels[left][:, None] - pixels[chosen], axis=2).min(axis=1)
        chosen.append(int(left[np.argmax(apart)]))
    return chosen
