"""Designs of a subset tried on the sample frames: what they state, and what halves of them show."""

from dataclasses import dataclass, field, replace

import numpy as np

from vfm_sdm.core.arrays import MAD_TO_STD, BoolArray, FloatArray, LumaArray
from vfm_sdm.stages.registration.designs import FEWEST_BELIEVED_PX, SubsetDesign, Warp
from vfm_sdm.stages.registration.records import Registration
from vfm_sdm.stages.registration.subsets import SubsetBank

__all__ = ["Trial"]

_FAILED = 0.2
"""Largest share of the sample frames in which a warp may fail to converge."""
_LEAST_FRAMES = 4
_SEEN = 1e-2
"""Rotation and strain below this are not told from what a codec makes of a square (0.3 px over 30 px) [1]."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Registration of one point's subsets to the sample frames.

    Parameters
    ----------
    frames
        The window [v, u] around the point in the reference frame and in K sample frames, shape (K + 1, R, R).
    offset
        Vector from the middle pixel to the point, shape (2,) [px].
    motion
        Motion of the point in each sample frame, shape (K, 2) [px], from which registrations start.
    orders
        Warps to choose from, from the least to the most.
    """

    frames: LumaArray
    offset: FloatArray
    motion: FloatArray
    orders: tuple[Warp, ...]
    _known: dict[tuple[object, ...], list[Registration]] = field(default_factory=dict, init=False, repr=False)

    def covariance(self, design: SubsetDesign) -> FloatArray | None:
        """What one frame's registration states, the middle of all, shape (2, 2) [px2]; ``None`` where it fails.

        Parameters
        ----------
        design
            The subset.
        """
        stated = np.stack([one.covariance[0] for one in self._register([design])])
        known = np.isfinite(stated).all(axis=(1, 2))
        return None if np.mean(known) < 1 - _FAILED else np.median(stated[known], axis=0)

    def spread(self, design: SubsetDesign) -> FloatArray:
        """Variance of two halves of a subset against each other, over 16, shape (2, 2) [px2].

        Were their errors independent, a quarter of it would be the variance of the whole. Halves lose themselves more
        easily than the whole, so half of that standard deviation is taken for certain: a shadow that moves, a codec's
        blocks or a second motion let them disagree by more than the noise of their pixels. Zero where a half is too
        small.

        Parameters
        ----------
        design
            The subset.

        Notes
        -----
        Each half is two opposite quarters of the square: both then have the same middle, so that a rotation does not
        move them apart, and an edge through the middle runs through both.
        """
        side = np.arange(design.subset_px) < design.subset_px // 2
        opposite = side[:, None] == side[None, :]
        whole = np.ones(opposite.shape, np.bool_) if design.mask is None else design.mask
        masks = [whole & opposite, whole & ~opposite]
        if min(np.count_nonzero(mask) for mask in masks) < FEWEST_BELIEVED_PX:
            return np.zeros((2, 2))
        warp = Warp.EDGE if design.warp == Warp.EDGE else Warp.TRANSLATION
        halves = [replace(design, warp=warp, mask=mask, omitted_std=0.0) for mask in masks]
        apart = np.stack([one.position[0] - one.position[1] for one in self._register(halves)])
        known = np.isfinite(apart).all(axis=1)
        if np.count_nonzero(known) < _LEAST_FRAMES:
            return np.zeros((2, 2))
        # The middle of the squares: a half that has little texture loses itself in some frames.
        std = MAD_TO_STD * np.median(np.abs(apart[known]), axis=0) / 4
        return np.diag(std**2)

    def linear_std(self, size: int, mask: BoolArray, shading: int = 0) -> float:
        """Rotation and strain that are seen in the frames, as one number for all elements [1]; 0 where none are.

        Parameters
        ----------
        size
            Side of the square [px].
        mask
            Its believed pixels, shape (S, S).
        shading
            Degree of the surface of brightness that may come and go.
        """
        design = SubsetDesign(size, Warp.AFFINE, None, mask, shading=shading)
        found = self._register([design])
        linear = np.stack([one.affine[0] - np.eye(2) for one in found])
        variance = np.array([np.trace(one.covariance[0]) / 2 for one in found])
        known = np.isfinite(variance) & np.isfinite(linear).all(axis=(1, 2))
        if np.count_nonzero(known) < _LEAST_FRAMES:
            return 0.0
        # Texture that is spread evenly over a square of side S tells a slope to sqrt(12) / S of what it tells a place.
        place = max(float(np.median(variance[known])), 4 * float(np.diag(self.spread(design)).max()))
        seen = float(np.median(np.mean(linear[known] ** 2, axis=(1, 2))))
        excess = float(np.sqrt(max(seen - 4 * 12 / size**2 * place, 0.0)))
        return excess if excess > _SEEN else 0.0

    def _register(self, designs: list[SubsetDesign]) -> list[Registration]:
        """Registrations of all designs in every sample frame, each made once."""
        key = tuple(part for design in designs for part in _identify(design))
        if key not in self._known:
            self._known[key] = self._register_anew(designs)
        return self._known[key]

    def _register_anew(self, designs: list[SubsetDesign]) -> list[Registration]:
        middle = self.frames.shape[1] // 2
        points = np.tile(middle + self.offset, (len(designs), 1))
        bank = SubsetBank.prepare(self.frames[0], points, designs=designs)
        rows = np.arange(len(designs))
        start = np.tile([middle, middle, 1.0, 0.0, 0.0, 1.0], (len(designs), 1))
        found = []
        for frame, motion in zip(self.frames[1:], self.motion, strict=True):
            moved = start.copy()
            moved[:, :2] += motion
            found.append(bank.interpret(bank.run(frame, rows, moved)))
        return found


def _identify(design: SubsetDesign) -> tuple[object, ...]:
    """What tells a design from others."""
    across, mask = (None if array is None else array.tobytes() for array in (design.across, design.mask))
    return design.subset_px, design.warp, across, mask, design.omitted_std, design.shading
