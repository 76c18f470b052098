"""A structure that has settled by 2 mm, filmed by cameras that stand elsewhere and zoom otherwise."""

import csv
import json

import numpy as np
import pytest
from rich.console import Console

from revisits import MOVING, STATIC, first_plan, second_plan
from vfm_sdm.commands.tables import revisit_table
from vfm_sdm.core.statuses import RevisitStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.measurement import Measurement, measure
from vfm_sdm.stages.revisit import Change, Revisit
from vfm_sdm.studies.synthetic.field_test import make_field_test


@pytest.mark.slow
def test_a_settlement_of_two_millimetres_is_found_within_its_interval(tmp_path):
    first = first_plan()
    second = second_plan(first, settlement_mm=2.0)
    measure(read_session(make_field_test(tmp_path / "May", first)), tmp_path / "runs" / "May")
    file = make_field_test(tmp_path / "October", second)
    # The clicks of the later visit are a few pixels beside those of the earlier one.
    session = read_session(file)
    points = [
        p.model_copy(update={"pixel": (p.pixel[0] + 2.3, p.pixel[1] - 1.7)}) if not p.static else p
        for p in session.point
    ]
    later = session.model_copy(update={"point": tuple(points), "baseline_visit": tmp_path / "runs" / "May"})
    run = tmp_path / "runs" / "October"
    found = measure(later, run).revisit
    assert set(found.static) == set(STATIC)
    rest = {p.name: p.position for p in second.points}
    assert [one.point for one in found.changes] == list(MOVING)
    for one in found.changes:
        true = 1e3 * second.motion.settled(np.array([rest[one.point]]))[0]
        assert one.status is RevisitStatus.OK
        assert (np.abs(one.change_mm - true) < 2 * np.array(one.std_mm)).all(), one
    middle = found.changes[-1]
    assert middle.change_mm[1] == pytest.approx(2.0, abs=0.5)
    assert 2 * middle.std_mm[1] < 0.8  # the settlement stands out
    assert abs(found.scale_ratio - 1) < 3 * found.scale_ratio_std < 0.02
    with (run / "revisit.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert float(rows[-1]["vertical [mm]"]) == pytest.approx(middle.change_mm[1], rel=1e-5)
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert summary["revisit"]["changes"][-1]["change_mm"] == list(middle.change_mm)
    # Nothing of the earlier visit is touched, and without its films there is nothing to compare with.
    (tmp_path / "May" / "left.mp4").unlink()
    with pytest.raises(SessionError, match=r"baseline_visit: expected the run folder .* with its recordings"):
        _ = Measurement(later, run).revisit


def test_the_table_says_all_on_a_narrow_terminal(capsys):
    found = Revisit(
        "May",
        ("lateral", "vertical", "longitudinal"),
        ("wall", "block"),
        (
            Change("1/2 span", RevisitStatus.OK, (0.104, 2.003, -0.5), (0.05, 0.151, 0.2)),
            Change("1/4 span", RevisitStatus.LOOK_ALIKE),
        ),
        ("take note",),
        1.002,
        0.001,
    )
    Console(width=50, markup=False).print(revisit_table(found))
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 50
    words = "".join(out.split())
    for word in ("2.00", "0.30", "wall,block", "100.20+-0.20%", "takenote"):
        assert word in words, word
    Console(width=200, markup=False).print(revisit_table(found))
    out = capsys.readouterr().out
    for word in ("2.00 +- 0.30", "several places look alike", "relative to the static points wall, block"):
        assert word in out, word
