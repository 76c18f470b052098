"""Feature matches by learned networks: SuperPoint features with SuperGlue or LightGlue, through ``transformers``."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.inputs.session import Sfm
from vfm_sdm.inputs.video import Region
from vfm_sdm.networks.weights import weights_id
from vfm_sdm.stages.matching.features import FeatureMatches
from vfm_sdm.stages.matching.network_images import reduce_image

__all__ = ["MATCHERS", "LearnedMatcher", "superpoint_matcher"]

MATCHERS = {"superglue": "magic-leap-community/superglue_outdoor", "lightglue": "ETH-CVG/lightglue_superpoint"}
"""Published checkpoint of each matcher; both hold SuperPoint, whose licence excludes commercial use."""

_KEYPOINTS = 2048
"""Strongest features of an image that are kept: the matchers compare each with each."""
_CELL_PX = 8
"""The detector works on cells of this side, so the canvas has a whole number of them."""
_BORDER_PX = 4


class LearnedMatcher:
    """SuperPoint features, matched by SuperGlue or LightGlue.

    Parameters
    ----------
    matcher
        Key of `MATCHERS`.
    model
        Folder with ``config.json`` and ``model.safetensors``; by default the published checkpoint where it lies
        already in the download cache. Nothing is downloaded here: the checkpoints come with a licence to accept.

    Attributes
    ----------
    weights_id
        Name and hash, or commit, of the weights, for keys.

    Raises
    ------
    BackendUnavailableError
        The matcher is unknown, torch or transformers is missing, or the folder does not hold such a network whole.

    References
    ----------
    .. [1] DeTone, D., Malisiewicz, T., Rabinovich, A. (2018). SuperPoint: self-supervised interest point detection and
       description. CVPR Workshops.
    .. [2] Sarlin, P.-E., DeTone, D., Malisiewicz, T., Rabinovich, A. (2020). SuperGlue: learning feature matching with
       graph neural networks. IEEE/CVF Conference on Computer Vision and Pattern Recognition.
    .. [3] Lindenberger, P., Sarlin, P.-E., Pollefeys, M. (2023). LightGlue: local feature matching at light speed.
       IEEE/CVF International Conference on Computer Vision.
    """

    def __init__(self, matcher: str, *, model: Path | str | None = None) -> None:
        if matcher not in MATCHERS:
            raise BackendUnavailableError(
                f"sfm matcher: expected one of {sorted(MATCHERS)}, got {matcher!r}; choose one of these"
            )
        try:
            self._torch: Any = import_module("torch")
            transformers: Any = import_module("transformers")
        except ImportError as error:
            raise BackendUnavailableError(
                f"sfm matcher {matcher!r}: expected torch and transformers, got no {error.name}; "
                "pip install 'vfm-sdm[sfm]', or use matching = 'sift'"
            ) from error
        self._network = _load_network(transformers, matcher, model)
        # A checkpoint of the hub is one commit; a folder is known by its weights.
        commit = getattr(self._network.config, "_commit_hash", None)
        self.weights_id = f"{matcher}-{commit}" if model is None else weights_id(Path(model) / "model.safetensors")

    def match(self, images: Sequence[LumaArray]) -> dict[tuple[int, int], FeatureMatches]:
        """Features that look alike, by pair of images, before any geometric check.

        Parameters
        ----------
        images
            Luma, shape (H, W) each; sizes may differ.

        Returns
        -------
        matches
            By pair ``i < j``; their quality is the matcher's score.

        Notes
        -----
        All images are reduced by their own scale and stand at the top left of one common canvas, so that an image
        has the same features in all its pairs.
        """
        parts = [reduce_image(image) for image in images]
        regions = [region for _, region in parts]
        width, height = (
            -(-max(region.canvas_size[axis] for region in regions) // _CELL_PX) * _CELL_PX for axis in range(2)
        )
        canvases = [_make_canvas(part, (width, height)) for part, _ in parts]
        found = {}
        for i, j in combinations(range(len(images)), 2):
            *pixels, quality = self._match_pair(canvases[i], canvases[j])
            whole = np.logical_and(*(_is_inside(u, regions[k]) for u, k in zip(pixels, (i, j), strict=True)))
            points = [regions[k].to_full(u[whole]) for u, k in zip(pixels, (i, j), strict=True)]
            found[i, j] = FeatureMatches(points[0], points[1], quality[whole])
        return found

    def _match_pair(self, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Canvas pixels of the matches, shape (N, 2) each, and their scores, shape (N,)."""
        torch = self._torch
        pair = torch.from_numpy(np.stack([first, second])[None, :, None].repeat(3, axis=2).astype(np.float32))
        with torch.inference_mode():
            output = self._network(pixel_values=pair)
        size = np.array(first.shape[::-1], dtype=np.float64)
        # The network numbers pixels from the centre of the first one, as we do, and divides by the size.
        points = output.keypoints[0].double().numpy() * size
        # LightGlue drops the axis of the single pair where it neither stops early nor prunes.
        partner, known = output.matches.reshape(2, -1)[0].numpy(), output.mask.reshape(2, -1).numpy() > 0
        rows = np.flatnonzero(known[0] & (partner >= 0))
        rows = rows[known[1][partner[rows]]]
        scores = output.matching_scores.reshape(2, -1)[0].double().numpy()
        return points[0, rows], points[1, partner[rows]], scores[rows]


def superpoint_matcher(*, matcher: str, sfm: Sfm) -> LearnedMatcher:
    """The matcher of ``matching = "superpoint+..."`` with the settings of ``[method.sfm]``.

    Raises
    ------
    BackendUnavailableError
        See `LearnedMatcher`.
    """
    return LearnedMatcher(matcher, model=sfm.model)


def _load_network(transformers: Any, matcher: str, model: Path | str | None) -> Any:
    """The network in evaluation mode, from local files only."""
    source = MATCHERS[matcher] if model is None else str(model)
    advice = (
        f"download {MATCHERS[matcher]} (read its licence first) and pass its folder as model = '...', "
        "or use matching = 'sift'"
    )
    if model is not None and not Path(model).is_dir():
        raise BackendUnavailableError(f"sfm model {source}: expected a folder, got none; {advice}")
    unreadable = (OSError, ValueError, RuntimeError, import_module("safetensors").SafetensorError)
    try:
        config = transformers.AutoConfig.from_pretrained(source, local_files_only=True)
        if config.model_type != matcher:
            raise BackendUnavailableError(
                f"sfm model {source}: expected a {matcher} network, got {config.model_type}; {advice}"
            )
        config.keypoint_detector_config.max_keypoints = _KEYPOINTS
        with _silence(transformers.utils.logging):
            network, report = transformers.AutoModelForKeypointMatching.from_pretrained(
                source,
                config=config,
                local_files_only=True,
                use_safetensors=True,
                ignore_mismatched_sizes=True,
                output_loading_info=True,
            )
    except unreadable as error:
        if model is None:
            raise BackendUnavailableError(
                f"sfm matcher {matcher!r}: expected its checkpoint on this machine, got none; {advice}"
            ) from error
        raise BackendUnavailableError(
            f"sfm model {source}: expected a {matcher} checkpoint, got: {' '.join(str(error).split())}; {advice}"
        ) from error
    # What does not fit is filled with random numbers instead.
    unfit = sorted({*report["missing_keys"], *(key[0] for key in report["mismatched_keys"])})
    if unfit:
        raise BackendUnavailableError(
            f"sfm model {source}: expected all weights of its network, got {len(unfit)} missing or of another shape "
            f"({', '.join(unfit[:3])}); {advice}"
        )
    return network.eval()


@contextmanager
def _silence(log: Any) -> Iterator[None]:
    """Holds back the library's report and progress bar while it loads."""
    verbosity, has_bar = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity(log.CRITICAL)
    log.disable_progress_bar()
    try:
        yield
    finally:
        log.set_verbosity(verbosity)
        if has_bar:
            log.enable_progress_bar()


def _make_canvas(part: LumaArray, size: tuple[int, int]) -> FloatArray:
    """A reduced image in the range 0 to 1 at the top left of a canvas that repeats its last row and column."""
    right, below = size[0] - part.shape[1], size[1] - part.shape[0]
    padded = cv2.copyMakeBorder(np.asarray(part), 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.asarray(padded / 255.0)


def _is_inside(points: FloatArray, region: Region) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Whether canvas pixels lie in the image itself, away from its border."""
    return np.asarray(((points >= _BORDER_PX) & (points < np.array(region.canvas_size) - _BORDER_PX)).all(axis=1))
