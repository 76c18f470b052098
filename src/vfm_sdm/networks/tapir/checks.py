"""What TAPIR asks of its inputs."""

from collections.abc import Sequence

import torch
from torch import Tensor

from vfm_sdm.errors import DatasetError
from vfm_sdm.networks.tapir.config import Resolution, TapirConfig, check_resolution, refinement_resolutions
from vfm_sdm.networks.tapir.results import CausalState

__all__ = ["check_chunks", "check_queries", "check_resolutions", "check_state", "check_video"]


def check_video(video: Tensor) -> Resolution:
    """Height and width of a video [px].

    Parameters
    ----------
    video
        Floats in [-1, 1], shape (T, H, W, 3).

    Raises
    ------
    DatasetError
        The tensor has another shape, no frame, another kind of number, or values outside [-1, 1].

    Examples
    --------
    >>> check_video(torch.zeros(2, 48, 64, 3))
    (48, 64)
    """
    if video.ndim != 4 or video.shape[3] != 3 or video.numel() == 0:
        raise DatasetError(f"video: expected shape (T, H, W, 3) with T >= 1, got {tuple(video.shape)}; reshape it")
    if not video.is_floating_point():
        raise DatasetError(f"video: expected floats in [-1, 1], got {video.dtype}; divide by 127.5 and subtract 1")
    low, high = (float(value) for value in torch.aminmax(video))
    if not (low >= -1.0 and high <= 1.0):
        raise DatasetError(f"video: expected values in [-1, 1], got {low:g} to {high:g}; divide and shift them")
    return video.shape[1], video.shape[2]


def check_queries(queries: Tensor, frames: int, image_size: Resolution) -> None:
    """Refuses query points outside the video.

    Parameters
    ----------
    queries
        Frame index, row and column, shape (N, 3) [frames, px, px].
    frames
        Number of frames of the video.
    image_size
        Height and width of the video [px].

    Raises
    ------
    DatasetError
        The tensor has another shape, no point, or a point outside the video.

    Examples
    --------
    >>> check_queries(torch.tensor([[0.0, 12.0, 20.0]]), 2, (48, 64))
    """
    if queries.ndim != 2 or queries.shape[1] != 3 or len(queries) == 0:
        raise DatasetError(f"queries: expected shape (N, 3) with N >= 1, got {tuple(queries.shape)}; reshape them")
    upper = torch.tensor([frames - 1, *image_size], dtype=torch.float64)
    points = queries.detach().to("cpu", torch.float64)
    inside = ((points >= 0) & (points <= upper)).all(dim=1)
    if not inside.all():
        raise DatasetError(
            f"queries: expected (t, y, x) from 0 to {tuple(upper.tolist())}, got {tuple(points[~inside][0].tolist())}; "
            "give frame index and pixels of the video"
        )


def check_resolutions(
    resolutions: Sequence[Resolution] | None, image_size: Resolution, config: TapirConfig
) -> tuple[Resolution, ...]:
    """The refinement resolutions asked for, or the default ones of the video.

    Parameters
    ----------
    resolutions
        Heights and widths [px]; the default ones where ``None``.
    image_size
        Height and width of the video [px].
    config
        Constants of the network.

    Raises
    ------
    DatasetError
        The list is empty.
    SessionError
        The network cannot run at a resolution.

    Examples
    --------
    >>> check_resolutions(None, (240, 256), TapirConfig())
    ((256, 256),)
    """
    if resolutions is None:
        resolutions = refinement_resolutions(image_size, config.initial_resolution)
    if not resolutions:
        raise DatasetError("resolutions: expected at least one, got none; leave it out for the default")
    return tuple(check_resolution(resolution, config.pyramid_level) for resolution in resolutions)


def check_state(state: CausalState, refinements: int, shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    """Refuses a state of other points or resolutions.

    Parameters
    ----------
    state
        Memory after the frame before.
    refinements
        Number of refinements that it must have.
    shapes
        Shapes of the two parts of each.

    Raises
    ------
    DatasetError
        The state belongs to other points or resolutions.
    """
    found = [(tuple(mixer.normalized.shape), tuple(mixer.activated.shape)) for mixer in state.refinements]
    if found != [shapes] * refinements:
        raise DatasetError(
            f"state: expected {refinements} refinements of shapes {shapes}, got {len(found)} of {found[:1]}; "
            "start from initial_state"
        )


def check_chunks(frame_chunk: int, query_chunk: int) -> None:
    """Refuses chunks without content.

    Parameters
    ----------
    frame_chunk, query_chunk
        Number of frames and of points that are computed at a time.

    Raises
    ------
    DatasetError
        One of them is below 1.

    Examples
    --------
    >>> check_chunks(16, 16)
    """
    if frame_chunk < 1 or query_chunk < 1:
        raise DatasetError(
            f"chunks: expected at least 1, got {frame_chunk} frames and {query_chunk} queries; enlarge them"
        )
