"""Pictures of reports: plan, first frames, and what stands for them where recordings are gone or changed."""

import json
import re
from base64 import b64decode
from io import BytesIO
from types import SimpleNamespace

import html5lib
import numpy as np
import pytest
from PIL import Image

from run_folders import write_run
from vfm_sdm.inputs.session import Lens, Site, View
from vfm_sdm.inputs.session.hashes import InputHashes
from vfm_sdm.outputs.report import find_language, open_run, write_report
from vfm_sdm.outputs.report.drawing import WIDTH
from vfm_sdm.outputs.report.site_plan import Place, draw_site, lay_flat, site_places

SIZE = (1920, 1080)


@pytest.fixture
def filmed(tmp_path):
    """A run folder beside its films, image sequences of two frames a view."""
    site = tmp_path / "sité [a]"
    rng = np.random.default_rng(2)
    for view in ("left", "right"):
        (site / view).mkdir(parents=True)
        for n in range(2):
            Image.fromarray(rng.integers(0, 255, SIZE[::-1], dtype=np.uint8)).save(
                site / view / f"{n}.png", compress_level=0
            )
    views = tuple(
        View(name=view, images=f"{view}/*.png", fps=30.0, lens=Lens(focal_px=8000.0)) for view in ("left", "right")
    )
    measurement, _ = write_run(site / "run", folder=site, view=views)
    path = site / "run" / "summary.json"
    hashes = InputHashes().of(measurement.session)
    path.write_text(json.dumps({**json.loads(path.read_text()), "input_hashes": hashes}))
    return site


def report_of(folder):
    text = write_report(folder)[0].read_text(encoding="utf-8")
    html5lib.HTMLParser(strict=True).parse(text)
    return text


def test_first_frames_are_shown_with_points_and_stay_small(filmed):
    text = report_of(filmed / "run")
    pictures = [Image.open(BytesIO(b64decode(one))) for one in re.findall(r"data:image/jpeg;base64,([^\"]+)", text)]
    assert len(pictures) == 2
    assert all(
        picture.width <= 1600 and picture.width / picture.height == pytest.approx(16 / 9, rel=0.01)
        for picture in pictures
    )
    assert text.count("+ vertical") == 4  # with its halo, in either view
    # Noise is the worst that a codec can meet.
    assert len(text) < 5_000_000


def test_recordings_that_changed_or_are_gone_are_named(filmed):
    (filmed / "left" / "0.png").write_bytes((filmed / "left" / "1.png").read_bytes()[:-1] + b"x")
    for path in (filmed / "right").iterdir():
        path.unlink()
    figures = filmed / "run" / "figures"
    figures.mkdir()
    Image.new("RGB", (3000, 2000), "red").save(figures / "points_right.png")
    (figures / "points_left.png").write_bytes(b"damaged")
    text = report_of(filmed / "run")
    assert "View left: the recording is not the one that was measured" in text
    assert "View right: the recording was not at hand" in text
    assert "View right: figure that the measurement drew" in text
    assert text.count("data:image/jpeg") == 1


def test_plan_shows_cameras_and_points_where_they_are(tmp_path):
    _, site = write_run(tmp_path)
    with open_run(tmp_path) as inputs:
        places = {place.name: place for place in site_places(inputs)}
    assert list(places) == ["left", "right", "p0", "p1", "s0", "s1", "s2"]
    for name, camera in zip(("left", "right"), site.solution.rig.cameras, strict=True):
        expected = site.solution.frame.rotation @ camera.center
        assert places[name].position == pytest.approx(expected, abs=1e-6)
    assert places["s0"].static
    assert not places["p0"].static
    # The structure lies away from the camera, and both cameras look at it.
    assert places["p0"].position[0] > 2
    assert all(places[name].sight[0][0] > 0 for name in ("left", "right"))


@pytest.mark.parametrize("view", ["plan", "elevation"])
def test_drawings_are_no_mirror_images(tmp_path, view):
    """The face is on the right of who looks along the camera, from above and from behind it."""
    _, site = write_run(tmp_path)
    axes = ("lateral", "vertical", "longitudinal")
    sheet = lay_flat(axes, view) @ site.frame.rotation
    camera = lay_flat(("right", "down", "forward"), view)
    turned = sheet @ np.linalg.pinv(camera) if view == "plan" else sheet[:, :2] @ np.diag([1, -1])
    # From the camera's own right and forward (or up) to the sheet: a rotation, and no reflection.
    assert np.linalg.det(turned) > 0.1
    if view == "plan":
        sight, lateral = sheet @ [0, 0, 1], np.array([0.0, 1.0])
        assert sight[0] * lateral[1] - sight[1] * lateral[0] < 0


@pytest.mark.parametrize("view", ["plan", "elevation"])
def test_names_stand_beside_their_own_dots_apart_and_inside(view):
    """As on an abutment: two points beside each other, and others at the edges of the site."""
    axes = ("lateral", "vertical", "longitudinal")
    along = {"abutment": 4.01, "abutment corner": 3.41, "a rather long name": 6.2, "right end": -3.2}
    places = [Place(name, np.array([6.9, 0.8, z]), static=True) for name, z in along.items()]
    svg = draw_site(SimpleNamespace(axis_names=axes), places, view, find_language("en"))
    dots = [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)]
    letters = r'<text x="([\d.]+)" y="([\d.]+)" font-size="10.5" text-anchor="(\w+)" fill="#222222">([a-z ]+)<'
    spans = {}
    for x, y, anchor, name in re.findall(letters, svg):
        width = 0.5 * 10.5 * len(name)
        left = float(x) - width * {"start": 0, "middle": 0.5, "end": 1}[anchor]
        spans[name] = (left, left + width, float(y))
    assert list(spans)[:4] == list(along)
    for (x, y), name in zip(dots, along, strict=True):
        left, right, base = spans[name]
        assert 0 < left < right < WIDTH
        assert max(left - x, x - right) < 10
        assert -10 < base - y < 18
    for one in along:
        for other in along:
            if one < other:
                (a, b, y), (c, d, z) = spans[one], spans[other]
                assert abs(y - z) > 8 or b < c or d < a


def test_without_distances_the_axes_are_the_cameras(tmp_path):
    write_run(tmp_path, site=Site(baseline={"value": 4.0, "std": 0.01}))
    text = report_of(tmp_path)
    assert "positive to the right in the reference camera" in text
    assert "The axes are those of the reference camera" in text


def test_one_view_has_neither_plan_nor_budget(tmp_path):
    site = Site(length=({"points": ["p0", "p1"], "value": 2.0, "std": 0.01},))
    view = View(name="left", video="left.mp4")
    write_run(tmp_path, view=(view,), site=site)
    text = report_of(tmp_path)
    assert "no metric cameras are known" in text
    assert "Of a single view there is no budget" in text
    assert "motion towards it is not seen" in text


def test_points_that_were_never_seen_leave_dashes(tmp_path):
    write_run(tmp_path, lost=("p0",))
    text = report_of(tmp_path)
    assert "too short or too many gaps" in text
    assert "Seen in less than 95 % of the frames: p0" in text


def test_a_baseline_is_stated(tmp_path):
    write_run(tmp_path)
    assert re.search(r"optical centres of the first two cameras: \d\.\d+ m", report_of(tmp_path))
