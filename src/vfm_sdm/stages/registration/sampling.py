"""Compiled sampling of images by quintic B-splines, and the sums over a subset that registration needs.

Arrays are indexed ``[u, v]`` here (first axis to the right), the order of pixel positions; only ``image`` keeps the
usual ``[v, u]``.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from vfm_sdm.core.arrays import FloatArray, LumaArray

__all__ = [
    "AFTER",
    "BEFORE",
    "DECAY_PX",
    "TAPS",
    "apply_mask",
    "compiled",
    "correlate",
    "load_coefficients",
    "padded",
    "remove_shading",
    "sample_shifted",
    "sample_warped",
    "set_weights",
]

# Roots of z^4 + 26 z^3 + 66 z^2 + 26 z + 1 inside the unit circle: the filter from samples to spline coefficients.
_POLES = (-0.43057534709997379, -0.04309628820326465)
DECAY_PX = 6  # the filter forgets what it assumes outside a region: 0.43^6 = 0.6 %
TAPS, BEFORE, AFTER = 6, 2, 3
# The filter is 1 / (D(z) D(1/z)) with D(z) = (1 - pole_1 z)(1 - pole_2 z); D(1)^2 brings it to unit gain.
_POLE_SUM, _POLE_PRODUCT = np.float32(sum(_POLES)), np.float32(_POLES[0] * _POLES[1])
_STEADY = np.float32(1 / ((1 - _POLES[0]) * (1 - _POLES[1])))
_AXIS_GAIN = np.float32(((1 - _POLES[0]) * (1 - _POLES[1])) ** 2 / 120)
_ONE = np.float32(1)

Single = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Corner = tuple[int, int]

# Sums may be reordered for SIMD; NaN and infinity keep their meaning (no "nnan", "ninf").
compiled = njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "arcp", "contract"})


@compiled
def _mirrored(index: int, size: int) -> int:
    """Index inside 0 ... size - 1, reflected about the first and last element."""
    if size == 1:
        return 0
    period = 2 * (size - 1)
    index = abs(index) % period
    return min(index, period - index)


@compiled
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


@compiled
def _level(image: LumaArray, columns: int, box: Integers) -> np.float32:
    """A rough mean of the image in the box, from its diagonal: keeps single-precision sums accurate."""
    total = 0.0
    for k in range(box[2]):
        total += image[_mirrored(box[1] + k * box[3] // box[2], image.shape[0]), _mirrored(box[0] + k, columns)]
    return np.float32(total / box[2])


@compiled
def _filter_first_axis(block: Single, count: int, width: int) -> None:
    """Recursive spline filter along the first axis of block[:count, :width], in place; its gain is in the weights.

    Both poles in one recursion each way, y_k = x_k + sum y_(k-1) - product y_(k-2). It starts as if the first value
    had stood for ever; that is forgotten after `DECAY_PX`. The block is passed whole because numba vectorises over
    rows of contiguous arrays only; ``count`` is two more than a multiple of four (see `padded`).
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


@compiled
def load_coefficients(image: LumaArray, columns: int, box: Integers, region: Single, coefficients: Single) -> None:
    """Spline coefficients [u, v] of the image in the box, less a level; ``region`` is room for the pixels."""
    width, height = box[2], box[3]
    _load_region(image, columns, box, _level(image, columns, box), region)
    _filter_first_axis(region, height, width)
    _transpose(region, height, width, coefficients)
    _filter_first_axis(coefficients, width, height)


@compiled
def padded(count: int) -> int:
    """The next count that is two more than a multiple of four."""
    return count + (2 - count) % 4


@compiled
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


@compiled
def _transpose(block: Single, count: int, width: int, out: Single) -> None:
    for k in range(count):
        row = block[k, :width]
        for j in range(width):
            out[j, k] = row[j]


@compiled
def _power5(x: np.float32) -> np.float32:
    square = x * x
    return square * square * x


@compiled
def set_weights(t: np.float32, weights: Single) -> None:
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


@compiled
def sample_shifted(coefficients: Single, size: int, corner: Corner, weights: Single, line: Single, out: Single) -> None:
    """Spline on the grid of a pure translation: out[k size + l] at (u0 + k, v0 + l) plus the fraction.

    One fraction serves all pixels, so the two axes separate: 12 multiplications a pixel instead of 36. ``weights``,
    shape (2, 6), are those of the fraction along u and v; ``line`` is room for a line of the subset.
    """
    wu, wv = weights[0], weights[1]
    u0, v0 = corner
    a0, a1, a2, a3, a4, a5 = wu[0], wu[1], wu[2], wu[3], wu[4], wu[5]
    b0, b1, b2, b3, b4, b5 = wv[0], wv[1], wv[2], wv[3], wv[4], wv[5]
    span = size + TAPS - 1
    left, right = v0 - BEFORE, v0 - BEFORE + span
    for k in range(size):
        first = u0 + k - BEFORE
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


@compiled
def sample_warped(
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
            set_weights(np.float32(u - u0), wu)
            set_weights(np.float32(v - v0), wv)
            total = np.float32(0)
            for a in range(TAPS):
                row = coefficients[u0 - BEFORE + a, v0 - BEFORE : v0 + AFTER + 1]
                part = np.float32(0)
                for b in range(TAPS):
                    part += wv[b] * row[b]
                total += wu[a] * part
            out[k * size + j] = total


@compiled
def apply_mask(believed: Single, row: int, values: Single) -> None:
    """Zero for the pixels of a subset that are not believed; without masks (no rows) nothing."""
    if believed.shape[0] > 0:
        mask = believed[row]
        for i in range(values.size):
            values[i] *= mask[i]


@compiled
def remove_shading(shading: Single, values: Single, shares: FloatArray) -> None:
    """Takes orthonormal surfaces, shape (Q, S S), out of the values of a subset; ``shares`` gets how much of each."""
    for q in range(shading.shape[0]):
        surface = shading[q]
        share = np.float32(0)
        for i in range(values.size):
            share += surface[i] * values[i]
        for i in range(values.size):
            values[i] -= share * surface[i]
        shares[q] = share


@compiled
def correlate(values: Single, pixels: Single, offsets: Single, sums: FloatArray) -> None:
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
