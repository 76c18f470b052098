"""From cameras as a network gives them to the rig with which the adjustment on site begins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import FirstFrames, Session
from vfm_sdm.stages.cameras.priors import CameraPriors
from vfm_sdm.stages.cameras.related_views import relate_to_first
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["ADVICE", "NetworkAccuracy", "related_matches"]

ADVICE = "use another camera estimator"
"""Last note of cameras that are none."""
_MIN_BASELINE = 1e-3
"""Over the distance of what a network sees, its unit: half a pixel of VGGT's pictures, a fifth of PoseDiffusion's."""


@dataclass(frozen=True)
class NetworkAccuracy:
    """How far the cameras of a network are trusted: standard deviations.

    Parameters
    ----------
    source
        Name of the network, for notes.
    focal
        Of its focal lengths, relative [1].
    rotation_rad
        Of its rotations about each axis [rad].
    position
        Of its positions along each axis, over the baseline [1].
    """

    source: str
    focal: float
    rotation_rad: float
    position: float

    def place(
        self, priors: CameraPriors, cam_from_world: FloatArray, focal_px: FloatArray
    ) -> tuple[Rig | None, CameraPriors]:
        """The rig at the measured baseline, and the priors with the network's focal lengths in them.

        Parameters
        ----------
        priors
            What is known of the V cameras without the network.
        cam_from_world
            The network's poses, shape (V, 3, 4), in a world and a unit of its own.
        focal_px
            Its focal lengths along both axes, shape (V, 2) [px].

        Returns
        -------
        rig
            Metric rig [m] with a covariance of shape (10 V, 10 V); ``None`` where the network gave no cameras.
        priors
            Their status says why, or names a contradiction.

        Examples
        --------
        >>> cameras = tuple(Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480)) for _ in range(2))
        >>> known = np.diag([0.05, 10.0, 10.0, 0.1]) ** 2
        >>> priors = CameraPriors(("left", "right"), cameras, np.tile(known, (2, 1, 1)), 4.0, ())
        >>> rig, priors = NetworkAccuracy("a network", 0.05, 0.1, 0.2).place(
        ...     priors, np.tile(np.eye(3, 4), (2, 1, 1)), np.full((2, 2), 1000.0)
        ... )
        >>> rig is None, priors.status.value
        (True, 'the network put the first two cameras in one place')
        """
        if not (np.isfinite(focal_px).all() and np.isfinite(cam_from_world).all()):
            return None, replace(priors, status=CameraStatus.NOT_A_CAMERA)
        fused = priors.fused(focal_px, relative_std=self.focal, source=self.source)
        posed = [replace(c, cam_from_world=pose) for c, pose in zip(fused.cameras, cam_from_world, strict=True)]
        rig = Rig.from_world(fused.names, posed, metric=False)
        if rig.baseline() < _MIN_BASELINE:
            return None, replace(fused, status=CameraStatus.ONE_PLACE)
        return fused.metric_rig(rig.cameras, rotation_std_rad=self.rotation_rad, position_std=self.position), fused


def related_matches(
    session: Session, frames: FirstFrames, cameras: Sequence[Camera]
) -> tuple[tuple[Matches, ...], tuple[str, ...]]:
    """Matches of every further view with the first one that agree with a pose, and why others have none.

    Parameters
    ----------
    session, frames
        As in `vfm_sdm.stages.cameras.base.CameraEstimator`.
    cameras
        Intrinsics and distortion of each view.

    Returns
    -------
    matches, doubts
        Matches of the views that have them, and a sentence on each of the others.
    """
    related = [views[0] for views in relate_to_first(session, frames, cameras)]
    return (
        tuple(view.matches for view in related if not view.fault),
        tuple(view.fault for view in related if view.fault),
    )
