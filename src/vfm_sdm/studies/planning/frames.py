"""First frames with a grid of pixels, named points and their subsets, from which a session can be written."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from vfm_sdm.core.datasets import frames_of_points
from vfm_sdm.core.files import distinct_stem, file_stem, write_file
from vfm_sdm.core.netcdf import read_points, read_tracks
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.errors import BackendUnavailableError, ResultsError
from vfm_sdm.inputs.session import Session, read_session
from vfm_sdm.inputs.video import RgbArray, Video, open_video
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.plots import draw_frame

__all__ = ["FramePicture", "find_frames", "write_frames"]


@dataclass(frozen=True, eq=False)
class FramePicture:
    """A frame and what is named in it.

    Parameters
    ----------
    view
        Name of the view; that of the file for a video without a session.
    number
        Number of the frame, from the first one that is used.
    video
        The recording.
    names
        Points that are named in this frame, length P.
    places
        Their positions, shape (P, 2) [px]; NaN where a point was not found.
    static
        Whether they must not move, length P.
    sides_px
        Sides of their subsets, length P [px]; 0 where there is none.
    """

    view: str
    number: int
    video: Video
    names: tuple[str, ...] = ()
    places: npt.NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    static: tuple[bool, ...] = ()
    sides_px: tuple[int, ...] = ()

    @property
    def stem(self) -> str:
        """Name of the picture's file, without suffix."""
        return file_stem(self.view) + (f"_frame_{self.number}" if self.number else "")

    def picture(self) -> RgbArray:
        """The frame in colour, shape (H, W, 3)."""
        return self.video.single(self.number).color_frame(self.number)


def find_frames(source: Path | str, *, progress: Progress | None = None) -> Iterator[FramePicture]:
    """First frames of all views, and those of points that come into view later.

    Parameters
    ----------
    source
        A session's file, with or without points; the folder of a finished run, whose points are drawn in every view
        with the subsets that were compared; or a video.
    progress
        Called with what is being done: subsets of many points take minutes.

    Raises
    ------
    SessionError, VideoError
        The session or a recording cannot be used.
    ResultsError
        The folder holds no run.

    Notes
    -----
    In a session's frames stand the points that are named there, with subsets as the tracker would choose them; a run
    says where all points were found.
    """
    path = Path(source)
    if path.suffix.lower() == ".toml":
        session = read_session(path, points_needed=False)
        yield from _frames_of(session, None, {}, progress)
    elif path.is_dir():
        if not (path / SESSION).is_file():
            raise ResultsError(
                f"{path}: expected a run folder with {SESSION}, got none; name a session's file, a video, or "
                "the folder of a finished run"
            )
        tracks = read_tracks(path) if (path / "tracks.nc").exists() else {}
        yield from _frames_of(read_session(path / SESSION), read_points(path), tracks, progress)
    else:
        yield FramePicture(path.stem, 0, open_video(path))


def write_frames(folder: Path | str, frames: Iterator[FramePicture]) -> Iterator[Path]:
    """Writes pictures one by one and returns their paths: ``VIEW.png``, ``VIEW_frame_N.png``.

    Parameters
    ----------
    folder
        Folder to write to; made when absent.
    frames
        The frames.

    Raises
    ------
    ResultsError
        A picture cannot be written.
    """
    taken: set[str] = set()
    for one in frames:
        stem = distinct_stem(one.stem, taken)
        drawn = BytesIO()
        figure = draw_frame(
            one.picture(), one.places, one.names, title=_title(one), sides_px=one.sides_px, static=one.static
        )
        figure.savefig(drawn, format="png", pil_kwargs={"compress_level": 3})
        yield write_file(Path(folder) / f"{stem}.png", drawn.getvalue())


def _title(one: FramePicture) -> str:
    height, width = one.video.info.height, one.video.info.width
    which = f"frame {one.number}" if one.number else "first frame"
    squares = "; squares are subsets (orange: moving, blue: static)" if any(one.sides_px) else ""
    return f"{one.view}, {which}, {width} x {height} px{squares}"


def _frames_of(
    session: Session, points: xr.Dataset | None, tracks: Mapping[str, xr.Dataset], progress: Progress | None
) -> Iterator[FramePicture]:
    """Frames of a session, with the points of a run or those that it names."""
    measurement = Measurement(session, progress=progress)
    static = {point.name: point.static for point in session.point}
    default = session.method.usual_subset_px
    # A run compared nothing at a point that it refused; of a session it is shown what would be compared.
    refused = 0 if tracks else default
    sides = {view: _sides(of_view, refused) for view, of_view in (tracks or _expected(measurement)).items()}
    for view, video in measurement.recordings.items():
        places = _named_in(session, view) if points is None else _found_in(points, view)
        numbers = measurement.reference_frames.get(view, {})
        if points is not None:
            of_view = points.sel(view=view)
            numbers = dict(zip(places, frames_of_points(of_view).tolist(), strict=True))
        for number in sorted({0, *(numbers.get(name, 0) for name in places)}):
            names = tuple(name for name in places if numbers.get(name, 0) == number)
            yield FramePicture(
                view,
                number,
                video,
                names,
                np.array([places[name] for name in names]).reshape(-1, 2),
                tuple(static.get(name, False) for name in names),
                tuple(sides.get(view, {}).get(name, default) for name in names),
            )


def _expected(measurement: Measurement) -> Mapping[str, xr.Dataset]:
    """What named points should measure, by view; nothing where the session's tracker cannot run here."""
    try:
        return measurement.expectation
    except BackendUnavailableError:
        return {}


def _named_in(session: Session, view: str) -> dict[str, npt.NDArray[np.float64]]:
    """Places of the points that a session names in a view [px]."""
    named = {point.name: point.pixel if point.view == view else point.pixel_in.get(view) for point in session.point}
    return {name: np.array(pixel, np.float64) for name, pixel in named.items() if pixel is not None}


def _found_in(points: xr.Dataset, view: str) -> dict[str, npt.NDArray[np.float64]]:
    """Places of all points in a view of a run [px]; NaN where one was not found."""
    position = points["position"].sel(view=view).transpose("point", "pixel")
    return dict(zip(map(str, position["point"].values), position.values, strict=True))


def _sides(of_view: xr.Dataset, refused: int) -> dict[str, int]:
    """Sides of the subsets of a view by point [px]; none of trackers that compare none."""
    if "subset_px" not in of_view:
        return {}
    named = zip(of_view["point"].values, of_view["subset_px"].values, strict=True)
    return {str(name): int(side) or refused for name, side in named}
