"""The whole network: cameras of frames, and tracks of points through them."""

import torch
from torch import Tensor, nn

from vfm_sdm.errors import DatasetError
from vfm_sdm.networks.vggt.aggregator import Aggregator
from vfm_sdm.networks.vggt.camera_head import CameraHead
from vfm_sdm.networks.vggt.config import VggtConfig
from vfm_sdm.networks.vggt.feature_head import FeatureHead
from vfm_sdm.networks.vggt.tracker import PointTracker, PointTracks

__all__ = ["HEADS", "Vggt"]

HEADS = ("camera_head", "track_head", "depth_head", "point_head")
"""Prefixes of the checkpoints' parameters beside the aggregator; heads of the last two are never built here."""


class Vggt(nn.Module):
    """VGGT with the heads that are asked for.

    Parameters
    ----------
    config
        Sizes.
    camera, track
        Whether to build the camera head and the tracking head.

    References
    ----------
    .. [1] Wang, J., Chen, M., Karaev, N., Vedaldi, A., Rupprecht, C., Novotny, D. (2025). VGGT: visual geometry
       grounded transformer. IEEE/CVF Conference on Computer Vision and Pattern Recognition.
    """

    def __init__(self, config: VggtConfig | None = None, *, camera: bool = True, track: bool = True) -> None:
        super().__init__()
        self.config = config or VggtConfig()
        self.aggregator = Aggregator(self.config)
        if camera:
            self.camera_head = CameraHead(self.config)
        if track:
            self.track_head = _TrackHead(self.config)

    @property
    def heads_left_out(self) -> tuple[str, ...]:
        """Prefixes of a checkpoint's parameters that this network does not have."""
        return tuple(name for name in HEADS if not hasattr(self, name))

    def estimate_poses(self, images: Tensor) -> Tensor:
        """Pose vectors (`vfm_sdm.networks.vggt.pose`) after every iteration, shape (iterations, S, 9).

        Parameters
        ----------
        images
            Shape (S, 3, H, W), RGB in 0 .. 1. The first frame's camera is the origin.

        Raises
        ------
        DatasetError
            The images' shape does not fit.
        """
        self._check(images)
        last = self.config.depth - 1
        camera_tokens = self.aggregator(images, (last,))[last][:, 0]
        with torch.autocast(images.device.type, enabled=False):
            poses: Tensor = self.camera_head(camera_tokens)
        return poses

    def features(self, images: Tensor) -> Tensor:
        """Feature maps of frames that were seen together, shape (S, features, H / 2, W / 2).

        Parameters
        ----------
        images
            RGB in 0 .. 1, shape (S, 3, H, W).

        Raises
        ------
        DatasetError
            The images' shape does not fit.
        """
        self._check(images)
        if min(images.shape[-2:]) < self.config.smallest_side:
            raise DatasetError(
                f"images: expected at least {self.config.smallest_side} px a side for tracking, got "
                f"{images.shape[-1]} x {images.shape[-2]}; use larger patches"
            )
        half = torch.is_autocast_enabled(images.device.type)
        keep_dtype = torch.get_autocast_dtype(images.device.type) if half else None
        tokens = self.aggregator(images, self.config.feature_layers, keep_dtype=keep_dtype)
        maps: Tensor = self.track_head.feature_extractor(tokens, (images.shape[-2], images.shape[-1]))
        return maps

    def track(self, images: Tensor, queries: Tensor) -> PointTracks:
        """Tracks of points of the first frame.

        Parameters
        ----------
        images
            RGB in 0 .. 1, shape (S, 3, H, W).
        queries
            Column and row in the first frame, shape (G, N, 2) [px], as in `PointTracker.forward`.

        Raises
        ------
        DatasetError
            The images' shape does not fit.
        """
        tracks: PointTracks = self.track_head.tracker(self.features(images), queries)
        return tracks

    def _check(self, images: Tensor) -> None:
        patch = self.config.patch_size
        if images.ndim != 4 or images.shape[1] != 3 or any(side % patch for side in images.shape[-2:]):
            raise DatasetError(
                f"images: expected shape (frames, 3, height, width) with sides that are multiples of {patch}, got "
                f"{tuple(images.shape)}; resize or crop them"
            )
        if not images.is_floating_point():
            raise DatasetError(f"images: expected floating-point values 0 .. 1, got {images.dtype}; divide by 255")


class _TrackHead(nn.Module):
    """Feature maps, and the tracker on them."""

    def __init__(self, config: VggtConfig) -> None:
        super().__init__()
        self.feature_extractor = FeatureHead(config)
        self.tracker = PointTracker(config)
