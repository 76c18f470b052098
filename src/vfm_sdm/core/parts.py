"""Every interchangeable part of the package, one line each: trackers, cameras, matchers, writers, checks, sections.

Parts are named by dotted strings, so that the layers below them can ask what a part needs without importing it. To add
one, write its class (or, of writers, checks and sections, its function) and its line here; another package announces
its own through the entry-point group of the kind (`KINDS`), and says the same of it by attributes of the class.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from operator import attrgetter
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from vfm_sdm.errors import BackendUnavailableError, VfmSdmError

__all__ = ["BUILT_IN", "KINDS", "Kind", "KindInfo", "Needs", "Part", "PartSettings", "Requirement"]

Kind = Literal["trackers", "cameras", "matchers", "features", "writers", "checks", "sections"]

Requirement = Literal["baseline", "camera files", "chessboard"]
"""Entry that a session must have for a camera estimator: ``site.baseline``, a ``camera`` file for every view, or the
table ``[chessboard]``."""


@dataclass(frozen=True)
class KindInfo:
    """Properties that all parts of a kind have in common.

    Parameters
    ----------
    word
        Word for such a part in messages; for parts that a session names, the word of ``[method]``.
    title
        Title of a list of such parts.
    group
        Entry-point group in which other packages announce their parts.
    field
        Dotted field of ``[method]`` that names the part to use; empty where a session names none.
    calls
        Method that the part must have; empty where the part itself is called.
    """

    word: str
    title: str
    group: str
    field: str = ""
    calls: str = ""


KINDS: Mapping[Kind, KindInfo] = {
    "trackers": KindInfo("tracker", "trackers", "vfm_sdm.trackers", "tracker", "track"),
    "cameras": KindInfo("cameras", "camera estimators", "vfm_sdm.cameras", "cameras", "estimate"),
    "matchers": KindInfo("correspondence", "matchers of points", "vfm_sdm.matchers", "correspondence", "locate"),
    "features": KindInfo("matching", "matchers of features", "vfm_sdm.features", "matching", "match"),
    "writers": KindInfo("export", "output writers", "vfm_sdm.writers"),
    "checks": KindInfo("check", "audit checks", "vfm_sdm.checks"),
    "sections": KindInfo("section", "report sections", "vfm_sdm.sections"),
}


class PartSettings(BaseModel):
    """A part's own table ``[method.NAME]`` of a session; parts with settings derive their model from it.

    It is frozen, and unknown keys are refused. Relative paths in fields of the type ``Path`` start at the session's
    folder.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True)
class Needs:
    """Packages and weights that a part needs beyond the core.

    Parameters
    ----------
    extra
        Extra of this package that installs the packages; empty where they are installed otherwise.
    packages
        Names of the packages to import.
    checkpoints
        Registered weights with which the part can run in its default settings, the preferred one first; one is enough.
    all_checkpoints
        Registered weights that the part needs all.
    """

    extra: str
    packages: tuple[str, ...]
    checkpoints: tuple[str, ...] = ()
    all_checkpoints: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """Location of a part, with what others have to know about it.

    Parameters
    ----------
    target
        ``module:attribute`` of the part's class or function; empty where the calling code has it built in.
    reads
        Fields of ``[method]`` in a session that the part reads: ``subset_px``, or ``network.weights`` for one key of a
        table. Its constructor takes the fields, or whole tables, by their names; keys of a table that are not declared
        have their defaults there.
    fixed
        Arguments of the constructor that belong to the part's name.
    made_of
        Kind and name of the parts of which it is made; their needs and the fields that they read are its own, too.
    chooses
        Kinds of which the session names a part for this one; the constructor takes it by the name of the kind.
    settings
        ``module:attribute`` of the model of the part's own table ``[method.NAME]``, a `PartSettings`, which the
        constructor takes as ``settings``; empty where it has none.
    needs
        Packages and weights that the part needs.
    requires
        Entries that the session must have.
    distribution
        Name and version of the package with the part, such as ``strange-trackers 1.2``; empty for this package's.
    """

    target: str
    reads: tuple[str, ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)
    made_of: tuple[tuple[Kind, str], ...] = ()
    chooses: tuple[Kind, ...] = ()
    settings: str = ""
    needs: Needs | None = None
    requires: tuple[Requirement, ...] = ()
    distribution: str = ""

    @property
    def module(self) -> str:
        """Where its code lies; empty where whoever asks for it has it built in."""
        return self.target.partition(":")[0]

    def load(self) -> Any:
        """The class or function; ``None`` where whoever asks for it has it built in."""
        return _load(self.target)

    def make(self, **options: Any) -> Any:
        """The part with these options; where it has settings and none are given, with their defaults.

        Raises
        ------
        BackendUnavailableError
            It cannot run here.
        """
        made, model = self.load(), self.settings_model()
        if model is not None:
            options["settings"] = options["settings"] if "settings" in options else model()
        if made is None:
            return None
        try:
            return made(**self.fixed, **options)
        except VfmSdmError:
            raise
        except Exception as error:
            if not self.distribution:
                raise
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise BackendUnavailableError(
                f"{self.target} of {self.distribution}: expected it to take {sorted(options)}, got {reason}; "
                "repair or uninstall that package"
            ) from error

    def settings_model(self) -> type[PartSettings] | None:
        """The model of its own table; ``None`` where it has none."""
        model: type[PartSettings] | None = _load(self.settings)
        return model


def _load(target: str) -> Any:
    if not target:
        return None
    module, _, attribute = target.partition(":")
    return attrgetter(attribute)(import_module(module))


_STAGES = "vfm_sdm.stages."
_CHECKPOINTS = ("vggt-1b", "vggt-1b-commercial")
_VGGT = Needs("vfm", ("torch", "safetensors"), _CHECKPOINTS)
_ON_A_DEVICE = ("network.weights", "network.device", "network.precision")


def _polished(follower: str) -> Part:
    parts: tuple[tuple[Kind, str], ...] = (("trackers", follower), ("trackers", "icgn"))
    return Part(_STAGES + "tracking.hybrid:HybridTracker", fixed={"follower": follower}, made_of=parts)


_TRACKERS = {
    "icgn": Part(_STAGES + "tracking.icgn:IcgnTracker", ("subset_px",)),
    "template": Part(_STAGES + "tracking.template:TemplateTracker", ("subset_px",)),
    "vggt": Part(_STAGES + "tracking.vggt:VggtTracker", (*_ON_A_DEVICE, "network.preset"), needs=_VGGT),
    "tapir": Part(
        _STAGES + "tracking.tapir:TapirTracker",
        ("network.weights", "network.device"),
        needs=Needs("vfm", ("torch",), ("bootstapir",)),
    ),
    "file": Part(_STAGES + "tracking.file:FileTracker", settings=_STAGES + "tracking.file:TrackFiles"),
    "vggt+icgn": _polished("vggt"),
    "tapir+icgn": _polished("tapir"),
}
_CAMERAS = {
    "file": Part(_STAGES + "cameras.file:FileCameras", requires=("camera files",)),
    "chessboard": Part(_STAGES + "cameras.chessboard.estimator:ChessboardCameras", requires=("chessboard",)),
    "two-view": Part(_STAGES + "cameras.two_view:TwoViewCameras", chooses=("features",), requires=("baseline",)),
    "vggt": Part(_STAGES + "cameras.vggt:VggtCameras", _ON_A_DEVICE, needs=_VGGT, requires=("baseline",)),
    "posediffusion": Part(
        _STAGES + "cameras.posediffusion:PoseDiffusionCameras",
        ("network.weights", "network.device"),
        needs=Needs("vfm", ("torch",), ("posediffusion-co3d", "posediffusion-re10k")),
        requires=("baseline",),
    ),
    "sfm": Part(
        _STAGES + "cameras.sfm:SfmCameras",
        chooses=("features",),
        needs=Needs("sfm", ("pycolmap",)),
        requires=("baseline",),
    ),
}
_MATCHERS = {
    "registration": Part(""),  # the search along the epipolar line, which every answer goes through
    "vggt": Part(_STAGES + "matching.network:VggtMatcher", _ON_A_DEVICE, needs=_VGGT),
}
_KORNIA = _STAGES + "matching.kornia_features:"


def _trained(detector: str, *checkpoints: str) -> Part:
    needs = Needs("sfm", ("torch", "kornia"), all_checkpoints=checkpoints)
    return Part(_KORNIA + "KorniaMatcher", ("network.device",), fixed={"detector": detector}, needs=needs)


def _superpoint(matcher: str) -> Part:
    target = _STAGES + "matching.learned_features:superpoint_matcher"
    return Part(target, ("sfm.model",), fixed={"matcher": matcher}, needs=Needs("sfm", ("torch", "transformers")))


_FEATURES = {
    "auto": Part(_KORNIA + "choose_matcher", ("network.device",)),
    "sift": Part(""),  # whoever asks has its own
    "aliked+lightglue": _trained("aliked", "aliked-n16", "aliked-lightglue"),
    "xfeat": _trained("xfeat", "xfeat", "xfeat-lighterglue"),
    "superpoint+lightglue": _superpoint("lightglue"),
    "superpoint+superglue": _superpoint("superglue"),
}
_RESULTS = "vfm_sdm.outputs.results."
_WRITERS = {
    "csv": Part(_RESULTS + "exports:to_csv"),
    "mat": Part(_RESULTS + "exports:to_mat"),
    "uff": Part(_RESULTS + "universal:to_uff"),
}
_AUDIT = _STAGES + "audit."
_CHECKS = {
    "site": Part(_AUDIT + "geometry:check_site"),
    "baseline": Part(_AUDIT + "geometry:check_baseline"),
    "scale": Part(_AUDIT + "scale:check_scale"),
    "epipolar-level": Part(_AUDIT + "geometry:check_epipolar_level"),
    "epipolar-motion": Part(_AUDIT + "geometry:check_epipolar_motion"),
    "agreement": Part(_AUDIT + "geometry:check_agreement"),
    "synchronization": Part(_AUDIT + "clocks:check_synchronization"),
    "drift": Part(_AUDIT + "clocks:check_drift"),
    "points": Part(_AUDIT + "tracks:check_points"),
    "grid": Part(_AUDIT + "grid:check_grid"),
    "tracked": Part(_AUDIT + "tracks:check_tracked"),
    "frozen": Part(_AUDIT + "tracks:check_frozen"),
    "slip": Part(_AUDIT + "tracks:check_slip"),
    "halves": Part(_AUDIT + "tracks:check_halves"),
    "references": Part(_AUDIT + "references:check_references"),
    "parts": Part(_AUDIT + "subsets:check_parts"),
    "believed": Part(_AUDIT + "subsets:check_believed"),
    "static-points": Part(_AUDIT + "tracks:check_static_points"),
    "camera-motion": Part(_AUDIT + "tracks:check_camera_motion"),
    "stabilization": Part(_AUDIT + "tracks:check_stabilization"),
    "still-interval": Part(_AUDIT + "still:check_still_interval"),
    "signal": Part(_AUDIT + "signal:check_signal"),
    "gain": Part(_AUDIT + "signal:check_gain"),
    "recording": Part(_AUDIT + "signal:check_recording"),
    "frames": Part(_AUDIT + "signal:check_duration"),
    "refinement": Part(_AUDIT + "signal:check_refinement"),
}
_SECTIONS_AT = "vfm_sdm.outputs.report.sections."
_SECTIONS = {
    "task": Part(_SECTIONS_AT + "head:describe_task"),
    "verdict": Part(_SECTIONS_AT + "head:describe_verdict"),
    "site": Part(_SECTIONS_AT + "site:describe_site"),
    "photos": Part(_SECTIONS_AT + "site:describe_photos"),
    "results": Part(_SECTIONS_AT + "results:describe_results"),
    "histories": Part(_SECTIONS_AT + "results:describe_histories"),
    "field": Part(_SECTIONS_AT + "field:describe_field"),
    "budget": Part(_SECTIONS_AT + "budget:describe_budget"),
    "audit": Part(_SECTIONS_AT + "checks:describe_audit"),
    "comparison": Part(_SECTIONS_AT + "checks:describe_comparison"),
    "fusion": Part(_SECTIONS_AT + "fusion:describe_fusion_section"),
    "modes": Part(_SECTIONS_AT + "modes:describe_modes"),
    "load-test": Part(_SECTIONS_AT + "load_test:describe_load_test"),
    "passages": Part(_SECTIONS_AT + "load_test:describe_passages"),
    "repeatability": Part(_SECTIONS_AT + "repeatability:describe_repeatability"),
    "traceability": Part(_SECTIONS_AT + "traceability:describe_traceability"),
}

BUILT_IN: Mapping[Kind, dict[str, Part]] = {
    "trackers": _TRACKERS,
    "cameras": _CAMERAS,
    "matchers": _MATCHERS,
    "features": _FEATURES,
    "writers": _WRITERS,
    "checks": _CHECKS,
    "sections": _SECTIONS,
}
"""This package's own parts by kind and name; of checks and sections, in the order of audit and report."""
