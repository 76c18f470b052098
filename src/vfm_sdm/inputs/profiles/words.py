"""What people and files call cameras and their settings, brought to one form.

Calibrators, sessions and metadata name the same thing in many ways: ``HERO 5 black``, ``4K 16:9 Linear, NO-EIS``,
``iPhone 13 Pro back camera 5.7mm``. Names are compared without spaces and signs, settings by the words in them.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["CameraClass", "Setting", "aspect_of", "class_of", "plain", "plain_model", "read_setting"]


class CameraClass(StrEnum):
    """Kinds of cameras whose lenses resemble each other; each can be stated in place of a model."""

    PHONE = "phone"
    ACTION = "action camera"
    DRONE = "drone"
    CAMERA = "camera"
    """With a lens that is chosen by its owner: system and cinema cameras, camcorders."""


@dataclass(frozen=True)
class Setting:
    """What a text says of the lens and how it was used.

    Parameters
    ----------
    mode
        Word for the field of view, such as ``linear``; empty where there is none.
    film_mm
        Focal length that is named [mm]: of the lens itself on cameras, its equivalent for 35 mm film on phones.
    stabilised
        Whether the picture is stabilised by cropping; ``None`` where nothing is said.
    aspect
        Picture's longer side over its shorter one, such as ``16:9``; empty where there is none.
    """

    mode: str = ""
    film_mm: float | None = None
    stabilised: bool | None = None
    aspect: str = ""


_OFF = re.compile(
    r"\b(?:no|non|without|w/o|kein)[ -]*"
    r"(?:eis|o?is|ibis|stab\w*|steady\w*|rock ?steady|rs|image stab\w*|hypersmooth|hs)\b"
    r"|\bnoeis\b|(?:eis|ois|ibis|stab\w*|steady ?shot|rock ?steady|smooth|hs)[ -:]*(?:off|no|n|disabled)\b"
    r"|\boff[ -]*(?:eis|ibis|ois|stab\w*)|disabled stab\w*|无防抖|防抖关闭|关防抖|关闭防抖|no software stab\w*"
)
_ON = re.compile(
    r"\b(?:e-?is|hs|hyper ?smooth|rock ?steady|super ?steady|steady ?shot|steady|horizon ?steady|smoothing|ibis)\b"
    r"|stab\w*[ -]*(?:on|active|std|high|yes|y)\b|stabiliz?s?ed|防抖"
)
_MODES = (
    ("hyperview", r"hyper ?view"),
    ("superview", r"super ?view|\bsuper\b|\bmsv\b"),
    ("max lens", r"max ?lens|\bmax\b"),
    ("linear", r"linear|lineal|dewarp(?:ed)?(?:[ _]on)?(?![ _]*off)\b|\bldc on\b|distortion correction on"),
    ("narrow", r"narrow|schmal"),
    ("medium", r"\bmed(?:ium)?\b"),
    ("ultra wide", r"ultra[ -]?wide|\buwide\b|(?<![\d./])0?[.,][56]\b|\buw\b"),
    ("wide", r"\bwide|gran ?angular|weitwinkel"),
    ("tele", r"\btele|\b(?:2|3|5|10)(?:\.0)? ?x\b|\bx ?(?:2|3|5|10)\b"),
    ("main", r"\bmain\b|\b1(?:[.,]0)? ?x\b|\bx ?1(?:[.,]0)?\b|primary|主摄"),
)
_PATTERNS = tuple((name, re.compile(pattern)) for name, pattern in _MODES)
_RANGE = re.compile(r"\d+(?:[.,]\d+)? ?(?:mm)? ?[-_/–] ?\d+(?:[.,]\d+)? ?mm|\b\d{2,3}[-_–]\d{2,3}\b")
_MILLIMETRES = re.compile(r"(?<![\d.,/])(\d{1,3}(?:[.,]\d{1,2})?) ?mm\b")
_LIMITS_MM = (6.0, 800.0)
_ASPECT = re.compile(r"\b(16|17|4|3|8|21|9|1) ?[:x/] ?(9|10|3|2|7|16|4|1)\b")
_ASPECTS = {"16:9": 16 / 9, "4:3": 4 / 3, "3:2": 3 / 2, "17:9": 256 / 135, "8:7": 8 / 7, "1:1": 1.0, "2:1": 2.0}
_SAME_ASPECT = 0.02

_RANGES = r"\b(?:galaxy|lumix|eos|alpha|moto|smartphone|camera)\b"
_CODES = {
    # What Samsung's phones write of themselves, up to the letter of the region.
    **{f"smg97{n}": f"s10{v}" for n, v in ((0, "e"), (3, ""), (5, "+"))},
    **{f"smg98{n}": f"s20{v}" for n, v in ((1, ""), (6, "+"), (8, "ultra"))},
    **{f"smg99{n}": f"s21{v}" for n, v in ((1, ""), (6, "+"), (8, "ultra"))},
    **{f"sms9{n}{m}": f"s2{n + 2}{v}" for n in range(4) for m, v in ((1, ""), (6, "+"), (8, "ultra"))},
    # What DJI's cameras write.
    **{"fc7303": "mini2", "fc3411": "air2s", "fc3170": "air2", "fc3582": "mini3pro", "l1d20c": "mavic2pro"},
    **{"fc2204": "mavic2zoom", "l2d20c": "mavic3", "fc8282": "air3"},
}
_FIRMWARE = {
    # First part of the firmware's name that GoPro writes into its files.
    **{"hd301": "hero3", "hd302": "hero3silver", "hd303": "hero3black", "hd311": "hero3+black", "hd401": "hero4silver"},
    **{"hd402": "hero4black", "hx101": "herosession", "hd502": "hero5black", "hd503": "hero5session"},
    **{"hd601": "hero6black", "hd701": "hero7black", "hd702": "hero7silver", "hd703": "hero7white"},
    **{"hd801": "hero8black", "hd901": "hero9black", "h2101": "hero10black", "h2201": "hero11black"},
    **{"h2203": "hero11blackmini", "h2301": "hero12black", "h2401": "hero13black", "h1903": "max"},
}
_SONY = re.compile(r"^ilce(7|9|1|\d{4})([rsc]*)(?:m(\d))?")
_ROMAN = {"2": "ii", "3": "iii", "4": "iv", "5": "v"}
"""What Sony's cameras call themselves, and people call them: ILCE-7M4 and a7 IV."""
_PHONES = [
    "apple",
    "samsung",
    "google",
    "xiaomi",
    "oneplus",
    "huawei",
    "vivo",
    "motorola",
    "redmi",
    "poco",
    "lg",
    "lge",
    "realme",
    "oppo",
    "honor",
    "zte",
    "asus",
    "nothing",
    "nokia",
    "fairphone",
    "blackshark",
    "blackberry",
    "generalmobile",
    "meizu",
    "iqoo",
    "sharp",
    "ulefone",
    "nubia",
    "umidigi",
    "tecno",
    "infinix",
    "lenovo",
    "volla",
    "hp",
    "mi",
]
_CAMERAS = [
    "sony",
    "red",
    "canon",
    "blackmagic",
    "panasonic",
    "fujifilm",
    "nikon",
    "zcam",
    "sigma",
    "kinefinity",
    "olympus",
    "arri",
    "leica",
    "freefly",
    "pentax",
    "digitalbolex",
    "hasselblad",
    "jvc",
    "ricoh",
    "chronos",
    "casio",
    "om",
    "omsystem",
    "kodak",
    "fujifilmx",
    "fufifilm",
]
_DRONES = ["fimi", "holystone", "skydio", "parrot", "autel", "ryze", "visuo", "yuneec", "jjrcx5", "hubsan"]
_ACTION_MODELS = re.compile(
    r"^yi|mijia|actioncam|miaction|gear360|as\d00|x[13]000|x1000|hdras|osmoaction|^action\d|rx0|keymission|^actionpro|miniactioncam"
)
_DRONE_MODELS = re.compile(
    r"mini[\d ]|^mini|mavic|^air\d|^air$|phantom|spark|avata|inspire|^fpv|airunit|^fc\d{3}|^l[12]d|^o[34]|flip|neo"
)
_PHONE_MODELS = re.compile(r"xperia|^pixel")
_HAND_HELD = re.compile(r"pocket|zenmuse|ronin|^4d|osmo$|^osmo")


def plain(name: str) -> str:
    """A name in lower case without spaces and signs that people set as they like.

    Parameters
    ----------
    name
        Any name.

    Examples
    --------
    >>> plain("HERO 5 Black"), plain("X-T3")
    ('hero5black', 'xt3')
    """
    return re.sub(r"[^\w+]|_", "", name.casefold())


def plain_model(brand: str, model: str) -> str:
    """A model's name without its brand and range, as `plain`; codes of firmware and of sales become names.

    Parameters
    ----------
    brand, model
        As somebody wrote them.

    Examples
    --------
    >>> plain_model("Samsung", "Samsung Galaxy S22"), plain_model("samsung", "SM-S901B")
    ('s22', 's22')
    >>> plain_model("GoPro", "HD9.01.01.72.00"), plain_model("Sony", "ILCE-7SM3")
    ('hero9black', 'a7siii')
    """
    text = re.sub(rf"^\W*{re.escape(brand.casefold())}\b", " ", model.casefold().strip()) if brand else model.casefold()
    short = plain(re.sub(_RANGES, " ", text)).removeprefix(plain(brand)) or plain(text) or plain(model)
    short = re.sub(r"plus$", "+", short)
    body = _SONY.match(short)
    if body is not None:
        return f"a{body[1]}{body[2]}{_ROMAN.get(body[3] or '', '')}"
    for table in (_CODES, _FIRMWARE):
        known = next((name for code, name in table.items() if short.startswith(code)), None)
        if known is not None:
            return known
    return short


def class_of(brand: str, model: str) -> CameraClass:
    """The kind of a camera.

    Parameters
    ----------
    brand, model
        Names as `plain` gives them.

    Examples
    --------
    >>> class_of("gopro", "hero5black").value, class_of("sony", "xperia1").value, class_of("dji", "mini2").value
    ('action camera', 'phone', 'drone')
    """
    if _ACTION_MODELS.search(model):
        return CameraClass.ACTION
    if _PHONE_MODELS.search(model):
        return CameraClass.PHONE
    if brand == "dji":
        return CameraClass.DRONE if _DRONE_MODELS.search(model) and not _HAND_HELD.search(model) else CameraClass.ACTION
    if brand == "samsung" and model.startswith("nx"):
        return CameraClass.CAMERA
    kinds = ((_PHONES, CameraClass.PHONE), (_CAMERAS, CameraClass.CAMERA), (_DRONES, CameraClass.DRONE))
    return next((kind for brands, kind in kinds if brand in brands), CameraClass.ACTION)


def read_setting(texts: Iterable[str], kind: CameraClass) -> Setting:
    """What texts say of the lens.

    Parameters
    ----------
    texts
        Name of the lens, setting, notes: in any language, with anything else in them.
    kind
        The kind of camera, which decides what "wide" means.

    Notes
    -----
    On phones the lens that is called wide is the main one, beside an ultra-wide one and a longer one. Of two focal
    lengths the first that is not the end of a zoom's range counts.

    Examples
    --------
    >>> read_setting(["4K 16:9 Linear", "NO-EIS"], CameraClass.ACTION)
    Setting(mode='linear', film_mm=None, stabilised=False, aspect='16:9')
    >>> read_setting(["Sigma 18-35mm @ 24mm"], CameraClass.CAMERA).film_mm
    24.0
    """
    text = " | ".join(texts).casefold()
    stabilised = False if _OFF.search(text) else True if _ON.search(text) else None
    mode = next((name for name, pattern in _PATTERNS if pattern.search(text)), "")
    if kind is CameraClass.PHONE:
        mode = {"wide": "main", "max lens": "", "linear": "", "medium": ""}.get(mode, mode)
    elif kind is CameraClass.CAMERA:
        mode = ""
    else:
        mode = {"main": "", "tele": ""}.get(mode, mode)
    named = (float(one.replace(",", ".")) for one in _MILLIMETRES.findall(_RANGE.sub(" ", text)))
    film_mm = next((one for one in named if _LIMITS_MM[0] <= one <= _LIMITS_MM[1]), None)
    if kind not in (CameraClass.PHONE, CameraClass.CAMERA):
        film_mm = None
    return Setting(mode, film_mm, stabilised, _read_aspect(text))


def _read_aspect(text: str) -> str:
    for wide, high in _ASPECT.findall(text):
        sides = sorted((int(wide), int(high)))
        name = aspect_of(sides[1], sides[0])
        if name in _ASPECTS:
            return name
    return ""


def aspect_of(width: float, height: float) -> str:
    """The name of a picture's format, lying or upright, such as ``16:9``; of unusual ones the ratio.

    Parameters
    ----------
    width, height
        Sides of the picture, of one unit.

    Examples
    --------
    >>> aspect_of(1920, 1080), aspect_of(1080, 1440), aspect_of(2704, 1000)
    ('16:9', '4:3', '2.70:1')
    """
    ratio = max(width, height) / min(width, height)
    name = min(_ASPECTS, key=lambda one: abs(ratio / _ASPECTS[one] - 1))
    return name if abs(ratio / _ASPECTS[name] - 1) <= _SAME_ASPECT else f"{ratio:.2f}:1"
