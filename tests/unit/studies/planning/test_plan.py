"""The plan's file: what it may say, and the sentences about what it may not."""

import pytest
import tomli_w

from planned import a_plan, fields
from vfm_sdm.errors import SessionError
from vfm_sdm.studies.planning.plan import read_plan


def without(table, key):
    return {name: value for name, value in table.items() if name != key}


MEASURED = fields()["measured"]
FAULTS = {
    "did you mean 'longitudinal_m'": {"camera": [{**without(one, "longitudinal_m"), "longitudinal": 1.0}
                                                  for one in fields()["camera"]]},
    "expected top_m above bottom_m": {"structure": {"span_m": 12.0, "bottom_m": 2.0, "top_m": 1.0}},
    "expected motion along one of": {"motion": {}},
    "camera: expected every name once, got 'left' twice": {"camera": [fields()["camera"][0]] * 2},
    "point: expected every name once, got 'wall' twice": {"point": [*fields()["point"], fields()["point"][2]]},
    "got static ones alone": {"point": [fields()["point"][2]]},
    "measured.range[1].point: expected one of the points": {
        "measured": {**MEASURED, "range": [{"point": "nowhere", "std_m": 0.01}]}
    },
    "measured.range[1].view: expected one of the cameras": {
        "measured": {**MEASURED, "range": [{"point": "wall", "view": "third", "std_m": 0.01}]}
    },
    "measured.length[1].points: expected one of the points": {
        "measured": {**MEASURED, "length": [{"points": ("wall", "nowhere"), "std_m": 0.01}]}
    },
    "got 'wall' twice; name the other end": {
        "measured": {**MEASURED, "length": [{"points": ("wall", "wall"), "std_m": 0.01}]}
    },
    "measured.reading: expected a camera beside the first": {
        "measured": {**MEASURED, "reading": [{"view": "left", "level_std_deg": 0.1}]}
    },
    "measured.reading[1].view: expected one of the cameras": {
        "measured": {**MEASURED, "reading": [{"view": "third", "level_std_deg": 0.1}]}
    },
    "duration_s: expected 2 s, a second more than still_s, got 1.5 s": {"duration_s": 1.5},
    "motion.vertical.frequency_hz: expected less than half of fps": {
        "motion": {"vertical": {"amplitude_mm": 1.0, "frequency_hz": 15.0}}
    },
    "camera: expected cameras at different places, got 'left' and 'other' at one": {
        "camera": [fields()["camera"][0], {**fields()["camera"][0], "name": "other"}]
    },
    "expected at least 2": {"camera": fields()["camera"][:1]},
}  # fmt: skip


@pytest.mark.parametrize("says", FAULTS)
def test_a_fault_is_named(says):
    with pytest.raises(SessionError) as caught:
        a_plan(**FAULTS[says])
    assert says in str(caught.value)


def test_a_plan_comes_back_from_its_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(tomli_w.dumps(fields()), encoding="utf-8")
    found = read_plan(path)
    assert found.model_dump() == a_plan().model_dump()
    assert found.folder == tmp_path


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "expected a plan, got no such file"),
        (b"name = ", "expected TOML in UTF-8"),
        (b"folder = 'a'", "folder: expected no such key"),
        (b"\xff\xfe", "expected TOML in UTF-8"),
        (b"name = 'a'\nduration_s = 0.0", "faults"),
    ],
)
def test_a_file_that_is_no_plan_is_named(tmp_path, content, says):
    path = tmp_path / "plan.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SessionError) as caught:
        read_plan(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_folder_is_no_plan(tmp_path):
    with pytest.raises(SessionError, match="expected a readable plan"):
        read_plan(tmp_path)
