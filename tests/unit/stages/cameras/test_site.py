import numpy as np
import pytest

from faults import GOOD
from measurements import simulate
from simulation import SIZE, gain_error, placed_cameras, project_all, site_trial
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.propagation import compute_gain_sensitivity, compute_gain_std
from vfm_sdm.geometry.structure_frame import compute_view_angle, structure_from_cam1
from vfm_sdm.inputs.session import Level, Readings, Site
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint
from vfm_sdm.stages.cameras.whitening import bend
from vfm_sdm.stages.matching.matches import Matches


def measured_site(trial, rng, *, range_std=None, baseline_std=0.01, **more):
    """Site of a trial as a tape and a laser would give it."""
    site = {"baseline": {"value": trial.truth.baseline() + rng.normal(0, baseline_std), "std": baseline_std}, **more}
    if range_std is not None:
        distance = float(np.linalg.norm(trial.point))
        value = distance * (1 + rng.normal(0, range_std))
        site["range"] = [{"point": "p", "value": value, "std": distance * range_std}]
    return Site(**site)


def adjusted_gain(trial, rng, **site):
    """Errors of the displacement gain along the reference camera's axes, their stated std, the adjustment."""
    pixels = trial.pixels + rng.normal(0, 0.1, trial.pixels.shape)
    adjustment = adjust_to_site(
        trial.prior, [trial.matches], measured_site(trial, rng, **site), {"p": SitePoint(pixels)}
    )
    sensitivity = compute_gain_sensitivity(trial.pixels[:, None], adjustment.rig)
    stated = np.diag(compute_gain_std(sensitivity, np.eye(3), adjustment.covariance)[0])
    return gain_error(trial.truth, adjustment.rig, trial.point), stated, adjustment


def run_trials(count, *, range_std, seed=0, **draw):
    rng = np.random.default_rng(seed)
    results = [adjusted_gain(site_trial(rng, **draw), rng, range_std=range_std) for _ in range(count)]
    return np.array([r[0] for r in results]), np.array([r[1] for r in results]), [r[2].status for r in results]


def covered(errors, stated):
    return np.mean(np.abs(errors) <= 1.96 * stated, axis=0)


def test_without_a_range_the_scale_is_uncertain_and_says_so():
    errors, stated, _ = run_trials(12, range_std=None)
    assert np.all(stated[:, 0] > 0.04)
    assert np.sqrt(np.mean(errors[:, 0] ** 2)) < 2 * np.sqrt(np.mean(stated[:, 0] ** 2))


def test_a_range_of_half_a_per_cent_brings_the_scale_below_one_per_cent():
    # In the image plane. 0.5 % of range is 0.5 % of focal length, and both make Z / f wrong: 1 % is the floor.
    errors, stated, _ = run_trials(12, range_std=0.005)
    assert np.sqrt(np.mean(errors[:, :2] ** 2, axis=0)).max() <= 0.01
    assert stated[:, :2].max() < 0.012


def test_lenses_of_pan_clips_bring_the_scale_below_one_per_cent_without_a_range():
    errors, stated, _ = run_trials(12, range_std=None, focal_std=0.002, center_std=0.0005, corner_distortion_std=0.001)
    assert np.sqrt(np.mean(errors[:, :2] ** 2, axis=0)).max() <= 0.01
    assert stated[:, :2].max() < 0.01
    assert np.abs(errors[:, :2] / stated[:, :2]).max() < 4


@pytest.mark.slow
@pytest.mark.parametrize("range_std", [None, 0.005])
@pytest.mark.parametrize(
    ("count", "draw"),
    [
        (200, {"shared_error_px": 0.0}),
        (50, {"shared_error_px": 0.2}),
        (50, {"center_std": 0.015, "corner_distortion_std": 0.025}),
    ],
    ids=["focal lengths", "and matches that err together", "and principal point and distortion"],
)
def test_stated_intervals_hold_in_many_trials(range_std, count, draw, capsys):
    errors, stated, status = run_trials(count, range_std=range_std, seed=1, **draw)
    usable = np.array(status) == "ok"
    rms = 100 * np.sqrt(np.mean(errors[usable] ** 2, axis=0))
    with capsys.disabled():
        print(
            f"\nrange {range_std}, {draw}: usable {usable.mean():.3f}, RMS {rms.round(2)} %, stated "
            f"{(100 * stated[usable].mean(axis=0)).round(2)} %, covered {covered(errors, stated)[:].round(3)}"
        )
    assert usable.mean() > 0.95
    assert np.all(covered(errors, stated) >= 0.90)
    if count == 200:
        assert np.all(covered(errors, stated) <= 0.99)
    if range_std is not None and count == 200:
        assert rms[:2].max() <= 1.0


def test_without_any_focal_prior_the_result_is_named_as_undetermined():
    rng = np.random.default_rng(2)
    trial = site_trial(rng, focal_std=0.05)
    covariance = np.array(trial.prior.covariance)
    covariance[0, 0] = covariance[10, 10] = 0.5**2
    prior = Rig(trial.prior.names, trial.prior.cameras, False, covariance)
    adjustment = adjust_to_site(prior, [trial.matches], measured_site(trial, rng), {})
    assert adjustment.status == CameraStatus.NOT_IDENTIFIABLE
    assert any("state the lens, or measure a range" in note for note in adjustment.notes)
    sensitivity = compute_gain_sensitivity(trial.pixels[:, None], adjustment.rig)
    assert compute_gain_std(sensitivity, np.eye(3), adjustment.covariance)[0, 0, 0] > 0.15


def test_a_focal_prior_that_contradicts_a_range_is_named():
    rng = np.random.default_rng(3)
    trial = site_trial(rng, focal_std=0.002)
    wrong = Site(
        baseline={"value": trial.truth.baseline(), "std": 0.005},
        range=[{"point": "p", "value": 1.2 * float(np.linalg.norm(trial.point)), "std": 0.02}],
    )
    adjustment = adjust_to_site(trial.prior, [trial.matches], wrong, {"p": SitePoint(trial.pixels)})
    assert adjustment.status == CameraStatus.DISAGREE
    assert any("standard deviations away" in note for note in adjustment.notes)


def test_ten_times_the_matches_do_not_make_the_result_more_certain():
    rng = np.random.default_rng(4)
    trial = site_trial(rng)
    site = measured_site(trial, rng)
    m = trial.matches
    many = Matches(0, 1, np.tile(m.points_first, (10, 1)), np.tile(m.points_second, (10, 1)))
    few_std = np.sqrt(np.diag(adjust_to_site(trial.prior, [m], site, {}).covariance))[0]
    many_std = np.sqrt(np.diag(adjust_to_site(trial.prior, [many], site, {}).covariance))[0]
    assert many_std == pytest.approx(few_std, rel=0.05)


def test_without_anything_but_priors_they_come_back():
    trial = site_trial(np.random.default_rng(5))
    adjustment = adjust_to_site(trial.prior, [], Site(), {})
    np.testing.assert_allclose(adjustment.covariance[:20, :20], trial.prior.covariance, atol=1e-3)
    assert not any(q.determined for q in adjustment.quantities)
    assert np.isnan(adjustment.epipolar_rms_px)


def test_a_length_between_two_points_sets_the_scale():
    rng = np.random.default_rng(6)
    trial = site_trial(rng, focal_std=1e-4)
    ends = np.array([[-2.0, 0.0, 20.0], [2.0, 0.5, 21.0]])
    u = project_all(trial.truth, ends)
    length = {"points": ("p", "q"), "value": float(np.linalg.norm(ends[0] - ends[1])), "std": 0.002}
    site = Site(length=[length])
    adjustment = adjust_to_site(trial.prior, [trial.matches], site, {"p": SitePoint(u[:, 0]), "q": SitePoint(u[:, 1])})
    assert adjustment.rig.baseline() == pytest.approx(trial.truth.baseline(), rel=0.005)


def test_level_second_camera_is_an_observation():
    rng = np.random.default_rng(7)
    trial = site_trial(rng)
    site = measured_site(trial, rng)
    readings = {"b": Readings(level=Level(std_deg=0.05))}
    before = {q.name: q for q in adjust_to_site(trial.prior, [], site, {}).quantities}
    adjustment = adjust_to_site(trial.prior, [], site, {}, readings=readings)
    after = {q.name: q for q in adjustment.quantities}
    assert "pitch b" not in before
    # The reference camera's own level is only known to a degree, so its reading cannot be beaten by the second.
    assert after["pitch b"].std <= 0.05 + 1e-6
    assert after["roll b"].value == pytest.approx(0.0, abs=0.05)


class TestStructuralAxes:
    ANGLE = compute_view_angle(9.0, 20.0)

    def site(self, trial, **more):
        return Site(
            baseline={"value": trial.truth.baseline(), "std": 0.005},
            perpendicular_distance={"value": 9.0, "std": 0.02},
            longitudinal_distance={"value": 20.0, "std": 0.05},
            reference_camera_level={"pitch_deg": 2.0, "roll_deg": -1.0, "std_deg": 0.3},
            **more,
        )

    @pytest.mark.parametrize("side", ["right", "left"])
    def test_follow_the_distances_and_the_level(self, side):
        trial = site_trial(np.random.default_rng(8), focal_std=1e-3)
        adjustment = adjust_to_site(trial.prior, [trial.matches], self.site(trial, structure_side=side), {})
        expected = structure_from_cam1(self.ANGLE, pitch_rad=np.radians(2), roll_rad=np.radians(-1), side=side)
        assert adjustment.frame is not None
        np.testing.assert_allclose(adjustment.frame.rotation, expected, atol=2e-3)
        std_deg = np.degrees(np.sqrt(np.diag(adjustment.frame.covariance)))
        assert std_deg[[0, 2]] == pytest.approx([0.3, 0.3], rel=0.1)
        assert 0.01 < std_deg[1] < 0.3

    def test_a_point_on_the_face_tells_about_the_focal_length(self):
        trial = site_trial(np.random.default_rng(9), focal_std=0.05)
        lateral = structure_from_cam1(self.ANGLE)[0]
        ray = np.array([0.02, 0.01, 1.0])
        on_face = ray * 9.0 / (lateral @ ray)
        u = project_all(trial.truth, on_face[None])[:, 0]
        site = self.site(trial, face_offset_std=0.05)
        without = adjust_to_site(trial.prior, [trial.matches], site, {"p": SitePoint(u)})
        with_face = adjust_to_site(trial.prior, [trial.matches], site, {"p": SitePoint(u, on_face=True)})
        stds = [np.sqrt(a.covariance[0, 0]) for a in (without, with_face)]
        assert stds[1] < 0.6 * stds[0]

    @pytest.mark.slow
    def test_relief_of_the_face_does_not_lengthen_the_focal_lengths(self):
        # Longer lenses flatten the relief that the same pictures show: least squares of it in metres would choose them.
        rng = np.random.default_rng(16)
        lateral = structure_from_cam1(self.ANGLE, pitch_rad=np.radians(2), roll_rad=np.radians(-1))[0]
        pulls, suspects = [], []
        for _ in range(6):
            trial = site_trial(rng, focal_std=0.2)
            first = rng.uniform(0, np.array(SIZE) - 1, (400, 2))
            rays = np.column_stack([trial.truth.cameras[0].normalize(first), np.ones(400)])
            cell = (first[:, 0] * 6 // SIZE[0] * 6 + first[:, 1] * 6 // SIZE[1]).astype(int)
            relief = rng.normal(0, 0.1, 36)[cell] + rng.normal(0, 0.02, 400)
            X = rays * ((9.0 + relief) / (rays @ lateral))[:, None]
            u = project_all(trial.truth, X) + rng.normal(0, 0.2, (2, 400, 2))
            matches = Matches(0, 1, u[0], u[1], on_face=np.ones(400, dtype=bool))
            adjustment = adjust_to_site(trial.prior, [matches], self.site(trial, face_offset_std=0.1), {})
            focal = [c.focal_px / t.focal_px for c, t in zip(adjustment.rig.cameras, trial.truth.cameras, strict=True)]
            std = np.sqrt([adjustment.covariance[0, 0], adjustment.covariance[10, 10]])
            pulls.append(np.mean(np.log(focal) / std))
            suspects += adjustment.suspects
        assert abs(np.mean(pulls)) < 2 / np.sqrt(len(pulls))
        assert not suspects

    def test_a_distance_that_nobody_could_measure_stops_no_search(self):
        # From one of its starts the perpendicular distance of this site passes zero on the way.
        assert simulate(56, **GOOD).solution.status == CameraStatus.OK

    def test_an_unread_level_is_noted(self):
        trial = site_trial(np.random.default_rng(10))
        fields = self.site(trial).model_dump(exclude={"reference_camera_level"})
        adjustment = adjust_to_site(trial.prior, [], Site(**fields), {})
        assert any("pitch and roll taken as 0 +- 1 degree" in note for note in adjustment.notes)


def test_a_rig_without_prior_is_refused():
    trial = site_trial(np.random.default_rng(11))
    with pytest.raises(CameraError, match="expected a rig with a prior covariance"):
        adjust_to_site(Rig(("a", "b"), trial.prior.cameras), [], Site(), {})


def test_a_range_to_a_point_that_was_not_found_is_refused():
    trial = site_trial(np.random.default_rng(12))
    site = Site(range=[{"point": "p", "value": 20.0, "std": 0.1}])
    with pytest.raises(CameraError, match=r"expected pixels in every view for points \['p'\]"):
        adjust_to_site(trial.prior, [], site, {})


def test_more_than_two_views():
    rng = np.random.default_rng(13)
    trial = site_trial(rng, focal_std=0.01)
    third = trial.truth.cameras[1].perturbed([0.01, 0, 0, 0, 0, 0.1, 0, -2.0, 0, 0.3])
    truth = Rig(("a", "b", "c"), (*trial.truth.cameras, third), True)
    covariance = np.zeros((30, 30))
    covariance[:20, :20] = trial.prior.covariance
    covariance[20:, 20:] = np.asarray(trial.prior.covariance)[10:, 10:]
    start = third.perturbed([0.01, 0, 0, 0, 0.01, -0.01, 0.005, 0.1, 0.05, 0.05])
    prior = Rig(truth.names, (*trial.prior.cameras, start), False, covariance)
    X = np.column_stack([rng.uniform(-3, 3, 500), rng.uniform(-2, 2, 500), rng.uniform(15, 40, 500)])
    u = project_all(truth, X)
    u = u[:, ((u >= 0) & (u <= np.array(SIZE) - 1)).all(axis=(0, 2))]
    assert u.shape[1] > 50
    pairs = [Matches(0, k, u[0], u[k]) for k in (1, 2)]
    adjustment = adjust_to_site(prior, pairs, measured_site(trial, rng), {})
    assert adjustment.epipolar_rms_px < 0.2
    assert len(adjustment.rig) == 3


PLACES = {
    "a row": [(0, 0, 0), (2, 0, -0.5), (4, 0, -1)],
    "an uneven row": [(0, 0, 0), (3, 0, -0.75), (4, 0, -1)],
    "the third between": [(0, 0, 0), (4, 0, -1), (2, 0, -0.5)],
    "the reference in the middle": [(0, 0, 0), (2, 0, -0.5), (-2, 0, 0.5)],
    "a row that goes away": [(0, 0, 0), (1.0, 0, -2), (2, 0, -4)],
    "nearly a row": [(0, 0, 0), (2, 0, -0.5), (4, -0.05, -1)],
    "a triangle": [(0, 0, 0), (4, 0, -1), (2, -1.5, 0)],
    "four in a row": [(0, 0, 0), (2, 0, -0.5), (4, 0, -1), (6, 0, -1.5)],
}


def distance_and_std(rig, view):
    """Distance of a view from the first [m], and its standard deviation."""
    along = rig.cameras[view].translation / rig.baseline(0, view)
    last = slice(10 * view + 7, 10 * view + 10)
    return rig.baseline(0, view), float(np.sqrt(along @ rig.covariance[last, last] @ along))


@pytest.mark.parametrize("places", PLACES)
def test_further_cameras_stand_where_they_stand(places):
    """Matches with the first view alone; what holds a camera in a row are points that three views see."""
    for seed in range(2):
        placed = placed_cameras(PLACES[places], seed=seed)
        site = Site(baseline={"value": placed.truth.baseline(), "std": 0.005})
        adjustment = adjust_to_site(placed.prior, placed.pairs(), site, {})
        assert adjustment.status == "ok"
        named = {q.name: q for q in adjustment.quantities}
        for view in range(2, len(placed.truth)):
            true = placed.truth.baseline(0, view)
            found, std = distance_and_std(adjustment.rig, view)
            assert std < 0.004 * true
            assert abs(found - true) < 3 * std
            quantity = named[f"distance a to {adjustment.rig.names[view]}"]
            assert (quantity.value, quantity.std) == pytest.approx((found, std), rel=1e-4)
            assert quantity.determined


@pytest.mark.slow
def test_stated_std_of_a_third_camera_in_a_row_is_its_scatter():
    deviations = []
    for seed in range(25):
        placed = placed_cameras(PLACES["a row"], seed=seed, shared_error_px=0.2)
        site = Site(baseline={"value": placed.truth.baseline(), "std": 1e-4})
        rig = adjust_to_site(placed.prior, placed.pairs(), site, {}).rig
        found, std = distance_and_std(rig, 2)
        deviations.append((found - placed.truth.baseline(0, 2)) / std)
    assert 0.6 < np.sqrt(np.mean(np.square(deviations))) < 1.3
    assert abs(np.mean(deviations)) < 3 / np.sqrt(25)


@pytest.mark.parametrize("places", ["a row", "a triangle"])
def test_a_third_camera_without_common_points_is_named(places):
    """Two pairs that share no point: each has its own scale."""
    placed = placed_cameras(PLACES[places])
    site = Site(baseline={"value": placed.truth.baseline(), "std": 0.005})
    adjustment = adjust_to_site(placed.prior, placed.pairs(common=False), site, {})
    assert adjustment.status == CameraStatus.UNKNOWN_DISTANCE
    assert any("distance a to c: known to" in note and "three see the same points" in note for note in adjustment.notes)


def test_the_robust_loss_keeps_its_derivative_at_zero():
    """Exact matches have no residual; the steps of the derivative must not drown in the root of one plus nothing."""
    small = np.array([-3e-8, 1e-9, 2e-8])
    assert bend(small) == pytest.approx(small, rel=1e-12)
    assert bend(np.array([1e6])) == pytest.approx(np.sqrt(2 * 3 * 1e6), rel=1e-3)
