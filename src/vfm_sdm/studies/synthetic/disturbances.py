"""Everything unkind between a scene and a file: settings of one camera, their effects on pictures, and the truth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.studies.synthetic.defects import BLACK, Frame, compute_row_delays
from vfm_sdm.studies.synthetic.exposure import ExposureStep, Flicker, compute_step_gain
from vfm_sdm.studies.synthetic.obstacles import Blob, Branch, Passer, cover
from vfm_sdm.studies.synthetic.optics import LateralColour, Shake, compute_turn_fields, resample, spread_colours
from vfm_sdm.studies.synthetic.photometry import Photometry, compute_blur
from vfm_sdm.studies.synthetic.timing import Timing
from vfm_sdm.studies.synthetic.weather import Haze, Rain, add_rain

__all__ = ["Disturbances", "Disturber", "Stage", "random_stream"]

Stage = Callable[[Frame, int, float], Frame]
"""From a picture, the number of its frame and its time [s] to the picture as it goes on."""

_STREAMS = ("shake", "rain", "branches", "timing")


def random_stream(seed: int, view: int, kind: str) -> tuple[int, int, int]:
    """Seed of one disturbance of one view; switching another one off leaves it as it is.

    Parameters
    ----------
    seed, view
        Of the plan, and the number of the view.
    kind
        ``shake``, ``rain``, ``branches`` or ``timing``.
    """
    return seed, view, 1 + _STREAMS.index(kind)


@dataclass(frozen=True)
class Disturbances:
    """What one camera suffers; each is off by default, in the order in which they act on light.

    Parameters
    ----------
    haze
        Air between camera and scene.
    passers, branches
        What hides a part of the picture.
    rain
        Streaks of drops.
    shake
        Wind on the tripod.
    lateral_colour
        Of the lens.
    exposure_steps, flicker
        Of the light that a frame gets.
    timing
        Of frames and stamps.
    bits_per_pixel
        Of the encoder, which then has this rate instead of a constant quality; 0 for that [1].

    Raises
    ------
    DatasetError
        The rate is negative.
    """

    haze: Haze | None = None
    passers: tuple[Passer, ...] = ()
    branches: tuple[Branch, ...] = ()
    rain: Rain | None = None
    shake: Shake | None = None
    lateral_colour: LateralColour | None = None
    exposure_steps: tuple[ExposureStep, ...] = ()
    flicker: Flicker | None = None
    timing: Timing | None = None
    bits_per_pixel: float = 0.0

    def __post_init__(self) -> None:
        if not self.bits_per_pixel >= 0:
            raise DatasetError(f"bits_per_pixel: expected >= 0, got {self.bits_per_pixel}; correct it")

    def gain(self, time_s: float, exposure_s: float, delays_s: FloatArray | float = 0.0) -> FloatArray:
        """Light of a frame relative to the plan's [1], for each delay.

        Parameters
        ----------
        time_s
            Middle of its exposure [s].
        exposure_s
            Its duration [s].
        delays_s
            Of rows that are read later, shape (...) [s].
        """
        lamps = 1.0 if self.flicker is None else self.flicker.gain(time_s + np.asarray(delays_s), exposure_s)
        return np.asarray(compute_step_gain(self.exposure_steps, time_s) * lamps * np.ones(np.shape(delays_s)))

    def blobs(self, time_s: float, camera: Camera, *, seed: tuple[int, ...]) -> list[tuple[float, list[Blob]]]:
        """Distances of what hides parts of the picture [m], and its patches, the farthest first.

        Parameters
        ----------
        time_s
            True time [s].
        camera
            The camera.
        seed
            Of the branches, `random_stream`.
        """
        size = camera.image_size
        near = [(passer.distance_m, passer.blobs(time_s, camera.focal_px, size)) for passer in self.passers]
        near += [
            (branch.distance_m, branch.blobs(time_s, size, seed=(*seed, number)))
            for number, branch in enumerate(self.branches)
        ]
        return sorted(near, key=lambda each: -each[0])


class Disturber:
    """The disturbances of one camera as stages of its pictures.

    Parameters
    ----------
    disturbances
        Settings.
    camera
        The camera.
    seed
        Of the plan, and the number of the view.
    exposure_s
        Of a frame [s].
    photometry
        Of the lens; without it nothing near is out of focus.
    """

    def __init__(
        self,
        disturbances: Disturbances,
        camera: Camera,
        *,
        seed: tuple[int, int],
        exposure_s: float,
        photometry: Photometry | None = None,
    ) -> None:
        self._settings, self._camera, self._seed = disturbances, camera, seed
        self._exposure_s, self._photometry = exposure_s, photometry

    def before_lens(self, rays: FloatArray, depth_m: FloatArray) -> list[Stage]:
        """What happens between the scene and the lens's vignetting.

        Parameters
        ----------
        rays
            Of the pixels, shape (H, W, 2) [1].
        depth_m
            Along the optical axis of what each shows, shape (H, W) [m].
        """
        settings, stages = self._settings, list[Stage]()
        if settings.haze is not None:
            distance_m = depth_m * np.sqrt(1 + np.sum(rays**2, axis=-1))
            left = settings.haze.transmission(distance_m).astype(np.float32)
            veil = np.float32(settings.haze.airlight) * (1 - left)
            stages.append(lambda luma, number, time_s: left * luma + veil)
        if settings.passers or settings.branches:
            stages.append(self._hide)
        if settings.rain is not None:
            rain, stream = settings.rain, random_stream(*self._seed, "rain")
            stages.append(lambda luma, number, time_s: add_rain(luma, rain, seed=(*stream, number)))
        if settings.shake is not None:
            stages.append(self._shaken(settings.shake, rays))
        if settings.lateral_colour is not None:
            colour, (u, v) = settings.lateral_colour, self._camera.K[:2, 2].tolist()
            stages.append(lambda luma, number, time_s: spread_colours(luma, colour, (u, v)))
        return stages

    def after_lens(self, read_out_s: float) -> list[Stage]:
        """What happens to the light before the sensor; rows get it at their own time.

        Parameters
        ----------
        read_out_s
            Of the rolling shutter [s].
        """
        settings, exposure_s = self._settings, self._exposure_s
        if settings.flicker is None and not settings.exposure_steps:
            return []
        delays = compute_row_delays(self._camera.image_size[1], read_out_s)

        def expose(luma: Frame, number: int, time_s: float) -> Frame:
            gain = settings.gain(time_s, exposure_s, delays).astype(np.float32)[:, None]
            return np.float32(BLACK) + gain * (luma - np.float32(BLACK))

        return [expose]

    def _hide(self, luma: Frame, number: int, time_s: float) -> Frame:
        seed = random_stream(*self._seed, "branches")
        before = self._settings.blobs(time_s - 0.5 * self._exposure_s, self._camera, seed=seed)
        after = self._settings.blobs(time_s + 0.5 * self._exposure_s, self._camera, seed=seed)
        for (distance_m, blobs), (_, later) in zip(before, after, strict=True):
            moved = np.subtract(later[0].center_px, blobs[0].center_px) if blobs else np.zeros(2)
            out_of_focus = 0.0
            if self._photometry is not None:
                out_of_focus = float(compute_blur(self._photometry, self._camera.focal_px, np.array(distance_m)))
            # A uniform motion of length L has a standard deviation of L / sqrt(12).
            luma, _ = cover(luma, blobs, float(np.hypot(out_of_focus, np.linalg.norm(moved) / np.sqrt(12))))
        return luma

    def _shaken(self, shake: Shake, rays: FloatArray) -> Stage:
        fields = compute_turn_fields(self._camera, rays)
        rows, columns = np.indices(rays.shape[:2], dtype=np.float32)
        seed = random_stream(*self._seed, "shake")

        def turn(luma: Frame, number: int, time_s: float) -> Frame:
            moved = np.tensordot(shake.turns([time_s], seed=seed)[0].astype(np.float32), fields, axes=1)
            return resample(luma, columns - moved[0], rows - moved[1])

        return turn
