"""The command ``frames``: pixels can be read off its pictures, and what is named stands where it was named."""

import cv2
import numpy as np
import pytest

from vfm_sdm.core.datasets import make_points, make_tracks
from vfm_sdm.core.netcdf import write_points, write_tracks
from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.inputs.session import Session, write_session
from vfm_sdm.outputs.plots import draw_frame
from vfm_sdm.studies.planning.frames import find_frames

SIZE = (240, 160)
BRIGHT = (37, 101)


@pytest.fixture
def session(tmp_path):
    """Two views of four pictures with one white pixel, and a point that comes into view in the third."""
    rng = np.random.default_rng(1)
    for view in ("left", "right [B]"):
        (tmp_path / view).mkdir()
        for number in range(4):
            picture = rng.integers(0, 90, SIZE[::-1], np.uint8)
            picture[BRIGHT[::-1]] = 255
            assert cv2.imwrite(str(tmp_path / view / f"{number}.png"), picture)
    return Session(
        name="bridge",
        view=[
            {"name": "left", "images": "left/*.png", "fps": 30.0},
            {"name": "right [B]", "images": "right [[]B[]]/*.png", "fps": 30.0, "time_offset_s": 0.0},
        ],
        point=[
            {"name": "mid", "view": "left", "pixel": [120.0, 80.0], "pixel_in": {"right [B]": [110.0, 82.0]}},
            {"name": "pier", "view": "left", "pixel": [60.0, 80.0], "static": True},
            {"name": "late", "view": "left", "pixel": [90.0, 40.0], "frame": 2},
        ],
        site={"baseline": {"value": 3.6, "std": 0.01}},
        folder=tmp_path,
    )


def test_a_pixel_lies_where_its_ticks_say(tmp_path):
    """Found in the saved picture at the place that the axes give its coordinates, all of it and no other."""
    luma = np.zeros(SIZE[::-1], np.uint8)
    luma[BRIGHT[::-1]] = 255
    figure = draw_frame(luma, np.empty((0, 2)), (), title="one pixel")
    axes = figure.axes[0]
    axes.grid(visible=False, which="both")
    figure.savefig(tmp_path / "one.png")
    picture = cv2.imread(str(tmp_path / "one.png"), cv2.IMREAD_GRAYSCALE)
    box = axes.get_window_extent()
    inside = picture[round(picture.shape[0] - box.y1) + 3 : round(picture.shape[0] - box.y0) - 3]
    inside = inside[:, round(box.x0) + 3 : round(box.x1) - 3]
    rows, columns = np.nonzero(inside > 128)
    times = box.width / SIZE[0]
    assert times == pytest.approx(8.0, abs=0.01)
    assert ((columns + 3.5) / times - 0.5).mean() == pytest.approx(BRIGHT[0], abs=0.1)
    assert ((rows + 3.5) / times - 0.5).mean() == pytest.approx(BRIGHT[1], abs=0.1)
    assert len(rows) == pytest.approx(64, abs=17)


def test_ticks_are_labelled_at_round_pixels():
    for width, step in ((240, 10), (1280, 100), (3840, 250)):
        axes = draw_frame(np.zeros((width // 2, width), np.uint8), np.empty((0, 2)), (), title="").axes[0]
        assert set(np.diff(axes.get_xticks())) == {step}
        assert set(np.diff(axes.get_yticks())) == {step}


def test_points_stand_in_their_own_frames(session):
    written = write_session(session.folder / "session.toml", session)
    said = []
    found = {(one.view, one.number): one for one in find_frames(written, progress=lambda what, *_: said.append(what))}
    assert "subsets left" in said  # of many points they take minutes
    assert {key: one.names for key, one in found.items()} == {
        ("left", 0): ("mid", "pier"),
        ("left", 2): ("late",),
        ("right [B]", 0): ("mid",),
    }
    first = found["left", 0]
    assert first.places.tolist() == [[120.0, 80.0], [60.0, 80.0]]
    assert first.static == (False, True)
    assert min(first.sides_px) >= 9
    assert found["right [B]", 0].places.tolist() == [[110.0, 82.0]]


def test_a_run_shows_where_all_points_were_found_and_what_was_compared(session):
    folder = session.folder / "run"
    write_session(folder / SESSION, session)
    names, views = ["mid", "pier", "late"], ["left", "right [B]"]
    places = np.arange(12.0).reshape(2, 3, 2) * 10
    places[1, 1] = np.nan
    points = make_points(
        views, names, position=places, position_std=np.zeros((2, 3, 2)), status=np.full((2, 3), "ok", dtype=object)
    )
    write_points(folder, points.assign(frame=(("view", "point"), [[0, 0, 2], [0, 0, 1]])))
    tracks = make_tracks([0.0], names, np.zeros((1, 3, 2)), np.zeros((1, 3, 2, 2)), np.zeros((1, 3)), attrs={})
    write_tracks(folder, dict.fromkeys(views, tracks.assign(subset_px=("point", [21, 31, 0]))))
    found = {(one.view, one.number): one for one in find_frames(folder)}
    assert {key: one.names for key, one in found.items()} == {
        ("left", 0): ("mid", "pier"),
        ("left", 2): ("late",),
        ("right [B]", 0): ("mid", "pier"),
        ("right [B]", 1): ("late",),
    }
    np.testing.assert_array_equal(found["right [B]", 0].places, places[1, :2])
    assert found["left", 0].sides_px == (21, 31)


def test_every_frame_becomes_a_file(session, command, capsys):
    written = write_session(session.folder / "session.toml", session)
    status, out, _ = command("frames", written, "-o", session.folder / "out")
    assert status == 0
    assert out.count("written:") == 3
    assert {path.name for path in (session.folder / "out").iterdir()} == {
        "left.png",
        "left_frame_2.png",
        "right_-B-.png",
    }


def test_a_folder_without_a_run_and_no_video_are_named(tmp_path, command):
    status, _, err = command("frames", tmp_path)
    assert status == 1
    assert "expected a run folder" in err
    status, _, err = command("frames", tmp_path / "none.mp4")
    assert status == 1
    assert "none.mp4" in err
