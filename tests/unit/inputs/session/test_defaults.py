"""Defaults of many sessions: how they merge, what is refused, and what keys see of them."""

import pytest

from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_defaults, read_session, session_hash, write_session

SESSION = """
name = "bridge"
[[view]]
name = "left"
video = "left.mp4"
[[view]]
name = "right"
video = "right.mp4"
lens = { focal_px = 900.0 }
[site]
baseline = { value = 3.5, std = 0.01 }
[[point]]
name = "mid"
view = "left"
pixel = [10.0, 20.0]
[method.sgr]
pixel = 0.1
"""
DEFAULTS = """
[[view]]
name = "right"
lens = { focal_mm = 24.0, sensor_width_mm = 6.0 }
level = { std_deg = 0.3 }
[[view]]
name = "left"
lens = { focal_px = 800.0, relative_std = 0.01 }
[[view]]
name = "middle"
lens = { focal_px = 700.0 }
[site]
baseline = { value = 4.0, std = 0.02 }
perpendicular_distance = { value = 9.0, std = 0.02 }
longitudinal_distance = { value = 1.0, std = 0.02 }
structure_side = "right"
[site.lines]
out_of_plumb_std_deg = 0.5
[[point]]
name = "mid"
view = "left"
pixel = [1.0, 1.0]
static = true
[method]
refinement = "sgr"
[method.sgr]
pixel = 0.2
others = 3.0
"""


@pytest.fixture
def files(tmp_path):
    """Writes session and defaults; returns the session that they make."""

    def make(session=SESSION, defaults=DEFAULTS):
        (tmp_path / "session.toml").write_text(session)
        (tmp_path / "defaults.toml").write_text(defaults)
        given = read_defaults(tmp_path / "defaults.toml")
        return read_session(tmp_path / "session.toml", check_files=False, defaults=given)

    return make


def test_tables_merge_by_key_and_named_lists_by_name(files):
    session = files()
    left, right = session.view  # those of the session, in its order; nobody asked for the middle one
    assert (left.name, left.lens.focal_px, left.lens.relative_std) == ("left", 800.0, 0.01)
    assert (right.lens.focal_px, right.lens.focal_mm) == (900.0, None)  # a table in braces is taken as a whole
    assert right.level.std_deg == 0.3
    assert (session.site.baseline.value, session.site.baseline.std) == (3.5, 0.01)
    assert (session.site.perpendicular_distance.value, session.site.structure_side) == (9.0, "right")
    assert session.site.lines.out_of_plumb_std_deg == 0.5
    assert (session.point[0].pixel, session.point[0].static) == ((10.0, 20.0), True)
    assert (session.method.refinement, session.method.sgr.pixel, session.method.sgr.others) == ("sgr", 0.1, 3.0)


def test_inner_tables_of_site_and_method_merge_too(files):
    further = (
        "[site.lines]\nout_of_square_std_deg = 0.1\n[method]\nscale_limit = 0.1\n[method.sgr]\nothers_rate = 1.0\n"
    )
    session = files(SESSION.replace("[method.sgr]\npixel = 0.1\n", further))
    assert (session.site.lines.out_of_plumb_std_deg, session.site.lines.out_of_square_std_deg) == (0.5, 0.1)
    assert (session.method.refinement, session.method.scale_limit) == ("sgr", 0.1)
    assert (session.method.sgr.pixel, session.method.sgr.others, session.method.sgr.others_rate) == (0.2, 3.0, 1.0)


def test_a_list_of_which_the_session_says_nothing_is_taken_whole(files):
    without = SESSION[: SESSION.index("[[point]]")]
    assert [point.name for point in files(without).point] == ["mid"]
    with pytest.raises(SessionError, match="point: expected at least 1, got 0"):
        files(without, defaults="")


def test_the_merged_session_is_what_is_written_and_hashed(files, tmp_path):
    merged, alone = files(), files(defaults="")
    assert session_hash(merged) != session_hash(alone)
    written = read_session(write_session(tmp_path / "run" / "session.resolved.toml", merged), check_files=False)
    assert written.site == merged.site
    assert written.method == merged.method
    assert session_hash(files()) == session_hash(merged)


REFUSED = {
    "unknown key": ("weather = 1", "weather: expected one of the keys name, view, "),
    "unknown key of a table": ("[site]\nbase = 1", "site.base: expected one of the keys baseline, .*did you mean"),
    "unknown key of an entry": ('[[view]]\nname = "l"\nlense = 1', r"view\[l\].lense: .*did you mean 'lens'"),
    "unknown part": ("[method.icgm]\na = 1", "method.icgm: expected one of the keys"),
    "wrong type": ("[method]\ninjection = 3", "method.injection: expected a valid boolean"),
    "no name": ('[[view]]\nvideo = "l.mp4"', r"view\[1\].name: expected a value, got nothing"),
    "one name twice": ('[[point]]\nname = "a"\n[[point]]\nname = "a"', r"point\[a\].name: expected a name of its own"),
    "folder": ('folder = "x"', "folder: expected no such key"),
    "no TOML": ("[site", "defaults.toml: expected TOML, got"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_the_file_named(case, tmp_path):
    content, message = REFUSED[case]
    (tmp_path / "defaults.toml").write_text(content)
    with pytest.raises(SessionError, match=message) as caught:
        read_defaults(tmp_path / "defaults.toml")
    assert "defaults.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_absent_defaults(tmp_path):
    with pytest.raises(SessionError, match="expected a file of defaults, got no such file"):
        read_defaults(tmp_path / "defaults.toml")


def test_faults_of_the_whole_name_both_files(files):
    with pytest.raises(SessionError, match=r"session.toml over .*defaults.toml: view\[left\]: .*images, got both"):
        files(defaults='[[view]]\nname = "left"\nimages = "*.png"\nfps = 30.0')
    # Wrong types in a session are its own faults, whatever the defaults hold.
    with pytest.raises(SessionError, match=r"view: expected a list"):
        files('name = "x"\nview = 3')
    with pytest.raises(SessionError, match=r"site: expected one table"):
        files('name = "x"\nsite = [1]\n[[view]]\nname = "left"\nvideo = "a"')
