"""The file of a lens, TOML: what `vfm-sdm lens` writes and a session's ``lens = { file = ... }`` names."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import Field, Strict, model_validator

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.covariances import is_covariance
from vfm_sdm.core.files import file_hash, write_file
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera
from vfm_sdm.inputs.session.entries import read_entry
from vfm_sdm.inputs.session.site import Entry

__all__ = ["KnownLens", "read_lens", "write_lens"]

_PARAMETERS = CAMERA_PARAMETERS[:4]
_Number = Annotated[float, Strict(), Field(ge=-1e15, le=1e15)]
_Focal = Annotated[float, Strict(), Field(ge=1e-3, le=1e9)]
_Pixels = Annotated[int, Strict(), Field(gt=0, le=10**6)]
_Row = tuple[_Number, _Number, _Number, _Number]
_SAME_SHAPE_PX = 1.0
"""Difference of a height from that of the scaled picture within which the shape is the same: heights are rounded."""


@dataclass(frozen=True, eq=False)
class KnownLens:
    """A lens and what is known of it.

    Parameters
    ----------
    camera
        Intrinsics and distortion; its pose is the identity.
    covariance
        Of ``log_focal, cx, cy, k1``, in their units, shape (4, 4).
    scaled_from
        Image size at which the lens was found, where it is another one [px].
    """

    camera: Camera
    covariance: FloatArray
    scaled_from: tuple[int, int] | None = None

    def at(self, image_size: tuple[int, int]) -> "KnownLens":
        """The same lens in pictures of another size, of which each shows the same field.

        Parameters
        ----------
        image_size
            Width and height [px].

        Raises
        ------
        CameraError
            Their shape is another one.

        Examples
        --------
        >>> K = np.array([[1000.0, 0.0, 959.5], [0.0, 1000.0, 539.5], [0.0, 0.0, 1.0]])
        >>> known = KnownLens(Camera(K, (1920, 1080)), np.diag([1e-3, 4.0, 4.0, 0.01]) ** 2)
        >>> larger = known.at((3840, 2160))
        >>> larger.camera.K[0].tolist(), np.sqrt(np.diag(larger.covariance)).tolist()
        ([2000.0, 0.0, 1919.5], [0.001, 8.0, 8.0, 0.01])
        """
        own = self.camera.image_size
        if image_size == own:
            return self
        scale = image_size[0] / own[0]
        smaller = min(scale, 1.0)
        if abs(own[1] * scale - image_size[1]) > _SAME_SHAPE_PX / smaller * max(scale, 1.0):
            raise CameraError(
                f"lens file: expected a lens for pictures of {image_size[0]} x {image_size[1]} px or of their shape, "
                f"got one for {own[0]} x {own[1]} px; film the pan clip in the mode of the recording, and upright or "
                "on its side as that"
            )
        K = self.camera.K.copy()
        # Pixels are counted from their centres: the picture begins at -1/2.
        K[:2, 2] += 0.5
        K[:2] *= scale
        K[:2, 2] -= 0.5
        units = np.array([1.0, scale, scale, 1.0])
        camera = Camera(K, image_size, self.camera.distortion)
        return replace(self, camera=camera, covariance=self.covariance * np.outer(units, units), scaled_from=own)


class _Clip(Entry):
    name: str = ""
    sha256: str = ""


class _LensEntry(Entry):
    format: Literal["vfm-sdm lens 1"] = "vfm-sdm lens 1"
    image_size: tuple[_Pixels, _Pixels]
    fx: _Focal
    fy: _Focal
    cx: _Number
    cy: _Number
    distortion: Annotated[tuple[_Number, ...], Field(max_length=5)]
    covariance_parameters: tuple[str, ...]
    covariance: tuple[_Row, _Row, _Row, _Row]
    clip: _Clip = _Clip()
    settings: dict[str, Any] = Field(default_factory=dict)
    found: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known_covariance(self) -> Self:
        if self.covariance_parameters != _PARAMETERS:
            raise ValueError(
                f"expected covariance_parameters {list(_PARAMETERS)}, got {list(self.covariance_parameters)}; use a "
                "file written by this version"
            )
        matrix = np.array(self.covariance)
        if not (np.diag(matrix) > 0).all():
            raise ValueError("expected variances > 0 in covariance, got others; write the file anew")
        if not is_covariance(matrix):
            raise ValueError("expected a symmetric, positive covariance, got another matrix; write the file anew")
        return self


def write_lens(
    path: Path | str,
    known: KnownLens,
    *,
    clip: Path | str,
    settings: Mapping[str, Any] | None = None,
    found: Mapping[str, Any] | None = None,
) -> Path:
    """Writes a lens, whole or not at all; returns the path.

    Parameters
    ----------
    path
        The file to make or replace.
    known
        The lens.
    clip
        The pan clip from which it was found; its name and hash are kept.
    settings
        What was said of the scene, for the reader's information.
    found
        What else was found, for the reader's information.

    Raises
    ------
    ResultsError
        The file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> K = np.array([[1000.0, 0.0, 959.5], [0.0, 1000.0, 539.5], [0.0, 0.0, 1.0]])
    >>> known = KnownLens(Camera(K, (1920, 1080)), np.diag([1e-3, 4.0, 4.0, 0.01]) ** 2)
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "pan.mp4").write_bytes(b"a clip")
    ...     path = write_lens(f"{folder}/lens.toml", known, clip=f"{folder}/pan.mp4")
    ...     print(read_lens(path, image_size=(3840, 2160)).camera.focal_px)
    2000.0
    """
    K = known.camera.K
    document: dict[str, Any] = {
        "format": "vfm-sdm lens 1",
        "image_size": list(known.camera.image_size),
        "fx": float(K[0, 0]),
        "fy": float(K[1, 1]),
        "cx": float(K[0, 2]),
        "cy": float(K[1, 2]),
        "distortion": known.camera.distortion.tolist(),
        "covariance_parameters": list(_PARAMETERS),
        "covariance": known.covariance.tolist(),
        "clip": {"name": Path(clip).name, "sha256": file_hash(clip)},
        "settings": dict(settings or {}),
        "found": dict(found or {}),
    }
    return write_file(path, tomli_w.dumps(document))


def read_lens(path: Path | str, *, image_size: tuple[int, int] | None = None) -> KnownLens:
    """The lens that `write_lens` wrote.

    Parameters
    ----------
    path
        The file.
    image_size
        Width and height of the pictures for which it is wanted [px]; those of the pan clip when left out.

    Raises
    ------
    CameraError
        The file is absent or no TOML, a key is unknown, missing or has an impossible value, or the pictures have
        another shape.
    """
    advice = "check the path, or make it from a pan clip with `vfm-sdm lens`"
    entry = read_entry(path, _LensEntry, what="lens file", advice=advice)
    K = np.array([[entry.fx, 0.0, entry.cx], [0.0, entry.fy, entry.cy], [0.0, 0.0, 1.0]])
    known = KnownLens(Camera(K, entry.image_size, np.array(entry.distortion)), np.array(entry.covariance))
    if image_size is None:
        return known
    try:
        return known.at(image_size)
    except CameraError as error:
        raise CameraError(f"{path}: {error}") from error
