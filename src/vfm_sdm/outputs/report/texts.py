"""Catalogue of a report's texts: by key, in English and in German.

A key that begins with a kind of word (``axis``, ``check``, ``outcome`` ...) translates a word of the results.
"""

from collections.abc import Mapping

from vfm_sdm.outputs.report.texts_of_field import FIELD_TEXTS
from vfm_sdm.outputs.report.texts_of_fusion import FUSION_TEXTS
from vfm_sdm.outputs.report.texts_of_load_tests import LOAD_TEST_TEXTS
from vfm_sdm.outputs.report.texts_of_modes import MODE_TEXTS
from vfm_sdm.outputs.report.texts_of_repeatability import REPEATABILITY_TEXTS
from vfm_sdm.outputs.report.texts_of_results import RESULT_TEXTS
from vfm_sdm.outputs.report.texts_of_words import WORD_TEXTS

__all__ = ["CATALOGUE"]

_FRAME: Mapping[str, tuple[str, str]] = {
    "report title": ("Displacement measurement report", "Messbericht Verschiebungen"),
    "footer": (
        "{name} · session {hash} · vfm-sdm {version} · report of {day}",
        "{name} · Session {hash} · vfm-sdm {version} · Bericht vom {day}",
    ),
    "contents": ("Contents", "Inhalt"),
    "page": ("Page", "Seite"),
    "signature": ("Place, date, signature", "Ort, Datum, Unterschrift"),
    # Task.
    "title task": ("Task", "Auftrag"),
    "client": ("Client", "Auftraggeber"),
    "project": ("Project", "Projekt"),
    "place": ("Place", "Ort"),
    "date": ("Date of recording", "Tag der Aufnahme"),
    "measured_by": ("Measured by", "Gemessen von"),
    "cameras": ("Cameras", "Kameras"),
    "weather": ("Weather", "Wetter"),
    "structure": ("Measurement", "Messung"),
    "views": ("Views", "Ansichten"),
    "count of": ("{count} ({names})", "{count} ({names})"),
    "points": ("Points", "Punkte"),
    "points counted": (
        "{moving} on the structure, {static} that must not move",
        "{moving} am Bauwerk, {static}, die sich nicht bewegen dürfen",
    ),
    "no report table": (
        "Client, project and place are not stated; the table [report] of the session file holds them.",
        "Auftraggeber, Projekt und Ort sind nicht angegeben; sie stehen in der Tabelle [report] der Sessiondatei.",
    ),
    # Verdict.
    "title verdict": ("Verdict and limits", "Urteil und Grenzen"),
    "flagged head": ("What stands against unrestricted use:", "Was gegen eine uneingeschränkte Verwendung spricht:"),
    "flagged": ("{check} ({outcome}): {meaning}", "{check} ({outcome}): {meaning}"),
    "limits head": ("The results hold within these limits:", "Die Ergebnisse gelten in diesen Grenzen:"),
    "limit time": (
        "{seconds} s were measured, in {frames} frames at {rate} frames a second; oscillations above {highest} Hz "
        "cannot "
        "be seen, and nothing is said of other times.",
        "Gemessen wurden {seconds} s in {frames} Bildern mit {rate} Bildern je Sekunde; Schwingungen über {highest} Hz "
        "sind nicht erkennbar, und über andere Zeiten ist nichts gesagt.",
    ),
    "limit noise": (
        "Oscillations with amplitudes below {most} (of the worst point and axis) may be noise. Of motion within the "
        "noise, "
        "peak-to-peak and RMS show the noise.",
        "Schwingungen mit Amplituden unter {most} (ungünstigster Punkt und Achse) können Rauschen sein. Bei "
        "Bewegungen im "
        "Rauschen zeigen Schwingweite und Effektivwert das Rauschen.",
    ),
    "limit scale": (
        "All displacements of a point along an axis may be too large or too small by one factor; it is known to "
        "{percent} (k = 2, {axis} of {point}, the worst of all points on the structure and axes).",
        "Alle Verschiebungen eines Punkts entlang einer Achse können um einen Faktor zu groß oder zu klein sein; er "
        "ist auf {percent} bekannt (k = 2, {axis} von {point}, ungünstigster aller Punkte am Bauwerk und Achsen).",
    ),
    "limit sgr": (
        "Along the axis {axis} motion was assumed to be small, not measured; do not use it.",
        "Entlang der Achse {axis} wurde die Bewegung als klein angenommen und nicht gemessen; nicht verwenden.",
    ),
    "limit one view": (
        "One camera shows motion across its line of sight only; motion towards it is not seen and appears as an error.",
        "Eine Kamera zeigt nur Bewegung quer zur Blickrichtung; Bewegung auf sie zu wird nicht gesehen und "
        "erscheint als "
        "Fehler.",
    ),
    "limit no axes": (
        "The axes are those of the reference camera, because no distances to the structure were stated.",
        "Die Achsen sind die der Referenzkamera, weil keine Abstände zum Bauwerk angegeben wurden.",
    ),
    "limit static": (
        "Static points are taken to be at rest; motion that they share with the structure is not seen.",
        "Festpunkte gelten als ruhend; Bewegung, die sie mit dem Bauwerk teilen, wird nicht gesehen.",
    ),
    "limit no static": (
        "No static point was named; a camera that moved cannot be told from a structure that moved.",
        "Es wurde kein Festpunkt benannt; eine bewegte Kamera ist von einem bewegten Bauwerk nicht zu unterscheiden.",
    ),
    "limit edges": (
        "Measured across an edge only, with nothing said of motion along it: {points}.",
        "Nur quer zu einer Kante gemessen, ohne Aussage über Bewegung längs der Kante: {points}.",
    ),
    "limit refused": (
        "Not measured, because there is no texture to follow: {points}.",
        "Nicht gemessen, weil keine verfolgbare Textur vorhanden ist: {points}.",
    ),
    "limit rarely": (
        "Seen in less than 95 % of the frames: {points}.",
        "In weniger als 95 % der Bilder gesehen: {points}.",
    ),
    # Site and photos.
    "title site": ("Site and axes", "Aufstellung und Achsen"),
    "axes head": (
        "Displacement is stated along these axes; the sign says which way is positive:",
        "Verschiebungen sind entlang dieser Achsen angegeben; das Vorzeichen gibt die positive Richtung an:",
    ),
    "no cameras": (
        "Cameras and points cannot be drawn to scale: no metric cameras are known.",
        "Kameras und Punkte können nicht maßstäblich gezeichnet werden: Es sind keine metrischen Kameras bekannt.",
    ),
    "figure plan": (
        "Plan, seen from above and to scale: cameras with their fields of view (red), points (blue), static points "
        "(grey circles), and the face through the points.",
        "Grundriss, maßstäblich: Kameras mit Blickfeldern (rot), Punkte (blau), Festpunkte (graue Kreise) und die "
        "Bauwerksfläche durch die Punkte.",
    ),
    "figure elevation": (
        "Elevation, seen from the cameras' side and to scale.",
        "Ansicht von der Seite der Kameras, maßstäblich.",
    ),
    "figure plan label": ("plan of the site", "Grundriss"),
    "figure elevation label": ("elevation of the site", "Ansicht"),
    "table places": (
        "Places along these axes, counted from the reference camera.",
        "Lage entlang dieser Achsen, gezählt von der Referenzkamera.",
    ),
    "name": ("name", "Name"),
    "what": ("what", "Art"),
    "camera": ("camera", "Kamera"),
    "point": ("point", "Punkt"),
    "static point": ("static point", "Festpunkt"),
    "baseline is": (
        "Distance between the optical centres of the first two cameras: {metres} m.",
        "Abstand der Projektionszentren der ersten beiden Kameras: {metres} m.",
    ),
    "title photos": ("Points in the pictures", "Punkte in den Bildern"),
    "figure photo": (
        "View {view}: first frame, with the points, the squares that are compared at their true size (white: static "
        "points), and the positive directions of the axes.",
        "Ansicht {view}: erstes Bild mit den Punkten, den verglichenen Bildausschnitten in wahrer Größe (weiß: "
        "Festpunkte) "
        "und den positiven Achsrichtungen.",
    ),
    "figure photo later": (
        "Frame {frame} of view {view}, in which further points are named; squares and axes as before.",
        "Bild {frame} der Ansicht {view}, in dem weitere Punkte benannt sind; Quadrate und Achsen wie zuvor.",
    ),
    "figure photo kept": (
        "View {view}: figure that the measurement drew.",
        "Ansicht {view}: Abbildung, die die Messung gezeichnet hat.",
    ),
    "figure photo later label": ("frame {frame} of view {view}", "Bild {frame} der Ansicht {view}"),
    "figure photo label": ("first frame of view {view}", "erstes Bild der Ansicht {view}"),
    "recording gone": (
        "View {view}: the recording was not at hand when this report was written.",
        "Ansicht {view}: Die Aufnahme lag nicht vor, als dieser Bericht geschrieben wurde.",
    ),
    "recording changed": (
        "View {view}: the recording is not the one that was measured; its pictures are not shown.",
        "Ansicht {view}: Die Aufnahme ist nicht die gemessene; ihre Bilder werden nicht gezeigt.",
    ),
    # Traceability.
    "title traceability": ("Traceability", "Rückverfolgbarkeit"),
    "session hash": ("Session (SHA-256 of what it says)", "Session (SHA-256 der Angaben)"),
    "session file": ("File {file} (SHA-256)", "Datei {file} (SHA-256)"),
    "result key": ("Result (hash of all it was made of)", "Ergebnis (Hash all dessen, woraus es entstand)"),
    "system": ("Operating system", "Betriebssystem"),
    "system is": (
        "{platform}, {processor}, {count} processors",
        "{platform}, {processor}, {count} Prozessoren",
    ),
    "not recorded": ("not recorded", "nicht aufgezeichnet"),
    "versions": ("Versions", "Versionen"),
    "how to hash": (
        "To compute them again: the file's with `sha256sum {file}` in the run folder; the session's, which does not "
        "depend on spelling, folder and the table [report], from the session file that was measured with:",
        "Nachrechnen: den der Datei mit `sha256sum {file}` im Ergebnisordner; den der Session, der nicht von "
        "Schreibweise, "
        "Ordner und der Tabelle [report] abhängt, aus der gemessenen Sessiondatei mit:",
    ),
    "table files": (
        "Input files. Hashes that begin with `sampled-` are of size, time stamp and 64 blocks of a large file.",
        "Eingabedateien. Hashes, die mit `sampled-` beginnen, sind aus Größe, Zeitstempel und 64 Blöcken einer großen "
        "Datei gebildet.",
    ),
    "file": ("file", "Datei"),
    "hash": ("SHA-256", "SHA-256"),
    "table seconds": (
        "Time that the steps took; what was reused took none.",
        "Dauer der Schritte; Wiederverwendetes braucht keine Zeit.",
    ),
    "step": ("step", "Schritt"),
    "table settings": ("Settings of the method.", "Einstellungen des Verfahrens."),
    "setting": ("setting", "Einstellung"),
    "value": ("value", "Wert"),
    "notes head": ("Notes of the measurement:", "Hinweise der Messung:"),
}

CATALOGUE: Mapping[str, tuple[str, str]] = {
    **_FRAME,
    **RESULT_TEXTS,
    **LOAD_TEST_TEXTS,
    **REPEATABILITY_TEXTS,
    **FUSION_TEXTS,
    **FIELD_TEXTS,
    **MODE_TEXTS,
    **WORD_TEXTS,
}
"""Text of every key in English and German."""
