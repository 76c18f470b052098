"""How well the surroundings of a point resemble those of places in another view: maps of it, and their peaks."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.stages.registration.peaks import DISTINCT_PX

__all__ = [
    "LEAST_CORRELATION",
    "Candidate",
    "ResemblanceMap",
    "best_candidates",
    "count_cells",
    "lowest_between",
    "map_resemblance",
    "score",
    "soften",
]

SoftArray = npt.NDArray[np.float32]
"""A picture softened for comparison, shape (H, W)."""
LEAST_CORRELATION = 0.7
"""Below this correlation two subsets do not show the same."""
_FULL_CORRELATION = 0.98
"""Above this correlation two views of one place do not tell more: gloss, shading and focus differ as much."""
_INDEPENDENT_PIXELS = 10.0
"""What differs between two views is the same over large parts of a subset: it counts as so many independent pixels."""
_CHANCE = 0.2
"""Expected number of places that resemble a point as well by chance, up to which one of them counts."""
_SOFTENING_PX = 1.0
_REACH = 3.5
"""Standard deviations of the expectation that are searched."""
_LARGEST_PX = 900
"""Half the side of the largest search [px]."""
_FIT_PX = 4
"""Half the side of the square over which a peak's shape is fitted [px of the first view]."""
_WIDEST_PX = 30.0
"""Standard deviation of a peak along which nothing changes: as far as a subset reaches."""
_PEAKS = 8
_NOWHERE = -1e9
_PEAK_PX = 2
"""A peak is no lower than anything this near [steps of the map]."""


def score(correlation: FloatArray | float, cells: float = _INDEPENDENT_PIXELS) -> FloatArray:
    """Logarithm of the likelihood of a correlation [1].

    Parameters
    ----------
    correlation
        Normalised cross-correlation, any shape.
    cells
        Independent pixels of the residual between two views of one place; or, over the likelihood of unrelated
        pictures, of the texture (`count_cells`).

    Notes
    -----
    Residuals of n independent pixels of unknown variance: ``-n/2 log(1 - r^2)``.

    Examples
    --------
    >>> [round(float(score(r)), 1) for r in (0.7, 0.9, 0.99)]
    [3.4, 8.3, 16.1]
    """
    known = np.clip(correlation, 0.0, _FULL_CORRELATION)
    return np.asarray(-cells / 2 * np.log(1 - known**2))


def count_cells(subset: SoftArray) -> float:
    """Number of independent cells of a texture: what is smooth resembles much else by chance.

    Parameters
    ----------
    subset
        Shape (S, S).

    Notes
    -----
    A random texture of variance s2 whose slope along a direction has the variance g2 decorrelates over ``l = s / g``; a
    Gaussian autocorrelation of this width covers ``sqrt(2 pi) l``. The directions are those of the structure tensor.

    References
    ----------
    .. [1] Foerstner, W., Guelch, E. (1987). A fast operator for detection and precise location of distinct points,
       corners and centres of circular features. ISPRS Intercommission Workshop, Interlaken.

    Examples
    --------
    >>> stripes = np.tile(np.sin(np.arange(41) / 2), (41, 1)).astype(np.float32)
    >>> round(count_cells(stripes)), round(count_cells(stripes + stripes.T))
    (8, 33)
    """
    slopes = [d.ravel() for d in np.gradient(subset.astype(np.float64))]
    power = np.linalg.eigvalsh(np.array([[np.mean(a * b) for a in slopes] for b in slopes]))
    widths = np.sqrt(2 * np.pi * subset.var() / np.maximum(power, 1e-12))
    return float(np.maximum(len(subset) / np.maximum(widths, 1e-6), 1.0).prod())


@dataclass(frozen=True, eq=False)
class ResemblanceMap:
    """Correlation of one point's subset with the places of a grid.

    Parameters
    ----------
    correlation
        Shape (M, N) [1]; -1 where the subset would leave the picture.
    origin
        Place of the grid's first node in the second view, shape (2,) [px].
    affine
        Map of steps on the grid, in pixels of the first view, to pixels of the second one, shape (2, 2) [1].
    size
        Side of the subset [px].
    cells
        Independent cells of its texture.
    """

    correlation: FloatArray
    origin: FloatArray
    affine: FloatArray
    size: int
    cells: float

    def least_correlation(self, covariance: FloatArray) -> float:
        """Correlation that unrelated pictures hardly reach at one of the places where a point may be.

        Parameters
        ----------
        covariance
            Of where it is expected, shape (2, 2) [px2].
        """
        # Ellipse of two standard deviations over the area of a cell.
        area = 4 * np.pi * np.sqrt(np.linalg.det(covariance))
        places = max(area * self.cells / (self.size**2 * abs(np.linalg.det(self.affine))), 1.0)
        return float(np.sqrt(1 - (_CHANCE / places) ** (2 / self.cells)))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place that resembles the point.

    Parameters
    ----------
    position
        Where it resembles it most, shape (2,) [px].
    covariance
        How well that is determined, shape (2, 2) [px2]: wide along an edge.
    correlation
        Normalised cross-correlation there.
    affine
        Map of offsets from the first to the second view, shape (2, 2) [1].
    size
        Side of the subset [px].
    value
        Score less half the squared distance from the expectation.
    """

    position: FloatArray
    covariance: FloatArray
    correlation: float
    affine: FloatArray
    size: int
    value: float = 0.0

    @property
    def score(self) -> float:
        """Logarithm of the likelihood of the correlation."""
        return float(score(self.correlation))


def map_resemblance(
    images: tuple[SoftArray, SoftArray],
    point: FloatArray,
    expected: tuple[FloatArray, FloatArray],
    affine: FloatArray,
    size: int,
) -> ResemblanceMap | None:
    """Correlation of a point's subset with all places where it is expected; ``None`` where the subset has no room.

    Parameters
    ----------
    images
        The two views, shape (H, W) each, softened alike.
    point
        Place in the first view, shape (2,) [px].
    expected
        Mean (2,) [px] and covariance (2, 2) [px2] of its place in the second view.
    affine
        Map of offsets from the first to the second view, shape (2, 2) [1].
    size
        Side of the subset [px].
    """
    first, second = images
    half = size // 2
    centre = np.floor(point + 0.5).astype(int)
    height, width = first.shape
    if not ((centre >= half).all() and centre[0] + half < width and centre[1] + half < height):
        return None
    subset = first[centre[1] - half : centre[1] + half + 1, centre[0] - half : centre[0] + half + 1]
    mean, covariance = expected
    back = np.linalg.inv(affine)
    reach = np.sqrt(np.diag(back @ covariance @ back.T)) * _REACH + 3
    reach_u, reach_v = np.minimum(np.ceil(reach), _LARGEST_PX).astype(int)
    shape = (int(2 * (reach_u + half) + 1), int(2 * (reach_v + half) + 1))
    # The subset is cut around a whole pixel; the grid is that of the point itself.
    middle = mean + affine @ (centre - point)
    moving = np.column_stack([affine, middle - affine @ [reach_u + half, reach_v + half]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    area = cv2.warpAffine(second, moving, shape, flags=flags)
    found = cv2.matchTemplate(area, np.ascontiguousarray(subset), cv2.TM_CCOEFF_NORMED).astype(np.float64)
    no_number = ~(np.abs(found) <= 1.0001)
    if not _lies_inside(moving, shape, second.shape):
        inside = cv2.warpAffine(np.ones(second.shape, np.float32), moving, shape, flags=flags)
        whole = cv2.boxFilter(inside, -1, (size, size))[half : half + found.shape[0], half : half + found.shape[1]]
        no_number |= ~(whole > 0.999)
    found[no_number] = -1.0
    return ResemblanceMap(found, mean - affine @ [reach_u, reach_v], affine, size, count_cells(subset))


def _lies_inside(moving: FloatArray, shape: tuple[int, int], image: tuple[int, ...]) -> bool:
    """Whether an area of this width and height, moved onto an image of this height and width, lies wholly in it."""
    last = np.subtract(shape, 1)
    corners = np.array([[u, v, 1.0] for u in (0.0, last[0]) for v in (0.0, last[1])]) @ moving.T
    return bool((corners >= 0).all() and (corners <= [image[1] - 1, image[0] - 1]).all())


def soften(image: LumaArray) -> SoftArray:
    """The image blurred a little, in single precision: noise and focus matter less, shape (H, W)."""
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SOFTENING_PX), np.float32)


def best_candidates(
    maps: list[ResemblanceMap], mean: FloatArray, covariance: FloatArray, *, gate: float
) -> list[Candidate]:
    """Places that resemble a point and lie where it is expected, the best first.

    Parameters
    ----------
    maps
        Maps of the point.
    mean, covariance
        Where it is expected, shapes (2,) [px] and (2, 2) [px2].
    gate
        Largest squared standardised distance from there.
    """
    found: list[Candidate] = []
    inverse = np.linalg.inv(covariance)
    for one in maps:
        like = np.nonzero(one.correlation >= max(LEAST_CORRELATION, one.least_correlation(covariance)))
        apart = np.column_stack(like[::-1]) @ one.affine.T + one.origin - mean
        distance = np.einsum("ni,ij,nj->n", apart, inverse, apart)
        near = distance <= gate
        rows, columns = like[0][near], like[1][near]
        values = score(one.correlation[rows, columns]) - distance[near] / 2
        peaks = _are_peaks(one.correlation.shape, rows, columns, values)
        for place in peaks[np.argsort(-values[peaks], kind="stable")[:_PEAKS]]:
            found.append(_candidate(one, rows[place], columns[place], float(values[place])))
    kept: list[Candidate] = []
    for candidate in sorted(found, key=lambda c: -c.value):
        if all(np.linalg.norm(candidate.position - other.position) > DISTINCT_PX for other in kept):
            kept.append(candidate)
    return kept[:_PEAKS]


def _are_peaks(shape: tuple[int, int], rows: IntArray, columns: IntArray, values: FloatArray) -> IntArray:
    """Which of some places of a map, all others of which are nowhere, are no lower than any within two pixels."""
    field = np.full((shape[0] + 2 * _PEAK_PX, shape[1] + 2 * _PEAK_PX), _NOWHERE)
    field[rows + _PEAK_PX, columns + _PEAK_PX] = values
    highest = values > _NOWHERE
    for down in range(2 * _PEAK_PX + 1):
        for right in range(2 * _PEAK_PX + 1):
            highest &= values >= field[rows + down, columns + right]
    return np.flatnonzero(highest)


def lowest_between(maps: list[ResemblanceMap], one: Candidate, other: Candidate) -> float:
    """Lowest score on the straight way from a candidate to another one.

    Parameters
    ----------
    maps
        Maps of the point, among them that of ``one``.
    one, other
        The two candidates.
    """
    found = next(m for m in maps if m.affine is one.affine and m.size == one.size)
    back = np.linalg.inv(found.affine)
    ends = [back @ (place - found.origin) for place in (one.position, other.position)]
    count = int(np.ceil(np.linalg.norm(ends[1] - ends[0]))) + 1
    way = np.rint(np.linspace(ends[0], ends[1], count)).astype(int)
    rows, columns = found.correlation.shape
    inside = ((way >= 0) & (way < [columns, rows])).all(axis=1)
    return float(score(found.correlation[way[inside, 1], way[inside, 0]]).min()) if inside.all() else 0.0


def _candidate(one: ResemblanceMap, row: int, column: int, value: float) -> Candidate:
    """A peak of a map with the shape of the score around it."""
    rows, columns = one.correlation.shape
    top, left = max(row - _FIT_PX, 0), max(column - _FIT_PX, 0)
    part = one.correlation[top : min(row + _FIT_PX + 1, rows), left : min(column + _FIT_PX + 1, columns)]
    v, u = np.mgrid[: part.shape[0], : part.shape[1]]
    x, y, s = (u + left - column).ravel(), (v + top - row).ravel(), score(part).ravel()
    known = part.ravel() > 0
    design = np.column_stack([np.ones(x.size), x, y, -(x**2) / 2, -x * y, -(y**2) / 2])[known]
    shift, inner = np.zeros(2), np.diag([_WIDEST_PX**2] * 2)
    if known.sum() >= 12:
        _, gx, gy, a, b, c = np.linalg.lstsq(design, s[known], rcond=None)[0]
        information, axes = np.linalg.eigh(np.array([[a, b], [b, c]]))
        inner = (axes / np.maximum(information, _WIDEST_PX**-2)) @ axes.T
        shift = np.clip(inner @ [gx, gy], -_FIT_PX / 2, _FIT_PX / 2)
    place = one.origin + one.affine @ (np.array([column, row]) + shift)
    covariance = one.affine @ inner @ one.affine.T
    return Candidate(place, covariance, float(one.correlation[row, column]), one.affine, one.size, value)
