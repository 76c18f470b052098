"""Noise levels of the sensor and of the video, as the record shows them, and how well it does."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from vfm_sdm.analysis.fusion.drive import Drive
from vfm_sdm.analysis.fusion.kernels import SLOW, filter_forward, smooth_backward
from vfm_sdm.analysis.fusion.still_points import VideoErrors
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.signals.derivatives import curvature

__all__ = ["Levels", "Nodes", "Posterior", "estimate_levels", "high_noise_std"]

_SENSOR_SPREAD = (0.5, 3.0)
"""What is known beforehand of the sensor's noise and of its bias' wandering: standard deviations of logarithms."""
_EXPOSURE_SPREAD = 1.5
"""Of the log odds of the exposure over the time from frame to frame."""
_LEAST_CURVATURE = 0.5
"""Of the posterior, in those of what is known beforehand."""


@dataclass(frozen=True)
class Levels:
    """Noise of the sensor and of the video.

    Parameters
    ----------
    sensor_density
        Standard deviation of the sensor's noise in a band of 1 Hz (two-sided) [mm/s2/sqrt(Hz)].
    wander_density
        How its bias wanders: standard deviation of its change in a second [mm/s2].
    video_factor
        Standard deviation of what differs from frame to frame, over the stated one [1].
    slow_factor
        Standard deviation of the slow error, over that of what differs from frame to frame [1].
    slow_s
        Correlation time of the slow error [s].
    exposure_share
        Exposure over the time from frame to frame [1].
    """

    sensor_density: float
    wander_density: float
    video_factor: float
    slow_factor: float
    slow_s: float
    exposure_share: float

    def noise(self, std_mm: float) -> FloatArray:
        """Parameters of the filter (`vfm_sdm.analysis.fusion.kernels.filter_forward`).

        Parameters
        ----------
        std_mm
            Typical stated standard deviation of the video [mm].
        """
        slow = (self.slow_factor * self.video_factor * std_mm) ** 2
        return np.array([self.sensor_density**2, self.wander_density**2, slow, 1 / self.slow_s])


@dataclass(frozen=True, eq=False)
class Nodes:
    """A stretch of both records at the nodes of the filter.

    Parameters
    ----------
    steps
        Of `vfm_sdm.analysis.fusion.drive.Drive.steps`, shape (N, 6 + 2 A).
    values_mm, stds_mm
        The video and its stated standard deviation, shape (N,) [mm]; NaN where there is none.
    exposed
        Of `vfm_sdm.analysis.fusion.drive.Drive.exposed`, shape (9, N, 1 + A) [mm].
    state, covariance
        Before the first node, shapes (n,) and (n, n).
    """

    steps: FloatArray
    values_mm: FloatArray
    stds_mm: FloatArray
    exposed: FloatArray
    state: FloatArray
    covariance: FloatArray

    @property
    def std_mm(self) -> float:
        """Typical stated standard deviation of the video [mm]."""
        return float(np.nanmedian(self.stds_mm))

    def arrays(self, levels: Levels) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Arguments of the filter with these levels."""
        variances = np.square(levels.video_factor * self.stds_mm)
        exposed = np.ascontiguousarray(Drive.share_exposed(self.exposed, levels.exposure_share))
        return self.steps, self.values_mm, variances, exposed

    def likelihood(self, levels: Levels) -> float:
        """Log-likelihood of the video with these levels."""
        return self._filter(levels, 0)[0]

    def run(self, levels: Levels) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """State and covariance at the end, innovations and their expected standard deviations."""
        _, innovations, stds, state, covariance, _ = self._filter(levels, 0)
        return state, covariance, innovations, stds

    def smooth(self, levels: Levels) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """State and covariance at the end; displacement [mm] and its variance [mm2] at every node between values."""
        *_, state, covariance, kept = self._filter(levels, int(np.isfinite(self.values_mm).sum()))
        return state, covariance, *smooth_backward(self.arrays(levels), levels.noise(self.std_mm), *kept)

    def _filter(
        self, levels: Levels, keep: int
    ) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        noise, size = levels.noise(self.std_mm), len(self.state)
        state, covariance = self.state.copy(), self.covariance.copy()
        covariance[SLOW, SLOW] = noise[2]
        kept = np.zeros((keep, size)), np.zeros((keep, size, size))
        total, innovations, stds = filter_forward(self.arrays(levels), noise, state, covariance, *kept)
        return float(total), innovations, stds, state, covariance, kept


@dataclass(frozen=True, eq=False)
class Posterior:
    """What the record tells of the levels.

    Parameters
    ----------
    best
        The most probable levels.
    around
        Levels that lie around them as the record leaves them open: their mean and scatter are those of the
        distribution.
    """

    best: Levels
    around: tuple[Levels, ...]


def high_noise_std(acceleration: FloatArray) -> float:
    """Standard deviation of white noise that the quiet half of a record's spectrum would be part of.

    Parameters
    ----------
    acceleration
        Record, any unit, shape (T,).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> motion = np.sin(np.arange(4000) / 5)
    >>> bool(0.8 < high_noise_std(motion + 0.01 * rng.standard_normal(4000)) / 0.01 < 1.2)
    True
    """
    window = np.hanning(len(acceleration))
    power = np.abs(np.fft.rfft((acceleration - acceleration.mean()) * window)[1:]) ** 2 / np.sum(window**2)
    # Of exponentially distributed powers a quarter lies below ln(4/3) of the mean.
    return float(np.sqrt(np.quantile(power, 0.25) / np.log(4 / 3)))


def estimate_levels(nodes: Nodes, density: float, errors: VideoErrors, start: Levels | None = None) -> Posterior:
    """Levels by their posterior: likelihood of the video's innovations and what is known of instruments at large.

    Parameters
    ----------
    nodes
        Nodes at the frames of the video.
    density
        First guess of the sensor's noise [mm/s2/sqrt(Hz)], of its record.
    errors
        What is known of the video's errors.
    start
        Levels from which the search starts.

    Notes
    -----
    The noise of the sensor is known to a factor of 1.6 beforehand, the wandering of its bias to one of 20. Where the
    record says more that does not matter; where it does not, the width is part of the result's uncertainty. The
    posterior is taken as normal in the logarithms, with the curvature at its top [1]_.

    References
    ----------
    .. [1] Harvey, A. C. (1989). Forecasting, structural time series models and the Kalman filter. Cambridge, ch. 3.
    """
    units = (density, 0.1 * density, 1.0, 1.0, 1.0)
    centre = np.array([0.0, 0.0, *errors.centre, 0.0])
    spread = np.array([*_SENSOR_SPREAD, *errors.spread, _EXPOSURE_SPREAD])

    def levels_of(z: FloatArray) -> Levels:
        logs = centre + spread * z
        sensor, wander, video, slow, seconds = (u * float(np.exp(x)) for u, x in zip(units, logs[:-1], strict=True))
        return Levels(sensor, wander, video, slow, seconds, float(1 / (1 + np.exp(-logs[-1]))))

    def cost(z: FloatArray) -> float:
        return 0.5 * float(z @ z) - nodes.likelihood(levels_of(z))

    first = np.zeros(len(centre))
    if start is not None:
        share = start.exposure_share
        logs = [np.log(v / u) for v, u in zip(list(vars(start).values())[:-1], units, strict=True)]
        first = (np.array([*logs, np.log(share / (1 - share))]) - centre) / spread
    found = minimize(cost, first, method="L-BFGS-B", bounds=[(-5, 5)] * len(first), options={"maxiter": 60})
    values, vectors = np.linalg.eigh(curvature(cost, found.x))
    # Never wider than what is known beforehand would leave it at twice the variance.
    shape = vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE))
    reach = np.sqrt(len(first))
    around = [levels_of(found.x + sign * reach * column) for column in shape.T for sign in (1, -1)]
    return Posterior(levels_of(found.x), tuple(around))
