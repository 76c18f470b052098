"""Points followed as pictures come, and what the last minute of them says."""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.covariances import judged_std, measured_axes
from vfm_sdm.core.datasets import Status
from vfm_sdm.inputs.video import VideoInfo
from vfm_sdm.stages.registration.subsets import SubsetDesign
from vfm_sdm.stages.tracking.base import Targets
from vfm_sdm.stages.tracking.follow import Follower
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.track_noise import include_track_noise

__all__ = ["LivePoints", "PointMotion", "summarize_motion"]


@dataclass(frozen=True, eq=False)
class PointMotion:
    """What the last minute says of one point.

    Parameters
    ----------
    samples
        Pictures in which it was looked for.
    lost, unreliable
        Share of them in which it was not found, or found and not to be trusted [1].
    now_px
        Image motion (u, v) from the first picture on, in the newest one, shape (2,) [px]; NaN where it is not seen. Of
        an edge its part across.
    rms_px, peak_px
        Standard deviation and peak-to-peak of its motion along its main direction [px].
    noise_px
        Standard deviation of a sample: what is stated of the registrations, or the scatter near the Nyquist frequency
        where that is more [px].
    along
        Main direction of its motion (u, v), a unit vector, shape (2,) [1].
    time_s, trace_px
        Motion along it about its mean, NaN where lost, shape (T,) [s], [px].
    """

    samples: int
    lost: float
    unreliable: float
    now_px: FloatArray
    rms_px: float
    peak_px: float
    noise_px: float
    along: FloatArray
    time_s: FloatArray
    trace_px: FloatArray

    @property
    def signal_to_noise(self) -> float:
        """Standard deviation of the motion over that of the noise [1]; about 1 where there is nothing but noise."""
        return self.rms_px / self.noise_px if self.noise_px > 0 else float("nan")


class LivePoints:
    """Follows points of one view from picture to picture, and keeps what was found in the last ones.

    Parameters
    ----------
    reference
        The picture in which the points are named, shape (H, W).
    points
        Points in it, shape (P, 2) [px].
    names
        Their names, length P.
    designs
        Size, warp and mask of each subset; ``None`` for a point that is not followed.
    executor
        Threads that share the work.
    kept_s
        How far back it remembers [s].
    """

    def __init__(
        self,
        reference: LumaArray,
        points: FloatArray,
        names: Sequence[str],
        *,
        designs: Sequence[SubsetDesign | None],
        executor: Executor,
        kept_s: float = 60.0,
    ) -> None:
        self._tracker, self._targets = IcgnTracker(), Targets(points, tuple(names), designs)
        self._bank = self._tracker.prepare(reference, self._targets, executor)
        self._follower = Follower(self._bank, reference, self._tracker.settings, executor)
        self._kept_s = kept_s
        self._found: deque[tuple[float, FloatArray, FloatArray, FloatArray, Any]] = deque()

    def advance(self, time_s: float, luma: LumaArray) -> None:
        """Takes the next picture.

        Parameters
        ----------
        time_s
            When it was taken, later than the last one [s].
        luma
            The picture, shape (H, W).
        """
        raw, status = self._follower.advance(luma)
        found = self._bank.interpret(raw)
        self._found.append((time_s, found.position, found.covariance, found.correlation, status))
        while self._found[0][0] < time_s - self._kept_s:
            self._found.popleft()

    def tracks(self, info: VideoInfo) -> xr.Dataset:
        """Tracks of the pictures that are remembered, judged as those of a recording; of a point without any, too.

        Parameters
        ----------
        info
            What is known of the view.

        Returns
        -------
        xr.Dataset
            Tracks (see `vfm_sdm.core.datasets`) with ``edge_across`` [1] and ``scatter`` [px], for P points.
        """
        time_s, *arrays = zip(*list(self._found), strict=True)
        position, covariance, correlation, status = (np.stack(one) for one in arrays)
        record = xr.Dataset(
            {
                "position": (("time", "point", "pixel"), position),
                "position_covariance": (("time", "point", "pixel_a", "pixel_b"), covariance),
                "correlation": (("time", "point"), correlation),
                "status": (("time", "point"), status.astype(np.int8)),
                "edge_across": (("point", "pixel"), self._bank.edge_across, {"units": "1"}),
            },
            coords={"time": np.array(time_s)},
        )
        tracks = self._tracker.judge(record, self._targets, info)
        return include_track_noise(tracks.assign(edge_across=record["edge_across"]))


def summarize_motion(tracks: xr.Dataset, points: FloatArray) -> tuple[PointMotion, ...]:
    """What tracks of the last minute say of each of their points.

    Parameters
    ----------
    tracks
        Of `LivePoints.tracks`, shape (T, P, 2) [px].
    points
        Where the points were in the first picture, shape (P, 2) [px].

    Examples
    --------
    >>> from vfm_sdm.core.datasets import make_tracks
    >>> swing = np.sin(np.arange(300.0))[:, None, None] * [0.0, 0.5]
    >>> covariance = np.tile(0.01**2 * np.eye(2), (300, 1, 1, 1))
    >>> tracks = make_tracks(np.arange(300) / 30, ["a"], 50 + swing, covariance, np.zeros((300, 1)), attrs={})
    >>> tracks = tracks.assign(edge_across=(("point", "pixel"), np.full((1, 2), np.nan)))
    >>> motion = summarize_motion(tracks, np.full((1, 2), 50.0))[0]
    >>> round(motion.peak_px, 2), round(motion.rms_px, 2), abs(motion.along).round(2).tolist()
    (1.0, 0.35, [0.0, 1.0])
    """
    status, across = tracks["status"].values, tracks["edge_across"].values
    time_s, moved = tracks["time"].values, tracks["position"].values - points
    std_px = judged_std(tracks["position_covariance"].values, across)
    motions = []
    for p in range(len(points)):
        code, of_point = status[:, p], np.isfinite(moved[:, p]).all(axis=1)
        trusted = of_point & (code == Status.OK)
        along, trace = _main_direction(moved[:, p], trusted, across[p])
        seen = trace[trusted]
        noise = std_px[trusted, p]
        motions.append(
            PointMotion(
                samples=len(time_s),
                lost=float(np.mean(~of_point)),
                unreliable=float(np.mean(of_point & ~trusted)),
                now_px=moved[-1, p],
                rms_px=float(np.std(seen)) if seen.size else np.nan,
                peak_px=float(np.ptp(seen)) if seen.size else np.nan,
                # The reference picture itself is known without noise.
                noise_px=float(np.median(noise[noise > 0])) if (noise > 0).any() else np.nan,
                along=along,
                time_s=time_s,
                trace_px=trace,
            )
        )
    return tuple(motions)


def _main_direction(moved: FloatArray, trusted: Any, across: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction (2,) in which a point moves most, or across its edge, and its motion along it about the mean (T,)."""
    along = measured_axes(across)[0]
    if not trusted.any():
        return along, np.full(len(moved), np.nan)
    centred = moved - moved[trusted].mean(axis=0)
    if not np.isfinite(across).all() and trusted.sum() > 2:
        along = np.linalg.eigh(np.cov(centred[trusted].T))[1][:, -1]
        along = along if along[np.argmax(np.abs(along))] > 0 else -along
    return along, np.where(trusted, centred @ along, np.nan)
