"""Words of results in the reader's language: axes, verdicts, checks with what to do, components and sources."""

from collections.abc import Mapping

__all__ = ["WORD_TEXTS"]

_CHECKS: Mapping[str, tuple[str, str, str]] = {
    "site and lenses": (
        "Ortsmaße und Objektive",
        "a reading, lens or point contradicts the others; check the one that is named.",
        "Ein Maß, Objektiv oder Punkt widerspricht den anderen; das genannte prüfen.",
    ),
    "scale by a spare length": (
        "Maßstab durch überzähliges Maß",
        "no spare length checks the scale; measure the length between two points of the structure.",
        "Kein überzähliges Maß prüft den Maßstab; den Abstand zweier Punkte am Bauwerk messen.",
    ),
    "scale": (
        "Maßstab",
        "the scale is not known well enough, or nothing checks the lenses it rests on; measure what is named below.",
        "Der Maßstab ist nicht gut genug bekannt, oder nichts prüft die Objektive, auf denen er beruht; das unten "
        "Genannte "
        "messen.",
    ),
    "epipolar error": (
        "Epipolarfehler",
        "the views do not see the same point; place it by hand in the other view (pixel_in), and check the order of "
        "views.",
        "Die Ansichten sehen nicht denselben Punkt; ihn in der anderen Ansicht von Hand setzen (pixel_in) und die "
        "Reihenfolge "
        "der Ansichten prüfen.",
    ),
    "epipolar error in motion": (
        "Epipolarfehler in Bewegung",
        "the views do not see one motion; check clocks, tracks and tripods.",
        "Die Ansichten sehen nicht dieselbe Bewegung; Uhren, Verfolgung und Stative prüfen.",
    ),
    "agreement of the views": (
        "Übereinstimmung der Ansichten",
        "the views show motions of different size; choose points with more texture.",
        "Die Ansichten zeigen verschieden große Bewegungen; Punkte mit mehr Textur wählen.",
    ),
    "clocks": (
        "Uhren",
        "whether the views run on one clock was not shown; film longer, or state the offset.",
        "Ob die Ansichten auf einer Uhr laufen, wurde nicht gezeigt; länger filmen oder den Versatz angeben.",
    ),
    "clock drift": (
        "Uhrendrift",
        "the clocks run at different rates, or the recording is too short to tell.",
        "Die Uhren laufen verschieden schnell, oder die Aufnahme ist zu kurz, um es zu erkennen.",
    ),
    "points refused": (
        "Abgelehnte Punkte",
        "a point has no texture to follow; name another place.",
        "Ein Punkt hat keine verfolgbare Textur; eine andere Stelle benennen.",
    ),
    "points of the grid": (
        "Punkte des Rasters",
        "half of the points of a grid or more are not measured; draw it where both views see the face.",
        "Die Hälfte der Punkte eines Rasters oder mehr ist nicht gemessen; es dort zeichnen, wo beide Ansichten die "
        "Fläche sehen.",
    ),
    "samples missing": (
        "Fehlende Werte",
        "a point was lost too often; choose one that is always seen.",
        "Ein Punkt ging zu oft verloren; einen wählen, der immer zu sehen ist.",
    ),
    "frozen tracks": (
        "Eingefrorene Spuren",
        "a track stands still while its point moves; look for repeated frames or dirt on the lens.",
        "Eine Spur steht, während sich der Punkt bewegt; nach wiederholten Bildern oder Schmutz auf dem Objektiv "
        "suchen.",
    ),
    "slipping tracks": (
        "Rutschende Spuren",
        "a track drifts away from the others; choose another place for the point.",
        "Eine Spur driftet von den anderen weg; den Punkt anders setzen.",
    ),
    "halves of a subset": (
        "Hälften eines Ausschnitts",
        "a square covers things that move differently; move the point or make the square smaller.",
        "Ein Ausschnitt enthält verschieden Bewegtes; den Punkt verschieben oder den Ausschnitt verkleinern.",
    ),
    "parts of a subset": (
        "Teile eines Ausschnitts",
        "strips of a square move by different amounts; move the point or make the square smaller.",
        "Streifen eines Ausschnitts bewegen sich verschieden; den Punkt verschieben oder den Ausschnitt verkleinern.",
    ),
    "reference frames": (
        "Referenzbilder",
        "light made new reference frames necessary; slow motion is less certain.",
        "Das Licht machte neue Referenzbilder nötig; langsame Bewegung ist weniger sicher.",
    ),
    "share of a subset": (
        "Anteil eines Ausschnitts",
        "much of a square does not move with its point; move the point.",
        "Vieles in einem Ausschnitt bewegt sich nicht mit dem Punkt; den Punkt verschieben.",
    ),
    "static points": (
        "Festpunkte",
        "what must not move moves, or no such point was named; check the tripods, and name static points.",
        "Was ruhen muss, bewegt sich, oder es wurde kein Festpunkt benannt; Stative prüfen und Festpunkte benennen.",
    ),
    "tripods": (
        "Stative",
        "a camera moved, or nothing shows that it did not; use a heavier tripod, and name static points.",
        "Eine Kamera bewegte sich, oder nichts zeigt, dass sie stillstand; ein schwereres Stativ nehmen und Festpunkte "
        "benennen.",
    ),
    "stabilised video": (
        "Bildstabilisierung",
        "the picture follows the structure; switch stabilisation off and film again.",
        "Das Bild folgt dem Bauwerk; Stabilisierung abschalten und neu filmen.",
    ),
    "still interval": (
        "Ruheintervall",
        "the structure moves while it should be at rest; choose another still interval.",
        "Das Bauwerk bewegt sich, während es ruhen sollte; ein anderes Ruheintervall wählen.",
    ),
    "signal to noise": (
        "Signal zu Rauschen",
        "motion hardly stands clear of its noise; film from nearer, or with a longer lens.",
        "Die Bewegung hebt sich kaum vom Rauschen ab; näher oder mit längerer Brennweite filmen.",
    ),
    "gain of injected shifts": (
        "Verstärkung bekannter Verschiebungen",
        "known shifts do not come out at their full size; choose points with more texture.",
        "Bekannte Verschiebungen kommen nicht in voller Größe heraus; Punkte mit mehr Textur wählen.",
    ),
    "recordings": (
        "Aufnahmen",
        "frames are missing or repeated; copy the files again, or record otherwise.",
        "Bilder fehlen oder sind wiederholt; die Dateien neu kopieren oder anders aufnehmen.",
    ),
    "length of the recording": (
        "Länge der Aufnahme",
        "too few frames to judge noise, clocks and cameras by; film longer.",
        "Zu wenige Bilder, um Rauschen, Uhren und Kameras zu beurteilen; länger filmen.",
    ),
    "slow drift": (
        "Langsame Drift",
        "what must not move drifts over the recording; slow motion of the structure is as doubtful.",
        "Was ruhen muss, driftet über die Aufnahme; langsame Bewegung des Bauwerks ist ebenso zweifelhaft.",
    ),
    "refinement": (
        "Verfeinerung",
        "points could not be refined, because both views are poor; choose points with more texture.",
        "Punkte konnten nicht verfeinert werden, weil beide Ansichten schlecht sind; Punkte mit mehr Textur wählen.",
    ),
}

_OTHERS: Mapping[str, tuple[str, str]] = {
    "axis lateral": ("lateral", "quer"),
    "axis vertical": ("vertical", "vertikal"),
    "axis longitudinal": ("longitudinal", "längs"),
    "axis right": ("right", "rechts"),
    "axis down": ("down", "unten"),
    "axis forward": ("forward", "vorn"),
    "axis short lateral": ("lat.", "quer"),
    "axis short vertical": ("vert.", "vert."),
    "axis short longitudinal": ("long.", "längs"),
    "direction lateral": (
        "horizontal, at right angles to the structure's face; positive away from the reference camera",
        "horizontal, rechtwinklig zur Bauwerksfläche; positiv von der Referenzkamera weg",
    ),
    "direction vertical": (
        "positive downwards: a deck that sags moves in the positive direction",
        "positiv nach unten: Ein Überbau, der sich durchbiegt, bewegt sich in positiver Richtung",
    ),
    "direction longitudinal": (
        "horizontal, along the structure; positive to the left for one who faces it from the reference camera's side, "
        "as the arrows of plan and pictures show",
        "horizontal, entlang des Bauwerks; positiv nach links, wenn man es von der Seite der Referenzkamera aus "
        "ansieht, wie die Pfeile in Grundriss und Bildern zeigen",
    ),
    "direction right": (
        "positive to the right in the reference camera's picture",
        "positiv nach rechts im Bild der Referenzkamera",
    ),
    "direction down": (
        "positive downwards in the reference camera's picture",
        "positiv nach unten im Bild der Referenzkamera",
    ),
    "direction forward": (
        "positive along the reference camera's line of sight",
        "positiv in Blickrichtung der Referenzkamera",
    ),
    "relative mean of the still interval": (
        "Displacement is relative to the mean over the still interval.",
        "Verschiebungen beziehen sich auf das Mittel über das Ruheintervall.",
    ),
    "relative first valid sample": (
        "Displacement is relative to the first trusted sample of each point; a load that stood there before is not "
        "seen.",
        "Verschiebungen beziehen sich auf den ersten gültigen Wert jedes Punkts; eine Last, die vorher da war, wird "
        "nicht "
        "gesehen.",
    ),
    "verdict fit to use": ("Fit to use.", "Verwendbar."),
    "verdict use with care": ("Use with care.", "Mit Vorsicht verwenden."),
    "verdict not judged": ("Not judged.", "Nicht beurteilt."),
    "verdict do not use": ("Do not use.", "Nicht verwenden."),
    "verdict short fit to use": ("fit to use", "verwendbar"),
    "verdict short use with care": ("use with care", "mit Vorsicht"),
    "verdict short not judged": ("not judged", "nicht beurteilt"),
    "verdict short do not use": ("do not use", "nicht verwenden"),
    "advice fit to use": (
        "Every check passed, or is one of those that a good measurement can do without.",
        "Alle Prüfungen sind bestanden oder solche, auf die eine gute Messung verzichten kann.",
    ),
    "advice use with care": (
        "A check calls for caution, or one that is needed could not be made. Use what it does not concern.",
        "Eine Prüfung mahnt zur Vorsicht, oder eine nötige war nicht möglich. Verwenden, was sie nicht betrifft.",
    ),
    "advice not judged": (
        "Most of the checks that are needed could not be made: nobody knows whether the result is right.",
        "Die meisten nötigen Prüfungen waren nicht möglich: Ob das Ergebnis stimmt, weiß niemand.",
    ),
    "advice do not use": (
        "A check failed. Mend what it names, and measure again.",
        "Eine Prüfung ist nicht bestanden. Beheben, was sie nennt, und neu messen.",
    ),
    "outcome pass": ("pass", "bestanden"),
    "outcome caution": ("caution", "Vorsicht"),
    "outcome fail": ("fail", "nicht bestanden"),
    "outcome not possible": ("not possible", "nicht möglich"),
    "unit frames": ("frames", "Bilder"),
    "unit std": ("std", "Std.-Abw."),
    "component random": ("scatter of the tracks", "Streuung der Spuren"),
    "component cameras": ("cameras, lengths and axes", "Kameras, Längen und Achsen"),
    "component synchronization": ("offset of the clocks", "Versatz der Uhren"),
    "component assumption": ("assumption of the refinement", "Annahme der Verfeinerung"),
    "component compression": ("compression of the video", "Kompression des Videos"),
    "component subset": ("motion beside the point", "Bewegung neben dem Punkt"),
    "component origin": ("origin", "Ursprung"),
    "component short random": ("random", "zufällig"),
    "component short cameras": ("cameras", "Kameras"),
    "component short synchronization": ("clocks", "Uhren"),
    "component short assumption": ("assum.", "Annahme"),
    "component short compression": ("compr.", "Kompr."),
    "component short subset": ("subset", "Ausschn."),
    "component short origin": ("origin", "Ursprung"),
    "source focal": ("focal length", "Brennweite"),
    "source matches": ("matches of the views", "Verknüpfungen der Ansichten"),
    "source points off the face": ("points off the face", "Punkte außerhalb der Fläche"),
    "source places of the points": ("places of the points", "Lage der Punkte"),
    "source principal point and distortion": ("principal point and distortion", "Hauptpunkt und Verzeichnung"),
    "source range": ("range", "Strecke"),
    "source longitudinal distance": ("longitudinal distance", "Abstand längs"),
    "source perpendicular distance": ("perpendicular distance", "Abstand quer"),
    "source baseline": ("baseline", "Basislänge"),
    "source pose": ("pose", "Stellung"),
    "source pitch": ("pitch", "Neigung"),
    "source roll": ("roll", "Rollen"),
    "source length": ("length", "Länge"),
}

WORD_TEXTS: Mapping[str, tuple[str, str]] = {
    **{f"check {name}": (name, german) for name, (german, _, _) in _CHECKS.items()},
    **{f"todo {name}": (english, german) for name, (_, english, german) in _CHECKS.items()},
    **_OTHERS,
}
"""Word of every key in English and German."""
