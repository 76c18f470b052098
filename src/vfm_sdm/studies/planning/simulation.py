"""A planned measurement without images: exact matches and tracks through the program's own adjustment and budget."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.core.datasets import Status, make_points, make_tracks
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.site import SiteAdjustment, adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.matching.matches import Matches
from vfm_sdm.stages.registration.reference_subsets import prepare_subsets
from vfm_sdm.stages.tracking.track_noise import include_track_noise
from vfm_sdm.studies.planning.layout import Layout

__all__ = ["MATCH_STD_PX", "adjust", "list_matches", "measure_exactly", "predict_noise_px", "simulate_tracks"]

_GRID = 12
"""Matches along each side of the first picture: two by two in each cell of the adjustment."""
_LEAST_MATCH_STD_PX, MATCH_STD_PX = 0.25, 0.35
"""Standard deviation of what the matches of a cell share [px]: the least that the adjustment takes, and that planned
with, the root of two more, because in films only about half of the cells that could hold matches do."""
_PLACE_STD_PX = 0.05
"""How well the same point is found in a further view [px]: registered subsets of 41 px."""
_GAIN_STD, _PART_GAIN_STD = 0.002, 0.01
"""Least standard deviation of a track's gain after injected motion, and of the gains of a subset's parts [1]."""
_GAIN_NOISE, _PART_NOISE = 0.5, 1.2
"""What noise adds to both: times the noise of one frame (of `_GAIN_FRAMES` frames; of all its own noise), over the root
mean square of the motion in the picture [1]."""
_GAIN_FRAMES, _MOST_GAIN_FRAMES = 60, 180
"""Moving frames of the films that `_GAIN_NOISE` is from, and the most that motion is put into."""
_LARGEST_GAIN_STD = 0.3
_SUBSET_PX = 41
_GREY_NOISE = 0.68
"""Noise of a recorded picture as registration sees it, a sensor of one grey level smoothed by a codec [grey levels]."""
_BITS_PER_PIXEL = np.array([0.07, 0.33, 0.5, 1.0, 1.3, 2.8])
_CODEC_PX = np.array([0.032, 0.014, 0.010, 0.005, 0.0032, 0.001])
"""Error that a codec adds to each frame's track [px] by the size of the recording [bit a pixel]: rendered films of
640 x 360 px, the ends from docs/decisions/008-compression.md."""
_TEXTURE_PX = 3.0
"""Wavelength of the finest texture that a lens draws, over its standard deviation as a filter [px]."""
_SEED = 14


def adjust(laid: Layout, matches: Sequence[Matches]) -> SiteAdjustment:
    """The site adjustment of a plan, with exact values and their standard deviations.

    Parameters
    ----------
    laid
        The plan.
    matches
        Of `list_matches`.
    """
    known = laid.priors
    session, pixels = laid.session, laid.pixels
    seen = {
        one.name: SitePoint(at, on_face=not one.static)
        for one, at in zip(laid.plan.point, pixels.swapaxes(0, 1), strict=True)
        if np.isfinite(at).all(axis=1).sum() >= 2
    }
    readings = {view.name: view for view in session.view[1:]}
    posed = [
        replace(camera, cam_from_world=true.cam_from_world)
        for camera, true in zip(known.cameras, laid.rig.cameras, strict=True)
    ]
    start = known.metric_rig(posed)
    return adjust_to_site(start, matches, session.site, seen, readings=readings)


def list_matches(laid: Layout) -> list[Matches]:
    """Exact matches of every two views, on the face and on what lies behind it.

    Parameters
    ----------
    laid
        The plan.

    Notes
    -----
    Rays of a grid over the first picture end on the face, or on a background that is near where it is low and far where
    it is high. A match needs both pictures, and nothing of the face before it.
    """
    scene, on_face = _scene_points(laid)
    pixels = np.stack([camera.project(scene) for camera in laid.cameras])
    sizes = np.array([camera.image_size for camera in laid.cameras])[:, None]
    with np.errstate(invalid="ignore"):
        seen = ((pixels >= 0) & (pixels <= sizes - 1)).all(axis=-1)
    seen &= np.stack([on_face | ~_behind_face(laid, scene, camera.center) for camera in laid.cameras])
    stated = float(np.sqrt(MATCH_STD_PX**2 - _LEAST_MATCH_STD_PX**2))
    found = []
    for first in range(len(laid.cameras)):
        for second in range(first + 1, len(laid.cameras)):
            both = seen[first] & seen[second]
            found.append(Matches(first, second, pixels[first, both], pixels[second, both], on_face[both], stated))
    return found


def _scene_points(laid: Layout) -> tuple[FloatArray, BoolArray]:
    """Places that the first picture shows on a grid, shape (N, 3) [m], and whether each lies on the face."""
    camera, (lateral, upper, lower, start, end) = laid.cameras[0], laid.face_m
    size = np.array(camera.image_size)
    cells = (np.stack(np.meshgrid(*[np.arange(_GRID)] * 2), axis=-1).reshape(-1, 2) + 0.5) / _GRID
    rays = np.column_stack([camera.normalize(cells * size - 0.5), np.ones(len(cells))]) @ camera.rotation
    ahead = rays[:, 0] > 1e-6
    rays = rays[ahead] / rays[ahead, :1]
    at = rays * lateral
    on_face = (at[:, 1] > upper) & (at[:, 1] < lower) & (at[:, 2] > start) & (at[:, 2] < end)
    near, far = laid.plan.structure.background_m
    # What is low is near, what is high is far: a bank below, trees or houses above.
    behind = np.where(rays[:, 1] * (lateral + far) < 0.5 * (upper + lower), far, near)
    return rays * (lateral + np.where(on_face, 0.0, behind))[:, None], np.asarray(on_face)


def _behind_face(laid: Layout, points: FloatArray, center: FloatArray) -> BoolArray:
    """Whether the face stands between a camera and each point, shape (N,)."""
    lateral, upper, lower, start, end = laid.face_m
    ray = points - center
    with np.errstate(divide="ignore", invalid="ignore"):
        step = (lateral - center[0]) / ray[:, 0]
        at = center + step[:, None] * ray
        hit = (at[:, 1] > upper) & (at[:, 1] < lower) & (at[:, 2] > start) & (at[:, 2] < end)
    return np.asarray(hit & (step > 0) & (step < 1 - 1e-9))


def simulate_tracks(laid: Layout, *, seed: int = _SEED) -> dict[str, xr.Dataset]:
    """Tracks of all points in every view, with the expected motion and noise as it is predicted.

    Parameters
    ----------
    laid
        The plan.
    seed
        Of the noise.

    Returns
    -------
    tracks
        By view, shape (T, P, 2) [px].
    """
    plan, rng = laid.plan, np.random.default_rng(seed)
    own_px = predict_noise_px(plan.structure.contrast) if plan.structure.noise_px is None else plan.structure.noise_px
    clock, names = np.arange(plan.frames) / plan.fps, [point.name for point in plan.point]
    moved = laid.motion.displacement(clock, laid.points3d) * ~laid.static[:, None]
    visible, tracks = laid.visible(), {}
    for number, (view, camera) in enumerate(zip(laid.priors.names, laid.cameras, strict=True)):
        bits = _bits_per_pixel(laid, number)
        # A stated noise is that of the tracks, whatever the codec.
        codec_px = 0.0 if plan.structure.noise_px is not None else _codec_noise_px(bits)
        noise_px = float(np.hypot(own_px, codec_px))
        position = camera.project((laid.points3d + moved).reshape(-1, 3)).reshape(*moved.shape[:2], 2)
        motion_px = position[clock >= plan.still_s + laid.motion.onset_s].std(axis=0)
        position += noise_px * rng.standard_normal(position.shape)
        covariance = np.broadcast_to(noise_px**2 * np.eye(2), (*position.shape[:2], 2, 2)).copy()
        outside = ~visible[number]
        position[:, outside], covariance[:, outside] = np.nan, np.nan
        status = np.where(outside, int(Status.OUTSIDE), int(Status.OK)) * np.ones((len(clock), 1), int)
        facts = {"tracker": "planned", "view": view, "recording": {"bits_per_pixel": bits}}
        size = {"image_width": camera.image_size[0], "image_height": camera.image_size[1]}
        made = include_track_noise(make_tracks(clock, names, position, covariance, status, attrs={**facts, **size}))
        frames = min(plan.frames, _MOST_GAIN_FRAMES)
        injected = _GAIN_NOISE * noise_px * np.sqrt(_GAIN_FRAMES / frames)
        tracks[view] = made.assign(
            gain_left_std=(("point", "direction"), _gain_std(_GAIN_STD, injected, motion_px), {"units": "1"}),
            part_gain_std=(
                ("point", "direction"),
                _gain_std(_PART_GAIN_STD, _PART_NOISE * own_px, motion_px),
                {"units": "1"},
            ),
        )
    return tracks


def _gain_std(least: float, noise_px: float, motion_px: FloatArray) -> FloatArray:
    """Standard deviation of a gain that is told by a motion, shape (P, 2) [1]."""
    return np.minimum(np.hypot(least, noise_px / np.maximum(motion_px, 1e-9)), _LARGEST_GAIN_STD)


def _codec_noise_px(bits_per_pixel: float) -> float:
    """What a codec adds to the noise of one frame's track [px]; nothing where the bit rate is not stated."""
    if not np.isfinite(bits_per_pixel):
        return 0.0
    return float(np.exp(np.interp(np.log(bits_per_pixel), np.log(_BITS_PER_PIXEL), np.log(_CODEC_PX))))


def _bits_per_pixel(laid: Layout, number: int) -> float:
    one = laid.plan.camera[number]
    if one.bitrate_mbit_s is None:
        return float("inf")
    return float(1e6 * one.bitrate_mbit_s / laid.plan.fps / np.prod(one.image_size))


def predict_noise_px(contrast: float) -> float:
    """Standard deviation of one frame's track of a surface, by the registration of an artificial texture [px].

    Parameters
    ----------
    contrast
        Standard deviation of the texture [grey levels of 8 bits].

    Notes
    -----
    Both the reference and the current frame have the noise of a recorded picture.
    """
    rng = np.random.default_rng(_SEED)
    side = 3 * _SUBSET_PX
    texture = gaussian_filter(rng.standard_normal((side, side)), _TEXTURE_PX / np.sqrt(2))
    luma = np.clip(np.round(128 + contrast * texture / texture.std()), 0, 255).astype(np.uint8)
    middle = np.array([[side // 2, side // 2]])
    subset = prepare_subsets(luma, (middle, np.zeros((1, 2))), _SUBSET_PX // 2)
    return float(_GREY_NOISE * np.sqrt(2 * np.trace(subset.unit_covariance[0]) / 2))


def measure_exactly(laid: Layout, adjusted: SiteAdjustment, tracks: dict[str, xr.Dataset]) -> xr.Dataset:
    """Displacement with its uncertainty budget, as a measurement of these tracks with these cameras states it.

    Parameters
    ----------
    laid
        The plan.
    adjusted
        Of `adjust`.
    tracks
        Of `simulate_tracks`.

    Returns
    -------
    displacement
        Shape (T, P, 3) [mm], with the budget of `vfm_sdm.stages.displacement.uncertainty.add_uncertainty`.

    Raises
    ------
    DatasetError
        The cameras do not allow displacement.
    SessionError
        The motion does not tell the offset between the cameras.
    """
    pixels = np.where(laid.visible()[..., None], laid.pixels, np.nan)
    std = np.where(np.isfinite(pixels), _PLACE_STD_PX, np.nan)
    std[0] = np.where(np.isfinite(pixels[0]), 0.0, np.nan)
    status = np.where(np.isfinite(pixels).all(axis=-1), PointStatus.OK, PointStatus.NOT_FOUND)
    names = [point.name for point in laid.plan.point]
    places = make_points(list(laid.priors.names), names, position=pixels, position_std=std, status=status)
    solution = CameraSolution.of(adjusted, places)
    displacement = Measurement(laid.session).given(cameras=solution, tracks=tracks, frames={}).displacement
    if displacement is None:
        raise DatasetError(f"plan: expected displacement, got none: {adjusted.status}; change the plan")
    if not np.isfinite(displacement["clock_offset_std"].values).all():
        raise SessionError(
            f"duration_s: expected motion that tells the offset between the cameras, got {laid.plan.duration_s:g} s of "
            'it; record longer, or start the cameras together (synchronization = "none" with time_offset_std_s)'
        )
    return displacement
