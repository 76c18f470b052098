"""The first thing that went wrong in a measurement without a usable sample."""

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from vfm_sdm.core.datasets import Status
from vfm_sdm.core.statuses import CameraStatus, ClockStatus, PointStatus
from vfm_sdm.outputs.results.notes import describe_subsets, subset_notes
from vfm_sdm.stages.cameras.solution import CameraSolution

__all__ = ["first_cause"]

_KNOWN_CLOCK = (ClockStatus.OK, ClockStatus.STATED)


def first_cause(solution: CameraSolution, tracks: Mapping[str, xr.Dataset], displacement: xr.Dataset | None) -> str:
    """Why no sample is ok, in a sentence: the first fault on the way from recordings to displacement.

    Parameters
    ----------
    solution
        Cameras and points.
    tracks
        Tracks by view, shape (T, P, 2) [px].
    displacement
        Displacement dataset, shape (T, P, 3) [mm]; ``None`` where there is none.

    Returns
    -------
    sentence
        Empty where at least one sample is ok.
    """
    if displacement is not None and (displacement["status"] == Status.OK).any():
        return ""
    return next(_list_causes(solution, tracks, displacement))


def _list_causes(
    solution: CameraSolution, tracks: Mapping[str, xr.Dataset], displacement: xr.Dataset | None
) -> Iterator[str]:
    """Faults in the order of the way from recordings to displacement; at least one."""
    if solution.rig is None and len(tracks) > 1:
        yield f"cameras: {solution.status}" + "".join(f"; {note}" for note in solution.notes[-1:])
    # A place without texture in the view where a point was named is not found in the other views either.
    for followed in list(tracks.values())[:1]:
        if (subsets := describe_subsets(followed)) and all(
            row["status"] == PointStatus.NO_TEXTURE for row in subsets.values()
        ):
            yield f"points: none can be followed; {subset_notes(tracks)[0]}"
    found = solution.points["status"] == PointStatus.OK
    if len(tracks) > 1 and not (found.sum("view") >= 2).any():
        yield (
            "points: none was found in a second view; name their places there (pixel_in), or choose points that stand "
            "out in both views"
        )
    for view, followed in tracks.items():
        if not (followed["status"] == Status.OK).any():
            yield (
                f"tracking: every point was lost in view {view!r}; choose points with more texture, or a larger subset"
            )
    if displacement is not None and "clock_status" in displacement:
        for view, clock in zip(displacement["view"].values, displacement["clock_status"].values, strict=True):
            if str(clock) and clock not in _KNOWN_CLOCK:
                yield f"clocks: view {str(view)!r}: {clock}; state its time_offset_s, or film longer while it moves"
    if solution.status != CameraStatus.OK:
        yield f"cameras: {solution.status}"
    if displacement is None:
        yield "displacement: no length gives the scale; measure the baseline or a length between two points"
    codes = np.concatenate([np.ravel(followed["status"].values) for followed in tracks.values()])
    lost = float((codes != Status.OK).mean())
    yield f"tracking: {lost:.0%} of the samples are lost or unreliable, and no point is good in two views at one time"
