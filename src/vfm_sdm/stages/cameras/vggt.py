"""VGGT as a camera estimator (section VFM-based sparse-view camera parameter estimation)."""

from functools import cached_property
from typing import TYPE_CHECKING

from vfm_sdm.inputs.session import FirstFrames, Network, Session
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.vggt.pose import decode_pose
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.network_rig import ADVICE, NetworkAccuracy, related_matches
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.matching.network_view import network_view

if TYPE_CHECKING:
    from vfm_sdm.networks.vggt.inference import VggtInference

__all__ = ["VggtCameras"]

_ACCURACY = NetworkAccuracy("VGGT", focal=0.05, rotation_rad=0.035, position=0.1)
"""Assumed, not measured."""


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
        rig, priors = _ACCURACY.place(priors, poses, focal)
        if rig is None:
            return CameraEstimate(None, (), priors.status, (*priors.notes, ADVICE))
        matches, doubts = related_matches(session, frames, priors.cameras)
        return CameraEstimate(rig, matches, priors.status, (*priors.notes, *doubts))
