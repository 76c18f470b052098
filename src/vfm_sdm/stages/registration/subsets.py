"""Subsets of a reference image, prepared once and registered to many other images."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray, as_float_array
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.registration.covariance import RIGID_PX, SubsetNoise
from vfm_sdm.stages.registration.designs import SubsetDesign, Warp, check_subset_px
from vfm_sdm.stages.registration.kernels import FAILED, correlate_on_grid, register_subsets
from vfm_sdm.stages.registration.records import RawRegistration, Registration, Starts
from vfm_sdm.stages.registration.reference_subsets import ReferenceSubsets, prepare_subsets

__all__ = [
    "RawRegistration",
    "Registration",
    "Starts",
    "SubsetBank",
    "SubsetDesign",
    "Warp",
    "check_luma",
    "check_subset_px",
    "register_subset",
]

TOLERANCE_PX = 1e-4
"""Distance to the minimum below which a registration has converged (RMS over the subset, from how the steps shrink):
a small part of the scatter that any noise gives."""

_NEVER_RIGID = -1.0
_RANK = 1e-9
"""Share of the largest singular value from which on one counts: pixels against their strain differ by a million."""
_SHARE = 16  # fewest registrations worth a thread of their own
_PROCESSORS = os.cpu_count() or 1  # asked once: asking costs as much as a registration


@dataclass(frozen=True, eq=False)
class SubsetBank:
    """Subsets of a reference image with everything that their registration needs; made by `prepare`.

    Parameters
    ----------
    points
        Named points in the reference image, shape (P, 2) [px].
    centers
        Pixels nearest to the points, which are the centres of the subsets, shape (P, 2) [px].
    subset_px
        Side of each subset, odd, shape (P,) [px]; 1 for a point without a subset.
    inside
        Whether the subset lies inside the reference image, shape (P,).
    usable
        Whether, in addition, its texture fixes all parameters of the warp, shape (P,).
    designs
        Size, warp and mask of each subset; ``None`` where all are whole squares with an affine warp.
    prepared
        Gradients and matrices: the subsets of each size, by their rows among the P.

    Notes
    -----
    A subset is centred on the pixel nearest to its point, and the sub-pixel rest is carried as an offset through the
    warp. Sampling the reference between the pixels would do the same in principle, but interpolated noise and its
    derivative are correlated at a general phase, which pulls the estimate (at a quarter pixel and 1 % noise by
    0.004 px on a good texture, by 0.03 px on a weak one); at the samples they are not.
    """

    points: FloatArray
    centers: IntArray
    subset_px: IntArray
    inside: BoolArray
    usable: BoolArray
    designs: tuple[SubsetDesign | None, ...] | None
    prepared: tuple[tuple[IntArray, ReferenceSubsets], ...]

    @classmethod
    def prepare(
        cls,
        reference: LumaArray,
        points: npt.ArrayLike,
        *,
        subset_px: int = 41,
        designs: Sequence[SubsetDesign | None] | None = None,
        moderate: bool = True,
        executor: Executor | None = None,
    ) -> "SubsetBank":
        """Bank of the subsets around points of a reference image.

        Parameters
        ----------
        reference
            Reference image, shape (H, W), uint8 or uint16.
        points
            Points in it, shape (P, 2) [px], at any position. A subset that leaves the image is kept, as not usable.
        subset_px
            Side of the subsets, odd [px], where there are no designs.
        designs
            Size, warp and mask of each of the P subsets; ``None`` for a point that is not to be registered.
        moderate
            Whether rotation and strain are small, as in a recording and not between views, so that those that the
            texture does not determine may be held.
        executor
            Threads that share the work; without them, it runs in this thread.

        Raises
        ------
        DatasetError
            The image or the points are malformed, or there is not one design a point.
        SessionError
            The size of the subset is even or too small.
        """
        check_luma(reference, "reference")
        check_subset_px(subset_px, "subset_px")
        points2d = as_float_array(points, "points", (None, 2))
        if not np.isfinite(points2d).all():
            raise DatasetError("points: expected finite pixels, got NaN or infinity; name points in the reference")
        if designs is not None and len(designs) != len(points2d):
            raise DatasetError(
                f"designs: expected one a point, got {len(designs)} for {len(points2d)} points; state None for points "
                "that are not to be registered"
            )
        centers = np.floor(points2d + 0.5).astype(np.int64)
        sides = np.full(len(points2d), subset_px)
        if designs is not None:
            sides = np.array([1 if design is None else design.subset_px for design in designs], np.int64)
        half = (sides // 2)[:, None]
        limit = np.array(reference.shape[::-1]) - 1
        inside = np.all((centers >= half) & (centers <= limit - half), axis=1)
        safe = np.where(inside[:, None], centers, half)
        usable, prepared = np.zeros(len(points2d), np.bool_), []
        for side in np.unique(sides[sides > 1]).tolist() if designs is not None else [subset_px]:
            rows = np.flatnonzero(sides == side)
            of_side = None if designs is None else [d for d in designs if d is not None and d.subset_px == side]
            places = safe[rows], (points2d - centers)[rows]
            subsets = prepare_subsets(
                reference, places, side // 2, designs=of_side, moderate=moderate, executor=executor
            )
            usable[rows] = inside[rows] & subsets.usable
            prepared.append((rows, subsets))
        kept = None if designs is None else tuple(designs)
        return cls(points2d, centers, sides, inside, usable, kept, tuple(prepared))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def offset(self) -> FloatArray:
        """Vectors from the centre of each subset to its named point, shape (P, 2) [px]."""
        return self.points - self.centers

    def register(
        self,
        current: LumaArray,
        position: npt.ArrayLike,
        *,
        affine: npt.ArrayLike | None = None,
        rows: IntArray | None = None,
        max_iterations: int = 50,
        executor: Executor | None = None,
    ) -> Registration:
        """Subsets registered to another image, from given starts.

        Parameters
        ----------
        current
            Current image, shape (H, W), uint8 or uint16; it may differ in size and brightness from the reference image.
        position
            Start of the positions, shape (K, 2) [px]; NaN is answered by NaN.
        affine
            Start of the maps, shape (K, 2, 2) [1]; identity by default.
        rows
            Row of the subset of each start, shape (K,); all P in order by default.
        max_iterations
            Gauss-Newton steps after which a registration has failed.
        executor
            Threads that share the work; without them, it runs in this thread.

        Raises
        ------
        DatasetError
            The image is malformed, or the starts do not match the subsets.
        """
        check_luma(current, "current")
        rows = np.arange(len(self)) if rows is None else rows
        start = as_float_array(position, "position", (len(rows), 2))
        A = np.broadcast_to(np.eye(2), (len(rows), 2, 2)) if affine is None else affine
        A = as_float_array(A, "affine", (len(rows), 2, 2))
        warps = np.concatenate([start - (A @ self.offset[rows][..., None])[..., 0], A.reshape(-1, 4)], axis=1)
        return self.interpret(self.run(current, rows, warps, max_iterations=max_iterations, executor=executor))

    def run(
        self,
        current: LumaArray,
        rows: IntArray,
        warps: FloatArray,
        *,
        max_iterations: int = 50,
        exact: bool = False,
        executor: Executor | None = None,
    ) -> RawRegistration:
        """Registrations without checks and covariances, for inner loops.

        Parameters
        ----------
        current
            Current image, shape (H, W).
        rows
            Row of the subset of each start, shape (K,).
        warps
            Starts: position of the centre [px], then the affine map row by row [1], shape (K, 6).
        max_iterations
            Gauss-Newton steps after which a registration has failed.
        exact
            Whether subsets that are strained hardly at all are sampled as such, too, at some cost: what light does to a
            subset may else lead back and forth between both ways of sampling, without an end.
        executor
            Threads that share the work; without them, it runs in this thread.
        """
        settings = (max_iterations, TOLERANCE_PX, _NEVER_RIGID if exact else RIGID_PX)
        return self._run_in_threads(register_subsets, settings, current, rows, warps, executor)

    def run_on_grid(
        self, current: LumaArray, rows: IntArray, warps: FloatArray, *, divisions: int, executor: Executor | None = None
    ) -> RawRegistration:
        """Translations only: the highest correlation on a grid, within a pixel of the start.

        Parameters
        ----------
        current
            Current image, shape (H, W).
        rows
            Row of the subset of each start, shape (K,).
        warps
            Starts, shape (K, 6), as in `run`; only the position [px] is used.
        divisions
            Number of grid steps in a pixel.
        executor
            Threads that share the work; without them, it runs in this thread.
        """
        return self._run_in_threads(correlate_on_grid, divisions, current, rows, warps, executor)

    def _run_in_threads(
        self,
        kernel: Callable[..., None],
        settings: object,
        current: LumaArray,
        rows: IntArray,
        warps: FloatArray,
        executor: Executor | None,
    ) -> RawRegistration:
        """A kernel's work on registrations, in as many threads as are worth it."""
        picture = _find_plane(current)
        warps = np.where(self.usable[rows][:, None], warps, np.nan)
        outcome = np.full((len(rows), 6), np.nan)
        outcome[:, :2] = FAILED, 0
        work = []
        for members, subsets in self.prepared:
            # One size is all registrations, which are then worked on where they stand.
            mine = slice(None) if len(members) == len(self) else np.flatnonzero(np.isin(rows, members))
            own = (np.searchsorted(members, rows[mine]), warps[mine], outcome[mine])
            work.append((mine, subsets[:6], own))

        def share(part: tuple[int, tuple[int, int]]) -> None:
            _, bank, own = work[part[0]]
            kernel(picture, bank, own, settings, part[1])

        shares = []
        for number, (_, _, own) in enumerate(work):
            count = len(own[0])
            parts = max(min(_PROCESSORS, count // _SHARE), 1) if executor is not None else 1
            shares += [(number, bound) for bound in pairwise(count * part // parts for part in range(parts + 1))]
        if executor is None or len(shares) < 2:
            for one in shares:
                share(one)
        else:
            list(executor.map(share, shares))
        for mine, _, own in work:
            warps[mine], outcome[mine] = own[1:]
        return RawRegistration(rows, warps, outcome)

    def position(self, rows: IntArray, warps: FloatArray) -> FloatArray:
        """Positions of the named points under warps, shape (K, 2) [px].

        Parameters
        ----------
        rows
            Row of the subset of each warp, shape (K,).
        warps
            Position of the centre [px], then the affine map row by row [1], shape (K, 6).
        """
        u, v = self.offset[rows].T
        t_u, t_v, a, b, c, d = warps.T
        return np.column_stack([t_u + a * u + b * v, t_v + c * u + d * v])

    def interpret(self, raw: RawRegistration) -> Registration:
        """Positions [px], covariances [px2] and outcome of K registrations.

        Parameters
        ----------
        raw
            Numbers of the kernel, shape (K, ...).
        """
        warps = np.where(raw.converged[:, None], raw.warps, np.nan)
        return Registration(
            position=self.position(raw.rows, warps),
            affine=warps[:, 2:].reshape(-1, 2, 2),
            covariance=self._noise.position_covariance(raw.rows, warps, raw.outcome[:, 3:]),
            correlation=raw.correlation,
            iterations=raw.outcome[:, 1].astype(np.int64),
            converged=raw.converged,
            outside=raw.outside,
        )

    @cached_property
    def edge_across(self) -> FloatArray:
        """Unit vectors across the edges, shape (P, 2) [1]; NaN for a subset that is none."""
        unknown = np.full(2, np.nan)
        designs = (None,) * len(self) if self.designs is None else self.designs
        across = [unknown if design is None else design.direction() for design in designs]
        return np.array(across).reshape(-1, 2)

    def hold_along_edges(self, rows: IntArray, centers: FloatArray) -> FloatArray:
        """Starts of registrations, moved along edges to where the subset lies in the reference image.

        Parameters
        ----------
        rows
            Row of the subset of each start, shape (K,).
        centers
            Starts of the subsets' centres, shape (K, 2) [px].

        Returns
        -------
        centers
            Shape (K, 2) [px]; as they are where a subset is no edge.
        """
        if self.designs is None:
            return centers
        home, across = self.centers[rows], self.edge_across[rows]
        moved = np.einsum("ki,ki->k", centers - home, across)
        return np.where(np.isfinite(across), home + moved[:, None] * across, centers)

    @cached_property
    def freedoms(self) -> IntArray:
        """Parameters of each warp that are allowed and that the texture determines, shape (P,); 0 where unusable."""
        found = np.zeros(len(self), np.int64)
        for members, subsets in self.prepared:
            found[members] = np.linalg.matrix_rank(subsets.matrices[:, 0], rtol=_RANK)
        return np.where(self.usable, found, 0)

    @cached_property
    def _noise(self) -> SubsetNoise:
        return SubsetNoise.of(self.subset_px, self.designs, self.prepared)


def register_subset(
    reference: LumaArray,
    current: LumaArray,
    points_reference: npt.ArrayLike,
    starts: Starts,
    *,
    subset_px: int = 41,
    max_iterations: int = 50,
) -> Registration:
    """Positions of a reference image's points in another image, by affine subset registration (IC-GN, ZNSSD).

    Parameters
    ----------
    reference, current
        The two images, shape (H, W), uint8 or uint16; sizes may differ.
    points_reference
        Points in the reference image, shape (P, 2) [px]; the same point may stand several times, with several starts.
    starts
        Starts in the current image, shapes (P, 2) [px] and (P, 2, 2) [1].
    subset_px
        Side of the subsets, odd [px].
    max_iterations
        Gauss-Newton steps after which a registration has failed.

    Raises
    ------
    DatasetError
        An image, the points or the starts are malformed.
    SessionError
        The size of the subset is even or too small.

    Notes
    -----
    `SubsetBank` does the same for many images against one reference.

    References
    ----------
    .. [1] Pan, B., Li, K., Tong, W. (2013). Fast, robust and accurate digital image correlation calculation without
       redundant computations. Experimental Mechanics 53(7), 1277-1289.
    .. [2] Baker, S., Matthews, I. (2004). Lucas-Kanade 20 years on: a unifying framework. International Journal of
       Computer Vision 56(3), 221-255.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter, shift
    >>> texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (80, 100)), 1.5)
    >>> first, second = (np.rint(128 + 200 * shift(texture, (0, u), order=5)).astype(np.uint8) for u in (0, 0.3))
    >>> found = register_subset(first, second, [[50.0, 40.0]], Starts([[50.0, 40.0]]), subset_px=31)
    >>> found.converged.tolist(), found.position.round(1).tolist()
    ([True], [[50.3, 40.0]])
    """
    points = as_float_array(points_reference, "points_reference", (None, 2))
    distinct, rows = np.unique(points, axis=0, return_inverse=True)
    with ThreadPoolExecutor(os.cpu_count() or 1) as executor:
        bank = SubsetBank.prepare(reference, distinct, subset_px=subset_px, moderate=False, executor=executor)
        return bank.register(
            current,
            starts.position,
            affine=starts.affine,
            rows=rows.reshape(-1),
            max_iterations=max_iterations,
            executor=executor,
        )


def check_luma(image: LumaArray, name: str) -> None:
    """Refuses what is not one image plane.

    Parameters
    ----------
    image
        The image, expected of shape (H, W) and of type uint8 or uint16.
    name
        Name of the image in the message.

    Raises
    ------
    DatasetError
        The image has another shape or type.

    Examples
    --------
    >>> check_luma(np.zeros((48, 64), np.uint8), "current")
    """
    if not (isinstance(image, np.ndarray) and image.ndim == 2 and image.dtype in (np.uint8, np.uint16)):
        found = f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise DatasetError(f"{name}: expected one plane (H, W) of uint8 or uint16, got {found}; convert the image")


def _find_plane(image: LumaArray) -> tuple[LumaArray, int]:
    """The image as one contiguous read-only array where that needs no copy, and the width of the picture in it.

    Decoders pad the lines; the whole buffer is passed then, so that the kernel is compiled for one kind of array and
    reads contiguous lines. Other layouts (rotated views) are passed as they are, and compiled for on first use.
    """
    rows, width = image.shape
    base = image.base
    padded = (
        isinstance(base, np.ndarray)
        and base.ndim == 2
        and base.dtype == image.dtype
        and base.flags.c_contiguous
        and base.strides == image.strides
        and base.ctypes.data == image.ctypes.data
        and base.shape[0] >= rows
    )
    plane = base[:rows] if padded and isinstance(base, np.ndarray) else image.view()
    plane.flags.writeable = False
    return plane, width
