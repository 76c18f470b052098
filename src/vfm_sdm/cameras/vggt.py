"""VGGT as a camera estimator (section VFM-based sparse-view camera parameter estimation)."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vfm_sdm.arrays import FloatArray, LumaArray
from vfm_sdm.cameras.base import CameraEstimate, Matches
from vfm_sdm.cameras.features import match_features
from vfm_sdm.cameras.network_view import network_view
from vfm_sdm.cameras.priors import CameraPriors, read_priors
from vfm_sdm.cameras.two_view import MIN_INLIERS, estimate_relative_pose
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.networks.availability import default_checkpoint, require_torch
from vfm_sdm.networks.vggt.pose import decode_pose
from vfm_sdm.networks.weights import find_weights
from vfm_sdm.session import Network, Session, first_color_frames

if TYPE_CHECKING:
    from vfm_sdm.networks.vggt.inference import VggtInference

__all__ = ["NO_BASELINE", "NO_FIELD_OF_VIEW", "VggtCameras"]

NO_FIELD_OF_VIEW = "VGGT gave no field of view"
NO_BASELINE = "VGGT put all cameras in one place"

_FOCAL_STD, _ROTATION_STD, _TRANSLATION_STD = 0.05, 0.035, 0.1
"""How far VGGT may be off: focal length (relative), rotation [rad], position over the baseline. Assumptions, wider than
its authors' scores on street and indoor scenes suggest; what contradicts the tape is named."""
_SQUARE = 0.03
"""Two focal lengths of one lens that differ by more than this share say that the network was unsure."""


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
    The whole first frames are seen, 518 px along the longer side. The result is a prior: its focal lengths are fused
    with what is known of the lenses, and its poses stand with a standard deviation, so that the adjustment on site lets
    baseline, distances and feature matches correct them.
    """

    name = "vggt"

    def __init__(self, *, network: Network | None = None) -> None:
        require_torch("cameras vggt")
        self.settings = network or Network()
        self.weights = find_weights(self.settings.weights or default_checkpoint("cameras", self.name))

    @cached_property
    def inference(self) -> "VggtInference":
        """The network, loaded when it is first used."""
        from vfm_sdm.networks.vggt.inference import VggtInference  # noqa: PLC0415  (PyTorch is optional)

        settings = self.settings
        return VggtInference.load(str(self.weights), device=settings.device, precision=settings.precision, camera=True)

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Rig with the tape's baseline, prior covariance, and matches that agree with a pose; views in any number.

        Parameters
        ----------
        session
            Lens priors and baseline; its recordings are opened for their first frames in colour.
        frames
            First frame of every view, in the session's order.

        Raises
        ------
        CameraError
            Fewer than two views, or no baseline in the session.
        """
        priors = read_priors(session, frames, estimator=self.name)
        colors = first_color_frames(session)
        images, canvases = network_view([colors[name] for name in frames])
        height, width = images.shape[1:3]
        cam_from_world, intrinsics = decode_pose(self.inference.estimate_poses(images), (width, height))
        scales = [(canvas.region.scale_u, canvas.region.scale_v) for canvas in canvases]
        focal = intrinsics[:, [0, 1], [0, 1]] / np.array(scales)
        if not (np.isfinite(focal).all() and np.isfinite(cam_from_world).all()):
            return CameraEstimate(None, (), NO_FIELD_OF_VIEW, ("VGGT: use another camera estimator",))
        priors, notes = _fused(priors, focal)
        posed = [replace(c, cam_from_world=pose) for c, pose in zip(priors.cameras, cam_from_world, strict=True)]
        rig = Rig.from_world(priors.names, posed, metric=False)
        if not rig.baseline() > 0:
            return CameraEstimate(None, (), NO_BASELINE, ("VGGT: use another camera estimator",))
        pose_std = [_ROTATION_STD] * 3 + [_TRANSLATION_STD * priors.baseline_m] * 3
        stds = np.column_stack([priors.intrinsics_std, [[0.0] * 6] + [pose_std] * (len(posed) - 1)])
        metric = replace(rig.scaled(priors.baseline_m / rig.baseline()), covariance=np.diag(stds.ravel() ** 2))
        matches = _matches(list(frames.values()), priors.cameras)
        if len(matches) < len(frames) - 1:
            notes += ("too few features agree between some views: only VGGT and the tape relate them",)
        return CameraEstimate(metric, matches, "ok", (*priors.notes, *notes))


def _fused(priors: CameraPriors, focal: FloatArray) -> tuple[CameraPriors, tuple[str, ...]]:
    """Priors whose focal lengths also know what VGGT found along both axes (V, 2) [px], and notes on contradictions."""
    cameras, stds, notes = [], priors.intrinsics_std.copy(), []
    for name, camera, std, (f_u, f_v) in zip(priors.names, priors.cameras, stds, focal, strict=True):
        found = float(np.log(f_u * f_v) / 2 - np.log(camera.focal_px))
        if abs(np.log(f_u / f_v)) > _SQUARE:
            notes.append(f"view {name!r}: VGGT's focal lengths differ along the axes, {f_u:.0f} and {f_v:.0f} px")
        if abs(found) > 3 * np.hypot(std[0], _FOCAL_STD):
            notes.append(
                f"view {name!r}: VGGT's focal length is {np.expm1(found):+.0%} off what the session says of the lens"
            )
        weight = std[0] ** 2 / (std[0] ** 2 + _FOCAL_STD**2)
        gain = np.exp(weight * found)
        cameras.append(replace(camera, K=camera.K * np.array([[gain, 1, 1], [1, gain, 1], [1, 1, 1]])))
        std[0] *= np.sqrt(1 - weight)
    return replace(priors, cameras=tuple(cameras), intrinsics_std=stds), tuple(notes)


def _matches(frames: list[LumaArray], cameras: tuple[Camera, ...]) -> tuple[Matches, ...]:
    """Features of the first view that agree on a relative pose with those of each other one."""
    found = []
    for index in range(1, len(frames)):
        points = match_features(frames[0], frames[index])
        _, agree = estimate_relative_pose(*points, cameras[0], cameras[index])
        if agree.sum() >= MIN_INLIERS:
            found.append(Matches(0, index, points[0][agree], points[1][agree]))
    return tuple(found)
