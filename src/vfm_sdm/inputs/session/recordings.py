"""The recordings that a session names."""

import numpy as np

from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.video import RgbArray, Video, open_images, open_video

__all__ = ["first_color_frames", "open_views"]


def open_views(session: Session) -> dict[str, Video]:
    """The recordings of all views by name, in the session's order.

    Raises
    ------
    VideoError
        A file is missing or holds no frame.
    """
    videos = {}
    for view in session.view:
        if view.video is not None:
            videos[view.name] = open_video(session.resolve(view.video))
        else:
            videos[view.name] = open_images(session.resolve_pattern(str(view.images)), float(view.fps or 0.0))
    return videos


def first_color_frames(session: Session) -> dict[str, RgbArray]:
    """First frame of every view in colour, shape (height, width, 3), by name in the session's order.

    Raises
    ------
    VideoError
        A file is missing or holds no frame.
    """
    return {name: np.ascontiguousarray(video.color_frame(0)) for name, video in open_views(session).items()}
