"""Covariance of a registration's position, from what the registration leaves of the subset."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.datasets import UNMEASURED_STD_PX
from vfm_sdm.stages.registration.designs import SubsetDesign, Warp
from vfm_sdm.stages.registration.determined_warps import LINEAR, LINEAR_STD
from vfm_sdm.stages.registration.reference_subsets import (
    NEIGHBOURS,
    ReferenceSubsets,
    interpolation_jumps,
    interpolation_noise,
)

__all__ = ["RIGID_PX", "SubsetNoise"]

RIGID_PX = 0.15
"""Largest displacement of a pixel by the warp's linear part that is left to the linearisation."""
_BRIGHTNESS = 2  # gain and bias: degrees of freedom that a registration takes beside those of the warp
_AFFINE = 6  # those of an affine warp
_ROUNDING_PX2 = 1e-12


@dataclass(frozen=True, eq=False)
class SubsetNoise:
    """What P subsets make of the noise of a pixel.

    Parameters
    ----------
    half
        Half the side of each subset, without its centre, shape (P,) [px].
    pixels
        Believed pixels, shape (P,).
    parameters
        Degrees of freedom that a registration takes, shape (P,).
    norm2
        Squared norm of the template, shape (P,) [squared grey levels].
    unit_covariance, noise_share, smooth_covariance
        As in `ReferenceSubsets`, shapes (P, 2, 2), (P, 2, 2) and (P, G, 2, 2).
    fixed
        Covariance of the position that no noise explains, shape (P, 2, 2) [px2]: along an edge, and from what the warp
        leaves out; ``None`` where there is none.
    """

    half: IntArray
    pixels: IntArray
    parameters: IntArray
    norm2: FloatArray
    unit_covariance: FloatArray
    noise_share: FloatArray
    smooth_covariance: FloatArray
    fixed: FloatArray | None

    @classmethod
    def of(
        cls,
        subset_px: IntArray,
        designs: Sequence[SubsetDesign | None] | None,
        prepared: Sequence[tuple[IntArray, ReferenceSubsets]],
    ) -> "SubsetNoise":
        """The noise of the subsets of a bank.

        Parameters
        ----------
        subset_px
            Side of each subset, shape (P,) [px].
        designs
            P designs; ``None`` where all subsets are whole squares with an affine warp.
        prepared
            The subsets of each size, with their rows among the P.
        """
        count = len(subset_px)
        pixels, parameters, norm2 = np.ones(count, np.int64), np.full(count, _AFFINE + _BRIGHTNESS), np.zeros(count)
        unit, share = np.full((count, 2, 2), np.nan), np.full((count, 2, 2), np.nan)
        smooth = np.full((count, 0 if designs is None else len(NEIGHBOURS), 2, 2), np.nan)
        for rows, subsets in prepared:
            pixels[rows], norm2[rows] = subsets.moments[:, 13].astype(np.int64), subsets.moments[:, 0]
            unit[rows], share[rows] = subsets.unit_covariance, subsets.noise_share
            smooth[rows] = subsets.smooth_covariance
        leakages = np.zeros((count, 2, 6))
        for rows, subsets in prepared:
            leakages[rows] = subsets.leakage
        fixed = np.zeros((count, 2, 2))
        for row, design in enumerate(designs or ()):
            if design is not None:
                parameters[row] = design.basis().shape[1] + _BRIGHTNESS + design.shadings
                fixed[row] = _compute_fixed_covariance(design, leakages[row])
        if designs is None:
            fixed = LINEAR_STD**2 * leakages[:, :, LINEAR] @ leakages[:, :, LINEAR].swapaxes(1, 2)
            # Where nothing is held, all that is left is rounding.
            if np.abs(fixed).max(initial=0.0) < _ROUNDING_PX2:
                return cls(subset_px // 2, pixels, parameters, norm2, unit, share, smooth, None)
        return cls(subset_px // 2, pixels, parameters, norm2, unit, share, smooth, fixed)

    def position_covariance(self, rows: IntArray, warps: FloatArray, outcome: FloatArray) -> FloatArray:
        """Covariance of positions, shape (K, 2, 2) [px2]; derived in `vfm_sdm.stages.tracking.icgn.IcgnTracker`.

        Parameters
        ----------
        rows
            Row of the subset of each registration, shape (K,).
        warps
            Position of the centre [px], then the affine map row by row [1], shape (K, 6).
        outcome
            Residual sum of squares [squared grey levels], gain of the brightness [1] and roughness of the residuals [1]
            (NaN where it was not measured), shape (K, 3).

        Notes
        -----
        What a codec or a shadow leaves in the residuals is smoother than noise: it spoils the gradients less, and does
        not average out over the subset. The roughness, the mean squared difference of neighbours over that of white
        noise (as interpolation leaves it), is one less the correlation of neighbours; noise of the gradients is that of
        white noise times it, and the covariance is that for noise whose correlation falls by the same factor from pixel
        to pixel. Where it was not measured, noise is white.
        """
        residual, gain, roughness = outcome.T
        A = warps[:, 2:].reshape(-1, 2, 2)
        table = interpolation_noise()
        fraction = warps[:, :2] - np.floor(warps[:, :2])
        kept = np.interp(fraction, np.linspace(0, 1, len(table)), table).prod(axis=1)
        bending = np.abs(A - np.eye(2)).sum(axis=2).max(axis=1) * self.half[rows]
        # A bent grid meets all fractions at once.
        kept = np.where(bending > RIGID_PX, table[:-1].mean() ** 2, kept)
        pixels = self.pixels[rows]
        contrast = self.norm2[rows] / pixels
        signal = np.ones(len(rows))  # share of the template's variance that is not noise; it draws the gain towards 0
        for _ in range(2):
            variance = residual / ((pixels - self.parameters[rows]) * (kept + gain**2 / signal))
            signal = np.maximum(1 - variance / np.where(contrast > 0, contrast, 1), 0.1)
        gain2 = (gain / signal) ** 2
        rough = np.where(np.isnan(roughness), 1.0, np.minimum(roughness / _white_roughness(fraction, kept, gain), 1.0))
        share = rough[:, None, None] * self.noise_share[rows]
        inflation = _invert_two_by_two(np.eye(2) - variance[:, None, None] * share)
        effective = variance * (1 + gain2) / gain2
        spread = A @ inflation
        unit = spread @ self._unit_covariance(rows, 1 - rough) @ spread.swapaxes(1, 2)
        covariance = effective[:, None, None] * unit
        return np.asarray(covariance if self.fixed is None else covariance + A @ self.fixed[rows] @ A.swapaxes(1, 2))

    def _unit_covariance(self, rows: IntArray, correlation: FloatArray) -> FloatArray:
        """Covariance for noise of one grey level whose neighbours are correlated, (K,) to (K, 2, 2) [px2]."""
        if self.smooth_covariance.shape[1] == 0:
            return self.unit_covariance[rows]
        place = np.interp(np.nan_to_num(correlation), NEIGHBOURS, np.arange(len(NEIGHBOURS)))
        low = np.minimum(place.astype(np.int64), len(NEIGHBOURS) - 2)
        part, of = (place - low)[:, None, None], self.smooth_covariance
        return np.asarray((1 - part) * of[rows, low] + part * of[rows, low + 1])


def _white_roughness(fraction: FloatArray, kept: FloatArray, gain: FloatArray) -> FloatArray:
    """Roughness that white noise in both frames has after interpolation at fractions (K, 2) of a pixel, shape (K,).

    ``kept`` is the share of the current frame's variance that interpolation keeps, shape (K,).
    """
    steps = np.linspace(0, 1, len(interpolation_noise()))
    of_value, of_jump = (np.interp(fraction, steps, table) for table in (interpolation_noise(), interpolation_jumps()))
    jumps = (of_jump[:, 0] * of_value[:, 1] + of_value[:, 0] * of_jump[:, 1]) / 2
    return np.asarray((jumps + gain**2) / (kept + gain**2))


def _compute_fixed_covariance(design: SubsetDesign, leakage: FloatArray) -> FloatArray:
    """Covariance of a position from what the warp leaves out, shape (2, 2) [px2], with its leakage (2, 6)."""
    linear = leakage[:, LINEAR]
    # An affine warp leaves out what the texture does not determine.
    omitted_std = max(design.omitted_std, LINEAR_STD) if design.warp == Warp.AFFINE else design.omitted_std
    covariance = omitted_std**2 * linear @ linear.T
    if design.across is not None:
        u, v = design.direction()
        along = np.array([-v, u])
        covariance = covariance + UNMEASURED_STD_PX**2 * np.outer(along, along)
    return np.asarray(covariance)


def _invert_two_by_two(matrices: FloatArray) -> FloatArray:
    """Inverses of 2 x 2 matrices (..., 2, 2) near the identity.

    They are NaN where the determinant is below 0.01: there nine tenths of the gradients are noise, without texture.
    """
    (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))
    determinant = a * d - b * c
    sound = (determinant > 0.01) & (a + d > 0.2)
    adjugate = np.moveaxis(np.array([[d, -b], [-c, a]]), (0, 1), (-2, -1))
    inverse: FloatArray = adjugate / np.where(sound, determinant, np.nan)[..., None, None]
    return inverse
