import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial.transform import Rotation

from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, Status, make_displacement, make_tracks
from vfm_sdm.errors import DatasetError, ResultsError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame, structure_from_cam1
from vfm_sdm.outputs.plots.protocol import (
    SensitivityRecord,
    plot_camera_poses,
    plot_comparison,
    plot_displacement3d,
    plot_parity,
    plot_refinement,
    plot_sensitivity,
    plot_trajectories,
    save_figure,
)

POINTS = ["1/2 span", "1/4 span"]
TIME = np.arange(120) / 30
GAP = slice(40, 50)


def make_pair(seed=0):
    """Synchronised tracks of two views; the second point is lost for a while in the right view."""
    views = []
    for number, name in enumerate(("left", "right")):
        rng = np.random.default_rng(seed + number)
        position = 500 + rng.normal(0, 0.1 + number, (120, 2, 2))
        status = np.zeros((120, 2), int)
        if number:
            position[GAP, 1] = np.nan
            status[GAP, 1] = Status.LOST
            status[60, 1] = Status.UNRELIABLE
        covariance = np.zeros((120, 2, 2, 2))
        views.append(make_tracks(TIME, POINTS, position, covariance, status, attrs={"view": name}))
    return xr.concat(views, xr.Variable("view", ["left", "right"]), combine_attrs="drop_conflicts")


def make_motion(scale=1.0):
    values = scale * np.sin(2 * np.pi * TIME)[:, None, None] * np.array([[1.0, 4.0, 2.0]]) * np.array([[1.0], [1.5]])
    status = np.zeros((120, 2), int)
    values[GAP, 1] = np.nan
    status[GAP, 1] = Status.LOST
    return make_displacement(
        TIME,
        POINTS,
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.full(values.shape, 0.25),
            scale_std=np.full((2, 3), 0.02),
            position_m=np.zeros(values.shape),
            reprojection_error_px=np.zeros(status.shape),
            status=status,
        ),
        attrs={"frame": "structure"},
    )


def make_series():
    rng = np.random.default_rng(5)
    series = {}
    for axis, size in (("lateral", 1.0), ("vertical", 4.0)):  # not in the order of the panels
        truth = size * np.sin(9 * TIME)
        reference = truth.copy()
        reference[:20] = np.nan
        vision = 0.5 + 0.8 * truth + rng.normal(0, 0.1, 120)
        vision[GAP] = np.nan
        series[axis] = {"vision": vision, "reference": reference, "truth": truth, "vision_std": np.full(120, 0.1)}
    return series


def make_rig(yaw=-0.3, *, metric=True, scale=1.0):
    K = np.array([[1000.0, 0, 319.5], [0, 1000.0, 239.5], [0, 0, 1]])
    R = Rotation.from_euler("y", yaw).as_matrix().T
    second = np.column_stack([R, -R @ [4.0 * scale, 0.0, 0.0]])
    cameras = (Camera(K, (640, 480)), Camera(K, (640, 480), cam_from_world=second))
    return Rig(("left", "right"), cameras, metric)


def make_records():
    return [
        SensitivityRecord(parameter, value, method, axis, 0.01 * value * (1 + index))
        for parameter, values in (("blur [px]", (0.0, 1.0, 2.0)), ("amplitude [px]", (0.1, 1.0, 10.0)))
        for value in values
        for index, method in enumerate(("with refinement", "without refinement"))
        for axis in ("lateral", "vertical")
    ]


ALL = {
    "trajectories": lambda: plot_trajectories(make_pair(), point="1/4 span"),
    "refinement": lambda: plot_refinement(make_pair(), make_pair(7), view="right", point="1/4 span").figure,
    "displacement3d": lambda: plot_displacement3d(make_motion(), make_motion(0.5), point="1/4 span"),
    "comparison": lambda: plot_comparison(TIME, make_series(), title="data-2, 1/4 span"),
    "parity": lambda: plot_parity(make_series(), title="data-2, 1/4 span"),
    "poses": lambda: (
        plot_camera_poses(
            {"true": make_rig(), "two-view": make_rig(-0.2)},
            frame=StructureFrame(structure_from_cam1(0.4)),
            points3d=[[4.0, 0.2, 8.0], [2.0, 0.2, 22.0], [0.0, 0.2, 36.0]],
            title="data-2",
        ).figure
    ),
    "sensitivity": lambda: plot_sensitivity(make_records(), log=["amplitude [px]"]),
}


def lines_by_label(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def legend_labels(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("name", ALL)
def test_equal_data_give_equal_bytes_and_nothing_is_cut_off(name, tmp_path):
    before = dict(mpl.rcParams)
    figure = ALL[name]()
    first = save_figure(tmp_path / "figures" / "first.png", figure)
    second = save_figure(tmp_path / "figures" / "second.png", ALL[name]())
    assert dict(mpl.rcParams) == before
    assert first.read_bytes() == second.read_bytes()
    assert sorted(path.name for path in first.parent.iterdir()) == ["first.png", "second.png"]
    with Image.open(first) as image:
        assert image.width == 1380  # the text of an A4 page at 200 dpi
        assert "Software" not in image.info
        pixels = np.asarray(image.convert("L"))
    assert (pixels[[0, -1]] == 255).all()
    assert (pixels[:, [0, -1]] == 255).all()
    assert (pixels < 128).mean() > 0.002


def test_trajectories_of_both_views():
    tracks = make_pair()
    panels = plot_trajectories(tracks, point="1/4 span").axes
    assert [panel.get_title(loc="left") for panel in panels] == ["1/4 span, view left", "1/4 span, view right"]
    assert [panel.get_xlabel() for panel in panels] == ["", "time [s]"]
    assert {panel.get_ylabel() for panel in panels} == {"movement [px]"}
    assert panels[0].get_ylim() == panels[1].get_ylim()
    for panel, view in zip(panels, ("left", "right"), strict=True):
        position = tracks["position"].sel(view=view, point="1/4 span").values
        for label, values in zip(("u (right)", "v (down)"), position.T, strict=True):
            np.testing.assert_array_equal(lines_by_label(panel)[label].get_ydata(), values - values[0])
    assert np.isnan(lines_by_label(panels[1])["u (right)"].get_ydata()[GAP]).all()
    assert legend_labels(panels[0].figure) == ["u (right)", "v (down)", "unreliable", "lost"]


def test_refinement_shows_both_relative_to_the_same_sample():
    before, after = make_pair(), make_pair(7)
    before["status"][:, 0, 1] = Status.UNRELIABLE
    axes = plot_refinement(before, after, view="right", point="1/4 span")
    lines = lines_by_label(axes)
    origin = before["position"].values[1, 1, 1, 0]
    for tracks, label in ((before, "before refinement"), (after, "after refinement")):
        np.testing.assert_array_equal(lines[label].get_ydata(), tracks["position"].values[1, :, 1, 0] - origin)
        assert np.isnan(lines[label].get_ydata()[GAP]).all()
    assert lines["lost"].get_xdata().tolist() == TIME[GAP].tolist()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "u (right) [px]")
    assert axes.get_title(loc="left") == "1/4 span, view right"


def test_refinement_of_a_point_never_found_is_empty():
    tracks = make_pair()
    tracks["status"][:] = Status.LOST
    tracks["position"][:] = np.nan
    axes = plot_refinement(tracks, tracks, view="left", point="1/2 span")
    assert np.isnan(lines_by_label(axes)["after refinement"].get_ydata()).all()


def test_displacement_before_and_after_refinement():
    data = (make_motion(), make_motion(0.5))
    panels = plot_displacement3d(*data, point="1/4 span").axes
    titles = [panel.get_title(loc="left") for panel in panels]
    assert titles == ["(a) 1/4 span, before refinement", "(b) 1/4 span, after refinement"]
    for panel, displacement in zip(panels, data, strict=True):
        for axis, label in zip(STRUCTURE_AXES, ("lateral", "vertical (positive down)", "longitudinal"), strict=True):
            expected = displacement["displacement"].sel(point="1/4 span", axis=axis).values
            np.testing.assert_array_equal(lines_by_label(panel)[label].get_ydata(), expected)
        assert panel.get_ylabel() == "displacement [mm]"
    assert panels[0].get_ylim() == panels[1].get_ylim()
    assert panels[1].get_xlabel() == "time [s]"
    assert legend_labels(panels[0].figure) == ["lateral", "vertical (positive down)", "longitudinal", "lost"]


def test_comparison_has_vertical_above_lateral_with_a_band():
    series = make_series()
    figure = plot_comparison(TIME, series, title="data-2")
    upper, lower = figure.axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("vertical [mm]\npositive down", "lateral [mm]\n")
    assert (upper.get_title(loc="left"), lower.get_xlabel()) == ("data-2", "time [s]")
    for panel, axis in ((upper, "vertical"), (lower, "lateral")):
        lines = lines_by_label(panel)
        assert list(lines) == ["reference", "truth", "vision"]
        for name, line in lines.items():
            np.testing.assert_array_equal(line.get_xdata(), TIME)
            np.testing.assert_array_equal(line.get_ydata(), series[axis][name])
        band = panel.collections[0].get_paths()[0].vertices
        ends = sorted({y for x, y in band if x == TIME[5]})
        np.testing.assert_allclose(ends, series[axis]["vision"][5] + np.array([-0.2, 0.2]))
        assert len(panel.collections[0].get_paths()) == 2  # the gap parts the band
    assert legend_labels(figure) == ["vision ± 2 std", "reference", "truth", "vision"]


def test_comparison_needs_neither_truth_nor_band():
    series = {"vertical": {"vision": np.zeros(120), "reference": np.ones(120)}}
    (panel,) = plot_comparison(TIME, series).axes
    assert list(lines_by_label(panel)) == ["reference", "vision"]
    assert not panel.collections


@pytest.mark.parametrize("against", ["reference", "truth"])
def test_parity_agrees_with_an_independent_regression(against):
    series = make_series()
    left, right = plot_parity(series, against=against).axes
    for panel, axis in ((left, "vertical"), (right, "lateral")):
        vision, reference = series[axis]["vision"], series[axis][against]
        known = np.isfinite(vision) & np.isfinite(reference)
        lines = lines_by_label(panel)
        np.testing.assert_array_equal(lines["samples"].get_xydata(), np.column_stack([reference, vision])[known])
        slope, intercept = np.polyfit(reference[known], vision[known], 1)
        x = np.array([reference[known].min(), reference[known].max()])
        np.testing.assert_allclose(lines["regression"].get_xydata(), np.column_stack([x, intercept + slope * x]))
        np.testing.assert_array_equal(lines["1:1"].get_xdata(), lines["1:1"].get_ydata())
        R = np.corrcoef(reference[known], vision[known])[0, 1]
        assert panel.get_title() == f"{axis}: R = {R:.3f}, slope {slope:.2f}"
        assert panel.get_xlim() == panel.get_ylim()
        assert panel.get_aspect() == 1.0
        assert (panel.get_xlabel(), panel.get_ylabel()) == (f"{against}, {axis} [mm]", f"vision, {axis} [mm]")


def drawn_points(axes, label):
    return np.column_stack(lines_by_label(axes)[label].get_data_3d())


def test_cameras_stand_where_they_are_in_the_structure_with_down_below():
    rotation = structure_from_cam1(0.6, pitch_rad=0.1)
    points = np.array([[0.5, 0.2, 12.0], [np.nan, 0, 0], [-0.5, 0.1, 14.0]])
    axes = plot_camera_poses({"true": make_rig()}, frame=StructureFrame(rotation), points3d=points, title="data-2")
    centres = [line.get_data_3d() for line in axes.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(np.ravel(centres[1]), (rotation @ [4.0, 0, 0])[[0, 2, 1]], atol=1e-12)
    np.testing.assert_allclose(drawn_points(axes, "points"), (points[[0, 2]] @ rotation.T)[:, [0, 2, 1]])
    labels = axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()
    assert labels == ("lateral (away) [m]", "longitudinal [m]", "vertical (down) [m]")
    bottom, top = axes.get_zlim()
    assert bottom > top
    # Equal units along all axes.
    spans = np.abs(np.diff([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])).ravel()
    np.testing.assert_allclose(spans / spans[0], np.asarray(axes._box_aspect) / axes._box_aspect[0])
    assert [text.get_text().strip() for text in axes.texts] == ["left", "right"]


def test_pyramids_pass_through_the_image_corners():
    rig = make_rig()
    axes = plot_camera_poses({"true": rig})
    pyramids = [np.column_stack(line.get_data_3d()) for line in axes.get_lines() if line.get_marker() == "None"]
    for camera, stroke in zip(rig.cameras, pyramids, strict=True):
        corners = stroke[~np.isclose(stroke[:, [0, 2, 1]], camera.center).all(axis=1)][:, [0, 2, 1]]
        pixels = {tuple(np.round(pixel, 6)) for pixel in camera.project(corners)}
        assert pixels == {(-0.5, -0.5), (639.5, -0.5), (639.5, 479.5), (-0.5, 479.5)}
        np.testing.assert_allclose((corners @ camera.rotation.T + camera.translation)[:, 2], rig.baseline())
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == ("right [m]", "forward [m]", "down [m]")


def test_rigs_without_scale_get_the_baseline_of_a_metric_one():
    rigs = {"two-view": make_rig(metric=False, scale=0.25), "true": make_rig()}
    axes = plot_camera_poses(rigs, points3d=[[0.0, 0.0, 2.5]])
    centres = [np.ravel(line.get_data_3d()) for line in axes.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(centres[1], [4.0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(centres[3], [4.0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(drawn_points(axes, "points"), [[0, 10.0, 0]])
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts == ["points", "two-view (scale aligned)", "true"]
    colours = {lines_by_label(axes)[label].get_color() for label in texts}
    assert len(colours) == 3


def test_without_any_scale_lengths_are_baselines():
    axes = plot_camera_poses({"a": make_rig(metric=False), "b": make_rig(metric=False, scale=3.0)})
    centres = [np.ravel(line.get_data_3d()) for line in axes.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(centres[1], [1.0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(centres[3], [1.0, 0, 0], atol=1e-12)
    assert axes.get_xlabel() == "right [baselines]"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b"]


def test_sensitivity_has_a_panel_a_parameter_and_a_line_an_axis_and_method():
    figure = plot_sensitivity([tuple(record) for record in make_records()], log=["amplitude [px]"])
    first, second = figure.axes
    assert (first.get_xlabel(), second.get_xlabel()) == ("blur [px]", "amplitude [px]")
    assert (first.get_xscale(), second.get_xscale()) == ("linear", "log")
    assert first.get_ylabel() == "NRMSE [1]"
    assert first.get_ylim()[0] == 0
    lines = lines_by_label(first)
    assert len(lines) == 4
    np.testing.assert_allclose(lines["lateral, without refinement"].get_xydata(), [[0, 0], [1, 0.02], [2, 0.04]])
    np.testing.assert_allclose(lines["lateral, with refinement"].get_xydata(), [[0, 0], [1, 0.01], [2, 0.02]])
    assert lines["vertical, with refinement"].get_color() == lines["vertical, without refinement"].get_color()
    assert lines["vertical, with refinement"].get_color() != lines["lateral, with refinement"].get_color()
    assert lines["vertical, with refinement"].get_linestyle() != lines["vertical, without refinement"].get_linestyle()


def test_sensitivity_of_several_cases_is_their_mean_and_a_failure_breaks_the_line():
    errors = {1.0: (0.1, 0.3), 2.0: (0.2, np.nan), 3.0: (0.4, 0.6)}
    records = [("noise [1]", value, "sgr", "vertical", nrmse) for value, both in errors.items() for nrmse in both]
    (panel,) = plot_sensitivity(reversed(records)).axes
    mean, dots, missing = panel.get_lines()
    np.testing.assert_allclose(mean.get_xydata(), [[1, 0.2], [2, np.nan], [3, 0.5]])
    assert dots.get_xdata().size == 6
    assert (missing.get_label(), missing.get_xdata().tolist()) == ("no result", [2.0])


def test_four_parameters_take_two_rows():
    records = [(f"p{i}", 1.0, "sgr", "other axis", 0.1) for i in range(4)]
    figure = plot_sensitivity(records)
    assert [axes.get_xlabel() for axes in figure.axes if axes.axison] == ["p0", "p1", "p2", "p3"]
    assert [axes.get_ylabel() for axes in figure.axes if axes.axison] == ["NRMSE [1]", "", "", "NRMSE [1]"]


def test_single_panels_draw_into_the_axes_given():
    flat = Figure().add_subplot()
    assert plot_refinement(make_pair(), make_pair(7), flat, view="left", point="1/2 span") is flat
    solid = Figure().add_subplot(projection="3d")
    assert plot_camera_poses({"true": make_rig()}, solid) is solid


def test_unknown_names_and_other_datasets_are_refused():
    tracks, motion = make_pair(), make_motion()
    with pytest.raises(DatasetError, match=r"point: expected one of .*, got 'x'"):
        plot_trajectories(tracks, point="x")
    with pytest.raises(DatasetError, match=r"position: expected dims .*'view'"):
        plot_trajectories(tracks.sel(view="left"), point="1/2 span")
    with pytest.raises(DatasetError, match=r"view: expected one of \['left', 'right'\], got 'up'"):
        plot_refinement(tracks, tracks, view="up", point="1/2 span")
    with pytest.raises(DatasetError, match=r"point: expected one of \['1/2 span'\], got '1/4 span'"):
        plot_refinement(tracks, tracks.sel(point=["1/2 span"]), view="left", point="1/4 span")
    with pytest.raises(DatasetError, match=r"point: expected one of .*, got None"):
        plot_displacement3d(motion, motion)
    with pytest.raises(DatasetError, match="expected a variable 'displacement'"):
        plot_displacement3d(motion, tracks, point="1/2 span")


def test_series_that_do_not_fit_are_refused():
    zeros = np.zeros(120)
    with pytest.raises(DatasetError, match="series: expected at least one axis, got none"):
        plot_comparison(TIME, {})
    with pytest.raises(DatasetError, match=r"series of 'lateral': expected \['vision'\].*got \['reference'\]"):
        plot_comparison(TIME, {"lateral": {"reference": zeros}})
    with pytest.raises(DatasetError, match=r"no others than .*got \['laser', 'vision'\]; rename them"):
        plot_comparison(TIME, {"lateral": {"vision": zeros, "laser": zeros}})
    with pytest.raises(DatasetError, match=r"reference: expected shape \(120\), got \(3,\)"):
        plot_comparison(TIME, {"lateral": {"vision": zeros, "reference": zeros[:3]}})
    with pytest.raises(DatasetError, match=r"expected \['vision', 'truth'\], .*got \['vision'\]"):
        plot_parity({"lateral": {"vision": zeros}}, against="truth")
    with pytest.raises(DatasetError, match="expected a signal that moves"):
        plot_parity({"lateral": {"vision": TIME, "reference": zeros}})


def test_rigs_that_cannot_be_drawn_are_refused():
    with pytest.raises(DatasetError, match="rigs: expected at least one, got none"):
        plot_camera_poses({})
    one = Rig(("left",), make_rig().cameras[:1])
    with pytest.raises(DatasetError, match="rig 'x': expected two cameras at a distance"):
        plot_camera_poses({"x": one})
    with pytest.raises(DatasetError, match="rig 'x': expected two cameras at a distance"):
        plot_camera_poses({"x": make_rig(scale=0.0)})
    with pytest.raises(DatasetError, match="ax: expected three-dimensional axes"):
        plot_camera_poses({"x": make_rig()}, Figure().add_subplot())
    with pytest.raises(DatasetError, match=r"points3d: expected shape \(any, 3\)"):
        plot_camera_poses({"x": make_rig()}, points3d=np.zeros((4, 2)))


def test_records_that_cannot_be_drawn_are_refused():
    with pytest.raises(DatasetError, match="records: expected at least one"):
        plot_sensitivity([])
    with pytest.raises(DatasetError, match=r"log: expected names out of \['blur \[px\]', .*got \['noise'\]"):
        plot_sensitivity(make_records(), log=["noise"])
    with pytest.raises(DatasetError, match=r"blur \[px\]: expected finite values, above 0 on a log.*, got 0.0"):
        plot_sensitivity(make_records(), log=["blur [px]"])
    with pytest.raises(DatasetError, match=r"p: expected finite values.*got inf"):
        plot_sensitivity([("p", np.inf, "sgr", "vertical", 0.1)])


def test_figures_that_cannot_be_saved_are_named(tmp_path):
    with pytest.raises(ResultsError, match=r"a.pdf: expected a name that ends in .png, got '.pdf'"):
        save_figure(tmp_path / "a.pdf", Figure())
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(ResultsError, match=r"a.png: expected to write it, got: .*; choose another folder"):
        save_figure(tmp_path / "file" / "a.png", Figure())


def test_pyplot_is_not_needed():
    code = "import sys, vfm_sdm.outputs.plots.protocol; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
