"""The command ``points suggest``: table, session file and picture; nothing is written without a result."""

import cv2
import numpy as np
import pytest

from vfm_sdm.commands import points as command_module
from vfm_sdm.errors import CameraError, DatasetError
from vfm_sdm.inputs.session import FirstFrames, Point, Session, open_views, read_session, write_session
from vfm_sdm.studies.planning.suggested_picture import draw_suggestion
from vfm_sdm.studies.planning.suggestion import SuggestedPoint, Suggestion


@pytest.fixture
def session(tmp_path):
    """A session without points, of two views of two pictures."""
    for view in ("left", "right"):
        (tmp_path / view).mkdir()
        for number in range(2):
            assert cv2.imwrite(str(tmp_path / view / f"{number}.png"), np.full((120, 200), 90, np.uint8))
    made = Session(
        name="bridge",
        view=[{"name": view, "images": f"{view}/*.png", "fps": 30.0} for view in ("left", "right")],
        site={"baseline": {"value": 3.6, "std": 0.01}},
        folder=tmp_path,
    )
    write_session(tmp_path / "session.toml", made)
    return made


def suggestion(session):
    def point(name, *, static, u):
        return SuggestedPoint(
            name=name,
            static=static,
            pixels=np.array([[u, 60.0], [np.nan, np.nan] if static else [u + 20, 61.0]]),
            along_m=5.1234,
            behind_m=0.0,
            std_mm=np.array([0.0111, 0.0222, 0.0333]),
            expanded_mm=np.array([0.1, 0.2, np.nan]),
            subset_px=41,
            moved_px=0.5,
            why="because",
        )

    points = point("span 1", static=False, u=50.0), point("still 1", static=True, u=150.0)
    named = tuple(Point(name=p.name, view="left", pixel=(p.pixels[0, 0], 60.0), static=p.static) for p in points)
    frames = FirstFrames(open_views(session))
    return Suggestion(session.model_copy(update={"point": named}), points, frames, ("take note",))


def test_table_session_and_picture(session, tmp_path, command, monkeypatch, capsys):
    asked = {}

    def suggest(given, **settings):
        asked.update(settings, points=given.point)
        return suggestion(session)

    monkeypatch.setattr(command_module, "suggest_points", suggest)
    target = tmp_path / "new" / "with points.toml"
    target.parent.mkdir()
    words = ("points", "suggest", tmp_path / "session.toml", "-o", target, "--count", 4, "--static", 1)
    status, out, _ = command(*words)
    assert status == 0
    assert (asked["count"], asked["static"], asked["points"]) == (4, 1, ())
    for word in ("span 1", "still 1", "5.12", "0.011 0.022 0.033", "0.100 0.200 -", "41", "because", "note: take note"):
        assert word in out, word
    written = read_session(target)
    assert [(p.name, p.pixel, p.static) for p in written.point] == [
        ("span 1", (50.0, 60.0), False),
        ("still 1", (150.0, 60.0), True),
    ]
    assert sorted(open_views(written)) == ["left", "right"]  # paths lead to the same files
    picture = cv2.imread(str(target.with_suffix(".png")))
    assert picture is not None
    assert picture.shape[0] > 1000


@pytest.mark.parametrize("error", [CameraError("expected cameras"), DatasetError("expected places")])
def test_no_result_writes_nothing(session, tmp_path, command, monkeypatch, error):
    def suggest(*_, **__):
        raise error

    monkeypatch.setattr(command_module, "suggest_points", suggest)
    status, _, _ = command("points", "suggest", tmp_path / "session.toml", "-o", tmp_path / "new.toml")
    assert status == 3
    assert not (tmp_path / "new.toml").exists()
    assert not (tmp_path / "new.png").exists()


def test_other_commands_say_how_to_find_points(session, tmp_path, command):
    status, _, err = command("measure", tmp_path / "session.toml", "-o", tmp_path / "run")
    assert status == 1
    assert "point: expected at least 1, got 0" in err
    assert "vfm-sdm points suggest" in err
    assert not (tmp_path / "run").exists()


def test_the_picture_shows_each_subset_at_its_size(session):
    figure = draw_suggestion(suggestion(session))
    left, right = figure.axes
    assert [patch.get_width() for patch in left.patches] == [41, 41]
    assert [patch.get_x() for patch in left.patches] == [50 - 20.5, 150 - 20.5]
    assert len(right.patches) == 1
    assert "not found here: still 1" in right.get_xlabel()


def test_the_session_itself_is_not_written_over(session, tmp_path, command):
    path = tmp_path / "session.toml"
    before = path.read_bytes()
    code, _, said = command("points", "suggest", path, "-o", path)
    assert code == 1
    assert "expected another file than the session" in said
    assert path.read_bytes() == before
