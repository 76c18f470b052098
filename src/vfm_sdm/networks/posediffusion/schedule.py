"""The diffusion: its schedule of noise, and one step back."""

import torch
from torch import Tensor, nn

from vfm_sdm.networks.posediffusion.config import PoseDiffusionConfig
from vfm_sdm.networks.posediffusion.denoiser import Denoiser

__all__ = ["Diffusion", "noise_schedule"]

_FIRST, _LAST = 1e-4, 0.1
_LEAST_VARIANCE = 1e-20


def noise_schedule(steps: int) -> dict[str, Tensor]:
    """Tables of the schedule by the names in checkpoints, shape (steps,) each, in single precision.

    Parameters
    ----------
    steps
        Steps of the diffusion.

    Notes
    -----
    Variances grow linearly; everything else follows from them as in [1]_, Eqs. (4), (6) and (7).

    References
    ----------
    .. [1] Ho, J., Jain, A., Abbeel, P. (2020). Denoising diffusion probabilistic models. Advances in Neural Information
       Processing Systems 33.

    Examples
    --------
    >>> noise_schedule(100)["betas"][[0, 99]].tolist()
    [9.999999747378752e-05, 0.10000000149011612]
    """
    beta = torch.linspace(_FIRST, _LAST, steps, dtype=torch.float64)
    kept = (1 - beta).cumprod(0)
    kept_before = torch.cat([torch.ones(1, dtype=torch.float64), kept[:-1]])
    variance = beta * (1 - kept_before) / (1 - kept)
    tables = {
        "betas": beta,
        "alphas_cumprod": kept,
        "alphas_cumprod_prev": kept_before,
        "sqrt_alphas_cumprod": kept.sqrt(),
        "sqrt_one_minus_alphas_cumprod": (1 - kept).sqrt(),
        "log_one_minus_alphas_cumprod": (1 - kept).log(),
        "sqrt_recip_alphas_cumprod": (1 / kept).sqrt(),
        "sqrt_recipm1_alphas_cumprod": (1 / kept - 1).sqrt(),
        "posterior_variance": variance,
        "posterior_log_variance_clipped": variance.clamp(min=_LEAST_VARIANCE).log(),
        "posterior_mean_coef1": beta * kept_before.sqrt() / (1 - kept),
        "posterior_mean_coef2": (1 - kept_before) * (1 - beta).sqrt() / (1 - kept),
        "p2_loss_weight": torch.ones(steps, dtype=torch.float64),
    }
    return {name: table.float() for name, table in tables.items()}


class Diffusion(nn.Module):
    """The denoiser with its schedule."""

    sqrt_recip_alphas_cumprod: Tensor
    sqrt_recipm1_alphas_cumprod: Tensor
    posterior_mean_coef1: Tensor
    posterior_mean_coef2: Tensor
    posterior_log_variance_clipped: Tensor

    def __init__(self, config: PoseDiffusionConfig) -> None:
        super().__init__()
        self.steps = config.steps
        for name, table in noise_schedule(config.steps).items():
            self.register_buffer(name, table)
        self.model = Denoiser(config)

    def denoise(self, poses: Tensor, features: Tensor, time: int) -> tuple[Tensor, Tensor]:
        """Noise-free pose vectors as they look from this step, and the mean of the next step, shape (N, 9) each.

        Parameters
        ----------
        poses
            Pose vectors of N frames at this step, shape (N, 9).
        features
            Image features, shape (N, width) [1].
        time
            The step; counts down to 0.
        """
        noise = self.model(poses[None], features[None], torch.tensor([time], device=poses.device))[0]
        clean = self.sqrt_recip_alphas_cumprod[time] * poses - self.sqrt_recipm1_alphas_cumprod[time] * noise
        return clean, self.mean(clean, poses, time)

    def mean(self, clean: Tensor, poses: Tensor, time: int) -> Tensor:
        """Mean of the next step, shape (N, 9), from the noise-free pose vectors of N frames and those of this step."""
        return self.posterior_mean_coef1[time] * clean + self.posterior_mean_coef2[time] * poses

    def spread(self, mean: Tensor, noise: Tensor, time: int) -> Tensor:
        """Pose vectors of the next step, shape (N, 9): the mean with noise, which the last step has none of.

        Parameters
        ----------
        mean, noise
            Mean of the step for N frames, and standard normal noise, shape (N, 9) each.
        time
            The step; counts down to 0.
        """
        return mean if time == 0 else mean + (self.posterior_log_variance_clipped[time] / 2).exp() * noise
