"""Straight edges in a picture, to a fraction of a pixel: chains of edge points with a parabola through each."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, IntArray, LumaArray, as_float_array

__all__ = ["StraightEdges", "find_straight_edges"]

_LEAST_LENGTH_PX = 40.0
"""With 0.1 px of noise at ten independent points such a chain tells its direction to 0.3 degrees."""
_MOST_EDGES = 400
_SMOOTHING_PX = 1.0
"""Standard deviation of the Gaussian whose derivative finds edges, as Canny's default is."""
_REACH_PX, _STEP_PX = 4.0, 0.5
"""How far across a chain its edge points are looked for, and in which steps."""
_LEAST_SLOPE = 0.3
"""Share of the chain's median slope of brightness that a point of it has at least."""
_LEAST_KEPT = 0.6
"""Share of a chain's length along which the edge must be there."""
_OUTLIER = 3.0
_LEAST_STD_PX = 0.02
"""Standard deviation of an edge point: that of the sampling itself."""
_LEAST_POINTS = 3.0


@dataclass(frozen=True, eq=False)
class StraightEdges:
    """Edges of one view, each as a parabola through its chain of edge points.

    Parameters
    ----------
    view
        Index of the view in the rig.
    places
        Start, middle and end of the parabola of N edges, shape (N, 3, 2) [px].
    slope_std_px
        Standard deviation of how far, against one another, both ends lie across the edge, half of it each, shape (N,)
        [px].
    bow_std_px
        Standard deviation of the distance of the middle from the chord, shape (N,) [px].

    Notes
    -----
    With Legendre's polynomials along the chain, ``a1`` and ``a2`` of the fit are uncorrelated: the chord of the ends
    has the slope of the straight fit whatever the bow, ``a1`` being how far an end lies across; the middle is
    ``-1.5 a2`` from the chord.
    """

    view: int
    places: FloatArray
    slope_std_px: FloatArray
    bow_std_px: FloatArray

    def __post_init__(self) -> None:
        places = as_float_array(self.places, "places of edges", (None, 3, 2))
        object.__setattr__(self, "places", places)
        for name in ("slope_std_px", "bow_std_px"):
            object.__setattr__(self, name, as_float_array(getattr(self, name), name, (len(places),)))

    def __len__(self) -> int:
        return len(self.places)

    @property
    def length_px(self) -> FloatArray:
        """Length of each chord, shape (N,) [px]."""
        return np.asarray(np.linalg.norm(self.places[:, 2] - self.places[:, 0], axis=1))

    def chosen(self, rows: IntArray | BoolArray) -> "StraightEdges":
        """Edges of these rows.

        Parameters
        ----------
        rows
            Indices of the edges, shape (M,), or whether to take each, shape (N,).

        Examples
        --------
        >>> edges = StraightEdges(0, np.zeros((2, 3, 2)), np.ones(2), np.ones(2))
        >>> len(edges.chosen(np.array([True, False])))
        1
        """
        return StraightEdges(self.view, self.places[rows], self.slope_std_px[rows], self.bow_std_px[rows])


def find_straight_edges(luma: LumaArray, view: int) -> StraightEdges:
    """Straight edges of a picture, the longest first.

    Parameters
    ----------
    luma
        First frame of the view, shape (H, W).
    view
        Index of the view in the rig.

    Notes
    -----
    Segments of OpenCV's line segment detector [1]_ say where to look. Across each the derivative of the brightness,
    smoothed by a Gaussian, has its extremum at the edge, which a parabola through the logarithms of three samples tells
    to a fraction of a pixel [2]_: that of a blurred edge is a Gaussian itself. Errors of neighbouring points are
    correlated; their number that counts is that of the points over the sum of the autocorrelations up to the first that
    is not positive [3]_.

    References
    ----------
    .. [1] Grompone von Gioi, R., Jakubowicz, J., Morel, J.-M., Randall, G. (2012). LSD: a line segment detector. Image
       Processing On Line 2, 35-55.
    .. [2] Devernay, F. (1995). A non-maxima suppression method for edge detection with sub-pixel accuracy. INRIA
       research report 2724.
    .. [3] Geyer, C. J. (1992). Practical Markov chain Monte Carlo. Statistical Science 7(4), 473-483.

    Examples
    --------
    >>> luma = np.full((120, 160), 40, dtype=np.uint8)
    >>> luma[60:] = 200
    >>> edges = find_straight_edges(luma, 0)
    >>> len(edges), edges.places[0, :, 1].round(2).tolist()
    (1, [59.5, 59.5, 59.5])
    """
    segments = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(np.ascontiguousarray(luma))[0]
    empty = StraightEdges(view, np.empty((0, 3, 2)), np.empty(0), np.empty(0))
    if segments is None:
        return empty
    ends = np.asarray(segments, dtype=np.float64).reshape(-1, 2, 2)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    order = [index for index in np.argsort(-length, kind="stable") if length[index] >= _LEAST_LENGTH_PX]
    # Not OpenCV's interpolation, which rounds places to a 32nd of a pixel.
    spline = spline_filter(cv2.GaussianBlur(luma.astype(np.float64), (0, 0), _SMOOTHING_PX), order=3)
    found = [one for index in order[:_MOST_EDGES] if (one := _fit_chain(spline, ends[index])) is not None]
    if not found:
        return empty
    places, slope, bow = zip(*found, strict=True)
    return StraightEdges(view, np.array(places), np.array(slope), np.array(bow))


def _fit_chain(spline: FloatArray, ends: FloatArray) -> tuple[FloatArray, float, float] | None:
    """Places of a parabola (3, 2) along a segment (2, 2) [px] and their standard deviations; ``None`` without an edge.

    Parameters
    ----------
    spline
        Cubic spline of the smoothed picture, shape (H, W).
    """
    reach, half = _REACH_PX, float("nan")
    for _ in range(2):
        along = ends[1] - ends[0]
        half = float(np.linalg.norm(along)) / 2
        normal = np.array([-along[1], along[0]]) / (2 * half)
        t = np.linspace(-1, 1, int(2 * half) + 1)
        across, known = _find_edge_points(spline, ends.mean(axis=0) + t[:, None] * along / 2, normal, reach)
        if known.sum() < _LEAST_KEPT * len(t):
            return None
        fit = _fit_parabola(t[known], across[known])
        if fit is None:
            return None
        a, std, count = fit
        # Along the edge as found, and nearer to it, where other edges disturb less.
        ends = ends + normal * np.array([[a[0] - a[1]], [a[0] + a[1]]])
        reach = _REACH_PX / 2
    # The last fit is along the segment of the round before: its slope is in the ends now, its bow is not.
    middle = ends.mean(axis=0) - 1.5 * a[2] * normal
    return (
        np.stack([ends[0], middle, ends[1]]),
        float(std * np.sqrt(3 / count)),
        float(1.5 * std * np.sqrt(5 / count)),
    )


def _find_edge_points(
    spline: FloatArray, centres: FloatArray, normal: FloatArray, reach: float
) -> tuple[FloatArray, BoolArray]:
    """Distance of the edge from points (N, 2) along a normal [px], shape (N,), and whether there is one."""
    steps = np.arange(-reach - _STEP_PX, reach + 1.5 * _STEP_PX, _STEP_PX)
    places = centres[:, None] + steps[:, None] * normal
    sampled = map_coordinates(spline, np.moveaxis(places[..., ::-1], -1, 0), order=3, mode="nearest", prefilter=False)
    slope, offsets = sampled[:, 2:] - sampled[:, :-2], steps[1:-1]
    # One edge is brighter on one side all along.
    slope = slope * np.sign(np.median(slope[:, len(offsets) // 2]))
    best = np.clip(slope.argmax(axis=1), 1, len(offsets) - 2)
    rows = np.arange(len(centres))
    before, peak, after = slope[rows, best - 1], slope[rows, best], slope[rows, best + 1]
    known = (peak >= before) & (peak >= after) & (np.minimum(before, after) > 0) & (before + after < 2 * peak)
    known &= peak > _LEAST_SLOPE * np.median(peak)
    before, peak, after = (np.log(np.where(known, one, 1.0)) for one in (before, peak, after))
    curvature = np.where(known, before - 2 * peak + after, 1.0)
    shift = (before - after) / (2 * curvature)
    return offsets[best] + _STEP_PX * shift, known


def _fit_parabola(t: FloatArray, across: FloatArray) -> tuple[FloatArray, float, float] | None:
    """Legendre coefficients (3,) [px], standard deviation of a point [px] and the number of independent points."""
    basis = np.polynomial.legendre.legvander(t, 2)
    kept = np.ones(len(t), dtype=np.bool_)
    for _ in range(4):
        if kept.sum() < _LEAST_KEPT * len(t):
            return None
        a = np.asarray(np.linalg.lstsq(basis[kept], across[kept], rcond=None)[0], dtype=np.float64)
        left = across - basis @ a
        std = MAD_TO_STD * float(np.median(np.abs(left[kept])))
        kept = np.abs(left) <= _OUTLIER * max(std, _LEAST_STD_PX)
    left = left[kept]
    std = float(np.sqrt(np.mean(left**2)))
    count = len(left) / _correlation_length(left) if std > 0 else float(len(left))
    return a, max(std, _LEAST_STD_PX), max(count, _LEAST_POINTS)


def _correlation_length(left: FloatArray) -> float:
    """Number of successive residuals (N,) that count as one."""
    size = len(left)
    spectrum = np.abs(np.fft.rfft(left, 2 * size)) ** 2
    autocorrelation = np.fft.irfft(spectrum)[:size]
    autocorrelation = autocorrelation / autocorrelation[0]
    negative = np.flatnonzero(autocorrelation <= 0)
    last = int(negative[0]) if negative.size else size
    return float(1 + 2 * autocorrelation[1:last].sum())
