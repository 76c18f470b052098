"""What is to be expected of a lens, from lenses like it: means of ever narrower groups, each shrunk to the one above.

A lens is looked up from its kind of camera down to its brand, model, mode, format and state of stabilisation. At each
level the mean of the group is weighed against what the level above expects: with few calibrators the model counts
little, with many its brand does (empirical Bayes [1]_).

References
----------
.. [1] Efron, B., Morris, C. (1975). Data analysis using Stein's estimator and its generalizations. Journal of the
   American Statistical Association 70(350), 311-319.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.profiles.table import ProfileTable, Scatter
from vfm_sdm.inputs.profiles.words import CameraClass, Setting

__all__ = [
    "LEVELS",
    "Expected",
    "LensKey",
    "Moments",
    "chain_of",
    "collect_moments",
    "expect",
    "shared_words",
    "shrink",
]

LEVELS = {
    "class": ("kind",),
    "any": ("kind", "brand", "model", "aspect", "stabilised"),
    "mode": ("kind", "of the mode", "brand", "model", "aspect", "stabilised"),
    "film": ("kind", "brand", "model", "aspect", "film", "stabilised"),
}
"""Levels from coarse to fine, by what is known of the mode: nothing but the kind of camera, no mode, a word for the
field of view, or a focal length. Under ``mode`` all levels from the second on share the word."""
_NONE = 1e-12
"""Takes the place of no calibrators, and of no variance."""


@dataclass(frozen=True)
class LensKey:
    """What a lens is looked up by; names as `vfm_sdm.inputs.profiles.words.plain` gives them, empty where unknown."""

    kind: CameraClass
    brand: str = ""
    model: str = ""
    setting: Setting = field(default_factory=Setting)


@dataclass(frozen=True, eq=False)
class Moments:
    """What L levels hold of some quantity.

    Parameters
    ----------
    levels
        Their names.
    count, mean
        Number and mean of the calibrators' values, shape (L,) [1].
    squares
        Sum of squared deviations from the mean at the finest level [1].
    """

    levels: tuple[str, ...]
    count: FloatArray
    mean: FloatArray
    squares: float


@dataclass(frozen=True)
class Expected:
    """Mean and standard deviation of a quantity of a lens [1]."""

    mean: float
    std: float


def chain_of(key: LensKey) -> str:
    """Name of the chain of `LEVELS` that a lens is looked up by.

    Parameters
    ----------
    key
        What is known of the lens.

    Examples
    --------
    >>> chain_of(LensKey(CameraClass.ACTION, "gopro", "hero5black", Setting(mode="linear")))
    'mode'
    """
    if key.setting.film_mm is not None:
        return "film"
    if key.setting.mode:
        return "mode"
    return "any" if key.brand else "class"


def _levels(key: LensKey, chain: str) -> list[tuple[str, dict[str, str]]]:
    """Names of the levels of a chain as far as the key goes, each with the words that its groups share."""
    setting = key.setting
    known = {
        "kind": str(key.kind),
        "brand": key.brand,
        "model": key.model,
        "aspect": setting.aspect,
        "film": "" if setting.film_mm is None else str(round(setting.film_mm)),
        "stabilised": "" if setting.stabilised is None else "on" if setting.stabilised else "off",
    }
    shared: dict[str, str] = {}
    found = []
    for level in LEVELS[chain]:
        if level == "of the mode":
            shared = {**shared, "mode": setting.mode}
        elif not known[level]:
            # What is not known may be anything: the level above stands for it. Below an unknown model nothing is known.
            if level in ("brand", "model"):
                break
            continue
        else:
            shared = {**shared, level: known[level]}
        found.append((level, shared))
    return found


def shared_words(key: LensKey, level: str) -> dict[str, str]:
    """Words that the groups of a level share with a key, by column.

    Parameters
    ----------
    key
        What is known of the lens.
    level
        A level of its chain.
    """
    return dict(_levels(key, chain_of(key)))[level]


def collect_moments(
    table: ProfileTable, key: LensKey, *, values: FloatArray, squares: FloatArray, chain: str = "", order: int = 0
) -> Moments:
    """Number, mean and scatter of calibrators at every level of a lens.

    Parameters
    ----------
    table
        Groups of calibrations.
    key
        What is known of the lens.
    values, squares
        Mean of each group, and its sum of squared deviations, shape (G,) each.
    chain
        Chain of `LEVELS`; that of the key when left out.
    order
        Only groups with this number of radial coefficients; with 0 all that have some.

    Notes
    -----
    Along the chain ``film`` values are those of the logarithm of a focal length less that of the named one, so that
    groups with other focal lengths tell of the camera.
    """
    chain = chain or chain_of(key)
    usable = table.order == order if order else table.order > 0
    if chain == "film":
        usable &= table.film_mm > 0
    levels = _levels(key, chain)
    count, mean, scatter = np.zeros(len(levels)), np.zeros(len(levels)), np.zeros(len(levels))
    for place, (_, shared) in enumerate(levels):
        chosen = usable & table.same(shared)
        weights, own = table.calibrators[chosen], values[chosen]
        count[place] = weights.sum()
        if count[place]:
            mean[place] = weights @ own / count[place]
            scatter[place] = squares[chosen].sum() + weights @ (own - mean[place]) ** 2
    names = tuple(name for name, _ in levels)
    if names[-1] == "stabilised" and not count[-1]:
        # Nobody says it of these lenses: all states are in the level above, and the one that is known among them.
        names, count, mean, scatter = names[:-1], count[:-1], mean[:-1], scatter[:-1]
    return Moments(names, count, mean, float(scatter[-1]))


def expect(moments: Moments, scatter: Scatter, *, unknown: Sequence[str] = ()) -> Expected:
    """What is to be expected of a lens, before the interval is widened to hold.

    Parameters
    ----------
    moments
        What its levels hold.
    scatter
        How much lenses of its kind differ.
    unknown
        Levels that are not known and about which the lens may differ as well.

    Notes
    -----
    From coarse to fine, with the expectation ``m`` of variance ``V`` of the level above and the standard deviation
    ``t`` of means at this level, ``m <- m + g (y - m)`` and ``V <- (1 - g) (V + t^2)``, with the gain
    ``g = (V + t^2) / (V + t^2 + s^2 / n)`` of a group with mean ``y`` of ``n`` calibrators. Their variance ``s^2`` is
    that of the kind, together with what the finest group itself shows, and at coarse levels that of all levels below.

    Examples
    --------
    >>> moments = Moments(("kind", "brand"), np.array([100.0, 4.0]), np.array([0.0, 1.0]), 0.0)
    >>> round(expect(moments, Scatter({"brand": 0.1}, own=0.2, freedom=1e6, widen={})).mean, 2)
    0.5
    """
    beyond = sum(scatter.levels.get(name, 0.0) ** 2 for name in unknown)
    steps = np.array([scatter.levels.get(name, 0.0) for name in moments.levels[1:]])
    mean, std = shrink(moments.count, moments.mean, np.asarray(moments.squares), steps=steps, scatter=scatter)
    return Expected(float(mean), float(np.hypot(std, np.sqrt(beyond))))


def shrink(
    count: FloatArray, means: FloatArray, squares: FloatArray, *, steps: FloatArray, scatter: Scatter
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of `expect` for many lenses at once, shape (N,) each.

    Parameters
    ----------
    count, means
        Number and mean of the calibrators' values at L levels, shape (N, L).
    squares
        Sum of squared deviations at the finest level, shape (N,).
    steps
        Standard deviation of means about those of the level above, shape (L - 1,).
    scatter
        Its `own` and `freedom`.
    """
    freedom = np.maximum(count[..., -1] - 1, 0.0)
    own = (scatter.freedom * scatter.own**2 + squares) / (scatter.freedom + freedom)
    mean, variance = means[..., 0], np.zeros_like(means[..., 0])
    below = np.append(np.cumsum(steps[::-1] ** 2)[::-1], 0.0)
    for place, step in enumerate(steps, start=1):
        known = np.maximum(count[..., place], _NONE)
        variance = variance + step**2
        gain = variance / np.maximum(variance + (own + below[place]) / known, _NONE)
        mean = mean + gain * (means[..., place] - mean)
        variance = (1 - gain) * variance
    return mean, np.sqrt(variance + own)
