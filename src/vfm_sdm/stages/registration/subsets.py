"""Subsets of a reference image, prepared once and registered to many other images."""

import os
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray, LumaArray, as_float_array
from vfm_sdm.errors import DatasetError, SessionError
from vfm_sdm.stages.registration.kernels import correlate_on_grid, register_subsets
from vfm_sdm.stages.registration.records import RawRegistration, Registration, Starts
from vfm_sdm.stages.registration.reference_subsets import ReferenceSubsets, interpolation_noise, prepare_subsets

__all__ = [
    "RawRegistration",
    "Registration",
    "Starts",
    "SubsetBank",
    "check_luma",
    "check_subset_px",
    "register_subset",
]

TOLERANCE_PX = 1e-4
"""Distance to the minimum below which a registration has converged (RMS over the subset, from how the steps shrink):
a small part of the scatter that any noise gives."""
RIGID_PX = 0.15
"""Largest displacement of a pixel by the warp's linear part that is left to the linearisation."""

_SHARE = 16  # fewest registrations worth a thread of their own
_PARAMETERS = 8  # six of the warp, gain and bias: degrees of freedom that a registration takes


@dataclass(frozen=True, eq=False)
class SubsetBank:
    """Square subsets of a reference image with everything that their registration needs; made by `prepare`.

    Parameters
    ----------
    points
        Named points in the reference image, shape (P, 2) [px].
    centers
        Pixels nearest to the points, which are the centres of the subsets, shape (P, 2) [px].
    subset_px
        Side of the subsets, odd [px].
    inside
        Whether the subset lies inside the reference image, shape (P,).
    usable
        Whether, in addition, its texture fixes all parameters of the warp, shape (P,).
    prepared
        Gradients and matrices.

    Notes
    -----
    A subset is centred on the pixel nearest to its point, and the sub-pixel rest is carried as an offset through the
    warp. Sampling the reference between the pixels would do the same in principle, but interpolated noise and its
    derivative are correlated at a general phase, which pulls the estimate (at a quarter pixel and 1 % noise by
    0.004 px on a good texture, by 0.03 px on a weak one); at the samples they are not.
    """

    points: FloatArray
    centers: IntArray
    subset_px: int
    inside: BoolArray
    usable: BoolArray
    prepared: ReferenceSubsets

    @classmethod
    def prepare(
        cls,
        reference: LumaArray,
        points: npt.ArrayLike,
        *,
        subset_px: int = 41,
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
            Side of the subsets, odd [px].
        executor
            Threads that share the work; without them, it runs in this thread.

        Raises
        ------
        DatasetError
            The image or the points are malformed.
        SessionError
            The size of the subset is even or too small.
        """
        check_luma(reference, "reference")
        half = check_subset_px(subset_px, "subset_px") // 2
        points2d = as_float_array(points, "points", (None, 2))
        if not np.isfinite(points2d).all():
            raise DatasetError("points: expected finite pixels, got NaN or infinity; name points in the reference")
        centers = np.floor(points2d + 0.5).astype(np.int64)
        limit = np.array(reference.shape[::-1]) - 1
        inside = np.all((centers >= half) & (centers <= limit - half), axis=1)
        safe = np.where(inside[:, None], centers, half)
        prepared = prepare_subsets(reference, safe, points2d - centers, half, executor=executor)
        return cls(points2d, centers, subset_px, inside, inside & prepared.usable, prepared)

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
        executor
            Threads that share the work; without them, it runs in this thread.
        """
        settings = (max_iterations, TOLERANCE_PX, RIGID_PX)
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
        outcome = np.full((len(rows), 5), np.nan)

        def share(bounds: tuple[int, int]) -> None:
            kernel(picture, self.prepared[:4], (rows, warps, outcome), settings, bounds)

        parts = min(os.cpu_count() or 1, len(rows) // _SHARE) if executor is not None else 1
        if executor is None or parts < 2:
            share((0, len(rows)))
        else:
            bounds = np.linspace(0, len(rows), parts + 1).round().astype(int).tolist()
            list(executor.map(share, pairwise(bounds)))
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
            covariance=self._covariance(raw.rows, warps, raw.outcome[:, 3], raw.outcome[:, 4]),
            correlation=raw.correlation,
            iterations=raw.outcome[:, 1].astype(np.int64),
            converged=raw.converged,
            outside=raw.outside,
        )

    def _covariance(self, rows: IntArray, warps: FloatArray, residual: FloatArray, gain: FloatArray) -> FloatArray:
        """Covariance of the positions, shape (K, 2, 2) [px2]; derived in `vfm_sdm.stages.tracking.icgn.IcgnTracker`."""
        A = warps[:, 2:].reshape(-1, 2, 2)
        table = interpolation_noise()
        fraction = warps[:, :2] - np.floor(warps[:, :2])
        kept = np.interp(fraction, np.linspace(0, 1, len(table)), table).prod(axis=1)
        bending = np.abs(A - np.eye(2)).sum(axis=2).max(axis=1) * (self.subset_px // 2)
        # A bent grid meets all fractions at once.
        kept = np.where(bending > RIGID_PX, table[:-1].mean() ** 2, kept)
        pixels = self.subset_px**2
        contrast = self.prepared.moments[rows, 0] / pixels
        signal = np.ones(len(rows))  # share of the template's variance that is not noise; it draws the gain towards 0
        for _ in range(2):
            variance = residual / ((pixels - _PARAMETERS) * (kept + gain**2 / signal))
            signal = np.maximum(1 - variance / np.where(contrast > 0, contrast, 1), 0.1)
        gain2 = (gain / signal) ** 2
        inflation = _invert_two_by_two(np.eye(2) - variance[:, None, None] * self.prepared.noise_share[rows])
        effective = variance * (1 + gain2) / gain2
        spread = A @ inflation
        unit = spread @ self.prepared.unit_covariance[rows] @ spread.swapaxes(1, 2)
        return np.asarray(effective[:, None, None] * unit)


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
        bank = SubsetBank.prepare(reference, distinct, subset_px=subset_px, executor=executor)
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


def check_subset_px(subset_px: int, name: str) -> int:
    """The side of a subset [px], after checking it.

    Parameters
    ----------
    subset_px
        Side of the subset [px].
    name
        Name of the setting in the message.

    Raises
    ------
    SessionError
        The side is even or below 9 px.

    Examples
    --------
    >>> check_subset_px(41, "subset_px")
    41
    """
    if subset_px < 9 or subset_px % 2 == 0:
        raise SessionError(f"{name}: expected an odd number of at least 9 pixels, got {subset_px}; use 41")
    return subset_px


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
