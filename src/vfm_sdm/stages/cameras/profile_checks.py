"""Whether the focal length that everything else gives is that of the camera and mode that are stated or named.

A profile's interval covers what calibrators differ by, and so hides a wrong mode: cropping for stabilisation takes some
nine per cent, as much as two calibrators may differ by. Most of them agree far better than that. Where a length on the
structure or a calibration tells the focal length, it is asked which of the camera's modes lies nearest.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vfm_sdm.core.arrays import LumaArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.inputs.profiles import CROP, LensKey, aspect_of, expect_lens, list_modes
from vfm_sdm.inputs.session import Session, View, camera_tags, pixel_aspect
from vfm_sdm.stages.cameras.profile_priors import key_of_stated, key_of_tags, name_of

__all__ = ["Found", "compare_with_mode", "compare_with_profiles", "find_focals"]

_LEAST_REDUNDANCY = 0.5
"""Share of the prior's variance that everything else has to take away for it to be checked."""
_CLEAR = 1.645
"""Standard deviations of a difference that chance exceeds in one of ten: it is a mode to look at again."""
_HALF_A_CROP = -float(np.log(CROP)) / 2
"""Logarithm of the focal length half way between those of the two states of stabilisation."""


@dataclass(frozen=True)
class Found:
    """Logarithm of focal length over longer side that everything but the profile gives, with its standard deviation."""

    log_focal: float
    std: float


def compare_with_profiles(session: Session, frames: Mapping[str, LumaArray], prior: Rig, adjusted: Rig) -> list[str]:
    """Sentences on lenses whose focal length is that of another mode than the stated or named one.

    Parameters
    ----------
    session
        What is stated of the lenses.
    frames
        First frame of every view by name, shape (H, W) each.
    prior, adjusted
        Cameras before and after the adjustment to the site, with their covariances.

    Notes
    -----
    A prior from a profile is taken out of the adjusted value first, because it drew it to itself: with the share r of
    the prior's variance that everything else took away, the value without it is the prior's plus 1/r of the way to the
    adjusted one, and its variance 1/r of the adjusted one's.
    """
    found = list(find_focals(session, frames, prior, adjusted))
    said = [(name, compare_with_mode(key, focal)) for name, key, focal in found]
    return [f"view {name!r}: {sentence}" for name, sentence in said if sentence]


def find_focals(
    session: Session, frames: Mapping[str, LumaArray], prior: Rig, adjusted: Rig
) -> Iterator[tuple[str, LensKey, Found]]:
    """Views whose camera is stated or named, with what everything else gives for its focal length.

    Parameters
    ----------
    session, frames, prior, adjusted
        As in `compare_with_profiles`.
    """
    if prior.covariance is None or adjusted.covariance is None:
        return
    views = {view.name: view for view in session.view}
    variances = [np.diag(c)[:: len(CAMERA_PARAMETERS)] for c in (prior.covariance, adjusted.covariance)]
    for place, name in enumerate(prior.names):
        known = _key(views[name], frames)
        if known is None or variances[0][place] <= 0:
            continue
        key, of_prior = known
        start, end = (float(np.log(rig.cameras[place].focal_px / _longer(rig, place))) for rig in (prior, adjusted))
        redundancy = 1 - variances[1][place] / variances[0][place]
        if of_prior and redundancy < _LEAST_REDUNDANCY:
            continue
        share = redundancy if of_prior else 1.0
        focal = Found(start + (end - start) / share, float(np.sqrt(variances[1][place] / share)))
        yield name, key, focal


def compare_with_mode(key: LensKey, found: Found) -> str:
    """A sentence where a focal length lies nearer to another mode of a camera than to this one; else empty.

    Parameters
    ----------
    key
        Camera and mode as stated.
    found
        The focal length that everything else gives.

    Examples
    --------
    >>> from vfm_sdm.inputs.profiles import CameraClass, Setting
    >>> linear = LensKey(CameraClass.ACTION, "gopro", "hero7black", Setting("linear", None, False, "16:9"))
    >>> expected = expect_lens(linear).log_focal.mean
    >>> compare_with_mode(linear, Found(expected + 0.01, 0.01))
    ''
    >>> "10 % longer" in compare_with_mode(linear, Found(expected + np.log(1.1), 0.01))
    True
    """
    setting = key.setting
    if not key.model or (not setting.mode and setting.film_mm is None):
        return ""
    expected = expect_lens(key).log_focal.mean
    away = found.log_focal - expected
    if abs(away) <= max(_HALF_A_CROP, _CLEAR * found.std):
        return ""
    others = sorted((abs(found.log_focal - mean), words) for words, mean in _others(key, expected))
    nearer = [words for distance, words in others if distance < abs(away)]
    percent = 100 * abs(float(np.expm1(away)))
    said = (
        f"everything else gives a focal length {percent:.0f} % {'longer' if away > 0 else 'shorter'} than calibrators "
        f"of {name_of(key)} found"
    )
    return f"{said}; nearer lies: {nearer[0] if nearer else 'none of its modes'}; check mode and stabilisation"


def _others(key: LensKey, expected: float) -> Iterator[tuple[str, float]]:
    """Other states and modes of a camera, with the logarithm of their focal length over the longer side."""
    setting = key.setting
    if setting.stabilised is not None:
        crop = float(np.log(CROP))
        yield ("not stabilised", expected + crop) if setting.stabilised else ("stabilised", expected - crop)
    for mode in list_modes(key):
        if mode != setting.mode:
            other = replace(key, setting=replace(setting, mode=mode, film_mm=None))
            yield f"mode {mode!r}", expect_lens(other).log_focal.mean


def _key(view: View, frames: Mapping[str, LumaArray]) -> tuple[LensKey, bool] | None:
    """Camera and mode of a view, and whether they are its prior; None where nobody says."""
    luma = frames[view.name]
    size = (luma.shape[1] * pixel_aspect(frames, view.name), luma.shape[0])
    if view.camera is not None:
        return None
    if view.lens is not None and view.lens.camera is not None:
        return key_of_stated(view.lens, aspect_of(*size)), True
    named = key_of_tags(camera_tags(frames, view.name), aspect_of(*size))
    return None if named is None else (named, view.lens is None)


def _longer(rig: Rig, place: int) -> float:
    return float(max(rig.cameras[place].image_size))
