"""The whole network: pose vectors of frames, from noise."""

import torch
from torch import Tensor, nn

from vfm_sdm.errors import DatasetError
from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig
from vfm_sdm.networks.posediffusion.encoder import ImageFeatures
from vfm_sdm.networks.posediffusion.guidance import GUIDED_STEPS, Guide
from vfm_sdm.networks.posediffusion.pose import POSE_SIZE
from vfm_sdm.networks.posediffusion.schedule import Diffusion

__all__ = ["PoseDiffusion"]


class PoseDiffusion(nn.Module):
    """PoseDiffusion.

    Parameters
    ----------
    config
        Sizes.

    References
    ----------
    .. [1] Wang, J., Rupprecht, C., Novotny, D. (2023). PoseDiffusion: solving pose estimation via diffusion-aided
       bundle adjustment. International Conference on Computer Vision.
    """

    def __init__(self, config: PoseDiffusionConfig | None = None) -> None:
        super().__init__()
        self.config = config or PoseDiffusionConfig()
        self.image_feature_extractor = ImageFeatures(self.config)
        self.diffuser = Diffusion(self.config)

    def sample(self, images: Tensor, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """Pose vectors before the first and after every step, shape (steps + 1, N, 9); the last ones are the answer.

        Parameters
        ----------
        images
            Pictures of N frames, RGB in 0 .. 1, shape (N, 3, H, W).
        noise
            Standard normal numbers for the start and for each step but the last, shape (steps, N, 9); the last
            `GUIDED_STEPS` - 1 are not needed where matches guide.
        guide
            Matches that guide the last steps.

        Raises
        ------
        DatasetError
            The shapes do not fit.
        """
        self._check(images, noise, guide)
        return self.sample_from(self.image_feature_extractor(images), noise, guide)

    def sample_from(self, features: Tensor, noise: Tensor, guide: Guide | None = None) -> Tensor:
        """As `sample`, from the image features of N frames, shape (N, width) [1]; the other arguments are the same."""
        steps = self.config.steps
        chain = [noise[0]]
        for time in reversed(range(steps)):
            _, mean = self.diffuser.denoise(chain[-1], features, time)
            if guide is not None and time < GUIDED_STEPS:
                chain.append(guide.refine(mean))
            else:
                # The last step has no noise.
                chain.append(self.diffuser.spread(mean, noise[min(steps - time, len(noise) - 1)], time))
        return torch.stack(chain)

    def _check(self, images: Tensor, noise: Tensor, guide: Guide | None) -> None:
        if images.ndim != 4 or images.shape[1] != 3 or not images.is_floating_point():
            raise DatasetError(
                "images: expected floating-point values 0 .. 1 of shape (frames, 3, height, width), got "
                f"{images.dtype} of shape {tuple(images.shape)}; use crop_pictures"
            )
        steps = self.config.steps if guide is None else self.config.steps - GUIDED_STEPS + 1
        if noise.ndim != 3 or len(noise) < steps or noise.shape[1:] != (len(images), POSE_SIZE):
            raise DatasetError(
                f"noise: expected shape ({steps}, {len(images)}, {POSE_SIZE}) or longer, got {tuple(noise.shape)}; "
                "draw one number for every step and every entry of every frame's vector"
            )
