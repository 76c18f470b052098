"""One measurement in one run folder: stages timed, their products written, and reused while inputs are the same."""

import hashlib
import json
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property
from glob import glob
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.core.netcdf import read_tracks, write_tracks
from vfm_sdm.core.registry import make
from vfm_sdm.errors import ResultsError
from vfm_sdm.inputs.session import Session, file_hash, open_views, session_hash, write_session
from vfm_sdm.inputs.video import Video
from vfm_sdm.outputs.plots import save_figures
from vfm_sdm.outputs.results import (
    describe_camera_motion,
    describe_clocks,
    describe_recording,
    describe_refinement,
    displacement_notes,
    recording_notes,
    summarize_displacement,
    write_displacement,
    write_summary,
)
from vfm_sdm.pipeline import Progress, audit_of, displacement_of, solve_cameras, track_views
from vfm_sdm.stages.audit import Audit
from vfm_sdm.stages.cameras.base import estimator_of
from vfm_sdm.stages.cameras.solution import CameraSolution, read_solution, write_solution
from vfm_sdm.stages.tracking.base import tracker_of

__all__ = ["Measurement", "Run", "measure"]

_PACKAGES = ("vfm-sdm", "numpy", "scipy", "xarray", "av", "opencv-python-headless", "numba", "poselib")
_OPTIONAL = ("torch", "pycolmap", "transformers")
_CAMERA_SETTINGS = ("method.cameras", "method.subset_px", "method.correspondence", "method.network")


@dataclass(frozen=True, eq=False)
class Measurement:
    """What `measure` yields.

    Parameters
    ----------
    session
        What was measured, resolved.
    cameras
        Cameras, axes, points.
    tracks
        Tracks by view, each on its own clock.
    displacement
        Displacement dataset; ``None`` where no cameras could be found (``cameras.status`` says why).
    audit
        Checks and verdict; ``None`` where there is no displacement, or a single view.
    summary
        As written to ``summary.json``.
    """

    session: Session
    cameras: CameraSolution
    tracks: Mapping[str, xr.Dataset]
    displacement: xr.Dataset | None
    audit: Audit | None
    summary: Mapping[str, Any]


@dataclass
class Run:
    """The stages of one session, in a folder or in memory.

    Parameters
    ----------
    session
        What to measure.
    folder
        Run folder; ``None`` keeps everything in memory.
    progress
        See `vfm_sdm.pipeline.Progress`.
    """

    session: Session
    folder: Path | None = None
    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    _videos: dict[str, Video] = field(default_factory=dict)
    _hashes: dict[str, str] = field(default_factory=dict)
    _frames: dict[str, LumaArray] = field(default_factory=dict)

    def check_method(self) -> None:
        """Looks every back end up before any work is done.

        Raises
        ------
        BackendUnavailableError
            One of them is unknown or cannot run here.
        """
        _ = self._weights

    @property
    def videos(self) -> dict[str, Video]:
        """The recordings, opened once."""
        if not self._videos:
            self._videos = open_views(self.session)
        return self._videos

    @property
    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of every input file, by its path as the session names it."""
        if not self._hashes:
            with self._timed("hashing inputs"):
                self._hashes = {name: file_hash(path) for name, path in _input_files(self.session)}
        return self._hashes

    @property
    def frames(self) -> dict[str, LumaArray]:
        """First frame of every view."""
        if not self._frames:
            self._frames = {view: video.first_frame().luma.copy() for view, video in self.videos.items()}
        return self._frames

    def cameras(self) -> CameraSolution:
        """Cameras, axes and points, written to ``cameras.toml``."""
        weights = json.dumps(self._weights["cameras"])
        key = self._key("view", "site", "point", "chessboard", *_CAMERA_SETTINGS, extra=weights)
        path = self._path("cameras.toml")
        if path is not None and path.exists():
            solution, found = read_solution(path)
            if found == key:
                self.reused.append("cameras")
                return solution
        with self._timed("cameras"):
            self._say("cameras", 0, None)
            solution = solve_cameras(self.session, self.frames)
        if path is not None:
            write_solution(path, solution, key=key)
        return solution

    def tracks(self, cameras: CameraSolution) -> dict[str, xr.Dataset]:
        """Tracks of every view, written to ``tracks.nc``."""
        # Not the whole view: a better lens prior must not cost another pass over the recordings.
        sources = [[v.name, str(v.video), v.images, v.fps] for v in self.session.view]
        points = {v: dict(p) for v, p in cameras.points.items()}
        inputs = json.dumps([sources, points, self._weights["tracking"]], sort_keys=True)
        key = self._key("method.tracker", "method.subset_px", "method.network", extra=inputs)
        path = self._path("tracks.nc")
        if path is not None and path.exists():
            tracks = read_tracks(path)
            if all(t.attrs.get("key") == key for t in tracks.values()) and list(tracks) == list(self.videos):
                self.reused.append("tracking")
                return tracks
        tracker = tracker_of(self.session.resolved_method)
        with self._timed("tracking"):
            tracks = track_views(self.videos, cameras.points, tracker, progress=self.progress)
        for view, video in self.videos.items():
            tracks[view].attrs.update({f"decode_{k}": v for k, v in asdict(video.report).items()}, key=key)
            tracks[view].attrs["decode_bits_per_pixel"] = self._bits_per_pixel(view)
        if path is not None:
            write_tracks(path.parent, tracks)
        return tracks

    def displacement(self, cameras: CameraSolution, tracks: Mapping[str, xr.Dataset]) -> xr.Dataset | None:
        """Displacement, written to ``displacement.nc`` and ``displacement.csv``; ``None`` without cameras or scale."""
        with self._timed("displacement"):
            displacement = displacement_of(self.session, tracks, cameras)
        if displacement is None:
            return None
        displacement.attrs.update(session_hash=session_hash(self.session), versions=json.dumps(versions()))
        if self.folder is not None:
            write_displacement(self.folder, displacement)
        return displacement

    def audit(
        self, cameras: CameraSolution, tracks: Mapping[str, xr.Dataset], displacement: xr.Dataset | None
    ) -> Audit | None:
        """Checks and verdict; ``None`` without displacement."""
        if displacement is None:
            return None
        with self._timed("audit"):
            return audit_of(self.session, tracks, cameras, displacement, self.frames)

    def figures(
        self,
        cameras: CameraSolution,
        tracks: Mapping[str, xr.Dataset],
        displacement: xr.Dataset,
        audit: Audit | None = None,
    ) -> list[Path]:
        """The pictures of the run, in ``figures/``."""
        if self.folder is None:
            return []
        with self._timed("figures"):
            self._say("figures", 0, None)
            points = {view: np.array(list(named.values())) for view, named in cameras.points.items()}
            return save_figures(self.folder, tracks, displacement, self.frames, points, audit=audit)

    def summary(
        self,
        cameras: CameraSolution,
        tracks: Mapping[str, xr.Dataset],
        displacement: xr.Dataset | None,
        audit: Audit | None = None,
    ) -> dict[str, Any]:
        """Everything a reviewer asks for, written to ``summary.json``."""
        summary = {
            "name": self.session.name,
            "status": cameras.status,
            "audit": None if audit is None else audit.as_table(),
            "notes": [*cameras.notes, *recording_notes(tracks), *displacement_notes(displacement)],
            "points": {} if displacement is None else summarize_displacement(displacement),
            "frame": None if displacement is None else displacement.attrs["frame"],
            "cameras": {
                "epipolar_rms_px": cameras.epipolar_rms_px,
                "quantities": [{**asdict(q), "determined": q.determined} for q in cameras.quantities],
                "point_status": {v: dict(p) for v, p in cameras.point_status.items()},
            },
            "recordings": {view: describe_recording(t) for view, t in tracks.items()},
            "clocks": {} if displacement is None else describe_clocks(displacement, list(tracks)),
            "camera_motion": {} if displacement is None else describe_camera_motion(displacement, list(tracks)),
            "refinement": {} if displacement is None else describe_refinement(displacement),
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
            "reused_stages": list(self.reused),
            "versions": versions(),
            "session_hash": session_hash(self.session),
            "input_hashes": self.input_hashes,
        }
        if self.folder is not None:
            write_summary(self.folder, summary)
        return summary

    def _bits_per_pixel(self, view: str) -> float:
        """Size of a video's file over the pixels it holds; NaN for images."""
        source = next(v.video for v in self.session.view if v.name == view)
        video = self.videos[view]
        pixels = video.info.width * video.info.height * max(video.report.frames, 1)
        return float("nan") if source is None else 8 * self.session.resolve(source).stat().st_size / pixels

    @cached_property
    def _weights(self) -> dict[str, list[str]]:
        """Which weights the networks of each stage have; to know them, every back end is looked up."""
        method = self.session.resolved_method
        stages: dict[str, list[object]] = {"cameras": [estimator_of(method)], "tracking": [tracker_of(method)]}
        stages["cameras"].append(make("matchers", method))
        return {
            stage: [str(part.weights_id) for part in parts if hasattr(part, "weights_id")]
            for stage, parts in stages.items()
        }

    def _key(self, *parts: str, extra: str = "") -> str:
        """Hash of those parts of the session, and of the input files, that a stage depends on."""
        fields = self.session.model_dump(mode="json")
        chosen = {part: _dig(fields, part) for part in parts}
        text = json.dumps([chosen, self.input_hashes, extra, version("vfm-sdm")], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _path(self, name: str) -> Path | None:
        return None if self.folder is None else self.folder / name

    def _say(self, what: str, done: int, total: int | None) -> None:
        if self.progress is not None:
            self.progress(what, done, total)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start


def measure(session: Session, folder: Path | str | None = None, *, progress: Progress | None = None) -> Measurement:
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

    Raises
    ------
    VfmSdmError
        Something in the session or its files cannot be used; see the subclasses.
    """
    run = Run(session, None if folder is None else Path(folder), progress)
    run.check_method()
    if run.folder is not None:
        _prepare_folder(run.folder)
        write_session(run.folder / "session.resolved.toml", session)
    cameras = run.cameras()
    tracks = run.tracks(cameras)
    displacement = run.displacement(cameras, tracks)
    audit = run.audit(cameras, tracks, displacement)
    if displacement is not None:
        run.figures(cameras, tracks, displacement, audit)
    summary = run.summary(cameras, tracks, displacement, audit)
    return Measurement(session, cameras, tracks, displacement, audit, summary)


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}
    for name in _OPTIONAL:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _prepare_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(
            f"{folder}: expected a folder to write to, got {error.strerror}; choose another -o"
        ) from error


def _input_files(session: Session) -> Iterator[tuple[str, Path]]:
    for view in session.view:
        if view.video is not None:
            yield str(view.video), session.resolve(view.video)
        else:
            yield from _pattern_files(session, view.name, str(view.images))
        if view.camera is not None:
            yield str(view.camera), session.resolve(view.camera)
    board = session.chessboard
    if board is not None and board.corners is not None:
        yield str(board.corners), session.resolve(board.corners)
    for name, pattern in (board.images or {} if board is not None else {}).items():
        yield from _pattern_files(session, f"chessboard {name}", pattern)


def _pattern_files(session: Session, label: str, pattern: str) -> Iterator[tuple[str, Path]]:
    for path in sorted(glob(session.resolve_pattern(pattern))):
        yield f"{label}: {Path(path).name}", Path(path)


def _dig(fields: Mapping[str, Any], dotted: str) -> Any:
    value: Any = fields
    for part in dotted.split("."):
        value = value[part]
    return value
