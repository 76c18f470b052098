"""One measurement: its products in the order of the paper's Figure 4, each made when it is first asked for.

Cameras (B), points and tracks (A), the camera motion taken out, one clock, refinement and displacement (C), and what is
said of them. Any product can be asked for alone; what it needs is made before it, and nothing else. With a run folder,
cameras and tracks whose inputs have not changed are read from it.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import xarray as xr

from vfm_sdm.analysis.fusion.scale import SensorScale, find_sensor_scale
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.files import file_hash
from vfm_sdm.core.products import product
from vfm_sdm.core.progress import Progress
from vfm_sdm.core.run_folder import SESSION, RunFolder
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.core.versions import package_versions
from vfm_sdm.errors import DatasetError
from vfm_sdm.inputs.session import (
    RecordedChain,
    Session,
    input_files,
    write_session,
)
from vfm_sdm.outputs.plots import describe_run, first_places, save_figures, save_later_points
from vfm_sdm.outputs.results import describe_measurement
from vfm_sdm.outputs.results.kept import CAMERAS, DISPLACEMENT, INJECTION, POINTS, REVISIT, TRACKS
from vfm_sdm.stages.audit import Audit, AuditInputs, audit
from vfm_sdm.stages.camera_motion import CameraMotion, follow_depths, steady_tracks
from vfm_sdm.stages.cameras.grid import add_grids
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.cameras.solve import solve_cameras
from vfm_sdm.stages.displacement.monocular import measure_planar
from vfm_sdm.stages.displacement.origin import include_origin
from vfm_sdm.stages.displacement.result import add_facts, state_uncertainty
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.intervals import Carried, MeasuredInterval, measure_intervals
from vfm_sdm.stages.refinement import Refinement, refine, sgr_settings
from vfm_sdm.stages.revisit import Revisit, Visit, compare_to_baseline
from vfm_sdm.stages.synchronize import synchronize_tracks
from vfm_sdm.stages.tracking.base import DesignedTracker, check_later_points
from vfm_sdm.stages.tracking.injection.views import correct_tracks, inject_views
from vfm_sdm.stages.tracking.segments import Work
from vfm_sdm.stages.tracking.subset_design import SubsetChoice, SubsetDesigns, describe_subsets
from vfm_sdm.stages.tracking.track_noise import include_static_noise
from vfm_sdm.stages.tracking.views import is_whole, track_views

__all__ = ["Measurement", "measure"]


class Measurement(RecordedChain):
    """The products of one session, in a folder or in memory.

    Parameters
    ----------
    session
        What to measure.
    folder
        Run folder; ``None`` keeps everything in memory.
    progress
        Called with what is being done.
    whole_files
        Whether input files are told from others by their whole content; else large ones are by their size, time stamp
        and sampled blocks (`vfm_sdm.core.files.file_fingerprint`).
    executor
        Who tracks the segments of the recordings: processes, or a cluster; this process when ``None``. Results are the
        same.

    Attributes
    ----------
    session
        What is measured.

    Examples
    --------
    >>> Measurement.products()[:5]
    ('recordings', 'frames', 'reference_frames', 'sensor_scale', 'cameras')
    """

    def __init__(
        self,
        session: Session,
        folder: Path | str | None = None,
        *,
        progress: Progress | None = None,
        whole_files: bool = False,
        executor: Executor | None = None,
    ) -> None:
        super().__init__(session, None if folder is None else Path(folder), whole_files=whole_files)
        self.progress, self._executor = progress, executor
        self._designs = SubsetDesigns(self._say)

    # B and A: cameras, points in every view, tracks.

    @product(
        reads=("name", "view", "point", "site", "chessboard", "sensor", "method"),
        needs=("recordings", "frames", "reference_frames"),
        parts=("cameras", "matchers", "trackers"),
        # A sensor that is no length standard must not cost other cameras.
        identity=lambda scale: scale.as_table(),
    )
    def sensor_scale(self, session: Session) -> SensorScale:
        """What accelerometers say of the size of motions, by a first measurement in any scale; of most, nothing."""
        return find_sensor_scale(session, self._measure_first)

    @product(
        reads=(
            *("view.name", "view.images", "view.lens", "view.camera", "view.level", "view.stands"),
            *("view.perpendicular_distance", "view.longitudinal_distance"),
            *("point.name", "point.view", "point.pixel", "point.pixel_in", "point.static"),
            *("site", "chessboard", "method.subset_px"),
        ),
        needs=("frames", "reference_frames", "sensor_scale"),
        parts=("cameras", "matchers"),
        kept=CAMERAS,
    )
    def cameras(self, session: Session) -> CameraSolution:
        """Cameras, structural axes, and the points' pixels that helped to adjust them to the site."""
        self._say("cameras")
        scale, late = self.sensor_scale, self.reference_frames
        parts = self.part("cameras"), self.part("matchers")
        solved = solve_cameras(scale.put_into(session), self.frames, parts[0], matcher=parts[1], reference_frames=late)
        return scale.judge(solved)

    @product(
        reads=("grid", "site", "view.name", "method.subset_px"),
        needs=("cameras", "frames"),
        kept=POINTS,
        # A better lens must not cost another pass over the recordings where it leaves the points as they are.
        identity=lambda points: points.to_dict(),
    )
    def points(self, session: Session) -> xr.Dataset:
        """Pixels of every point in every view, in its first frame or in the one in which it is named."""
        return add_grids(session, self.cameras, self.frames if session.grid else {})

    @product(
        reads=("point.name", "point.view", "point.pixel", "point.pixel_in"),
        needs=("recordings", "reference_frames"),
        parts=("trackers",),
    )
    def expectation(self, session: Session) -> dict[str, xr.Dataset]:
        """What named pixels should measure and how well, by view, before anything else is known of them."""
        named: dict[str, dict[str, FloatArray]] = {}
        for point in session.point:
            for view, pixel in {point.view: point.pixel, **point.pixel_in}.items():
                named.setdefault(view, {})[point.name] = np.array(pixel)
        size, late = session.method.subset_px, self.reference_frames
        chosen = {view: self._choose(view, places, size, late.get(view, {})) for view, places in named.items()}
        return {view: describe_subsets(list(of), list(of.values())) for view, of in chosen.items()}

    @product(needs=("recordings", "points"), parts=("trackers",))
    def subsets(self, session: Session) -> dict[str, dict[str, SubsetChoice]]:
        """What the subset of every point compares, by view and point; empty for trackers that compare none."""
        if not isinstance(self.part("trackers"), DesignedTracker):
            return {}
        return self._designs.choose_all(self.recordings, self.points, session.method.subset_px)

    @product(
        reads=("method.segment_s",),
        needs=("recordings", "points", "subsets"),
        parts=("trackers",),
        kept=TRACKS,
        label="tracking",
    )
    def tracks(self, session: Session) -> dict[str, xr.Dataset]:
        """Tracks of all points by view, each on its own clock."""
        tracker = self.part("trackers")
        work = Work(session.method.segment_s, self._executor, self.pieces(), self.folder)
        return track_views(self.recordings, self.points, tracker, subsets=self.subsets, progress=self._say, work=work)

    @product(
        reads=("method.injection",),
        needs=("recordings", "tracks", "subsets"),
        parts=("trackers",),
        kept=INJECTION,
    )
    def injection(self, session: Session) -> xr.Dataset | None:
        """Gain and noise of every point, by motion put into the recordings; ``None`` where not asked for."""
        if not session.method.injection or "tracks" in self.were_given:
            return None
        return inject_views(self.recordings, self.tracks, self.part("trackers"), self.subsets, progress=self._say)

    @product(needs=("tracks", "injection"))
    def injected(self, session: Session) -> dict[str, xr.Dataset]:
        """Tracks at their true size, where injection shows what is missing."""
        return correct_tracks(self.tracks, self.injection)

    # C: the cameras' own motion taken out, one clock, displacement; of a long recording interval by interval.

    @product(reads=("view", "point", "site", "method"), needs=("frames", "cameras", "points", "tracks", "injection"))
    def intervals(self, session: Session) -> tuple[xr.Dataset, Audit] | None:
        """Displacement and audit of a long recording, of those of its intervals; ``None`` of one that is one."""
        planar = len(session.view) == 1 and session.site.length
        if self.cameras.rig is None and not planar:
            return None
        tracks = {view.name: self.tracks[view.name] for view in session.view}
        return measure_intervals(tracks, session, self._measure_interval, folder=self.folder, progress=self._say)

    @product()
    def carried(self, session: Session) -> Carried:
        """What other intervals of a long recording told; nothing where it is measured as a whole."""
        return Carried()

    @product(reads=("point.name", "point.static", "method.camera_motion"), needs=("cameras", "injected", "carried"))
    def steady(self, session: Session) -> CameraMotion:
        """Tracks without the cameras' motion that static points show, and that motion; air adds to their covariance."""
        static = [p.name for p in session.point if p.static]
        asked, known = static * (session.method.camera_motion == "remove"), self.cameras
        found = steady_tracks(self.injected, known.rig, asked, self.carried.rest, known.place_std)
        return replace(found, tracks=include_static_noise(found.tracks, static))

    @product(
        reads=(
            *("view.name", "view.time_offset_s", "view.time_offset_std_s", "view.start", "view.use_s"),
            *("point.name", "point.static", "method.synchronization", "method.still_interval_s"),
        ),
        needs=("cameras", "steady", "carried"),
    )
    def aligned(self, session: Session) -> xr.Dataset:
        """Tracks of all views on the reference view's clock, what is known of each view's clock, and of the origin."""
        known = self.cameras.rig if self.cameras.status == CameraStatus.OK else None
        static = [p.name for p in session.point if p.static]
        found = follow_depths(synchronize_tracks(session, self.steady.tracks, known), self.cameras.rig)
        return self.carried.put_into(include_origin(found, static, session.method.still_interval_s))

    @product(reads=("method.refinement", "method.sgr", "method.still_interval_s"), needs=("cameras", "aligned"))
    def refinement(self, session: Session) -> Refinement | None:
        """Structural geometry refinement of the tracks; ``None`` where it was not asked for."""
        if session.method.refinement == "none" or self.cameras.rig is None:
            return None
        settings, still = sgr_settings(session.method.sgr), session.method.still_interval_s
        return refine(self.aligned, self.cameras.rig, self.cameras.frame, settings=settings, still_interval_s=still)

    @product(reads=("method.still_interval_s",), needs=("cameras", "points", "aligned"))
    def unrefined(self, session: Session) -> xr.Dataset | None:
        """Displacement as the images alone give it; ``None`` without cameras."""
        return self._triangulated(self.aligned, session) if self.cameras.rig is not None else None

    @product(
        reads=(
            *("view.name", "view.start", "view.use_s", "point.name", "point.pixel", "point.static", "site.length"),
            *("method.refinement", "method.sgr", "method.still_interval_s", "method.tracker", "method.cameras"),
        ),
        needs=("intervals", "cameras", "points", "injected", "steady", "aligned", "refinement", "unrefined", "carried"),
        kept=DISPLACEMENT,
    )
    def displacement(self, session: Session) -> xr.Dataset | None:
        """Displacement with its uncertainty; ``None`` without cameras or scale, as the cameras' status says.

        A single view gives motion in the image plane if a length between two of its points is known.
        """
        if self.intervals is not None:
            return self.intervals[0]
        rig = self.cameras.rig
        if rig is None and len(session.view) == 1 and session.site.length:
            return measure_planar(session, self.carried.put_into(self.injected[session.view[0].name]))
        if rig is None or self.unrefined is None:
            return None
        refined = self.unrefined
        if self.refinement is not None:
            tracks = self.carried.put_into(self.refinement.tracks, refined=True)
            refined = self._triangulated(tracks, session, self.refinement)
        method = session.method
        refined = refined.assign_attrs(
            camera_status=self.cameras.status,
            tracker=method.tracker,
            cameras=method.cameras,
            refinement=method.refinement,
        )
        stated = state_uncertainty(
            refined,
            self.unrefined,
            self.aligned,
            (rig, self.cameras.frame),
            self.refinement,
            method.sgr.suppressed_axis,
        )
        return add_facts(stated, self.aligned, self.steady.views, self.refinement, self.points)

    # What is said of it.

    @product(
        reads=("view", "point", "site", "method"),
        needs=("intervals", "frames", "cameras", "tracks", "steady", "aligned", "unrefined", "displacement"),
    )
    def audit(self, session: Session) -> Audit | None:
        """Checks and verdict, of a single view as far as it allows; ``None`` without displacement."""
        if self.displacement is None:
            return None
        if self.intervals is not None:
            return self.intervals[1]
        alone = self.displacement if self.unrefined is None else self.unrefined
        inputs = AuditInputs(
            session=session,
            cameras=self.cameras,
            tracks=self.tracks,
            aligned=self.aligned,
            displacement=self.displacement,
            unrefined=alone.assign(status=self.displacement["status"]),
            camera_motion=self.steady.views,
            frames=self.frames,
        )
        return audit(inputs)

    @product(
        reads=("baseline_visit", "point.name", "point.static", "method.subset_px", "method.still_interval_s"),
        needs=("frames", "cameras", "tracks", "displacement"),
        kept=REVISIT,
    )
    def revisit(self, session: Session) -> Revisit | None:
        """Change of rest positions since the visit that the session names; ``None`` where it names none."""
        return compare_to_baseline(Visit(session, self.frames, self.cameras, self.tracks, self.displacement))

    @product(reads=("name", "point", "view"), needs=("frames", "points", "tracks", "displacement", "audit"))
    def figures(self, session: Session) -> list[Path]:
        """Paths of the pictures of the run, in ``figures/``; none without a folder or displacement."""
        if self.folder is None or self.displacement is None:
            return []
        self._say("figures")
        about, places = describe_run(session, self.audit), first_places(self.points)
        drawn = save_figures(self.folder, self.tracks, self.displacement, self.frames, places, about=about)
        return drawn + save_later_points(self.folder, self.points, self.frames.picture, about=about)

    @product(reads=("*",), needs=("cameras", "tracks", "displacement", "audit", "revisit"))
    def summary(self, session: Session) -> dict[str, Any]:
        """Everything a reviewer asks for, written to ``summary.json``."""
        summary = describe_measurement(self.cameras, self.tracks, self.displacement, self.audit) | {
            "name": session.name,
            "revisit": None if self.revisit is None else self.revisit.as_table(),
            "seconds": self.rounded_seconds(),
            "reused_stages": list(self.reused),
            "versions": package_versions(),
            **self._identity(session),
        }
        if self.folder is not None:
            RunFolder(self.folder).add({**summary, "products": self.in_folder})
        return summary

    def run(self, *names: str) -> Self:
        """The measurement with these products made, alone in its folder, which holds no other session's results.

        Parameters
        ----------
        names
            Names of products, such as ``cameras`` or ``displacement``.

        Raises
        ------
        VfmSdmError
            Something in the session or its files cannot be used, or another process writes to the folder.
        """
        self.check_method()
        if self.folder is None:
            for name in names:
                getattr(self, name)
            return self
        folder = RunFolder(self.folder)
        kept = [one.file for name in self.products() if (one := self.product(name).kept) is not None]
        folder.check_inputs_stay([path for _, path in input_files(self._session)], kept)
        with folder.opened(self._identity(self._session)):
            folder.add({"session_file": file_hash(write_session(self.folder / SESSION, self._session))})
            for name in names:
                getattr(self, name)
            if "figures" in names:
                folder.keep_figures(self.figures)
            folder.add({"products": self.in_folder})
        return self

    def check_method(self) -> None:
        """As `SessionChain.check_method`, and that the tracker can follow points that come into view later."""
        super().check_method()
        check_later_points(self._part("trackers"), [one.name for one in self._session.point if one.comes_later])

    def _choose(
        self, view: str, places: Mapping[str, FloatArray], subset_px: int | None, numbers: Mapping[str, int]
    ) -> dict[str, SubsetChoice]:
        """Subsets of points at places (2,) [px] of a view, by name, each looked at once; none without use for them."""
        if not isinstance(self.part("trackers"), DesignedTracker):
            return {}
        return self._designs.choose(self.recordings[view], view, places, numbers, subset_px)

    def _measure_first(self, session: Session) -> tuple[CameraSolution, xr.Dataset | None]:
        """Cameras and displacement of a session, kept in a folder of its own."""
        folder = None if self.folder is None else self.folder / "sensor_scale"
        first = Measurement(session, folder, progress=self.progress, executor=self._executor)
        first.run("cameras", "points", "tracks", "displacement")
        return first.cameras, first.displacement

    def _measure_interval(
        self, session: Session, tracks: Mapping[str, xr.Dataset], carried: Carried
    ) -> MeasuredInterval:
        """An interval of the recording, as a recording of its own."""
        known = {name: getattr(self, name) for name in ("frames", "cameras", "points", "injection")}
        one = Measurement(session).given(**known, tracks=tracks, carried=carried)
        if one.displacement is None or one.audit is None:
            raise DatasetError("intervals: expected displacement of each, got none; see the status of the cameras")
        aligned = None if len(session.view) == 1 else one.aligned
        unrefined = one.displacement if one.unrefined is None else one.unrefined
        return MeasuredInterval(one.steady.views, aligned, unrefined, one.displacement, one.audit)

    def _triangulated(self, tracks: xr.Dataset, session: Session, refinement: Refinement | None = None) -> xr.Dataset:
        """Displacement of synchronised tracks, refined or not."""
        cameras = self.cameras
        if cameras.rig is None:
            raise DatasetError("displacement: expected cameras, got none; see the status of the cameras")
        return compute_displacement(
            tracks.assign(place_std=self.points["position_std"]),
            cameras.rig,
            frame=cameras.frame,
            covariance=cameras.covariance,
            refinement_gain=None if refinement is None else refinement.gain,
            still_interval_s=session.method.still_interval_s,
        )

    def _say(self, what: str, done: int = 0, total: int | None = None) -> None:
        """Tells the caller, who may ask the measurement for anything."""
        if self.progress is not None:
            with self._step_outside():
                self.progress(what, done, total)


def measure(
    session: Session,
    folder: Path | str | None = None,
    *,
    progress: Progress | None = None,
    whole_files: bool = False,
    executor: Executor | None = None,
    forecast: Callable[[Mapping[str, xr.Dataset]], None] | None = None,
) -> Measurement:
    """The whole way from recordings to displacement.

    Parameters
    ----------
    session
        What to measure.
    folder
        Run folder to write to; finished stages in it are reused unless their inputs changed. ``None`` keeps the
        results in memory only.
    progress
        Called with what is being done.
    whole_files
        Whether large input files are hashed as a whole, see `Measurement`.
    executor
        Who tracks the segments of the recordings, see `Measurement`.
    forecast
        Called with what the named points should measure (`Measurement.expectation`), before anything else is done.

    Returns
    -------
    measurement
        With all its products made: ``cameras``, ``tracks``, ``displacement`` (``None`` where no cameras could be
        found; ``cameras.status`` says why), ``audit`` (``None`` where there is no displacement), ``summary``, ...

    Raises
    ------
    VfmSdmError
        Something in the session or its files cannot be used; see the subclasses.
    """
    measurement = Measurement(session, folder, progress=progress, whole_files=whole_files, executor=executor)
    measurement.check_method()
    if forecast is not None and measurement.expectation:
        forecast(measurement.expectation)
    # What is said of the result comes before what is drawn of it.
    measurement.run("cameras", "points", "tracks", "displacement", "audit", "summary", "figures")
    measurement.summary["seconds"] = measurement.rounded_seconds()
    if measurement.folder is not None:
        # What is not whole is tried once more by the next run.
        finished = is_whole(measurement.tracks)
        RunFolder(measurement.folder).add({"finished": finished, "seconds": measurement.summary["seconds"]})
    return measurement
