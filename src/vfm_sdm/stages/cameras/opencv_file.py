"""Cameras in the YAML, XML or JSON files of OpenCV, or of programs that write like it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Camera, Rig

__all__ = ["read_opencv_camera", "read_opencv_stereo"]

_MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "K", "M")
_DISTORTION_KEYS = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D")
_NUMBER_OF_NAME = {"1": "1", "left": "1", "2": "2", "right": "2"}
_MODELS = ("", "plumb_bob")
"""Values of ``distortion_model`` that mean k1, k2, p1, p2, k3."""


def read_opencv_camera(
    path: Path | str, name: str | None = None, *, image_size: tuple[int, int] | None = None
) -> Camera:
    """One camera without a pose from an OpenCV file.

    Parameters
    ----------
    path
        File with ``camera_matrix`` (or ``K``, ``M``) and ``distortion_coefficients`` (or ``D``), or with two numbered
        cameras (``M1, D1, M2, D2``); ROS camera files are read too.
    name
        ``"left"`` or ``"1"``, ``"right"`` or ``"2"`` where the file holds two cameras; else it may be anything.
    image_size
        Width and height [px] where the file has no ``image_width`` and ``image_height``.

    Returns
    -------
    camera
        Intrinsics K, shape (3, 3) [px], and distortion, shape (5,) [1]; the pose is the identity.

    Raises
    ------
    CameraError
        The file cannot be read, a key is missing, the lens model is another one, or the image size is unknown or
        contradicts the file.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     storage = cv2.FileStorage(f"{folder}/camera.yml", cv2.FILE_STORAGE_WRITE)
    ...     storage.write("camera_matrix", np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]]))
    ...     storage.write("distortion_coefficients", np.zeros((1, 5)))
    ...     storage.release()
    ...     print(read_opencv_camera(f"{folder}/camera.yml", image_size=(640, 480)).focal_px)
    1000.0
    """
    with _open_storage(path) as storage:
        number = _find_camera_number(storage, path, name)
        K = _read_first_matrix(storage, path, [key + number for key in _MATRIX_KEYS])
        distortion = _read_first_matrix(storage, path, [key + number for key in _DISTORTION_KEYS])
        size = _read_image_size(storage)
        model = storage.getNode("distortion_model")
        model_name = model.string() if model.isString() else ""
        fisheye = storage.getNode("fisheye_model")
        is_fisheye = fisheye.isInt() and fisheye.real() != 0
    if model_name not in _MODELS or is_fisheye:
        raise CameraError(
            f"{path}: expected the model k1, k2, p1, p2, k3, got {'a fisheye lens' if is_fisheye else model_name}; "
            "calibrate with the five-coefficient model"
        )
    if size is None and image_size is None:
        raise CameraError(f"{path}: expected image_width and image_height, got none; add them to the file")
    if size is not None and image_size is not None and size != image_size:
        raise CameraError(f"{path}: expected an image size of {image_size}, got {size}; use the camera's own file")
    if K.shape != (3, 3):
        raise CameraError(f"{path}: expected a 3 x 3 camera matrix, got {K.shape[0]} x {K.shape[1]}; check the file")
    return Camera(K, size or image_size or (0, 0), distortion.ravel())


def read_opencv_stereo(
    intrinsics_path: Path | str,
    extrinsics_path: Path | str,
    image_size: tuple[int, int],
    *,
    names: tuple[str, str] = ("left", "right"),
    unit_m: float | None = None,
) -> Rig:
    """The rig in the pair of files that OpenCV's stereo calibration sample writes.

    Parameters
    ----------
    intrinsics_path
        File with ``M1, D1, M2, D2``.
    extrinsics_path
        File with ``R`` and ``T``, which lead from the first camera's frame to the second one's.
    image_size
        Width and height of both images [px].
    names
        Names of the two views.
    unit_m
        Length of one unit of ``T`` [m], which the files do not tell; without it the rig is not metric.

    Raises
    ------
    CameraError
        A file cannot be read, a key is missing, or a matrix has another shape.
    """
    first, second = (read_opencv_camera(intrinsics_path, number, image_size=image_size) for number in ("1", "2"))
    with _open_storage(extrinsics_path) as storage:
        R = _read_first_matrix(storage, extrinsics_path, ["R"])
        T = _read_first_matrix(storage, extrinsics_path, ["T"])
    if R.shape != (3, 3) or T.size != 3:
        raise CameraError(
            f"{extrinsics_path}: expected R of 3 x 3 and T of 3 numbers, got {R.shape} and {T.shape}; check the file"
        )
    rig = Rig(names, (first, replace(second, cam_from_world=np.column_stack([R, T.ravel()]))))
    if unit_m is None:
        return rig
    if not (np.isfinite(unit_m) and unit_m > 0):
        raise CameraError(f"unit_m: expected a length above 0 m, got {unit_m}; give the size of a unit of T")
    return rig.scaled(unit_m)


@contextmanager
def _open_storage(path: Path | str) -> Iterator[Any]:
    if not Path(path).is_file():
        raise CameraError(f"{path}: expected a camera file, got none there; correct the path")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:  # OpenCV's constructor turns its own error into a SystemError
        raise CameraError(f"{path}: expected YAML, XML or JSON as OpenCV writes it, got something else") from error
    if not storage.isOpened():
        raise CameraError(f"{path}: expected YAML, XML or JSON as OpenCV writes it, got something else")
    try:
        yield storage
    finally:
        storage.release()


def _find_camera_number(storage: Any, path: Path | str, name: str | None) -> str:
    """Suffix of the camera's keys: empty in a file of one camera."""
    numbered = [n for n in ("1", "2") if any(not storage.getNode(key + n).empty() for key in _MATRIX_KEYS)]
    if not numbered:
        return ""
    number = _NUMBER_OF_NAME.get(name or "", "")
    if number in numbered:
        return number
    if len(numbered) == 1 and not number:
        return numbered[0]
    raise CameraError(
        f"{path}: expected the name of one of its cameras ({', '.join(numbered)}; left, right), got {name!r}; "
        "write each view's camera to a file of its own"
    )


def _read_first_matrix(storage: Any, path: Path | str, keys: Sequence[str]) -> FloatArray:
    """The matrix under the first key that is there, shape (rows, cols)."""
    for key in keys:
        node = storage.getNode(key)
        if not node.empty():
            return _read_matrix(node, f"{path}: {key}")
    raise CameraError(f"{path}: expected {' or '.join(keys)}, got keys {list(storage.root().keys())}; check the file")


def _read_matrix(node: Any, label: str) -> FloatArray:
    # Read by hand, because OpenCV's own reader wants a type tag that ROS files do not have.
    entries = {key: node.getNode(key) for key in ("rows", "cols", "data")} if node.isMap() else {}
    if not entries or any(entry.empty() for entry in entries.values()) or not entries["data"].isSeq():
        raise CameraError(f"{label}: expected rows, cols and data, got another layout; write it as OpenCV does")
    items = [entries["data"].at(index) for index in range(entries["data"].size())]
    rows, cols = int(entries["rows"].real()), int(entries["cols"].real())
    if len(items) != rows * cols or not all(item.isReal() or item.isInt() for item in items):
        raise CameraError(f"{label}: expected {rows} x {cols} numbers, got {len(items)} entries; check the file")
    return np.array([item.real() for item in items], dtype=np.float64).reshape(rows, cols)


def _read_image_size(storage: Any) -> tuple[int, int] | None:
    width, height = storage.getNode("image_width"), storage.getNode("image_height")
    if width.isInt() and height.isInt():
        return int(width.real()), int(height.real())
    return None
