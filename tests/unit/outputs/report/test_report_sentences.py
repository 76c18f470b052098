"""Sentences of the program in German reports: each has a form, and what has none stays English and whole."""

import ast
import re
from pathlib import Path
from string import Formatter

import pytest

from faults import FAULTS
from measurements import measured
from run_folders import write_run
from vfm_sdm.core.statuses import CameraStatus, ClockStatus, PointStatus, RecordingStatus, RefinementStatus
from vfm_sdm.outputs.report import build_content, find_language, open_run
from vfm_sdm.outputs.report.sentences import Forms
from vfm_sdm.outputs.report.texts_of_checks import CHECK_FORMS, THING_FORMS
from vfm_sdm.outputs.report.texts_of_notes import NOTE_FORMS

SOURCES = Path(__file__).parents[4] / "src" / "vfm_sdm"
WRITERS = (
    *sorted(path.relative_to(SOURCES) for path in (SOURCES / "stages" / "audit").glob("*.py")),
    *("stages/intervals/verdicts.py", "outputs/results/notes.py"),
    *(f"stages/cameras/{name}.py" for name in ("solve", "site", "file", "culprits", "confusions", "hypotheses")),
    *(f"stages/cameras/{name}.py" for name in ("related_views", "two_view", "priors", "network_rig", "posediffusion")),
    *(f"stages/cameras/{name}.py" for name in ("site_problem", "sfm", "profile_checks", "chessboard/estimator")),
    *("stages/tracking/frame_clock.py", "stages/tracking/segments.py", "analysis/evaluation/comparison.py"),
    *(f"analysis/fusion/{name}.py" for name in ("fuse", "result", "scale")),
    *(f"inputs/video/{name}.py" for name in ("marks", "numbering", "continuity")),
)
"""Files whose strings with blanks in them are sentences of audits and notes, or parts of these."""
NO_SENTENCES = frozenset(
    {
        *("vfm-sdm cameras 1", "camera file", "tracking 7", "cameras posediffusion", "_Steps | None"),
        "use cameras = 'two-view', which takes the intrinsics from it",
    }
)
"""Strings of these files that no report shows."""
PLACES = re.compile(r"[\d\W]*((of|in|and|view)[\d\W]+)*")
"""As `'7' in view '7'`: of which the words are translated with what stands in the gaps, or alike in German."""
QUICK_FAULTS = frozenset({"a moved tripod", "views swapped"})
GERMAN = find_language("de")


class _Strings(ast.NodeVisitor):
    """Strings of a module but for docstrings and errors; what stands in the gaps of sentences is 7."""

    def __init__(self):
        self.found = []

    def visit_Raise(self, node):
        pass

    def visit_Expr(self, node):
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_Constant(self, node):
        if isinstance(node.value, str):
            self.found.append(re.sub(r"\{.*?\}", "7", node.value))

    def visit_JoinedStr(self, node):
        said = ""
        for part in node.values:
            if isinstance(part, ast.Constant):
                said += part.value
                continue
            said += "7 %" if "say_percent" in ast.unparse(part.value) else "7"
            self.visit(part.value)
        self.found.append(said)


def sentences(path):
    strings = _Strings()
    strings.visit(ast.parse((SOURCES / path).read_text(encoding="utf-8")))
    return [one for one in strings.found if " " in one.strip() and not PLACES.fullmatch(one)]


def is_told(sentence):
    return not GERMAN.tell(sentence).left


@pytest.mark.parametrize("path", WRITERS, ids=str)
def test_every_sentence_of_the_program_has_a_german_form(path):
    missing = [one for one in sentences(path) if one not in NO_SENTENCES and not is_told(one)]
    assert missing == [], "add their forms to outputs/report/texts_of_checks.py or texts_of_notes.py"


def test_the_search_finds_sentences_that_have_no_form():
    assert not is_told("a new sentence that nobody translated; the views are synchronised")
    assert sum(len(sentences(path)) for path in WRITERS) > 200


def test_every_status_has_a_german_form():
    known = (*CameraStatus, *ClockStatus, *PointStatus, *RecordingStatus, *RefinementStatus)
    assert [str(one) for one in known if one != "ok" and GERMAN.tell(str(one)).left] == []


def test_forms_keep_what_stands_in_their_gaps():
    for english, german in {**CHECK_FORMS, **NOTE_FORMS, **THING_FORMS}.items():
        names = [sorted(name for _, name, _, _ in Formatter().parse(text) if name) for text in (english, german)]
        assert names[0] == names[1], english


@pytest.mark.parametrize(
    ("english", "german"),
    [
        (
            "signal to noise: little more than noise: lateral of 1.5, vertical of a b; use a longer lens, a larger "
            "subset or more light; tripods: camera 'left' moved: 0.25 px (rms) were removed with the help of 2 static "
            "points, 0.01 px are left",
            "Signal zu Rauschen: kaum mehr als Rauschen: quer von 1.5, vertikal von a b; längere Brennweite, größeren "
            "Ausschnitt oder mehr Licht verwenden; Stative: Kamera 'left' bewegte sich: 0,25 px (Effektivwert) wurden "
            "mithilfe von 2 Festpunkten entfernt, 0,01 px bleiben",
        ),
        (
            "camera 'left' moved far: 46.50 px (rms) were taken out by its pose in every frame, found by 4 static "
            "points; 0.010 px are left of each by the others",
            "Kamera 'left' bewegte sich weit: 46,50 px (Effektivwert) wurden durch ihre Lage in jedem Bild "
            "herausgenommen, die 4 Festpunkte zeigen; je Festpunkt bleiben durch die anderen 0,010 px",
        ),
        (
            "camera 'left' moved far: 46.50 px (rms) were taken out by its pose in every frame; three static points "
            "show it and nothing checks them: name a fourth",
            "Kamera 'left' bewegte sich weit: 46,50 px (Effektivwert) wurden durch ihre Lage in jedem Bild "
            "herausgenommen; drei Festpunkte zeigen sie, und nichts prüft diese: einen vierten benennen",
        ),
        (
            "camera 'left' moves far, and fewer than three static points show how; name four or more at several depths",
            "Kamera 'left' bewegt sich weit, und weniger als drei Festpunkte zeigen, wie; vier oder mehr in mehreren "
            "Tiefen benennen",
        ),
        (
            "camera 'left' moves far, and its static points do not show how: they lie on one line or leave the "
            "picture; name four or more at several depths, all around the structure",
            "Kamera 'left' bewegt sich weit, und ihre Festpunkte zeigen nicht, wie: sie liegen auf einer Linie oder "
            "verlassen das Bild; vier oder mehr in mehreren Tiefen rings um das Bauwerk benennen",
        ),
        ("point 'a' was not refined: both views poor", "Punkt 'a' wurde nicht verfeinert: beide Ansichten schlecht"),
        (
            "the clocks keep step (in 2 of 5 intervals, worst from 0 to 60 s)",
            "die Uhren laufen gleich (in 2 von 5 Teilen, am ungünstigsten von 0 bis 60 s)",
        ),
        (
            "most probably wrong: focal left, stated as 8320 px; everything else gives 1390 +- 10 (as if stated in "
            "feet): expected a sensor 6.4 or 13 mm wide, got that of 35 mm film, do: state its own width; nearly as "
            "probable: baseline, range left to 'mid'; what was stated contradicts itself, and the scale with it",
            "höchstwahrscheinlich falsch: Brennweite left, angegeben als 8320 px; alles Übrige ergibt 1390 ± 10 (als "
            "sei es in Fuß angegeben): erwartet war ein 6,4 oder 13 mm breiter Sensor, gegeben ist der von "
            "Kleinbildfilm; die eigene Breite angeben; fast ebenso wahrscheinlich: Basislänge, Strecke left bis 'mid'; "
            "die Angaben widersprechen einander, und damit der Maßstab",
        ),
        ("known to 1e+02 % (k = 2)", "bekannt auf 100 % (k = 2)"),
        # Old versions, and other packages, write other sentences.
        ("a sentence of 2.5 others; hardly any motion", "a sentence of 2.5 others; kaum Bewegung"),
        ("", ""),
    ],
)
def test_sentences_are_put_together_from_forms(english, german):
    assert GERMAN.tell(english).text == german
    assert find_language("en").tell(english) == (english, ())


def test_names_are_never_translated():
    forms = Forms({"point {point} moves {mm:n} mm": "Punkt {point}: {mm} mm", "still": "still!"}, {}, ",")
    assert forms.tell("point still moves 1.5 mm").text == "Punkt still: 1,5 mm"
    assert forms.tell("point 1.5 moves -1.5 mm").text == "Punkt 1.5: -1,5 mm"


@pytest.mark.parametrize(
    "fault",
    [pytest.param(one, marks=() if one in QUICK_FAULTS else pytest.mark.slow) for one in FAULTS],
)
def test_audits_of_faults_hold_no_english_clause(fault):
    run = FAULTS[fault][0](3)
    found = measured(run.session, run.tracks, run.solution).audit
    left = [clause for check in found.checks for clause in GERMAN.tell(check.sentence).left]
    assert left == []
    assert found.flagged


def test_a_german_report_with_many_cautions_is_german(tmp_path):
    """Three frames of points that are never seen: hardly a check passes."""
    write_run(tmp_path, duration_s=0.2, lost=("p0", "s0", "s1", "s2"))
    with open_run(tmp_path) as inputs:
        content = build_content(inputs, GERMAN)
        checks = inputs.summary["audit"]["checks"]
    assert sum(check["outcome"] != "pass" for check in checks) > 8
    assert [block for section in content.sections for block in section.blocks if getattr(block, "foreign", False)] == []
    shown = str(content)
    assert [check["sentence"] for check in checks if check["sentence"] in shown] == []
