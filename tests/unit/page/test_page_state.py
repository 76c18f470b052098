"""What the steps of a page share is opened once, and anew where the session's file says otherwise."""

import pytest

pytest.importorskip("tomlkit")

from drifting_plate import motion, pictures, write_film
from vfm_sdm.errors import SessionError
from vfm_sdm.page.folder import Project
from vfm_sdm.page.state import PageState


@pytest.fixture
def page(tmp_path):
    write_film(tmp_path / "left.mp4", pictures(motion(20)))
    found = PageState(Project(tmp_path))
    found.draft.set_rows("view", [{"name": "left", "video": "left.mp4"}])
    return found


def test_films_are_opened_anew_only_where_the_session_names_others(page):
    first = page.pictures()
    assert page.pictures() is first
    page.draft.put(("view", "left", "lens"), {"focal_mm": 4.2, "sensor_width_mm": 6.2})
    assert page.pictures() is first
    page.draft.put(("view", "left", "use_s"), [0.5, 1.5])
    assert page.pictures() is not first


def test_the_whole_film_and_what_is_used_of_it_are_there_by_turns(page):
    page.draft.put(("view", "left", "use_s"), [0.2])
    used, whole = page.pictures(), page.pictures(whole=True)
    assert used.recordings["left"].info.frame_count < whole.recordings["left"].info.frame_count == 20
    assert (page.pictures(), page.pictures(whole=True)) == (used, whole)
    assert whole.picture("left", 0) != used.picture("left", 0)


def test_what_the_films_show_is_asked_of_the_same_recordings(page):
    assert page.sight().sizes == {"left": (320, 240)}
    assert page.pictures().picture("left")[:2] == b"\xff\xd8"
    assert page.pictures().picture("left") is page.pictures().picture("left")


def test_a_page_begins_with_a_session_that_cannot_be_read(tmp_path, capsys):
    (tmp_path / "session.toml").write_text("no [ TOML")
    page = PageState(Project(tmp_path))
    page.begin()
    with pytest.raises(SessionError, match="expected TOML"):
        page.pictures()
    assert "Traceback" not in capsys.readouterr().err
