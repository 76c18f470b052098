"""What a video file says of the camera that recorded it: maker, model, lens, mode and stabilisation.

Phones and cameras write these as metadata of the container; GoPro writes its settings as a structure of its own into
the box ``GPMF``, and Apple the lens into the metadata of the track.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vfm_sdm.inputs.video.boxes import read_boxes

__all__ = ["CameraTags", "read_camera_tags"]

_MAKE = ("com.apple.quicktime.make", "com.android.manufacturer", "make", "manufacturer")
_MODEL = ("com.apple.quicktime.model", "com.android.model", "model", "model_name")
_FILM = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
_LENS = ("com.apple.quicktime.camera.lens_model", "lens_model", "lens")
_GOPRO_MODES = {"W": "Wide", "L": "Linear", "S": "SuperView", "N": "Narrow", "M": "Medium", "H": "HyperView"}
"""Letters of GoPro's field of view (VFOV)."""
_FIRMWARE = re.compile(r"^H[DX]?\d{1,2}\.\d\d\.")
"""Name of a GoPro's firmware, which begins with its model."""
_FILM_LIMITS_MM = (6.0, 1000.0)


@dataclass(frozen=True)
class CameraTags:
    """What a file says of its camera; empty where it says nothing.

    Parameters
    ----------
    make, model
        Names as the file has them.
    texts
        What it says of lens and mode.
    film_mm
        Focal length that gives the same field of view on 35 mm film [mm].
    stabilised
        Whether the picture is stabilised by cropping.
    """

    make: str = ""
    model: str = ""
    texts: tuple[str, ...] = ()
    film_mm: float | None = None
    stabilised: bool | None = None


def read_camera_tags(metadata: Mapping[str, str], path: Path) -> CameraTags:
    """What a video says of its camera.

    Parameters
    ----------
    metadata
        Metadata of the container and its stream, as the demuxer gives them.
    path
        The file; boxes that the demuxer leaves out are read from it.

    Examples
    --------
    >>> tags = {"com.android.manufacturer": "Google", "com.android.model": "Pixel 7"}
    >>> read_camera_tags(tags, Path("none.mp4"))
    CameraTags(make='Google', model='Pixel 7', texts=(), film_mm=None, stabilised=None)
    """
    found = {key.casefold(): value.strip("\0 ") for key, value in {**read_boxes(path), **metadata}.items() if value}
    make, model, lens = (next((found[key] for key in keys if key in found), "") for keys in (_MAKE, _MODEL, _LENS))
    texts = [lens] if lens else []
    firmware = next((found[key] for key in ("fmwr", "firm", "firmware") if key in found), "")
    if "minf" in found or _FIRMWARE.match(firmware):
        make, model = "GoPro", found.get("minf") or ".".join(firmware.split(".")[:2])
        mode = found.get("vfov", "")
        texts = [_GOPRO_MODES.get(mode, mode)] if mode else []
    return CameraTags(make, model, tuple(texts), _read_film(found.get(_FILM, "")), _read_stabilised(found))


def _read_film(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if _FILM_LIMITS_MM[0] <= number <= _FILM_LIMITS_MM[1] else None


def _read_stabilised(found: Mapping[str, str]) -> bool | None:
    """What GoPro says was applied (EISA: ``N``, ``Y``, ``HS EIS``, ...), else what was asked for (EISE)."""
    for key in ("eisa", "eise"):
        said = found.get(key, "").upper()
        if said and said != "N/A":
            return said not in ("N", "NO", "OFF")
    return None
