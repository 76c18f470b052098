"""Texts of a report about modes."""

from collections.abc import Mapping

__all__ = ["MODE_TEXTS"]

MODE_TEXTS: Mapping[str, tuple[str, str]] = {
    "title modes": ("Modes", "Eigenformen"),
    "modes settings": (
        "From {channels} series (along {axes}) of {duration} s at {rate} Hz, in the band from {low} to {high} Hz; "
        "linear trend and everything below the band removed. Modes are found by covariance-driven subspace "
        "identification (SSI-cov) with models of up to order {order}; frequency and damping are those at which the "
        "recording is most probable.",
        "Aus {channels} Reihen ({axes}) von {duration} s mit {rate} Hz, im Band von {low} bis {high} Hz; linearer "
        "Trend und alles unterhalb des Bandes entfernt. Die Eigenformen findet die kovarianzbasierte "
        "Unterraum-Identifikation (SSI-cov) mit Modellen bis zur Ordnung {order}; Frequenz und Dämpfung sind die, bei "
        "denen die Aufnahme am wahrscheinlichsten ist.",
    ),
    "modes none": ("No mode is clear of the noise.", "Keine Eigenform hebt sich klar vom Rauschen ab."),
    "modes short": (
        "The recording is too short for the damping of mode {modes}: the interval is as wide as the value.",
        "Die Aufnahme ist zu kurz für die Dämpfung von Form {modes}: Das Intervall ist so breit wie der Wert.",
    ),
    "mode": ("mode", "Form"),
    "damping percent": ("damping [%]", "Dämpfung [%]"),
    "mode interval": ("95 %", "95 %"),
    "mode mpc": ("MPC", "MPC"),
    "mode rms": ("RMS [mm]", "Effektivwert [mm]"),
    "table modes": (
        "Natural frequencies and damping with expanded uncertainty (k = 2) or the interval that holds them with 95 %, "
        "where it is known. MPC: collinearity of the phases, 1 for a real shape. RMS: of the mode at the point that it "
        "moves most.",
        "Eigenfrequenzen und Dämpfung mit erweiterter Unsicherheit (k = 2) oder dem Intervall, das sie mit 95 % "
        "enthält, wo es bekannt ist. MPC: Kollinearität der Phasen, 1 bei reeller Form. Effektivwert: der Form am "
        "Punkt, den sie am stärksten bewegt.",
    ),
    "table shapes": ("Shapes: amplitude and phase by mode.", "Eigenformen: Amplitude und Phase je Form."),
    "figure stabilisation": (
        "Stabilisation diagram: largest singular value of the spectra over the noise (line, dB) and poles by order of "
        "the model (dots; filled: of a mode).",
        "Stabilisierungsdiagramm: größter Singulärwert der Spektren über dem Rauschen (Linie, dB) und Pole je "
        "Modellordnung (Punkte; gefüllt: einer Eigenform).",
    ),
    "figure shapes": (
        "Shapes along the structure: vertical (blue, down as drawn) and lateral (orange).",
        "Formen entlang des Bauwerks: vertikal (blau, nach unten gezeichnet) und quer (orange).",
    ),
    "mode line": ("mode {mode}: {hertz} Hz", "Form {mode}: {hertz} Hz"),
    "modes order": ("order of the model", "Modellordnung"),
    "modes along": ("along the structure [m]", "entlang des Bauwerks [m]"),
    "modes hertz": ("frequency [Hz]", "Frequenz [Hz]"),
}
