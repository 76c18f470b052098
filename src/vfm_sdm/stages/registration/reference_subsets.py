"""Preparation of subsets of the reference image for registration: gradients, matrices, and the effect of noise."""

from collections.abc import Sequence
from concurrent.futures import Executor
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d, map_coordinates, spline_filter1d

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.registration.determined_warps import estimate_noise, invert_determined

__all__ = [
    "NEIGHBOURS",
    "SMOOTHING",
    "ReferenceSubsets",
    "interpolation_jumps",
    "interpolation_noise",
    "prepare_subsets",
]

SMOOTHING = np.array([1, -6, 15, 44, 15, -6, 1]) / 64
"""Low-pass of the steepest-descent images, 1 - sin^6(pi f): flat up to a quarter of the sampling frequency, zero at
half of it, where no interpolation is right."""

_DERIVATIVE = np.array([-1, -10, 0, 10, 1]) / 24  # of a quintic spline at the samples, from its coefficients
_VALUE = np.array([1, 26, 66, 26, 1]) / 120  # its value there
_FILTERS = len(_VALUE) // 2 + len(SMOOTHING) // 2  # pixels around a subset that the filters after the spline's need
_MARGIN = _FILTERS + 9  # the spline's coefficients settle over 9 pixels, to 0.43^9
NEIGHBOURS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
"""Correlations of the noise of neighbouring pixels for which the covariance of a designed subset is prepared."""
_NEXT_TO_NOTHING = 1e-9
"""Share of the noise that holds only what no texture at all determines."""
_BATCH = 32  # subsets prepared at one time; bounds the memory


class ReferenceSubsets(NamedTuple):
    """Arrays of P prepared subsets of one size; the kernel `register_subsets` reads the first six.

    Parameters
    ----------
    pixels
        Template less its mean, smoothed gradients along u and v, in [u, v] order, shape (P, 3, S S) [grey levels]; zero
        where a pixel is not believed.
    moments
        Squared norm of the template; sums of the six steepest-descent images; their products with the template; number
        of believed pixels; share of each shading in the template; shape (P, 14 + Q).
    matrices
        Inverse of the Gauss-Newton matrix M within the allowed warps, and the plain Hessian, shape (P, 2, 6, 6).
    grid
        Offsets (u, v) of a subset's pixels in [u, v] order, shape (2, S S) [px]; the same for all.
    believed
        1 for believed pixels, 0 for others, in [u, v] order, shape (P, S S); (0, S S) without designs.
    shading
        Surfaces of brightness that may come and go, orthonormal to each other and to a constant on the believed pixels,
        in [u, v] order, shape (P, Q, S S) [1]; zero where a subset has fewer than Q.
    usable
        Whether the texture fixes the position, shape (P,).
    unit_covariance
        Covariance of the position for noise of one grey level in all, shape (P, 2, 2) [px2].
    noise_share
        Part of the gradient matrix that noise of one grey level makes, shape (P, 2, 2) [1].
    smooth_covariance
        Covariance of the position for noise of one grey level of which neighbouring pixels have the correlations
        `NEIGHBOURS` in common, shape (P, G, 2, 2) [px2]; (P, 0, 2, 2) without designs.
    leakage
        Error of the position for each unit of a true warp, shape (P, 2, 6) [px, px per unit of the linear part]: what
        the allowed warps leave out, and those that the texture does not determine; zero where there are none.
    """

    pixels: npt.NDArray[np.float32]
    moments: FloatArray
    matrices: FloatArray
    grid: npt.NDArray[np.float32]
    believed: npt.NDArray[np.float32]
    shading: npt.NDArray[np.float32]
    usable: BoolArray
    unit_covariance: FloatArray
    noise_share: FloatArray
    smooth_covariance: FloatArray
    leakage: FloatArray


def prepare_subsets(
    reference: LumaArray,
    places: tuple[IntArray, FloatArray],
    half: int,
    *,
    designs: Sequence[SubsetDesign] | None = None,
    moderate: bool = True,
    executor: Executor | None = None,
) -> ReferenceSubsets:
    """Gradients and matrices of the subsets around pixels of the reference image.

    Parameters
    ----------
    reference
        Reference image, shape (H, W).
    places
        Centres, pixels at least ``half`` away from the border, and vectors from them to the named points, shape (P, 2)
        each [px].
    half
        Half the side of the subset, without its centre [px].
    designs
        Warp and mask of each of the P subsets, all of this size; affine and whole by default.
    moderate
        Whether rotation and strain are small, so that those that the texture does not determine may be held.
    executor
        Threads that share the work; without them, it runs in this thread.

    Notes
    -----
    With T the steepest-descent images of the affine warp (plain gradients) and S the smoothed ones, both orthogonal
    to a constant and to the template, a step is M^-1 S G / gain with M = S T'. Smoothing S costs next to nothing in
    precision (the weights of a least-squares estimate may be perturbed to first order) and takes away most of the
    bias that interpolation has near half the sampling frequency. That S is orthogonal to the template makes the step
    independent of gain and bias, the ZNSSD criterion, without normalising the current subset.

    With B the basis of the allowed warps (`SubsetDesign.basis`), M^-1 becomes B (B' M B)^-1 B': the least-squares step
    within them. A true warp p is then found as Q p with Q = B (B' M B)^-1 B' M, so that the position is wrong by
    J (Q - 1) p, where J takes the warp to the named point. For a translation and a rotation or strain this is the
    rotation or strain times the distance of the point from the middle of the texture. Pixels that are not believed
    have no part in any sum. Linear warps that the texture does not determine are held as those that are not allowed
    (`vfm_sdm.stages.registration.determined_warps.invert_determined`).

    References
    ----------
    .. [1] Baker, S., Matthews, I. (2004). Lucas-Kanade 20 years on: a unifying framework. International Journal of
       Computer Vision 56(3), 221-255.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    >>> prepared = prepare_subsets(image, (np.array([[40, 30]]), np.zeros((1, 2))), 10)
    >>> prepared.pixels.shape, prepared.usable.tolist()
    ((1, 3, 441), [True])
    """
    # Of all points together: a batch without shading has as many surfaces, of zeros.
    centers, offsets = places
    shading = _stack_shading(designs, len(centers), half)

    def prepare(start: int) -> tuple[npt.NDArray[Any], ...]:
        some = slice(start, start + _BATCH)
        chosen = None if designs is None else designs[some]
        return _prepare(reference, (centers[some], offsets[some]), half, chosen, shading[some], moderate)

    starts = range(0, max(len(centers), 1), _BATCH)
    parts = map(prepare, starts) if executor is None else executor.map(prepare, starts)
    pixels, moments, matrices, *others = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    masks = _believed(designs)
    grid = _offset_grid(half).astype(np.float32)
    believed = np.empty((0, grid.shape[1]), np.float32) if masks is None else masks.astype(np.float32)
    return ReferenceSubsets(pixels, moments, matrices, grid, believed, shading.astype(np.float32), *others)


def _believed(designs: Sequence[SubsetDesign] | None) -> BoolArray | None:
    """Masks of subsets of one size in [u, v] order, shape (P, S S); ``None`` without designs."""
    if not designs:
        return None
    side = (designs[0].subset_px, designs[0].subset_px)
    masks = [np.ones(side, np.bool_) if design.mask is None else design.mask for design in designs]
    return np.stack([mask.T.ravel() for mask in masks])


def _offset_grid(half: int) -> FloatArray:
    """Offsets (u, v) of a subset's pixels in [u, v] order, shape (2, S S) [px]."""
    steps = np.arange(-half, half + 1.0)
    return np.stack(np.meshgrid(steps, steps, indexing="ij")).reshape(2, -1)


@cache
def interpolation_noise() -> FloatArray:
    """Share of white noise's variance that interpolation along one axis keeps, at fractions 0, 1/32 ... 1 [1]."""
    return np.asarray((_interpolation_response() ** 2).sum(axis=0))


@cache
def interpolation_jumps() -> FloatArray:
    """Share of the squared difference of neighbours in white noise that interpolation keeps, as above [1]."""
    return np.asarray((np.diff(_interpolation_response(), axis=0) ** 2).sum(axis=0) / 2)


def _interpolation_response() -> FloatArray:
    """Interpolated values around a single bright pixel, at fractions 0, 1/32 ... 1 of a pixel, shape (48, 33)."""
    impulse = np.zeros(65)
    impulse[32] = 1
    positions = 8 + np.arange(48)[:, None] + np.arange(33) / 32
    return np.asarray(map_coordinates(impulse, [positions], order=5, mode="mirror"))


def _stack_shading(designs: Sequence[SubsetDesign] | None, points: int, half: int) -> FloatArray:
    """Surfaces of brightness of P subsets of one size in [u, v] order, shape (P, Q, S S); Q is 0 without designs."""
    most = max((design.shadings for design in designs or ()), default=0)
    if not designs or most == 0:
        return np.empty((points, 0, (2 * half + 1) ** 2))
    x, y = _offset_grid(half) / half
    found = []
    for design in designs:
        powers = [(i, total - i) for total in range(design.shading + 1) for i in range(total + 1)]
        believed = np.ones(x.size) if design.mask is None else design.mask.T.ravel().astype(np.float64)
        basis = np.linalg.qr(np.stack([believed * x**i * y**j for i, j in powers], axis=1))[0]
        found.append(np.pad(basis.T[1:], ((0, most - design.shadings), (0, 0))))
    return np.stack(found)


def _prepare(
    reference: LumaArray,
    places: tuple[IntArray, FloatArray],
    half: int,
    designs: Sequence[SubsetDesign] | None,
    shading: FloatArray,
    moderate: bool,
) -> tuple[npt.NDArray[Any], ...]:
    """The fields of `ReferenceSubsets` without grid and masks, for one batch of points."""
    centers, offsets = places
    windows = _cut_windows(reference, centers, half + _MARGIN)
    core = np.s_[:, _MARGIN:-_MARGIN, _MARGIN:-_MARGIN]
    points, side2 = len(centers), (2 * half + 1) ** 2
    gray = windows[core].reshape(points, side2)
    plain, smooth = ([g.reshape(points, side2) for g in kind] for kind in _compute_gradients(windows))
    count, believed = np.full(points, side2), _believed(designs)
    if believed is None:
        template = gray - gray.mean(axis=1, keepdims=True)
    else:
        count = believed.sum(axis=1)
        template = (gray - ((gray * believed).sum(axis=1) / count)[:, None]) * believed
        plain, smooth = ([g * believed for g in kind] for kind in (plain, smooth))
    shaded = (shading @ template[..., None])[..., 0]
    if shading.shape[1]:
        template = template - (shaded[:, None] @ shading)[:, 0]
    design = np.stack([np.ones(side2), *_offset_grid(half)])
    S, T = (_Images(kind, template, design, count, shading) for kind in (smooth, plain))
    M, hessian, scatter = _normal_matrix(S, T, design), _normal_matrix(T, T, design), _normal_matrix(S, S, design)

    bases = None if designs is None else [one.basis() for one in designs]
    noise = (1.0 if moderate else _NEXT_TO_NOTHING) * _noise_of_linear(windows[core], believed)
    inverse, usable = invert_determined(M, noise, bases)
    usable &= S.norm2 > 0
    J = np.zeros((points, 2, 6))
    J[:, 0, 0] = J[:, 1, 3] = 1
    J[:, 0, 1:3] = J[:, 1, 4:6] = offsets
    to_position = J @ inverse
    return (
        np.stack([template, *smooth], axis=1).astype(np.float32),
        np.column_stack([S.norm2, S.sums, S.on_template, count, shaded]),
        np.stack([inverse, hessian], axis=1),
        usable,
        to_position @ scatter @ to_position.swapaxes(1, 2),
        _compute_gradient_noise() * count[:, None, None] * inverse[:, ::3, ::3],
        np.empty((points, 0, 2, 2)) if believed is None else _spread_smooth_noise(S, believed, to_position),
        to_position @ M - J,
    )


def _noise_of_linear(gray: FloatArray, believed: BoolArray | None) -> FloatArray:
    """What the noise of subsets (P, S, S) alone gives their matrices for linear warps, shape (P, 4, 4).

    Offsets count from the middle of the believed pixels, shape (P, S S): translation is free.
    """
    design = np.stack([np.ones(gray[0].size), *_offset_grid(gray.shape[1] // 2)])
    squares = np.einsum("in,jn->nij", design, design).reshape(-1, 9)
    sums = np.tile(squares.sum(axis=0), (len(gray), 1)) if believed is None else believed @ squares
    sums = sums.reshape(-1, 3, 3)
    spread = sums[:, 1:, 1:] - sums[:, 1:, :1] * sums[:, :1, 1:] / sums[:, :1, :1]
    of_gradients = _compute_gradient_noise() * estimate_noise(gray)
    return np.asarray(np.einsum("p,ab,pij->paibj", of_gradients, np.eye(2), spread).reshape(-1, 4, 4))


def _cut_windows(reference: LumaArray, centers: IntArray, reach: int) -> FloatArray:
    """Windows [u, v] of the image around pixels, mirrored about its border, shape (P, R, R)."""
    steps = np.arange(-reach, reach + 1)
    indices = []
    for axis, size in enumerate(reference.shape[::-1]):
        period = max(2 * (size - 1), 1)
        folded = np.abs(centers[:, axis, None] + steps) % period
        indices.append(np.minimum(folded, period - folded))
    windows: FloatArray = reference[indices[1][:, None, :], indices[0][:, :, None]].astype(np.float64)
    return windows


def _compute_gradients(windows: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Derivatives along u and v of the quintic spline through the samples, at the samples: plain, and smoothed.

    From windows, shape (P, R, R), they give the inner part, shape (P, R - 2 margin, R - 2 margin): every filter drops
    the border that it leaves incomplete.
    """
    inner = _MARGIN - _FILTERS
    coefficients = spline_filter1d(windows, order=5, axis=1, mode="mirror")[:, inner:-inner]
    coefficients = spline_filter1d(coefficients, order=5, axis=2, mode="mirror")[:, :, inner:-inner]
    wide = [_apply_filter(coefficients, _DERIVATIVE, _VALUE), _apply_filter(coefficients, _VALUE, _DERIVATIVE)]
    border = len(SMOOTHING) // 2
    plain = [gradient[:, border:-border, border:-border] for gradient in wide]
    return plain, [_apply_filter(gradient, SMOOTHING, SMOOTHING) for gradient in wide]


def _apply_filter(images: FloatArray, along_u: FloatArray, along_v: FloatArray) -> FloatArray:
    """Images (P, R, R) correlated with one kernel along each axis, without the incomplete border."""
    border_u, border_v = len(along_u) // 2, len(along_v) // 2
    partly = correlate1d(images, along_u, axis=1)[:, border_u:-border_u]
    return np.asarray(correlate1d(partly, along_v, axis=2)[:, :, border_v:-border_v])


def _spread_smooth_noise(S: "_Images", believed: BoolArray, to_position: FloatArray) -> FloatArray:
    """Covariance of the position for noise whose correlation falls by a factor a pixel, (P, G, 2, 2) [px2].

    ``to_position`` takes the products of the images with a frame to the position, shape (P, 2, 6).
    """
    points, side = len(believed), int(np.sqrt(believed.shape[1]) + 0.5)
    design = np.stack([np.ones(believed.shape[1]), *_offset_grid(side // 2)])
    images = np.concatenate([g[:, None] * design for g in S.gradients], axis=1)
    norm2 = np.where(S.norm2 > 0, S.norm2, 1)[:, None, None]
    images = images - (S.sums / S.count[:, None])[..., None] * believed[:, None]
    images = images - S.on_template[..., None] * S.template[:, None] / norm2 - S.on_shading @ S.shading
    weights = (to_position @ images).reshape(points, 2, side, side)
    apart = np.abs(np.subtract.outer(np.arange(side), np.arange(side)))
    spread = []
    for correlation in NEIGHBOURS:
        decay = float(correlation) ** apart
        spread.append(np.einsum("piuv,pjuv->pij", weights, decay @ weights @ decay, optimize=True))
    return np.stack(spread, axis=1)


class _Images:
    """Steepest-descent images of one kind of gradient: the gradients times 1, u, v of the offset (``design``)."""

    def __init__(
        self,
        gradients: list[FloatArray],
        template: FloatArray,
        design: FloatArray,
        count: IntArray,
        shading: FloatArray,
    ) -> None:
        self.gradients, self.count, self.template, self.shading = gradients, count, template, shading
        self.norm2 = np.einsum("pn,pn->p", template, template)
        self.sums = np.concatenate([g @ design.T for g in gradients], axis=1)
        self.on_template = np.concatenate([(g * template) @ design.T for g in gradients], axis=1)
        # Shape (P, 6, Q).
        self.on_shading = np.concatenate([(shading * g[:, None]) @ design.T for g in gradients], axis=2).swapaxes(1, 2)


def _normal_matrix(first: _Images, second: _Images, design: FloatArray) -> FloatArray:
    """Products of the six images of both, less what each shares with a constant, template and shading, (P, 6, 6).

    ZNSSD sees neither gain nor bias, so those shares carry no information about the warp.
    """
    squares = np.einsum("in,jn->nij", design, design).reshape(design.shape[1], 9)
    blocks = np.array([[(a * b) @ squares for b in second.gradients] for a in first.gradients])
    product = blocks.reshape(2, 2, -1, 3, 3).transpose(2, 0, 3, 1, 4).reshape(-1, 6, 6)
    norm2 = np.where(first.norm2 > 0, first.norm2, 1)[:, None, None]
    constant = first.sums[:, :, None] * second.sums[:, None, :] / first.count[:, None, None]
    template = first.on_template[:, :, None] * second.on_template[:, None, :] / norm2
    # Without shading, there is nothing to subtract.
    return np.asarray(product - constant - template - first.on_shading @ second.on_shading.swapaxes(1, 2))


@cache
def _compute_gradient_noise() -> float:
    """Expected product of smoothed and plain gradient in white noise of one grey level [1]."""
    side = 2 * _MARGIN + 41
    impulse = np.zeros((1, side, side))
    impulse[0, side // 2, side // 2] = 1
    plain, smooth = _compute_gradients(impulse)
    return float((plain[0] * smooth[0]).sum())
