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
    "origin first valid sample": ("first valid sample", "erster gültiger Wert"),
    "origin mean of the still interval": ("mean of the still interval", "Mittel über das Ruheintervall"),
    "origin differs": (
        "Displacement is relative to something else from run to run, so that runs differ by a constant, which is not "
        "in the peak-to-peak: {listed}.",
        "Die Verschiebungen der Auswertungen beziehen sich auf Verschiedenes und unterscheiden sich so um eine "
        "Konstante, die nicht in der Schwingweite ist: {listed}.",
    ),
    "start differs": (
        "The runs state other dates and times for time zero: {listed}.",
        "Die Auswertungen geben für den Zeitpunkt null Verschiedenes an: {listed}.",
    ),
    "first frame differs": (
        "The first valid sample, which displacement is relative to, is not of the same frame in all runs, so that they "
        "differ by a constant, which is not in the peak-to-peak: {points}.",
        "Der erste gültige Wert, auf den sich die Verschiebung bezieht, liegt nicht in allen Auswertungen im selben "
        "Bild; sie unterscheiden sich um eine Konstante, die nicht in der Schwingweite ist: {points}.",
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
