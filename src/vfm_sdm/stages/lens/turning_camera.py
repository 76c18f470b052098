"""A camera that turns about a fixed point before a still scene: what it sees, and the derivatives of that.

The optical centre lies beside the point of rotation by the lever ``l``, a vector that turns with the camera. A scene
point in direction d (unit vector) and at distance 1 / rho from the point of rotation is seen along

    y = R d - rho l - g e

in the camera's axes: a far scene or no lever leaves the rotation alone. Off the axis a picture is stretched, and what a
detector takes for the middle of a place moves with that: by g times its distance from the axis, which is what a shift
along the axis e does, too. Rows are exposed one after another: a row that
is read when the share s of the read-out time T has passed since the middle row sees the camera turned on by the
rotation vector T s w + (T s)^2 a / 2, with the rate of rotation w and its change a.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.geometry.distortion import distort, distort_derivative

__all__ = ["LENS", "LEVER", "LensClip", "Sightings", "TurningCamera"]

LENS = ("log_focal", "cx", "cy", "k1", "k2", "lever_x", "lever_y", "lever_z", "nearness", "readout")
"""The parameters that all frames share: ``log_focal`` [1]; ``cx, cy`` [px]; ``k1, k2`` [1]; the lever in the camera's
axes [m]; ``nearness``, the mean of 1 / distance over the scene [1/m]; ``readout``, from first row to last [s]."""
LEVER = slice(5, 8)
"""Where the lever stands in `LENS`."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Scene points seen in the frames of a clip, sorted by point.

    Parameters
    ----------
    frame, point
        Number of frame and point, shape (N,).
    pixel
        Shape (N, 2) [px].
    turn_rate
        Rate of rotation of each frame's middle row in the camera's axes, shape (F, 3) [rad/s].
    turn_change
        Change of that rate, shape (F, 3) [rad/s2].
    """

    frame: IntArray
    point: IntArray
    pixel: FloatArray
    turn_rate: FloatArray
    turn_change: FloatArray

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.turn_rate)

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class TurningCamera:
    """Lens, lever, attitudes and scene.

    Parameters
    ----------
    camera
        Intrinsics and distortion; its pose is the identity.
    shared
        Lever, nearness and read-out time, the last five of `LENS`, shape (5,).
    attitudes
        ``camera_from_scene`` of each frame, shape (F, 3, 3).
    directions
        Unit vectors to the scene points, shape (P, 3).
    nearness
        Deviation of each point's 1 / distance from the mean, shape (P,) [1/m].
    growth
        Each point's g, shape (P,) [1].
    """

    camera: Camera
    shared: FloatArray
    attitudes: FloatArray
    directions: FloatArray
    nearness: FloatArray
    growth: FloatArray

    @property
    def lens(self) -> FloatArray:
        """Values of `LENS`, shape (10,)."""
        K, coefficients = self.camera.K, self.camera.distortion
        return np.array([np.log(self.camera.focal_px), K[0, 2], K[1, 2], *coefficients[:2], *self.shared])

    def moved(self, lens: FloatArray, turns: FloatArray, points: FloatArray) -> "TurningCamera":
        """The same after a step of all parameters.

        Parameters
        ----------
        lens
            Step of `LENS`, shape (10,).
        turns
            Rotation vectors in the camera's axes, shape (F, 3) [rad].
        points
            Step of each point across its direction [rad] (along `tangents`), of its nearness [1/m] and growth [1],
            shape (P, 4).
        """
        camera = self.camera.perturbed([*lens[:4], *[0.0] * 6])
        distortion = camera.distortion.copy()
        distortion[1] += lens[4]
        directions = self.directions + np.einsum("pia,pa->pi", tangents(self.directions), points[:, :2])
        return TurningCamera(
            replace(camera, distortion=distortion),
            self.shared + lens[5:],
            Rotation.from_rotvec(turns).as_matrix() @ self.attitudes,
            directions / np.linalg.norm(directions, axis=1, keepdims=True),
            self.nearness + points[:, 2],
            self.growth + points[:, 3],
        )

    def mirrored(self) -> "TurningCamera":
        """The same picture of a scene on the other side: lever and nearness with the other sign."""
        shared = self.shared * np.array([-1.0, -1.0, -1.0, -1.0, 1.0])
        return replace(self, shared=shared, nearness=-self.nearness)

    def residuals(self, seen: Sightings) -> FloatArray:
        """Seen minus predicted pixels, shape (N, 2) [px]."""
        return seen.pixel - self._project(self._rays(seen)[0])

    def _rays(self, seen: Sightings) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rays y (N, 3), turned directions (N, 3), and the turn since the middle row per second of read-out (N, 3)."""
        height, readout = self.camera.image_size[1], self.shared[4]
        share = ((seen.pixel[:, 1] - (height - 1) / 2) / height)[:, None]
        rate, change = seen.turn_rate[seen.frame], seen.turn_change[seen.frame]
        turn = readout * share * (rate + readout * share / 2 * change)
        turned = np.einsum("nij,nj->ni", self.attitudes[seen.frame], self.directions[seen.point])
        onward = np.cross(turn, turned)
        # The turn within one frame is some milliradians: its cube moves no pixel by a thousandth.
        turned = turned + onward + np.cross(turn, onward) / 2
        by_readout = share * (rate + readout * share * change)
        rays = turned - self._closeness(seen)[:, None] * self.lever
        rays[:, 2] -= self.growth[seen.point]
        return rays, turned, by_readout

    def _closeness(self, seen: Sightings) -> FloatArray:
        return np.asarray(self.shared[3] + self.nearness[seen.point])

    def _project(self, rays: FloatArray) -> FloatArray:
        return np.asarray(self.camera.pixels(distort(rays[:, :2] / rays[:, 2:], self.camera.distortion)))

    @property
    def lever(self) -> FloatArray:
        """From the point of rotation to the optical centre, in the camera's axes, shape (3,) [m]."""
        return self.shared[:3]

    def tangents_seen(self, seen: Sightings) -> FloatArray:
        """`tangents` of each sighting's point in the camera's axes, shape (N, 3, 2)."""
        across = tangents(self.directions)[seen.point]
        return np.asarray(np.einsum("nij,nja->nia", self.attitudes[seen.frame], across))

    def derivative_by_ray(self, seen: Sightings) -> FloatArray:
        """Derivative of the predicted pixels by the ray y, shape (N, 2, 3) [px]."""
        return self._by_ray(self._rays(seen)[0])

    def _by_ray(self, rays: FloatArray) -> FloatArray:
        slope = rays[:, :2] / rays[:, 2:]
        by_slope = self.camera.K[:2, :2] @ distort_derivative(slope, self.camera.distortion)
        return np.concatenate([by_slope, -by_slope @ slope[:, :, None]], axis=2) / rays[:, 2][:, None, None]

    def derivatives(self, seen: Sightings) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives of the predicted pixels.

        Returns
        -------
        by_lens, by_turn, by_point
            By `LENS`, shape (N, 2, 10); by the rotation vector of the sighting's frame, (N, 2, 3); by the step of its
            point as in `moved`, (N, 2, 4).
        """
        rays, turned, turn = self._rays(seen)
        slope = rays[:, :2] / rays[:, 2:]
        radius2 = (slope**2).sum(axis=1, keepdims=True)
        scale = self.camera.K[:2, :2]
        by_ray = self._by_ray(rays)
        closeness, lever = self._closeness(seen), self.lever
        radial = np.stack([slope * radius2, slope * radius2**2], axis=2)
        by_lens = np.concatenate(
            [
                (distort(slope, self.camera.distortion) @ scale.T)[:, :, None],
                np.broadcast_to(np.eye(2), (len(seen), 2, 2)),
                scale @ radial,
                -closeness[:, None, None] * by_ray,
                -(by_ray @ lever)[:, :, None],
                (by_ray @ np.cross(turn, turned)[:, :, None]),
            ],
            axis=2,
        )
        across = by_ray @ self.tangents_seen(seen)
        by_point = np.concatenate([across, -(by_ray @ lever)[:, :, None], -by_ray[:, :, 2:]], axis=2)
        return by_lens, -by_ray @ _cross_matrices(turned), by_point


@dataclass(frozen=True, eq=False)
class LensClip:
    """What a clip shows, and what is known of its camera and scene before.

    Parameters
    ----------
    seen
        The sightings.
    prior
        Mean of `LENS` and standard deviations in their units, two arrays of shape (10,); zero holds a value.
    nearness_std
        Standard deviation of single points' 1 / distance about the mean [1/m].
    growth_std
        Standard deviation of their growth [1].
    """

    seen: Sightings
    prior: tuple[FloatArray, FloatArray]
    nearness_std: float
    growth_std: float = 1e-4


def tangents(directions: FloatArray) -> FloatArray:
    """Two unit vectors across each direction, shape (P, 3, 2).

    Parameters
    ----------
    directions
        Unit vectors, shape (P, 3).
    """
    aside = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=2)


def _cross_matrices(vectors: FloatArray) -> FloatArray:
    """Matrices [v]x with ``[v]x w = v x w``, shape (N, 3, 3)."""
    return np.asarray(np.cross(vectors[:, None, :], np.eye(3)[None]).swapaxes(1, 2))
