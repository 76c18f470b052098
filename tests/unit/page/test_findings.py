"""What is known of the points, and how it is drawn."""

import re

from vfm_sdm.outputs.results import Worth
from vfm_sdm.page.findings import LIGHTS, Findings
from vfm_sdm.page.sight import Counterpart, Subset

POINT = {"name": "1/2 span", "view": "left", "pixel": [100.0, 50.0]}


def _known():
    findings = Findings()
    findings.add_subset("left", (100.0, 50.0), Subset(41, (0.004, 0.006), "0.004 to 0.006 px", Worth.GOOD))
    line = [(0.0, 40.0), (200.0, 48.0)]
    findings.add_counterparts(POINT, {"right": Counterpart((80.0, 44.0), "ok", line)})
    return findings


def test_a_square_is_drawn_at_its_size_in_the_colour_of_its_worth():
    drawn = _known().draw([POINT], "left", size=(200, 100), chosen="")
    assert 'viewBox="-0.5 -0.5 200 100"' in drawn
    rectangle = re.search(r'<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)"', drawn)
    assert [float(one) for one in rectangle.groups()] == [79.5, 29.5, 41.0]
    assert LIGHTS[Worth.GOOD] in drawn


def test_the_line_is_that_of_the_chosen_point():
    findings = _known()
    assert "polyline" in findings.draw([POINT], "right", size=(200, 100), chosen="1/2 span")
    assert "polyline" not in findings.draw([POINT], "right", size=(200, 100), chosen="other")


def test_a_place_named_by_hand_stands_for_what_was_found():
    by_hand = {**POINT, "pixel_in": {"right": [70.0, 43.0]}}
    assert _known().places([by_hand], "right") == {"1/2 span": (70.0, 43.0)}
    assert _known().counterparts(by_hand) == {}  # to be looked for anew


def test_a_new_name_keeps_what_is_known():
    renamed = {**POINT, "name": "mid"}
    assert _known().describe(renamed) == "left (100.0, 50.0): 0.004 to 0.006 px · right (80.0, 44.0): ok"
    assert _known().light([renamed], "left", "mid") == (LIGHTS[Worth.GOOD], "left: 0.004 to 0.006 px")
    assert "not looked at yet" in _known().light([renamed], "right", "mid")[1]


def test_what_was_not_found_says_what_to_do():
    findings = Findings()
    findings.add_counterparts(POINT, {"right": Counterpart(None, "several places look alike")})
    assert "several places look alike; choose it, then" in findings.describe(POINT)


def test_names_stay_text():
    evil = {**POINT, "name": '"><script>alert(1)</script>'}
    assert "<script" not in _known().draw([evil], "left", size=(200, 100), chosen="")
