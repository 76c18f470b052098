"""What the table of profiles says of one lens: focal length, distortion and read-out, and how far that holds."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.inputs.profiles.hierarchy import Expected, LensKey, chain_of, collect_moments, expect, shared_words
from vfm_sdm.inputs.profiles.table import ProfileTable, Scatter, read_scatter, read_table
from vfm_sdm.inputs.profiles.words import CameraClass

__all__ = ["CROP", "LensProfile", "expect_any", "expect_focal", "expect_lens", "list_modes", "scatter_of"]

CROP = 0.913
"""Share of the picture's sides that stabilisation in the camera leaves, as official and other calibrations show it."""
_BENT = ("superview", "hyperview")
"""Modes that stretch the picture more at its sides than in its middle, which no radial distortion does."""
_MAJORITY = 0.5
_ENOUGH = 3
"""Calibrators from which on they tell the form of the distortion, and not their own noise."""
_Rows = npt.NDArray[np.bool_]
_LONGEST = float(np.log(0.5 / np.tan(np.radians(7))))
"""Logarithm of the focal length over the longer side of a lens that sees 14 degrees: structures are filmed from afar
with such, and calibrators of cameras for sports and phones have none."""


@dataclass(frozen=True, eq=False)
class LensProfile:
    """What is to be expected of a lens.

    Parameters
    ----------
    log_focal
        Logarithm of focal length over the picture's longer side: mean and standard deviation, of which 1.96 hold in 95
        of 100 [1].
    corner
        Radial coefficients times the corner's radius over the focal length, ``k_i c^2i``, shape (3,) [1].
    corner_std
        Standard deviation of the first of them [1].
    residual
        Root mean square of what they leave over the picture, over its longer side [1].
    readout_ms
        Time in which the sensor is read [ms]; 0 where nobody says.
    calibrators
        Number of independent calibrators of the finest level that has any.
    level
        Name of that level.
    described
        Whether radial distortion describes the lens.
    """

    log_focal: Expected
    corner: FloatArray
    corner_std: float
    residual: float
    readout_ms: float
    calibrators: int
    level: str
    described: bool = True


def scatter_of(scatter: Mapping[str, Mapping[str, Scatter]], kind: CameraClass, chain: str) -> Scatter:
    """Scatter of a kind of camera along a chain; that of another kind where too few calibrations of it are there.

    Parameters
    ----------
    scatter
        By kind and chain.
    kind, chain
        What is asked for.
    """
    kinds = (kind, CameraClass.ACTION, CameraClass.CAMERA)
    return next(scatter[str(one)][chain] for one in kinds if chain in scatter[str(one)])


def expect_focal(key: LensKey, table: ProfileTable, scatter: Scatter) -> Expected:
    """Logarithm of focal length over longer side, with an interval that holds.

    Parameters
    ----------
    key
        What is known of the lens.
    table
        Groups of calibrations.
    scatter
        Of its kind along its chain.
    """
    found = _expect_focal(key, table, scatter)
    if key.setting.stabilised is None:
        # Not to know the state never makes the interval shorter.
        states = [replace(key, setting=replace(key.setting, stabilised=state)) for state in (True, False)]
        std = max(_expect_focal(one, table, scatter).std for one in states)
        found = replace(found, std=max(found.std, std))
    return found


def _expect_focal(key: LensKey, table: ProfileTable, scatter: Scatter) -> Expected:
    """The same for the state of stabilisation as it is."""
    chain = chain_of(key)
    film_mm = np.where(table.film_mm > 0, table.film_mm, 1.0) if chain == "film" else np.ones(len(table))
    values = table.log_focal - np.log(film_mm)
    moments = collect_moments(table, key, values=values, squares=table.log_focal_squares)
    unknown = [] if key.setting.stabilised is not None else ["stabilised"]
    unknown += [name for name in ("brand", "model") if chain != "class" and not getattr(key, name)]
    found = expect(moments, scatter, unknown=unknown)
    seen = "model" in moments.levels and moments.count[moments.levels.index("model")] > 0
    state = "known" if key.setting.stabilised is not None else "unknown"
    factor = scatter.widen[state if seen or chain == "class" else "unseen"]
    named = 0.0 if chain != "film" or key.setting.film_mm is None else float(np.log(key.setting.film_mm))
    return Expected(found.mean + named, found.std * factor)


@cache
def expect_any() -> Expected:
    """Logarithm of focal length over longer side of a lens of which nothing is known.

    Notes
    -----
    Two standard deviations reach from the widest end of all kinds of cameras' 95 % intervals to the longest, or to a
    lens that sees 14 degrees.

    Examples
    --------
    >>> wide = expect_any()
    >>> [round(float(np.exp(wide.mean + n * wide.std)), 1) for n in (-2, 0, 2)]
    [0.3, 1.1, 4.1]
    """
    found = [expect_lens(LensKey(kind)).log_focal for kind in CameraClass]
    low = min(one.mean - NORMAL_95 * one.std for one in found)
    high = max(_LONGEST, *(one.mean + NORMAL_95 * one.std for one in found))
    return Expected((low + high) / 2, (high - low) / 4)


def expect_lens(
    key: LensKey,
    table: ProfileTable | None = None,
    scatter: Mapping[str, Mapping[str, Scatter]] | None = None,
) -> LensProfile:
    """What calibrations of this lens and of lenses like it let expect.

    Parameters
    ----------
    key
        What is known of the lens.
    table, scatter
        Groups of calibrations and how much lenses differ; those of the package when left out.

    Examples
    --------
    >>> from vfm_sdm.inputs.profiles.words import Setting
    >>> linear = expect_lens(LensKey(CameraClass.ACTION, "gopro", "hero7black", Setting("linear", None, False, "16:9")))
    >>> bool(0.4 < np.exp(linear.log_focal.mean) < 0.7), linear.described
    (True, True)
    """
    table = read_table() if table is None else table
    scatter = read_scatter() if scatter is None else scatter
    chain = chain_of(key)
    focal = expect_focal(key, table, scatter_of(scatter, key.kind, chain))
    ones = np.ones(len(table))
    moments = collect_moments(table, key, values=ones, squares=ones)
    finest = _finest(moments.count, 1)
    rows = _rows_like(table, key, moments.levels[finest])
    order = _order_of(table, _rows_like(table, key, moments.levels[_finest(moments.count, _ENOUGH)]))
    of_corner = scatter_of(scatter, key.kind, "corner")
    corner = [
        expect(
            collect_moments(table, key, values=table.corner[:, place], squares=table.corner_squares, order=order),
            of_corner,
        )
        for place in range(order)
    ]
    mean = np.array([one.mean for one in corner] + [0.0] * (3 - order))
    # Modes with other distortion are as probable where the mode is not known.
    away = np.abs(table.corner.sum(axis=1) - mean.sum())
    spread = _quantile_95(away, table.calibrators, rows & (table.order > 0)) / NORMAL_95
    undescribed = float(table.calibrators[rows & (table.order == 0)].sum())
    own = moments.levels[finest] not in ("kind", "of the mode", "brand")
    return LensProfile(
        focal,
        mean,
        max(corner[0].std * of_corner.widen["known"], spread),
        _weighted(table.residual, table.calibrators, rows & (table.order == order)),
        _weighted(table.readout_ms, table.calibrators, rows & (table.readout_ms > 0)),
        round(float(moments.count[finest])),
        moments.levels[finest],
        key.setting.mode not in _BENT and not (own and undescribed > _MAJORITY * table.calibrators[rows].sum()),
    )


def _finest(count: FloatArray, least: int) -> int:
    """The finest level with so many calibrators; the coarsest where none has."""
    return next((place for place in reversed(range(len(count))) if count[place] >= least), 0)


def _order_of(table: ProfileTable, rows: _Rows) -> int:
    """Number of radial coefficients of most calibrators of these groups whose lenses any describe."""
    weights = np.where(table.order[rows] > 0, table.calibrators[rows], 0.0)
    return int(np.bincount(table.order[rows], weights=weights, minlength=4).argmax()) if weights.any() else 1


def _rows_like(table: ProfileTable, key: LensKey, level: str) -> _Rows:
    """Groups that agree with a key down to a level, shape (G,), those that no distortion describes among them."""
    chosen = table.same(shared_words(key, level))
    return chosen & (table.film_mm > 0) if chain_of(key) == "film" else chosen


def _weighted(values: FloatArray, weights: FloatArray, rows: _Rows) -> float:
    return float(np.average(values[rows], weights=weights[rows])) if rows.any() else 0.0


def _quantile_95(values: FloatArray, weights: FloatArray, rows: _Rows) -> float:
    """What 95 of 100 of these values do not exceed; 0 where there are none."""
    order = np.argsort(values[rows])
    share = np.cumsum(weights[rows][order])
    return float(values[rows][order][np.searchsorted(share, 0.95 * share[-1])]) if len(order) and share[-1] else 0.0


def list_modes(key: LensKey) -> list[str]:
    """Words for the field of view that calibrators used of a model and picture format, sorted.

    Parameters
    ----------
    key
        The camera; its own mode does not count.

    Examples
    --------
    >>> from vfm_sdm.inputs.profiles.words import Setting
    >>> list_modes(LensKey(CameraClass.ACTION, "gopro", "hero7black", Setting(aspect="16:9")))
    ['linear', 'superview', 'wide']
    """
    table = read_table()
    rows = table.same({"brand": key.brand, "model": key.model, "aspect": key.setting.aspect}) & (table.order > 0)
    return sorted({str(mode) for mode in table.mode[rows]} - {""})
