"""What is seen of the films before anything is measured: pictures, what a pixel is worth, and where it is elsewhere."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import CameraError, VideoError
from vfm_sdm.inputs.session import FirstFrames, Point, Session
from vfm_sdm.inputs.video import Frame, Region, RgbArray, Video
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results import Worth, describe_expectation
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.matching.detection import ImageFeatures, detect_features
from vfm_sdm.stages.matching.epipolar import epipolar_band
from vfm_sdm.stages.matching.locate import PointFinder
from vfm_sdm.stages.matching.repeats import lie_on_repeats
from vfm_sdm.stages.matching.starts import find_depth_range
from vfm_sdm.stages.tracking.design.samples import SAMPLES

__all__ = ["Counterpart", "Sight", "Subset"]

_LINE_SAMPLES = 60


@dataclass(frozen=True)
class Subset:
    """What a point should measure in a view.

    Parameters
    ----------
    side_px
        Side of its square [px]; 0 where it is refused.
    std_px
        Expected standard deviations in one frame, the best direction first [px].
    words
        That in words, with what to do.
    worth
        That in a word.
    """

    side_px: int
    std_px: tuple[float, float]
    words: str
    worth: Worth


@dataclass(frozen=True)
class Counterpart:
    """Where a point of one view is in another one.

    Parameters
    ----------
    pixel
        Its place (u, v) [px]; ``None`` where it was not found.
    status
        Whether it was found, or why not.
    line
        Its epipolar line, shape (N, 2) [px], as far as the picture shows it; empty without cameras.
    """

    pixel: tuple[float, float] | None
    status: str
    line: list[tuple[float, float]] = field(default_factory=list)


class Sight:
    """Recordings of a session, looked at.

    Parameters
    ----------
    session
        With or without points; of its site only what is known.
    recordings
        Its recordings, where they are open.

    Notes
    -----
    The relation of the views takes some seconds the first time, and each further point then a
    part of a second. Any thread may ask.
    """

    def __init__(self, session: Session, recordings: Mapping[str, Video] | None = None) -> None:
        self._measurement = Measurement(session)
        if recordings is not None:
            self._measurement = self._measurement.given(recordings=dict(recordings))
        self._recordings = self._measurement.recordings
        self._sampled = {view: _SampledVideo(video) for view, video in self._recordings.items()}
        self._related: CameraEstimate | None = None
        self._features: dict[str, ImageFeatures] = {}
        # Relating the views takes long; what a pixel is worth must not wait for it.
        self._lock, self._relating = Lock(), Lock()

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Width and height of each view's picture [px]."""
        return {name: (video.info.width, video.info.height) for name, video in self._recordings.items()}

    def look_around(self) -> None:
        """Reads and computes what every click needs of all views, so that the first one does not wait for it."""
        for view, video in self._sampled.items():
            with self._lock:
                video.spread(SAMPLES)
            self._features_of(view)
        _ = self.relation

    def judge(self, view: str, pixel: tuple[float, float]) -> Subset:
        """What a pixel should measure.

        Parameters
        ----------
        view
            The view.
        pixel
            Its place [px].
        """
        point = Point(name="here", view=view, pixel=pixel)
        with self._lock:
            asked = Measurement(self._measurement.session.model_copy(update={"point": (point,)}))
            subset = asked.given(recordings=self._sampled).expectation[view].isel(point=0)
        words, worth = describe_expectation(subset)
        if worth in (Worth.GOOD, Worth.PART) and self._repeats(view, pixel):
            words, worth = f"{words}; its pattern repeats, so it may be mistaken for a place beside it", Worth.PART
        std_px = subset["expected_std"].values
        return Subset(int(subset["subset_px"].item()), (float(std_px[0]), float(std_px[1])), words, worth)

    def counterparts(self, point: Point) -> dict[str, Counterpart]:
        """Where a point is in the other views, by view.

        Parameters
        ----------
        point
            The point; places that it names in other views stay.
        """
        views = list(self._recordings)
        others = [view for view in views if view != point.view]
        estimate = self.relation
        if estimate.rig is None:
            named = {view: point.pixel_in.get(view) for view in others}
            return {
                view: Counterpart(pixel, "named" if pixel else str(estimate.status)) for view, pixel in named.items()
            }
        session = self._measurement.session.model_copy(update={"point": (point,)})
        with self._relating:
            found = PointFinder(session, self._frames).find(estimate.rig, estimate.matches)
        here, result = views.index(point.view), {}
        for view in others:
            place = found["position"].sel(view=view, point=point.name).values
            status = str(found["status"].sel(view=view, point=point.name).item())
            if view in point.pixel_in and status == PointStatus.OK:
                status = "named"
            pixel = (float(place[0]), float(place[1])) if np.isfinite(place).all() else None
            line = self._line(estimate, np.array(point.pixel), (here, views.index(view)))
            result[view] = Counterpart(pixel, status, line)
        return result

    @property
    def relation(self) -> CameraEstimate:
        """Cameras as the pictures and what is known of them tell them, once looked for; none where they do not."""
        with self._relating:
            if self._related is None:
                try:
                    self._related = self._measurement.part("cameras").estimate(self._measurement.session, self._frames)
                except CameraError as error:
                    self._related = CameraEstimate(None, status=str(error))
            return self._related

    @property
    def _frames(self) -> FirstFrames:
        with self._lock:
            return self._measurement.frames

    def _line(self, estimate: CameraEstimate, pixel: FloatArray, views: tuple[int, int]) -> list[tuple[float, float]]:
        """The part of an epipolar line that the picture shows."""
        if estimate.rig is None:
            return []
        between = [one for one in estimate.matches if {one.first, one.second} == set(views)]
        if not between:
            return []
        line = epipolar_band(pixel, estimate.rig, views, find_depth_range(estimate.rig, between[0])).line
        width, height = list(self.sizes.values())[views[1]]
        inside = line[((line >= -0.5) & (line <= [width - 0.5, height - 0.5])).all(axis=1)]
        chosen = np.linspace(0, len(inside) - 1, min(_LINE_SAMPLES, len(inside))).astype(int)
        return [(float(u), float(v)) for u, v in inside[chosen]]

    def _repeats(self, view: str, pixel: tuple[float, float]) -> bool:
        return bool(lie_on_repeats(np.array([pixel]), self._features_of(view))[0])

    def _features_of(self, view: str) -> ImageFeatures:
        if view not in self._features:
            self._features[view] = detect_features(self._frames[view])
        return self._features[view]


class _SampledVideo:
    """A recording that keeps the frames spread over it, once they were read; else it is the recording.

    Parameters
    ----------
    video
        The recording.
    """

    def __init__(self, video: Video) -> None:
        self._video, self._frames = video, dict[tuple[int, int], list[Frame]]()

    def spread(self, count: int, *, also: int = 0) -> list[Frame]:
        """As `Video.spread`."""
        if (count, also) not in self._frames:
            # Copies: a frame as it comes keeps the decoder's memory.
            read = self._video.spread(count, also=also)
            self._frames[count, also] = [replace(one, luma=one.luma.copy(), convert=_without_colours) for one in read]
        return self._frames[count, also]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._video, name)


def _without_colours(_: Region) -> RgbArray:
    raise VideoError("sampled frame: expected luma alone to be read, got a question for colours; ask the recording")
