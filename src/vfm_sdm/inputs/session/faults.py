"""What is wrong with a session, in sentences: which key, what was expected, what was found, what to do."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from vfm_sdm.core.registry import parts_of, settings_model, table_names
from vfm_sdm.errors import BackendUnavailableError

__all__ = ["NAMED", "cross_faults", "field_faults", "repeated_names"]

NAMED = ("view", "point", "grid", "sensor")
"""Lists of a session whose entries have names of their own."""

_Location = Sequence[str | int]


def field_faults(
    error: ValidationError, model: type[BaseModel], fields: Mapping[str, Any], *, partial: bool = False
) -> list[str]:
    """One sentence for each faulty field.

    Parameters
    ----------
    error
        What pydantic found.
    model
        The model that was to be built.
    fields
        Its raw input, from which entries of arrays take their names.
    partial
        Whether anything but names may be missing; what tables contradict in themselves is then left to the whole.
    """
    details = error.errors()
    inner = {detail["loc"][:length] for detail in details for length in range(len(detail["loc"]))}
    return [
        f"{_label(detail['loc'], fields)}: {_sentence(detail, model)}"
        for detail in details
        # An array counts as short when its entries are faulty; they speak for themselves.
        if not (detail["type"] == "too_short" and detail["loc"] in inner) and not (partial and _may_come(detail))
    ]


def _may_come(detail: ErrorDetails) -> bool:
    """Whether a fault of a part may be none of the whole."""
    if detail["type"] == "missing":
        return detail["loc"][-1] != "name" or len(detail["loc"]) == 1
    return detail["type"] == "value_error" and isinstance(detail["input"], Mapping)


def _label(location: _Location, fields: Mapping[str, Any]) -> str:
    """A readable path such as ``view[left].lens.focal_mm``; nameless entries are counted from 1."""
    label = ""
    here: Any = fields
    for part in location:
        if isinstance(part, str):
            label += f".{part}" if label else part
            here = _get(here, part)
            continue
        here = here[part] if isinstance(here, list | tuple) and part < len(here) else None
        name = _get(here, "name")
        label += f"[{name}]" if isinstance(name, str) and name else f"[{part + 1}]"
    return label or "session"


def _sentence(detail: ErrorDetails, model: type[BaseModel]) -> str:
    context, found = detail.get("ctx", {}), _show(detail["input"])
    key = str(detail["loc"][-1]) if detail["loc"] else ""
    sentences = {
        "value_error": str(context.get("error")),
        "missing": f"expected a value, got nothing; add {key} = ...",
        "tuple_type": f"expected a list of values or [[{key}]] tables, got {found}; correct the brackets",
        "model_type": f"expected one table [{key}], got {found}; correct the brackets",
        "string_pattern_mismatch": f"expected {_seen(str(context.get('pattern')))}, got {found}; rename it",
        "too_short": f"expected at least {context.get('min_length')}, got {context.get('actual_length')}; add one",
        "too_long": f"expected {context.get('max_length')} values, got {found}; remove the others",
    }
    if detail["type"] in sentences:
        return sentences[detail["type"]]
    if detail["type"] == "extra_forbidden":
        known = _keys_at(model, detail["loc"][:-1])
        close = get_close_matches(key, known, n=1, cutoff=0.6)
        advice = f"did you mean {close[0]!r}? Rename it" if close else "remove it"
        return f"expected one of the keys {', '.join(known)}, got an unknown one; {advice}"
    expected = detail["msg"].removeprefix("Input should be ")
    return f"expected {expected[:1].lower()}{expected[1:]}, got {found}; correct it"


def _seen(pattern: str) -> str:
    """What a pattern of names asks for."""
    letters = "letters that can be seen, without control characters and marks that turn the direction of text"
    return f"a name without slashes, not of dots alone, of {letters}" if "/" in pattern else letters


def _show(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _keys_at(model: type[BaseModel], location: _Location) -> list[str]:
    """The keys that the file may have in the table at a location."""
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            model = next(_models_in(model.model_fields[part].annotation), model)
        elif isinstance(part, str) and model.model_config.get("extra") == "allow":
            model = settings_model(part) or model
    tables = table_names() if model.model_config.get("extra") == "allow" else []
    return [*(name for name, field in model.model_fields.items() if not field.exclude), *tables]


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def cross_faults(fields: Mapping[str, Any]) -> list[str]:
    """Contradictions between entries, one sentence each.

    Works on raw tables as well as on models and skips what has the wrong type, which `field_faults` reports.
    """
    views, points = _entries(fields, "view"), _entries(fields, "point")
    view_names, point_names = _names(views), _names(points)
    faults = repeated_names(fields)
    for point in points:
        label = f"point[{_get(point, 'name')}]"
        faults += _unknown(f"{label}.view", _get(point, "view"), "view", view_names)
        for other in _get(point, "pixel_in") or {}:
            faults += _unknown(f"{label}.pixel_in", other, "view", view_names)
            if other == _get(point, "view"):
                faults.append(f"{label}.pixel_in: expected other views, got its own {other!r}; keep pixel alone")
    faults += _grid_faults(fields, view_names)
    for sensor in _entries(fields, "sensor"):
        faults += _unknown(f"sensor[{_get(sensor, 'name')}].point", _get(sensor, "point"), "point", point_names)
    faults += _scale_faults(fields, views, points)
    faults += _site_faults(_get(fields, "site"), views, view_names, point_names)
    faults += _method_faults(fields, views, view_names)
    return faults


def _grid_faults(fields: Mapping[str, Any], view_names: list[str]) -> list[str]:
    """Grids lie on a face whose place is known, in one of two views or more."""
    faults: list[str] = []
    for grid in _entries(fields, "grid"):
        label = f"grid[{_get(grid, 'name')}]"
        faults += _unknown(f"{label}.view", _get(grid, "view"), "view", view_names)
        site = _get(fields, "site")
        lacking = [key for key in ("perpendicular_distance", "longitudinal_distance") if _get(site, key) is None]
        if lacking:
            faults.append(
                f"{label}: expected the distances of the face that it lies on, got no {' and no '.join(lacking)}; "
                "state them under [site]"
            )
        if len(view_names) == 1:
            faults.append(f"{label}: expected two views or more, got one; name the points of one view as [[point]]")
    return faults


def repeated_names(fields: Mapping[str, Any]) -> list[str]:
    """Names that several entries of a list have, one sentence each; of raw tables or models.

    Parameters
    ----------
    fields
        A session's fields.
    """
    return [fault for kind in NAMED for fault in _repeated(kind, _names(_entries(fields, kind)))]


def _site_faults(site: Any, views: list[Any], view_names: list[str], point_names: list[str]) -> list[str]:
    faults: list[str] = []
    for number, entry in enumerate(_entries(site, "range"), start=1):
        label = f"site.range[{number}]"
        faults += _unknown(f"{label}.point", _get(entry, "point"), "point", point_names)
        faults += _unknown(f"{label}.view", _get(entry, "view"), "view", view_names)
    for number, entry in enumerate(_entries(site, "length"), start=1):
        label, ends = f"site.length[{number}].points", _get(entry, "points")
        ends = list(ends) if isinstance(ends, list | tuple) else []
        for end in ends:
            faults += _unknown(label, end, "point", point_names)
        if len(ends) == 2 and ends[0] == ends[1]:
            faults.append(f"{label}: expected two different points, got {ends[0]!r} twice; name the other end")
    for number, entry in enumerate(_entries(site, "rectangle"), start=1):
        corners = _get(entry, "points")
        for corner in corners if isinstance(corners, list | tuple) else []:
            faults += _unknown(f"site.rectangle[{number}].points", corner, "point", point_names)
        for view in _get(entry, "corners") or {}:
            faults += _unknown(f"site.rectangle[{number}].corners", view, "view", view_names)
    if _get(site, "reference_camera_level") is not None and views and _get(views[0], "level") is not None:
        faults.append(
            "site.reference_camera_level: expected one level of the reference camera, got another in "
            f"view[{_get(views[0], 'name')}].level; remove one of them"
        )
    faults += _reading_faults(site, views)
    return faults


def _reading_faults(site: Any, views: list[Any]) -> list[str]:
    """What is read at the reference camera stands in [site]; what is read at the others refers to it."""
    faults: list[str] = []
    distances = ("perpendicular_distance", "longitudinal_distance")
    for number, view in enumerate(views):
        label = f"view[{_get(view, 'name')}]"
        read = [key for key in (*distances, "stands") if _get(view, key) is not None]
        if number == 0:
            faults += [
                f"{label}.{key}: expected it of another view, got it of the first one, the reference; "
                + ("remove it" if key == "stands" else f"state it as site.{key}")
                for key in read
            ]
            if _get(view, "level") is not None and _get(site, "reference_camera_level") is None:
                faults.append(
                    f"{label}.level: expected it of another view, got it of the first one, the reference; "
                    "state it as site.reference_camera_level"
                )
        elif set(read) & set(distances) and _get(site, "perpendicular_distance") is None:
            faults.append(
                f"{label}: expected the distances of the reference camera beside its own, got none; add "
                "perpendicular_distance and longitudinal_distance under [site]"
            )
    return faults


def _scale_faults(fields: Mapping[str, Any], views: list[Any], points: list[Any]) -> list[str]:
    """A sensor tells the cameras' scale by motion that two of them see."""
    faults: list[str] = []
    static = {_get(point, "name") for point in points if _get(point, "static") is True}
    for sensor in _entries(fields, "sensor"):
        if _get(sensor, "use_as_scale") is not True:
            continue
        label, point = f"sensor[{_get(sensor, 'name')}]", _get(sensor, "point")
        if isinstance(point, str) and point in static:
            faults.append(
                f"{label}.point: expected a point that moves, got the static one {point!r}; a sensor at rest tells no "
                "length: name another point, or remove use_as_scale"
            )
        if len(views) == 1:
            faults.append(
                f"{label}.use_as_scale: expected two views, got one; state a length of the site instead, or remove it"
            )
    if _get(_get(fields, "site"), "motion"):
        faults.append(
            "site.motion: expected no such key, got one; it is found from sensors with use_as_scale: remove it"
        )
    return faults


def _method_faults(fields: Mapping[str, Any], views: list[Any], view_names: list[str]) -> list[str]:
    faults: list[str] = []
    cameras = _get(_get(fields, "method"), "cameras") or "two-view"
    required = _requirements(cameras)
    chessboard = _get(fields, "chessboard")
    scaled = any(_get(sensor, "use_as_scale") is True for sensor in _entries(fields, "sensor"))
    if "baseline" in required and len(views) > 1 and not scaled and _get(_get(fields, "site"), "baseline") is None:
        faults.append(
            "site.baseline: expected the measured distance between the cameras, got nothing; "
            "add baseline = { value = ..., std = ... } in metres under [site]"
        )
    if "chessboard" in required and chessboard is None:
        faults.append(
            f'chessboard: expected a table [chessboard] for cameras = "{cameras}", got nothing; '
            "add it with pattern, square_mm and images"
        )
    if "camera files" in required:
        faults += [
            f'view[{_get(view, "name")}].camera: expected a file for cameras = "{cameras}", got nothing; '
            'add camera = "..."'
            for view in views
            if _get(view, "camera") is None
        ]
    images = _get(chessboard, "images")
    if isinstance(images, Mapping):
        for name in images:
            faults += _unknown("chessboard.images", name, "view", view_names)
        missing = [name for name in view_names if name not in images] if "chessboard" in required else []
        faults += [f"chessboard.images: expected a pattern for view {name!r}, got none; add it" for name in missing]
    return faults


def _requirements(cameras: Any) -> set[str]:
    """What the session has to state for a camera estimator; nothing where the estimator cannot be had."""
    if not isinstance(cameras, str):
        return set()
    try:
        parts = parts_of("cameras", cameras)
    except BackendUnavailableError:
        return set()
    return {requirement for part in parts.values() for requirement in part.requires}


def _get(entry: Any, key: str) -> Any:
    return entry.get(key) if isinstance(entry, Mapping) else getattr(entry, key, None)


def _entries(fields: Any, key: str) -> list[Any]:
    found = _get(fields, key)
    if not isinstance(found, list | tuple):
        return []
    return [entry for entry in found if isinstance(entry, Mapping | BaseModel)]


def _names(entries: Iterable[Any]) -> list[str]:
    names = (_get(entry, "name") for entry in entries)
    return [name for name in names if isinstance(name, str)]


def _repeated(kind: str, names: list[str]) -> list[str]:
    counted = Counter(names).items()
    return [
        f"{kind}[{name}].name: expected a name of its own, got it {times} times; rename"
        for name, times in counted
        if times > 1
    ]


def _unknown(label: str, name: Any, kind: str, known: list[str]) -> list[str]:
    if not isinstance(name, str) or name in known:
        return []
    close = get_close_matches(name, known, n=1)
    advice = f"did you mean {close[0]!r}?" if close else f"use one of these or add a [[{kind}]]"
    return [f"{label}: expected the name of a {kind} ({', '.join(known) or 'there is none'}), got {name!r}; {advice}"]
