"""Priors of the cameras: what is known of them before the images are used, and a rig that carries it as covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Session, View, camera_tags, lens_from_exif, pixel_aspect, tags_from_exif
from vfm_sdm.inputs.video import CameraTags
from vfm_sdm.inputs.video.images import find_images
from vfm_sdm.stages.cameras.file import read_camera
from vfm_sdm.stages.cameras.profile_priors import LensPrior, prior_of_stated, prior_of_tags, prior_of_unknown
from vfm_sdm.stages.lens.file import read_lens
from vfm_sdm.stages.lens.scene import PRINCIPAL_POINT_STD

__all__ = ["CameraPriors", "read_prior", "read_priors"]


_CALIBRATED_STD = 0.003
_CORNER_DISTORTION_STD = 0.025
"""Radial distortion at the image corner, over the radius: usual for lenses that are not wide-angle."""
_ROTATION_STD_RAD, _POSITION_STD = 1.0, 2.0
"""Standard deviations of poses that are left free: rotation [rad], and position over the baseline [1]."""
_CONTRADICTION_STD = 3.0
_SQUARE = 1e-3
"""Share by which a pixel may be wider than high and count as square."""
_ONE_FOCAL = 0.03
"""Share by which the two focal lengths of one lens may differ before the estimate counts as unsure."""


@dataclass(frozen=True, eq=False)
class CameraPriors:
    """What is known of the cameras of all V views, and the baseline that was measured.

    Parameters
    ----------
    names
        Names of the views.
    cameras
        Intrinsics and distortion of each; their poses have no meaning.
    intrinsics_covariance
        Covariance of the first four of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, in their units, of each view, shape
        (V, 4, 4).
    baseline_m
        Measured distance of the first two views [m].
    notes
        Sentences for the summary where something had to be assumed.
    status
        ``ok``, or the name of a contradiction.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    intrinsics_covariance: FloatArray
    baseline_m: float
    notes: tuple[str, ...]
    status: str = CameraStatus.OK

    def fused(self, focal_px: FloatArray, *, relative_std: float, source: str) -> "CameraPriors":
        """The priors with focal lengths that include another estimate of them, where the two do not contradict.

        Parameters
        ----------
        focal_px
            Estimated focal lengths along both axes, shape (V, 2) [px].
        relative_std
            Standard deviation of their mean, relative to it [1].
        source
            Name of the estimator; for the notes on contradictions.

        Notes
        -----
        The result is the mean of the logarithms, weighted by their precisions. When a focal length changes, the
        standard deviation of the distortion changes with it, so that it stays the same at the image's corner. Beyond
        three standard deviations one of the two is wrong, and a mean would be, too: the session's value stands, and the
        status names the contradiction.

        Examples
        --------
        >>> cameras = tuple(Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480)) for _ in range(2))
        >>> known = np.diag([0.05, 10.0, 10.0, 0.1]) ** 2
        >>> priors = CameraPriors(("left", "right"), cameras, np.tile(known, (2, 1, 1)), 4.0, ())
        >>> fused = priors.fused(np.full((2, 2), 1040.0), relative_std=0.05, source="another estimator")
        >>> round(fused.cameras[0].focal_px, 1), round(float(fused.intrinsics_covariance[0, 0, 0]) ** 0.5, 4)
        (1019.8, 0.0354)
        """
        cameras, covariances, notes, status = [], [], list(self.notes), self.status
        known = zip(self.names, self.cameras, self.intrinsics_covariance, focal_px, strict=True)
        for name, camera, covariance, found in known:
            off_u, off_v = np.log(found / np.diag(camera.K)[:2])
            off, joint = (off_u + off_v) / 2, np.hypot(np.sqrt(covariance[0, 0]), relative_std)
            if abs(off_u - off_v) > _ONE_FOCAL:
                notes.append(f"view {name!r}: {source} gives two focal lengths, {found[0]:.0f} and {found[1]:.0f} px")
            if abs(off) > _CONTRADICTION_STD * joint:
                notes.append(f"view {name!r}: {source}'s focal length is {np.expm1(off):+.0%} off what was known of it")
                status = CameraStatus.CONTRADICTION
                cameras.append(camera)
                covariances.append(covariance)
                continue
            gain = covariance[:, 0] / joint**2
            cameras.append(camera.perturbed([*(gain * off), *[0.0] * 6]))
            same_pixels = np.array([1, 1, 1, np.exp(2 * gain[0] * off)])
            covariances.append((covariance - np.outer(gain, gain) * joint**2) * np.outer(same_pixels, same_pixels))
        return replace(
            self,
            cameras=tuple(cameras),
            intrinsics_covariance=np.array(covariances),
            notes=tuple(notes),
            status=status,
        )

    def metric_rig(
        self,
        posed: Sequence[Camera],
        *,
        rotation_std_rad: float = _ROTATION_STD_RAD,
        position_std: float = _POSITION_STD,
    ) -> Rig:
        """The rig of these cameras at the measured baseline, with the priors as its covariance.

        Parameters
        ----------
        posed
            The V cameras with their poses, of any scale; the first one is the origin of the world.
        rotation_std_rad
            Standard deviation of the further cameras' rotations about each axis [rad].
        position_std
            Standard deviation of the further cameras' translations along each axis, over the baseline [1].

        Returns
        -------
        rig
            Metric rig [m], with a covariance of shape (10 V, 10 V).

        Notes
        -----
        The distance of the first two views scales all of them (s = B_true / B_est). Relative poses are left free by
        default: they come from matches that the adjustment on site uses again, and a narrower prior would count these
        twice.

        Examples
        --------
        >>> cameras = tuple(Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480)) for _ in range(2))
        >>> known = np.diag([0.05, 10.0, 10.0, 0.1]) ** 2
        >>> priors = CameraPriors(("left", "right"), cameras, np.tile(known, (2, 1, 1)), 4.0, ())
        >>> apart = cameras[1].perturbed([0, 0, 0, 0, 0, 0, 0, -1.0, 0, 0])
        >>> rig = priors.metric_rig([cameras[0], apart])
        >>> rig.metric, rig.baseline(), rig.covariance.shape
        (True, 4.0, (20, 20))
        """
        rig = Rig(self.names, tuple(posed), False)
        pose_std = [rotation_std_rad] * 3 + [position_std * self.baseline_m] * 3
        poses_std = np.array([np.zeros(6)] + [pose_std] * (len(posed) - 1))
        blocks = zip(self.intrinsics_covariance, poses_std, strict=True)
        covariance = block_diag(*[part for known, pose in blocks for part in (known, np.diag(pose**2))])
        return replace(rig.scaled(self.baseline_m / rig.baseline()), covariance=covariance)


def read_priors(session: Session, frames: Mapping[str, LumaArray], *, estimator: str) -> CameraPriors:
    """Prior of every view's camera, from its own file, its lens or EXIF, in the order of ``frames``.

    Parameters
    ----------
    session
        Lens priors, camera files and the baseline.
    frames
        First frame of every view, shape (H, W); only names, sizes [px] and the shape of the pixels are used.
    estimator
        Name of the estimator that asks; messages begin with it.

    Raises
    ------
    CameraError
        Fewer than two views, no baseline in the session, or a camera file of another image size.
    """
    if len(frames) < 2:
        raise CameraError(f"{estimator}: expected at least two views, got {list(frames)}; add a [[view]]")
    baseline = session.site.baseline
    if baseline is None:
        raise CameraError(f"{estimator}: expected site.baseline, got none; measure the distance between the cameras")
    views = {view.name: view for view in session.view}
    found = [
        read_prior(
            session,
            views[name],
            (luma.shape[1], luma.shape[0]),
            pixel_aspect(frames, name),
            camera_tags(frames, name),
        )
        for name, luma in frames.items()
    ]
    cameras, covariances, notes = zip(*found, strict=True)
    return CameraPriors(
        tuple(frames), cameras, np.array(covariances), baseline.value, tuple(note for note in notes if note)
    )


def read_prior(
    session: Session, view: View, image_size: tuple[int, int], aspect: float, tags: CameraTags
) -> tuple[Camera, FloatArray, str]:
    """What is known of one view's camera before its pictures are used: from its own file, its lens or EXIF.

    Parameters
    ----------
    session, view
        The session, and one of its views.
    image_size
        Width and height of its pictures [px].
    aspect
        Width of a pixel over its height [1].
    tags
        What the recording says of its camera.

    Returns
    -------
    camera, covariance, note
        Intrinsics and distortion; the covariance of the first four of `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, in
        their units, shape (4, 4); and a note or an empty one.

    Raises
    ------
    CameraError
        A camera file is of another image size, or pixels beside a lens file are not square.
    """
    width, height = image_size
    diagonal = float(np.hypot(width, height))
    if view.camera is not None:
        known = read_camera(session.resolve(view.camera), view.name, image_size=image_size)
        if known.image_size != image_size:
            raise CameraError(
                f"camera of view {view.name!r}: expected an image size of {image_size}, got {known.image_size}; "
                "calibrate at the size of the recording"
            )
        corner = diagonal / 2 / known.focal_px
        std = [_CALIBRATED_STD, 0.001 * diagonal, 0.001 * diagonal, 0.002 / corner**2]
        return replace(known, cam_from_world=np.eye(3, 4)), np.diag(np.square(std)), ""
    if view.lens is not None and view.lens.file is not None:
        return _read_lens_file(session.resolve(view.lens.file), view.name, image_size, aspect)
    lying = width * aspect >= height
    along = width if lying else height
    prior = _find_lens(session, view, (width * aspect, height), along, tags)
    focal = prior.focal * along
    # The lens states the focal length along the longer side; one length is fewer pixels where these are wider.
    fx, fy = (focal, focal * aspect) if lying else (focal / aspect, focal)
    K = np.array([[fx, 0, (width - 1) / 2], [0, fy, (height - 1) / 2], [0, 0, 1.0]])
    corner = float(np.hypot(width / fx, height / fy)) / 2
    centre_std = PRINCIPAL_POINT_STD * diagonal
    std = [prior.relative_std, centre_std, centre_std, prior.corner_std / corner**2]
    k1, k2, k3 = prior.corner / corner ** (2 * np.arange(1, 4))
    note = "; ".join(prior.notes)
    found = Camera(K, image_size, np.array([k1, k2, 0.0, 0.0, k3]))
    return found, np.diag(np.square(std)), f"view {view.name!r}: {note}" if note else ""


def _find_lens(session: Session, view: View, size: tuple[float, float], along: int, tags: CameraTags) -> LensPrior:
    """What is known of a view's lens: what the session states, what the file says, or what any lens may be.

    ``size`` holds the picture's sides in one unit, ``along`` counts the pixels along the longer one.
    """
    lens, notes = view.lens, []
    if view.images is not None and (lens is None or lens.camera is not None):
        photograph = find_images(session.resolve_pattern(view.images))[0]
        tags = tags_from_exif(photograph)
        if lens is None:
            lens = lens_from_exif(photograph)
            notes = [] if lens is None else ["focal length from EXIF, known to 5 %"]
    if lens is None:
        return prior_of_tags(tags, size) or prior_of_unknown()
    if lens.camera is not None:
        return prior_of_stated(lens, size, tags)
    focal = lens.focal_prior_px(along) / along
    return LensPrior(focal, lens.relative_std, np.zeros(3), _CORNER_DISTORTION_STD, tuple(notes))


def _read_lens_file(
    path: Path, name: str, image_size: tuple[int, int], aspect: float
) -> tuple[Camera, FloatArray, str]:
    """What `read_prior` yields, from a lens file."""
    if abs(aspect - 1) > _SQUARE:
        raise CameraError(
            f"view {name!r}: expected square pixels beside a lens file, got pixels {aspect:g} as wide as high; state "
            "focal_px"
        )
    known = read_lens(path, image_size=image_size)
    note = ""
    if known.scaled_from is not None:
        width, height = known.scaled_from
        note = f"view {name!r}: lens of pictures of {width} x {height} px, taken as showing the same field as these"
    return known.camera, known.covariance, note
