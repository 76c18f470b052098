"""Photos of a report show every point in the frame in which it is named."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from vfm_sdm.core.datasets import make_points
from vfm_sdm.inputs.session import Session
from vfm_sdm.inputs.session.hashes import InputHashes
from vfm_sdm.outputs.report.language import LANGUAGES
from vfm_sdm.outputs.report.photos import draw_photo, find_photos

FRAMES, SIZE = 5, (60, 80)


@pytest.fixture
def inputs(tmp_path):
    (tmp_path / "left").mkdir()
    for number in range(FRAMES):
        cv2.imwrite(str(tmp_path / "left" / f"{number}.png"), np.full(SIZE, 40 * number, np.uint8))
    view = {"name": "left", "images": "left/*.png", "fps": 30.0}
    named = [{"name": name, "view": "left", "pixel": [40.0, 30.0]} for name in ("first", "later", "nowhere")]
    session = Session(name="s", view=[view], point=named).model_copy(update={"folder": tmp_path})
    place = [[[40.0, 30.0], [20.0, 30.0], [np.nan, np.nan]]]
    points = make_points(["left"], ["first", "later", "nowhere"], position=place, position_std=[[[0, 0]] * 3],
                         status=[["ok", "ok", "not found"]])  # fmt: skip
    narrowed = session.narrowed(("view.name", "view.video", "view.images"))
    return SimpleNamespace(
        session=session,
        points=points.assign(frame=(("view", "point"), [[0, 3, 4]])),
        summary={"input_hashes": InputHashes(whole_files=True).of(narrowed), "subsets": {}},
        folder=tmp_path,
        cameras=SimpleNamespace(rig=None),
        point_names=["first", "later", "nowhere"],
        static=[],
    )


def test_each_frame_shows_its_own_points(inputs):
    photos = find_photos(inputs)
    assert [(photo.view, photo.number) for photo in photos] == [("left", 0), ("left", 3)]
    assert [int(photo.frame[0, 0]) for photo in photos] == [0, 120]
    first, later = (draw_photo(inputs, photo, LANGUAGES["en"]) for photo in photos)
    assert ">first<" in first
    assert ">later<" not in first
    assert ">later<" in later
    assert ">first<" not in later
    assert "frame 3 of view left" in later
    assert "nowhere" not in first + later


def test_without_the_recording_there_is_one_figure_a_view(inputs):
    for path in inputs.folder.glob("left/*.png"):
        path.unlink()
    [photo] = find_photos(inputs)
    assert photo.frame is None
    assert photo.reason == "recording gone"
