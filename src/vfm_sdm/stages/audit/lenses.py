"""What a wrong lens could do to the scale without being noticed."""

from collections.abc import Iterator

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = ["find_unseen_lens_error"]

_NOTICED = 4.0 + 1.28
"""Error of a lens that a test at four standard deviations notices in nine of ten cases [standard deviations]."""
_CALIBRATED_STD = 0.005
"""Relative standard deviation up to which a focal length was calibrated: a data sheet or EXIF does not tell it."""
_LARGEST = float(np.log(2.0))
"""Largest error of a lens that is thought of: 35 mm equivalents and sides of a picture are beside it by less."""


def find_unseen_lens_error(cameras: CameraSolution, slope: FloatArray) -> float:
    """Largest relative error of a scale that a wrong lens could cause without a contradiction [1].

    Parameters
    ----------
    cameras
        Adjusted cameras with their covariance and the focal lengths' priors.
    slope
        Change of the logarithm of the scale with parameters of the cameras and axes, shape (10 V + 3,).

    Returns
    -------
    error
        Of one lens, or of all together as with a wrong sensor width; 0 where no lens rests on a statement.

    Notes
    -----
    External reliability [1]_: with weights P of the stated focal lengths, their covariance C after the adjustment and
    C_0 before, an error e d in them changes the scale by ``slope C P d e``, and is noticed from
    ``e = delta / sqrt(d' P (C_0 - C) P d)`` on.

    References
    ----------
    .. [1] Baarda, W. (1968). A testing procedure for use in geodetic networks. Netherlands Geodetic Commission,
       Publications on Geodesy 2(5).
    """
    if cameras.rig is None or cameras.covariance is None:
        return 0.0
    priors = {
        q.name.removeprefix("focal "): q.prior_std / q.prior for q in cameras.quantities if q.name.startswith("focal ")
    }
    stated = [(len(CAMERA_PARAMETERS) * n, priors.get(view, 0.0)) for n, view in enumerate(cameras.rig.names)]
    known = [(index, std) for index, std in stated if std > _CALIBRATED_STD]
    if not known:
        return 0.0
    indices, stds = [index for index, _ in known], np.array([std for _, std in known])
    weight = np.diag(stds**-2.0)
    checked = weight @ (np.diag(stds**2) - cameras.covariance[np.ix_(indices, indices)]) @ weight
    pull = slope @ cameras.covariance[:, indices] @ weight
    return max(_reach(pull, checked, one) for one in _directions(len(known)))


def _directions(count: int) -> Iterator[FloatArray]:
    """Errors of all lenses together, and of each alone, shape (V,)."""
    yield np.ones(count)
    yield from np.eye(count)


def _reach(pull: FloatArray, checked: FloatArray, one: FloatArray) -> float:
    """Change of the scale by the largest error along a direction that stays unnoticed."""
    weight = float(one @ checked @ one)
    unseen = _NOTICED / np.sqrt(weight) if weight > 0 else np.inf
    return abs(float(pull @ one)) * min(unseen, _LARGEST)
