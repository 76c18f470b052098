"""Pictures of the films, which are there before anything else is known of them."""

from collections.abc import Mapping
from threading import Lock
from typing import Any

import cv2

from vfm_sdm.errors import SessionError, VideoError
from vfm_sdm.inputs.session import Session, open_views
from vfm_sdm.inputs.video import RgbArray, Video

__all__ = ["Pictures", "provisional"]

_QUALITY = 90
_SOMEWHERE = {"baseline": {"value": 1.0, "std": 0.1}}
"""Site where nothing was measured yet: places in pictures do not depend on the scale."""


def provisional(fields: dict[str, Any]) -> Session:
    """A session of the films alone, where what was measured on site is not complete yet.

    Parameters
    ----------
    fields
        Plain tables, as of a file.

    Raises
    ------
    SessionError
        The films or points are not stated as they must be.
    """
    views = [
        {key: view[key] for key in ("name", "video", "images", "fps", "capture_fps", "use_s", "lens") if key in view}
        for view in fields.get("view", ())
    ]
    kept = {key: fields[key] for key in ("name", "point") if key in fields}
    return Session(**kept, view=views, site=_SOMEWHERE if len(views) > 1 else {})


class Pictures:
    """Frames of a session's recordings as JPEG; the first ones are kept.

    Parameters
    ----------
    session
        The session; only its views matter.

    Raises
    ------
    VideoError
        A file is missing or holds no frame.

    Notes
    -----
    Any thread may ask; one that asks for what another one makes waits for it.
    """

    def __init__(self, session: Session) -> None:
        self.recordings: Mapping[str, Video] = open_views(session)
        self._first: dict[str, bytes] = {}
        self._locks = {view: Lock() for view in self.recordings}

    @property
    def lengths(self) -> dict[str, int]:
        """Number of frames of each view, as far as its file tells; 1 where it does not."""
        return {name: video.info.frame_count or 1 for name, video in self.recordings.items()}

    def picture(self, view: str, number: int = 0) -> bytes:
        """A frame as JPEG.

        Parameters
        ----------
        view, number
            The view, and the number of its frame.

        Raises
        ------
        SessionError
            There is no such view.
        VideoError
            There is no such frame.
        """
        video = self.recordings.get(view)
        if video is None:
            raise SessionError(f"view: expected one of {', '.join(self.recordings)}, got {view!r}; reload the page")
        if number:
            return _encode(view, video.single(number).color_frame(number))
        with self._locks[view]:
            if view not in self._first:
                self._first[view] = _encode(view, video.first_frame().color())
            return self._first[view]


def _encode(view: str, colours: RgbArray) -> bytes:
    ok, encoded = cv2.imencode(".jpg", colours[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not ok:
        raise VideoError(f"{view}: expected a picture that JPEG can hold, got {colours.shape}; choose another film")
    return bytes(encoded)
