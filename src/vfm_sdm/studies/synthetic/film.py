"""Frames of one view of a virtual field test: the moving scene through lens, light, shutter, sensor and processing."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.studies.synthetic.defects import (
    add_glare,
    compute_exposure_times,
    compute_row_delays,
    compute_stabilization_path,
    defocus,
    lower_light,
    sharpen,
    warp,
)
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.motion import Motion
from vfm_sdm.studies.synthetic.plan import Preset
from vfm_sdm.studies.synthetic.render import Displacement, Renderer
from vfm_sdm.studies.synthetic.scene import Scene

__all__ = ["film_view"]

_BLUR_STEP_PX = 0.25
"""Largest motion between two instants of one exposure [px]."""
_BAND_ROWS = 32
"""Rows that a rolling shutter exposes together."""
_STATIONS = 200
_INSTANTS_PER_FRAME = 8

_Luma = npt.NDArray[np.float32]


def film_view(plan: Preset, scene: Scene, view: int) -> tuple[Iterator[npt.NDArray[np.uint8]], npt.NDArray[np.uint8]]:
    """Frames of a view, drawn one at a time, and its chroma.

    Parameters
    ----------
    plan
        The field test.
    scene
        Scene of the field test, `vfm_sdm.studies.synthetic.footbridge.build_footbridge`.
    view
        0 for the reference view, 1 and more for the further ones.

    Returns
    -------
    frames, chroma
        Luma, shape (H, W) each, and the chroma of all frames, shape (2, H / 2, W / 2), in units of 8-bit video.
    """
    largest, fastest = _bounds(plan, view)
    renderer = Renderer(scene, plan.site.cameras()[view], reach_m=1.02 * largest + 1e-5)
    return _frames(plan, renderer, view, fastest), renderer.chroma_at_rest()


def _frames(plan: Preset, renderer: Renderer, view: int, fastest: float) -> Iterator[npt.NDArray[np.uint8]]:
    recording = plan.recordings[view]
    moved_px = fastest * recording.exposure_s * renderer.pixels_per_metre
    samples = max(1, int(np.ceil(moved_px / _BLUR_STEP_PX)))
    imager = Imager(renderer.camera.image_size, noise_std=recording.noise_std, seed=(plan.seed, view))
    time_s = plan.frame_times(view)
    paths = None
    if recording.stabilization is not None:
        motion_px = _dominant_motion(plan, renderer, time_s)
        size = renderer.camera.image_size
        paths = compute_stabilization_path(time_s, motion_px, recording.stabilization, image_size=size)
    for number, time in enumerate(time_s):
        instants = compute_exposure_times(float(time), recording.exposure_s, samples)
        luma = _exposed(renderer, plan.motion, instants, recording.rolling_shutter_s)
        if recording.defocus_px > 0:
            luma = defocus(luma, recording.defocus_px)
        if recording.glare is not None:
            luma = add_glare(luma, recording.glare, time_s=float(time))
        if recording.light < 1:
            luma = lower_light(luma, recording.light)
        if paths is not None:
            luma = warp(luma, paths[number])
        if recording.sharpening > 0:
            luma = sharpen(luma, recording.sharpening)
        yield imager.expose(luma, number)


def _exposed(renderer: Renderer, motion: Motion, instants: FloatArray, read_out_s: float) -> _Luma:
    """Mean of the pictures at some instants; with a rolling shutter each band of rows at its own."""
    pictures = [_picture(renderer, motion, float(instant), read_out_s) for instant in instants]
    return pictures[0] if len(pictures) == 1 else np.mean(pictures, axis=0, dtype=np.float32)


def _picture(renderer: Renderer, motion: Motion, time_s: float, read_out_s: float) -> _Luma:
    if read_out_s == 0:
        return renderer.render(_at(motion, time_s))
    luma, delays = renderer.luma_at_rest.copy(), compute_row_delays(renderer.camera.image_size[1], read_out_s)
    for first in range(0, len(luma), _BAND_ROWS):
        last = min(first + _BAND_ROWS, len(luma))
        renderer.render(_at(motion, time_s + float(delays[first:last].mean())), rows=(first, last), into=luma)
    return luma


def _at(motion: Motion, time_s: float) -> Displacement:
    return partial(_displacement_at, motion, time_s)


def _displacement_at(motion: Motion, time_s: float, positions: FloatArray) -> FloatArray:
    return np.asarray(motion.displacement([time_s], positions)[0])


def _bounds(plan: Preset, view: int) -> tuple[float, float]:
    """Largest displacement [m] and speed [m/s] of any point during a recording, also between its frames."""
    motion, recording, frames = plan.motion, plan.recordings[view], plan.frame_times(view)
    margin = (recording.exposure_s + recording.rolling_shutter_s) / 2
    time_s = np.linspace(frames[0] - margin, frames[-1] + margin, _INSTANTS_PER_FRAME * len(frames))
    stations = np.linspace(motion.support_m, motion.support_m + motion.span_m, _STATIONS)
    along = np.column_stack([np.zeros((_STATIONS, 2)), stations])
    displacement = motion.displacement(time_s, along)
    speed = np.gradient(displacement, time_s, axis=0)
    return float(np.linalg.norm(displacement, axis=2).max()), float(np.linalg.norm(speed, axis=2).max())


def _dominant_motion(plan: Preset, renderer: Renderer, time_s: FloatArray) -> FloatArray:
    """Motion in the image of the girder's middle in the picture, shape (T, 2) [px]."""
    middle = np.array([plan.site.perpendicular_m, 0.0, plan.site.longitudinal_m])
    moved = middle + plan.motion.displacement(time_s, middle[None])[:, 0]
    return np.asarray(renderer.camera.project(moved) - renderer.camera.project(middle))
