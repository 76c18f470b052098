"""Step 4: the measurement, in a process of its own, with progress, log and stop."""

from nicegui import ui

from vfm_sdm.page.state import PageState
from vfm_sdm.page.steps.common import tell_errors

__all__ = ["show_measure"]

_EVERY_S = 0.5
_ENDS = {
    0: "finished: see the review",
    1: "stopped by an error, see the log",
    3: "the films did not allow a result, see the log",
}


def show_measure(page: PageState) -> None:
    """Builds the step.

    Parameters
    ----------
    page
        What the steps share.
    """
    ui.markdown(
        "Measures what `session.toml` says, in a process of its own: the browser may be closed. What is done is "
        "kept, so that a stopped run goes on where it was."
    )
    with ui.row().classes("items-center"):
        begin = ui.button("Measure", icon="play_arrow")
        stop = ui.button("Stop", icon="stop").props("outline color=negative")
        state = ui.label("")
    bar = ui.linear_progress(value=0.0, show_value=False).classes("w-full")
    log = ui.log(max_lines=500).classes("w-full h-64")
    shown = 0

    def refresh() -> None:
        nonlocal shown
        process = page.process
        begin.set_enabled(not page.measuring)
        stop.set_enabled(page.measuring)
        if process is None:
            state.set_text("results are there" if (page.project.run / "summary.json").exists() else "not measured yet")
            return
        step = process.step
        of = f" of {step.total}" if step.total else ""
        count = f" {step.done}{of}" if step.done or step.total else ""
        state.set_text(
            f"{step.what}{count}" if page.measuring else _ENDS.get(process.status or 0, "stopped; what is done is kept")
        )
        bar.set_value(step.done / step.total if step.total else (0.0 if page.measuring else 1.0))
        lines = list(process.lines)
        if len(lines) < shown:
            shown = 0
            log.clear()
        for line in lines[shown:]:
            log.push(line)
        shown = len(lines)

    async def start() -> None:
        nonlocal shown
        page.measure()
        shown = 0
        log.clear()
        refresh()

    async def halt() -> None:
        if page.process is not None:
            page.process.stop()

    begin.on_click(tell_errors(start))
    stop.on_click(tell_errors(halt))
    ui.timer(_EVERY_S, refresh)
