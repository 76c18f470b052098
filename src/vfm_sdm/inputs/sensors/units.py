"""Units as instruments write them in the header of a file."""

import re

__all__ = ["TIME_UNITS", "find_units", "split_name"]

TIME_UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    "d": 86400.0,
}
"""Seconds in each unit of time."""

_SPELLINGS = {
    "g": "g gn g0 g's gee",
    "mg": "mg milli-g millig",
    "m/s2": "m/s2 m/s/s ms-2 m*s-2 m.s-2 m/sec2 m/sec/sec mps2 mpss meter/s2 metre/s2",
    "cm/s2": "cm/s2 cm/s/s cms-2 gal gals",
    "mm/s2": "mm/s2 mm/s/s mms-2",
    "mm": "mm millimeter millimetre millimeters millimetres",
    "m": "m meter metre meters metres",
    "cm": "cm centimeter centimetre centimeters centimetres",
    "um": "um micron microns micrometer micrometre micrometers micrometres",
    "s": "s sec secs second seconds sek sekunden",
    "ms": "ms msec msecs millisecond milliseconds millis millisekunden",
    "us": "us usec microsecond microseconds micros",
    "ns": "ns nsec nanosecond nanoseconds nanos",
    "min": "min mins minute minutes",
    "h": "h hr hrs hour hours",
    "d": "d day days",
}
_UNITS = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}
_POWERS = str.maketrans(
    {"²": "2", "µ": "u", "μ": "u", "·": "*", "⋅": "*", "×": "*", "⁻": "-", **dict.fromkeys("^ ()[]{}", None)}
)
_BRACKETED = re.compile(r"(?P<name>.*?)\s*[(\[{](?P<units>[^()\[\]{}]*(?:\([^()]*\))?[^()\[\]{}]*)[)\]}]\s*$")
_SEPARATED = re.compile(r"(?P<name>.*\S)(?:\s+/\s+|\s+in\s+|\s*[,;:]\s*)(?P<units>\S+)$")
_APPENDED = re.compile(r"(?P<name>.*?[^\W_])[_/ ](?P<units>g|s|[^\s_]{2,})$")


def find_units(text: str) -> str | None:
    """The unit that a text spells, in the package's own spelling; ``None`` where it is none that is known.

    Parameters
    ----------
    text
        Text such as ``[m/s²]``, ``(Gal)`` or ``msec``; brackets around it are left out.

    Examples
    --------
    >>> find_units("m/s^2"), find_units("[ms]"), find_units("volts")
    ('m/s2', 'ms', None)
    """
    plain = text.translate(_POWERS).replace("**", "").casefold()
    return _UNITS.get(plain)


def split_name(text: str) -> tuple[str, str | None]:
    """Name and unit of a column whose header may state both.

    Parameters
    ----------
    text
        Header of a column, such as ``Acceleration x (m/s^2)``, ``Time / ms`` or ``time_ms``.

    Returns
    -------
    name, units
        The name alone and the unit in the package's own spelling; the whole text and ``None`` where no known unit ends
        it.

    Examples
    --------
    >>> split_name("Acceleration x (m/s^2)"), split_name("vertical_mm"), split_name("a_x"), split_name("ms")
    (('Acceleration x', 'm/s2'), ('vertical', 'mm'), ('a_x', None), ('ms', None))
    """
    for pattern in (_BRACKETED, _SEPARATED, _APPENDED):
        found = pattern.match(text.strip())
        if found and (units := find_units(found["units"])) is not None and found["name"].strip():
            return found["name"].strip(), units
    return text.strip(), None
