"""The lens from a pan clip: key frames, places seen again, a start, the adjustment, and whether to believe it."""

from dataclasses import dataclass, field, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import LensStatus
from vfm_sdm.errors import CameraError, VideoError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.lens.adjustment import AdjustedClip, adjust_clip
from vfm_sdm.stages.lens.key_frames import KeyFrames, choose_key_frames, detect_in, follow_clip
from vfm_sdm.stages.lens.scene import READOUT_S, PanScene, begin_adjustment, plain_camera
from vfm_sdm.stages.lens.sightings import Pair, join_pairs, match_key_frames
from vfm_sdm.stages.lens.start import chain_turns, search_focal
from vfm_sdm.stages.lens.steadiness import FocalCourse, follow_focal
from vfm_sdm.stages.lens.turning_camera import LENS, LEVER, Sightings, TurningCamera

__all__ = ["LensEstimate", "estimate_lens", "judge_lens", "merge_radial"]

_SIGHTINGS = 3
"""Key frames that must see a place: two tell of the turn between them alone."""
_ROUNDS, _SETTLED = 8, 0.1
"""Rounds of rates and adjustment at most, and the step of the focal length over its standard deviation that ends them:
a round begins with rates of the last one's focal length, which holds it back."""
_MOST_POINTS = 1200
_LEAST_FRAMES, _LEAST_POINTS = 5, 60
_MOST_FOCAL_STD = 0.03
_MOST_NOISE = 1e-3
"""Noise of a sighting over the longer side beyond which something else than turns moves the picture: features are found
to a fifth of that."""
_CLEAR = 4.0
_BEYOND = 4.0
"""Standard deviations of what is known before, beyond which a result is not believed."""
_LONGER, _MUCH_LONGER = 3.5, 10.0
"""Length of the lever in its standard deviations from which it is said, and from which it is refused: three normal
values are longer than the first once in 150 times. Pictures tell lever times nearness, and the focal length follows
from that; a scene ten times nearer than stated is another one."""
_MOST_DRIFT = 1e-3
_LEFT_OUT_PX = 0.1
"""What lens model and detectors leave out at the edge of the picture: errors of calibrations with good targets."""
_SQUARE = 1e-3
_WORTHWHILE, _COARSE = 0.7, 0.005


@dataclass(frozen=True, eq=False)
class LensEstimate:
    """A lens with its uncertainty.

    Parameters
    ----------
    status
        ``ok``, or what is wrong.
    camera
        Intrinsics and distortion; ``None`` where the clip did not allow an estimate.
    covariance
        Of ``log_focal, cx, cy, k1``, the first of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, shape (4, 4); NaN
        without a camera. ``k1`` stands for all radial distortion there: for what the fourth-order term has in common
        with it.
    notes
        Sentences on what was found.
    adjusted
        The adjustment, where there was one.
    course
        Focal length over time.
    """

    status: LensStatus
    camera: Camera | None = None
    covariance: FloatArray = field(default_factory=lambda: np.full((4, 4), np.nan))
    notes: tuple[str, ...] = ()
    adjusted: AdjustedClip | None = None
    course: FocalCourse | None = None

    @property
    def usable(self) -> bool:
        """Whether the lens may be taken for the recording's."""
        return self.status == LensStatus.OK

    @property
    def advice(self) -> tuple[str, ...]:
        """What would make the focal length better known."""
        if self.adjusted is None or not self.usable:
            return ()
        held = _std_without_lever(self.adjusted)
        if held < _WORTHWHILE * self.focal_std:
            return (
                f"a scene farther away, or the lens over the axes of the head, would bring {self.focal_std:.2%} to "
                f"{held:.2%}",
            )
        if self.focal_std > _COARSE:
            return ("a longer clip that turns farther, also about the lens's own axis, would tell the lens better",)
        return ()

    @property
    def focal_std(self) -> float:
        """Relative standard deviation of the focal length [1]."""
        return float(np.sqrt(self.covariance[0, 0]))


def estimate_lens(video: Video, scene: PanScene | None = None) -> LensEstimate:
    """Focal length, principal point and distortion from a clip of a camera that pans, tilts and rolls.

    Parameters
    ----------
    video
        The clip.
    scene
        How far the scene is, and how long the lever.

    Returns
    -------
    estimate
        The lens, or a status that says why there is none.

    Raises
    ------
    VideoError
        The clip cannot be decoded, or its pixels are not square.

    Notes
    -----
    A camera that only turns sees any two pictures related by ``K R K^-1``, whatever the scene [1]_: the same scene
    points in some dozens of frames determine K and the distortion. Their adjustment is
    `vfm_sdm.stages.lens.adjustment`.

    References
    ----------
    .. [1] Hartley, R. I. (1997). Self-calibration of stationary cameras. International Journal of Computer Vision
       22(1), 5-23.
    """
    scene = scene or PanScene()
    size = (video.info.width, video.info.height)
    if abs(video.info.pixel_aspect - 1) > _SQUARE:
        raise VideoError(
            f"{video.info.source}: expected square pixels, got pixels {video.info.pixel_aspect:g} as wide as high; "
            "film the pan clip in a mode with square ones"
        )
    motion = follow_clip(video.frames())
    numbers = choose_key_frames(motion, size)
    if len(numbers) < _LEAST_FRAMES:
        return LensEstimate(LensStatus.STILL, notes=("pan, tilt and roll the camera over more than its picture",))
    keys = detect_in(video.frames(), numbers)
    pairs = match_key_frames(keys, size)
    if not pairs:
        return LensEstimate(LensStatus.FEW_PLACES, notes=("film a scene with more texture, and turn more slowly",))
    focal = search_focal(keys, pairs, size)
    connected, attitudes = chain_turns(keys, pairs, size, focal)
    frame, point, pixel = _sightings(keys, pairs, connected, size)
    if len(connected) < _LEAST_FRAMES or len(np.unique(point)) < _LEAST_POINTS:
        return LensEstimate(LensStatus.FEW_PLACES, notes=("film a scene with more texture, and turn more slowly",))
    chosen = keys.numbers[connected]
    rates = motion.turn_rates(chosen, plain_camera(focal, size), readout_s=READOUT_S, shift=np.zeros(3))
    seen = Sightings(frame, point, pixel, *rates)
    camera, clip = begin_adjustment(seen, attitudes[connected], (focal, size), scene)
    try:
        adjusted = adjust_clip(camera, clip)
        for _ in range(_ROUNDS):
            # Lens, lever and read-out that were found tell the rates better, and these the read-out.
            camera = adjusted.camera
            shift, readout = camera.shared[3] * camera.lever, float(camera.shared[4])
            rate, change = motion.turn_rates(chosen, camera.camera, readout_s=readout, shift=shift)
            clip = replace(clip, seen=replace(seen, turn_rate=rate, turn_change=change))
            adjusted = adjust_clip(camera, clip, again=False)
            if _is_settled(adjusted, camera):
                # Whether another minimum is better is asked once, at the rates that count.
                camera, adjusted = adjusted.camera, adjust_clip(adjusted.camera, clip)
                if _is_settled(adjusted, camera):
                    break
        return judge_lens(adjusted, motion.time_s[chosen])
    except CameraError as error:  # singular: nothing to step along
        return LensEstimate(LensStatus.NOT_DETERMINED, notes=(str(error),))


def _sightings(
    keys: KeyFrames, pairs: list[Pair], connected: IntArray, size: tuple[int, int]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Sightings of the points that most key frames see, spread over the frames, with frames counted anew."""
    frame, point, pixel = join_pairs(keys, pairs, least=_SIGHTINGS)
    kept = np.isin(frame, connected)
    frame, point, pixel = np.searchsorted(connected, frame[kept]), point[kept], pixel[kept]
    count = np.bincount(point, minlength=1)
    # Cells of pictures have their share: strong texture in one corner would leave the others to the priors.
    cell = np.floor(pixel / max(size) * 6).astype(int)
    first = np.unique(point, return_index=True)[1]
    key = frame[first] * 64 + cell[first, 0] * 8 + cell[first, 1]
    order = np.lexsort((-count[np.unique(point)], key)) if len(first) else np.zeros(0, int)
    rank = np.empty(len(first), int)
    begin = np.flatnonzero(np.diff(key[order], prepend=-1)) if len(first) else np.zeros(0, int)
    rank[order] = np.arange(len(first)) - np.repeat(begin, np.diff([*begin, len(first)]))
    chosen = np.unique(point)[np.argsort(rank, kind="stable")[:_MOST_POINTS]]
    used = np.isin(point, chosen) & (count[point] >= _SIGHTINGS)
    _, renumbered = np.unique(point[used], return_inverse=True)
    return frame[used], renumbered, pixel[used]


def _is_settled(adjusted: AdjustedClip, before: TurningCamera) -> bool:
    """Whether an adjustment left the focal length as it was before."""
    return bool(abs(adjusted.camera.lens[0] - before.lens[0]) < _SETTLED * np.sqrt(adjusted.covariance[0, 0]))


def judge_lens(adjusted: AdjustedClip, time_s: FloatArray) -> LensEstimate:
    """The lens of an adjustment, and its status.

    Parameters
    ----------
    adjusted
        The adjustment.
    time_s
        When the key frames were taken, shape (F,) [s].
    """
    camera = adjusted.camera.camera
    values, seen = adjusted.lens, adjusted.clip.seen
    width, height = camera.image_size
    K = camera.K.copy()
    K[:2, :2] *= np.exp(values[0] - np.log(camera.focal_px))
    K[:2, 2] = values[1:3]
    distortion = np.array([*values[3:5], 0, 0, 0])
    found = Camera(K, camera.image_size, distortion)
    covariance = merge_radial(adjusted.covariance, found)
    covariance[0, 0] += (_LEFT_OUT_PX / (max(width, height) / 2)) ** 2
    course = follow_focal(adjusted, time_s)
    # A drift that was found is spread evenly between its ends, and the recording may be at either.
    covariance[0, 0] += max(course.drift**2 - course.drift_std**2, 0.0) / 12
    notes = [
        f"{len(time_s)} frames, {seen.point.max() + 1} places, {len(seen)} sightings to {adjusted.noise_px:.2f} px",
        f"lever {np.linalg.norm(adjusted.camera.lever):.2f} m, scene at about {1 / values[8]:.0f} m, read-out "
        f"{1e3 * values[9]:.0f} ms",
    ]
    status = LensStatus.OK
    mean, std = adjusted.clip.prior
    beyond = (std > 0) & (np.abs(values - mean) > _BEYOND * std)
    longer = float(np.linalg.norm(values[LEVER] / np.where(std[LEVER] > 0, std[LEVER], np.inf)))
    beyond[LEVER] = False
    if adjusted.noise_px > _MOST_NOISE * max(width, height):
        status = LensStatus.MOVED
    elif np.sqrt(covariance[0, 0]) > _MOST_FOCAL_STD:
        status = LensStatus.NOT_DETERMINED
    elif abs(course.drift) > max(_CLEAR * course.drift_std, _MOST_DRIFT):
        status = LensStatus.CHANGING
        notes.append(f"the focal length changes by {course.drift:+.2%} during the clip; lock focus and zoom")
    elif beyond.any():
        # Another minimum, or a camera that was carried: a lens so far from all that is known is not this one.
        status = LensStatus.NOT_DETERMINED
        names = ", ".join(name for name, off in zip(LENS, beyond, strict=True) if off)
        notes.append(f"far from what was stated or any lens has: {names}; state lever and distances as they are")
    elif longer > _MUCH_LONGER:
        status = LensStatus.NEARER
    if longer > _LONGER:
        notes.append(
            f"at the stated distances the parallax asks for a lever of {np.linalg.norm(adjusted.camera.lever):.2f} m: "
            "the scene is nearer, or the lever longer, than stated; standard deviations are wider by as much"
        )
        # What contradicts its prior by so much says that standard deviations are too small by that ratio (Birge).
        covariance = covariance * (longer / _LONGER) ** 2
    return LensEstimate(status, found, covariance, tuple(notes), adjusted, course)


def merge_radial(covariance: FloatArray, camera: Camera) -> FloatArray:
    """Covariance of log_focal, cx, cy and k1, shape (4, 4), where k1 takes k2's part that looks like it.

    Parameters
    ----------
    covariance
        Of the first five of `LENS`, shape (5, 5) or larger, in their units.
    camera
        The lens.

    Notes
    -----
    The k1 that moves the pixels of the whole picture most nearly as k2 does, in the mean of squares, is k2 times the
    mean of r^8 over that of r^6.
    """
    (width, height), K = camera.image_size, camera.K
    u, v = np.meshgrid(np.linspace(0, width - 1, 40), np.linspace(0, height - 1, 30))
    r2 = ((u - K[0, 2]) / K[0, 0]) ** 2 + ((v - K[1, 2]) / K[1, 1]) ** 2
    take = np.eye(4, 5)
    take[3, 4] = float((r2**4).mean() / (r2**3).mean())
    return np.asarray(take @ covariance[:5, :5] @ take.T)


def _std_without_lever(adjusted: AdjustedClip) -> float:
    """Relative standard deviation of the focal length if the lens lay in the point of rotation [1]."""
    free = np.flatnonzero(np.diag(adjusted.covariance) > 0)
    precision = np.linalg.inv(adjusted.covariance[np.ix_(free, free)])
    others = [row for row, value in enumerate(free) if value not in range(*LEVER.indices(len(LENS)))]
    return float(np.sqrt(np.linalg.inv(precision[np.ix_(others, others)])[0, 0]))
