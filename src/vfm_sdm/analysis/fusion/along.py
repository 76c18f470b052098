"""Fusion along one axis: the filter's nodes, its constants, the levels of noise, and the smoothed displacement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.analysis.fusion.drive import Drive, keep_motion
from vfm_sdm.analysis.fusion.kernels import BIAS, DRIFT, GAINS, LAG
from vfm_sdm.analysis.fusion.levels import Levels, Nodes, Posterior, estimate_levels, high_noise_std
from vfm_sdm.analysis.fusion.still_points import ASSUMED, VideoErrors
from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Alignment", "Fused", "Record", "Video", "fuse_along"]

_BIAS_STD = 50.0
"""Of a bias after the mean was taken off [mm/s2]: 5 mg."""
_MOST_FRAMES = 6000
"""Frames, from the middle, from which levels of noise are estimated."""
_ROUNDS = 6
_SETTLED = 0.05
"""Change of lag and gain, in their standard deviations, at which the linearised filter is repeated no more."""
_LOST_S = 0.05
"""Correlation time of motion that a sensor missed [s]."""
_GAP = 1.5
"""Frame intervals beyond which there is a gap."""
_WIDE = 100.0
"""Standard deviations of the first value of the video within which displacement begins."""
_WIDEST_LAG_S = 2e-3
"""Least standard deviation of the lag with which the filter begins [s]."""


@dataclass(frozen=True, eq=False)
class Record:
    """Acceleration of a sensor on its own clock.

    Parameters
    ----------
    time_s
        Shape (T,) [s].
    acceleration
        With gravity, shape (T, A) [mm/s2].
    known
        Samples that were recorded and within the sensor's range, shape (T,).
    axes
        Names of the A axes.
    """

    time_s: FloatArray
    acceleration: FloatArray
    known: BoolArray
    axes: tuple[str, ...]

    @property
    def interval_s(self) -> float:
        """Time from sample to sample [s]."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)


@dataclass(frozen=True, eq=False)
class Video:
    """Displacement along one axis from the video.

    Parameters
    ----------
    time_s
        Shape (T,) [s].
    values_mm, stds_mm
        With their stated standard deviation, shape (T,) [mm]; NaN where there is none.
    """

    time_s: FloatArray
    values_mm: FloatArray
    stds_mm: FloatArray

    @property
    def interval_s(self) -> float:
        """Time from frame to frame [s]."""
        return float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True)
class Alignment:
    """How a sensor's clock and sensitivity relate to the video.

    Parameters
    ----------
    rate_ratio, offset_s
        A stamp t of the sensor is ``t * rate_ratio + offset_s`` on the video's clock [1, s].
    lag_std_s
        Standard deviation of the lag [s].
    drift_std
        Standard deviation of the rate of the clocks [1].
    at_s
        Time on the video's clock at which the lag is known as said [s].
    gain_std, cross_std
        Standard deviations of the gain along the axis itself and along others [1].
    """

    rate_ratio: float
    offset_s: float
    lag_std_s: float
    drift_std: float
    at_s: float
    gain_std: float
    cross_std: float

    def on_video(self, time_s: FloatArray) -> FloatArray:
        """Stamps of the sensor on the video's clock, shape (T,) [s]."""
        return np.asarray(time_s * self.rate_ratio + self.offset_s)

    @property
    def lag_s(self) -> float:
        """How much later an event of the video at ``at_s`` shows up on the sensor's clock [s]."""
        return (self.at_s - self.offset_s) / self.rate_ratio - self.at_s

    def shifted(self, lag_s: float, drift: float, at_s: float) -> "Alignment":
        """The alignment after a lag that is left at a time, and the drift of what is left.

        Parameters
        ----------
        lag_s, drift
            By how much events still happen later on the sensor's clock [s], and its growth [1].
        at_s
            When, on the video's clock [s].
        """
        offset_s = self.offset_s * (1 - drift) + drift * at_s - lag_s
        return replace(self, rate_ratio=self.rate_ratio * (1 - drift), offset_s=offset_s)


@dataclass(frozen=True, eq=False)
class Fused:
    """Fused displacement along one axis, and what was found of both instruments.

    Parameters
    ----------
    time_s
        Times of the sensor's samples from the first value of the video to the last, shape (N,) [s].
    places
        Numbers of these samples in the record, shape (N,).
    values_mm, stds_mm
        Displacement and its standard deviation, shape (N,) [mm].
    bridged
        Samples in a gap of the video, shape (N,).
    alignment
        Clocks as found; standard deviations are those after the fusion.
    gains, gain_stds
        Gain of every axis of the sensor, acceleration of the video over that of the sensor, shape (A,) [1].
    bias
        Bias at the end, mean of the record included [mm/s2].
    levels
        Noise of both.
    innovation_rms_mm
        Root mean square of what each value of the video is off the prediction from those before [mm].
    innovation_ratio
        The same in the standard deviations that the filter expects [1].
    worst_innovation, worst_s
        The largest one in these [1], and when [s].
    video_std_mm
        Standard deviation of a value of the video alone, slow error included [mm].
    slow_std_mm
        Standard deviation of that slow error [mm].
    exposure_s
        Exposure that the fast motion shows [s].
    own
        Number of the sensor's axis along which displacement is.
    size, size_std
        Gain of the sensor however it is turned: the length of the vector of gains, and its standard deviation [1].
    """

    time_s: FloatArray
    places: IntArray
    values_mm: FloatArray
    stds_mm: FloatArray
    bridged: BoolArray
    alignment: Alignment
    gains: FloatArray
    gain_stds: FloatArray
    bias: float
    levels: Levels
    innovation_rms_mm: float
    innovation_ratio: float
    worst_innovation: float
    worst_s: float
    video_std_mm: float
    slow_std_mm: float
    exposure_s: float
    own: int
    size: float
    size_std: float


def fuse_along(record: Record, video: Video, axis: str, alignment: Alignment, errors: VideoErrors = ASSUMED) -> Fused:
    """Displacement along one axis from both.

    Parameters
    ----------
    record
        The sensor's record.
    video
        The series of the video; at least one value.
    axis
        Axis of the record along which that is.
    alignment
        What is known of clock and sensitivity.
    errors
        What is known of the video's errors.

    Notes
    -----
    The filter is linear but for the lag times the gain; it is repeated about the lag and gain that it found. Levels of
    noise are estimated at the first and at the last round.
    """
    alignment = replace(alignment, lag_std_s=max(alignment.lag_std_s, _WIDEST_LAG_S))
    own = record.axes.index(axis)
    pair = _Pair.of(record, video, own, alignment)
    density = float(pair.noise_stds[own] * np.sqrt(record.interval_s))
    times = video.time_s[np.isfinite(video.values_mm)]
    now, gains = alignment, pair.first_gains
    nodes = pair.place_nodes(times, now, gains)
    posterior = estimate_levels(_cut_middle(nodes), density, errors)
    for _ in range(_ROUNDS):
        state, covariance = nodes.run(posterior.best)[:2]
        left = abs(state[[LAG, GAINS + own]]) / np.sqrt(np.diag(covariance)[[LAG, GAINS + own]])
        now, gains = now.shifted(state[LAG], state[DRIFT], times[-1]), gains + state[GAINS:]
        nodes = pair.place_nodes(times, now, gains)
        if left.max() < _SETTLED:
            break
    posterior = estimate_levels(_cut_middle(nodes), density, errors, posterior.best)
    return _smooth(pair, now, gains, posterior)


@dataclass(frozen=True, eq=False)
class _Pair:
    """Both records, the number of the sensor's axis, and what was known of the clocks at first.

    ``centred`` is the acceleration less its mean, ``motion`` what of it is clear of noise, shape (T, A) [mm/s2], and
    ``noise_stds`` the standard deviations of that, shape (A,) [mm/s2].
    """

    record: Record
    video: Video
    own: int
    first: Alignment
    centred: FloatArray
    motion: FloatArray
    noise_stds: FloatArray

    @classmethod
    def of(cls, record: Record, video: Video, own: int, first: Alignment) -> "_Pair":
        """Both records, with what of the acceleration is motion."""
        centred = record.acceleration - record.acceleration.mean(axis=0)
        noise_stds = np.array([high_noise_std(column) for column in centred.T])
        return cls(record, video, own, first, centred, keep_motion(centred, noise_stds, record.interval_s), noise_stds)

    @property
    def first_gains(self) -> FloatArray:
        """Gains as they are known before, shape (A,) [1]."""
        gains = np.zeros(self.centred.shape[1])
        gains[self.own] = 1.0
        return gains

    def place_nodes(self, times: FloatArray, now: Alignment, gains: FloatArray) -> Nodes:
        """Nodes of the filter at these times, those of the video's values among them."""
        record, video, centred = self.record, self.video, self.centred
        clock = now.on_video(record.time_s)
        drive = Drive(clock, np.column_stack([centred @ gains, self.motion]))
        steps = drive.steps(times)
        if not record.known.all():
            lost = np.interp(times, clock, (~record.known).astype(float)) > 0
            extra = 2 * _LOST_S * float(np.var(centred[record.known, self.own]))
            steps[1:, 1] = np.where(lost[1:] | lost[:-1], extra, 0.0)
        has = np.isfinite(video.values_mm)
        place = np.searchsorted(times, video.time_s[has])
        values, stds = np.full(len(times), np.nan), np.full(len(times), np.nan)
        values[place], stds[place] = video.values_mm[has], video.stds_mm[has]
        shown = drive.exposed(times[place], video.interval_s)
        exposed = np.zeros((len(shown), len(times), shown.shape[2]))
        exposed[:, place] = shown
        state, covariance = self._begin(times[0], now, gains)
        state[0] = values[place[0]]
        rms = float(np.sqrt(np.mean(centred[record.known, self.own] ** 2)))
        typical = float(np.nanmedian(stds))
        covariance[0, 0] = (_WIDE * typical) ** 2
        # What moved so fast as to be elsewhere in the second frame, or what the acceleration makes in a second.
        covariance[1, 1] = (rms * 1.0 + typical / video.interval_s) ** 2
        covariance[BIAS, BIAS] = _BIAS_STD**2
        return Nodes(steps, values, stds, exposed, state, covariance)

    def _begin(self, begin_s: float, now: Alignment, gains: FloatArray) -> tuple[FloatArray, FloatArray]:
        """State of lag, drift and gains at a time, as they are known before, with their covariance."""
        first, inputs = self.first, len(gains)
        state, covariance = np.zeros(GAINS + inputs), np.zeros((GAINS + inputs, GAINS + inputs))
        # What the clock was shifted by since is no news.
        at_s = (first.at_s - first.offset_s) / first.rate_ratio * now.rate_ratio + now.offset_s
        state[DRIFT] = now.rate_ratio / first.rate_ratio - 1
        away = begin_s - at_s
        state[LAG] = at_s - first.at_s + state[DRIFT] * away
        covariance[DRIFT, DRIFT] = first.drift_std**2
        covariance[LAG, DRIFT] = covariance[DRIFT, LAG] = first.drift_std**2 * away
        covariance[LAG, LAG] = first.lag_std_s**2 + (first.drift_std * away) ** 2
        state[GAINS:] = self.first_gains - gains
        covariance[np.arange(GAINS, len(state)), np.arange(GAINS, len(state))] = first.cross_std**2
        covariance[GAINS + self.own, GAINS + self.own] = first.gain_std**2
        return state, covariance


def _cut_middle(nodes: Nodes) -> Nodes:
    """At most so many nodes, from the middle, as a record of its own."""
    count = len(nodes.values_mm)
    if count <= _MOST_FRAMES:
        return nodes
    begin = (count - _MOST_FRAMES) // 2
    part = slice(begin, begin + _MOST_FRAMES)
    steps, state = nodes.steps[part].copy(), nodes.state.copy()
    steps[0] = 0
    state[0] = nodes.values_mm[part][0]
    return Nodes(steps, nodes.values_mm[part], nodes.stds_mm[part], nodes.exposed[:, part], state, nodes.covariance)


def _smooth_around(nodes: Nodes, around: Sequence[Levels]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """What `Nodes.smooth` gives over levels as the record leaves them open: means, and spreads of both kinds."""
    drawn = [nodes.smooth(levels) for levels in around]
    states, covariances, means, variances = (np.stack(one) for one in zip(*drawn, strict=True))
    covariance = covariances.mean(axis=0) + np.cov(states.T, bias=True)
    return states.mean(axis=0), covariance, means.mean(axis=0), variances.mean(axis=0) + np.var(means, axis=0)


def _smooth(pair: _Pair, now: Alignment, gains: FloatArray, posterior: Posterior) -> Fused:
    """The smoothed displacement at the sensor's samples, its spread that of the levels included."""
    video = pair.video
    seen = video.time_s[np.isfinite(video.values_mm)]
    clock = now.on_video(pair.record.time_s)
    places = np.flatnonzero((clock >= seen[0]) & (clock <= seen[-1]))
    times, back = np.unique(np.concatenate([seen, clock[places]]), return_inverse=True)
    nodes, wanted = pair.place_nodes(times, now, gains), back[len(seen) :]
    _, _, innovations, expected = nodes.run(posterior.best)
    if len(seen) <= _MOST_FRAMES:
        state, covariance, value, variance = _smooth_around(nodes, posterior.around)
    else:
        # Once, and wider by as much as in the middle: a dozen times would take minutes.
        middle = _cut_middle(pair.place_nodes(seen, now, gains))
        wider = _smooth_around(middle, posterior.around)[3] / middle.smooth(posterior.best)[3]
        state, covariance, value, variance = nodes.smooth(posterior.best)
        variance *= float(np.median(wider))
    value, variance = value[wanted], variance[wanted]
    after = np.searchsorted(seen, clock[places]).clip(1, len(seen) - 1)
    best, found_gains = posterior.best, gains + state[GAINS:]
    back_s = times[-1] - pair.first.at_s
    # The lag at its own time, from lag and drift at the end.
    lag_variance = covariance[LAG, LAG] - 2 * back_s * covariance[LAG, DRIFT] + back_s**2 * covariance[DRIFT, DRIFT]
    found = replace(
        now,
        lag_std_s=float(np.sqrt(lag_variance)),
        drift_std=float(np.sqrt(covariance[DRIFT, DRIFT])),
        at_s=pair.first.at_s,
    )
    stds = np.sqrt(np.diag(covariance))
    ratio = innovations / expected
    settled = slice(len(ratio) // 10, None)
    worst = len(ratio) // 10 + int(np.argmax(np.nan_to_num(np.abs(ratio[settled]))))
    return Fused(
        clock[places],
        places,
        value,
        np.sqrt(np.maximum(variance, 0.0)),
        seen[after] - seen[after - 1] > _GAP * video.interval_s,
        found,
        found_gains,
        stds[GAINS:],
        float(pair.record.acceleration[:, pair.own].mean() + state[BIAS] / found_gains[pair.own]),
        best,
        float(np.sqrt(np.nanmean(innovations[settled] ** 2))),
        float(np.sqrt(np.nanmean(ratio[settled] ** 2))),
        float(abs(ratio[worst])),
        float(times[worst]),
        nodes.std_mm * best.video_factor * float(np.hypot(1.0, best.slow_factor)),
        nodes.std_mm * best.video_factor * best.slow_factor,
        video.interval_s * best.exposure_share,
        pair.own,
        *_measure_length(found_gains, covariance[GAINS:, GAINS:]),
    )


def _measure_length(gains: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Length of a vector (A,) of gains with covariance (A, A), and its standard deviation [1]."""
    length = float(np.linalg.norm(gains))
    along = gains / max(length, 1e-12)
    return length, float(np.sqrt(along @ covariance @ along))
