"""Tables of load steps: read as they are meant, or refused with what to correct."""

import pytest

from vfm_sdm.analysis.load_test import read_steps
from vfm_sdm.errors import DatasetError


def test_a_table_with_decimal_commas_says_the_same(tmp_path):
    point = "load [kN],begin_s,end_s,mid span vertical [mm],quarter Lateral [mm]\n0,0,20,0,-\n300,40.5,70,-2.5,0.1\n"
    (tmp_path / "a.csv").write_text(point)
    (tmp_path / "b.csv").write_text(point.replace(",", ";").replace(".", ","))
    a, b = (read_steps(tmp_path / name) for name in ("a.csv", "b.csv"))
    assert a == b
    assert a.timed
    assert a.unit == "kN"
    assert a.steps[1].calculated_mm == {("mid span", "vertical"): -2.5, ("quarter", "lateral"): 0.1}
    assert a.steps[0].calculated_mm == {("mid span", "vertical"): 0.0}
    assert (a.steps[1].begin_s, a.steps[1].end_s) == (40.5, 70.0)


def test_times_may_be_left_out(tmp_path):
    (tmp_path / "a.csv").write_text("step,load\n1,0\n2,5\n3,0\n")
    plan = read_steps(tmp_path / "a.csv")
    assert (plan.timed, plan.unit, [step.load for step in plan.steps]) == (False, "", [0.0, 5.0, 0.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("weight,begin_s,end_s\n0,0,1\n1,2,3\n", "expected a column load, got weight, begin_s, end_s"),
        ("load,begin_s\n0,0\n1,2\n", "expected both begin_s and end_s"),
        ("load,begin_s,end_s\n0,0,20\n5,15,30\n", "expected steps one after the other"),
        ("load,begin_s,end_s\n0,20,0\n5,25,30\n", "expected steps one after the other"),
        ("load,mid up [mm]\n0,1\n5,2\n", "got 'mid up'; name a point and one of lateral, vertical, longitudinal"),
        ("load,vertical\n0,1\n5,2\n", "got 'vertical'; name a point"),
        ("load,begin_s,end_s\n0,0,20\n-,25,30\n", "expected the load of every step, got none in row 2"),
        ("load,mid vertical [cm]\n0,0\n5,2\n", "expected mid vertical in mm, got cm"),
        ("load,begin_s [min],end_s [min]\n0,0,1\n5,2,3\n", "expected begin_s in s, got min"),
        ("load [kN],load [t]\n0,0\n5,2\n", "expected each column once, got several load"),
        ("load,mid vertical,mid Vertical\n0,0,0\n5,2,3\n", "expected each column once, got several mid vertical"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, text, message):
    path = tmp_path / "steps.csv"
    path.write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_steps(path)
