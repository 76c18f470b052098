"""Acceptance tests against constructed truth: right results pass, wrong ones fail, and each fault is named."""

import json

import numpy as np
import pytest
import xarray as xr

from scenes import make_rig
from vfm_sdm.analysis.acceptance import (
    AcceptedRun,
    BudgetModel,
    KnownLength,
    check_budget,
    check_lengths,
    check_noise_floor,
    check_rigid,
    read_lengths,
    read_steps,
    write_acceptance,
)
from vfm_sdm.core.datasets import DisplacementArrays, make_displacement, make_points, make_tracks
from vfm_sdm.core.statuses import Outcome
from vfm_sdm.errors import DatasetError
from vfm_sdm.geometry.rig_draws import RigDraws
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.signals.spectrum import detection_limit
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.stages.displacement.stereo import compute_displacement
from vfm_sdm.stages.displacement.uncertainty import BudgetInputs, add_uncertainty

AXES = ("right", "down", "forward")
PLACES = np.array([[-0.5, 0.0, 9.8], [0.6, 0.2, 10.1]])
STD = np.array([0.02, 0.02, 0.05])


def made(motion_mm, seed=0, time_s=None):
    """A run of two points that move together, (T, 3) [mm], with noise as it states."""
    count = len(motion_mm)
    noise = np.random.default_rng(seed).normal(0, STD, (count, 2, 3))
    values = motion_mm[:, None] + noise
    data = make_displacement(
        np.arange(count) / 20 if time_s is None else time_s,
        ["a", "b"],
        AXES,
        DisplacementArrays(
            displacement_mm=values,
            displacement_std_mm=np.broadcast_to(STD, values.shape),
            scale_std=np.full((2, 3), 0.002),
            position_m=PLACES + values / 1e3,
            reprojection_error_px=np.zeros((count, 2)),
            status=np.zeros((count, 2)),
        ),
        attrs={"frame": "reference camera", "relative_to": "first valid sample"},
    )
    return data.assign(expanded_uncertainty=(("time", "point", "axis"), np.broadcast_to(2 * STD, values.shape)))


def run_of(data, tmp_path):
    return AcceptedRun(tmp_path, data, None)


class TestNoiseFloor:
    def test_stated_noise_passes(self):
        result = check_noise_floor(made(np.zeros((400, 3))))
        assert result.outcome is Outcome.PASS
        stds = [row.value for row in result.rows if row.quantity == "std"]
        np.testing.assert_allclose(stds, np.tile(STD, 2), rtol=0.1)

    @pytest.mark.parametrize(
        ("quantity", "motion"), [("mean", np.full(400, 0.1)), ("drift", np.linspace(-0.1, 0.1, 400))]
    )
    def test_what_is_not_at_rest_fails(self, quantity, motion):
        result = check_noise_floor(made(np.outer(motion, [0, 1, 0])))
        assert result.outcome is Outcome.FAIL
        failed = {(row.subject, row.quantity) for row in result.rows if row.outcome is Outcome.FAIL}
        assert ("a down", quantity) in failed
        assert not any("forward" in subject for subject, _ in failed)

    def test_noise_of_twice_the_stated_size_fails(self):
        data = made(np.zeros((400, 3)))
        # Arithmetic of some versions of xarray loses the unit.
        noisy = data["displacement"].copy(data=2 * data["displacement"].values)
        assert check_noise_floor(data.assign(displacement=noisy)).outcome is Outcome.FAIL

    def test_the_spectrum_adds_up_to_the_variance(self):
        result = check_noise_floor(made(np.zeros((4096, 3))))
        lines = result.details["spectra"]["a"]["forward"]["rms_mm"]
        assert np.sqrt(np.sum(np.square(lines))) == pytest.approx(STD[2], rel=0.05)

    def test_a_given_limit_counts(self):
        assert check_noise_floor(made(np.zeros((400, 3))), limit_mm=0.01).outcome is Outcome.FAIL
        with pytest.raises(DatasetError, match="limit: expected a positive number, got -1; correct"):
            check_noise_floor(made(np.zeros((400, 3))), limit_mm=-1)

    def test_too_short(self):
        with pytest.raises(DatasetError, match="expected 10 frames or more, got 3; film longer"):
            check_noise_floor(made(np.zeros((3, 3))))


STEPS_MM = np.array([0.0, 2.0, 4.0, 6.0, 3.0])
STEPS = "start_s,end_s,down\n" + "".join(f"{5 * n + 1},{5 * n + 4.5},{mm}\n" for n, mm in enumerate(STEPS_MM))


class TestRigid:
    def steps(self, tmp_path):
        (tmp_path / "steps.csv").write_text(STEPS)
        return read_steps(tmp_path / "steps.csv")

    def test_right_steps_pass(self, tmp_path):
        motion = np.outer(np.repeat(STEPS_MM, 100), [0, 1, 0])
        result = check_rigid(run_of(made(motion), tmp_path), self.steps(tmp_path))
        assert result.outcome is Outcome.PASS
        assert len(result.rows) == 7

    def test_a_wrong_scale_fails(self, tmp_path):
        motion = np.outer(np.repeat(STEPS_MM, 100), [0, 1.03, 0])
        result = check_rigid(run_of(made(motion), tmp_path), self.steps(tmp_path))
        failed = [row.quantity for row in result.rows if row.outcome is Outcome.FAIL]
        assert failed == ["slope - 1", "slope - 1"]
        assert result.rows[0].value == pytest.approx(0.03, abs=0.003)

    def test_points_that_move_apart_fail(self, tmp_path):
        data = made(np.outer(np.repeat(STEPS_MM, 100), [0, 1, 0]))
        apart = np.zeros(data["position"].shape)
        apart[300:400, 1, 0] = 1e-3
        result = check_rigid(run_of(data.assign(position=data["position"] + apart), tmp_path), self.steps(tmp_path))
        assert [row.subject for row in result.rows if row.outcome is Outcome.FAIL] == ["a - b"]
        assert abs(result.rows[-1].value) == pytest.approx(1.0, abs=0.1)

    @pytest.mark.parametrize(
        ("text", "says"),
        [
            ("start_s,end_s\n0,1\n", "a column for each axis"),
            (STEPS.replace("1,4.5", "1,x"), "expected a number in column 'end_s', got 'x'"),
            (STEPS.replace("end_s", "end"), "expected columns"),
            (STEPS + "1,2\n", "expected 3 cells in row 6"),
        ],
    )
    def test_malformed_files(self, tmp_path, text, says):
        (tmp_path / "steps.csv").write_text(text)
        with pytest.raises(DatasetError, match=says):
            read_steps(tmp_path / "steps.csv")

    def test_other_axes(self, tmp_path):
        (tmp_path / "steps.csv").write_text(STEPS.replace("down", "vertical"))
        with pytest.raises(DatasetError, match="expected axes of the measurement"):
            check_rigid(run_of(made(np.zeros((500, 3))), tmp_path), read_steps(tmp_path / "steps.csv"))


def solution(std_focal=1e-3):
    rig = make_rig()
    variance = np.zeros(23)
    variance[[0, 10]] = std_focal**2
    places = np.stack([camera.project(PLACES) for camera in rig.cameras])
    points = make_points(rig.names, ["a", "b"], position=places, position_std=0 * places, status=[["ok"] * 2] * 2)
    return CameraSolution(rig, None, np.diag(variance), points)


class TestLengths:
    LENGTH = float(np.linalg.norm(PLACES[0] - PLACES[1]))

    def check(self, tmp_path, length_m, **limits):
        known = [KnownLength("a", "b", length_m)]
        return check_lengths(run_of(made(np.zeros((400, 3))), tmp_path), solution(), known, **limits)

    def test_right_and_wrong_lengths(self, tmp_path):
        assert self.check(tmp_path, self.LENGTH).outcome is Outcome.PASS
        wrong = self.check(tmp_path, 0.98 * self.LENGTH)
        assert wrong.outcome is Outcome.FAIL
        assert wrong.rows[0].value == pytest.approx(20 * self.LENGTH, rel=1e-3)

    def test_the_permissible_error_grows_with_the_length(self, tmp_path):
        error = {"limit_mm": 1.0, "limit_per_m": 2.0}
        assert self.check(tmp_path, self.LENGTH, **error).rows[0].limit == pytest.approx(1 + 2 * self.LENGTH)

    def test_unknown_points(self, tmp_path):
        (tmp_path / "l.csv").write_text("point_a,point_b,length_m\na,z,1\n")
        with pytest.raises(DatasetError, match=r"expected two of the points \['a', 'b'\] each, got \['z'\]"):
            check_lengths(run_of(made(np.zeros((9, 3))), tmp_path), solution(), read_lengths(tmp_path / "l.csv"))


def model(focal_std, clock_std_s=0.0):
    """A budget model whose cameras, pixels and clock are as uncertain as stated."""
    cameras = solution(focal_std)
    rig, time_s = cameras.rig, np.arange(60) / 20
    motion = 5e-3 * np.sin(2 * np.pi * 0.8 * time_s)[:, None] * np.array([0.4, 1.0, 0.3])
    views = []
    for camera in rig.cameras:
        u = camera.project(PLACES + motion[:, None])
        covariance = np.broadcast_to(0.002**2 * np.eye(2), (60, 2, 2, 2))
        views.append(make_tracks(time_s, ["a", "b"], u, covariance, np.zeros((60, 2)), attrs={}))
    tracks = xr.concat(views, "view").assign_coords(view=list(rig.names))
    displacement = compute_displacement(tracks, rig, covariance=cameras.covariance)
    tracks = tracks.assign(
        clock_offset_std=("view", [0.0, clock_std_s]),
        origin_covariance=(("view", "point", "pixel_a", "pixel_b"), np.zeros((2, 2, 2, 2))),
    )
    inputs = BudgetInputs(tracks, clock_std_s={"right": clock_std_s})
    stated = add_uncertainty(displacement, inputs)
    return BudgetModel(stated, displacement, tracks, rig, np.eye(3), cameras.covariance)


class TestBudget:
    def test_linear_and_monte_carlo_agree(self):
        result = check_budget(model(0.002), trials=20_000)
        assert result.outcome is Outcome.PASS
        assert not result.notes

    def test_a_budget_that_is_too_small_is_named_and_the_wider_counts(self):
        of = model(0.05)
        budget = of.displacement["uncertainty"].copy()
        budget.loc[{"component": "cameras"}] *= 0.3
        small = BudgetModel(
            of.displacement.assign(uncertainty=budget), of.unrefined, of.tracks, of.rig, of.rotation, of.covariance
        )
        result = check_budget(small, trials=20_000)
        assert result.outcome is Outcome.FAIL
        table = result.details["points"]["a"]["forward"]
        assert table["differs"] == "cameras"
        assert table["stated_mm"] > 1.2 * table["linear_mm"]
        assert any("a forward: U linear" in note and "'cameras'" in note for note in result.notes)

    def test_too_few_trials(self):
        with pytest.raises(DatasetError, match="expected 10000 or more, got 100: with fewer"):
            check_budget(model(0.002), trials=100)

    def test_draws_triangulate_as_rigs_that_are_perturbed_one_by_one(self):
        rig, rng = make_rig(), np.random.default_rng(0)
        scale = [1e-2, 2.0, 2.0, 1e-2, 1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2]
        steps = rng.normal(0, scale, (5, 2, 10))
        pixels = np.stack([camera.project(PLACES[0]) for camera in rig.cameras])[:, None] + np.zeros((2, 5, 2))
        found = RigDraws(rig, steps).triangulate(pixels)
        for step, place in zip(steps, found, strict=True):
            np.testing.assert_allclose(place, triangulate(pixels[:, 0], rig.perturbed(step.ravel())), atol=1e-9)


def test_the_file_says_what_was_tested(tmp_path):
    run = run_of(made(np.zeros((400, 3))), tmp_path)
    path = write_acceptance(run, check_noise_floor(run.displacement, limit_mm=1.0))
    found = json.loads(path.read_text())
    assert path.name == "acceptance_noise-floor.json"
    assert (found["outcome"], found["limits"], len(found["rows"])) == ("pass", "1 mm", 18)


def test_a_sinusoid_at_the_detection_limit_is_seen_and_noise_is_not():
    rng, n, seen, false = np.random.default_rng(0), 400, 0, 0
    limit = np.log(n / 2 / 0.05) * n
    for _ in range(400):
        noise = rng.normal(0, 1, n)
        wave = detection_limit(1.0, n) * np.sin(2 * np.pi * 31 * np.arange(n) / n + rng.uniform(0, 6))
        false += (np.abs(np.fft.rfft(noise)[1:-1]) ** 2).max() > limit
        seen += (np.abs(np.fft.rfft(noise + wave)[1:-1]) ** 2).max() > limit
    assert 4 <= false <= 40
    assert seen >= 0.45 * 400
