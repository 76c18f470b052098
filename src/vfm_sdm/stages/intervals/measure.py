"""The intervals of a long recording, measured one after the other."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

from vfm_sdm.core.allocator import return_free_memory
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.inputs.session import Session
from vfm_sdm.stages.audit import Audit
from vfm_sdm.stages.camera_motion import ViewMotion
from vfm_sdm.stages.intervals.carried import Carried
from vfm_sdm.stages.intervals.division import divide_tracks
from vfm_sdm.stages.intervals.join import JoinedDisplacement
from vfm_sdm.stages.intervals.verdicts import join_audits

__all__ = ["MeasuredInterval", "measure_intervals"]


@dataclass(frozen=True, eq=False)
class MeasuredInterval:
    """Products of one interval.

    Parameters
    ----------
    motions
        Motion of its cameras by view.
    aligned
        Its synchronised tracks, shape (V, T, P, 2) [px]; ``None`` of a single view.
    unrefined, displacement
        Its displacement, shape (T, P, 3) [mm], before and after refinement.
    audit
        Its audit.
    """

    motions: Mapping[str, ViewMotion]
    aligned: xr.Dataset | None
    unrefined: xr.Dataset
    displacement: xr.Dataset
    audit: Audit


def measure_intervals(
    tracks: Mapping[str, xr.Dataset],
    session: Session,
    measure: Callable[[Session, Mapping[str, xr.Dataset], Carried], MeasuredInterval],
    *,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> tuple[xr.Dataset, Audit] | None:
    """Displacement and audit of a long recording, of those of its intervals; ``None`` where it is no longer than one.

    Parameters
    ----------
    tracks
        Tracks by view, shape (T, P, 2) [px], each on its own clock, the reference view's first.
    session
        The session, with ``method.interval_s``.
    measure
        Measures a recording of these tracks, which go on from others.
    folder
        Where the displacement lies as long as it is needed; the folder for temporary files when ``None``.
    progress
        Called with the number of intervals done.

    Raises
    ------
    DatasetError
        No frame lies in the still interval, or no interval has frames of all views.

    Notes
    -----
    Memory is that of one interval, and clocks, noise and the audit are its own. Where the session names a still
    interval, what holds it is measured first: its mean is the origin of all, also of what was before.
    """
    intervals = divide_tracks(next(iter(tracks.values())), session)
    if len(intervals) < 2:
        return None
    still, carried = session.method.still_interval_s, Carried(divided=True)
    ahead = [one for one in intervals if still is not None and one.holds(still[0])]
    joined, audits = JoinedDisplacement(folder), []
    for number, interval in enumerate([*ahead, *intervals]):
        if progress is not None:
            progress("intervals", number, len(ahead) + len(intervals))
        cut = interval.cut(tracks, session, carried)
        if cut is None:
            continue
        found = measure(interval.session(session, carried), cut, carried)
        carried = carried.after(interval.begin_s, found.motions, found.aligned, found.unrefined, found.displacement)
        if number >= len(ahead):
            joined.append(interval, found.displacement)
            audits.append((interval, found.audit))
        del found, cut
        return_free_memory()
    moving, static = ([p.name for p in session.point if p.static == wanted] for wanted in (False, True))
    audit = join_audits(audits, joined.facts(), moving, static)
    whole = joined.finish([one.verdict == Verdict.REFUSED for one in audit.intervals])
    if still is not None:
        whole.attrs["relative_to"] = "mean of the still interval"
    return whole, audit
