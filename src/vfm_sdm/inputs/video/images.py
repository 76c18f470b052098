"""Frames of a numbered sequence of image files."""

from collections.abc import Callable, Generator
from copy import copy
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.core.files import match_files, natural_key
from vfm_sdm.core.statuses import RecordingStatus
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video.cuts import Cut
from vfm_sdm.inputs.video.decoder import Start
from vfm_sdm.inputs.video.numbering import read_numbering
from vfm_sdm.inputs.video.records import DecodeStop, Frame, RgbArray, VideoInfo
from vfm_sdm.inputs.video.region import Region

__all__ = ["ImageSource", "find_files", "find_images"]

_JPEG = b"\xff\xd8"
_TIFF = (b"II", b"MM")
# Both apply the EXIF orientation. The luma of a JPEG is stored as such, so it is read without a colour conversion.
_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR
_LUMA_ONLY = cv2.IMREAD_GRAYSCALE
_FORMATS = {("u1", 2): "gray", ("u2", 2): "gray16le", ("u1", 3): "bgr24", ("u2", 3): "bgr48le"}

ImageArray = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class ImageSource:
    """Images of one size, a constant time apart; a missing number is a gap in time.

    Parameters
    ----------
    pattern
        File pattern, see `find_images`.
    fps
        Images a second, positive [1/s].

    Raises
    ------
    VideoError
        No file matches, or the first one is not an image of 8 or 16 bits.
    """

    def __init__(self, pattern: str, fps: float) -> None:
        sequence = read_numbering(find_images(pattern))
        self._files, self._ticks = sequence.files, sequence.ticks.tolist()
        self._fps = fps
        self._like = first = self._files[0]
        try:
            image, _ = _read_image(first)
        except DecodeStop as damage:
            raise VideoError(damage.detail) from damage
        _check_single_page(first)
        rows, columns = image.shape[:2]
        self.info = VideoInfo(
            source=pattern,
            width=columns,
            height=rows,
            fps=fps,
            frame_count=len(self._files),
            duration_s=(self._ticks[-1] + 1) / fps,
            codec=first.suffix.lower().lstrip("."),
            pixel_format=_FORMATS[image.dtype.str[1:], image.ndim],
            bit_depth=8 * image.dtype.itemsize,
            rotation_deg=0,
            remarks=sequence.remarks,
        )

    begins_s = 0.0

    def clock(self) -> FloatArray:
        """Times of all images from the first one, shape (T,) [s]."""
        return np.array(self._ticks) / self._fps

    def soon_decoded(self, number: int, frames: int) -> int:
        """The image itself.

        Parameters
        ----------
        number
            Number of the image.
        frames
            Number of images that may be decoded for it.
        """
        return number

    def compressed_from(self, number: int) -> tuple[Path, None]:
        """The file of an image.

        Parameters
        ----------
        number
            Number of the image.
        """
        return self._files[number], None

    def stream(self) -> Generator[Frame]:
        """A fresh pass over the images, in order, numbered from 0; see `stream_from`."""
        return self.stream_from(0)

    def stream_from(self, first: int) -> Generator[Frame]:
        """A pass that begins with a later image; numbers and times are those of a whole pass.

        Parameters
        ----------
        first
            Number of the image.

        Raises
        ------
        DecodeStop
            A file cannot be read or decoded.
        VideoError
            An image has another size or bit depth than the first.
        """
        return self.decode(first, None)

    def on_one_thread(self) -> "ImageSource":
        """The same images, which are read one by one in any case."""
        return self

    def keys(self) -> IntArray:
        """Numbers of all images: each can be decoded by itself."""
        return np.arange(len(self._files))

    def cut(self, first: int, count: int | None) -> list[Cut]:
        """So many images from one on; all that follow for ``None``.

        Parameters
        ----------
        first, count
            Number of the first image, and of images.
        """
        # The paths of the others are not sent along with a part of them.
        source, end = copy(self), None if count is None else first + count
        source._files, source._ticks = self._files[first:end], self._ticks[first:end]
        return [Cut(source, 0, None, count, shift=first)]

    def decode(self, number: int, start: Start | None) -> Generator[Frame]:
        """A pass that begins with an image of this number; see `stream_from`."""
        del start  # every image can be decoded by itself
        expected = (self.info.height, self.info.width, self.info.bit_depth)
        for index, (path, tick) in islice(enumerate(zip(self._files, self._ticks, strict=True)), number, None):
            image, in_color = _read_image(path)
            found = (*image.shape[:2], 8 * image.dtype.itemsize)
            if found != expected:
                raise VideoError(
                    f"{path}: expected {_size_words(expected)} like {self._like.name}, got {_size_words(found)}; "
                    "leave only images of one recording in the pattern"
                )
            luma = image if image.ndim == 2 else cast("LumaArray", cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
            luma.flags.writeable = False
            yield Frame(index, tick / self._fps, luma, partial(_convert_part, in_color))


def find_images(pattern: str) -> list[Path]:
    """Paths of the image files that match a pattern, in natural order: ``img2`` before ``img10``.

    Parameters
    ----------
    pattern
        A path whose later parts may hold ``*``, ``?`` and ``[...]``. Leading parts that exist as they stand are taken
        literally, so a folder may have brackets in its name.

    Raises
    ------
    VideoError
        No file matches.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for number in (10, 2, 1):
    ...         Path(folder, f"img{number}.png").touch()
    ...     print([path.name for path in find_images(f"{folder}/img*.png")])
    ['img1.png', 'img2.png', 'img10.png']
    """
    return find_files(pattern, "image")


def find_files(pattern: str, kind: str) -> list[Path]:
    """Paths of the files that match a pattern, in natural order.

    Parameters
    ----------
    pattern
        As of `find_images`.
    kind
        What the files are, in messages.

    Raises
    ------
    VideoError
        No file matches.
    """
    # Hidden files are an operating system's, not a camera's ("._0001.jpg").
    files = sorted((path for path in match_files(pattern) if path.name[0] != "."), key=natural_key)
    if not files:
        raise VideoError(
            f"{pattern}: expected {kind} files, got no match; check the folder and the pattern (such as left/*.jpg)"
        )
    return files


def _read_image(path: Path) -> tuple[ImageArray, Callable[[], ImageArray]]:
    """The image that holds the luma, and a function that gives its colours; a JPEG is decoded again for them."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DecodeStop(
            RecordingStatus.CORRUPT, f"{path}: expected an image, got {error.strerror}; check the file"
        ) from error
    if data[:2] == _JPEG:
        return _decode(path, data, _LUMA_ONLY), cache(partial(_decode, path, data, cv2.IMREAD_COLOR))
    image = _decode(path, data, _AS_STORED)
    if (image.dtype.str[1:], image.ndim) not in _FORMATS or image.dtype.kind != "u":
        raise VideoError(
            f"{path}: expected an image of 8 or 16 bits, got {image.dtype.name} of shape {image.shape}; convert it"
        )
    return image, lambda: image


def _decode(path: Path, data: bytes, flags: int) -> ImageArray:
    # From memory, since OpenCV fills up a JPEG file that ends early with grey. An empty buffer makes it raise.
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags) if data else None
    if image is None:
        raise DecodeStop(
            RecordingStatus.CORRUPT, f"{path}: expected an image, got data that do not decode; copy the file again"
        )
    return cast("ImageArray", image)


def _convert_part(in_color: Callable[[], ImageArray], region: Region) -> RgbArray:
    part = region.crop(in_color())
    # The upper eight of 16 bits.
    eight = (part >> 8).astype(np.uint8) if part.itemsize > 1 else part
    return cast("RgbArray", cv2.cvtColor(eight, cv2.COLOR_GRAY2RGB if eight.ndim == 2 else cv2.COLOR_BGR2RGB))


def _check_single_page(path: Path) -> None:
    with path.open("rb") as file:
        is_tiff = file.read(2) in _TIFF
    pages = cv2.imcount(str(path)) if is_tiff else 1
    if pages > 1:
        raise VideoError(f"{path}: expected one image a file, got {pages} pages; write every page to a file of its own")


def _size_words(size: tuple[int, ...]) -> str:
    return f"{size[1]} x {size[0]} px of {size[2]} bits"
