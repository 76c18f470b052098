"""What looks like a point: never taken for it after a loss; and what a point looks like after it turned."""

import cv2
import numpy as np

from moving_frames import NaturalTexture, digitize, memory_video
from vfm_sdm.core.datasets import Status
from vfm_sdm.stages.registration.subsets import SubsetBank, SubsetDesign
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.templates import WarpedTemplates
from vfm_sdm.stages.tracking.whereabouts import LookAlikes, Whereabouts

PITCH, FRAMES = 150.0, 75
SWING = 60 * np.sin(2 * np.pi * 0.27 * np.arange(FRAMES) / 20)


def rows_of_dots(hidden, columns=620):
    """Equal dots, 150 px apart, that swing together; something is held before the first one in some frames."""
    rng = np.random.default_rng(0)
    frames = []
    for number, x in enumerate(SWING):
        image = np.full((4 * 130, 4 * columns), 60, np.uint8)
        for left in 4 * (110 + PITCH * np.arange(4) + x):
            cv2.rectangle(image, (int(left - 96), 4 * 65 - 96), (int(left + 96), 4 * 65 + 96), 230, -1)
            cv2.circle(image, (int(left), 4 * 65), 36, 15, -1)
        if number in hidden:
            image[:, int(4 * (80 + x)) : int(4 * (195 + x))] = 110
        small = cv2.resize(image, (columns, 130), interpolation=cv2.INTER_AREA)
        frames.append(digitize(cv2.GaussianBlur(small.astype(float), (0, 0), 0.8), rng, 2.0))
    return frames


def track(frames, points):
    names = [f"p{number}" for number in range(len(points))]
    return IcgnTracker().track(memory_video(frames), np.array(points), names=names)


def error_of(tracks, point):
    return tracks["position"].values[:, point, 0] - tracks["position"].values[0, point, 0] - SWING


def test_a_point_that_was_hidden_does_not_come_back_as_its_neighbour():
    tracks = track(rows_of_dots(range(18, 50)), [[110.0, 65.0], [260.0, 65.0]])
    found = tracks["status"].values[:, 0] == Status.OK
    assert np.abs(error_of(tracks, 0)[found]).max() < 0.3
    assert found[:18].all()
    assert found[55:].mean() > 0.8  # the neighbour's motion says which one it is
    assert (tracks["status"].values[:, 1] == Status.OK).all()


def test_alone_it_is_not_trusted():
    tracks = track(rows_of_dots(range(18, 50)), [[110.0, 65.0]])
    wrong = np.abs(np.nan_to_num(error_of(tracks, 0))) > 3
    assert wrong.any()
    assert (tracks["status"].values[wrong, 0] == Status.UNRELIABLE).all()


def test_a_short_loss_leaves_no_doubt():
    tracks = track(rows_of_dots([30]), [[110.0, 65.0]])
    found = np.arange(FRAMES) != 30
    assert (tracks["status"].values[found, 0] == Status.OK).all()


def test_a_unique_point_comes_back_whatever_happened():
    texture = NaturalTexture(21, contrast=28)
    shifts = 15 * np.sin(np.arange(40) / 5)
    frames = [digitize(texture.image((shift, 0.0)), np.random.default_rng(1), 2.0) for shift in shifts]
    for number in range(15, 30):
        frames[number][:] = 90
    tracks = track(frames, [[128.0, 128.0]])
    status = tracks["status"].values[:, 0]
    assert (status[15:30] == Status.LOST).all()
    assert (np.delete(status, range(15, 30)) == Status.OK).all()


def test_motion_is_learnt_from_a_neighbour_that_moves_more():
    home = np.array([[100.0, 50.0], [300.0, 50.0]])
    whereabouts = Whereabouts(home.copy(), 40)
    motion = 20 * np.sin(np.arange(60) / 6)
    for x in motion:
        whereabouts.add(home + np.array([[0.4 * x, 0.0], [x, 0.0]]))
    for _ in range(30):
        whereabouts.add(np.array([[np.nan, np.nan], home[1]]))
    expected = whereabouts.expect(0, np.array([[np.nan, np.nan], [318.0, 50.0]]))
    np.testing.assert_allclose(expected.center, [107.2, 50.0], atol=0.2)
    assert expected.radius < 5
    alone = whereabouts.expect(0, np.full((2, 2), np.nan))
    assert alone.radius > 20


def test_only_what_resembles_as_much_counts():
    alike = LookAlikes(np.array([[10.0, 0.0], [0.0, 30.0]]), np.array([0.99, 0.7]))
    assert alike.as_good_as(0.98).tolist() == [[10.0, 0.0]]
    assert len(alike.as_good_as(0.7)) == 2


def test_a_template_turns_with_its_point_and_its_mask():
    image = digitize(NaturalTexture(21, contrast=28).image())
    mask = np.zeros((31, 31), bool)
    mask[:, 20:] = True
    point = np.array([[128.0, 128.0]])
    bank = SubsetBank.prepare(image, point, designs=[SubsetDesign(31, mask=mask)])
    templates = WarpedTemplates(image, bank)
    angle = np.radians(90)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    straight, kept = templates.cut(0, np.array([1.0, 0.0, 0.0, 1.0]))
    turned, design = templates.cut(0, turn.ravel())
    assert kept.mask is mask
    np.testing.assert_array_equal(turned, np.rot90(straight, -1))
    np.testing.assert_array_equal(design.mask, np.rot90(mask, -1))
