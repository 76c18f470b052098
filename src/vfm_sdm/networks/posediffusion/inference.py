"""PoseDiffusion on pictures as NumPy arrays: loaded once, run where there is room."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

import numpy as np
import torch

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks.device import Placement, choose_placement, one_thread
from vfm_sdm.networks.interface import RgbFrames
from vfm_sdm.networks.loading import load_weights
from vfm_sdm.networks.posediffusion.crop import SquareCrop, crop_pictures
from vfm_sdm.networks.posediffusion.guidance import ITERATIONS, LIMIT_PX2, Guide, ImageMatches
from vfm_sdm.networks.posediffusion.model import PoseDiffusion
from vfm_sdm.networks.posediffusion.pose import FOCAL_RANGE, POSE_SIZE, decode_pose
from vfm_sdm.networks.posediffusion.schedule import noise_schedule

__all__ = ["GuidedPoses", "PictureMatches", "PoseDiffusionInference", "choose_image_size"]

_SEED = 0
_WRAPPED = "module."
_CORNER = 0.5
"""Shift of the pixel origin [px]: the network has the picture's corner at (0, 0), this package the top-left pixel's
centre."""
_IMAGE_SIZE, _LARGE_IMAGE_SIZE = 224, 336


class PictureMatches(Protocol):
    """Pixels of the same points in two full pictures; the centre of the top-left pixel is (0, 0)."""

    @property
    def first(self) -> int:
        """Index of the one picture."""
        ...

    @property
    def second(self) -> int:
        """Index of the other picture."""
        ...

    @property
    def points_first(self) -> FloatArray:
        """Pixels in the one picture, shape (M, 2) [px]."""
        ...

    @property
    def points_second(self) -> FloatArray:
        """Pixels in the other picture, shape (M, 2) [px]."""
        ...


@dataclass(frozen=True, eq=False)
class GuidedPoses:
    """Cameras as the network sees them, in a world and a unit of its own.

    Parameters
    ----------
    cam_from_world
        Shape (N, 3, 4); x right, y down, z forward. NaN where the quaternion has no length.
    focal_px
        Focal lengths along x and y in each full picture, shape (N, 2) [px]; NaN where the network's is at its limit.
    near
        Whether each match agrees with the cameras, shape (M,), in the order given.
    guided
        Whether enough matches agree for the last step to be guided.
    """

    cam_from_world: FloatArray
    focal_px: FloatArray
    near: np.ndarray
    guided: bool


def choose_image_size(weights: str | Path) -> int:
    """Side of the pictures that a file of weights was trained on, told by the file's name [px].

    Parameters
    ----------
    weights
        Name or path of the weights.

    Notes
    -----
    All weights have the same keys and shapes.

    Examples
    --------
    >>> choose_image_size("co3d_model1.pth"), choose_image_size("posediffusion-re10k.pth")
    (224, 336)
    """
    name = Path(weights).name.lower()
    return _LARGE_IMAGE_SIZE if "realestate" in name or "re10k" in name else _IMAGE_SIZE


class PoseDiffusionInference:
    """A network on its device, in float32.

    Parameters
    ----------
    network
        Network with its weights; it is moved to the device.
    placement
        Where it runs.
    image_size
        Side of the pictures that the weights were trained on [px].
    iterations
        Iterations of a pass of the guidance.

    Raises
    ------
    DeviceMemoryError
        The device has no room for the weights.
    """

    def __init__(
        self,
        network: PoseDiffusion,
        placement: Placement,
        *,
        image_size: int = _IMAGE_SIZE,
        iterations: int = ITERATIONS,
    ) -> None:
        self.placement, self.image_size, self.iterations = placement, image_size, iterations
        with placement.running(), torch.inference_mode(False):
            self.network = network.eval().requires_grad_(False).to(placement.device)

    @classmethod
    def load(cls, weights: str, *, device: str = "auto") -> Self:
        """The published network.

        Parameters
        ----------
        weights
            Name or path of the weights; ``module.`` in front of every key is taken off.
        device
            ``auto`` (a GPU where there is one), or a name that PyTorch knows.

        Raises
        ------
        BackendUnavailableError
            The weights are not here, or are others, or there is no such device.
        """
        placement = choose_placement(device, "float32")
        with torch.device("meta"):
            network = PoseDiffusion()
        load_weights(network, weights, wrapped_in=_WRAPPED, dtype=torch.float32)
        _check_schedule(network, weights)
        return cls(network, placement, image_size=choose_image_size(weights))

    def estimate_poses(self, pictures: Sequence[RgbFrames], matches: Sequence[PictureMatches] = ()) -> GuidedPoses:
        """Cameras of pictures that are seen together; the first one is the pivot.

        Parameters
        ----------
        pictures
            Red, green and blue, shape (height, width, 3) each.
        matches
            What matches between the pictures; it guides the sampling.

        Raises
        ------
        DeviceMemoryError
            The pictures do not fit the memory.

        Notes
        -----
        Its noise is drawn from one seed on the processor, and there all is computed by one thread: the same pictures
        give the same cameras, on however many cores.
        """
        crops = [SquareCrop.of(picture.shape[1], picture.shape[0]) for picture in pictures]
        shape = (self.network.config.steps, len(pictures), POSE_SIZE)
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(_SEED))
        # The guidance carries the rounding of sums that threads share to the second digit of a pose vector.
        with one_thread(), self.placement.running():
            images = crop_pictures(list(pictures), self.image_size).to(self.placement.device)
            guide = self._guide(crops, matches)
            poses = self.network.sample(images, noise.to(self.placement.device), guide)[-1]
            near = np.zeros(0, dtype=bool) if guide is None else (guide.errors(poses) < LIMIT_PX2).cpu().numpy()
            # In double precision, or rotations would be none to more than seven digits.
            rotation, translation, focal = (part.numpy() for part in decode_pose(poses.cpu().double()))
        known = np.where((focal > FOCAL_RANGE[0]) & (focal < FOCAL_RANGE[1]), focal, np.nan)
        sides = np.array([[crop.side] for crop in crops])
        cam_from_world = np.concatenate([rotation, translation[..., None]], axis=2)
        guided = guide is not None and guide.enough(torch.from_numpy(near), len(pictures))
        return GuidedPoses(cam_from_world, known * sides / 2, near, guided)

    def _guide(self, crops: Sequence[SquareCrop], matches: Sequence[PictureMatches]) -> Guide | None:
        if not matches:
            return None
        ends = [[(m.first, m.points_first) for m in matches], [(m.second, m.points_second) for m in matches]]
        first, second = (
            self._tensor(np.concatenate([crops[k].from_full(u + _CORNER, self.image_size) for k, u in end]))
            for end in ends
        )
        frames = np.concatenate([np.tile([m.first, m.second], (len(m.points_first), 1)) for m in matches])
        found = ImageMatches(first, second, torch.from_numpy(frames).to(self.placement.device))
        return Guide(found, self.image_size, self.iterations)

    def _tensor(self, values: FloatArray) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.placement.device)


def _check_schedule(network: PoseDiffusion, weights: str) -> None:
    """Weights for another schedule would give cameras, and wrong ones."""
    for name, table in noise_schedule(network.config.steps).items():
        if not torch.allclose(network.diffuser.get_buffer(name), table, rtol=1e-5, atol=1e-7):
            raise BackendUnavailableError(
                f"weights {Path(weights).name}: expected the noise schedule of PoseDiffusion, got another {name}; give "
                "the file that belongs to this network (`vfm-sdm weights list`)"
            )
