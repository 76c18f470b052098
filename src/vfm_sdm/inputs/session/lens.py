"""What is known of a lens before looking at the images."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PlainSerializer, Strict, model_validator

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.profiles import find_camera
from vfm_sdm.inputs.session.site import Entry, Name, not_below

__all__ = ["Lens"]

_Millimetres = Annotated[float, Strict(), Field(gt=0, le=1e5), not_below(1e-2)]
_File = Annotated[Path, PlainSerializer(lambda path: path.as_posix(), return_type=str)]
_FORMS = "focal_px, focal_mm with sensor_width_mm, file, or camera"


class Lens(Entry):
    """What is known of the focal length before looking at the images.

    One of ``focal_mm`` with ``sensor_width_mm`` (the true focal length, and the longer side of the sensor area that is
    recorded), ``focal_px``, in pixels along that side, ``file``, which `vfm-sdm lens` wrote from a pan clip and which
    also holds principal point, distortion and their covariance, and ``camera``, of which profiles are known
    (`vfm_sdm.inputs.profiles`). ``relative_std`` is the relative standard deviation of a focal length that is stated
    here [1].
    """

    focal_mm: _Millimetres | None = None
    sensor_width_mm: _Millimetres | None = None
    focal_px: Annotated[float, Strict(), Field(gt=0, le=1e7), not_below(1)] | None = None
    file: _File | None = None
    """Lens file; a relative path starts at the session's folder."""
    camera: Name | None = None
    """Maker and model, or ``phone``, ``action camera``, ``drone`` or ``camera``."""
    mode: Name | None = None
    """Its setting: a word for the field of view such as ``Linear``, or a focal length such as ``26mm``."""
    stabilised: bool | None = None
    """Whether the camera crops the picture to stabilise it; where that is not stated either may be true."""
    relative_std: Annotated[float, Strict(), Field(gt=0, le=10), not_below(1e-7)] = 0.02

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        millimetres = {"focal_mm": self.focal_mm, "sensor_width_mm": self.sensor_width_mm}
        stated = {
            "focal_mm with sensor_width_mm": any(value is not None for value in millimetres.values()),
            "focal_px": self.focal_px is not None,
            "file": self.file is not None,
            "camera": self.camera is not None,
        }
        ways = [name for name, given in stated.items() if given]
        if len(ways) > 1:
            raise ValueError(f"expected one of {_FORMS}, got {' and '.join(ways)}; keep one of them")
        missing = [name for name, value in millimetres.items() if value is None]
        if not ways or ("focal_mm" in ways[0] and missing):
            got = "none" if not ways else f"no {missing[0]}"
            raise ValueError(f"expected {_FORMS}, got {got}; add it")
        if self.file is not None and "relative_std" in self.model_fields_set:
            raise ValueError("relative_std: expected none beside a lens file, which states its own; remove it")
        if self.camera is not None:
            if "relative_std" in self.model_fields_set:
                raise ValueError("relative_std: expected none beside camera, whose profiles tell it; remove it")
            find_camera(self.camera)
        elif self.mode is not None or self.stabilised is not None:
            raise ValueError("mode, stabilised: expected them beside camera, got no camera; add it")
        return self

    def focal_prior_px(self, image_width: int) -> float:
        """The focal length [px] for images of this width.

        Parameters
        ----------
        image_width
            Number of pixels along the sensor's longer side [px]; of a turned video, that before it was turned.

        Raises
        ------
        SessionError
            The width is not positive, or a lens file or profiles of a camera tell the focal length.
        """
        if image_width <= 0:
            raise SessionError(f"image_width: expected pixels > 0, got {image_width}; pass the width of the video")
        if self.focal_px is not None:
            return self.focal_px
        if self.focal_mm is None or self.sensor_width_mm is None:
            told_by = "lens file" if self.camera is None else "profile of a camera"
            raise SessionError(f"lens: expected a focal length, got a {told_by}; read that one")
        return self.focal_mm / self.sensor_width_mm * image_width
