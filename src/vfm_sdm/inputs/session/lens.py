"""What is known of a lens before looking at the images."""

from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session.site import Entry, not_below

__all__ = ["Lens"]

_Millimetres = Annotated[float, Strict(), Field(gt=0, le=1e5), not_below(1e-2)]


class Lens(Entry):
    """What is known of the focal length before looking at the images.

    Either ``focal_mm`` and ``sensor_width_mm`` (the true focal length, and the longer side of the sensor area that is
    recorded), or ``focal_px``, in pixels along that side. ``relative_std`` is the relative standard deviation of the
    focal length [1].
    """

    focal_mm: _Millimetres | None = None
    sensor_width_mm: _Millimetres | None = None
    focal_px: Annotated[float, Strict(), Field(gt=0, le=1e7), not_below(1)] | None = None
    relative_std: Annotated[float, Strict(), Field(gt=0, le=10), not_below(1e-7)] = 0.02

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        millimetres = (self.focal_mm is not None, self.sensor_width_mm is not None)
        if self.focal_px is not None and any(millimetres):
            raise ValueError("expected focal_px or focal_mm with sensor_width_mm, got both; keep one of them")
        if self.focal_px is None and not all(millimetres):
            raise ValueError("expected focal_px, or focal_mm with sensor_width_mm, got neither complete; add them")
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
            The width is not positive.
        """
        if image_width <= 0:
            raise SessionError(f"image_width: expected pixels > 0, got {image_width}; pass the width of the video")
        if self.focal_px is not None:
            return self.focal_px
        if self.focal_mm is None or self.sensor_width_mm is None:
            raise SessionError("lens: expected focal_px, or focal_mm with sensor_width_mm, got neither; add them")
        return self.focal_mm / self.sensor_width_mm * image_width
