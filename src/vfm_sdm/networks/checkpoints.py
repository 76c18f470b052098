"""The checkpoints that the networks load: where each is published, how large it is, and under which licence."""

from dataclasses import dataclass

__all__ = ["CHECKPOINTS", "Checkpoint"]

_HUB = "https://huggingface.co/"
_TAPNET = "https://storage.googleapis.com/dm-tapnet/"
_POSEDIFFUSION = "https://github.com/facebookresearch/PoseDiffusion"
_APACHE = "https://www.apache.org/licenses/LICENSE-2.0"


@dataclass(frozen=True)
class Checkpoint:
    """One published set of weights.

    Parameters
    ----------
    name
        Name in commands and sessions.
    network
        Architecture that loads it, by the name of its package here.
    source
        Repository on Hugging Face (``owner/name``), or the address of a folder (``https://...``).
    file_name
        File in it.
    size_bytes
        Size, to better than one percent.
    licence
        Short name of the licence of these weights; that of the published code may be another one.
    licence_url
        Address where the licence can be read.
    gated
        The publisher gives access only after its terms were accepted on the model's page.
    by_hand
        There is no fixed address of the file: the page at ``source`` links to it, and a person fetches it.
    remarks
        What a user has to know before choosing it.

    Examples
    --------
    >>> CHECKPOINTS["bootstapir"].size
    '219 MB'
    """

    name: str
    network: str
    source: str
    file_name: str
    size_bytes: int
    licence: str
    licence_url: str
    gated: bool = False
    by_hand: bool = False
    remarks: str = ""

    @property
    def on_hub(self) -> bool:
        """Whether it lies in a repository on Hugging Face."""
        return not self.source.startswith("https://")

    @property
    def page(self) -> str:
        """Address of the model's page, or of the file where there is no page."""
        if self.by_hand:
            return self.source
        return _HUB + self.source if self.on_hub else self.source + self.file_name

    @property
    def size(self) -> str:
        """Size as people read it, such as ``5.03 GB`` or ``219 MB``."""
        return f"{self.size_bytes / 1e9:.2f} GB" if self.size_bytes >= 1e9 else f"{self.size_bytes / 1e6:.0f} MB"


_ALL = (
    Checkpoint(
        "vggt-1b",
        "vggt",
        "facebook/VGGT-1B",
        "model.safetensors",
        5_026_370_000,
        "CC-BY-NC-4.0",
        "https://creativecommons.org/licenses/by-nc/4.0/",
        remarks="not for commercial use; the paper's checkpoint",
    ),
    Checkpoint(
        "vggt-1b-commercial",
        "vggt",
        "facebook/VGGT-1B-Commercial",
        "model.safetensors",
        5_026_370_000,
        "VGGT License v1",
        "https://github.com/facebookresearch/vggt/blob/main/LICENSE.txt",
        gated=True,
        remarks="commercial use under an acceptable-use policy, which excludes military use among others",
    ),
    Checkpoint(
        "vggt-tracker-fixed",
        "vggt",
        "facebook/VGGT_tracker_fixed",
        "model_tracker_fixed_e20.pt",
        5_026_900_000,
        "see model page",
        "https://huggingface.co/facebook/VGGT_tracker_fixed",
        remarks=(
            "its authors' correction of VGGT-1B: tracker fine-tuned with the position embedding in its feature head "
            "switched on, all else unchanged, so the network must be built with that embedding; the licence was not "
            "confirmed, treat it as CC-BY-NC-4.0 like VGGT-1B unless the model page says otherwise"
        ),
    ),
    Checkpoint(
        "bootstapir",
        "tapir",
        f"{_TAPNET}bootstap/",
        "bootstapir_checkpoint_v2.pt",
        218_886_140,
        "Apache-2.0",
        _APACHE,
        remarks="offline: reads the whole recording before it answers",
    ),
    Checkpoint(
        "bootstapir-causal",
        "tapir",
        f"{_TAPNET}bootstap/",
        "causal_bootstapir_checkpoint.pt",
        218_887_028,
        "Apache-2.0",
        _APACHE,
        remarks="online: frame by frame; same keys and shapes as bootstapir, so the network must be built causal",
    ),
    Checkpoint(
        "tapir-panning",
        "tapir",
        _TAPNET,
        "tapir_checkpoint_panning.pt",
        124_348_474,
        "Apache-2.0",
        _APACHE,
        remarks="plain TAPIR, offline: fewer pyramid levels, no extra convolutions",
    ),
    Checkpoint(
        "posediffusion-co3d",
        "posediffusion",
        _POSEDIFFUSION,
        "co3d_model1.pth",
        156_000_000,
        "CC-BY-NC-4.0",
        "https://creativecommons.org/licenses/by-nc/4.0/",
        by_hand=True,
        remarks=(
            "not for commercial use: the licence is that of the published code, of the weights none is stated; the "
            "paper's second camera estimator, trained on objects (CO3D)"
        ),
    ),
    Checkpoint(
        "posediffusion-re10k",
        "posediffusion",
        _POSEDIFFUSION,
        "posediffusion-re10k.pth",
        156_000_000,
        "CC-BY-NC-4.0",
        "https://creativecommons.org/licenses/by-nc/4.0/",
        by_hand=True,
        remarks=(
            "as posediffusion-co3d, trained on rooms and houses (RealEstate10K) with pictures of 336 px, which only "
            "the file's name tells; the publisher's name of the file is not known here"
        ),
    ),
    Checkpoint(
        "aliked-n16",
        "aliked",
        "https://github.com/Shiaoming/ALIKED/raw/main/models/",
        "aliked-n16.pth",
        2_738_091,
        "BSD-3-Clause",
        "https://github.com/Shiaoming/ALIKED/blob/main/LICENSE",
        remarks="features of matching = 'aliked+lightglue', with aliked-lightglue",
    ),
    Checkpoint(
        "aliked-lightglue",
        "lightglue",
        "https://github.com/cvg/LightGlue/releases/download/v0.1_arxiv/",
        "aliked_lightglue.pth",
        47_632_827,
        "Apache-2.0",
        _APACHE,
        remarks="matcher of matching = 'aliked+lightglue', with aliked-n16",
    ),
    Checkpoint(
        "xfeat",
        "xfeat",
        "https://github.com/verlab/accelerated_features/raw/main/weights/",
        "xfeat.pt",
        6_247_949,
        "Apache-2.0",
        _APACHE,
        remarks="features of matching = 'xfeat', with xfeat-lighterglue",
    ),
    Checkpoint(
        "xfeat-lighterglue",
        "lightglue",
        "https://github.com/verlab/accelerated_features/raw/main/weights/",
        "xfeat-lighterglue.pt",
        10_820_795,
        "Apache-2.0",
        _APACHE,
        remarks="matcher of matching = 'xfeat', with xfeat",
    ),
)

CHECKPOINTS = {checkpoint.name: checkpoint for checkpoint in _ALL}
"""Every checkpoint by its name."""
