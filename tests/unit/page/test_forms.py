"""Forms of the page, filled in without a browser: what is typed is what the session's file says."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("httpx")

from nicegui import ui
from nicegui.testing import User
from nicegui.testing.user_simulation import user_simulation

from drifting_plate import motion, pictures, write_film
from vfm_sdm.page.folder import Project
from vfm_sdm.page.server import build
from vfm_sdm.page.state import PageState

_PATIENT = {"retries": 100}


@pytest.fixture
def page(tmp_path):
    """Two films in a folder, and nothing else."""
    for name in ("a", "b"):
        write_film(tmp_path / f"{name}.mp4", pictures(motion(20)))
    return PageState(Project(tmp_path))


def visit(page: PageState, acts: Callable[[User], Awaitable[None]]) -> None:
    """Lets somebody act on the page; the house has no plugin for tests that wait."""

    async def go() -> None:
        async with user_simulation(root=lambda: build(page)) as user:
            await user.open("/")
            await acts(user)

    asyncio.run(go())


async def until(found: Callable[[], bool]) -> None:
    """Waits for what follows from a click."""
    for _ in range(200):
        if found():
            return
        await asyncio.sleep(0.05)
    assert found()


def field(user: User, label: str, kind: type = ui.number):
    """The first field of a label."""
    with user:
        return min(user.find(kind=kind, content=label).elements, key=lambda one: one.id)


def roles(user: User) -> list[ui.select]:
    """Choices of the films, from above."""
    return sorted(user.find(kind=ui.select).elements, key=lambda one: one.id)


def test_films_change_places_and_nothing_that_is_said_of_a_view_is_lost(page):
    async def acts(user: User) -> None:
        await user.should_see("a.mp4", **_PATIENT)
        first, second = roles(user)
        with user:
            first.set_value("left")
            await until(lambda: len(page.fields.get("view", ())) == 1)
            second.set_value("right")
            await until(lambda: len(page.fields["view"]) == 2)
            page.draft.put(("view", "left", "lens"), {"focal_mm": 4.0, "sensor_width_mm": 6.0})
            first.set_value("right")
            await until(lambda: page.fields["view"][0]["video"] == "b.mp4")
        assert [one.value for one in roles(user)] == ["right", "left"]

    visit(page, acts)
    left, right = page.fields["view"]
    assert (left["name"], left["video"], left["lens"]["focal_mm"]) == ("left", "b.mp4", 4.0)
    assert (right["name"], right["video"]) == ("right", "a.mp4")


def test_an_interval_is_kept_while_it_is_typed_unless_it_holds_nothing(page):
    page.draft.set_rows("view", [{"name": "left", "video": "a.mp4"}, {"name": "right", "video": "b.mp4"}])

    async def acts(user: User) -> None:
        await user.should_see("use from [s]", **_PATIENT)
        with user:
            field(user, "use from [s]").set_value(0.2)
            await until(lambda: page.fields["view"][0].get("use_s") == [0.2])
            field(user, "to [s]").set_value(0.1)
            await user.should_see("not kept: expected an end after the begin", **_PATIENT)
            assert page.fields["view"][0]["use_s"] == [0.2]
            field(user, "to [s]").set_value(99.0)
            await user.should_see("the film ends at", **_PATIENT)
            field(user, "begins later than the reference").set_value(0.0)
            await until(lambda: page.fields["view"][1].get("time_offset_s") == 0.0)
            field(user, "use from [s]").set_value(None)
            field(user, "to [s]").set_value(None)
            await until(lambda: "use_s" not in page.fields["view"][0])

    visit(page, acts)


def test_a_time_of_rest_is_kept_unless_it_holds_nothing_and_taken_back(page):
    page.draft.set_rows("view", [{"name": "left", "video": "a.mp4"}, {"name": "right", "video": "b.mp4"}])
    page.draft.put(("method", "refinement"), "sgr")

    def still():
        return page.fields["method"].get("still_interval_s")

    async def acts(user: User) -> None:
        await user.should_see("structure at rest from [s]", **_PATIENT)
        begin, end = field(user, "structure at rest from [s]"), field(user, "at rest to [s]")
        with user:
            begin.set_value(0.1)
            await user.should_see("not kept: expected a begin, and an end after it", **_PATIENT)
            assert still() is None
            end.set_value(0.4)
            await until(lambda: still() == [0.1, 0.4])
            end.set_value(0.05)
            await user.should_see("not kept: expected a begin, and an end after it", **_PATIENT)
            assert still() == [0.1, 0.4]
            begin.set_value(None)
            await until(lambda: still() == [0.0, 0.05])
            end.set_value(None)
            await until(lambda: still() is None)

    visit(page, acts)
    assert page.fields["method"]["refinement"] == "sgr"


def test_steps_before_there_are_films_say_what_is_missing(page):
    async def acts(user: User) -> None:
        for step in ("Site", "Measure"):
            user.find(kind=ui.tabs).elements.pop().set_value(step)
            if step == "Measure":
                await user.should_see("not measured yet", **_PATIENT)
                user.find(kind=ui.button, content="Measure").click()
            await user.should_see("films: expected two, got none; choose them in step 1", **_PATIENT)

    visit(page, acts)
    assert not page.draft.path.exists()


def test_a_site_is_typed_and_taken_back(page):
    page.draft.set_rows("view", [{"name": "left", "video": "a.mp4"}, {"name": "right", "video": "b.mp4"}])

    async def acts(user: User) -> None:
        with user:
            user.find(kind=ui.tabs).elements.pop().set_value("Site")
            await user.should_see("Baseline", **_PATIENT)
            field(user, "Baseline").set_value(4.0)
            await until(lambda: "site" in page.fields)
            assert page.fields["site"]["baseline"] == {"value": 4.0, "std": 0.005}
            field(user, "Reference camera to the face").set_value(8.0)
            field(user, "From the foot").set_value(6.0)
            await until(lambda: "longitudinal_distance" in page.fields["site"])
            user.find(kind=ui.button, content="Undo").click()
            await until(lambda: "longitudinal_distance" not in page.fields["site"])
            await until(lambda: field(user, "From the foot").value is None)
            assert field(user, "Reference camera to the face").value == 8.0

    visit(page, acts)
