"""All views of a session watched at once, and what of it is not to be trusted."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import SessionError, VfmSdmError
from vfm_sdm.inputs.session import Session, View
from vfm_sdm.inputs.video.live import LiveSource
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.studies.watching.scales import find_places, find_scales
from vfm_sdm.studies.watching.view import PointNow, ViewNow, WatchedView

__all__ = ["Watch", "doubt_point", "doubt_view"]

_FEWEST = 30
_LOST, _UNRELIABLE = 0.02, 0.1
_SIGNAL = 3.0
"""Motion over noise below which it is not told from it [1]."""
_WHITE_POINT, _WHITE_PICTURE = 0.02, 0.02
_LIGHT = 0.25
_KEPT = 0.8
_SILENT_S = 2.0
_LATE_S = 1.0


class Watch:
    """Watches the views of a session as long as the context lasts.

    Parameters
    ----------
    session
        Views and points.
    sources
        Where the pictures of views come from, by name: a file that grows, an address, a camera. Those that are not
        named are the session's recordings, as files that grow.
    earlier
        Cameras of an earlier run: they know the points' places in every view, and their distances.
    idle_s
        After how long without anything new a source has ended [s].

    Raises
    ------
    SessionError
        A source is for no view of the session, or a view has neither a source nor a single video file.

    Attributes
    ----------
    notes
        Sentences on what is not known from the start.
    """

    def __init__(
        self,
        session: Session,
        sources: Mapping[str, str] | None = None,
        *,
        earlier: CameraSolution | None = None,
        idle_s: float = 10.0,
    ) -> None:
        sources = sources or {}
        unknown = sorted(set(sources) - {view.name for view in session.view})
        if unknown:
            raise SessionError(
                f"source: expected views of the session ({', '.join(v.name for v in session.view)}), got "
                f"{', '.join(unknown)}; correct the name"
            )
        self._session, self._earlier = session, earlier
        self._executor = ThreadPoolExecutor()
        self.notes: list[str] = []
        self._views = [
            WatchedView(
                view.name,
                LiveSource(sources.get(view.name) or _own_file(session, view), idle_s=idle_s),
                session.point,
                find_places(session, view, earlier),
                subset_px=session.method.subset_px,
                executor=self._executor,
            )
            for view in session.view
        ]
        self._scaled: set[str] = set()

    def __enter__(self) -> Self:
        for view in self._views:
            view.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for view in self._views:
            view.stop()
        self._executor.shutdown()

    @property
    def running(self) -> bool:
        """Whether more may come in any view."""
        return any(view.running for view in self._views)

    def look(self) -> tuple[ViewNow, ...]:
        """What can be said of the views now, in the session's order.

        Raises
        ------
        VfmSdmError
            Of no view anything can be shown; what is wrong with the first one.
        """
        for view in self._views:
            self._find_scales(view)
        seen, errors = tuple(view.look() for view in self._views), [view.error for view in self._views]
        if errors[0] is not None and None not in errors and not any(view.measured for view in seen):
            raise errors[0]
        return seen

    def _find_scales(self, watched: WatchedView) -> None:
        """Millimetres a pixel, as soon as the size of the pictures is known."""
        if watched.name in self._scaled or watched.image_size is None:
            return
        self._scaled.add(watched.name)
        view = next(one for one in self._session.view if one.name == watched.name)
        places = find_places(self._session, view, self._earlier)
        try:
            watched.scales = find_scales(self._session, view, watched.image_size, places, self._earlier)
        except VfmSdmError as error:
            self.notes.append(f"no millimetres: {error}")


def _own_file(session: Session, view: View) -> str:
    """The session's recording of a view, as a file that grows."""
    if not isinstance(view.video, Path):
        found = "images" if view.video is None else "several chapters"
        raise SessionError(
            f"view {view.name!r}: expected one video file that grows, got {found}; name a camera, an address or a file "
            f"with --source {view.name}=SOURCE"
        )
    return str(session.resolve(view.video))


def doubt_point(now: PointNow) -> tuple[str, ...]:
    """Why what is shown of a point is not to be trusted, most important first; nothing where it may be.

    Parameters
    ----------
    now
        The point.
    """
    motion, choice, doubts = now.motion, now.choice, []
    if motion is None or choice is None:
        return ("not measured yet",)
    if choice.status != PointStatus.OK:
        place = ", ".join(f"{x:.0f}" for x in choice.nearest)
        return (f"{choice.status}" + (f"; {place} would do" if np.isfinite(choice.nearest).all() else ""),)
    if not np.isfinite(motion.now_px).all():
        doubts.append("lost now")
    if motion.lost > _LOST:
        doubts.append(f"lost in {motion.lost:.0%}")
    if motion.unreliable > _UNRELIABLE:
        doubts.append(f"unreliable in {motion.unreliable:.0%}")
    if now.light is not None and now.light.saturated > _WHITE_POINT:
        doubts.append(f"{now.light.saturated:.0%} of it is white: expose less")
    if motion.samples < _FEWEST:
        doubts.append(f"only {motion.samples} pictures so far")
    elif np.isfinite(motion.signal_to_noise):
        moves = motion.signal_to_noise >= _SIGNAL
        if moves and now.point.static:
            doubts.append("static, but moves: tripod, wind?")
        elif not (moves or now.point.static):
            doubts.append("no motion above noise")
    return tuple(doubts)


def doubt_view(now: ViewNow) -> tuple[str, ...]:
    """Why what is shown of a view is not to be trusted; nothing where it may be.

    Parameters
    ----------
    now
        The view.
    """
    doubts = []
    if now.state == "measuring" and now.silent_s > _SILENT_S:
        doubts.append(f"no picture for {now.silent_s:.0f} s: what is shown is old")
    if now.latency_s > _LATE_S:
        doubts.append(f"shown {now.latency_s:.1f} s late")
    if now.kept_hz < _KEPT * now.rate_hz:
        doubts.append(
            f"{now.kept_hz:.1f} of {now.rate_hz:.1f} pictures a second are measured: motion above "
            f"{now.kept_hz / 2:.1f} Hz is shown wrong"
        )
    if now.missing:
        doubts.append(f"missing in the source itself, in the last minute: {now.missing}")
    if now.damaged:
        doubts.append(f"damaged: {now.damaged}")
    if now.light is not None:
        if now.light.saturated > _WHITE_PICTURE:
            doubts.append(f"{now.light.saturated:.0%} of the picture is white: expose less")
        if abs(now.light.change) > _LIGHT:
            doubts.append(f"light has changed by {now.light.change:+.0%} since the start")
    if now.elsewhere:
        doubts.append(f"not watched here, no pixel known: {', '.join(now.elsewhere)}")
    return tuple(doubts)
