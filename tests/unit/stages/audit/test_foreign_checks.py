"""Checks of other packages: they take part in every audit, and their faults cost nobody the result."""

import pytest

from faults import good_run
from measurements import measured
from plugins import installed
from vfm_sdm.core.statuses import Outcome

CHECK = """
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.stages.audit import AuditCheck

def check(inputs):
    {}
"""


@pytest.fixture(scope="module")
def run():
    return good_run(0)


def audit_with(run, folder, text):
    with installed(folder, {"vfm_sdm.checks": {"mine": "foreign:check"}}, {"foreign": text}):
        return measured(run.session, run.tracks, run.solution).audit


@pytest.fixture(scope="module")
def without(run):
    return measured(run.session, run.tracks, run.solution).audit


def test_one_that_works_is_the_last_of_the_checks(run, without, tmp_path):
    text = CHECK.format("return AuditCheck('mine', Outcome.FAIL, 2.0, 1.0, '1', 'twice too much')")
    audit = audit_with(run, tmp_path, text)
    assert audit["mine"].sentence == "twice too much"
    assert [check.name for check in audit.checks[:-1]] == [check.name for check in without.checks]
    assert audit.verdict == "do not use"


def test_one_that_does_not_apply_is_left_out(run, without, tmp_path):
    audit = audit_with(run, tmp_path, CHECK.format("return None"))
    assert [check.name for check in audit.checks] == [check.name for check in without.checks]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (CHECK.format("return inputs['tracks']"), "the check of river-tools 1.2 failed: TypeError: "),
        (CHECK.format("return 'fine'"), "expected the check of river-tools 1.2 to be an AuditCheck, got 'fine'"),
        ("import no_such_module", "check 'mine' of river-tools 1.2: expected to import foreign:check, got ModuleNot"),
    ],
)
def test_one_that_fails_is_not_possible_and_says_why(run, without, tmp_path, text, sentence):
    audit = audit_with(run, tmp_path, text)
    assert audit["mine"].outcome == Outcome.NOT_POSSIBLE
    assert audit["mine"].sentence.startswith(sentence)
    assert audit.verdict == without.verdict
    assert len(audit.checks) == len(without.checks) + 1
