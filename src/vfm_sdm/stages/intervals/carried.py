"""What an interval takes over from those that were measured before it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.inputs.session import Session, View
from vfm_sdm.stages.camera_motion import ViewMotion

__all__ = ["Carried"]

_PAIR = 2
_DRIFT = 5e-5
"""How much two clocks of cameras may drift apart beyond what their rates were found to be [1]."""


@dataclass(frozen=True)
class _Clock:
    """A view's clock as it was found in an interval: offset (s.d.) at its beginning, and rate."""

    begin_s: float
    offset_s: float
    std_s: float
    rate: float


@dataclass(frozen=True, eq=False)
class Carried:
    """Where things are at rest, and how the clocks go, as intervals before told them.

    Displacement of an interval goes on where that of the others ended: cameras' motion is relative to the same pixels
    of the static points, and displacement to the same positions.

    Parameters
    ----------
    rest
        Pixels (2,) of static points with the cameras at rest, of cameras that move far of all points, by view and point
        [px].
    origin
        Positions that displacement is relative to (point, axis) [m, of a single view px], by ``unrefined`` and
        ``refined``.
    origin_covariance
        Their covariance (view, point, pixel_a, pixel_b) [px2]; ``None`` of a single view, and before any.
    clocks
        Clocks by view.
    disagreement
        How more than two views disagree (`vfm_sdm.stages.refinement.sightings.see_tracks`); empty of two.
    divided
        Whether there are several intervals.
    """

    rest: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    origin: Mapping[str, xr.DataArray] = field(default_factory=dict)
    origin_covariance: xr.DataArray | None = None
    clocks: Mapping[str, _Clock] = field(default_factory=dict)
    disagreement: xr.Dataset = field(default_factory=xr.Dataset)
    divided: bool = False

    def clock(self, session: Session, view: View, begin_s: float) -> tuple[float | None, float | None]:
        """Offset of a view, as `View.time_offset_s`, for an interval whose time begins with it, and its deviation [s].

        Parameters
        ----------
        session, view
            The session of the whole recording, and one of its views.
        begin_s
            Beginning of the interval [s].
        """
        if view.name not in self.clocks:
            stated_s = session.stated_offset_s(view)
            own_s = None if stated_s is None else stated_s - session.later_use_s(view)
            return own_s, view.time_offset_std_s
        known = self.clocks[view.name]
        apart_s = begin_s - known.begin_s
        offset_s = known.offset_s + (known.rate - 1) * apart_s - session.later_use_s(view)
        return offset_s, float(np.hypot(known.std_s, _DRIFT * apart_s))

    def put_into(self, aligned: xr.Dataset, refined: bool = False) -> xr.Dataset:
        """Synchronised tracks with the origin that is known of their points.

        Parameters
        ----------
        aligned
            Tracks, shape (V, T, P, 2) [px], or of a single view, with ``origin_covariance`` where it is known.
        refined
            Whether the origin is that of refined displacement.
        """
        if self.divided and aligned.sizes.get("view", 0) > _PAIR:
            # The positions that the views give together go on when one of them is lost later.
            aligned = aligned.assign({**_unknown_disagreement(aligned), **self.disagreement})
        known = self.origin.get("refined" if refined else "unrefined")
        if known is None:
            return aligned
        aligned = aligned.assign(origin=known)
        if self.origin_covariance is None or "origin_covariance" not in aligned:
            return aligned
        found = aligned["origin_covariance"]
        kept = self.origin_covariance.where(known.notnull().all("axis"), found)
        return aligned.assign(origin_covariance=kept.transpose(*found.dims).assign_attrs(found.attrs))

    def after(
        self,
        begin_s: float,
        motions: Mapping[str, ViewMotion],
        aligned: xr.Dataset | None,
        unrefined: xr.Dataset,
        refined: xr.Dataset,
    ) -> "Carried":
        """What is known when one more interval was measured.

        Parameters
        ----------
        begin_s
            Its beginning [s].
        motions
            Motion of its cameras by view.
        aligned
            Its synchronised tracks, shape (V, T, P, 2) [px], of `put_into`; ``None`` of a single view.
        unrefined, refined
            Its displacement, shape (T, P, 3) [mm], before and after refinement.
        """
        rest = {view: {**self._rest_of(motion), **self.rest.get(view, {})} for view, motion in motions.items()}
        found = {"unrefined": unrefined["origin"], "refined": refined["origin"]}
        origin = {name: self.origin[name].fillna(one) if self.origin else one for name, one in found.items()}
        now = replace(self, rest={**self.rest, **rest}, origin=origin, disagreement=self._disagree(unrefined))
        if aligned is None:
            return now
        clocks = {**self.clocks, **_read_clocks(begin_s, aligned)}
        return replace(now, origin_covariance=aligned["origin_covariance"], clocks=clocks)

    def _disagree(self, unrefined: xr.Dataset) -> xr.Dataset:
        """Disagreement of the views, of those that saw a point before as it was then."""
        names = ["view_shift", "view_shift_covariance", "view_shift_known"]
        if names[0] not in unrefined:
            return self.disagreement
        found = xr.Dataset({name: unrefined[name] for name in names})
        if not self.disagreement.data_vars:
            return found
        before = self.disagreement["view_shift_known"] > 0
        return xr.Dataset({name: self.disagreement[name].where(before, found[name]) for name in names})

    def _rest_of(self, motion: ViewMotion) -> dict[str, FloatArray]:
        # Where a camera moves far, nothing but its first frame tells where points are that come to rest elsewhere.
        return {**motion.places, **dict(zip(motion.static, motion.rest, strict=True))}


def _unknown_disagreement(aligned: xr.Dataset) -> dict[str, tuple[tuple[str, ...], FloatArray]]:
    """Variables of `see_tracks` that say that no view's disagreement is known."""
    views, points = aligned.sizes["view"], aligned.sizes["point"]
    return {
        "view_shift": (("view", "point", "pixel"), np.zeros((views, points, 2))),
        "view_shift_covariance": (("view", "point", "pixel_a", "pixel_b"), np.zeros((views, points, 2, 2))),
        "view_shift_known": (("view", "point"), np.zeros((views, points))),
    }


def _read_clocks(begin_s: float, aligned: xr.Dataset) -> dict[str, _Clock]:
    """Clocks of the views whose offset is known."""
    names = [str(view) for view in aligned["view"].values]
    columns = (aligned[name].values.tolist() for name in ("clock_offset", "clock_offset_std", "clock_rate"))
    rows = zip(names[1:], *(column[1:] for column in columns), strict=True)
    return {view: _Clock(begin_s, offset, std, rate) for view, offset, std, rate in rows if np.isfinite(std)}
