"""What is found of a camera's motion, and how much of it static points show."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import BoolArray, FloatArray, mean_of_known
from vfm_sdm.core.statuses import CameraMotionStatus

__all__ = [
    "CameraMotion",
    "ViewMotion",
    "compute_predicted_share",
    "compute_scatter",
    "keep_measured",
    "root_mean_square",
]

_SMALL = {CameraMotionStatus.OK, CameraMotionStatus.ONE_POINT}
_FAR = {CameraMotionStatus.FOLLOWED, CameraMotionStatus.FOLLOWED_BY_THREE}


@dataclass(frozen=True, eq=False)
class ViewMotion:
    """Motion of one camera, T frames on the view's own clock.

    Parameters
    ----------
    status
        One of `vfm_sdm.core.statuses.CameraMotionStatus`.
    static
        Names of the S static points that were used.
    rotation, rotation_std
        Shape (T, 3) [rad], about the camera's own axes right, down and forward; NaN where no static point is seen.
    translation, translation_std
        Shape (T, 3) [m], along the same axes. A point at X in the axes of the camera at rest is at ``X + w x X + s``
        in those of the moved camera, with the rotation w and the translation s; both are relative to their mean. Of a
        camera that moves far, at ``R(w) X + s`` with the rotation R of the vector w; both relative to the first frame.
    point_rms_before_px, point_rms_after_px
        Root mean square shift of each static point from its mean, shape (S,) [px]: as tracked, and less what the other
        static points predict. NaN for a single point.
    rest
        Pixels of the static points with the camera at rest, shape (S, 2) [px].
    places
        Of a camera that moves far, pixels (2,) of all points that it saw at rest, by name [px].
    """

    status: str
    static: tuple[str, ...]
    rotation: FloatArray
    rotation_std: FloatArray
    translation: FloatArray
    translation_std: FloatArray
    point_rms_before_px: FloatArray
    point_rms_after_px: FloatArray
    rest: FloatArray
    places: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def applied(self) -> bool:
        """Whether the motion was removed from the tracks."""
        return self.status in _SMALL or self.far

    @property
    def far(self) -> bool:
        """Whether it was removed by poses that were followed frame by frame."""
        return self.status in _FAR

    @property
    def rms_before_px(self) -> float:
        """Shift of the static points, root mean square over points and frames [px]; NaN without any."""
        return root_mean_square(self.point_rms_before_px)

    @property
    def rms_after_px(self) -> float:
        """What the other static points leave of it [px]; NaN with fewer than two."""
        return root_mean_square(self.point_rms_after_px)


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """Tracks without the motion of the cameras, and that motion.

    Parameters
    ----------
    tracks
        Tracks by view name, shape (T, P, 2) [px]; where the motion of a view was not removed, they are the dataset that
        was given.
    views
        Motion of each camera by view name.
    """

    tracks: Mapping[str, xr.Dataset]
    views: Mapping[str, ViewMotion]


def keep_measured(shift: FloatArray, across: FloatArray) -> FloatArray:
    """Shifts (T, S, 2) [px]; of edges, whose directions across are (S, 2), the part across."""
    part = np.einsum("tpi,pi->tp", shift, across)[..., None] * across
    return np.where(np.isfinite(across), part, shift)


def compute_predicted_share(shift: FloatArray, left: FloatArray, rest: FloatArray) -> float:
    """Share of the shifts' variance, beyond noise that is white in time, that the others predict; at most 1.

    Of a point whose rest (S, 2) [px] is known, shifts count from there: a camera that has left it may keep still in
    this part of the recording, and what was taken out before would come back.
    """
    known = np.asarray(np.isfinite(rest).all(axis=1))[:, None]
    before, after = (root_mean_square(compute_scatter(one, known)) ** 2 for one in (shift, left))
    white = root_mean_square(np.diff(left, axis=0)) ** 2
    # Twice the variance of u or v, as the difference of two frames has it, is what u and v have together.
    return (before - after) / max(before - min(white, after), np.finfo(float).tiny)


def compute_scatter(shift: FloatArray, from_rest: BoolArray | bool = False) -> FloatArray:
    """Root mean square distance from the mean over time, or from the rest, (T, S, 2) to (S,); NaN without samples."""
    squares = mean_of_known((shift - np.where(from_rest, 0.0, mean_of_known(shift))) ** 2)
    return np.asarray(np.sqrt(squares.sum(axis=-1)))


def root_mean_square(values: FloatArray) -> float:
    """Root of the mean square of what is not NaN; NaN where nothing is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
