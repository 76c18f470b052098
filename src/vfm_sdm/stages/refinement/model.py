"""Settings and result of the structural geometry refinement."""

from dataclasses import dataclass, field

import xarray as xr

from vfm_sdm.core.arrays import FloatArray, IntArray
from vfm_sdm.core.datasets import STRUCTURE_AXES
from vfm_sdm.core.statuses import RefinementStatus
from vfm_sdm.errors import DatasetError
from vfm_sdm.stages.refinement.objective import SgrWeights

__all__ = ["REFINEMENT_STATUSES", "Refinement", "SgrSettings"]

REFINEMENT_STATUSES = tuple(str(status) for status in RefinementStatus)
"""What became of a point; with every status but "ok" its tracks are returned unchanged."""


@dataclass(frozen=True)
class SgrSettings:
    """Settings of the refinement.

    Parameters
    ----------
    weights
        Weights of the five terms.
    suppressed_axis
        The structural axis along which hardly any motion is expected: longitudinal for bridges, vertical for towers.
    uncertain_view
        Name or index of the view to refine, or ``"auto"``: for each point, the view with the larger median standard
        deviation of u over the frames; of more than two, the one whose correction leaves the least error along the
        other axes.
    poor_std_px
        A view whose median standard deviation of u is above this cannot be the reference [px]. Half a pixel is ten
        times what tracking a textured surface leaves, and more than the motion that is usually looked for.
    max_iterations
        Gauss-Newton steps before a point counts as not converged.

    Raises
    ------
    DatasetError
        The axis is unknown, or a limit is not positive.
    """

    weights: SgrWeights = field(default_factory=SgrWeights)
    suppressed_axis: str = "longitudinal"
    uncertain_view: str | int = "auto"
    poor_std_px: float = 0.5
    max_iterations: int = 30

    def __post_init__(self) -> None:
        if self.suppressed_axis not in STRUCTURE_AXES:
            raise DatasetError(
                f"suppressed axis: expected one of {list(STRUCTURE_AXES)}, got {self.suppressed_axis!r}; correct it"
            )
        if not (self.poor_std_px > 0 and self.max_iterations > 0):
            raise DatasetError(
                f"refinement: expected poor_std_px and max_iterations > 0, got {self.poor_std_px} and "
                f"{self.max_iterations}; raise them"
            )


@dataclass(frozen=True, eq=False)
class Refinement:
    """Refined tracks of P points in T frames, and what is known of the refinement.

    Parameters
    ----------
    tracks
        As given, with u of the uncertain view corrected; the covariances are still those of the tracker. Of more than
        two views, ``refined_view`` (on ``point``) names it, empty for a point that is not ``ok``.
    correction_px
        What was added to u, shape (T, P) [px]; zero for a point that is not ``ok``, NaN where a sample is missing, or
        seen by other views only, and then as these give it.
    uncertain_view
        The refined view of each point; ``None`` where none was chosen.
    reference_views
        The views that it was refined against, for each point: the other one, or all others that see the point.
    status
        One of `REFINEMENT_STATUSES` for each point.
    cost
        Objective at the minimum, shape (P,) [1]; NaN where not ``ok``.
    iterations
        Steps until the minimum, shape (P,).
    prior_share
        Share of the information of the refined coordinate u about depth that the assumption replaced, shape (P,) [1],
        from 0 (images only) to 1 (assumption only); NaN where not ``ok``.
    gain
        Refined displacement along structural axis a from true motion along axis b, shape (P, 3, 3) [1]; NaN where not
        ``ok``.

    Notes
    -----
    A correction of u moves a point along one direction ``g = dX/du``, of two views nearly the other's ray. In the
    linearised problem the answer to a baseline displacement ``z`` along the suppressed axis is ``-S(f) z g / g_z``,
    with the share ``S(f) = g_z^2 h_z / (g_z^2 h_z + g_x^2 h_xy + g_y^2 h_xy + w)``, where ``h = level + 4 rate
    sin^2(pi f)`` are the normalised weights at the frequency f [1/frame] and w that of the pixel. ``prior_share`` is
    the mean of S over all frequencies up to Nyquist's; ``gain`` is ``I - S g e_z^T / g_z``: motion along the other
    axes passes unchanged, motion along the suppressed axis is mostly removed and leaks into the others.
    """

    tracks: xr.Dataset
    correction_px: FloatArray
    uncertain_view: tuple[str | None, ...]
    reference_views: tuple[tuple[str, ...], ...]
    status: tuple[str, ...]
    cost: FloatArray
    iterations: IntArray
    prior_share: FloatArray
    gain: FloatArray
