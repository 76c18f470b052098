"""Priors of cameras of which profiles are known: what a session states of them, or a file says of its camera."""

from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.constants import NORMAL_95
from vfm_sdm.errors import CameraError
from vfm_sdm.inputs.profiles import (
    LensKey,
    LensProfile,
    aspect_of,
    expect_any,
    expect_lens,
    find_camera,
    find_tagged,
    read_setting,
)
from vfm_sdm.inputs.session import Lens
from vfm_sdm.inputs.video import CameraTags

__all__ = [
    "LensPrior",
    "key_of_stated",
    "key_of_tags",
    "name_of",
    "prior_of_stated",
    "prior_of_tags",
    "prior_of_unknown",
]

_UNKNOWN_CORNER_STD = 0.025
"""Radial distortion at the image corner, over the radius: usual for lenses that are not wide-angle."""
_APART = 1.96
"""Standard deviations by which two focal lengths may differ before they count as those of two modes."""


@dataclass(frozen=True, eq=False)
class LensPrior:
    """What is known of a lens before the images are looked at.

    Parameters
    ----------
    focal
        Focal length over the picture's longer side [1].
    relative_std
        Its relative standard deviation [1].
    corner
        Radial coefficients times powers of the corner's radius over the focal length, ``k_i c^2i``, shape (3,) [1].
    corner_std
        Standard deviation of the first of them [1].
    notes
        Sentences for the summary.
    """

    focal: float
    relative_std: float
    corner: FloatArray
    corner_std: float
    notes: tuple[str, ...] = ()


def prior_of_unknown() -> LensPrior:
    """The prior of a lens of which nothing is known: any that consumer cameras have.

    Examples
    --------
    >>> prior_of_unknown().relative_std > 0.5
    True
    """
    any_lens = expect_any()
    low, high = (_view_deg(any_lens.mean + sign * 2 * any_lens.std) for sign in (1, -1))
    note = (
        "nothing known of the lens; state `lens` in the session, if only its camera. Taken is what consumer cameras "
        f"have, {low:.0f} to {high:.0f} degrees of view"
    )
    return LensPrior(float(np.exp(any_lens.mean)), any_lens.std, np.zeros(3), _UNKNOWN_CORNER_STD, (note,))


def prior_of_stated(lens: Lens, image_size: tuple[float, float], tags: CameraTags) -> LensPrior:
    """The prior of a camera that a session states.

    Parameters
    ----------
    lens
        With ``camera``.
    image_size
        Width and height of the picture, in one unit.
    tags
        What the file says of its camera; where it contradicts a note says so.

    Raises
    ------
    CameraError
        The mode's distortion is not one that the camera model describes.
    """
    aspect = aspect_of(*image_size)
    key = key_of_stated(lens, aspect)
    setting, notes = key.setting, []
    if lens.mode is not None and not setting.mode and setting.film_mm is None:
        notes.append(f"mode {lens.mode!r} names no field of view: taken as unknown; say Linear, Wide, 1x, 26mm or such")
    stated = read_setting([lens.mode or ""], key.kind).aspect
    if stated and stated != aspect:
        notes.append(f"mode {lens.mode!r} is {stated}, and the picture {aspect}: the picture's is taken")
    profile = expect_lens(key)
    if not profile.described:
        advice = "film in a linear mode" if setting.mode else "state the mode, best a linear one"
        raise CameraError(
            f"lens of {name_of(key, lens.camera)}: expected distortion that is radial and moderate, got some that the "
            f"camera model does not describe; {advice}, or calibrate the camera (`camera = FILE`)"
        )
    notes += _contradictions(lens.camera or "", key, profile, tags, aspect)
    said = _describe(f"profiles of {name_of(key, lens.camera)}", profile)
    return _prior(profile, (said, *notes))


def prior_of_tags(tags: CameraTags, image_size: tuple[float, float]) -> LensPrior | None:
    """The prior of the camera that a file names; None where it names none, or none that profiles are known of.

    Parameters
    ----------
    tags
        What the file says.
    image_size
        Width and height of the picture, in one unit.

    Notes
    -----
    A lens that the camera model does not describe is not used: the prior is then that of any lens, and a note says so.
    """
    key = key_of_tags(tags, aspect_of(*image_size))
    if key is None:
        return None
    profile, name = expect_lens(key), name_of(key, f"{tags.make} {tags.model}".strip())
    if not profile.described:
        prior = prior_of_unknown()
        said = f"the file names {name}, whose distortion the camera model does not describe: its profile is not used"
        return replace(prior, notes=(*prior.notes, said))
    said = _describe(f"the file names {name}", profile)
    return _prior(profile, (f"{said}; state `lens` in the session for more",))


def key_of_stated(lens: Lens, aspect: str) -> LensKey:
    """What a stated camera is looked up by.

    Parameters
    ----------
    lens
        With ``camera``.
    aspect
        The picture's format, as `vfm_sdm.inputs.profiles.aspect_of` names it.
    """
    asked = find_camera(lens.camera or "")
    setting = read_setting([lens.mode or ""], asked.kind)
    stabilised = _first(lens.stabilised, setting.stabilised)
    return replace(asked, setting=replace(setting, aspect=aspect, stabilised=stabilised))


def key_of_tags(tags: CameraTags, aspect: str) -> LensKey | None:
    """What the camera that a file names is looked up by; None where the table has nothing of it.

    Parameters
    ----------
    tags
        What the file says.
    aspect
        The picture's format, as `vfm_sdm.inputs.profiles.aspect_of` names it.
    """
    found = find_tagged(tags.make, tags.model) if tags.model or tags.make else None
    if found is None:
        return None
    setting = read_setting(tags.texts, found.kind)
    film_mm = tags.film_mm if tags.film_mm is not None else None if "mm f/" in " ".join(tags.texts) else setting.film_mm
    stabilised = _first(tags.stabilised, setting.stabilised)
    return replace(found, setting=replace(setting, film_mm=film_mm, stabilised=stabilised, aspect=aspect))


def _contradictions(stated: str, key: LensKey, profile: LensProfile, tags: CameraTags, aspect: str) -> list[str]:
    """Notes on a camera or mode that a file names otherwise than the session."""
    tagged = key_of_tags(tags, aspect)
    if tagged is None:
        return []
    named = f"{tags.make} {tags.model}".strip()
    other_brand = bool(key.brand) and tagged.brand != key.brand
    other_model = bool(key.model) and bool(tagged.model) and tagged.model != key.model
    if other_brand or other_model or tagged.kind is not key.kind:
        return [f"the session states {stated!r}, and the file names {named!r}: the session is believed; correct one"]
    notes = []
    if None not in (key.setting.stabilised, tagged.setting.stabilised) and (
        key.setting.stabilised is not tagged.setting.stabilised
    ):
        state = "stabilised" if tagged.setting.stabilised else "not stabilised"
        notes.append(f"the file says that it is {state}, and the session the opposite: the session is believed")
    if key.setting.mode and tagged.setting.mode and key.setting.mode != tagged.setting.mode:
        words = f"{key.setting.mode!r}, and the file {tagged.setting.mode!r}"
        notes.append(f"the session states the mode {words}: the session is believed")
    elif tagged.setting.film_mm is not None:
        other = expect_lens(tagged).log_focal
        away = other.mean - profile.log_focal.mean
        if abs(away) > _APART * np.hypot(other.std, profile.log_focal.std):
            notes.append(
                f"the file names a lens of {tagged.setting.film_mm:g} mm, {np.expm1(away):+.0%} off the mode's"
            )
    return notes


def _prior(profile: LensProfile, notes: tuple[str, ...]) -> LensPrior:
    focal = profile.log_focal
    return LensPrior(float(np.exp(focal.mean)), focal.std, profile.corner, profile.corner_std, notes)


def _describe(source: str, profile: LensProfile) -> str:
    """What was found, by how many, and how far it holds."""
    focal = profile.log_focal
    low, high = (100 * np.expm1(sign * NORMAL_95 * focal.std) for sign in (-1, 1))
    of = {
        "kind": "cameras of the kind",
        "of the mode": "cameras of the kind in this mode",
        "brand": "cameras of the maker",
    }.get(profile.level, "the model")
    said = (
        f"{source} ({profile.calibrators} calibrators of {of}): {_view_deg(focal.mean):.0f} degrees of view, the focal "
        f"length known to {low:+.0f} and {high:+.0f} % (95 %)"
    )
    return said + (f"; the sensor is read in about {profile.readout_ms:.0f} ms" if profile.readout_ms else "")


def name_of(key: LensKey, camera: str | None = None) -> str:
    """A camera with mode, format and state, in words.

    Parameters
    ----------
    key
        What is known of the lens.
    camera
        What the session or the file calls it.
    """
    camera = camera or f"{key.brand} {key.model}".strip() or str(key.kind)
    setting = key.setting
    film = "" if setting.film_mm is None else f"{setting.film_mm:g} mm"
    mode = film or setting.mode or "unknown mode"
    state = {None: "stabilised or not", True: "stabilised", False: "not stabilised"}[setting.stabilised]
    return f"{camera!r}, {mode}, {setting.aspect}, {state}"


def _view_deg(log_focal: float) -> float:
    """Field of view along the longer side [deg]."""
    return float(np.degrees(2 * np.arctan(0.5 / np.exp(log_focal))))


def _first(one: bool | None, other: bool | None) -> bool | None:
    return other if one is None else one
