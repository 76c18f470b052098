"""Texts of a report about repeatability and reproducibility, and about results that are older than the displacement."""

from collections.abc import Mapping

__all__ = ["REPEATABILITY_TEXTS"]

REPEATABILITY_TEXTS: Mapping[str, tuple[str, str]] = {
    "outdated": (
        "This was made of an earlier displacement of this folder: run `vfm-sdm {command}` again before it is used.",
        "Dies entstand aus einer früheren Verschiebung dieses Ordners: vor der Verwendung `vfm-sdm {command}` "
        "erneut ausführen.",
    ),
    "title repeatability": ("Repeatability and reproducibility", "Wiederhol- und Vergleichpräzision"),
    "repeatability head": (
        "The same films were measured {count} times by {people} persons ({names}), who placed the points and noted the "
        "site themselves. Standard deviations after ISO 5725-2, with intervals of 95 %: of results of one person, and "
        "of single results of different persons. Noise of the pictures is the same for all and not in them; where they "
        "exceed the standard uncertainty that the runs state, the runs contradict what they state.",
        "Dieselben Filme wurden {count}-mal von {people} Personen ausgewertet ({names}), die Punkte und Aufstellung "
        "selbst angaben. Standardabweichungen nach ISO 5725-2 mit Intervallen von 95 %: von Ergebnissen einer Person "
        "und von einzelnen Ergebnissen verschiedener Personen. Das Rauschen der Bilder ist für alle gleich und nicht "
        "enthalten; wo sie die angegebene Standardunsicherheit übersteigen, widersprechen die Auswertungen ihren "
        "eigenen Angaben.",
    ),
    "table repeatability": ("{quantity}, standard deviations in mm.", "{quantity}, Standardabweichungen in mm."),
    "quantity displacement": ("Displacement (all samples)", "Verschiebung (alle Werte)"),
    "quantity peak_to_peak": ("Peak-to-peak", "Schwingweite"),
    "one person": ("one person [mm]", "eine Person [mm]"),
    "different persons": ("different persons [mm]", "verschiedene Personen [mm]"),
    "stated": ("stated [mm]", "angegeben [mm]"),
    "consistency": ("spread / stated", "Streuung / angegeben"),
}
"""Text of every key in English and German."""
