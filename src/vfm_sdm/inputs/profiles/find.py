"""A camera as people name it, or as files do, found in the table of profiles."""

from collections import Counter
from difflib import get_close_matches
from functools import cache

from vfm_sdm.inputs.profiles.hierarchy import LensKey
from vfm_sdm.inputs.profiles.table import read_table
from vfm_sdm.inputs.profiles.words import CameraClass, class_of, plain, plain_model

__all__ = ["find_camera", "find_tagged"]

_SUGGESTED, _CLOSE = 4, 0.5


def find_camera(name: str) -> LensKey:
    """What a stated camera is looked up by: brand and model, a brand alone, or a kind of camera.

    Parameters
    ----------
    name
        Such as ``GoPro HERO11 Black``, ``iPhone 13``, ``phone``.

    Raises
    ------
    ValueError
        Nothing of that name is in the table, or several brands have it; the nearest names are told.

    Examples
    --------
    >>> find_camera("GoPro HERO 7 black").model, find_camera("iPhone 13").brand, find_camera("phone").kind.value
    ('hero7black', 'apple', 'phone')
    """
    kinds = {plain(kind): kind for kind in CameraClass}
    if plain(name) in kinds:
        return LensKey(kinds[plain(name)])
    brands = sorted((brand for brand in _cameras() if plain(name).startswith(brand)), key=len, reverse=True)
    for brand in brands:
        models = _cameras()[brand]
        if plain(name) == brand:
            return LensKey(CameraClass(Counter(models.values()).most_common(1)[0][0]), brand)
        model = plain_model(brand, plain(name).removeprefix(brand))
        if model in models:
            return LensKey(CameraClass(models[model]), brand, model)
    alone = {brand: model for brand, models in _cameras().items() if (model := plain_model(brand, name)) in models}
    if len(alone) == 1:
        brand, model = alone.popitem()
        return LensKey(CameraClass(_cameras()[brand][model]), brand, model)
    words = ", ".join(repr(str(kind)) for kind in CameraClass)
    if alone:
        said = " or ".join(repr(f"{brand} {name}") for brand in alone)
        raise ValueError(f"camera: expected one camera, got {name!r}, which several makers have; say {said}")
    near = get_close_matches(plain(name), list(_names()), n=_SUGGESTED, cutoff=_CLOSE)
    nearest = f"; nearest: {', '.join(repr(_names()[one]) for one in near)}" if near else ""
    raise ValueError(f"camera: expected a camera with profiles, or one of {words}, got {name!r}{nearest}; choose one")


def find_tagged(make: str, model: str) -> LensKey | None:
    """What the camera that a file names is looked up by: as much of it as the table has; None where it has nothing.

    Parameters
    ----------
    make, model
        As the file says.

    Examples
    --------
    >>> find_tagged("Apple", "iPhone 13").model, find_tagged("samsung", "SM-S901B").model, find_tagged("Unheard", "of")
    ('iphone13', 's22', None)
    """
    try:
        if not make:
            return find_camera(model)
    except ValueError:
        return None
    said = {plain(make), plain(make.split(maxsplit=1)[0])}
    brand = next((one for one in _cameras() if one in said), None)
    if brand is None:
        return None
    short = plain_model(brand, model)
    known = short in _cameras()[brand]
    return LensKey(class_of(brand, short), brand, short if known else "")


@cache
def _cameras() -> dict[str, dict[str, str]]:
    """Kinds of the models of every brand, by plain names."""
    table, found = read_table(), dict[str, dict[str, str]]()
    for brand, model, kind in zip(table.brand, table.model, table.kind, strict=True):
        found.setdefault(str(brand), {})[str(model)] = str(kind)
    return found


@cache
def _names() -> dict[str, str]:
    """Names of the cameras as most calibrators wrote them, by plain ones."""
    table = read_table()
    return {f"{b}{m}": str(name) for b, m, name in zip(table.brand, table.model, table.name, strict=True)}
