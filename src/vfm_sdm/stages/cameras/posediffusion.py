"""PoseDiffusion as a camera estimator, the paper's second one, guided by the matches of this package."""

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import FirstFrames, Network, Session
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.cameras.related_views import relate_to_first

if TYPE_CHECKING:
    from vfm_sdm.networks.posediffusion.inference import PoseDiffusionInference

__all__ = ["PoseDiffusionCameras"]

_FOCAL_STD, _ROTATION_STD_RAD, _POSITION_STD = 0.1, 0.1, 0.2
"""Standard deviations of its focal length (relative), rotation, and position over the baseline; assumed, not measured,
and wider than VGGT's."""
_MIN_BASELINE = 1e-3  # in the unit of the network, the distance of what it sees: a fifth of a pixel of its pictures
_ADVICE = "use another camera estimator"


class PoseDiffusionCameras:
    """Estimator ``posediffusion``.

    Parameters
    ----------
    network
        Weights and device.

    Raises
    ------
    BackendUnavailableError
        PyTorch or the weights are not here.

    Notes
    -----
    Feature matches that agree with a pose guide the sampling, as far as the network's cameras come near them. The
    result is a prior for the adjustment on site, as VGGT's is.
    """

    name = "posediffusion"

    def __init__(self, *, network: Network | None = None) -> None:
        require_torch("cameras posediffusion")
        self.network = network or Network()
        self.weights = choose_weights("cameras", self.name, self.network.weights)
        self.weights_id = weights_id(self.weights)

    @cached_property
    def inference(self) -> "PoseDiffusionInference":
        """The network, loaded when it is first used."""
        from vfm_sdm.networks.posediffusion.inference import PoseDiffusionInference  # noqa: PLC0415  (optional PyTorch)

        return PoseDiffusionInference.load(str(self.weights), device=self.network.device)

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
        related = [views[0] for views in relate_to_first(session, frames, priors.cameras)]
        matches = tuple(view.matches for view in related if not view.fault)
        found = self.inference.estimate_poses(list(frames.colors.values()), matches)
        doubts = [view.fault for view in related if view.fault]
        if matches and not found.guided:
            near, count = int(found.near.sum()), len(found.near)
            doubts.append(f"PoseDiffusion: {near} of {count} matches agree with its cameras, too few to guide it")
        if not (np.isfinite(found.focal_px).all() and np.isfinite(found.cam_from_world).all()):
            return CameraEstimate(None, (), CameraStatus.NOT_A_CAMERA, (*priors.notes, *doubts, _ADVICE))
        fused = priors.fused(found.focal_px, relative_std=_FOCAL_STD, source="PoseDiffusion")
        posed = [replace(c, cam_from_world=pose) for c, pose in zip(fused.cameras, found.cam_from_world, strict=True)]
        rig = Rig.from_world(fused.names, posed, metric=False)
        if rig.baseline() < _MIN_BASELINE:
            return CameraEstimate(None, (), CameraStatus.ONE_PLACE, (*fused.notes, *doubts, _ADVICE))
        rig = fused.metric_rig(rig.cameras, rotation_std_rad=_ROTATION_STD_RAD, position_std=_POSITION_STD)
        return CameraEstimate(rig, matches, fused.status, (*fused.notes, *doubts))
