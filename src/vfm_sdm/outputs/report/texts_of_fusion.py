"""Texts of a report's section on the fusion with an accelerometer."""

from collections.abc import Mapping

__all__ = ["FUSION_FORMS", "FUSION_TEXTS", "FUSION_THINGS"]

FUSION_TEXTS: Mapping[str, tuple[str, str]] = {
    "title fusion": ("Fusion with an accelerometer", "Fusion mit einem Beschleunigungssensor"),
    "fusion head": (
        "Displacement of {point} from the video and the acceleration of sensor {sensor} together, from standstill to "
        "{highest} Hz at {rate} values a second. Values stand with their expanded uncertainty (k = 2).",
        "Verschiebung von {point} aus dem Video und der Beschleunigung des Sensors {sensor} gemeinsam, vom Stillstand "
        "bis {highest} Hz mit {rate} Werten je Sekunde. Werte stehen mit ihrer erweiterten Unsicherheit (k = 2).",
    ),
    "table fusion": (
        "Lag: how much later the sensor's clock shows an event. Gain: motion of the video over that of the sensor. "
        "Noise: standard deviation of one value. Innovation: what a value of the video is off the prediction.",
        "Versatz: um wie viel später die Uhr des Sensors ein Ereignis zeigt. Verhältnis: Bewegung des Videos zu der "
        "des Sensors. Rauschen: Standardabweichung eines Werts. Innovation: Abweichung eines Werts des Videos von der "
        "Vorhersage.",
    ),
    "fusion lag": ("lag [ms]", "Versatz [ms]"),
    "fusion gain": ("gain", "Verhältnis"),
    "fusion p2p": ("peak-to-peak [mm]", "Schwingweite [mm]"),
    "fusion video": ("noise, video [mm]", "Rauschen, Video [mm]"),
    "fusion fused": ("noise, fused [mm]", "Rauschen, fusioniert [mm]"),
    "fusion innovation": ("innovation [mm]", "Innovation [mm]"),
    "fusion bridged": ("bridged [%]", "überbrückt [%]"),
    "figure fusion": (
        "{axis}: fused displacement with its expanded uncertainty (band, k = 2), as a whole and where it moves "
        "fastest, with the values of the video as dots.",
        "{axis}: fusionierte Verschiebung mit erweiterter Unsicherheit (Band, k = 2), im Ganzen und bei der "
        "schnellsten Bewegung, Werte des Videos als Punkte.",
    ),
}

FUSION_FORMS: Mapping[str, str] = {
    "the video scatters {ratio:n} times as much as it states": "das Video streut {ratio}-mal so stark wie angegeben",
    "check that the sensor sits at the point": "prüfen, ob der Sensor an diesem Punkt sitzt",
    "the video is off what the sensor predicts by {ratio:n} times what both explain": "das Video weicht um das "
    "{ratio}-fache dessen, was beide erklären, von der Vorhersage des Sensors ab",
    "at {time:n} s the video is off what the sensor predicts by {ratio:n} times what both explain": "bei {time} s "
    "weicht das Video um das {ratio}-fache dessen, was beide erklären, von der Vorhersage des Sensors ab",
    "one of them jumped there and the result is wrong about it": "eines von beiden ist dort gesprungen und das "
    "Ergebnis dort falsch",
    "{count:n} lone samples are bridged": "{count} einzeln abweichende Werte sind überbrückt",
    "the first at {time:n} s": "der erste bei {time} s",
    "check the logger": "den Datenlogger prüfen",
    "the video is {gain:n} times the sensor": "das Video ist das {gain}-fache des Sensors",
    "check the sensor's units and the sign of its column": "Einheiten des Sensors und Vorzeichen seiner Spalte prüfen",
    "do not rely on the intervals": "den Intervallen nicht vertrauen",
    "video and sensor differ in size by {percent:n} %": "Video und Sensor unterscheiden sich um {percent} %",
    "which the stated uncertainty of the scale does not explain": "was die angegebene Unsicherheit des Maßstabs nicht "
    "erklärt",
    "check the lengths of the site and the sensor's units": "die Längen des Orts und die Einheiten des Sensors prüfen",
    "no static point shows how the video errs slowly": "kein Festpunkt zeigt, wie das Video langsam abweicht",
    "0.3 of its scatter is assumed, within a factor of two": "angenommen sind 0,3 seiner Streuung, auf den "
    "Faktor zwei genau",
    "add a point that must not move": "einen Punkt hinzufügen, der sich nicht bewegen darf",
    "the lag is looked for within {width:n} s of {centre:n} s, by the start times of video and sensor": "der Versatz "
    "wird im Abstand von {width} s um {centre} s gesucht, nach den Anfangszeiten von Video und Sensor",
    "lag of the sensor": "Versatz des Sensors",
    "sensor {sensor} tells no length": "Sensor {sensor} gibt keine Länge an",
    "it reads {value:n} m/s2 at rest": "er zeigt in Ruhe {value} m/s2",
    "its vertical axis does not feel gravity": "seine vertikale Achse spürt die Fallbeschleunigung nicht",
    "neither gravity nor nothing": "weder die Fallbeschleunigung noch nichts",
    "check its units and its columns": "seine Einheiten und Spalten prüfen",
    "name those of all three axes where it is not upright": "die aller drei Achsen angeben, wenn er nicht aufrecht "
    "steht",
    "its record holds no gravity and nothing checks its units": "seine Aufzeichnung enthält keine Fallbeschleunigung "
    "und "
    "nichts prüft seine Einheiten",
    "along {axis} the video scatters {ratio:n} times as much about it as it states": "entlang {axis} streut das "
    "Video um "
    "ihn {ratio}-mal so stark wie angegeben",
    "along {axis} its motion has another size at some frequencies than at others": "entlang {axis} ist seine "
    "Bewegung bei "
    "manchen Frequenzen anders groß als bei anderen",
    "the video over it is {ratio:n} times as large along {first} as along {second}": "das Video ist über ihm entlang "
    "{first} {ratio}-mal so groß wie entlang {second}",
    "check that it sits at {point} and that nothing filters it": "prüfen, ob er an {point} sitzt und nichts ihn "
    "filtert",
    "the video over the sensor is {size:n} from {low:n} to {high:n} Hz and {other:n} from {begin:n} to {end:n} Hz": ""
    "das "
    "Video über dem Sensor ist {size} von {low} bis {high} Hz und {other} von {begin} bis {end} Hz",
    "the sensor sits elsewhere or does not show all frequencies alike": "der Sensor sitzt anderswo oder zeigt nicht "
    "alle "
    "Frequenzen gleich",
    "the cameras were not found": "die Kameras wurden nicht gefunden",
    "point {point} is not seen in two views": "Punkt {point} ist nicht in zwei Ansichten zu sehen",
    "scale by sensor {sensor}": "Maßstab durch Sensor {sensor}",
    "motion of {point} along {axis} known to {percent:n} %": "Bewegung von {point} entlang {axis} auf "
    "{percent} % bekannt",
    "no baseline was measured": "keine Basislänge wurde gemessen",
    "the scale rests on the sensors and on other lengths of the site": "der Maßstab beruht auf den Sensoren und "
    "anderen Längen des Orts",
    "the sensor does not see the motion": "der Sensor sieht die Bewegung nicht",
    "several lags agree": "mehrere Versätze passen",
    "the lag lies outside the search": "der Versatz liegt außerhalb der Suche",
    "too short together": "gemeinsam zu kurz",
    "video and sensor differ in size or sign": "Video und Sensor unterscheiden sich in Größe oder Vorzeichen",
}
"""German forms of what is said of a fusion, and of sensors as length standards."""
FUSION_THINGS: Mapping[str, str] = {
    "motion of {point} by sensor {sensor}": "Bewegung von {point} durch Sensor {sensor}",
}
"""German forms of what the adjustment calls a sensor's length."""
