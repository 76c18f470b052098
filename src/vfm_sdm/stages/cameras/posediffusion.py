"""PoseDiffusion as a camera estimator, the paper's second one, guided by the matches of this package."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vfm_sdm.inputs.session import FirstFrames, Network, Session
from vfm_sdm.networks.availability import choose_weights, require_torch
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.network_rig import ADVICE, NetworkAccuracy, related_matches
from vfm_sdm.stages.cameras.priors import read_priors
from vfm_sdm.stages.matching.matches import Matches

if TYPE_CHECKING:
    from vfm_sdm.networks.posediffusion.inference import GuidedPoses, PoseDiffusionInference

__all__ = ["PoseDiffusionCameras"]

_ACCURACY = NetworkAccuracy("PoseDiffusion", focal=0.1, rotation_rad=0.1, position=0.2)
"""Assumed, not measured, and wider than VGGT's."""
_AGREEING = 0.5
"""Share of the matches of two views within 3.2 px below which the guidance did not lead there."""


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
        matches, faults = related_matches(session, frames, priors.cameras)
        found = self.inference.estimate_poses(list(frames.colors.values()), matches)
        doubts = [*faults, *_list_doubts(priors.names, matches, found)]
        rig, priors = _ACCURACY.place(priors, found.cam_from_world, found.focal_px)
        if rig is None:
            return CameraEstimate(None, (), priors.status, (*priors.notes, *doubts, ADVICE))
        return CameraEstimate(rig, matches, priors.status, (*priors.notes, *doubts))


def _list_doubts(names: tuple[str, ...], matches: tuple[Matches, ...], found: "GuidedPoses") -> list[str]:
    """Sentences where matches, which all agree with one pose, do not agree with the network's."""
    if not matches:
        return []
    if not found.guided:
        near, count = int(found.near.sum()), len(found.near)
        return [f"PoseDiffusion: {near} of {count} matches agree with its cameras, too few to guide it"]
    ends = np.cumsum([len(m) for m in matches])
    return [
        f"PoseDiffusion: {near.sum()} of {len(m)} matches of {names[m.first]!r} and {names[m.second]!r} agree with its "
        "cameras; they are probably wrong"
        for m, near in zip(matches, np.split(found.near, ends[:-1]), strict=True)
        if near.mean() < _AGREEING
    ]
