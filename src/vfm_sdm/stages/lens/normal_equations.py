"""Normal equations of a turning camera, with the scene points eliminated."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.errors import CameraError
from vfm_sdm.stages.lens.nearness import PointSums, PointsVolume
from vfm_sdm.stages.lens.turning_camera import LENS, LEVER, LensClip, TurningCamera

__all__ = ["NormalEquations", "invert_scaled", "solve_scaled"]

_LENS = len(LENS)


class NormalEquations:
    """Normal equations at a camera: of `LENS` and all turns, C values; P points are eliminated (Schur complement).

    Parameters
    ----------
    camera
        Where they are taken.
    clip
        Sightings and priors.
    weights
        Weight of each sighting, shape (N,) [1/px2].
    damping
        Share by which the diagonal is raised, after Levenberg and Marquardt [1].
    volume
        What the points' distances take from the likelihood; left out of consideration where there is none.

    Notes
    -----
    A sighting knows one frame and one point, so that a frame's block and its coupling to a point are sums over few
    sightings. Values that are held, and the first attitude, from which the directions of the scene are counted, have a
    row of the identity.
    """

    def __init__(
        self,
        camera: TurningCamera,
        clip: LensClip,
        weights: FloatArray,
        *,
        damping: float = 0.0,
        volume: PointsVolume | None = None,
    ) -> None:
        self._camera, self._clip, self._volume = camera, clip, volume
        self._lever = None if volume is None else volume.lever_precision(camera)
        self.weights = weights
        seen = clip.seen
        self.by_lens, self.by_turn, self.by_point = camera.derivatives(seen)
        self._sums = PointSums(seen.point)
        self._held = np.r_[np.flatnonzero(clip.prior[1] == 0), _LENS : _LENS + 3]
        self._size = _LENS + 3 * seen.frames
        full = self._shared_block()
        self._coupling = self._couple()
        points = self._sums(self._heavy(self.by_point) @ self.by_point)
        points[:, 2, 2] += 1 / clip.nearness_std**2
        points[:, 3, 3] += 1 / clip.growth_std**2
        full[np.diag_indices(self._size)] *= 1 + damping
        points[:, range(4), range(4)] *= 1 + damping
        self._points = np.linalg.inv(points)
        carried = self._coupling @ self._points
        self.reduced = full - np.tensordot(carried, self._coupling, axes=([0, 2], [0, 2]))
        self._carried = carried

    def step(self) -> TurningCamera:
        """The camera that the equations lead to."""
        camera, clip = self._camera, self._clip
        shared, points = self._gradient(camera.residuals(clip.seen))
        mean, std = clip.prior
        free = std > 0
        shared[:_LENS][free] += (mean - camera.lens)[free] / std[free] ** 2
        if self._volume is not None:
            shared[LEVER] -= self._volume.lever_precision(camera) @ camera.lever
            shared[:_LENS] -= self._volume.slope
        shared[self._held] = 0.0
        points[:, 2] -= camera.nearness / clip.nearness_std**2
        points[:, 3] -= camera.growth / clip.growth_std**2
        return self._moved(*self._solve(shared, points))

    def along(self, shared: FloatArray) -> TurningCamera:
        """The camera after a step of its shared values, shape (C,), with the points where it takes them."""
        return self._moved(shared, -np.einsum("pab,pcb,c->pa", self._points, self._coupling, shared))

    def unexplained(self, values: FloatArray) -> FloatArray:
        """What no step of any value explains of a change of all pixels, shape (N, 2) [px].

        Parameters
        ----------
        values
            Change of each sighting, shape (N, 2) [px].
        """
        shared, points = self._gradient(values)
        shared[self._held] = 0.0
        lens, points = self._solve(shared, points)
        seen = self._clip.seen
        turns = lens[_LENS:].reshape(-1, 3)[seen.frame]
        explained = self.by_lens @ lens[:_LENS]
        explained += (self.by_turn @ turns[:, :, None])[:, :, 0]
        return np.asarray(values - explained - (self.by_point @ points[seen.point][:, :, None])[:, :, 0])

    def _solve(self, shared: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steps of the shared values (C,) and of the points (P, 4) from the gradients."""
        step = solve_scaled(self.reduced, shared - np.einsum("pca,pa->c", self._carried, points))
        back = points - np.einsum("pca,c->pa", self._coupling, step)
        return step, np.einsum("pab,pb->pa", self._points, back)

    def _moved(self, shared: FloatArray, points: FloatArray) -> TurningCamera:
        return self._camera.moved(shared[:_LENS], shared[_LENS:].reshape(-1, 3), points)

    def _heavy(self, derivative: FloatArray) -> FloatArray:
        """Weighted and transposed, shape (N, K, 2)."""
        return np.asarray((derivative * self.weights[:, None, None]).swapaxes(1, 2))

    def _gradient(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums of derivatives times ``values`` (N, 2) over the shared values (C,) and the points (P, 4)."""
        seen, column = self._clip.seen, values[:, :, None]
        shared = np.zeros(self._size)
        shared[:_LENS] = (self._heavy(self.by_lens) @ column)[:, :, 0].sum(axis=0)
        turns = np.zeros((seen.frames, 3))
        np.add.at(turns, seen.frame, (self._heavy(self.by_turn) @ column)[:, :, 0])
        shared[_LENS:] = turns.ravel()
        return shared, self._sums((self._heavy(self.by_point) @ column)[:, :, 0])

    def _shared_block(self) -> FloatArray:
        """Of `LENS` and the turns, with their priors, shape (C, C)."""
        seen = self._clip.seen
        full = np.zeros((self._size, self._size))
        heavy = self._heavy(self.by_lens)
        full[:_LENS, :_LENS] = (heavy @ self.by_lens).sum(axis=0)
        own, cross = np.zeros((seen.frames, 3, 3)), np.zeros((seen.frames, _LENS, 3))
        np.add.at(own, seen.frame, self._heavy(self.by_turn) @ self.by_turn)
        np.add.at(cross, seen.frame, heavy @ self.by_turn)
        for frame in range(seen.frames):
            columns = slice(_LENS + 3 * frame, _LENS + 3 * frame + 3)
            full[columns, columns] = own[frame]
            full[:_LENS, columns] = cross[frame]
            full[columns, :_LENS] = cross[frame].T
        std = self._clip.prior[1]
        free = np.flatnonzero(std > 0)
        full[free, free] += 1 / std[free] ** 2
        if self._lever is not None:
            full[LEVER, LEVER] += self._lever
        full[self._held, :] = full[:, self._held] = 0.0
        full[self._held, self._held] = 1.0
        return full

    def _couple(self) -> FloatArray:
        """Of the shared values with each point, shape (P, C, 4)."""
        seen = self._clip.seen
        coupling = np.zeros((int(seen.point[-1]) + 1, self._size, 4))
        coupling[:, :_LENS] = self._sums(self._heavy(self.by_lens) @ self.by_point)
        turns = coupling[:, _LENS:].reshape(len(coupling), seen.frames, 3, 4)
        np.add.at(turns, (seen.point, seen.frame), self._heavy(self.by_turn) @ self.by_point)
        coupling[:, self._held] = 0.0
        return coupling


def solve_scaled(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a symmetric system whose values have units of different size, shape (C,) or (C, K).

    Parameters
    ----------
    matrix, right
        Shapes (C, C) and (C,) or (C, K).

    Raises
    ------
    CameraError
        The matrix is not positive definite.

    Examples
    --------
    >>> solve_scaled(np.diag([4.0, 1e-12]), np.array([2.0, 1e-12])).tolist()
    [0.5, 1.0]
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    try:
        factor = cho_factor(matrix * scale[:, None] * scale)
    except np.linalg.LinAlgError as error:
        raise CameraError(
            "pan clip: expected sightings that determine all turns, got a singular adjustment; pan, tilt and roll more"
        ) from error
    return np.asarray((cho_solve(factor, (right.T * scale).T).T * scale).T)


def invert_scaled(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric matrix whose values have units of different size, shape (C, C).

    Parameters
    ----------
    matrix
        Shape (C, C).

    Raises
    ------
    CameraError
        The matrix is not positive definite.
    """
    return solve_scaled(matrix, np.eye(len(matrix)))
