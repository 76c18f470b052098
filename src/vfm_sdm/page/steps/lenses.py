"""What is known of a view's focal length, in the ways in which people know it."""

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from vfm_sdm.errors import SessionError
from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import in_thread, tell_errors, value_at

__all__ = ["LensForm"]

_WAYS = {
    "unknown": "not known (or EXIF)",
    "camera": "camera's name",
    "sensor": "focal length and sensor width",
    "equivalent": "35 mm equivalent",
    "view": "horizontal field of view",
}
_FILM_MM = 36.0, 24.0
_VIEW_STD = 0.05
"""Relative standard deviation of equivalents and fields of view as they are stated: of some setting, rounded."""


class LensForm:
    """Fields of one view's lens.

    Parameters
    ----------
    page
        What the steps share.
    view
        The view's table in the session.
    changed
        Called after a change.
    """

    def __init__(self, page: PageState, view: dict[str, Any], changed: Callable[[], Awaitable[None]]) -> None:
        self._page, self._name, self._changed = page, str(view["name"]), changed
        self._found: dict[str, Any] = dict(view.get("lens") or {})
        self._way = "camera" if "camera" in self._found else "sensor" if "focal_mm" in self._found else "unknown"

    def build(self) -> None:
        """Shows the fields of the way that is chosen."""
        if {"file", "focal_px"} & self._found.keys():
            ui.label(f"{self._name}: as session.toml states it ({', '.join(self._found)})")
            return
        self._row = ui.row().classes("items-end no-wrap w-full")
        self._show()

    def _show(self) -> None:
        self._row.clear()
        with self._row:
            ui.label(self._name).classes("text-bold w-16")
            chosen = ui.select(_WAYS, value=self._way).props("dense").classes("w-56")
            chosen.props["aria-label"] = f"lens of {self._name}"
            chosen.on_value_change(tell_errors(self._change))
            fields = self._fields()
            for one in fields.values():
                one.on("blur", tell_errors(partial(self._keep, fields)))

    def _fields(self) -> dict[str, Any]:
        """Fields of the way, by what they state."""
        found = self._found
        if self._way == "camera":
            model = ui.input("such as GoPro HERO11 Black, or phone", value=found.get("camera", "")).props("dense")
            mode = ui.input("mode, such as Linear", value=found.get("mode", "")).props("dense").classes("w-32")
            return {"camera": model, "mode": mode}
        if self._way == "sensor":
            focal = ui.number("focal length [mm]", value=found.get("focal_mm"), min=0).props("dense")
            sensor = ui.number("sensor width [mm]", value=found.get("sensor_width_mm"), min=0).props("dense")
            std = ui.number("std [%]", value=100 * found.get("relative_std", 0.02), min=0.01).props("dense")
            return {"focal_mm": focal, "sensor_width_mm": sensor, "std": std}
        if self._way == "equivalent":
            return {"focal_mm": ui.number("35 mm equivalent [mm]", min=0).props("dense")}
        if self._way == "view":
            return {"degrees": ui.number("horizontal field of view [deg]", min=1, max=179).props("dense")}
        return {}

    async def _change(self, event: Any) -> None:
        self._way = str(event.value)
        self._show()
        if self._way == "unknown":
            await self._write(None)

    async def _keep(self, fields: dict[str, Any]) -> None:
        given = {key: one.value for key, one in fields.items() if one.value not in (None, "")}
        if self._way == "camera" and given.get("camera"):
            await self._write(given)
        elif self._way == "sensor" and {"focal_mm", "sensor_width_mm"} <= given.keys():
            std = float(given.pop("std", 2.0)) / 100
            await self._write({**given, "relative_std": round(std, 6)})
        elif self._way == "equivalent" and given:
            # The same diagonal angle of view, on the part of the sensor that has the picture's shape.
            width, height = (await in_thread(self._page.sight)).sizes[self._name]
            sensor_mm = np.hypot(*_FILM_MM) * max(width, height) / np.hypot(width, height)
            await self._write({**given, "sensor_width_mm": round(float(sensor_mm), 3), "relative_std": _VIEW_STD})
        elif self._way == "view" and given:
            focal_mm = _FILM_MM[0] / (2 * np.tan(np.radians(given["degrees"]) / 2))
            stated = {"focal_mm": round(float(focal_mm), 3), "sensor_width_mm": _FILM_MM[0]}
            await self._write({**stated, "relative_std": _VIEW_STD})

    async def _write(self, lens: dict[str, Any] | None) -> None:
        """Keeps a lens; the one before where the session refuses it."""
        path = ("view", self._name, "lens")
        before = value_at(self._page.fields, path)
        self._page.draft.put(path, lens)
        faults = [fault for fault in self._page.draft.session()[1] if ".lens" in fault]
        if faults:
            self._page.draft.put(path, before)
            raise SessionError("; ".join(faults))
        await self._changed()
