"""Reference frames are renewed where light has changed: what is kept, how far it drifts, and what is no reason."""

import pickle

import numpy as np
import pytest

from lit_films import NAMES, POINTS, LitFilm, points_of_view
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.registration.subsets import SubsetBank, SubsetDesign
from vfm_sdm.stages.tracking.base import Targets
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.references import add_alike
from vfm_sdm.stages.tracking.segments import Work, plan_segments, track_segment
from vfm_sdm.stages.tracking.views import track_views

SEGMENT_S = 30.0
FRAMES = 400


def track(film, segment_s=SEGMENT_S):
    points, subsets = points_of_view()
    work = Work(segment_s=segment_s)
    return track_views({"left": film.video}, points, IcgnTracker(), subsets=subsets, work=work)["left"]


def targets(points=POINTS):
    return Targets(points, NAMES, [SubsetDesign(41)] * len(NAMES))


def plan(film, tracker=None):
    return plan_segments(film.video, tracker or IcgnTracker(), targets(), SEGMENT_S)


def numbers(tasks):
    """Numbers of the references of the points in each segment."""
    found = np.zeros((len(tasks), len(NAMES)), int)
    for row, task in enumerate(tasks):
        for one in task.start or ():
            found[row, one.rows] = one.number
    return found


def relative_error(film, tracks):
    """Errors over their stated standard deviations, shape (T, P, 2)."""
    std = np.sqrt(np.einsum("tpii->tpi", tracks["position_covariance"].values))
    return film.error(tracks)[1:] / std[1:]


@pytest.fixture(scope="module")
def half_turn(tmp_path_factory):
    """Light that turns by half a circle: what was dark is bright in the end."""
    return LitFilm(tmp_path_factory.mktemp("half turn"), np.linspace(0, 180, FRAMES))


@pytest.fixture(scope="module")
def renewed(half_turn):
    return track(half_turn)


def test_samples_are_kept_while_light_turns_by_half_a_circle(half_turn, renewed):
    assert (renewed["status"].values == Status.OK).mean() >= 0.99
    relative = relative_error(half_turn, renewed)
    assert np.sqrt((relative**2).mean()) < 1
    assert np.sqrt((relative[-20:].mean(axis=0) ** 2).mean()) < 1
    assert (np.abs(relative[-20:].mean(axis=0)) < 2).all()
    # A bound that says nothing would be met as well.
    assert np.sqrt(renewed["position_covariance"].values[-1, :, 0, 0]).max() < 0.5


def test_without_renewal_points_are_lost(tmp_path):
    alone = track(LitFilm(tmp_path / "alone", np.linspace(0, 180, FRAMES // 4)), segment_s=1e9)
    assert "reference" not in alone
    assert (alone["status"].values == Status.OK).mean() < 0.5
    assert (alone["status"].values[FRAMES // 8 :] != Status.OK).all()


def test_tracks_say_what_the_chain_of_references_adds(renewed):
    references = renewed["reference_frame"].values
    assert references[0] == 0
    assert len(references) > 4
    assert set(np.unique(renewed["reference"])) == set(references)
    added = renewed["reference_covariance"]
    for point in NAMES:
        chain = np.einsum("rii->r", added.sel(point=point).values)
        chain = chain[np.isfinite(chain)]
        assert chain[0] == 0
        assert (np.diff(chain) > 0).all()
    last = added.sel(point="a", reference_frame=int(renewed["reference"].values[-1, 0])).values
    own = renewed["position_covariance"].values[-5:, 0] - last
    assert (np.linalg.eigvalsh(own) > 0).all()


def test_drift_has_one_sign_while_light_goes_on(half_turn, renewed):
    # Which is why standard deviations are added along a chain: as independent errors, links would understate it.
    of_quarters = half_turn.error(renewed).reshape(4, FRAMES // 4, -1).mean(axis=1)
    worst = np.abs(of_quarters[-1]).argmax()
    assert (np.diff(of_quarters[:, worst]) * np.sign(of_quarters[-1, worst]) > 0).all()


def test_a_task_gives_the_same_in_another_process(half_turn):
    tasks = plan(half_turn)
    renewed_in = int(np.flatnonzero(numbers(tasks).any(axis=1))[3])
    assert len(tasks[renewed_in].start) >= 1
    here = track_segment(tasks[renewed_in])
    there = track_segment(pickle.loads(pickle.dumps(tasks[renewed_in].on_one_thread())))
    assert here.identical(there)
    again = plan(half_turn, IcgnTracker(threads=1))
    assert (numbers(again) == numbers(tasks)).all()
    for first, second in zip(tasks[-1].start, again[-1].start, strict=True):
        assert (first.points == second.points).all()
        assert (first.covariance == second.covariance).all()


def test_light_that_comes_back_takes_up_old_references(tmp_path):
    film = LitFilm(tmp_path / "back", np.concatenate([np.linspace(0, 60, 100), np.linspace(60, 0, 100)]), seed=1)
    tracks = track(film)
    assert tracks["reference"].values[80:120].min() > 0
    assert (tracks["reference"].values[-10:] == 0).all()
    assert np.abs(film.error(tracks)[-10:]).max() < 0.05
    # It needs none but those of the way there.
    assert tracks["reference_frame"].max() <= 110


def test_points_are_taken_up_again_after_a_night(tmp_path):
    azimuth = np.concatenate([np.linspace(0, 50, 100), np.full(45, np.nan), np.linspace(0, 20, 55)])
    film = LitFilm(tmp_path / "night", azimuth, seed=2)
    tracks = track(film)
    status = tracks["status"].values
    assert (status[:98] == Status.OK).mean() > 0.97
    assert (status[101:144] == Status.LOST).all()
    assert (status[152:] == Status.OK).mean() > 0.97
    assert (tracks["reference"].values[160:] == 0).all()
    assert np.nanmax(np.abs(film.error(tracks)[152:])) < 0.1


def test_nothing_is_renewed_in_light_that_stays(tmp_path):
    film = LitFilm(tmp_path / "still", np.zeros(120))
    tasks = plan(film)
    assert len(tasks) > 8
    assert (numbers(tasks) == 0).all()
    assert all(len(task.start) == 1 for task in tasks[1:])
    assert "reference" not in track(film)


def test_noise_is_no_reason(tmp_path):
    film = LitFilm(tmp_path / "weak", np.zeros(100), contrast=16.0)
    tasks = plan(film)
    bank = SubsetBank.prepare(film.video.frame(0).luma, POINTS, designs=[SubsetDesign(41)] * 3)
    found = bank.register(film.video.frame(50).luma, POINTS + film.moved[50])
    assert (found.correlation < 0.9).all()
    assert (numbers(tasks) == 0).all()


def test_what_passes_before_a_point_becomes_no_part_of_a_reference(tmp_path):
    def pass_by(number, picture):
        if 49 <= number <= 52:
            picture[28:62, 64:72] = 90

    film = LitFilm(tmp_path / "passes", np.zeros(120), change=pass_by)
    bank = SubsetBank.prepare(film.video.frame(0).luma, POINTS, designs=[SubsetDesign(41)] * 3)
    covered = bank.register(film.video.frame(50).luma, POINTS + film.moved[50]).correlation[0]
    assert 0.6 < covered < 0.9
    tasks = plan(film)
    assert [task.first for task in tasks].count(50) == 1
    assert (numbers(tasks) == 0).all()


def test_a_damaged_first_frame_leaves_all_as_it_was(tmp_path):
    film = LitFilm(tmp_path / "damaged", np.zeros(60))
    (tmp_path / "damaged" / "00030.png").write_bytes(b"no picture")
    tasks = plan(film)
    damaged = [task.first for task in tasks].index(30)
    before, at = tasks[damaged - 1].start[0].state, tasks[damaged].start[0].state
    assert (before.warps == at.warps).all()


def test_samples_are_kept_where_light_strains_a_subset_by_the_limit_of_a_translation(tmp_path):
    film = LitFilm(tmp_path / "strain", 180 * np.arange(140) / 399, coarsest_px=60.0)
    reference, later = film.video.frame(70).luma, range(115, 140)
    home = POINTS + film.moved[70]
    bank = SubsetBank.prepare(reference, home, designs=[SubsetDesign(41)] * 3)
    for exact in (False, True):
        ends = []
        for number in later:
            warps = np.concatenate([bank.centers, np.tile([1.0, 0.0, 0.0, 1.0], (3, 1))], axis=1)
            warps[:, :2] += film.moved[number] - film.moved[70]
            ends.append(bank.run(film.video.frame(number).luma, np.arange(3), warps, exact=exact).converged)
        assert np.all(ends) == exact
    # What is lost here is not found; what sunk correlation is taken for comes later.
    followed = IcgnTracker().of_whole_subsets().follow(film.video, film.video.frame(70), targets(home))
    assert (followed["status"].values[later] == Status.OK).all()


def test_standard_deviations_add_up_however_alike_errors_are():
    rng = np.random.default_rng(0)
    for _ in range(20):
        A, B = rng.normal(0, 1, (2, 2, 2))
        first, second = A @ A.T, B @ B.T
        bound = add_alike(first, second)
        turn = np.linalg.qr(rng.normal(0, 1, (2, 2)))[0]
        cross = A @ turn @ B.T
        assert np.linalg.eigvalsh(bound - (first + second + cross + cross.T)).min() > -1e-9
    assert add_alike(first, np.zeros((2, 2))).tolist() == first.tolist()
