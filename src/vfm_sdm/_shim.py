"""Temporary, until the registry lands."""

from vfm_sdm.stages.cameras.base import ESTIMATORS, estimator_of
from vfm_sdm.stages.tracking.base import TRACKERS, find_tracker, tracker_of

KINDS = ("cameras", "matchers", "trackers")


def _entry(kind, method):
    if kind == "matchers":
        return "correspondence", TRACKERS["vggt"] if method.correspondence == "vggt" else None
    return (
        ("cameras", ESTIMATORS.get(method.cameras)) if kind == "cameras" else ("tracker", TRACKERS.get(method.tracker))
    )


def settings_read(kind, method):
    word, entry = _entry(kind, method)
    return [word, *(entry.settings if entry else ())]


def code_modules(kind, method):
    _, entry = _entry(kind, method)
    return (entry.module,) if entry else ()


def make(kind, method):
    if kind == "cameras":
        return estimator_of(method)
    if kind == "trackers":
        return tracker_of(method)
    return find_tracker("vggt", network=method.network).inference if method.correspondence == "vggt" else None
