"""Plan of a virtual field test: what stands where, what moves, and how each camera sees it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.defects import Glare, Stabilization
from vfm_sdm.studies.synthetic.disturbances import Disturbances, random_stream
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.girder_bridge import GirderBridgeSite
from vfm_sdm.studies.synthetic.motion import Motion
from vfm_sdm.studies.synthetic.photometry import Photometry
from vfm_sdm.studies.synthetic.sensors import Accelerometer
from vfm_sdm.studies.synthetic.timing import Schedule, Timing

__all__ = [
    "Blunder",
    "FurtherReadings",
    "MountedAccelerometer",
    "Preset",
    "Recording",
    "Site",
    "SiteErrors",
    "SitePoint",
    "view_names",
]

Site = FootbridgeSite | GirderBridgeSite
"""Where structure and cameras stand, and what they look like."""

_NAMES = ("left", "right", "third", "fourth", "fifth", "sixth")


def view_names(cameras: int) -> tuple[str, ...]:
    """Names for so many views.

    Examples
    --------
    >>> view_names(3)
    ('left', 'right', 'third')
    """
    return (*_NAMES[:cameras], *(f"view {number + 1}" for number in range(len(_NAMES), cameras)))


@dataclass(frozen=True)
class SitePoint:
    """A named point of the site.

    Parameters
    ----------
    name
        As in the session.
    position
        At rest, in the world frame of `vfm_sdm.studies.synthetic.scene` [m].
    static
        Whether it stands still.
    """

    name: str
    position: tuple[float, float, float]
    static: bool = False


@dataclass(frozen=True)
class MountedAccelerometer:
    """An accelerometer on the deck.

    Parameters
    ----------
    sensor
        What it is.
    point
        Name of the point at which it measures.
    """

    sensor: Accelerometer
    point: str


@dataclass(frozen=True)
class SiteErrors:
    """Standard deviations of what is measured on site and noted in the session."""

    baseline_m: float = 0.01
    perpendicular_m: float = 0.02
    longitudinal_m: float = 0.05
    level_deg: float = 0.2
    range_m: float = 0.01
    lens_relative: float = 0.02
    length_m: float = 0.02


@dataclass(frozen=True)
class FurtherReadings:
    """What an engineer who was asked for more would also have measured, in a session file of its own.

    Parameters
    ----------
    ranged
        Name of the point whose distance from the second camera a laser gave.
    lengths
        Names of points whose distances a tape gave.
    """

    ranged: str
    lengths: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Blunder:
    """A reading noted wrong, far beyond its standard deviation.

    Parameters
    ----------
    reading
        ``baseline``, ``perpendicular_distance``, ``longitudinal_distance``, ``range``, or ``length 1``, ``length 2``
        and so on in the order of the session.
    error_m
        Added to what would have been noted [m].
    """

    reading: str
    error_m: float


@dataclass(frozen=True)
class Recording:
    """How one camera records, in the order in which light and processing act.

    Parameters
    ----------
    exposure_s
        Of a frame [s].
    rolling_shutter_s
        From the read-out of the first row to that of the last [s]; 0 for a global shutter.
    defocus_px
        Standard deviation of the Gaussian point spread of a lens out of focus [px].
    glare
        Stray light.
    light
        Share of the light that reaches the picture, 1 where it is well lit.
    noise_std
        Standard deviation of sensor noise in luma units of 8 bits.
    sharpening
        Amount of the unsharp mask [1].
    stabilization
        Of the phone.
    crf
        Quality of the encoder x264; less is better.
    start_s
        True time of the middle of the first frame [s].
    clock_rate
        Seconds of the camera's clock in a true second [1].
    photometry
        Lens and sensor that get linear light from the scene; without it, the scene's luma is that of the video.
    disturbances
        Weather, light, people, wind and timing that are unkind.

    Raises
    ------
    DatasetError
        A number is out of its range.
    """

    exposure_s: float = 1 / 1000
    rolling_shutter_s: float = 0.0
    defocus_px: float = 0.0
    glare: Glare | None = None
    light: float = 1.0
    noise_std: float = 1.0
    sharpening: float = 0.0
    stabilization: Stabilization | None = None
    crf: int = 14
    start_s: float = 0.0
    clock_rate: float = 1.0
    # Not printed, so that a film without it is told apart as before (`field_test._film_hash`).
    photometry: Photometry | None = field(default=None, repr=False)
    disturbances: Disturbances = field(default=Disturbances(), repr=False)

    def __post_init__(self) -> None:
        least = min(self.exposure_s, self.rolling_shutter_s, self.defocus_px, self.noise_std, self.sharpening)
        if not (least >= 0 and 0 < self.light <= 1 and 0 <= self.crf <= 51 and self.clock_rate > 0):
            raise DatasetError(
                "recording: expected times, defocus, noise and sharpening >= 0, light in (0, 1], crf from 0 to 51 and "
                f"clock_rate > 0, got {self}; correct them"
            )

    def frame_times(self, frames: int, fps: float) -> FloatArray:
        """True times of the middles of frames, shape (frames,) [s]; the container's stamps are ``k / fps``."""
        return self.start_s + np.arange(frames) / fps / self.clock_rate


@dataclass(frozen=True)
class Preset:
    """A virtual field test.

    Parameters
    ----------
    name, size
        Such as ``data-1`` and ``full``.
    description
        Conditions in words.
    site
        Places of footbridge and cameras, and the lenses.
    motion
        Of the structure.
    points
        Monitored points first.
    recordings
        Of the reference view and the further ones, in the order of the site's cameras.
    accelerometers
        At the monitored points.
    fps
        Frames a second on each camera's own clock [Hz].
    duration_s
        Of all videos [s].
    still_s
        Until when the structure is at rest in all videos, in seconds of the reference view [s].
    errors
        Of the measurements on site.
    seed
        Of textures, noise and errors.
    within_assumptions
        False where the recording violates what the method assumes, such as cameras that stand still.
    ranged
        Name of the point whose distance from the reference camera a laser gave; the first point when ``None``.
    known_length
        Names of two points whose distance the drawings give.
    further
        Readings of a second session file.
    encoder
        Options of x264 beside the quality.
    refinement
        Of the session: ``none`` or ``sgr``.
    subset_px
        Of the session [px].
    synchronization
        Of the session: ``motion``, or ``none`` for cameras that are known to start together.
    blunders
        Readings noted wrong in both session files.
    views
        Names of the views, which are those of their videos.

    Raises
    ------
    DatasetError
        There is not one recording and one name a camera, an accelerometer is at no point, or the structure moves before
        the still interval is over.
    """

    name: str
    size: str
    description: str
    site: Site
    motion: Motion
    points: tuple[SitePoint, ...]
    recordings: tuple[Recording, ...]
    accelerometers: tuple[MountedAccelerometer, ...]
    fps: int
    duration_s: float
    still_s: float
    errors: SiteErrors
    seed: int
    within_assumptions: bool = True
    ranged: str | None = None
    known_length: tuple[str, str] | None = None
    further: FurtherReadings | None = None
    refinement: Literal["none", "sgr"] = "sgr"
    subset_px: int = 61
    synchronization: Literal["motion", "none"] = "motion"
    encoder: Mapping[str, str] = field(default_factory=lambda: {"preset": "superfast", "threads": "2"})
    blunders: tuple[Blunder, ...] = ()
    views: tuple[str, ...] = ("left", "right")

    def __post_init__(self) -> None:
        cameras = 1 + len(self.site.further)
        if not len(self.recordings) == len(self.views) == cameras:
            raise DatasetError(
                f"recordings, views: expected one of each for {cameras} cameras, got {len(self.recordings)} and "
                f"{list(self.views)}; name and record every view once"
            )
        names = [point.name for point in self.points]
        unknown = [mounted.point for mounted in self.accelerometers if mounted.point not in names]
        if unknown:
            raise DatasetError(f"accelerometers: expected points of {names}, got {unknown}; mount them on one of these")
        if not self.still_s <= self.motion.still_s:
            raise DatasetError(
                f"still_s: expected at most {self.motion.still_s} s, when the motion starts, got {self.still_s}; "
                "shorten it"
            )

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres of the first two cameras [m]."""
        return float(np.linalg.norm(self.site.further[0].center))

    @property
    def frames(self) -> int:
        """Number of frames of each video without dropped ones."""
        return round(self.duration_s * self.fps)

    def frame_times(self, view: int) -> FloatArray:
        """True times of the frames of a view, 0 the reference, shape (frames,) [s]."""
        recording = self.recordings[view]
        if recording.disturbances.timing is None:
            return recording.frame_times(self.frames, self.fps)
        return recording.start_s + self._schedule(view).stamps / self.fps / recording.clock_rate

    def stamps(self, view: int) -> FloatArray:
        """Stamps of the frames of a view on its own clock, shape (frames,) [frame intervals]."""
        return self._schedule(view).stamps

    def repeated(self, view: int) -> BoolArray:
        """Whether each frame of a view shows the picture before it once more, shape (frames,)."""
        return self._schedule(view).repeated

    def _schedule(self, view: int) -> Schedule:
        timing = self.recordings[view].disturbances.timing or Timing()
        return timing.schedule(self.frames, seed=random_stream(self.seed, view, "timing"))
