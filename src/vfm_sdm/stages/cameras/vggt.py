"""VGGT as a camera estimator (section VFM-based sparse-view camera parameter estimation)."""

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import FirstFrames, Network, Session
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.vggt.pose import decode_pose
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.cameras.related_views import relate_to_first
from vfm_sdm.stages.matching.network_view import network_view

if TYPE_CHECKING:
    from vfm_sdm.networks.vggt.inference import VggtInference

__all__ = ["VggtCameras"]

_FOCAL_STD, _ROTATION_STD_RAD, _POSITION_STD = 0.05, 0.035, 0.1
"""Standard deviations of VGGT's focal length (relative), rotation, and position over the baseline; assumed, not
measured."""
_MIN_BASELINE = 1e-3  # in VGGT's unit, the mean distance of what it sees: half a pixel of its images


class VggtCameras:
    """Estimator ``vggt``.

    Parameters
    ----------
    network
        Weights, device and precision.

    Raises
    ------
    BackendUnavailableError
        PyTorch or the weights are not here.

    Notes
    -----
    The result is a prior: its focal lengths are fused with what is known of the lenses, and its poses have a standard
    deviation, so that the adjustment on site lets baseline, distances and feature matches correct them.
    """

    name = "vggt"

    def __init__(self, *, network: Network | None = None) -> None:
        require_torch("cameras vggt")
        self.network = network or Network()
        self.weights = choose_weights("cameras", self.name, self.network.weights)
        self.weights_id = weights_id(self.weights)

    @cached_property
    def inference(self) -> "VggtInference":
        """The network, loaded when it is first used."""
        from vfm_sdm.networks.vggt.inference import VggtInference  # noqa: PLC0415  (PyTorch is optional)

        where = self.network
        return VggtInference.load(str(self.weights), device=where.device, precision=where.precision, camera=True)

    def estimate(self, session: Session, frames: FirstFrames) -> CameraEstimate:
        """Rig with the measured baseline, its prior covariance, and matches that agree with a pose.

        Parameters
        ----------
        session, frames
            As in `CameraEstimator`.

        Raises
        ------
        CameraError
            Fewer than two views, or no baseline in the session.
        """
        priors = read_priors(session, frames, estimator=self.name)
        images, canvases = network_view(list(frames.colors.values()))
        poses, intrinsics = decode_pose(self.inference.estimate_poses(images), (images.shape[2], images.shape[1]))
        # Each axis was resized by itself.
        focal = intrinsics[:, [0, 1], [0, 1]] / [[canvas.region.scale_u, canvas.region.scale_v] for canvas in canvases]
        if not (np.isfinite(focal).all() and np.isfinite(poses).all()):
            return CameraEstimate(None, (), CameraStatus.NOT_A_CAMERA, (*priors.notes, "use another camera estimator"))
        priors = priors.fused(focal, relative_std=_FOCAL_STD, source="VGGT")
        posed = [replace(c, cam_from_world=pose) for c, pose in zip(priors.cameras, poses, strict=True)]
        rig = Rig.from_world(priors.names, posed, metric=False)
        if rig.baseline() < _MIN_BASELINE:
            return CameraEstimate(None, (), CameraStatus.ONE_PLACE, (*priors.notes, "use another camera estimator"))
        rig = priors.metric_rig(rig.cameras, rotation_std_rad=_ROTATION_STD_RAD, position_std=_POSITION_STD)
        related = [views[0] for views in relate_to_first(session, frames, priors.cameras)]
        matches = tuple(view.matches for view in related if not view.fault)
        return CameraEstimate(
            rig, matches, priors.status, (*priors.notes, *(view.fault for view in related if view.fault))
        )
