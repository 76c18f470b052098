import av
import numpy as np
import pytest
import xarray as xr
from rendered_scenes import register

from vfm_sdm.core.datasets import check_displacement
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import read_session
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_demo
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite
from vfm_sdm.studies.synthetic.motion import modal_displacement

FILES = {"left.mp4", "right.mp4", "session.toml", "truth.nc", "cameras_true.toml"}
SMALL = FootbridgeSite(image_size=(640, 360))


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A demo of 1 s and half the size, and what was reported while it was made."""
    steps = []
    path = make_demo(
        tmp_path_factory.mktemp("demo"), seed=5, duration_s=1.0, site=SMALL, progress=lambda *step: steps.append(step)
    )
    return path, steps


@pytest.fixture(scope="module")
def truth(demo):
    with xr.open_dataset(demo[0].parent / "truth.nc", engine="h5netcdf") as dataset:
        return dataset.load()


def frames(path):
    with av.open(str(path)) as container:
        decoded = [(float(f.pts * f.time_base), f.to_ndarray()[: f.height]) for f in container.decode(video=0)]
    return np.array([time for time, _ in decoded]), [luma.astype(float) for _, luma in decoded]


def test_demo_is_a_session_folder_with_truth(demo, truth):
    path, steps = demo
    assert {file.name for file in path.parent.iterdir()} == FILES
    session = read_session(path)
    assert [view.name for view in session.view] == ["left", "right"]
    assert [point.name for point in session.point] == list(truth["point"].values)
    assert sum(not point.static for point in session.point) == 4
    assert 1 <= sum(point.static for point in session.point) <= 2
    assert steps == [("filming synthetic footbridge", k, 60) for k in range(1, 61)]


def test_clock_of_the_videos_is_the_clock_of_the_truth(demo, truth):
    for name in ("left", "right"):
        time_s, images = frames(demo[0].with_name(f"{name}.mp4"))
        assert images[0].shape == (360, 640)
        np.testing.assert_array_equal(time_s, truth["time"].values)


def test_truth_is_exact_and_along_the_axes_of_the_structure(truth):
    check_displacement(truth)
    assert list(truth["axis"].values) == ["lateral", "vertical", "longitudinal"]
    assert truth.attrs["frame"] == "structure"
    for name in ("displacement_std", "scale_std", "reprojection_error", "status"):
        assert np.all(truth[name].values == 0), name
    rest = np.array([point.position for point in demo_plan(site=SMALL).points])
    np.testing.assert_allclose(truth["position"] - 1e-3 * truth["displacement"].values, [rest] * 30, atol=1e-12)
    expected = 1e3 * modal_displacement(truth["time"].values, rest[:4], motion=demo_plan(site=SMALL).motion)
    np.testing.assert_allclose(truth["displacement"].values[:, :4], expected, atol=1e-12)
    moved = np.abs(truth["displacement"]).max("time").values
    assert np.all(moved[4:] == 0)
    assert np.all(moved[:4, 1] > 1.5)
    assert np.all(truth["displacement"].values[truth["time"].values <= 0.4] == 0)


def test_videos_show_the_motion_of_the_truth(demo, truth):
    for name, camera in zip(("left", "right"), SMALL.cameras(), strict=True):
        _, images = frames(demo[0].with_name(f"{name}.mp4"))
        pixels = camera.project(truth["position"].values)
        error = [
            register(images[0], images[k], pixels[0, p]) - (pixels[k, p] - pixels[0, p])
            for k in range(14, 30, 3)
            for p in range(4)
        ]
        # Sensor noise and compression of both frames.
        assert np.sqrt(np.mean(np.square(error))) < 0.03
        assert np.abs(np.mean(error, axis=0)).max() < 0.015


def test_points_are_placed_where_the_reference_camera_sees_them(demo):
    reference = SMALL.cameras()[0]
    for given, point in zip(read_session(demo[0]).point, demo_plan(site=SMALL).points, strict=True):
        assert (given.view, given.static) == ("left", point.static)
        np.testing.assert_allclose(given.pixel, reference.project(point.position), atol=6e-4)


def test_lengths_in_the_session_have_errors_of_the_size_that_they_state(tmp_path):
    exact = {
        "baseline": float(np.linalg.norm(SMALL.further[0].center)),
        "perpendicular_distance": SMALL.perpendicular_m,
        "longitudinal_distance": SMALL.longitudinal_m,
    }
    ranged = float(np.linalg.norm(demo_plan(site=SMALL).points[1].position))
    tiny = FootbridgeSite(image_size=(160, 90))
    shares = []
    for seed in range(3):
        session = read_session(make_demo(tmp_path / str(seed), seed=seed, duration_s=0.5, site=tiny))
        for name, value in exact.items():
            measured = getattr(session.site, name)
            shares.append((measured.value - value) / measured.std)
        shares.append((session.site.range[0].value - ranged) / session.site.range[0].std)
        shares.append(session.site.reference_camera_level.value_deg / session.site.reference_camera_level.std_deg)
        for view, camera in zip(session.view, tiny.cameras(), strict=True):
            assert view.lens.relative_std == 0.02
            error = view.lens.focal_prior_px(160) / camera.focal_px - 1
            assert abs(error) < 0.021
            shares.append(error / 0.01)
    assert np.abs(shares).max() <= 2.2
    assert 0.5 < np.std(shares) < 1.4


def test_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path):
    tiny = FootbridgeSite(image_size=(160, 90))
    first, again, other = (
        make_demo(tmp_path / name, seed=seed, duration_s=0.5, site=tiny).parent
        for name, seed in (("first", 5), ("again", 5), ("other", 6))
    )
    for name in FILES:
        assert (first / name).read_bytes() == (again / name).read_bytes(), name
        if name != "cameras_true.toml":  # cameras are where the site says, whatever the seed
            assert (first / name).read_bytes() != (other / name).read_bytes(), name


def test_an_earlier_demo_is_replaced_and_a_cut_short_one_is_no_session(tmp_path):
    tiny = FootbridgeSite(image_size=(160, 90))
    path = make_demo(tmp_path, seed=1, duration_s=0.5, site=tiny)
    before = path.read_bytes()

    def stop(what, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_demo(tmp_path, seed=2, duration_s=0.5, site=tiny, progress=stop)
    assert not path.exists()
    make_demo(tmp_path, seed=1, duration_s=0.5, site=tiny)
    assert path.read_bytes() == before
    assert {file.name for file in tmp_path.iterdir()} == FILES


def test_a_folder_with_someone_elses_recording_is_left_alone(tmp_path):
    (tmp_path / "left.mp4").write_bytes(b"mine")
    with pytest.raises(ResultsError, match=r"expected a new folder or an earlier demo, got \['left\.mp4'\]"):
        make_demo(tmp_path)
    assert (tmp_path / "left.mp4").read_bytes() == b"mine"


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="expected a folder to write to"):
        make_demo(tmp_path / "file" / "demo")


def test_a_truth_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "truth.nc").mkdir()
    with pytest.raises(ResultsError, match=r"truth\.nc: expected to write it, got: "):
        make_demo(tmp_path)


@pytest.mark.parametrize("duration_s", [0.3, -1.0, float("nan")])
def test_a_recording_that_is_too_short_is_refused(tmp_path, duration_s):
    with pytest.raises(SessionError, match=r"duration_s: expected at least 0\.5 s"):
        make_demo(tmp_path / "demo", duration_s=duration_s)
    assert not (tmp_path / "demo").exists()
