"""German forms of the sentences of the audit, and of the places and things that they name."""

from collections.abc import Mapping

from vfm_sdm.core.statuses import CameraStatus, ClockStatus, PointStatus, RecordingStatus, RefinementStatus
from vfm_sdm.outputs.report.texts_of_words import WORD_TEXTS

__all__ = ["CHECK_FORMS", "THING_FORMS"]

_POINTS: Mapping[str, str] = {
    PointStatus.NOT_LOOKED_FOR: "nicht gesucht",
    PointStatus.NOT_FOUND: "in der anderen Ansicht nicht gefunden",
    PointStatus.AMBIGUOUS: "mehrere Stellen sehen gleich aus",
    PointStatus.NOT_RETURNED: "der Rückweg endet anderswo",
    PointStatus.NO_TEXTURE: "keine verfolgbare Textur",
}
_STATUSES: Mapping[str, str] = {
    **_POINTS,
    RecordingStatus.TRUNCATED: "die Datei endet vorzeitig",
    RecordingStatus.CORRUPT: "beschädigt",
    RecordingStatus.NOT_READ: "nicht gelesen",
    CameraStatus.ONE_VIEW: "eine Ansicht: nur Bewegung in der Bildebene",
    CameraStatus.TOO_FEW_MATCHES: "zu wenige Verknüpfungen zwischen den Ansichten",
    CameraStatus.NOT_CLEAR: "keine Kamerastellung hebt sich vom Zufall ab",
    CameraStatus.NO_LENGTH: "keine Länge ist bekannt",
    CameraStatus.NO_COMMON_SCALE: "zu wenige Punkte in drei Ansichten gesehen",
    CameraStatus.CONTRADICTION: "die Brennweiten widersprechen dem, was von den Objektiven bekannt ist",
    CameraStatus.BASELINES_DISAGREE: "Schachbrett und gemessene Basislänge stimmen nicht überein",
    CameraStatus.NOT_A_CAMERA: "das Netz lieferte kein Blickfeld oder keine Drehung",
    CameraStatus.ONE_PLACE: "das Netz setzte die ersten beiden Kameras an einen Ort",
    CameraStatus.NOT_RECONSTRUCTED: "die Rekonstruktion aus den Bildern (structure from motion) konvergierte nicht",
    CameraStatus.DISAGREE: "Vorwissen und Bilder stimmen nicht überein",
    CameraStatus.NOT_IDENTIFIABLE: "Brennweite nicht bestimmt",
    CameraStatus.UNKNOWN_DISTANCE: "Abstand einer weiteren Kamera nicht bestimmt",
    CameraStatus.SEVERAL: "mehrere Kamerastellungen passen zu allem Bekannten",
    CameraStatus.NOT_CONVERGED: "die Ausgleichung konvergierte nicht",
    CameraStatus.BEHIND: "die Szene liegt hinter den Kameras",
    CameraStatus.TURNED: "eine Kamera ist weit von dort weggedreht, wo sie geschätzt wurde",
    ClockStatus.STATED: "wie angegeben",
    ClockStatus.NOT_UNIQUE: "Maximum nicht eindeutig",
    ClockStatus.NO_MOTION: "keine gemeinsame Bewegung",
    ClockStatus.TOO_SHORT: "zu kurz",
    ClockStatus.TOO_SLOW: "zu wenige Werte je Sekunde für das Frequenzband",
    ClockStatus.AT_EDGE: "Maximum am Rand des Suchbereichs",
    ClockStatus.NOT_CONVERGED: "nicht konvergiert",
    RefinementStatus.EDGE: "nur quer zu einer Kante gemessen",
    RefinementStatus.BOTH_POOR: "beide Ansichten schlecht",
    RefinementStatus.UNKNOWN: "Unsicherheit unbekannt",
    RefinementStatus.TOO_FEW_FRAMES: "zu wenige Bilder",
    RefinementStatus.NO_STILL_FRAMES: "keine Bilder in Ruhe",
}

_SENTENCES: Mapping[str, str] = {
    "nothing to look at": "nichts zu prüfen vorhanden",
    "nothing was measured": "nichts wurde gemessen",
    "it takes a second view to see it": "nur mit einer zweiten Ansicht erkennbar",
    "it takes a second view to refine": "zum Verfeinern ist eine zweite Ansicht nötig",
    # Clocks.
    "nobody knows when {view} began": "niemand weiß, wann {view} begann",
    "neither the motion nor the session tells its offset": "weder die Bewegung noch die Session nennt den Versatz",
    "the views are synchronised": "die Ansichten sind synchronisiert",
    "{view} is not synchronised with the reference view; let the motion do it (method.synchronization)": "{view} ist "
    "nicht mit der Referenzansicht synchronisiert; die Bewegung dafür verwenden (method.synchronization)",
    "the recording is shorter than {seconds:n} s": "die Aufnahme ist kürzer als {seconds} s",
    "clocks hardly drift in that time": "in dieser Zeit driften Uhren kaum",
    "the clocks keep step": "die Uhren laufen gleich",
    "the clock of {view} drifts against the reference view's; use a shorter part, or a constant frame rate": "die Uhr "
    "von {view} driftet gegen die der Referenzansicht; einen kürzeren Teil oder eine konstante Bildrate verwenden",
    "the motion does not tell": "die Bewegung gibt keine Auskunft",
    "without {points}, which moves otherwise than most": "ohne {points}, was sich anders bewegt als die meisten",
    "check its place": "Lage prüfen",
    # Site, lenses, scale.
    "the displacement has no usable scale": "die Verschiebung hat keinen brauchbaren Maßstab",
    "what was measured on site, the lenses and the images agree": "Ortsmaße, Objektive und Bilder stimmen überein",
    "{what:what} contradicts the rest; a lens, a tape reading or a point is wrong, and with it the scale": "{what} "
    "widerspricht dem Übrigen; ein Objektiv, ein Bandmaß oder ein Punkt ist falsch, und damit der Maßstab",
    "what was stated contradicts itself, and the scale with it": "die Angaben widersprechen einander, und damit der "
    "Maßstab",
    "the notes of the cameras say where": "die Hinweise zu den Kameras sagen, wo",
    "a baseline misread by {percent:n} % or more would have been noticed": "eine um {percent} % oder mehr falsch "
    "abgelesene Basislänge wäre aufgefallen",
    "only a baseline wrong by {percent:n} % or more would be noticed": "nur eine um {percent} % oder mehr falsche "
    "Basislänge fiele auf",
    "nothing else tells the scale, so a wrong baseline cannot be seen": "nichts sonst gibt den Maßstab an, also ist "
    "eine falsche Basislänge nicht erkennbar",
    "Measure the length between two points of the structure, which checks it": "Den Abstand zweier Punkte am Bauwerk "
    "messen; er prüft sie",
    "no baseline was measured": "es wurde keine Basislänge gemessen",
    "nobody knows how well the scale is known": "niemand weiß, wie gut der Maßstab bekannt ist",
    "the cameras come without their uncertainty": "die Kameras sind ohne Unsicherheit angegeben",
    "known to {percent:n} % (k = 2)": "bekannt auf {percent} % (k = 2)",
    "known to {percent:n} % (k = 2) if the lenses are as stated": "bekannt auf {percent} % (k = 2), wenn die Objektive "
    "wie angegeben sind",
    "it rests on them, and nothing would show a lens so wrong that the scale is off by {percent:n} %. {reading:what} "
    "checks them": "er beruht auf ihnen, und ein Objektiv, das den Maßstab um {percent} % verfälscht, fiele nicht auf. "
    "{reading} prüft sie",
    "known to {percent:n} % only (k = 2), most of it common to all points and samples": "nur auf {percent} % bekannt "
    "(k = 2), überwiegend gemeinsam für alle Punkte und Werte",
    "no single length, range or lens would tell it much better": "keine einzelne Länge, keine Strecke und kein "
    "Objektiv machte ihn viel besser bekannt",
    "measure several": "mehrere messen",
    "{reading:what} brings {now:n} % to {then:n} %": "{reading} verringert {now} % auf {then} %",
    # Views.
    "the views see the same points": "die Ansichten sehen dieselben Punkte",
    "point {point} is another place in another view, the views are swapped, or a camera is wrong": "Punkt {point} ist "
    "in einer anderen Ansicht eine andere Stelle, die Ansichten sind vertauscht, oder eine Kamera ist falsch",
    "the views see one motion": "die Ansichten sehen dieselbe Bewegung",
    "point {point} moves differently in two views": "Punkt {point} bewegt sich in zwei Ansichten verschieden",
    "clocks, a track that slips, or a camera that moves": "Uhren, eine rutschende Spur oder eine bewegte Kamera",
    "the views show the same vertical motion": "die Ansichten zeigen dieselbe vertikale Bewegung",
    "the views disagree about how much {point} moves up and down; one track slips or a scale is wrong": "die Ansichten "
    "sind sich uneins, wie weit sich {point} auf und ab bewegt; eine Spur rutscht, oder ein Maßstab ist falsch",
    # Tracks.
    "every point of the structure can be followed": "jeder Punkt am Bauwerk ist verfolgbar",
    "not measured, as was said before tracking: {why:say}; name other places, or their places in the other view": ""
    "nicht gemessen, wie vor dem Verfolgen gesagt: {why}; andere Stellen benennen, oder ihre Stellen in der anderen "
    "Ansicht",
    "{measured:n} of {all:n} points of the grid are measured": "{measured} von {all} Punkten des Rasters sind gemessen",
    "left out: {names}": "ausgelassen: {names}",
    "draw the polygon where both views see the face, and where it has texture": "das Polygon dort zeichnen, wo beide "
    "Ansichten die Fläche sehen und wo sie Textur hat",
    "hardly any sample is missing": "kaum ein Wert fehlt",
    "point {point} was lost, left the picture or is not to be trusted in part of the recording": "Punkt {point} ging "
    "verloren, verließ das Bild oder ist in einem Teil der Aufnahme nicht vertrauenswürdig",
    "no track stands still while its point moves": "keine Spur steht, während sich ihr Punkt bewegt",
    "{place:what} stands still while another view shows motion": "{place} steht, während eine andere Ansicht Bewegung "
    "zeigt",
    "frames repeated, or the tracker holds on to dirt": "Bilder sind wiederholt, oder die Verfolgung haftet an Schmutz",
    "no point drifts away from the others": "kein Punkt driftet von den anderen weg",
    "point {point} drifts along the structure as no other point does": "Punkt {point} driftet entlang des Bauwerks wie "
    "kein anderer",
    "its track slips in one view": "seine Spur rutscht in einer Ansicht",
    "both halves of every subset move alike": "beide Hälften jedes Ausschnitts bewegen sich gleich",
    "the halves of {place:what} move apart": "die Hälften von {place} bewegen sich auseinander",
    "the square covers an edge, a plant or something else that moves": "der Ausschnitt enthält eine Kante, eine "
    "Pflanze oder anderes Bewegtes",
    "all parts of every subset move by one amount": "alle Teile jedes Ausschnitts bewegen sich gleich weit",
    "parts of the subset of {place:what} move by different amounts, as where a still band crosses it: a cable, a hand "
    "rail, background": "Teile des Ausschnitts von {place} bewegen sich verschieden weit, als kreuzte ihn ein ruhender "
    "Streifen: ein Kabel, ein Geländer, Hintergrund",
    "Name a place that moves as a whole": "Eine Stelle benennen, die sich als Ganzes bewegt",
    "most of every subset moves with its point": "das meiste in jedem Ausschnitt bewegt sich mit seinem Punkt",
    "most of the square around {place:what} moves otherwise": "das meiste im Ausschnitt um {place} bewegt sich anders",
    "what was followed may be a cable, a shadow or what lies behind": "verfolgt wurde vielleicht ein Kabel, ein "
    "Schatten oder Dahinterliegendes",
    "Look at the figure of its subset, or name a place with more of the structure around it": "Die Abbildung des "
    "Ausschnitts ansehen, oder eine Stelle mit mehr Bauwerk ringsum benennen",
    "reference frames were renewed {count:n} times as light changed": "Referenzbilder wurden wegen veränderten Lichts "
    "{count}-mal erneuert",
    "that adds {added:n} px in {place:what}": "das fügt {added} px bei {place} hinzu",
    "slow motion below that cannot be told from light; measure parts of the recording in even light": "langsame "
    "Bewegung darunter ist nicht vom Licht zu unterscheiden; Teile der Aufnahme bei gleichmäßigem Licht messen",
    # What must not move.
    "no point that must not move was named and found": "es wurde kein Festpunkt benannt und gefunden",
    "a tripod that moves looks like a structure that moves": "ein bewegtes Stativ sieht aus wie ein bewegtes Bauwerk",
    "Name two on an abutment or behind the structure (static = true)": "Zwei auf einem Widerlager oder hinter dem "
    "Bauwerk benennen (static = true)",
    "what must not move does not": "was ruhen muss, ruht",
    "point {point} must not move and does": "Punkt {point} darf sich nicht bewegen und bewegt sich",
    "a tripod moves, or the point is not where it was meant": "ein Stativ bewegt sich, oder der Punkt ist nicht, wo er "
    "sein soll",
    "the cameras stood still": "die Kameras standen still",
    "camera {view} moved": "Kamera {view} bewegte sich",
    "what stands still moves in its picture": "was ruht, bewegt sich in ihrem Bild",
    "{before:n} px (rms) were removed with the help of {count:n} static points, {after:n} px are left": "{before} px "
    "(Effektivwert) wurden mithilfe von {count} Festpunkten entfernt, {after} px bleiben",
    "camera {view} moved far": "Kamera {view} bewegte sich weit",
    "{before:n} px (rms) were taken out by its pose in every frame, found by {count:n} static points; {after:n} px are "
    "left of each by the others": "{before} px (Effektivwert) wurden durch ihre Lage in jedem Bild herausgenommen, die "
    "{count} Festpunkte zeigen; je Festpunkt bleiben durch die anderen {after} px",
    "{before:n} px (rms) were taken out by its pose in every frame; three static points show it and nothing checks "
    "them": "{before} px (Effektivwert) wurden durch ihre Lage in jedem Bild herausgenommen; drei Festpunkte zeigen "
    "sie, und nichts prüft diese",
    "name a fourth": "einen vierten benennen",
    "camera {view} moves far, and fewer than three static points show how; name four or more at several depths": ""
    "Kamera {view} bewegt sich weit, und weniger als drei Festpunkte zeigen, wie; vier oder mehr in mehreren Tiefen "
    "benennen",
    "camera {view} moves far, and its static points do not show how": "Kamera {view} bewegt sich weit, und ihre "
    "Festpunkte zeigen nicht, wie",
    "they lie on one line or leave the picture; name four or more at several depths, all around the structure": "sie "
    "liegen auf einer Linie oder verlassen das Bild; vier oder mehr in mehreren Tiefen rings um das Bauwerk benennen",
    "the picture does not follow the structure": "das Bild folgt dem Bauwerk nicht",
    "the picture of {view} follows the structure": "das Bild von {view} folgt dem Bauwerk",
    "the camera stabilises": "die Kamera stabilisiert",
    "Switch it off and film again": "Die Stabilisierung abschalten und neu filmen",
    "{view} stabilises its picture; the static points took it out, but switch it off next time": "{view} stabilisiert "
    "ihr Bild; die Festpunkte nahmen es heraus, aber nächstes Mal die Stabilisierung abschalten",
    "the structure rests during the still interval": "das Bauwerk ruht während des Ruheintervalls",
    "the structure moves during the still interval ({place:what})": "das Bauwerk bewegt sich während des "
    "Ruheintervalls ({place})",
    "the origin of displacement is off by up to as much; name a time of rest (method.still_interval_s), or leave it "
    "out": "der Ursprung der Verschiebung ist bis zu ebenso viel falsch; eine Zeit der Ruhe angeben "
    "(method.still_interval_s) oder weglassen",
    # Signal.
    "all motion stands clear of its noise": "alle Bewegung hebt sich klar vom Rauschen ab",
    "nothing rises above the noise": "nichts hebt sich vom Rauschen ab",
    "little more than noise": "kaum mehr als Rauschen",
    "little more than noise: {places:what}": "kaum mehr als Rauschen: {places}",
    "use a longer lens, a larger subset or more light": "längere Brennweite, größeren Ausschnitt oder mehr Licht "
    "verwenden",
    "positions are a network's own, whose gain on small motion is not known": "die Positionen stammen von einem Netz, "
    "dessen Verstärkung bei kleiner Bewegung nicht bekannt ist",
    'let registration measure (tracker "...+icgn"), or test the weights (docs/networks.md)': "mit Registrierung messen "
    '(tracker "...+icgn"), oder die Gewichte prüfen (docs/networks.md)',
    "known shifts of parts of a pixel come out at their full size": "bekannte Verschiebungen um Teile eines Pixels "
    "kommen in voller Größe heraus",
    "known shifts come out wrong at {place:what}": "bekannte Verschiebungen kommen bei {place} falsch heraus",
    "too little texture for the noise; use a larger subset": "zu wenig Textur für das Rauschen; einen größeren "
    "Ausschnitt verwenden",
    "no frame is missing or repeated": "kein Bild fehlt oder ist wiederholt",
    "the recording of {view}": "die Aufnahme von {view}",
    "the recording of {view} lacks frames or repeats them": "der Aufnahme von {view} fehlen Bilder, oder sie sind "
    "wiederholt",
    "the recording of {view} is not whole": "die Aufnahme von {view} ist nicht vollständig",
    "{lost:n} % of its frames cannot be read": "{lost} % ihrer Bilder sind nicht lesbar",
    "copy it from the camera again": "sie neu von der Kamera kopieren",
    "{frames:n} frames of all views together are enough to judge noise and motion by": "{frames} gemeinsame Bilder "
    "aller Ansichten genügen, um Rauschen und Bewegung zu beurteilen",
    "{frames:n} trusted frames of all views together are too few to judge noise, clocks and cameras by": "{frames} "
    "vertrauenswürdige gemeinsame Bilder aller Ansichten sind zu wenige, um Rauschen, Uhren und Kameras zu beurteilen",
    "{percent:n} % of {view} has no frame at its side and is not used": "{percent} % von {view} haben kein Bild zur "
    "Seite und werden nicht verwendet",
    "point {point} was not refined: {why:say}": "Punkt {point} wurde nicht verfeinert: {why}",
    "every point was refined": "jeder Punkt wurde verfeinert",
    "for {place:what} the assumption about the suppressed axis weighs {times:n} times the images' noise in the stated "
    "uncertainty": "für {place} wiegt die Annahme über die unterdrückte Achse in der angegebenen Unsicherheit das "
    "{times}-Fache des Bildrauschens",
    # Long recordings.
    "hardly any motion": "kaum Bewegung",
    "no point that must not move was named": "es wurde kein Festpunkt benannt",
    "whether cameras or structure drift, nobody can tell": "ob Kameras oder Bauwerk driften, kann niemand sagen",
    "what must not move stays where it is over all intervals": "was ruhen muss, bleibt über alle Teile, wo es ist",
    "point {point} must not move and drifts from interval to interval": "Punkt {point} darf sich nicht bewegen und "
    "driftet von Teil zu Teil",
    "slow motion of the others is as doubtful": "langsame Bewegung der anderen ist ebenso zweifelhaft",
    "in {count:n} of {all:n} intervals, worst from {begin:n} to {end:n} s": "in {count} von {all} Teilen, am "
    "ungünstigsten von {begin} bis {end} s",
    # Checks of other packages.
    "expected the check of {package} to be an AuditCheck, got {answer}": "die Prüfung von {package} lieferte keinen "
    "AuditCheck, sondern {answer}",
    "the check of {package} failed": "die Prüfung von {package} ist gescheitert",
}

CHECK_FORMS: Mapping[str, str] = {
    **_STATUSES,
    **{f"{english} in view {{view}}": f"{german} (Ansicht {{view}})" for english, german in _POINTS.items()},
    **{
        f"{{point}}: {english} in view {{view}}": f"{{point}}: {german} (Ansicht {{view}})"
        for english, german in _POINTS.items()
    },
    **{english: german for key, (english, german) in WORD_TEXTS.items() if key.startswith("check ")},
    **_SENTENCES,
}
"""Sentences of checks, and the names of the checks before them."""

THING_FORMS: Mapping[str, str] = {
    **{
        f"{english} of {{point}}": f"{german} von {{point}}"
        for key, (english, german) in WORD_TEXTS.items()
        if key.startswith("axis ") and "short" not in key
    },
    "baseline": "Basislänge",
    "focal {view}": "Brennweite {view}",
    "focal lengths of all views": "Brennweiten aller Ansichten",
    "principal point u {view}": "Hauptpunkt u {view}",
    "principal point v {view}": "Hauptpunkt v {view}",
    "distortion k1 {view}": "Verzeichnung k1 {view}",
    "pitch reference camera": "Neigung der Referenzkamera",
    "roll reference camera": "Rollen der Referenzkamera",
    "perpendicular distance": "Abstand quer",
    "longitudinal distance": "Abstand längs",
    "perpendicular distance {view}": "Abstand quer {view}",
    "longitudinal distance {view}": "Abstand längs {view}",
    "range {view} to {point}": "Strecke {view} bis {point}",
    "range to {point}": "Strecke zu {point}",
    "rectangle of {points}": "Rechteck aus {points}",
    "length {first} to {second}": "Länge {first} bis {second}",
    "distance {first} to {second}": "Abstand {first} bis {second}",
    "point {point}": "Punkt {point}",
    "recordings of the two views": "Aufnahmen der beiden Ansichten",
    "lenses of the two views": "Objektive der beiden Ansichten",
    "distances of {first} and {second}": "Abstände von {first} und {second}",
    "distances of {view}": "Abstände von {view}",
    "side of the structure": "Seite des Bauwerks",
    "sign of the pitch": "Vorzeichen der Neigung",
    "sign of the roll": "Vorzeichen des Rollens",
    "signs of the level": "Vorzeichen der Wasserwaage",
    "pitch and roll": "Neigung und Rollen",
    "sign of the pitch of {view}": "Vorzeichen der Neigung von {view}",
    "sign of the roll of {view}": "Vorzeichen des Rollens von {view}",
    "signs of the level of {view}": "Vorzeichen der Wasserwaage von {view}",
    "pitch and roll of {view}": "Neigung und Rollen von {view}",
    "a length of {metres:n} m between {first} and {second} known to {std:n} mm": "eine auf {std} mm bekannte Länge von "
    "{metres} m zwischen {first} und {second}",
    "a range of {metres:n} m from the camera of {view} to {point} known to {std:n} mm": "eine auf {std} mm bekannte "
    "Strecke von {metres} m von der Kamera von {view} bis {point}",
    "a baseline of {metres:n} m known to {std:n} mm": "eine auf {std} mm bekannte Basislänge von {metres} m",
    "a calibration of the lens of {view} to {percent:n} %": "eine Kalibrierung des Objektivs von {view} auf "
    "{percent} %",
    "places of the points": "Lage der Punkte",
    "exact displacement of a synthetic field test": "exakte Verschiebung eines synthetischen Feldversuchs",
    "sensors {names}": "Sensoren {names}",
    "a calibration of the lenses": "eine Kalibrierung der Objektive",
}
"""Places, quantities and readings as sentences name them."""
