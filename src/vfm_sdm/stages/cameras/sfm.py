"""Cameras by structure from motion: features, exhaustive matching, incremental mapping and bundle adjustment in COLMAP.

The paper's attempt with a classical pipeline (section Discussion: COLMAP with SuperPoint and SuperGlue), which fails on
blurred or sparsely textured views; here that failure has a name.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import BackendUnavailableError, CameraError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.priors import CameraPriors, read_priors
from vfm_sdm.stages.cameras.related_views import MIN_INLIERS
from vfm_sdm.stages.matching.base import FeatureMatcher
from vfm_sdm.stages.matching.detection import to_eight_bit
from vfm_sdm.stages.matching.features import FeatureMatches
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["SfmCameras"]


_FEATURES = 4000
_LONG_SIDE_PX = 2000
"""Images with a longer side are reduced to it for SIFT: finer features cost time and add nothing to the geometry."""
_MIN_ANGLE_DEG = 1.5
"""Least angle between the rays to a point [deg], COLMAP's default for points. Its default for the first pair is 16
degrees, but cameras that see a distant bridge from one shore stand closer together."""
_SEED = 0
_HALF_PIXEL = 0.5
"""Shift of the pixel origin [px]: COLMAP has the image's corner at (0, 0), this package the first pixel's centre."""
_ONLY_FATAL = 3
_NO_LIMIT = 1e12
"""COLMAP drops cameras with a focal length or distortion coefficients above a limit, which long lenses exceed."""


class SfmCameras:
    """Estimator ``sfm``.

    Parameters
    ----------
    features
        What matches features; COLMAP's own SIFT by default.

    Raises
    ------
    BackendUnavailableError
        The package pycolmap is missing.

    Notes
    -----
    Intrinsics and distortion stay at what is known of the lens: two views of one place cannot tell the focal length,
    and the matches of more views are used by the adjustment on site, which weighs them against the lens prior. Poses
    and points refined here together with the focal length would use the same matches twice. For the same reason the
    covariance of the result is the prior of that adjustment, with relative poses left free.

    References
    ----------
    .. [1] Schönberger, J. L., Frahm, J.-M. (2016). Structure-from-motion revisited. IEEE Conference on Computer Vision
       and Pattern Recognition.
    """

    name = "sfm"

    def __init__(self, *, features: FeatureMatcher | None = None) -> None:
        try:
            self._colmap: Any = import_module("pycolmap")
        except ImportError as error:
            raise BackendUnavailableError(
                "sfm: expected the package pycolmap, got none; pip install 'vfm-sdm[sfm]'"
            ) from error
        self._matcher = features

    @property
    def weights_id(self) -> str:
        """Identity of the matcher's weights, which keys contain; empty without such."""
        return str(getattr(self._matcher, "weights_id", ""))

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Rig with the measured baseline, its prior covariance, and the matches that the bundle adjustment kept.

        Parameters
        ----------
        session
            Lens priors and baseline [m].
        frames
            First frame of every view, shape (H, W), in the session's order.

        Raises
        ------
        CameraError
            Fewer than two views, no baseline in the session, or a camera with skew.

        Notes
        -----
        The same frames give the same result: one thread in the mapper, and a fixed seed. COLMAP's messages are held
        back for the process while it works.
        """
        priors = read_priors(session, frames, estimator=self.name)
        for name, camera in zip(priors.names, priors.cameras, strict=True):
            if camera.K[0, 1] != 0:
                raise CameraError(
                    f"sfm: view {name!r}: expected K without skew, got {camera.K[0, 1]}; use cameras = 'two-view'"
                )
        with TemporaryDirectory() as folder, _silence(self._colmap):
            workspace = _Workspace(self._colmap, Path(folder), priors.cameras)
            if self._matcher is None:
                workspace.match_sift(list(frames.values()))
            else:
                workspace.add_matches(self._matcher.match(list(frames.values())))
            found, agreeing = workspace.count_matches()
            linked = [max(n for pair, n in agreeing.items() if view in pair) for view in range(len(frames))]
            model = workspace.reconstruct() if min(linked) >= MIN_INLIERS else None
            return _make_estimate(priors, model, found, agreeing, too_few=min(linked) < MIN_INLIERS)


class _Workspace:
    """A folder with COLMAP's database; views are numbered from 0 here, images from 1 there.

    Parameters
    ----------
    colmap
        The module pycolmap.
    folder
        An empty folder.
    cameras
        Intrinsics and distortion of the camera of each view.
    """

    def __init__(self, colmap: Any, folder: Path, cameras: Sequence[Camera]) -> None:
        self._colmap, self._folder, self._path = colmap, folder, folder / "colmap.db"
        self._images = [f"{view}.png" for view in range(len(cameras))]
        with colmap.Database.open(self._path) as database:
            for file, camera in zip(self._images, cameras, strict=True):
                camera_id = database.write_camera(_make_colmap_camera(colmap, camera))
                database.write_image(colmap.Image(name=file, camera_id=camera_id))

    def match_sift(self, images: Sequence[LumaArray]) -> None:
        """Finds and matches features, and keeps the matches that agree with one pose of a pair.

        Parameters
        ----------
        images
            Luma of every view, shape (H, W).
        """
        colmap = self._colmap
        for file, image in zip(self._images, images, strict=True):
            cv2.imwrite(str(self._folder / file), to_eight_bit(image))
        extraction = colmap.FeatureExtractionOptions()
        extraction.max_image_size = _LONG_SIDE_PX
        extraction.sift.max_num_features = _FEATURES
        colmap.extract_features(
            self._path, self._folder, self._images, extraction_options=extraction, device=colmap.Device.cpu
        )
        colmap.match_exhaustive(
            self._path, verification_options=self._make_verification_options(), device=colmap.Device.cpu
        )

    def add_matches(self, matches: Mapping[tuple[int, int], FeatureMatches]) -> None:
        """Takes matches from elsewhere, and keeps those that agree with one pose of the pair.

        Parameters
        ----------
        matches
            By pair of views.
        """
        sides = [side for (i, j), both in matches.items() for side in ((i, both.points_first), (j, both.points_second))]
        with self._colmap.Database.open(self._path) as database:
            numbers: dict[int, np.ndarray[Any, Any]] = {}
            for view in range(len(self._images)):
                every = np.concatenate([points for k, points in sides if k == view])
                # A feature that is matched in several views is one feature, or there would be no common scale.
                features, numbers[view] = np.unique(every, axis=0, return_inverse=True)
                database.write_keypoints(view + 1, (features + _HALF_PIXEL).astype(np.float32))
            start = dict.fromkeys(numbers, 0)
            for (i, j), both in matches.items():
                rows = [numbers[k][start[k] : start[k] + len(both)] for k in (i, j)]
                start[i], start[j] = start[i] + len(both), start[j] + len(both)
                database.write_matches(i + 1, j + 1, np.column_stack(rows).astype(np.uint32))
        self._colmap.geometric_verification(self._path, two_view_geometry_options=self._make_verification_options())

    def count_matches(self) -> tuple[dict[tuple[int, int], int], dict[tuple[int, int], int]]:
        """Number of matches of every pair of views, and number of those that agree with one pose."""
        found, agreeing = {}, {}
        with self._colmap.Database.open(self._path) as database:
            for i, j in combinations(range(len(self._images)), 2):
                found[i, j] = len(database.read_matches(i + 1, j + 1))
                agreeing[i, j] = len(database.read_two_view_geometry(i + 1, j + 1).inlier_matches)
        return found, agreeing

    def reconstruct(self) -> Any | None:
        """COLMAP's reconstruction that holds every view, or ``None``."""
        options = self._colmap.IncrementalPipelineOptions()
        options.num_threads, options.random_seed = 1, _SEED
        options.multiple_models, options.extract_colors = False, False
        options.min_model_size, options.min_num_matches = len(self._images), MIN_INLIERS
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.max_focal_length_ratio = options.max_extra_param = _NO_LIMIT
        options.triangulation.ignore_two_view_tracks = False
        mapper = options.mapper
        mapper.init_min_num_inliers = mapper.abs_pose_min_num_inliers = MIN_INLIERS
        mapper.init_min_tri_angle = _MIN_ANGLE_DEG
        mapper.abs_pose_refine_focal_length = mapper.abs_pose_refine_extra_params = False
        models = self._colmap.incremental_mapping(self._path, self._folder, self._folder, options)
        whole = [model for model in models.values() if model.num_reg_images() == len(self._images)]
        return whole[0] if whole else None

    def _make_verification_options(self) -> Any:
        options = self._colmap.TwoViewGeometryOptions()
        options.ransac.random_seed = _SEED
        return options


def _make_estimate(
    priors: CameraPriors,
    model: Any | None,
    found: Mapping[tuple[int, int], int],
    agreeing: Mapping[tuple[int, int], int],
    *,
    too_few: bool,
) -> CameraEstimate:
    """The estimate from a reconstruction, or the named failure where there is none."""
    counts = "; ".join(
        f"{priors.names[i]} and {priors.names[j]}: {agreeing[i, j]} of {n} matches agree" for (i, j), n in found.items()
    )
    if too_few:
        advice = f"every view needs {MIN_INLIERS} with another one; choose views that overlap more"
        return CameraEstimate(None, (), CameraStatus.TOO_FEW_MATCHES, (*priors.notes, f"{counts}; {advice}"))
    posed = _read_poses(priors.cameras, model) if model is not None else None
    if model is None or posed is None:
        advice = "state the lens of every view, or choose views with more overlap, depth and distance between them"
        return CameraEstimate(None, (), CameraStatus.NOT_RECONSTRUCTED, (*priors.notes, f"{counts}; {advice}"))
    note = (
        f"structure from motion: {model.num_points3D()} points, mean reprojection error "
        f"{model.compute_mean_reprojection_error():.2f} px; {counts}"
    )
    return CameraEstimate(
        priors.metric_rig(posed), _read_matches(model, len(posed)), CameraStatus.OK, (*priors.notes, note)
    )


def _read_poses(cameras: Sequence[Camera], model: Any) -> tuple[Camera, ...] | None:
    """The cameras with their poses, the first one the origin; ``None`` where the first two stand at one place."""
    moved = []
    for view, camera in enumerate(cameras):
        pose = np.asarray(model.image(view + 1).cam_from_world().matrix(), dtype=np.float64)
        moved.append(Camera(camera.K, camera.image_size, camera.distortion, pose))
    rig = Rig.from_world([str(view) for view in range(len(moved))], moved, metric=False)
    return rig.cameras if np.isfinite(rig.baseline()) and rig.baseline() > 0 else None


def _read_matches(model: Any, views: int) -> tuple[Matches, ...]:
    """Pixels of the reconstructed points, for every pair of views that shares some."""
    seen: dict[tuple[int, int], list[FloatArray]] = {}
    for point_id in sorted(model.point3D_ids()):
        pixels = {
            element.image_id - 1: model.image(element.image_id).point2D(element.point2D_idx).xy - _HALF_PIXEL
            for element in model.point3D(point_id).track.elements
        }
        for i, j in combinations(sorted(pixels), 2):
            seen.setdefault((i, j), []).append(np.stack([pixels[i], pixels[j]]))
    pairs = ((pair, np.array(seen[pair])) for pair in combinations(range(views), 2) if pair in seen)
    return tuple(Matches(i, j, points[:, 0], points[:, 1]) for (i, j), points in pairs)


def _make_colmap_camera(colmap: Any, camera: Camera) -> Any:
    """COLMAP's camera with our intrinsics and all five distortion coefficients, known beforehand."""
    K = camera.K
    centre = K[:2, 2] + _HALF_PIXEL
    width, height = camera.image_size
    # Its model of these five has three more, in a denominator, which stay zero.
    params = [K[0, 0], K[1, 1], *centre, *camera.distortion, 0.0, 0.0, 0.0]
    made = colmap.Camera(model="FULL_OPENCV", width=width, height=height, params=params)
    made.has_prior_focal_length = True
    return made


@contextmanager
def _silence(colmap: Any) -> Iterator[None]:
    """Holds back COLMAP's messages, which go to the terminal; its log has no other level than that of the process."""
    before = colmap.logging.minloglevel
    colmap.logging.minloglevel = _ONLY_FATAL
    try:
        yield
    finally:
        colmap.logging.minloglevel = before
