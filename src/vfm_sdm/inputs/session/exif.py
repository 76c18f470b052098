"""The focal length that a camera wrote into its photographs."""

from math import hypot
from pathlib import Path

from PIL import Image, UnidentifiedImageError
from PIL.ExifTags import IFD, Base

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.lens import Lens

__all__ = ["lens_from_exif"]

_RELATIVE_STD = 0.05
_FILM_DIAGONAL_MM = hypot(36.0, 24.0)
_UNITS_IN_MM = {2: 25.4, 3: 10.0, 4: 1.0}
"""FocalPlaneResolutionUnit: inch, centimetre, millimetre."""


def lens_from_exif(image_path: Path | str) -> Lens | None:
    """A weak prior on the focal length from a photograph's EXIF data; None where they do not tell.

    Parameters
    ----------
    image_path
        A photograph as the camera wrote it (JPEG, TIFF), taken with the settings of the recording.

    Returns
    -------
    Lens or None
        With a relative standard deviation of 5 %.

    Raises
    ------
    SessionError
        The file is missing or is not an image.

    Notes
    -----
    ``FocalLengthIn35mmFilm`` is read as the focal length that gives the same diagonal angle of view on 36 x 24 mm
    film. Else the focal length is ``FocalLength`` times ``FocalPlaneXResolution``. The sensor's width is that along the
    picture's longer side, however the picture lies in its file: upright photographs are stored lying, with an
    orientation, or turned by a program. Video is often cropped from the sensor's area, which EXIF data of a photograph
    cannot show: a lens and sensor width from the data sheet are better.
    """
    path = Path(image_path)
    try:
        with Image.open(path) as image:
            width, height = image.size
            tags = image.getexif().get_ifd(IFD.Exif)
    except FileNotFoundError as error:
        raise SessionError(f"{path}: expected a photograph, got no such file; check the path") from error
    except (UnidentifiedImageError, OSError) as error:
        raise SessionError(f"{path}: expected a photograph, got no readable image; pass a JPEG or TIFF") from error
    film_mm = _positive(tags.get(Base.FocalLengthIn35mmFilm))
    if film_mm is not None:
        sensor_width_mm = _FILM_DIAGONAL_MM * max(width, height) / hypot(width, height)
        return Lens(focal_mm=film_mm, sensor_width_mm=sensor_width_mm, relative_std=_RELATIVE_STD)
    focal_mm = _positive(tags.get(Base.FocalLength))
    resolution = _positive(tags.get(Base.FocalPlaneXResolution))
    unit_mm = _UNITS_IN_MM.get(tags.get(Base.FocalPlaneResolutionUnit, 2))
    if focal_mm is None or resolution is None or unit_mm is None:
        return None
    # The resolution counts pixels of the picture as taken, of which this file may be a smaller copy.
    taken = [_positive(tags.get(tag)) for tag in (Base.ExifImageWidth, Base.ExifImageHeight)]
    copied = max(width, height) / max((side for side in taken if side is not None), default=max(width, height))
    focal_px = focal_mm / unit_mm * resolution * copied
    return Lens(focal_px=focal_px, relative_std=_RELATIVE_STD)


def _positive(value: object) -> float | None:
    """The number of a tag; None for the zero, infinity or text that cameras write when they do not know."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < float("inf") else None
