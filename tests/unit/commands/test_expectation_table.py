"""What the terminal says of points before anything is measured."""

import numpy as np
import pytest
from rich.console import Console

from vfm_sdm.commands.tables import expectation_table
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.stages.registration.designs import SubsetDesign, Warp
from vfm_sdm.stages.tracking.subset_design import SubsetChoice, describe_subsets

NOWHERE = np.full(2, np.nan)
LEVEL = np.array([1.0, 0.0])
EDGE = SubsetDesign(41, Warp.EDGE, across=LEVEL)
CHOICES = {
    "good": SubsetChoice(SubsetDesign(41), np.array([0.012, 0.02]), LEVEL, 1.0, PointStatus.OK, NOWHERE),
    "part": SubsetChoice(SubsetDesign(41), np.array([0.012, 0.02]), LEVEL, 0.4, PointStatus.OK, NOWHERE),
    "lit": SubsetChoice(SubsetDesign(41, shading=2), np.array([0.012, 0.02]), LEVEL, 1.0, PointStatus.OK, NOWHERE),
    "edge": SubsetChoice(EDGE, np.array([0.02, np.inf]), LEVEL, 1.0, PointStatus.OK, NOWHERE),
    "flange": SubsetChoice(EDGE, np.array([0.02, np.inf]), LEVEL[::-1], 1.0, PointStatus.OK, NOWHERE),
    "brace": SubsetChoice(EDGE, np.array([0.02, np.inf]), np.sqrt([0.5, 0.5]), 1.0, PointStatus.OK, NOWHERE),
    "flat": SubsetChoice(None, np.full(2, np.inf), LEVEL, 1.0, PointStatus.NO_TEXTURE, np.array([80.0, 40.0])),
    "nothing": SubsetChoice(None, np.full(2, np.inf), LEVEL, 1.0, PointStatus.NO_TEXTURE, NOWHERE),
    "border": SubsetChoice(SubsetDesign(41), NOWHERE, NOWHERE, 1.0, PointStatus.OK, NOWHERE),
}
WORDS = {
    "good": "0.012 to 0.020 px",
    "part": "0.012 to 0.020 px; 40% of its square moves with it",
    "lit": "0.012 to 0.020 px; light that moves over it is taken out",
    "edge": "0.020 px horizontally, across its edge; nothing along it",
    "flange": "0.020 px vertically, across its edge; nothing along it",
    "brace": "0.020 px at 135 degrees, across its edge; nothing along it",
    "flat": "refused: no texture to follow; name another place: (80, 40) would do",
    "nothing": "refused: no texture to follow; name another place",
    "border": "not known: too few frames, or too near to the border",
}


@pytest.mark.parametrize("name", CHOICES)
def test_a_line_says_how_well_a_point_should_measure_and_what_to_do(name):
    console = Console(width=160, record=True, force_terminal=False)
    console.print(expectation_table({"left": describe_subsets([name], [CHOICES[name]])}))
    line = next(line for line in console.export_text().splitlines() if name in line and "left" in line)
    assert line.split(name, 1)[1].strip() == WORDS[name]
