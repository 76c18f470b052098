"""A field in motion: the structure's pixels in the first frame moved as the field moves, magnified."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import av
import cv2
import numpy as np
import numpy.typing as npt
import xarray as xr
from av.video.stream import VideoStream
from PIL import Image

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.files import replace_file
from vfm_sdm.errors import VideoError
from vfm_sdm.geometry.camera import Camera

__all__ = ["FieldPicture", "write_gif", "write_mp4"]

Picture = npt.NDArray[np.uint8]

_SHOWN_PX, _GIF_PX = 1280, 640
_MOST_FRAMES = 240
_REACH = 0.03
"""Largest magnified motion, as a share of the picture's height [1]."""
_EDGE_PX = 24
"""Width over which the motion fades out around the points, in pixels of the shown picture."""
_STEPS = (1, 2, 5)
_ENCODERS = ("libx264", "mpeg4")
_GIF_FPS = 15


@dataclass(frozen=True, eq=False)
class FieldPicture:
    """The first frame of a view, and how a field moves it.

    Parameters
    ----------
    picture
        The frame as it is shown, shape (H, W).
    station_m
        Station of every pixel, shape (H, W) [m].
    slope
        Motion of a pixel for motion along each axis, where the structure is, fading out around it; shape (H, W, 2, 3)
        [px/mm].
    """

    picture: Picture
    station_m: FloatArray
    slope: FloatArray

    @classmethod
    def of(
        cls, picture: npt.NDArray[Any], camera: Camera, places_m: FloatArray, rotation: FloatArray
    ) -> "FieldPicture":
        """The picture of a field whose points a camera sees.

        Parameters
        ----------
        picture
            First frame of the view, shape (H, W).
        camera
            The view's camera.
        places_m
            Places of the field's points along the structure's axes, shape (P, 3) [m].
        rotation
            Rotation from the first camera to the structure's axes, shape (3, 3).

        Notes
        -----
        Between the points, station and slopes are second-order polynomials of the pixel.
        """
        factor = min(1.0, _SHOWN_PX / picture.shape[1])
        shown = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        shown = shown[: shown.shape[0] // 2 * 2, : shown.shape[1] // 2 * 2]
        if shown.dtype != np.uint8:
            shown = np.clip(shown / max(float(shown.max()), 1.0) * 255, 0, 255).astype(np.uint8)
        here = camera.project(places_m @ rotation)
        moved = [camera.project((places_m + step) @ rotation) - here for step in 1e-3 * np.eye(3)]
        slopes = factor * np.stack(moved, axis=-1)
        pixels = (here + 0.5) * factor - 0.5
        height, width = shown.shape
        v, u = np.indices((height, width), dtype=np.float64)
        scale = np.array([width, height], np.float64)
        fitted = np.linalg.lstsq(
            _terms(pixels / scale), np.column_stack([places_m[:, 2], slopes.reshape(-1, 6)]), rcond=None
        )[0]
        values = _terms(np.stack([u.ravel(), v.ravel()], axis=1) / scale) @ fitted
        inside = np.zeros((height, width), np.uint8)
        outline = cv2.convexHull(np.rint(pixels[np.isfinite(pixels).all(axis=1)]).astype(np.int32))
        cv2.fillConvexPoly(inside, outline, 255)
        inside = cv2.dilate(inside, np.ones((2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1), np.uint8))
        fading = cv2.GaussianBlur(inside.astype(np.float32) / 255, (0, 0), _EDGE_PX / 3).astype(np.float64)
        slope = values[:, 1:].reshape(height, width, 2, 3) * fading[..., None, None]
        return cls(np.ascontiguousarray(shown), values[:, 0].reshape(height, width), slope)

    def magnification(self, field: xr.Dataset) -> float:
        """The round number by which the largest motion is a small part of the picture's height [1].

        Parameters
        ----------
        field
            Field dataset, shape (T, S, 3) [mm].
        """
        most = np.nanmax(np.abs(field["displacement"].values), axis=(0, 1))
        largest = float(np.linalg.norm(np.abs(self.slope).reshape(-1, 2, 3).max(axis=0) @ most))
        wanted = _REACH * self.picture.shape[0] / max(largest, 1e-9)
        if wanted <= 1:
            return 1.0
        decade = 10.0 ** np.floor(np.log10(wanted))
        return float(max(step * decade for step in _STEPS if step * decade <= wanted))

    def frames(self, field: xr.Dataset, magnification: float, *, most: int = _MOST_FRAMES) -> Iterator[Picture]:
        """Pictures of the moving structure, shape (H, W) each, with time and magnification written in.

        Parameters
        ----------
        field
            Field dataset, shape (T, S, 3) [mm].
        magnification
            How much larger the motion is shown than it is [1].
        most
            How many pictures at most; the times around the largest motion are taken.
        """
        v, u = np.indices(self.picture.shape, dtype=np.float32)
        station = field["station"].values
        for row in _around_largest(field, most):
            now = np.nan_to_num(field["displacement"].values[row])
            motion = np.stack([np.interp(self.station_m, station, line) for line in now.T], axis=-1)
            shift = magnification * np.einsum("hwij,hwj->hwi", self.slope, motion).astype(np.float32)
            frame = cv2.remap(
                self.picture, u - shift[..., 0], v - shift[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE
            )
            words = f"{float(field['time'].values[row]):.2f} s   x {magnification:g}"
            (wide, high), below = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 1)
            cv2.rectangle(frame, (8, 30 - high), (24 + wide, 40 + below), 0, -1)
            cv2.putText(frame, words, (16, 36), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 1, cv2.LINE_AA)
            yield np.asarray(frame, np.uint8)


def _terms(pixels: FloatArray) -> FloatArray:
    """Terms of a polynomial of second order, shape (N, 6)."""
    u, v = pixels.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _around_largest(field: xr.Dataset, most: int) -> range:
    """Rows of the times that are shown."""
    count = field.sizes["time"]
    size = np.nan_to_num(np.abs(field["displacement"].values)).max(axis=(1, 2))
    begin = int(np.clip(int(size.argmax()) - most // 2, 0, max(count - most, 0)))
    return range(begin, min(begin + most, count))


def write_mp4(path: Path | str, frames: Iterator[Picture], fps: float) -> Path:
    """Writes pictures as a film in MP4 and returns its path.

    Parameters
    ----------
    path
        File to write.
    frames
        Pictures, shape (H, W) each, with even sides.
    fps
        Pictures a second [Hz].

    Raises
    ------
    VideoError
        No encoder is there, or the file cannot be written.
    """
    encoder = next((name for name in _ENCODERS if name in av.codecs_available), None)
    if encoder is None:
        raise VideoError(f"animation: expected one of the encoders {_ENCODERS}, got none; install another PyAV")
    try:
        with replace_file(path) as file, av.open(str(file), "w", format="mp4") as container:
            stream = cast(VideoStream, container.add_stream(encoder, rate=round(fps)))
            stream.pix_fmt = "yuv420p"
            for number, frame in enumerate(frames):
                if number == 0:
                    stream.height, stream.width = frame.shape
                coded = av.VideoFrame.from_ndarray(frame, format="gray").reformat(format="yuv420p")
                container.mux(stream.encode(coded))
            container.mux(stream.encode())
    except (OSError, av.error.FFmpegError) as error:
        raise VideoError(f"{path}: expected to write a film, got: {error}; choose another folder") from error
    return Path(path)


def write_gif(path: Path | str, frames: Iterator[Picture], fps: float) -> Path:
    """Writes pictures as an animated GIF, smaller and with fewer pictures a second, and returns its path.

    Parameters
    ----------
    path
        File to write.
    frames
        Pictures, shape (H, W) each.
    fps
        Pictures a second [Hz].

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    step = max(1, round(fps / _GIF_FPS))
    pictures = []
    for number, frame in enumerate(frames):
        if number % step == 0:
            picture = Image.fromarray(frame)
            picture.thumbnail((_GIF_PX, _GIF_PX))
            pictures.append(picture)
    with replace_file(path) as file:
        pictures[0].save(
            file, format="GIF", save_all=True, append_images=pictures[1:], duration=round(1000 * step / fps), loop=0
        )
    return Path(path)
