"""The budget against simulated measurements whose errors are known, on a site like the paper's."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from intervals import TOO_NARROW, TOO_WIDE, objections
from simulation import intrinsics, looking_at
from stated_tracks import stated_tracks
from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.core.datasets import Status
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.geometry.structure_frame import StructureFrame
from vfm_sdm.stages.displacement.agreement import compute_gain_difference
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.displacement.uncertainty import (
    COMPONENTS,
    COVERAGE_FACTOR,
    BudgetInputs,
    add_uncertainty,
    compression_gain_std,
)
from vfm_sdm.stages.refinement import refine

FPS = 60.0
STILL_S = (0.0, 0.5)
CLOCK = np.arange(300) / FPS
VIEWS = ("left", "right")
POINTS = np.array([[9.8, 0.0, 22.4], [9.8, -0.4, 20.5], [9.8, 0.3, 24.5]])
AMPLITUDE_MM = (3.0, 6.0, 0.0)
"""Lateral, vertical and longitudinal: half of the peak to peak."""

CAMERAS = tuple(
    Camera(intrinsics(15500.0), (3840, 2160), np.zeros(5), looking_at(center, POINTS[0]))
    for center in (np.zeros(3), np.array([2.7, -0.1, -2.95]))
)
RIG = Rig.from_world(VIEWS, CAMERAS, metric=True)
FRAME = StructureFrame(CAMERAS[0].rotation.T)

# Focal length, principal point, k1, rotation, position of each camera; then the axes. The first camera is the origin.
_INNER_STD = [0.005, 5.0, 5.0, 0.0]
PARAMETER_STD = np.array([*_INNER_STD, *[0.0] * 6, *_INNER_STD, *[3e-4] * 3, *[0.01] * 3, *[0.003] * 3])
COVARIANCE = np.diag(PARAMETER_STD**2)


def motion_mm(time_s: FloatArray, amplitude_mm: tuple[float, float, float] = AMPLITUDE_MM) -> FloatArray:
    """Along lateral, vertical, longitudinal, shape (T, 3); at rest during the still interval."""
    moving = np.clip((time_s - STILL_S[1]) / 0.5, 0.0, 1.0)[:, None]
    wave = np.sin(2 * np.pi * np.outer(time_s - STILL_S[1], [1.6, 2.3, 2.9]) + [0.0, 0.0, 0.6])
    return np.asarray(amplitude_mm) * moving**2 * (3 - 2 * moving) * wave


def pixels(
    *, time_s: FloatArray = CLOCK, late_s: float = 0.0, amplitude_mm: tuple[float, float, float] = AMPLITUDE_MM
) -> FloatArray:
    """Exact pixels, shape (V, T, P, 2); the second view looks ``late_s`` later than it says."""
    views = []
    for camera, late in zip(CAMERAS, (0.0, late_s), strict=True):
        views.append(camera.project(POINTS + motion_mm(time_s + late, amplitude_mm)[:, None] / 1e3))
    return np.stack(views)


def tracks_of(
    position: FloatArray,
    *,
    covariance: FloatArray | None = None,
    rng: np.random.Generator | None = None,
    time_s: FloatArray = CLOCK,
) -> xr.Dataset:
    """Synchronised tracks with white noise of a covariance (V, 2, 2) [px2], drawn where there is a generator."""
    stated = np.zeros((2, 2, 2)) if covariance is None else covariance
    views = []
    for view, moved in enumerate(position):
        noise = 0.0 if rng is None else rng.multivariate_normal([0, 0], stated[view], moved.shape[:2])
        views.append(stated_tracks(moved + noise, stated[view], time_s))
    return xr.concat(views, dim="view").assign_coords(view=list(VIEWS)).transpose("view", ...)


def white(*std_px: float) -> FloatArray:
    """Covariance of equal noise along u and v, for each view."""
    return np.stack([std**2 * np.eye(2) for std in std_px])


def measured(
    tracks: xr.Dataset,
    rig: Rig = RIG,
    frame: StructureFrame = FRAME,
    *,
    covariance: FloatArray | None = COVARIANCE,
    refinement_gain: FloatArray | None = None,
) -> xr.Dataset:
    return compute_displacement(
        tracks,
        rig,
        frame=frame,
        covariance=covariance,
        refinement_gain=refinement_gain,
        still_interval_s=STILL_S,
    )


def part(budget: xr.Dataset, component: str) -> FloatArray:
    """One component, shape (T, P, 3) [mm]."""
    return budget["uncertainty"].sel(component=component).values


def refined(
    before: xr.Dataset, tracks: xr.Dataset, rig: Rig = RIG, frame: StructureFrame = FRAME, **known: object
) -> xr.Dataset:
    """The measurement with structural geometry refinement, and its budget, from the one without."""
    refinement = refine(tracks, rig, frame, still_interval_s=STILL_S)
    assert set(refinement.status) == {"ok"}
    after = measured(refinement.tracks, rig, frame, refinement_gain=refinement.gain)
    return add_uncertainty(
        after,
        BudgetInputs(tracks, baseline=(before, "longitudinal"), refinement_gain=refinement.gain, **known),
    )


def wrong_site(rng: np.random.Generator) -> tuple[Rig, StructureFrame]:
    """Cameras and axes with errors drawn from the stated covariance."""
    step = rng.normal(0, PARAMETER_STD)
    return RIG.perturbed(step[:20]), StructureFrame(Rotation.from_rotvec(step[20:]).as_matrix() @ FRAME.rotation)


def test_combined_is_the_root_of_the_sum_of_squares():
    tracks = tracks_of(pixels(), covariance=white(0.02, 0.03), rng=np.random.default_rng(0))
    inputs = BudgetInputs(tracks, clock_std_s={"right": 5e-4}, bits_per_pixel={"left": 2.81, "right": 0.31})
    before = measured(tracks)
    budget = add_uncertainty(before, inputs)
    parts = budget["uncertainty"]
    assert tuple(parts["component"].values) == COMPONENTS
    assert parts.dims == ("component", "time", "point", "axis")
    assert COMPONENTS == ("random", "cameras", "synchronization", "assumption", "compression", "subset", "origin")
    total = np.sqrt(sum(part(budget, name) ** 2 for name in COMPONENTS))
    np.testing.assert_allclose(budget["combined_std"], total, rtol=1e-12)
    np.testing.assert_allclose(budget["expanded_uncertainty"], 2 * total, rtol=1e-12)
    assert COVERAGE_FACTOR == budget["expanded_uncertainty"].attrs["coverage_factor"] == 2.0
    assert {budget[name].attrs["units"] for name in ("uncertainty", "combined_std", "expanded_uncertainty")} == {"mm"}
    # The poorest of the recordings counts, and nothing was assumed.
    np.testing.assert_allclose(part(budget, "compression"), 0.012 * np.abs(before["displacement"].values), rtol=1e-12)
    np.testing.assert_array_equal(part(budget, "random"), before["displacement_std"].values)
    np.testing.assert_array_equal(part(budget, "assumption"), 0.0)
    xr.testing.assert_identical(budget.drop_vars([*set(budget.variables) - set(before.variables)]), before)


def test_what_is_proportional_to_motion_is_nothing_at_rest():
    tracks = tracks_of(pixels())
    inputs = BudgetInputs(tracks, clock_std_s={"right": 5e-4}, bits_per_pixel={"left": 0.31})
    budget = add_uncertainty(measured(tracks), inputs)
    rest = slice(0, 28)
    for name in ("cameras", "synchronization", "compression"):
        assert np.abs(part(budget, name)[rest]).max() < 1e-6
        assert part(budget, name)[..., 1].max() > 0.01
    assert budget["expanded_uncertainty"].values[rest].max() < 1e-6


def test_cameras_are_the_scatter_over_wrong_cameras_and_axes():
    tracks = tracks_of(pixels())
    exact = add_uncertainty(measured(tracks), BudgetInputs(tracks))
    top = int(np.abs(exact["displacement"].values[:, 0, :2]).sum(axis=-1).argmax())
    ends = tracks.isel(time=[0, top])
    rng = np.random.default_rng(1)
    draws = [
        compute_displacement(ends, rig, frame=frame)["displacement"].values[1]
        for rig, frame in (wrong_site(rng) for _ in range(150))
    ]
    np.testing.assert_allclose(part(exact, "cameras")[top], np.std(draws, axis=0), rtol=0.2)


def test_cameras_of_unknown_covariance_leave_the_whole_unknown():
    tracks = tracks_of(pixels(), covariance=white(0.02, 0.02))
    budget = add_uncertainty(measured(tracks, covariance=None), BudgetInputs(tracks))
    assert np.isnan(part(budget, "cameras")).all()
    assert np.isnan(budget["combined_std"].values).all()
    assert np.isfinite(part(budget, "random")).all()


def test_synchronization_is_the_error_of_a_late_view():
    tau = 5e-4
    late = tracks_of(pixels(late_s=tau))
    budget = add_uncertainty(measured(late), BudgetInputs(late, clock_std_s={"right": tau}))
    error = np.abs(measured(late)["displacement"].values - measured(tracks_of(pixels()))["displacement"].values)
    stated = part(budget, "synchronization")
    for axis in range(3):
        assert error[..., axis].max() > 0.005
        np.testing.assert_allclose(stated[..., axis], error[..., axis], atol=0.05 * error[..., axis].max())
    both = add_uncertainty(measured(late), BudgetInputs(late, clock_std_s={"right": tau, "left": tau}))
    assert (part(both, "synchronization") >= stated).all()
    assert part(both, "synchronization").max() > 1.1 * stated.max()


def test_a_gap_hides_no_error_of_the_clock():
    tracks = tracks_of(pixels())
    whole = part(add_uncertainty(measured(tracks), BudgetInputs(tracks, {"right": 5e-4})), "synchronization")
    tracks["position"].values[1, 101::7, 0] = np.nan
    tracks["status"].values[1, 101::7, 0] = Status.LOST
    budget = add_uncertainty(measured(tracks), BudgetInputs(tracks, {"right": 5e-4}))
    found = np.isfinite(budget["combined_std"].values[:, 0, 1])
    assert (~found).sum() == len(CLOCK[101::7])
    stated = part(budget, "synchronization")
    np.testing.assert_allclose(stated[found, 0], whole[found, 0], atol=0.15 * whole.max())


def test_an_unknown_clock_leaves_the_whole_unknown():
    tracks = tracks_of(pixels())
    budget = add_uncertainty(measured(tracks), BudgetInputs(tracks, {"right": np.nan}))
    assert np.isnan(budget["combined_std"].values).all()


def test_two_frames_have_no_velocity():
    tracks = tracks_of(pixels()).isel(time=[0, 100])
    budget = add_uncertainty(measured(tracks), BudgetInputs(tracks, {"right": 5e-4}))
    np.testing.assert_array_equal(part(budget, "synchronization"), 0.0)


def test_assumption_covers_true_motion_along_the_suppressed_axis():
    amplitude = (3.0, 6.0, 0.15)
    truth = motion_mm(CLOCK, amplitude)
    stated_square, actual_square, within = [], [], []
    for seed in (2, 3, 4):
        results = []
        for one in (amplitude, AMPLITUDE_MM):
            noisy = tracks_of(pixels(amplitude_mm=one), covariance=white(0.02, 0.02), rng=np.random.default_rng(seed))
            results.append(refined(measured(noisy), noisy))
        with_motion, without = results
        stated = part(with_motion, "assumption")
        assert np.ptp(stated, axis=0).max() == 0.0
        stated_square.append(stated[0] ** 2)
        # The same noise, so what the true motion changed beyond itself is what the assumption did to it.
        change = (with_motion["displacement"] - without["displacement"]).values
        change[..., 2] -= truth[:, None, 2]
        actual_square.append(np.mean(change**2, axis=0))
        error = np.abs(with_motion["displacement"].values - truth[:, None])
        within.append((error <= with_motion["expanded_uncertainty"].values).mean(axis=(0, 1)))
    assert np.mean(within, axis=0).min() > 0.9
    assert (np.sqrt(actual_square)[..., 0] > 0.02).all()
    # The noise there is three times the motion, so one series tells it to a factor; many tell it well.
    ratio = np.sqrt(np.mean(stated_square, axis=(0, 1)) / np.mean(actual_square, axis=(0, 1)))[[0, 2]]
    assert (ratio > 0.8).all()
    assert (ratio < 1.8).all()


def hidden_std(amplitude_mm: tuple[float, float, float], seed: int) -> tuple[FloatArray, FloatArray]:
    """What may hide along an axis that is wholly suppressed, and the noise there; shape (P,) each [mm]."""
    noisy = pixels(amplitude_mm=amplitude_mm)
    tracks = tracks_of(noisy, covariance=white(0.02, 0.02), rng=np.random.default_rng(seed))
    before = measured(tracks)
    gain = np.tile(np.diag([1.0, 1.0, 0.0]), (3, 1, 1))
    stated = part(add_uncertainty(before, BudgetInputs(tracks, {}, {}, (before, "longitudinal"), gain)), "assumption")
    np.testing.assert_array_equal(stated[..., :2], 0.0)
    return stated[0, :, 2], before["displacement_std"].values[0, :, 2]


def test_noise_hides_less_where_the_motion_tells_its_frequencies():
    # The variance of noise is known to sqrt(2 / n) of itself; an excess of none is stated as 0.8 of that.
    floor = np.sqrt(np.sqrt(2 / np.pi)) * (2 / 300) ** 0.25
    share = {}
    for name, amplitude in (("moving", AMPLITUDE_MM), ("at rest", (0.0, 0.0, 0.0))):
        drawn = [np.divide(*hidden_std(amplitude, seed)) for seed in range(30, 40)]
        share[name] = np.sqrt(np.mean(np.square(drawn))) / floor
    assert 0.75 < share["at rest"] < 1.35
    assert 0.2 < share["moving"] < 0.75


def test_all_motion_counts_where_it_stands_out_of_the_noise():
    for amplitude in (0.6, 2.0):
        stated, _ = hidden_std((3.0, 6.0, amplitude), 41)
        np.testing.assert_allclose(stated, np.std(motion_mm(CLOCK, (0, 0, amplitude))[:, 2]), rtol=0.2)


def test_points_that_were_not_refined_assume_nothing_and_too_few_samples_tell_nothing():
    tracks = tracks_of(pixels(), covariance=white(0.02, 0.02), rng=np.random.default_rng(4))
    gain = np.tile(np.diag([1.0, 1.0, 0.2]), (3, 1, 1))
    gain[1] = np.nan
    before = measured(tracks)
    before["status"].values[9:, 2] = Status.LOST
    stated = part(add_uncertainty(before, BudgetInputs(tracks, {}, {}, (before, "longitudinal"), gain)), "assumption")
    assert (stated[:, 0, 2] > 0).all()
    np.testing.assert_array_equal(stated[:, 1], 0.0)
    assert np.isnan(stated[:, 2, 2]).all()


def test_random_is_the_scatter_of_white_noise():
    covariance = np.array([[[4e-4, 1e-4], [1e-4, 9e-4]], [[16e-4, -4e-4], [-4e-4, 4e-4]]])
    tracks = tracks_of(pixels(), covariance=covariance, rng=np.random.default_rng(5))
    budget = add_uncertainty(measured(tracks), BudgetInputs(tracks))
    error = budget["displacement"].values - measured(tracks_of(pixels()))["displacement"].values
    ratio = np.sqrt(np.mean(error**2, axis=(0, 1)) / np.mean(part(budget, "random") ** 2, axis=(0, 1)))
    assert (ratio > 0.9).all()
    assert (ratio < 1.1).all()


@pytest.mark.parametrize(("bits", "loss"), [(0.07, 0.020), (0.31, 0.012), (1.26, 0.007), (2.81, 0.001)])
def test_compression_at_the_measured_sizes(bits, loss):
    assert compression_gain_std(bits) == pytest.approx(loss)


def test_compression_falls_with_the_size():
    sizes = np.geomspace(0.07, 50.0, 200)
    gains = np.array([compression_gain_std(size) for size in sizes])
    assert (np.diff(gains) < 0).all()
    assert np.abs(np.diff(gains)).max() < 1e-3
    assert compression_gain_std(5.62) == pytest.approx(0.0005)
    assert compression_gain_std(0.01) == compression_gain_std(0.0) == 0.020
    assert compression_gain_std(np.inf) == 0.0


def gains_left(tracks: xr.Dataset, std: np.ndarray) -> xr.Dataset:
    """Tracks whose gains are known to standard deviations of shape (V, P, 2), along u and v."""
    views, points = tracks.sizes["view"], tracks.sizes["point"]
    directions = np.broadcast_to(np.eye(2), (views, points, 2, 2))
    return tracks.assign(
        gain_left_std=(("view", "point", "direction"), std, {"units": "1"}),
        injected_direction=(("view", "point", "direction", "pixel"), directions),
    )


def test_compression_is_the_scatter_over_wrong_gains_where_they_were_measured():
    tracks = tracks_of(pixels())
    std = np.broadcast_to([[[0.02, 0.01]], [[0.005, 0.03]]], (2, tracks.sizes["point"], 2))
    plain, rng = measured(tracks), np.random.default_rng(9)
    budget = add_uncertainty(plain, BudgetInputs(gains_left(tracks, std), bits_per_pixel={"left": 0.07}))
    start, errors = tracks["position"].values[:, :1], []
    for _ in range(60):
        wrong = tracks.copy()
        gain = 1 + std[:, None] * rng.normal(size=(2, 1, tracks.sizes["point"], 2))
        wrong["position"] = tracks["position"].copy(data=start + gain * (tracks["position"].values - start))
        errors.append(measured(wrong)["displacement"].values - plain["displacement"].values)
    scatter = np.sqrt(np.mean(np.square(errors), axis=(0, 1, 2)))
    stated = np.sqrt(np.mean(part(budget, "compression") ** 2, axis=(0, 1)))
    np.testing.assert_allclose(stated, scatter, rtol=0.15)


def test_subset_is_the_spread_of_gains_over_subsets():
    tracks, std = tracks_of(pixels()), 0.03
    parts = tracks.assign(part_gain_std=(("view", "point", "direction"), np.full((2, tracks.sizes["point"], 2), std)))
    budget = add_uncertainty(measured(tracks), BudgetInputs(parts))
    as_left = add_uncertainty(measured(tracks), BudgetInputs(gains_left(tracks, parts["part_gain_std"].values)))
    np.testing.assert_allclose(part(budget, "subset"), part(as_left, "compression"))
    np.testing.assert_array_equal(part(as_left, "subset"), 0.0)
    vertical = np.abs(measured(tracks)["displacement"].values[..., 1])
    assert part(budget, "subset")[..., 1].max() > 0.5 * std * vertical.max()


def test_a_component_that_nothing_told_says_so():
    tracks = tracks_of(pixels())
    spread = np.full((2, tracks.sizes["point"], 2), 0.03)
    spread[:, 0] = np.nan  # of the first point no parts were compared
    parts = tracks.assign(part_gain_std=(("view", "point", "direction"), spread))
    inputs = BudgetInputs(parts, clock_std_s={"right": np.nan}, bits_per_pixel={"left": 0.31, "right": np.inf})
    told = add_uncertainty(measured(tracks), inputs)["uncertainty_estimated"]
    assert told.sel(component="subset").values.tolist() == [False] + [True] * (tracks.sizes["point"] - 1)
    whole = told.isel(point=1).to_series()
    assert whole[~whole].index.tolist() == ["assumption", "origin"]
    plain = add_uncertainty(measured(tracks), BudgetInputs(tracks, bits_per_pixel={"left": np.inf}))
    whole = plain["uncertainty_estimated"].all("point").to_series()
    assert whole[whole].index.tolist() == ["random", "cameras"]


def test_compression_is_by_size_where_a_gain_was_not_measured():
    tracks = tracks_of(pixels())
    std = np.full((2, tracks.sizes["point"], 2), 0.001)
    std[1, 0, 0] = np.nan
    plain = measured(tracks)
    budget = add_uncertainty(plain, BudgetInputs(gains_left(tracks, std), bits_per_pixel={"left": 0.07}))
    moved = np.abs(plain["displacement"].values)
    np.testing.assert_allclose(part(budget, "compression")[:, 0], 0.02 * moved[:, 0])
    vertical = np.s_[:, 1:, 1]
    assert np.mean(part(budget, "compression")[vertical] ** 2) < np.mean((0.005 * moved[vertical]) ** 2)


def test_tracks_of_other_points_are_refused():
    tracks = tracks_of(pixels())
    displacement = measured(tracks)
    with pytest.raises(DatasetError, match="tracks: expected the points of the displacement"):
        add_uncertainty(displacement, BudgetInputs(tracks.isel(point=[0, 2, 1])))
    with pytest.raises(DatasetError, match="position: expected dims"):
        add_uncertainty(displacement, BudgetInputs(tracks.isel(view=0)))


@pytest.fixture(scope="module")
def error_ratios() -> dict[str, list[FloatArray]]:
    """Errors over expanded uncertainties, lateral and vertical, shape (sample, axis) of each measurement.

    Measurements from poor to good, with cameras, clocks and noise in error as far as is stated.
    """
    rng = np.random.default_rng(7)
    ratios: dict[str, list[FloatArray]] = {"plain": [], "refined": []}
    time_s = CLOCK[:180]
    for number in range(40):
        tau = rng.uniform(1e-4, 1e-3)
        scale = rng.uniform(0.1, 2.0)
        amplitude = (3 * scale, 6 * scale, 0.02 * scale)
        position = pixels(time_s=time_s, late_s=rng.normal(0, tau), amplitude_mm=amplitude)[:, :, :2]
        noise = white(rng.uniform(0.005, 0.05), rng.uniform(0.005, 0.05))
        tracks = tracks_of(position, covariance=noise, rng=rng, time_s=time_s)
        rig, frame = wrong_site(rng)
        truth = motion_mm(time_s, amplitude)[:, None]
        before = measured(tracks, rig, frame)
        results = {"plain": add_uncertainty(before, BudgetInputs(tracks, {"right": tau}))}
        if number % 2:
            results["refined"] = refined(before, tracks, rig, frame, clock_std_s={"right": tau})
        for name, result in results.items():
            ratio = (result["displacement"].values - truth) / result["expanded_uncertainty"].values
            ratios[name].append(ratio[..., :2].reshape(-1, 2))
    return ratios


@pytest.mark.parametrize("name", ["plain", "refined"])
def test_expanded_uncertainties_hold_the_truth_and_are_no_wider_than_that_takes(error_ratios, name):
    assert objections(error_ratios[name]) == set()


@pytest.mark.parametrize("name", ["plain", "refined"])
@pytest.mark.parametrize(("factor", "expected"), [(3.0, TOO_WIDE), (np.inf, TOO_WIDE), (1 / 3, TOO_NARROW)])
def test_expanded_uncertainties_three_times_too_wide_or_narrow_are_objected_to(error_ratios, name, factor, expected):
    assert objections([one / factor for one in error_ratios[name]]) == expected


def test_views_that_disagree_on_the_motion_are_stated_with_compression():
    tracks = tracks_of(pixels(), covariance=white(0.01, 0.01))
    plain = compute_displacement(tracks, RIG, frame=FRAME, covariance=COVARIANCE, still_interval_s=STILL_S)
    difference = np.array([0.06, np.nan, 0.001])
    sizes = {"left": 2.81, "right": 2.81}

    def share(inputs: BudgetInputs) -> FloatArray:
        parts = add_uncertainty(plain, inputs).sel(component="compression", axis="vertical", time=CLOCK[200])
        return np.asarray(parts["uncertainty"] / np.abs(plain["displacement"].sel(axis="vertical", time=CLOCK[200])))

    by_size = compression_gain_std(2.81)
    both = share(BudgetInputs(tracks, bits_per_pixel=sizes, gain_difference=difference))
    np.testing.assert_allclose(both, [0.03, by_size, by_size])
    # Without a codec, views disagree for reasons that the cameras' part states.
    np.testing.assert_array_equal(share(BudgetInputs(tracks, gain_difference=difference)), 0.0)


def test_the_difference_of_the_views_is_found():
    def difference(share: float, frame: StructureFrame | None = FRAME) -> FloatArray:
        seen = pixels()
        seen[1] = seen[1, :1] + share * (seen[1] - seen[1, :1])
        tracks = tracks_of(seen, covariance=white(0.001, 0.001))
        plain = compute_displacement(tracks, RIG, frame=FRAME, covariance=COVARIANCE, still_interval_s=STILL_S)
        return compute_gain_difference(tracks, plain, RIG, frame)

    np.testing.assert_allclose(difference(1.0), 0.0, atol=2e-3)
    np.testing.assert_allclose(difference(0.95), 0.05, atol=5e-3)
    assert np.isnan(difference(1.0, frame=None)).all()
