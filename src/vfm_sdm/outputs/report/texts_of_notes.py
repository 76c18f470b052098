"""German forms of the notes on cameras, recordings and results."""

from collections.abc import Mapping

__all__ = ["NOTE_FORMS"]

_RECORDINGS: Mapping[str, str] = {
    "view {view}": "Ansicht {view}",
    "compressed to {bits:n} bits a pixel": "auf {bits} Bit je Pixel komprimiert",
    "motion comes out some 1 to 2 % too small; it is corrected where injected motion shows by how much, else stated "
    "(docs/decisions/008-compression.md)": "Bewegung kommt etwa 1 bis 2 % zu klein heraus; sie ist korrigiert, wo "
    "eingefügte Bewegung zeigt, um wie viel, sonst als Unsicherheit angegeben (docs/decisions/008-compression.md)",
    "{count:n} {how:say} frames of {all:n}": "{count} {how} von {all} Bildern",
    "dropped": "verlorene",
    "duplicated": "wiederholte",
    "measured across an edge only, nothing along it: {points}": "nur quer zu einer Kante gemessen, nichts längs: "
    "{points}",
    "point {point} in view {view}": "Punkt {point} in Ansicht {view}",
    "not tracked": "nicht verfolgt",
    "name another": "eine andere Stelle benennen",
    "({u:n}, {v:n}) would do": "geeignet wäre ({u}; {v})",
    "none near would do": "in der Nähe ist keine geeignet",
    "not synchronised by its motion": "nicht durch die Bewegung synchronisiert",
    "its time_offset_s was taken (0 when not stated, and then all samples are marked unreliable)": "time_offset_s "
    "wurde verwendet (0, wenn nicht angegeben; dann sind alle Werte als unzuverlässig markiert)",
    'state it, or set method.synchronization = "none" for cameras that start together': "ihn angeben, oder für "
    'gemeinsam gestartete Kameras method.synchronization = "none" setzen',
    "point {point}": "Punkt {point}",
    "point {point}, view {view}": "Punkt {point}, Ansicht {view}",
    "not refined": "nicht verfeinert",
    "refinement: the assumption that hardly anything moves along the suppressed axis says more than the images do "
    "about {first:what}": "Verfeinerung: Die Annahme, dass sich entlang der unterdrückten Achse kaum etwas bewegt, "
    "sagt mehr als die Bilder über {first}",
    "the assumption that hardly anything moves along the suppressed axis says more than the images do about": "Die "
    "Annahme, dass sich entlang der unterdrückten Achse kaum etwas bewegt, sagt mehr als die Bilder über",
    "all points jump at once at {seconds} s": "alle Punkte springen zugleich bei {seconds} s",
    "frames are missing there that the time stamps do not show, and the time after is wrong; film at a lower rate or "
    "with a faster card, and measure the parts between alone": "dort fehlen Bilder, was die Zeitstempel nicht zeigen, "
    "und die Zeit danach ist falsch; mit kleinerer Bildrate oder schnellerer Karte filmen und die Teile dazwischen "
    "einzeln messen",
    "every {number:n}th frame repeats the one before": "jedes {number}. Bild wiederholt das vorige",
    "converted from {rate:n} frames a second; {count:n} repeated frames are left out and the others are an even time "
    "apart": "umgerechnet von {rate} Bildern je Sekunde; {count} wiederholte Bilder sind ausgelassen, und die übrigen "
    "haben gleichen Abstand",
    "{count:n} frames repeat the one before and their samples are not trusted; use the camera's original file, or a "
    "constant frame rate": "{count} Bilder wiederholen das vorige, und ihre Werte gelten nicht; die Originaldatei der "
    "Kamera oder eine konstante Bildrate verwenden",
    "time stamps jitter by {jitter:n} ms (rms) while the motion runs evenly": "die Zeitstempel schwanken um {jitter} "
    "ms (Effektivwert), während die Bewegung gleichmäßig verläuft",
    "an even clock of {rate:n} frames a second is used": "verwendet wird eine gleichmäßige Uhr mit {rate} Bildern je "
    "Sekunde",
    "not tracked from {begin:n} s to {end:say}": "nicht verfolgt von {begin} s bis {end}",
    "{seconds:n} s": "{seconds} s",
    "the end": "zum Ende",
    "run again to try it once more": "für einen neuen Versuch noch einmal messen",
    "{tracker} needs the whole recording": "{tracker} braucht die ganze Aufnahme",
    "no frames at which it can be divided": "keine Bilder, an denen sie sich teilen lässt",
    "tracked in one piece of {seconds:n} s": "in einem Stück von {seconds} s verfolgt",
    "the tracker made no pass over the frames": "die Verfolgung las die Bilder nicht",
    "interlaced": "Zeilensprung (interlaced)",
    "every picture holds two fields of different times, and motion comes out late and too small; film progressively, "
    "or make a picture of each field (bwdif)": "jedes Bild enthält zwei Halbbilder verschiedener Zeit, und Bewegung "
    "kommt verspätet und zu klein heraus; progressiv filmen, oder aus jedem Halbbild ein Bild machen (bwdif)",
    "read {frames:n} frames": "{frames} Bilder gelesen",
    "read {frames:n} of {all:n} claimed frames": "{frames} von angeblich {all} Bildern gelesen",
    "read {frames:n} of about {all:n} claimed frames": "{frames} von angeblich etwa {all} Bildern gelesen",
    "irregular time stamps": "unregelmäßige Zeitstempel",
    "dropped frames cannot be told": "verlorene Bilder sind nicht erkennbar",
    "used from {begin:n} to {end:n} s of {length:n} s": "verwendet von {begin} bis {end} s von {length} s",
    "{count:n} chapters as one recording": "{count} Kapitel als eine Aufnahme",
    "{gap:n} s missing between {first} and {second}": "{gap} s fehlen zwischen {first} und {second}",
    "anamorphic": "anamorph",
    "pixels are {aspect:n} times as wide as high (sample aspect ratio {ratio:say})": "Pixel sind {aspect}-mal so breit "
    "wie hoch (Seitenverhältnis {ratio})",
    "cameras allow for it, and all pixels, those of named points too, are the stored ones": "die Kameras "
    "berücksichtigen es, und alle Pixel, auch die benannter Punkte, sind die gespeicherten",
    "capture_fps was stated, but the file names no rate of its own": "capture_fps ist angegeben, aber die Datei nennt "
    "keine eigene Bildrate",
    "stamps as of exported slow motion ({rate:n} frames a second)": "Zeitstempel wie von exportierter Zeitlupe ({rate} "
    "Bilder je Sekunde)",
    "film without it, use the camera's original file, or state capture_fps, the rate at which it was filmed": "ohne "
    "Zeitlupe filmen, die Originaldatei der Kamera verwenden, oder capture_fps angeben, die Bildrate der Aufnahme",
    "the file says that {taken:n} frames a second were taken and holds {stored:n}": "die Datei nennt {taken} "
    "aufgenommene Bilder je Sekunde und enthält {stored}",
    "its time stamps are used; state capture_fps where they are wrong": "ihre Zeitstempel werden verwendet; "
    "capture_fps angeben, wo sie falsch sind",
    "slow motion": "Zeitlupe",
    "time lapse": "Zeitraffer",
    "capture rate": "Bildrate der Aufnahme",
    "filmed at {taken:n} and stored at {stored:n} frames a second": "mit {taken} Bildern je Sekunde gefilmt und mit "
    "{stored} gespeichert",
    "as the file says": "wie die Datei sagt",
    "as stated (capture_fps)": "wie angegeben (capture_fps)",
    "state capture_fps = {rate:n} if its time stamps are right": "capture_fps = {rate} angeben, wenn ihre Zeitstempel "
    "stimmen",
    "time is that of filming": "die Zeit ist die der Aufnahme",
    "{count:n} files whose names do not belong to the sequence are left out": "{count} Dateien, deren Namen nicht zur "
    "Folge gehören, sind ausgelassen",
    "{count:n} numbers are missing in the sequence, the first after {file}": "in der Folge fehlen {count} Nummern, die "
    "erste nach {file}",
    "gaps in time": "Lücken in der Zeit",
    "number the files without gaps if nothing is missing": "die Dateien ohne Lücken nummerieren, wenn nichts fehlt",
    "{after} was begun {apart:n} s after {before} by the dates of the files, {late:n} s later than it is joined": ""
    "{after} wurde nach den Daten der Dateien {apart} s nach {before} begonnen, {late} s später als angefügt",
    "if the camera was stopped between them, measure them one by one": "wenn die Kamera dazwischen angehalten wurde, "
    "sie einzeln messen",
    "the session in this folder is not measured to its end; `vfm-sdm measure` finishes it": "die Session in diesem "
    "Ordner ist nicht zu Ende gemessen; `vfm-sdm measure` beendet sie",
}

_CAMERAS: Mapping[str, str] = {
    "no level reading of the reference camera": "keine Wasserwaage an der Referenzkamera abgelesen",
    "pitch and roll taken as 0 +- 1 degree": "Neigung und Rollen als 0 ± 1 Grad angenommen",
    "not determined by the other data, rests on its prior alone: {names:what}": "durch die übrigen Daten nicht "
    "bestimmt, beruht allein auf der Vorgabe: {names}",
    "{what:what}: expected {prior:n} +- {std:n} {units}, the adjustment gives {value:n} ({times:n} standard deviations "
    "away)": "{what}: erwartet {prior} ± {std} {units}, die Ausgleichung ergibt {value} ({times} Standardabweichungen "
    "entfernt)",
    "{what:what}: known to {percent:n} % only; state the lens, or measure a range to a point": "{what}: nur auf "
    "{percent} % bekannt; das Objektiv angeben, oder eine Strecke zu einem Punkt messen",
    "{what:what}: known to {percent:n} % only; choose views that overlap more, so that three see the same points": ""
    "{what}: nur auf {percent} % bekannt; Ansichten wählen, die sich mehr überdecken, damit drei dieselben Punkte "
    "sehen",
    "straight edges": "gerade Kanten",
    "too few along any axis of the structure, none used": "zu wenige entlang jeder Achse des Bauwerks, keine verwendet",
    "straight edges used: {counts:say}": "verwendete gerade Kanten: {counts}",
    "{count:n} lateral": "{count} quer",
    "{count:n} vertical": "{count} vertikal",
    "{count:n} longitudinal": "{count} längs",
    "the axes come from them, for the two distances were not measured": "die Achsen kommen von ihnen, denn die beiden "
    "Abstände wurden nicht gemessen",
    "{what:what} not used": "{what} nicht verwendet",
    "its point was not found in a second view": "ihr Punkt wurde in keiner zweiten Ansicht gefunden",
    "the camera file states no covariance": "die Kameradatei gibt keine Kovarianz an",
    "the scale has no stated uncertainty": "der Maßstab hat keine angegebene Unsicherheit",
    "camera files are not metric": "Kameradateien sind nicht metrisch",
    "lengths need a measured baseline": "Längen brauchen eine gemessene Basislänge",
    "camera files": "Kameradateien",
    "without a joint covariance their part of the uncertainty is unknown": "ohne gemeinsame Kovarianz ist ihr Anteil "
    "an der Unsicherheit unbekannt",
    # What is most probably wrong.
    "most probably wrong: {what:what}": "höchstwahrscheinlich falsch: {what}",
    "stated as {value:n} {units}": "angegeben als {value} {units}",
    "everything else gives {value:n} +- {std:n}": "alles Übrige ergibt {value} ± {std}",
    "in millimetres": "in Millimetern",
    "in feet": "in Fuß",
    "in kilometres, or divided by 1000 once too often": "in Kilometern, oder einmal zu oft durch 1000 geteilt",
    "as if {how:say}": "als sei es {how}",
    "stated in millimetres": "in Millimetern angegeben",
    "stated in kilometres, or divided by 1000 once too often": "in Kilometern angegeben, oder einmal zu oft durch 1000 "
    "geteilt",
    "stated in feet": "in Fuß angegeben",
    "of the other side of a picture of 16 to 9, as EXIF of a turned picture gives it": "von der anderen Seite eines "
    "Bildes 16 zu 9, wie EXIF es bei gedrehten Bildern angibt",
    "stated with the other sign": "mit umgekehrtem Vorzeichen angegeben",
    "nearly as probable: {names:what}": "fast ebenso wahrscheinlich: {names}",
    "expected a pan clip filmed with the lens, zoom and mode of the recording, got a lens file of another one, do: "
    "film the pan clip again just before or after the recording, with focus and zoom locked": "erwartet war ein "
    "Schwenkvideo mit Objektiv, Zoom und Modus der Aufnahme, gegeben ist eine Objektivdatei von einem anderen; das "
    "Schwenkvideo kurz vor oder nach der Aufnahme mit fixiertem Fokus und Zoom neu filmen",
    "expected a sensor {width:n} mm wide, got that of 35 mm film, do: state its own width": "erwartet war ein {width} "
    "mm breiter Sensor, gegeben ist der von Kleinbildfilm; die eigene Breite angeben",
    "expected a sensor {widths:n} or {width:n} mm wide, got that of 35 mm film, do: state its own width": "erwartet "
    "war ein {widths} oder {width} mm breiter Sensor, gegeben ist der von Kleinbildfilm; die eigene Breite angeben",
    "expected the focal length of the lens itself, got focal_mm = {focal} as of 35 mm film, do: state the lens's own, "
    "or sensor_width_mm = {width} beside it": "erwartet war die Brennweite des Objektivs selbst, gegeben ist focal_mm "
    "= {focal} wie bei Kleinbild; die eigene angeben, oder sensor_width_mm = {width} dazu",
    "expected the recording of either camera under its name, got {pair} the other way round, do: exchange them": ""
    "erwartet war die Aufnahme jeder Kamera unter ihrem Namen, {pair} sind vertauscht; sie tauschen",
    "expected the lens of either camera under its name, got those of {pair} the other way round, do: exchange them": ""
    "erwartet war das Objektiv jeder Kamera unter ihrem Namen, die von {pair} sind vertauscht; sie tauschen",
    "expected those of {first} under [site], got those of {second} there, do: exchange them": "unter [site] wurden die "
    "von {first} erwartet, dort stehen die von {second}; sie tauschen",
    "expected {across:n} m across and {along:n} m along the structure, got them the other way round, do: exchange "
    "perpendicular_distance and longitudinal_distance": "erwartet waren {across} m quer und {along} m längs des "
    "Bauwerks, sie sind vertauscht; perpendicular_distance und longitudinal_distance tauschen",
    "expected {side}, got {other}, do: correct structure_side": "erwartet war {side}, angegeben ist {other}; "
    "structure_side berichtigen",
    "expected pitch {pitch:n} and roll {roll:n} deg, got {other:n} and {wrong:n}, do: correct the level (pitch is "
    "positive upwards, roll with the right-hand side lowered)": "erwartet waren Neigung {pitch} und Rollen {roll} "
    "Grad, angegeben sind {other} und {wrong}; die Wasserwaage berichtigen (Neigung ist aufwärts positiv, Rollen mit "
    "gesenkter rechter Seite)",
    "expected {value:n} m, got {other:n} {unit:say}, do: state it in metres": "erwartet waren {value} m, angegeben "
    "sind {other} {unit}; in Metern angeben",
    # Several cameras that fit.
    "halves of the matches give cameras that differ by up to {turn:n} degrees, {times:n} times as much as they should: "
    "which matches agree is chance": "Hälften der Verknüpfungen ergeben Kameras, die um bis zu {turn} Grad abweichen, "
    "{times}-mal so viel wie zulässig: Welche Verknüpfungen passen, ist Zufall",
    "name five points in both views (pixel_in), measure both distances of the face, or use a learned matcher": "fünf "
    "Punkte in beiden Ansichten benennen (pixel_in), beide Abstände der Bauwerksfläche messen, oder eine gelernte "
    "Verknüpfung verwenden",
    "measure both distances of the face, name five points in both views (pixel_in), or use a learned matcher": "beide "
    "Abstände der Bauwerksfläche messen, fünf Punkte in beiden Ansichten benennen (pixel_in), oder eine gelernte "
    "Verknüpfung verwenden",
    "other cameras, turned by {turn:n} degrees, agree as well": "andere Kameras, um {turn} Grad gedreht, passen ebenso",
    "a range from the other camera": "eine Strecke von der anderen Kamera",
    "perpendicular distance of view {view} would decide: {here:n} or {there:n} {unit}": "der Abstand quer der Ansicht "
    "{view} würde entscheiden: {here} oder {there} {unit}",
    "longitudinal distance of view {view} would decide: {here:n} or {there:n} {unit}": "der Abstand längs der Ansicht "
    "{view} würde entscheiden: {here} oder {there} {unit}",
    "{what} of view {view} would decide: {here:n} or {there:n} {unit}": "{what} der Ansicht {view} würde entscheiden: "
    "{here} oder {there} {unit}",
    "stands of view {view} would decide": "der Standort der Ansicht {view} würde entscheiden",
    '"{side}" or "{other}"': '"{side}" oder "{other}"',
    "{few:n} of {all:n} matches of {first} and {second} do not lie in front of both cameras": "{few} von {all} "
    "Verknüpfungen von {first} und {second} liegen nicht vor beiden Kameras",
    "{view} is turned by {degrees:n} degrees from where its estimator put it, which states {std:n}": "{view} ist um "
    "{degrees} Grad von dort weggedreht, wo ihr Verfahren sie sah, das {std} angibt",
    "use another camera estimator": "ein anderes Verfahren für die Kameras wählen",
    "PoseDiffusion: {few:n} of {all:n} matches agree with its cameras, too few to guide it": "PoseDiffusion: {few} von "
    "{all} Verknüpfungen passen zu seinen Kameras, zu wenige, um es zu führen",
    "PoseDiffusion: {few:n} of {all:n} matches of {first} and {second} agree with its cameras": "PoseDiffusion: {few} "
    "von {all} Verknüpfungen von {first} und {second} passen zu seinen Kameras",
    "they are probably wrong": "sie sind vermutlich falsch",
    "{source} gives two focal lengths, {first:n} and {second:n} px": "{source} gibt zwei Brennweiten an, {first} und "
    "{second} px",
    "{source}'s focal length is {percent} off what was known of it": "die Brennweite von {source} weicht um {percent} "
    "von der bekannten ab",
    "focal length from EXIF, known to 5 %": "Brennweite aus EXIF, auf 5 % bekannt",
    "lens of pictures of {width:n} x {height:n} px, taken as showing the same field as these": "Objektiv von Bildern "
    "mit {width} x {height} px, als gleiches Blickfeld angenommen",
    "{first} and {second}: the pose that most matches agree with contradicts the points that are named in both "
    "views": "{first} und {second}: Die Stellung, zu der die meisten Verknüpfungen passen, widerspricht den in beiden "
    "Ansichten benannten Punkten",
    "correct their pixels (pixel_in), name five such points, or measure both distances of the face": "ihre Pixel "
    "(pixel_in) berichtigen, fünf solche Punkte benennen, oder beide Abstände der Bauwerksfläche messen",
    "{first} and {second}: all but {few:n} of {all:n} matches lie on what repeats, {needed:n} others are needed": ""
    "{first} und {second}: Alle bis auf {few} von {all} Verknüpfungen liegen auf sich Wiederholendem, {needed} andere "
    "sind nötig",
    "name five points in both views (pixel_in), or choose views that show more": "fünf Punkte in beiden Ansichten "
    "benennen (pixel_in), oder Ansichten wählen, die mehr zeigen",
    "{few:n} of {all:n} matches agree, {needed:n} are needed": "{few} von {all} Verknüpfungen passen, {needed} sind "
    "nötig",
    "choose views that overlap more, or name five points in both views (pixel_in)": "Ansichten wählen, die sich mehr "
    "überdecken, oder fünf Punkte in beiden Ansichten benennen (pixel_in)",
    "matches agree in {few:n} places of the images, by chance they do in {chance:n}": "Verknüpfungen passen an {few} "
    "Stellen der Bilder, durch Zufall an {chance}",
    "no pose stands out, as with what repeats": "keine Stellung hebt sich ab, wie bei sich Wiederholendem",
    "{views} and {last}: {few:n} matches go through all three, {needed:n} are needed": "{views} und {last}: {few} "
    "Verknüpfungen gehen durch alle drei, {needed} sind nötig",
    "choose views that overlap more": "Ansichten wählen, die sich mehr überdecken",
}

_LENSES: Mapping[str, str] = {
    "nothing known of the lens; state `lens` in the session, if only its camera": "nichts vom Objektiv bekannt; `lens` "
    "in der Session angeben, und sei es nur die Kamera",
    "Taken is what consumer cameras have, {low:n} to {high:n} degrees of view": "Angenommen ist, was übliche Kameras "
    "haben, {low} bis {high} Grad Blickfeld",
    "mode {mode} names no field of view": "der Modus {mode} nennt kein Blickfeld",
    "taken as unknown; say Linear, Wide, 1x, 26mm or such": "als unbekannt genommen; Linear, Wide, 1x, 26mm oder "
    "Ähnliches angeben",
    "mode {mode} is {stated}, and the picture {aspect}": "der Modus {mode} ist {stated} und das Bild {aspect}",
    "the picture's is taken": "das des Bildes wird genommen",
    "film in a linear mode": "in einem linearen Modus filmen",
    "state the mode, best a linear one": "den Modus angeben, am besten einen linearen",
    "the file names {camera}": "die Datei nennt {camera}",
    "the file names {camera}, whose distortion the camera model does not describe": "die Datei nennt {camera}, deren "
    "Verzeichnung das Kameramodell nicht beschreibt",
    "its profile is not used": "ihr Profil wird nicht verwendet",
    "state `lens` in the session for more": "für mehr `lens` in der Session angeben",
    "the session states {stated}, and the file names {named}": "die Session nennt {stated}, und die Datei nennt "
    "{named}",
    "the session is believed": "die Session gilt",
    "correct one": "eine davon berichtigen",
    "the file says that it is {state:say}, and the session the opposite": "die Datei sagt, sie sei {state}, und die "
    "Session das Gegenteil",
    "stabilised": "stabilisiert",
    "not stabilised": "nicht stabilisiert",
    "the session states the mode {mode}": "die Session nennt den Modus {mode}",
    "the file names a lens of {film:n} mm, {percent} off the mode's": "die Datei nennt ein Objektiv von {film} mm, "
    "{percent} neben dem des Modus",
    "everything else gives a focal length {percent:n} % {way:say} than calibrators of {name} found": "alles Übrige "
    "ergibt eine um {percent} % {way} Brennweite, als Kalibrierungen von {name} fanden",
    "longer": "längere",
    "shorter": "kürzere",
    "mode {mode}": "Modus {mode}",
    "nearer lies": "näher liegt",
    "none of its modes": "keiner ihrer Modi",
    "check mode and stabilisation": "Modus und Stabilisierung prüfen",
    "{count:n} calibrators of {group:say}": "{count} Kalibrierungen; {group}",
    "the model": "das Modell",
    "cameras of the kind": "Kameras dieser Art",
    "cameras of the kind in this mode": "Kameras dieser Art in diesem Modus",
    "cameras of the maker": "Kameras des Herstellers",
    "{degrees} degrees of view": "{degrees} Grad Blickfeld",
    "the focal length known to {low:n} and {high:n} % (95 %)": "die Brennweite auf {low} und {high} % bekannt (95 %)",
    "the sensor is read in about {time:n} ms": "der Sensor wird in etwa {time} ms ausgelesen",
    # Chessboards and structure from motion.
    "chessboard": "Schachbrett",
    "{used:n} pairs used, {dropped:n} dropped": "{used} Paare verwendet, {dropped} verworfen",
    "reprojection error {error:n} px": "Rückprojektionsfehler {error} px",
    "baseline {length:n} mm with standard deviation {std:n} mm": "Basislänge {length} mm mit Standardabweichung {std} "
    "mm",
    "chessboard pair {pair} dropped": "Schachbrettpaar {pair} verworfen",
    "chessboard pair {pair}": "Schachbrettpaar {pair}",
    "corners turned in one view, put in order": "Ecken in einer Ansicht verdreht, geordnet",
    "the pictures contradict each other more than independent corner errors would": "die Bilder widersprechen einander "
    "mehr, als unabhängige Eckenfehler es täten",
    "variances are {times:n} times those of independent errors on average": "die Varianzen sind im Mittel {times}-mal "
    "die unabhängiger Fehler",
    "baseline {found:n} m, measured {stated:n} m": "Basislänge {found} m, gemessen {stated} m",
    "they differ by {times:n} standard deviations": "sie weichen um {times} Standardabweichungen ab",
    "check the size of the squares and the tape": "Größe der Felder und Bandmaß prüfen",
    "{first} and {second}: {few:n} of {all:n} matches agree": "{first} und {second}: {few} von {all} Verknüpfungen "
    "passen",
    "every view needs {count:n} with another one": "jede Ansicht braucht {count} mit einer anderen",
    "state the lens of every view, or choose views with more overlap, depth and distance between them": "das Objektiv "
    "jeder Ansicht angeben, oder Ansichten mit mehr Überdeckung, Tiefe und Abstand wählen",
    "structure from motion": "Rekonstruktion aus den Bildern (structure from motion)",
    "{count:n} points, mean reprojection error {error:n} px": "{count} Punkte, mittlerer Rückprojektionsfehler {error} "
    "px",
}

_COMPARISON: Mapping[str, str] = {
    "reference": "Referenz",
    "lag of the reference unknown": "Versatz der Referenz unbekannt",
    "widen or narrow the search, or state the lag": "den Suchbereich ändern, oder den Versatz angeben",
    "left out": "ausgelassen",
    "axes {axes}, which one side does not have": "Achsen {axes}, die eine Seite nicht hat",
    "the band {low:n} to {high:n} Hz is wider than the reference's, {first:n} to {last:n}": "das Band {low} bis {high} "
    "Hz ist breiter als das der Referenz, {first} bis {last}",
}

NOTE_FORMS: Mapping[str, str] = {**_RECORDINGS, **_CAMERAS, **_LENSES, **_COMPARISON}
"""Sentences of notes."""
