"""Which statement is wrong where they contradict each other: every one freed in turn, the costs compared.

A lens stated as known to 2 %, a tape reading, a point on the face: each is a claim. Where they contradict, the claim
without which everything else agrees best is the most probable culprit (data snooping [1]_, with the multivariate form
for what has several values [2]_).

References
----------
.. [1] Baarda, W. (1968). A testing procedure for use in geodetic networks. Netherlands Geodetic Commission,
   Publications on Geodesy 2(5).
.. [2] Teunissen, P. J. G. (2006). Testing theory: an introduction, 2nd edition. Delft University Press, chapter 4.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.session import Lens

__all__ = ["AS_PROBABLE", "CULPRIT_STD", "Claim", "Suspect", "advise_on_lens", "list_suspects", "name_confusions"]

CULPRIT_STD = 4.0
"""Standard deviations from which a claim is named as wrong: by chance one of 15 in a run of a thousand."""
AS_PROBABLE = 4.0
"""Difference of two drops of the cost below which the data hardly tell two culprits apart."""
_LEAST_REDUNDANCY = 0.01
"""Share of a claim that the others must check for it to be tested."""
_ALIKE = 0.1
"""Relative distance within which a freed value agrees with what a confusion would give; 35 mm equivalents and picture
formats lie farther apart."""
_FACTORS = (
    (1000.0, "stated in millimetres"),
    (1e-3, "stated in kilometres, or divided by 1000 once too often"),
    (0.3048**-1, "stated in feet"),
    (16 / 9, "of the other side of a picture of 16 to 9, as EXIF of a turned picture gives it"),
    (9 / 16, "of the other side of a picture of 16 to 9, as EXIF of a turned picture gives it"),
    (-1.0, "stated with the other sign"),
)
"""What a value is stated too large by, and the confusion of which this is a sign."""
_FILM_WIDTH_MM = 36.0
_FILM_WIDTHS_MM = (35.0, 37.0)
_CROP_FACTORS = (1.5, 1.6, 2.0, 2.7)
"""Width of film over that of usual sensors: APS-C of two makers, four thirds, one inch."""
_NEAR_FACTOR = 0.05
"""Relative distance from a crop factor within which it is recognised; the factors lie farther apart but for two."""


@dataclass(frozen=True, eq=False)
class Claim:
    """A statement that may be wrong.

    Parameters
    ----------
    name, units
        What is stated, and its unit.
    stated, std
        Value and standard deviation [units]; NaN for one of several values.
    rows
        Change of all R residuals with an error of one standard deviation of it, shape (R, K) for K values [1].
    logarithmic
        Whether the standard deviation is relative.
    advice
        What to say where it is wrong.
    """

    name: str
    units: str
    stated: float
    std: float
    rows: FloatArray
    logarithmic: bool = False
    advice: str = ""

    def freed(self, error: float) -> float:
        """Value that the others give, from the error of the claim in its standard deviations [units]."""
        if self.logarithmic:
            return float(self.stated * np.exp(np.clip(self.std * error, -7, 7)))
        return float(self.stated + self.std * error)


@dataclass(frozen=True)
class Suspect:
    """A claim and what speaks against it.

    Parameters
    ----------
    name, units
        What is stated, and its unit.
    stated, freed
        Value as stated, and what all others give for it [units]; NaN for one of several values.
    freed_std
        Standard deviation of `freed` [units].
    drop
        By how much the cost falls without the claim, as standard deviations of one normal error [1].
    advice
        What was expected, what is stated, and what to do, where something was confused.
    rank
        The same before it is turned into probability, for order where that is zero: drop of the cost [1].

    Examples
    --------
    >>> Suspect("baseline", "m", 3.0, 3.2, 0.02, drop=6.5, rank=42.0).name
    'baseline'
    """

    name: str
    units: str
    stated: float
    freed: float
    freed_std: float
    drop: float
    rank: float
    advice: str = ""

    def sentence(self, others: Sequence["Suspect"] = ()) -> str:
        """What is most probably wrong, with the others that are nearly as probable."""
        words = f"most probably wrong: {self.name}"
        if np.isfinite(self.freed):
            words += (
                f", stated as {self.stated:.6g} {self.units}; everything else gives "
                f"{self.freed:.4g} +- {self.freed_std:.2g}"
            )
            words += "".join(f" (as if {one})" for one in name_confusions(self))
        words += f": {self.advice}" if self.advice else ""
        also = [one.name for one in others if one.name != self.name]
        return words + (f"; nearly as probable: {', '.join(also)}" if also else "")


def list_suspects(claims: Iterable[Claim], residuals: FloatArray, jacobian: FloatArray) -> list[Suspect]:
    """Every claim that the others check, the most probable culprit first.

    Parameters
    ----------
    claims
        Claims, with rows for R residuals.
    residuals, jacobian
        At the least-squares solution, shapes (R,) and (R, M) [1].

    Notes
    -----
    With the projector Q = I - J (J'J)^-1 J' onto what the parameters cannot explain, freeing a claim with rows B lowers
    the cost by r'B (B'QB)^-1 B'r, a draw from chi2 with as many degrees of freedom as B has columns where the claim is
    right.

    Examples
    --------
    >>> jacobian = np.ones((4, 1))
    >>> readings = np.array([1.0, 1.1, 0.9, 9.0])
    >>> claims = [Claim(f"reading {n}", "m", v, 1.0, np.eye(4)[:, [n]]) for n, v in enumerate(readings)]
    >>> worst, *_ = list_suspects(claims, readings.mean() - readings, jacobian)
    >>> worst.name, round(worst.freed, 3)
    ('reading 3', 1.0)
    """
    normal = np.linalg.inv(jacobian.T @ jacobian)
    found = []
    for claim in claims:
        seen = jacobian.T @ claim.rows
        checked = claim.rows.T @ claim.rows - seen.T @ normal @ seen
        if np.linalg.eigvalsh(checked)[-1] < _LEAST_REDUNDANCY:
            continue
        against = claim.rows.T @ residuals
        inverse = np.linalg.pinv(checked, rcond=_LEAST_REDUNDANCY, hermitian=True)
        rank = float(against @ inverse @ against)
        count = int(np.linalg.matrix_rank(checked, tol=_LEAST_REDUNDANCY, hermitian=True))
        # The larger of two tails: a sum of squares has one.
        drop = np.sqrt(rank) if count == 1 else float(norm.isf(max(chi2.sf(rank, count), 1e-300) / 2))
        single = claim.rows.shape[1] == 1
        freed = claim.freed(float((inverse @ against)[0])) if single else float("nan")
        unit = claim.std * (abs(freed) if claim.logarithmic else 1.0)
        std = unit * float(np.sqrt(inverse[0, 0])) if single else float("nan")
        found.append(Suspect(claim.name, claim.units, claim.stated, freed, std, float(drop), rank, claim.advice))
    return sorted(found, key=lambda one: (-one.drop, -one.rank))


def name_confusions(suspect: Suspect) -> Iterator[str]:
    """Simple confusions that would give a claim's value in place of the freed one.

    Parameters
    ----------
    suspect
        A claim with one value.

    Examples
    --------
    >>> list(name_confusions(Suspect("baseline", "m", 3780.0, 3.79, 0.01, drop=9.0, rank=81.0)))
    ['stated in millimetres']
    """
    if not np.isfinite(suspect.freed) or suspect.freed == 0:
        return
    of_lens, of_angle = suspect.name.startswith("focal"), suspect.units == "deg"
    for factor, words in _FACTORS:
        format_of_picture = "picture" in words
        if (factor < 0) != of_angle or format_of_picture != of_lens:
            continue
        expected = suspect.freed * factor
        if abs(suspect.stated - expected) < max(_ALIKE * abs(expected), 2 * abs(factor) * suspect.freed_std):
            yield words


def advise_on_lens(suspect: Suspect, lens: Lens | None) -> str:
    """What to do where a focal length and a sensor's width do not belong together; empty where they may.

    Parameters
    ----------
    suspect
        A focal length that everything else contradicts.
    lens
        What the session says of it.

    Examples
    --------
    >>> lens = Lens(focal_mm=26.0, sensor_width_mm=6.0)
    >>> advise_on_lens(Suspect("focal left", "px", 8320.0, 1390.0, 10.0, drop=30.0, rank=900.0), lens).split(",")[1]
    ' got focal_mm = 26 as of 35 mm film'
    """
    if lens is not None and lens.file is not None:
        return (
            "expected a pan clip filmed with the lens, zoom and mode of the recording, got a lens file of another one, "
            "do: film the pan clip again just before or after the recording, with focus and zoom locked"
        )
    if lens is None or lens.focal_mm is None or lens.sensor_width_mm is None or not np.isfinite(suspect.freed):
        return ""
    width = lens.sensor_width_mm

    def looks_like(factor: float) -> bool:
        away = abs(np.log(suspect.stated / suspect.freed / factor))
        return bool(away < max(_NEAR_FACTOR, 2 * suspect.freed_std / suspect.freed))

    if _FILM_WIDTHS_MM[0] <= width <= _FILM_WIDTHS_MM[1]:
        crops = [crop for crop in _CROP_FACTORS if looks_like(1 / crop)]
        said = " or ".join(f"{_FILM_WIDTH_MM / crop:.3g}" for crop in crops)
        return f"expected a sensor {said} mm wide, got that of 35 mm film, do: state its own width" if crops else ""
    if looks_like(_FILM_WIDTH_MM / width):
        return (
            f"expected the focal length of the lens itself, got focal_mm = {lens.focal_mm:g} as of 35 mm film, do: "
            f"state the lens's own, or sensor_width_mm = {_FILM_WIDTH_MM:g} beside it"
        )
    return ""
