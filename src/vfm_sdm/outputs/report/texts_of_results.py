"""Texts of a report around its figures: results, histories, budget, audit, comparison."""

from collections.abc import Mapping

__all__ = ["RESULT_TEXTS"]

RESULT_TEXTS: Mapping[str, tuple[str, str]] = {
    # Results.
    "title results": ("Results", "Ergebnisse"),
    "results head": (
        "Each value stands with its expanded uncertainty (k = 2, about 95 %). Only samples with status ok count; "
        "zero is "
        "the origin named above. An asterisk marks points that must not move.",
        "Jeder Wert steht mit seiner erweiterten Unsicherheit (k = 2, etwa 95 %). Nur Werte mit Status ok zählen; "
        "null ist "
        "der oben genannte Ursprung. Ein Stern kennzeichnet Punkte, die sich nicht bewegen dürfen.",
    ),
    "table results": (
        "Displacement in mm; times in s from the first frame of the reference view. Shift: mean over the last "
        "{length} s "
        "less the mean over the first {length} s. Frequency: of the strongest oscillation that stands clear of the "
        "noise.",
        "Verschiebung in mm; Zeiten in s ab dem ersten Bild der Referenzansicht. Verlagerung: Mittel der letzten "
        "{length} s "
        "minus Mittel der ersten {length} s. Frequenz: der stärksten Schwingung, die sich klar vom Rauschen abhebt.",
    ),
    "axis": ("axis", "Achse"),
    "p2p": ("peak-to-peak [mm]", "Schwingweite [mm]"),
    "highest": ("maximum [mm]", "Maximum [mm]"),
    "lowest": ("minimum [mm]", "Minimum [mm]"),
    "at": ("at [s]", "bei [s]"),
    "rms": ("RMS [mm]", "Effektivwert [mm]"),
    "shift": ("shift [mm]", "Verlagerung [mm]"),
    "dominant": ("frequency [Hz]", "Frequenz [Hz]"),
    "table quality": (
        "Quality by point. Noise: standard deviation of one sample (median). Limit: smallest amplitude of an "
        "oscillation "
        "that is told from noise over the recording. Scale: expanded relative uncertainty (k = 2).",
        "Güte je Punkt. Rauschen: Standardabweichung eines Werts (Median). Grenze: kleinste Amplitude einer "
        "Schwingung, die "
        "über die Aufnahme vom Rauschen zu unterscheiden ist. Maßstab: erweiterte relative Unsicherheit (k = 2).",
    ),
    "valid": ("valid [%]", "gültig [%]"),
    "noise of": ("noise [mm]", "Rauschen [mm]"),
    "limit of": ("limit [mm]", "Grenze [mm]"),
    "scale of": ("scale [%]", "Maßstab [%]"),
    # Histories.
    "title histories": ("Time histories and spectra", "Zeitverläufe und Spektren"),
    "histories head": (
        "Left: displacement with its expanded uncertainty (band, k = 2), drawn from the lowest and highest value in "
        "each "
        "column; gaps are samples without a trusted value. Right: amplitude in mm by frequency, with the dominant "
        "frequency dashed.",
        "Links: Verschiebung mit erweiterter Unsicherheit (Band, k = 2), gezeichnet aus kleinstem und größtem Wert je "
        "Bildspalte; Lücken sind Werte ohne Vertrauen. Rechts: Amplitude in mm über der Frequenz, die dominante "
        "Frequenz "
        "gestrichelt.",
    ),
    "figure history": ("{point}", "{point}"),
    "figure static history": ("{point} (must not move)", "{point} (darf sich nicht bewegen)"),
    "figure history label": ("history and spectrum of {point}", "Zeitverlauf und Spektrum von {point}"),
    "figure overview label": ("histories along {axis}", "Zeitverläufe entlang {axis}"),
    "figure spans label": ("peak-to-peak of all points", "Schwingweite aller Punkte"),
    "time s": ("time [s]", "Zeit [s]"),
    "frequency hz": ("frequency [Hz]", "Frequenz [Hz]"),
    "no spectrum": ("too short or too many gaps", "zu kurz oder zu viele Lücken"),
    "overviews head": (
        "Overviews of {count} points; an asterisk marks points that must not move.",
        "Übersichten über {count} Punkte; ein Stern kennzeichnet Punkte, die sich nicht bewegen dürfen.",
    ),
    "overviews part": (
        "They show the {count} that move most; the table above has all.",
        "Gezeigt sind die {count}, die sich am meisten bewegen; die Tabelle oben enthält alle.",
    ),
    "figure spans": (
        "Peak-to-peak with expanded uncertainty (k = 2).",
        "Schwingweite mit erweiterter Unsicherheit (k = 2).",
    ),
    "figure overview": (
        "{axis}: histories about their means, all to one scale (left), and amplitudes by frequency, all to one scale "
        "(right).",
        "{axis}: Zeitverläufe um ihre Mittelwerte, alle in einem Maßstab (links), und Amplituden über der Frequenz, "
        "alle in "
        "einem Maßstab (rechts).",
    ),
    # Budget.
    "title budget": ("Uncertainty budget", "Unsicherheitsbudget"),
    "budget head": (
        "After the GUM (JCGM 100:2008), for the point that moves most: components as root mean square over time (k "
        "= 1); "
        "value times sensitivity is the contribution. All but the random part are systematic: they do not average "
        "out over "
        "a series. A dash: not estimated, because nothing told it; it counts as zero, unless the sum is a dash too.",
        "Nach GUM (JCGM 100:2008), für den Punkt mit der größten Bewegung: Anteile als quadratische Mittel über die "
        "Zeit "
        "(k = 1); Wert mal Empfindlichkeit ist der Beitrag. Alle außer dem zufälligen Anteil sind systematisch: Sie "
        "mitteln "
        "sich über eine Reihe nicht heraus. Ein Strich: nicht ermittelt, weil nichts darüber Auskunft gab; zählt als "
        "null, wenn nicht auch die Summe ein Strich ist.",
    ),
    "no budget": (
        "Of a single view there is no budget: its uncertainty is made of the random part and of the scale.",
        "Für eine einzelne Ansicht gibt es kein Budget: Ihre Unsicherheit besteht aus zufälligem Anteil und Maßstab.",
    ),
    "table budget": ("{axis} displacement of {point}.", "Verschiebung {axis} von {point}."),
    "source": ("source", "Quelle"),
    "distribution": ("distribution", "Verteilung"),
    "sensitivity": ("sensitivity", "Empfindlichkeit"),
    "contribution": ("contribution [mm]", "Beitrag [mm]"),
    "normal a": ("normal, type A", "normal, Typ A"),
    "normal b": ("normal, type B", "normal, Typ B"),
    "combined": ("combined, k = 1", "kombiniert, k = 1"),
    "expanded": ("expanded, k = 2", "erweitert, k = 2"),
    "table components": (
        "Components of all points and axes in mm, root mean square over time (k = 1); u combined, U expanded (k = 2).",
        "Anteile aller Punkte und Achsen in mm, quadratisches Mittel über die Zeit (k = 1); u kombiniert, U erweitert "
        "(k = 2).",
    ),
    "table scale": (
        "What the scale rests on ({axis} of {point}, which of all that the audit judges knows it least: {percent}, "
        "k = 2): sources with their stated values, and what each adds to its uncertainty (k = 1).",
        "Worauf der Maßstab beruht ({axis} von {point}, wo er von allem Geprüften am wenigsten bekannt ist: {percent}, "
        "k = 2): Quellen mit ihren Angaben und ihr Beitrag zur Unsicherheit (k = 1).",
    ),
    "stated value": ("value", "Wert"),
    "stated std": ("std", "Std.-Abw."),
    "contribution percent": ("contribution [%]", "Beitrag [%]"),
    "share": ("share of variance [%]", "Anteil der Varianz [%]"),
    # Audit.
    "title audit": ("Audit", "Prüfung"),
    "table audit": (
        "Checks that need no reference. What could not be checked does not count as passed. Values without a unit are "
        "shares or ratios.",
        "Prüfungen, die keine Referenz brauchen. Was nicht geprüft werden konnte, gilt nicht als bestanden. Werte ohne "
        "Einheit sind Anteile oder Verhältnisse.",
    ),
    "check": ("check", "Prüfung"),
    "outcome": ("outcome", "Ergebnis"),
    "where": ("worst at", "ungünstigste Stelle"),
    "found": ("value", "Wert"),
    "limit": ("limit", "Grenze"),
    "not checked": ("What could not be checked, and why:", "Was nicht geprüft werden konnte, und warum:"),
    "measure next": (
        "What would make the scale better known, and what would be left of its uncertainty (k = 2):",
        "Was den Maßstab besser bekannt machte, und was von seiner Unsicherheit bliebe (k = 2):",
    ),
    "table intervals": (
        "Verdicts on parts of the recording ({count} of {all}).",
        "Urteile über Teile der Aufnahme ({count} von {all}).",
    ),
    "from s": ("from [s]", "von [s]"),
    "to s": ("to [s]", "bis [s]"),
    "verdict": ("verdict", "Urteil"),
    "reasons": ("reasons", "Gründe"),
    # Comparison.
    "title comparison": ("Comparison with a reference", "Vergleich mit einer Referenz"),
    "comparison head": ("Compared with: {reference}.", "Verglichen mit: {reference}."),
    "comparison band": ("Both were filtered to {low} to {high} Hz.", "Beide wurden auf {low} bis {high} Hz gefiltert."),
    "table comparison": (
        "NRMSE: root mean square error over the range of the reference. RPPAE: error of the peak-to-peak over that "
        "of the "
        "reference. Coverage: share of samples whose stated interval, nominally 95 %, holds the reference.",
        "NRMSE: quadratischer Mittelwert des Fehlers über der Spannweite der Referenz. RPPAE: Fehler der "
        "Schwingweite über "
        "der der Referenz. Deckung: Anteil der Werte, deren angegebenes Intervall (nominell 95 %) die Referenz "
        "enthält.",
    ),
    "p2p here": ("peak-to-peak [mm]", "Schwingweite [mm]"),
    "p2p reference": ("reference [mm]", "Referenz [mm]"),
    "rms error": ("RMS error [mm]", "RMS-Fehler [mm]"),
    "nrmse": ("NRMSE", "NRMSE"),
    "correlation": ("correlation", "Korrelation"),
    "rppae": ("RPPAE", "RPPAE"),
    "gain": ("gain", "Verstärkung"),
    "lag ms": ("lag [ms]", "Versatz [ms]"),
    "coverage": ("coverage [%]", "Deckung [%]"),
}
