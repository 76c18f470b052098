"""Real surfaces from films to millimetres: what a first user's bridge gives, and what is said where it gives nothing."""

import re

import cv2
import numpy as np
import pytest

from scenes import SIZE, write_scene
from vfm_sdm.inputs.session import Session, read_session, write_session

SKY_ROWS = SIZE[1] // 2


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """A session all of whose points lie on flat sky above a textured plane."""
    path = write_scene(tmp_path_factory.mktemp("sky"), frames=24)
    rng = np.random.default_rng(0)
    for file in sorted(path.parent.glob("*/*.png")):
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        noise = rng.normal(0, 1.2, (SKY_ROWS, SIZE[0]))
        picture[:SKY_ROWS] = np.clip(np.rint(205 + noise), 0, 255)
        cv2.imwrite(str(file), picture)
    session = read_session(path)
    points = [{"name": f"sky {u:.0f}", "view": "left", "pixel": [u, 60.0]} for u in (90.0, 180.0, 270.0)]
    return write_session(path, Session(**{**session.model_dump(), "folder": session.folder, "point": points}))


def test_points_on_the_sky_end_with_the_first_cause(command, sky, tmp_path):
    status, out, err = command("measure", sky, "-o", tmp_path / "run")
    assert status == 3
    # What to expect comes before everything else, and names each point.
    table = err[: err.index("no sample is ok")]
    assert all(re.search(rf"sky {u} .*refused: no texture to follow", table) for u in (90, 180, 270))
    last = err.strip().splitlines()[-1]
    assert last.startswith("vfm-sdm: no sample is ok: points: none can be followed; point 'sky 90' in view 'left'")
    # The way out is another place, and not the same place in the other view.
    assert re.search(r"name another: \(\d+, \d+\) would do$", last)
    assert "pixel_in" not in last
    assert "verdict: do not use" in out
