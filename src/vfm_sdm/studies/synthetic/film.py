"""Frames of one view of a virtual field test: the moving scene through lens, light, shutter, sensor and processing."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.studies.synthetic.defects import (
    BLACK,
    add_glare,
    compute_exposure_times,
    compute_row_delays,
    compute_stabilization_path,
    defocus,
    lower_light,
    sharpen,
    warp,
)
from vfm_sdm.studies.synthetic.disturbances import Disturber, Stage
from vfm_sdm.studies.synthetic.imager import Imager
from vfm_sdm.studies.synthetic.lighting import Shading
from vfm_sdm.studies.synthetic.motion import Motion
from vfm_sdm.studies.synthetic.photometry import DepthBlur, Photometry, compute_blur, compute_vignetting
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
    camera, photometry = plan.site.cameras()[view], plan.recordings[view].photometry
    behind = None if scene.backdrop is None else Renderer(scene.backdrop, camera, reach_m=0.0)
    backdrop = None if behind is None else _focused(behind, photometry)(behind.luma_at_rest)
    renderer = Renderer(scene, camera, reach_m=1.02 * largest + 1e-5, backdrop=backdrop)
    chroma = renderer.chroma_at_rest(behind)
    return _frames(plan, _LitRenderer(renderer, behind), view, fastest), chroma


class _LitRenderer:
    """Pictures of the displaced scene with the shadows of an instant."""

    def __init__(self, renderer: Renderer, behind: Renderer | None = None) -> None:
        self.renderer, self._behind = renderer, behind
        scene, self._shading = renderer.scene, None
        if scene.light is not None and scene.light.canopy is not None:
            self._shading = Shading(
                scene.light,
                planes=renderer.face_planes,
                rays=renderer.rays,
                pose=renderer.camera.cam_from_world,
            )

    def depth_at_rest(self) -> FloatArray:
        """Distance of what each pixel shows along the optical axis, also behind the scene, shape (H, W) [m]."""
        depth = self.renderer.depth_at_rest()
        if self._behind is None:
            return depth
        return np.where(self.renderer.face_at_rest < 0, self._behind.depth_at_rest(), depth)

    def picture(self, motion: Motion, time_s: float, read_out_s: float) -> _Luma:
        """Luma at an instant; with a rolling shutter each band of rows at its own."""
        luma = _picture(self.renderer, motion, time_s, read_out_s)
        return luma if self._shading is None else self._shading.draw(luma, self.renderer.face_drawn, time_s)


def _focused(renderer: Renderer, photometry: Photometry | None) -> Callable[[_Luma], _Luma]:
    """What the lens's depth of field does to pictures of a scene."""
    if photometry is None or photometry.aperture_mm == 0:
        return _unchanged
    sigma_px = compute_blur(photometry, renderer.camera.focal_px, renderer.depth_at_rest())
    # Where the backdrop is seen, it is out of focus already.
    behind = renderer.face_at_rest < 0
    return DepthBlur(np.where(behind, 0.0, sigma_px))


def _unchanged(luma: _Luma) -> _Luma:
    return luma


def _stages(plan: Preset, lit: _LitRenderer, view: int) -> list[Stage]:
    """What happens to a picture between the scene and the sensor, in this order."""
    recording, renderer, stages = plan.recordings[view], lit.renderer, list[Stage]()
    photometry, glare = recording.photometry, recording.glare
    disturber = Disturber(
        recording.disturbances,
        renderer.camera,
        seed=(plan.seed, view),
        exposure_s=recording.exposure_s,
        photometry=photometry,
    )
    if photometry is not None and photometry.aperture_mm > 0:
        focused = _focused(renderer, photometry)
        stages.append(lambda luma, number, time_s: focused(luma))
    stages += disturber.before_lens(renderer.rays, lit.depth_at_rest())
    if recording.defocus_px > 0:
        stages.append(lambda luma, number, time_s: defocus(luma, recording.defocus_px))
    if photometry is not None and photometry.vignetting > 0:
        share = compute_vignetting(photometry, renderer.camera)
        stages.append(lambda luma, number, time_s: np.float32(BLACK) + (luma - np.float32(BLACK)) * share)
    if glare is not None:
        stages.append(lambda luma, number, time_s: add_glare(luma, glare, time_s=time_s))
    stages += disturber.after_lens(recording.rolling_shutter_s)
    if recording.light < 1:
        stages.append(lambda luma, number, time_s: lower_light(luma, recording.light))
    if recording.stabilization is not None:
        time_s, size = plan.frame_times(view), renderer.camera.image_size
        motion_px = _dominant_motion(plan, renderer, time_s)
        paths = compute_stabilization_path(time_s, motion_px, recording.stabilization, image_size=size)
        stages.append(lambda luma, number, time_s: warp(luma, paths[number]))
    if recording.sharpening > 0:
        stages.append(lambda luma, number, time_s: sharpen(luma, recording.sharpening))
    return stages


def _frames(plan: Preset, lit: _LitRenderer, view: int, fastest: float) -> Iterator[npt.NDArray[np.uint8]]:
    recording, renderer = plan.recordings[view], lit.renderer
    moved_px = fastest * recording.exposure_s * renderer.pixels_per_metre
    samples = max(1, int(np.ceil(moved_px / _BLUR_STEP_PX)))
    imager = Imager(
        renderer.camera.image_size,
        noise_std=recording.noise_std,
        seed=(plan.seed, view),
        photometry=recording.photometry,
    )
    stages, shown = _stages(plan, lit, view), np.empty(0, np.uint8)
    repeated = plan.repeated(view)
    for number, time in enumerate(plan.frame_times(view)):
        if repeated[number]:
            yield shown
            continue
        instants = compute_exposure_times(float(time), recording.exposure_s, samples)
        luma = _exposed(lit, plan.motion, instants, recording.rolling_shutter_s)
        for stage in stages:
            luma = stage(luma, number, float(time))
        shown = imager.expose(luma, number)
        yield shown


def _exposed(lit: _LitRenderer, motion: Motion, instants: FloatArray, read_out_s: float) -> _Luma:
    """Mean of the pictures at some instants."""
    pictures = [lit.picture(motion, float(instant), read_out_s) for instant in instants]
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
