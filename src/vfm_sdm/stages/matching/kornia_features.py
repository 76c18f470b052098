"""Feature matches by small trained networks that kornia holds: ALIKED, XFeat, and a LightGlue for each."""

from collections.abc import Sequence
from importlib import import_module
from itertools import combinations
from typing import Any

import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.inputs.session import Network
from vfm_sdm.networks.availability import require_torch, why_unavailable
from vfm_sdm.networks.loading import load_weights, read_state
from vfm_sdm.networks.weights import find_weights, weights_id
from vfm_sdm.stages.matching.features import FeatureMatches
from vfm_sdm.stages.matching.network_images import reduce_image

__all__ = ["AUTOMATIC", "KorniaMatcher", "choose_matcher"]

AUTOMATIC = ("aliked+lightglue", "xfeat")
"""What ``auto`` takes, the first whose packages and weights are here: ALIKED places features to a fraction of a pixel
and bears every kind of texture; XFeat takes half the time and finds more on built structures, at whole pixels."""

_KEYPOINTS = {"aliked": 2048, "xfeat": 4096}
"""Strongest features of an image that are kept, as their authors propose; LightGlue compares each with each."""
_MATCHERS = {"aliked": "aliked-lightglue", "xfeat": "xfeat-lighterglue"}
_EXTRACTORS = {"aliked": "aliked-n16", "xfeat": "xfeat"}


class KorniaMatcher:
    """Features of a trained detector, matched by a LightGlue trained for it.

    Parameters
    ----------
    detector
        ``aliked`` [1]_ or ``xfeat`` [2]_.
    network
        Settings of networks, of which the device counts; the weights are those registered for the detector.

    Attributes
    ----------
    weights_id
        Names and hashes of the weights, for keys.

    Raises
    ------
    BackendUnavailableError
        PyTorch, kornia or the weights are not here.

    References
    ----------
    .. [1] Zhao, X., Wu, X., Chen, W., Chen, P. C. Y., Xu, Q., Li, Z. (2023). ALIKED: a lighter keypoint and descriptor
       extraction network via deformable transformation. IEEE Transactions on Instrumentation and Measurement 72.
    .. [2] Potje, G., Cadar, F., Araujo, A., Martins, R., Nascimento, E. R. (2024). XFeat: accelerated features for
       lightweight image matching. IEEE/CVF Conference on Computer Vision and Pattern Recognition.
    .. [3] Lindenberger, P., Sarlin, P.-E., Pollefeys, M. (2023). LightGlue: local feature matching at light speed.
       IEEE/CVF International Conference on Computer Vision.
    """

    def __init__(self, detector: str, *, network: Network | None = None) -> None:
        require_torch(f"matching by {detector}")
        try:
            self._kornia: Any = import_module("kornia.feature")
        except ImportError as error:
            raise BackendUnavailableError(
                f"matching by {detector}: expected the package kornia, got none; pip install 'vfm-sdm[sfm]', or use "
                "matching = 'sift'"
            ) from error
        self._torch: Any = import_module("torch")
        placing: Any = import_module("vfm_sdm.networks.device")
        self._place: Any = placing.choose_placement((network or Network()).device, "float32")
        self._detector = detector
        files = (find_weights(names[detector]) for names in (_EXTRACTORS, _MATCHERS))
        self.weights_id = "+".join(weights_id(file) for file in files)
        self._extract = self._load_extractor().to(self._place.device).eval()
        self._glue = self._load_matcher().to(self._place.device).eval()

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
        """
        with self._place.running():
            features = [self._find_features(image) for image in images]
            pairs = combinations(range(len(images)), 2)
            return {(i, j): self._match_pair(features[i], features[j]) for i, j in pairs}

    def _find_features(self, luma: LumaArray) -> tuple[dict[str, Any], FloatArray]:
        """Features as LightGlue takes them, and their full-image pixels, shape (N, 2)."""
        image, region = reduce_image(luma)
        batch = self._torch.from_numpy(np.ascontiguousarray(image))[None, None].to(self._place.device).float() / 255
        if self._detector == "xfeat":
            found = self._extract.detectAndCompute(batch)[0]
            points, descriptors = found["keypoints"], found["descriptors"]
        else:
            found = self._extract(batch)[0]
            points, descriptors = found.keypoints, found.descriptors
        entry = {
            "keypoints": points[None],
            "descriptors": descriptors[None],
            "image_size": self._torch.tensor([region.canvas_size], device=points.device),
        }
        return entry, region.to_full(points.double().cpu().numpy())

    def _match_pair(
        self, first: tuple[dict[str, Any], FloatArray], second: tuple[dict[str, Any], FloatArray]
    ) -> FeatureMatches:
        if min(len(first[1]), len(second[1])) == 0:
            return FeatureMatches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))
        found = self._glue({"image0": first[0], "image1": second[0]})
        rows, partners = found["matches"][0].cpu().numpy().T
        quality = found["scores"][0].double().cpu().numpy()
        order = np.argsort(-quality, kind="stable")
        return FeatureMatches(first[1][rows], second[1][partners], quality).chosen(order)

    def _load_extractor(self) -> Any:
        """The detector with its weights."""
        count, state = _KEYPOINTS[self._detector], read_state(_EXTRACTORS[self._detector])
        if self._detector == "xfeat":
            network = self._kornia.XFeat(top_k=count)
            load_weights(network.net, state)
            return network
        network = self._kornia.ALIKED("aliked-n16", max_num_keypoints=count, detection_threshold=0.0)
        load_weights(network, {**_computed(network, "dkd."), **state})
        return network

    def _load_matcher(self) -> Any:
        """LightGlue with the weights for this detector."""
        settings = {**self._kornia.LightGlue.features[self._detector], "weights": None}
        network = self._kornia.LightGlue(None, **settings)
        state = {key.removeprefix("matcher."): value for key, value in read_state(_MATCHERS[self._detector]).items()}
        # Older files name the layers by what they are; some hold the detector, too.
        for layer in range(network.conf.n_layers):
            for part in ("self_attn", "cross_attn"):
                old, new = f"{part}.{layer}.", f"transformers.{layer}.{part}."
                state = {new + k.removeprefix(old) if k.startswith(old) else k: v for k, v in state.items()}
        load_weights(
            network, {**_computed(network, "confidence_thresholds"), **state}, optional_prefixes=("extractor.",)
        )
        return network


def choose_matcher(*, network: Network) -> KorniaMatcher | None:
    """The matcher of ``matching = "auto"``: a network whose packages and weights are here, else ``None`` for SIFT.

    Parameters
    ----------
    network
        Settings of networks.
    """
    for name in AUTOMATIC:
        if why_unavailable("features", name) is None:
            return KorniaMatcher(name.partition("+")[0], network=network)
    return None


def _computed(network: Any, prefix: str) -> dict[str, Any]:
    """Entries of a network's state that are computed when it is built, not trained."""
    return {key: value for key, value in network.state_dict().items() if key.startswith(prefix)}
