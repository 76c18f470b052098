"""The table that a report reads and a measurement does not."""

from datetime import date

import pytest

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import Report, Session, read_session, session_hash, write_session

FIELDS = {"name": "bridge", "view": [{"name": "left", "video": "left.mp4"}]}
SAID = {"client": "city", "date": "2026-11-20", "remarks": "closed\nto traffic"}


def test_it_goes_to_the_file_and_back(tmp_path):
    session = Session(**FIELDS, report=SAID, folder=tmp_path)
    assert session.report.date == date(2026, 11, 20)
    path = write_session(tmp_path / "session.toml", session)
    assert read_session(path, check_files=False, points_needed=False).report == session.report


@pytest.mark.parametrize("written", ["2026-11-20", '"2026-11-20"', "2026-11-20T10:15:30Z"])
def test_dates_may_be_dates_of_toml(tmp_path, written):
    path = tmp_path / "session.toml"
    path.write_text(f'name = "b"\n[[view]]\nname = "left"\nvideo = "l.mp4"\n[report]\ndate = {written}\n')
    assert read_session(path, check_files=False, points_needed=False).report.date == date(2026, 11, 20)


def test_hash_and_fields_of_a_session_are_those_without_it():
    plain, said = Session(**FIELDS), Session(**FIELDS, report=SAID)
    assert session_hash(said) == session_hash(plain)
    assert "report" not in plain.as_fields()
    assert said.as_fields()["report"]["client"] == "city"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"date": 20261120}, "report.date: expected a date such as 2026-11-20, got 20261120; correct it"),
        ({"date": "yesterday"}, "report.date"),
        ({"client": ""}, "report.client"),
        ({"client": "two\nlines"}, "report.client"),
        ({"client": "city \u202e"}, "report.client: expected letters that can be seen, without control characters and"),
        ({"remarks": "\x07"}, "report.remarks"),
        ({"remarks": "one\n\u2066two"}, "report.remarks"),
        ({"remarks": "\n \t"}, "report.remarks"),
        ({"customer": "city"}, "report.customer"),
    ],
)
def test_what_cannot_be_is_refused(table, message):
    with pytest.raises(SessionError) as caught:
        Session(**FIELDS, report=table)
    assert message in str(caught.value)


def test_remarks_may_have_lines_and_stops():
    said = "bays\t3\n\nעברית 🌉"
    assert Report(remarks=said).remarks == said


def test_nothing_need_be_said():
    assert Report() == Report(client=None)
    assert Session(**FIELDS, report={}).report == Report()
