"""The demonstration: a rendered recording, measured without calibration, against its truth."""

from dataclasses import replace
from functools import partial

import html5lib
import numpy as np
import pytest

from vfm_sdm.commands.demo import run_demo
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.statuses import Verdict
from vfm_sdm.inputs.session import Lens, Method, read_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.report import write_report
from vfm_sdm.outputs.results import read_summary, write_movement
from vfm_sdm.stages.cameras.file import read_rig
from vfm_sdm.stages.lens.file import KnownLens, write_lens
from vfm_sdm.studies.synthetic.field_test import make_demo
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run_demo(tmp_path_factory.mktemp("demo"))


@pytest.fixture(scope="module", params=["small", pytest.param("whole", marks=pytest.mark.slow)])
def demo(request, tmp_path_factory):
    """The demonstration as users run it; and half as long with fewer pixels, which holds the same limits."""
    if request.param == "whole":
        return request.getfixturevalue("whole")
    small = partial(make_demo, duration_s=1.5, site=FootbridgeSite(image_size=(640, 360)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vfm_sdm.commands.demo.make_demo", small)
        return run_demo(tmp_path_factory.mktemp("demo"))


def test_within_a_tenth_of_a_millimetre_in_every_axis(demo):
    rows = demo.evaluation.rows
    assert {row.axis for row in rows} == {"lateral", "vertical", "longitudinal"}
    assert max(row.rms_error_mm for row in rows) <= 0.1
    assert max(row.reference_peak_to_peak_mm for row in rows) > 5


def test_cameras_are_solved_without_calibration(demo):
    assert demo.measurement.cameras.status == "ok"
    assert demo.measurement.session.method.cameras == "two-view"
    assert demo.measurement.displacement.attrs["frame"] == "structure"


def test_gains_lie_within_their_stated_uncertainty(demo):
    scale_std = demo.measurement.displacement["scale_std"]
    checked = 0
    for row in demo.evaluation.rows:
        if row.reference_peak_to_peak_mm > 2:
            assert abs(row.score.gain - 1) <= 3 * float(scale_std.sel(point=row.point, axis=row.axis))
            checked += 1
    assert checked >= 6


@pytest.mark.slow
def test_the_stated_random_part_is_the_scatter(whole):
    """Of static points, whose surfaces are too few pixels in the small one."""
    truth = read_displacement(whole.run_folder.parent / "recording" / "truth.nc")
    measured = whole.measurement.displacement
    error = measured["displacement"].values - truth["displacement"].values
    static = [i for i, name in enumerate(measured["point"].values) if "abutment" in str(name)]
    ratio = error[:, static].std(axis=0) / np.median(measured["displacement_std"].values[:, static], axis=0)
    assert 0.4 < ratio.min() <= ratio.max() < 1.6


@pytest.mark.slow
def test_lens_files_of_pan_clips_tell_the_scale_without_a_range(whole, tmp_path):
    """The demonstration without ranges and lengths, with lenses as pan clips at 40 degrees know them."""
    recording = whole.run_folder.parent / "recording"
    session, rig = read_session(recording / "session.toml"), read_rig(recording / "cameras_true.toml")
    std, rng, views = np.array([1e-3, 0.5, 0.5, 1e-3]), np.random.default_rng(4), []
    for view, camera in zip(session.view, rig.cameras, strict=True):
        stated = replace(camera.perturbed(np.append(rng.normal(0, std), np.zeros(6))), cam_from_world=np.eye(3, 4))
        path = write_lens(
            tmp_path / f"{view.name}.toml", KnownLens(stated, np.diag(std**2)), clip=recording / "session.toml"
        )
        views.append(view.model_copy(update={"lens": Lens(file=path)}))
    site = session.site.model_copy(update={"range": (), "length": ()})
    measured = Measurement(session.model_copy(update={"view": tuple(views), "site": site}))
    before, found = whole.measurement.audit.scale, measured.audit.scale
    assert measured.audit.verdict == Verdict.FIT
    # A standard deviation of one percent; what is left is the pose that matches give.
    assert found.expanded < min(0.02, 0.6 * before.expanded)
    assert next(iter(before.shares)).startswith("focal")
    assert next(iter(found.shares)) == "matches"
    truth = read_displacement(recording / "truth.nc")["displacement"]
    for point in measured.displacement["point"].values:
        for axis in ("lateral", "vertical"):
            moved = truth.sel(point=point, axis=axis).values
            if np.ptp(moved) < 2:
                continue
            one = measured.displacement.sel(point=point, axis=axis)
            gain = float(np.polyfit(moved, one["displacement"].values, 1)[0])
            assert abs(gain - 1) < 3 * float(one["scale_std"]) + 0.002


def test_its_report_shows_both_first_frames_and_is_valid(demo):
    text = write_report(demo.run_folder, language="de")[0].read_text(encoding="utf-8")
    html5lib.HTMLParser(strict=True).parse(text)
    assert text.count('href="data:image/jpeg;base64,') == 2
    assert "Messbericht" in text
    assert len(text) < 5_000_000
    summary = read_summary(demo.run_folder)
    assert summary["session_hash"] in text


def test_tracks_of_files_give_the_same_displacement(demo, tmp_path):
    """Without gains by injected motion, which needs the tracker itself."""
    session, tracks = demo.measurement.session, demo.measurement.tracks
    files = dict(zip(tracks, write_movement(tmp_path, tracks), strict=True))
    with_tracker = session.method.model_copy(update={"injection": False})
    with_files = Method(**session.method.model_dump() | {"tracker": "file", "file": files, "injection": False})
    given = Measurement(session.model_copy(update={"method": with_tracker})).given(
        cameras=demo.measurement.cameras, tracks=tracks, frames=demo.measurement.frames
    )
    read = Measurement(session.model_copy(update={"method": with_files})).given(cameras=demo.measurement.cameras)
    difference = read.displacement["displacement"] - given.displacement["displacement"]
    assert float(np.abs(difference).max()) < 0.02
    assert (read.displacement["status"] == 0).equals(given.displacement["status"] == 0)
    assert read.displacement.attrs["tracker"] == "file"
