"""Compiled inner loops of the subset registration: quintic B-spline sampling and Gauss-Newton on the affine warp.

Arrays are indexed ``[u, v]`` here (first axis to the right), the order of pixel positions; only ``image`` keeps the
usual ``[v, u]``. The kernels release the interpreter lock, so that threads share the points (see `subsets`). They
are not compiled with numba's own thread pool: it must not be entered from two threads at once on every platform,
which would end the process when two views are tracked side by side. All in one file, because numba's cache notices
a change only in the file of the function that is called from Python.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from vfm_sdm.core.arrays import FloatArray, LumaArray

__all__ = ["CONVERGED", "FAILED", "OUTSIDE", "correlate_on_grid", "register_subsets"]

CONVERGED, FAILED, OUTSIDE = 0, 1, 2
"""Outcome codes of one registration."""

# Roots of z^4 + 26 z^3 + 66 z^2 + 26 z + 1 inside the unit circle: the filter from samples to spline coefficients.
_POLES = (-0.43057534709997379, -0.04309628820326465)
_DECAY_PX = 6  # the filter forgets what it assumes outside a region: 0.43^6 = 0.6 %
_DRIFT_PX = 1  # motion after which a loaded region still serves
_REGION_FACTOR = 2  # largest stretch of a subset by the warp; beyond it the registration has diverged
_TAPS, _BEFORE, _AFTER = 6, 2, 3
_FAR = 1e7
# The filter is 1 / (D(z) D(1/z)) with D(z) = (1 - pole_1 z)(1 - pole_2 z); D(1)^2 brings it to unit gain.
_POLE_SUM, _POLE_PRODUCT = np.float32(sum(_POLES)), np.float32(_POLES[0] * _POLES[1])
_STEADY = np.float32(1 / ((1 - _POLES[0]) * (1 - _POLES[1])))
_AXIS_GAIN = np.float32(((1 - _POLES[0]) * (1 - _POLES[1])) ** 2 / 120)
_ONE = np.float32(1)

Single = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Picture = tuple[LumaArray, int]
Bank = tuple[Single, FloatArray, FloatArray, Single, Single]
Work = tuple[Integers, FloatArray, FloatArray]
Corner = tuple[int, int]
# Plain tuples, because numba's cache on disk cannot be read any more once a class named in a signature is renamed.

# Sums may be reordered for SIMD; NaN and infinity keep their meaning (no "nnan", "ninf").
_jit = njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "arcp", "contract"})


@_jit
def _mirrored(index: int, size: int) -> int:
    """Index inside 0 ... size - 1, reflected about the first and last element."""
    if size == 1:
        return 0
    period = 2 * (size - 1)
    index = abs(index) % period
    return min(index, period - index)


@_jit
def _load_region(image: LumaArray, columns: int, box: Integers, level: np.float32, region: Single) -> None:
    """The image's ``box`` minus ``level`` as region[v, u], mirrored about the border pixels outside."""
    rows = image.shape[0]
    left, top, width, height = box[0], box[1], box[2], box[3]
    whole = left >= 0 and top >= 0 and left + width <= columns and top + height <= rows
    for v in range(height):
        target = region[v, :width]
        if whole:
            source = image[top + v, left : left + width]
            for u in range(width):
                target[u] = np.float32(source[u]) - level
        else:
            row = image[_mirrored(top + v, rows)]
            for u in range(width):
                target[u] = np.float32(row[_mirrored(left + u, columns)]) - level


@_jit
def _level(image: LumaArray, columns: int, box: Integers) -> np.float32:
    """A rough mean of the image in the box, from its diagonal: keeps single-precision sums accurate."""
    total = 0.0
    for k in range(box[2]):
        total += image[_mirrored(box[1] + k * box[3] // box[2], image.shape[0]), _mirrored(box[0] + k, columns)]
    return np.float32(total / box[2])


@_jit
def _filter_first_axis(block: Single, count: int, width: int) -> None:
    """Recursive spline filter along the first axis of block[:count, :width], in place; its gain is in the weights.

    Both poles in one recursion each way, y_k = x_k + sum y_(k-1) - product y_(k-2). It starts as if the first value
    had stood for ever; that is forgotten after `_DECAY_PX`. The block is passed whole because numba vectorises over
    rows of contiguous arrays only; ``count`` is two more than a multiple of four (see `_padded`).
    """
    for j in range(width):
        block[0, j] *= _STEADY
        block[1, j] += (_POLE_SUM - _POLE_PRODUCT) * block[0, j]
    k = 2
    while k < count - 3:
        _recur(block, k, 1, width)
        k += 4
    for j in range(width):
        block[count - 1, j] *= _STEADY
        block[count - 2, j] += (_POLE_SUM - _POLE_PRODUCT) * block[count - 1, j]
    k = count - 3
    while k > 2:
        _recur(block, k, -1, width)
        k -= 4


@_jit
def _load_coefficients(image: LumaArray, columns: int, box: Integers, region: Single, coefficients: Single) -> None:
    """Spline coefficients [u, v] of the image in the box, less a level; ``region`` is room for the pixels."""
    width, height = box[2], box[3]
    _load_region(image, columns, box, _level(image, columns, box), region)
    _filter_first_axis(region, height, width)
    _transpose(region, height, width, coefficients)
    _filter_first_axis(coefficients, width, height)


@_jit
def _padded(count: int) -> int:
    """The next count that is two more than a multiple of four."""
    return count + (2 - count) % 4


@_jit
def _recur(block: Single, k: int, step: int, width: int) -> None:
    """Four rows of the recursion at a time, from ``k`` on in steps of 1 or -1: that halves the traffic with memory."""
    earlier, before = block[k - 2 * step], block[k - step]
    a, b, c, d = block[k], block[k + step], block[k + 2 * step], block[k + 3 * step]
    for j in range(width):
        first = a[j] + _POLE_SUM * before[j] - _POLE_PRODUCT * earlier[j]
        second = b[j] + _POLE_SUM * first - _POLE_PRODUCT * before[j]
        third = c[j] + _POLE_SUM * second - _POLE_PRODUCT * first
        d[j] += _POLE_SUM * third - _POLE_PRODUCT * second
        a[j], b[j], c[j] = first, second, third


@_jit
def _transpose(block: Single, count: int, width: int, out: Single) -> None:
    for k in range(count):
        row = block[k, :width]
        for j in range(width):
            out[j, k] = row[j]


@_jit
def _power5(x: np.float32) -> np.float32:
    square = x * x
    return square * square * x


@_jit
def _weights(t: np.float32, weights: Single) -> None:
    """The six quintic B-spline weights at fraction ``t`` of a pixel, as differences of truncated powers."""
    s = _ONE - t
    s0, s1, s2 = _power5(s), _power5(_ONE + s), _power5(np.float32(2) + s)
    t0, t1, t2 = _power5(t), _power5(_ONE + t), _power5(np.float32(2) + t)
    six, fifteen = np.float32(6), np.float32(15)
    weights[0] = _AXIS_GAIN * s0
    weights[1] = _AXIS_GAIN * (s1 - six * s0)
    weights[2] = _AXIS_GAIN * (s2 - six * s1 + fifteen * s0)
    weights[3] = _AXIS_GAIN * (t2 - six * t1 + fifteen * t0)
    weights[4] = _AXIS_GAIN * (t1 - six * t0)
    weights[5] = _AXIS_GAIN * t0


@_jit
def _sample_shifted(
    coefficients: Single, size: int, corner: Corner, weights: Single, line: Single, out: Single
) -> None:
    """Spline on the grid of a pure translation: out[k size + l] at (u0 + k, v0 + l) plus the fraction.

    One fraction serves all pixels, so the two axes separate: 12 multiplications a pixel instead of 36. ``weights``,
    shape (2, 6), are those of the fraction along u and v; ``line`` is room for a line of the subset.
    """
    wu, wv = weights[0], weights[1]
    u0, v0 = corner
    a0, a1, a2, a3, a4, a5 = wu[0], wu[1], wu[2], wu[3], wu[4], wu[5]
    b0, b1, b2, b3, b4, b5 = wv[0], wv[1], wv[2], wv[3], wv[4], wv[5]
    span = size + _TAPS - 1
    left, right = v0 - _BEFORE, v0 - _BEFORE + span
    for k in range(size):
        first = u0 + k - _BEFORE
        c0, c1 = coefficients[first, left:right], coefficients[first + 1, left:right]
        c2, c3 = coefficients[first + 2, left:right], coefficients[first + 3, left:right]
        c4, c5 = coefficients[first + 4, left:right], coefficients[first + 5, left:right]
        for j in range(span):
            line[j] = a0 * c0[j] + a1 * c1[j] + a2 * c2[j] + a3 * c3[j] + a4 * c4[j] + a5 * c5[j]
        row = out[k * size : (k + 1) * size]
        for j in range(size):
            row[j] = (
                b0 * line[j] + b1 * line[j + 1] + b2 * line[j + 2]
                + b3 * line[j + 3] + b4 * line[j + 4] + b5 * line[j + 5]
            )  # fmt: skip


@_jit
def _sample_warped(
    coefficients: Single, size: int, corner: Corner, warp: FloatArray, weights: Single, out: Single
) -> None:
    """Spline on the grid of an affine warp; ``corner`` is the pixel of coefficients[0, 0], ``weights`` room (2, 6)."""
    wu, wv = weights[0], weights[1]
    left, top = corner
    half = size // 2
    for k in range(size):
        for j in range(size):
            u = warp[0] + warp[2] * (k - half) + warp[3] * (j - half) - left
            v = warp[1] + warp[4] * (k - half) + warp[5] * (j - half) - top
            u0, v0 = int(np.floor(u)), int(np.floor(v))
            _weights(np.float32(u - u0), wu)
            _weights(np.float32(v - v0), wv)
            total = np.float32(0)
            for a in range(_TAPS):
                row = coefficients[u0 - _BEFORE + a, v0 - _BEFORE : v0 + _AFTER + 1]
                part = np.float32(0)
                for b in range(_TAPS):
                    part += wv[b] * row[b]
                total += wu[a] * part
            out[k * size + j] = total


@_jit
def _apply_mask(believed: Single, row: int, values: Single) -> None:
    """Zero for the pixels of a subset that are not believed; without masks (no rows) nothing."""
    if believed.shape[0] > 0:
        mask = believed[row]
        for i in range(values.size):
            values[i] *= mask[i]


@_jit
def _correlate(values: Single, pixels: Single, offsets: Single, sums: FloatArray) -> None:
    """Sums over the subset: values, values^2, template * values, then the six steepest-descent products."""
    template, grad_u, grad_v = pixels[0], pixels[1], pixels[2]
    x, y = offsets[0], offsets[1]
    zero = np.float32(0)
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for i in range(values.size):
        g = values[i]
        du, dv = grad_u[i] * g, grad_v[i] * g
        s0 += g
        s1 += g * g
        s2 += template[i] * g
        s3 += du
        s4 += x[i] * du
        s5 += y[i] * du
        s6 += dv
        s7 += x[i] * dv
        s8 += y[i] * dv
    sums[0], sums[1], sums[2] = s0, s1, s2
    sums[3], sums[4], sums[5] = s3, s4, s5
    sums[6], sums[7], sums[8] = s6, s7, s8


@_jit
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


@_jit
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


@_jit
def _reach(warp: FloatArray, half: int) -> tuple[float, float]:
    """Half-width of the warped subset's bounding box along u and v."""
    return half * (abs(warp[2]) + abs(warp[3])), half * (abs(warp[4]) + abs(warp[5]))


@_jit
def _is_place(warp: FloatArray) -> bool:
    """Whether the position is a number of sensible size (a comparison: reordered sums may deceive ``isfinite``)."""
    return bool(abs(warp[0]) < _FAR and abs(warp[1]) < _FAR)


@_jit
def _deviation(warp: FloatArray, half: int) -> float:
    """Largest displacement [px] along an axis that the warp's linear part gives a pixel of the subset."""
    along_u = abs(warp[2] - 1.0) + abs(warp[3])
    along_v = abs(warp[4]) + abs(warp[5] - 1.0)
    return float(half * max(along_u, along_v))


@_jit
def _covers(box: Integers, warp: FloatArray, half: int) -> bool:
    """Whether ``box`` (left, top, width, height) holds all that sampling the warped subset needs; else moves it."""
    reach_u, reach_v = _reach(warp, half)
    left, right = int(np.floor(warp[0] - reach_u)) - _BEFORE, int(np.floor(warp[0] + reach_u)) + _AFTER
    top, bottom = int(np.floor(warp[1] - reach_v)) - _BEFORE, int(np.floor(warp[1] + reach_v)) + _AFTER
    margin_right, margin_bottom = box[0] + box[2] - _DECAY_PX, box[1] + box[3] - _DECAY_PX
    if left - box[0] >= _DECAY_PX and right < margin_right and top - box[1] >= _DECAY_PX and bottom < margin_bottom:
        return True
    margin = _DECAY_PX + _DRIFT_PX
    box[0], box[2] = left - margin, _padded(right - left + 1 + 2 * margin)
    box[1], box[3] = top - margin, _padded(bottom - top + 1 + 2 * margin)
    return False


@_jit
def _inside(warp: FloatArray, half: int, columns: int, rows: int) -> bool:
    """Whether every sample of the warped subset lies within the image."""
    reach_u, reach_v = _reach(warp, half)
    low, high = min(warp[0] - reach_u, warp[1] - reach_v), max(warp[0] + reach_u - columns, warp[1] + reach_v - rows)
    return bool(low >= 0.0 and high <= -1.0)


@_jit
def _moved2(step: FloatArray, half: int) -> float:
    """Mean square by which a step moves the pixels of a subset of half width ``half`` [px2]."""
    turned = step[1] * step[1] + step[2] * step[2] + step[4] * step[4] + step[5] * step[5]
    return float(step[0] * step[0] + step[3] * step[3] + half * half / 3.0 * turned)


@_jit
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
        Tuple of the reference (see `ReferenceSubsets`): pixels (P, 3, S S) float32, moments (P, 14), matrices
        (P, 2, 6, 6), offsets (2, S S) float32, masks (P or 0, S S) float32.
    work
        Row of the bank of each registration, shape (K,). Starts, which the results replace: t_u, t_v [px], then A row
        by row [1], shape (K, 6). Outcomes to fill in: code, iterations, ZNCC, residual sum of squares and gain, shape
        (K, 5).
    settings
        Largest number of iterations, tolerance (distance from the minimum) [px], and the deviation [px] of A from the
        identity up to which the grid of a pure translation is sampled.
    share
        First registration, and the one after the last.
    """
    (image, columns), (rows, warps, outcome) = picture, work
    pixels, moments, matrices, offsets, believed = bank
    max_iterations, tolerance, rigid_px = settings
    count = pixels.shape[2]
    size = int(np.sqrt(count) + 0.5)
    half = size // 2
    limit = _padded(_REGION_FACTOR * size + 2 * (_DECAY_PX + _DRIFT_PX + _TAPS))
    region, coefficients = np.empty((limit, limit), np.float32), np.empty((limit, limit), np.float32)
    line, sampled = np.empty(size + _TAPS, np.float32), np.empty(count, np.float32)
    weights = np.empty((2, _TAPS), np.float32)
    box, grid = np.empty(4, np.int64), np.empty(6)
    sums, step, measure = np.empty(9), np.empty(6), np.empty(3)
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
                _load_coefficients(image, columns, box, region, coefficients)
            if rigid:
                u0, v0 = int(np.floor(grid[0])), int(np.floor(grid[1]))
                _weights(np.float32(grid[0] - u0), weights[0])
                _weights(np.float32(grid[1] - v0), weights[1])
                _sample_shifted(coefficients, size, (u0 - half - box[0], v0 - half - box[1]), weights, line, sampled)
            else:
                _sample_warped(coefficients, size, (box[0], box[1]), grid, weights, sampled)
            _apply_mask(believed, row, sampled)
            _correlate(sampled, pixels[row], offsets, sums)
            if not (
                _solve_step(sums, int(moments[row, 13]), moments[row], matrices[row], step, measure)
                and _compose_inverse(grid, step, warp)
            ):
                break
            outcome[k, 1] = iteration + 1
            outcome[k, 2], outcome[k, 3], outcome[k, 4] = measure[0], measure[1], measure[2]
            moved = _moved2(step, 0 if rigid else half)
            # Steps shrink by a steady factor, so what is left to go is a geometric series.
            factor = min(np.sqrt(moved / before), 0.9)
            before = moved
            if np.sqrt(moved) * factor < tolerance * (1.0 - factor):
                outcome[k, 0] = CONVERGED
                break


@_jit
def _score_shift(
    coefficients: Single,
    size: int,
    center: tuple[float, float],
    subset: tuple[Single, FloatArray, Single, Single, int],
    buffers: tuple[Single, Single, Single, FloatArray],
    measure: FloatArray,
) -> float:
    """ZNCC of a subset with the image shifted to a centre; ``measure`` gets it, the residual and the gain.

    The centre is counted in ``coefficients``. ``subset`` are its pixels and moments, the pixels' offsets, the masks
    and its row in them; ``buffers`` are room for a line, the samples, the spline weights and the sums.
    """
    (pixels, moments, offsets, believed, row), (line, sampled, weights, sums) = subset, buffers
    half = size // 2
    u0, v0 = int(np.floor(center[0])), int(np.floor(center[1]))
    _weights(np.float32(center[0] - u0), weights[0])
    _weights(np.float32(center[1] - v0), weights[1])
    _sample_shifted(coefficients, size, (u0 - half, v0 - half), weights, line, sampled)
    _apply_mask(believed, row, sampled)
    _correlate(sampled, pixels, offsets, sums)
    norm2 = moments[0]
    energy = sums[1] - sums[0] * sums[0] / int(moments[13])
    measure[2] = sums[2] / norm2
    measure[1] = max(energy - measure[2] * sums[2], 0.0)
    measure[0] = sums[2] / np.sqrt(norm2 * energy) if energy > 0.0 else -1.0
    return float(measure[0])


@_jit
def correlate_on_grid(picture: Picture, bank: Bank, work: Work, divisions: int, share: tuple[int, int]) -> None:
    """Moves subsets to the highest ZNCC on a grid of 1 / ``divisions`` px within one pixel of their start.

    The arguments are those of `register_subsets`. Of the starts, shape (K, 6), only the position is read and moved,
    from the nearest pixel. The search halves its step from half a pixel down to one division and climbs at every step.
    """
    (image, columns), (rows, warps, outcome) = picture, work
    pixels, moments, _, offsets, believed = bank
    count = pixels.shape[2]
    size = int(np.sqrt(count) + 0.5)
    reach = size // 2 + 1 + _AFTER + _DECAY_PX
    side = _padded(2 * reach + 1)
    region, coefficients = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
    sums, measure, box = np.empty(9), np.empty(3), np.empty(4, np.int64)
    weights = np.empty((2, _TAPS), np.float32)
    buffers = (np.empty(size + _TAPS, np.float32), np.empty(count, np.float32), weights, sums)
    for k in range(share[0], share[1]):
        subset = (pixels[rows[k]], moments[rows[k]], offsets, believed, rows[k])
        outcome[k, 0], outcome[k, 1], outcome[k, 2] = FAILED, 0, np.nan
        if not _is_place(warps[k]):
            continue
        u0, v0 = int(np.floor(warps[k, 0] + 0.5)), int(np.floor(warps[k, 1] + 0.5))
        box[0], box[1], box[2], box[3] = u0 - reach, v0 - reach, side, side
        _load_coefficients(image, columns, box, region, coefficients)
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
