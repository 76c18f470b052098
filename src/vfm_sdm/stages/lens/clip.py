"""The lens from a pan clip: key frames, places seen again, a start, the adjustment, and whether to believe it."""

from dataclasses import dataclass, field, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.statuses import LensStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.lens.adjustment import AdjustedClip, adjust_clip
from vfm_sdm.stages.lens.key_frames import KeyFrames, choose_key_frames, detect_in, follow_clip
from vfm_sdm.stages.lens.sightings import Pair, join_pairs, match_key_frames
from vfm_sdm.stages.lens.start import chain_turns, search_focal
from vfm_sdm.stages.lens.steadiness import FocalCourse, follow_focal
from vfm_sdm.stages.lens.turning_camera import LensClip, Sightings, TurningCamera

__all__ = ["LensEstimate", "PanScene", "estimate_lens"]

_SIGHTINGS = 3
"""Key frames that must see a place: two tell of the turn between them alone."""
_ROUNDS = 2
_MOST_POINTS = 1200
_LEAST_FRAMES, _LEAST_POINTS = 5, 60
_FOCAL_STD = 1.0
_CENTRE_STD = 0.015
"""Principal point from the image centre, over the image diagonal."""
_K1_CORNER_STD, _K2_CORNER_STD = 0.1, 0.03
"""Radial distortion at the image corner, over the radius: of lenses of any field of view."""
_READOUT_S = 0.012
"""Read-out of a picture, and its standard deviation: rolling shutters take 5 to 30 ms, global ones none [s]."""
_MOST_FOCAL_STD = 0.03
_MOST_NOISE = 1e-3
"""Noise of a sighting over the longer side beyond which something else than turns moves the picture: features are found
to a fifth of that."""
_CLEAR = 4.0
_MOST_DRIFT = 1e-3


@dataclass(frozen=True)
class PanScene:
    """What is known of a pan clip's scene and tripod.

    Parameters
    ----------
    nearest_m, farthest_m
        Distances between which the scene lies [m].
    lever_std_m
        Standard deviation of the lever along each axis, from the point about which the camera turns to its lens [m].

    Raises
    ------
    DatasetError
        A distance is not positive, they are in the wrong order, or the standard deviation is negative.
    """

    nearest_m: float = 50.0
    farthest_m: float = 1000.0
    lever_std_m: float = 0.08

    def __post_init__(self) -> None:
        if not (0 < self.nearest_m <= self.farthest_m and self.lever_std_m >= 0):
            raise DatasetError(
                f"pan clip: expected 0 < nearest <= farthest distance and a lever >= 0 m, got {self.nearest_m:g}, "
                f"{self.farthest_m:g} and {self.lever_std_m:g} m; correct them"
            )

    @property
    def nearness(self) -> tuple[float, float]:
        """Mean and standard deviation of 1 / distance, as if every value between the ends were as likely [1/m]."""
        near, far = 1 / self.nearest_m, 1 / self.farthest_m
        return (near + far) / 2, max((near - far) / np.sqrt(12), 1e-3 * near)


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
    clip
        What was adjusted.
    course
        Focal length over time.
    """

    status: LensStatus
    camera: Camera | None = None
    covariance: FloatArray = field(default_factory=lambda: np.full((4, 4), np.nan))
    notes: tuple[str, ...] = ()
    adjusted: AdjustedClip | None = None
    clip: LensClip | None = None
    course: FocalCourse | None = None

    @property
    def usable(self) -> bool:
        """Whether the lens may be taken for the recording's."""
        return self.status == LensStatus.OK

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
    seen = Sightings(frame, point, pixel, motion.turn_rates(chosen, _plain_camera(focal, size), _READOUT_S))
    camera, clip = _begin(seen, attitudes[connected], (focal, size), scene)
    adjusted = adjust_clip(camera, clip)
    for _ in range(_ROUNDS):
        # The lens and the read-out that were found tell the rates better, and these the read-out.
        camera = adjusted.camera
        rates = motion.turn_rates(chosen, camera.camera, float(camera.shared[4]))
        clip = replace(clip, seen=replace(seen, turn_rate=rates))
        adjusted = adjust_clip(camera, clip)
    return _judge(adjusted, clip, motion.time_s[chosen])


def _plain_camera(focal: float, size: tuple[int, int]) -> Camera:
    """A camera with its principal point in the middle, without distortion."""
    return Camera(np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]]), size)


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


def _begin(
    seen: Sightings, attitudes: FloatArray, lens: tuple[float, tuple[int, int]], scene: PanScene
) -> tuple[TurningCamera, LensClip]:
    """Where the adjustment starts, and what is known before; the lens by its focal length [px] and image size."""
    focal, (width, height) = lens
    diagonal = float(np.hypot(width, height))
    corner = diagonal / 2 / focal
    nearness, nearness_std = scene.nearness
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    mean = np.array([np.log(focal), *centre, *[0.0] * 5, nearness, _READOUT_S])
    levers = [scene.lever_std_m] * 3
    centre_std = _CENTRE_STD * diagonal
    std = np.array(
        [
            *(_FOCAL_STD, centre_std, centre_std, _K1_CORNER_STD / corner**2, _K2_CORNER_STD / corner**4),
            *(*levers, nearness_std, _READOUT_S),
        ]
    )
    rays = np.column_stack([(seen.pixel - centre) / focal, np.ones(len(seen))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    turned = np.einsum("nji,nj->ni", attitudes[seen.frame], rays)
    directions = np.add.reduceat(turned, np.flatnonzero(np.diff(seen.point, prepend=-1)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    camera = TurningCamera(
        _plain_camera(focal, (width, height)), mean[5:], attitudes, directions, np.zeros(len(directions))
    )
    return camera, LensClip(seen, (mean, std), nearness_std)


def _judge(adjusted: AdjustedClip, clip: LensClip, time_s: FloatArray) -> LensEstimate:
    """The lens of an adjustment, and its status."""
    camera = adjusted.camera.camera
    values = adjusted.lens
    width, height = camera.image_size
    K = camera.K.copy()
    K[:2, :2] *= np.exp(values[0] - np.log(camera.focal_px))
    K[:2, 2] = values[1:3]
    distortion = np.array([*values[3:5], 0, 0, 0])
    found = Camera(K, camera.image_size, distortion)
    covariance = _as_one_coefficient(adjusted.covariance, found)
    course = follow_focal(adjusted, clip, time_s)
    # A drift that was found is spread evenly between its ends, and the recording may be at either.
    covariance[0, 0] += max(course.drift**2 - course.drift_std**2, 0.0) / 12
    notes = [
        f"{len(time_s)} frames, {clip.seen.point.max() + 1} places, {len(clip.seen)} sightings to "
        f"{adjusted.noise_px:.2f} px",
        f"lever {np.linalg.norm(adjusted.camera.lever):.2f} m, scene at about {1 / values[8]:.0f} m, read-out "
        f"{1e3 * values[9]:.0f} ms",
    ]
    status = LensStatus.OK
    if adjusted.noise_px > _MOST_NOISE * max(width, height):
        status = LensStatus.MOVED
    elif np.sqrt(covariance[0, 0]) > _MOST_FOCAL_STD:
        status = LensStatus.NOT_DETERMINED
    elif abs(course.drift) > max(_CLEAR * course.drift_std, _MOST_DRIFT):
        status = LensStatus.CHANGING
        notes.append(f"the focal length changes by {course.drift:+.2%} during the clip; lock focus and zoom")
    return LensEstimate(status, found, covariance, tuple(notes), adjusted, clip, course)


def _as_one_coefficient(covariance: FloatArray, camera: Camera) -> FloatArray:
    """Covariance of log_focal, cx, cy and k1, shape (4, 4), where k1 takes k2's part that looks like it.

    The k1 that moves the pixels of the whole picture most nearly as k2 does, in the mean of squares, is k2 times the
    mean of r^8 over that of r^6.
    """
    (width, height), K = camera.image_size, camera.K
    u, v = np.meshgrid(np.linspace(0, width - 1, 40), np.linspace(0, height - 1, 30))
    r2 = ((u - K[0, 2]) / K[0, 0]) ** 2 + ((v - K[1, 2]) / K[1, 1]) ** 2
    take = np.eye(4, 5)
    take[3, 4] = float((r2**4).mean() / (r2**3).mean())
    return np.asarray(take @ covariance[:5, :5] @ take.T)
