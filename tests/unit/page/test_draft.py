"""The session as it is filled in: what is written, what stays, and what is refused."""

import pytest

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.page.draft import Draft

TEXT = """# our bridge
name = "bridge"

[[view]]  # the camera on the bank
name = "left"
video = "left.mp4"
time_offset_s = 0.5

[[view]]
name = "right"
video = "right.mp4"

[site]
baseline = { value = 4.0, std = 0.005 }  # laser
range = [{ point = "mid", value = 9.0, std = 0.01 }]

[[site.length]]
points = ["mid", "end"]
value = 3.0
std = 0.01

[[point]]
name = "mid"
view = "left"
pixel = [10.0, 20.0]

[[point]]
name = "end"
view = "left"
pixel = [30.0, 20.0]
"""


@pytest.fixture
def draft(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text(TEXT, encoding="utf-8")
    for name in ("left.mp4", "right.mp4"):
        (tmp_path / name).touch()
    return Draft(path)


def test_a_new_session_is_begun_with_the_first_change(tmp_path):
    draft = Draft(tmp_path / "way" / "session.toml")
    assert draft.fields == {"name": "way"}
    assert not draft.path.exists()
    draft.set_rows("view", [{"name": "left", "video": "a.mp4"}])
    assert draft.fields["view"] == [{"name": "left", "video": "a.mp4"}]


def test_comments_and_what_is_not_asked_for_stay(draft):
    draft.put(("site", "perpendicular_distance"), {"value": 7.0, "std": 0.01})
    draft.set_rows("view", [{"name": "left", "video": "other.mp4"}, {"name": "right", "video": "right.mp4"}])
    text = draft.path.read_text(encoding="utf-8")
    for comment in ("# our bridge", "# the camera on the bank", "# laser"):
        assert comment in text
    assert draft.fields["view"][0] == {"name": "left", "video": "other.mp4", "time_offset_s": 0.5}


def test_fields_are_set_and_removed_by_the_names_of_their_tables(draft):
    draft.put(("view", "right", "lens"), {"camera": "phone"})
    assert draft.fields["view"][1]["lens"] == {"camera": "phone"}
    draft.put(("view", "right", "lens"), None)
    draft.put(("method", "sgr", "pixel"), None)  # of a table that is not there
    assert "lens" not in draft.fields["view"][1]
    assert "method" not in draft.fields
    with pytest.raises(SessionError, match=r"expected a table named 'third', got .*'left', 'right'"):
        draft.put(("view", "third", "lens"), {"camera": "phone"})


def test_points_are_added_under_free_names(draft):
    assert draft.add_point("left", (1.23456, 2.0)) == "point 1"
    assert draft.add_point("right", (3.0, 4.0), static=True) == "point 2"
    assert draft.fields["point"][2:] == [
        {"name": "point 1", "view": "left", "pixel": [1.235, 2.0]},
        {"name": "point 2", "view": "right", "pixel": [3.0, 4.0], "static": True},
    ]
    with pytest.raises(SessionError, match="'mid': expected a name of its own"):
        draft.add_point("left", (1.0, 2.0), name="mid")
    found, faults = draft.session()
    assert faults == []
    assert [point.name for point in found.point] == ["mid", "end", "point 1", "point 2"]


def test_a_new_name_is_followed_everywhere(draft):
    draft.change_point("mid", name="1/2 span")
    fields = draft.fields
    assert fields["site"]["range"][0]["point"] == "1/2 span"
    assert fields["site"]["length"][0]["points"] == ["1/2 span", "end"]
    with pytest.raises(SessionError, match="'end': expected a name of its own"):
        draft.change_point("1/2 span", name="end")
    with pytest.raises(SessionError, match="expected a table named 'gone'"):
        draft.change_point("gone", static=True)


def test_a_place_in_another_view_is_named_and_given_back_to_the_search(draft):
    draft.move_point("mid", "left", (11.0, 21.0))
    draft.move_point("mid", "right", (50.0, 60.0))
    assert draft.fields["point"][0] == {
        "name": "mid", "view": "left", "pixel": [11.0, 21.0], "pixel_in": {"right": [50.0, 60.0]},
    }  # fmt: skip
    draft.move_point("mid", "right", None)
    assert "pixel_in" not in draft.fields["point"][0]
    with pytest.raises(SessionError, match="expected a place in its own view"):
        draft.move_point("mid", "left", None)


def test_with_a_point_go_the_lengths_to_it(draft):
    draft.remove_point("mid")
    fields = draft.fields
    assert [point["name"] for point in fields["point"]] == ["end"]
    assert "range" not in fields["site"]
    assert "length" not in fields["site"]
    draft.remove_point("end")
    assert "point" not in draft.fields


def test_what_is_missing_is_told(draft):
    draft.put(("site", "baseline"), None)
    found, faults = draft.session()
    assert found is None
    assert len(faults) == 1
    assert faults[0].startswith("site.baseline: expected the measured distance")


def test_the_command_line_reads_what_was_written(draft):
    draft.add_point("left", (1.0, 2.0), name='with "quotes" and \\')
    assert read_session(draft.path).point[-1].name == 'with "quotes" and \\'


def test_a_file_that_is_no_toml_is_not_touched(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text("name = ", encoding="utf-8")
    with pytest.raises(SessionError, match=r"expected TOML, got: .*; correct it in an editor"):
        Draft(path).add_point("left", (1.0, 2.0))
    assert path.read_text(encoding="utf-8") == "name = "


def test_changes_are_taken_back_one_after_the_other(draft):
    begun = draft.path.read_text(encoding="utf-8")
    draft.remove_point("mid")
    with draft.at_once():
        names = [draft.add_point("left", (float(number), 1.0)) for number in range(3)]
    assert names == ["point 1", "point 2", "point 3"]
    draft.undo()
    assert [one["name"] for one in draft.fields["point"]] == ["end"]
    draft.undo()
    assert draft.path.read_text(encoding="utf-8") == begun
    with pytest.raises(SessionError, match="undo: expected a change made on this page, got none"):
        draft.undo()


def test_several_changes_are_all_made_or_none(draft):
    begun = draft.path.read_text(encoding="utf-8")

    def add_two() -> None:
        with draft.at_once():
            draft.add_point("left", (1.0, 1.0))
            draft.add_point("left", (2.0, 1.0), name="mid")

    with pytest.raises(SessionError, match="a name of its own"):
        add_two()
    assert draft.path.read_text(encoding="utf-8") == begun
    assert draft.add_point("left", (1.0, 1.0)) == "point 1"


def test_what_another_wrote_is_not_taken_back(draft):
    draft.put(("site", "perpendicular_distance"), {"value": 7.0, "std": 0.01})
    by_hand = draft.path.read_text(encoding="utf-8") + "# measured again on Monday\n"
    draft.path.write_text(by_hand, encoding="utf-8")
    with pytest.raises(SessionError, match="undo: expected the file as the page left it"):
        draft.undo()
    assert draft.path.read_text(encoding="utf-8") == by_hand


def test_points_are_written_apart_from_what_stands_before(draft):
    draft.add_point("left", (1.0, 1.0))
    draft.add_point("left", (2.0, 1.0))
    assert draft.path.read_text(encoding="utf-8").count("\n\n[[point]]") == 4
