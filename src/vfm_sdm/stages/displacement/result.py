"""Result of a measurement: displacement with its uncertainty, and the facts that later stages need beside it."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import START, Status
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.camera_motion import ViewMotion
from vfm_sdm.stages.displacement.agreement import compute_gain_difference
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty
from vfm_sdm.stages.refinement import Refinement

__all__ = ["INJECTED", "add_facts", "state_uncertainty"]

INJECTED = ("injected_gain", "injected_gain_std", "injected_noise", "injected_direction", "injection_status")
"""Variables on view and point that tell of motion put into the recordings."""


def state_uncertainty(
    displacement: xr.Dataset,
    unrefined: xr.Dataset,
    aligned: xr.Dataset,
    cameras: tuple[Rig, StructureFrame | None],
    refinement: Refinement | None,
    suppressed_axis: str,
) -> xr.Dataset:
    """Displacement with the uncertainty budget of every sample, and the difference between the views.

    Parameters
    ----------
    displacement
        The result, refined or not, shape (T, P, 3) [mm].
    unrefined
        Displacement as the images alone give it, shape (T, P, 3) [mm]; the same where nothing was refined.
    aligned
        Synchronised tracks before any refinement, shape (V, T, P, 2) [px], with each view's clock and bits a pixel
        (`vfm_sdm.stages.synchronize.synchronize_tracks`).
    cameras
        Metric cameras and the structure's axes.
    refinement, suppressed_axis
        Result of the refinement, ``None`` without one, and the axis along which motion was assumed to be small.

    Returns
    -------
    displacement
        With the variables of `add_uncertainty`, and on ``point`` the ``gain_difference`` [1] between the views.
    """
    rig, frame = cameras
    views = [str(name) for name in aligned["view"].values]
    difference = compute_gain_difference(aligned, unrefined, rig, frame)
    inputs = BudgetInputs(
        aligned,
        clock_std_s=dict(zip(views[1:], aligned["clock_offset_std"].values[1:].tolist(), strict=True)),
        bits_per_pixel=dict(zip(views, aligned["bits_per_pixel"].values.tolist(), strict=True)),
        gain_difference=difference,
        baseline=None if refinement is None else (unrefined, suppressed_axis),
        refinement_gain=None if refinement is None else refinement.gain,
    )
    return add_uncertainty(displacement, inputs).assign(gain_difference=("point", difference, {"units": "1"}))


def add_facts(
    displacement: xr.Dataset,
    aligned: xr.Dataset,
    motions: Mapping[str, ViewMotion],
    refinement: Refinement | None,
    points: xr.Dataset,
) -> xr.Dataset:
    """Displacement with the facts about each view and point; samples are unreliable where a view's clock is unknown.

    Parameters
    ----------
    displacement
        The result with its budget, shape (T, P, 3) [mm].
    aligned
        Synchronised tracks with each view's clock, shape (V, T, P, 2) [px].
    motions
        Motion of the cameras by view; empty where it was not looked for.
    refinement
        Result of the refinement; ``None`` without one.
    points
        Points dataset, shape (V, P, 2) [px], with ``grid`` (point) where there are grids.

    Returns
    -------
    displacement
        With, on ``view``, ``clock_offset`` [s], ``clock_offset_std`` [s], ``clock_rate`` [1], ``clock_status``,
        ``clock_use`` (view, point), ``camera_motion_before`` and ``camera_motion_after`` [px] (root mean square shift
        of the static points) and ``camera_motion_status``; what injected motion showed, on view and point (`INJECTED`);
        on ``point`` the ``grid`` that it belongs to, where there is one;
        and of a refinement ``refinement_correction`` (time, point) [px], and on ``point`` ``prior_share`` [1],
        ``refinement_status`` and ``refined_view``; of more than two views also
        ``reference_views``, those that it was refined against. The attribute ``time_coverage_start`` where it is known.
    """
    facts = {
        name: aligned[name] for name in ("clock_offset", "clock_offset_std", "clock_rate", "clock_status", "clock_use")
    }
    facts |= {name: aligned[name] for name in INJECTED if name in aligned}
    displacement = displacement.assign(facts).assign_attrs({k: v for k, v in aligned.attrs.items() if k == START})
    if "grid" in points:
        displacement = displacement.assign(grid=points["grid"])
    if motions:
        chosen = [motions[str(view)] for view in displacement["view"].values]
        displacement = displacement.assign(
            camera_motion_before=("view", [m.rms_before_px for m in chosen], {"units": "px"}),
            camera_motion_after=("view", [m.rms_after_px for m in chosen], {"units": "px"}),
            camera_motion_status=("view", np.array([str(m.status) for m in chosen], dtype=object)),
        )
    if not np.isfinite(aligned["clock_offset_std"].values).all():
        codes = displacement["status"]
        displacement["status"] = codes.where(codes != Status.OK, np.int8(Status.UNRELIABLE)).assign_attrs(codes.attrs)
    if refinement is not None:
        views = [view or "" for view in refinement.uncertain_view]
        displacement = displacement.assign(
            refinement_correction=(("time", "point"), refinement.correction_px, {"units": "px"}),
            prior_share=("point", refinement.prior_share, {"units": "1"}),
            refinement_status=("point", np.array([str(status) for status in refinement.status], dtype=object)),
            refined_view=("point", np.array(views, dtype=object)),
        )
        if displacement.sizes["view"] > 2:
            others = [", ".join(names) for names in refinement.reference_views]
            displacement = displacement.assign(reference_views=("point", np.array(others, dtype=object)))
    return displacement
