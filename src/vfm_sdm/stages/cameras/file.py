"""Camera files in the project's own TOML, and the estimator ``file`` that takes the cameras from them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import Field, Strict, model_validator
from scipy.spatial.distance import pdist

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.covariances import is_covariance
from vfm_sdm.core.files import write_file
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.geometry.rig_views import select_views
from vfm_sdm.inputs.session import Session
from vfm_sdm.inputs.session.entries import read_entry
from vfm_sdm.inputs.session.site import Entry
from vfm_sdm.stages.cameras.base import CameraEstimate
from vfm_sdm.stages.cameras.opencv_file import read_opencv_camera, read_opencv_stereo

__all__ = ["FileCameras", "read_camera", "read_opencv_stereo", "read_rig", "write_rig"]

_FORMAT = "vfm-sdm cameras 1"
_Number = Annotated[float, Strict(), Field(ge=-1e15, le=1e15)]
_Focal = Annotated[float, Strict(), Field(gt=0, ge=1e-3, le=1e9)]
_Pixels = Annotated[int, Strict(), Field(gt=0, le=10**6)]
_Vector = tuple[_Number, _Number, _Number]
_SAME_PLACE = 1e-9


class _CameraEntry(Entry):
    name: Annotated[str, Field(min_length=1)]
    image_size: tuple[_Pixels, _Pixels]
    fx: _Focal
    fy: _Focal
    cx: _Number
    cy: _Number
    skew: _Number = 0.0
    distortion: Annotated[tuple[_Number, ...], Field(max_length=5)]
    rotation: tuple[_Vector, _Vector, _Vector] | None = None
    translation: _Vector | None = None

    @model_validator(mode="after")
    def _whole_pose(self) -> Self:
        if (self.rotation is None) != (self.translation is None):
            raise ValueError("expected rotation and translation or neither, got one of them; add the other")
        return self

    @property
    def has_pose(self) -> bool:
        return self.rotation is not None

    def camera(self) -> Camera:
        K = np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])
        if self.rotation is None or self.translation is None:
            return Camera(K, self.image_size, np.array(self.distortion))
        pose = np.column_stack([self.rotation, self.translation])
        return Camera(K, self.image_size, np.array(self.distortion), pose)


class _RigEntry(Entry):
    format: Literal["vfm-sdm cameras 1"] = "vfm-sdm cameras 1"
    metric: Annotated[bool, Strict()] = False
    camera: Annotated[tuple[_CameraEntry, ...], Field(min_length=1)]
    covariance_parameters: tuple[str, ...] | None = None
    covariance: tuple[tuple[_Number, ...], ...] | None = None
    extra: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known_parameters(self) -> Self:
        if self.covariance is not None and self.covariance_parameters != CAMERA_PARAMETERS:
            raise ValueError(
                f"expected covariance_parameters {list(CAMERA_PARAMETERS)}, got {self.covariance_parameters}; "
                "use a file written by this version"
            )
        return self


def write_rig(path: Path | str, rig: Rig, *, extra: Mapping[str, Any] | None = None) -> None:
    """Writes a rig as TOML, complete and without loss; the file is whole or absent.

    Parameters
    ----------
    path
        The file to make or replace.
    rig
        V cameras, with intrinsics [px], poses [length unit of the rig] and covariance, shape (10 V, 10 V), if there is
        one.
    extra
        Further values for the reader's information, kept in the table ``extra``.

    Raises
    ------
    CameraError
        ``extra`` holds something that TOML cannot.
    ResultsError
        The file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> with TemporaryDirectory() as folder:
    ...     write_rig(f"{folder}/cameras.toml", Rig(("left",), (camera,)))
    ...     print(Path(folder, "cameras.toml").read_text().splitlines()[0])
    format = "vfm-sdm cameras 1"
    """
    document: dict[str, Any] = {"format": _FORMAT, "metric": rig.metric}
    if rig.covariance is not None:
        document["covariance_parameters"] = list(CAMERA_PARAMETERS)
        document["covariance"] = rig.covariance.tolist()
    document["camera"] = [
        {
            "name": name,
            "image_size": list(camera.image_size),
            "fx": float(camera.K[0, 0]),
            "fy": float(camera.K[1, 1]),
            "cx": float(camera.K[0, 2]),
            "cy": float(camera.K[1, 2]),
            "skew": float(camera.K[0, 1]),
            "distortion": camera.distortion.tolist(),
            "rotation": camera.rotation.tolist(),
            "translation": camera.translation.tolist(),
        }
        for name, camera in zip(rig.names, rig.cameras, strict=True)
    ]
    if extra:
        document["extra"] = dict(extra)
    try:
        text = tomli_w.dumps(document)
    except TypeError as error:
        raise CameraError(f"extra: expected numbers, strings, lists and tables, got another type; {error}") from error
    write_file(path, text)


def read_rig(path: Path | str) -> Rig:
    """The rig that `write_rig` wrote; a single camera needs no pose.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    rig
        V cameras, with intrinsics [px], poses [length unit of the rig] and covariance, shape (10 V, 10 V), if the file
        has one.

    Raises
    ------
    CameraError
        The file is absent or no TOML, a key is unknown, missing or has an impossible value, or one of several
        cameras has no pose.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> with TemporaryDirectory() as folder:
    ...     write_rig(f"{folder}/cameras.toml", Rig(("left",), (camera,)))
    ...     print(read_rig(f"{folder}/cameras.toml").names)
    ('left',)
    """
    entry = _read_entry(path)
    without = [camera.name for camera in entry.camera if not camera.has_pose]
    if without and len(entry.camera) > 1:
        raise CameraError(
            f"{path}: expected rotation and translation of every camera, got none for {without}; add them"
        )
    return _make_rig(path, entry)


def read_camera(path: Path | str, name: str | None = None, *, image_size: tuple[int, int] | None = None) -> Camera:
    """One camera from the project's own TOML (``.toml``) or from an OpenCV file (YAML, XML, JSON).

    Parameters
    ----------
    path
        The file.
    name
        Name of the camera, where the file holds several; a single one is taken whatever its name.
    image_size
        Width and height [px] for OpenCV files that do not state them.

    Raises
    ------
    CameraError
        The file cannot be read, or does not hold the camera.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> camera = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
    >>> with TemporaryDirectory() as folder:
    ...     write_rig(f"{folder}/cameras.toml", Rig(("left",), (camera,)))
    ...     print(read_camera(f"{folder}/cameras.toml").focal_px)
    1000.0
    """
    if Path(path).suffix.lower() != ".toml":
        return read_opencv_camera(path, name, image_size=image_size)
    cameras = {entry.name: entry for entry in _read_entry(path).camera}
    if len(cameras) == 1:
        return next(iter(cameras.values())).camera()
    if name not in cameras:
        raise CameraError(f"{path}: expected one of its cameras {list(cameras)}, got {name!r}; give the right name")
    return cameras[name].camera()


class FileCameras:
    """Estimator ``file``: every view's ``camera`` names a file with its intrinsics and pose."""

    name = "file"

    def estimate(self, session: Session, frames: Mapping[str, LumaArray]) -> CameraEstimate:
        """Rig of the session's views, with the first view as the reference view.

        Parameters
        ----------
        session
            The measurement, whose views name their files under ``camera``: one file with all cameras, or several files
            whose poses are given in one common frame.
        frames
            First frame of each view, shape (H, W); only the sizes [px] are used.

        Raises
        ------
        CameraError
            A view has no file, a file has no camera of the view's name or no pose for it, the files disagree about
            being metric, or an image size is not that of the recording.
        """
        paths = {view.name: view.camera for view in session.view if view.name in frames}
        missing = [view for view in frames if paths.get(view) is None]
        if missing:
            raise CameraError(
                f"cameras = 'file': expected a camera file for every view, got none for {missing}; add it"
            )
        files = {view: session.resolve(path) for view, path in paths.items() if path is not None}
        rigs = {file: _read_posed_rig(file) for file in dict.fromkeys(files.values())}
        for view, luma in frames.items():
            _check_view(files[view], rigs[files[view]], view, (luma.shape[1], luma.shape[0]))
        metric = {rig.metric for rig in rigs.values()}
        if len(metric) > 1:
            raise CameraError(
                f"cameras = 'file': expected files that are all metric or none, got both in {sorted(map(str, rigs))}; "
                "write them from one calibration"
            )
        notes = [] if metric == {True} else ["camera files are not metric: lengths need a measured baseline"]
        if len(rigs) == 1:
            rig = select_views(next(iter(rigs.values())), tuple(frames))
        else:
            cameras = [rigs[files[view]].camera(view) for view in frames]
            rig = Rig.from_world(tuple(frames), cameras, metric=metric == {True})
        distances = pdist([camera.center for camera in rig.cameras])
        if distances.size and distances.min() < _SAME_PLACE * (1 + distances.max()):
            raise CameraError(
                "cameras = 'file': expected cameras that stand apart, got two at one place; correct their poses"
            )
        if rig.covariance is None:
            notes.append("camera files: without a joint covariance their part of the uncertainty is unknown")
        return CameraEstimate(rig, (), CameraStatus.OK, tuple(notes))


def _read_entry(path: Path | str) -> _RigEntry:
    entry = read_entry(path, _RigEntry, what="camera file")
    names = [camera.name for camera in entry.camera]
    if len(set(names)) != len(names):
        raise CameraError(f"{path}: expected distinct camera names, got {names}; rename them")
    return entry


def _make_rig(path: Path | str, entry: _RigEntry) -> Rig:
    names = tuple(camera.name for camera in entry.camera)
    cameras = tuple(camera.camera() for camera in entry.camera)
    covariance = None
    if entry.covariance is not None:
        size = len(CAMERA_PARAMETERS) * len(names)
        if len(entry.covariance) != size or any(len(row) != size for row in entry.covariance):
            raise CameraError(f"{path}: expected a covariance of {size} x {size}, got another shape; write it anew")
        covariance = np.array(entry.covariance)
        if not is_covariance(covariance):
            raise CameraError(
                f"{path}: expected a symmetric covariance without negative variances, got another matrix; write it anew"
            )
    return Rig(names, cameras, entry.metric, covariance)


def _read_posed_rig(path: Path) -> Rig:
    """The file's rig, which must hold poses."""
    advice = "use cameras = 'two-view', which takes the intrinsics from it"
    if path.suffix.lower() != ".toml":
        raise CameraError(f"{path}: expected a TOML file with poses for cameras = 'file', got {path.suffix}; {advice}")
    entry = _read_entry(path)
    without = [camera.name for camera in entry.camera if not camera.has_pose]
    if without:
        raise CameraError(f"{path}: expected rotation and translation of {without}, got intrinsics only; {advice}")
    return _make_rig(path, entry)


def _check_view(path: Path, rig: Rig, view: str, size: tuple[int, int]) -> None:
    if view not in rig.names:
        raise CameraError(f"{path}: expected a camera named {view!r}, got {list(rig.names)}; rename it in the file")
    found = rig.camera(view).image_size
    if found != size:
        raise CameraError(
            f"{path}: camera {view!r}: expected the recording's {size[0]} x {size[1]} pixels, "
            f"got {found[0]} x {found[1]}; calibrate at the size of the recording"
        )
