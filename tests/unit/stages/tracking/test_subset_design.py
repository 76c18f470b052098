"""What a point's subset compares, on sequences whose layers and motions are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from moving_frames import digitize, memory_video
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.stages.registration.designs import Warp
from vfm_sdm.stages.registration.subsets import SubsetBank
from vfm_sdm.stages.tracking.design import samples
from vfm_sdm.stages.tracking.design.belief import _is_sure
from vfm_sdm.stages.tracking.design.coarse import coarse_motion
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.subset_design import describe_subsets, design_subsets

SIZE, MIDDLE = 181, 90
FRAMES = 24
NOISE = 1.5
STILL = np.zeros((FRAMES, 2))
PHASE = 2 * np.pi * np.arange(FRAMES) / FRAMES
SWAY = np.stack([0.7 * np.sin(2 * PHASE), 1.1 * (np.cos(PHASE) - 1)], axis=1)
"""Motion in pixels (u, v), zero in the first frame, as of a structure: 0.5 and 0.8 px (rms)."""


def texture(seed, contrast=40.0, blur=1.6):
    """A random surface, mean 128 grey levels."""
    rough = gaussian_filter(np.random.default_rng(seed).normal(0, 1, (SIZE, SIZE)), blur)
    return 128 + contrast * rough / rough.std()


def bars(period=120.0, at=None, low=90.0, high=170.0):
    """A single vertical edge through the middle, as sharp as a lens makes it."""
    columns = np.arange(SIZE) - (MIDDLE if at is None else at)
    return np.tile(low + (high - low) / (1 + np.exp(-columns / 0.8)), (SIZE, 1))


def film(layers, *, noise=NOISE, seed=0):
    """Frames of layers, the farthest first: image, opacity (H, W) and motion (T, 2) of each."""
    rng = np.random.default_rng(seed)
    frames = []
    for k in range(FRAMES):
        picture = np.zeros((SIZE, SIZE))
        for image, opacity, motion in layers:
            u, v = motion[k]
            moved, cover = (shift(layer, (v, u), order=5, mode="nearest") for layer in (image, opacity))
            picture = picture * (1 - np.clip(cover, 0, 1)) + moved * np.clip(cover, 0, 1)
        frames.append(digitize(picture, rng, noise))
    return memory_video(frames, fps=20.0)


def box(u0, u1, v0, v1):
    """Opacity of a rectangle with the soft border that a lens gives it."""
    opaque = np.zeros((SIZE, SIZE))
    opaque[v0:v1, u0:u1] = 1.0
    return gaussian_filter(opaque, 0.7)


EVERYWHERE = np.ones((SIZE, SIZE))
POINT = np.array([[90.0, 90.0]])


def lit_film(image, motion, light, *, seed=0):
    """Frames of one surface that moves, under the light of each frame, ``light(k)`` of shape (H, W)."""
    rng = np.random.default_rng(seed)
    moved = [shift(image, motion[k][::-1], order=5, mode="nearest") for k in range(FRAMES)]
    return memory_video([digitize(picture * light(k), rng, NOISE) for k, picture in enumerate(moved)], fps=20.0)


def soft_shadow(k):
    """Light under a shadow whose soft lower border sways by 5 px over the point, three times while it is filmed."""
    rows = np.arange(SIZE)[:, None] - MIDDLE - 5 * np.sin(3 * PHASE[k])
    return np.tile(1 - 0.5 / (1 + np.exp(rows / 6)), (1, SIZE))


def choose(video, point=POINT, subset_px=41):
    return design_subsets(video, point, [f"p{k}" for k in range(len(point))], subset_px=subset_px)[0]


def track_error(video, choice, motion, point=POINT):
    """Root mean square difference from a known motion, across an edge or along u and v, [px]."""
    tracks = IcgnTracker().track(video, point, names=["p"], designs=[choice.design])
    found = tracks["position"].values[:, 0] - point[0]
    axes = np.eye(2) if choice.design.across is None else choice.design.across[None, :]
    return np.sqrt(np.mean(((found - motion) @ axes.T) ** 2, axis=0))


class TestOneSurface:
    def test_a_textured_surface_is_believed_whole_and_registered_in_both_directions(self):
        video = film([(texture(0), EVERYWHERE, SWAY)])
        choice = choose(video)
        assert choice.status == PointStatus.OK
        assert choice.design.warp != Warp.EDGE
        assert choice.design.mask is None
        assert choice.believed == 1.0
        assert (track_error(video, choice, SWAY) < 0.02).all()

    def test_the_expected_standard_deviation_is_that_of_the_track(self):
        video = film([(texture(1, contrast=12), EVERYWHERE, SWAY)], noise=3.0)
        choice = choose(video, subset_px=31)
        error = track_error(video, choice, SWAY)
        assert (error < 2 * choice.std_px.max()).all()
        assert (error > choice.std_px.min() / 3).all()

    def test_nothing_is_masked_where_nothing_moves(self):
        choice = choose(film([(texture(2), EVERYWHERE, STILL)]))
        assert choice.believed == 1.0
        assert choice.design.mask is None

    def test_weak_texture_is_registered_with_fewer_parameters_than_strong_texture(self):
        def freedoms(contrast):
            video = film([(texture(3, contrast, blur=3.0), EVERYWHERE, SWAY)])
            frame = next(iter(video.frames())).luma
            return SubsetBank.prepare(frame, POINT, designs=[choose(video).design]).freedoms[0]

        assert freedoms(8.0) < freedoms(60.0) == 6


class TestEdges:
    def test_an_edge_is_tracked_across_and_its_direction_stated(self):
        video = film([(bars(), EVERYWHERE, SWAY)])
        choice = choose(video)
        assert choice.design.warp == Warp.EDGE
        assert abs(choice.design.across[0]) == pytest.approx(1, abs=0.01)
        assert np.isinf(choice.std_px[1])
        assert track_error(video, choice, SWAY) < 0.03

    def test_a_point_beside_an_edge_takes_the_nearest_texture(self):
        video = film([(bars(at=MIDDLE + 12), EVERYWHERE, SWAY)])
        choice = choose(video)
        assert choice.design.warp == Warp.EDGE
        assert track_error(video, choice, SWAY) < 0.03

    @pytest.mark.parametrize("turn_deg", [0, 45])
    def test_an_edge_of_many_grey_levels_is_an_edge(self, turn_deg):
        turn = np.radians(turn_deg)
        columns, rows = np.meshgrid(*[np.arange(SIZE) - MIDDLE] * 2)
        away = columns * np.cos(turn) + rows * np.sin(turn)
        # Moved exactly, and without noise: what is left is rounding.
        shifts = SWAY @ [np.cos(turn), np.sin(turn)]
        frames = [digitize(20 + 215 / (1 + np.exp(-(away - s) / 0.8)), dtype=np.uint16, scale=257.0) for s in shifts]
        choice = choose(memory_video(frames, fps=20.0))
        assert choice.status == PointStatus.OK
        assert choice.design.warp == Warp.EDGE
        assert np.abs(choice.design.across @ [np.cos(turn), np.sin(turn)]) == pytest.approx(1, abs=1e-3)

    def test_motion_along_what_shows_nothing_is_not_sure_where_rounding_leaves_a_singular_matrix(self):
        covariance = np.full((2, 2), 5e3)
        along, across = np.array([[3.0, 3.0]]), np.array([[3.0, -3.0]])
        assert not _is_sure(along, covariance)
        assert _is_sure(across, covariance)


class TestLight:
    """Light that moves is no motion, and what it does to the brightness is taken out where it shows."""

    def test_a_soft_shadow_that_sways_over_a_point_moves_it_by_no_more_than_is_stated(self):
        video = lit_film(texture(24, contrast=24), SWAY, soft_shadow)
        choice = choose(video)
        plain = replace(choice, design=replace(choice.design, shading=0))
        error = track_error(video, choice, SWAY)
        assert choice.design.shading > 0
        assert (error < 1.5 * choice.std_px.max()).all()
        assert error.max() < track_error(video, plain, SWAY).max() / 2

    def test_steady_light_leaves_the_texture_to_the_motion(self):
        for contrast in (12, 40):
            choice = choose(film([(texture(25, contrast), EVERYWHERE, SWAY)]))
            assert choice.design.shading == 0

    def test_brightness_that_all_of_a_point_shares_is_a_gain(self):
        choice = choose(lit_film(texture(26, contrast=24), SWAY, lambda k: 1 - 0.3 * np.sin(PHASE[k]) ** 2))
        assert choice.design.shading == 0

    def test_shadows_far_from_an_edge_do_not_move_it(self):
        columns = np.arange(SIZE)[None, :] - MIDDLE

        def far_shadow(k):
            return np.tile(1 - 0.4 / (1 + np.exp((24 + 5 * np.sin(3 * PHASE[k]) - columns) / 2)), (SIZE, 1))

        video = lit_film(bars(), SWAY, far_shadow)
        choice = choose(video, subset_px=61)
        whole = replace(choice, design=replace(choice.design, mask=None, shading=0))
        error = track_error(video, choice, SWAY)
        assert choice.design.warp == Warp.EDGE
        assert error < 0.03
        assert error < track_error(video, whole, SWAY) / 2

    def test_what_was_chosen_is_said(self):
        described = describe_subsets(["p0"], [choose(lit_film(texture(24, contrast=24), SWAY, soft_shadow))])
        assert described["shading"].item() > 0


class TestRefused:
    def test_a_flat_place_is_refused_with_the_nearest_place_that_would_do(self):
        surface = np.full((SIZE, SIZE), 128.0)
        surface[:, 125:] = texture(4)[:, 125:]
        video = film([(surface, EVERYWHERE, SWAY)])
        choice = choose(video)
        assert choice.status == PointStatus.NO_TEXTURE
        assert choice.design is None
        assert 90 < choice.nearest[0] < 130
        assert choose(video, choice.nearest[None]).design.warp != Warp.EDGE

    def test_a_flat_picture_offers_no_other_place(self):
        choice = choose(film([(np.full((SIZE, SIZE), 128.0), EVERYWHERE, SWAY)]))
        assert choice.status == PointStatus.NO_TEXTURE
        assert np.isnan(choice.nearest).all()

    def test_points_of_one_view_are_judged_by_themselves(self):
        surface = texture(5)
        surface[:, :90] = 128.0
        points = np.array([[40.0, 90.0], [140.0, 90.0]])
        flat, rough = design_subsets(film([(surface, EVERYWHERE, SWAY)]), points, ["a", "b"], subset_px=31)
        assert (flat.status, rough.status) == (PointStatus.NO_TEXTURE, PointStatus.OK)


class TestTwoMotions:
    def test_still_background_around_a_moving_patch_is_masked(self):
        """Most of the square stands still: the majority has no say."""
        patch = box(80, 102, 80, 102)
        video = film([(texture(6), EVERYWHERE, STILL), (texture(7), patch, SWAY)])
        choice = choose(video, subset_px=61)
        moving = patch[60:121, 60:121] > 0.5
        assert choice.design.mask[moving].mean() > 0.7
        assert choice.design.mask[~moving].mean() < 0.1
        assert choice.believed == pytest.approx(moving.mean(), abs=0.06)
        assert (track_error(video, choice, SWAY) < 0.06).all()

    def test_moving_surroundings_of_a_still_patch_are_masked(self):
        patch = box(78, 104, 78, 104)
        video = film([(texture(8), EVERYWHERE, SWAY), (texture(9), patch, STILL)])
        choice = choose(video, subset_px=61)
        still = patch[60:121, 60:121] > 0.5
        assert choice.design.mask[still].mean() > 0.7
        assert choice.design.mask[~still].mean() < 0.2
        assert (track_error(video, choice, STILL) < 0.05).all()

    def test_a_post_before_leaves_is_tracked_across_it_only(self):
        """Where the leaves end at the post they make corners, which move with neither."""
        plain = np.full((SIZE, SIZE), 60.0)
        video = film([(texture(10), EVERYWHERE, STILL), (plain, box(86, 96, 0, SIZE), SWAY)])
        choice = choose(video, point=np.array([[90.0, 90.0]]), subset_px=61)
        assert choice.design.warp == Warp.EDGE
        assert abs(choice.design.across[0]) > 0.98
        assert choice.believed < 0.6
        assert track_error(video, choice, SWAY) < 0.08

    @pytest.mark.parametrize("seed", [0, 1])
    def test_a_post_before_leaves_in_trembling_air_is_tracked_across_it_only(self, seed):
        """Nothing stands still: the leaves tremble as the post does, as far as it moves."""
        air = np.random.default_rng(seed).normal(0, 0.35, (FRAMES, 2))
        air -= air[0]
        plain, motion = np.full((SIZE, SIZE), 60.0), 0.7 * SWAY + air
        video = film([(texture(10), EVERYWHERE, air), (plain, box(86, 96, 0, SIZE), motion)])
        choice = choose(video, subset_px=61)
        assert choice.design.warp == Warp.EDGE
        assert abs(choice.design.across[0]) > 0.98
        assert choice.believed < 0.3

    @pytest.mark.parametrize("period", [26, 34])
    def test_joints_of_a_wall_behind_balusters_do_not_tell_their_motion(self, period):
        rows, columns = np.arange(SIZE)[:, None] + 0 * np.arange(SIZE), 0 * np.arange(SIZE)[:, None] + np.arange(SIZE)
        wall = gaussian_filter(np.where(rows % 13 < 3, 125.0, 100.0), 0.7)
        railing = gaussian_filter((((columns - MIDDLE + 4) % period) < 8).astype(float), 0.7)
        # What moves sideways as a railing does: a wall that stands still agrees with it along every joint.
        sideways = np.stack([SWAY[:, 1], 0 * SWAY[:, 1]], axis=1)
        video = film([(wall, EVERYWHERE, STILL), (np.full((SIZE, SIZE), 85.0), railing, 0.3 * sideways)], noise=2.5)
        choice = choose(video, subset_px=61)
        assert choice.design.warp == Warp.EDGE
        assert abs(choice.direction[0]) > 0.99
        assert (track_error(video, choice, 0.3 * sideways) < 0.08).all()

    def test_texture_in_both_directions_that_moves_in_one_is_measured_in_both(self):
        upwards = np.stack([0 * SWAY[:, 1], SWAY[:, 1]], axis=1)
        choice = choose(film([(texture(4, contrast=12), EVERYWHERE, upwards)], noise=3.0))
        assert choice.design.warp != Warp.EDGE

    def test_two_layers_that_both_move_are_told_apart(self):
        other = 0.8 * SWAY[:, ::-1]
        video = film([(texture(11), EVERYWHERE, other), (texture(12), box(75, 107, 75, 107), SWAY)])
        choice = choose(video, subset_px=61)
        assert choice.believed < 0.5
        assert (track_error(video, choice, SWAY) < 0.06).all()

    def test_a_square_cut_by_a_deck_is_believed_on_the_named_side(self):
        half = box(0, SIZE, 100, SIZE)
        video = film([(texture(13), EVERYWHERE, STILL), (texture(14), half, SWAY)])
        for row, motion in ((88.0, STILL), (112.0, SWAY)):
            choice = choose(video, point=np.array([[90.0, row]]), subset_px=41)
            assert choice.design.mask is not None
            assert (track_error(video, choice, motion, np.array([[90.0, row]])) < 0.05).all()


class TestSizes:
    def test_strong_texture_gets_the_smallest_square(self):
        assert choose(film([(texture(15), EVERYWHERE, SWAY)]), subset_px=None).design.subset_px == 41

    def test_weak_texture_gets_a_larger_one(self):
        choice = choose(film([(texture(16, contrast=6, blur=3.0), EVERYWHERE, SWAY)], noise=3.0), subset_px=None)
        assert choice.design.subset_px > 41

    def test_a_named_size_is_kept(self):
        assert choose(film([(texture(17), EVERYWHERE, SWAY)]), subset_px=33).design.subset_px == 33

    def test_a_point_at_the_border_keeps_a_whole_square_of_the_usual_size(self):
        choice = choose(film([(texture(18), EVERYWHERE, SWAY)]), point=np.array([[5.0, 90.0]]), subset_px=None)
        assert (choice.design.subset_px, choice.design.mask, choice.status) == (41, None, PointStatus.OK)


class TestInputs:
    def test_a_size_that_is_even_is_refused(self):
        with pytest.raises(SessionError, match="subset_px: expected an odd number"):
            choose(film([(texture(19), EVERYWHERE, STILL)]), subset_px=40)

    def test_a_reference_frame_that_the_video_lacks_is_refused(self):
        video = film([(texture(20), EVERYWHERE, STILL)])
        with pytest.raises(Exception, match="expected a frame 99"):
            design_subsets(video, POINT, ["p"], reference_frame=99)

    def test_one_frame_tells_nothing(self):
        video = memory_video([digitize(texture(21))])
        choice = choose(video)
        assert choice.status == PointStatus.OK
        assert np.isnan(choice.std_px).all()

    def test_another_reference_frame_is_the_one_compared(self):
        video = film([(texture(22), EVERYWHERE, SWAY)])
        sampled = samples.sample_windows(video, POINT, half_px=20, reference_frame=12)
        later = list(video.frames())[12].luma
        np.testing.assert_array_equal(sampled.windows[0][0], later[70:111, 70:111])

    def test_windows_of_points_at_the_border_repeat_it(self):
        video = film([(texture(23), EVERYWHERE, STILL)])
        window = samples.sample_windows(video, np.array([[3.0, 90.0]]), half_px=20).windows[0][0]
        assert window.shape == (41, 41)
        assert (window[:, 0] == window[:, 17]).all()


def test_the_dataset_says_what_was_chosen():
    choice = choose(film([(bars(), EVERYWHERE, SWAY)]))
    described = describe_subsets(["p0"], [choice])
    assert described["warp"].values.tolist() == ["edge"]
    assert described["expected_std"].attrs["units"] == "px"
    assert np.isinf(described["expected_std"].sel(direction="along").item())


class TestFarMotion:
    """Motion beyond the reach of a registration that starts from rest: states of a load test, large swings."""

    STATES = np.array([[0, 0], [2.1, 0.3], [4.3, 0.4], [6.2, 0.6], [8.4, 0.7]])

    def photographs(self, picture):
        rng = np.random.default_rng(0)
        return memory_video([digitize(shift(picture, state[::-1]), rng, NOISE) for state in self.STATES], fps=1.0)

    def test_a_few_photographs_far_from_each_other_are_followed(self):
        video = self.photographs(texture(6))
        choice = choose(video)
        assert choice.status == PointStatus.OK
        assert choice.believed > 0.95
        assert choice.std_px.max() < 0.02
        assert (track_error(video, choice, self.STATES) < 0.02).all()

    def test_an_edge_that_moves_far_stays_an_edge(self):
        choice = choose(self.photographs(bars()))
        assert choice.design.warp == Warp.EDGE
        assert abs(choice.design.across[0]) == pytest.approx(1, abs=0.01)

    def test_a_large_swing_before_a_still_background_is_the_points(self):
        swing = 12 * SWAY
        wall, post = texture(7), texture(8)
        video = film([(wall, EVERYWHERE, STILL), (post, box(60, 121, 0, 181), swing)])
        choice = choose(video)
        assert choice.status == PointStatus.OK
        assert choice.std_px.max() < 0.05
        assert choice.believed > 0.9

    def test_motion_is_found_to_a_pixel_and_left_to_the_registration_where_it_is_small(self):
        moved = [shift(texture(9), state[::-1], mode="reflect").astype(np.uint8) for state in (*self.STATES, (60, -40))]
        found = coarse_motion(np.stack(moved)[:, 20:-20, 20:-20], 31)
        np.testing.assert_array_equal(found[0], 0)
        assert np.abs(found[-2] - self.STATES[-1]).max() <= 2
        unrelated = np.stack([moved[0], texture(10).astype(np.uint8)])
        np.testing.assert_array_equal(coarse_motion(unrelated, 31), 0)

    def test_of_bricks_that_repeat_the_nearest_is_taken(self):
        tile = texture(11)[:20, :20]
        bricks = np.tile(tile, (9, 9))[:-1, :-1].astype(np.uint8)
        found = coarse_motion(np.stack([bricks, np.roll(bricks, 7, axis=1)]), 31)
        assert np.abs(found[0] - [7, 0]).max() <= 2


def test_a_flat_part_of_a_picture_is_nowhere_to_go():
    """Where a picture is flat, as a clipped sky is, correlation coefficients mean nothing."""
    rng = np.random.default_rng(4)
    first = np.kron(rng.integers(60, 200, (30, 30)), np.ones((4, 4)))[:119, :119]
    first[:, :40] = 128
    later = np.roll(first, 1, axis=1)
    later[:, :40] = 128
    np.testing.assert_array_equal(coarse_motion(np.stack([first, later]).astype(np.uint8), 41), 0)
