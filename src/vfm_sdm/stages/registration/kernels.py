"""Compiled inner loops of the subset registration: quintic B-spline sampling and Gauss-Newton on the affine warp.

Arrays are indexed ``[u, v]`` here (first axis to the right), the order of pixel positions; only ``image`` keeps the
usual ``[v, u]``. The kernels release the interpreter lock, so that threads share the points (see `subsets`). They
are not compiled with numba's own thread pool: it must not be entered from two threads at once on every platform,
which would end the process when two views are tracked side by side.
"""

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.compiled import cached_by_code
from vfm_sdm.stages.registration.sampling import (
    AFTER,
    BEFORE,
    DECAY_PX,
    TAPS,
    apply_mask,
    compiled,
    correlate,
    load_coefficients,
    padded,
    remove_shading,
    sample_shifted,
    sample_warped,
    set_weights,
)

__all__ = ["CONVERGED", "FAILED", "OUTSIDE", "correlate_on_grid", "register_subsets"]

CONVERGED, FAILED, OUTSIDE = 0, 1, 2
"""Outcome codes of one registration."""

_DRIFT_PX = 1  # motion after which a loaded region still serves
_REGION_FACTOR = 2  # largest stretch of a subset by the warp; beyond it the registration has diverged
_FAR = 1e7

Single = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Picture = tuple[LumaArray, int]
Bank = tuple[Single, FloatArray, FloatArray, Single, Single, Single]
Work = tuple[Integers, FloatArray, FloatArray]
# Plain tuples, because numba's cache on disk cannot be read any more once a class named in a signature is renamed.


@compiled
def _solve_step(
    sums: FloatArray, count: int, moments: FloatArray, matrices: FloatArray, step: FloatArray, measure: FloatArray
) -> bool:
    """Gauss-Newton step of one subset from its sums; False when the patch does not resemble the template.

    ``measure`` receives the correlation (ZNCC), the residual sum of squares and the gain after the step.
    """
    norm2 = moments[0]
    energy = sums[1] - sums[0] * sums[0] / count
    gain = sums[2] / norm2
    if not (energy > 0.0 and gain > 0.0):
        return False
    inverse, hessian = matrices[0], matrices[1]
    for i in range(6):
        step[i] = 0.0
        for j in range(6):
            product = sums[3 + j] - moments[1 + j] * sums[0] / count - moments[7 + j] * gain
            step[i] += inverse[i, j] * product
    explained = 0.0
    for i in range(6):
        for j in range(6):
            explained += step[i] * hessian[i, j] * step[j]
    residual = max(energy - gain * gain * norm2 - explained, 0.0)
    measure[0] = gain * np.sqrt(norm2 / (gain * gain * norm2 + residual))
    measure[1], measure[2] = residual, gain
    for i in range(6):
        step[i] /= gain
    return True


@compiled
def _correlate_whole(moments: FloatArray, measure: FloatArray, shares: FloatArray) -> float:
    """Correlation (ZNCC) of a subset with its template, shading included, from ``measure`` without it."""
    if shares.size == 0:
        return float(measure[0])
    norm2, gain = moments[0], measure[2]
    product, squares, energy = gain * norm2, norm2, gain * gain * norm2 + measure[1]
    for q in range(shares.size):
        product += moments[14 + q] * shares[q]
        squares += moments[14 + q] * moments[14 + q]
        energy += shares[q] * shares[q]
    return float(product / np.sqrt(squares * energy))


@compiled
def _measure_roughness(
    values: Single, template: Single, believed: Single, row: int, sums: FloatArray, gain: float
) -> float:
    """Mean squared difference of neighbours over twice the mean square, of what the template leaves unexplained.

    It is 1 for white noise, near 0 for what is smooth, and NaN without masks. ``sums`` are those of `correlate`.
    """
    if believed.shape[0] == 0:
        return np.nan
    mask, size = believed[row], int(np.sqrt(values.size) + 0.5)
    total, squares, pairs, jumps = 0.0, 0.0, 0.0, 0.0
    for i in range(values.size):
        total += mask[i]
    mean = sums[0] / total
    for i in range(values.size):
        if mask[i] > 0:
            left = values[i] - mean - gain * template[i]
            squares += left * left
            if (i + 1) % size > 0 and mask[i + 1] > 0:
                jump = values[i + 1] - mean - gain * template[i + 1] - left
                jumps += jump * jump
                pairs += 1
            if i + size < values.size and mask[i + size] > 0:
                jump = values[i + size] - mean - gain * template[i + size] - left
                jumps += jump * jump
                pairs += 1
    return jumps * total / (2 * pairs * squares)


@compiled
def _compose_inverse(warp: FloatArray, step: FloatArray, out: FloatArray) -> bool:
    """Warp after the inverse-compositional update: warp o (identity + step)^-1, all as (t_u, t_v, A row by row)."""
    p, q, r, s = 1.0 + step[1], step[2], step[4], 1.0 + step[5]
    determinant = p * s - q * r
    if not determinant > 0.1:
        return False
    i11, i12, i21, i22 = s / determinant, -q / determinant, -r / determinant, p / determinant
    tu, tv = -(i11 * step[0] + i12 * step[3]), -(i21 * step[0] + i22 * step[3])
    a, b, c, d = warp[2], warp[3], warp[4], warp[5]
    out[0], out[1] = warp[0] + a * tu + b * tv, warp[1] + c * tu + d * tv
    out[2], out[3] = a * i11 + b * i21, a * i12 + b * i22
    out[4], out[5] = c * i11 + d * i21, c * i12 + d * i22
    return True


@compiled
def _reach(warp: FloatArray, half: int) -> tuple[float, float]:
    """Half-width of the warped subset's bounding box along u and v."""
    return half * (abs(warp[2]) + abs(warp[3])), half * (abs(warp[4]) + abs(warp[5]))


@compiled
def _is_place(warp: FloatArray) -> bool:
    """Whether the position is a number of sensible size (a comparison: reordered sums may deceive ``isfinite``)."""
    return bool(abs(warp[0]) < _FAR and abs(warp[1]) < _FAR)


@compiled
def _deviation(warp: FloatArray, half: int) -> float:
    """Largest displacement [px] along an axis that the warp's linear part gives a pixel of the subset."""
    along_u = abs(warp[2] - 1.0) + abs(warp[3])
    along_v = abs(warp[4]) + abs(warp[5] - 1.0)
    return float(half * max(along_u, along_v))


@compiled
def _covers(box: Integers, warp: FloatArray, half: int) -> bool:
    """Whether ``box`` (left, top, width, height) holds all that sampling the warped subset needs; else moves it."""
    reach_u, reach_v = _reach(warp, half)
    left, right = int(np.floor(warp[0] - reach_u)) - BEFORE, int(np.floor(warp[0] + reach_u)) + AFTER
    top, bottom = int(np.floor(warp[1] - reach_v)) - BEFORE, int(np.floor(warp[1] + reach_v)) + AFTER
    margin_right, margin_bottom = box[0] + box[2] - DECAY_PX, box[1] + box[3] - DECAY_PX
    if left - box[0] >= DECAY_PX and right < margin_right and top - box[1] >= DECAY_PX and bottom < margin_bottom:
        return True
    margin = DECAY_PX + _DRIFT_PX
    box[0], box[2] = left - margin, padded(right - left + 1 + 2 * margin)
    box[1], box[3] = top - margin, padded(bottom - top + 1 + 2 * margin)
    return False


@compiled
def _inside(warp: FloatArray, half: int, columns: int, rows: int) -> bool:
    """Whether every sample of the warped subset lies within the image."""
    reach_u, reach_v = _reach(warp, half)
    low, high = min(warp[0] - reach_u, warp[1] - reach_v), max(warp[0] + reach_u - columns, warp[1] + reach_v - rows)
    return bool(low >= 0.0 and high <= -1.0)


@compiled
def _moved2(step: FloatArray, half: int) -> float:
    """Mean square by which a step moves the pixels of a subset of half width ``half`` [px2]."""
    turned = step[1] * step[1] + step[2] * step[2] + step[4] * step[4] + step[5] * step[5]
    return float(step[0] * step[0] + step[3] * step[3] + half * half / 3.0 * turned)


@compiled
@cached_by_code
def register_subsets(
    picture: Picture, bank: Bank, work: Work, settings: tuple[int, float, float], share: tuple[int, int]
) -> None:
    """Registers some of the subsets by inverse-compositional Gauss-Newton.

    Parameters
    ----------
    picture
        Current image [v, u], shape (H, W), uint8 or uint16, whose lines may be padded; and the width of the picture in
        it [px].
    bank
        Tuple of the reference (see `ReferenceSubsets`): pixels (P, 3, S S) float32, moments (P, 14 + Q), matrices
        (P, 2, 6, 6), offsets (2, S S) float32, masks (P or 0, S S) and shading (P, Q, S S) float32.
    work
        Row of the bank of each registration, shape (K,). Starts, which the results replace: t_u, t_v [px], then A row
        by row [1], shape (K, 6). Outcomes to fill in: code, iterations, ZNCC, residual sum of squares, gain and, for
        subsets with masks, the roughness of the residuals, shape (K, 6).
    settings
        Largest number of iterations, tolerance (distance from the minimum) [px], and the deviation [px] of A from the
        identity up to which the grid of a pure translation is sampled.
    share
        First registration, and the one after the last.
    """
    (image, columns), (rows, warps, outcome) = picture, work
    pixels, moments, matrices, offsets, believed, shading = bank
    max_iterations, tolerance, rigid_px = settings
    count = pixels.shape[2]
    size = int(np.sqrt(count) + 0.5)
    half = size // 2
    limit = padded(_REGION_FACTOR * size + 2 * (DECAY_PX + _DRIFT_PX + TAPS))
    region, coefficients = np.empty((limit, limit), np.float32), np.empty((limit, limit), np.float32)
    line, sampled = np.empty(size + TAPS, np.float32), np.empty(count, np.float32)
    weights = np.empty((2, TAPS), np.float32)
    box, grid = np.empty(4, np.int64), np.empty(6)
    sums, step, measure, shares = np.empty(9), np.empty(6), np.empty(3), np.empty(shading.shape[1])
    for k in range(share[0], share[1]):
        row, warp = rows[k], warps[k]
        box[2], before = 0, 1e-12
        outcome[k, 0], outcome[k, 1], outcome[k, 2] = FAILED, max_iterations, np.nan
        for iteration in range(max_iterations):
            for i in range(6):  # an array assignment would double the time of compilation
                grid[i] = warp[i]
            rigid = _deviation(warp, half) <= rigid_px
            if rigid:
                grid[2], grid[3], grid[4], grid[5] = 1.0, 0.0, 0.0, 1.0
            if not _inside(grid, half, columns, image.shape[0]):
                outcome[k, 0] = OUTSIDE if _is_place(grid) else FAILED
                break
            if not _covers(box, grid, half):
                if max(box[2], box[3]) > limit:
                    break
                load_coefficients(image, columns, box, region, coefficients)
            if rigid:
                u0, v0 = int(np.floor(grid[0])), int(np.floor(grid[1]))
                set_weights(np.float32(grid[0] - u0), weights[0])
                set_weights(np.float32(grid[1] - v0), weights[1])
                sample_shifted(coefficients, size, (u0 - half - box[0], v0 - half - box[1]), weights, line, sampled)
            else:
                sample_warped(coefficients, size, (box[0], box[1]), grid, weights, sampled)
            apply_mask(believed, row, sampled)
            remove_shading(shading[row], sampled, shares)
            correlate(sampled, pixels[row], offsets, sums)
            if not (
                _solve_step(sums, int(moments[row, 13]), moments[row], matrices[row], step, measure)
                and _compose_inverse(grid, step, warp)
            ):
                break
            outcome[k, 1], outcome[k, 2] = iteration + 1, _correlate_whole(moments[row], measure, shares)
            outcome[k, 3], outcome[k, 4] = measure[1], measure[2]
            moved = _moved2(step, 0 if rigid else half)
            # Steps shrink by a steady factor, so what is left to go is a geometric series.
            factor = min(np.sqrt(moved / before), 0.9)
            before = moved
            if np.sqrt(moved) * factor < tolerance * (1.0 - factor):
                outcome[k, 0] = CONVERGED
                outcome[k, 5] = _measure_roughness(sampled, pixels[row, 0], believed, row, sums, measure[2])
                break


@compiled
def _score_shift(
    coefficients: Single,
    size: int,
    center: tuple[float, float],
    subset: tuple[Single, FloatArray, Single, Single, Single, int],
    buffers: tuple[Single, Single, Single, FloatArray, FloatArray],
    measure: FloatArray,
) -> float:
    """ZNCC of a subset with the image shifted to a centre; ``measure`` gets it, the residual and the gain.

    The centre is counted in ``coefficients``. ``subset`` are its pixels and moments, the pixels' offsets, the masks
    and shadings, and its row in them; ``buffers`` are room for a line, the samples, the spline weights, the sums and
    the shares of the shadings.
    """
    (pixels, moments, offsets, believed, shading, row), (line, sampled, weights, sums, shares) = subset, buffers
    half = size // 2
    u0, v0 = int(np.floor(center[0])), int(np.floor(center[1]))
    set_weights(np.float32(center[0] - u0), weights[0])
    set_weights(np.float32(center[1] - v0), weights[1])
    sample_shifted(coefficients, size, (u0 - half, v0 - half), weights, line, sampled)
    apply_mask(believed, row, sampled)
    remove_shading(shading[row], sampled, shares)
    correlate(sampled, pixels, offsets, sums)
    norm2 = moments[0]
    energy = sums[1] - sums[0] * sums[0] / int(moments[13])
    measure[2] = sums[2] / norm2
    measure[1] = max(energy - measure[2] * sums[2], 0.0)
    measure[0] = sums[2] / np.sqrt(norm2 * energy) if energy > 0.0 else -1.0
    return float(measure[0])


@compiled
@cached_by_code
def correlate_on_grid(picture: Picture, bank: Bank, work: Work, divisions: int, share: tuple[int, int]) -> None:
    """Moves subsets to the highest ZNCC on a grid of 1 / ``divisions`` px within one pixel of their start.

    The arguments are those of `register_subsets`. Of the starts, shape (K, 6), only the position is read and moved,
    from the nearest pixel. The search halves its step from half a pixel down to one division and climbs at every step.
    """
    (image, columns), (rows, warps, outcome) = picture, work
    pixels, moments, _, offsets, believed, shading = bank
    count = pixels.shape[2]
    size = int(np.sqrt(count) + 0.5)
    reach = size // 2 + 1 + AFTER + DECAY_PX
    side = padded(2 * reach + 1)
    region, coefficients = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
    sums, measure, box = np.empty(9), np.empty(3), np.empty(4, np.int64)
    weights = np.empty((2, TAPS), np.float32)
    buffers = (
        np.empty(size + TAPS, np.float32),
        np.empty(count, np.float32),
        weights,
        sums,
        np.empty(shading.shape[1]),
    )
    for k in range(share[0], share[1]):
        subset = (pixels[rows[k]], moments[rows[k]], offsets, believed, shading, rows[k])
        outcome[k, 0], outcome[k, 1], outcome[k, 2] = FAILED, 0, np.nan
        if not _is_place(warps[k]):
            continue
        u0, v0 = int(np.floor(warps[k, 0] + 0.5)), int(np.floor(warps[k, 1] + 0.5))
        box[0], box[1], box[2], box[3] = u0 - reach, v0 - reach, side, side
        load_coefficients(image, columns, box, region, coefficients)
        best, best_i, best_j = -2.0, 0, 0
        step = divisions // 2
        while step > 0:
            center_i, center_j = best_i, best_j
            for i in range(center_i - step, center_i + step + 1, step):
                for j in range(center_j - step, center_j + step + 1, step):
                    if max(abs(i), abs(j)) > divisions:
                        continue
                    center = (reach + i / divisions, reach + j / divisions)
                    score = _score_shift(coefficients, size, center, subset, buffers, measure)
                    if score > best:
                        best, best_i, best_j = score, i, j
                        outcome[k, 2], outcome[k, 3], outcome[k, 4] = measure[0], measure[1], measure[2]
            if best_i == center_i and best_j == center_j:
                step //= 2
        warps[k, 0], warps[k, 1] = u0 + best_i / divisions, v0 + best_j / divisions
        outcome[k, 0] = CONVERGED
