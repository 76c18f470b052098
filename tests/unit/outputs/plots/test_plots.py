import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement, make_tracks
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.outputs.plots import (
    About,
    draw_overview,
    file_stem,
    plot_displacement,
    plot_points,
    plot_spectrum,
    plot_trajectory,
    save_figures,
)
from vfm_sdm.outputs.plots.figures import _draw_displacement, _draw_points, _draw_trajectories

POINTS = ["1/2 span", "abutment"]


def make_example(frames=100):
    time_s = np.arange(frames) / 50
    shape = (frames, 2, 3)
    values = np.broadcast_to(np.sin(time_s)[:, None, None], shape) * np.array([1.0, 2.0, 3.0])
    status = np.zeros(shape[:2], int)
    status[10, 0], status[20, 0], status[30, 0], status[40, 0] = 1, 2, 3, 4
    values = np.where((np.isin(status, [1, 2, 4]))[..., None], np.nan, values)
    return make_displacement(
        time_s,
        POINTS,
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(shape, 0.25),
            scale_std=np.full((2, 3), 0.02),
            position_m=np.zeros(shape),
            reprojection_error_px=np.zeros(shape[:2]),
            status=status,
        ),
        attrs={"frame": "structure"},
    )


def make_track(frames=100, names=POINTS):
    position = np.tile([1000.0, 500.0], (frames, len(names), 1))
    position[:, 0, 0] += 0.1 * np.arange(frames)
    status = np.zeros((frames, len(names)), int)
    position[0, 0], status[0, 0] = np.nan, Status.LOST
    covariance = np.zeros((frames, len(names), 2, 2))
    return make_tracks(np.arange(frames) / 50, names, position, covariance, status, attrs={"view": "left"})


def lines_by_label(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def test_trajectory_is_relative_to_the_first_sample_found():
    axes = plot_trajectory(make_track(), point="1/2 span")
    lines = lines_by_label(axes)
    u, v = lines["u (right)"].get_ydata(), lines["v (down)"].get_ydata()
    assert np.isnan(u[0])
    np.testing.assert_allclose(u[1:], 0.1 * np.arange(99), atol=1e-9)
    np.testing.assert_allclose(v[1:], 0, atol=1e-9)
    np.testing.assert_array_equal(lines["lost"].get_xdata(), [0.0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "movement [px]")
    assert axes.get_title(loc="left") == "1/2 span"


def test_trajectory_of_a_point_never_found_is_empty():
    track = make_track(5)
    track["status"][:] = Status.LOST
    track["position"][:] = np.nan
    axes = plot_trajectory(track, point="1/2 span")
    assert np.isnan(lines_by_label(axes)["u (right)"].get_ydata()).all()
    assert lines_by_label(axes)["lost"].get_xdata().size == 5


def test_displacement_with_band_and_marks():
    data = make_example()
    axes = plot_displacement(data, point="1/2 span", axis="vertical")
    np.testing.assert_array_equal(axes.get_lines()[0].get_ydata(), data["displacement"].values[:, 0, 1])
    band = axes.collections[0].get_paths()[0].vertices
    # At time 0 the value is 0 and twice the standard deviation 0.5.
    assert sorted({round(y, 9) for x, y in band if x == 0}) == [-0.5, 0.5]
    marks = lines_by_label(axes)
    assert {name: float(marks[name].get_xdata()[0]) for name in ("lost", "outside", "unreliable", "behind camera")} == {
        "lost": 10 / 50,
        "outside": 20 / 50,
        "unreliable": 30 / 50,
        "behind camera": 40 / 50,
    }
    assert marks["unreliable"].get_ydata()[0] == data["displacement"].values[30, 0, 1]
    assert axes.get_ylabel() == "vertical [mm]"
    assert axes.get_title(loc="right") == "scale ± 4 % (k = 2)"


def test_the_band_is_the_expanded_uncertainty_where_there_is_one():
    data = make_example()
    assert band_of(plot_displacement(data, point="1/2 span", axis="vertical")) == ("± 2 std (random)", 0.5)
    expanded = np.full(data["displacement"].shape, 0.8)
    expanded[..., 1] = 1.7
    data["expanded_uncertainty"] = (("time", "point", "axis"), expanded, {"units": "mm"})
    assert band_of(plot_displacement(data, point="1/2 span", axis="vertical")) == ("expanded uncertainty (k = 2)", 1.7)


def band_of(axes):
    """Label of the band, and its half width at time 0, where the displacement is 0."""
    band = axes.collections[0]
    edges = {round(float(y), 9) for x, y in band.get_paths()[0].vertices if x == 0}
    assert len(edges) == 2
    assert sum(edges) == 0
    return band.get_label(), max(edges)


def test_unknown_scale_is_said():
    data = make_example()
    data["scale_std"][:] = np.nan
    axes = plot_displacement(data, point="abutment", axis="lateral")
    assert axes.get_title(loc="right") == "scale uncertainty not known"
    assert not {"lost", "unreliable"} & set(lines_by_label(axes))


def test_each_draws_into_the_axes_given():
    figure = Figure()
    panels = figure.subplots(3)
    assert plot_trajectory(make_track(), panels[0], point="abutment") is panels[0]
    assert plot_displacement(make_example(), panels[1], point="abutment", axis="lateral") is panels[1]
    assert plot_points(np.zeros((4, 4), np.uint8), np.zeros((1, 2)), ["a"], panels[2]) is panels[2]


def test_the_only_point_needs_no_name():
    single = make_track().sel(point=["abutment"])
    assert plot_trajectory(single).get_title(loc="left") == "abutment"


def test_long_recordings_are_drawn_with_few_corners_and_all_extremes():
    data = make_example(100_000)
    data["displacement"][54_321, 0, 0] = 77.0
    data["displacement"][12_345, 0, 0] = -66.0
    data["status"][:, 0] = Status.UNRELIABLE
    axes = plot_displacement(data, point="1/2 span", axis="lateral")
    line = axes.get_lines()[0]
    assert line.get_xdata().size < 10_000
    assert np.nanmax(line.get_ydata()) == 77.0
    assert np.nanmin(line.get_ydata()) == -66.0
    high = line.get_xdata()[np.nanargmax(line.get_ydata())]
    assert high == pytest.approx(54_321 / 50, abs=1.0)
    assert lines_by_label(axes)["unreliable"].get_xdata().size <= 2001
    assert axes.collections[0].get_paths()[0].vertices[:, 1].max() == pytest.approx(77.5)


def test_points_lie_at_their_full_image_pixels_on_a_smaller_picture():
    luma = np.zeros((2163, 3841), np.uint8)
    luma[1200:1206, 3000:3006] = 255
    axes = plot_points(luma, [[3002.5, 1202.5], [np.nan, np.nan]], ["a", "b"])
    image = axes.get_images()[0]
    drawn = image.get_array()
    assert drawn.shape == (721, 1280)  # blocks of three
    left, right, bottom, top = image.get_extent()
    row, column = np.argwhere(drawn > 200).mean(axis=0)
    assert left + (column + 0.5) * (right - left) / drawn.shape[1] == pytest.approx(3002.5)
    assert top + (row + 0.5) * (bottom - top) / drawn.shape[0] == pytest.approx(1202.5)
    assert axes.get_xlim() == (-0.5, 3840.5)
    assert axes.get_ylim() == (2162.5, -0.5)
    assert axes.get_xlabel() == "u [px]\nnot found here: b"
    assert [text.get_text() for text in axes.texts] == ["a"]


@pytest.mark.parametrize(
    ("image", "limits"),
    [
        (np.array([[10, 20], [30, 40]], np.uint8), (0, 255)),
        (np.array([[10, 20], [30, 1000]], np.uint16), (10, 1000)),
    ],
)
def test_grey_range_follows_the_bit_depth(image, limits):
    axes = plot_points(image, np.zeros((0, 2)), [])
    assert axes.get_images()[0].get_clim() == limits


def test_colour_frames_are_drawn_in_colour():
    axes = plot_points(np.full((2000, 4000, 3), 7, np.uint8), np.zeros((0, 2)), [])
    drawn = axes.get_images()[0].get_array()
    assert (drawn.shape, drawn.dtype) == ((666, 1333, 3), np.uint8)
    assert (drawn == 7).all()


def test_names_of_a_great_many_points_are_left_out():
    points = np.full((41, 2), 1.0)
    assert len(plot_points(np.zeros((4, 4), np.uint8), points, [str(i) for i in range(41)]).texts) == 0
    assert len(plot_points(np.zeros((4, 4), np.uint8), points[:40], [str(i) for i in range(40)]).texts) == 40


def test_misuse_is_refused():
    with pytest.raises(DatasetError, match=r"point: expected one of \['1/2 span', 'abutment'\], got None"):
        plot_trajectory(make_track())
    with pytest.raises(DatasetError, match=r"axis: expected one of .*, got 'Y'; name one of these"):
        plot_displacement(make_example(), point="abutment", axis="Y")
    with pytest.raises(DatasetError, match="position: expected dims"):
        plot_trajectory(make_example(), point="abutment")
    with pytest.raises(DatasetError, match="expected a variable 'displacement'"):
        plot_displacement(make_track(), point="abutment", axis="lateral")
    with pytest.raises(DatasetError, match=r"luma: expected shape \(H, W\) or \(H, W, 3\), got \(4,\)"):
        plot_points(np.zeros(4), np.zeros((0, 2)), [])
    with pytest.raises(DatasetError, match=r"points2d: expected shape \(1, 2\), got \(2, 2\)"):
        plot_points(np.zeros((4, 4), np.uint8), np.zeros((2, 2)), ["a"])
    with pytest.raises(DatasetError, match="view 'up': expected its first frame and its tracks"):
        save_figures("nowhere", {}, None, {}, {"up": np.zeros((1, 2))})


def test_figures_of_a_run(tmp_path):
    frame = np.zeros((90, 160), np.uint8)
    tracks = {"left": make_track(), "right/2": make_track()}
    points = {"left": np.full((2, 2), 50.0), "right/2": np.full((2, 2), 50.0)}
    before = dict(mpl.rcParams)
    paths = save_figures(tmp_path, tracks, make_example(), {"left": frame, "right/2": frame}, points)
    assert dict(mpl.rcParams) == before
    assert [path.relative_to(tmp_path).as_posix() for path in paths] == [
        "figures/trajectory_left.png",
        "figures/trajectory_right-2.png",
        "figures/displacement_1-2_span.png",
        "figures/displacement_abutment.png",
        "figures/points_left.png",
        "figures/points_right-2.png",
    ]
    for path in paths:
        with Image.open(path) as image:
            assert image.info["dpi"] == pytest.approx((150, 150), abs=0.1)
            assert image.width > 1400
            pixels = np.asarray(image.convert("L"))
        # Nothing runs over the edge of the sheet.
        assert (pixels[[0, -1]] == 255).all()
        assert (pixels[:, [0, -1]] == 255).all()
    assert len(list((tmp_path / "figures").iterdir())) == len(paths)


def test_without_displacement_there_are_no_figures_of_it(tmp_path):
    paths = save_figures(tmp_path, {"left": make_track()}, None, {}, {})
    assert [path.name for path in paths] == ["trajectory_left.png"]


def test_names_that_become_one_file_name_get_numbers(tmp_path):
    data = make_example().assign_coords(point=["1/2 span", "1-2 SPAN"])
    names = [path.name for path in save_figures(tmp_path, {}, data, {}, {})]
    assert names == ["displacement_1-2_span.png", "displacement_1-2_SPAN_2.png"]


def test_trajectories_of_many_points_show_the_first_twelve(tmp_path):
    track = make_track(5, [f"p{i}" for i in range(14)])
    (path,) = save_figures(tmp_path, {"left": track}, None, {}, {})
    with Image.open(path) as image:
        assert image.height == pytest.approx(150 * (1.7 + 12 * 1.7), abs=2)


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "figures").write_text("a file, no folder")
    with pytest.raises(
        ResultsError, match=r"trajectory_left.png: expected to write it, got: .*; choose another folder"
    ):
        save_figures(tmp_path, {"left": make_track()}, None, {}, {})


@pytest.mark.parametrize(
    ("name", "stem"),
    [("1/2 span", "1-2_span"), ("Süd 3", "Süd_3"), ("..", "unnamed"), ('a:b*"c', "a-b--c"), ("  x\ty ", "x_y")],
)
def test_file_stem(name, stem):
    assert file_stem(name) == stem
    assert Path(stem).name == stem


def test_pyplot_is_not_needed():
    code = "import sys, vfm_sdm.outputs.plots; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def texts_of(figure):
    found = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        found += [axes.get_title(loc) for loc in ("left", "center", "right")] + [axes.get_xlabel()]
    return found


def test_a_spectrum_shows_amplitudes_and_the_dominant_frequency():
    data = make_example(500)
    axes = plot_spectrum(data, point="abutment", axis="vertical")
    frequency_hz, amplitude = axes.get_lines()[0].get_data()
    assert frequency_hz[amplitude.argmax()] == pytest.approx(1 / (2 * np.pi), abs=0.11)
    assert amplitude.max() == pytest.approx(2.0, rel=0.15)  # the highest line may lie half a bin beside it
    steady = make_example(1000)
    steady["displacement"][:, 1, 1] = 0.7 * np.sin(2 * np.pi * 3.0 * steady["time"].values)
    axes = plot_spectrum(steady, point="abutment", axis="vertical")
    assert axes.get_lines()[0].get_ydata().max() == pytest.approx(0.7, rel=1e-3)
    assert axes.get_title(loc="right") == "3.00 Hz"


def test_a_spectrum_that_cannot_be_had_says_why():
    assert "too short" in plot_spectrum(make_example(90), point="abutment", axis="vertical").texts[0].get_text()


def test_figures_say_of_what_and_when_they_are():
    about = About("bridge $1", frozenset({"abutment"}), start="2026-05-04T12:30:00+02:00")
    found = texts_of(_draw_displacement(make_example(), "abutment", about))
    assert "displacement of abutment (static) (structure axes)" in found
    assert r"bridge \$1, 2026-05-04 12:30 UTC+02:00" in found
    assert "positive: down" in found
    assert "positive: away from the reference camera" in found
    assert "frequency [Hz]" in found
    assert "abutment (static)" in texts_of(_draw_trajectories("left", make_track(), about))
    assert About("bridge $1").line == "bridge $1, date not stated"


def test_static_points_are_blue():
    title = "points in view left, first frame"
    picture = np.zeros((90, 160), np.uint8)
    figure = _draw_points(
        picture, [[10.0, 20.0], [30.0, 40.0]], POINTS, About("bridge", frozenset({"abutment"})), title
    )
    circles = {tuple(line.get_xydata()[0]): line.get_markeredgecolor() for line in figure.axes[0].get_lines()}
    assert circles == {(10.0, 20.0): "#E69F00", (30.0, 40.0): "#0072B2"}
    assert [text.get_text() for text in figure.texts] == [f"{title}; blue: static", "bridge, date not stated"]


def many(points, frames=100):
    data = make_example(frames)
    wide = data.isel(point=np.zeros(points, int)).assign_coords(point=[f"p{number}" for number in range(points)])
    factors = np.linspace(1, 2, points)
    wide["displacement"] = wide["displacement"] * factors[:, None]
    return wide.assign(displacement=wide["displacement"].assign_attrs(units="mm"))


def test_many_points_have_overviews_in_place_of_figures(tmp_path):
    names = [path.name for path in save_figures(tmp_path, {}, many(21), {}, {})]
    assert names == [f"displacement_overview_{axis}.png" for axis in STRUCTURE_AXES]
    assert len(save_figures(tmp_path, {}, many(20), {}, {})) == 20


@pytest.mark.parametrize("frames", [100, 20_000])
def test_an_overview_shows_every_point(frames, tmp_path):
    """Peak-to-peak of sinusoids that grow from point to point, in the bars and in the colours of whole periods."""
    figure = draw_overview(many(30, frames), "vertical", About("bridge", frozenset({"p3"})))
    colours, bars, _ = figure.axes
    widths = np.array([bar.get_width() for bar in bars.patches])
    np.testing.assert_allclose(widths / widths[0], np.linspace(1, 2, 30))
    assert widths[0] == pytest.approx(2 * np.ptp(np.sin(np.arange(frames) / 50)), rel=0.01)
    shown = np.ma.filled(colours.get_images()[0].get_array(), np.nan)
    assert shown.shape[0] == 30
    assert shown.shape[1] <= 1500
    assert np.isnan(shown).any() == (frames == 100)  # a sample alone is lost in a column of many
    assert colours.get_position().y0 == bars.get_position().y0
    assert colours.get_position().y1 == bars.get_position().y1
    assert colours.get_yticklabels()[3].get_text() == "p3 (static)"
    figure.savefig(tmp_path / "overview.png")
    with Image.open(tmp_path / "overview.png") as image:
        pixels = np.asarray(image.convert("L"))
    assert (pixels[[0, -1]] == 255).all()
    assert (pixels[:, [0, -1]] == 255).all()
    assert (tmp_path / "overview.png").stat().st_size < 1e6
