"""Whitened parameters and robust residuals of the site adjustment, and their derivatives."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig

__all__ = [
    "OUTLIER",
    "ROBUST_STD",
    "STEP",
    "RigParameters",
    "bend",
    "differentiate",
    "differentiate_centrally",
    "factor_prior",
]

ROBUST_STD = 3.0
"""Residual over its standard deviation from which the loss grows linearly [1]."""
OUTLIER = 1e3
"""Residual of what has no value [standard deviations]."""
STEP = 1e-8
"""Of a derivative by forward differences [1]."""
_RIGS_KEPT = 64
_LENS = "principal point and distortion"
_SOURCES = {"log_focal": "focal", "cx": _LENS, "cy": _LENS, "k1": _LENS}
"""What a parameter of the rig belongs to; the others are the pose's."""
_FOCAL_REACH = 3.0
"""Largest change of a logarithm of a focal length that distortion follows: a factor of twenty is only a trial step."""


class RigParameters:
    """Whitened parameters of the cameras, each with a standard normal prior.

    Parameters
    ----------
    start
        Cameras whose ``covariance`` is the prior of their parameters; a parameter with zero variance is held fixed.

    Attributes
    ----------
    factor
        Factor of the prior, from the whitened parameters to those of the rig, shape (10 V, size).
    size
        Number of whitened parameters.
    """

    def __init__(self, start: Rig) -> None:
        self._start = start
        self._rigs: dict[bytes, Rig] = {}
        # Most steps of a derivative move one camera alone.
        self._cameras = list(start.cameras)
        self._steps = np.zeros((len(start), len(CAMERA_PARAMETERS)))
        self.factor = factor_prior(np.asarray(start.covariance))
        self.size = self.factor.shape[1]

    def rig(self, inner: FloatArray) -> Rig:
        """Cameras at these parameters.

        Parameters
        ----------
        inner
            Whitened parameters, shape (size,).
        """
        # Making one costs as much as all residuals, and derivatives ask for the same ones again and again.
        key = inner.tobytes()
        if key not in self._rigs:
            if len(self._rigs) >= _RIGS_KEPT:
                self._rigs.clear()
            for view, step in enumerate(self._step_to(inner).reshape(self._steps.shape)):
                if not np.array_equal(step, self._steps[view]):
                    self._cameras[view] = self._start.cameras[view].perturbed(step)
                    self._steps[view] = step
            self._rigs[key] = replace(self._start, cameras=tuple(self._cameras))
        return self._rigs[key]

    def sources(self) -> dict[str, list[int]]:
        """Whitened parameters by what was stated of them: the lens of each view, and its pose where it has a prior."""
        covariance, count = np.asarray(self._start.covariance), len(CAMERA_PARAMETERS)
        free = np.flatnonzero(np.diag(covariance) > 0)
        found: dict[str, list[int]] = {}
        for index, parameter in enumerate(free):
            view, kind = self._start.names[parameter // count], CAMERA_PARAMETERS[parameter % count]
            found.setdefault(f"{_SOURCES.get(kind, 'pose')} {view}", []).append(index)
        return found

    def _step_to(self, inner: FloatArray) -> FloatArray:
        """Change of the rig's parameters, shape (10 V,); that of the distortion keeps its pixels.

        A prior of k1 says by how much a lens moves the pixels at the corner of the image. With a focal length that is
        uncertain itself, the same pixels are another k1: it grows with the square of the focal length.
        """
        step = self.factor @ inner
        focal, k1 = (step[CAMERA_PARAMETERS.index(name) :: len(CAMERA_PARAMETERS)] for name in ("log_focal", "k1"))
        k1 *= np.exp(2 * np.clip(focal, -_FOCAL_REACH, _FOCAL_REACH))
        return np.asarray(step)

    def common_focal(self) -> tuple[FloatArray, float]:
        """Parameters of all focal lengths one prior standard deviation longer, and that deviation.

        Returns
        -------
        direction, std
            Shape (size,); and the mean relative standard deviation [1].
        """
        stds = np.linalg.norm(self.factor[:: len(CAMERA_PARAMETERS)], axis=1)
        wanted = np.zeros(len(self.factor))
        wanted[:: len(CAMERA_PARAMETERS)] = stds
        return np.asarray(np.linalg.pinv(self.factor) @ wanted), float(stds.mean())


def bend(scaled: FloatArray) -> FloatArray:
    """Residuals with the pseudo-Huber loss: quadratic near zero, linear beyond three standard deviations.

    A trial step may change the distortion so much that a pixel has no ray: it counts as a gross outlier.

    Parameters
    ----------
    scaled
        Residuals over their standard deviations, any shape [1].
    """
    known = np.where(np.isfinite(scaled), scaled, OUTLIER)
    # Not sqrt(1 + x) - 1, of which nothing is left near zero: the derivative at an exact solution would be lost.
    return np.asarray(known * np.sqrt(2 / (np.sqrt(1 + known**2 / ROBUST_STD**2) + 1)))


def differentiate(
    function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int, *, step: float = STEP
) -> FloatArray:
    """Derivative with respect to the first ``count`` parameters by forward differences, shape (residuals, count).

    The step is small because priors of the pose are wide: with a step of a millionth of them the curvature of the
    residuals would end the iterations too early.

    Parameters
    ----------
    function
        From parameters (M,) to residuals (R,) [1].
    z
        Parameters, shape (M,) [1].
    count
        Number of parameters that move the residuals.
    step
        Change of each parameter [1].
    """
    base = function(z)
    columns = [np.empty((base.size, 0))]
    for index in range(count):
        shift = np.zeros_like(z)
        shift[index] = step
        columns.append((function(z + shift) - base)[:, None] / step)
    return np.concatenate(columns, axis=1)


def differentiate_centrally(function: Callable[[FloatArray], FloatArray], z: FloatArray, count: int) -> FloatArray:
    """Derivative of residuals that include a triangulation, whose rounding errors need a longer step.

    Central differences, shape (residuals, count).

    Parameters
    ----------
    function
        From parameters (M,) to residuals (R,) [1].
    z
        Parameters, shape (M,) [1].
    count
        Number of parameters that move the residuals.
    """
    step = 1e-6
    return np.stack(
        [(function(z + shift) - function(z - shift)) / (2 * step) for shift in step * np.eye(z.size)[:count]], axis=1
    )


def factor_prior(covariance: FloatArray) -> FloatArray:
    """Factor L with ``covariance = L L^T``, without the columns of parameters that are held fixed.

    Parameters
    ----------
    covariance
        Covariance of N parameters, shape (N, N), in their units.
    """
    free = np.flatnonzero(np.diag(covariance) > 0)
    factor = np.zeros((covariance.shape[0], free.size))
    if free.size:
        scale = np.sqrt(np.diag(covariance)[free])
        correlation = covariance[np.ix_(free, free)] / np.outer(scale, scale)
        # A prior that comes from an earlier adjustment may be singular to rounding.
        lower = cholesky(correlation + 1e-12 * np.eye(free.size), lower=True)
        factor[free] = scale[:, None] * lower
    return factor
