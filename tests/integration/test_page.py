"""The browser page as a person uses it: five steps on a small virtual field test, in a real browser."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import measure
from vfm_sdm.page.draft import Draft
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite

nicegui = pytest.importorskip("nicegui")
playwright = pytest.importorskip("playwright.sync_api")

CHROMIUM = shutil.which("chromium")
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium")
SIZE = 640, 360


@pytest.fixture(scope="module")
def field_test(tmp_path_factory):
    """Session of a field test of four seconds, small."""
    site = FootbridgeSite(image_size=SIZE)
    plan = demo_plan(duration_s=4.0, site=site)
    return make_field_test(tmp_path_factory.mktemp("field"), replace(plan, points=plan.points[:4]))


@pytest.fixture
def folder(field_test, tmp_path):
    """A folder with nothing but the films."""
    for film in field_test.parent.glob("*.mp4"):
        shutil.copy(film, tmp_path)
    return tmp_path


def _environment() -> dict[str, str]:
    """That of a user: NiceGUI serves nothing where it believes to be tested."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "NICEGUI"))}


class Page:
    """A page in a process of its own."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        command = [sys.executable, "-u", "-m", "vfm_sdm", "page", str(folder), "--no-browser", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", env=_environment(),
        )  # fmt: skip
        self.said = ""
        while "Ctrl-C" not in self.said:
            line = self.process.stdout.readline()
            if not line:
                break
            self.said += line
        found = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=\S+", self.said)
        self.url, self.port = (found[0], int(found[1])) if found else ("", 0)

    def stop(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(20)

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def _status(url: str) -> int:
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def test_nobody_else_is_let_in(folder):
    with Page(folder) as page:
        bare = f"http://127.0.0.1:{page.port}"
        for path in ("/", "/static/page.js", "/picture/left/0", "/?token=x", "/report", "/_nicegui_ws/socket.io/"):
            assert _status(bare + path) == 403
        assert _status(page.url) == 200
        token = page.url.rpartition("token=")[2]
        for path in ("../../etc/passwd", "..%2f..%2fetc%2fpasswd", "%2e%2e/page/server.py"):
            assert _status(f"{bare}/static/{path}?token={token}") in {404, 400}
        with socket.socket() as probe:  # this machine alone
            probe.settimeout(2)
            own = socket.gethostbyname(socket.gethostname())
            assert own.startswith("127.") or probe.connect_ex((own, page.port)) != 0
        second = subprocess.run(
            [sys.executable, "-m", "vfm_sdm", "page", str(folder), "--no-browser"],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert second.returncode == 1
        assert "another page" in second.stderr or "a folder without a page" in " ".join(second.stderr.split())
        assert page.stop() == 0
    assert not list(folder.glob(".page*"))


def test_films_outside_the_folder_are_refused(folder, tmp_path_factory, field_test):
    text = (
        f'name = "x"\n[[view]]\nname = "left"\nvideo = "{field_test.parent.as_posix()}/left.mp4"\n'
        '[[view]]\nname = "right"\nvideo = "../left.mp4"\n'
    )
    (folder / "session.toml").write_text(text, encoding="utf-8")
    with Page(folder) as page:
        assert _status(page.url.replace("/?", "/picture/left/0?")) == 404


class Person:
    """Somebody at the browser."""

    def __init__(self, page, shots: Path) -> None:
        self.page, self.shots = page, shots

    def open(self, step: str) -> None:
        self.page.get_by_role("tab", name=step).click()

    def keep(self, name: str) -> None:
        self.page.screenshot(path=self.shots / f"{name}.png", full_page=True)

    def choose(self, label: str, value: str) -> None:
        self.page.get_by_label(label).click()
        self.page.locator(".q-menu").get_by_text(value, exact=True).click()
        # What is still closing would be taken for the next one.
        _until(lambda: self.page.locator(".q-menu").count() == 0, "the choice to close", 10.0)

    def type(self, label: str, value: object) -> None:
        field = self.page.get_by_label(re.compile(re.escape(label))).first
        field.fill(str(value))
        field.press("Tab")

    def place(self, view: int, pixel: tuple[float, float]) -> tuple[float, float]:
        """Where a pixel of a view is on the screen."""
        box = self.page.locator(".vs-frame").nth(view).locator("img").bounding_box()
        return tuple(
            box[corner] + (one + 0.5) / size * box[side]
            for one, size, corner, side in zip(pixel, SIZE, ("x", "y"), ("width", "height"), strict=True)
        )


def _until(found, what: str, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not found():
        assert time.monotonic() < end, f"waited for {what}"
        time.sleep(0.1)


@needs_browser
def test_pictures_are_those_of_the_session_and_hear_one_click(folder):
    """However often a step was opened; what is below the cursor stays there while the picture grows."""
    session = folder / "session.toml"
    draft = Draft(session)
    draft.set_rows("view", [{"name": "left", "video": "left.mp4"}, {"name": "right", "video": "right.mp4"}])
    shown = "[...document.querySelectorAll('.vs-frame img')].every((one) => one.naturalWidth)"
    with Page(folder) as served, playwright.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        person = Person(page, folder)
        page.goto(served.url)
        first = page.locator("img").first
        first.wait_for()
        before = first.get_attribute("src")
        draft.set_rows("view", [{"name": "left", "video": "right.mp4"}, {"name": "right", "video": "left.mp4"}])
        for step, sign in (("2 Points", ".vs-frame"), ("1 Films", ".q-slider")) * 2:
            person.open(step)
            page.locator(sign).nth(1).wait_for()
        assert page.locator("img").first.get_attribute("src") != before
        person.open("2 Points")
        page.locator(".vs-frame").nth(1).locator("img").wait_for()
        page.wait_for_function(shown)

        low = (0.8 * SIZE[0], 0.9 * SIZE[1])
        page.mouse.move(*person.place(0, low))
        for _ in range(4):
            there = person.place(0, low)
            page.mouse.wheel(0, -240)
            page.wait_for_timeout(200)
            assert np.allclose(person.place(0, low), there, atol=3)

        page.mouse.click(*person.place(0, low))
        page.get_by_label("name of point 1", exact=True).wait_for()
        page.wait_for_timeout(1000)
        assert len(draft.fields["point"]) == 1
        page.get_by_role("button", name="Undo").click()
        page.get_by_text("No point yet.").wait_for()
        browser.close()
    assert "point" not in draft.fields


@needs_browser
@pytest.mark.slow
def test_from_films_to_a_report_by_hand(folder, field_test, tmp_path_factory):
    """Clicks, drags, types, measures and reads; the session's file gives the same displacement without the page."""
    known = read_session(field_test)
    shots = tmp_path_factory.mktemp("shots")
    session = folder / "session.toml"
    with Page(folder) as served, playwright.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        asked: list[str] = []
        errors: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: errors.append(str(error)))
        person = Person(page, shots)
        page.goto(served.url)
        for view in ("left", "right"):
            person.choose(f"view of {view}.mp4", view)
            _until(lambda view=view: session.exists() and view in session.read_text(encoding="utf-8"), view)
        page.get_by_text("frame 0").nth(1).wait_for()
        person.keep("1-films")

        for step in ("2 Points", "1 Films", "2 Points"):
            person.open(step)
        page.locator(".vs-frame").nth(1).locator("img").wait_for()
        page.wait_for_function("[...document.querySelectorAll('.vs-frame img')].every((one) => one.naturalWidth)")
        for point in known.point:
            page.mouse.click(*person.place(0, point.pixel))
            field = page.get_by_label("name of point 1", exact=True)
            field.wait_for()
            field.fill(point.name)
            field.press("Enter")
            page.get_by_label(f"name of {point.name}", exact=True).wait_for()
        found = page.get_by_text(re.compile(r"right \(\d+\.\d, \d+\.\d\): ok"))
        _until(lambda: found.count() == len(known.point), "counterparts")
        # One is dragged away and back: where it is let go it stays.
        there = person.place(0, known.point[0].pixel)
        away = there[0] + 30, there[1] + 10
        for begin, end in ((there, away), (away, there)):
            page.mouse.move(*begin)
            page.mouse.down()
            page.mouse.move(*end, steps=5)
            page.mouse.up()
            page.wait_for_timeout(1500)
        for number, point in enumerate(known.point):
            if point.static:
                page.get_by_role("checkbox", name="static").nth(number).click()
        person.keep("2-points")

        person.open("3 Site")
        for label, length in (
            ("Baseline", known.site.baseline),
            ("Reference camera to the face", known.site.perpendicular_distance),
            ("From the foot", known.site.longitudinal_distance),
        ):
            person.type(label, length.value)
        for number, view in enumerate(known.view, start=1):
            person.choose(f"lens of {view.name}", "focal length and sensor width")
            _until(lambda number=number: page.get_by_label("focal length [mm]").count() == number, "fields of a lens")
            for label, value in (
                ("focal length [mm]", view.lens.focal_mm),
                ("sensor width [mm]", view.lens.sensor_width_mm),
            ):
                field = page.get_by_label(label).last
                field.fill(str(value))
                field.press("Tab")
            page.wait_for_timeout(500)
        [ranged] = known.site.range
        person.choose("length to", ranged.point)
        person.type("length [m]", ranged.value)
        person.type("std of the length", 1e3 * ranged.std)
        page.get_by_role("button", name="Add", exact=True).click()
        page.get_by_text(f"camera left to {ranged.point}: {ranged.value:g} m").wait_for()
        page.get_by_text("Readings at camera right").click()
        person.choose("side of right", "right")
        page.get_by_text("Rectangles and straight edges").click()
        for corner, point in zip(("top left", "top right", "bottom right", "bottom left"), known.point, strict=False):
            person.choose(f"{corner} corner", point.name)
        page.get_by_role("button", name="Add rectangle").click()
        page.get_by_text(re.compile("^rectangle ")).wait_for()
        page.get_by_role("button", name="remove rectangle 1").click()  # which these points are none of
        _until(lambda: "rectangle" not in session.read_text(encoding="utf-8"), "the rectangle to go")
        page.get_by_text("Place cameras and points").click()
        page.get_by_text("plan (from above)").wait_for(timeout=60000)
        person.keep("3-site")

        person.open("4 Measure")
        page.get_by_role("button", name="Measure").click()
        page.get_by_text("finished: see the review").wait_for(timeout=240000)
        person.keep("4-measure")

        person.open("5 Review")
        page.get_by_text(re.compile("fit to use|use with care|do not use")).first.wait_for(timeout=30000)
        chart = page.locator(".nicegui-echart").first
        chart.locator("canvas").wait_for()
        chart.scroll_into_view_if_needed()
        box = chart.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.wheel(0, -400)
        zoomed = "(one) => getElement(Number(one.id.slice(1))).chart.getOption().dataZoom[0]"
        page.wait_for_timeout(1500)
        window = chart.evaluate(zoomed)
        assert 0 < window["startValue"] < window["endValue"] < 4.0, window
        page.get_by_role("button", name="Write report").click()
        with page.expect_popup() as opened:
            page.get_by_text("open the report").click()
        opened.value.get_by_text("1/2 span").first.wait_for()
        person.keep("5-review")
        # What was changed since is said, so that no old number passes for a new one.
        assert page.get_by_text("was changed since this was measured").count() == 0
        Draft(session).put(("site", "baseline"), {"value": 5.0, "std": 0.005})
        page.get_by_role("button", name="Read again").click()
        page.get_by_text("was changed since this was measured").wait_for()
        Draft(session).put(("site", "baseline"), {"value": known.site.baseline.value, "std": 0.005})
        browser.close()
        assert served.stop() == 0
    assert not errors
    assert asked
    assert all(re.match(r"(http|ws)://127\.0\.0\.1:|data:|blob:", url) for url in asked)
    assert "1/2 span" in (folder / "run" / "report.html").read_text(encoding="utf-8")
    assert len(list(shots.glob("*.png"))) == 5

    written = read_session(session)
    assert written.site.range == known.site.range
    assert written.view[1].stands == "right"
    assert [point.name for point in written.point] == [point.name for point in known.point]
    for one, other in zip(written.point, known.point, strict=True):
        assert one.static == other.static
        # The screen shows a pixel as half of one or more.
        assert np.abs(np.subtract(one.pixel, other.pixel)).max() <= 1.5
    again = measure(written).displacement
    kept = read_displacement(folder / "run")
    assert np.array_equal(again["displacement"].values, kept["displacement"].values, equal_nan=True)
    truth = read_displacement(field_test.parent / "truth.nc").sel(point=kept["point"], time=kept["time"], method=None)
    error = kept["displacement"].sel(axis="vertical").values - truth["displacement"].sel(axis="vertical").values
    assert np.sqrt(np.nanmean(error**2)) < 0.2 * np.nanstd(truth["displacement"].sel(axis="vertical").values)
