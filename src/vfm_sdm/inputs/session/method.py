"""The table ``[method]`` of ``session.toml``: which parts measure, and with which settings.

Parts are named as `vfm_sdm.core.parts` and installed packages list them. A part may have a table of its own,
``[method.NAME]``, which its own model validates; a part that is chosen has it also where the file says nothing, with
its defaults, so that a session states all that it measures with.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, Strict, model_validator
from pydantic_core import PydanticKnownError

from vfm_sdm.core.parts import KINDS, Kind
from vfm_sdm.core.registry import explain_unknown, find, parts_of, settings_model
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.inputs.session.site import Entry, Name, Number, Positive, not_below
from vfm_sdm.networks.interface import Precision

__all__ = ["Method", "Network", "Sfm", "Sgr", "table_paths"]

_USUAL_SUBSET_PX = 41
_Weight = Annotated[Number, Field(ge=0)]


def _named(kind: Kind) -> AfterValidator:
    """A validator of the name of a part."""

    def check(name: str) -> str:
        if unknown := explain_unknown(kind, name):
            raise ValueError(unknown)
        if name in Method.model_fields and find(kind, name).settings:
            raise ValueError(
                f"expected a part whose table has a name of its own, got {name!r}, which is another key of [method]; "
                "ask its author to rename it"
            )
        return name

    return AfterValidator(check)


@dataclass(frozen=True)
class _RawTable:
    """What stands under a key of ``[method]`` that is none of its own, with the key."""

    name: str
    content: Any


def _table(raw: _RawTable | BaseModel) -> BaseModel:
    """The settings of a part, validated by the model that the part declares."""
    if isinstance(raw, BaseModel):
        return raw
    try:
        model = settings_model(raw.name)
    except BackendUnavailableError as error:
        raise ValueError(str(error)) from error
    if model is None:
        raise PydanticKnownError("extra_forbidden")
    return model.model_validate(raw.content)


def _increasing(interval: tuple[float, float]) -> tuple[float, float]:
    if not 0 <= interval[0] < interval[1]:
        raise ValueError(f"expected 0 <= start < end in seconds, got {list(interval)}; swap or correct them")
    return interval


def _subset(size: int) -> int:
    if size % 2 == 0 or size < 9:
        raise ValueError(f"expected an odd number of pixels >= 9, got {size}; leave it out when in doubt")
    return size


class Sgr(Entry):
    """Settings of the structural geometry refinement (`vfm_sdm.stages.refinement`); the paper's by default."""

    suppressed_axis: Literal["lateral", "vertical", "longitudinal"] = "longitudinal"
    uncertain_view: Name = "auto"
    """Name of the view to correct, or the one that each point's covariances show to be the poorer."""
    longitudinal: _Weight = 4.0
    longitudinal_rate: _Weight = 8.0
    others: _Weight = 6.0
    others_rate: _Weight = 12.0
    pixel: Positive = 0.05


class Network(Entry):
    """Settings of the back ends that run a network: ``vggt``, ``tapir`` and what builds on them."""

    weights: Name | None = None
    """Name of a checkpoint (``vfm-sdm weights list``), or its file; the back end's own by default."""
    preset: Literal["fast", "paper"] = "fast"
    """Division of a recording into VGGT's inputs: ``paper`` pads patches and streams overlapping chunks as the paper
    does, ``fast`` takes small chunks that all begin with the reference frame."""
    device: Name = "auto"
    """Name of PyTorch's device; a GPU by default where there is one."""
    precision: Precision = "auto"
    """Precision of VGGT's matrix products; bfloat16 on GPUs by default. TAPIR always runs in float32."""


class Sfm(Entry):
    """Settings of matching by SuperPoint."""

    model: Name | None = None
    """Folder of the matcher's checkpoint; the published one in the download cache by default."""


class Method(Entry):
    """How to measure."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_table)]]

    tracker: Annotated[str, _named("trackers")] = "icgn"
    cameras: Annotated[str, _named("cameras")] = "two-view"
    refinement: Literal["none", "sgr"] = "none"
    synchronization: Literal["motion", "none"] = "motion"
    """Whether the offset between views is estimated from the points' motion, or taken as stated."""
    camera_motion: Literal["remove", "keep"] = "remove"
    """Whether motion of the cameras that static points show is taken out of the tracks, where that is sure to help."""
    scale_limit: Annotated[float, Strict(), Field(gt=0, le=1), not_below(1e-4)] = 0.05
    """Largest expanded relative uncertainty of the scale (k = 2) with which a result can be fit to use [1]."""
    injection: bool = True
    """Whether the gain of every point is measured by known motion that is put into the recordings, and corrected."""
    sgr: Sgr = Sgr()
    still_interval_s: Annotated[tuple[Number, Number], AfterValidator(_increasing)] | None = None
    """When the structure is at rest; displacement is relative to the mean of it, else to the first frame [s]."""
    segment_s: Annotated[float, Strict(), Field(gt=0), not_below(1.0)] = 60.0
    """Nominal length of the segments in which a recording is tracked, each by itself [s]."""
    interval_s: Annotated[float, Strict(), Field(gt=0), not_below(10.0)] = 600.0
    """Nominal length of the intervals in which a recording is measured and judged behind tracking [s]."""
    subset_px: Annotated[int, Strict(), AfterValidator(_subset)] | None = None
    """Side of the square that a tracker compares [px]; chosen for each point by default."""
    correspondence: Annotated[str, _named("matchers")] = "registration"
    """Who finds a named point in the other views: subsets registered along the epipolar line, or, as in the paper,
    VGGT's tracker, whose answer is then registered to a fraction of a pixel."""
    matching: Annotated[str, _named("features")] = "sift"
    """Who matches features of first frames for cameras; ``auto``: a trained network where one is here, else SIFT."""
    network: Network = Network()
    sfm: Sfm = Sfm()

    @model_validator(mode="after")
    def _model_is_used(self) -> Self:
        if self.sfm.model and not self.matching.startswith("superpoint"):
            raise ValueError(
                f"expected matching = 'superpoint+lightglue' or 'superpoint+superglue' for sfm.model, got "
                f"{self.matching!r}; correct it"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _parts_tables(cls, fields: Any) -> Any:
        """The fields with the tables of all chosen parts, each with its name."""
        if not isinstance(fields, Mapping):
            return fields
        fields = _with_matching(fields)
        own = {key: value for key, value in fields.items() if key in cls.model_fields}
        tables = {key: _RawTable(key, value) for key, value in fields.items() if key not in own}
        unsaid = {name: _RawTable(name, {}) for name in cls._with_settings(own) if name not in fields}
        return {**own, **tables, **unsaid}

    @classmethod
    def _with_settings(cls, fields: Mapping[str, Any]) -> set[str]:
        """Names of the chosen parts that have a table; a part that cannot be had says so when it is made."""
        names: set[str] = set()
        for kind, info in KINDS.items():
            name = _raw_name(fields, info.field) if info.field else None
            if name is not None and explain_unknown(kind, name) is None:
                with suppress(BackendUnavailableError):
                    names |= {called for (_, called), part in parts_of(kind, name).items() if part.settings}
        return names

    @property
    def usual_subset_px(self) -> int:
        """Side of the squares that are compared where none is chosen for each point [px]."""
        return self.subset_px or _USUAL_SUBSET_PX

    @property
    def tables(self) -> dict[str, BaseModel]:
        """Settings of parts by the parts' names."""
        return dict(self.model_extra or {})


def _with_matching(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields with ``matching`` in place of ``sfm.features`` and ``sfm.matcher``, as it was written before."""
    sfm = fields.get("sfm")
    if not isinstance(sfm, Mapping) or "features" not in sfm:
        return dict(fields)
    named = sfm["features"]
    if named == "superpoint":
        named = f"superpoint+{sfm.get('matcher', 'superglue')}"
    rest = {key: value for key, value in sfm.items() if key not in ("features", "matcher")}
    if fields.get("matching", named) != named:
        raise ValueError(
            f"expected features in one place, got matching and sfm.features = {named!r}; remove the latter"
        )
    return {**fields, "matching": named, "sfm": rest}


def _raw_name(fields: Mapping[str, Any], dotted: str) -> str | None:
    """Name of a part in unchecked fields; the default's where there is none, ``None`` where it is no text."""
    here: Any = fields
    default: Any = Method.model_construct()
    for key in dotted.split("."):
        default = getattr(default, key)
        here = here.get(key, default) if isinstance(here, Mapping) else getattr(here, key, default)
    return here if isinstance(here, str) else None


def table_paths(table: BaseModel) -> dict[str, Path]:
    """The paths in a part's settings, by key."""
    return {key: value for key, value in table if isinstance(value, Path)}
