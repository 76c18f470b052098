"""Texts of a report's section on the field: by key, in English and in German."""

from collections.abc import Mapping

__all__ = ["FIELD_TEXTS"]

FIELD_TEXTS: Mapping[str, tuple[str, str]] = {
    "title field": ("Displacement along the structure", "Verschiebung entlang des Bauwerks"),
    "field head": (
        "{count} points were brought together into one line of displacement along the structure, from {begin} m to "
        "{end} m. Bands hold 95 %, errors of scale and cameras included.",
        "Aus {count} Punkten wurde eine Linie der Verschiebung entlang des Bauwerks bestimmt, von {begin} m bis {end} "
        "m. Die Bänder gelten für 95 %, Fehler des Maßstabs und der Kameras eingeschlossen.",
    ),
    "field left out": (
        "{count} points were left out, because they departed from their neighbours or were not seen all the time; "
        "field.nc says why of each.",
        "{count} Punkte blieben außer Betracht, weil sie von ihren Nachbarn abwichen oder nicht durchgehend zu sehen "
        "waren; field.nc nennt für jeden den Grund.",
    ),
    "table field": (
        "Line at the times of the largest displacement along {axis}, with its 95 % band [mm]",
        "Linie zu den Zeiten der größten Verschiebung, {axis}, mit ihrem 95-%-Band [mm]",
    ),
    "station m": ("along m", "längs m"),
    "field at": ("{seconds} s", "{seconds} s"),
    "field shapes": (
        "The structure moved most at these frequencies, each with a shape of its own: {frequencies} Hz.",
        "Am stärksten bewegte sich das Bauwerk bei diesen Frequenzen, jeweils mit eigener Form: {frequencies} Hz.",
    ),
}
