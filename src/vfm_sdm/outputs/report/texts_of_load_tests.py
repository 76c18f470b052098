"""Texts of a report about load tests: steps, what remains, and vehicles that passed."""

from collections.abc import Mapping

__all__ = ["LOAD_TEST_TEXTS"]

LOAD_TEST_TEXTS: Mapping[str, tuple[str, str]] = {
    "title load test": ("Load test", "Belastungsversuch"),
    "load test head": (
        "Deflection of each step from the first one on, along {axis}, with expanded uncertainty (95 %). "
        "P is the probability that a limit is exceeded, after the uncertainty of the measurement alone; whoever "
        "calculated has an uncertainty, too.",
        "Durchbiegung jeder Stufe gegen die erste, {axis}, mit erweiterter Unsicherheit (95 %). "
        "P ist die Wahrscheinlichkeit, dass ein Grenzwert überschritten ist, allein nach der Unsicherheit der Messung; "
        "auch die Berechnung ist unsicher.",
    ),
    "stillness given": (
        "When each step stood was stated.",
        "Wann jede Stufe stand, wurde angegeben.",
    ),
    "stillness found": (
        "When each step stood was found in the displacement; compare the times with the notes of the test.",
        "Wann jede Stufe stand, wurde in der Verschiebung gefunden; die Zeiten sind mit dem Protokoll zu vergleichen.",
    ),
    "table steps": (
        "Steps along {axis}; the ratio is measured over calculated.",
        "Laststufen, {axis}; das Verhältnis ist gemessen durch berechnet.",
    ),
    "table residual": (
        "What remains after unloading along {axis}, as a share of the largest deflection, and the slope of deflection "
        "against load.",
        "Bleibende Verformung nach der Entlastung, {axis}, als Anteil der größten Durchbiegung, und Steigung der "
        "Durchbiegung über der Last.",
    ),
    "figure load": (
        "Deflection along {axis} against load, with expanded uncertainty (95 %); crosses are calculated values.",
        "Durchbiegung {axis} über der Last mit erweiterter Unsicherheit (95 %); Kreuze sind berechnete Werte.",
    ),
    "figure load label": ("deflection against load", "Durchbiegung über der Last"),
    "load": ("load [{units}]", "Last [{units}]"),
    "stood": ("stood [s]", "stand [s]"),
    "deflection mm": ("deflection [mm]", "Durchbiegung [mm]"),
    "calculated mm": ("calculated [mm]", "berechnet [mm]"),
    "ratio": ("ratio", "Verhältnis"),
    "exceeds ratio": ("P (ratio > {limit})", "P (Verhältnis > {limit})"),
    "largest mm": ("largest [mm]", "größte [mm]"),
    "residual mm": ("residual [mm]", "bleibend [mm]"),
    "share percent": ("share [%]", "Anteil [%]"),
    "exceeds share": ("P (share > {limit} %)", "P (Anteil > {limit} %)"),
    "slope": ("slope [mm per unit of load]", "Steigung [mm je Lasteinheit]"),
    "static left out": (
        "Points that must not move are left out: {count}; {where} holds all points.",
        "Festpunkte sind weggelassen: {count}; {where} enthält alle Punkte.",
    ),
    "static moved in step": (
        "Static point {point} moved by {size} mm along {axis} in step {number}: a camera moved, or the point did; "
        "other points may be wrong by as much.",
        "Festpunkt {point} hat sich in Stufe {number} um {size} mm bewegt ({axis}): eine Kamera oder der Punkt selbst "
        "hat sich bewegt; andere Punkte können um ebenso viel falsch sein.",
    ),
    "static moved in passage": (
        "Static point {point} moved by {size} mm along {axis} in passage {number}: a camera moved, or the point did; "
        "other points may be wrong by as much.",
        "Festpunkt {point} hat sich bei Überfahrt {number} um {size} mm bewegt ({axis}): eine Kamera oder der Punkt "
        "selbst hat sich bewegt; andere Punkte können um ebenso viel falsch sein.",
    ),
    # Passages.
    "title passages": ("Passages", "Überfahrten"),
    "passages head": (
        "Dynamic amplification: largest displacement over the largest of its static part, which is what lies below the "
        "cutoff. The interval (95 %) holds noise, the choice of the cutoff, and what the passage itself adds to the "
        "static part.",
        "Dynamischer Überhöhungsfaktor: größte Verschiebung durch die größte ihres statischen Anteils, der unterhalb "
        "der Grenzfrequenz liegt. Das Intervall (95 %) enthält Rauschen, die Wahl der Grenzfrequenz und was die "
        "Überfahrt selbst zum statischen Anteil beiträgt.",
    ),
    "passages frequency": (
        "Natural frequency along {axis}: {hertz} Hz, {origin}. The cutoff lies between it and the static part of a "
        "passage of that duration.",
        "Eigenfrequenz, {axis}: {hertz} Hz, {origin}. Die Grenzfrequenz liegt zwischen ihr und dem statischen Anteil "
        "einer Überfahrt dieser Dauer.",
    ),
    "passages frequency given": ("as stated", "wie angegeben"),
    "passages frequency found": (
        "found as the strongest oscillation of each point",
        "gefunden als stärkste Schwingung jedes Punkts",
    ),
    "passages frequency none": (
        "Along {axis} no natural frequency stands clear of the noise: static and dynamic part cannot be told apart.",
        "Keine Eigenfrequenz hebt sich klar vom Rauschen ab ({axis}): statischer und dynamischer Anteil sind nicht zu "
        "trennen.",
    ),
    "table passages": ("Passages along {axis}.", "Überfahrten, {axis}."),
    "passage time": ("time [s]", "Zeit [s]"),
    "speed": ("speed [km/h]", "Geschwindigkeit [km/h]"),
    "total mm": ("total [mm]", "gesamt [mm]"),
    "static mm": ("static [mm]", "statisch [mm]"),
    "amplification": ("amplification", "Überhöhung"),
    "interval": ("interval", "Intervall"),
    "cutoff hz": ("cutoff [Hz]", "Grenzfrequenz [Hz]"),
    "status": ("status", "Status"),
    "figure static": (
        "Static displacement along {axis} against the place of the first axle, with expanded uncertainty (95 %).",
        "Statische Verschiebung {axis} über dem Ort der ersten Achse, mit erweiterter Unsicherheit (95 %).",
    ),
    "figure influence": (
        "Influence lines along {axis}: static displacement under 1 kN against its place, with expanded uncertainty "
        "(95 %).",
        "Einflusslinien {axis}: statische Verschiebung unter 1 kN über deren Ort, mit erweiterter Unsicherheit (95 %).",
    ),
    "figure static label": ("displacement against place", "Verschiebung über dem Ort"),
    "place m": ("place [m]", "Ort [m]"),
    "share of passage": ("share of the passage", "Anteil der Überfahrt"),
    "passage status ok": ("ok", "ok"),
    "passage status gaps": ("gaps", "Lücken"),
    "passage status no frequency": ("no frequency", "keine Frequenz"),
    "passage status too fast": ("too fast", "zu schnell"),
    "passage status within noise": ("within noise", "im Rauschen"),
}
"""Text of every key in English and German."""
