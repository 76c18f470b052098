"""Motion in space of points that views see across an edge only: weighted least squares with a weak prior."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import projection_jacobian
from vfm_sdm.geometry.triangulation import triangulate

__all__ = ["EdgeMotion", "EdgePoint"]

_STEPS = 3
"""Gauss-Newton steps; each leaves of the last error the motion over the distance: a thousandth for 20 mm at 20 m."""


@dataclass(frozen=True, eq=False)
class EdgeMotion:
    """Motion of a point about its position of reference.

    Parameters
    ----------
    motion
        Shape (T, 3) [length unit of the rig], in the frame of the first camera; NaN where no view sees the point.
    covariance
        Covariance of the noise of the pixels and of what the prior leaves open, shape (T, 3, 3).
    residual
        Root mean square, over the views, of the distance between seen and reprojected pixel in units of its standard
        deviation, times the smallest of these, shape (T,) [px].
    """

    motion: FloatArray
    covariance: FloatArray
    residual: FloatArray


@dataclass(frozen=True, eq=False)
class EdgePoint:
    """One point of which at least one view measures one direction only.

    Parameters
    ----------
    anchor
        Pixels of reference, shape (V, 2) [px]; NaN in views that never see the point. Motion is counted from there.
    information
        Inverse covariances of the pixels in all samples, shape (V, T, 2, 2) [1/px2]; zero where a view does not see
        the point.
    prior
        Information of the prior on the motion, shape (3, 3) [1 / squared length unit], in the first camera's frame; its
        mean is no motion.

    Notes
    -----
    With J the derivative of all pixels by the position at the triangulated anchor, z the pixels' motion from the
    anchor, W the information of the pixels and L that of the prior, the motion is ``(J' W J + L)^-1 J' W z``, and the
    inverse is its covariance. Where the anchors' rays do not meet, the difference is constant and no part of it. Along
    an edge W is next to zero, so that the view says nothing there: an edge whose image lies along the epipolar lines of
    two views gives the motion across them and leaves the depth to the prior.

    References
    ----------
    .. [1] Tarantola, A. (2005). Inverse Problem Theory. SIAM, section 3.2 (the linear Gaussian problem).
    """

    anchor: FloatArray
    information: FloatArray
    prior: FloatArray

    def place(self, rig: Rig) -> FloatArray:
        """Position of reference in the frame of the first camera, shape (3,) [length unit of the rig]; may be NaN."""
        place: FloatArray = triangulate(self.anchor[:, None], rig)[0]
        return place

    def solve(self, pixels: FloatArray, rig: Rig) -> EdgeMotion:
        """Motion in all samples.

        Parameters
        ----------
        pixels
            Shape (V, T, 2) [px]; NaN where a view does not see the point.
        rig
            V cameras.
        """
        place = self.place(rig)
        J = projection_jacobian(place[None], rig)[0]
        seen = np.isfinite(pixels).all(axis=-1) & np.isfinite(J).all(axis=(1, 2))[:, None]
        W, J = np.where(seen[..., None, None], self.information, 0.0), np.nan_to_num(J)
        at_rest = np.stack([camera.project(place) for camera in rig.cameras])
        moved = np.where(seen[..., None], pixels - self.anchor[:, None], 0.0)
        weighted = np.einsum("vki,vtkl->vtil", J, W)
        covariance = np.linalg.inv(np.einsum("vtil,vlj->tij", weighted, J) + self.prior)
        motion = np.zeros((pixels.shape[1], 3))
        for _ in range(_STEPS):
            expected = np.stack([camera.project(place + motion) for camera in rig.cameras]) - at_rest[:, None]
            left = np.where(seen[..., None], moved - expected, 0.0)
            right = np.einsum("vtil,vtl->ti", weighted, left) - motion @ self.prior
            motion = motion + np.einsum("tij,tj->ti", covariance, right)
        square = np.einsum("vti,vtij,vtj->vt", left, W, left)
        count, any_seen = np.maximum(seen.sum(axis=0), 1), seen.any(axis=0)
        best = 1 / np.sqrt(np.maximum(np.linalg.eigvalsh(W)[..., -1].max(axis=0), np.finfo(float).tiny))
        residual = np.where(any_seen, np.sqrt(square.sum(axis=0) / count) * best, np.nan)
        known = any_seen & np.isfinite(place).all()
        return EdgeMotion(
            np.where(known[:, None], motion, np.nan), np.where(known[:, None, None], covariance, np.nan), residual
        )

    def jacobian(self, anchor: FloatArray, rig: Rig) -> FloatArray:
        """Change of the motion with the pixels, with the mean information of all samples.

        Parameters
        ----------
        anchor
            Pixels of reference, shape (V, 2) [px]; NaN in a view that is left out.
        rig
            V cameras.

        Returns
        -------
        jacobian
            Shape (3, V, 2) [length unit of the rig per px].
        """
        place = triangulate(anchor[:, None], rig)[0]
        J = np.nan_to_num(projection_jacobian(place[None], rig)[0])
        seen = np.asarray(np.isfinite(anchor).all(axis=-1) & self.information.any(axis=(1, 2, 3)))
        frames = np.maximum(self.information.any(axis=(2, 3)).sum(axis=1), 1)
        W = np.where(seen[:, None, None], self.information.sum(axis=1) / frames[:, None, None], 0.0)
        weighted = np.einsum("vki,vkl->vil", J, W)
        covariance = np.linalg.inv(np.einsum("vil,vlj->ij", weighted, J) + self.prior)
        return np.asarray(np.einsum("ij,vjl->ivl", covariance, weighted))

    def open_axes(self, covariance: FloatArray, axes: FloatArray, largest_share: float) -> BoolArray:
        """Axes along which the pixels leave too much to the prior in half of the samples or more, shape (3,).

        Parameters
        ----------
        covariance
            Of `EdgeMotion`, shape (T, 3, 3).
        axes
            Rows are the axes in the first camera's frame, shape (3, 3) [1].
        largest_share
            Share of the prior's variance that may be left [1].
        """
        found = np.isfinite(covariance).all(axis=(1, 2))
        if not found.any():
            return np.ones(3, np.bool_)
        left = np.median(np.einsum("ai,tij,aj->ta", axes, covariance[found], axes), axis=0)
        before = np.einsum("ai,ij,aj->a", axes, np.linalg.inv(self.prior), axes)
        return np.asarray(left > largest_share * before)
