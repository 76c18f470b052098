"""A measurement of a part of the recordings, and of recordings in chapters."""

import numpy as np
import pytest

import scenes
from vfm_sdm.errors import SessionError
from vfm_sdm.inputs.session import read_session, write_session
from vfm_sdm.inputs.session.model import View
from vfm_sdm.inputs.session.recordings import list_chapters
from vfm_sdm.measurement import Measurement


def with_views(session, **updates):
    """The session with fields of its views changed, by name of the view."""
    views = [View(**{**view.model_dump(exclude_none=True), **updates.get(view.name, {})}) for view in session.view]
    return session.model_copy(update={"view": tuple(views)})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A session and its measurement."""
    folder = tmp_path_factory.mktemp("whole")
    session = read_session(scenes.write_scene(folder, frames=20, synchronization="none", injection=False))
    return session, Measurement(session).run("displacement")


@pytest.mark.parametrize(
    "begins",
    [(0.1, 0.2), pytest.param((0.1, 0.1), marks=pytest.mark.slow), pytest.param((0.2, 0.1), marks=pytest.mark.slow)],
)
def test_what_is_used_moves_as_it_does_in_the_whole(whole, begins):
    whole, measured = whole
    frame = round(begins[0] * scenes.FPS)
    places = measured.tracks["left"]["position"].isel(time=frame)
    points = [
        p.model_copy(update={"pixel": tuple(places.sel(point=p.name).values.tolist()), "pixel_in": {}})
        for p in whole.point
    ]
    used = with_views(whole, left={"use_s": [begins[0]]}, right={"use_s": [begins[1], 10.0]})
    used = read_session(write_session(whole.folder / "used.toml", used.model_copy(update={"point": tuple(points)})))
    expected, found = measured.displacement, Measurement(used).displacement
    # Time counts from where the reference view's interval begins; both recordings began together.
    later = max(begins[1] - begins[0], 0.0)
    np.testing.assert_allclose(found["time"].values[0], later, atol=1e-9)
    shift = expected.assign_coords(time=expected["time"].values - begins[0]).sel(time=found["time"], method="nearest")
    np.testing.assert_allclose(shift["time"].values, found["time"].values, atol=1e-6)
    moved = [one["displacement"].values - one["displacement"].values[:1] for one in (shift, found)]
    assert np.ptp(moved[0][..., :2]) > 0.5
    assert np.abs(moved[1] - moved[0])[..., :2].max() < 0.02 * np.ptp(moved[0][..., :2])


def test_intervals_by_the_clock_on_the_wall(tmp_path):
    session = read_session(scenes.write_scene(tmp_path, frames=3))
    fields = {"start": "2026-11-20T10:00:00Z", "use_s": ["2026-11-20T10:00:12Z", "2026-11-20T11:00:40.5+01:00"]}
    used = with_views(session, left=fields)
    assert used.view[0].interval_s == (12.0, 40.5)
    assert used.view[1].interval_s == (0.0, None)
    again = read_session(write_session(tmp_path / "used.toml", used))
    assert again.view[0].interval_s == (12.0, 40.5)
    assert again.stated_offset_s(again.view[1]) == pytest.approx(-12.0)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"use_s": ["2026-11-20T10:00:12Z"]}, "expected start beside dates and times"),
        ({"use_s": [5.0, 2.0]}, "expected a beginning before the end"),
        ({"use_s": [-1.0, 2.0]}, "expected to begin with the first frame"),
        ({"use_s": 3.0}, r"expected \[from\] or \[from, to\]"),
        ({"use_s": [1.0, 2.0, 3.0]}, r"expected \[from\] or \[from, to\]"),
        ({"video": []}, "expected a file, a pattern, or a list of files"),
        ({"video": [3]}, "expected a file, a pattern, or a list of files"),
    ],
)
def test_what_cannot_be_an_interval_or_a_recording_is_named(tmp_path, fields, said):
    path = scenes.write_scene(tmp_path, frames=2)
    session = read_session(path)
    table = session.as_fields()
    table["view"][0] = {k: v for k, v in table["view"][0].items() if v is not None and k not in fields} | fields
    with pytest.raises(SessionError, match=said):
        type(session)(**table, folder=tmp_path)


def test_a_pattern_names_the_chapters_in_the_order_of_their_numbers(tmp_path):
    session = read_session(scenes.write_scene(tmp_path, frames=2))
    for name in ("GX100007.MP4", "GX020007.MP4", "GX010007.MP4", "GX010008.MP4"):
        (tmp_path / name).touch()
    table = session.as_fields()
    table["view"][0] = {"name": "left", "video": "GX*0007.MP4", "camera": "rig.toml"}
    found = type(session)(**table, folder=tmp_path)
    names = [path.name for path in list_chapters(found, found.view[0])]
    assert names == ["GX010007.MP4", "GX020007.MP4", "GX100007.MP4"]
    (tmp_path / "GX*0007.MP4").touch()
    assert len(list_chapters(found, found.view[0])) == 1
