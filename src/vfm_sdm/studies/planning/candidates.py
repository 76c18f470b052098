"""Places of a picture that a tracker could follow, and which of them lie on the structure's face."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, IntArray, LumaArray
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.inputs.session import FirstFrames, Point, Session
from vfm_sdm.stages.matching.locate import PointFinder
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["Located", "find_textured", "locate_candidates"]

_LEAST_TEXTURE = 1.0
"""Least mean square of the brightness gradient in its weakest direction [grey levels squared a pixel squared]: a subset
of 41 px with noise of two grey levels then has 0.07 px, sqrt(2) 2 / 41, near what is refused."""


def find_textured(
    luma: LumaArray, *, subset_px: int, grid: tuple[int, int], each: int = 1, avoid: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """The places with the most texture in every direction, the best few of each cell of a grid.

    Parameters
    ----------
    luma
        The picture, shape (H, W).
    subset_px
        Side of the square over which texture counts, which is also the least distance between two places [px].
    grid
        Columns and rows of the grid.
    each
        Most places in a cell.
    avoid
        Places to stay away from by a subset, shape (K, 2) [px].

    Returns
    -------
    pixels, texture
        Shape (N, 2) [px] and (N,) [grey levels squared a pixel squared]: the smaller eigenvalue of the mean gradient
        matrix of the subset; most texture first.

    Notes
    -----
    The covariance of a registered subset is the noise over the sum of its gradient matrix [1]_ [2]_: the smaller
    eigenvalue tells how well its worst direction is measured.

    References
    ----------
    .. [1] Shi, J., Tomasi, C. (1994). Good features to track. IEEE Conference on Computer Vision and Pattern
       Recognition, 593-600.
    .. [2] Pan, B., Xie, H., Wang, Z., Qian, K., Wang, Z. (2008). Study on subset size selection in digital image
       correlation for speckle patterns. Optics Express 16(10), 7037-7048.

    Examples
    --------
    >>> picture = np.full((200, 300), 90, np.uint8)
    >>> picture[60:120, 100:130] = 160
    >>> pixels, texture = find_textured(picture, subset_px=41, grid=(3, 1))
    >>> len(pixels) > 0, bool((np.abs(pixels[0] - [114.5, 60]) < [37, 22]).all())
    (True, True)
    """
    texture = _weakest_texture(luma, subset_px)
    border = subset_px // 2 + 2
    inside = np.zeros_like(texture, dtype=np.bool_)
    inside[border:-border, border:-border] = True
    for u, v in np.empty((0, 2)) if avoid is None else avoid[np.isfinite(avoid).all(axis=1)]:
        top, left = (max(0, round(float(middle)) - subset_px) for middle in (v, u))
        inside[top : top + 2 * subset_px + 1, left : left + 2 * subset_px + 1] = False
    texture = np.where(inside, texture, 0.0)
    highest = cv2.dilate(texture, np.ones((subset_px, subset_px), np.uint8))
    rows, columns = (one.astype(np.intp) for one in np.nonzero((texture == highest) & (texture >= _LEAST_TEXTURE)))
    found = texture[rows, columns]
    order = np.argsort(-found, kind="stable")
    height, width = luma.shape
    counts: dict[tuple[int, int], int] = {}
    kept: list[int] = []
    for index in order:
        cell = int(columns[index] * grid[0] // width), int(rows[index] * grid[1] // height)
        if counts.get(cell, 0) < each and _apart(index, kept, columns, rows, subset_px):
            counts[cell] = counts.get(cell, 0) + 1
            kept.append(int(index))
    return np.column_stack([columns[kept], rows[kept]]).astype(np.float64).reshape(-1, 2), found[kept]


def _apart(index: int, kept: Sequence[int], columns: IntArray, rows: IntArray, least: int) -> bool:
    """Whether a place is no neighbour of those that were kept: the two cover less than half of each other."""
    return all(max(abs(columns[index] - columns[k]), abs(rows[index] - rows[k])) > least / 2 for k in kept)


def _weakest_texture(luma: LumaArray, subset_px: int) -> FloatArray:
    """The smaller eigenvalue of the mean gradient matrix of the subset around every pixel, shape (H, W)."""
    image = luma.astype(np.float32) * np.float32(255.0 / max(255.0, float(luma.max())))
    du, dv = (cv2.Sobel(image, cv2.CV_32F, *axis, ksize=3, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    size = (subset_px, subset_px)
    uu, uv, vv = (cv2.boxFilter(product, -1, size) for product in (du * du, du * dv, dv * dv))
    return np.asarray((uu + vv) / 2 - np.sqrt(((uu - vv) / 2) ** 2 + uv**2), np.float64)


@dataclass(frozen=True, eq=False)
class Located:
    """Candidates found in every view.

    Parameters
    ----------
    pixels
        Shape (V, N, 2) [px]; those of the reference view are as given.
    std_px
        Standard deviation of each, shape (V, N, 2) [px]; 0 in the reference view.
    points3d
        In the frame of the reference camera, shape (N, 3) [m]; NaN where no second view shows a place.
    status
        ``ok`` where a second view shows it, else why not, length N.
    """

    pixels: FloatArray
    std_px: FloatArray
    points3d: FloatArray
    status: tuple[str, ...]

    @classmethod
    def none(cls, views: int) -> "Located":
        """No candidates of this many views."""
        nowhere = np.empty((views, 0, 2))
        return cls(nowhere, nowhere, np.empty((0, 3)), ())

    @property
    def largest_std_px(self) -> FloatArray:
        """The largest standard deviation over views and axes, shape (N,) [px]."""
        return np.asarray(np.where(np.isfinite(self.std_px), self.std_px, 0.0).max(axis=(0, 2)))

    def chosen(self, rows: IntArray) -> "Located":
        """Those of these rows."""
        status = tuple(self.status[row] for row in rows)
        return Located(self.pixels[:, rows], self.std_px[:, rows], self.points3d[rows], status)

    def joined(self, other: "Located") -> "Located":
        """These and others."""
        pixels = np.concatenate([self.pixels, other.pixels], axis=1)
        std_px = np.concatenate([self.std_px, other.std_px], axis=1)
        return Located(pixels, std_px, np.concatenate([self.points3d, other.points3d]), self.status + other.status)


def locate_candidates(
    session: Session, frames: FirstFrames, rig: Rig, pixels: FloatArray, *, static: bool, matches: Sequence[Matches]
) -> Located:
    """Where the other views show places of the reference view.

    Parameters
    ----------
    session
        The measurement; its points take no part.
    frames
        First frame of every view.
    rig
        Cameras, lengths in metres.
    pixels
        Places in the reference view, shape (N, 2) [px].
    static
        Whether they are looked for anywhere on their rays; else on the face.
    matches
        Feature matches between views.
    """
    reference = session.reference_view.name
    named = tuple(
        Point(name=f"candidate {number}", view=reference, pixel=(float(u), float(v)), static=static)
        for number, (u, v) in enumerate(pixels)
    )
    if not named:
        return Located.none(len(frames))
    found = PointFinder(session.model_copy(update={"point": named}), frames).find(rig, matches)
    position, std = (found[name].transpose("view", "point", "pixel").values for name in ("position", "position_std"))
    states = found["status"].transpose("point", "view").values[:, 1:]
    status = tuple(str(PointStatus.OK if (row == PointStatus.OK).any() else row[0]) for row in states)
    return Located(position, std, triangulate(position, rig), status)
