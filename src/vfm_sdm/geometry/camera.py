"""Pinhole camera with lens distortion, and the rig of several such cameras (Eq. 1 of the paper)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray, as_float_array
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.distortion import distort, squared_fold_radius, undistort

__all__ = ["CAMERA_PARAMETERS", "Camera", "Rig"]

CAMERA_PARAMETERS = ("log_focal", "cx", "cy", "k1", "rx", "ry", "rz", "tx", "ty", "tz")
"""The parameters of one camera that carry uncertainty, in the order of a rig's covariance.

``log_focal`` scales fx and fy together [1]; ``cx, cy`` shift the principal point [px]; ``k1`` is the first radial
coefficient [1]; ``rx, ry, rz`` rotate the camera, a rotation vector in the camera's own frame [rad];
``tx, ty, tz`` shift the translation of ``cam_from_world`` [length unit of the rig].
"""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with Brown-Conrady distortion.

    Parameters
    ----------
    K
        Intrinsics, shape (3, 3) [px]; the centre of the top-left pixel is (0, 0).
    image_size
        Width and height [px].
    distortion
        Coefficients k1, k2, p1, p2, k3 in OpenCV's order, shape (5,) [1]; shorter ones are padded with zeros.
    cam_from_world
        Pose, shape (3, 4): rotation and translation. Axes: x right, y down, z forward.

    Raises
    ------
    CameraError
        K is not an upper triangle with positive focal lengths, the rotation is not a rotation, the image has no
        size, there are more than five distortion coefficients, or a value is not finite.
    DatasetError
        A shape is wrong.

    Notes
    -----
    A world point X is seen at ``u = K d((R X + t) / z)`` with the depth z of ``R X + t`` and the distortion d (Eq. 1 of
    the paper; d is the identity there).

    References
    ----------
    .. [1] Brown, D. C. (1971). Close-range camera calibration. Photogrammetric Engineering 37(8), 855-866.
    .. [2] Hartley, R., Zisserman, A. (2004). Multiple View Geometry in Computer Vision, 2nd edition, chapters 6 and 7.
    """

    K: FloatArray
    image_size: tuple[int, int]
    distortion: FloatArray = field(default_factory=lambda: np.zeros(5))
    cam_from_world: FloatArray = field(default_factory=lambda: np.eye(3, 4))

    def __post_init__(self) -> None:
        K = as_float_array(self.K, "K", (3, 3))
        pose = as_float_array(self.cam_from_world, "cam_from_world", (3, 4))
        coefficients = np.asarray(self.distortion, dtype=np.float64).ravel()
        if coefficients.size > 5 and np.any(coefficients[5:] != 0):
            raise CameraError(
                f"distortion: expected at most k1, k2, p1, p2, k3, got {coefficients.size} non-zero coefficients; "
                "calibrate with the five-coefficient model"
            )
        coefficients = np.pad(coefficients[:5], (0, max(0, 5 - coefficients.size)))
        if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
            raise CameraError(f"K: expected finite values and positive focal lengths, got {K.tolist()}; check the file")
        if K[1, 0] != 0 or not np.array_equal(K[2], [0.0, 0.0, 1.0]):
            raise CameraError(
                f"K: expected an upper triangle with last row (0, 0, 1), got {K.tolist()}; "
                "transpose it if it comes from a program that writes it by columns"
            )
        if not (np.isfinite(pose).all() and np.isfinite(coefficients).all()):
            raise CameraError(
                "camera: expected a finite pose and finite distortion, got NaN or infinity; check the file"
            )
        if min(self.image_size) <= 0:
            raise CameraError(
                f"image_size: expected width and height above 0 px, got {self.image_size}; check the file"
            )
        R = pose[:, :3]
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
            raise CameraError("cam_from_world: expected a rotation in its first three columns; orthonormalise it")
        for name, value in (("K", K), ("distortion", coefficients), ("cam_from_world", pose)):
            frozen = value.copy()
            frozen.flags.writeable = False
            object.__setattr__(self, name, frozen)
        object.__setattr__(self, "image_size", (int(self.image_size[0]), int(self.image_size[1])))

    @property
    def rotation(self) -> FloatArray:
        """Rotation R of ``cam_from_world``, shape (3, 3), from the world frame to the camera's axes [1]."""
        return self.cam_from_world[:, :3]

    @property
    def translation(self) -> FloatArray:
        """Translation t of ``cam_from_world`` in the camera's axes, shape (3,) [length unit of the rig]."""
        return self.cam_from_world[:, 3]

    @property
    def center(self) -> FloatArray:
        """Optical centre ``C = -R^T t`` in the world frame, shape (3,) [length unit of the rig]."""
        return -self.rotation.T @ self.translation

    @property
    def focal_px(self) -> float:
        """Geometric mean of fx and fy [px]."""
        return float(np.sqrt(self.K[0, 0] * self.K[1, 1]))

    def project(self, points3d: npt.ArrayLike) -> FloatArray:
        """Pixels of world points (Eq. 1).

        Parameters
        ----------
        points3d
            World frame, shape (..., 3) [length unit of the rig].

        Returns
        -------
        points2d
            Full-image pixels, shape (..., 2) [px]. NaN for points behind the camera, and for points so far off the axis
            that the distortion polynomial folds.

        Raises
        ------
        DatasetError
            The points have another shape.

        Examples
        --------
        >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
        >>> camera.project([[0.1, 0.0, 2.0], [0.0, 0.0, -2.0]]).tolist()
        [[370.0, 240.0], [nan, nan]]
        """
        X = as_float_array(points3d, "points3d", (-1, 3))
        in_camera = X @ self.rotation.T + self.translation
        depth = np.where(in_camera[..., 2:] > 0, in_camera[..., 2:], np.nan)
        normalized = in_camera[..., :2] / depth
        inside = (normalized**2).sum(axis=-1, keepdims=True) < squared_fold_radius(self.distortion)
        return self.pixels(distort(np.where(inside, normalized, np.nan), self.distortion))

    def pixels(self, distorted: FloatArray) -> FloatArray:
        """Pixels of normalised coordinates that hold the distortion already.

        Parameters
        ----------
        distorted
            Distorted coordinates (x/z, y/z) in the camera's axes, shape (..., 2) [1].

        Returns
        -------
        points2d
            Full-image pixels, shape (..., 2) [px].

        Examples
        --------
        >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
        >>> camera.pixels(np.array([0.05, 0.0])).tolist()
        [370.0, 240.0]
        """
        return distorted @ self.K[:2, :2].T + self.K[:2, 2]

    def normalize(self, points2d: npt.ArrayLike) -> FloatArray:
        """Undistorted normalised coordinates of pixels: the inverse of `project`, up to the depth.

        Parameters
        ----------
        points2d
            Full-image pixels, shape (..., 2) [px].

        Returns
        -------
        normalized
            Coordinates (x/z, y/z) in the camera's axes, shape (..., 2) [1]; NaN where the distortion has no inverse.

        Raises
        ------
        DatasetError
            The points have another shape.

        Examples
        --------
        >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
        >>> camera.normalize([370.0, 240.0]).round(4).tolist()
        [0.05, 0.0]
        """
        u = as_float_array(points2d, "points2d", (-1, 2))
        y = (u[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (u[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        return undistort(np.stack([x, y], axis=-1), self.distortion)

    def turn_to(self, other: "Camera") -> float:
        """Angle by which another camera is turned against this one [rad].

        Parameters
        ----------
        other
            A camera in the same frame.

        Examples
        --------
        >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
        >>> round(camera.turn_to(camera.perturbed([0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0])), 6)
        0.1
        """
        return float(Rotation.from_matrix(self.rotation @ other.rotation.T).magnitude())

    def perturbed(self, delta: npt.ArrayLike) -> "Camera":
        """The camera with its uncertain parameters changed by a small step.

        Parameters
        ----------
        delta
            Change of every one of `CAMERA_PARAMETERS`, in their order and units, shape (10,).

        Raises
        ------
        DatasetError
            The step has another shape.

        Examples
        --------
        >>> camera = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
        >>> longer = camera.perturbed([np.log(1.01), 0, 0, 0, 0, 0, 0, 0, 0, 0])
        >>> round(longer.focal_px, 6)
        1010.0
        """
        step = as_float_array(delta, "delta", (len(CAMERA_PARAMETERS),))
        K = self.K.copy()
        K[:2, :2] *= np.exp(step[0])
        K[:2, 2] += step[1:3]
        distortion = self.distortion.copy()
        distortion[0] += step[3]
        R = Rotation.from_rotvec(step[4:7]).as_matrix() @ self.rotation
        pose = np.column_stack([R, self.translation + step[7:10]])
        return replace(self, K=K, distortion=distortion, cam_from_world=pose)


@dataclass(frozen=True, eq=False)
class Rig:
    """Fixed cameras with known relative pose; the first view is the reference and defines the world frame.

    Parameters
    ----------
    names
        View names, in the order of ``cameras``.
    cameras
        At least one camera; ``cam_from_world`` of the first is the identity.
    metric
        Whether lengths are metres; otherwise they are known up to one common factor.
    covariance
        Covariance of all uncertain parameters of the V cameras, shape (10 V, 10 V), camera by camera in the order
        and units of `CAMERA_PARAMETERS`; ``None`` when nothing is known about it.

    Raises
    ------
    CameraError
        Names and cameras differ in number, names repeat, or the covariance has another shape.

    Examples
    --------
    >>> left = Camera(np.array([[1000.0, 0.0, 320.0], [0.0, 1000.0, 240.0], [0.0, 0.0, 1.0]]), (640, 480))
    >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    >>> rig = Rig(("left", "right"), (left, right))
    >>> rig.baseline()
    2.0
    >>> rig.scaled(3.0 / rig.baseline()).cameras[1].center.tolist()
    [3.0, 0.0, 0.0]
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    metric: bool = False
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if len(self.names) != len(self.cameras) or not self.cameras or len(set(self.names)) != len(self.names):
            raise CameraError(
                f"rig: expected one distinct name a camera, got names {list(self.names)} for {len(self.cameras)} "
                "cameras; name every view once"
            )
        if self.covariance is not None:
            size = len(CAMERA_PARAMETERS) * len(self.cameras)
            object.__setattr__(self, "covariance", as_float_array(self.covariance, "rig covariance", (size, size)))

    def __len__(self) -> int:
        return len(self.cameras)

    def camera(self, name: str) -> Camera:
        """The camera of the named view.

        Parameters
        ----------
        name
            Name of the view.

        Raises
        ------
        CameraError
            No view has this name.
        """
        if name not in self.names:
            raise CameraError(f"view {name!r}: expected one of {list(self.names)}; use a name of the session")
        return self.cameras[self.names.index(name)]

    def baseline(self, first: int = 0, second: int = 1) -> float:
        """Distance between the optical centres of two views [length unit of the rig].

        Parameters
        ----------
        first, second
            Positions of the views in ``names``.

        Examples
        --------
        >>> left = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
        >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
        >>> Rig(("left", "right"), (left, right)).baseline()
        2.0
        """
        return float(np.linalg.norm(self.cameras[first].center - self.cameras[second].center))

    def scaled(self, factor: float, *, metric: bool = True) -> "Rig":
        """The rig with all lengths multiplied by one factor.

        Parameters
        ----------
        factor
            Measured length over the same length in the rig [1]: s = B_true / B_est (paper, section Triangulation).
        metric
            Whether the lengths of the result are metres.

        Notes
        -----
        The covariance is scaled along: variances of translations by the square of the factor.

        Examples
        --------
        >>> left = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
        >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
        >>> rig = Rig(("left", "right"), (left, right))
        >>> rig.scaled(3.0 / rig.baseline()).baseline()
        3.0
        """
        cameras = tuple(
            replace(c, cam_from_world=np.column_stack([c.rotation, factor * c.translation])) for c in self.cameras
        )
        covariance = self.covariance
        if covariance is not None:
            gain = np.tile([1.0] * 7 + [factor] * 3, len(self))
            covariance = covariance * np.outer(gain, gain)
        return Rig(self.names, cameras, metric, covariance)

    def perturbed(self, delta: npt.ArrayLike) -> "Rig":
        """The rig with the uncertain parameters of all cameras changed by a small step.

        Parameters
        ----------
        delta
            Change of every one of `CAMERA_PARAMETERS`, camera by camera, in their order and units, shape (10 V,).

        Raises
        ------
        DatasetError
            The step has another shape.
        """
        size = len(CAMERA_PARAMETERS)
        steps = as_float_array(delta, "delta", (size * len(self),)).reshape(len(self), size)
        cameras = tuple(c.perturbed(step) for c, step in zip(self.cameras, steps, strict=True))
        return replace(self, cameras=cameras)

    @classmethod
    def from_world(cls, names: Sequence[str], cameras: Sequence[Camera], *, metric: bool) -> "Rig":
        """A rig from cameras in any common world frame, moved so that the first camera is the origin.

        Parameters
        ----------
        names
            View names, in the order of ``cameras``.
        cameras
            At least one camera.
        metric
            Whether lengths are metres.

        Raises
        ------
        CameraError
            Names and cameras differ in number, or names repeat.

        Notes
        -----
        ``R' = R R1^T`` and ``t' = t - R' t1``, with R1 and t1 of the first camera.

        Examples
        --------
        >>> left = Camera(np.diag([1000.0, 1000.0, 1.0]), (640, 480))
        >>> right = Camera(left.K, (640, 480), cam_from_world=np.array([[1.0, 0, 0, -2], [0, 1, 0, 0], [0, 0, 1, 0]]))
        >>> rig = Rig.from_world(["right", "left"], [right, left], metric=True)
        >>> rig.cameras[1].center.tolist()
        [-2.0, 0.0, 0.0]
        """
        first = cameras[0]
        moved = []
        for c in cameras:
            # Products of matrices leave a rig that begins at the origin as it is, to the last digit.
            R = c.rotation @ first.rotation.T
            moved.append(replace(c, cam_from_world=np.column_stack([R, c.translation - R @ first.translation])))
        return cls(tuple(names), tuple(moved), metric)
