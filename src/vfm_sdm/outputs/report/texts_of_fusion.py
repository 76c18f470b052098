"""Texts of a report's section on the fusion with an accelerometer."""

from collections.abc import Mapping

__all__ = ["FUSION_TEXTS"]

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
